"""Losses of gears. They depend on the load: the torque that the joint needs (inverse), or that the actuator gives
(forward)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar, is_nonzero
from robodyn_cli.model.model import Body, JointForce, Model
from robodyn_cli.spatial.algebra import Array, Values, Vector


def depends_on_load(force: JointForce) -> bool:
    """Tell whether a force follows from the load on the joint, as losses of a gear do, and not from q and v alone."""
    return bool(force.element.of_load)


def geared(model: Model) -> list[tuple[Body, JointForce]]:
    """Return the gears with losses, each with the body whose joint it drives."""
    return [(b, f) for b in model.bodies for f in b.forces if depends_on_load(f)]


def _on_motor(body: Body, v: int) -> bool:
    """Tell whether the friction of a coordinate acts on the motor's side of the gear."""
    return any(f.element.side == "motor" for f in body.forces if f.v == v)


def losses_of_load(
    model: Model,
    needed: Values,
    a: Values,
    v: Values,
    terms: Mapping[str, Vector],
    elements: Mapping[str, Vector],
) -> dict[int, Scalar]:
    """Return the torques of the losses by velocity index, from the torques that the joints need.

    The gear transmits the torque of the rigid bodies less passive and external torques and joint friction. The rotor's
    inertia, and friction on the motor's side, do not go through it.

    Parameters
    ----------
    needed : M a + C v + G (nv,), rotors included. terms, elements : torques of everything else on the joints: of what
    is in them, and of forces on bodies.
    """
    losses = {}
    others = [*terms.items(), *((f"forces {name}", x) for name, x in elements.items())]
    for body, gear in geared(model):
        k = gear.v
        load: Any = needed[k] - body.rotors[k - body.v] * a[k]
        for name, term in others:
            if not (name == "friction" and _on_motor(body, k)):
                load = load - term[k]
        losses[k] = gear.element.torque_of_load(load, v[k])
    return losses


def losses_along(model: Model, tau: Array, friction: Array, a: Array, v: Array) -> Array:
    """Return the torques of the losses (T, nv) of gears in a mechanism with loops, along a motion.

    The joint gets L = tau - N^2 J v-dot + tau_friction where friction is on the motor's side, else tau - N^2 J v-dot.

    Parameters
    ----------
    tau : (T, nv) of the actuators if gears had no losses. friction : torque in the joints. a, v : (T, nv).
    """
    lost = np.zeros_like(tau)
    for body, gear in geared(model):
        k = gear.v
        load = tau[:, k] - float(body.rotors[k - body.v]) * a[:, k]
        if _on_motor(body, k):
            load = load + friction[:, k]
        lost[:, k] = gear.element.torque_of_load(load, v[:, k])
    return lost


def losses_of_drive(
    model: Model, drive: Values, v: Values, terms: Mapping[str, Vector], prescribed: Mapping[str, Any]
) -> dict[int, Scalar]:
    """Return the torques of the losses by velocity index, from the torques that the actuators give.

    Raises
    ------
    CapabilityError : the rotor has inertia, or the motion is prescribed: the torque through the gear then depends on
    the accelerations.
    """
    losses = {}
    for body, gear in geared(model):
        k = gear.v
        if is_nonzero(body.rotors[k - body.v]) or gear.name in prescribed:
            cause = "rotor_inertia" if gear.name not in prescribed else "prescribed motion"
            raise CapabilityError(
                f"joint {gear.name}: gear losses together with {cause} are done by `inverse` only; allowed in "
                "simulations: gear losses without rotor inertia, of joints driven by torques",
                joint=gear.name,
            )
        torque: Any = drive[k]
        if "friction" in terms and _on_motor(body, k):
            torque = torque + terms["friction"][k]
        try:
            losses[k] = gear.element.torque_of_drive(torque, v[k])
        except CapabilityError as error:
            raise CapabilityError(f"joint {gear.name}: {error.message}", joint=gear.name) from error
    return losses
