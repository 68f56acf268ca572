"""Losses of gears. They depend on the load: the torque that the joint needs (inverse), or that the actuator gives
(forward)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar, is_nonzero
from robodyn_cli.model.model import Body, JointForce, Model
from robodyn_cli.spatial.algebra import Values, Vector

if TYPE_CHECKING:
    from robodyn_cli.forces.gear import Gear


def depends_on_load(force: JointForce) -> bool:
    """Tell whether a force follows from the load on the joint, as losses of a gear do, and not from q and v alone."""
    return hasattr(force.element, "torque_of_load")


def geared(model: Model) -> list[tuple[Body, Gear]]:
    """Return the bodies whose joints have gears with losses."""
    return [(b, f.element) for b in model.bodies for f in b.forces if depends_on_load(f)]


def _on_motor(body: Body) -> bool:
    """Tell whether the joint's friction acts on the motor's side of the gear."""
    return any(getattr(f.element, "side", "joint") == "motor" for f in body.forces)


def losses_of_load(
    model: Model, needed: Values, a: Values, v: Values, terms: Mapping[str, Vector]
) -> dict[int, Scalar]:
    """Return the torques of the losses by velocity index, from the torques that the joints need.

    The gear transmits the torque of the rigid bodies less passive and external torques and joint friction. The rotor's
    inertia, and friction on the motor's side, do not go through it.

    Parameters
    ----------
    needed : M a + C v + G (nv,), rotors included. terms : torques of everything else on the joints.
    """
    found = {}
    for body, gear in geared(model):
        k = body.v
        load: Any = needed[k] - body.armature * a[k]
        for name, term in terms.items():
            if not (name == "friction" and _on_motor(body)):
                load = load - term[k]
        found[k] = gear.torque_of_load(load, v[k])
    return found


def losses_of_drive(
    model: Model, drive: Values, v: Values, terms: Mapping[str, Vector], prescribed: Mapping[str, Any]
) -> dict[int, Scalar]:
    """Return the torques of the losses by velocity index, from the torques that the actuators give.

    Raises
    ------
    CapabilityError : the rotor has inertia, or the motion is prescribed: the torque through the gear then depends on
    the accelerations.
    """
    found = {}
    for body, gear in geared(model):
        k = body.v
        if is_nonzero(body.armature) or body.joint_name in prescribed:
            what = "rotor_inertia" if body.joint_name not in prescribed else "prescribed motion"
            raise CapabilityError(
                f"joint {body.joint_name}: gear losses together with {what} are done by `inverse` only; allowed in "
                "simulations: gear losses without rotor inertia, of joints driven by torques"
            )
        torque: Any = drive[k]
        if "friction" in terms and _on_motor(body):
            torque = torque + terms["friction"][k]
        try:
            found[k] = gear.torque_of_drive(torque, v[k])
        except CapabilityError as error:
            raise CapabilityError(f"joint {body.joint_name}: {error.message}") from error
    return found
