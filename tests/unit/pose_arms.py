"""Random arms of the structures that have a closed form, and others, as scenes; targets by Pinocchio."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.scene import load_scene_text
from robodyn_cli.scene.types import Scene
from tests.engines import to_pinocchio

Points = Sequence[np.ndarray]


def unit(rng: np.random.Generator) -> np.ndarray:
    x = rng.normal(size=3)
    return x / np.linalg.norm(x)


def across(h: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    x = np.cross(h, unit(rng))
    return x / np.linalg.norm(x)


def written(x: Sequence[float]) -> str:
    return "[" + ", ".join(repr(float(v)) for v in x) + "]"


def arm(axes: Points, points: Points, flange: np.ndarray, rng: np.random.Generator, **more: str) -> Scene:
    """Return an arm with these axes through these points in its zero position, on a turned and shifted base.

    more : for a joint by number (``j3``), further keys in flow style, ``type: prismatic`` among them.
    """
    joints, last = [], np.zeros(3)
    for k, (h, p) in enumerate(zip(axes, points), start=1):
        keys = {"type": "revolute"} | dict(x.split(": ", 1) for x in more.get(f"j{k}", "").split("; ") if x)
        listed = ", ".join(f"{name}: {value}" for name, value in keys.items())
        place = f"origin: {{xyz: {written(p - last)}}}, axis: {written(h)}"
        joints.append(f"    - {{name: j{k}, {listed}, {place}}}")
        last = p
    links = [
        f"    - {{name: l{k}, mass: {rng.uniform(1, 3)!r}, com: {written(rng.normal(size=3) * 0.1)}, "
        "inertia: {xx: 0.1, yy: 0.12, zz: 0.14, xy: 0.01}}"
        for k in range(1, len(axes) + 1)
    ]
    text = "\n".join(
        [
            "schema: 1",
            "gravity: [0, 0, -9.81]",
            "robot:",
            f"  base: {{xyz: {written(rng.normal(size=3))}, rpy: {written(rng.normal(size=3))}}}",
            "  joints:",
            *joints,
            "  links:",
            *links,
            "  frames:",
            f"    flange: {{link: l{len(axes)}, at: {written(flange - last)}, rpy: {written(rng.normal(size=3))}}}",
        ]
    )
    return load_scene_text(text + "\n")


def spherical_wrist(rng: np.random.Generator) -> Scene:
    """Offsets everywhere, axes in any direction but for the second and third, which are parallel or opposite."""
    h1, h2 = unit(rng), unit(rng)
    p = rng.normal(size=(4, 3)) * 0.5
    wrist = [unit(rng) for _ in range(3)]
    points = [p[0], p[1], p[2], *(p[3] + rng.normal() * 0.1 * h for h in wrist)]
    return arm([h1, h2, h2 * rng.choice([-1, 1]), *wrist], points, p[3] + rng.normal(size=3) * 0.2, rng)


def three_parallel(rng: np.random.Generator) -> Scene:
    h1, h2 = unit(rng), unit(rng)
    h5, h6 = unit(rng), unit(rng)
    p = rng.normal(size=(5, 3)) * 0.4
    axes = [h1, h2, h2 * rng.choice([-1, 1]), h2 * rng.choice([-1, 1]), h5, h6]
    points = [p[0], p[1], p[2], p[3], p[4] + 0.1 * h5, p[4] - 0.2 * h6]
    return arm(axes, points, p[4] + rng.normal(size=3) * 0.2, rng)


def parallel_axes(rng: np.random.Generator, turning: int, slide: int | None) -> Scene:
    """Parallel axes, with a slide along them at a place, or none."""
    h, n = unit(rng), turning + (slide is not None)
    more = {} if slide is None else {f"j{slide + 1}": "type: prismatic"}
    axes = [h * rng.choice([-1, 1]) for _ in range(n)]
    return arm(axes, list(rng.normal(size=(n, 3)) * 0.5), rng.normal(size=3), rng, **more)


def general(rng: np.random.Generator, n: int, slides: Sequence[int] = (), limits: str = "") -> Scene:
    """An arm with nothing special about it."""
    more = {
        f"j{k}": "; ".join(
            ["type: prismatic" if k in slides else "type: revolute", *([limits] if limits else [])]
        )
        for k in range(1, n + 1)
    }
    points = np.cumsum(rng.normal(size=(n, 3)) * 0.25, axis=0)
    return arm(
        [unit(rng) for _ in range(n)], list(points), points[-1] + rng.normal(size=3) * 0.1, rng, **more
    )


class Oracle:
    """Poses of a frame by Pinocchio, in the world."""

    def __init__(self, model: object, frame: str) -> None:
        self.model, self.frame = model, frame
        self.other = to_pinocchio(model)  # type: ignore[arg-type]

    def __call__(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        import pinocchio as pin

        m, data = self.other.model, self.other.data
        base = self.model.base  # type: ignore[attr-defined]
        E, r = np.array(base.E, dtype=float), np.array(base.r, dtype=float)
        p, R = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
        for k, row in enumerate(q):
            pin.framesForwardKinematics(m, data, self.other.to(row))
            found = data.oMf[m.getFrameId(self.frame)]
            p[k], R[k] = r + E.T @ found.translation, E.T @ found.rotation
        return p, R


def angles(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return the angles (T,) between rotations, accurate for small ones."""
    difference = np.linalg.norm(A - B, axis=(1, 2)) / np.sqrt(8.0)
    return 2.0 * np.arcsin(np.minimum(1.0, difference))
