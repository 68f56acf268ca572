"""States at which C is compared with Python: their values there, and what rounding makes of them in each precision."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.over.c99.functions import GROUPS, CFunction, ModelFunctionsOfScene
from robodyn_cli.ready.doors import at_rest
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.record import record
from robodyn_cli.solve.closure import CLOSED, Numbers, newton, rank
from robodyn_cli.solve.independent_rows import RANK_TOLERANCE
from robodyn_cli.solve.load_sharing import accelerations, allowed_motions
from robodyn_cli.spatial.algebra import Array

STATES_COMPARED = 6
STEP = 0.1  # rad or m: how far states of loops lie from the start
ALLOWED = 16.0  # times the error found here may be that of C: other libraries and compilers round otherwise
LEAST = 8.0  # units of rounding that are always allowed
ROUNDING = {"double": 2.0**-53, "single": 2.0**-24}
LOST = {"double": 1e-7, "single": 1e-5}  # part of the largest pivot below which rows depend on others
TYPES: dict[str, Any] = {"double": np.float64, "single": np.float32}


@record
class ComparedOutput:
    """What one output of a function is at all states.

    values : (T, n), correct to double. errors : by precision the largest difference, in parts of the largest entry, or
    of ``least`` where that is more.
    """

    function: str
    output: str
    values: Array
    errors: Mapping[str, float]
    least: float = 0.0

    def allowed(self, precision: str) -> float:
        """Return the error that the self test allows, in parts of the largest entry."""
        return ALLOWED * max(self.errors[precision], LEAST * ROUNDING[precision])


@record
class ComparedStates:
    """States by argument (T, n), the outputs at them, q (nq,) and qd (nv,) of the start, and the rank of Psi there."""

    arguments: Mapping[str, Array]
    outputs: tuple[ComparedOutput, ...]
    q: Array
    qd: Array
    rank: int


def compared_states(own: ModelFunctionsOfScene) -> ComparedStates:
    """Return states of a mechanism, closed ones where it has loops, with the values of its functions.

    Raises
    ------
    RobodynError : its loops do not close.
    """
    problem = own.problem
    setup = prepare(at_rest(problem.scene), neutral=True)
    q, v = setup.assembled.q, setup.assembled.v
    rng = np.random.default_rng(7)
    model, count = problem.model, STATES_COMPARED
    if problem.constraints.rows:
        qs, vs = _closed(problem, q, rng)
    else:
        manifold = Manifold(model)
        qs = np.array([q, *(manifold.integrate(q, dq) for dq in rng.normal(size=(count - 1, model.nv)))])
        vs = rng.normal(size=(count, model.nv))
    control = problem.control
    arguments = {
        "t": np.zeros((count, 1)) if problem.constraints.rows else np.linspace(0.0, 1.0, count)[:, None],
        "q": qs,
        "qd": vs,
        "qdd": rng.normal(size=(count, model.nv)),
        "tau": rng.normal(size=(count, model.nv)),
        "z": rng.normal(size=(count, 0 if control is None else len(control.z))),
        "noise": rng.normal(size=(count, 0 if control is None else control.channels)),
    }
    outputs = [x for function in own.functions for x in _compared(function, arguments)]
    psi = problem.numbers(problem.psi, q)
    return ComparedStates(arguments, tuple(outputs), q, v, rank(psi, RANK_TOLERANCE) if psi.size else 0)


def _closed(problem: Problem, q: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return positions (T, nq) near q (nq,) that close the loops at t = 0, and rates (T, nv) that keep them closed."""
    numbers = Numbers(problem, problem.at_start)
    qs, vs = [], []
    for k in range(STATES_COMPARED):
        there, left = q, 0.0
        N = allowed_motions(numbers.psi(q)[None])[0][0]
        if k and N.shape[1]:
            step = N @ rng.normal(size=N.shape[1]) * STEP
            there, left = newton(numbers, numbers.step(q, step), range(problem.model.nv))
        if left > 1e3 * CLOSED:  # too far away: the start closes
            there = q
        psi = numbers.psi(there)
        N = allowed_motions(psi[None])[0][0]
        forced = -np.linalg.lstsq(psi, numbers.eta_t(there), rcond=RANK_TOLERANCE)[0]
        qs.append(there)
        vs.append(forced + N @ rng.normal(size=N.shape[1]))
    return np.array(qs), np.array(vs)


