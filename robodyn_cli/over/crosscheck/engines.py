"""The tree of a mechanism in Pinocchio and in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.over.crosscheck import engine
from robodyn_cli.spatial.algebra import Array

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
            raise CapabilityError(engine.MISSING.format("Pinocchio", "pinocchio")) from None
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

    def mass_matrix(self, q: Array) -> Array:
        M = np.array(self.pin.crba(self.model, self.data, *self._to(q)))
        return self.in_our_order(self.in_our_order(np.triu(M) + np.triu(M, 1).T).T)

    def place(self, q: Array, v: Array, frame: FixedFrame) -> engine.PeerPlace:
        pin, joint = self.pin, self.joint[frame.body]
        at = self.pin.SE3(engine.real(frame.R), engine.real(frame.p))
        here, rates = self._to(q, v)
        pin.computeJointJacobians(self.model, self.data, here)
        pin.forwardKinematics(self.model, self.data, here, rates, np.zeros(self.size))
        local = pin.Frame("", joint, 0, at, pin.FrameType.OP_FRAME)
        pose = self.data.oMi[joint] * local.placement
        axes = pin.LOCAL_WORLD_ALIGNED
        J = pin.getFrameJacobian(self.model, self.data, joint, at, axes)
        velocity = pin.getFrameVelocity(self.model, self.data, joint, at, axes)
        drift = pin.getFrameClassicalAcceleration(self.model, self.data, joint, at, axes)
        return engine.PeerPlace(
            pose.translation.copy(),
            pose.rotation.copy(),
            self.in_our_order(np.concatenate([J[3:], J[:3]])),
            np.concatenate([drift.angular, drift.linear]),
            velocity.angular.copy(),
        )


# by our joint: MuJoCo's joints of one body, outermost first, each with its axis
MUJOCO_KINDS: Mapping[str, tuple[tuple[str, str], ...]] = {
    "revolute": (("hinge", "0 0 1"),),
    "prismatic": (("slide", "0 0 1"),),
    "cylindrical": (("hinge", "0 0 1"), ("slide", "0 0 1")),
    "universal": (("hinge", "0 0 1"), ("hinge", "1 0 0")),
    "planar": (("slide", "1 0 0"), ("slide", "0 1 0"), ("hinge", "0 0 1")),
    "spherical": (("ball", "0 0 1"),),
}
VELOCITIES = {"hinge": 1, "slide": 1, "ball": 3}


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
            raise CapabilityError(engine.MISSING.format("MuJoCo", "mujoco")) from None
        super().__init__(model)
        self.mj, self.version = mujoco, mujoco.__version__
        try:
            self.model = mujoco.MjModel.from_xml_string(_mjcf(model, mujoco))
        except ValueError as error:
            raise CapabilityError(f"MuJoCo does not take the mechanism: {error}") from None
        self.data = mujoco.MjData(self.model)
        self.body = {BASE: 0}
        for k, body in enumerate(model.bodies):
            self.body[k] = self.model.body(f"body{k}").id
            first = self.model.joint(f"{k}.0")
            q, v = int(first.qposadr[0]), int(first.dofadr[0])
            self.q_places[q : q + body.joint.nq] = range(body.q, body.q + body.joint.nq)
            self.v_places[v : v + body.joint.nv] = range(body.v, body.v + body.joint.nv)

    def _set(self, q: Array, v: Array) -> None:
        self.data.qpos[:], self.data.qvel[:] = q[self.q_places], v[self.v_places]

    def torques(self, q: Array, v: Array, a: Array) -> Array:
        self._set(q, v)
        self.data.qacc[:] = a[self.v_places]
        self.mj.mj_inverse(self.model, self.data)
        return self.in_our_order(np.array(self.data.qfrc_inverse))

    def free_accelerations(self, q: Array, v: Array, tau: Array) -> Array:
        self._set(q, v)
        self.data.qfrc_applied[:] = tau[self.v_places]
        self.mj.mj_forward(self.model, self.data)
        return self.in_our_order(np.array(self.data.qacc))

    def mass_matrix(self, q: Array) -> Array:
        self._set(q, np.zeros(self.size))
        self.mj.mj_forward(self.model, self.data)
        # column by column, by a call whose meaning no version has changed
        M, unit = np.zeros((self.size, self.size)), np.eye(self.size)
        for k in range(self.size):
            self.mj.mj_mulM(self.model, self.data, M[k], unit[k])
        return self.in_our_order(self.in_our_order(M).T)

    def place(self, q: Array, v: Array, frame: FixedFrame) -> engine.PeerPlace:
        self._set(q, v)
        self.mj.mj_forward(self.model, self.data)
        body, data = self.body[frame.body], self.data
        R = data.xmat[body].reshape(3, 3).copy()
        p = data.xpos[body] + R @ engine.real(frame.p)
        J, rate = np.zeros((6, self.size)), np.zeros((6, self.size))
        self.mj.mj_jac(self.model, data, J[3:], J[:3], p, body)
        self.mj.mj_jacDot(self.model, data, rate[3:], rate[:3], p, body)
        return engine.PeerPlace(
            p, R @ engine.real(frame.R), self.in_our_order(J), rate @ data.qvel, J[:3] @ data.qvel
        )


def _numbers(x: Any) -> str:
    return " ".join(repr(float(e)) for e in np.ravel(x))


def _mjcf(model: Model, mujoco: Any) -> str:
    """Return the MJCF of a tree."""
    below = engine.children(model)

    def write(k: int) -> list[str]:
        body = model.bodies[k]
        if body.joint.type not in MUJOCO_KINDS:
            raise engine.refuse_joint("MuJoCo", body, tuple(MUJOCO_KINDS))
        turn = np.zeros(4)
        mujoco.mju_mat2Quat(turn, np.ascontiguousarray(engine.real(body.X_tree.E).T).ravel())
        m, c, I = engine.mass_properties(body)
        full = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
        lines = [
            f'<body name="body{k}" pos="{_numbers(body.X_tree.r)}" quat="{_numbers(turn)}">',
            f'<inertial pos="{_numbers(c)}" mass="{m!r}" fullinertia="{_numbers(full)}"/>',
        ]
        used = 0
        for j, (kind, axis) in enumerate(MUJOCO_KINDS[body.joint.type]):
            lines.append(
                f'<joint name={quoteattr(f"{k}.{j}")} type="{kind}" axis="{axis}" '
                f'armature="{float(body.rotors[used])!r}"/>'
            )
            used += VELOCITIES[kind]
        return [*lines, *(line for child in below[k] for line in write(child)), "</body>"]

    return "\n".join(
        [
            '<mujoco><compiler angle="radian" inertiafromgeom="false" balanceinertia="false"/>',
            f'<option gravity="{_numbers(model.gravity)}"><flag contact="disable" constraint="disable"/></option>',
            "<worldbody>",
            *(line for k in below[BASE] for line in write(k)),
            "</worldbody></mujoco>",
        ]
    )
