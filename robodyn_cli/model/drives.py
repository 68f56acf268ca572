"""What drives add to a model: inertia of rotors and gears behind a ratio, and masses on the links that carry them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from robodyn_cli.expr.graph import is_nonzero
from robodyn_cli.model.model import BASE, RigidPart
from robodyn_cli.motors.drive import NOWHERE, Train
from robodyn_cli.scene.types import Joint, Scene
from robodyn_cli.spatial.algebra import Transform, vector, zeros


def trains(scene: Scene) -> dict[str, Train]:
    """Return the drives of a scene with their parts, by joint."""
    return {name: Train.of(drive, scene.catalogue) for name, drive in scene.drives.items()}


def add_drives(scene: Scene, placed: Mapping[str, Any], moving: list[Any]) -> None:
    """Give the joints of moving bodies the ratios and rotors of their drives, and bodies the masses that they carry.

    placed : where each link is. moving : the bodies, which are changed.
    """
    found = trains(scene)
    for joint in scene.robot.joints:
        if (train := found.get(joint.name)) is None:
            continue
        own = moving[placed[str(joint.link)].body]
        own.joint = _driven(joint, train)
        link = train.drive.mass_on or str(joint.parent)
        if link == NOWHERE or not is_nonzero(train.mass) or placed[link].body == BASE:
            continue
        where = placed[link]
        at = zeros(3) if train.drive.mass_at is None else vector(train.drive.mass_at)
        frame: Transform = where.link_frame
        if train.drive.mass_at is None:
            frame = where.joint_frame if link == joint.link else own.X_tree
        moving[where.body].parts += (RigidPart(train.mass, at, zeros(3, 3), frame),)


def _driven(joint: Joint, train: Train) -> Joint:
    """Return a joint with ratio and rotor of its drive."""
    inertia = train.inertia if train.drive.count == 1 else float(train.drive.count) * train.inertia
    return dataclasses.replace(joint, gear_ratio=train.turns, rotor_inertia=inertia)
