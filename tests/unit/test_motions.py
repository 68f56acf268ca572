"""Motions of the joints from stop to stop, through way points, as series, and chained: time laws, limits, continuity."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.errors import RobodynError, SceneError
from robodyn_cli.scene import load_scene_text
from robodyn_cli.spatial import quaternion
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.legs import fastest
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate
from tests.numeric import assert_close

ARM = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: j, type: revolute, axis: [0.3, 1, 0.2], limits: {lower: -2, upper: 2, speed: 2, acceleration: 5, jerk: 40}}
    - {name: slide, type: prismatic, axis: [1, 0.1, 0.4], origin: {xyz: [0.3, 0.1, 0]}, limits: {speed: 1, acceleration: 3, jerk: 50}}
  links:
    - {name: a, mass: 3, com: [0.1, 0.2, 0.3], inertia: {xx: 0.3, yy: 0.4, zz: 0.5, xy: 0.01, xz: 0.02}}
    - {name: b, mass: 2, com: [0, 0.1, 0.05], inertia: {xx: 0.2, yy: 0.3, zz: 0.4, yz: 0.01}}
"""
BODY = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: j, type: revolute, axis: [0, 1, 0]}
    - {name: ball, type: KIND}
  links:
    - {name: a, mass: 1, com: [0.1, 0.2, 0.3], inertia: {xx: 0.3, yy: 0.4, zz: 0.5, xy: 0.01}}
    - {name: b, mass: 12, com: [0, 0.1, 0.02], inertia: {xx: 0.3, yy: 0.4, zz: 0.5, xy: 0.01}}
