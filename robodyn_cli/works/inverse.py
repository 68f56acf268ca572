"""Inverse dynamics: what torques does this motion need."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError
from robodyn_cli.given.motion import Planned, knot_places, motion_near, plan_near
from robodyn_cli.observe.evaluation import refuse_result
from robodyn_cli.observe.places import FORCES, add_places
from robodyn_cli.observe.units import add_joint_limits, add_motion, joint_columns
from robodyn_cli.ready.doors import along
from robodyn_cli.results.result import Result
from robodyn_cli.scene.points import with_points
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.quadrature import Breaks, spaced
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Absent, LoopResidual, Termination
from robodyn_cli.summaries.inverse import (
    FastestFigures,
    InverseErrors,
    InverseSummary,
    LoadedMechanism,
    definitions_of,
)
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.torques.build import build_inverse
from robodyn_cli.torques.checks import (
    FIGURES,
    Loaded,
    breaks_of,
    crowded_turns,
    error_estimate,
    half_turns,
    joint_figures,
    path_error,
)
from robodyn_cli.torques.program import InverseProgram, LoopSamples, Sampled

if TYPE_CHECKING:
    from robodyn_cli.observe.reactions import Loads
    from robodyn_cli.trajectories.motion import JointMotion

MOST_ROWS = 10_000_000  # of a table for a controller
ROUNDED = 1e-12  # of a number of periods


@np.errstate(all="ignore")  # ``refuse_result`` names numbers that are not finite
def inverse(
    scene: Scene,
    *,
    samples: int | None = None,
    progress: Progress = no_progress,
    watch: Stopwatch | None = None,
) -> Result:
    """Compute the joint torques that the scene's trajectory needs.

        tau = M qdd + C qd + G - tau_passive - tau_friction - tau_external

    ``tau`` (T, nv) is the actuators' torque [N m or N]; the terms are signed so that they sum to it. With closed
    loops the left side is B tau + Psi^T lambda (see ``closed``).

    Parameters
    ----------
    samples : number of uniform samples; default: the scene's ``inverse.samples``.
    progress : called when the work is done. watch : adds up wall times by stage.

    Returns
    -------
    A Result with the contract's datasets (``docs/hdf5.md``); joints, residuals and errors in the summary.

    Raises
    ------
    SceneError : no motion, data that the equations need is not given, or inertias that no robot has. CapabilityError :
    motion or actuators do not suffice. GeometryError : the motion cannot be met. SingularConfigurationError : a
    singular pose on the way. NumericalError : a number of the result is not finite.
    """
    watch = watch or Stopwatch()
    count = scene.inverse.samples if samples is None else samples
    if count < 2:
        raise ValueError(f"samples: {count}; allowed: 2 or more")
    with watch.stage("equations"):
        program = program_of(scene)
        function = program.compile(count)
    with watch.stage("solve"):
        planned = planned_at(program, program.times(count))
    with watch.stage("evaluate"):
        sampled = program.evaluate(planned, function)
    _refuse_indefinite(program.problem, sampled)
    with watch.stage("error_estimate"):
        closer, looked = _closer(program, planned, sampled)
        loaded = Loaded.of(program.problem, looked)
        errors = error_estimate(program, closer, looked, loaded)
    with watch.stage("evaluate"):
        loads = loads_of(program, sampled) if scene.outputs.reactions else None
        there = loads_of(program, looked) if loads is not None and looked is not sampled else loads
    progress(program.duration, program.duration)
    result = report(program, planned, sampled, loads)
    _add_table(result, program, watch)
    summary = summarise(program, closer, looked, loaded, errors)
    reactions = ABSENT if there is None else there.summary(loaded.breaks)
    records = [dataclasses.replace(summary, samples=count, reactions=reactions)]
    with watch.stage("drives"):
        records = _with_drives(records, result, program, looked)
        records = _with_balance(records, result, program, (sampled, looked))
    result.summarise(*records, seconds=watch.report())
    refuse_result(result)
    return result


def _add_table(result: Result, program: InverseProgram, watch: Stopwatch) -> None:
    """Add the motion and its torques at the multiples of a period, up to the end of the motion, where one is given.

    Raises
    ------
    CapabilityError : there are too many.
    """
    given = program.problem.scene.inverse.period
    if given is None:
        return
    period = float(given)
    count = int(program.duration / period * (1.0 + ROUNDED)) + 1
    if count > MOST_ROWS:
        raise CapabilityError(
            f"{count} samples of {period:g} s; allowed: no more than {MOST_ROWS}, so a longer period",
            ("inverse.period",),
            key="inverse.period",
        )
    times = np.minimum(period * np.arange(count), program.duration)
    with watch.stage("evaluate"):
        planned, sampled = evaluated_at(program, times)
    result.add("feed_forward/time", times)
    columns, motion = joint_columns(program.problem.model), planned.motion
    for name, data in (("q", motion.q), ("qd", motion.qd), ("qdd", motion.qdd), ("tau", sampled.tau)):
        own = {**columns[name].described(), "dims": ("feed_forward_sample", columns[name].dims[1])}
        result.add(f"feed_forward/{name}", data, **own)


def program_of(scene: Scene) -> InverseProgram:
    """Return the program of a scene, whose motion is found first where it follows from the dynamics or from paths.

    Raises
    ------
    RobodynError : see ``inverse``.
    """
    if scene.inverse.shaking is not None:
        scene = with_points(scene, [scene.inverse.shaking])
    program = build_inverse(along(scene))
    if scene.motorisation is not None:
        from robodyn_cli.drives.motorisation import acting

        acting(program.problem, inertia=True)
    return program


def _with_drives(records: list[Any], result: Result, program: InverseProgram, looked: Sampled) -> list[Any]:
    """Return the records with those of the scene's drives and of its margins of motorisation, where it has any."""
    problem, motion = program.problem, looked.motion
    scene = problem.scene
    if not scene.drives and scene.motorisation is None:
        return records
    from robodyn_cli.drives.report import Moved, with_drives

    breaks = tuple(breaks_of(problem, looked.times, motion))
    moved = Moved(looked.times, motion.q, motion.qd, motion.qdd, looked.tau, breaks)
    if scene.drives:
        records = with_drives(records, result, problem, moved)
    if scene.motorisation is not None:
        from robodyn_cli.drives.motorisation import with_motorisation

        at_samples = Moved.of(
            result.__getitem__, tuple(spaced(knot_places(scene, result.time), len(result.time)))
        )
        records = with_motorisation(records, result, problem, at_samples, moved)
    return records


