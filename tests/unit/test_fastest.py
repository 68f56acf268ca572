"""Paths in the least time: closed forms, limits kept everywhere, and no path that a faster motion exists on."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import trapezoid

from robodyn_cli import load_scene, load_scene_text
from robodyn_cli.errors import CapabilityError, GeometryError, SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.ready.doors import along
from robodyn_cli.scene.types import Scene
from robodyn_cli.torques.dynamics import InverseDynamics
from robodyn_cli.works.inverse import inverse
from tests.random_paths import random_path
from tests.source import ROOT

MASS = """
schema: 1
gravity: [{gravity}, 0, 0]
robot:
  joints: [{{name: slide, type: prismatic, axis: [1, 0, 0]{friction}}}]
  links: [{{name: mass, mass: 2, com: [0, 0, 0]}}]
trajectory: {{type: fastest, points: [{{q: {{slide: 0}}}}, {{q: {{slide: 1}}}}], {limits}}}
"""
SEVEN = ROOT / "configs" / "seven_joint_arm.yaml"
WAY = (
    (0.0, 0.3, 0.0, 1.2, 0.0, 0.5, 0.0),
    (0.5, 0.8, -0.4, 0.8, 0.5, 1.0, 0.6),
    (1.0, 0.2, 0.3, 1.5, -0.3, 0.2, 1.0),
)
EFFORT = (120, 150, 60, 60, 20, 15, 8)
SPEED = (2, 2, 2.5, 2.5, 3, 3, 3)


def mass(limits: str, gravity: float = 0.0, friction: str = "") -> Scene:
    text = MASS.format(limits=limits, gravity=gravity, friction=friction and f", friction: {friction}")
    return load_scene_text(text, "mass.yaml")


def duration(scene: Scene) -> float:
    return float(along(scene).trajectory.duration)


def two_parts(up: float, down: float) -> float:
    """Return the time over 1 m that is speeded up on and braked on at these rates."""
    top = np.sqrt(2.0 * up * down / (up + down))
    return float(top / up + top / down)


def test_a_mass_under_a_force() -> None:
    assert duration(mass("effort: {slide: 10}")) == pytest.approx(two_parts(5.0, 5.0), abs=1e-12)


@pytest.mark.parametrize("gravity", [-4.0, -1.234, 3.3])
def test_a_mass_under_a_force_and_gravity(gravity: float) -> None:
    expected = two_parts(5.0 + gravity, 5.0 - gravity)
    assert duration(mass("effort: {slide: 10}", gravity)) == pytest.approx(expected, abs=1e-9)


def test_a_mass_under_limits_of_speed_and_acceleration() -> None:
    found = duration(mass("speed: {slide: 1.5}, acceleration: {slide: 4}"))
    assert found == pytest.approx(1.0 / 1.5 + 1.5 / 4.0, abs=1e-4)


def test_friction_slows_the_start_and_does_not_help_at_the_last_moment() -> None:
    found = duration(mass("effort: {slide: 10}", friction="{coulomb: 2}"))
    # braking with friction at 6 m/s^2, but for the last of it, where the drive alone brakes
    assert two_parts(4.0, 6.0) <= found < two_parts(4.0, 6.0) * 1.002


def test_viscous_friction() -> None:
    """F - d v = m a up to the switch, -F - d v = m a from there: the switching speed by bisection on the way."""
    found = duration(mass("effort: {slide: 10}", friction="{viscous: 3}"))
    F, d, m = 10.0, 3.0, 2.0

    def way_and_time(top: float) -> tuple[float, float]:
        v = np.linspace(0.0, top, 20001)
        up, down = m / (F - d * v), m / (F + d * v)
        return float(trapezoid(v * (up + down), v)), float(trapezoid(up + down, v))

    low, high = 0.0, F / d * (1.0 - 1e-9)
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if way_and_time(middle)[0] < 1.0 else (low, middle)
    assert found == pytest.approx(way_and_time(low)[1], rel=1e-4)


def seven(intervals: int) -> Scene:
    scene = load_scene(SEVEN)
    names = [f"q{k}" for k in range(1, 8)]
    text = f"points: [{', '.join('{q: ' + str(dict(zip(names, q))) + '}' for q in WAY)}]".replace("'", "")
    limits = {"effort": dict(zip(names, EFFORT)), "speed": dict(zip(names, SPEED))}
    given = "\n".join(f"  {name}: {value}".replace("'", "") for name, value in limits.items())
    head = SEVEN.read_text().split("trajectory:")[0]
    end = f"trajectory:\n  type: fastest\n  {text}\n{given}\n  intervals: {intervals}\n"
    assert scene.robot.joints
    return load_scene_text(head + end, str(SEVEN))


def test_no_limit_is_passed_between_grid_points() -> None:
    scene = along(seven(100))
    law = scene.trajectory.scaling.law
    # many times in each interval, but the last moment, at rest without friction
    times = (law.knots[:-1, None] + np.diff(law.knots)[:, None] * np.linspace(1e-6, 1.0 - 1e-6, 41)).ravel()
    names = [f"q{k}" for k in range(1, 8)]
    motion = scene.trajectory.motion(times, names, {})
    tau = InverseDynamics(dataclasses.replace(scene, trajectory=None))(motion.q, motion.qd, motion.qdd)
    use = np.maximum(np.abs(tau) / EFFORT, np.abs(motion.qd) / SPEED)
    assert use.max() <= 1.0 + 1e-6
    # and one of them is touched nearly all the time
    assert np.mean(use.max(axis=1) > 0.999) > 0.9


@pytest.mark.parametrize("seed", range(6))
def test_random_paths_under_random_limits(seed: int) -> None:
    """No limit is passed between grid points, one binds nearly always, and the time converges from above."""
    rng = np.random.default_rng(seed)
    path = ROOT / "configs" / "trajectories" / "fastest_2r.yaml"
    q = np.cumsum(rng.uniform(-1.0, 1.0, (4, 2)), axis=0)
    points = ", ".join(f"{{q: {{theta1: {a:.6f}, theta2: {b:.6f}}}}}" for a, b in q)
    bounds = {
        name: rng.uniform(low, high)
        for name, low, high in (
            ("effort", [320, 140], [600, 250]),
            ("speed", [1, 1], [4, 4]),
            ("acceleration", [10, 10], [60, 60]),
        )
    }
    limits = ", ".join(f"{name}: {{theta1: {a}, theta2: {b}}}" for name, (a, b) in bounds.items())
    head = path.read_text().split("trajectory:")[0]

    def timed(intervals: int) -> Scene:
        text = f"{head}trajectory: {{type: fastest, points: [{points}], {limits}, intervals: {intervals}}}\n"
        return along(load_scene_text(text, str(path)))

    scene = timed(200)
    law = scene.trajectory.scaling.law
    times = (law.knots[:-1, None] + np.diff(law.knots)[:, None] * np.linspace(1e-6, 1.0 - 1e-6, 41)).ravel()
    motion = scene.trajectory.motion(times, ["theta1", "theta2"], {})
    tau = InverseDynamics(dataclasses.replace(scene, trajectory=None))(motion.q, motion.qd, motion.qdd)
    parts = (tau, "effort"), (motion.qd, "speed"), (motion.qdd, "acceleration")
    use = np.max([np.abs(x) / bounds[name] for x, name in parts], axis=(0, 2))
    assert use.max() <= 1.0 + 1e-6
    assert np.mean(use > 0.99) > 0.9
    fine = timed(1600).trajectory.scaling
    assert fine.error < 1e-4 * fine.law.duration
    assert -fine.error < law.duration - fine.law.duration < scene.trajectory.scaling.error + fine.error


@pytest.mark.parametrize("seed", [0, 1, 6, 14, 29])
def test_random_arms_meet_their_tolerance(seed: int) -> None:
    """The duration is within the tolerance of that on a much finer grid, the stated error is honest, limits are kept."""
    scene = random_path(seed)
    found = along(scene).trajectory
    finer = dataclasses.replace(scene.trajectory, intervals=8 * found.scaling.intervals)
    fine = along(dataclasses.replace(scene, trajectory=finer)).trajectory.scaling
    off = found.duration - fine.law.duration
    assert -fine.error <= off < 1e-4 * found.duration
    assert off < 1.5 * found.scaling.error < 1.5e-4 * found.duration + 1e-9
    law = found.scaling.law
    times = (law.knots[:-1, None] + np.diff(law.knots)[:, None] * np.linspace(1e-6, 1.0 - 1e-6, 41)).ravel()
    model = build_model(scene)
    motion = found.motion(times, model.q_names, {})
    tau = InverseDynamics(dataclasses.replace(scene, trajectory=None))(motion.q, motion.qd, motion.qdd)
    values = {"effort": tau, "speed": motion.qd, "acceleration": motion.qdd}
    for kind, limits in found.scaling.limits.items():
        for name, bound in limits.items():
            assert np.abs(values[kind][:, model.v_names.index(name)]).max() <= bound * (1.0 + 1e-6)


def test_a_tighter_tolerance_takes_more_intervals() -> None:
    scene = seven(100)
    found = []
    for tolerance in (1e-2, 1e-5):
        trajectory = dataclasses.replace(scene.trajectory, intervals=None, tolerance=tolerance)
        found.append(along(dataclasses.replace(scene, trajectory=trajectory)).trajectory.scaling)
    loose, tight = found
    assert tight.intervals > 2 * loose.intervals
    assert tight.error < 1e-5 * tight.law.duration < loose.error


def test_the_time_converges_and_its_error_is_stated() -> None:
    coarse, fine = (along(seven(n)).trajectory.scaling for n in (100, 400))
    assert fine.law.duration <= coarse.law.duration
    assert coarse.law.duration - fine.law.duration < 2.0 * coarse.error
    assert coarse.error < 1e-2 * coarse.law.duration


def test_a_slower_motion_of_the_same_path_needs_less_and_a_faster_one_more() -> None:
    """Brute force: no time law of a family of others is faster and keeps to the limits."""
    scene = load_scene(ROOT / "configs" / "trajectories" / "fastest_2r.yaml")
    least = inverse(scene, samples=2001)
    circle = dataclasses.replace(scene.trajectory.path, duration=1.0)
    assert least.summary["fastest"]["largest_use"] == pytest.approx(1.0, abs=1e-6)
    T = least.summary["fastest"]["duration"]
    for power in (1.0, 1.5, 2.0):  # s = 1 / (1 + ((1 - r) / r)^p) with r from a smooth step
        r = np.linspace(0.0, 1.0, 400)
        smooth = 6 * r**5 - 15 * r**4 + 10 * r**3
        s = smooth**power / (smooth**power + (1.0 - smooth) ** power)
        assert _least_time(scene, circle, s) >= T * (1.0 - 1e-3)


def _least_time(scene: Scene, circle: object, s: np.ndarray) -> float:
    """Return the shortest time in which s, at uniform times, keeps to the limits of torque."""
    from robodyn_cli.equations.problem import Problem
    from robodyn_cli.given.motion import plan_motion

    problem = Problem(along(dataclasses.replace(scene, trajectory=circle)))
    law = dataclasses.replace(problem.scene, trajectory=circle)
    way = plan_motion(Problem(along(law)), s).motion
    h = 1.0 / (len(s) - 1)
    sd, sdd = np.gradient(s, h), np.gradient(np.gradient(s, h), h)
    dynamics, bounds = InverseDynamics(problem), np.array([250.0, 120.0])
    low, high = 0.2, 50.0
    for _ in range(40):
        T = 0.5 * (low + high)
        qd, qdd = way.qd * (sd / T)[:, None], way.qdd * ((sd / T) ** 2)[:, None]
        tau = dynamics(way.q, qd, qdd + way.qd * (sdd / T**2)[:, None])
        low, high = (low, T) if (np.abs(tau) <= bounds).all() else (T, high)
    return high


STOPS = (
    "{{type: fastest, effort: {{theta1: 250, theta2: 120}}, path: {{type: path, point: tip, law: quintic, speed: 1, "
    "start: {{position: {}}}, ik: {{branch: elbow_up}}, segments: [{}]}}}}"
)
THERE, BACK = "{type: line, to: [1.0, 1.2, 0]}", "{type: line, to: [0.6, 1.5, 0]}"


def stopping(start: str, *segments: str, payload: str = "") -> Scene:
    """Return the scene of an arm that goes along lines in the least time; payload : instants of a mass at the tip."""
    path = ROOT / "configs" / "trajectories" / "fastest_2r.yaml"
    before = path.read_text().split("trajectory:")[0]
    mass = f"payloads: [{{name: part, at: tip, mass: 5, inertia: {{zz: 0}}, {payload}}}]\n" if payload else ""
    return load_scene_text(
        f"{before}trajectory: {STOPS.format(start, ', '.join(segments))}\n{mass}", str(path)
    )


def test_a_path_with_stops_is_its_ways_one_after_another() -> None:
    first, second = duration(stopping("[1.4, 1.0, 0]", THERE)), duration(stopping("[1.0, 1.2, 0]", BACK))
    both = stopping("[1.4, 1.0, 0]", THERE.replace("}", ", dwell: 0.2}"), BACK)
    assert duration(both) == pytest.approx(first + 0.2 + second, rel=1e-6)
    result = inverse(both)
    figures = result.summary["fastest"]
    assert figures["duration"] == pytest.approx(first + 0.2 + second, rel=1e-6)
    assert figures["largest_use"] == pytest.approx(1.0, abs=1e-6)
    law = along(both).trajectory.scaling.law
    assert np.all(np.diff(law(np.linspace(0.0, law.duration, 200))[:, 0]) >= -1e-12), (
        "the path is not gone back"
    )
    still = (result.time > first + 1e-6) & (result.time < first + 0.2 - 1e-6)
    assert still.any() and not result["qd"][still].any()
    assert (np.abs(result["tau"]).max(axis=0) <= np.array([250, 120]) * (1 + 1e-6)).all()


def test_payloads_change_where_the_motion_rests() -> None:
    """Behind the stop the arm carries more, which takes longer; limits hold with what is carried."""
    lines = THERE.replace("}", ", dwell: 0.2}"), BACK
    first = duration(stopping("[1.4, 1.0, 0]", THERE))
    loaded = stopping("[1.4, 1.0, 0]", *lines, payload=f"from: {{time: {first + 0.1}}}")
    assert duration(loaded) > duration(stopping("[1.4, 1.0, 0]", *lines)) + 1e-3
    tau = np.abs(inverse(loaded)["tau"]).max(axis=0)
    assert (tau <= np.array([250, 120]) * (1 + 1e-6)).all() and (tau / [250, 120]).max() > 0.999
    with pytest.raises(CapabilityError, match="payload 'part' changes at .* on a way in the least time"):
        duration(stopping("[1.4, 1.0, 0]", *lines, payload=f"from: {{time: {0.5 * first}}}"))


def test_the_time_law_of_a_path_is_dropped() -> None:
    scene = load_scene(ROOT / "configs" / "trajectories" / "fastest_2r.yaml")
    text = (ROOT / "configs" / "trajectories" / "fastest_2r.yaml").read_text()
    before, found = text.split("  path:")[0], []
    for law in ("quintic, speed: 1", "trapezoid, speed: 0.3, acceleration: 2"):
        way = f"{{type: path, point: tip, start: {{position: [1.4, 1.0, 0]}}, law: {law}, ik: {{branch: elbow_up}}, "
        way += "segments: [{type: line, to: [1.0, 1.2, 0]}]}"
        line = load_scene_text(
            f"{before}  path: {way}\n  effort: {{theta1: 250, theta2: 120}}\n", str(scene.path)
        )
        found.append(duration(line))
    assert found[0] == pytest.approx(found[1], rel=1e-6)


REFUSED = [
    ("{type: fastest, effort: {slide: 1}}", SceneError, "either 'points' or 'path'"),
    (
        "{type: fastest, path: {type: fastest, points: [{q: {slide: 0}}, {q: {slide: 1}}]}}",
        SceneError,
        "allowed: joint, quintic,",
    ),
    ("{type: fastest, points: [{q: {slide: 0}}, {q: {slide: 1}}]}", SceneError, "needs limits"),
    (
        "{type: fastest, points: [{q: {slide: 0}}, {q: {slide: 0}}], effort: {slide: 1}}",
        SceneError,
        "leave one",
    ),
    ("{type: fastest, points: [{q: {slide: 0}}, {q: {slide: 1}}], effort: {slid: 1}}", SceneError, "slid"),
    (
        "{type: fastest, effort: {slide: 9}, path: {type: joint, q: {slide: '(t-1)^2'}, duration: 2}}",
        GeometryError,
        "stands still",
    ),
    (
        "{type: fastest, effort: {slide: 9}, path: {type: table, interpolation: linear, columns: [t, slide], "
        "rows: [[0, 0], [1, 1], [2, 3]]}}",
        GeometryError,
        "corner",
    ),
]


@pytest.mark.parametrize(("trajectory", "error", "words"), REFUSED)
def test_what_is_wrong_is_said(trajectory: str, error: type[Exception], words: str) -> None:
    text = (
        MASS.format(limits="", gravity=0, friction="").split("trajectory:")[0] + f"trajectory: {trajectory}\n"
    )
    with pytest.raises(error, match=words):
        along(load_scene_text(text, "mass.yaml"))


def test_a_drive_that_cannot_hold_the_weight_is_named() -> None:
    with pytest.raises(
        GeometryError, match="'slide' needs 20 there at rest, and its effort is limited to 10"
    ):
        along(mass("effort: {slide: 10}", gravity=-10.0))


def test_losses_of_gears_are_refused() -> None:
    text = MASS.format(limits="effort: {slide: 9}", gravity=0, friction="")
    text = text.replace("axis: [1, 0, 0]", "axis: [1, 0, 0], gear: {ratio: 10, efficiency: 0.8}")
    with pytest.raises((CapabilityError, SceneError)):
        along(load_scene_text(text, "mass.yaml"))


def test_a_mechanism_keeps_to_the_limits_of_its_drives() -> None:
    path = ROOT / "robodyn_cli" / "robots" / "five_bar.yaml"
    text, circle = (
        path.read_text(),
        "{type: circle, point: tip, center: [0.3, 0.9], radius: 0.15, duration: 3}",
    )
    assert circle in text
    scene = load_scene_text(text, str(path))
    drives = scene.actuated
    assert drives is not None
    slow = inverse(scene, samples=51)
    columns = [list(slow.variables["tau"].names).index(name) for name in drives]
    bounds = {name: 2.0 * float(np.abs(slow["tau"][:, k]).max()) for name, k in zip(drives, columns)}
    limits = ", ".join(f"{name}: {x}" for name, x in bounds.items())
    timed = f"{{type: fastest, intervals: 16, effort: {{{limits}}}, path: {circle}}}"
    found = inverse(load_scene_text(text.replace(circle, timed), str(path)), samples=51)
    assert 0.99 < found.summary["fastest"]["largest_use"] <= 1.0 + 1e-6
    use = np.abs(found["tau"][:, columns]) / np.array(list(bounds.values()))
    assert np.mean(use.max(axis=1) > 0.8) > 0.9
