"""Closing the loops at t = 0: from rough guesses to exact configurations, and words for what cannot close."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import load_scene, load_scene_text, simulate
from robodyn_cli.errors import GeometryError, RobodynError, SceneError, SingularConfigurationError
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.solve.closing.assembly import Assembled
from tests.mechanisms import BENNETT, LONG, SIX_BAR, SKEW, SLIDER, TWIST

CONFIGS = Path(__file__).parents[2] / "configs"
CRANK, ROD = 1.241, 1.2


def four_bar(*overrides: str, name: str = "four_bar_deploy") -> Assembled:
    return prepare(load_scene(CONFIGS / f"{name}.yaml", overrides)).assembled


def assembled(text: str, *overrides: str) -> Assembled:
    return prepare(load_scene_text("schema: 1\n" + text, overrides=overrides)).assembled


def failure(*overrides: str, name: str = "four_bar_deploy") -> RobodynError:
    with pytest.raises(RobodynError) as caught:
        four_bar(*overrides, name=name)
    return caught.value


def follower(theta: float, branch: int) -> float:
    """Return phi1 that closes the lecture's four-bar, by the intersection of two circles."""
    elbow = CRANK * np.array([np.cos(theta), np.sin(theta)])
    d = np.array([CRANK, 0.0]) - elbow
    r = float(np.hypot(*d))
    pin = elbow + d / 2 + branch * np.sqrt(ROD**2 - r * r / 4) * np.array([-d[1], d[0]]) / r
    return float(np.arctan2(pin[1], pin[0] - CRANK))


# -- closing -----------------------------------------------------------------------------------------------
def test_the_lectures_start() -> None:
    found = four_bar()
    np.testing.assert_allclose(found.q, (0.01, -0.01017083, 0.01017083), atol=5e-9)
    assert found.q[0] == 0.01 and found.position_residual < 1e-15 and found.redundant == ()
    assert np.all(found.v == 0.0)


@pytest.mark.parametrize(
    ("initial", "branch"),
    [
        ("{theta1: 1, phi1: 1.1}", 1),
        ("{theta1: 1, phi1: 0.4}", 1),
        ("{theta1: 1, phi1: 2.6}", -1),
        ("{theta1: 1, phi1: -2.6}", -1),
        ("{theta1: 1, phi1: 3.6}", -1),
        ("{theta1: 1, phi2: -1, phi1: 1}", 1),
        ("{theta1: 1, phi2: -1}", 1),
        ("{theta1: 1, phi2: 2.6}", -1),
        # guesses from which a plain Newton iteration does not arrive
        ("{theta1: 1, phi1: 3, phi2: 1.6}", None),
        ("{theta1: 0.3, phi1: 2.0, phi2: -3.0}", None),
        ("{theta1: 2.6, phi1: 0, phi2: 0}", None),
    ],
)
def test_guesses_pick_the_branch(initial: str, branch: int | None) -> None:
    found = four_bar(f"initial={{q: {initial}, hold: [theta1]}}")
    theta, phi2, phi1 = found.q
    assert found.position_residual < 1e-14
    pin = [CRANK * f(theta) + ROD * f(theta + phi2) for f in (np.cos, np.sin)]
    other = [CRANK + ROD * np.cos(phi1), ROD * np.sin(phi1)]
    np.testing.assert_allclose(pin, other, atol=1e-14)
    if branch is not None:
        assert np.cos(phi1 - follower(theta, branch)) > 1 - 1e-12


@pytest.mark.parametrize("turns", [-8, 3, 8])
def test_given_turns_are_kept(turns: int) -> None:
    found = four_bar(f"initial={{q: {{theta1: 1, phi1: {1.0 + 2 * np.pi * turns}}}, hold: [theta1]}}")
    assert found.q[2] == pytest.approx(follower(1.0, 1) + 2 * np.pi * turns, abs=1e-9)


def test_without_hold_all_joints_move_a_little() -> None:
    found = four_bar("initial={q: {theta1: 1, phi2: -1.05, phi1: 0.98}}")
    np.testing.assert_allclose(found.q, (1.0, -1.05, 0.98), atol=0.06)
    assert found.q[0] != 1.0 and found.position_residual < 1e-14


def test_without_any_value_something_regular_is_found() -> None:
    found = four_bar("initial={}")
    assert found.position_residual < 1e-14
    again = four_bar("initial={}")
    assert np.array_equal(found.q, again.q)  # the same each time


@pytest.mark.parametrize("text", [SIX_BAR, SLIDER, BENNETT], ids=["six-bar", "slider-crank", "Bennett"])
def test_other_mechanisms_close_to_rounding(text: str) -> None:
    assert assembled(text).position_residual < 1e-14


