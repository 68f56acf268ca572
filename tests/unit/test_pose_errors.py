"""Errors of positions that reach a pose cover what fifty digits tell of arms at random, near singular poses too."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from robodyn_cli.errors import GeometryError
from robodyn_cli.scene import load_scene_text
from robodyn_cli.works.reach import reach
from tests.pose_oracle import KINDS, Arm

SINGULAR = ("almost straight", "spherical wrist", "three parallel")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(12))
def test_errors_cover_what_many_digits_tell(seed: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    singular = 10.0 ** -rng.uniform(1.0, 8.0) if kind in SINGULAR else 0.0
    arm = Arm(rng, KINDS[kind], kind, singular)
    try:
        summary = reach(load_scene_text(arm.scene())).summary
    except GeometryError:
        pytest.skip("rounding puts the target out of reach")
    chosen = [x["configuration"] for x in summary.get("branches", []) if x["chosen"]]
    assert len(chosen) == ("branches" in summary)
    assert not chosen or list(chosen[0].values()) == pytest.approx(
        list(summary["configuration"].values()), abs=1e-6
    )
    found = [(summary["configuration"], summary["error_estimate"]["configuration"])]
    found += [(x["configuration"], x["errors"]) for x in summary.get("branches", []) if x["reached"]]
    for q, off in found:
        true = arm.exact(list(q.values()))
        for name, exact in zip(q, true):
            assert abs(float(mp.mpf(q[name]) - exact)) <= off[name], (kind, name, q[name], off[name])
        # steps end where 1e-13 is left
        assert summary["singular_ratio"] < 1e-7 or max(off.values()) < 1e-4


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


def test_a_stretched_arm_is_off_by_the_root_of_rounding() -> None:
    for short in (1e-4, 1e-8, 1e-10, 1e-12, 1e-14, 4.4e-16, 0.0):
        stretched(2.0 - short)


def stretched(x: float) -> None:
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
        arm = Arm(np.random.default_rng(3), "rrr", "plane")
    summary = reach(load_scene_text(arm.scene())).summary
    assert summary["freedom"] == 1 and 0.0 < max(summary["error_estimate"]["configuration"].values()) < 1e-11
