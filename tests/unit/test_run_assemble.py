"""Assembly: levels, what is held, branches against closed forms, gaps of loops that do not close."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli import load_scene, load_scene_text
from robodyn_cli.errors import CapabilityError, GeometryError
from robodyn_cli.report.registry import applicable, draw
from robodyn_cli.results.result import Result
from robodyn_cli.solve.closing.search import halton
from robodyn_cli.works.assemble import assemble
from tests.mechanisms import BENNETT, CONFIGS, SIX_BAR, SLIDER, close


def of(text: str, *overrides: str) -> Result:
    return assemble(load_scene_text("schema: 1\n" + text, overrides=overrides))


def angles(result: Result, joint: str) -> np.ndarray:
    return np.array([branch["configuration"][joint] for branch in result.summary["branches"]])


def same(found: np.ndarray, expected: np.ndarray) -> None:
    """Fail unless the rows are the same modulo whole turns, in any order."""
    assert len(found) == len(expected)
    for row in expected:
        away = np.abs((found - row + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
        assert away.min() < 1e-10


def dyads(first: np.ndarray, second: np.ndarray, r1: float, r2: float) -> list[np.ndarray]:
    """Return the points at distances r1 and r2 from two points of the plane."""
    d = second - first
    length = float(np.linalg.norm(d))
    along = (length**2 + r1**2 - r2**2) / (2 * length)
    high = r1**2 - along**2
    if high < 0.0:
        return []
    across = np.array([-d[1], d[0]]) / length * np.sqrt(high)
    return [first + along * d / length + side * across for side in (1, -1)]


def test_levels_and_what_is_held() -> None:
    result = of(SLIDER, "initial.qd={crank: 2}")
    summary = result.summary
    assert summary["held"] == ["crank"] and summary["solved"] == ["rod", "slide"]
    assert max(summary["residual"].values()) < 1e-13 and set(summary["residual_by_loop"]) == {"pin"}
    # x' = -r sin(q) q' - ... of the slider-crank
    r, l, q, w = 0.3, 0.9, 0.2, 2.0
    tilt = np.arcsin(-r * np.sin(q) / l)
    turn = -r * np.cos(q) / (l * np.cos(tilt)) * w
    assert summary["rates"]["slide"] == pytest.approx(-r * np.sin(q) * w - l * np.sin(tilt) * turn, abs=1e-13)
    assert applicable(result) == ["mechanism"]


def test_a_loop_that_binds_nothing() -> None:
    """A plane in which the arm moves anyway: no row of the closure has a say."""
    result = of(
        """
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1]}
    - {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [1, 0, 0]}}
  links:
    - {name: l, mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.1}}
    - {name: m, mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.1}}
loops: [{name: table, type: planar, between: [base.origin, m.com], axis: [0, 0, 1]}]
initial: {q: {a: 0.2, b: 0.3}}
"""
    )
    assert result.summary["configuration"] == {"a": 0.2, "b": 0.3}
    assert set(result.summary["residual"].values()) == {0.0}
    assert result.summary["mobility"]["actual"] == 2


def test_branches_of_planar_mechanisms_are_complete() -> None:
    """Each dyad closes in two ways; the squeezer has three of them, whose circles do not always meet."""
    slider = of(SLIDER, "assemble.branches=true")
    tilt = np.arcsin(-0.3 * np.sin(0.2) / 0.9)
    x = [0.3 * np.cos(0.2) + side * 0.9 * np.cos(tilt) for side in (1, -1)]
    close(np.sort(angles(slider, "slide")), np.sort(x), 1e-12)
    pin = np.array([0.4 * np.cos(1.0), 0.4 * np.sin(1.0)])
    expected = []
    for end in dyads(pin, np.array([1.0, 0.0]), 1.2, 0.9):
        c1, rocker = np.arctan2(*(end - pin)[::-1]) - 1.0, np.arctan2(*(end - [1.0, 0.0])[::-1])
        for far in dyads(end, np.array([2.1, 0.0]), 1.1, 0.8):
            turn, out = np.arctan2(*(far - end)[::-1]), np.arctan2(*(far - [2.1, 0.0])[::-1])
            expected.append([1.0, c1, rocker, turn - rocker, out])
    result = of(SIX_BAR, "assemble.branches=true")
    assert len(expected) in (2, 4)
    same(result["branches/q"], np.array(expected))
    assert result.summary["branches"][0]["chosen"] and not result.summary["branches"][1]["chosen"]
    assert np.all(result["branches/determinant"] != 0.0)
    signs = {branch["orientation"] for branch in result.summary["branches"]}
    assert signs == {1, -1}
    assert len(draw(result, "branches").axes) == len(expected) and "branches" in applicable(result)


def test_branches_of_redundant_and_spatial_loops() -> None:
    bennett = of(BENNETT, "assemble.branches=true")
    assert bennett.summary["redundant_rows"] and len(bennett.summary["branches"]) == 1
    assert bennett.summary["branches"][0]["orientation"] is None
    scene = load_scene(CONFIGS / "benchmarks" / "spatial_slider_crank.yaml", ["assemble.branches=true"])
    spatial = assemble(scene)
    x = np.sqrt(0.3**2 - 0.1**2 - 0.2**2)
    # the slider to either side, and the universal joint's two ways to point the rod
    assert set(np.round(angles(spatial, "x"), 12)) == {round(x, 12), round(-x, 12)}
    assert len(spatial.summary["branches"]) == 4


def test_what_cannot_close_says_which_and_by_how_much() -> None:
    with pytest.raises(GeometryError, match=r"'pin' does not close .*: at best a gap of 0\.1") as caught:
        of(SLIDER, "initial={q: {crank: 0, slide: 1.3}, hold: [crank, slide]}")
    assert caught.value.exit_code == 5 and caught.value.details["gap"] == pytest.approx(0.1)
    with pytest.raises(CapabilityError, match="hold 1 more"):
        of(SLIDER, "assemble.branches=true", "initial.hold=[]")
    with pytest.raises(CapabilityError, match="this scene has none"):
        assemble(load_scene(CONFIGS / "double_pendulum.yaml"))


def test_halton_points_fill_the_cube() -> None:
    points = halton(600, 3)
    assert points[:3, 0].tolist() == [0.5, 0.25, 0.75] and points[0].tolist() == [1 / 2, 1 / 3, 1 / 5]
    for low in np.ndindex(3, 3, 3):
        inside = np.all((points * 3 >= low) & (points * 3 < np.array(low) + 1), axis=1)
        assert abs(inside.sum() - 600 / 27) < 8


def test_branches_of_the_squeezer() -> None:
    """Three dyads, and the point E decides whether the circles of the other two meet (Andrews' squeezer)."""
    beta = -0.0617138900142764
    overrides = ["assemble.branches=true", "initial.hold=[beta]", f"initial.q.beta={beta}"]
    result = assemble(load_scene(CONFIGS / "benchmarks" / "andrews.yaml", overrides))
    crank, ground = 0.007 * np.array([np.cos(beta), np.sin(beta)]), np.array([-0.06934, -0.00227])
    expected = 0
    for end in dyads(crank, np.array([-0.03635, 0.03273]), 0.028, 0.035):
        expected += len(dyads(ground, end, 0.04, 0.02)) ** 2
    assert len(result.summary["branches"]) == expected > 2
    assert max(branch["residual"] for branch in result.summary["branches"]) < 1e-12
