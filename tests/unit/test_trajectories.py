"""Trajectories: exact derivatives, splines that honour what is given, targets in world coordinates."""

from __future__ import annotations

import re

import numpy as np
import pytest

from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.expr.formula import parse
from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.trajectories.cartesian import CartesianTrajectory
from robodyn_cli.trajectories.circle import CircleTrajectory
from robodyn_cli.trajectories.course import QuinticSpline
from robodyn_cli.trajectories.given import JointTrajectory, TableTrajectory
from robodyn_cli.trajectories.joint_space import JointSpaceTrajectory
from robodyn_cli.trajectories.registry import trajectory_types
from robodyn_cli.trajectories.way_points import QuinticTrajectory, WayPoint
from tests.numeric import assert_close, first_derivative, second_derivative

ROBOT = """\
schema: 1
gravity: [0, -9.81, 0]
parameters: {w: 1.5}
robot:
  convention: standard
  joints:
    - {name: j1, type: revolute, a: 1.0, alpha: 0, d: 0}
    - {name: j2, type: revolute, a: 1.0, alpha: 0, d: 0}
  links: [{name: l1, mass: 1}, {name: l2, mass: 1}]
  points: {tip: {link: l2, at: end}}
"""
TIMES = np.linspace(0.0, 2.0, 41)


def trajectory(text: str):
    return load_scene_text(ROBOT + "trajectory: " + text).trajectory


def check_derivatives(f, times, h=0.02, tolerance=1e-9):
    """Check that f(times) -> (x, xd, xdd) are consistent, by differences of order 8."""
    _, xd, xdd = f(times)
    assert_close(first_derivative(lambda s: f(times + s)[0], h), xd, tolerance)
    assert_close(second_derivative(lambda s: f(times + s)[0], h), xdd, 100 * tolerance)


def joints(t, parameters=None):
    return lambda times: tuple(vars(t.motion(times, ("j1", "j2"), parameters or {})).values())


def points(t):
    return lambda times: tuple(vars(t.target(times, {})).values())


def test_every_kind_belongs_to_one_space() -> None:
    for name, kind in trajectory_types.items():
        spaces = issubclass(kind, JointSpaceTrajectory), issubclass(kind, TaskSpaceTrajectory)
        # the fastest motion is that of another trajectory, in its space
        assert sum(spaces) == (name != "fastest")


def test_formulas_have_exact_derivatives() -> None:
    found = trajectory('{type: joint, duration: 2, q: {j1: "0.3 + sin(w*t)", j2: "t^3 - 2*t"}}').motion(
        TIMES, ("j1", "j2"), {"w": 1.5}
    )
    assert_close(found.q, np.stack([0.3 + np.sin(1.5 * TIMES), TIMES**3 - 2 * TIMES], axis=1), 1e-15)
    assert_close(found.qd, np.stack([1.5 * np.cos(1.5 * TIMES), 3 * TIMES**2 - 2], axis=1), 1e-15)
    assert_close(found.qdd, np.stack([-2.25 * np.sin(1.5 * TIMES), 6 * TIMES], axis=1), 1e-15)
    assert all(a.flags.f_contiguous for a in (found.q, found.qd, found.qdd))


def test_columns_follow_the_joints_asked_for_not_the_file() -> None:
    t = trajectory('{type: joint, duration: 2, q: {j2: "2*t", j1: 1}}')
    found = t.motion(TIMES, ("j1", "j2"), {})
    assert_close(found.q, np.stack([np.ones_like(TIMES), 2 * TIMES], axis=1), 1e-15)
    assert not found.qd[:, 0].any() and not found.qdd.any()


@pytest.mark.parametrize(
    "formula",
    ["exp(-t)*sin(3*t)", "tanh(t-1)", "sqrt(1+t^2)", "atan2(t, 2)", "1/(1+t)", "(2+cos(t))^1.5", "log(1+t)"],
)
def test_derivatives_agree_with_differences(formula: str) -> None:
    t = JointTrajectory("joint", {"j1": parse(formula), "j2": parse("t")}, 2.0)
    check_derivatives(joints(t), TIMES[5:-5])


@pytest.mark.parametrize(
    ("formula", "what", "time"),
    [("sqrt(t)", "rate", "t = 0 s"), ("1/(t-1)", "value", "t = 1 s"), ("t^1.5", "acceleration", "t = 0 s")],
)
def test_motion_that_is_not_finite_is_an_error(formula: str, what: str, time: str) -> None:
    t = JointTrajectory("joint", {"j1": parse("0"), "j2": parse(formula)}, 2.0)
    with pytest.raises(NumericalError) as caught:
        t.motion(np.linspace(0, 2, 21), ("j1", "j2"), {})
    assert all(part in caught.value.message for part in ("j2", formula, what, time))


