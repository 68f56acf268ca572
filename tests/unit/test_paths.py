"""Paths of frames: exact derivatives, limits, geometry in closed form, joints that follow them, and bad input."""

from __future__ import annotations

import dataclasses
import math
import pickle
from typing import Any

import numpy as np
import pytest

from robodyn_cli import InverseKinematics, assemble, load_scene
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from robodyn_cli.given.motion import point_task
from robodyn_cli.ready.doors import along
from robodyn_cli.scene import load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.fields import Orientation
from robodyn_cli.spatial.algebra import Array, rotation_rpy
from robodyn_cli.trajectories.base import Ik
from robodyn_cli.trajectories.motion import PointMotion, PoseMotion
from robodyn_cli.trajectories.path import PathStart, PathTrajectory
from robodyn_cli.trajectories.task import taylor
from robodyn_cli.trajectories.task.segments import LineSegment
from robodyn_cli.trajectories.task.stretch import LIMITS
from robodyn_cli.works.kinematics import plan
from tests.engines import to_pinocchio
from tests.numeric import assert_close
from tests.source import ROOT

ROBOT = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints: [{name: body, type: floating}]
  links: [{name: craft, mass: 1, com: [0, 0, 0], inertia: {xx: 1, yy: 1, zz: 1}}]
  points: {tip: {link: craft, at: [0, 0, 0]}, table: {link: base, at: [1, 2, 3]}}
  frames: {bench: {link: base, at: [1, 2, 3], axis: [1, 1, 0], angle: 0.7}}