def _with_balance(
    records: list[Any], result: Result, program: InverseProgram, sampled: tuple[Sampled, Sampled]
) -> list[Any]:
    """Return the records with those of shaking forces and a flywheel, where the scene asks for them."""
    asked = program.problem.scene.inverse
    if asked.shaking is None and asked.flywheel is None:
        return records
    from robodyn_cli.works.balance import with_balance

    return with_balance(records, result, program, *sampled)


def _closer(program: InverseProgram, planned: Planned, sampled: Sampled) -> tuple[Planned, Sampled]:
    """Return the motion where figures are looked at (see ``looked_at``), if it has values there, else its samples."""

    def plan(times: Array) -> Planned:
        same = np.array_equal(times, planned.times)
        return planned if same else _planned_near(program, planned, times) or planned_at(program, times)

    try:
        closer = looked_at(program, len(sampled.times), plan)
        return closer, sampled if closer is planned else evaluated(program, closer)
    except NumericalError:
        return planned, sampled


def looked_at(program: InverseProgram, samples: int, plan: Callable[[Array], Planned]) -> Planned:
    """Return the motion where figures are looked at, as it is planned for times (T,): from knot to knot, and cut where
    joints turn back too near to these for a break."""
    problem, planned = program.problem, plan(program.looked_at(samples))

    def at(times: Array) -> JointMotion:
        return motion_near(problem.model, planned, times) or program.plan(times).motion

    turns = crowded_turns(problem, planned.times, planned.motion, at)
    if not turns:
        return planned
    times = program.looked_at(samples, turns)
    return _planned_near(program, planned, times) or plan(times)


def _planned_near(program: InverseProgram, known: Planned, times: Array) -> Planned | None:
    """Return the motion at times (T,) from what is known of it; None where it has to be followed."""
    found = plan_near(program.problem, known, times)
    return None if found is None else at_rest(program.problem, found)


def planned_at(program: InverseProgram, times: Array) -> Planned:
    """Return the motion at times (T,)."""
    return at_rest(program.problem, program.plan(times))


def evaluated(program: InverseProgram, planned: Planned) -> Sampled:
    """Return what is evaluated along a motion."""
    return program.evaluate(planned, program.compile(len(planned.times)))


def evaluated_at(program: InverseProgram, times: Array) -> tuple[Planned, Sampled]:
    """Return the motion at times (T,), and what is evaluated along it."""
    planned = planned_at(program, times)
    return planned, evaluated(program, planned)


def at_rest(problem: Problem, planned: Planned) -> Planned:
    """Return the motion with joints at rest where only rounding moves them (see ``rest``)."""
    if not any(body.forces for body in problem.model.bodies):
        return planned
    from robodyn_cli.torques.rest import with_rest

    return with_rest(problem, planned)


def _beyond_limits(problem: Problem, sampled: Sampled, breaks: Breaks) -> list[str]:
    """Return a warning for each limit of a joint that the motion, or the torque that it needs, is beyond."""
    if not problem.scene.robot.limited:
        return []
    from robodyn_cli.observe.joint_limits import limit_warnings, limited_joints

    motion = sampled.motion
    rates = {"qd": motion.qd, "qdd": motion.qdd, "tau": sampled.tau}
    joints = limited_joints(problem.scene, problem.model)
    return limit_warnings(joints, sampled.times, rates, motion.q, breaks)


