"""Checks of what drives joints: drives, whose parts exist and fit, and controllers with recorded signals."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

from robodyn_cli.control.base import Follower
from robodyn_cli.expr.formula import formulas_in
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.motors.drive import NOWHERE, Drive, Train
from robodyn_cli.motors.electric import Electric
from robodyn_cli.record import record
from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.checks.robot import columns
from robodyn_cli.scene.points import BASE
from robodyn_cli.scene.text.nodes import Path, dotted
from robodyn_cli.scene.types import Joint, Scene
from robodyn_cli.trajectories.base import SceneNames
from robodyn_cli.trajectories.led import velocity_columns

GROUPS = (("motor", "motors"), ("gear", "gears"), ("brake", "brakes"))
OWN = ("gear_ratio", "rotor_inertia", "gear")


def check_drives(scene: Scene, check: Check) -> None:
    """Report everything that is wrong with the catalogue and with the drives."""
    before = len(check.found)
    for _, group in GROUPS:
        for name, part in getattr(scene.catalogue, group).items():
            for where, message in part.problems():
                with check:
                    check.fail(("catalogue", group, name, *where), message)
    if len(check.found) > before:
        return
    joints = {joint.name: k for k, joint in enumerate(scene.robot.joints)}
    for name, drive in scene.drives.items():
        with check:
            check.known(name, joints, "joint", ("drives", name), at_key=True)
            _Checked(scene, check, name, drive, joints[name]).run()


@record
class _Checked:
    """A drive and the joint with a number of the robot that it drives."""

    scene: Scene
    check: Check
    name: str
    drive: Drive
    number: int

    @property
    def joint(self) -> Joint:
        return self.scene.robot.joints[self.number]

    @property
    def path(self) -> Path:
        return ("drives", self.name)

    def run(self) -> None:
        """Report all that is wrong with the drive, but for what follows from something else."""
        check = self.check
        with check:
            self.joint_is_driven()
            with check:
                self.joint_is_silent()
            known = [self.is_known(key, group) for key, group in GROUPS]
            if all(known):
                with check:
                    self.parts_fit(Train.of(self.drive, self.scene.catalogue))
            with check:
                self.mass_fits()

    def is_known(self, key: str, group: str) -> bool:
        """Tell whether the catalogue has the part that a key names, and report it where not."""
        name, parts = getattr(self.drive, key), getattr(self.scene.catalogue, group)
        with self.check:
            if name is not None:
                self.check.known(name, parts, key, (*self.path, key))
        return name is None or name in parts

    def joint_is_driven(self) -> None:
        """The joint has one coordinate and an actuator."""
        joint, check = self.joint, self.check
        if joint_types[joint.type].nv != 1:
            single = [j.name for j in self.scene.robot.joints if joint_types[j.type].nv == 1]
            message = f"joint {joint.name!r} is {joint.type}; allowed: joints with one coordinate, {', '.join(single)}"
            check.fail(self.path, message, at_key=True)
        actuated = self.scene.actuated
        if actuated is not None and joint.name not in actuated:
            message = f"joint {joint.name!r} is not in 'actuated'; allowed: {', '.join(actuated) or 'none'}"
            check.fail(self.path, message, at_key=True)

    def joint_is_silent(self) -> None:
        """The joint says nothing of its drive itself."""
        place: Path = ("robot", "joints", self.number)
        twice: list[Path] = [(key,) for key in OWN if self.check.has((*place, key))]
        friction = dict(self.joint.forces).get("friction")
        if friction is not None and friction.side == "motor":
            twice.append(("friction", "side"))
        if twice:
            keys = " and ".join(repr(dotted(key)) for key in twice)
            says, them = ("says", "it") if len(twice) == 1 else ("say", "them")
            of_motor = (
                " (friction of the motor belongs to the catalogue)" if ("friction", "side") in twice else ""
            )
            message = (
                f"joint {self.name!r}: {keys} {says} what its drive says too{of_motor}; leave out {them} or "
                f"'drives.{self.name}'"
            )
            self.check.fail((*place, *twice[0]), message, at_key=True)

    def parts_fit(self, train: Train) -> None:
        """The gear makes the motion of the joint, and the motor runs on its supply."""
        drive, check = self.drive, self.check
        unit = joint_types[self.joint.type].v_units[0]
        drives = "rad" if train.gear is None else train.gear.drives
        if drives != unit:
            gears = self.scene.catalogue.gears
            fitting = ", ".join(n for n, g in gears.items() if g.drives == unit) or "none of the catalogue"
            message = (
                "needs a gear that moves a slide" if unit == "m" else "turns, and this gear moves a slide"
            )
            message = f"joint {self.joint.name!r} {message}; allowed: {fitting}"
            check.fail((*self.path, *(() if drive.gear is None else ("gear",))), message)
        motor = train.motor
        if not isinstance(motor, Electric):
            if drive.voltage is not None:
                message = f"does nothing: motor {drive.motor!r} is described by its curves at one voltage"
                check.fail((*self.path, "voltage"), message, at_key=True)
            if motor.thermal is not None and not drive.ambient < motor.thermal.max_temperature:
                check.fail(
                    (*self.path, "ambient"), f"at {drive.ambient:g} degC its winding is too hot already"
                )
            return
        problem = motor.supply_problem(train.supply)
        if problem is not None:
            key = "ambient" if check.has((*self.path, "ambient")) else "voltage"
            check.fail((*self.path, key), f"motor {drive.motor!r} cannot run on this: {problem}")

    def mass_fits(self) -> None:
        """The mass of the drive is somewhere."""
        drive, check, joint = self.drive, self.check, self.joint
        links = [BASE, *(link.name for link in self.scene.robot.links)]
        if drive.mass_on is not None and drive.mass_on != NOWHERE:
            check.known(drive.mass_on, [*links, NOWHERE], "link", (*self.path, "mass_on"))
        if drive.mass_on == NOWHERE:
            for key in ("mass", "mass_at"):
                if check.has((*self.path, key)):
                    check.fail((*self.path, key), "does nothing with 'mass_on: none'", at_key=True)
        beside = (None, NOWHERE, BASE, joint.parent, joint.link)
        if drive.mass_on not in beside and drive.mass_at is None:
            message = (
                f"joint {joint.name!r} is not on link {drive.mass_on!r}; allowed: with 'mass_at' beside it"
            )
            check.fail((*self.path, "mass_on"), message)


KNOWN_TO_CONTROL = ("ref", "refd", "refdd", "s")
SAMPLED = ("delay", "rate_limit", "sensors")  # keys that only a sampled controller has


def check_control(scene: Scene, names: SceneNames, check: Check) -> Scene:
    """Return the scene with the controller's joints filled in, and its reference completed."""
    controller = scene.control
    if controller is None:
        _check_signals(scene, (), check)
        return scene
    with check:
        if scene.simulate.singular == "pass":
            check.fail(
                ("simulate", "singular"),
                "'pass' leaps over poses without a controller; allowed beside 'control': stop",
            )
    before = len(check.found)
    joints = _driven(scene, names, check)
    if len(check.found) > before:
        return scene  # what follows is about these joints
    _check_times(scene, check)
    for path, message in controller.problems():
        with check:
            check.fail(("control", *path), message)
    _check_maps(scene, joints, check)
    _check_signals(scene, joints, check)
    checked = dataclasses.replace(controller, joints=joints)
    if isinstance(checked, Follower):
        checked = dataclasses.replace(checked, reference=_reference(scene, names, joints, check))
    return dataclasses.replace(scene, control=checked)


