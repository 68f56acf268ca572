"""Checks of a scene that look at more than one key; each error is placed at the key that is wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from robodyn_cli.integration_methods import FIXED_STEP
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.record import record
from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.checks.robot import check_joints, check_robot, columns, moving
from robodyn_cli.scene.points import joints_between, point_problem
from robodyn_cli.scene.text.nodes import Path
from robodyn_cli.scene.types import DeployOptions, KinematicsOptions, Robot, Scene, Torque
from robodyn_cli.trajectories.led import (
    FOLLOW,
    follow_trajectory,
    position_columns,
    to_find,
    velocity_columns,
)
from robodyn_cli.trajectories.registry import trajectory_types

if TYPE_CHECKING:
    from robodyn_cli.forces.limits import Limits


@record
class _SceneNames:
    """The names of a scene, for trajectories."""

    robot: Robot
    closed: bool = False
    some: bool = False
    parameters: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def joints(self) -> tuple[str, ...]:
        return columns(self.robot, quasi=False)

    @property
    def columns(self) -> tuple[str, ...]:
        return columns(self.robot)

    @property
    def rates(self) -> tuple[str, ...]:
        return columns(self.robot, velocities=True)

    def limits(self, joint: str) -> Limits | None:
        own: Limits | None = self.robot.limits_of(joint)
        return own

    @property
    def quasi(self) -> tuple[str, ...]:
        return tuple(joint.name for joint in self.robot.joints if joint_types[joint.type].quasi)

    def point_problem(self, reference: str) -> str | None:
        return None if reference in self.robot.frames else point_problem(self.robot, reference)

    def moves(self, reference: str, against: str = "base.origin") -> bool:
        points = (self.robot.points.get(name) for name in (reference, against))
        if any(point is not None and point.motion is not None for point in points):
            return True
        return bool(joints_between(self.robot, reference, against) & set(moving(self.robot)))


def names_of(scene: Scene, some: bool = False) -> _SceneNames:
    """Return the names of a scene; ``some`` : a trajectory may leave joints to the forces, as it may in loops."""
    closed = bool(scene.loops or scene.couplers)
    return _SceneNames(scene.robot, closed, closed or some, scene.parameters)


def check_scene(scene: Scene, check: Check) -> Scene:
    """Return the scene with the robot's connections filled in; ``check.found`` holds all errors."""
    robot = check_robot(scene.robot, check)
    follow = None
    if scene.prescribed:
        scene, follow = _without_following(scene)
    actuated = robot.actuated if scene.actuated is None else scene.actuated
    scene = dataclasses.replace(scene, robot=robot, actuated=actuated)
    joints = {joint.name for joint in robot.joints}
    for name in scene.parameters:
        with check:
            if name in joints:
                message = f"{name!r} is a joint already; choose another name"
                check.fail(("parameters", name), message, at_key=True)
    elements = (
        scene.loops,
        robot.loops,
        scene.couplers,
        robot.couplers,
        scene.forces,
        scene.payloads,
        scene.torques,
    )
    if any((*elements, scene.outputs.signals, scene.control, scene.deploy.latches)):
        from robodyn_cli.scene.checks.elements import check_elements

        scene = check_elements(scene, check)
    _check_drives(scene, check)
    if scene.catalogue is not None:  # without drives too: ``size`` looks for them there
        from robodyn_cli.scene.checks.drives import check_drives

        check_drives(scene, check)
    _check_initial(scene, check)
    if scene.trajectory is not None:
        names = names_of(scene, follow is not None or bool(scene.prescribed))
        with check:
            for path, message in scene.trajectory.problems(names):
                with check:
                    check.fail(("trajectory", *path), message)
        if not check.found:
            scene = dataclasses.replace(scene, trajectory=scene.trajectory.completed(names))
    if scene.control is not None or scene.outputs.signals:
        from robodyn_cli.scene.checks.drives import check_control

        scene = check_control(scene, names_of(scene), check)
    if follow is not None:
        scene = _following(scene, follow, check)
    _check_runs(scene, check)
    balance = (scene.inverse.shaking, scene.inverse.flywheel, scene.simulate.fluctuation)
    columns = (scene.outputs.extremes, scene.outputs.abscissa)
    if any((scene.expect, scene.study.of, scene.search, *columns, *balance)):
        from robodyn_cli.scene.checks.keys import check_figures

        scene = check_figures(scene, check)
    return scene


