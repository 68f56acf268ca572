"""Exported C beside ``Mechanism`` on random mechanisms: branches, mixed joints, full inertias, springs and friction."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import Mechanism, load_scene_text
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.over.c99.asked_keys import AskedKey
from robodyn_cli.over.c99.folder import export_c
from robodyn_cli.scene.load import Family
from tests.exported_c import ExportedC, needs_compiler, self_test
from tests.random_models import random_inertia

AXES = ("revolute", "prismatic", "helical", "cylindrical", "universal")
KINDS = (*AXES, "spherical", "floating", "planar")


def random_scene(seed: int) -> dict[str, Any]:
    """Return a random tree as the YAML of a scene: a body of each of some kinds of joint, in a random order."""
    rng = np.random.default_rng(seed)
    kinds = list(rng.permutation([k for k in KINDS if k in joint_types]))[:4]
    joints, links = [], []
    for k, kind in enumerate([*kinds, "revolute"]):
        m, c, I = random_inertia(rng)
        joint: dict[str, Any] = {"name": f"j{k}", "type": str(kind)}
        parent = int(rng.integers(-1, k)) if k else -1
        if kind == "floating":
            parent = -1
        joint["parent"] = "base" if parent < 0 else f"l{parent}"
        joint["origin"] = {
            "xyz": rng.normal(size=3).round(3).tolist(),
            "rpy": rng.normal(size=3).round(3).tolist(),
        }
        if kind in ("revolute", "prismatic", "helical", "cylindrical"):
            axis = rng.normal(size=3)
            joint["axis"] = (axis / np.linalg.norm(axis)).tolist()
        if kind == "helical":
            joint["pitch"] = 0.05
        if kind in ("revolute", "prismatic"):
            joint["spring"] = {"stiffness": 3.0 + k, "rest": 0.2}
            joint["friction"] = {"viscous": 0.4, "coulomb": 0.7}
        joints.append(joint)
        inertia = {n: float(I[i, j]) for n, i, j in (
            ("xx", 0, 0), ("yy", 1, 1), ("zz", 2, 2), ("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2)
        )}  # fmt: skip
        links.append({"name": f"l{k}", "mass": float(m), "com": c.tolist(), "inertia": inertia})
    points = {"tip": {"link": f"l{len(kinds)}", "at": rng.normal(size=3).tolist()}}
    return {
        "schema": 1, "gravity": rng.normal(size=3).tolist(),
        "robot": {"joints": joints, "links": links, "points": points},
    }  # fmt: skip


def random_family(seed: int) -> Family:
    import yaml

    return Family.of(load_scene_text(yaml.safe_dump(random_scene(seed), sort_keys=False)))


@needs_compiler
@pytest.mark.parametrize("seed", range(6))
def test_random_mechanisms(seed: int) -> None:
    family = random_family(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name, "c")
        mass = "robot.links.l1.mass"
        export_c(family, [AskedKey(mass), AskedKey("robot.links.l1.inertia.xy")], folder)
        self_test(folder)
        library = ExportedC(folder)
        compare(library, Mechanism(family), seed)
        value = 1.7 * next(link.mass for link in family.own.robot.links if link.name == "l1")
        assert library.set(mass, value) == 0
        compare(library, Mechanism(family.with_values([f"{mass}={value!r}"])), seed)


def compare(library: ExportedC, mechanism: Mechanism, seed: int) -> None:
    """Compare all functions at random states."""
    rng = np.random.default_rng(100 + seed)
    manifold = Manifold(mechanism._problem.model)
    nv = manifold.nv
    for _ in range(5):
        q = manifold.integrate(manifold.neutral(), rng.normal(size=nv))
        qd, x = rng.normal(size=nv), rng.normal(size=nv)
        p, R = mechanism.forward_kinematics("tip", q)
        expected = {
            "mass_matrix": ((q,), mechanism.mass_matrix(q)),
            "coriolis": ((q, qd), mechanism.coriolis(q, qd)),
            "coriolis_torques": ((q, qd), mechanism.coriolis_torques(q, qd)),
            "gravity": ((q,), mechanism.gravity(q)),
            "inverse_dynamics": ((q, qd, x), mechanism.inverse_dynamics(q, qd, x)),
            "forward_dynamics": ((q, qd, x), mechanism.forward_dynamics(q, qd, x)),
            "centre_of_mass": ((q,), mechanism.centre_of_mass(q)),
            "jacobian_tip": ((q,), mechanism.jacobian("tip", q)),
        }
        for function, (given, values) in expected.items():
            (own,) = library.call(function, *given)
            close(own, values, function)
        for own, values in zip(library.call("pose_tip", q), (p, R)):
            close(own, values, "pose_tip")


def close(own: np.ndarray, values: np.ndarray, label: str) -> None:
    # rounding in M^-1 of bodies as light as these is some thousand times that of the others
    assert np.abs(own - values.ravel()).max() <= 1e-11 * max(1.0, np.abs(values).max()), label
