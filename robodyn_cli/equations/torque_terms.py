"""The parts of the torques that a motion needs, as expressions.

Power of the forces that have no potential, by what exerts them. Torques with their roles in a margin of motorisation.
"""

from __future__ import annotations

from collections.abc import Iterable

from robodyn_cli.equations.elements import given_torques
from robodyn_cli.equations.gears import depends_on_load
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar, is_nonzero
from robodyn_cli.record import record
from robodyn_cli.scene.types import Torque
from robodyn_cli.schema.fields import DRIVE, LOAD
from robodyn_cli.spatial.algebra import zeros

Outputs = dict[str, list[Scalar]]


def torque_terms(problem: Problem, at_rest: bool = False) -> Outputs:
    """Return the parts of tau = M qdd + C qd + G - tau_passive - tau_friction - tau_external, by name.

    Inertia is always included, but at rest, where it is left out with M qdd + C qd; so is any other part that vanishes
    identically. Friction has the exact sign of the rate.
    """
    rigid = {"gravity": problem.gravity_torques} if at_rest else problem.rigid_terms()
    terms: Outputs = {name: list(term) for name, term in rigid.items()}
    for name, term in problem.passive_forces(smooth=False).items():
        terms[name] = [-x for x in term]
    return {
        name: term for name, term in terms.items() if name == "inertia" or any(is_nonzero(x) for x in term)
    }


DRIVE_INERTIA = "drive_inertia"  # the role of what a given motion needs to be accelerated


@record
class Exerted:
    """Torques on the joints (nv,) [N m or N] of one thing that acts on them, and its role."""

    role: str
    torque: list[Scalar]

    @property
    def acts(self) -> list[bool]:
        """Whether it acts on each joint."""
        return [is_nonzero(x) for x in self.torque]


def exerted(problem: Problem, inertia: bool) -> dict[str, Exerted]:
    """Return everything that acts on the joints by its name: forces, ``torques``, gravity, inertia where asked for.

    Friction has the exact sign of the rate. Stops, losses of gears and what a controller gives are left out.
    """
    nv, joints, every = problem.model.nv, problem.forces_in_joints, {}
    for body in problem.model.bodies:
        for force in body.forces:
            if force.element.role and not depends_on_load(force):
                own = zeros(nv)
                own[force.v] = joints.torque(force, smooth=False)
                every[f"{force.name}.{force.kind}"] = Exerted(force.element.role, list(own))
    if problem.model.forces:
        torques = problem.elements.each_torque()
        for between in problem.model.forces:
            every[f"forces.{between.name}"] = Exerted(between.element.role, list(torques[between.name]))
    for name, torque in problem.scene.torques.items():
        own = given_torques({name: torque}, problem.model, problem.environment)
        every[f"torques.{name}"] = Exerted(torque.role if isinstance(torque, Torque) else DRIVE, list(own))
    rigid = problem.rigid_terms()
    if "gravity" in rigid:
        every["gravity"] = Exerted(LOAD, [-x for x in rigid["gravity"]])
    if inertia:
        every["inertia"] = Exerted(DRIVE_INERTIA, [-x for x in rigid["inertia"] + rigid["coriolis"]])
    return {name: one for name, one in every.items() if any(one.acts)}


def powers(problem: Problem) -> dict[str, Scalar]:
    """Return the power of all forces without a potential [W]."""
    rows = problem.constraints
    # Psi^T lambda does work at the rate -lambda eta_t on a row that depends on time
    driven = total(problem.forward.lam[i] * rows.rows[i].eta_t for i in rows.rheonomic)
    return {**applied_powers(problem), "prescribed motion": -driven}


def applied_powers(problem: Problem) -> dict[str, Scalar]:
    """Return the power of actuators, of losses, and of forces between bodies that have no potential [W]."""
    v = problem.v
    return {
        "actuators": total(tau * rate for tau, rate in zip(problem.actuator_torques, v)),
        "friction, dampers or stops": total(torque * v[place] for place, torque in problem.dissipated),
        "forces on points and between bodies": problem.elements.power if problem.model.forces else 0.0,
    }


def total(terms: Iterable[Scalar]) -> Scalar:
    """Return the sum."""
    return sum(terms, 0.0)
