"""Torques of the elements in the joints: springs, dampers, friction, stops."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.equations.contact_joints import ContactJoint
from robodyn_cli.equations.gears import depends_on_load
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.model.model import Body, JointForce, Model
from robodyn_cli.spatial.algebra import Values, Vector, zeros


class JointForces:
    """What the elements in the joints of a model do at q, v; ``contacts`` : the joints with a contact state."""

    def __init__(self, model: Model, q: Values, v: Values, contacts: Sequence[ContactJoint]) -> None:
        self.model, self.q, self.v = model, q, v
        self.sliding = {id(joint.friction): joint for joint in contacts if joint.friction is not None}

    def torque(self, body: Body, force: JointForce, smooth: bool) -> Scalar:
        """Return one element's torque; ``smooth`` as a simulation has it, else with the exact sign of the rate."""
        rate, gear = self.v[body.v], body.gear_ratio
        torque: Scalar
        if smooth and (joint := self.sliding.get(id(force.element))) is not None:
            torque = force.element.slip_torque(rate, gear, joint.direction)
            return torque
        try:
            torque = force.element.torque(self.q[body.q], rate, gear, smooth)
        except CapabilityError as error:
            raise CapabilityError(f"joint {body.joint_name}: {error.message}") from error
        return torque

    def terms(self, smooth: bool) -> dict[str, Vector]:
        """Return the torques (nv,) by term: ``passive`` (springs, dampers), ``friction``, ``stops``."""
        terms: dict[str, Vector] = {}
        for body in self.model.bodies:
            for force in body.forces:
                if depends_on_load(force):  # see ``gears``
                    continue
                term = terms.setdefault(force.element.term, zeros(self.model.nv))
                term[body.v] = term[body.v] + self.torque(body, force, smooth)
        return terms

    def losses(self, smooth: bool) -> list[tuple[int, Scalar]]:
        """Return the torques that are not the gradient of a potential, with their velocity index."""
        found: list[tuple[int, Scalar]] = []
        for body in self.model.bodies:
            for force in body.forces:
                if depends_on_load(force):
                    continue
                if force.element.dissipative:
                    found.append((body.v, self.torque(body, force, smooth)))
                elif hasattr(force.element, "loss"):
                    loss = force.element.loss(self.q[body.q], self.v[body.v], body.gear_ratio, smooth)
                    found.append((body.v, loss))
        return found

    def switches(self) -> list[tuple[str, Expr]]:
        """Return the expressions that change sign where an element engages or releases, with the key of the
        element."""
        found: list[tuple[str, Expr]] = []
        for body in self.model.bodies:
            for force in body.forces:
                if hasattr(force.element, "switches"):
                    entries = force.element.switches(self.q[body.q], self.v[body.v])
                    found += [(f"{body.joint_name}.{force.kind}", switch) for switch in entries]
        return found
