"""Kinematic design against closed forms, Kennedy's theorem, rolling centrodes and differences of positions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from robodyn_cli import load_scene_text
from robodyn_cli.errors import CapabilityError, RobodynError, SceneError
from robodyn_cli.over.checks import kinematics as check
from robodyn_cli.report.registry import applicable, draw
from robodyn_cli.results.result import Result
from robodyn_cli.solve.four_bar import FourBar
from robodyn_cli.works.kinematics import kinematics
from tests.mechanisms import SIX_BAR, close

PHASES = (Phase.explicit, Phase.generate)
LINKS = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {{name: crank, type: revolute, axis: [0, 0, 1]}}
    - {{name: rocker, type: revolute, axis: [0, 0, {turn}], parent: base, link: swing, origin: {{xyz: [{d}, 0, 0]}}}}
"""
BAR = """\
    - {{name: coupler, type: revolute, axis: [0, 0, 1], parent: arm, link: bar, origin: {{xyz: [{a}, 0, 0]}}}}
  links: [{{name: arm}}, {{name: swing}}, {{name: bar}}]
  points: {{pin: {{link: bar, at: [{b}, 0, 0]}}, tip: {{link: swing, at: [{c}, 0, 0]}}}}
loops: [{{name: ring, type: {kind}, between: [pin, tip]}}]
"""
ROD = """\
  links: [{{name: arm}}, {{name: swing}}]
  points: {{pin: {{link: arm, at: [{a}, 0, 0]}}, tip: {{link: swing, at: [{c}, 0, 0]}}}}
loops: [{{name: ring, type: distance, between: [pin, tip], length: {b}}}]
"""
MOTION = """
initial: {{q: {{crank: {phi}, rocker: {psi}{more}}}}}
kinematics:
  samples: {samples}
  sweep: {{joint: crank, start: {phi}, stop: {end}, rate: 1}}
  design: {design}
"""
FORMS = {"revolute": BAR, "spherical": BAR, "distance": ROD}


def closed(a: float, b: float, c: float, d: float, phi: float, branch: float = 1.0) -> tuple[float, float]:
    """Return the angles of coupler and rocker of a four-bar: the pin is where two circles meet."""
    x, y = a * math.cos(phi) - d, a * math.sin(phi)
    f = math.hypot(x, y)
    psi = math.atan2(y, x) - branch * math.acos((c * c + f * f - b * b) / (2 * c * f))
    pin = (d + c * math.cos(psi) - a * math.cos(phi), c * math.sin(psi) - y)
    return math.atan2(pin[1], pin[0]), psi


def scene_of(
    lengths: tuple[float, ...], phi: float, end: float, design: str, form: str = "revolute", samples: int = 181,
    turn: int = 1, branch: float = 1.0,
) -> str:  # fmt: skip
    a, b, c, d = lengths
    theta, psi = closed(a, b, c, d, phi, branch)
    more = "" if form == "distance" else f", coupler: {theta - phi!r}"
    values = {
        "a": a, "b": b, "c": c, "d": d, "phi": phi, "psi": turn * psi, "end": end, "more": more, "turn": turn,
        "samples": samples, "design": design, "kind": form,
    }  # fmt: skip
    return (LINKS + FORMS[form] + MOTION).format(**values)


def run(text: str, *overrides: str) -> Result:
    return kinematics(load_scene_text(text, overrides=overrides))


def design(text: str, *overrides: str) -> dict[str, Any]:
    found: dict[str, Any] = run(text, *overrides).summary["design"]
    return found


CRANK_ROCKER = (0.4, 1.2, 0.9, 1.0)
WHOLE = (0.3, 0.3 + 2 * math.pi)

# -- Grashof ---------------------------------------------------------------------------------------------------------
lengths = st.tuples(*[st.floats(0.3, 2.0) for _ in range(4)])


