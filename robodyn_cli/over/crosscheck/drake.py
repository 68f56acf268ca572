"""A mechanism in Drake's discrete MultibodyPlant, with its own ball, weld and coupler constraints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError, NumericalError, of_option
from robodyn_cli.model.model import Body
from robodyn_cli.over.crosscheck.engine import Translation, real, refuse_joint
from robodyn_cli.over.crosscheck.own_engines import OwnRun, plain_robot
from robodyn_cli.over.export.mjcf import ACROSS
from robodyn_cli.over.export.robot import GROUND, ExportedLink, ExportedLoop, ExportedRobot, followers
from robodyn_cli.spatial.algebra import Array

STEP = 1e-3  # s, of Drake's tutorials
MISSING = "Drake is not installed: pip install 'robodyn[peers]'"
SINGLE = ("revolute", "prismatic")
# by our joint: Drake's of (its module, name, frame on the parent, frame on the child, damping), along z of these frames
# but for the universal joint, which turns about x and then y
KINDS: Mapping[str, Callable[..., Any]] = {
    "revolute": lambda drake, name, F, M, c: drake.RevoluteJoint(name, F, M, [0, 0, 1], damping=c),
    "prismatic": lambda drake, name, F, M, c: drake.PrismaticJoint(name, F, M, [0, 0, 1], damping=c),
    "universal": lambda drake, name, F, M, c: drake.UniversalJoint(name, F, M),
    "planar": lambda drake, name, F, M, c: drake.PlanarJoint(name, F, M),
    "spherical": lambda drake, name, F, M, c: drake.BallRpyJoint(name, F, M),
    "floating": lambda drake, name, F, M, c: drake.QuaternionFloatingJoint(name, F, M),
}
IN_PLACE = ("spherical", "floating")  # whose coordinates are those of our link's frame, whatever the axis


class OwnDrake(OwnRun):
    """Drake's MultibodyPlant with a time step, at its defaults.

    Raises
    ------
    CapabilityError : Drake is not installed, or has no counterpart of a joint or of what acts in it.
    """

    name = "drake"

    def __init__(self, translated: Translation, step: float | None) -> None:
        try:
            from importlib.metadata import version

            from pydrake import all as drake
        except ImportError:
            raise of_option("--with drake", MISSING, CapabilityError) from None
        self.drake, self.version, self.bodies = drake, version("drake"), translated.model.bodies
        for body in self.bodies:
            if body.joint.type not in KINDS:
                raise refuse_joint("Drake", body, tuple(KINDS))
        self.step = STEP if step is None else step
        self.nq, self.nv = translated.model.nq, translated.model.nv
        self.plant = drake.MultibodyPlant(self.step)
        self.plant.SetUseSampledOutputPorts(False)  # so that a step can be made by hand
        robot = plain_robot(translated)
        self.parts = {GROUND: self.plant.world_body()}
        self.joints = [self._link(link) for link in robot.links]
        self._close(robot)
        self.plant.mutable_gravity_field().set_gravity_vector(robot.gravity)
        self.plant.Finalize()
        self.context = self.plant.CreateDefaultContext()
        self.settings = {
            "integrator": "discrete MultibodyPlant",
            "contact approximation": self.plant.get_discrete_contact_approximation().name.removeprefix("k"),
        }
        self.v_places = np.zeros(self.nv, dtype=int)
        for body, joint in zip(self.bodies, self.joints):
            own = np.arange(body.v, body.v + body.joint.nv)
            places = np.roll(own, 3) if body.joint.type == "floating" else own
            self.v_places[joint.velocity_start() : joint.velocity_start() + len(own)] = places

    def _link(self, link: ExportedLink) -> Any:
        """Add a link and its joint; return the joint."""
        drake, plant, m = self.drake, self.plant, link.mass
        tensor = drake.RotationalInertia(
            *np.diag(link.inertia), link.inertia[0, 1], link.inertia[0, 2], link.inertia[1, 2]
        )
        try:
            inertia = drake.SpatialInertia.MakeFromCentralInertia(m, link.com, tensor)
        except RuntimeError as error:
            raise CapabilityError(f"Drake does not take link {link.name!r}: {first_line(error)}") from None
        body = self.parts[link.name] = plant.AddRigidBody(link.name, inertia)
        order = [2, 0, 1] if link.type == "universal" else [0, 1, 2]
        axes = np.eye(3) if link.type in IN_PLACE else link.axes[:, order]
        turned = drake.RigidTransform(drake.RotationMatrix(axes), np.zeros(3))
        pose = drake.RigidTransform(drake.RotationMatrix(real(link.pose.rotation)), real(link.pose.xyz))
        parent = self.parts[link.parent].body_frame()
        F = plant.AddFrame(drake.FixedOffsetFrame(f"{link.name} F", parent, pose @ turned))
        M = plant.AddFrame(drake.FixedOffsetFrame(f"{link.name} M", body.body_frame(), turned))
        own = link.coordinates[0]
        joint = plant.AddJoint(KINDS[link.type](drake, link.joint, F, M, own.damping))
        if link.type not in SINGLE:
            if any(one.acts for one in link.coordinates):
                raise CapabilityError(
                    f"joint {link.joint!r} is {link.type}, for which springs, dampers and rotors are not built in "
                    f"Drake; allowed: {', '.join(SINGLE)}"
                )
            return joint
        if own.stiffness:
            spring = drake.RevoluteSpring if link.type == "revolute" else drake.PrismaticSpring
            plant.AddForceElement(spring(joint, own.rest, own.stiffness))
        if own.rotor_inertia:
            actuator = plant.AddJointActuator(f"{link.joint} rotor", joint)
            actuator.set_default_rotor_inertia(own.rotor_inertia)
            actuator.set_default_gear_ratio(own.gear_ratio)
        return joint

    def _close(self, robot: ExportedRobot) -> None:
        """Add the closures: of a pin two points, since Drake has no other constraint for it."""
        if any(end.link == GROUND for loop in robot.loops for end in loop.ends):
            # Drake 1.51 ends by a segmentation fault where a constraint is to the world's own body
            ground = self.plant.AddRigidBody(
                "ground of loops", self.drake.SpatialInertia.SolidSphereWithMass(1.0, 1.0)
            )
            self.plant.WeldFrames(self.plant.world_frame(), ground.body_frame())
            self.parts = {**self.parts, GROUND: ground}
        for loop in robot.loops:
            self._loop(loop)
        mimics, others = followers(robot.couplers)
        if others:
            names = ", ".join(coupler.name for coupler in others)
            raise CapabilityError(f"couplers of other than two joints are not built in Drake ({names})")
        joints = {link.joint: joint for link, joint in zip(robot.links, self.joints)}
        for name, (leader, multiplier, offset, _) in mimics.items():
            self.plant.AddCouplerConstraint(joints[name], joints[leader], multiplier, offset)

    def _loop(self, loop: ExportedLoop) -> None:
        drake, ends = (
            self.drake,
            [(self.parts[end.link], real(end.pose.xyz), real(end.axis)) for end in loop.ends],
        )
        (A, a, u), (B, b, w) = ends
        if loop.type == "fixed":
            R = drake.RotationMatrix.ProjectToRotationMatrix(loop.attitude)
            self.plant.AddWeldConstraint(A, drake.RigidTransform(R, a), B, drake.RigidTransform(b))
            return
        self.plant.AddBallConstraint(A, a, B, b)
        if loop.type == "revolute":
            self.plant.AddBallConstraint(A, a + ACROSS * u, B, b + ACROSS * w)

    # -- states ---------------------------------------------------------------------------------------------
    def _turn(self, q: Array) -> Array:
        """Return T (nv, nv), orthogonal: Drake's velocities are T v, for those of turns in space are in parent axes."""
        T = np.eye(self.nv)
        for body in self.bodies:
            for k in range(body.v, body.v + body.joint.nv, 3) if body.joint.type in IN_PLACE else ():
                T[k : k + 3, k : k + 3] = _rotation(body, q)
        return T

    def _drift(self, v: Array) -> Array:
        """Return T^T T-dot v (nv,)."""
        drift = np.zeros(self.nv)
        for body in self.bodies:
            if body.joint.type == "floating":
                k = body.v
                drift[k : k + 3] = np.cross(v[k + 3 : k + 6], v[k : k + 3])
        return drift

    def _set(self, q: Array, v: Array) -> Array:
        T = self._turn(q)
        positions = np.zeros(self.plant.num_positions())
        for body, joint in zip(self.bodies, self.joints):
            own = q[body.q : body.q + body.joint.nq]
            if body.joint.type == "spherical":
                own = self.drake.RollPitchYaw(self.drake.RotationMatrix(_rotation(body, q))).vector()
            elif body.joint.type == "floating":
                own = np.roll(own, 4)
            positions[joint.position_start() : joint.position_start() + len(own)] = own
        self.plant.SetPositions(self.context, positions)
        self.plant.SetVelocities(self.context, (T @ v)[self.v_places])
        return T

    def _state(self) -> tuple[Array, Array, Array]:
        """Return q, v and T."""
        positions, q = self.plant.GetPositions(self.context), np.empty(self.nq)
        for body, joint in zip(self.bodies, self.joints):
            own = positions[joint.position_start() : joint.position_start() + joint.num_positions()]
            if body.joint.type == "spherical":
                own = self.drake.RollPitchYaw(own).ToQuaternion().wxyz()
            elif body.joint.type == "floating":
                # Drake's steps leave quaternions longer than 1, and its rotations are those of unit ones
                own = np.concatenate([own[4:], own[:4] / np.linalg.norm(own[:4])])
            q[body.q : body.q + body.joint.nq] = own
        T = self._turn(q)
        return q, self._ours(self.plant.GetVelocities(self.context)) @ T, T

    def _ours(self, x: Array) -> Array:
        out = np.empty_like(x)
        out[..., self.v_places] = x
        return out

    def start(self, q: Array, v: Array) -> None:
        self.context.SetTime(0.0)
        self._set(q, v)

    def advance(self, tau: Array) -> tuple[Array, Array, Array]:
        _, before, T = self._state()
        old = self.plant.GetVelocities(self.context)
        self.plant.get_applied_generalized_force_input_port().FixValue(self.context, (T @ tau)[self.v_places])
        try:
            after = self.plant.EvalUniquePeriodicDiscreteUpdate(self.context)
        except RuntimeError as error:
            raise NumericalError(f"drake gives up: {first_line(error)}") from None
        self.context.SetDiscreteState(after)
        self.context.SetTime(self.context.get_time() + self.step)
        change = (self.plant.GetVelocities(self.context) - old) / self.step
        q, v, _ = self._state()
        return q, v, self._ours(change) @ T - self._drift(before)

    def inertia(self, q: Array, v: Array) -> tuple[Array, Array]:
        T = self._set(q, v)
        M = T.T @ self._ours(self._ours(self.plant.CalcMassMatrix(self.context)).T) @ T
        weight = self.plant.CalcGravityGeneralizedForces(self.context)
        bias = self._ours(self.plant.CalcBiasTerm(self.context) - weight) @ T
        return M, bias + M @ self._drift(v)


def _rotation(body: Body, q: Array) -> Array:
    """Return the axes (3, 3) of a body in its parent."""
    return real(body.joint.transform(q[body.q : body.q + body.joint.nq]).E).T


def first_line(error: Exception) -> str:
    """Return the first line of what an error says."""
    return str(error).strip().partition("\n")[0]
