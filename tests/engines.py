"""The model in other engines: Pinocchio and MuJoCo, for tests and benchmarks.

Both order joint coordinates in their own way; ``index`` maps, so that arrays on our side keep our order.
"""

from __future__ import annotations

import dataclasses
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.over.crosscheck.engine import depth_first, mass_properties, real

Array = NDArray[np.float64]


def children(model: Model) -> dict[int, list[int]]:
    """Return the bodies that hang on each body and on the base."""
    found: dict[int, list[int]] = {k: [] for k in range(BASE, len(model.bodies))}
    for k, body in enumerate(model.bodies):
        found[body.parent].append(k)
    return found


@dataclasses.dataclass
class Foreign:
    """A model of another engine with its workspace.

    index : index[k] is the engine's place of our velocity (and position) coordinate k.
    body : the engine's body (Pinocchio: joint) of each of our bodies.
    """

    model: Any
    data: Any
    index: Array
    body: dict[int, int]

    def to(self, x: Any) -> Array:
        """Return an array (nv,) in the engine's order."""
        out = np.empty(len(self.index))
        out[self.index] = real(x)
        return out

    def ours(self, x: Any) -> Array:
        """Return a vector (nv,), or the columns of a matrix (..., nv), in our order."""
        return real(x)[..., self.index]

    def ours_square(self, x: Any) -> Array:
        """Return a matrix (nv, nv) in our order."""
        return real(x)[np.ix_(self.index, self.index)]


class PinocchioModel(Foreign):
    """A Pinocchio model."""


def to_pinocchio(model: Model) -> PinocchioModel:
    """Build the Pinocchio model of a tree; points, frames and links become operational frames by name.

    Joints go in depth first: Pinocchio's CRBA takes the coordinates of a subtree to be contiguous.
    """
    import pinocchio as pin

    out = pin.Model()
    out.gravity.linear = real(model.gravity)
    kinds = {"revolute": pin.JointModelRZ, "prismatic": pin.JointModelPZ}
    joint = {BASE: 0}
    index = np.zeros(model.nv, dtype=int)
    armature = np.zeros(model.nv)
    for k in depth_first(model):
        body = model.bodies[k]
        X = body.X_tree
        placement = pin.SE3(real(X.E).T, real(X.r))
        joint[k] = out.addJoint(joint[body.parent], kinds[body.joint.type](), placement, body.joint_name)
        m, c, I = mass_properties(body)
        out.appendBodyToJoint(joint[k], pin.Inertia(m, c, I), pin.SE3.Identity())
        index[body.v] = out.idx_vs[joint[k]]
        armature[index[body.v]] = float(body.armature)
    for name, frame in {**model.links, **model.points, **model.frames}.items():
        place = pin.SE3(real(frame.R), real(frame.p))
        out.addFrame(pin.Frame(name, joint[frame.body], 0, place, pin.FrameType.OP_FRAME))
    out.armature = armature
    return PinocchioModel(out, out.createData(), index, joint)


@dataclasses.dataclass
class MujocoModel(Foreign):
    """A MuJoCo model, and the MJCF text that it was compiled from."""

    text: str

    def set_state(self, q: Any, qd: Any) -> None:
        """Set positions and rates, and compute what depends on them."""
        import mujoco

        self.data.qpos[:] = self.to(q)
        self.data.qvel[:] = self.to(qd)
        mujoco.mj_forward(self.model, self.data)


def _numbers(x: Any) -> str:
    return " ".join(repr(float(e)) for e in np.ravel(x))


def _quaternion(R: Array) -> Array:
    import mujoco

    out = np.zeros(4)
    mujoco.mju_mat2Quat(out, np.ascontiguousarray(R).ravel())
    return out


def _mjcf_frames(frames: dict[str, FixedFrame], body: int) -> list[str]:
    return [
        f'<site name={quoteattr(name)} pos="{_numbers(frame.p)}" '
        f'quat="{_numbers(_quaternion(real(frame.R)))}"/>'
        for name, frame in frames.items()
        if frame.body == body
    ]


def to_mjcf(model: Model) -> str:
    """Return the MJCF of a tree without contacts; points, frames and links become sites by name."""
    below = children(model)
    frames = {**model.links, **model.frames, **model.points}

    def write(k: int) -> list[str]:
        body = model.bodies[k]
        X = body.X_tree
        m, c, I = mass_properties(body)
        full = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
        kind = {"revolute": "hinge", "prismatic": "slide"}[body.joint.type]
        return [
            f'<body name="body{k}" pos="{_numbers(X.r)}" quat="{_numbers(_quaternion(real(X.E).T))}">',
            f'<inertial pos="{_numbers(c)}" mass="{m!r}" fullinertia="{_numbers(full)}"/>',
            f'<joint name={quoteattr(body.joint_name)} type="{kind}" axis="0 0 1" '
            f'armature="{float(body.armature)!r}"/>',
            *_mjcf_frames(frames, k),
            *[line for child in below[k] for line in write(child)],
            "</body>",
        ]

    lines = [
        '<mujoco><compiler angle="radian" inertiafromgeom="false" balanceinertia="false"/>',
        f'<option gravity="{_numbers(model.gravity)}"><flag contact="disable" energy="enable"/></option>',
        "<worldbody>",
        *_mjcf_frames(frames, BASE),
        *[line for k in below[BASE] for line in write(k)],
        "</worldbody></mujoco>",
    ]
    return "\n".join(lines)


def to_mujoco(model: Model) -> MujocoModel:
    """Build the MuJoCo model of a tree."""
    import mujoco

    text = to_mjcf(model)
    out = mujoco.MjModel.from_xml_string(text)
    index = np.zeros(model.nv, dtype=int)
    body = {BASE: 0}
    for k, b in enumerate(model.bodies):
        index[b.v] = out.joint(b.joint_name).dofadr[0]
        body[k] = out.body(f"body{k}").id
    return MujocoModel(out, mujoco.MjData(out), index, body, text)
