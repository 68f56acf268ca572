"""Criteria: how they are written, and what they make of a summary."""

from __future__ import annotations

import math
from typing import Any

import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.expr.statements import parse_expectation
from robodyn_cli.over.batch.criteria import exit_code, judge
from robodyn_cli.scene.load import load_scene_text
from tests.unit.scene_text import SCENE, check_place

CASES = [
    ("12.283 +- 0.001", [12.283, 12.2821, 12.2839], [12.285, 12.2815, None, "12.283", True]),
    ("12.283 ± 0.001", [12.283], [12.285]),
    ("-2 +- 10 %", [-2.19, -1.81], [-2.21, -1.79, 2.0]),
    ("5 +- 0", [5, 5.0], [5.000001]),
    ("90 deg +- 1e-9", [math.pi / 2], [90.0]),
    ("< 170", [169.9, -1e300], [170.0, math.nan, "x"]),
    ("<= 170", [170.0, 3], [170.1]),
    ("> -1", [0, 1e9], [-1, -2]),
    (">= 0", [0, 1], [-1e-300]),
    ("-1 .. 2", [-1, 0.3, 2], [-1.01, 2.01]),
    ("1e-3 .. 1/2", [0.5], [0.51]),
    (5, [5, 5.0], [5.1, "5", True]),
    (0.1, [0.1], [0.1 + 1e-16 + 1e-17]),
    (True, [True], [1, "true", False]),
    ("locked", ["locked"], ["Locked", None, 3]),
    ("end of the trajectory", ["end of the trajectory"], ["end"]),
    ("e", ["e"], [math.e]),
    (None, [None], [0, False, ""]),
]


@pytest.mark.parametrize(("text", "good", "bad"), CASES)
def test_expectations(text: Any, good: list[Any], bad: list[Any]) -> None:
    expected = parse_expectation(text)
    assert all(expected.holds(value) for value in good)
    assert not any(expected.holds(value) for value in bad)


SHOWN = [
    (9, 9.000000000000002, "9.000000000000002"), ("<= 1", 1.0 + 1e-12, "1.000000000001"), ("< 0.8", 0.81, "0.81"),
    ("> 1000 rpm", 23.98, "228.992132 rpm"), ("<= 12 N cm", 0.120000000000001, "12.0000000000001 N cm"),
    ("1 mm .. 2 cm", 0.0305, "30.5 mm"), ("12.28 s +- 10 ms", 12.5, "12.5 s"), ("< 1e-3 m", 0.25, "0.25 m"),
    ("9.81 m/s^2 * 80 gram", 0.9, "0.9 N"), ("< (30 + 15) deg", math.pi / 3, "60 deg"), (3, 3, "3"), (3, 4, "4"),
    ("ok", 1.0 / 3.0, "0.333333333"), ("ok", None, "null"), (None, True, "true"), (True, False, "false"), (1, "ok", "ok"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "value", "words"), SHOWN)
def test_what_was_judged_in_words(text: Any, value: Any, words: str) -> None:
    """In the unit of the bounds, and with so many digits that value and bound differ where it does not hold."""
    assert parse_expectation(text).shown(value) == words


def test_figures_in_degrees_are_shown_in_the_unit_of_their_bounds() -> None:
    for text, words in (("30 deg", "45 deg"), ("500 mrad", "785.398163 mrad"), ("30", "45")):
        expected = parse_expectation(text, "lock.angles_deg.swing")
        assert not expected.holds(45.0) and expected.shown(45.0) == words
    assert parse_expectation("45 deg", "lock.angles_deg.swing").holds(45.0)


def test_a_number_that_misses_by_rounding_says_so() -> None:
    (missed,) = judge(
        {"lock.time": parse_expectation(9)}, {"status": "ok", "lock": {"time": 9.000000000000002}}
    )
    assert str(missed) == (
        "lock.time: 9.000000000000002, off by rounding: '9' has no tolerance, '9 +- 1e-6 %' has (expected 9)"
    )
    assert parse_expectation("9 +- 1e-6 %").holds(9.000000000000002)
    (text,) = judge({"lock.kind": parse_expectation(9)}, {"status": "ok", "lock": {"kind": "dead_point"}})
    assert str(text) == "lock.kind: dead_point (expected 9)"


