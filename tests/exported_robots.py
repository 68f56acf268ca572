"""Random robots for exports, with loops that are closed at a pose, and their equations in two descriptions."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.rebuild import Values
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.scene.types import Scene
from tests.random_models import random_inertia

Array = NDArray[np.float64]
GRAVITY = [0.4, -1.3, -9.7]


def numbers(x: Any) -> list[float]:
    return [float(e) for e in np.ravel(x)]


def random_robot(
    rng: np.random.Generator, kinds: tuple[str, ...], acting: tuple[str, ...], n: int = 8
) -> dict[str, Any]:
    """Return a robot of two branches and more: every kind of joint, full inertias, turned frames, D-H parameters.

    acting : of friction, damper, spring, rotor, limits, what joints with one coordinate have.
    """
    joints, links = [], []
    order = [*kinds, *rng.choice(kinds, max(0, n - len(kinds)))]
    for k, kind in enumerate(order):
        parent = "base" if kind == "floating" or k in (0, 1) else f"link{int(rng.integers(0, k))}"
        m, c, I = random_inertia(rng)
        place = {"xyz": numbers(rng.normal(size=3) * 0.4), "rpy": numbers(rng.uniform(-2, 2, 3))}
        joint: dict[str, Any] = {
            "name": f"q{k}",
            "type": str(kind),
            "parent": parent,
            "link": f"link{k}",
            "origin": place,
        }
        if kind in ("revolute", "prismatic") and rng.uniform() < 0.3:
            joint |= {"a": float(rng.normal()), "alpha": float(rng.normal())}
            joint |= {"d": 0.2} if kind == "revolute" else {"theta": 0.3}
        elif joint_types[kind].nv and kind not in ("spherical", "floating"):
            axis = rng.normal(size=3)
            joint["axis"] = numbers(axis)
            if kind in ("universal", "planar"):
                joint["axis2"] = numbers(np.cross(axis, rng.normal(size=3)))
        if kind == "helical":
            joint["pitch"] = 0.07
        if joint_types[kind].nq == 1:
            joint |= {key: x for key, x in _acting(rng).items() if key in acting}
            joint |= {"gear_ratio": -3.0, "rotor_inertia": 0.01} if "rotor" in acting else {}
        if kind == "spherical" and "ball rotor" in acting:
            joint["rotor_inertia"] = 0.03
        joints.append(joint)
        inertia = {a + b: float(I[i, j]) for i, a in enumerate("xyz") for j, b in enumerate("xyz") if j >= i}
        frame = str(rng.choice(["joint", "link"]))
        link = {
            "name": f"link{k}",
            "mass": float(m),
            "com": numbers(c),
            "com_frame": frame,
            "inertia": inertia,
        }
        links.append(link)
    base = {"xyz": [0.1, 0.2, 0.3], "rpy": [0.3, -0.2, 0.5]}
    return {"convention": "standard", "base": base, "joints": joints, "links": links}


def _acting(rng: np.random.Generator) -> dict[str, Any]:
    low, high = -float(rng.uniform(1, 2)), float(rng.uniform(1, 2))
    return {
        "friction": {"viscous": 0.13, "coulomb": 0.21, "law": "set_valued"},
        "damper": {"damping": 0.31},
        "spring": {"stiffness": 2.7, "rest": 0.2},
        "limits": {"lower": low, "upper": high, "speed": 3.1, "effort": 17.3},
    }


def scene_of(robot: dict[str, Any], **more: Any) -> Scene:
    return load_scene_text(
        yaml.safe_dump({"schema": 1, "gravity": GRAVITY, "robot": robot, **more}), "robot.yaml"
    )


def random_q(model: Model, rng: np.random.Generator) -> Array:
    return Manifold(model).integrate(Manifold(model).neutral(), rng.normal(size=model.nv) * 0.6)


def initial(model: Model, q: Array) -> dict[str, Any]:
    """Return positions as ``initial.q``."""
    at = {}
    for body in model.bodies:
        own = q[body.q : body.q + body.joint.nq]
        at[body.joint_name] = float(own[0]) if body.joint.nq == 1 else numbers(own)
    return at


def with_loops(
    robot: dict[str, Any], kinds: tuple[str, ...], rng: np.random.Generator
) -> tuple[dict[str, Any], Array]:
    """Return a robot with one loop of each kind, closed at the positions returned; one of them ends on the ground."""
    scene = scene_of(robot)
    model = Problem(scene).model
    q = random_q(model, rng)
    problem = Problem(scene)
    loops, points = [], {}
    movable = [joint["link"] for joint in robot["joints"] if joint["type"] != "fixed"]
    for k, kind in enumerate(kinds):
        first, second = (str(x) for x in rng.choice(movable, 2, replace=False))
        if k == 0:
            second = "base"
        T = [world(problem, link, q) for link in (first, second)]
        p = T[0] @ [*rng.normal(size=3) * 0.3, 1.0]
        u, w = rng.normal(size=3), rng.normal(size=3)
        u, w = u / np.linalg.norm(u), np.cross(u, w) / np.linalg.norm(np.cross(u, w))
        ends = []
        for i, link in enumerate((first, second)):
            points[f"l{k}_{i}"] = {"link": link, "at": numbers((np.linalg.inv(T[i]) @ p)[:3])}
            ends.append(f"l{k}_{i}")
        loop: dict[str, Any] = {"name": f"loop{k}", "type": kind, "between": ends}
        axes = [numbers(T[0][:3, :3].T @ u), numbers(T[1][:3, :3].T @ (w if kind == "universal" else u))]
        if kind in ("revolute", "planar", "universal"):
            loop |= {"axis": axes[0], "axis2": axes[1]}
        if kind == "prismatic":
            loop["axis"] = axes[0]
        if kind in ("prismatic", "fixed"):
            loop["rpy"] = numbers(Rotation.from_matrix(T[0][:3, :3].T @ T[1][:3, :3]).as_euler("xyz"))
        loops.append(loop)
    return {**robot, "loops": loops, "points": points}, q


def world(problem: Problem, link: str, q: Array) -> Array:
    """Return the pose (4, 4) of a link's frame in base axes."""
    if link == "base":
        return np.eye(4)
    model = problem.model
    frame = model.links[link]
    pose = Values({"t": [0.0], "q": q.tolist(), "v": [0.0] * model.nv, "a": [0.0] * model.nv, "p": []})
    R, p = np.eye(3), np.zeros(3)
    for k in model.path_to(frame.body):
        X = problem.X[k]
        E, r = (np.array(pose.of(list(np.asarray(x, dtype=object).ravel())), dtype=float) for x in (X.E, X.r))
        p, R = p + R @ r, R @ E.reshape(3, 3).T
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R @ np.array(frame.R, dtype=float), p + R @ np.array(frame.p, dtype=float)
    return T