def _without_following(scene: Scene) -> tuple[Scene, tuple[str, ...] | None]:
    """Return the scene with the motions that formulas prescribe alone, and the joints that follow the trajectory.

    Those are named one by one, or nobody is: then all that it leads follow. None: no joint follows it.
    """
    if isinstance(scene.prescribed, str):
        return dataclasses.replace(scene, prescribed={}), ()
    named = tuple(name for name, x in scene.prescribed.items() if x == FOLLOW)
    formulas = {name: x for name, x in scene.prescribed.items() if name not in named}
    return dataclasses.replace(scene, prescribed=formulas), named or None


def _following(scene: Scene, named: tuple[str, ...], check: Check) -> Scene:
    """Return the scene with the joints prescribed that its trajectory leads, or those of them that are named."""
    with check:
        trajectory = scene.trajectory
        if trajectory is None:
            message = (
                f"there is no trajectory to follow; give `trajectory`, of type {', '.join(trajectory_types)}"
            )
            check.fail(("prescribed",), message)
        check_joints(scene, _keys(named, "prescribed"), check, at_key=True)
        in_time = not trajectory.lacks
        if not in_time and (scene.loops or scene.couplers):
            check.fail(
                ("prescribed",),
                f"with loops or couplers no motion of joints is found along a path of type {trajectory.type}; follow "
                "the result of `inverse` or `kinematics` as a table",
            )
        if not check.found:
            formulas = scene.prescribed
            led: dict[str, Any] = dict(
                follow_trajectory(trajectory, scene.simulate.duration)
                if in_time
                else to_find(_columns_along(scene.robot, trajectory, position_columns(formulas)))
            )
            joints = {name: name.partition(".")[0] for name in led}
            _check_named(named, tuple(dict.fromkeys(joints.values())), in_time, check)
            following = {name: x for name, x in led.items() if not named or joints[name] in named}
            scene = dataclasses.replace(scene, prescribed={**formulas, **following})
            _check_drives(scene, check)
    return scene


def _check_named(named: tuple[str, ...], led: tuple[str, ...], in_time: bool, check: Check) -> None:
    """Refuse joints to follow a trajectory that does not lead them, and a path that not all of its joints follow."""
    for name in named:
        if name not in led:
            message = f"the trajectory does not lead joint {name!r}; allowed: {', '.join(led) or 'none'}"
            check.fail(("prescribed", name), message)
    left = [name for name in led if name not in named]
    if named and left and not in_time:
        message = f"joint {left[0]!r} moves the point too; let it follow the trajectory, or give it a formula"
        check.fail(("prescribed",), message)


def _columns_along(robot: Robot, trajectory: Any, given: tuple[str, ...]) -> tuple[str, ...]:
    """Return the columns of q that a path leads: those of the joints that carry its point; for the least time all.

    given : the columns that move by formulas.
    """
    from robodyn_cli.trajectories.base import Lacks

    every = tuple(name for name in columns(robot) if name not in given)
    if not trajectory.lacks:
        return position_columns(trajectory.joints)
    if trajectory.lacks is Lacks.PARTS:
        led = {name for segment in trajectory.segments for name in _columns_along(robot, segment, given)}
        return tuple(name for name in every if name in led)
    if trajectory.lacks is Lacks.TIMES:
        return every
    joints = joints_between(robot, trajectory.point, trajectory.relative_to or "base.origin")
    return tuple(name for name in every if name.partition(".")[0] in joints)


def _keys(names: Iterable[str], *path: str) -> list[tuple[str, Path]]:
    """Return the joints of columns, and their places in the tree."""
    joints = dict.fromkeys(name.partition(".")[0] for name in names)
    return [(name, (*path, name)) for name in joints]