loops: [{name: near, type: distance, between: [base.origin, tip], length: 9}]
"""  # closed, so that a path of a point is accepted: only the path itself is looked at here
LIMITED = (
    "speed: 0.6, acceleration: 2, jerk: 15, angular_speed: 1.5, angular_acceleration: 6, angular_jerk: 50"
)
TURNED = "orientation: {axis: [1, 2, -1], angle: 0.9}"
CORNERS = (
    "start: {position: [0, 0, 0], orientation: {rpy: [0.1, 0, 0]}}, segments: ["
    f"{{type: line, to: [1, 0, 0], blend: 0.1, {TURNED}}}, {{type: line, to: [1, 0.8, 0.1], blend: 0.2}},"
    "{type: line, to: [0, 1, 0.5], orientation: {rpy: [1, -1, 2]}, dwell: 0.3},"
    "{type: line, to: [0, 1, 0.5], orientation: {rpy: [0, 0, 2]}},"
    "{type: arc, via: [0.3, 1.1, 0.6], to: [0.4, 0.8, 0.9], orientation: {rpy: [0, 1, 0]}},"
    "{type: spline, through: [[0.4, 0.5, 0.2], [0, 0.2, 0.4], [0.1, 0, 0]], orientation: {rpy: [0, 0, 0]}}]"
)
POINTS = [[0.4, 0.5, 0.2], [0, 0.6, 0.4], [0.1, 0.2, 0.1], [0.5, 0.1, -0.2]]
ATTITUDES = [[0.4, -0.2, 0.9], [1.2, 0.3, 1.5], [0.3, 1.1, 2.6], [-0.5, 0.4, 3.6]]
SPLINE = (
    "start: {position: [0, 0, 0], orientation: {rpy: [0.1, 0, 0]}}, segments: ["
    f"{{type: spline, through: {POINTS}, orientations: [{', '.join(f'{{rpy: {x}}}' for x in ATTITUDES)}], dwell: 0.2}},"
    "{type: line, to: [0.5, 0.4, -0.2], orientation: {rpy: [0, 0, 0]}}]"
)
ROUND = (
    "start: {position: [1, 0, 0]}, segments: [{type: line, to: [1, 0.5, 0], blend: 0},"
    "{type: circle, center: [0.6, 0.5, 0], angle: 90 deg, blend: 0}, {type: line, to: [0, 0.9, 0]}]"
)


def path(rest: str, law: str = "s_curve", limits: str = LIMITED):
    text = f"{ROBOT}trajectory: {{type: path, point: tip, law: {law}, {limits}, {rest}}}"
    return load_scene_text(text).trajectory


def smooth_times(motion, count: int, h: float) -> Array:
    """Return random times further than h from where an acceleration jumps."""
    knots = np.array([0.0, *motion.knots, motion.duration])
    times = np.random.default_rng(7).uniform(0.0, motion.duration, count)
    return times[np.abs(times[:, None] - knots).min(axis=1) > 1.1 * h]


def turned(R: Array, before: Array) -> Array:
    """Return R before^T - its transpose, as the vector of a small turn (T, 3)."""
    D = R @ np.swapaxes(before, -1, -2)
    return 0.5 * np.stack(
        [D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], axis=-1
    )


@pytest.mark.parametrize("rest", [CORNERS, SPLINE])
def test_paths_go_to_other_processes(rest: str) -> None:
    """Studies send scenes whose paths have been read already."""
    motion = path(rest)
    times = smooth_times(motion, 20, 1e-5)
    here, there = (x.target(times, {}) for x in (motion, pickle.loads(pickle.dumps(motion))))
    assert np.array_equal(here.pdd, there.pdd)


@pytest.mark.parametrize("law", ["s_curve", "trapezoid", "quintic", "cubic"])
@pytest.mark.parametrize(
    "rest",
    [
        CORNERS,
        SPLINE,
        ROUND + ", facing: {to: tangent, axis: y, up: [0, 0.1, 1]}",
        ROUND + ", facing: {to: [0.2, 0.1, -1], axis: z, up: [1, 0, 0]}",
    ],
)
def test_rates_are_exact_and_limits_hold(rest: str, law: str) -> None:
    limits = ", ".join(x for x in LIMITED.split(", ") if law in ("s_curve", "quintic") or "jerk" not in x)
    motion, h = path(rest, law, limits), 1e-5
    times = smooth_times(motion, 300, 2 * h)
    assert len(times) > 200
    at, before, after = (motion.target(times + x, {}) for x in (0.0, -h, h))
    assert isinstance(at, PoseMotion)
    assert_close((after.p - before.p) / (2 * h), at.pd, 1e-8, scale=1.0)
    assert_close((after.pd - before.pd) / (2 * h), at.pdd, 1e-7, scale=1.0)
    assert_close(turned(after.R, before.R) / (2 * h), at.w, 1e-8, scale=1.0)
    assert_close((after.w - before.w) / (2 * h), at.wd, 1e-6, scale=1.0)
    assert_close(at.R @ np.swapaxes(at.R, -1, -2), np.broadcast_to(np.eye(3), at.R.shape), 1e-13)
    jerks = [(after.pdd - before.pdd) / (2 * h), (after.wd - before.wd) / (2 * h)]
    sizes = dict(zip(LIMITS, [at.pd, at.pdd, jerks[0], at.w, at.wd, jerks[1]]))
    for name, x in sizes.items():
        bound = getattr(motion, name)
        if bound is not None:
            assert np.linalg.norm(x, axis=1).max() <= bound * (1.0 + 1e-5)


@pytest.mark.parametrize("seed", range(6))
def test_random_paths_touch_a_limit_and_pass_none(seed: int) -> None:
    random = np.random.default_rng(seed)
    ways = random.normal(size=(4, 3)) + [[2.0, 0.0, 0.0]] * 4
    points = np.cumsum([random.normal(size=3), *ways], axis=0).tolist()
    turns = random.normal(size=(3, 3)).tolist()
    corners = [
        f"{{type: line, to: {p}, blend: 0.2, orientation: {{rpy: {w}}}}}" for p, w in zip(points[1:], turns)
    ]
    segments = ", ".join([*corners, f"{{type: line, to: {points[-1]}}}"])
    motion = path(f"start: {{position: {points[0]}, orientation: {{}}}}, segments: [{segments}]")
    knots = np.array([0.0, *motion.knots, motion.duration])
    times = np.unique(np.linspace(knots[:-1], knots[1:], 2001))
    found, h = motion.target(times, {}), np.diff(times)[:, None]
    steps = [np.diff(x, axis=0)[h[:, 0] > 1e-6] / h[h[:, 0] > 1e-6] for x in (found.pdd, found.wd)]
    rates = dict(zip(LIMITS, [found.pd, found.pdd, steps[0], found.w, found.wd, steps[1]]))
    used = [np.linalg.norm(x, axis=1).max() / getattr(motion, name) for name, x in rates.items()]
    assert 0.999 < max(used) <= 1.0 + 1e-8


def test_a_line_takes_the_time_of_its_law() -> None:
    motion = path(
        "start: {position: [0, 0, 0]}, segments: [{type: line, to: [0, 3, 4]}]",
        "trapezoid",
        "speed: 2, acceleration: 4",
    )
    assert math.isclose(motion.duration, 5.0 / 2.0 + 2.0 / 4.0, rel_tol=1e-12)
    found = motion.target(np.array([0.25, 1.0, motion.duration]), {})
    assert isinstance(found, PointMotion)
    s = np.array([0.5 * 4 * 0.25**2, 0.5 + 2 * 0.5, 5.0])
    assert_close(found.p, s[:, None] * [0.0, 0.6, 0.8], 1e-12)


def test_arcs_circles_and_splines_pass_their_points() -> None:
    arc = path(
        "start: {position: [1, 0, 0]}, segments: [{type: arc, via: [0, 0, 1], to: [0, 1, 0]}]",
        "cubic",
        "speed: 1",
    )
    p = arc.target(np.linspace(0, arc.duration, 101), {}).p
    assert_close(np.linalg.norm(p, axis=1), np.ones(101), 1e-12)
    assert_close(p[-1], [0.0, 1.0, 0.0], 1e-12)
    assert np.linalg.norm(p - [0, 0, 1], axis=1).min() < 0.05
    circle = path(
        "start: {position: [0, 2, 1]}, segments: [{type: circle, center: [0, 0, 1], normal: [1, 0, 0], angle: -270 deg}]", "cubic", "speed: 1"
    )  # fmt: skip
    assert_close(circle.target(np.array([circle.duration]), {}).p[0], [0.0, 0.0, 3.0], 1e-12)
    assert math.isclose(circle.duration, 1.5 * 1.5 * math.pi * 2.0, rel_tol=1e-9)
    curve = path(
        "start: {position: [0, 0, 0]}, segments: [{type: spline, through: [[1, 1, 0], [2, 0, 1], [3, 1, 1]]}]",
        "quintic",
        "speed: 1",
    )
    t = np.linspace(0, curve.duration, 20001)
    found = curve.target(t, {})
    for point in ([1, 1, 0], [2, 0, 1], [3, 1, 1]):
        assert np.linalg.norm(found.p - point, axis=1).min() < 1e-3
    speed = np.linalg.norm(found.pd, axis=1)
    length = float(np.sum(np.linalg.norm(np.diff(found.p, axis=0), axis=1)))
    assert math.isclose(speed.max(), 1.0, rel_tol=1e-9) and math.isclose(
        curve.duration, 1.875 * length, rel_tol=1e-6
    )


def test_a_spline_passes_its_attitudes_smoothly() -> None:
    """The frame is turned as asked at each point, and w-dot jumps at none; equal attitudes do not turn it."""
    motion = path(SPLINE)
    stretch = motion.plan.stretches[0]
    for s, place, rpy in zip([*stretch.knots[1:]], POINTS, ATTITUDES):
        p = stretch.position(np.array([s]))
        assert_close(p[0, 0], np.array(place), 1e-10, scale=1.0)
        assert_close(
            stretch.turning.axes(p, np.array([s]))[0, 0], np.array(rotation_rpy(rpy)), 1e-11, scale=1.0
        )
    inside = stretch.knots[1:-1]
    w, wd = (
        [
            taylor.angular(stretch.turning.axes(stretch.position(s), s))[k]
            for s in (inside - 1e-9, inside + 1e-9)
        ]
        for k in (0, 1)
    )
    assert_close(w[0], w[1], 1e-6, scale=1.0)
    assert_close(wd[0], wd[1], 1e-5, scale=1.0)
    still = SPLINE.replace("rpy: [0.1, 0, 0]", "rpy: [0.4, 0, 0]")
    for rpy in ATTITUDES:
        still = still.replace(f"{{rpy: {rpy}}}", "{rpy: [0.4, 0, 0]}")
    fixed = path(still)
    times = np.linspace(0.0, fixed.plan.stretches[0].duration, 51)
    found = fixed.target(times, {})
    assert_close(found.R, np.broadcast_to(np.array(rotation_rpy([0.4, 0, 0])), (51, 3, 3)), 1e-14)
    assert np.abs(found.w).max() < 1e-14


def test_a_turn_is_about_one_axis_the_shorter_way() -> None:
    motion = path(
        "start: {position: [0, 0, 0], orientation: {rpy: [0, 0, 170 deg]}}, segments: [{type: line, to: [0, 0, 0],"
        " orientation: {rpy: [0, 0, -170 deg]}}]", "cubic", "angular_speed: 1")  # fmt: skip
    found = motion.target(np.linspace(0, motion.duration, 11), {})
    assert_close(motion.duration, 1.5 * math.radians(20.0), 1e-9)
    assert_close(found.w[:, :2], np.zeros((11, 2)), 1e-12)
    assert np.all(found.w[1:-1, 2] > 0.0) and not found.pd.any()
    half = path(
        "start: {position: [0, 0, 0], orientation: {}}, segments: [{type: line, to: [1, 0, 0], orientation: {rpy: [180 deg, 0, 0]}}]",
        "cubic",
        "speed: 1",
    )
    assert_close(half.target(np.array([half.duration]), {}).R[0], np.diag([1.0, -1.0, -1.0]), 1e-12)


def test_series_of_known_functions() -> None:
    x = np.array([0.3, 1.1])
    a = np.array([x, np.ones(2), np.zeros(2), np.zeros(2)])
    s, c = taylor.sine_and_cosine(a)
    assert_close(s[3], -np.cos(x) / 6.0, 1e-15)
    twice = taylor.composed(s, np.array([a[0], 2.0 * np.ones(2), np.zeros(2), np.zeros(2)]))
    assert_close(twice[2], -4.0 * np.sin(x) / 2.0, 1e-15)
    assert_close((taylor.scaled(s, s) + taylor.scaled(c, c))[1:], np.zeros((3, 2)), 1e-15, scale=1.0)


@pytest.mark.parametrize(
    ("rest", "limits", "law", "words"),
    [
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [0, 0, 0]}]", "speed: 1", "cubic", "nothing moves"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [1, 0, 0]}]", "speed: 1", "s_curve", "limit 'acceleration'"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [1, 0, 0]}]", "acceleration: 0", "trapezoid", "> 0"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [1, 0, 0], duration: 1}]", "speed: 1", "cubic", "allowed: 1.5 s or more"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [1, 0, 0], blend: 0}, {type: line, to: [1, 1, 0]}]", "speed: 1", "cubic", "turns by 90 deg"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [1, 0, 0], blend: 2}, {type: line, to: [1, 1, 0]}]", "speed: 1", "cubic", "up to 1"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [1, 0, 0], blend: 0.1}, {type: line, to: [0, 0, 0]}]", "speed: 1", "cubic", "turns back"),
        ("start: {position: [0, 0, 0]}, segments: [{type: arc, via: [1, 0, 0], to: [2, 0, 0]}]", "speed: 1", "cubic", "on one line"),
        ("start: {position: [0, 0, 0]}, segments: [{type: circle, center: [1, 0, 1]}]", "speed: 1", "cubic", "beside the plane"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [1, 0, 0], blend: 0.1}]", "speed: 1", "cubic", "path ends here"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [0, 0, 1]}], facing: {to: tangent}", "speed: 1", "cubic", "parallel to 'up'"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [0, 0, 1], orientation: {rpy: [0, 0, 1]}}]", "speed: 1", "cubic", "with start.orientation"),
        ("start: {position: [0, 0, 0], orientation: {quaternion: [1, 1, 0, 0]}}, segments: [{type: line, to: [0, 0, 1]}]", "speed: 1", "cubic", "length 1"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [0, 0, 1]}], relative_to: tip", "speed: 1", "cubic", "no joint moves"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [0, 0, 1]}], relative_to: bnch", "speed: 1", "cubic", "unknown point"),
        ("start: {position: [0, 0, 0]}, segments: [{type: spline, through: [[1, 0, 0], [1, 0, 0]]}]", "speed: 1", "cubic", "point before it"),
        (SPLINE.replace("dwell: 0.2", "blend: 0"), "speed: 1", "cubic", "has to stop there"),
        (SPLINE.replace("dwell: 0.2", "orientation: {}"), "speed: 1", "cubic", "one of them"),
        (SPLINE.replace(", [0.5, 0.1, -0.2]]", "]"), "speed: 1", "cubic", "one for each of the 3 points"),
        (SPLINE.replace(", orientation: {rpy: [0.1, 0, 0]}", ""), "speed: 1", "cubic", "with start.orientation"),
        ("start: {position: [0, 1e300, 0]}, segments: [{type: line, to: [1, 0, 0], blend: 0.1}, {type: line, to: [1, 1, 0]}]", "speed: 1", "cubic", "too far away"),
        ("start: {position: [0, 0, 0]}, segments: [{type: circle, center: [1e200, 0, 0]}]", "speed: 1", "cubic", "too far away"),
        ("start: {position: [0, 0, 0]}, segments: [{type: spline, through: [[1e200, 0, 0], [1, 1, 1]]}]", "speed: 1", "cubic", "too far away"),
        ("start: {position: [0, 0, 0]}, segments: [{type: line, to: [1, 0, 0], blend: 1e-300}, {type: line, to: [1, 1, 0]}]", "speed: 1", "cubic", "round no corner"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_name(rest: str, limits: str, law: str, words: str) -> None:
    with pytest.raises(SceneError, match="trajectory") as caught:
        path(rest, law, limits)
    assert words in str(caught.value)


# -- arms and mechanisms that follow ------------------------------------------------------------------------
PUMA = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  include: %s
  base: {xyz: [0.1, 0.2, 0.05], rpy: [0.1, 0.2, 0.3]}
  frames: {hand: {link: link6, at: [0.02, -0.01, 0.1], rpy: [0.3, -0.2, 0.5]}, bench: {link: base, at: [0.45, -0.25, 0.55], rpy: [0.2, 0.1, 0.4]}}
""" % (ROOT / "configs" / "robots" / "puma560.yaml")  # fmt: skip
WAYS = (
    "relative_to: bench, speed: 0.8, acceleration: 4, jerk: 60, angular_speed: 3, angular_acceleration: 15,"
    "angular_jerk: 300, start: {position: [0, 0, 0.2], orientation: {rpy: [2.8, 0.2, 0.1]}}, segments: ["
    "{type: line, to: [-0.1, 0.3, 0.2], blend: 0.05, orientation: {rpy: [2.5, -0.2, 1]}},"
    "{type: line, to: [-0.1, 0.4, 0.05]}, {type: arc, via: [0.05, 0.2, 0.1], to: [0, 0, 0.2], orientation: {rpy: [2.8, 0.2, 0.1]}}]"
)  # fmt: skip
FORMULAS = (
    'type: cartesian, duration: 3, relative_to: bench, position: ["0.1*cos(t)", "0.1*sin(2*t)", "0.1 + 0.05*t"],'
    'orientation: {rpy: ["2.8 + 0.2*sin(t)", "0.3*cos(2*t)", "0.5*sin(t)"]}'
)


