"""Statics: where a mechanism balances, and what holds it where it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.kinematics import slice_q, slice_v
from robodyn_cli.equations.modes import gates
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError, SingularConfigurationError
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.expr.rebuild import Evaluator, evaluate
from robodyn_cli.formulations.index1 import start_modes
from robodyn_cli.kernels.program import unknown_data
from robodyn_cli.model.model import UNKNOWN_GROUP
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import ABSENT, as_keys
from robodyn_cli.run.driver.prepare import held_columns, initial_positions
from robodyn_cli.run.driver.singularity import loop_rows
from robodyn_cli.run.inverse.program import torque_terms
from robodyn_cli.run.inverse.sharing import lost_rank, refuse_gears
from robodyn_cli.run.mechanism.loop_conditions import Lead, LoopConditions, nothing_led, velocity_places
from robodyn_cli.run.mechanism.mobility import mobility
from robodyn_cli.run.mechanism.prescribed import check_prescribed
from robodyn_cli.run.mechanism.report import add_rows, add_sample
from robodyn_cli.run.mechanism.summary import (
    Balanced,
    ForceResidual,
    Held,
    Residual,
    StaticsSummary,
    Termination,
)
from robodyn_cli.run.observation.evaluation import without_idle_unknowns
from robodyn_cli.run.observation.reactions import Loads, loads_along
from robodyn_cli.run.observation.units import joint_columns
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.assembly import assemble
from robodyn_cli.solve.equilibrium import Balance, balance
from robodyn_cli.solve.load_sharing import LostRank, Shared, TooFewActuators, share
from robodyn_cli.trajectories.motion import JointMotion

Array = NDArray[np.float64]


@record
class AtRest:
    """A configuration at rest with the torques (nv,) and the multipliers (m,) of the loops that hold it.

    terms : the torques (nv,) by term, where actuators hold it.
    """

    problem: Problem
    q: Array
    tau: Array
    lam: Array
    facts: Balanced | Held
    terms: Mapping[str, Array]


@np.errstate(all="ignore")  # what is not finite is refused by name
def statics(scene: Scene, *, progress: Progress = no_progress, watch: Stopwatch | None = None) -> Result:
    """Find the balanced configuration of a scene, or the torques that hold the given one.

    ``balance``: springs, weights, forces and the scene's torques at t = 0 balance; joints in ``initial.hold`` and
    prescribed ones stay, and the torque that this takes is a result. ``hold``: the actuators hold the initial
    configuration; their torques in the scene are ignored.

    Returns
    -------
    A Result of one sample with torques, multipliers and, where asked for, reactions; stability of the balance in the
    summary.

    Raises
    ------
    NumericalError : no balance is found, or a force is not finite. CapabilityError : too few actuators to hold the
    mechanism. GeometryError, SingularConfigurationError : from closing the loops; a dead point of the actuators.
    """
    watch = watch or Stopwatch()
    with watch.stage("equations"):
        problem = Problem(scene)
    with watch.stage("assemble"):
        q = closed_configuration(problem)
    with watch.stage("solve"):
        state = balanced(problem, q) if scene.statics.find == "balance" else held(problem, q)
        refuse_beyond_stops(problem, state.q)
    with watch.stage("evaluate"):
        loads = loads_at_rest(state) if scene.outputs.reactions else None
    progress(0.0, 0.0)
    result = report(state, loads)
    result.summary = as_keys(summarise(state, loads, watch))
    return result


def closed_configuration(problem: Problem) -> Array:
    """Return the initial configuration q (nq,) with the loops closed, held joints where they are."""
    scene = problem.scene
    given = initial_positions(scene, problem)
    held = tuple(dict.fromkeys((*held_columns(scene, problem), *scene.prescribed)))
    check_prescribed(problem)
    return assemble(problem, given, {}, held).q


def refuse_beyond_stops(problem: Problem, q: Array) -> None:
    """Refuse a configuration beyond a rigid stop: what the stop bears is not among the forces that balance.

    Raises
    ------
    CapabilityError
    """
    for gate in gates(problem.model):
        for push, at in gate.stops:
            if push * (q[gate.q] - at) < -1e-9 * max(1.0, abs(at)):
                raise CapabilityError(
                    f"joint {gate.joint!r} would be at {q[gate.q]:.6g}, beyond its rigid stop at {at:.6g}, which "
                    "`statics` does not follow; allowed: stops with 'stiffness', or the joint in 'initial.hold'"
                )


class _RestForces:
    """Generalised forces at rest (see ``solve.equilibrium.Forces``): r = G - tau_passive - tau_a at v = 0, t = 0."""

    def __init__(self, problem: Problem, conditions: LoopConditions) -> None:
        model = self.model = problem.model
        self.modes = start_modes(problem)  # nothing sticks, and no stop is met
        load = list(problem.bias - problem.applied)
        lam = problem.graph.symbols(list(conditions.names), "lam")
        rows = problem.constraints.rows
        held: list[Scalar] = list(load)
        for row, multiplier in zip(rows, lam):  # led rows have a constant Psi
            for k, x in enumerate(row.psi):
                held[k] = held[k] - x * multiplier
        entries: list[Scalar] = []
        for j in range(model.nv):
            unit: list[Any] = [1.0 if k == j else 0.0 for k in range(model.nv)]
            rates: list[Any] = [0.0] * model.nq
            for body in model.bodies:
                moved = body.joint.velocity_map(slice_q(body, problem.q), slice_v(body, unit))
                rates[body.q : body.q + body.joint.nq] = list(moved)
            entries += directional(held, problem.q, rates)
        refuse_unknown(load)
        self._load, self._stiffness = Evaluator(load), Evaluator(without_idle_unknowns(entries, load))

    def _values(self, q: Array) -> dict[str, Any]:
        return {"q": q.tolist(), "v": [0.0] * self.model.nv, "t": [0.0], "p": self.modes}

    def load(self, q: Array) -> Array:
        return np.array(self._load(self._values(q)), dtype=float)

    def stiffness(self, q: Array, lam: Array) -> Array:
        found = self._stiffness({**self._values(q), "lam": lam.tolist()})
        return np.array(found, dtype=float).reshape(self.model.nv, self.model.nv).T


def _stay(problem: Problem, q: Array) -> Lead:
    """Return a lead that keeps the held joints where they are."""
    model = problem.model
    held = [x for x in held_columns(problem.scene, problem) if x not in problem.scene.prescribed]
    quasi = [name for name in problem.scene.initial.hold if model.body_of(name).joint.quasi]
    if quasi:
        raise CapabilityError(
            f"joint {quasi[0]!r} cannot be held in a balance, since its velocities are no rates of positions; use "
            "joints of one axis in its place, or a loop closure of type fixed"
        )
    places = [model.q_names.index(name) for name in held]

    def asked(times: Array) -> tuple[Array, Array, Array]:
        still = np.tile(q[places], (len(times), 1))
        return still, 0.0 * still, 0.0 * still

    return Lead(asked, joints=tuple(held))


def balanced(problem: Problem, q: Array) -> AtRest:
    """Return the balance that is reached downhill from a closed configuration q (nq,).

    Raises
    ------
    NumericalError : none is found.
    """
    conditions = LoopConditions(problem, _stay(problem, q), np.zeros(1))
    found = balance(conditions, _RestForces(problem, conditions), q)
    if not found.converged:
        raise NumericalError(
            f"no balance found in {found.iterations} steps: a force of {found.residual:.3g} N m or N is left; start "
            "nearer to one (initial.q), or hold joints that nothing balances (initial.hold)",
            residual=found.residual, q=found.q.tolist(),
        )  # fmt: skip
    loops = loop_rows(problem)
    tau = np.array(evaluate(list(problem.actuator_torques), at_rest(problem, found.q)), dtype=float)
    _, J = conditions.at(found.q, 0.0)
    holding = [i for i in range(len(conditions.names)) if i not in loops]
    tau += J[holding].T @ found.lam[holding]
    return AtRest(problem, found.q, tau, found.lam[loops], _described(found), {})


def _described(found: Balance) -> Balanced:
    real = bool(np.all(np.abs(found.stiffness.imag) <= 1e-9 * np.abs(found.stiffness).max(initial=1.0)))
    stiffness = found.stiffness.real.tolist() if real else [[x.real, x.imag] for x in found.stiffness]
    return Balanced(found.stability, stiffness, found.residual, found.iterations)


def at_rest(problem: Problem, q: Array) -> dict[str, Any]:
    """Return the values of all symbols at q (nq,), t = 0, at rest."""
    still = [0.0] * problem.model.nv
    return {"q": q.tolist(), "v": still, "a": still, "t": [0.0], "p": []}


def held(problem: Problem, q: Array) -> AtRest:
    """Return the torques of actuators that hold a closed configuration q (nq,).

    Raises
    ------
    CapabilityError : too few actuators. SingularConfigurationError : they cannot hold it there.
    """
    model = problem.model
    if model.closures:
        refuse_gears(problem)
    terms = {name: x for name, x in torque_terms(problem).items() if name not in ("inertia", "coriolis")}
    refuse_unknown([x for term in terms.values() for x in term])
    values = at_rest(problem, q)
    needed = {name: np.array([evaluate(term, values)], dtype=float) for name, term in terms.items()}
    needed = needed or {"gravity": np.zeros((1, model.nv))}
    conditions = LoopConditions(problem, nothing_led(), np.zeros(1))
    _, J = conditions.at(q, 0.0)
    names = _holding(problem)
    shared = _shared(problem, J[loop_rows(problem)], names, needed, q)
    facts = Held(list(names), *shared.uniqueness, shared.residual)
    split = {name: term[0] for name, term in shared.terms.items()}
    return AtRest(problem, q, shared.tau[0], shared.multipliers[0], facts, split)


def _holding(problem: Problem) -> tuple[str, ...]:
    """Return the joints with an actuator: those in ``actuated``, else those that something drives or holds, or all."""
    scene, model = problem.scene, problem.model
    if scene.actuated is not None:
        return scene.actuated
    driven = tuple(dict.fromkeys((*scene.torques, *scene.prescribed, *scene.initial.hold)))
    return driven if model.closures and driven else model.joint_names


def _shared(
    problem: Problem, psi: Array, names: tuple[str, ...], needed: Mapping[str, Array], q: Array
) -> Shared:
    columns = velocity_places(problem.model, names)
    try:
        return share(psi[None], columns, needed)
    except TooFewActuators as few:
        if len(columns) >= few.freedom:
            raise SingularConfigurationError(
                f"dead point of the actuators: {', '.join(names)} cannot hold the mechanism in this configuration, "
                f"which leaves {few.freedom - few.commanded} of its {few.freedom} degrees of freedom to itself",
                kind="dead_point", q=q.tolist(),
            ) from None  # fmt: skip
        raise CapabilityError(
            f"the mechanism has {few.freedom} degrees of freedom, and its actuated joints ({', '.join(names)}) hold "
            f"{few.commanded} of them; name more in 'actuated', or find the balance (statics.find: balance)"
        ) from None
    except LostRank as lost:
        raise lost_rank(problem, lost, np.zeros(1), q[None]) from None


def refuse_unknown(entries: Sequence[Scalar]) -> None:
    """Refuse expressions that depend on data which the scene does not give.

    Raises
    ------
    SceneError
    """
    missing = [s.value[0] for s in free_symbols(entries) if s.value[1] == UNKNOWN_GROUP]
    if missing:
        raise unknown_data(missing)


def loads_at_rest(state: AtRest) -> Loads:
    """Return forces and moments in joints and closures."""
    problem, still = state.problem, np.zeros((1, state.problem.model.nv))
    lam = np.zeros((1, len(problem.constraints.rows)))
    lam[0, loop_rows(problem)] = state.lam
    return loads_along(problem, np.zeros(1), JointMotion(state.q[None], still, still), lam)


def report(state: AtRest, loads: Loads | None) -> Result:
    """Return the datasets of a run."""
    problem = state.problem
    scene, model = problem.scene, problem.model
    result = Result("statics", scene.title or "statics", "ok", scene.text)
    still, columns = np.zeros(model.nv), joint_columns(model)["tau"].described()
    add_sample(result, problem, state.q, still, still)
    result.add("tau", state.tau[None], **columns)
    for name, term in state.terms.items():
        result.add(f"torque_terms/{name}", term[None], **columns)
    rows = [problem.constraints.rows[i] for i in loop_rows(problem)]
    if rows:
        add_rows(result, rows, {"constraints/multipliers": state.lam[None]})
    if loads is not None:
        loads.add_to(result)
    return result


def summarise(state: AtRest, loads: Loads | None, watch: Stopwatch) -> StaticsSummary:
    """Return the summary of a run."""
    problem = state.problem
    model, find = problem.model, problem.scene.statics.find
    rows = [problem.constraints.rows[i] for i in loop_rows(problem)]
    values = at_rest(problem, state.q)
    psi = np.array([evaluate([x for row in rows for x in row.psi], values)], dtype=float)
    eta = np.array(evaluate([row.eta for row in rows], values), dtype=float)
    return StaticsSummary(
        status="ok",
        termination=Termination("balanced" if find == "balance" else "held", 0.0),
        mobility=mobility(problem, psi.reshape(1, len(rows), model.nv)) if rows else ABSENT,
        multipliers=dict(zip([row.name for row in rows], state.lam.tolist())) if rows else ABSENT,
        constraint_residual=Residual(float(np.abs(eta).max())) if rows else ABSENT,
        samples=1,
        find=find,
        configuration=dict(zip(model.q_names, state.q.tolist())),
        torques_of_joints=dict(zip(model.v_names, state.tau.tolist())),
        equilibrium=state.facts,
        error_estimate=ForceResidual(state.facts.residual),
        reactions=ABSENT if loads is None else loads.summary(),
        wall_time_s=watch.report(),
    )
