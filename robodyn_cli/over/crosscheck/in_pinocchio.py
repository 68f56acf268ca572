"""The tree of a mechanism in Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.over.crosscheck.engine import (
    MISSING,
    PeerEngine,
    PeerPlace,
    depth_first,
    mass_properties,
    real,
    refuse_joint,
)
from robodyn_cli.spatial.algebra import Array

XYZW = (1, 2, 3, 0)  # places of x, y, z, w among w, x, y, z


def _composite(pin: Any, *parts: Any) -> Any:
    found = pin.JointModelComposite()
    for part in parts:
        found.addJoint(part)
    return found


# by our joint: Pinocchio's, and where each of its positions is among ours
KINDS: dict[str, tuple[Callable[[Any, Any], Any], tuple[int, ...]]] = {
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


class InPinocchio(PeerEngine):
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
            raise CapabilityError(MISSING.format("Pinocchio", "pinocchio")) from None
        super().__init__(model)
        self.pin, self.version = pin, pin.__version__
        out = pin.Model()
        out.gravity.linear = real(model.gravity)
        self.joint = {BASE: 0}
        rotors = np.zeros(model.nv)
        for k in depth_first(model):
            body = model.bodies[k]
            if body.joint.type not in KINDS:
                raise refuse_joint("Pinocchio", body, tuple(KINDS))
            make, places = KINDS[body.joint.type]
            placement = pin.SE3(real(body.X_tree.E).T, real(body.X_tree.r))
            at = out.addJoint(self.joint[body.parent], make(pin, body.joint), placement, body.joint_name)
            m, c, I = mass_properties(body)
            out.appendBodyToJoint(at, pin.Inertia(m, c, I), pin.SE3.Identity())
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

    def place(self, q: Array, v: Array, frame: FixedFrame) -> PeerPlace:
        pin, joint = self.pin, self.joint[frame.body]
        at = self.pin.SE3(real(frame.R), real(frame.p))
        here, rates = self._to(q, v)
        pin.computeJointJacobians(self.model, self.data, here)
        pin.forwardKinematics(self.model, self.data, here, rates, np.zeros(self.size))
        local = pin.Frame("", joint, 0, at, pin.FrameType.OP_FRAME)
        pose = self.data.oMi[joint] * local.placement
        axes = pin.LOCAL_WORLD_ALIGNED
        J = pin.getFrameJacobian(self.model, self.data, joint, at, axes)
        velocity = pin.getFrameVelocity(self.model, self.data, joint, at, axes)
        drift = pin.getFrameClassicalAcceleration(self.model, self.data, joint, at, axes)
        return PeerPlace(
            pose.translation.copy(),
            pose.rotation.copy(),
            self.in_our_order(np.concatenate([J[3:], J[:3]])),
            np.concatenate([drift.angular, drift.linear]),
            velocity.angular.copy(),
        )
