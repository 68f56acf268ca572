"""The keys of trajectories: what is read, and what the trajectory itself refuses."""

from __future__ import annotations

from typing import Any

import pytest

from robodyn_cli.scene import load_scene_text
from robodyn_cli.trajectories.circle import CircleTrajectory
from robodyn_cli.trajectories.given import TableTrajectory
from robodyn_cli.trajectories.way_points import QuinticTrajectory
from tests.unit.scene_text import refusals, spoiled

JOINT = "trajectory: {{type: joint, duration: 1, q: {}}}"
TABLE = "trajectory: {{type: table, columns: {}, rows: {}}}"
QUINTIC = "trajectory: {{type: quintic, points: [{}]}}"
CIRCLE = "trajectory: {{type: circle, point: {}, center: [1, 1], radius: 0.1, duration: 1{}}}"
AT0, AT1 = "{t: 0, q: {j1: 0, j2: 0}}", "{t: 1, q: {j1: 1, j2: 1}}"

BAD = {
    "circle point": ("", CIRCLE.format("§tpi", ""), "trajectory.point", "did you mean 'tip'"),
    "circle end": ("", CIRCLE.format("§l3.end", ""), "trajectory.point", "no D-H"),
    "circle normal": ("", CIRCLE.format("tip", ", normal: §[0, 0, 0]"), "trajectory.normal", "zero"),
    "circle turns": ("", CIRCLE.format("tip", ", turns: §0"), "trajectory.turns", "zero"),
    "circle center": (
        "",
        "trajectory: {type: circle, point: tip, center: §[1], radius: 1, duration: 1}",
        "trajectory.center",
        "2 to 3 numbers",
    ),
    "guess": ("", CIRCLE.format("tip", ", ik: {guess: {x: §1}}"), "trajectory.ik.guess.x", "unknown joint"),
    "half a guess": (
        "",
        CIRCLE.format("tip", ", ik: {guess: §{j1: 1}}"),
        "trajectory.ik.guess",
        "'j2' is missing",
    ),
    "cartesian point": (
        "",
        "trajectory: {type: cartesian, point: §x, position: [t, 1], duration: 1}",
        "trajectory.point",
        "unknown point",
    ),
    "cartesian names": (
        "",
        "trajectory: {type: cartesian, point: tip, position: [t, §j1], duration: 1}",
        "trajectory.position.1",
        "'j1' is not allowed here; allowed: t, k",
    ),
    "joint lacks one": ("", JOINT.format("§{j1: t}"), "trajectory.q", "joint 'j2' is missing", "j1, j2"),
    "joint has one more": (
        "",
        JOINT.format("{j1: t, j2: t, weld: §t}"),
        "trajectory.q.weld",
        "unknown joint",
    ),
    "joint in joint": ("", JOINT.format("{j1: t, j2: §j1}"), "trajectory.q.j2", "not allowed here"),
    "one way point": (
        "",
        QUINTIC.format(AT0).replace("points: ", "points: §"),
        "trajectory.points",
        "at least 2",
    ),
    "way point joint": (
        "",
        QUINTIC.format(AT0 + ", {t: 1, q: §{j1: 1}}"),
        "trajectory.points.1.q",
        "'j2' is missing",
    ),
    "way point rate": (
        "",
        QUINTIC.format("{t: 0, q: {j1: 0, j2: 0}, qd: §{j2: 0}}, " + AT1),
        "trajectory.points.0.qd",
        "'j1' is missing",
    ),
    "way point times": (
        "",
        QUINTIC.format(AT0 + ", {t: §0, q: {j1: 1, j2: 1}}"),
        "trajectory.points.1.t",
        "times must increase",
    ),
    "way point start": (
        "",
        QUINTIC.format("{t: §0.5, q: {j1: 0, j2: 0}}, " + AT1),
        "trajectory.points.0.t",
        "first time must be 0",
    ),
    "empty table": (
        "",
        "trajectory: §{type: table}",
        "trajectory",
        "needs 'file', or both 'columns' and 'rows'",
    ),
    "table without t": (
        "",
        TABLE.format("[§time, j1, j2]", "[[0, 0, 0], [1, 1, 1]]"),
        "trajectory.columns.0",
        "must be 't'",
    ),
    "table joint": (
        "",
        TABLE.format("[t, j1, §j3]", "[[0, 0, 0], [1, 1, 1]]"),
        "trajectory.columns.2",
        "unknown",
    ),
    "table column twice": (
        "",
        TABLE.format("[t, j1, j2, §j1]", "[[0, 0, 0, 0], [1, 1, 1, 1]]"),
        "trajectory.columns.3",
        "twice",
    ),
    "table lacks one": (
        "",
        TABLE.format("§[t, j1]", "[[0, 0], [1, 1]]"),
        "trajectory.columns",
        "'j2' is missing",
    ),
    "table width": (
        "",
        TABLE.format("[t, j1, j2]", "[[0, 0, 0], §[1, 1]], interpolation: linear"),
        "trajectory.rows.1",
        "has 2 numbers; needed: 3",
    ),
    "rows in disorder": (
        "",
        TABLE.format("[t, j1, j2]", "[[0, 0, 0], [1, 1, 1], [§1, 0, 0]], interpolation: linear"),
        "trajectory.rows.2.0",
        "times must increase",
    ),
    "empty row": (
        "",
        TABLE.format("[t, j1, j2]", "[§[], [1, 1, 1]], interpolation: linear"),
        "trajectory.rows.0",
        "has 0 numbers",
    ),
}


test_refused_at_its_place = refusals(BAD)


def trajectory(text: str) -> Any:
    return load_scene_text(spoiled("", text)).trajectory


def test_trajectories() -> None:
    circle = trajectory(
        CIRCLE.format("l2.end", ", start: 90 deg, turns: -2, ik: {guess: {j1: 5 deg, j2: 0}}")
    )
    assert isinstance(circle, CircleTrajectory)
    assert (circle.center, circle.turns, circle.normal) == ((1.0, 1.0), -2.0, (0.0, 0.0, 1.0))
    assert circle.start == pytest.approx(1.5707963267948966)
    assert circle.ik.method == "auto" and circle.ik.tolerance == 1e-12 and circle.ik.max_iterations == 50
    assert circle.ik.branch is None and circle.ik.guess == {
        "j1": pytest.approx(0.08726646259971647),
        "j2": 0.0,
    }
    quintic = trajectory(QUINTIC.format(f"{AT0}, {AT1}"))
    assert isinstance(quintic, QuinticTrajectory)
    assert [p.t for p in quintic.points] == [0.0, 1.0] and quintic.points[0].qd == {}
    table = trajectory(TABLE.format("[t, j2, j1]", "[[0, 1, 2], [1, 3, 4]], interpolation: linear"))
    assert isinstance(table, TableTrajectory)
    assert table.columns == ("t", "j2", "j1") and table.interpolation == "linear"
    assert table.rows == ((0.0, 1.0, 2.0), (1.0, 3.0, 4.0))
    cartesian = trajectory(
        "trajectory: {type: cartesian, point: tip, position: [1 + t, 2, k*t], duration: 1}"
    )
    assert [f.evaluate({"t": 2.0, "p.k": 5.0}) for f in cartesian.position] == [3.0, 2.0, 10.0]
