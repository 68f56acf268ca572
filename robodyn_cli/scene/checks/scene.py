"""Checks of a scene that look at more than one key; each error is placed at the key that is wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from robodyn_cli.commands import SCENE_COMMANDS
from robodyn_cli.expr.statements import Expectation
from robodyn_cli.integration_methods import FIXED_STEP
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.record import record
from robodyn_cli.scene.checks.check import EXTREMES, Check, key_place
from robodyn_cli.scene.checks.robot import check_joints, check_robot, column_units, columns, moving
from robodyn_cli.scene.points import joints_between, point_problem
from robodyn_cli.scene.text.nodes import Mapping as MappingNode
from robodyn_cli.scene.text.nodes import Path, find
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
    from robodyn_cli.loops.base import LoopClosure
    from robodyn_cli.summaries.keys import Names


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
    scene = dataclasses.replace(scene, robot=robot)
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
    if scene.search is not None:
        from robodyn_cli.scene.checks.options import check_search

        check_search(scene.search, check)
    named = [key for key, *_ in _named_keys(scene)]
    turning = scene.simulate.fluctuation
    if turning or scene.inverse.shaking or scene.inverse.flywheel or scene.outputs.abscissa:
        from robodyn_cli.scene.checks.options import check_fluctuation

        check_fluctuation(scene, check)
        # a coefficient of fluctuation is that of the extremes of a rate
        named += [f"{EXTREMES}qd.{name}.largest" for name in turning]
    if scene.outputs.extremes or any(key.startswith(EXTREMES) for key in named):
        from robodyn_cli.scene.checks.columns import with_extremes

        scene = with_extremes(scene, places_of(scene), named, check)
    if len(named) > len(turning):
        _check_keys(scene, check)
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
    actuated = scene.actuated
    check_joints(scene, _items(actuated or (), "actuated"), check, at_key=False)
    check.unique(actuated or (), "joint", [path for _, path in _items(actuated or (), "actuated")])
    check_joints(scene, _keys(scene.torques, "torques"), check, at_key=True)
    check_joints(scene, _keys(scene.prescribed, "prescribed"), check, at_key=True)
    for name, torque in scene.torques.items():
        with check:
            _check_torque(scene, name, torque, check)


def _check_torque(scene: Scene, name: str, torque: object, check: Check) -> None:
    joint, dot, coordinate = name.partition(".")
    path: Path = ("torques", joint, *((coordinate,) if dot else ()))
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


def _check_keys(scene: Scene, check: Check) -> None:
    """Refuse keys of summaries that no run has; without a command, those that no command has."""
    from robodyn_cli.summaries.keys import leaf_of

    commands = [name for name in SCENE_COMMANDS if scene.command in (None, name)]
    for key, expected, section in _named_keys(scene):
        number = expected is None or section[0] == "search" or expected.numeric
        leaves = [leaf for name in commands if (leaf := leaf_of(name, key)) is not None]
        if number:
            leaves = [leaf for leaf in leaves if leaf.is_number]
        known = leaves and leaves[0].kind is not Any
        if expected is not None and expected.unit and known:
            units_of = _units_of_names(scene, key)
            with check:
                _check_expected_unit(
                    expected, key_place(check.root, section, key), [x.unit(units_of) for x in leaves], check
                )
        names = key_names(scene, key.startswith(EXTREMES)) if not leaves or leaves[0].names else {}
        if not leaves or (names and not any(leaf.fits(names) for leaf in leaves)):
            from robodyn_cli.summaries.keys import refusal

            with check:
                message = refusal(commands[0], key, names, number)
                check.fail(
                    key_place(check.root, section, key),
                    message,
                    at_key=isinstance(find(check.root, section), MappingNode),
                )


def _named_keys(scene: Scene) -> Iterator[tuple[str, Expectation | None, Path]]:
    """Yield the keys of summaries that a scene names: each with what is expected of it, and the section."""
    yield from ((key, expected, ("expect",)) for key, expected in scene.expect.items())
    yield from ((key, None, ("study", "of")) for key in scene.study.of)
    search = scene.search
    if search is not None:
        yield from ((key, None, ("search", "minimise")) for key in (search.minimise,) if key)
        yield from ((key, None, ("search", "maximise")) for key in (search.maximise,) if key)
        yield from ((key, expected, ("search", "reach")) for key, expected in (search.reach or {}).items())
        yield from ((key, expected, ("search", "keep")) for key, expected in (search.keep or {}).items())


def _check_expected_unit(expected: Expectation, place: Path, allowed: Sequence[str], check: Check) -> None:
    """Refuse bounds of another kind than the value of a summary that they are for; allowed : its units."""
    from robodyn_cli.expr import units

    given = units.of(expected.unit)
    assert given is not None
    faults = [
        units.fault(given.dims, "rad" if unit == "deg" else unit, expected.text)
        for unit in allowed
        if any(map(units.of, units.forms(unit)))
    ]
    if faults and all(faults):
        check.fail(place, f"{expected.text!r} does not fit: {faults[0]}")


def _units_of_names(scene: Scene, key: str) -> dict[str, str]:
    """Return the units of what the names in a key of a summary name, as far as they are known."""
    if key.startswith(EXTREMES):
        from robodyn_cli.scene.checks.columns import units_of_columns

        return units_of_columns(scene, places_of(scene))
    return column_units(scene.robot, velocities=True) | column_units(scene.robot)


def key_names(scene: Scene, of_columns: bool = True) -> Names:
    """Return the names that keys of summaries of a scene may have in them, by kind; ``of_columns`` : those too."""
    rates = columns(scene.robot, velocities=True)
    joints = (joint.name for joint in scene.robot.joints)
    named: dict[str, tuple[str, ...]] = {}
    if of_columns:
        from robodyn_cli.scene.checks.columns import column_names

        named["COLUMN"] = column_names(scene, places_of(scene))
    return {
        **named,
        "JOINT": tuple(dict.fromkeys((*columns(scene.robot), *rates, *joints))),
        "LOOP": (*(x.name for x in (*scene.loops, *scene.couplers)), "latch"),
        "LIMIT": tuple(f"{name} {limit}" for name in rates for limit in ("speed", "acceleration", "effort")),
        "PAYLOAD": tuple(payload.name for payload in scene.payloads),
        "LATCH": tuple(latch.name for latch in scene.deploy.latches),
        "PAIR": () if scene.kinematics.design is None else tuple(scene.kinematics.design.ratios),
        "POINT": places_of(scene),
        "ROW": _row_names(scene),
    }


def places_of(scene: Scene) -> tuple[str, ...]:
    """Return the points of which a run tells where they are."""
    led = () if scene.trajectory is None else scene.trajectory.places
    return (*scene.robot.points, *led, *scene.kinematics.places)


def _row_names(scene: Scene) -> tuple[str, ...]:
    """Return the names that rows of closures, couplers and prescribed joints may have; in the plane some vanish."""
    closures = list(scene.loops)
    if scene.deploy.latch is not None:
        from robodyn_cli.loops.pairs import FixedLoop

        closures.append(FixedLoop(name="latch", type="fixed", between=("", "")))
    rows = _rows_of(closures) if closures else ()
    moved = {name.partition(".")[0] for name in scene.prescribed}
    prescribed = (
        f"prescribed.{name}{axis}" for name in moved for axis in ("", ".x", ".y", ".z", ".wx", ".wy", ".wz")
    )
    return (*rows, *(f"{coupler.name}.coupling" for coupler in scene.couplers), *prescribed)


def _rows_of(closures: Sequence[LoopClosure]) -> tuple[str, ...]:
    """Return the names of the rows of closures, as they are between any two frames."""
    from robodyn_cli.loops.base import LoopFrame
    from robodyn_cli.spatial.algebra import identity, zeros

    none = zeros(3)
    ends = [
        LoopFrame(p, identity(), zeros(3, 1), zeros(3, 1), none, none, none, [0.0])
        for p in (none, none + 1.0)
    ]
    return tuple(row.name for loop in closures for row in loop.rows(*ends))