@settings(max_examples=12, deadline=None, phases=PHASES)
@given(lengths, st.floats(0.0, 6.0), st.sampled_from(list(FORMS)), st.sampled_from([1, -1]))
def test_grashof_is_what_circles_say(L: tuple[float, ...], phi: float, form: str, turn: int) -> None:
    """The crank turns fully if the pin closes at all of its angles; the rocker likewise."""
    a, b, c, d = L

    def closes(angle: float, arm: float, other: float) -> bool:
        way = math.hypot(arm * math.cos(angle) - d, arm * math.sin(angle))
        return abs(b - other) <= way <= b + other

    s, *middle, l = sorted(L)
    if abs(s + l - sum(middle)) < 1e-3 or not closes(phi, a, c) or abs(abs(b - c) - abs(a - d)) < 1e-3:
        return
    x = math.hypot(a * math.cos(phi) - d, a * math.sin(phi))
    if min(x - abs(b - c), b + c - x) < 1e-2:
        return
    found = design(scene_of(L, phi, phi + 1e-4, "{grashof: true}", form, 11, turn))["four_bars"]["ring"]
    assert found["grashof"] == (s + l < sum(middle))
    assert found["margin"] == pytest.approx(sum(middle) - s - l, abs=found["margin_error"])
    coupler = "ring" if form == "distance" else "bar"
    assert found["lengths"] == pytest.approx({"arm": a, coupler: b, "swing": c, "base": d})
    angles = np.linspace(0.0, np.pi, 400)
    for joint, arm, other in (("crank", a, c), ("rocker", c, a)):
        turns = all(closes(x, arm, other) for x in angles)
        assert found["joints"][joint]["turns"] == turns
        if not turns:
            _is_dead_point(found["joints"][joint], joint, turn, (arm, b, other, d))
    full = [found["joints"][x]["turns"] for x in ("crank", "rocker")]
    name = "double crank" if all(full) else "crank-rocker" if any(full) else "double rocker"
    assert found["type"] == (name if found["grashof"] else "triple rocker")


def _is_dead_point(joint: dict[str, Any], name: str, turn: int, L: tuple[float, ...]) -> None:
    """In a dead point the two links beyond the joint are in line."""
    arm, b, other, d = L
    for end in ("lower", "upper"):
        angle = joint[end] if name == "crank" else math.pi - turn * joint[end]
        way = math.hypot(arm * math.cos(angle) - d, arm * math.sin(angle))
        slope = arm * d * abs(math.sin(angle)) / way
        off = min(abs(way - b - other), abs(way - abs(b - other)))
        assert off <= joint["error"] * max(slope, joint["error"] * arm) + 1e-12


NAMED = [
    ((0.4, 1.2, 0.9, 1.0), "crank-rocker"), ((1.0, 1.2, 0.9, 0.4), "double crank"),
    ((1.0, 0.4, 0.9, 1.2), "double rocker"), ((0.9, 1.2, 0.4, 1.0), "crank-rocker"),
    ((0.7, 1.0, 0.8, 1.6), "triple rocker"), ((0.5, 1.0, 0.5, 1.0), "change point: parallelogram"),
    ((0.6, 0.6, 1.1, 1.1), "change point: kite"), ((0.4, 1.0, 0.8, 1.4), "change point"),
    ((1.0, 1.0, 1.0, 1.0), "change point: rhombus"),
]  # fmt: skip


@pytest.mark.parametrize(("L", "name"), NAMED)
def test_inversions(L: tuple[float, ...], name: str) -> None:
    """Textbook's chains: whichever link is fixed, the classes are the same four."""
    phi = 1.2
    found = design(scene_of(L, phi, phi + 0.01, "{grashof: true}", samples=11))["four_bars"]["ring"]
    assert found["type"] == name == found["inversions"]["base"]
    kinds = list(found["inversions"].values())
    if found["grashof"]:
        assert sorted(kinds) == ["crank-rocker", "crank-rocker", "double crank", "double rocker"]
    if name.startswith("change point"):
        assert abs(found["margin"]) <= found["margin_error"] < 1e-11


@pytest.mark.parametrize("L", [(0.5, 1.0, 0.5, 1.0), (0.4, 1.0, 0.8, 1.4)])
def test_change_points_are_dead_points(L: tuple[float, ...]) -> None:
    """Where all pins come in line; the error there is the root of what rounding leaves of lengths."""
    crank = design(scene_of(L, 1.2, 1.3, "{grashof: true}", samples=11))["four_bars"]["ring"]["joints"][
        "crank"
    ]
    a, b, c, d = L
    at = [
        0.0 if abs(abs(d - a) - abs(b - c)) < 1e-12 else None,
        math.pi if abs(d + a - b - c) < 1e-12 else None,
    ]
    for angle in at:
        if angle is not None:
            near = [abs(math.remainder(crank[end] - angle, 2 * math.pi)) for end in ("lower", "upper")]
            assert min(near) <= crank["error"] < 1e-5
    assert not crank["turns"] and crank["distance"] > 0.3


