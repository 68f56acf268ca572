"""What drives add to a model: inertia of rotors and gears behind a ratio, and masses on the links that carry them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

from robodyn_cli.expr.graph import is_nonzero
from robodyn_cli.model.model import RigidPart
from robodyn_cli.motors.drive import NOWHERE, Train
from robodyn_cli.record import record
from robodyn_cli.scene.types import Joint, Robot, Scene
from robodyn_cli.spatial.algebra import matrix, vector, zeros


def trains(scene: Scene) -> dict[str, Train]:
    """Return the drives of a scene with their parts, by joint."""
    return {name: Train.of(drive, scene.catalogue) for name, drive in scene.drives.items()}


def driven(joint: Joint, train: Train) -> Joint:
    """Return a joint with ratio and rotor of its drive."""
    inertia = train.inertia if train.drive.count == 1 else float(train.drive.count) * train.inertia
    return dataclasses.replace(joint, gear_ratio=train.turns, rotor_inertia=inertia)


def with_drives(scene: Scene) -> Robot:
    """Return the robot whose joints have the ratios and rotors of their drives."""
    found = trains(scene)
    joints = tuple(driven(j, found[j.name]) if j.name in found else j for j in scene.robot.joints)
    return dataclasses.replace(scene.robot, joints=joints)


@record
class Load:
    """The mass of a drive on a link: at ``at`` in the link's frame, None for the place of the joint ``joint``."""

    link: str
    joint: str
    mass: float
    at: tuple[float, ...] | None

    def part(self, frame: object) -> RigidPart:
        """Return it as a part of a body, in a frame from body coordinates."""
        place = zeros(3) if self.at is None else vector(self.at)
        return RigidPart(self.mass, place, matrix([[0.0] * 3] * 3), frame)  # type: ignore[arg-type]


def loads(scene: Scene) -> Iterator[Load]:
    """Yield the masses of drives that are not in the links' own."""
    joints: Mapping[str, Joint] = {joint.name: joint for joint in scene.robot.joints}
    for name, train in trains(scene).items():
        on = train.drive.mass_on or joints[name].parent
        if on != NOWHERE and is_nonzero(train.mass):
            yield Load(str(on), name, train.mass, train.drive.mass_at)
