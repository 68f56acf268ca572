"""What latches and payloads did in words: each with the unit of its joint, of every command that has them."""

from __future__ import annotations

from typing import Any

from robodyn_cli.cli.commands import deploy, simulate
from robodyn_cli.cli.latch_words import latch_lines, payload_lines
from robodyn_cli.cli.words import stated
from robodyn_cli.errors import plural_of
from robodyn_cli.expr.statements import parse_expectation
from robodyn_cli.over.commands import execute
from robodyn_cli.scene.checks.keys import unit_fault
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.tools.progress import Stopwatch, no_progress

DRAWER = """
schema: 1
title: Drawer
command: COMMAND
gravity: [0, 0, 0]
robot:
  joints:
    - {name: s, type: prismatic, axis: [1, 0, 0], spring: {stiffness: 2 N/m, rest: 1 m}}
    - {name: h, type: revolute, axis: [0, 0, 1], spring: {stiffness: 0.5, rest: 0.3}}
  links: [{name: a, mass: 1}, {name: b, mass: 1, com: [0.2, 0, 0], inertia: {zz: 0.1}}]
  points: {tip: {link: b, at: [0.3, 0, 0]}}
initial: {q: {s: 0, h: 0}}
simulate: {duration: 2, samples: 11}
deploy:
  latches:
    - {name: k, joint: s, at: 800 mm}
    - {name: turn, joint: h, at: 10 deg}
    - {name: soft, joint: h, at: 20 deg, hold: {stiffness: 3}}
    - {name: far, joint: h, at: 170 deg}
    - {name: long, joint: h, at: {s: 90 cm}}
    - {name: never, joint: h, when: tip.x - 50}
  until: end
"""


def drawer() -> Scene:
    return load_scene_text(DRAWER.replace("COMMAND", "deploy"))


def test_closings_have_the_unit_of_what_is_held() -> None:
    summary = execute("deploy", drawer(), no_progress, Stopwatch()).summary
    lines = {line.split()[0]: line for line in latch_lines(summary)}
    assert list(lines)[:2] == ["turn", "k"], "in the order of their times"
    assert lines["k"].endswith(" N s") and f"closes at t = {summary['locks']['k']['time']:.5f}" in lines["k"]
    assert lines["turn"].endswith(" N m s")
    energy = summary["locks"]["k"]
    assert f"energy lost {stated(energy['energy_lost'], energy['errors']['energy_lost'])} J" in lines["k"]
    assert lines["k"].count("+-") == 3, "time, energy, impulse"
    assert lines["far"].endswith(" rad off") and lines["long"].endswith(" m off")
    assert lines["never"].endswith(" off") and not lines["never"].endswith(("m off", "rad off"))
    assert "\n".join(latch_lines(summary)) in deploy.describe(summary)
    # the same lines where a simulation goes on from such a run
    assert "\n".join(latch_lines(summary)) in simulate.describe({**summary, "samples": 11})


def test_units_of_latches_are_those_of_their_joints() -> None:
    scene = drawer()
    for key, wrong in (
        ("locks.k.angular_impulse", "3 N m s"),
        ("locks.turn.angular_impulse", "3 N s"),
        ("locks.k.angle", "3 deg"),
    ):
        fault = unit_fault(scene, "deploy", key, parse_expectation(f"< {wrong}"))
        assert fault is not None and " or " not in fault, fault
    # of a formula nothing is known, so either is taken
    assert unit_fault(scene, "deploy", "missed.never.nearest", parse_expectation("< 3 mm")) is None


def test_a_landing_is_told_with_its_range() -> None:
    landing = {"time": 0.92, "range": 14.4172, "highest": 0.724, "range_error": 2.5e-13}
    summary: dict[str, Any] = {
        "payloads": {"stone": {"landing": landing, "release": {"energy": 158.3}}, "held": {}}
    }
    (line,) = payload_lines(summary)
    assert "range 14.4172000000000 +- 3e-13 m, up to 0.724 m" in line and line.startswith("  stone")


def test_plurals() -> None:
    assert [plural_of(word) for word in ("joint", "latch", "body", "way", "pair")] == [
        "joints", "latches", "bodies", "ways", "pairs",
    ]  # fmt: skip
