"""Sequences with paths of a point and motions in the least time: what they are made of, and how they meet."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import linearise, load_scene_text
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.ready.doors import along
from robodyn_cli.scene.types import Scene
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.kinematics import kinematics
from robodyn_cli.works.simulate import simulate
from tests.cli.tool import invoke
from tests.source import ROOT

# full inertias, offset centres of mass, a base that is tilted
ARM = """
schema: 1
gravity: [0.3, -9.4, 1.1]
robot:
  joints:
    - {name: waist, type: revolute, axis: [0, 0, 1]}
    - {name: shoulder, type: revolute, axis: [0, 1, 0], origin: {xyz: [0, 0.05, 0.4]}}
    - {name: elbow, type: revolute, axis: [0, 1, 0], origin: {xyz: [0.5, -0.02, 0]}}
  links:
    - {name: post, mass: 3, com: [0.02, 0.01, 0.2], inertia: {xx: 0.05, yy: 0.06, zz: 0.03, xy: 0.002, xz: 0.003, yz: -0.001}}
    - {name: upper, mass: 2, com: [0.2, 0.03, 0.01], inertia: {xx: 0.01, yy: 0.05, zz: 0.045, xy: 0.001, xz: -0.002, yz: 0.001}}
    - {name: lower, mass: 1.5, com: [0.18, -0.02, 0.01], inertia: {xx: 0.008, yy: 0.03, zz: 0.028, xy: 0.001, xz: 0.001, yz: 0.0}}
  points:
    hand: {link: lower, at: [0.4, 0, 0]}
