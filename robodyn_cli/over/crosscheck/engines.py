"""The tree of a mechanism in Pinocchio and in MuJoCo."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any
from xml.etree.ElementTree import SubElement

import numpy as np

from robodyn_cli.errors import CapabilityError, of_option
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.over.crosscheck import engine
from robodyn_cli.over.export.mjcf import JOINTS, add_bodies, mujoco_element
from robodyn_cli.over.export.robot import ExportedFrames, ExportedRobot, links_of, loops_of, xml_text
from robodyn_cli.spatial.algebra import Array, Transform, cross

XYZW = (1, 2, 3, 0)  # places of x, y, z, w among w, x, y, z


def _composite(pin: Any, *parts: Any) -> Any:
    composite = pin.JointModelComposite()
    for part in parts:
        composite.addJoint(part)
    return composite


# by our joint: Pinocchio's, and where each of its positions is among ours
PINOCCHIO_KINDS: dict[str, tuple[Callable[[Any, Any], Any], tuple[int, ...]]] = {
    "revolute": (lambda pin, joint: pin.JointModelRZ(), (0,)),
    "prismatic": (lambda pin, joint: pin.JointModelPZ(), (0,)),
    "helical": (lambda pin, joint: pin.JointModelHZ(float(joint.pitch)), (0,)),
    "cylindrical": (lambda pin, joint: _composite(pin, pin.JointModelRZ(), pin.JointModelPZ()), (0, 1)),
    "universal": (lambda pin, joint: _composite(pin, pin.JointModelRZ(), pin.JointModelRX()), (0, 1)),
    "planar": (
        lambda pin, joint: _composite(pin, pin.JointModelPX(), pin.JointModelPY(), pin.JointModelRZ()),
        (0, 1, 2),
    ),
    "spherical": (lambda pin, joint: pin.JointModelSpherical(), XYZW),
    "floating": (lambda pin, joint: pin.JointModelFreeFlyer(), (0, 1, 2, *(3 + k for k in XYZW))),
}


class InPinocchio(engine.PeerEngine):
    """A tree in Pinocchio: recursive Newton-Euler, composite and articulated bodies, rotors as armature.

    Raises
    ------
    CapabilityError : Pinocchio is not installed, or has no counterpart of a joint.
    """

    name = "pinocchio"

    def __init__(self, model: Model) -> None:
        try:
            import pinocchio as pin
        except ImportError:
            raise of_option("--with pinocchio", engine.MISSING.format("Pinocchio"), CapabilityError) from None
        super().__init__(model)
        self.pin, self.version = pin, pin.__version__
        out = pin.Model()
        out.gravity.linear = engine.real(model.gravity)
        self.joint = {BASE: 0}
        rotors = np.zeros(model.nv)
        for k in engine.depth_first(model):
            body = model.bodies[k]
            if body.joint.type not in PINOCCHIO_KINDS:
                raise engine.refuse_joint("Pinocchio", body, tuple(PINOCCHIO_KINDS))
            make, places = PINOCCHIO_KINDS[body.joint.type]
            placement = pin.SE3(engine.real(body.X_tree.E).T, engine.real(body.X_tree.r))
            at = out.addJoint(self.joint[body.parent], make(pin, body.joint), placement, body.joint_name)
            try:
                inertia = pin.Inertia(*engine.mass_properties(body))
            except (RuntimeError, ValueError) as error:
                raise CapabilityError(f"Pinocchio does not take link {body.name!r}: {error}") from None
            out.appendBodyToJoint(at, inertia, pin.SE3.Identity())
            self.joint[k] = at
            self.q_places[out.idx_qs[at] : out.idx_qs[at] + body.joint.nq] = [body.q + j for j in places]
            self.v_places[out.idx_vs[at] : out.idx_vs[at] + body.joint.nv] = range(
                body.v, body.v + body.joint.nv
            )
            rotors[out.idx_vs[at] : out.idx_vs[at] + body.joint.nv] = [float(x) for x in body.rotors]
        out.armature = rotors
        self.model, self.data = out, out.createData()

    def _to(self, *arrays: Array) -> list[Array]:
        q, *others = arrays
        return [q[self.q_places], *(x[self.v_places] for x in others)]

    def torques(self, q: Array, v: Array, a: Array) -> Array:
        return self.in_our_order(np.array(self.pin.rnea(self.model, self.data, *self._to(q, v, a))))

    def free_accelerations(self, q: Array, v: Array, tau: Array) -> Array:
        return self.in_our_order(np.array(self.pin.aba(self.model, self.data, *self._to(q, v, tau))))

    def bring(self, q: Array, v: Array) -> None:
        self._q, rates = self._to(q, v)
        self.pin.computeJointJacobians(self.model, self.data, self._q)
        self.pin.forwardKinematics(self.model, self.data, self._q, rates, np.zeros(self.size))

    def mass_matrix(self) -> Array:
        M = np.array(self.pin.crba(self.model, self.data, self._q))
        return self.in_our_order(self.in_our_order(np.triu(M) + np.triu(M, 1).T).T)

    def places(self, frames: Sequence[FixedFrame]) -> engine.PeerPlaces:
        each = zip(*(self._place(frame) for frame in frames))
        return engine.PeerPlaces(*(np.array(x) for x in each))

    def _place(self, frame: FixedFrame) -> tuple[Array, ...]:
        """Return p, R, J, a and w of a frame, see ``PeerPlaces``."""
        pin, joint = self.pin, self.joint[frame.body]
        at = self.pin.SE3(engine.real(frame.R), engine.real(frame.p))
        local = pin.Frame("", joint, 0, at, pin.FrameType.OP_FRAME)
        pose = self.data.oMi[joint] * local.placement
        axes = pin.LOCAL_WORLD_ALIGNED
        J = pin.getFrameJacobian(self.model, self.data, joint, at, axes)
        velocity = pin.getFrameVelocity(self.model, self.data, joint, at, axes)
        drift = pin.getFrameClassicalAcceleration(self.model, self.data, joint, at, axes)
        return (
            pose.translation.copy(),
            pose.rotation.copy(),
            self.in_our_order(np.concatenate([J[3:], J[:3]])),
            np.concatenate([drift.angular, drift.linear]),
            velocity.angular.copy(),
        )


MUJOCO_KINDS = tuple(kind for kind in JOINTS if kind != "fixed")


class InMujoco(engine.PeerEngine):
    """A tree in MuJoCo, without contacts and without constraints of its own.

    Raises
    ------
    CapabilityError : MuJoCo is not installed, has no counterpart of a joint, or does not take a body's inertia.
    """

    name = "mujoco"

    def __init__(self, model: Model) -> None:
        try:
            import mujoco
        except ImportError:
            raise of_option("--with mujoco", engine.MISSING.format("MuJoCo"), CapabilityError) from None
        super().__init__(model)
        for body in model.bodies:
            if body.joint.type not in MUJOCO_KINDS:
                raise engine.refuse_joint("MuJoCo", body, MUJOCO_KINDS)
        self.mj, self.version = mujoco, mujoco.__version__
        text, names = self._described(model)
        try:
            self.model = mujoco.MjModel.from_xml_string(text)
        except ValueError as error:
            raise _refused(model, " ".join(str(error).split())) from None
        self.data = mujoco.MjData(self.model)
        self.flying = [body for body in model.bodies if body.joint.type == "floating"]
        self.body = {BASE: 0}
        for k, (name, body) in enumerate(zip(names, model.bodies)):
            self.body[k] = self.model.body(name).id
            first = int(self.model.body_jntadr[self.body[k]])
            q, v = int(self.model.jnt_qposadr[first]), int(self.model.jnt_dofadr[first])
            self.q_places[q : q + body.joint.nq] = range(body.q, body.q + body.joint.nq)
            self.v_places[v : v + body.joint.nv] = range(body.v, body.v + body.joint.nv)

    def _described(self, model: Model) -> tuple[str, list[str]]:
        """Return the MJCF, and the names of the bodies there."""
        return _mjcf(model), [f"body{k}" for k in range(len(model.bodies))]

    def _turn(self, q: Array) -> Array:
        """Return T (nv, nv), orthogonal: MuJoCo's velocities are T v; free bodies' are in their parent's axes."""
        T = np.eye(self.size)
        for body in self.flying:
            own = slice(body.v, body.v + 3)
            T[own, own] = engine.real(body.joint.transform(q[body.q : body.q + 7]).E).T
        return T

    def _drift(self, v: Array) -> Array:
        """Return T^T T-dot v (nv,): omega x v of free bodies."""
        drift = np.zeros(self.size)
        for body in self.flying:
            k = body.v
            drift[k : k + 3] = cross(v[k + 3 : k + 6], v[k : k + 3])
        return drift

    def _set(self, q: Array, v: Array) -> Array:
        T = self._turn(q)
        self.data.qpos[:], self.data.qvel[:] = q[self.q_places], (T @ v)[self.v_places]
        return T

    def torques(self, q: Array, v: Array, a: Array) -> Array:
        T = self._set(q, v)
        self.data.qacc[:] = (T @ (a + self._drift(v)))[self.v_places]
        self.mj.mj_inverse(self.model, self.data)
        return np.asarray(self.in_our_order(np.array(self.data.qfrc_inverse)) @ T)

    def free_accelerations(self, q: Array, v: Array, tau: Array) -> Array:
        T = self._set(q, v)
        self.data.qfrc_applied[:] = (T @ tau)[self.v_places]
        self.mj.mj_forward(self.model, self.data)
        return np.asarray(self.in_our_order(np.array(self.data.qacc)) @ T) - self._drift(v)

    def bring(self, q: Array, v: Array) -> None:
        self._T, self._lag = self._set(q, v), self._drift(v)
        self.mj.mj_forward(self.model, self.data)

    def mass_matrix(self) -> Array:
        # column by column, by a call whose meaning no version has changed
        M, unit = np.zeros((self.size, self.size)), np.eye(self.size)
        for k in range(self.size):
            self.mj.mj_mulM(self.model, self.data, M[k], unit[k])
        return np.asarray(self._T.T @ self.in_our_order(self.in_our_order(M).T) @ self._T)

    def places(self, frames: Sequence[FixedFrame]) -> engine.PeerPlaces:
        data, bodies = self.data, [self.body[frame.body] for frame in frames]
        axes = data.xmat[bodies].reshape(-1, 3, 3)
        p = data.xpos[bodies] + (axes @ np.array([engine.real(f.p) for f in frames])[..., None])[..., 0]
        J, rate = np.zeros((2, len(frames), 6, self.size))
        for k, body in enumerate(bodies):
            self.mj.mj_jac(self.model, data, J[k, 3:], J[k, :3], p[k], body)
            self.mj.mj_jacDot(self.model, data, rate[k, 3:], rate[k, :3], p[k], body)
        ours = self.in_our_order(J) @ self._T
        a, w = rate @ data.qvel + ours @ self._lag, J[:, :3] @ data.qvel
        return engine.PeerPlaces(p, axes @ np.array([engine.real(f.R) for f in frames]), ours, a, w)