def _compared(function: CFunction, arguments: Mapping[str, Array]) -> list[ComparedOutput]:
    if function.solved:
        return [_solved(function, arguments)]
    values = _values(function, arguments)
    exact = values(np.longdouble)
    rounded = {name: values(kind) for name, kind in TYPES.items()}
    return [
        ComparedOutput(
            function.name,
            name,
            exact[name].astype(float),
            {kind: _difference(values[name], exact[name], output.least) for kind, values in rounded.items()},
            output.least,
        )
        for name, output in function.outputs.items()
    ]


def _difference(values: Array, exact: Array, least: float = 0.0) -> float:
    """Return the largest difference in parts of the largest entry, or of ``least``."""
    most = float(np.abs(exact).max(initial=least))
    return float(np.abs(values - exact).max(initial=0.0)) / most if most else 0.0


def _values(function: CFunction, arguments: Mapping[str, Array]) -> Callable[[Any], dict[str, Array]]:
    """Return what computes the outputs (T, n) of a function in a type of numbers."""
    evaluate = Evaluator([x for output in function.entries.values() for x in output])
    count = len(arguments["q"])

    def values(kind: Any) -> dict[str, Array]:
        inputs = {GROUPS[name]: arguments[name].T.astype(kind) for name in function.takes}
        with np.errstate(all="ignore"):
            flat = evaluate(inputs)
        columns = iter(np.broadcast_to(np.asarray(x, dtype=kind), (count,)) for x in flat)
        return {
            name: np.array([next(columns) for _ in range(output.size)], dtype=kind).T.reshape(
                count, output.size
            )
            for name, output in function.outputs.items()
        }

    return values


def _solved(function: CFunction, arguments: Mapping[str, Array]) -> ComparedOutput:
    """Return the accelerations that follow from the linear equations of a function."""
    shapes = {name: output.entries.shape for name, output in function.outputs.items()}
    values = _values(function, arguments)

    def parts(kind: Any, rounded: Any) -> list[Array]:
        own = values(kind)
        M, load, psi, gamma = (
            own[name].astype(rounded).reshape(-1, *shapes[name]) for name in ("M", "load", "Psi", "gamma")
        )
        return [M, arguments["tau"].astype(rounded) - load, psi, gamma]

    M, f, psi, gamma = parts(np.longdouble, float)
    qdd = accelerations(M, f, psi, gamma, RANK_TOLERANCE)
    errors = {}
    for name, kind in TYPES.items():
        rows = [_eliminated(*one) for one in zip(*parts(kind, kind))]
        errors[name] = _difference(np.array(rows), qdd)
    return ComparedOutput(function.name, "qdd", qdd, errors)


def _eliminated(M: Array, f: Array, psi: Array, gamma: Array) -> Array:
    """Return qdd (nv,) by the operations of ``solve_constrained`` in C, in the precision of its arguments."""
    nv, kind = len(f), M.dtype
    A = np.concatenate([psi, -gamma[:, None]], axis=1)
    rows, columns, rank, first = list(range(len(psi))), list(range(nv)), 0, 0.0
    lost = LOST["double" if kind == np.float64 else "single"]
    while rank < min(len(rows), nv):
        block = np.abs(A[np.ix_(rows[rank:], columns[rank:])])
        i, j = np.unravel_index(int(np.argmax(block)), block.shape)
        first = first or float(block[i, j])
        if not block[i, j] > lost * first:
            break
        for order, k in ((rows, int(i)), (columns, int(j))):
            order[rank], order[rank + k] = order[rank + k], order[rank]
        row, column = rows[rank], columns[rank]
        A[row] /= A[row, column]
        others = [k for k in range(len(psi)) if k != row]
        A[others] -= A[others, column][:, None] * A[row]
        rank += 1
    x, Z = np.zeros(nv, kind), np.zeros((nv - rank, nv), kind)
    x[columns[:rank]] = A[rows[:rank], nv]
    Z[np.arange(nv - rank), columns[rank:]] = 1.0
    Z[:, columns[:rank]] = -A[np.ix_(rows[:rank], columns[rank:])].T
    g = np.linalg.solve(Z @ M @ Z.T, Z @ (f - M @ x)) if nv > rank else x[:0]
    return np.asarray(x + Z.T @ g)
