"""Checks of drives: that their parts exist, fit the joints and each other, and that nothing is said twice."""

from __future__ import annotations

from robodyn_cli.joints.registry import joint_types
from robodyn_cli.motors.drive import NOWHERE, Drive, Train
from robodyn_cli.motors.electric import Electric
from robodyn_cli.record import record
from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.points import BASE
from robodyn_cli.scene.text.nodes import Path, dotted
from robodyn_cli.scene.types import Joint, Scene

GROUPS = (("motor", "motors"), ("gear", "gears"), ("brake", "brakes"))
OWN = ("gear_ratio", "rotor_inertia", "gear")


def check_drives(scene: Scene, check: Check) -> None:
    """Report everything that is wrong with the catalogue and with the drives."""
    if scene.catalogue is None:
        return  # its file could not be read
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
            what = f"joint {joint.name!r} is {joint.type}; allowed: joints with one coordinate, {', '.join(single)}"
            check.fail(self.path, what, at_key=True)
        actuated = self.scene.actuated
        if actuated is not None and joint.name not in actuated:
            what = f"joint {joint.name!r} is not in 'actuated'; allowed: {', '.join(actuated) or 'none'}"
            check.fail(self.path, what, at_key=True)

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
            what = (
                f"joint {self.name!r}: {keys} {says} what its drive says too{of_motor}; leave out {them} or "
                f"'drives.{self.name}'"
            )
            self.check.fail((*place, *twice[0]), what, at_key=True)

    def parts_fit(self, train: Train) -> None:
        """The gear makes the motion of the joint, and the motor runs on its supply."""
        drive, check = self.drive, self.check
        unit = joint_types[self.joint.type].v_units[0]
        drives = "rad" if train.gear is None else train.gear.drives
        if drives != unit:
            gears = self.scene.catalogue.gears
            fitting = ", ".join(n for n, g in gears.items() if g.drives == unit) or "none of the catalogue"
            what = "needs a gear that moves a slide" if unit == "m" else "turns, and this gear moves a slide"
            what = f"joint {self.joint.name!r} {what}; allowed: {fitting}"
            check.fail((*self.path, *(() if drive.gear is None else ("gear",))), what)
        motor = train.motor
        if not isinstance(motor, Electric):
            if drive.voltage is not None:
                what = f"does nothing: motor {drive.motor!r} is described by its curves at one voltage"
                check.fail((*self.path, "voltage"), what, at_key=True)
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
            what = f"joint {joint.name!r} is not on link {drive.mass_on!r}; allowed: with 'mass_at' beside it"
            check.fail((*self.path, "mass_on"), what)