def test_one_quintic_segment_is_the_minimum_jerk_motion() -> None:
    t = QuinticTrajectory("quintic", (WayPoint(0.0, {"j": 1.0}), WayPoint(2.0, {"j": 3.0})))
    assert t.duration == 2.0
    s = TIMES / 2.0
    found = t.motion(TIMES, ("j",), {})
    assert_close(found.q[:, 0], 1.0 + 2.0 * (10 * s**3 - 15 * s**4 + 6 * s**5), 1e-14)
    assert_close(found.qd[:, 0], (30 * s**2 - 60 * s**3 + 30 * s**4), 1e-14)
    assert_close(found.qdd[:, 0], 0.5 * (60 * s - 180 * s**2 + 120 * s**3), 1e-14)


def test_quintic_spline_is_the_c4_spline_of_scipy() -> None:
    from scipy.interpolate import make_interp_spline

    rng = np.random.default_rng(3)
    t = np.cumsum([0.0, *rng.uniform(0.2, 3.0, 12)])
    q = rng.normal(size=(13, 2))
    ends = rng.normal(size=(2, 2, 2))
    free = np.full((13, 2), np.nan)
    v, a = free.copy(), free.copy()
    v[[0, -1]], a[[0, -1]] = ends[0], ends[1]
    bc = ([(1, ends[0, 0]), (2, ends[1, 0])], [(1, ends[0, 1]), (2, ends[1, 1])])
    other = make_interp_spline(t, q, k=5, bc_type=bc)
    times = np.linspace(0.0, t[-1], 500)
    for mine, order in zip(QuinticSpline(t, q, v, a)(times), range(3)):
        assert_close(mine, other(times, order), 1e-11)


def test_quintic_spline_reproduces_a_quintic() -> None:
    p = np.polynomial.Polynomial([0.3, -1.0, 0.5, 0.25, -0.2, 0.05])
    t = np.array([0.0, 0.1, 0.9, 1.0, 2.5])
    v, a = np.full((5, 1), np.nan), np.full((5, 1), np.nan)
    v[[0, -1], 0], a[[0, -1], 0] = p.deriv(1)(t[[0, -1]]), p.deriv(2)(t[[0, -1]])
    times = np.linspace(0, 2.5, 200)
    for mine, order in zip(QuinticSpline(t, p(t)[:, None], v, a)(times), range(3)):
        assert_close(mine[:, 0], p.deriv(order)(times) if order else p(times), 1e-12)


def jumps(spline: QuinticSpline, order: int) -> np.ndarray:
    """Jumps of a derivative at the inner points."""
    c, h = spline.c, np.diff(spline.t)[:, None]
    for _ in range(order):
        c = np.arange(1, len(c))[:, None, None] * c[1:] / h
    return c.sum(axis=0)[:-1] - c[0][1:]


@pytest.mark.parametrize(
    ("given", "smooth"), [("", (3, 4)), ("v", (3,)), ("a", (4,)), ("va", ())], ids=["free", "v", "a", "both"]
)
def test_given_inner_rates_and_accelerations_are_kept(given: str, smooth: tuple[int, ...]) -> None:
    rng = np.random.default_rng(5)
    t, q = np.array([0.0, 1.0, 1.7, 3.0]), rng.normal(size=(4, 3))
    v, a = np.full((4, 3), np.nan), np.full((4, 3), np.nan)
    v[[0, -1]] = a[[0, -1]] = 0.0
    if "v" in given:
        v[1] = [0.5, -1.0, 2.0]
    if "a" in given:
        a[1] = [1.5, 3.0, -1.0]
    spline = QuinticSpline(t, q, v, a)
    found = spline(t)
    assert_close(found[0], q, 1e-14)
    for stated, value in ((v, found[1]), (a, found[2])):
        known = ~np.isnan(stated)
        assert_close(value[known], stated[known], 1e-12, scale=1.0)
    for order in (1, 2):
        assert np.abs(jumps(spline, order)).max() < 1e-11
    for order in (3, 4):
        jump = np.abs(jumps(spline, order))
        assert jump[1].max() < 1e-9  # the second inner point is free
        assert (jump[0].max() < 1e-9) == (order in smooth)


def test_way_points_in_the_scene() -> None:
    t = trajectory(
        "{type: quintic, points: [{t: 0, q: {j1: 0, j2: 90 deg}}, "
        "{t: 1, q: {j1: 1, j2: 0}, qd: {j1: 0.5, j2: -1}}, {t: 3, q: {j1: 2, j2: 1}, qdd: {j1: 1, j2: 2}}]}"
    )
    found = t.motion(np.array([0.0, 1.0, 3.0]), ("j1", "j2"), {})
    assert_close(found.q, [[0, np.pi / 2], [1, 0], [2, 1]], 1e-14)
    assert_close(found.qd, [[0, 0], [0.5, -1], [0, 0]], 1e-13)
    assert_close(found.qdd[[0, 2]], [[0, 0], [1, 2]], 1e-12)
    check_derivatives(joints(t), np.array([0.4, 0.7, 1.5, 2.2]), h=0.01)


