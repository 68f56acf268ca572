"""Every kind of joint against every engine that has it, on branched trees with full inertias.

Pinocchio has all of them (a cylindrical joint as a composite; the planar one with velocities in body axes); MuJoCo all
but the helical one (a free joint with its linear velocity in world axes).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from robodyn_cli.algorithms.aba import aba
from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.energy import gravity_energy, kinetic_energy
from robodyn_cli.algorithms.kinematics import poses, transforms
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.joints.single_axis import Helical
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.spatial.algebra import Transform
from tests.engines import children, depth_first, mass_properties, real
from tests.numeric import assert_close
from tests.random_models import random_tree

WIDE = ("helical", "cylindrical", "universal", "planar", "spherical", "floating")
SEEDS = range(6)
MUJOCO = {
    "revolute": ("hinge", "z"), "prismatic": ("slide", "z"), "cylindrical": ("slide", "z", "hinge", "z"),
    "universal": ("hinge", "z", "hinge", "x"), "planar": ("slide", "x", "slide", "y", "hinge", "z"),
}  # fmt: skip


@dataclasses.dataclass
class State:
    """A random state and torques; floats as our algorithms take them."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray

    def lists(self) -> list[list[float]]:
        return [x.tolist() for x in (self.q, self.v, self.a, self.tau)]