def _items(names: Iterable[str], *path: str) -> list[tuple[str, Path]]:
    return [(name, (*path, k)) for k, name in enumerate(names)]


def _check_drives(scene: Scene, check: Check) -> None:
    for path, actuated in ((("actuated",), scene.actuated), (("robot", "actuated"), scene.robot.actuated)):
        items = _items(actuated or (), *path) if check.has(path) else []
        check_joints(scene, items, check, at_key=False)
        check.unique([name for name, _ in items], "joint", [place for _, place in items])
    check_joints(scene, _keys(scene.torques, "torques"), check, at_key=True)
    check_joints(scene, _keys(scene.prescribed, "prescribed"), check, at_key=True)
    for name, torque in scene.torques.items():
        with check:
            _check_torque(scene, name, torque, check)


def _check_torque(scene: Scene, name: str, torque: object, check: Check) -> None:
    joint, dot, coordinate = name.partition(".")
    path: Path = ("torques", joint, *((coordinate,) if dot else ()))
    if joint not in (each.name for each in scene.robot.joints):
        return  # told already
    if scene.actuated is not None and joint not in scene.actuated:
        allowed = ", ".join(scene.actuated) or "none"
        check.fail(path, f"joint {joint!r} is not in 'actuated'; allowed: {allowed}", at_key=True)
    if name in velocity_columns(scene.prescribed):
        check.fail(path, f"the motion of {name!r} is prescribed, so its torque is a result", at_key=True)
    if isinstance(torque, Torque):
        if (torque.table is None) == (torque.formula is None):
            check.fail(path, "needs one of 'table' and 'formula'")
        for k in range(1, len(torque.table or ())):
            time, before = torque.table[k][0], torque.table[k - 1][0]  # type: ignore[index]
            if not time > before:
                message = f"times must increase (value {time!r} after {before!r})"
                check.fail((*path, "table", k, 0), message)


def _check_initial(scene: Scene, check: Check) -> None:
    initial = scene.initial
    check_joints(scene, _keys(initial.q, "initial", "q"), check, at_key=True)
    check_joints(scene, _keys(initial.qd, "initial", "qd"), check, at_key=True)
    check_joints(scene, _items(initial.hold, "initial", "hold"), check, at_key=False)
    check.unique(initial.hold, "joint", [path for _, path in _items(initial.hold, "initial", "hold")])
    if initial.at is not None and initial.source is None:
        check.fail(
            ("initial", "at"), "says when to go on from a stored run, but `from` names none", at_key=True
        )


def _check_runs(scene: Scene, check: Check) -> None:
    options = scene.simulate
    with check:
        fixed = options.integrator in FIXED_STEP
        if fixed and options.step is None:
            message = f"has a fixed step: key 'step' is missing beside it (value {options.integrator!r})"
            check.fail(("simulate", "integrator"), f"{message}; allowed: a number > 0 [s]")
        if not fixed and options.step is not None:
            message = f"does not go with integrator {options.integrator!r}, which chooses its own"
            check.fail(("simulate", "step"), f"{message}; allowed: with {', '.join(FIXED_STEP)}")
        if fixed and options.max_step is not None:
            message = f"does not go with integrator {options.integrator!r}, whose steps are all as long as 'step' says"
            check.fail(
                ("simulate", "max_step"), f"{message}; allowed: with methods that choose their own steps"
            )
    if scene.kinematics != KinematicsOptions():
        from robodyn_cli.scene.checks.options import check_kinematics

        check_kinematics(scene, check)
    if scene.deploy != DeployOptions():
        from robodyn_cli.scene.checks.options import check_deploy

        check_deploy(scene, check)
    if scene.motorisation is not None:
        from robodyn_cli.scene.checks.options import check_motorisation

        check_motorisation(scene, scene.motorisation, check)
    if scene.reach is not None:
        from robodyn_cli.scene.checks.options import check_reach

        check_reach(scene.robot, scene.reach, check)