@pytest.mark.parametrize(
    "text", ["< ", "< abc", "a +- b", "1 +- -1", "2 .. 1", "1 ..", "> t", math.inf, "1 +- 2 +- 3"]
)
def test_what_is_no_expectation(text: Any) -> None:
    with pytest.raises(SceneError, match="allowed"):
        parse_expectation(text)


def test_errors_have_a_place() -> None:
    check_place(SCENE + "expect: {lock.time: §< soon}\n", "expect.lock.time", "'soon' is not a finite number")
    check_place(SCENE + "expect: {lock.time: §[1]}\n", "expect.lock.time", "[1]")
    check_place(SCENE + "expect: §[1]\n", "expect", "a map")


def test_nested_maps_are_dots() -> None:
    nested = load_scene_text(SCENE + "expect: {lock: {time: < 3, kind: dead_point}, status: locked}\n")
    flat = load_scene_text(SCENE + "expect: {lock.time: < 3, lock.kind: dead_point, status: locked}\n")
    assert nested.expect == flat.expect and list(flat.expect) == ["lock.time", "lock.kind", "status"]
    assert load_scene_text(SCENE, overrides=["expect.lock.time=< 3"]).expect == {
        "lock.time": flat.expect["lock.time"]
    }
    assert load_scene_text(flat.text).expect == flat.expect


SUMMARY: dict[str, Any] = {
    "status": "ok",
    "joints": {"theta1": {"peak_torque": 168.3, "torque_range": [71.9, 168.3]}, "a.b": {"peak_torque": 2.0}},
    "lock": None,
    "criteria": {"growth_times": {"10": 9.5, "1.5": 2.0}},
}


def check(summary: dict[str, Any] = SUMMARY, **expect: Any) -> list[bool]:
    found = judge({k.replace("__", "."): parse_expectation(v) for k, v in expect.items()}, summary)
    return [outcome.holds for outcome in found]


def test_key_paths_and_aliases() -> None:
    keys: dict[str, Any] = {
        "status": "ok", "joints.theta1.peak_torque": "< 170", "peak_torque.theta1": "< 170", "peak_torque.a.b": 2,
        "joints.a.b.peak_torque": "< 3", "joints.theta1.torque_range.0": "70 .. 72", "criteria.growth_times.10": 9.5,
        "criteria.growth_times.1.5": 2, "exit_code": 0, "lock": None,
    }  # fmt: skip
    outcomes = judge({k: parse_expectation(v) for k, v in keys.items()}, SUMMARY)
    assert [o.key for o in outcomes if not o.holds] == []


def test_nothing_lies_below_nothing() -> None:
    assert check(lock__time="< 3") == [False]


@pytest.mark.parametrize(
    ("key", "hint"),
    [
        ("peak_torqe.theta1", "'peak_torque.theta1'"),
        ("joints.theta1.peak_torqe", "'joints.theta1.peak_torque'"),
        ("joints.theta2.peak_torque", "did you mean"),
        ("statsu", "'status'"),
        ("nonsense", "allowed: status"),
    ],
)
def test_unknown_keys_are_errors(key: str, hint: str) -> None:
    with pytest.raises(SceneError, match="no such key") as caught:
        judge({key: parse_expectation(1)}, SUMMARY)
    assert hint in caught.value.message and caught.value.exit_code == 2


def test_several_values_are_no_value() -> None:
    with pytest.raises(SceneError, match=r"name one: .*joints\.theta1"):
        judge({"joints": parse_expectation(1)}, SUMMARY)


def test_failed_runs() -> None:
    failed = {"status": "failed", "error": {"exit_code": 4, "message": "a bifurcation"}}
    assert exit_code(failed) == 4
    assert check(failed, status="failed", exit_code=4, lock__time="< 3") == [True, True, False]
    assert exit_code({"status": "no_lock"}) == 1


def test_outcomes_in_words() -> None:
    good, bad = judge(
        {"peak_torque.theta1": parse_expectation("< 170"), "status": parse_expectation("locked")}, SUMMARY
    )
    assert str(good) == "peak_torque.theta1: 168.3 (expected < 170)"
    assert str(bad) == "status: ok (expected locked)"
