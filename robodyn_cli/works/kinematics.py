"""Kinematic analysis: where a mechanism goes, how fast, and how well it transmits, without any forces."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.bands import Scattered
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.expr.graph import Scalar, is_nonzero
from robodyn_cli.given.guided_motion import guided_motion, rounding_warnings
from robodyn_cli.given.loop_conditions import Lead, lead_of, refuse_quasi
from robodyn_cli.given.motion import Planned, knot_places, knots_of, looked_at, motion_duration, plan_motion
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.observe.evaluation import Outputs, SampleFunction, refuse_result
from robodyn_cli.observe.observe import add_rows
from robodyn_cli.observe.places import add_places, place_outputs, point_motion
from robodyn_cli.observe.singular_values import singular_values
from robodyn_cli.observe.units import add_joint_limits, add_motion
from robodyn_cli.ready.doors import along
from robodyn_cli.ready.prepare import held_columns
from robodyn_cli.ready.singularity import mobility
from robodyn_cli.results.result import Result, units_of
from robodyn_cli.scene.points import with_points
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.guided import CLOSED
from robodyn_cli.solve.quadrature import spaced
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.assemble import Mobility
from robodyn_cli.summaries.extremes import Extremes
from robodyn_cli.summaries.facts import ABSENT, Absent, LoopResidual, Termination
from robodyn_cli.summaries.mechanism import (
    ClosureErrors,
    JointRange,
    KinematicsSummary,
    PathErrors,
    PlacesAt,
    PointPath,
    PointPlace,
    RangeErrors,
    SingularRatio,
    TransmissionAngle,
    TransmissionErrors,
)
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.trajectories.course import between
from robodyn_cli.trajectories.led import velocity_columns
from robodyn_cli.works.kinematic_figures import (
    AT_SAMPLE,
    between_samples,
    of_one,
    path_figures,
    range_figures,
    ratio_figures,
    refuse_meeting,
    transmission_angle,
    transmission_figures,
)


@np.errstate(all="ignore")  # ``refuse_result`` names numbers that are not finite
def kinematics(scene: Scene, *, progress: Progress = no_progress, watch: Stopwatch | None = None) -> Result:
    """Compute the motion that a sweep, a trajectory or prescribed joints give: no mass is needed.

    Returns
    -------
    A Result with positions, rates and accelerations of joints and named points, singular values of the loops' Psi
    and of its passive block, the transmission angle where three points are given; mobility and extremes in the
    summary.

    Raises
    ------
    SceneError : nothing moves. GeometryError, SingularConfigurationError : the motion cannot be met, or ends at a
    singular configuration; attribute ``result`` then holds what was reached.
    """
    watch = watch or Stopwatch()
    with watch.stage("equations"):
        problem = problem_of(scene)
    with watch.stage("solve"):
        planned, led = plan(problem)
    with watch.stage("evaluate"):
        arrays = _evaluated_sparsely(problem, planned)
        result = report(problem, planned, led, arrays)
        closer, looked = _closer(problem, planned, result)
    progress(float(planned.times[-1]), float(planned.times[-1]))
    mobile = mobility(problem, result["singularity/psi"]) if problem.constraints.of_loops else None
    summary = dataclasses.replace(summarise(problem, closer, looked, mobile), samples=len(planned.times))
    records: list[Any] = [summary]
    if scene.kinematics.design is not None:
        from robodyn_cli.works.design import with_design

        records = with_design(records, result, problem, (planned, closer))
    if scene.motorisation is not None and planned.stopped is None:
        records = _with_motorisation(records, result, problem, (planned, closer))
    result.summarise(*records, seconds=watch.report())
    refuse_result(result)
    return result.unless(planned.stopped)


def problem_of(scene: Scene) -> Problem:
    """Return the equations of a scene for its kinematics, with the points that are wanted."""
    if scene.kinematics.sweep is None:
        scene = along(scene)
    led = () if scene.trajectory is None else scene.trajectory.places
    problem = Problem(with_points(scene, (*led, *scene.kinematics.places)))
    if scene.motorisation is not None:
        from robodyn_cli.drives.motorisation import acting

        acting(problem, inertia=None)
    return problem


def _with_motorisation(
    records: list[Any], result: Result, problem: Problem, motions: tuple[Planned, Planned]
) -> list[Any]:
    """Return the records with margins of motorisation; motions : at the samples, and where figures are looked at."""
    from robodyn_cli.drives.motorisation import with_motorisation
    from robodyn_cli.drives.report import Moved

    def moved(planned: Planned) -> Moved:
        times, motion = planned.times, planned.motion
        breaks = tuple(spaced(knot_places(problem.scene, times), len(times)))
        return Moved(times, motion.q, motion.qd, motion.qdd, np.zeros_like(motion.qd), breaks)

    return with_motorisation(records, result, problem, moved(motions[0]), moved(motions[1]))


def _closer(problem: Problem, planned: Planned, result: Result) -> tuple[Planned, Result]:
    """Return the motion where figures are looked at, if it has values there and does not end early; else at its
    samples."""
    times = closer_times(problem, planned.times)
    if planned.stopped is not None or np.array_equal(times, planned.times):
        return planned, result
    try:
        closer, led = plan(problem, times)
    except NumericalError:
        return planned, result
    if closer.stopped is not None:
        return planned, result
    return closer, report(problem, closer, led, _evaluated_sparsely(problem, closer))


def closer_times(problem: Problem, times: Array) -> Array:
    """Return the times at which the figures of a motion with samples at times (T,) are looked at."""
    return looked_at(times, knots_of(problem.scene) if problem.scene.kinematics.sweep is None else ())


def evaluated(problem: Problem, planned: Planned, own: Outputs | None = None) -> dict[str, Array]:
    """Return what is evaluated along a motion; own : expressions by result path, by default ``outputs``."""
    function = SampleFunction(outputs(problem) if own is None else own, MOTION_GROUPS, len(planned.times))
    return function.along(planned.times, planned.motion)


def _evaluated_sparsely(problem: Problem, planned: Planned) -> dict[str, Any]:
    """Return the same, with Psi by its entries: those of many loops are mostly zero."""
    own = outputs(problem)
    places = [k for k, x in enumerate(own["psi"]) if is_nonzero(x)]
    own["psi"] = [own["psi"][k] for k in places]
    arrays: dict[str, Any] = {**evaluated(problem, planned, own)}
    m, nv = len(problem.constraints.of_loops), problem.model.nv
    arrays["psi"] = Scattered(arrays["psi"], *np.divmod(np.array(places, dtype=np.intp), nv), (m, nv))
    return arrays


def plan(problem: Problem, times: Array | None = None) -> tuple[Planned, tuple[str, ...]]:
    """Return the motion at times (T,), by default those of the samples, and the velocity coordinates that lead it.

    Raises
    ------
    SceneError : nothing moves. Others as ``plan_motion`` and ``guided_motion``.
    """
    lead, own = leading(problem)
    times = own if times is None else times
    if lead is None:
        return plan_motion(problem, times), problem.model.v_names
    return guided_motion(problem, lead, times), (*lead.joints, *velocity_columns(problem.scene.prescribed))


def leading(problem: Problem) -> tuple[Lead | None, Array]:
    """Return what leads the mechanism, and times (T,); None in an open chain that a trajectory leads.

    Raises
    ------
    SceneError : nothing moves.
    """
    scene, samples = problem.scene, problem.scene.kinematics.samples
    sweep = scene.kinematics.sweep
    if sweep is not None:
        duration = abs(sweep.stop - sweep.start) / sweep.rate
        return _swept(problem), np.linspace(0.0, duration, samples)
    if scene.trajectory is None and not scene.prescribed:
        raise SceneError(
            "nothing moves: kinematics needs `kinematics.sweep`, `trajectory` or `prescribed`",
            (scene.path,),
            key="kinematics",
        )
    times = np.linspace(0.0, motion_duration(scene), samples)
    return (lead_of(problem) if problem.model.closures else None), times


def _swept(problem: Problem) -> Lead:
    """Return a lead with the swept joint and the joints that stay: held ones, or all others in an open chain."""
    scene = problem.scene
    sweep = scene.kinematics.sweep
    assert sweep is not None
    model = problem.model
    refuse_quasi(model, sweep.joint)
    others = held_columns(scene, problem) if model.closures else model.q_names
    held = [name for name in others if name != sweep.joint and name not in scene.prescribed]
    missing = [name for name in held if name not in scene.initial.q]
    if missing:
        raise SceneError(
            f"joint {missing[0]!r} stays where it is during the sweep, and has no position",
            (scene.path, "initial.q"),
            key="initial.q",
        )
    rate = sweep.rate if sweep.stop > sweep.start else -sweep.rate
    stay = [scene.initial.q[name] for name in held]
    return Lead.staying(model, (sweep.joint, *held), [sweep.start, *stay], rate)


def outputs(problem: Problem) -> dict[str, list[Scalar]]:
    """Return the expressions evaluated along the motion by result path, and Psi and eta of the loops."""
    rows = problem.constraints.loop_rows
    loops = {"psi": [x for row in rows for x in row.psi], "eta": [row.eta for row in rows]}
    return {**place_outputs(problem), **point_motion(problem), **loops}


def report(problem: Problem, planned: Planned, led: tuple[str, ...], arrays: Mapping[str, Any]) -> Result:
    """Return the datasets of a run; ``led`` are the velocity coordinates that lead."""
    scene = problem.scene
    result = Result.of("kinematics", scene, "ok" if planned.stopped is None else "failed")
    add_motion(result, problem.model, planned.times, planned.motion)
    add_joint_limits(result, scene, problem.model)
    add_places(result, {path: array for path, array in arrays.items() if path not in ("psi", "eta")})
    rows = problem.constraints.loop_rows
    if rows:
        add_rows(result, rows, {"constraints/position_residual": arrays["eta"]})
        passive = [k for k, name in enumerate(problem.model.v_names) if name not in led]
        leads = len(passive) < problem.model.nv
        own, m = arrays["psi"], len(rows)
        psi = own if isinstance(own, Scattered) else own.reshape(len(own), m, problem.model.nv)
        for path, data in singular_values(psi, passive if leads else ()).items():
            result.add(path, data)
    if scene.kinematics.transmission is not None:
        refuse_transmission(scene, arrays)
        result.add("transmission_angle", transmission_angle(arrays, scene.kinematics.transmission))
    return result


def refuse_transmission(scene: Scene, arrays: Mapping[str, Array]) -> None:
    """Refuse a transmission angle of points that meet.

    Raises
    ------
    CapabilityError
    """
    for pair in itertools.pairwise(scene.kinematics.transmission or ()):
        refuse_meeting(scene, arrays, pair, "kinematics.transmission")


def _beyond_limits(problem: Problem, planned: Planned) -> list[str]:
    """Return a warning for each limit of a joint that the motion is beyond."""
    if not problem.scene.robot.limited:
        return []
    from robodyn_cli.observe.joint_limits import limit_warnings, limited_joints

    motion, joints = planned.motion, limited_joints(problem.scene, problem.model)
    return limit_warnings(joints, planned.times, {"qd": motion.qd, "qdd": motion.qdd}, motion.q)


def summarise(
    problem: Problem, planned: Planned, result: Result, mobile: Mobility | None
) -> KinematicsSummary:
    """Return the summary of a run."""
    times, stopped = planned.times, planned.stopped
    breaks = spaced(knot_places(problem.scene, times), len(times))
    closed = CLOSED if planned.residuals else 0.0  # how far positions may be off
    whole = Termination("end of the motion", float(times[-1]))
    return KinematicsSummary(
        termination=whole if stopped is None else stopped.termination,
        mobility=ABSENT if mobile is None else mobile,
        samples=len(times),
        warnings=[*_beyond_limits(problem, planned), *rounding_warnings(problem, planned)] or ABSENT,
        joints=_joint_ranges(result, breaks, closed),
        points=_point_paths(result, breaks),
        at=places_at(problem.scene, result, closed) or ABSENT,
        singular_ratio=_singular_ratio(result, breaks, closed),
        transmission_angle=_transmission(result, breaks, closed),
        error_estimate=ClosureErrors(LoopResidual(**planned.residuals)) if planned.residuals else ABSENT,
        counters=planned.counters,
        extremes=extremes_of(problem, planned, result),
    )


def extremes_of(problem: Problem, planned: Planned, result: Result) -> dict[str, Extremes] | Absent:
    """Return the extremes that a scene asks for of a motion, but for those of kinematic design."""
    scene = problem.scene
    breaks = spaced(knot_places(scene, planned.times), len(planned.times))
    closed = CLOSED if planned.residuals else 0.0  # how far positions may be off at the samples [rad or m]
    names = scene.outputs.extremes
    if names and scene.kinematics.design is not None:
        from robodyn_cli.scene.checks.columns import DESIGNED

        names = tuple(name for name in names if not name.startswith(DESIGNED))  # which are told with it
    if not names:
        return ABSENT
    from robodyn_cli.observe.columns import chosen_extremes

    return chosen_extremes(result, names, breaks, closed)


def _joint_ranges(result: Result, breaks: Sequence[float], closed: float) -> dict[str, JointRange]:
    """Return where joints go, and how fast; closed : how far positions may be off at the samples [rad or m]."""
    positions = result.variables["q"].names
    columns = range_figures(result.time, (result["q"], result["qd"], result["qdd"]), breaks, closed)
    ranges, rates = {}, units_of(result.variables["qd"])
    for k, name in enumerate(result.variables["qd"].names):
        unit = rates[k].removesuffix("/s")
        # quasi-velocities are the rates of no position
        at = positions.index(name) if name in positions else None
        places = {"smallest": at, "largest": at, "peak_speed": k, "peak_acceleration": k}
        own, off = (
            {x: None if i is None else float(columns[x][part][i]) for x, i in places.items()}
            for part in (0, 1)
        )
        units = {"position": unit, "speed": rates[k], "acceleration": f"{unit}/s^2"}
        ranges[name] = JointRange(**own, errors=RangeErrors(**off), units=units)  # type: ignore[arg-type]
    return ranges


def _point_paths(result: Result, breaks: Sequence[float]) -> dict[str, PointPath]:
    names = list(result.group("point_velocities"))
    if not names:
        return {}
    groups = ("point_velocities", "point_accelerations")
    v, a = (np.stack([result[f"{group}/{name}"] for name in names], axis=1) for group in groups)
    figures = path_figures(result.time, v, a, breaks)
    paths = {}
    for k, name in enumerate(names):
        own, off = of_one(figures, k)
        paths[name] = PointPath(**own, errors=PathErrors(**off))
    return paths


def places_at(scene: Scene, result: Result, closed: float = 0.0) -> list[PlacesAt]:
    """Return where points are at the times that are asked for; closed : how far joints may be off [rad or m].

    Raises
    ------
    SceneError : a time is behind the end of the motion.
    """
    places, times = [], result.time
    for number, time in enumerate(scene.kinematics.at if len(times) > 1 else ()):
        if time > times[-1] * (1.0 + AT_SAMPLE):
            raise SceneError(
                f"{time:g} s is behind the end of the motion, {times[-1]:g} s",
                (scene.path, f"kinematics.at.{number}"),
                key=f"kinematics.at.{number}",
            )
        k, h, s = between_samples(time, times)
        points = {}
        for name, item in result.group("points").items():
            still = np.zeros_like(item.data)
            rates = [
                result.variables.get(f"{group}/{name}")
                for group in ("point_velocities", "point_accelerations")
            ]
            ways = [item.data, *(still if x is None else x.data for x in rates)]
            first, last = ((ways[0][j], ways[1][j], ways[2][j]) for j in (k, k + 1))
            y, off = between((first, last), h, s)
            points[name] = PointPlace(float(y[0]), float(y[1]), float(y[2]), float(off.max()) + closed)
        places.append(PlacesAt(time, points))
    return places


def _singular_ratio(result: Result, breaks: Sequence[float], closed: float) -> SingularRatio | Absent:
    if "singularity/passive" not in result:
        return ABSENT
    psi, passive = (result[f"singularity/{name}"][:, None] for name in ("psi", "passive"))
    own, off = of_one(ratio_figures(result.time, passive, psi, breaks, closed))
    return SingularRatio(own["smallest"], off["smallest"], own["time"], off["time"])


def _transmission(result: Result, breaks: Sequence[float], closed: float) -> TransmissionAngle | Absent:
    if "transmission_angle" not in result:
        return ABSENT
    angle = result["transmission_angle"][:, None]
    own, off = of_one(transmission_figures(result.time, angle, breaks, closed))
    return TransmissionAngle(**own, errors=TransmissionErrors(**off))
