"""Statics: the configuration in which a mechanism balances and its stability, or the torques that hold a pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.algorithms.bands import singular_values
from robodyn_cli.equations.contact_joints import contact_joints
from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import torque_terms
from robodyn_cli.errors import CapabilityError, SingularConfigurationError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.given.loop_conditions import LoopConditions, nothing_led, velocity_places
from robodyn_cli.given.prescribed import check_prescribed
from robodyn_cli.observe.evaluation import refuse_result
from robodyn_cli.observe.formulas import check_formulas
from robodyn_cli.observe.joint_limits import limited_joints, warnings_at_rest
from robodyn_cli.observe.observe import add_rows, add_sample
from robodyn_cli.observe.reactions import Loads, ReactionSamples
from robodyn_cli.observe.units import joint_columns
from robodyn_cli.ready.doors import at_rest
from robodyn_cli.ready.prepare import held_columns, initial_positions
from robodyn_cli.ready.singularity import mobility, psi_at, rank_tolerances
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve import closure
from robodyn_cli.solve.closing.assembly import Assembled, assemble
from robodyn_cli.solve.closing.balance import Balance
from robodyn_cli.solve.load_sharing import LostRank, Shared, Unbalanced, share
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.assemble import Mobility
from robodyn_cli.summaries.facts import ABSENT, Absent, LoopResidual, PeakLoad, PeakLoads, Termination
from robodyn_cli.summaries.mechanism import Balanced, Held, StaticsErrors, StaticsSummary
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.torques.closed import lost_rank, unbalanced
from robodyn_cli.trajectories.led import led_joints, position_columns
from robodyn_cli.works.equilibria import (
    AtRest,
    balanced,
    gap_at,
    refuse_unknown,
    rows_that_stay,
    staying_places,
)
from robodyn_cli.works.rest.errors import ErrorsOfBalances, ErrorsOfHolding, Nearby, OffAtRest, with_errors
from robodyn_cli.works.rest.terms import NearRest, RestTerms, RoundedLoads, SingleRest


def held(problem: Problem, q: Array) -> AtRest:
    """Return the torques of actuators that hold a closed configuration q (nq,).

    Raises
    ------
    CapabilityError : too few actuators. SingularConfigurationError : they cannot hold it there.
    """
    needed = {name: problem.numbers(term, q) for name, term in terms_at_rest(problem).items()}
    return held_by_actuators(problem, q, needed, psi_at(problem, q), gap_at(problem, q))


def terms_at_rest(problem: Problem) -> dict[str, list[Scalar]]:
    """Return the terms of the torques that hold a configuration.

    Raises
    ------
    SceneError : they depend on data that the scene does not give.
    """
    terms = torque_terms(problem, at_rest=True)
    refuse_unknown([x for term in terms.values() for x in term])
    return terms


def held_by_actuators(
    problem: Problem, q: Array, needed: Mapping[str, Array], psi: Array, gap: float
) -> AtRest:
    """Return what actuators give of the terms (nv,) that a configuration needs, where Psi (m, nv) is that of its loops,
    which are open by ``gap`` [rad or m].

    Raises
    ------
    CapabilityError, SingularConfigurationError : as ``held``.
    """
    names = holding_joints(problem)
    rows = {name: term[None] for name, term in needed.items()}
    tolerance = float(closure.rank_tolerances(problem.model, gap))
    shared = _shared(
        problem, (psi, tolerance), names, rows or {"gravity": np.zeros((1, problem.model.nv))}, q
    )
    facts = Held(list(names), *shared.uniqueness, shared.residual)
    split = {name: term[0] for name, term in shared.terms.items()}
    return AtRest(problem, q, shared.tau[0], shared.multipliers[0], facts, {}, split)


def holding_joints(problem: Problem) -> tuple[str, ...]:
    """Return the joints with an actuator: those in ``actuated``, else those with torques or prescribed or held ones,
    or all."""
    scene, model = problem.scene, problem.model
    if scene.actuated is not None:
        return scene.actuated
    driven = tuple(dict.fromkeys((*scene.torques, *led_joints(scene.prescribed), *scene.initial.hold)))
    return driven if model.closures and driven else model.joint_names


def _shared(
    problem: Problem,
    rows: tuple[Array, float],
    names: tuple[str, ...],
    needed: Mapping[str, Array],
    q: Array,
) -> Shared:
    """Return how actuators share the load; rows : Psi (m, nv), and the ratio of singular values that counts."""
    columns = velocity_places(problem.model, names)
    try:
        shared = share(rows[0][None], columns, needed, rows[1])
        lacking = shared.commanded < shared.freedom <= len(columns)
        freedom, commanded = shared.freedom, shared.commanded
    except Unbalanced as found:
        if len(columns) < found.freedom:
            raise unbalanced(problem, found, columns, "or the balance (statics.find: balance)") from None
        lacking, freedom, commanded = True, found.freedom, found.commanded
    except LostRank as lost:
        raise lost_rank(problem, lost, np.zeros(1), q[None]) from None
    if lacking:
        raise SingularConfigurationError(
            f"dead point of the actuators: {', '.join(names)} cannot hold the mechanism in this configuration, "
            f"which leaves {freedom - commanded} of its {freedom} degrees of freedom to itself",
            key="actuated", kind="dead_point", q=q.tolist(),
        )  # fmt: skip
    return shared


@np.errstate(all="ignore")  # ``refuse_result`` names numbers that are not finite
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
    state = rest_of(scene, watch)
    with watch.stage("evaluate"):
        off = errors_of(state)
        loads, peaks = loads_at_rest(state, off) if scene.outputs.reactions else (None, ABSENT)
    progress(0.0, 0.0)
    result = report(state, loads)
    result.summarise(summarise(state, off, peaks), seconds=watch.report())
    refuse_result(result)
    return result


def rest_of(scene: Scene, watch: Stopwatch) -> AtRest:
    """Return the balance, or the configuration that is held."""
    with watch.stage("equations"):
        problem = problem_of(scene)
    with watch.stage("assemble"):
        q = assembled_at_rest(problem).q
    with watch.stage("solve"):
        state = balanced(problem, q) if scene.statics.find == "balance" else held(problem, q)
        refuse_beyond_stops(problem, state.q)
    return state


def problem_of(scene: Scene) -> Problem:
    """Return the equations of a scene for its statics: a configuration is held without its controller.

    Raises
    ------
    CapabilityError : a balance under a controller, whose torques may depend on more than the configuration.
    """
    if scene.control is not None and scene.statics.find == "balance":
        raise CapabilityError(
            "statics knows no controller, whose torques may depend on more than the configuration; take "
            "'control' away, or simulate until the motion comes to rest"
        )
    return Problem(at_rest(scene))


def assembled_at_rest(problem: Problem) -> Assembled:
    """Return the initial configuration with the loops closed, held joints where they are."""
    scene = problem.scene
    given = initial_positions(scene, problem)
    held = tuple(dict.fromkeys((*held_columns(scene, problem), *position_columns(scene.prescribed))))
    check_prescribed(problem)
    assembled = assemble(problem, given, {}, held)
    check_formulas(problem, assembled.q, np.zeros(problem.model.nv))
    return assembled


def refuse_beyond_stops(problem: Problem, q: Array) -> None:
    """Refuse a configuration beyond a rigid stop, whose force is not among those that balance.

    Raises
    ------
    CapabilityError
    """
    for joint in contact_joints(problem.model):
        for push, at in joint.stops:
            if push * (q[joint.q] - at) < -1e-9 * max(1.0, abs(at)):
                raise CapabilityError(
                    f"joint {joint.name!r} would be at {q[joint.q]:.6g}, beyond its rigid stop at {at:.6g}, which "
                    "`statics` does not follow; allowed: stops with 'stiffness', or the joint in 'initial.hold'",
                    joint=joint.name,
                )


def errors_of(state: AtRest) -> OffAtRest | None:
    """Return the errors of a configuration at rest; None where rounding decides whether actuators hold it."""
    problem = state.problem
    if state.near is not None:
        staying = rows_that_stay(problem, len(state.near.expressions.conditions.names))
        return ErrorsOfBalances(state.near, staying)(state.q[None])[0]
    columns = velocity_places(problem.model, holding_joints(problem))
    return errors_held(problem, problem.constraints.of_loops, columns, (state.q, state.lam, state.tau))


def errors_held(
    problem: Problem, rows: Sequence[int], columns: Sequence[int], held: tuple[Array, Array, Array]
) -> OffAtRest | None:
    """Return the errors of a configuration q (nq,) that actuators of velocity coordinates hold with multipliers (m,) of
    some rows and torques (nv,); None where rounding decides whether they do."""
    q, lam, tau = held
    conditions = LoopConditions(problem, nothing_led(), np.zeros(1))
    tolerance = float(closure.rank_tolerances(problem.model, gap_at(problem, q)))
    terms = terms_that_hold(problem, conditions)
    near = SingleRest(conditions, _Needed(problem, terms.load), tolerance, problem, terms)
    return errors_of_holding(problem, near, rows, columns)(q[None], lam[None], tau[None])[0]


@record
class _Needed:
    """The forces that actuators and loops must give at rest."""

    problem: Problem
    entries: Sequence[Scalar]

    def load(self, q: Array) -> Array:
        return self.problem.numbers(list(self.entries), q)

    def stiffness(self, q: Array, lam: Array) -> Array:
        raise NotImplementedError  # it decides nothing where actuators hold


def terms_that_hold(problem: Problem, conditions: LoopConditions) -> RestTerms:
    """Return the terms of a configuration that actuators hold, whose torques in the scene are ignored."""
    none, p = [0.0] * problem.model.nv, problem.at_start
    load = [sum(parts) for parts in zip(*terms_at_rest(problem).values())] or none
    return RestTerms(conditions, load, none, [], (p, p))


def errors_of_holding(
    problem: Problem, near: NearRest, rows: Sequence[int], columns: Sequence[int]
) -> ErrorsOfHolding:
    """Return what tells the errors of configurations that rows and actuators of velocity coordinates hold."""
    stays = staying_places(problem)
    free = [k for k in range(problem.model.nv) if k not in stays]
    return ErrorsOfHolding(near, free, rows, columns)


def loads_at_rest(state: AtRest, off: OffAtRest | None) -> tuple[Loads, PeakLoads]:
    """Return forces and moments in joints and closures, and the largest of them with their errors."""
    problem, loops = state.problem, state.problem.constraints.of_loops
    q, lam = state.q[None], np.zeros((1, len(problem.constraints.rows)))
    lam[0, loops] = state.lam
    if off is not None:
        q = np.vstack([q, off.beside.q])
        nearby = np.zeros((len(off.beside.q), lam.shape[1]))
        nearby[:, loops] = off.beside.lam[:, loops]
        lam = np.vstack([lam, nearby])
    still = np.zeros((len(q), problem.model.nv))
    samples = ReactionSamples(problem, len(q))
    data = samples(np.zeros(len(q)), q, still, still, lam)
    loads = Loads(samples, np.zeros(1), {path: x[:1] for path, x in data.items()})
    largest = samples.largest(np.zeros(1), loads.data, ())
    if off is None:
        unknown = {x: PeakLoad(own.peak_force, own.peak_moment, None, None) for x, own in largest.items()}
        return loads, samples.described(unknown)
    parts = {path: data[path] for path in samples.of_parts}
    entries = {path: samples.function.outputs[path] for path in parts}
    rounded = RoundedLoads(entries)(q[:1], lam[:1], problem.model.nv)[0]
    return loads, samples.described(with_errors(largest, parts, samples.names, off.beside, rounded))


def loops_at(state: AtRest) -> tuple[Array, Array]:
    """Return eta (m,) and Psi (m, nv) of the loops there."""
    problem = state.problem
    eta = problem.numbers([row.eta for row in problem.constraints.loop_rows], state.q)
    return eta, psi_at(problem, state.q)


def mobility_at(state: AtRest, eta: Array, psi: Array, beside: Nearby | None = None) -> Mobility:
    """Return the degrees of freedom of the configuration, with eta (m,) and Psi (m, nv) of its loops; beside : what
    rounding may make of it."""
    problem, off = state.problem, None
    tolerance = float(rank_tolerances(problem, np.abs(eta).max(initial=0.0)))
    if beside is not None:
        changes = beside.J[:, problem.constraints.of_loops] - psi
        off = beside.off(changes.reshape(len(changes), -1)).reshape(psi.shape)
    return mobility(problem, singular_values(psi), tolerance, off)


def report(state: AtRest, loads: Loads | None) -> Result:
    """Return the datasets of a run."""
    problem = state.problem
    scene, model = problem.scene, problem.model
    result = Result.of("statics", scene)
    still, columns = np.zeros(model.nv), joint_columns(model)["tau"].described()
    add_sample(result, problem, state.q, still, still)
    result.add("tau", state.tau[None], **columns)
    for name, term in state.terms.items():
        result.add(f"torque_terms/{name}", term[None], **columns)
    rows = problem.constraints.loop_rows
    if rows:
        eta, psi = loops_at(state)
        arrays = {"constraints/multipliers": state.lam[None], "constraints/position_residual": eta[None]}
        add_rows(result, rows, arrays, mobility_at(state, eta, psi).redundant_rows > 0)
    if loads is not None:
        loads.add_to(result)
    return result


def _beyond_limits(state: AtRest) -> list[str]:
    """Return a warning for each limit of a joint that the balance is beyond; stops have pushed already."""
    joints = [
        joint for joint in limited_joints(state.problem.scene, state.problem.model) if not joint.limits.acts
    ]
    none = f"{state.starts} starts within the limits of the joints led to no balance there"
    return ([none] if state.starts else []) + warnings_at_rest(joints, state.q, state.tau)


def summarise(
    state: AtRest,
    off: OffAtRest | None,
    loads: PeakLoads | Absent,
    loops: tuple[Array, Array] | None = None,
) -> StaticsSummary:
    """Return the summary of a run. off : its errors. loops : their eta (m,) and Psi (m, nv), where these are known."""
    problem = state.problem
    model, find = problem.model, problem.scene.statics.find
    rows, held = problem.constraints.loop_rows, list(state.holding)
    names = [row.name for row in rows]
    eta, psi = loops or loops_at(state)
    return StaticsSummary(
        termination=Termination("balanced" if find == "balance" else "held", 0.0),
        mobility=mobility_at(state, eta, psi, None if off is None else off.beside) if rows else ABSENT,
        warnings=_beyond_limits(state) or ABSENT,
        multipliers=dict(zip(names, state.lam.tolist())) if rows else ABSENT,
        constraint_residual=LoopResidual(float(np.abs(eta).max())) if rows else ABSENT,
        samples=1,
        find=find,
        configuration=dict(zip(model.q_names, state.q.tolist())),
        units=model.coordinate_units,
        torques_of_joints=dict(zip(model.v_names, state.tau.tolist())),
        equilibrium=state.facts if isinstance(state.facts, Held) else _described(state, state.facts, off),
        error_estimate=StaticsErrors(
            state.facts.residual,
            _by_name(model.q_names, None if off is None else off.q),
            _by_name(model.v_names, None if off is None else off.tau),
            _by_name(held, None if off is None else off.holding[[model.v_names.index(x) for x in held]])
            if held
            else ABSENT,
            _by_name(names, None if off is None else off.lam[problem.constraints.of_loops])
            if rows
            else ABSENT,
        ),
        reactions=loads,
    )


def _by_name(names: Sequence[str], values: Array | None) -> dict[str, float | None]:
    """Return numbers by name, None of each where there are none."""
    return dict.fromkeys(names) if values is None else dict(zip(names, values.tolist()))


def _described(state: AtRest, rest: Balance, off: OffAtRest | None) -> Balanced:
    """Return what the summary says of a balance."""
    real = bool(np.all(np.abs(rest.stiffness.imag) <= 1e-9 * np.abs(rest.stiffness).max(initial=1.0)))
    stiffness = rest.stiffness.real.tolist() if real else [[x.real, x.imag] for x in rest.stiffness]
    error = None if off is None else off.stiffness
    stability, holding = rest.stability_beyond(error or 0.0), dict(state.holding) or ABSENT
    return Balanced(stability, stiffness, error, rest.residual, rest.iterations, holding)