def _driven(scene: Scene, names: SceneNames, check: Check) -> tuple[str, ...]:
    """Return the joints that the controller drives."""
    controller = scene.control
    single = columns(scene.robot, quasi=False)
    prescribed = velocity_columns(scene.prescribed)
    free = [name for name in single if name not in prescribed and "." not in name]
    law = tuple(controller.law)
    given = controller.joints
    path: Path = ("control", "joints") if given is not None else ("control", "law")
    if given is None:
        own = law or (scene.actuated if scene.actuated is not None else tuple(free))
        given = tuple(name for name in own if law or name in free)
    check.unique(given, "joint", [(*path, k) for k in range(len(given))])
    for k, name in enumerate(given):
        with check:
            at: Path = (*path, k) if path[-1] == "joints" else (*path, name)
            if name in prescribed:
                check.fail(at, f"the motion of {name!r} is prescribed, so its torque is a result")
            check.known(name, free, "joint with one coordinate", at)
    with check:
        if not given:
            check.fail(("control",), "there is no joint of one coordinate that it could drive")
        if law and set(law) != set(given):
            check.fail(("control", "joints"), f"and 'law' differ; allowed: {', '.join(law)}")
    _refuse_unactuated(scene, given, path, check)
    with check:
        left = [name for name in columns(scene.robot, velocities=True) if name not in given]
        if controller.whole and left and not names.closed:
            check.fail(
                ("control", "joints") if controller.joints else ("control", "type"),
                f"{controller.type!r} drives every joint; {left[0]!r} is left out",
            )
    return given


def _refuse_unactuated(scene: Scene, joints: tuple[str, ...], path: Path, check: Check) -> None:
    known = columns(scene.robot, velocities=True)  # of others it is told that they are no joints
    for name in joints if scene.actuated is not None else ():
        with check:
            if name in known and name not in (scene.actuated or ()):
                check.fail(
                    path, f"joint {name!r} is not in 'actuated'; allowed: {', '.join(scene.actuated or ())}"
                )


