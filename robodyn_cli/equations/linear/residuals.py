"""What is asked of the equations of a mechanism to linearise them.

Derivatives of expressions by steps along the joints' manifolds, and by symbols, as matrices.

The equations of motion and their exact derivatives at states, as arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from robodyn_cli.algorithms.kinematics import position_rates, slice_q
from robodyn_cli.equations.constraints import Constraints
from robodyn_cli.errors import unknown_data
from robodyn_cli.expr.calculus import SparseRow, directional, gradients
from robodyn_cli.expr.graph import Expr, Graph, free_symbols
from robodyn_cli.expr.rebuild import Interpreter
from robodyn_cli.model.model import Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array, Matrix, Values, Vector, identity, zeros


class LinearisedEquations(Protocol):
    """The equations of a mechanism (satisfied by ``Problem``)."""

    model: Model
    graph: Graph
    q: list[Expr]
    v: list[Expr]
    a: list[Expr]

    @property
    def mass_matrix(self) -> Matrix: ...
    @property
    def bias(self) -> Vector: ...
    @property
    def psi(self) -> Matrix: ...
    @property
    def constraints(self) -> Constraints: ...
    def numbers(self, entries: Any, q: Array, t: float = 0.0) -> Array: ...


def step_seeds(problem: LinearisedEquations) -> dict[int, SparseRow]:
    """Return the gradients of the position symbols by steps dq (nv,) along the joints' manifolds, by node.

    A step changes q by the rate that the velocity dq gives: the identity for joints with q-dot = v, half a product of
    quaternions for rotations in space.
    """
    seeds: dict[int, SparseRow] = {}
    for body in problem.model.bodies:
        q = slice_q(body, problem.q)
        rates = [body.joint.velocity_map(q, unit) for unit in identity(body.joint.nv)]
        for k, symbol in enumerate(q):
            seeds[symbol.index] = {body.v + j: rate[k] for j, rate in enumerate(rates)}
    return seeds


def by_steps(problem: LinearisedEquations, entries: Values) -> Matrix:
    """Return d entries / d q (n, nv) by steps along the joints' manifolds."""
    return dense(gradients(list(entries), step_seeds(problem)), problem.model.nv)


def by_symbols(entries: Values, symbols: Sequence[Any]) -> Matrix:
    """Return d entries / d symbols (n, nv)."""
    seeds: dict[int, SparseRow] = {symbol.index: {k: 1.0} for k, symbol in enumerate(symbols)}
    return dense(gradients(list(entries), seeds), len(symbols))


def dense(rows: Sequence[SparseRow], columns: int) -> Matrix:
    """Return sparse rows as a matrix."""
    out = zeros(len(rows), columns)
    for row, entries in zip(out, rows):
        for k, entry in entries.items():
            row[k] = entry
    return out


LAMBDA = "lam"  # symbol group of the multipliers


@record
class States:
    """States of a motion: times (T,), q (T, nq), v and a = v-dot (T, nv).

    tau : torques (T, nv) beside the forces of the equations. a : None where it is what the forces give.
    """

    times: Array
    q: Array
    v: Array
    a: Array | None
    tau: Array

    @staticmethod
    def one(q: Array, v: Array) -> States:
        """Return one state q (nq,), v (nv,) without further torques."""
        return States(np.zeros(1), q[None], v[None], None, np.zeros((1, len(v))))

    def __len__(self) -> int:
        return len(self.times)

    @property
    def groups(self) -> dict[str, Array]:
        return {"t": self.times[:, None], "q": self.q, "v": self.v}


