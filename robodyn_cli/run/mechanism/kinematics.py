"""Kinematic analysis: where a mechanism goes, how fast, and how well it transmits, without any forces."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.kinematics import motions, velocities
from robodyn_cli.equations.problem import GROUPS, Problem
from robodyn_cli.errors import RobodynError, SceneError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.model.model import BASE
from robodyn_cli.results.result import Result
from robodyn_cli.run.driver.prepare import held_columns
from robodyn_cli.run.driver.singularity import loop_rows
from robodyn_cli.run.inverse.motion import plan_motion, with_led_point, with_points
from robodyn_cli.run.mechanism.guided_motion import GuidedMotion, guided_motion
from robodyn_cli.run.mechanism.loop_conditions import Lead, lead_of, refuse_quasi
from robodyn_cli.run.mechanism.mobility import mobility
from robodyn_cli.run.observation.evaluation import SampleFunction
from robodyn_cli.run.observation.observe import loop_columns
from robodyn_cli.run.observation.places import add_places, place_outputs
from robodyn_cli.run.observation.units import joint_columns
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import cross

Array = NDArray[np.float64]


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
    options = scene.kinematics
    with watch.stage("equations"):
        named = with_points(with_led_point(scene), options.transmission or ())
        problem = Problem(named)
    with watch.stage("solve"):
        guided, led = _motion(problem)
    times, motion = guided.times, guided.motion
    rows = [problem.constraints.rows[i] for i in loop_rows(problem)]
    with watch.stage("equations"):
        places = place_outputs(problem)
        moving = _point_motion(problem)
        psi = {"psi": [x for row in rows for x in row.psi], "eta": [row.eta for row in rows]} if rows else {}
        function = SampleFunction({**places, **moving, **psi}, GROUPS, len(times))
    with watch.stage("evaluate"):
        arrays = function(t=times[:, None], q=motion.q, v=motion.qd, a=motion.qdd)
    result = Result("kinematics", scene.title or "kinematics", "ok", scene.text)
    names = problem.model.v_names
    result.add("time", times)
    columns = joint_columns(problem.model)
    for path, data in (("q", motion.q), ("qd", motion.qd), ("qdd", motion.qdd)):
        result.add(path, data, **columns[path].described())
    add_places(result, {path: arrays[path] for path in places})
    for path in moving:
        result.add(path, arrays[path])
    if rows:
        Psi = arrays["psi"].reshape(len(times), len(rows), problem.model.nv)
        column = loop_columns(rows)["constraints/position_residual"]
        result.add("constraints/position_residual", arrays["eta"], units=column.units, names=column.names)
        _add_singular_values(result, problem, Psi, led)
        result.summary["mobility"] = mobility(problem, Psi)
    if options.transmission is not None:
        result.add("transmission_angle", transmission_angle(result, options.transmission))
    _summarise(result, names, guided)
    progress(float(times[-1]), float(times[-1]))
    result.summary["wall_time_s"] = watch.report()
    if guided.stopped is not None:
        raise _stopped(result, guided.stopped)
    return result


def _motion(problem: Problem) -> tuple[GuidedMotion, tuple[str, ...]]:
    """Return the motion and the columns of v that lead it."""
    scene, model = problem.scene, problem.model
    samples = scene.kinematics.samples
    sweep = scene.kinematics.sweep
    if sweep is None and scene.trajectory is None and not scene.prescribed:
        raise SceneError(
            f"{scene.path}: nothing moves: kinematics needs `kinematics.sweep`, `trajectory` or `prescribed`",
            key="kinematics",
        )
    if sweep is None and scene.trajectory is not None and not problem.model.closures and not scene.prescribed:
        times = np.linspace(0.0, scene.trajectory.duration, samples)
        planned = plan_motion(problem, times)
        return GuidedMotion(times, planned.motion, {}, planned.counters), model.v_names
    if sweep is None:
        lead = lead_of(problem)
        duration = scene.trajectory.duration if scene.trajectory is not None else scene.simulate.duration
    else:
        lead, duration = _swept(problem), abs(sweep.stop - sweep.start) / sweep.rate
    found = guided_motion(problem, lead, np.linspace(0.0, duration, samples))
    return found, (*lead.joints, *scene.prescribed)


def _swept(problem: Problem) -> Lead:
    """Return a lead with the swept joint, and joints that stay: held ones, in an open chain all others."""
    scene = problem.scene
    sweep = scene.kinematics.sweep
    assert sweep is not None
    model = problem.model
    refuse_quasi(model, (sweep.joint, *scene.initial.hold))
    others = held_columns(scene, problem) if model.closures else model.q_names
    held = [name for name in others if name != sweep.joint and name not in scene.prescribed]
    missing = [name for name in held if name not in scene.initial.q]
    if missing:
        raise SceneError(
            f"{scene.path}: initial.q: joint {missing[0]!r} stays where it is during the sweep, and has no position",
            key="initial.q",
        )
    rate = sweep.rate if sweep.stop > sweep.start else -sweep.rate
    stay = [scene.initial.q[name] for name in held]

    def asked(times: Array) -> tuple[Array, Array, Array]:
        q = np.tile([sweep.start, *stay], (len(times), 1))
        q[:, 0] += rate * times
        qd = np.zeros_like(q)
        qd[:, 0] = rate
        return q, qd, np.zeros_like(q)

    return Lead(asked, joints=(sweep.joint, *held))


def _point_motion(problem: Problem) -> dict[str, list[Scalar]]:
    """Return velocities and accelerations of the named points in world coordinates, by result path."""
    model = problem.model
    speed = velocities(model, problem.X, problem.q, problem.v)
    motion = motions(model, problem.X, problem.q, problem.v, problem.a)
    out: dict[str, list[Scalar]] = {}
    for name, frame in model.points.items():
        if frame.body == BASE:
            continue
        to_world = model.base.E.T @ problem.pose[frame.body].R
        here = speed[frame.body]
        out[f"point_velocities/{name}"] = list(to_world @ (here.v + cross(here.w, frame.p)))
        out[f"point_accelerations/{name}"] = list(to_world @ motion[frame.body].acceleration_of(frame.p))
    return out


def _add_singular_values(result: Result, problem: Problem, psi: Array, led: tuple[str, ...]) -> None:
    result.add("singularity/psi", np.linalg.svd(psi, compute_uv=False))
    model = problem.model
    passive = [k for k, name in enumerate(model.v_names) if name not in led]
    if not passive or not led:
        return
    block = psi[:, :, passive]
    result.add("singularity/passive", np.linalg.svd(block, compute_uv=False))
    if block.shape[1] == block.shape[2]:
        result.add("singularity/determinant", np.linalg.det(block))


def transmission_angle(result: Result, points: tuple[str, ...]) -> Array:
    """Return the angle at the second of three points (T,) [rad], from 0 to pi."""
    a, b, c = (result[f"points/{name}"] for name in points)
    u, w = a - b, c - b
    across = np.linalg.norm(np.cross(u, w), axis=1)
    along: Array = np.einsum("ti,ti->t", u, w)
    angle: Array = np.arctan2(across, along)
    return angle


def _summarise(result: Result, names: tuple[str, ...], guided: GuidedMotion) -> None:
    summary: dict[str, Any] = result.summary
    times = guided.times
    summary["status"] = "ok"
    summary["termination"] = {"reason": "end of the motion", "time": float(times[-1])}
    summary["samples"] = len(times)
    summary["joints"] = {}
    positions = result.variables["q"].names
    for k, name in enumerate(names):
        # quasi-velocities are the rates of no position
        q = result["q"][:, positions.index(name)] if name in positions else None
        summary["joints"][name] = {
            "smallest": None if q is None else float(q.min()),
            "largest": None if q is None else float(q.max()),
            "peak_speed": float(np.abs(result["qd"][:, k]).max()),
            "peak_acceleration": float(np.abs(result["qdd"][:, k]).max()),
        }
    summary["points"] = {}
    for name, item in result.group("point_velocities").items():
        fast = np.linalg.norm(item.data, axis=1)
        summary["points"][name] = {
            "peak_speed": float(fast.max()),
            "peak_acceleration": float(np.linalg.norm(result[f"point_accelerations/{name}"], axis=1).max()),
            "path_length": float(np.linalg.norm(np.diff(result[f"points/{name}"], axis=0), axis=1).sum()),
        }
    if "singularity/passive" in result:
        ratio = result["singularity/passive"][:, -1] / result["singularity/psi"][:, 0]
        at = int(np.argmin(ratio))
        summary["singular_ratio"] = {"smallest": float(ratio[at]), "time": float(times[at])}
    if "transmission_angle" in result:
        angle = np.degrees(result["transmission_angle"])
        low, high = int(np.argmin(angle)), int(np.argmax(angle))
        summary["transmission_angle"] = {
            "smallest_deg": float(angle[low]), "smallest_time": float(times[low]),
            "largest_deg": float(angle[high]), "largest_time": float(times[high]),
        }  # fmt: skip
    if guided.residuals:
        summary["error_estimate"] = {"closure": guided.residuals}
    summary["counters"] = guided.counters


def _stopped(result: Result, error: RobodynError) -> RobodynError:
    result.status = result.summary["status"] = "failed"
    result.summary["termination"] = {"reason": error.message, **error.details}
    error.result = result
    return error
