"""Paths in the least time cost in proportion to their length, in mechanisms with loops as in open chains."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest

from robodyn_cli import load_scene_text
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SingularConfigurationError
from robodyn_cli.fastest.resolve import limited_path
from robodyn_cli.given.along import MotionAlong, motion_at
from robodyn_cli.given.motion import Planned, led_by
from robodyn_cli.ready.doors import along
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.guided import Guide
from robodyn_cli.solve.newton import PointSolver
from robodyn_cli.torques.build import build_inverse
from robodyn_cli.torques.closed import ClosedTorques
from robodyn_cli.trajectories.motion import JointMotion
from tests.source import ROOT

ARM = ROOT / "configs" / "trajectories" / "fastest_2r.yaml"
FIVE = ROOT / "configs" / "mechanisms" / "five_bar_circle.yaml"
TURNS = ("[1.0, 1.2, 0]", "[0.9, 1.4, 0]", "[0.6, 1.5, 0]", "[0.3, 1.4, 0]", "[0.2, 1.1, 0]", "[0.4, 0.9, 0]")


def lines(count: int) -> Scene:
    """Return the arm along so many lines, rounded where they meet, by Newton's method."""
    given = [f"{{type: line, to: {to}, blend: 0.05}}" for to in TURNS[:count]]
    given[-1] = given[-1].replace(", blend: 0.05", "")
    path = (
        f"{{type: path, point: tip, law: quintic, speed: 1, start: {{position: [1.4, 1.0, 0]}}, segments: "
        f"[{', '.join(given)}], ik: {{branch: elbow_up, method: newton}}}}"
    )
    text = ARM.read_text().split("trajectory:")[0]
    limits = "effort: {theta1: 250, theta2: 120}"
    return load_scene_text(f"{text}trajectory: {{type: fastest, path: {path}, {limits}}}\n", str(ARM))


def five_bar(trajectory: str, *more: str) -> Scene:
    text = FIVE.read_text().split("trajectory:")[0]
    return load_scene_text(f"{text}trajectory: {trajectory}\n" + "\n".join(more), str(FIVE))


CIRCLE = "{type: circle, point: tip, center: [0.3, 0.9], radius: 0.15, duration: 3}"
ROUND = f"{{type: fastest, path: {CIRCLE}, effort: {{left: 30, right: 25}}, speed: {{left: 8, right: 6}}}}"


def test_each_line_costs_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points at which inverse kinematics is evaluated, and intervals, for one, three and six lines."""
    evaluated: Counter[int] = Counter()
    intervals, count = {}, 0
    whole = PointSolver.kinematics

    def counted(self: PointSolver, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        evaluated[count] += len(q)
        return whole(self, q, v)

    monkeypatch.setattr(PointSolver, "kinematics", counted)
    for count in (1, 3, 6):
        intervals[count] = along(lines(count)).trajectory.scaling.intervals
    # corners need points of their own, which one line has not: from three lines to six there are 2.5 times as many
    assert evaluated[6] < 2.5 * evaluated[3] and intervals[6] < 2.5 * intervals[3]
    assert evaluated[3] < 5000


def test_a_mechanism_is_followed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = 0
    one = Guide._step

    def counted(self: Guide, *arguments: object) -> object:
        nonlocal steps
        steps += 1
        return one(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Guide, "_step", counted)
    found = along(five_bar(ROUND)).trajectory
    assert found.scaling.intervals > 200 and steps < 60


def test_samples_close_together_leave_steps_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step that the next sample cuts short says nothing about how long the one after it may be."""
    steps = 0
    one = Guide._step

    def counted(self: Guide, *arguments: object) -> object:
        nonlocal steps
        steps += 1
        return one(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Guide, "_step", counted)
    even = np.linspace(0.0, 3.0, 41)
    problem = Problem(along(five_bar(CIRCLE)))
    motion_at(problem, even)
    of_even, steps = steps, 0
    pairs = np.sort(np.concatenate([even, even[1:-1] + 1e-9]))
    motion_at(problem, pairs)
    assert steps < 4 * of_even


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_is_solved_near_what_is_known_is_what_is_followed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    center = (0.3 + 0.05 * rng.uniform(-1, 1), 0.9 + 0.05 * rng.uniform(-1, 1))
    circle = f"{{type: circle, point: tip, center: [{center[0]}, {center[1]}], radius: 0.1, duration: 3}}"
    for scene in (five_bar(circle), lines(3)):
        trajectory = getattr(scene.trajectory, "way", scene.trajectory)
        problem = Problem(led_by(scene, trajectory))
        T = trajectory.duration
        motion = MotionAlong(problem)
        motion(np.linspace(0.0, T, 65))
        followed = motion.known
        times = np.sort(np.concatenate([[0.0, T], rng.uniform(0.0, T, 40)]))
        found, wanted = motion(times), motion_at(problem, times)
        assert followed is not None and motion.known is not None and len(motion.known.times) == 65 + 40
        for name in ("q", "qd", "qdd"):
            size = np.abs(getattr(wanted, name)).max()
            assert np.abs(getattr(found, name) - getattr(wanted, name)).max() < 1e-9 * size