def test_a_bad_guess_for_two_loops() -> None:
    found = assembled(
        SIX_BAR, "initial={q: {crank: 1.0, c1: 2, rocker: 0.2, c2: 2.5, out: -2}, hold: [crank]}"
    )
    assert found.position_residual < 1e-14 and found.q[0] == 1.0


def test_a_sliding_joint_counts_in_lengths() -> None:
    found = assembled(SLIDER, "initial={q: {crank: 0.2}, hold: [crank]}")
    reach = 0.3 * np.cos(0.2) + np.array([1, -1]) * np.sqrt(0.81 - (0.3 * np.sin(0.2)) ** 2)
    assert np.abs(found.q[2] - reach).min() < 1e-12


@pytest.mark.parametrize("scale", [1e-5, 1e4])
def test_size_does_not_matter(scale: float) -> None:
    text = SLIDER
    for length in ("a: 0.3", "a: 0.9", "slide: 1.1"):
        key, value = length.split(": ")
        text = text.replace(length, f"{key}: {float(value) * scale}")
    found = assembled(text)
    assert found.position_residual < 1e-14 * scale
    assert found.q[0] == 0.2 and found.q[2] == pytest.approx(assembled(SLIDER).q[2] * scale, rel=1e-12)


# -- what cannot close -------------------------------------------------------------------------------------
@pytest.mark.parametrize("distance", [3.7, 4.0, 10.0])
def test_the_smallest_gap_is_reported(distance: float) -> None:
    error = failure(f"robot.joints.phi1.origin.xyz=[{distance}, 0, 0]", "initial={q: {theta1: 0.3}}")
    gap = distance - CRANK - 2 * ROD
    assert isinstance(error, GeometryError) and error.exit_code == 5
    assert error.details["gap"] == pytest.approx(gap, rel=1e-6) and error.details["loop"] == "pin"
    assert "'pin'" in error.message and f"{gap:.6g} m" in error.message


def test_a_held_joint_is_named_with_its_value() -> None:
    error = failure("initial={q: {theta1: 2.7}, hold: [theta1]}")
    assert isinstance(error, GeometryError) and "theta1 = 2.7 held" in error.message
    assert error.details["gap"] == pytest.approx(2 * CRANK * np.sin(1.35) - 2 * ROD, rel=1e-6)


def test_the_loop_that_stays_open_is_the_one_that_is_named() -> None:
    with pytest.raises(GeometryError) as caught:
        assembled(SIX_BAR, "robot.joints.out.origin.xyz=[9, 0, 0]")
    assert caught.value.details["loop"] == "second"


def test_axes_that_cannot_be_made_parallel() -> None:
    with pytest.raises(GeometryError) as caught:
        assembled(SLIDER, "loops.pin.axis2=[0, 1, 1]")
    assert "axis" in caught.value.message and "'pin'" in caught.value.message


def test_a_held_joint_needs_a_value() -> None:
    error = failure("initial={q: {phi1: 1}, hold: [theta1]}")
    assert isinstance(error, SceneError) and "'theta1'" in error.message and "hold" in error.message


# -- rates -------------------------------------------------------------------------------------------------
def test_rates_follow_from_the_one_that_is_given() -> None:
    found = four_bar("initial={q: {theta1: 1}, qd: {theta1: 2}, hold: [theta1]}")
    h = 1e-6
    slope = (follower(1 + h, 1) - follower(1 - h, 1)) / (2 * h)
    assert found.v[0] == 2.0 and found.v[2] == pytest.approx(2 * slope, rel=1e-8)
    assert found.velocity_residual < 1e-14


def test_consistent_rates_are_kept() -> None:
    free = four_bar("initial={q: {theta1: 1}, qd: {theta1: 2}, hold: [theta1]}").v
    text = f"{{theta1: 2, phi2: {float(free[1])!r}, phi1: {float(free[2])!r}}}"
    np.testing.assert_allclose(
        four_bar(f"initial={{q: {{theta1: 1}}, qd: {text}, hold: [theta1]}}").v, free, atol=1e-12
    )


def test_rates_that_contradict() -> None:
    error = failure("initial={q: {theta1: 1}, qd: {theta1: 1, phi1: 5}, hold: [theta1]}")
    assert isinstance(error, GeometryError) and "rates" in error.message and "pin." in error.message
    assert error.details["residual"] > 1.0


