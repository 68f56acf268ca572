"""The equations of motion of a scene, each part built when it is first used.

    M(q) v-dot + h(q, v) = tau_a + tau_f + Psi^T lambda,   eta(q, t) = 0

tau_a are actuator torques, tau_f those of springs, dampers and friction in the joints and of forces on bodies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.algorithms.aba import ArticulatedFactor
from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.energy import gravity_energy, kinetic_energy, spring_energy
from robodyn_cli.algorithms.kinematics import Pose, moved, poses, transforms
from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.equations.contact_joints import ContactJoint, contact_joints, moving_freely
from robodyn_cli.equations.elements import Elements, JointForces, functions_of_points, given_torques
from robodyn_cli.equations.gears import geared, losses_of_drive, losses_of_load
from robodyn_cli.expr.graph import Expr, Scalar, count_operations, is_nonzero
from robodyn_cli.expr.rebuild import numbers
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import FixedFrame, Model
from robodyn_cli.model.places import with_places
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import Array, Matrix, Transform, Values, Vector, vector, zeros

if TYPE_CHECKING:
    from robodyn_cli.algorithms.constraints import Multipliers
    from robodyn_cli.equations.constraints import Combination, Constraints, Dependence
    from robodyn_cli.equations.control.control import Control
    from robodyn_cli.equations.latches import LatchRow
    from robodyn_cli.equations.switching import Switching
    from robodyn_cli.loops.base import Row

CANCELLATION = 1e3  # so many units of rounding may be lost in a difference of moments of inertia
DENSE_LIMIT = 12  # velocities up to which the factored mass matrix is tried: it grows with their cube


class Problem:
    """The equations of one scene as expressions of t, q, v (and a, the accelerations), parameters p.

    Parameters
    ----------
    scene : the checked scene.
    symbolic : constants kept as parameters p, in this order (see ``build_model``).
    keep_rows : constraint rows to keep, by index; by default all. dependent : rows that depend on each other always.
    braces : inertias along constraint rows, by name (see ``with_inertia`` of ``equations/constraints.py``).
    """

    is_variant = False  # whether these are the equations with changes, to count operations

    def __init__(
        self,
        scene: sc.Scene,
        symbolic: Sequence[str] = (),
        keep_rows: Sequence[int] | None = None,
        model: Model | None = None,
        dependent: Sequence[Dependence] = (),
        braces: Mapping[str, float] | None = None,
    ) -> None:
        self.scene = scene = with_places(scene)
        self.model = model or build_model(scene, symbolic)
        graph = self.graph = self.model.graph
        self.t: Expr = graph.symbol("t", "t")
        self.q: list[Expr] = graph.symbols(self.model.q_names, "q")
        self.v: list[Expr] = graph.symbols([f"{n}'" for n in self.model.v_names], "v")
        self.a: list[Expr] = graph.symbols([f"{n}''" for n in self.model.v_names], "a")
        self.keep_rows, self.dependent = keep_rows, tuple(dependent)
        self.braces = braces or {}
        self.latches: tuple[LatchRow, ...] = ()  # those that events close and open
        if scene.latched:
            from robodyn_cli.equations.latches import latch_rows

            self.latches = latch_rows(self)
        self.sprung = tuple(latch for latch in self.latches if not latch.rigid)  # with a spring
        self.control: Control | None = None
        if scene.control is not None:
            from robodyn_cli.equations.control.control import Control

            self.of = Problem
            self.control = Control(self)

    def numbers(
        self, entries: Any, q: Array, t: float = 0.0, v: Array | None = None, p: Array | None = None
    ) -> Array:
        """Return the values of expressions at q (nq,) and v (nv,), by default 0, in the shape of ``entries``."""
        still, z = [0.0] * self.model.nv, [0.0] * (0 if self.control is None else len(self.control.names))
        groups = {"t": [t], "q": q.tolist(), "v": still if v is None else v.tolist(), "a": still, "z": z}
        return numbers(entries, groups | {"p": self.at_start if p is None else p.tolist()})

    # -- rigid bodies ---------------------------------------------------------------------------------
    @property
    def gravity(self) -> Vector | None:
        """Gravity in base coordinates, None where it is zero."""
        g = self.model.gravity
        return g if any(is_nonzero(x) for x in g) else None

    @cached_property
    def rigid(self) -> Model:
        """The bodies as M, C and G need them: with base parameters where the bodies' own numbers would lose digits."""
        exact = all(body.cancellation < CANCELLATION for body in self.model.bodies)
        return self.model.with_masses_at_joints() if exact else self.lumped

    @cached_property
    def lumped(self) -> Model:
        """The bodies with base parameters."""
        from robodyn_cli.model.base_parameters import with_base_parameters

        return with_base_parameters(self.model)

    @cached_property
    def X(self) -> list[Transform]:
        return transforms(self.model, self.q)

    @cached_property
    def pose(self) -> dict[int, Pose]:
        """Poses of the bodies in base coordinates."""
        return poses(self.model, self.X)

    @cached_property
    def tree_mass_matrix(self) -> Matrix:
        """M of the opened tree."""
        return crba(self.rigid, self.q, self.X)

    @cached_property
    def mass_matrix(self) -> Matrix:
        """M that the equations of motion are solved with: that of the opened tree, with braces where it needs them."""
        if not self.braces:
            return self.tree_mass_matrix
        from robodyn_cli.equations.constraints import with_inertia

        return with_inertia(self.tree_mass_matrix, self.braces, self.all_constraints)

    def newton_euler(self, v: Values, a: Values, gravity: Vector | None) -> Vector:
        """Return M a + C v + G for rates v and accelerations a (nv,)."""
        return rnea(self.rigid, self.q, v, a, gravity, self.X)

    @cached_property
    def bias(self) -> Vector:
        """h = C v + G, and what belongs to the braces of ``mass_matrix``."""
        h = self.newton_euler(self.v, zeros(self.model.nv), self.gravity)
        if not self.braces:
            return h
        from robodyn_cli.equations.constraints import with_force

        return with_force(h, self.braces, self.all_constraints)

    @cached_property
    def inverse_dynamics(self) -> Vector:
        """M a + C v + G."""
        return self.newton_euler(self.v, self.a, self.gravity)

    def rigid_terms(self) -> dict[str, Vector]:
        """Return M a, C v and G separately: ``inertia``, ``coriolis`` and, where there is gravity, ``gravity``."""
        v, a, rest = self.v, self.a, zeros(self.model.nv)
        terms = {"inertia": self.newton_euler(rest, a, None), "coriolis": self.newton_euler(v, rest, None)}
        return terms if self.gravity is None else {**terms, "gravity": self.gravity_torques}

    @cached_property
    def gravity_torques(self) -> Vector:
        """G (nv,), which holds the weight of the bodies."""
        return self.newton_euler(zeros(self.model.nv), zeros(self.model.nv), self.gravity)

    # -- torques --------------------------------------------------------------------------------------
    @cached_property
    def environment(self) -> dict[str, Any]:
        """What formulas of the scene may name."""
        env: dict[str, Any] = {"t": self.t, **self.of_points}
        env |= {f"q.{name}": q for name, q in zip(self.model.q_names, self.q)}
        env |= {f"qd.{name}": v for name, v in zip(self.model.v_names, self.v)}
        return env | {f"p.{name}": value for name, value in self.scene.parameters.items()}

    @cached_property
    def of_points(self) -> dict[str, Scalar]:
        """Distances, angles, coordinates and speeds of points that formulas ask for, by the names that these give."""
        return functions_of_points(self.model, self.X, self.q, self.v) if self.model.of_points else {}

    @cached_property
    def actuator_torques(self) -> Vector:
        """tau_a (nv,): the scene's ``torques``, and those of its controller."""
        tau, given = zeros(self.model.nv), self.scene.torques
        tau = given_torques(given, self.model, self.environment) if given else tau
        return tau if self.control is None else tau + self.control.on_joints()

    @cached_property
    def switching(self) -> Switching:
        """Where the equations switch, along the motion and in time."""
        from robodyn_cli.equations.switching import Switching

        return Switching(self)

    @cached_property
    def contact_joints(self) -> tuple[ContactJoint, ...]:
        """Joints with a contact state, which a simulation holds and releases by events."""
        return contact_joints(self.model)

    @property
    def at_start(self) -> tuple[float, ...]:
        """The parameters p at t = 0, with all joints moving freely and all latches open."""
        return moving_freely((*self.contact_joints, *self.latches), self.model.switched)

    @property
    def parameter_count(self) -> int:
        """How many parameters p there are before those that a partition chooses."""
        return max(len(self.at_start), len(self.model.parameters))

    @cached_property
    def elements(self) -> Elements:
        """Forces on points and between bodies."""
        return Elements(self.model, self.X, self.q, self.v, self.environment, self.t)

    def passive_forces(self, smooth: bool) -> dict[str, Vector]:
        """Return the torques of everything but the actuators on the joints (nv,), by term.

        ``passive``: springs, dampers, bushings; ``friction``; ``external``: forces and wrenches.
        """
        terms = self.joint_forces(smooth)
        for name, torques in self.elements.torques.items() if self.model.forces else ():
            terms[name] = terms[name] + torques if name in terms else torques
        if geared(self.model):
            losses = self.gear_losses(smooth)
            terms["gear"] = vector([losses.get(k, 0.0) for k in range(self.model.nv)])
        return terms

    def gear_losses(self, smooth: bool) -> dict[int, Scalar]:
        """Return the torques of losses in gears by velocity index: of the drives (``smooth``) or of the load; that
        depends on how actuators share it where there are loops (``losses_along``)."""
        if not geared(self.model) or (self.model.closures and not smooth):
            return {}
        terms, elements = self.joint_forces(smooth), self.elements.torques
        if smooth:
            return losses_of_drive(self.model, self.actuator_torques, self.v, terms, self.scene.prescribed)
        return losses_of_load(self.model, self.inverse_dynamics, self.a, self.v, terms, elements)

    @cached_property
    def forces_in_joints(self) -> JointForces:
        return JointForces(self.model, self.q, self.v, self.contact_joints)

    def joint_forces(self, smooth: bool) -> dict[str, Vector]:
        """Return the torques of springs, dampers (``passive``), ``friction`` and ``stops`` in the joints.

        ``smooth`` replaces the sign in Coulomb friction, for simulations.
        """
        terms = self.forces_in_joints.terms(smooth)
        for latch in self.sprung:
            terms["stops"] = terms.get("stops", zeros(self.model.nv)) + latch.torques(self.q, self.v)
        return terms

    def losses(self, smooth: bool) -> list[tuple[int, Scalar]]:
        """Torques of joint elements that are not the gradient of a potential: (velocity index, torque)."""
        of_latches = [one for x in self.sprung for one in x.losses(self.q, self.v).items()]
        return [*self.forces_in_joints.losses(smooth), *self.gear_losses(smooth).items(), *of_latches]

    @cached_property
    def applied(self) -> Vector:
        """tau_a + tau_f, as a simulation uses them."""
        return sum(self.passive_forces(smooth=True).values(), self.actuator_torques.copy())

    @cached_property
    def dissipated(self) -> list[tuple[int, Scalar]]:
        """The losses as a simulation has them."""
        return self.losses(smooth=True)

    # -- constraints ----------------------------------------------------------------------------------
    @cached_property
    def constraints(self) -> Constraints:
        """The rows that are kept."""
        return self.all_constraints if self.keep_rows is None else self.all_constraints.only(self.keep_rows)

    @cached_property
    def all_constraints(self) -> Constraints:
        """All of them: see ``constraints_of``."""
        from robodyn_cli.equations.constraints import constraints_of

        return constraints_of(self)

    @cached_property
    def psi(self) -> Matrix:
        return self.constraints.psi(self.model.nv)

    @cached_property
    def combinations(self) -> list[Combination]:
        """Combinations of the rows that depend on each other; their numbers are parameters p."""
        if not self.dependent:
            return []
        from robodyn_cli.equations.constraints import combinations

        return combinations(self.graph, self.dependent, self.constraints.names, self.parameter_count)

    @cached_property
    def independent_rows(self) -> Constraints:
        """The rows that the equations are solved with: combinations of dependent rows, then the other rows."""
        if not self.combinations:
            return self.constraints
        from robodyn_cli.equations.constraints import independent_rows

        return independent_rows(self.constraints, self.combinations)

    def moved(self, dq: Values) -> list[Scalar]:
        """Return q - dq (nq,) for a step dq (nv,), along the joints' manifolds."""
        return moved(self.model, self.q, [-x for x in dq])

    @property
    def constraint_rows(self) -> tuple[Row, ...]:
        return self.constraints.rows

    @property
    def loop_rank(self) -> int:
        """How many rows of the loops are independent."""
        return len(self.independent_rows.rows) - len(self.independent_rows.prescribed)

    @property
    def loop_psi(self) -> Matrix:
        """Psi of the independent rows of the loops (r, nv)."""
        return self.independent_rows.psi(self.model.nv)[: self.loop_rank]

    @cached_property
    def elimination_order(self) -> list[int]:
        """Velocity coordinates, leaves of the tree first."""
        return [body.v + j for body in reversed(self.model.bodies) for j in range(body.joint.nv)]

    # -- forward dynamics -----------------------------------------------------------------------------
    @property
    def is_held(self) -> bool:
        """Whether parameters hold and release parts of the mechanism: joints with a contact state, and latches."""
        return bool(self.contact_joints or self.latches)

    @cached_property
    def forward(self) -> Multipliers:
        """Accelerations (and multipliers) for the applied torques, by the way that takes fewer operations."""
        return self._solved[0]

    @cached_property
    def holding(self) -> list[Scalar]:
        """Multipliers of the joints with a contact state: the torques that hold them, zero for free joints."""
        return self._solved[1]

    @cached_property
    def _solved(self) -> tuple[Multipliers, list[Scalar]]:
        return self.solution(self.independent_rows.gamma)

    def solution(self, gamma: Sequence[Scalar], applied: Any = None) -> tuple[Multipliers, list[Scalar]]:
        """Return accelerations and multipliers for ``gamma`` of the independent rows and ``applied`` forces (nv,),
        those of the scene by default, and those of held joints."""
        from robodyn_cli.algorithms.constraints import Multipliers, solve_with_multipliers

        f = (self.applied if applied is None else applied) - self.bias
        if not (self.constraints.rows or self.is_held):
            return Multipliers(self.free_accelerations(f), zeros(0)), []
        from robodyn_cli.equations.latches import held_rows, without_held

        rows, drift, holds = held_rows(self)
        psi = np.concatenate([self.independent_rows.psi(self.model.nv), rows])
        M, f, psi = without_held(self, f, psi)
        factor = LdlFactor.of(M, self.elimination_order)
        solved = solve_with_multipliers(factor, f, psi, [*gamma, *drift], holds)
        for joint in self.contact_joints:  # rounding must not set a held joint in motion
            solved.qdd[joint.v] = solved.qdd[joint.v] * (1.0 - joint.hold)
        lam, holding = solved.lam[: len(gamma)], list(solved.lam[len(gamma) :])
        if self.combinations:
            from robodyn_cli.equations.constraints import multipliers_of_rows

            lam = multipliers_of_rows(self.constraints, self.combinations, lam)
        return Multipliers(solved.qdd, lam), holding

    def ways_to_accelerations(self, f: Values) -> dict[str, Vector]:
        """Return M^-1 f (nv,) of the open tree by the ways that may suit its size."""
        articulated = ArticulatedFactor(self.rigid, self.q, self.X).solve(f)
        if self.model.nv > DENSE_LIMIT:
            return {"articulated bodies": articulated}
        dense = LdlFactor.of(self.mass_matrix, self.elimination_order).solve(f)
        return {"factored mass matrix": dense, "articulated bodies": articulated}

    def free_accelerations(self, f: Values) -> Vector:
        """Return M^-1 f (nv,) of the open tree by the way that takes fewer operations."""
        return min(self.ways_to_accelerations(f).values(), key=count_operations)

    # -- energy ---------------------------------------------------------------------------------------
    @cached_property
    def kinetic(self) -> Scalar:
        return kinetic_energy(self.model, self.q, self.v, self.X)

    @cached_property
    def potential(self) -> Scalar:
        """Gravity (zero at the base's origin), joint springs and forces between bodies."""
        own = gravity_energy(self.model, self.q, self.gravity, self.X) + spring_energy(self.model, self.q)
        for latch in self.sprung:
            own = own + latch.potential(self.q)
        return own + self.elements.potential if self.model.forces else own

    # -- places ---------------------------------------------------------------------------------------
    def world_point(self, frame: FixedFrame) -> Vector:
        """Return the world coordinates [m] of a point fixed to a body."""
        return self.model.base.point(self.pose[frame.body].point(frame.p))
