"""Arms at random with targets near some of their positions, and what fifty digits tell of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import mpmath as mp
import numpy as np
import yaml

DIGITS = 50
# joints by letter: revolute or prismatic along z of its frame
KINDS = {
    "six joints": "rrrrrr",
    "a slide": "rrprrr",
    "spherical wrist": "rrrrrr",
    "three parallel": "rrrrrr",
    "position alone": "rrr",
    "position with a slide": "rpr",
    "plane": "rr",
    "almost straight": "rr",
}


def turn(axis: str, angle: Any) -> Any:
    """Return the rotation about an axis."""
    c, s = mp.cos(angle), mp.sin(angle)
    rows = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    return mp.matrix(rows[axis])


def rotation(rpy: Sequence[Any]) -> Any:
    return turn("z", rpy[2]) * turn("y", rpy[1]) * turn("x", rpy[0])


class Arm:
    """Joints about z of frames at random, a tool behind the last; a target near some positions.

    Parameters
    ----------
    joints : a letter for each. kind : see ``KINDS``. singular : how near a singular pose the target is, as far as the
    kind has one; 0 anywhere.
    """

    def __init__(self, rng: np.random.Generator, joints: str, kind: str, singular: float = 0.0) -> None:
        count = len(joints)
        self.joints, self.planar, self.placed = joints, kind in ("plane", "almost straight"), count < 6
        self.places = rng.uniform(-0.8, 0.8, (count, 3))
        self.turns = rng.uniform(-3.0, 3.0, (count, 3))
        self.tool = rng.uniform(0.1, 0.5, 3)
        q = rng.uniform(-2.5, 2.5, count)
        if kind == "spherical wrist":
            self.places[4:], self.turns[2:4] = 0.0, 0.0
            self.turns[4, 1:], self.turns[5, 1:] = 0.0, 0.0
            self.turns[4, 0], self.turns[5, 0] = 1.5, -1.5
            q[4] = singular or q[4]
        if kind == "three parallel":
            self.turns[2:4] = 0.0
            q[2] = singular or q[2]
        if self.planar:
            self.places[:, 1:], self.turns[:], self.tool[1:] = 0.0, 0.0, 0.0
            self.places[0], self.places[1:, 0] = 0.0, rng.uniform(0.2, 0.9, count - 1)
            q[-1] = singular or q[-1]
        self.start = q + rng.uniform(-0.05, 0.05, count)
        with mp.workdps(DIGITS):
            p, R = self.pose([mp.mpf(x) for x in q])
            self.position = [float(x) for x in p]
            pitch = -mp.asin(R[2, 0])
            self.rpy = [float(x) for x in (mp.atan2(R[2, 1], R[2, 2]), pitch, mp.atan2(R[1, 0], R[0, 0]))]

    def axes(self, q: Sequence[Any]) -> Iterator[tuple[str, Any, Any]]:
        """Yield the letter of each joint, its place and its attitude before it moves; last those of the tool."""
        p, R = mp.zeros(3, 1), mp.eye(3)
        for letter, value, place, own in zip(self.joints, q, self.places, self.turns):
            p += R * mp.matrix([mp.mpf(x) for x in place])
            R = R * rotation([mp.mpf(x) for x in own])
            yield letter, p, R
            if letter == "r":
                R = R * turn("z", value)
            else:
                p = p + R * mp.matrix([0, 0, value])
        yield "", p + R * mp.matrix([mp.mpf(x) for x in self.tool]), R

    def pose(self, q: Sequence[Any]) -> tuple[Any, Any]:
        """Return place and attitude of the tool."""
        *_, (_, p, R) = self.axes(q)
        return p, R

    def scene(self) -> str:
        names = [f"j{k}" for k in range(len(self.joints))]
        frames = [{"xyz": p.tolist(), "rpy": t.tolist()} for p, t in zip(self.places, self.turns)]
        kinds = [{"r": "revolute", "p": "prismatic"}[x] for x in self.joints]
        target: dict[str, Any] = {"frame": "tip", "position": self.position}
        target |= {"components": "xy"} if self.planar else {}
        target |= {} if self.placed else {"orientation": {"rpy": self.rpy}}
        return yaml.safe_dump({
            "schema": 1, "gravity": [0, 0, 0],
            "robot": {
                "joints": [{"name": x, "type": kind, "axis": [0, 0, 1], "origin": o} for x, kind, o in zip(names, kinds, frames)],
                "links": [{"name": f"l{k}"} for k in range(len(names))],
                "points": {"tip": {"link": f"l{len(names) - 1}", "at": self.tool.tolist()}},
            },
            "initial": {"q": dict(zip(names, self.start.tolist()))}, "reach": target,
        })  # fmt: skip

    def left(self, *q: Any) -> list[Any]:
        """Return what is left of the target."""
        p, R = self.pose(q)
        left = list(p - mp.matrix([mp.mpf(x) for x in self.position]))
        if self.placed:
            return left[:2] if self.planar else left
        D = R.T * rotation([mp.mpf(x) for x in self.rpy])
        return [*left, D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]]

    def exact(self, q: Sequence[float]) -> list[Any]:
        """Return the positions near q that reach the target; raises ValueError where there are none."""
        with mp.workdps(DIGITS):
            return list(mp.findroot(self.left, [mp.mpf(x) for x in q], tol=1e-40))

    def singular_ratio(self, q: Sequence[Any], size: float) -> Any:
        """Return the smallest over the largest singular value of what moves the tool, in rad and sizes."""
        with mp.workdps(DIGITS):
            *joints, (_, tip, _) = self.axes(q)
            columns = []
            for letter, p, R in joints:
                z, arm = R[:, 2], (tip - p) / mp.mpf(size)
                moved = [
                    z[1] * arm[2] - z[2] * arm[1],
                    z[2] * arm[0] - z[0] * arm[2],
                    z[0] * arm[1] - z[1] * arm[0],
                ]
                turned = list(z)
                if letter == "p":
                    moved, turned = list(z), [0, 0, 0]
                rows = moved[:2] if self.planar else moved if self.placed else [*moved, *turned]
                columns.append(rows)
            sizes = sorted(mp.svd_r(mp.matrix(columns), compute_uv=False))
            return sizes[0] / sizes[-1]
