"""Robots in MJCF with every frame turned and off, and what MuJoCo's own terms say of them with hard constraints.

Accelerations are those of the null space of MuJoCo's Jacobian, on its mass matrix, bias and passive forces; the rate of the
Jacobian is its difference along the motion. None of it is the program's.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from robodyn_cli import simulate
from robodyn_cli.scene.descriptions import load_description
from robodyn_cli.scene.load import load_scene
from tests.numeric import first_derivative

HINGE, FREE, BALL = (int(getattr(mujoco.mjtJoint, f"mjJNT_{x}")) for x in ("HINGE", "FREE", "BALL"))
OFF = ("CONTACT", "LIMIT", "FRICTIONLOSS")


def inertial(k: int = 0) -> str:
    """Return an <inertial> with all of its numbers."""
    return (
        f'<inertial pos="{0.1 + 0.01 * k} 0.02 -0.03" mass="{1.5 + 0.1 * k}" '
        'fullinertia="0.1 0.12 0.14 0.01 -0.02 0.015"/>'
    )


class Mujoco:
    """A model in MuJoCo with hard equalities."""

    def __init__(self, path: Path) -> None:
        self.m = mujoco.MjModel.from_xml_path(str(path))
        self.m.opt.jacobian = int(mujoco.mjtJacobian.mjJAC_DENSE)
        for name in OFF:
            self.m.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
        self.d = mujoco.MjData(self.m)

    def forward(self, q: np.ndarray, v: np.ndarray) -> None:
        self.d.qpos[:], self.d.qvel[:] = q, v
        mujoco.mj_forward(self.m, self.d)

    def rows(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals and the Jacobian of the equalities."""
        self.forward(q, np.zeros(self.m.nv))
        ties = [k for k in range(self.d.nefc) if self.d.efc_type[k] == 0]
        return self.d.efc_pos[ties].copy(), self.d.efc_J.reshape(-1, self.m.nv)[ties].copy()

    def moved(self, q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        new = q.copy()
        mujoco.mj_integratePos(self.m, new, v, t)
        return new

    def state(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a random state on the equalities."""
        rng = np.random.default_rng(seed)
        q = self.moved(self.m.qpos0, rng.uniform(-0.4, 0.4, self.m.nv), 1.0)
        for _ in range(60):
            gap, J = self.rows(q)
            if len(gap):
                q = self.moved(q, -np.linalg.pinv(J, 1e-9) @ gap, 1.0)
        assert np.abs(self.rows(q)[0]).max(initial=0.0) < 1e-13
        return q, self.null(self.rows(q)[1]) @ rng.uniform(-1, 1, self.null(self.rows(q)[1]).shape[1])

    @staticmethod
    def null(J: np.ndarray) -> np.ndarray:
        if not len(J):
            return np.eye(J.shape[1])
        _, s, V = np.linalg.svd(J)
        return V[int((s > 1e-9 * s[0]).sum()) :].T

    def accelerations(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the accelerations (nv,) with equalities that hold exactly."""
        J = self.rows(q)[1]
        rate = first_derivative(lambda t: self.rows(self.moved(q, v, t))[1] @ v, 1e-2)
        self.forward(q, v)
        M = np.zeros((self.m.nv, self.m.nv))
        for k, unit in enumerate(np.eye(self.m.nv)):
            mujoco.mj_mulM(self.m, self.d, M[k], unit)
        force = self.d.qfrc_passive - self.d.qfrc_bias
        own = -np.linalg.pinv(J, 1e-9) @ rate if len(J) else np.zeros(self.m.nv)
        Z = self.null(J)
        return own + Z @ np.linalg.solve(Z.T @ M @ Z, Z.T @ (force - M @ own))

    # -- as the program counts --------------------------------------------------------------------------
    def ours(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> dict[str, list[np.ndarray]]:
        """Return position, velocity and acceleration of each joint as the program counts them."""
        m, states = self.m, {}
        for j in range(m.njnt):
            name = m.joint(j).name
            p, k, kind = m.jnt_qposadr[j], m.jnt_dofadr[j], m.jnt_type[j]
            if kind == FREE:
                states[name] = free_state(m.qpos0[p : p + 7], q[p : p + 7], v[k : k + 6], a[k : k + 6])
            elif kind == BALL:
                states[name] = [q[p : p + 4], v[k : k + 3], a[k : k + 3]]
            else:
                states[name] = [q[p : p + 1] - m.qpos0[p], v[k : k + 1], a[k : k + 1]]
        return states


def rotation(quaternion: np.ndarray) -> np.ndarray:
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, quaternion / np.linalg.norm(quaternion))
    return R.reshape(3, 3)


def free_state(at: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> list[np.ndarray]:
    """Return the state of a free body from its pose in the file on, with velocities along the body's axes."""
    back, turned = at[3:] * [1, -1, -1, -1], np.zeros(4)
    mujoco.mju_mulQuat(turned, back, q[3:])
    R = rotation(q[3:])
    linear = R.T @ v[:3]
    moved = rotation(at[3:]).T @ (q[:3] - at[:3])
    return [
        np.concatenate([moved, turned]),
        np.concatenate([linear, v[3:]]),
        np.concatenate([R.T @ a[:3] - np.cross(v[3:], linear), a[3:]]),
    ]


def compared(path: Path, seed: int = 1, robot: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the accelerations by the program and by MuJoCo at a random state on the loops."""
    peer = Mujoco(path)
    q, v = peer.state(seed)
    moving = {joint.name for joint in load_description(path)[1].robot.joints if joint.type != "fixed"}
    states = {k: x for k, x in peer.ours(q, v, peer.accelerations(q, v)).items() if k in moving}
    scene = path.with_name("scene.yaml")
    start = [{name: _plain(x[k]) for name, x in states.items()} for k in (0, 1)]
    tree = {
        "schema": 1, "gravity": [float(x) for x in peer.m.opt.gravity], "robot": robot or path.name,
        "initial": {"q": start[0], "qd": start[1]}, "simulate": {"duration": 1e-4, "samples": 2},
    }  # fmt: skip
    scene.write_text(yaml.safe_dump(tree, sort_keys=False))
    own = np.array(simulate(load_scene(scene))["qdd"])[0]
    return own, np.concatenate([x[2] for x in states.values()])


def _plain(x: np.ndarray) -> Any:
    return float(x[0]) if len(x) == 1 else [float(y) for y in x]