def _rounding_warnings(problem: Problem, planned: Planned) -> list[str]:
    if not planned.residuals:
        return []
    from robodyn_cli.given.guided_motion import rounding_warnings

    return rounding_warnings(problem, planned)


def _rest_warnings(problem: Problem, planned: Planned) -> list[str]:
    if not any(body.forces for body in problem.model.bodies):
        return []
    from robodyn_cli.torques.rest import rest_warnings

    return rest_warnings(problem, planned)


def _refuse_indefinite(problem: Problem, sampled: Sampled) -> None:
    from robodyn_cli.model.consistency import doubtful_bodies

    if doubtful_bodies(problem.scene):
        from robodyn_cli.observe.rounding import few
        from robodyn_cli.ready.mass_matrix import refuse_indefinite

        refuse_indefinite(problem.scene, sampled.motion.q[few(len(sampled.times))])


def _payload_warnings(problem: Problem, sampled: Sampled) -> list[str]:
    if not problem.model.payloads:
        return []
    from robodyn_cli.torques.payloads import impact_warnings

    return impact_warnings(problem, sampled)


def loads_of(program: InverseProgram, sampled: Sampled) -> Loads:
    """Return forces and moments in joints and closures."""
    from robodyn_cli.observe.reactions import loads_along

    lam = program.row_multipliers(sampled)
    return loads_along(program.problem, sampled.times, sampled.motion, lam, sampled.p)


def report(program: InverseProgram, planned: Planned, sampled: Sampled, loads: Loads | None) -> Result:
    """Return the datasets of a run."""
    problem, arrays = program.problem, sampled.arrays
    scene, columns = problem.scene, joint_columns(problem.model)
    result = Result.of("inverse", scene)
    if problem.model.payloads:
        from robodyn_cli.torques.payloads import events_of

        result.events = events_of(scene, sampled.times)
    add_motion(result, problem.model, sampled.times, sampled.motion)
    add_joint_limits(result, scene, problem.model)
    result.add("tau", sampled.tau, **columns["tau"].described())
    for name, term in sampled.terms.items():
        result.add(f"torque_terms/{name}", term, **columns["tau"].described())
    kinetic, potential = arrays["energy/kinetic"][:, 0], arrays["energy/potential"][:, 0]
    result.add("energy/kinetic", kinetic)
    result.add("energy/potential", potential)
    result.add("energy/total", kinetic + potential)
    for path in FORCES:
        if path in arrays:
            result.add(path, arrays[path], names=problem.elements.names)
    program.add_loops(result, sampled)
    add_places(result, {path: arrays[path] for path in program.places})
    if planned.target is not None:
        # coordinates that the target leaves free are those of the point
        target = result[f"points/{planned.point}"].copy()
        target[:, : planned.target.shape[1]] = planned.target
        result.add(f"targets/{planned.point}", target)
    if program.scaling is not None:
        from robodyn_cli.fastest.resolve import add_limits

        add_limits(result, program.scaling, problem.model, sampled)
    if scene.trajectory is not None and scene.trajectory.least_time:
        from robodyn_cli.given.pieces import add_pieces

        add_pieces(result, problem)
    if loads is not None:
        loads.add_to(result)
    return result


def summarise(
    program: InverseProgram,
    planned: Planned,
    sampled: Sampled,
    loaded: Loaded,
    errors: InverseErrors,
    wanted: Collection[str] = FIGURES,
) -> InverseSummary:
    """Return the summary of a run; wanted : the figures of joints that are."""
    problem, loops = program.problem, sampled.loops
    fastest: FastestFigures | Absent = ABSENT
    inexact: list[str] = []
    if program.scaling is not None:
        from robodyn_cli.fastest.resolve import figures, warnings

        fastest, inexact = figures(program.scaling, problem.model, sampled), warnings(program.scaling)
    return InverseSummary(
        termination=Termination("end of the trajectory", float(sampled.times[-1])),
        samples=len(sampled.times),
        warnings=[
            *_beyond_limits(problem, sampled, loaded.breaks),
            *half_turns(problem, sampled),
            *_rounding_warnings(problem, planned),
            *_rest_warnings(problem, planned),
            *_payload_warnings(problem, sampled),
            *inexact,
        ]
        or ABSENT,
        mechanism=ABSENT if loops is None else _mechanism(loops),
        fastest=fastest,
        inverse_kinematics=planned.method or ABSENT,
        ik_residual=path_error(planned, sampled),
        attitude_residual=errors.attitude_residual,
        error_estimate=errors,
        round_trip=errors.round_trip,
        constraint_residual=ABSENT
        if loops is None
        else LoopResidual(loops.residual["position"], loops.residual["velocity"]),
        joints=joint_figures(problem, sampled, loaded, wanted),
        definitions=definitions_of(loops is not None),
        counters=dict(sampled.counters),
        reactions=ABSENT,
    )


def _mechanism(loops: LoopSamples) -> LoadedMechanism:
    shared = loops.shared
    return LoadedMechanism(shared.freedom, list(loops.actuated), *shared.uniqueness)