class Residuals:
    """M a + h - f - Psi^T lambda = tau and Psi a + gamma = 0 of a mechanism, f the forces that belong to it.

    Parameters
    ----------
    f : (nv,) as expressions of t, q and v. parameters : values of p.
    """

    def __init__(self, problem: LinearisedEquations, f: Vector, parameters: Sequence[float]) -> None:
        self.problem, self.f, self.parameters = problem, f, parameters
        self.rows = problem.constraints.rows

    @property
    def parts(self) -> dict[str, Any]:
        """``M`` (nv, nv), ``load`` = h - f (nv,), ``Psi`` (m, nv) and ``gamma`` (m,) as expressions of q and v."""
        problem = self.problem
        return {
            "M": problem.mass_matrix,
            "load": problem.bias - self.f,
            "Psi": problem.psi,
            "gamma": np.array(problem.constraints.gamma, dtype=object),
        }

    @property
    def slopes(self) -> dict[str, Matrix]:
        """Derivatives by steps dq along the joints' manifolds and by v, as expressions of q, v, a and lambda.

        ``r_q``, ``r_v`` (nv, nv) of M a + h - f - Psi^T lambda, ``g_q``, ``g_v`` (m, nv) of Psi a + gamma.
        """
        problem, psi = self.problem, self.problem.psi
        multipliers = problem.graph.symbols([row.name for row in self.rows], LAMBDA)
        needed = problem.mass_matrix @ np.array(problem.a, dtype=object) + problem.bias - self.f
        gap = np.array(problem.constraints.gamma, dtype=object)
        if self.rows:
            needed = needed - psi.T @ np.array(multipliers, dtype=object)
            gap = gap + psi @ np.array(problem.a, dtype=object)
        return {
            "r_q": by_steps(problem, needed), "r_v": by_symbols(needed, problem.v),
            "g_q": by_steps(problem, gap), "g_v": by_symbols(gap, problem.v),
        }  # fmt: skip

    def values(self, states: States) -> dict[str, Array]:
        """Return the values of ``parts``: ``M`` (T, nv, nv) and so on."""
        return self._evaluate(self.parts, states, {})

    def derivatives(self, states: States, a: Array, lam: Array) -> dict[str, Array]:
        """Return the values of ``slopes`` at accelerations a (T, nv) and multipliers lam (T, m).

        With them ``w_q`` (T, m, nv) of Psi v + eta_t, and ``bracket`` and ``N``: see ``drift``.
        """
        problem = self.problem
        rate = problem.constraints.velocity_residual(problem.v)
        bracket, N = _brackets(problem)
        outputs = {**self.slopes, "w_q": by_steps(problem, rate), "bracket": bracket, "N": N}
        return self._evaluate(outputs, states, {"a": a, LAMBDA: lam})

    def _evaluate(
        self, outputs: Mapping[str, Any], states: States, more: Mapping[str, Array]
    ) -> dict[str, Array]:
        groups = {**states.groups, **more}
        if self.parameters:
            groups["p"] = np.tile(self.parameters, (len(states), 1))
        return evaluated(outputs, groups)


def evaluated(outputs: Mapping[str, Any], groups: Mapping[str, Array]) -> dict[str, Array]:
    """Return arrays of expressions at samples, {name: (T, *shape)}; groups : (T, n) by symbol group.

    Raises
    ------
    SceneError : they depend on data that the scene does not give.
    """
    entries = {name: np.asarray(x, dtype=object) for name, x in outputs.items()}
    flat = [e for x in entries.values() for e in x.flat]
    missing = [s.value[0] for s in free_symbols(flat) if s.value[1] not in groups]
    if missing:
        raise unknown_data(missing)
    samples = len(next(iter(groups.values())))
    values = iter(Interpreter(flat)({name: x.T for name, x in groups.items()}))
    arrays = {}
    for name, x in entries.items():
        rows = np.empty((samples, x.size))
        for k in range(x.size):
            rows[:, k] = next(values)
        arrays[name] = rows.reshape(samples, *x.shape)
    return arrays


def _brackets(problem: LinearisedEquations) -> tuple[Matrix, Matrix]:
    """Return N (nq, nv) with q-dot = N v, and its bracket with the motion: d(N v)/dq N - d(N e_k)/dq (N v) in column k.

    A motion beside another one is q + N xi with a step xi (nv,). Then xi-dot = dv + K xi with N K = bracket: K vanishes
    where q-dot = v, and is -w x for rotations in body axes.
    """
    model, v = problem.model, problem.v
    if not any(body.joint.quasi for body in model.bodies):
        return zeros(0, model.nv), zeros(0, model.nv)
    rates = position_rates(model, problem.q, v)
    N = np.stack([position_rates(model, problem.q, unit) for unit in identity(model.nv)], axis=1)
    turned = np.array([directional(list(column), problem.q, rates) for column in N.T], dtype=object).T
    return by_steps(problem, rates) - turned, N


def drift(arrays: Mapping[str, Array], sample: int, nv: int) -> Array:
    """Return K (nv, nv) of ``_brackets`` at a sample."""
    if not arrays["N"].shape[1]:
        return np.zeros((nv, nv))
    return np.linalg.pinv(arrays["N"][sample]) @ arrays["bracket"][sample]