SLIDER = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {{name: crank, type: revolute, axis: [0, 0, 1]}}
    - {{name: rod, type: revolute, axis: [0, 0, 1], parent: arm, link: bar, origin: {{xyz: [{a}, 0, 0]}}}}
    - {{name: slide, type: prismatic, axis: [{way}, 0, 0], parent: base, link: block, origin: {{xyz: [0, {e}, 0]}}}}
  links: [{{name: arm}}, {{name: bar}}, {{name: block}}]
  points: {{pin: {{link: bar, at: [{b}, 0, 0]}}}}
loops: [{{name: ring, type: revolute, between: [pin, block.origin]}}]
initial: {{q: {{crank: {phi}, rod: {rod}, slide: {x}}}}}
kinematics:
  samples: 11
  sweep: {{joint: crank, start: {phi}, stop: {end}, rate: 1}}
  design: {{grashof: true}}
"""


@settings(max_examples=12, deadline=None, phases=PHASES)
@given(
    st.floats(0.2, 1.5),
    st.floats(0.2, 1.5),
    st.floats(-0.8, 0.8),
    st.floats(0, 6.2),
    st.sampled_from([1, -1]),
)
def test_slider_cranks(a: float, b: float, e: float, phi: float, way: int) -> None:
    reach = e - a * math.sin(phi)
    if abs(reach) > 0.95 * b or abs(abs(a - b) - abs(e)) < 1e-3:
        return
    x = a * math.cos(phi) + math.sqrt(b * b - reach * reach)
    rod = math.asin(reach / b) - phi
    text = SLIDER.format(a=a, b=b, e=e, way=way, phi=phi, rod=rod, x=way * x, end=phi + 1e-3)
    result = run(text)
    found = result.summary["design"]["four_bars"]["ring"]
    assert found["margin"] == pytest.approx(max(a, b) - min(a, b) - abs(e), abs=1e-12)
    assert found["grashof"] == (found["margin"] > 0)
    turns = all(abs(e - a * math.sin(t)) <= b for t in np.linspace(0, 2 * math.pi, 721))
    joints = found["joints"]
    assert joints["crank"]["turns"] == turns
    assert found["type"] == ("crank and slider" if turns else "rocker and slider")
    assert found["inversions"]["arm"] in ("double crank", "crank-rocker", "triple rocker")
    if not turns:  # the rod is across the slide
        for end in ("lower", "upper"):
            assert abs(e - a * math.sin(joints["crank"][end])) == pytest.approx(b, abs=1e-9)
            assert abs(joints["crank"][end] - phi) < 2 * math.pi
    drawn = result["four_bars/ring"]
    normals = np.cross(drawn[:, 1] - drawn[:, 0], drawn[:, 2] - drawn[:, 0])[:, 2]
    dead = drawn[1:][np.abs(normals[1:]) < 1e-9]  # crank and rod in a line
    ends = [way * (pose[2] - pose[0])[0] for pose in dead]
    assert sorted(map(abs, ends)) == pytest.approx(
        sorted(abs(joints["slide"][x]) for x in ("lower", "upper"))
    )
    sizes = np.linalg.norm(np.diff(drawn[:, :3], axis=1), axis=2)
    np.testing.assert_allclose(sizes, np.broadcast_to(sizes[0], sizes.shape), rtol=1e-9)
    ways = sorted(abs(joints["slide"][end]) for end in ("lower", "upper"))
    assert ways[1] == pytest.approx(math.sqrt((a + b) ** 2 - e * e))
    if abs(a - b) > abs(e):
        assert ways[0] == pytest.approx(math.sqrt((a - b) ** 2 - e * e))


def test_inverted_slider_by_a_pin_in_a_slot() -> None:
    """Whitworth's and the swinging block's mechanism: a point of one arm on the line of another."""
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {{name: crank, type: revolute, axis: [0, 0, 1]}}
    - {{name: slot, type: revolute, axis: [0, 0, 1], parent: base, link: guide, origin: {{xyz: [{d}, 0, 0]}}}}
  links: [{{name: arm}}, {{name: guide}}]
  points: {{pin: {{link: arm, at: [0.5, 0, 0]}}}}
loops: [{{name: ring, type: point_on_line, between: [guide.origin, pin], axis: [1, 0, 0]}}]
initial: {{q: {{crank: 1.0, slot: {psi}}}}}
kinematics: {{samples: 11, sweep: {{joint: crank, start: 1.0, stop: 1.01}}, design: {{grashof: true}}}}
"""
    for d, name in ((0.9, "crank-rocker"), (0.3, "double crank")):
        psi = math.atan2(0.5 * math.sin(1.0), 0.5 * math.cos(1.0) - d)
        found = design(text.format(d=d, psi=psi))["four_bars"]["ring"]
        assert (found["type"], found["offset"]) == (name, pytest.approx(0.0, abs=1e-12))
        assert found["margin"] == pytest.approx(abs(d - 0.5))
        if d > 0.5:  # the slot touches the crank's circle
            swing = math.pi - math.asin(0.5 / d), math.pi + math.asin(0.5 / d)
            assert (found["joints"]["slot"]["lower"], found["joints"]["slot"]["upper"]) == pytest.approx(
                swing
            )
            drawn = run(text.format(d=d, psi=psi))["four_bars/ring"][:, :, :2]
            assert len(drawn) == 3  # the arm is across the slot
            angles = [math.atan2(y, x) % (2 * math.pi) for x, y in drawn[1:, 2] - [d, 0.0]]
            assert sorted(angles) == pytest.approx(sorted(swing))


