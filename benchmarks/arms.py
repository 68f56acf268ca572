"""The arms of the benchmarks: numbers, a scene for robodyn, a model for Pinocchio, and a reference.

An arm is a serial chain of revolute joints in modified D-H (Craig): the joint's frame is that of the link
before, moved by a along x, turned by alpha about x, moved by d along the new z. Nothing here is shared with
robodyn but the text of the scene, so what differs in the results is an error of one or the other.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclasses.dataclass(frozen=True)
class Arm:
    """alpha, a, d, mass (n,); com (n, 3) in the link's frame; inertia (n, 3, 3) about it; gravity (3,)."""

    name: str
    alpha: Array
    a: Array
    d: Array
    mass: Array
    com: Array
    inertia: Array
    gravity: Array

    @property
    def n(self) -> int:
        return len(self.mass)


def planar_2r() -> Arm:
    """The lecture's planar arm; its inertias about x and y do not matter in the plane."""
    inertia = np.array([np.diag([0.5, 1.042, 1.042])] * 2)
    return Arm(
        "planar 2R", np.zeros(2), np.array([0.0, 1.0]), np.zeros(2), np.full(2, 12.456),
        np.array([[0.773, 0.0, 0.0], [0.583, 0.0, 0.0]]), inertia, np.array([0.0, -9.81, 0.0]),
    )  # fmt: skip


def seven_joint_arm() -> Arm:
    """A generic seven-joint arm: spherical shoulder, offset elbow, wrist; full inertias."""
    half = np.pi / 2
    rng = np.random.default_rng(7)
    mass = np.array([4.2, 4.0, 3.2, 2.9, 2.2, 1.6, 0.8])
    com = rng.uniform(-0.1, 0.1, (7, 3))
    return Arm(
        "7-joint arm",
        np.array([0.0, -half, half, half, -half, half, half]),
        np.array([0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088]),
        np.array([0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.107]),
        mass, com, np.array([m * random_inertia(rng) for m in mass]), np.array([0.0, 0.0, -9.81]),
    )  # fmt: skip


def random_chain(n: int, seed: int = 1) -> Arm:
    """A chain with random lengths, twists near 0 and 90 degrees, and full inertias."""
    rng = np.random.default_rng(seed + n)
    half = np.pi / 2
    return Arm(
        f"{n}-joint chain",
        rng.choice([0.0, half, -half], n) + rng.uniform(-0.2, 0.2, n),
        rng.uniform(-0.2, 0.2, n),
        rng.uniform(-0.3, 0.3, n),
        rng.uniform(0.5, 2.0, n),
        rng.uniform(-0.1, 0.1, (n, 3)),
        np.array([random_inertia(rng) for _ in range(n)]),
        np.array([0.0, 0.0, -9.81]),
    )


def random_inertia(rng: np.random.Generator) -> Array:
    """A full inertia that some body of about 1 kg has [kg m^2]."""
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.asarray(turn @ np.diag(rng.uniform(0.010, 0.019, 3)) @ turn.T)


def motion(n: int, samples: int, seed: int = 1) -> tuple[Array, Array, Array]:
    """Return q, qd, qdd (samples, n) of a motion on sines, in column order."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 10.0, samples)[:, None]
    w, phase, size = rng.uniform(0.3, 1.5, n), rng.uniform(0.0, 2 * np.pi, n), rng.uniform(0.3, 1.0, n)
    sine, cosine = np.sin(w * t + phase), np.cos(w * t + phase)
    q, qd, qdd = (np.asfortranarray(size * x) for x in (sine, w * cosine, -w * w * sine))
    return q, qd, qdd


def scene_text(arm: Arm) -> str:
    """Return the arm as a scene of robodyn."""
    lines = ["schema: 1", f"title: {arm.name}", f"gravity: {arm.gravity.tolist()}", "robot:"]
    lines += ["  convention: modified", "  joints:"]
    for k in range(arm.n):
        place = f"a: {float(arm.a[k])!r}, alpha: {float(arm.alpha[k])!r}, d: {float(arm.d[k])!r}"
        lines.append(f"    - {{name: q{k + 1}, type: revolute, {place}}}")
    lines.append("  links:")
    for k in range(arm.n):
        I = arm.inertia[k]
        entries = {"xx": I[0, 0], "yy": I[1, 1], "zz": I[2, 2], "xy": I[0, 1], "xz": I[0, 2], "yz": I[1, 2]}
        inertia = ", ".join(f"{name}: {float(x)!r}" for name, x in entries.items())
        lines.append(
            f"    - {{name: link{k + 1}, mass: {float(arm.mass[k])!r}, com: {arm.com[k].tolist()}, "
            f"com_frame: link, inertia: {{{inertia}}}}}"
        )
    return "\n".join(lines) + "\n"


def placement(arm: Arm, k: int) -> tuple[Array, Array]:
    """Return rotation and origin of joint k's frame at angle 0 in the link before."""
    c, s = np.cos(arm.alpha[k]), np.sin(arm.alpha[k])
    # an exact right angle stays one
    c, s = (0.0 if abs(x) < 1e-15 else x for x in (c, s))
    R = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return R, np.array([arm.a[k], -s * arm.d[k], c * arm.d[k]])