def test_a_prescribed_joint_brings_its_rate() -> None:
    found = four_bar("prescribed.theta1=0.01 + 0.5*t", name="four_bar_prescribed")
    assert found.v[0] == pytest.approx(0.5, abs=1e-15) and abs(found.v[2]) > 0.1


# -- singular and redundant --------------------------------------------------------------------------------
@pytest.mark.parametrize("angles", ["theta1: 0, phi2: 0, phi1: 0", "theta1: 180 deg, phi2: -180 deg, phi1: 180 deg",
                                    "theta1: 180 deg"])  # fmt: skip
def test_a_start_in_a_bifurcation(angles: str) -> None:
    error = failure(f"initial={{q: {{{angles}}}, hold: [theta1]}}", name="parallelogram")
    assert isinstance(error, SingularConfigurationError) and error.exit_code == 4
    assert (error.details["rank"], error.details["generic_rank"]) == (1, 2)
    assert "start away from it" in error.message


def test_close_to_a_bifurcation_is_no_bifurcation() -> None:
    found = four_bar(
        "initial={q: {theta1: 1e-4, phi2: -1e-4, phi1: 1e-4}, hold: [theta1]}", name="parallelogram"
    )
    assert found.position_residual < 1e-14 and found.q[0] == 1e-4


def test_redundant_rows_of_a_spatial_loop() -> None:
    found = assembled(BENNETT)
    assert len(found.independent) == 2 and len(found.redundant) == 3
    q = found.q
    # Bennett's conditions hold to rounding although three of five rows were left out
    ratio = np.sin((SKEW + TWIST) / 2) / np.sin((SKEW - TWIST) / 2)
    assert np.tan(q[0] / 2) * np.tan(q[1] / 2) == pytest.approx(ratio, rel=1e-10)
    assert q[2] == pytest.approx(-q[0], abs=1e-12)


def test_a_ring_that_misses_bennetts_condition_does_not_turn() -> None:
    """A length that is a little off makes the four bars a frame, or keeps them from closing at all."""
    text = BENNETT.replace(f"at: [{-LONG}, 0, 0]", f"at: [{-LONG * 1.01}, 0, 0]")
    assert text != BENNETT
    with pytest.raises(GeometryError):
        assembled(text)


