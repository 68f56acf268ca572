"""From a scene's trajectory to the motion of its joints."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, GeometryError, SceneError, SingularConfigurationError
from robodyn_cli.model.model import Model
from robodyn_cli.observe.places import in_world
from robodyn_cli.record import record
from robodyn_cli.scene.points import with_points
from robodyn_cli.scene.types import Ready, Scene
from robodyn_cli.solve.quadrature import GAP, gaps_between, places_of
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.trajectories.led import given_by_formulas, position_columns
from robodyn_cli.trajectories.motion import JointMotion, Near
from robodyn_cli.trajectories.registry import trajectory_types

if TYPE_CHECKING:
    from robodyn_cli.solve.inverse_kinematics import PathTask
    from robodyn_cli.solve.point_kinematics import PointFunction, PointKinematics
    from robodyn_cli.trajectories.joint_space import JointSpaceTrajectory, JointsTogether


@record
class Planned:
    """The joints' motion at sample times (T,), and its origin.

    point, target : the point that is led, and where it is asked to be in the world (T, 2 or 3) [m]. axes : those asked
    for there (T, 3, 3) as columns, None where the attitude is left free.
    method : of the inverse kinematics, ``analytic`` or ``newton``. residuals : the largest of the loops, by level.
    stopped : why the motion ends early, None where it is whole.
    near : solves the motion at other times (T,) near positions (T, nq); returns None where one of them is not regular,
    not reached or not close. None where a motion has to be followed.
    """

    times: Array
    motion: JointMotion
    point: str | None = None
    target: Array | None = None
    axes: Array | None = None
    method: str | None = None
    residuals: dict[str, float] = dataclasses.field(default_factory=dict)
    counters: dict[str, int] = dataclasses.field(default_factory=dict)
    stopped: GeometryError | SingularConfigurationError | None = None
    near: Near | None = None


def led_by(scene: Scene, trajectory: Any) -> Ready:
    """Return the scene with a motion in time as its trajectory, and no joint prescribed to follow any.

    The places that the trajectory names (as ``link2.end``) are among the scene's points.
    """
    prescribed = given_by_formulas(scene.prescribed)
    led = dataclasses.replace(scene, trajectory=trajectory, prescribed=prescribed)
    return Ready(led if trajectory is None else with_points(led, trajectory.places))


def by_columns(model: Model, motion: JointMotion) -> tuple[Array, Array, Array]:
    """Return the columns of q (T, nq) and their first and second derivatives, of attitudes too."""
    if not any(body.joint.quasi for body in model.bodies):
        return motion.q, motion.qd, motion.qdd
    from robodyn_cli.model.manifold import Manifold

    manifold = Manifold(model)
    rates = [manifold.rates(*state) for state in zip(motion.q, motion.qd, motion.qdd)]
    return motion.q, np.array([first for first, _ in rates]), np.array([second for _, second in rates])


def motion_duration(scene: Scene) -> float:
    """Return the length of the motion [s]: of the trajectory, else of the simulation, where joints are prescribed."""
    return float(scene.trajectory.duration if scene.trajectory is not None else scene.simulate.duration)


def knots_of(scene: Scene) -> list[float]:
    """Return the times [s] at which the trajectory of a scene has knots, as far as it knows them."""
    trajectory = scene.trajectory
    return [] if trajectory is None or trajectory.knots is None else [float(x) for x in trajectory.knots]


def knot_places(scene: Scene, times: Array) -> list[float]:
    """Return where the trajectory of a scene has knots among times (T,), in steps from the first: where samples lie on
    both sides of some, these."""
    gaps = gaps_between(times)
    return (gaps + 0.5).tolist() if gaps.size else places_of(knots_of(scene), times)


FEW = 8  # intervals of each of many pieces of a motion at which figures are looked at
CLOSE = 64  # of each of few pieces
MANY = 1024  # intervals of all pieces together that are shared out
SIDE = 1e-6  # of the shorter piece beside a knot: so far from it are the samples on both of its sides
BESIDE = 0.2 * GAP  # of the time between samples: no further than that
SHORT = 1e-9  # of a motion: a piece no longer is none


def looked_at(times: Array, knots: Sequence[float]) -> Array:
    """Return the times at which figures of a motion are looked at, whatever its samples at times (T,) are.

    In each piece from knot to knot, to both of its ends, they are as many, and no fewer in all than the samples.

    A piece has 4 n intervals, so that the parts of its samples are uniform too.
    """
    first, last = float(times[0]), float(times[-1])
    ends = [first]
    for knot in sorted(knots):
        if knot - ends[-1] > SHORT * (last - first) and last - knot > SHORT * (last - first):
            ends.append(knot)
    count, samples = len(ends), len(times) - 1
    if samples < 1 or (count == 1 and samples >= CLOSE):
        return times
    length = np.diff([*ends, last])
    intervals = 4 * -(-max(FEW, min(CLOSE, MANY // count), -(-samples // count)) // 4)
    side = min(SIDE, BESIDE / intervals) * np.minimum(length[1:], length[:-1])
    begin, end = (np.array(ends) + np.append(0.0, side), np.append(ends[1:], last) - np.append(side, 0.0))
    return np.linspace(begin, end, intervals + 1, axis=1).ravel()


def plan_motion(problem: Problem, times: Array) -> Planned:
    """Return the motion of an open chain's joints at ``times`` (T,), columns in the model's order.

    Prescribed joints move as they do, beside the trajectory.

    Raises
    ------
    SceneError : there is no trajectory, or its inverse kinematics lacks a choice. GeometryError and
    SingularConfigurationError : from the inverse kinematics.
    """
    scene, model = problem.scene, problem.model
    trajectory: JointSpaceTrajectory | TaskSpaceTrajectory | None = scene.trajectory
    if trajectory is None and not scene.prescribed:
        raise SceneError(
            f"key 'trajectory' is missing: inverse dynamics needs a motion; "
            f"kinds: {', '.join(trajectory_types)}",
            (scene.path,),
            key="trajectory",
        )
    if not isinstance(trajectory, TaskSpaceTrajectory):
        own = _together(problem) if scene.prescribed or trajectory is None else trajectory
        _refuse_some(model, own)
        return Planned(times, own.motion(times, model.q_names, scene.parameters))
    from robodyn_cli.solve.inverse_kinematics import follow_point

    followed = follow_point(point_task(problem), times, compile_point)
    counters = (
        {"ik_iterations": followed.iterations, "ik_steps": followed.steps} if followed.iterations else {}
    )
    planned = Planned(
        times,
        followed.motion,
        trajectory.point,
        method=followed.method,
        counters=counters,
        near=followed.near,
    )
    return _with_target(problem, planned)


def _with_target(problem: Problem, planned: Planned) -> Planned:
    """Return the motion of an open chain with where its point is asked to be."""
    from robodyn_cli.solve.inverse_kinematics import moving_reference, target_of

    model, trajectory, parameters = problem.model, problem.scene.trajectory, problem.scene.parameters
    wanted = target_of(model, trajectory, planned.times, parameters)
    moving = moving_reference(model, trajectory)
    target, axes = in_world(model, moving, wanted.p, wanted.R, planned.motion.q)
    return dataclasses.replace(planned, target=target, axes=axes)


def motion_near(model: Model, known: Planned, times: Array) -> JointMotion | None:
    """Return a known motion at other times (T,) within it, all solved at once from where polynomials through what is
    known put it; None where it has to be followed (see ``Planned.near``)."""
    if known.near is None:
        return None
    from robodyn_cli.trajectories.course import course_through

    q, v, a = by_columns(model, known.motion)
    return known.near(times, course_through(known.times, q, v, (a, a))(times))


def plan_near(problem: Problem, known: Planned, times: Array) -> Planned | None:
    """Return what ``plan_motion`` gave at other times (T,); None where it has to be followed, as with loops, whose
    residuals are those of the samples."""
    if known.near is None or problem.model.closures:
        return None
    motion = motion_near(problem.model, known, times)
    return (
        None
        if motion is None
        else _with_target(problem, dataclasses.replace(known, times=times, motion=motion))
    )


def _together(problem: Problem) -> JointsTogether:
    """Return the motion of the prescribed joints and of those that the trajectory leads."""
    from robodyn_cli.given.prescribed import check_prescribed, refuse_both
    from robodyn_cli.trajectories.joint_space import JointsTogether

    refuse_both(problem.scene)
    check_prescribed(problem)
    return JointsTogether(problem.scene.prescribed, problem.scene.trajectory)


def _refuse_some(model: Model, trajectory: JointSpaceTrajectory) -> None:
    """Refuse a motion of some joints only, which is enough for a simulation that it prescribes.

    Raises
    ------
    CapabilityError
    """
    led = position_columns(trajectory.joints)
    missing = [name for name in model.q_names if name not in led]
    if missing:
        raise CapabilityError(
            f"neither `trajectory` nor `prescribed` leads joint {missing[0]!r}, and the motion of all joints is needed "
            "here; only `simulate` leaves others to the forces"
        )


def point_task(problem: Problem) -> PathTask:
    """Return the point, or the frame, that the scene's trajectory leads, and its path."""
    from robodyn_cli.solve.inverse_kinematics import PathTask

    scene, model = problem.scene, problem.model
    trajectory: Any = scene.trajectory
    where = scene.path
    frame, ik = model.place(trajectory.point), trajectory.ik
    start, prescribed = ik.guess or scene.initial.q, scene.prescribed
    if prescribed:
        from robodyn_cli.given.prescribed import prescribed_starts

        start = {**scene.initial.q, **ik.guess, **prescribed_starts(scene)}
    task = PathTask(model, frame, trajectory, start, scene.parameters, where, prescribed=prescribed)
    named, redundant = ik.branch is not None and task.arm is None, ik.redundancy != "least_rates"
    if not named and not redundant:
        return task
    from robodyn_cli.given.poses.path import drift_of, start_of

    chosen = start_of(problem, task)
    if chosen is not None:
        task = dataclasses.replace(task, start=chosen, chosen=True)
    return dataclasses.replace(task, drift=drift_of(problem, task)) if redundant else task


def compile_point(kinematics: PointKinematics) -> PointFunction:
    """Return a point's kinematics as a compiled function, quick on single samples too."""
    from robodyn_cli.kernels.samples import SampleKernel, of_one_sample

    kernel = SampleKernel(kinematics.outputs(), ("q", "v"))
    single = of_one_sample(kernel, q=kinematics.nq, v=kinematics.nv)

    def function(q: Array, v: Array) -> tuple[Array, Array, Array]:
        if len(q) > 1:
            return kinematics.unpack(kernel.evaluate(len(q), {"q": q, "v": v}))
        return kinematics.unpack({name: array[None] for name, array in single(q=q[0], v=v[0]).items()})

    return function