@settings(max_examples=12, deadline=None, phases=PHASES)
@given(st.integers(0, 10**6), st.sampled_from([0, 3]), st.booleans())
def test_drawn_dead_points_of_chains_with_a_slide(seed: int, fixed: int, backwards: bool) -> None:
    """Links keep their lengths and the slide's line its distance; link 1 is across the slide, both links are in a line,
    or pin 2 is as near to pin 0 as that line."""
    rng = np.random.default_rng(seed)
    way = rng.normal(size=2)
    bar = FourBar(rng.normal(size=(3, 2)), way / np.linalg.norm(way))
    bar = bar.backwards if backwards else bar
    (a, b), e = bar.lengths, abs(bar.offset)
    for pin in (0,) if fixed == 3 else (0, 1):
        theta, between = bar.at_pin(pin)
        for end in (between.low, between.high):
            pose = None if end is None else bar.dead_pose(pin, end.value - theta, fixed, end.outer)
            if pose is None:
                continue
            first, second, slider, foot = pose
            assert np.linalg.norm(second - first) == pytest.approx(a)
            assert np.linalg.norm(slider - second) == pytest.approx(b)
            assert np.linalg.norm(foot - first) == pytest.approx(e)
            assert (slider - foot) @ (foot - first) == pytest.approx(0.0, abs=1e-6)
            np.testing.assert_allclose(
                pose[:1] if fixed == 3 else pose[:2], bar.pins[: 1 if fixed == 3 else 2]
            )
            if pin == 1:
                assert np.linalg.norm(slider - first) == pytest.approx(e)
            else:
                assert (slider - second) @ (slider - foot) == pytest.approx(0.0, abs=1e-6)


def test_six_bar_has_its_four_bars() -> None:
    text = "schema: 1\n" + SIX_BAR
    scene = load_scene_text(text)
    joint = scene.robot.joints[0].name
    start = scene.initial.q[joint]
    found = run(
        text, f"kinematics.sweep={{joint: {joint}, start: {start}, stop: {start + 0.01}}}", "kinematics.samples=11",
        "kinematics.design.grashof=true",
    ).summary["design"]["four_bars"]  # fmt: skip
    assert set(found) <= {loop.name for loop in scene.loops} and found


# -- poles -----------------------------------------------------------------------------------------------------------
PAIRS = "{poles: {ab: [bar, base], cb: [swing, base], aa: [arm, base], ca: [swing, arm], cab: [swing, bar]}}"