def _check_times(scene: Scene, check: Check) -> None:
    controller, duration = scene.control, scene.simulate.duration
    if controller.period is None:
        for name in SAMPLED:
            with check:
                if check.has(("control", name)) and getattr(controller, name) != 0.0:
                    check.fail(
                        ("control", name), "goes with 'period': only a sampled controller has it", at_key=True
                    )
        return
    with check:
        if controller.period > duration:
            check.fail(
                ("control", "period"),
                f"is longer than the run (value {controller.period:g} s); allowed: up to simulate.duration, "
                f"{duration:g} s",
            )
    with check:
        if controller.delay > duration:
            check.fail(
                ("control", "delay"),
                f"is longer than the run (value {controller.delay:g} s); allowed: up to {duration:g} s",
            )


def _check_maps(scene: Scene, joints: tuple[str, ...], check: Check) -> None:
    """Maps by joint name joints that are driven, and all of them; a pose, and weights of positions and rates, any."""
    controller = scene.control
    single = columns(scene.robot, quasi=False)
    for path, value in _maps(controller):
        any_joint = path == ("pose",) or (
            controller.type == "lqr" and path in (("gains", "q"), ("gains", "qd"))
        )
        names, label = (single, "joint") if any_joint else (joints, "joint of this controller")
        for name in value:
            with check:
                check.known(name, names, label, ("control", *path, name), at_key=True)
        known = all(name in names for name in value)
        missing = [name for name in joints if known and name not in value]
        partial = any_joint or path[0] in ("limit", "rate_limit", "sensors") or path[-1] == "anti_windup"
        with check:
            if missing and not partial:
                check.fail(
                    ("control", *path), f"joint {missing[0]!r} is missing; needed here: {', '.join(joints)}"
                )


def _maps(controller: Any) -> Iterator[tuple[Path, dict[str, Any]]]:
    for name in ("limit", "rate_limit", "gains", "sensors", "pose"):
        value = getattr(controller, name, None)
        if isinstance(value, dict):
            yield (name,), value
        elif dataclasses.is_dataclass(value):
            for field in dataclasses.fields(value):
                own = getattr(value, field.name)
                if isinstance(own, dict):
                    yield (name, field.name), own


def _reference(scene: Scene, names: SceneNames, joints: tuple[str, ...], check: Check) -> Any:
    """Return the motion to follow: the controller's own, completed, or that of the scene.

    Where loops close the mechanism, other joints than the driven ones may lead it.
    """
    own = scene.control.reference
    if own is None:
        _check_pose(scene, joints, check)
        _check_led(scene.trajectory, ("trajectory",), names, joints, check)
        return scene.trajectory
    some = dataclasses.replace(names, some=True)  # type: ignore[type-var]
    for path, message in own.problems(some):
        with check:
            check.fail(("control", "reference", *path), message)
    _check_led(own, ("control", "reference"), names, joints, check)
    return own if check.found else own.completed(some)


def _check_led(motion: Any, path: Path, names: SceneNames, joints: tuple[str, ...], check: Check) -> None:
    known = motion is not None and (motion.joints or not motion.lacks)
    missing = [name for name in joints if known and name not in motion.joints]
    with check:
        if missing and not names.closed:
            check.fail(path, f"does not lead joint {missing[0]!r}, which the controller drives")


def _check_pose(scene: Scene, joints: tuple[str, ...], check: Check) -> None:
    """Without a motion to follow, the pose at the start is held, which must be given."""
    controller = scene.control
    if scene.trajectory is not None or scene.initial.source is not None:
        return
    asks = [name.partition(".")[0] for x in formulas_in(controller) for name in x.names]
    needs = controller.type not in ("formulas", "python") or any(
        group in ("ref", "refd", "refdd") for group in asks
    )
    missing = [name for name in joints if name not in scene.initial.q]
    with check:
        if controller.at_point:
            check.fail(("control",), "follows a path of a point: key 'reference' or 'trajectory' is missing")
        if needs and missing:
            check.fail(
                ("control",),
                f"joint {missing[0]!r} has nothing to follow: neither 'reference' nor 'trajectory' is given, and "
                "'initial.q' lacks it",
            )


def _check_signals(scene: Scene, joints: tuple[str, ...], check: Check) -> None:
    """Formulas ask for the reference of joints that are driven."""
    given: list[tuple[Path, Any]] = [
        (("outputs", "signals", name), signal) for name, signal in scene.outputs.signals.items()
    ]
    if scene.control is not None:
        given += [(("control", "law", name), x) for name, x in scene.control.law.items()]
        given += [(("control", "state", name), x) for name, x in scene.control.state.items()]
    for path, value in given:
        for formula in formulas_in(value):
            for name in formula.names:
                group, _, joint = name.partition(".")
                with check:
                    if group not in KNOWN_TO_CONTROL or name.endswith(")"):
                        continue
                    if scene.control is None:
                        check.fail(path, f"{name!r} is of a controller, and there is none: key 'control'")
                    if group != "s" and joint not in joints:
                        check.fail(
                            path,
                            f"{name!r}: the controller drives no joint {joint!r}; allowed: {', '.join(joints)}",
                        )
