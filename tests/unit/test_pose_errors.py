"""Errors of positions that reach a pose cover what fifty digits tell of arms at random, near singular poses too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mpmath as mp
import numpy as np
import pytest
import yaml

from robodyn_cli.errors import GeometryError
from robodyn_cli.scene import load_scene_text
from robodyn_cli.works.reach import reach


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
    """Joints about z of frames at random, a tool behind the last; a target near some positions."""

    def __init__(self, rng: np.random.Generator, joints: int, planar: bool, near_singular: bool) -> None:
        self.joints, self.planar = joints, planar
        self.places = rng.uniform(-0.8, 0.8, (joints, 3))
        self.turns = rng.uniform(-3.0, 3.0, (joints, 3))
        self.tool = rng.uniform(0.1, 0.5, 3)
        q = rng.uniform(-2.5, 2.5, joints)
        if planar:
            self.places[:, 1:], self.turns[:], self.tool[1:] = 0.0, 0.0, 0.0
            self.places[0], self.places[1:, 0] = 0.0, rng.uniform(0.2, 0.9, joints - 1)
            if near_singular:  # the last joint almost straight
                q[-1] = 10.0 ** -rng.uniform(1.0, 8.0)
        self.start = q + rng.uniform(-0.05, 0.05, joints)
        p, R = self.pose([mp.mpf(x) for x in q])
        self.position = [float(x) for x in p]
        pitch = -mp.asin(R[2, 0])
        self.rpy = [float(x) for x in (mp.atan2(R[2, 1], R[2, 2]), pitch, mp.atan2(R[1, 0], R[0, 0]))]

    def pose(self, q: Sequence[Any]) -> tuple[Any, Any]:
        p, R = mp.zeros(3, 1), mp.eye(3)
        for angle, place, own in zip(q, self.places, self.turns):
            p += R * mp.matrix([mp.mpf(x) for x in place])
            R = R * rotation([mp.mpf(x) for x in own]) * turn("z", angle)
        return p + R * mp.matrix([mp.mpf(x) for x in self.tool]), R

    def scene(self) -> str:
        names = [f"j{k}" for k in range(self.joints)]
        frames = [{"xyz": p.tolist(), "rpy": t.tolist()} for p, t in zip(self.places, self.turns)]
        target: dict[str, Any] = {"frame": "tip", "position": self.position}
        target |= {"components": "xy"} if self.planar else {"orientation": {"rpy": self.rpy}}
        return yaml.safe_dump({
            "schema": 1, "gravity": [0, 0, 0],
            "robot": {
                "joints": [{"name": x, "type": "revolute", "axis": [0, 0, 1], "origin": o} for x, o in zip(names, frames)],
                "links": [{"name": f"l{k}"} for k in range(self.joints)],
                "points": {"tip": {"link": f"l{self.joints - 1}", "at": self.tool.tolist()}},
            },
            "initial": {"q": dict(zip(names, self.start.tolist()))}, "reach": target,
        })  # fmt: skip

    def left(self, *q: Any) -> list[Any]:
        """Return what is left of the target."""
        p, R = self.pose(q)
        left = list(p - mp.matrix([mp.mpf(x) for x in self.position]))
        if self.planar:
            return left[:2]
        D = R.T * rotation([mp.mpf(x) for x in self.rpy])
        return [*left, D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]]


@pytest.mark.parametrize("kind", ["six joints", "plane", "almost straight"])
@pytest.mark.parametrize("seed", range(12))
def test_errors_cover_what_many_digits_tell(seed: int, kind: str) -> None:
    with mp.workdps(50):
        arm = Arm(
            np.random.default_rng(seed),
            6 if kind == "six joints" else 2,
            kind != "six joints",
            kind[0] == "a",
        )
    try:
        summary = reach(load_scene_text(arm.scene())).summary
    except GeometryError:
        pytest.skip("rounding puts the target out of reach")
    found = [(summary["configuration"], summary["error_estimate"]["configuration"])]
    found += [(x["configuration"], x["errors"]) for x in summary.get("branches", []) if x["reached"]]
    with mp.workdps(50):
        for q, off in found:
            true = mp.findroot(arm.left, [mp.mpf(x) for x in q.values()], tol=1e-40)
            for name, exact in zip(q, true):
                assert abs(float(mp.mpf(q[name]) - exact)) <= off[name], (kind, name, q[name], off[name])
            assert max(off.values()) < 1e-4  # steps end where 1e-13 is left


REACH = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {{name: a, type: revolute, axis: [0, 0, 1]}}
    - {{name: b, type: revolute, axis: [0, 0, 1], origin: {{xyz: [1, 0, 0]}}}}
  links: [{{name: A}}, {{name: B}}]
  points: {{tip: {{link: B, at: [1, 0, 0]}}}}
initial: {{q: {{a: 0.3, b: 0.2}}}}
reach: {{frame: tip, position: [{x!r}, 0, 0], components: xy}}
"""


@pytest.mark.parametrize("short", [1e-4, 1e-8, 1e-10, 1e-12, 1e-14, 4.4e-16, 0.0])
def test_a_stretched_arm_is_off_by_the_root_of_rounding(short: float) -> None:
    x = 2.0 - short
    summary = reach(load_scene_text(REACH.format(x=x))).summary
    with mp.workdps(50):
        a = mp.acos(mp.mpf(x) / 2)
        for name, true in (("a", a), ("b", 2 * a)):
            off = abs(abs(mp.mpf(summary["configuration"][name])) - true)
            assert off <= summary["error_estimate"]["configuration"][name] < 1e-5
        # J = [[0, -sin b], [..]] of two bars of length 1: both singular values are known
        J = mp.matrix([[0, mp.sin(a)], [2 * mp.cos(a), mp.cos(a)]]) / 2
        s = sorted(mp.svd_r(J, compute_uv=False))
        assert abs(mp.mpf(summary["singular_ratio"]) - s[0] / s[1]) <= summary["singular_ratio_error"]


def test_what_a_pose_leaves_free_is_off_by_the_nearest_that_reaches_it() -> None:
    with mp.workdps(50):
        arm = Arm(np.random.default_rng(3), 3, True, False)
    summary = reach(load_scene_text(arm.scene())).summary
    assert summary["freedom"] == 1 and 0.0 < max(summary["error_estimate"]["configuration"].values()) < 1e-11