@pytest.mark.parametrize("kind", ["type: path, " + WAYS, FORMULAS])
def test_pinocchio_finds_the_frame_where_the_path_asks_and_as_fast(kind: str) -> None:
    pin = pytest.importorskip("pinocchio")
    text = f"{PUMA}trajectory: {{{kind}, point: hand, ik: {{branch: righty-elbow_up-flip}}}}"
    scene = along(load_scene_text(text))
    problem = Problem(
        dataclasses.replace(scene, kinematics=dataclasses.replace(scene.kinematics, samples=60))
    )
    planned = plan(problem)[0]
    asked = point_task(problem).target(planned.times)
    assert isinstance(asked, PoseMotion)
    model, frame = to_pinocchio(problem.model), problem.model.place("hand")
    base = np.array(problem.model.base.E, dtype=float).T, np.array(problem.model.base.r, dtype=float)
    name = model.model.getFrameId("hand")
    world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    assert frame.body == 5
    for k in range(60):
        q, v, a = (model.to(x[k]) for x in (planned.motion.q, planned.motion.qd, planned.motion.qdd))
        pin.forwardKinematics(model.model, model.data, q, v, a)
        pin.updateFramePlacements(model.model, model.data)
        at = model.data.oMf[name]
        rate = pin.getFrameVelocity(model.model, model.data, name, world)
        second = pin.getFrameClassicalAcceleration(model.model, model.data, name, world)
        assert_close(base[1] + base[0] @ at.translation, asked.p[k], 1e-11, scale=1.0)
        assert_close(base[0] @ at.rotation, asked.R[k], 1e-11, scale=1.0)
        for found, linear, angular in ((rate, asked.pd, asked.w), (second, asked.pdd, asked.wd)):
            assert_close(base[0] @ found.linear, linear[k], 1e-9, scale=10.0)
            assert_close(base[0] @ found.angular, angular[k], 1e-9, scale=10.0)