def test_rows_that_vanish_are_left_out_of_the_equations() -> None:
    setup = prepare(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    assert setup.problem.constraints.dropped == ("pin.z", "pin.axis1", "pin.axis2")
    assert setup.problem.constraints.names == ("pin.x", "pin.y")


def test_closing_far_from_the_start_is_told_with_the_place() -> None:
    """A screw that must turn some 49 rad to reach: the loops can close, and no attitude is in the way."""
    text = """
gravity: [0, 0, 0]
robot:
  joints:
    - {name: a, type: universal, axis: [1, 0, 0], axis2: [0, 1, 0]}
    - {name: d, type: helical, axis: [0, 0, 1], pitch: 0.1}
  links: [{name: l1, mass: 1, com: [1, 0, 0]}, {name: l2, mass: 1, com: [1, 0, 0]}]
loops: [{name: far, type: distance, between: [base.origin, l2.com], length: 5}]
initial: {q: {a: [1, 0], d: 2}}
simulate: {duration: 1}
"""
    with pytest.raises(GeometryError, match=r"only far from 'initial.q', at a.theta1 .*, d 48\.98"):
        assembled(text)


# -- why it does not close or move ---------------------------------------------------------------------------
def bars(
    closures: str, pivot: str = "0.3", start: str = "initial: {q: {crank: 30 deg}, hold: [crank]}"
) -> str:
    """Return a four-bar with crank 0.1 m, coupler 0.3 m, rocker 0.2 m and its second pivot at ``pivot`` [m]."""
    return (
        "gravity: [0, -9.81, 0]\nrobot:\n  joints:\n"
        "    - {name: crank, type: revolute, parent: base, link: c, axis: [0, 0, 1]}\n"
        "    - {name: coup, type: revolute, parent: c, link: k, axis: [0, 0, 1], origin: {xyz: [0.1, 0, 0]}}\n"
        f"    - {{name: rock, type: revolute, parent: base, link: r, axis: [0, 0, 1], origin: {{xyz: [{pivot}, 0, 0]}}}}\n"
        "  links:\n"
        "    - {name: c, mass: 1, com: [0.05, 0, 0], inertia: {zz: 1e-3}}\n"
        "    - {name: k, mass: 1, com: [0.15, 0, 0], inertia: {zz: 8e-3}}\n"
        "    - {name: r, mass: 1, com: [0.1, 0, 0], inertia: {zz: 4e-3}}\n"
        "  points: {kp: {link: k, at: [0.3, 0, 0]}, rp: {link: r, at: [0.2, 0, 0]}}\n"
        f"loops: [{closures}]\n{start}\nsimulate: {{duration: 0.1, samples: 3}}\n"
    )


PIN = "{name: pin, type: revolute, between: [kp, rp]}"
BRACE = "{name: brace, type: distance, between: [c.origin, rp], length: 0.35}"


@pytest.mark.parametrize(
    "closure",
    [
        "{name: pin, type: fixed, between: [kp, rp]}",
        "{name: pin, type: revolute, between: [kp, rp], axis: [1, 0, 0]}",
    ],
)
def test_an_attitude_that_cannot_be_met_is_no_gap(closure: str) -> None:
    """The points meet where the pin joint alone closes; the angle there is that of coupler and rocker."""
    closed = [assembled(bars(PIN), f"initial.q.coup={side}").q for side in (1.5, -1.5)]
    with pytest.raises(GeometryError, match="its points meet, but not in the attitude") as caught:
        assembled(bars(closure))
    turned = min(abs(np.sin(crank + coup - rock)) for crank, coup, rock in closed)
    assert np.sin(caught.value.details["angle"]) == pytest.approx(turned, rel=1e-8)
    assert "gap" not in caught.value.details and " m " not in caught.value.message


def test_a_truss_is_named() -> None:
    with pytest.raises(GeometryError, match="nothing held the loops close at .*: pin, brace make a truss"):
        assembled(bars(f"{PIN}, {BRACE}"))
    result = simulate(
        load_scene_text("schema: 1\n" + bars(f"{PIN}, {BRACE}", start="initial: {q: {crank: 30 deg}}"))
    )
    assert any(
        text.startswith("nothing can move: the loops (pin, brace)") for text in result.summary["warnings"]
    )
    assert not any("not meaningful" in text for text in result.summary["warnings"])
    assert "nothing can move" not in str(
        simulate(load_scene_text("schema: 1\n" + bars(PIN))).summary.get("warnings")
    )


def test_freedoms_of_first_order_that_are_no_motions() -> None:
    """A flat triangle of bars turns about its pivot; its middle corner moves across at first order only."""
    with pytest.raises(
        SingularConfigurationError, match=r"the start \(crank 0.523599, .*\) is a singular"
    ) as caught:
        assembled(bars(PIN, pivot="0"))
    assert caught.value.exit_code == 4 and len(caught.value.details["q"]) == 3


def test_a_coupler_that_cannot_hold_is_no_loop() -> None:
    text = """schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: left, type: prismatic, parent: base, axis: [0, 1, 0]}
    - {name: right, type: prismatic, parent: base, axis: [0, -1, 0]}
  links: [{name: a, mass: 1}, {name: b, mass: 1}]
couplers:
  - {name: mimic, terms: {left: 1, right: -1}}
  - {name: again, terms: {left: 1, right: 1}}
initial: {q: {left: 0.005}, hold: [left]}
simulate: {duration: 1}
"""
    with pytest.raises(
        GeometryError, match=r"the coupler '(mimic|again)' does not hold .*: .*close at left 0, right 0"
    ) as caught:
        simulate(load_scene_text(text))
    assert caught.value.details["coupler"] in ("mimic", "again")


def test_a_length_in_another_unit_is_told_where_loops_do_not_close() -> None:
    """The crank's length in millimetres; a mechanism that is only too short has no such words."""
    with pytest.raises(GeometryError, match="joint 'phi1' is 300 m from .*: are these metres"):
        assembled(OPEN, "robot.joints.phi1.origin.xyz.0=300")
    with pytest.raises(GeometryError) as caught:
        assembled(OPEN, "robot.joints.phi1.origin.xyz.0=3")
    assert "metres" not in str(caught.value)


OPEN = """
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: theta, type: revolute, axis: [0, 0, 1]}
    - {name: psi, type: revolute, axis: [0, 0, 1], origin: {xyz: [0.3, 0, 0]}}
    - {name: phi1, type: revolute, axis: [0, 0, 1], parent: base, origin: {xyz: [0.3, 0, 0]}}
  links:
    - {name: crank, mass: 1, inertia: {zz: 0.1}}
    - {name: rod, mass: 1, inertia: {zz: 0.1}}
    - {name: arm, mass: 1, inertia: {zz: 0.1}}
  points: {far: {link: rod, at: [0.4, 0, 0]}, tip: {link: arm, at: [0.4, 0, 0]}}
loops: [{name: pin, type: revolute, between: [far, tip]}]
initial: {q: {theta: 1}, hold: [theta]}
"""
