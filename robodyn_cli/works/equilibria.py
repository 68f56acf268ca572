"""Balances of a mechanism: where its forces leave it at rest, within the limits of its joints if they do so there."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import position_rates
from robodyn_cli.equations.contact_joints import moving_freely
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, unknown_data
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.given.loop_conditions import Lead, LoopConditions, velocity_places
from robodyn_cli.model.model import unknown_among
from robodyn_cli.observe.evaluation import cause, without_idle_unknowns
from robodyn_cli.observe.joint_limits import bounds_at_rest
from robodyn_cli.ready.prepare import held_columns
from robodyn_cli.record import record
from robodyn_cli.solve.closing.balance import Balance, balance
from robodyn_cli.solve.closure import CLOSED, CUT, RANK, Numbers, newton, rank_tolerances
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import rounded_up
from robodyn_cli.summaries.mechanism import Held
from robodyn_cli.trajectories.led import led_joints, position_columns
from robodyn_cli.works.rest.terms import RestTerms, SingleRest

STARTS = 12  # within the limits of the joints, where the balance that is reached first is not


@record
class AtRest:
    """A configuration at rest with the torques (nv,) and the multipliers (m,) of the loops that hold it.

    facts : the balance, or how actuators hold it. holding : torques that keep joints in place. terms : the torques
    (nv,) by term, where actuators hold it. starts : within the limits of the joints, of which none led to a balance
    within them. near : the run, whose errors are asked for.
    """

    problem: Problem
    q: Array
    tau: Array
    lam: Array
    facts: Balance | Held
    holding: Mapping[str, float]
    terms: Mapping[str, Array]
    starts: int = 0
    near: SingleRest | None = None


def refuse_unknown(entries: Sequence[Scalar]) -> None:
    """Refuse expressions that depend on data which the scene does not give.

    Raises
    ------
    SceneError
    """
    if missing := unknown_among(entries):
        raise unknown_data(missing)


class RestForces:
    """Generalised forces at rest (see ``solve.closing.balance.Forces``): r = G - tau_passive - tau_a at v = 0, t = 0.

    entries, slopes : r (nv,) and d(r - Psi^T lambda)/dq (nv, nv), column by column, as expressions.
    """

    def __init__(self, problem: Problem, conditions: LoopConditions) -> None:
        model = self.model = problem.model
        self.parameters = moving_freely(problem.contact_joints)  # no joint sticks or rests on a stop
        load = load_at_rest(problem)
        lam = problem.graph.symbols(list(conditions.names), "lam")
        rows = problem.constraints.rows
        held: list[Scalar] = list(load)
        for row, multiplier in zip(rows, lam):  # led rows have a constant Psi
            for k, x in row.entries.items():
                held[k] = held[k] - x * multiplier
        entries: list[Scalar] = []
        for j in range(model.nv):
            unit: list[Any] = [1.0 if k == j else 0.0 for k in range(model.nv)]
            entries += directional(held, problem.q, position_rates(model, problem.q, unit))
        refuse_unknown(load)
        self.entries, self.slopes = load, without_idle_unknowns(entries, load)
        self._load, self._stiffness = Evaluator(load), Evaluator(self.slopes)

    def _values(self, q: Array) -> dict[str, Any]:
        return {"q": q.tolist(), "v": [0.0] * self.model.nv, "t": [0.0], "p": self.parameters}

    def load(self, q: Array) -> Array:
        return np.array(self._load(self._values(q)), dtype=float)

    def stiffness(self, q: Array, lam: Array) -> Array:
        values = {**self._values(q), "lam": lam.tolist()}
        matrix = np.array(self._stiffness(values), dtype=float)
        if not np.isfinite(matrix).all():
            place = ", ".join(f"{name} = {x:.6g}" for name, x in zip(self.model.q_names, q))
            raise NumericalError(
                f"the forces have no finite slope at {place}, so no balance can be sought from there: "
                f"{cause(self.slopes, values)}",
                q=q.tolist(),
            )
        return matrix.reshape(self.model.nv, self.model.nv).T


def load_at_rest(problem: Problem) -> list[Scalar]:
    """Return r = h - tau_passive - tau_a (nv,), the forces that constraints must give where nothing moves."""
    return list(problem.bias - problem.applied)


def staying(problem: Problem, q: Array) -> Lead:
    """Return a lead that keeps the held joints where they are."""
    model = problem.model
    prescribed = position_columns(problem.scene.prescribed)
    held = [x for x in held_columns(problem.scene, problem) if x not in prescribed]
    return Lead.staying(model, held, q[[model.q_names.index(name) for name in held]].tolist())


def staying_places(problem: Problem) -> list[int]:
    """Return the places in v of the coordinates that stay where they are: of held joints and prescribed ones."""
    scene = problem.scene
    return velocity_places(problem.model, [*scene.initial.hold, *led_joints(scene.prescribed)])


def balanced(problem: Problem, q: Array) -> AtRest:
    """Return the balance that is reached downhill from a closed configuration q (nq,), or, where that is beyond a limit
    of a joint, the nearest to q within the limits that random starts there lead to.

    Raises
    ------
    NumericalError : none is found.
    """
    conditions = LoopConditions(problem, staying(problem, q), np.zeros(1))
    forces = RestForces(problem, conditions)
    tolerance = float(rank_tolerances(problem.model, gap_at(problem, q)))
    terms = RestTerms(
        conditions,
        forces.entries,
        list(problem.actuator_torques),
        forces.slopes,
        (forces.parameters, problem.at_start),
    )
    near = SingleRest(conditions, forces, tolerance, problem, terms)
    rest, starts = balance(conditions, forces, q, tolerance), 0
    if rest.converged and not is_within(problem, rest.q):
        within = _balances_within(problem, conditions, forces, q, tolerance)
        starts = 0 if within else STARTS
        rest = min(within, key=lambda one: float(np.linalg.norm(one.q - q)), default=rest)
    if not rest.converged:
        raise NumericalError(
            f"no balance found in {rest.iterations} steps: a force of {rounded_up(rest.residual):.2g} N m or N is "
            "left; start nearer to one (initial.q), or hold joints that nothing balances (initial.hold)",
            residual=rest.residual, q=rest.q.tolist(),
        )  # fmt: skip
    _, J = conditions.at(rest.q, 0.0)
    state = at_balance(problem, rest, problem.numbers(problem.actuator_torques, rest.q), J)
    return dataclasses.replace(state, starts=starts, near=near)


def gap_at(problem: Problem, q: Array) -> float:
    """Return by how much the loops are open at q (nq,) [rad or m]."""
    eta = problem.numbers([row.eta for row in problem.constraints.loop_rows], q)
    return float(np.abs(eta).max(initial=0.0))


def at_balance(problem: Problem, rest: Balance, tau: Array, J: Array) -> AtRest:
    """Return a balance with what holds joints in place. tau : of the scene (nv,). J : of all conditions (m, nv)."""
    staying = rows_that_stay(problem, len(J))
    needed = J[staying].T @ rest.lam[staying]
    holding = {problem.model.v_names[k]: float(needed[k]) for k in staying_places(problem)}
    return AtRest(problem, rest.q, tau + needed, rest.lam[problem.constraints.of_loops], rest, holding, {})


def rows_that_stay(problem: Problem, rows: int) -> list[int]:
    """Return which of all rows of a balance keep joints in place: those that are not of loops."""
    loops = problem.constraints.of_loops
    return [i for i in range(rows) if i not in loops]


def is_within(problem: Problem, q: Array) -> bool:
    """Tell whether joints are within their limits at q (nq,)."""
    bounds = bounds_at_rest(problem.scene, problem.model)
    return all(low <= q[k] <= high for k, (low, high) in bounds.items())


def _balances_within(
    problem: Problem, conditions: LoopConditions, forces: RestForces, q: Array, tolerance: float
) -> list[Balance]:
    """Return the balances within the limits of the joints to which random starts there lead; other joints start as at q
    (nq,)."""
    rng, loops = np.random.default_rng(0), Numbers(problem, problem.at_start)
    balances = []
    for _ in range(STARTS):
        start = q.copy()
        for k, (low, high) in bounds_at_rest(problem.scene, problem.model).items():
            nearest = min(max(q[k], low), high)
            start[k] = rng.uniform(max(low, nearest - np.pi), min(high, nearest + np.pi))
        cut = CUT if tolerance == RANK else tolerance
        closed, left = newton(conditions, start, range(problem.model.nv), cut=cut)
        if left > max(CLOSED, cut) or loops.turned(closed) or not is_within(problem, closed):
            continue
        rest = balance(conditions, forces, closed, tolerance)
        if rest.converged and is_within(problem, rest.q):
            balances.append(rest)
    return balances
