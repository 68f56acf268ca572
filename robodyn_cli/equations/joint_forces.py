"""Torques of the elements in the joints: springs, dampers, friction, stops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.equations.contact_joints import ContactJoint
from robodyn_cli.equations.gears import depends_on_load
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.model.model import JointForce, Model
from robodyn_cli.spatial.algebra import Values, Vector, vector, zeros


class JointForces:
    """What the elements in the joints of a model do at q, v; ``contacts`` : the joints with a contact state."""

    def __init__(self, model: Model, q: Values, v: Values, contacts: Sequence[ContactJoint]) -> None:
        self.model, self.q, self.v = model, q, v
        self.sliding = {id(joint.friction): joint for joint in contacts if joint.friction is not None}

    def torque(self, force: JointForce, smooth: bool) -> Any:
        """Return one element's torque, a vector in space.

        smooth : as a simulation has it, else with the exact sign of the rate.
        """
        rate, gear = self._rate(force), force.gear_ratio
        torque: Any
        if smooth and (joint := self.sliding.get(id(force.element))) is not None:
            torque = force.element.slip_torque(rate, gear, joint.direction)
            return torque
        try:
            torque = force.element.torque(self.q[force.q], rate, gear, smooth)
        except CapabilityError as error:
            raise CapabilityError(f"joint {force.name}: {error.message}", joint=force.name) from error
        return torque

    def _rate(self, force: JointForce) -> Any:
        return vector(self.v[force.v]) if force.in_space else self.v[force.v]

    def terms(self, smooth: bool) -> dict[str, Vector]:
        """Return the torques (nv,) by term: ``passive`` (springs, dampers), ``friction``, ``stops``."""
        terms: dict[str, Vector] = {}
        for body in self.model.bodies:
            for force in body.forces:
                if depends_on_load(force):  # see ``gears``
                    continue
                term = terms.setdefault(force.element.term, zeros(self.model.nv))
                term[force.v] = term[force.v] + self.torque(force, smooth)
        return terms

    def losses(self, smooth: bool) -> list[tuple[int, Scalar]]:
        """Return the torques that are not the gradient of a potential, with their velocity index."""
        found: list[tuple[int, Scalar]] = []
        for body in self.model.bodies:
            for force in body.forces:
                if depends_on_load(force):
                    continue
                if force.element.dissipative:
                    lost = self.torque(force, smooth)
                    found += zip(range(self.model.nv)[force.v], lost) if force.in_space else [(force.v, lost)]
                    continue
                loss = force.element.loss(self.q[force.q], self.v[force.v], force.gear_ratio, smooth)
                if loss is not None:
                    found.append((force.v, loss))
        return found

    def switches(self) -> list[tuple[str, Expr]]:
        """Return the expressions that change sign where an element engages or releases, with the key of the
        element."""
        found: list[tuple[str, Expr]] = []
        for body in self.model.bodies:
            for force in body.forces:
                entries = force.element.switches(self.q[force.q], self.v[force.v])
                found += [(f"{force.name}.{force.kind}", switch) for switch in entries]
        return found