def tree(kinds: tuple[str, ...], seed: int, n: int = 6) -> tuple[Model, State]:
    """A branched tree of these kinds, revolute and prismatic joints among them."""
    rng = np.random.default_rng([seed, len(kinds)])
    plain = random_tree(n, seed, branching=0.4, armature=False)
    bodies, q, v = [], 0, 0
    for k, body in enumerate(plain.bodies):
        joint: Joint = joint_types[kinds[k // 2 % len(kinds)]] if k % 2 == 0 else body.joint
        if joint.type == "helical":
            joint = Helical(float(rng.normal()))
        bodies.append(dataclasses.replace(body, joint=joint, q=q, v=v))
        q, v = q + joint.nq, v + joint.nv
    model = dataclasses.replace(plain, bodies=tuple(bodies), nq=q, nv=v)
    manifold = Manifold(model)
    here = manifold.integrate(manifold.neutral(), rng.normal(size=v))
    return model, State(here, *(rng.normal(size=v) for _ in range(3)))


def check(model: Model, s: State, torques: Any, M: Any, accelerations: Any) -> None:
    """Compare torques, mass matrix and accelerations."""
    q, v, a, tau = s.lists()
    scale = float(np.abs(torques).max()) + 1.0
    assert_close(rnea(model, q, v, a, model.gravity), torques, 2e-13, scale)
    assert_close(crba(model, q), M, 1e-13)
    tolerance = 1e-14 * np.linalg.cond(M) + 1e-13
    assert_close(aba(model, q, v, tau, model.gravity), accelerations, tolerance, np.abs(accelerations).max())


def planar_turn(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# -- Pinocchio ----------------------------------------------------------------------------------------------
@dataclasses.dataclass
class Coordinates:
    """From our coordinates to another engine's, and torques back: v' = T v, a' = T a + b, q' in its own order."""

    q: np.ndarray
    T: np.ndarray
    b: np.ndarray
    place: slice


def pinocchio_coordinates(
    model: Model, joints: dict[int, int], p: Any, s: State
) -> tuple[np.ndarray, list[Any]]:
    q = np.zeros(p.nq)
    found = []
    for k, body in enumerate(model.bodies):
        own, rates = slice(body.q, body.q + body.joint.nq), slice(body.v, body.v + body.joint.nv)
        mine, v = s.q[own], s.v[rates]
        T, b = np.eye(len(v)), np.zeros(len(v))
        if body.joint.quasi:
            mine = np.concatenate([mine[:-4], mine[-3:], mine[-4:-3]])  # scalar last
        elif body.joint.type == "planar":
            T = planar_turn(mine[2]).T
            b = np.cross([0.0, 0.0, -v[2]], T @ v) * [1.0, 1.0, 0.0]
            mine = np.array([mine[0], mine[1], np.cos(mine[2]), np.sin(mine[2])])
        j = joints[k]
        q[p.idx_qs[j] : p.idx_qs[j] + len(mine)] = mine
        found.append((rates, slice(p.idx_vs[j], p.idx_vs[j] + len(v)), T, b))
    return q, found


@pytest.mark.parametrize("kinds", [*((kind,) for kind in WIDE), WIDE[:3], WIDE[3:]], ids=str)
@pytest.mark.parametrize("seed", SEEDS)
def test_pinocchio(kinds: tuple[str, ...], seed: int) -> None:
    pin = pytest.importorskip("pinocchio")
    model, s = tree(kinds, seed)

    def kind(body: Body) -> Any:
        joint = body.joint
        if isinstance(joint, Helical):
            return pin.JointModelHZ(joint.pitch)
        if joint.type == "cylindrical":
            out = pin.JointModelComposite(2)
            out.addJoint(pin.JointModelRZ())
            out.addJoint(pin.JointModelPZ())
            return out
        if joint.type == "universal":
            return pin.JointModelUniversal(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
        names = {"revolute": "RZ", "prismatic": "PZ", "planar": "Planar", "spherical": "Spherical"}
        return getattr(pin, "JointModel" + names.get(joint.type, "FreeFlyer"))()

    p = pin.Model()
    p.gravity.linear = real(model.gravity)
    joints = {BASE: 0}
    for k in depth_first(model):
        body = model.bodies[k]
        placement = pin.SE3(real(body.X_tree.E).T, real(body.X_tree.r))
        joints[k] = p.addJoint(joints[body.parent], kind(body), placement, f"j{k}")
        m, c, I = mass_properties(body)
        p.appendBodyToJoint(joints[k], pin.Inertia(m, c, I), pin.SE3.Identity())
    data = p.createData()
    q, parts = pinocchio_coordinates(model, joints, p, s)
    # one matrix takes our velocities to theirs
    T, b = np.zeros((p.nv, model.nv)), np.zeros(p.nv)
    for mine, theirs, block, rate in parts:
        T[theirs, mine], b[theirs] = block, rate
    pin.forwardKinematics(p, data, q)
    pose = poses(model, transforms(model, s.q.tolist()))
    for k in range(len(model.bodies)):
        assert_close(pose[k].p, data.oMi[joints[k]].translation, 1e-13, 5.0)
        assert_close(pose[k].R, data.oMi[joints[k]].rotation, 1e-13)
    torques = T.T @ pin.rnea(p, data, q, T @ s.v, T @ s.a + b)
    M = pin.crba(p, data, q)
    M = T.T @ (np.triu(M) + np.triu(M, 1).T) @ T
    accelerations = np.linalg.solve(T, pin.aba(p, data, q, T @ s.v, np.linalg.solve(T.T, s.tau)) - b)
    check(model, s, torques, M, accelerations)
    kinetic = pin.computeKineticEnergy(p, data, q, T @ s.v)
    assert_close(kinetic_energy(model, s.q.tolist(), s.v.tolist()), kinetic, 1e-13)
    assert_close(
        gravity_energy(model, s.q.tolist(), model.gravity),
        pin.computePotentialEnergy(p, data, q),
        1e-12,
        50.0,
    )


# -- MuJoCo -------------------------------------------------------------------------------------------------
def mjcf(model: Model) -> str:
    below = children(model)

    def numbers(x: Any) -> str:
        return " ".join(repr(float(e)) for e in np.ravel(x))

    def write(k: int) -> list[str]:
        import mujoco

        body = model.bodies[k]
        m, c, I = mass_properties(body)
        full = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, np.ascontiguousarray(real(body.X_tree.E).T).ravel())
        if body.joint.type == "floating":
            joints = ["<freejoint/>"]
        elif body.joint.type == "spherical":
            joints = ['<joint type="ball"/>']
        else:
            words = MUJOCO[body.joint.type]
            if body.joint.type == "cylindrical":
                words = ("hinge", "z", "slide", "z")
            axes = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
            joints = [f'<joint type="{t}" axis="{axes[x]}"/>' for t, x in zip(words[::2], words[1::2])]
        return [
            f'<body name="body{k}" pos="{numbers(body.X_tree.r)}" quat="{numbers(quat)}">',
            f'<inertial pos="{numbers(c)}" mass="{m!r}" fullinertia="{numbers(full)}"/>', *joints,
            *[line for child in below[k] for line in write(child)], "</body>",
        ]  # fmt: skip

    head = '<mujoco><compiler angle="radian" inertiafromgeom="false" balanceinertia="false"/>'
    option = f'<option gravity="{numbers(model.gravity)}"><flag contact="disable"/></option>'
    lines = [
        head,
        option,
        "<worldbody>",
        *[x for k in below[BASE] for x in write(k)],
        "</worldbody></mujoco>",
    ]
    return "\n".join(lines)


@pytest.mark.parametrize("kind", [kind for kind in WIDE if kind != "helical"])
@pytest.mark.parametrize("seed", SEEDS)
def test_mujoco(kind: str, seed: int) -> None:
    mujoco = pytest.importorskip("mujoco")
    model, s = tree((kind,), seed)
    bodies = list(model.bodies)
    if kind == "floating":  # MuJoCo has free joints on the world only, and their positions there
        bodies = [
            dataclasses.replace(b, X_tree=Transform.identity(), parent=BASE) if b.joint.type == kind else b
            for b in bodies
        ]
        model = dataclasses.replace(model, bodies=tuple(bodies))
    mj = mujoco.MjModel.from_xml_string(mjcf(model))
    data = mujoco.MjData(mj)
    T, b = np.zeros((mj.nv, model.nv)), np.zeros(mj.nv)
    for k, body in enumerate(bodies):
        first = mj.body(f"body{k}").jntadr[0]
        qa, va = mj.jnt_qposadr[first], mj.jnt_dofadr[first]
        own, rates = slice(body.q, body.q + body.joint.nq), slice(body.v, body.v + body.joint.nv)
        data.qpos[qa : qa + body.joint.nq] = s.q[own]
        block = np.eye(body.joint.nv)
        if kind == body.joint.type == "floating":
            R = real(body.joint.transform(s.q[own]).E).T
            block[:3, :3] = R
            v = s.v[rates]
            b[va : va + 3] = R @ np.cross(v[3:], v[:3])
        T[va : va + body.joint.nv, rates] = block
    data.qvel[:] = T @ s.v
    data.qacc[:] = T @ s.a + b
    mujoco.mj_forward(mj, data)
    M = np.zeros((mj.nv, mj.nv))
    for row, unit in zip(M, np.eye(mj.nv)):
        mujoco.mj_mulM(mj, data, row, unit)
    bias = T.T @ data.qfrc_bias
    M_ours = T.T @ M @ T
    torques = M_ours @ s.a + T.T @ (M @ b) + bias
    accelerations = np.linalg.solve(M_ours, s.tau - bias - T.T @ (M @ b))
    check(model, s, torques, M_ours, accelerations)
