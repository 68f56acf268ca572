"""Random robots with random paths that are to be run through in the least time."""

from __future__ import annotations

import dataclasses

import numpy as np

from robodyn_cli import load_scene_text
from robodyn_cli.ready.doors import along
from robodyn_cli.scene.types import Scene
from robodyn_cli.torques.build import build_inverse
from robodyn_cli.torques.dynamics import InverseDynamics
from tests.random_models import random_inertia, random_rotation

EASE = (1.3, 4.0)  # limits of effort over the largest torque that a slow motion on the path needs


def random_path(seed: int) -> Scene:
    """Return an arm of 2 to 7 joints, some of them slides, with full inertias, and a path in joint space for it.

    Gravity has any direction; some joints have geared rotors and friction, every third arm carries a payload. Efforts
    are limited, in some scenes speeds and accelerations too; the limits allow a slow motion everywhere.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 8))
    frictional = seed % 2 == 1
    text = "schema: 1\ngravity: " + _list(rng.normal(size=3) * 6.0) + "\nrobot:\n  joints:\n"
    text += "".join(f"    - {_joint(rng, k, frictional)}\n" for k in range(n))
    text += "  links:\n" + "".join(f"    - {{name: link{k}, {_inertia(rng)}}}\n" for k in range(n))
    if seed % 3 == 0:
        text += f"  attach: [{{link: payload, to: link{n - 1}, {_inertia(rng)}}}]\n"
    count = int(rng.integers(2, 6))
    q = np.cumsum(rng.uniform(-0.7, 0.7, (count, n)), axis=0)
    text += "trajectory:\n  type: fastest\n  points:\n"
    text += "".join(f"    - {{q: {_map(row)}}}\n" for row in q) + f"  effort: {_map(np.full(n, 1e6))}\n"
    if rng.random() < 0.6:
        text += f"  speed: {_map(rng.uniform(1.0, 8.0, n))}\n"
    if rng.random() < 0.4:
        text += f"  acceleration: {_map(rng.uniform(5.0, 40.0, n))}\n"
    scene = load_scene_text(text, f"random{seed}.yaml")
    effort = _needed(scene) * rng.uniform(*EASE, n)
    trajectory = dataclasses.replace(
        scene.trajectory, effort={f"q{k}": float(x) for k, x in enumerate(effort)}
    )
    return dataclasses.replace(scene, trajectory=trajectory)


def _needed(scene: Scene) -> np.ndarray:
    """Return the torques (n,) that a slow motion on the path, half a unit of it a second, needs at most."""
    program = build_inverse(along(dataclasses.replace(scene, trajectory=scene.trajectory.way)))
    way = program.plan(program.times(301)).motion
    torques = InverseDynamics(program.problem)
    slow = np.abs(torques(way.q, 0.5 * way.qd, 0.25 * way.qdd)).max(axis=0)
    moving = np.abs(torques(way.q, 0.5 * way.qd, 0.25 * way.qdd + 0.5 * way.qd)).max(axis=0)
    return np.maximum(slow, moving)


def _joint(rng: np.random.Generator, k: int, frictional: bool) -> str:
    kind = "prismatic" if rng.random() < 0.25 else "revolute"
    R = random_rotation(rng)
    text = f"{{name: q{k}, type: {kind}, axis: {_list(rng.normal(size=3))}, "
    text += (
        f"origin: {{xyz: {_list(rng.normal(size=3) * 0.3)}, matrix: [{', '.join(_list(row) for row in R)}]}}"
    )
    if rng.random() < 0.5:
        text += f", gear_ratio: {rng.uniform(-60, 60):.6g}, rotor_inertia: {rng.uniform(0, 2e-4):.6g}"
    if frictional:
        text += f", friction: {{viscous: {rng.uniform(0, 0.6):.6g}, coulomb: {rng.uniform(0.0, 0.4):.6g}, transition_speed: 0.01}}"
    return text + "}"


def _inertia(rng: np.random.Generator) -> str:
    m, com, I = random_inertia(rng)
    entries = {"xx": I[0, 0], "yy": I[1, 1], "zz": I[2, 2], "xy": I[0, 1], "xz": I[0, 2], "yz": I[1, 2]}
    inertia = ", ".join(f"{key}: {float(x)!r}" for key, x in entries.items())
    return f"mass: {float(m)!r}, com: {_list(com)}, inertia: {{{inertia}}}"


def _list(x: np.ndarray) -> str:
    return "[" + ", ".join(repr(float(v)) for v in x) + "]"


def _map(x: np.ndarray) -> str:
    return "{" + ", ".join(f"q{k}: {float(v)!r}" for k, v in enumerate(x)) + "}"