def test_torques_along_a_path_are_those_of_inverse_dynamics() -> None:
    rng = np.random.default_rng(5)
    scene = five_bar(ROUND)
    program = build_inverse(led_by(scene, scene.trajectory.way))
    motion = motion_at(program.problem, np.linspace(0.0, 3.0, 30))
    torques = limited_path(scene.trajectory, program).torques
    assert isinstance(torques, ClosedTorques)
    for _ in range(2):  # rates that the loops allow
        u, x = rng.uniform(-1.0, 1.0, (30, 1)), rng.uniform(0.1, 2.0, (30, 1))
        own = JointMotion(motion.q, motion.qd * np.sqrt(x), motion.qd * u + motion.qdd * x)
        tau = torques(*(np.asfortranarray(a) for a in (own.q, own.qd, own.qdd)))
        planned = Planned(np.zeros(30), own)
        wanted = program.evaluate(planned, program.compile(30)).tau
        assert np.abs(tau - wanted).max() < 1e-11 * np.abs(wanted).max()


def test_slides_that_a_coupler_ties_take_as_long_as_one_mass() -> None:
    """y = 2 x: the force on x moves m1 + 4 m2, so half of the way is speeded up on and half braked."""
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0], parent: base}, {name: y, type: prismatic, axis: [0, 1, 0], parent: base}]
  links: [{name: one, mass: 2, com: [0, 0, 0]}, {name: two, mass: 3, com: [0, 0, 0]}]
couplers: [{name: belt, terms: {y: 1, x: -2}}]
actuated: [x]
initial: {q: {x: 0, y: 0}}
trajectory: {type: fastest, points: [{q: {x: 0}}, {q: {x: 0.7}}], effort: {x: 10}}
"""
    found = along(load_scene_text(text)).trajectory.scaling
    assert found.law.duration == pytest.approx(2.0 * np.sqrt(0.7 * 14.0 / 10.0), rel=1e-9)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_the_error_of_a_mechanism_covers(tolerance: float) -> None:
    scene = five_bar(ROUND)
    fine = dataclasses.replace(scene.trajectory, intervals=3200)
    reference = along(dataclasses.replace(scene, trajectory=fine)).trajectory.scaling
    own = dataclasses.replace(scene.trajectory, tolerance=tolerance)
    found = along(dataclasses.replace(scene, trajectory=own)).trajectory.scaling
    off = abs(found.law.duration - reference.law.duration)
    assert off <= found.error + reference.error
    assert found.error < tolerance * found.law.duration + 1e-6


def test_what_moves_by_itself_is_refused() -> None:
    text = FIVE.read_text().split("trajectory:")[0]
    led = "trajectory: {type: fastest, points: [{q: {left: 2.2}}, {q: {left: 2.0}}], effort: {left: 30}}\n"
    moving = text.replace("actuated:", "prescribed: {right: '0.9 - 0.1*t'}\nactuated:") + led
    with pytest.raises(CapabilityError, match=r"prescribed\.right moves by a formula of t"):
        along(load_scene_text(moving, str(FIVE)))
    resting = text.replace("actuated:", "prescribed: {right: '0.9'}\nactuated:") + led
    assert along(load_scene_text(resting, str(FIVE))).trajectory.duration > 0.0


def test_a_dead_point_of_the_actuators_has_its_place() -> None:
    """A rocker cannot push the crank through where crank and coupler are one line."""
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  convention: standard
  joints:
    - {name: crank, type: revolute, parent: base, a: 0.4, alpha: 0, d: 0}
    - {name: coupler, type: revolute, parent: arm, a: 1.2, alpha: 0, d: 0}
    - {name: rocker, type: revolute, parent: base, origin: {xyz: [1.0, 0, 0]}, a: 0.9, alpha: 0, d: 0}
  links:
    - {name: arm, mass: 1, com: [0.2, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
    - {name: bar, mass: 1, com: [0.6, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
    - {name: swing, mass: 1, com: [0.4, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
loops: [{name: pin, type: revolute, between: [bar.end, swing.end]}]
actuated: [rocker]
initial: {q: {crank: 0.3, coupler: 0.2, rocker: 1.5}}
trajectory: {type: fastest, points: [{q: {crank: 0.3}}, {q: {crank: 0.8}}], effort: {rocker: 10}}
"""
    line = np.arccos((1.0 + 1.6**2 - 0.9**2) / (2.0 * 1.6)) - 0.3
    with pytest.raises(SingularConfigurationError, match="dead point of the actuators") as caught:
        along(load_scene_text(text))
    assert caught.value.details["time"] == pytest.approx(line, abs=0.5 / 200)
