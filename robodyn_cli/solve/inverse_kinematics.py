"""From the path of a point, or of a frame with its axes, to the motion of the joints."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from robodyn_cli.errors import CapabilityError, GeometryError, SceneError, SingularConfigurationError
from robodyn_cli.expr.graph import Expr
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.record import record
from robodyn_cli.solve import planar_2r as planar_path
from robodyn_cli.solve.planar_2r import BRANCHES, ELBOW_DOWN, ELBOW_UP, Planar2R
from robodyn_cli.solve.reach import Singular, Unreachable
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import Ik, TaskSpaceTrajectory
from robodyn_cli.trajectories.led import position_columns
from robodyn_cli.trajectories.motion import Asked, JointMotion, Near, PointMotion, PoseMotion, in_frame

if TYPE_CHECKING:
    from robodyn_cli.solve.newton import Drift
    from robodyn_cli.solve.point_kinematics import Led, PointFunction, PointKinematics

Compile = Callable[["PointKinematics"], "PointFunction"]


@record
class PathTask:
    """A point of a model, or a frame there, and the path that it is to follow.

    frame : the point. trajectory : its path and the options of the inverse kinematics.
    start : joint positions by name near which the motion starts (``ik.guess``, or the scene's ``initial.q``).
    parameters : of the scene. where : the scene's file, for messages. chosen : whether the start is on the branch
    that ``ik.branch`` names. drift : of a redundant chain (see ``PointSolver``), None for the least rates.
    prescribed : formulas of joints whose motion is given beside the path, by column of q.
    """

    model: Model
    frame: FixedFrame
    trajectory: TaskSpaceTrajectory
    start: Mapping[str, float]
    parameters: Mapping[str, float]
    where: str = ""
    chosen: bool = False
    drift: Drift | None = None
    prescribed: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def ik(self) -> Ik:
        options: Ik = self.trajectory.ik
        return options

    @property
    def moving(self) -> FixedFrame | None:
        """The frame on a moving link in whose coordinates the path is given, None for the world's."""
        return moving_reference(self.model, self.trajectory)

    def target(self, times: Array) -> PointMotion | PoseMotion:
        """Return the target of the point, or of the frame, at ``times`` (T,); coordinates as of ``target_of``."""
        return target_of(self.model, self.trajectory, times, self.parameters)

    def asked(self, times: Array) -> PointMotion | PoseMotion | Asked:
        """Return the target at ``times`` (T,), and behind it the positions that are given beside the path."""
        target = self.target(times)
        if not self.prescribed:
            return target
        from robodyn_cli.trajectories.formulas import evaluated, joint_expressions, time_symbol, with_rates

        t, env = time_symbol(self.parameters)
        columns = position_columns(self.prescribed)
        q = joint_expressions(evaluated(self.prescribed, env), columns, t).q
        given = with_rates(q, t, times, [f"prescribed.{name}" for name in columns])
        own = target.values, target.rates, target.accelerations
        return Asked(*(np.concatenate(pair, axis=1) for pair in zip(own, given)))

    def point_target(self, times: Array) -> PointMotion:
        """Return the target of a point that has no orientation."""
        target = self.target(times)
        assert isinstance(target, PointMotion)
        return target

    @cached_property
    def arm(self) -> Planar2R | None:
        """The planar arm whose angles follow from the path in closed form, None where there is none."""
        if self.moving is not None or self.prescribed:
            return None
        arm, target = Planar2R.recognise(self.model, self.frame), self.target(np.zeros(1))
        if arm is None or isinstance(target, PoseMotion) or arm.in_plane(target) is None:
            return None
        return arm

    @property
    def method(self) -> str:
        """``analytic`` or ``newton``."""
        return "analytic" if self.arm is not None and self.ik.method != "newton" else "newton"

    @property
    def led(self) -> Led:
        """What the path leads."""
        from robodyn_cli.solve.point_kinematics import Led

        target = self.target(np.zeros(1))
        oriented = isinstance(target, PoseMotion)
        return Led(
            self.frame, target.p.shape[1], oriented, self.moving, tuple(position_columns(self.prescribed))
        )

    def kinematics(self) -> PointKinematics:
        """Return the expressions that Newton's method evaluates, over the symbols q and v."""
        from robodyn_cli.solve.point_kinematics import PointKinematics

        graph, names = self.model.graph, self.model.v_names
        q, v = graph.symbols(self.model.q_names, "q"), graph.symbols([f"{n}'" for n in names], "v")
        return PointKinematics.of(self.model, q, v, self.led)

    def start_positions(self) -> Array | None:
        """Return the start as an array (nq,), None where there is none."""
        names = self.model.q_names
        if not self.start:
            return None
        missing = [name for name in names if name not in self.start]
        if missing:
            raise SceneError(
                f"the inverse kinematics of {self.trajectory.point!r} starts at initial.q, which "
                f"lacks joint {missing[0]!r}; give all of {', '.join(names)}, there or in trajectory.ik.guess",
                (self.where,),
                key="initial.q",
            )
        return np.array([self.start[name] for name in names])


def moving_reference(model: Model, trajectory: TaskSpaceTrajectory) -> FixedFrame | None:
    """Return the frame in whose coordinates a path is given where a moving link carries it, else None."""
    place = None if trajectory.relative_to is None else model.place(trajectory.relative_to)
    return None if place is None or place.body == BASE else place


def target_of(
    model: Model, trajectory: TaskSpaceTrajectory, times: Array, parameters: Mapping[str, float]
) -> PointMotion | PoseMotion:
    """Return what a trajectory asks at ``times`` (T,), in world coordinates, or in those of a ``moving_reference``."""
    motion = trajectory.target(times, parameters)
    if trajectory.relative_to is None or moving_reference(model, trajectory) is not None:
        return motion
    place = model.place(trajectory.relative_to)
    p, R = model.base.point(place.p), np.array(model.base.E.T @ place.R, dtype=float)
    if not any(isinstance(x, Expr) for x in p):
        rest = np.zeros((1, 3))
        return in_frame(motion, PointMotion(np.array([p], dtype=float), rest, rest), R)
    from robodyn_cli.trajectories.formulas import with_rates

    t = model.graph.symbol("t", "t")
    moves = with_rates(list(p), t, times, [f"the motion of {trajectory.relative_to!r}"] * 3)
    return in_frame(motion, PointMotion(*moves), R)


@record
class FollowedPath:
    """Joint motion that follows a path, the method (``analytic`` or ``newton``), its iterations and steps.

    near : solves it at other times, None where it has to be followed.
    """

    motion: JointMotion
    method: str
    iterations: int = 0
    steps: int = 0
    near: Near | None = None


def follow_point(task: PathTask, times: Array, compile: Compile) -> FollowedPath:
    """Return the joint motion, at T times, that keeps a point on its path.

    Joints are continuous along the path, rates and accelerations exact (``J qd = pd``, ``J qdd = pdd - J-dot
    qd``; for redundant chains see ``newton``). Joints that do not move the point stay where they start.

    Parameters
    ----------
    times : (T,) from 0. compile : makes the function that Newton's method calls, where it is needed.

    Raises
    ------
    SceneError : no branch and no start. CapabilityError : a method that does not fit the chain.
    GeometryError : a target out of reach. SingularConfigurationError : a singular pose on the way.
    """
    point, ik = task.trajectory.point, task.ik
    if task.frame.body == BASE:
        raise SceneError(
            f"point {point!r} is fixed to the base and cannot follow a trajectory",
            (task.where,),
            key="trajectory.point",
        )
    arm = task.arm
    _check_options(task)
    start = task.start_positions()
    try:
        if arm is not None and task.method == "analytic":
            branch = _branch(arm, ik, start, point, task.where)
            motion = planar_path.follow(arm, task.point_target, times, branch, start, ik.tolerance)
            return FollowedPath(motion, "analytic")
        if start is None and arm is not None and ik.branch is not None:
            start = planar_path.follow(
                arm, task.point_target, times[:1], BRANCHES[ik.branch], None, ik.tolerance
            ).q[0]
        if start is None:
            raise SceneError(
                f"the inverse kinematics of {point!r} needs joint positions to start from: give "
                "trajectory.ik.guess (or initial.q)",
                (task.where,),
                key="trajectory.ik",
            )
        return _by_newton(task, times, start, compile)
    except Unreachable as failure:
        _report_unreachable(failure, f"point {point!r}", task.where)
    except Singular as failure:
        raise SingularConfigurationError(
            f"point {point!r} meets a singular configuration at t = {failure.time:.6g} s "
            f"(measure {failure.measure:.1e}), where the joint rates that keep it on its path do not exist "
            f"or are not unique{_moves_most(task.model, failure)}; change the path or the branch",
            (task.where,),
            time=failure.time,
            measure=failure.measure,
        ) from None


def _moves_most(model: Model, failure: Singular) -> str:
    """Return which joint a singular pose concerns, as a part of a sentence."""
    if failure.joint is None:
        return ""
    return f", least of all that of joint {model.joint_of(failure.joint)!r}"


def _by_newton(task: PathTask, times: Array, start: Array, compile: Compile) -> FollowedPath:
    """Follow the path by Newton's method from one time to the next."""
    from robodyn_cli.model.manifold import Manifold
    from robodyn_cli.solve.follow import PathFollower
    from robodyn_cli.solve.newton import PointSolver

    ik = task.ik
    function = compile(task.kinematics())
    solver = PointSolver(
        function, task.led, Manifold(task.model), ik.tolerance, ik.max_iterations, task.drift
    )
    if not solver.leads:
        point = task.trajectory.point
        raise SceneError(
            f"no joint moves point {point!r}, so it cannot follow a trajectory",
            (task.where,),
            key="trajectory.point",
        )
    follower = PathFollower(solver, task.asked, times)
    given = [task.model.q_names.index(name) for name in task.led.columns]

    def exact(motion: JointMotion, follower: PathFollower) -> JointMotion:
        if given:
            motion.q[:, given] = follower.at_samples[0][:, -len(given) :]  # without the rounding of the steps
        return motion

    def near(times: Array, guess: Array) -> JointMotion | None:
        follower = PathFollower(solver, task.asked, times)
        motion = follower.near(guess)
        return None if motion is None else exact(motion, follower)

    motion = exact(follower.run(start), follower)
    found = None if follower.one_by_one else near
    return FollowedPath(motion, "newton", solver.iterations, follower.steps, found)


def _check_options(task: PathTask) -> None:
    """Refuse a method or a branch that does not suit the chain."""
    ik, arm, point, where = task.ik, task.arm, task.trajectory.point, task.where
    if arm is None and ik.method == "analytic":
        raise CapabilityError(
            f"trajectory.ik.method: analytic fits only planar 2R arms (two revolute joints with "
            f"parallel axes that carry point {point!r}); allowed here: auto, newton",
            (where,),
            key="trajectory.ik.method",
        )
    if arm is None and ik.branch is not None and not task.chosen:
        raise SceneError(
            f"trajectory.ik.branch ({ik.branch}) has a meaning only for arms whose branches have names (planar "
            "arms, SCARA robots, spherical wrists, three parallel axes) and for targets that determine all joints; "
            "use trajectory.ik.guess instead",
            (where,),
            key="trajectory.ik.branch",
        )
    if arm is not None and ik.branch is not None and ik.branch not in BRANCHES:
        raise SceneError(
            f"trajectory.ik.branch ({ik.branch}): a planar 2R arm has {', '.join(BRANCHES)}",
            (where,),
            key="trajectory.ik.branch",
        )


def _branch(arm: Planar2R, ik: Ik, start: Array | None, point: str, where: str) -> float:
    """Return the sign of the bend: from ``branch``, else from the start."""
    if ik.branch is not None:
        return BRANCHES[ik.branch]
    if start is None:
        raise SceneError(
            f"point {point!r} can be reached in two ways: choose trajectory.ik.branch (elbow_up, "
            "which is theta2 < 0, or elbow_down), or give trajectory.ik.guess",
            (where,),
            key="trajectory.ik",
        )
    bend = arm.bend(start)
    if abs(np.sin(bend)) < 1e-9:
        raise SceneError(
            f"trajectory.ik.guess (or initial.q) has the arm stretched out or folded, so it chooses "
            f"no branch for {point!r}; bend it, or choose trajectory.ik.branch (elbow_up, elbow_down)",
            (where,),
            key="trajectory.ik",
        )
    return ELBOW_UP if bend < 0.0 else ELBOW_DOWN


GRAZING = 1e-3  # part of the largest distance: less is that of a target just beyond reach


def _report_unreachable(failure: Unreachable, point: str, where: str) -> NoReturn:
    """Raise the error that says from when on, and how far, a target is out of reach."""
    nearest = "the nearest point it reaches is" if failure.nearest else "the nearest point found is"
    message = f"{point} cannot reach its target at t = {failure.time:.6g} s"
    if failure.distance > GRAZING * failure.worst:
        message += f": {nearest} {failure.distance:.4g} m away"
        if failure.worst_time != failure.time:
            message += f" (worst at t = {failure.worst_time:.3g} s: {failure.worst:.4g} m)"
    else:
        message += (
            f" and later: at worst, at t = {failure.worst_time:.3g} s, {nearest} {failure.worst:.4g} m away"
        )
    raise GeometryError(
        message,
        (where,),
        time=failure.time,
        distance=failure.distance,
        worst_time=failure.worst_time,
        worst_distance=failure.worst,
    ) from None