"""
HERE, THERE, VIA = "[0.6, 0.15, 0.2]", "[0.6, -0.2, 0.1]", "[0.7, 0.0, 0.3]"
OUT = (
    f"{{type: path, point: hand, start: {{position: {HERE}}}, law: s_curve, speed: 0.5, acceleration: 2, jerk: 30, "
    f"segments: [{{type: line, to: {THERE}}}], ik: {{guess: {{waist: 0.2, shoulder: 0.3, elbow: 0.8}}}}}}"
)
WAY = (
    f"type: path, point: hand, start: {{position: {THERE}}}, law: quintic, speed: 1, "
    f"segments: [{{type: arc, via: {VIA}, to: {HERE}}}]"
)
EFFORT = {"waist": 20.0, "shoulder": 60.0, "elbow": 25.0}
LIMITS = f"effort: {EFFORT}".replace("'", "")
BACK = f"{{type: fastest, path: {{{WAY}}}, {LIMITS}}}"


def scene_of(trajectory: str, rest: str = "") -> Scene:
    return load_scene_text(f"{ARM}trajectory: {trajectory}\n{rest}", "arm.yaml")


def test_a_path_and_the_fastest_way_back_twice() -> None:
    found = inverse(scene_of(f"{{type: sequence, repeat: 2, segments: [{OUT}, {BACK}]}}"), samples=4001)
    alone = scene_of(
        BACK.replace("law: quintic", "ik: {guess: {waist: -0.3, shoulder: 0.3, elbow: 0.8}}, law: quintic")
    )
    back = along(alone).trajectory
    out = scene_of(OUT).trajectory
    T = out.duration + back.duration
    times = found["time"].ravel()
    assert times[-1] == pytest.approx(2.0 * T, rel=1e-12)
    # the hand is on the path that each segment asks for
    here = times % T
    first, rest = here < out.duration, (here > out.duration) & (times < 2.0 * T * (1.0 - 1e-9))
    hand = found["points/hand"]
    assert hand[first] == pytest.approx(out.target(here[first], {}).p, abs=1e-9)
    assert hand[rest] == pytest.approx(back.target(here[rest] - out.duration, {}).p, abs=1e-9)
    # joints do not jump, and the drives are at one of their limits on the way back
    steps = np.abs(np.diff(found["q"], axis=0)).max()
    assert steps < 1.1 * np.abs(found["qd"]).max() * (times[1] - times[0])
    use = (np.abs(found["tau"]) / np.array(list(EFFORT.values()))).max(axis=1)
    assert use[rest].max() <= 1.0 + 1e-6
    assert np.mean(use[rest] > 0.99) > 0.95


def test_the_joints_go_on_where_the_segment_before_ends() -> None:
    """The second path has no start of its own: it stays on the branch, whichever the first one is on."""
    way = f"{{type: sequence, segments: [{OUT}, {{{WAY}}}]}}"
    other = way.replace("waist: 0.2, shoulder: 0.3, elbow: 0.8", "waist: 0.2, shoulder: 1.2, elbow: -0.8")
    ends = []
    for trajectory in (way, other):
        found = kinematics(scene_of(trajectory))
        assert np.abs(np.diff(found["q"], axis=0)).max() < 0.3
        ends.append(found["q"][-1])
        assert found["q"][-1] == pytest.approx(found["q"][0], abs=1e-9)
    assert ends[0][2] > 0.0 > ends[1][2]


def test_a_simulation_follows_it() -> None:
    trajectory = f"{{type: sequence, segments: [{OUT}, {{{WAY}}}]}}"
    scene = scene_of(
        trajectory,
        "prescribed: trajectory\ninitial: {q: {waist: 0.2, shoulder: 0.3, elbow: 0.8}}\n"
        "simulate: {duration: 1.2, samples: 61}\n",
    )
    run = simulate(scene)
    assert run.status == "ok"
    given = inverse(scene_of(trajectory), samples=2)
    whole = float(given["time"].ravel()[-1])
    fine = inverse(scene_of(trajectory), samples=8001)
    times = run["time"].ravel()
    for k in range(3):
        q = np.interp(times, np.linspace(0.0, whole, 8001), fine["q"][:, k])
        assert run["q"][:, k] == pytest.approx(q, abs=1e-6)


@pytest.mark.parametrize(
    "trajectory", ["{type: sequence, segments: [%s, %s]}", "%s"], ids=["sequence", "path"]
)
def test_what_a_simulation_follows_is_given_to_others(trajectory: str) -> None:
    """`prescribed: trajectory` is for what integrates; others take the same motion, and torques, without it."""
    circle = "{type: circle, point: tip, center: [0, 0], radius: 0.1, duration: 0.5}"
    text = f"""
schema: 1
command: inverse
gravity: [0, -9.81, 0]
robot:
  joints: [{{name: x, type: prismatic, axis: [1, 0, 0]}}, {{name: y, type: prismatic, axis: [0, 1, 0]}}]
  links: [{{name: guide, mass: 1}}, {{name: pen, mass: 1}}]
  points: {{tip: {{link: pen, at: [0, 0, 0]}}}}
initial: {{q: {{x: 0.1, y: 0}}}}
trajectory: {trajectory.replace("%s", circle)}
"""
    plain, following = load_scene_text(text), load_scene_text(text + "prescribed: trajectory")
    for compute, name in ((inverse, "tau"), (kinematics, "qdd")):
        assert np.array_equal(compute(plain)[name], compute(following)[name])
    models = [linearise(scene, about="motion") for scene in (plain, following)]
    assert np.array_equal(*(model["linear/B"] for model in models))


def test_a_controller_follows_paths_one_after_another() -> None:
    """Joints that a sequence leads are not known before those of its paths are found."""
    circle = "{type: circle, point: tip, center: [0, 0], radius: 0.1, duration: 0.5}"
    scene = load_scene_text(f"""
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{{name: x, type: prismatic, axis: [1, 0, 0]}}, {{name: y, type: prismatic, axis: [0, 1, 0]}}]
  links: [{{name: guide, mass: 1}}, {{name: pen, mass: 1}}]
  points: {{tip: {{link: pen, at: [0, 0, 0]}}}}