@pytest.mark.parametrize(("name", "degree"), [("linear", 1), ("cubic", 3), ("quintic", 5)])
def test_tables_reproduce_polynomials(name: str, degree: int) -> None:
    p = np.polynomial.Polynomial([0.2, -0.7, 0.4, 0.3, -0.2, 0.05][: degree + 1])
    t = np.array([0.0, 0.3, 0.5, 1.1, 1.2, 1.9, 2.0])
    rows = tuple((float(x), float(p(x)), float(-x)) for x in t)
    table = TableTrajectory("table", None, ("t", "j2", "j1"), rows, name)
    assert table.duration == 2.0
    found = table.motion(TIMES, ("j1", "j2"), {})
    for order, array in enumerate((found.q, found.qd, found.qdd)):
        expected = p.deriv(order)(TIMES) if order else p(TIMES)
        assert_close(array[:, 1], expected, 1e-12, scale=1.0)
        assert_close(array[:, 0], [-TIMES, -np.ones(41), np.zeros(41)][order], 1e-12, scale=1.0)


@pytest.mark.parametrize(("rows", "fits"), [(4, "linear or monotone or cubic"), (2, "linear")])
def test_a_short_table_says_what_would_fit(rows: int, fits: str) -> None:
    lines = ", ".join(f"[{k}, 0, 1]" for k in range(rows))
    with pytest.raises(SceneError) as caught:
        trajectory(f"{{type: table, columns: [t, j1, j2], rows: [{lines}]}}")
    assert f"{rows} rows" in caught.value.message and fits in caught.value.message


def test_circle_in_the_plane() -> None:
    t = trajectory("{type: circle, point: tip, center: [1.2, 0.5], radius: 0.3, duration: 2, start: 30 deg}")
    phi = np.radians(30) + np.pi * TIMES
    found = t.target(TIMES, {})
    assert found.p.shape == (41, 2)
    assert_close(found.p, np.stack([1.2 + 0.3 * np.cos(phi), 0.5 + 0.3 * np.sin(phi)], axis=1), 1e-15)
    check_derivatives(points(t), TIMES)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -2), (1, 0, 0), (0, 3, 0), (1, -2, 0.5)])
@pytest.mark.parametrize("turns", [1.0, -2.5])
def test_circle_in_space(normal: tuple[float, ...], turns: float) -> None:
    t = CircleTrajectory("circle", "tip", (0.1, -0.2, 0.7), 0.25, 2.0, 0.4, turns, normal)
    found = t.target(TIMES, {})
    arm = found.p - np.array([0.1, -0.2, 0.7])
    assert_close(np.linalg.norm(arm, axis=1), np.full(41, 0.25), 1e-14)
    assert np.abs(arm @ np.array(normal)).max() < 1e-14
    n = np.array(normal) / np.linalg.norm(normal)
    spin = np.cross(arm, found.pd) @ n / 0.25**2
    assert_close(spin, np.full(41, np.pi * turns), 1e-13)
    check_derivatives(points(t), TIMES, h=0.01)
    u, v = t.axes()
    assert u[0] >= 0.0 and abs(u @ v) < 1e-15


def test_flat_circle_cannot_be_tilted() -> None:
    with pytest.raises(SceneError, match="centre of three numbers"):
        trajectory("{type: circle, point: tip, center: [1, 0], radius: 0.3, duration: 2, normal: [1, 0, 1]}")


def test_cartesian_formulas() -> None:
    t = trajectory('{type: cartesian, point: tip, duration: 2, position: ["1 + 0.1*t", "sin(w*t)", 0.5]}')
    found = t.target(TIMES, {"w": 2.0})
    assert_close(found.p, np.stack([1 + 0.1 * TIMES, np.sin(2 * TIMES), 0.5 + 0 * TIMES], axis=1), 1e-15)
    assert_close(found.pdd, np.stack([0 * TIMES, -4 * np.sin(2 * TIMES), 0 * TIMES], axis=1), 1e-15)
    two = CartesianTrajectory("cartesian", "tip", (parse("t"), parse("1")), 2.0)
    assert two.target(TIMES, {}).p.shape == (41, 2)


# -- tables with rates, and of arrays --------------------------------------------------------------------------


