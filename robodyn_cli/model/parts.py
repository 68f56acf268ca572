"""What is added to the bodies of a model: drives, and masses that links pick up and release."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.expr.graph import Graph, is_nonzero
from robodyn_cli.model.model import BASE, PARAMETER_GROUP, FixedFrame, Model, RigidPart
from robodyn_cli.motors.drive import NOWHERE, Train
from robodyn_cli.record import record
from robodyn_cli.scene import nested_options as sp
from robodyn_cli.scene import types as sc
from robodyn_cli.scene.types import Joint, Scene
from robodyn_cli.spatial.algebra import Array, Transform, vector, zeros


def trains(scene: Scene) -> dict[str, Train]:
    """Return the drives of a scene with their parts, by joint."""
    return {name: Train.of(drive, scene.catalogue) for name, drive in scene.drives.items()}


def add_drives(scene: Scene, placed: Mapping[str, Any], moving: list[Any]) -> None:
    """Give the joints of moving bodies the ratios and rotors of their drives, and bodies the masses that they carry.

    placed : where each link is. moving : the bodies, which are changed.
    """
    by_joint = trains(scene)
    for joint in scene.robot.joints:
        if (train := by_joint.get(joint.name)) is None:
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


SAME_TIME = 1e-13  # part by which a sample may be off the time of a change, by rounding, to be that of before


@record
class CarriedMass:
    """A mass that a body picks up and releases.

    spec : its keys in the scene. body : what carries it. part : mass, centre of mass and inertia, None for nothing.
    place : of the parameter p that says whether it is carried, None for one that does not change.
    """

    name: str
    spec: Any
    body: int
    part: RigidPart | None
    place: int | None = None


def changing(model: Model) -> tuple[CarriedMass, ...]:
    """Return the payloads that parameters p switch, in their order."""
    return tuple(payload for payload in model.payloads if payload.place is not None)


def carried_at_start(model: Model) -> list[float]:
    """Return the parameters p of a state before anything is gripped or released."""
    return [float(payload.spec.start is None) for payload in changing(model)]


def as_link(payload: sp.Payload) -> sc.Link:
    """Return the link that a payload is for the body that carries it; data that are not given are unknown there too."""
    return sc.Link(name=payload.name, mass=payload.mass, com=payload.com, inertia=payload.inertia)


def placed(payload: sp.Payload, frame: FixedFrame, part: RigidPart | None, place: int | None) -> CarriedMass:
    """Return a payload held at ``frame``, in whose axes the ``part`` is given; ``place`` of its parameter, if any."""
    if part is not None:
        part = dataclasses.replace(part, frame=Transform.from_pose(frame.R, frame.p))
    return CarriedMass(payload.name, payload, frame.body, part, place)


def carried_part(payload: CarriedMass, graph: Graph) -> RigidPart | None:
    """Return what a payload adds to its body; None for nothing."""
    part = payload.part
    if part is None or payload.place is None:
        return None if payload.spec.start is not None else part
    s = graph.symbol(f"payloads.{payload.name}", PARAMETER_GROUP, payload.place)
    return RigidPart(s * part.m, part.c, s * part.I_com, part.frame)


def carried_at(payloads: Sequence[CarriedMass], times: Array) -> Array:
    """Return the parameters (T, n) of payloads with known times, at times (T,): at a change those of before."""
    columns = [np.ones(len(times)) for _ in payloads]
    for column, payload in zip(columns, payloads):
        if payload.spec.start is not None:
            column[times <= (1.0 + SAME_TIME) * payload.spec.start.time] = 0.0
        if payload.spec.until is not None:
            column[times > (1.0 + SAME_TIME) * payload.spec.until.time] = 0.0
    return np.array(columns).T.reshape(len(times), -1)