initial: {{q: {{x: 0.1, y: 0}}, qd: {{y: {0.4 * np.pi!r}}}}}
control:
  type: computed_torque
  gains: {{kp: 100, kd: 20}}
  reference: {{type: sequence, segments: [{circle}, {circle}]}}
simulate: {{duration: 1, samples: 101}}
""")
    assert scene.control.reference.joints == ()
    found = simulate(scene)
    phi = 4.0 * np.pi * found.time
    assert np.abs(found["q"] - 0.1 * np.stack([np.cos(phi), np.sin(phi)], axis=1)).max() < 1e-7


def test_a_motion_of_joints_goes_before_the_fastest_one() -> None:
    points = "points: [{q: {waist: 0.5, shoulder: 0, elbow: 1}}, {q: {waist: 0, shoulder: 0.4, elbow: 0.2}}]"
    move = (
        "{type: quintic, points: [{t: 0, q: {waist: 0, shoulder: 0, elbow: 1}}, "
        "{t: 0.5, q: {waist: 0.5, shoulder: 0, elbow: 1}, dwell: 0.2}]}"
    )
    fastest = f"{{type: fastest, {points}, {LIMITS}}}"
    both = inverse(scene_of(f"{{type: sequence, segments: [{move}, {fastest}]}}"), samples=1001)
    alone = inverse(scene_of(fastest), samples=1001)
    assert both["time"].ravel()[-1] == pytest.approx(0.7 + alone["time"].ravel()[-1], rel=1e-12)
    assert both["q"][-1] == pytest.approx([0.0, 0.4, 0.2], abs=1e-12)


REFUSED = [
    (
        f"{{type: sequence, segments: [{OUT}, {BACK.replace(THERE, '[0.6, -0.2, 0.12]')}]}}",
        r"arm\.yaml:\d+:\d+: trajectory\.segments\.1: .* begins at .*, where the segment before ends",
    ),
    (
        f"{{type: sequence, repeat: 2, segments: [{OUT}]}}",
        r"trajectory\.segments\.0: .* begins at .*, where the last one ends",
    ),
    (
        f"{{type: sequence, segments: [{OUT}, {{type: path, point: hand, start: {{position: {THERE}}}, law: quintic, "
        "speed: 1, segments: [{type: line, to: [3, 0, 0]}]}]}",
        r"trajectory\.segments\.1: .*cannot reach its target",
    ),
    (
        f"{{type: fastest, {LIMITS}, path: {{type: sequence, segments: [{OUT}]}}}}",
        r"trajectory\.path: is a sequence with motions of a point",
    ),
]


@pytest.mark.parametrize(("trajectory", "words"), REFUSED)
def test_what_is_wrong_is_said(trajectory: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(f"{ARM}trajectory: {trajectory}\n", encoding="utf-8")
    done = invoke("inverse", file, "--no-plots", "--out", tmp_path / "out")
    assert done.code in (2, 5)
    assert re.search(words, " ".join(done.err.split())), done.err


def test_drives_are_not_sized_by_times_that_follow_from_them() -> None:
    from robodyn_cli.works.size.candidates import Responses

    scene = scene_of(f"{{type: sequence, segments: [{OUT}, {BACK}]}}")
    with pytest.raises(CapabilityError, match="follow from the torques"):
        Responses.of(scene, {})


def test_a_mechanism_with_loops_takes_motions_of_joints_only() -> None:
    path = ROOT / "robodyn_cli" / "robots" / "five_bar.yaml"
    circle = "{type: circle, point: tip, center: [0.3, 0.9], radius: 0.15, duration: 3}"
    text = path.read_text()
    assert circle in text
    with pytest.raises((CapabilityError, SceneError), match="with loops or couplers a sequence leads joints"):
        inverse(load_scene_text(text.replace(circle, f"{{type: sequence, segments: [{circle}]}}"), str(path)))