def test_a_redundant_arm_and_a_platform_follow_paths() -> None:
    arm = load_scene(ROOT / "robodyn_cli" / "robots" / "seven_joint_arm.yaml")
    follow(arm, "link7", [0.1, 0.6, 0.2, -1.5, 0.3, 1.2, 0.1])
    platform = load_scene(ROOT / "robodyn_cli" / "robots" / "stewart_platform.yaml")
    follow(dataclasses.replace(platform, prescribed={}), "platform", assemble(platform)["q"][0])


def follow(scene: Scene, frame: str, q: Any) -> None:
    """Lead a frame along a path from where it is, and compare poses at the samples."""
    solver = InverseKinematics(scene, frame)
    p, R = (x[0] for x in solver.forward(np.array(q)[None]))
    to = (p + [0.03, 0.05, -0.04]).tolist()
    trajectory = PathTrajectory(
        "path", f"{frame}.origin", PathStart(tuple(p), Orientation(matrix=tuple(map(tuple, R)))),
        (LineSegment("line", to, Orientation(matrix=tuple(map(tuple, R @ np.array(rotation_rpy((0.1, -0.05, 0.2)), dtype=float))))),),
        law="quintic", speed=0.2, ik=dataclasses.replace(Ik(), guess=dict(zip(solver.model.q_names, np.array(q).tolist()))),
    )  # fmt: skip
    scene = dataclasses.replace(
        scene, trajectory=trajectory, kinematics=dataclasses.replace(scene.kinematics, samples=41),
        initial=dataclasses.replace(scene.initial, q=dict(zip(solver.model.q_names, np.array(q).tolist())), hold=()),
    )  # fmt: skip
    problem = Problem(along(scene))
    problem.model.points[trajectory.point] = (
        solver.task.frame
    )  # the link's frame, which may lie beside its joint
    planned = plan(problem)[0]
    asked = trajectory.target(planned.times, {})
    p, R = solver.forward(planned.motion.q)
    assert_close(p, asked.p, 1e-9, scale=1.0)
    assert_close(R, asked.R, 1e-9, scale=1.0)