@settings(max_examples=5, deadline=None, phases=PHASES)
@given(st.floats(0.3, 2.8), st.sampled_from([CRANK_ROCKER, (1.0, 1.2, 0.9, 0.4), (0.9, 1.2, 0.4, 1.0)]))
def test_kennedys_theorem(phi: float, L: tuple[float, ...]) -> None:
    """The poles of three links lie on a line; four of them are pins."""
    try:
        closed(*L, phi)
        closed(*L, phi + 0.2)
    except ValueError:
        return
    result = run(scene_of(L, phi, phi + 0.2, PAIRS, samples=31))
    pole = {name: result[f"poles/{name}"] for name in ("ab", "cb", "aa", "ca", "cab")}
    close(pole["aa"], 0.0, 1e-12)
    close(pole["cb"], [L[3], 0, 0], 1e-12)
    close(pole["cab"], result["points/pin"], 1e-11)
    crank = np.column_stack([np.cos(result["q"][:, 0]), np.sin(result["q"][:, 0]), np.zeros(31)]) * L[0]

    def area(*three: Any) -> Any:
        one, two, last = (np.broadcast_to(x, (31, 3)) for x in three)
        sizes = np.linalg.norm(two - one, axis=1) * np.linalg.norm(last - one, axis=1)
        return np.cross(two - one, last - one)[:, 2] / sizes

    close(area([0, 0, 0], crank, pole["ab"]), 0.0, 1e-9)  # base, arm, bar
    close(area([L[3], 0, 0], result["points/pin"], pole["ab"]), 0.0, 1e-9)  # base, swing, bar
    close(area([0, 0, 0], [L[3], 0, 0], pole["ca"]), 0.0, 1e-9)  # base, arm, swing


def test_centrodes_roll_on_each_other() -> None:
    """Their parts between samples are as long, whatever the inversion; the ratio is that of the ways to the pole."""
    text = scene_of(
        CRANK_ROCKER, *WHOLE, "{poles: {x: [swing, arm]}, ratios: {out: [rocker, crank]}}", samples=4001
    )
    result = run(text)
    fixed, moving = (
        np.linalg.norm(np.diff(result[f"centrodes/{kind}/x"], axis=0), axis=1) for kind in ("fixed", "moving")
    )
    close(fixed.sum(), moving.sum(), 1e-6 * fixed.sum())
    close(fixed, moving, 1e-5 * fixed.max())
    x = result["poles/x"][:, 0]
    close(result["ratios/out"], x / (x - 1.0), 1e-9)


def test_acceleration_pole_has_no_acceleration() -> None:
    """By differences of the link's positions, which follow from the closure by hand."""
    result = run(scene_of(CRANK_ROCKER, 0.3, 1.4, "{poles: {x: [bar, base]}}", samples=12))
    a, b, c, d = CRANK_ROCKER
    h = 1e-4

    def pose(t: float) -> tuple[Any, float]:
        phi = 0.3 + t
        return a * np.array([math.cos(phi), math.sin(phi)]), closed(a, b, c, d, phi)[0]

    for k in range(1, 11):
        t, pole = float(result.time[k]), result["acceleration_poles/x"][k, :2]
        (p, angle) = pose(t)
        C, S = math.cos(angle), math.sin(angle)
        own = np.array([[C, S], [-S, C]]) @ (pole - p)
        way = []
        for s in (-2, -1, 0, 1, 2):
            p, angle = pose(t + s * h)
            way.append(
                p + np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]) @ own
            )
        w = np.array(way)
        close((-w[0] + 16 * w[1] - 30 * w[2] + 16 * w[3] - w[4]) / (12 * h * h), 0.0, 1e-6)


def test_poles_at_infinity_are_gaps() -> None:
    """The coupler of a parallelogram never turns; of a crank-rocker it turns back twice, where crank and rocker are
    parallel."""
    still = run(scene_of((0.5, 1.0, 0.5, 1.0), 0.4, 2.6, "{poles: {x: [bar, base]}}", samples=51))
    assert np.isnan(still["poles/x"]).all() and still.summary["design"]["unbounded"]["poles/x"]["throughout"]
    result = run(scene_of(CRANK_ROCKER, *WHOLE, "{poles: {x: [bar, base]}}"))
    told = result.summary["design"]["unbounded"]["poles/x"]
    assert len(told["times"]) == 2
    for time in told["times"]:
        phi = 0.3 + time
        psi = closed(*CRANK_ROCKER, phi)[1]
        assert abs(math.sin(phi - psi)) <= 3 * told["error"]
    assert "poles/x.x" not in result.summary["extremes"]
    for one in (still, result):
        for name in applicable(one):
            draw(one, name)