"""
COLUMNS = ("j", "slide")
ATTITUDE = ("ball.qw", "ball.qx", "ball.qy", "ball.qz")
LIMITS = np.array([[2.0, 1.0], [5.0, 3.0], [40.0, 50.0]])


def trajectory(text: str, robot: str = ARM):
    return load_scene_text(f"{robot}trajectory: {text}").trajectory


def stops(q: np.ndarray, more: str = "") -> str:
    return "points: [" + ", ".join(f"{{q: {{j: {a!r}, slide: {b!r}}}{more}}}" for a, b in q.tolist()) + "]"


def way_points(t: np.ndarray, q: np.ndarray, more: str = "") -> str:
    rows = zip(t.tolist(), q.tolist())
    return (
        "points: ["
        + ", ".join(f"{{t: {x!r}, q: {{j: {a!r}, slide: {b!r}}}{more}}}" for x, (a, b) in rows)
        + "]"
    )


def check_rates(found, seed: int = 0, columns=COLUMNS) -> None:
    """Compare rates and accelerations with differences at random times away from knots."""
    rng, h = np.random.default_rng(seed), 1e-5
    times = rng.uniform(h, found.duration - h, 40)
    times = times[np.abs(times[:, None] - np.array([*found.knots, -1.0])).min(axis=1) > 2.0 * h]
    here, after, before = (found.motion(times + d, columns, {}) for d in (0.0, h, -h))
    q = (after.q - before.q) / (2.0 * h)
    if q.shape != here.qd.shape:
        k = columns.index("ball.qw")
        w = [quaternion.angular_velocity(list(a), list(b)) for a, b in zip(here.q[:, k:], q[:, k:])]
        rates = q[:, :k].copy()
        if k > 1:  # a floating body's velocity is in its own axes
            R = [np.array(quaternion.rotation(list(x)), dtype=float) for x in here.q[:, k:]]
            rates[:, k - 3 :] = [a.T @ b for a, b in zip(R, q[:, k - 3 : k])]
        q = np.concatenate([rates, np.array(w, dtype=float)], axis=1)
    assert_close(q, here.qd, 1e-7, scale=1.0 + np.abs(here.qdd).max())
    assert_close(
        (after.qd - before.qd) / (2.0 * h), here.qdd, 1e-6, scale=10.0 + 100.0 * np.abs(here.qdd).max()
    )


def jumps(found, order: int, columns=COLUMNS) -> float:
    """Largest jump of the positions, rates or accelerations at the knots."""
    knots, h = np.array(found.knots), 1e-12 * found.duration
    before, after = (found.motion(knots + d, columns, {}) for d in (-h, h))
    pair = [(m.q, m.qd, m.qdd)[order] for m in (before, after)]
    return float(np.abs(pair[1] - pair[0]).max()) if len(knots) else 0.0


# -- time laws -----------------------------------------------------------------------------------------
def test_the_trapezoid_in_closed_form() -> None:
    law = fastest(0.5, 2.0)
    assert_close(law.course.duration, 1.0 / 0.5 + 0.5 / 2.0, 1e-15)
    assert_close(fastest(10.0, 4.0).course.duration, 2.0 * math.sqrt(1.0 / 4.0), 1e-15)
    assert_close(fastest(math.inf, 4.0).course.duration, 1.0, 1e-15)


@pytest.mark.parametrize(
    ("limits", "duration"),
    [
        ((0.5, 1.0, 4.0), 1.0 / 0.5 + 0.5 / 1.0 + 1.0 / 4.0),  # all limits reached: D/v + v/a + a/j
        ((1e9, 1e9, 2.0), 4.0 * (1.0 / (2.0 * 2.0)) ** (1.0 / 3.0)),  # jerk alone
        ((math.inf, 1.0, 8.0), 0.125 + math.sqrt(0.125**2 + 4.0)),  # acceleration and jerk
        ((0.25, 1e9, 4.0), 1.0 / 0.25 + 2.0 * math.sqrt(0.25 / 4.0)),  # speed and jerk
    ],
)
def test_the_s_curve_in_closed_form(limits: tuple[float, ...], duration: float) -> None:
    assert_close(fastest(*limits).course.duration, duration, 1e-14)


@pytest.mark.parametrize("seed", range(60))
def test_laws_keep_to_their_limits_and_reach_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    speed, acceleration, jerk = 10.0 ** rng.uniform(-2, 2, 3)
    jerk = math.inf if rng.random() < 0.3 else jerk
    course = fastest(speed, acceleration, jerk).course
    ends = course(course.knots[[0, -1]])[:, 0]
    assert_close(ends, [0.0, 1.0], 1e-13)
    assert_close(course(course.knots[[0, -1]], 1)[:, 0], [0.0, 0.0], 1e-12, scale=course.largest(1)[0])
    shares = [
        course.largest(k)[0] / x
        for k, x in enumerate((speed, acceleration, jerk), start=1)
        if math.isfinite(x)
    ]
    assert max(shares) < 1.0 + 1e-9 and max(shares) > 1.0 - 1e-9, "no limit is reached"
    middle = np.linspace(0.0, course.duration, 101)
    assert_close(course(middle)[:, 0] + course(middle)[::-1, 0], np.ones(101), 1e-12)


def test_the_largest_value_of_a_course() -> None:
    rng = np.random.default_rng(3)
    course = Course([0.0, 0.7, 2.0], rng.standard_normal((6, 2, 3)))
    dense = np.linspace(0.0, 2.0, 200_001)
    for order in range(4):
        assert_close(course.largest(order), np.abs(course(dense, order)).max(axis=0), 1e-4)


# -- from stop to stop ---------------------------------------------------------------------------------
@pytest.mark.parametrize("blend", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("kind", ["trapezoid", "s_curve"])
def test_moves_keep_to_all_limits(kind: str, blend: float) -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-1.9, 1.9, (int(rng.integers(2, 7)), 2))
        found = trajectory(f"{{type: {kind}, blend: {blend}, {stops(q)}}}")
        times = np.sort(np.concatenate([np.linspace(0.0, found.duration, 3001), found.knots]))
        motion = found.motion(times, COLUMNS, {})
        assert_close(motion.q[[0, -1]], q[[0, -1]], 1e-12, scale=1.0)
        assert_close(motion.qd[[0, -1]], np.zeros((2, 2)), 1e-11, scale=1.0)
        within = 1.0 + 1e-8
        assert (np.abs(motion.qd).max(axis=0) <= LIMITS[0] * within).all()
        assert (np.abs(motion.qdd).max(axis=0) <= LIMITS[1] * within).all()
        assert (motion.q <= q.max(axis=0) + 1e-12).all() and (motion.q >= q.min(axis=0) - 1e-12).all()
        check_rates(found, seed)
        assert jumps(found, 0) < 1e-9 and jumps(found, 1) < 1e-9
        if kind == "s_curve":
            assert jumps(found, 2) < 1e-8
            assert (found.course.largest(3) <= LIMITS[2] * within).all()
            assert (found.course.largest(1) <= LIMITS[0] * within).all()


def test_some_joint_is_at_a_limit_all_the_time() -> None:
    found = trajectory("{type: trapezoid, " + stops(np.array([[0.0, 0.0], [1.5, 0.4], [-1.0, 0.9]])) + "}")
    times = np.linspace(0.0, found.duration, 500)[1:-1]
    motion = found.motion(times, COLUMNS, {})
    share = np.concatenate([np.abs(motion.qd) / LIMITS[0], np.abs(motion.qdd) / LIMITS[1]], axis=1)
    assert_close(share.max(axis=1), np.ones(len(times)), 1e-9)


def test_blends_save_time_and_pass_beside_the_way_points() -> None:
    q = np.array([[0.0, 0.0], [1.5, 0.5], [0.5, 1.5], [-1.0, 0.2]])
    durations = [trajectory(f"{{type: s_curve, blend: {b}, {stops(q)}}}").duration for b in (0.0, 0.3, 1.0)]
    assert durations[0] > durations[1] > durations[2]
    found = trajectory(f"{{type: s_curve, blend: 1, {stops(q)}}}")
    path = found.motion(np.linspace(0.0, found.duration, 4001), COLUMNS, {}).q
    assert 1e-3 < np.linalg.norm(path - q[1], axis=1).min() < 0.3


def test_dwell_and_a_duration_of_its_own() -> None:
    points = "points: [{q: {j: 0, slide: 0}, dwell: 0.5}, {q: {j: 1, slide: 0.1}, dwell: 0.25, duration: 3}]"
    found = trajectory(f"{{type: s_curve, blend: 1, {points}}}")
    assert_close(found.duration, 3.75, 1e-14)
    motion = found.motion(np.array([0.0, 0.3, 0.5, 2.0, 3.5, 3.7]), COLUMNS, {})
    assert_close(motion.q[:, 0], [0.0, 0.0, 0.0, 0.5, 1.0, 1.0], 1e-12, scale=1.0)
    assert not motion.qd[[0, 1, 5]].any() and not motion.qdd[[1, 5]].any()


def test_a_motion_within_its_limits_gives_no_warning() -> None:
    text = "{type: s_curve, " + stops(np.array([[0.0, 0.0], [1.5, 0.4], [-1.0, 0.9]])) + "}"
    result = inverse(load_scene_text(ARM + "trajectory: " + text), samples=20_001)
    assert "warnings" not in result.summary
    assert result.summary["round_trip"] < 1e-12


# -- way points ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("kind", "smooth"), [("quintic", 2), ("cubic", 1), ("monotone", 1)])
def test_way_points_are_met_and_rates_continuous(kind: str, smooth: int) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 1.5, 6))])
        q = rng.uniform(-1.9, 1.9, (7, 2))
        found = trajectory(f"{{type: {kind}, {way_points(t, q)}}}")
        motion = found.motion(t, COLUMNS, {})
        assert_close(motion.q, q, 1e-12, scale=1.0)
        assert_close(motion.qd[[0, -1]], np.zeros((2, 2)), 1e-11, scale=1.0)
        for order in range(smooth + 1):
            assert jumps(found, order) < 1e-7
        check_rates(found, seed)


def test_cubic_is_the_clamped_spline_of_continuous_accelerations() -> None:
    t, q = np.array([0.0, 0.5, 1.7, 2.0]), np.array([[0.0, 1.0], [1.0, 0.5], [-0.5, 1.5], [0.2, 0.3]])
    found = trajectory(f"{{type: cubic, {way_points(t, q)}}}")
    assert jumps(found, 2) < 1e-8
    # of all functions through the points with these rates at the ends it has the least integral of squared acceleration
    dense = np.linspace(0.0, 2.0, 20_001)
    other = trajectory(f"{{type: quintic, {way_points(t, q)}}}")
    least, more = (np.square(f.motion(dense, COLUMNS, {}).qdd).mean(axis=0) for f in (found, other))
    assert (least < more).all()


def test_monotone_never_leaves_the_range_of_two_way_points() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 2.0, 7))])
        q = np.round(rng.uniform(-1.5, 1.5, (8, 2)) * 2.0) / 2.0
        found = trajectory(f"{{type: monotone, {way_points(t, q)}}}")
        for k in range(7):
            path = found.motion(np.linspace(t[k], t[k + 1], 101), COLUMNS, {}).q
            low, high = np.minimum(q[k], q[k + 1]), np.maximum(q[k], q[k + 1])
            assert (path >= low - 1e-12).all() and (path <= high + 1e-12).all()


def test_monotone_rates_are_those_of_scipy() -> None:
    from scipy.interpolate import PchipInterpolator

    rng = np.random.default_rng(4)
    t, q = np.cumsum(rng.uniform(0.1, 1.0, 9)), rng.uniform(-1.0, 1.0, (9, 2))
    t -= t[0]
    found = trajectory(f"{{type: monotone, {way_points(t, q)}}}")
    assert_close(found.motion(t, COLUMNS, {}).qd[1:-1], PchipInterpolator(t, q)(t, 1)[1:-1], 1e-12, scale=1.0)


@pytest.mark.parametrize("kind", ["quintic", "cubic", "monotone"])
def test_the_joints_dwell(kind: str) -> None:
    points = (
        "points: [{t: 0, q: {j: 0, slide: 0}}, {t: 1, q: {j: 1, slide: 0.1}, dwell: 0.5}, "
        "{t: 2, q: {j: 0.5, slide: 1}}, {t: 3, q: {j: 0, slide: 1}, dwell: 0.25}]"
    )
    found = trajectory(f"{{type: {kind}, {points}}}")
    assert found.duration == 3.25
    still = found.motion(np.array([1.1, 1.3, 1.4999, 3.1]), COLUMNS, {})
    assert_close(still.q, [[1, 0.1], [1, 0.1], [1, 0.1], [0, 1]], 1e-14, scale=1.0)
    assert not still.qd.any() and not still.qdd.any()
    assert jumps(found, 1) < 1e-9 and (jumps(found, 2) < 1e-7) == (kind == "quintic")


def test_a_monotone_table_does_not_overshoot_and_meets_its_rows() -> None:
    rows = [[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [1.1, 1.0, 1.0], [2.0, 1.0, 1.0], [3.0, 1.0, 0.0]]
    found = trajectory(f"{{type: table, interpolation: monotone, columns: [t, j, slide], rows: {rows}}}")
    path = found.motion(np.linspace(0.0, 3.0, 2001), COLUMNS, {}).q
    assert path.min() > -1e-15 and path.max() < 1.0 + 1e-15
    assert_close(found.motion(np.array(rows)[:, 0], COLUMNS, {}).q, np.array(rows)[:, 1:], 1e-15, scale=1.0)


# -- series and sequences ------------------------------------------------------------------------------
def test_a_fourier_series() -> None:
    text = "{type: fourier, period: 2, duration: 4, offset: {j: 0.1, slide: 0.5}, sine: [{j: 0.3}, {slide: 0.2}], cosine: [{j: 0.2}]}"
    found, t, w = trajectory(text), np.linspace(0.0, 4.0, 31), np.pi
    motion = found.motion(t, COLUMNS, {})
    assert_close(motion.q[:, 0], 0.1 + 0.3 * np.sin(w * t) + 0.2 * np.cos(w * t), 1e-14)
    assert_close(motion.q[:, 1], 0.5 + 0.2 * np.sin(2 * w * t), 1e-14)
    assert_close(motion.qdd[:, 0], -w * w * (motion.q[:, 0] - 0.1), 1e-13)


FORTH = "{type: s_curve, points: [{q: {j: 0, slide: 0}}, {q: {j: 1, slide: 0.3}, dwell: 0.1}]}"
BACK = '{type: joint, duration: 2, q: {j: "cos(pi*t/4)^2", slide: "0.3*cos(pi*t/4)^2"}}'


def test_a_sequence_is_its_segments() -> None:
    forth, back = trajectory(FORTH), trajectory(BACK)
    found = trajectory(f"{{type: sequence, repeat: 3, segments: [{FORTH}, {BACK}]}}")
    one = forth.duration + back.duration
    assert_close(found.duration, 3 * one, 1e-14)
    times = np.linspace(0.0, 0.999 * one, 83)
    first = times < forth.duration
    for k in range(3):
        motion = found.motion(times + k * one, COLUMNS, {})
        expected = [
            forth.motion(times[first], COLUMNS, {}),
            back.motion(times[~first] - forth.duration, COLUMNS, {}),
        ]
        for name in ("q", "qd", "qdd"):
            parts = np.concatenate([getattr(m, name) for m in expected])
            assert_close(getattr(motion, name), parts, 1e-11, scale=10.0)


# -- attitudes -----------------------------------------------------------------------------------------
TURNS = ("[0, 0, 0]", "[0.5, 1, 2]", "[0.5, -1, 1]", "[-3, -1, 2]")
FREE = "acceleration: {j: 2, ball: [3, 2, 3]}, speed: {j: 1, ball: [1, 1.5, 1]}"
KINDS = {
    "trapezoid": f"{{type: trapezoid, {FREE}, POINTS}}",
    "s_curve": f"{{type: s_curve, {FREE}, jerk: {{j: 9, ball: [9, 9, 20]}}, POINTS}}",
    "quintic": "{type: quintic, TIMED}",
    "cubic": "{type: cubic, TIMED}",
    "monotone": "{type: monotone, TIMED}",
    "sequence": f"{{type: sequence, segments: [{{type: trapezoid, {FREE}, POINTS}}, {{type: quintic, TIMED_ON}}]}}",
}


def attitude_text(kind: str, place: str = "") -> str:
    rows = [f"{{j: {k}, ball: {{{place}rpy: {rpy}}}}}" for k, rpy in enumerate(TURNS)]
    timed = [f"{{t: {k}, q: {row}}}" for k, row in enumerate(rows)]
    on = [f"{{t: {k}, q: {row}}}" for k, row in enumerate(reversed(rows))]
    text = KINDS[kind].replace("TIMED_ON", f"points: [{', '.join(on)}]")
    text = text.replace("TIMED", f"points: [{', '.join(timed)}]")
    return text.replace("POINTS", "points: [" + ", ".join(f"{{q: {row}}}" for row in rows) + "]")


def floating(text: str) -> str:
    """Limits of a floating joint in place of those of a spherical one."""
    return text.replace("ball: [", "ball: [4, 4, 4, ")


@pytest.mark.parametrize("kind", KINDS)
def test_attitudes_have_exact_rates(kind: str) -> None:
    found = trajectory(attitude_text(kind), BODY.replace("KIND", "spherical"))
    check_rates(found, columns=("j", *ATTITUDE))
    assert jumps(found, 0, ("j", *ATTITUDE)) < 1e-9 and jumps(found, 1, ("j", *ATTITUDE)) < 1e-8
    columns = ("j", "ball.x", "ball.y", "ball.z", *ATTITUDE)
    text = attitude_text(kind, "xyz: [PLACE], ")
    for k in range(8):
        text = text.replace("PLACE", f"{0.1 * k}, {0.3 - k * 0.2}, {k % 2}", 1)
    if kind != "sequence":  # its segments would not meet
        check_rates(trajectory(floating(text), BODY.replace("KIND", "floating")), columns=columns)


def test_attitudes_meet_their_way_points_by_the_shorter_way() -> None:
    for kind in ("quintic", "cubic", "monotone"):
        found = trajectory(attitude_text(kind), BODY.replace("KIND", "spherical"))
        q = found.motion(np.arange(4.0), ATTITUDE, {}).q
        for row, rpy in zip(q, TURNS):
            expected = np.array(
                quaternion.from_rpy([float(x) for x in rpy.strip("[]").split(",")]), dtype=float
            )
            assert_close(abs(row @ expected), 1.0, 1e-14)
        assert (np.einsum("ti,ti->t", q[1:], q[:-1]) >= 0.0).all()


def test_an_attitude_turns_about_one_axis_from_stop_to_stop_within_its_limits() -> None:
    found = trajectory(attitude_text("trapezoid"), BODY.replace("KIND", "spherical"))
    motion = found.motion(np.linspace(0.0, found.duration, 4001), ("j", *ATTITUDE), {})
    assert (np.abs(motion.qd).max(axis=0) <= np.array([1.0, 1.0, 1.5, 1.0]) + 1e-9).all()
    assert (np.abs(motion.qdd).max(axis=0) <= np.array([2.0, 3.0, 2.0, 3.0]) + 1e-9).all()
    w, wd = motion.qd[:, 1:], motion.qdd[:, 1:]
    assert np.abs(np.cross(w, wd)).max() < 1e-9


def test_rates_of_an_attitude_may_be_given_at_a_way_point() -> None:
    points = (
        "points: [{t: 0, q: {j: 0, ball: {rpy: [0, 0, 0]}}}, {t: 1, q: {j: 1, ball: {rpy: [0.3, 0.4, 0.5]}}, "
        "qd: {j: 0.5, ball: [0.1, 0.2, -0.3]}, qdd: {j: 1, ball: [1, -2, 0.5]}}, {t: 2, q: {j: 0, ball: {rpy: [1, 0, 0]}}}]"
    )
    motion = trajectory(f"{{type: quintic, {points}}}", BODY.replace("KIND", "spherical")).motion(
        np.array([1.0]), ("j", *ATTITUDE), {}
    )
    assert_close(motion.qd[0], [0.5, 0.1, 0.2, -0.3], 1e-12)
    assert_close(motion.qdd[0], [1.0, 1.0, -2.0, 0.5], 1e-11)


def test_a_table_of_quaternions() -> None:
    t = np.linspace(0.0, 2.0, 21)
    rows = [[x, x, *quaternion.from_rpy([0.5 * x, np.sin(x), x * x / 3])] for x in t.tolist()]
    columns = "[t, j, ball.qw, ball.qx, ball.qy, ball.qz]"
    text = f"{{type: table, columns: {columns}, rows: {[[float(e) for e in row] for row in rows]}}}"
    found = trajectory(text, BODY.replace("KIND", "spherical"))
    check_rates(found, columns=("j", *ATTITUDE))
    formulas = trajectory(
        '{type: joint, duration: 2, q: {j: t, ball: {rpy: ["0.5*t", "sin(t)", "t^2/3"]}}}',
        BODY.replace("KIND", "spherical"),
    )
    times = np.linspace(0.2, 1.8, 41)
    asked, expected = (f.motion(times, ("j", *ATTITUDE), {}) for f in (found, formulas))
    assert_close(asked.qd, expected.qd, 1e-5)
    assert_close(asked.qdd, expected.qdd, 1e-3)


# -- as a prescribed motion ----------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["trapezoid", "quintic", "monotone"])
@pytest.mark.parametrize("joint", ["spherical", "floating"])
def test_a_simulation_that_follows_needs_the_torques_of_inverse(kind: str, joint: str) -> None:
    text = attitude_text(kind, "xyz: [1, 2, 3], " if joint == "floating" else "")
    text = floating(text) if joint == "floating" else text
    scene = BODY.replace("KIND", joint) + f"trajectory: {text}\nprescribed: trajectory\n"
    duration = load_scene_text(scene).trajectory.duration
    scene += f"simulate: {{duration: {duration!r}, samples: 101, rtol: 1.0e-11}}\ninverse: {{samples: 101}}\n"
    asked, found = inverse(load_scene_text(scene)), simulate(load_scene_text(scene))
    assert_close(found["q"], asked["q"], 1e-10, scale=1.0)
    assert_close(found["qd"], asked["qd"], 1e-9, scale=1.0)
    inside = (
        np.abs(asked["time"][:, None] - np.array(load_scene_text(scene).trajectory.knots)).min(axis=1) > 1e-6
    )
    assert_close(found["tau"][inside], asked["tau"][inside], 1e-8, scale=np.abs(asked["tau"]).max())


def test_forces_move_the_joints_that_the_trajectory_does_not_lead() -> None:
    move = "{type: trapezoid, points: [{q: {j: -0.5}}, {q: {j: 0.7}}]}"
    common = "initial: {q: {slide: 0.1}}\nforces: []\nsimulate: {duration: 2, samples: 201, rtol: 1.0e-12, atol: 1.0e-13}\n"
    scene = load_scene_text(ARM + f"trajectory: {move}\nprescribed: trajectory\n" + common)
    found = simulate(scene)
    # the same by formulas: a triangle or trapezoid in t, then at rest
    v, a, D = 2.0, 5.0, 1.2
    ramp = v / a if v * v / a <= D else math.sqrt(D / a)
    T = D / (a * ramp) + ramp
    first, last = f"{a / 2}*t^2", f"{D} - {a / 2}*({T!r} - t)^2"
    middle = f"{a * ramp!r}*(t - {ramp / 2!r})"
    formula = (
        f'"-0.5 + if(t < {ramp!r}, {first}, if(t < {T - ramp!r}, {middle}, if(t < {T!r}, {last}, {D})))"'
    )
    other = simulate(load_scene_text(ARM + f"prescribed: {{j: {formula}}}\n" + common))
    assert_close(found["q"], other["q"], 1e-9, scale=1.0)
    assert found["q"][-1, 0] == pytest.approx(0.7, abs=1e-12)


def test_a_motion_that_ends_on_the_way_cannot_be_held() -> None:
    table = "{type: table, interpolation: linear, columns: [t, j, slide], rows: [[0, 0, 0], [1, 0.2, 0.1]]}"
    scene = load_scene_text(ARM + f"trajectory: {table}\nprescribed: trajectory\nsimulate: {{duration: 2}}\n")
    with pytest.raises(SceneError, match="jumps at t = 1 s: its rate"):
        simulate(scene)


def test_a_prescribed_attitude_by_formulas() -> None:
    scene = load_scene_text(
        BODY.replace("KIND", "spherical")
        + 'prescribed: {ball: {rpy: ["0.3*t", "sin(t)", 0.2]}}\ninitial: {q: {j: 0.3}}\nsimulate: {duration: 2, samples: 51}\n'
    )
    found = simulate(scene)
    for t, q in zip(found["time"], found["q"]):
        expected = np.array(quaternion.from_rpy([0.3 * t, math.sin(t), 0.2]), dtype=float)
        assert_close(abs(expected @ q[1:]), 1.0, 1e-12)
    assert found.summary["error_estimate"]["q_max"] < 1e-8


# -- bad input -----------------------------------------------------------------------------------------
GOOD = "{type: s_curve, " + stops(np.array([[0.0, 0.0], [1.0, 0.5]])) + "}"
WAY = "{type: quintic, points: [{t: 0, q: {j: 0, slide: 0}}, {t: 1, q: {j: 1, slide: 0}}, {t: 2, q: {j: 0, slide: 0}}]}"
BAD = [
    (GOOD.replace("1.0", "2.5"), "points.1.q.j: 2.5 is beyond the joint's upper limit; allowed: -2 to 2"),
    (WAY.replace("j: 1", "j: -3"), "points.1.q.j: -3 is beyond the joint's lower limit; allowed: -2 to 2"),
    (WAY.replace("t: 2", "t: 0.5"), "points.2.t: times must increase (value 0.5 after 1.0)"),
    (WAY.replace("slide: 0}}, {t: 2", "slide: 0}, dwell: 1}, {t: 2"), "points.1.dwell: no time is left"),
    (WAY.replace("quintic", "cubic").replace("slide: 0}}, {t: 2", "slide: 0}, qdd: {j: 0, slide: 1}}, {t: 2"), "cubic has no accelerations"),
    (GOOD.replace("s_curve", "s_curve, speed: {j: 0}"), "speed.j: is too small (value 0); allowed: a number > 0"),
    (GOOD.replace("s_curve", "s_curve, speed: {j: 5}"), "speed.j: 5 is above the joint's own limit; allowed: up to 2"),
    (GOOD.replace("0.5}}", "0.5}, duration: 0.1}"), "points.1.duration: 0.1 s is too short under the limits; allowed: "),
    (GOOD.replace("slide: 0.0}}", "slide: 0.0}, duration: 1}"), "points.0.duration: the motion begins here"),
    (GOOD.replace("1.0", "0.0").replace("0.5", "0.0"), "points: nothing moves, and no time passes"),
    ("{type: sequence, repeat: 2, segments: [" + GOOD + "]}", "segments.0: j begins at 0, not at 1, where"),
    ("{type: sequence, segments: [" + GOOD + ", {type: table, interpolation: linear, columns: [t, j, slide], rows: [[0, 1, 0.5], [1, 0, 0]]}]}",
     "segments.1: the motion begins with a rate of -1, not of "),
    ("{type: fourier, period: 2, duration: 4, offset: {j: 0, slide: 0}, sine: [{k: 1}]}", "unknown joint 'k'"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD)
def test_bad_input_names_the_place_and_what_is_allowed(text: str, message: str) -> None:
    with pytest.raises(SceneError) as caught:
        trajectory(text)
    assert message in caught.value.message
    assert caught.value.details["line"] and caught.value.exit_code == 2


def test_a_joint_without_limits_is_named() -> None:
    robot = BODY.replace("KIND", "spherical")
    with pytest.raises(SceneError, match=r"joint 'ball.wx' has no limit of its acceleration"):
        trajectory(
            "{type: trapezoid, acceleration: {j: 1}, points: [{q: {j: 0, ball: {rpy: [0, 0, 0]}}}, {q: {j: 1, ball: {rpy: [1, 0, 0]}}}]}",
            robot,
        )


def test_following_needs_a_trajectory() -> None:
    with pytest.raises(
        SceneError, match="there is no trajectory to follow; give `trajectory`, of type joint, quintic"
    ):
        load_scene_text(ARM + "prescribed: trajectory\n")


def test_inverse_needs_all_joints() -> None:
    move = "{type: trapezoid, points: [{q: {j: -0.5}}, {q: {j: 0.7}}]}"
    with pytest.raises(RobodynError, match="leads joint 'slide'"):
        inverse(load_scene_text(ARM + f"trajectory: {move}\nprescribed: trajectory\n"))


# -- tables in HDF5 ------------------------------------------------------------------------------------
def test_a_table_from_a_result_repeats_its_motion(tmp_path: Path) -> None:
    from robodyn_cli.results.hdf5.writer import write

    text = attitude_text("quintic")
    first = inverse(load_scene_text(BODY.replace("KIND", "spherical") + f"trajectory: {text}\n"), samples=301)
    write(first, tmp_path / "first.h5")
    again = load_scene_text(
        BODY.replace("KIND", "spherical") + "trajectory: {type: table, file: first.h5}\n",
        str(tmp_path / "scene.yaml"),
    )
    found = inverse(again, samples=301)
    assert_close(found["q"], first["q"], 1e-14, scale=1.0)
    assert_close(found["tau"], first["tau"], 1e-4)


def test_a_table_from_datasets_and_what_is_wrong_with_others(tmp_path: Path) -> None:
    import h5py

    t = np.linspace(0.0, 1.0, 11)
    with h5py.File(tmp_path / "good.h5", "w") as file:
        file["slide"], file["t"], file["j"] = t**2, t, t**3
    with h5py.File(tmp_path / "untimed.h5", "w") as file:
        file["j"] = t
    with h5py.File(tmp_path / "uneven.hdf5", "w") as file:
        file["t"], file["j"], file["slide"] = t, t, t[1:]
    (tmp_path / "text.h5").write_text("t, j, slide\n")

    def table(name: str):
        return load_scene_text(
            ARM + f"trajectory: {{type: table, file: {name}}}\n", str(tmp_path / "scene.yaml")
        ).trajectory

    found = table("good.h5").motion(np.array([0.35]), COLUMNS, {})
    assert_close(found.q[0], [0.35**3, 0.35**2], 1e-13)
    assert_close(found.qdd[0], [6.0 * 0.35, 2.0], 1e-11)
    for name, message in {
        "untimed.h5": "has no dataset 't' of times; its datasets: j",
        "uneven.hdf5": "dataset 'slide' is no list of as many numbers as 't' has (shape (10,))",
        "text.h5": "cannot be read as HDF5",
        "missing.h5": "no such file",
    }.items():
        with pytest.raises(SceneError) as caught:
            table(name)
        assert message in caught.value.message and caught.value.details["line"] == 10


def test_courses_on_more_knots_and_at_rest_outside() -> None:
    rng = np.random.default_rng(5)
    knots = np.array([0.5, 0.9, 2.0, 2.3])
    course = Course(knots, rng.normal(size=(6, 3, 2)))
    times = np.linspace(0.5, 2.3, 50)
    more = course.refined(np.unique([*knots, *rng.uniform(0.5, 2.3, 7)]))
    part = course.refined(np.array([0.6, 0.9, 1.1, 1.7]))
    for order in range(4):
        assert_close(more(times, order), course(times, order), 1e-12)
        assert_close(part([0.6, 0.8, 1.3, 1.7], order), course([0.6, 0.8, 1.3, 1.7], order), 1e-12)
    held = course.at_rest_outside()
    assert_close(held(times), course(times), 1e-14)
    first, last = course([0.5])[0], course([2.3])[0]
    assert_close(held([-1e3, 0.1, 0.4999999, 2.3, 2.4, 1e3]), [first] * 3 + [last] * 3, 1e-14)
    assert not np.any(held([-1e3, 0.1, 2.4, 1e3], 1)) and np.any(course([0.1, 2.4], 1))
