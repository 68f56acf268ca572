"""Joints with a contact state: held (stuck by friction, or on a rigid stop) or free to move.

Contact states are parameters p of the equations, which events change: the constraint v-dot = 0 of each such joint is
part of the equations and is switched on and off by its parameter, so one compiled program serves all combinations.

    hold = 1:  v-dot = 0, with a multiplier lambda that must stay within [low, high]
    hold = 0:  lambda = 0, and Coulomb friction acts against ``direction``; or, in a joint that stands still because
               others are held, the torque ``carried``
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

from robodyn_cli.expr.graph import Expr
from robodyn_cli.model.model import PARAMETER_GROUP, Body, JointForce, Model
from robodyn_cli.record import record

if TYPE_CHECKING:
    from robodyn_cli.forces.friction import Friction
    from robodyn_cli.forces.limits import Limits

FIELDS = ("hold", "direction", "low", "high", "carried")
UNBOUNDED = 1e300  # a bound beyond every multiplier


@record
class ContactJoint:
    """A joint with a contact state, or a coordinate of one.

    q, v : its places. hold, direction, low, high, carried : parameters p from
    ``place`` on.
    """

    name: str
    q: int
    v: int
    place: int
    hold: Expr
    direction: Expr
    low: Expr
    high: Expr
    carried: Expr
    gear_ratio: float = 1.0
    friction: Friction | None = None
    limits: Limits | None = None

    @property
    def end(self) -> int:
        """The place behind its last parameter."""
        return self.place + len(FIELDS)

    @property
    def breakaway(self) -> tuple[float, float]:
        """Largest friction torques at rest against motion forwards and backwards, both >= 0."""
        return (0.0, 0.0) if self.friction is None else self.friction.breakaway(self.gear_ratio)

    @property
    def restitution(self) -> float:
        assert self.limits is not None and self.limits.stop is not None
        assert self.limits.stop.restitution is not None
        return self.limits.stop.restitution

    @property
    def stops(self) -> list[tuple[float, float]]:
        """Rigid stops as (direction of the push, position)."""
        if self.limits is None:
            return []
        sides = ((1.0, self.limits.lower), (-1.0, self.limits.upper))
        return [(push, at) for push, at in sides if at is not None]


def contact_joints(model: Model) -> tuple[ContactJoint, ...]:
    """Return the joints with a contact state, in the order of the tree; their parameters follow the model's own."""
    joints: list[ContactJoint] = []
    for forces in (forces for body in model.bodies if body.forces for forces in _by_coordinate(body)):
        friction, limits = _contacts(forces)
        if friction is None and limits is None:
            continue
        first = forces[0]
        place = len(model.parameters) + len(FIELDS) * len(joints)
        hold, direction, low, high, carried = (
            model.graph.symbol(f"{first.name}.{name}", PARAMETER_GROUP, place + k)
            for k, name in enumerate(FIELDS)
        )
        joints.append(
            ContactJoint(
                first.name, first.q, first.v, place, hold, direction, low, high, carried,
                first.gear_ratio, friction, limits,
            )
        )  # fmt: skip
    return tuple(joints)


def is_contact(force: JointForce) -> bool:
    """Tell whether a force in a joint has a contact state: friction that sticks, or rigid stops."""
    return bool(force.element.set_valued or force.element.rigid)


def without_contacts(model: Model, places: Collection[int]) -> Model:
    """Return the model without sticking friction and rigid stops in velocity coordinates."""
    bodies = (
        dataclasses.replace(
            body, forces=tuple(f for f in body.forces if f.v not in places or not is_contact(f))
        )
        for body in model.bodies
    )
    return dataclasses.replace(model, bodies=tuple(bodies)) if places else model


def _by_coordinate(body: Body) -> list[list[JointForce]]:
    """Return the forces in a joint by the coordinate that they act on."""
    forces: dict[str, list[JointForce]] = {}
    for force in body.forces:
        forces.setdefault(force.name, []).append(force)
    return list(forces.values())


def _contacts(forces: Sequence[JointForce]) -> tuple[Friction | None, Limits | None]:
    """Return the set-valued friction and the rigid stops of a coordinate."""
    friction = limits = None
    for force in forces:
        if force.element.set_valued:
            friction = force.element
        if force.element.rigid:
            limits = force.element
    return friction, limits


def moving_freely(held: Sequence[Any], carried: Sequence[float] = ()) -> tuple[float, ...]:
    """Return the parameters p with which every joint moves freely, without Coulomb friction; () for no joints.

    held : joints with a contact state, and latches, which are open. carried : parameters of payloads, which come first.
    """
    return (*carried, *(0.0,) * (held[-1].end - len(carried) if held else 0))