LEAST = 1e-14  # mass [kg] and principal moments [kg m^2] of bodies that MuJoCo takes


def _refused(model: Model, why: str) -> CapabilityError:
    """Return the error of a mechanism that MuJoCo refuses: links that it does not take, else why in its own words."""
    bad = []
    for body in model.bodies:
        mass, _, inertia = engine.mass_properties(body)
        A, B, C = (float(x) for x in np.linalg.eigvalsh(inertia))
        if mass < LEAST or A < LEAST or C > A + B:
            bad.append(
                f"{body.name!r} (mass {mass:.4g} kg, principal moments {A + 0.0:.4g}, {B:.4g}, {C:.4g} kg m^2)"
            )
    if not bad:
        return CapabilityError(f"MuJoCo does not take the mechanism: {why}")
    return CapabilityError(
        f"MuJoCo does not take link {', '.join(bad)}; allowed: bodies with mass and three positive principal moments, "
        "none of them above the sum of the others"
    )


def _mjcf(model: Model) -> str:
    """Return the MJCF of a tree: bodies by number with the frames of their joints, and no forces."""
    bodies = [
        dataclasses.replace(body, name=f"body{k}", joint_name=f"{k}", forces=())
        for k, body in enumerate(model.bodies)
    ]
    robot = robot_of(dataclasses.replace(model, bodies=tuple(bodies), loops=()))
    root = mujoco_element(robot, {"contact": "disable", "constraint": "disable"})
    add_bodies(SubElement(root, "worldbody"), robot)
    return xml_text(root)


def robot_of(model: Model) -> ExportedRobot:
    """Return a model for the writers of other formats, in the axes of its base, without couplers."""
    bare = dataclasses.replace(model, base=Transform.identity())
    frames = ExportedFrames(bare, joint_types, (), Manifold(model).neutral())
    links = links_of(bare, frames, {})
    return ExportedRobot("mechanism", engine.real(model.gravity), links, loops_of(bare, frames))