@dataclasses.dataclass
class Equations:
    """M, h, Psi and gamma at a state, and the least acceleration that keeps the loops closed."""

    M: Array
    h: Array
    psi: Array
    gamma: Array

    @staticmethod
    def of(scene: Scene, q: Array, v: Array) -> Equations:
        problem = Problem(scene)
        model = problem.model
        at = Values({"t": [0.0], "q": q.tolist(), "v": v.tolist(), "a": [0.0] * model.nv, "p": []})

        def array(x: Any) -> Array:
            x = np.asarray(x, dtype=object)
            return np.array(at.of(list(x.ravel())), dtype=float).reshape(x.shape)

        rows = problem.constraints.rows
        psi = np.array([array(row.psi) for row in rows]).reshape(len(rows), model.nv)
        h = array(problem.bias) - array(
            sum(problem.passive_forces(smooth=False).values(), np.zeros(model.nv))
        )
        return Equations(
            array(problem.mass_matrix),
            h,
            psi,
            np.array([array(row.gamma) for row in rows], dtype=float).ravel(),
        )

    @property
    def directions(self) -> Array:
        """The projector onto what the loops hold: the same for any rows that say the same."""
        return np.linalg.pinv(self.psi, rcond=1e-9) @ self.psi

    @property
    def drift(self) -> Array:
        return -np.linalg.pinv(self.psi, rcond=1e-9) @ self.gamma