def test_a_start_from_rest_has_poles() -> None:
    text = scene_of(CRANK_ROCKER, 0.3, 1.3, PAIRS, samples=41)
    moved = run(
        text, "kinematics.sweep=null",
        "trajectory={type: cubic, points: [{t: 0, q: {crank: 0.3}}, {t: 1, q: {crank: 1.0}}]}",
    )  # fmt: skip
    steady = run(text)
    close(moved["poles/ab"][0], steady["poles/ab"][0], 1e-8)
    assert np.isfinite(moved["poles/ab"]).all()


# -- points ----------------------------------------------------------------------------------------------------------
def test_curvature_is_that_of_the_path() -> None:
    text = scene_of(CRANK_ROCKER, *WHOLE, "{curves: [trace, pin]}", samples=2001)
    text = text.replace("points: {", "points: {trace: {link: bar, at: [-0.3, 0.4, 0]}, ")
    result = run(text)
    speed = np.linalg.norm(result["point_velocities/pin"], axis=1)
    quick = speed > 0.05 * speed.max()  # rounding grows with the third power of what is slower
    close(np.abs(result["curvatures/pin"][quick]), 1 / 0.9, 1e-10)
    path = result["points/trace"][:, :2]
    first = np.gradient(path, axis=0)
    second = np.gradient(first, axis=0)
    k = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / np.linalg.norm(first, axis=1) ** 3
    close(k[5:-5], result["curvatures/trace"][5:-5], 2e-4 * np.abs(k).max())
    found, coarse = (
        x.summary["extremes"]["curvatures/trace"] for x in (result, run(text, "kinematics.samples=181"))
    )
    off = coarse["errors"]["largest"] + found["errors"]["largest"]
    assert abs(found["largest"] - coarse["largest"]) <= off < 0.1 * found["largest"]


def test_a_cusp_has_no_curvature() -> None:
    """A point of a rolling centrode: where it is the pole, its path has a cusp."""
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0]}, {name: turn, type: revolute, axis: [0, 0, 1]}]
  links: [{name: axle}, {name: wheel}]
  points: {rim: {link: wheel, at: [0.5, 0, 0]}}