@pytest.mark.parametrize("degree, orders", [(3, 2), (5, 3)])
def test_rates_of_a_table_are_those_of_the_motion(degree: int, orders: int) -> None:
    """Polynomials of degree 2m - 1 are found again from m derivatives at rows that no spline could do with."""
    polynomials = [
        np.polynomial.Polynomial(c) for c in np.random.default_rng(degree).normal(size=(2, degree + 1))
    ]
    t = np.array([0.0, 0.7, 2.0])
    names = ("t", *(f"{sign}{joint}" for sign in ("", "qd.", "qdd.")[:orders] for joint in ("j2", "j1")))
    rows = np.column_stack([t, *(p.deriv(k)(t) for k in range(orders) for p in polynomials)])
    table = TableTrajectory("table", None, names, tuple(map(tuple, rows.tolist())), None)
    assert table.spline == "hermite" and table.joints == ("j2", "j1")
    found = table.motion(TIMES, ("j1", "j2"), {})
    for k, values in enumerate((found.q, found.qd, found.qdd)):
        expected = np.column_stack([p.deriv(k)(TIMES) for p in reversed(polynomials)])
        assert values == pytest.approx(expected, rel=1e-12, abs=1e-11 * np.abs(expected).max())
    assert table.missed() < 1e-12


def test_what_every_second_row_misses_falls_with_the_order() -> None:
    def missed(rows: int, orders: int) -> float:
        t = np.linspace(0.0, 2.0, rows)
        columns = ("t", "j1", "qd.j1", "qdd.j1")[: 1 + orders]
        values = np.column_stack([t, np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)])[:, : 1 + orders]
        return TableTrajectory("table", None, columns, tuple(map(tuple, values.tolist())), None).missed()

    for orders, order in ((1, 6), (2, 4), (3, 6)):
        assert missed(81, orders) < 1.5 * missed(41, orders) / 2**order, orders


@pytest.mark.parametrize(
    "columns, more, message",
    [
        ("[t, j1, j2, qd.j1]", "", "qd.j2 is missing; needed: that of every joint, or of none"),
        ("[t, j1, j2, qdd.j1, qdd.j2]", "", "qd.j1 is missing"),
        ("[t, j1, j2, qd.j1, qd.j2]", ", interpolation: linear", "a column of rates ('qd.j1') is of hermite"),
        ("[t, j1, j2]", ", interpolation: hermite", "hermite needs rates, as qd.joint"),
        ("[t, j1, j2, qd.j3]", "", "unknown joint 'qd.j3'"),
    ],
)  # fmt: skip
def test_rates_that_a_table_cannot_have(columns: str, more: str, message: str) -> None:
    row = ", ".join("0" for _ in columns.split(",")[1:])
    with pytest.raises(SceneError, match=re.escape(message)):
        trajectory(f"{{type: table, columns: {columns}, rows: [[0, {row}], [1, {row}], [2, {row}]]{more}}}")


def test_rows_without_names_are_of_all_joints() -> None:
    rows = "[[0, 1, 2, 3, 4], [1, 2, 3, 4, 5], [2, 3, 4, 5, 6]]"
    assert trajectory(f"{{type: table, rows: {rows}}}").columns == ("t", "j1", "j2", "qd.j1", "qd.j2")
    with pytest.raises(
        SceneError, match=re.escape("has 4 numbers for the joints j1, j2; needed without 'columns': 3, 5, 7")
    ):
        trajectory("{type: table, rows: [[0, 1, 2, 3], [1, 1, 2, 3]]}")


def test_arrays_are_references_of_controllers() -> None:
    """Of all joints, or of those that the controller names, in the map of a scene and as an override."""
    t = np.linspace(0.0, 2.0, 21)
    q, qd = np.column_stack([np.sin(t), np.cos(t)]), np.column_stack([np.cos(t), -np.sin(t)])
    law = {"type": "pd", "gains": {"kp": 100}}
    scene = load_scene(ROBOT, {"control": law, "control.reference": (t, q, qd), "simulate.duration": 0.1})
    assert scene.control is not None and scene.control.reference is not None
    assert scene.control.reference.columns == ("t", "j1", "j2", "qd.j1", "qd.j2")  # type: ignore[attr-defined]
    assert any(note.startswith("control.reference: 21 rows, interpolation hermite") for note in scene.notes)
    driven = {**law, "joints": ["j2"], "reference": (t, q[:, 1])}
    one = load_scene(ROBOT, {"control": driven})
    assert one.control.reference.columns == ("t", "j2")  # type: ignore[union-attr, attr-defined]
    with pytest.raises(SceneError, match=re.escape("is no motion: arrays of shapes (21,), (20, 2)")):
        load_scene(ROBOT, {"control": {**law, "reference": (t, q[1:])}})
    with pytest.raises(SceneError, match=re.escape("has 7 numbers for the joints j2; needed")) as raised:
        load_scene(ROBOT, {"control": {**law, "joints": ["j2"], "reference": (t, q, qd, qd)}})
    assert "control.reference.rows.0" in str(raised.value)