def pinocchio_model(arm: Arm) -> Any:
    """Return the arm as a model of Pinocchio."""
    import pinocchio as pin

    model = pin.Model()
    model.gravity.linear = arm.gravity
    parent = 0
    for k in range(arm.n):
        parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3(*placement(arm, k)), f"q{k + 1}")
        inertia = pin.Inertia(arm.mass[k], arm.com[k], arm.inertia[k])
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return model


# -- reference: Newton-Euler on all samples at once, in extended precision where the machine has it ----------


def newton_euler(arm: Arm, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the joint torques (samples, n) by the recursion of Luh, Walker and Paul in ``longdouble``."""
    real = np.longdouble
    samples = len(q)
    q, qd, qdd = (np.asarray(x, dtype=real) for x in (q, qd, qdd))
    z = np.array([0, 0, 1], dtype=real)
    w = wd = np.zeros((samples, 3), dtype=real)
    acceleration = np.tile(-np.asarray(arm.gravity, dtype=real), (samples, 1))
    turns, offsets, forces, moments = [], [], [], []
    for k in range(arm.n):
        R0, p = (np.asarray(x, dtype=real) for x in placement(arm, k))
        c, s = np.cos(q[:, k]), np.sin(q[:, k])
        turn = np.zeros((samples, 3, 3), dtype=real)  # from the link to the link before
        turn[:, :, 0] = c[:, None] * R0[:, 0] + s[:, None] * R0[:, 1]
        turn[:, :, 1] = c[:, None] * R0[:, 1] - s[:, None] * R0[:, 0]
        turn[:, :, 2] = R0[:, 2]
        acceleration = acceleration + np.cross(wd, p) + np.cross(w, np.cross(w, p))
        acceleration, w, wd = (np.einsum("tij,ti->tj", turn, x) for x in (acceleration, w, wd))
        wd = wd + np.cross(w, qd[:, k, None] * z) + qdd[:, k, None] * z
        w = w + qd[:, k, None] * z
        r, I = np.asarray(arm.com[k], dtype=real), np.asarray(arm.inertia[k], dtype=real)
        force = real(arm.mass[k]) * (acceleration + np.cross(wd, r) + np.cross(w, np.cross(w, r)))
        moments.append(wd @ I + np.cross(w, w @ I) + np.cross(r, force))
        forces.append(force)
        turns.append(turn)
        offsets.append(p)
    tau = np.zeros((samples, arm.n), dtype=real)
    force = moment = np.zeros((samples, 3), dtype=real)
    for k in reversed(range(arm.n)):
        force, moment = force + forces[k], moment + moments[k]
        tau[:, k] = moment[:, 2]
        force, moment = (np.einsum("tij,tj->ti", turns[k], x) for x in (force, moment))
        moment = moment + np.cross(offsets[k], force)
    return tau


def inverse_error(arm: Arm, q: Array, qd: Array, qdd: Array, tau: Array) -> float:
    """Return the largest deviation of torques from the reference over the largest torque."""
    right = newton_euler(arm, q, qd, qdd)
    return float(np.abs(tau - right).max() / np.abs(right).max())


def forward_error(arm: Arm, q: Array, qd: Array, tau: Array, qdd: Array) -> float:
    """Return the largest error of accelerations over the largest acceleration.

    The error is M^-1 times what is missing from the torques, so that no second algorithm for accelerations is
    needed; M's columns are the torques of unit accelerations.
    """
    missing = np.asarray(tau - newton_euler(arm, q, qd, qdd), dtype=float)
    still = dataclasses.replace(arm, gravity=np.zeros(3))
    rest = np.zeros_like(q)
    M = np.zeros((*q.shape, arm.n))
    for k in range(arm.n):
        unit = rest.copy()
        unit[:, k] = 1.0
        M[:, :, k] = newton_euler(still, q, rest, unit)
    error = np.linalg.solve(M, missing[:, :, None])[:, :, 0]
    return float(np.abs(error).max() / np.abs(qdd).max())