trajectory: {type: joint, duration: 8, q: {x: "0.5*t", turn: "-t"}}
kinematics: {samples: 161, design: {curves: [rim], poles: {roll: [wheel, base]}, ratios: {r: [x, turn]}}}
"""
    result = run(text)
    close(result["poles/roll"][:, 1], -0.5, 1e-12)
    close(result["centrodes/fixed/roll"][:, 0], 0.5 * result.time, 1e-12)
    close(np.linalg.norm(result["centrodes/moving/roll"], axis=1), 0.5, 1e-12)
    close(result["ratios/r"], -0.5, 1e-12)
    assert result.variables["ratios/r"].units == "m/rad"
    told = result.summary["design"]["unbounded"]["curvatures/rim"]
    at = [0.5 * math.pi, 2.5 * math.pi]
    assert all(abs(x - y) <= told["error"] for x, y in zip(told["times"], at)) and len(told["times"]) == 2


def test_pressure_angle_is_the_rest_of_the_transmission_angle() -> None:
    text = scene_of(CRANK_ROCKER, *WHOLE, "{pressure: {out: [bar.origin, pin]}}")
    result = run(text, "kinematics.transmission=[bar.origin, pin, swing.origin]")
    angle = np.abs(result["pressure_angles/out"])
    close(angle, np.abs(np.pi / 2 - result["transmission_angle"]), 1e-9)
    most = result.summary["extremes"]["pressure_angles/out"]
    L = np.array(CRANK_ROCKER)
    least = math.acos((L[1] ** 2 + L[2] ** 2 - (L[3] - L[0]) ** 2) / (2 * L[1] * L[2]))
    size = max(abs(most["smallest"]), abs(most["largest"]))
    assert (
        abs(size - (math.pi / 2 - least)) <= max(most["errors"]["smallest"], most["errors"]["largest"]) < 1e-6
    )


def test_dead_points_passed_are_those_of_the_closed_form() -> None:
    text = scene_of(CRANK_ROCKER, *WHOLE, "{grashof: true, ratios: {out: [rocker, crank]}}", turn=-1)
    found = design(text)
    rocker = found["four_bars"]["ring"]["joints"]["rocker"]
    passed = found["dead_points"]["out"]
    assert len(passed) == 2
    for one in passed:
        gap = min(abs(one["first"] - rocker[end]) for end in ("lower", "upper"))
        assert gap <= one["error"] + rocker["error"] and one["error"] < 1e-6
    assert abs(rocker["distance"]) <= rocker["distance_error"] < 1e-6


@settings(max_examples=3, deadline=None, phases=PHASES)
@given(st.floats(0.25, 0.5), st.integers(60, 400))
def test_other_samples_move_no_figure_beyond_its_error(a: float, samples: int) -> None:
    text = scene_of(
        (a, 1.2, 0.9, 1.0), *WHOLE, "{curves: [pin], ratios: {o: [rocker, crank]}, poles: {x: [swing, arm]}}"
    )
    one, other = (run(text, f"kinematics.samples={n}").summary for n in (samples, 2 * samples + 1))
    for name, first in one["extremes"].items():
        second = other["extremes"][name]
        for end in ("smallest", "largest", "final"):
            off = first["errors"][end] + second["errors"][end]
            assert abs(first[end] - second[end]) <= off, (name, end)


# -- what has no meaning ---------------------------------------------------------------------------------------------
REFUSED = [
    ("{poles: {x: [bar, nobody]}}", SceneError, "nobody"),
    ("{poles: {x: [bar, bar]}}", SceneError, "both"),
    ("{ratios: {x: [crank, bar]}}", SceneError, "a joint and a link"),
    ("{ratios: {x: [bar, base]}}", SceneError, "does not turn"),
    ("{curves: [base.origin]}", SceneError, "fixed to the base"),
    ("{curves: [swing.origin]}", CapabilityError, "does not move"),
    ("{pressure: {x: [pin, base.origin]}}", SceneError, "fixed to the base"),
    ("{pressure: {x: [tip, pin]}}", CapabilityError, "'tip' and 'pin' are at one place"),
]  # fmt: skip


@pytest.mark.parametrize(("asked", "kind", "words"), REFUSED)
def test_refusals(asked: str, kind: type[RobodynError], words: str) -> None:
    text = scene_of(CRANK_ROCKER, *WHOLE, asked, samples=11)
    with pytest.raises(kind, match=words) as caught:
        run(text)
    if kind is CapabilityError:  # validate says the same
        with pytest.raises(kind) as again:
            check(load_scene_text(text))
        assert str(again.value) == str(caught.value)


def test_a_transmission_angle_of_points_that_a_loop_joins_is_refused() -> None:
    text = scene_of(CRANK_ROCKER, *WHOLE, "{grashof: true}", samples=11)
    scene = load_scene_text(text, overrides=["kinematics.transmission=[bar.origin, pin, tip]"])
    for command in (kinematics, check):
        with pytest.raises(CapabilityError, match="transmission: 'pin' and 'tip' are at one place"):
            command(scene)


def test_chains_in_space_have_no_class() -> None:
    from tests.mechanisms import BENNETT

    more = ("kinematics={samples: 11, sweep: {joint: j1, start: 1, stop: 1.1}, design: {grashof: true}}",)
    with pytest.raises(CapabilityError, match="no closed chain has four links in a plane"):
        run("schema: 1\n" + BENNETT, *more)
    pair = more[0].replace("grashof: true", "poles: {x: [l1, l2]}")
    links = [link.name for link in load_scene_text("schema: 1\n" + BENNETT).robot.links]
    pair = pair.replace("l1, l2", ", ".join(links[:2]) if len(links) > 1 else "base, base")
    with pytest.raises(CapabilityError, match="do not move in one plane"):
        run("schema: 1\n" + BENNETT, pair.replace(links[0] + ", " + links[1], f"{links[1]}, base"))
