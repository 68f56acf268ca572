"""Motions in the least time as tables of pieces, and limits that differ by direction, from the scene to what they bound."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from robodyn_cli import load_scene, load_scene_text
from robodyn_cli.errors import SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.ready.doors import along
from robodyn_cli.results.hdf5.writer import write
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.spans import sides
from robodyn_cli.torques.dynamics import InverseDynamics
from robodyn_cli.trajectories.given import TableTrajectory
from robodyn_cli.works.inverse import inverse, program_of
from tests.random_paths import random_path

ROOT = Path(__file__).parents[2]
TRAJECTORIES = ROOT / "configs" / "trajectories"
HEAD = (TRAJECTORIES / "fastest_2r.yaml").read_text(encoding="utf-8").split("trajectory:")[0]
HEAD = HEAD.replace("../", f"{TRAJECTORIES.parent}/")
KEPT = 2e-6  # of a limit: 1e-6 by the search, and the error of the pieces


def table_of(result: Any) -> TableTrajectory:
    """Return the table that a result gives."""
    pieces = result.variables["pieces"]
    return TableTrajectory("table", None, tuple(pieces.names), tuple(map(tuple, pieces.data.tolist())), None)


def dense(knots: Any) -> np.ndarray:
    """Return many times in each piece, but the last moment, at rest without friction."""
    knots = np.asarray(knots)
    return (knots[:-1, None] + np.diff(knots)[:, None] * np.linspace(1e-6, 1.0 - 1e-6, 21)).ravel()


def largest_use(scene: Scene, table: TableTrajectory, limits: Any) -> dict[str, float]:
    """Return the largest part of each kind of limit that a table's motion uses, by the inverse dynamics."""
    model = build_model(scene)
    motion = table.motion(dense(table.course.knots), model.q_names, {})
    tau = InverseDynamics(dataclasses.replace(scene, trajectory=None))(motion.q, motion.qd, motion.qdd)
    use: dict[str, float] = {}
    for kind, values in (("effort", tau), ("speed", motion.qd), ("acceleration", motion.qdd)):
        for name, limit in limits.get(kind, {}).items():
            column, (low, high) = values[:, model.v_names.index(name)], sides(limit)
            span = 0.5 * (high - low)
            passed = max(column.max() - high, low - column.min()) / span
            use[kind] = max(use.get(kind, 0.0), 1.0 + float(passed))
    return use


def one_sided(limits: dict[str, Any], rng: np.random.Generator, kinds: tuple[str, ...]) -> dict[str, Any]:
    """Return limits with more room in one direction of each joint than in the other."""
    return {
        kind: {
            name: (-x * rng.uniform(1.0, 2.0), x * rng.uniform(1.0, 2.0)) if kind in kinds else x
            for name, x in given.items()
        }
        for kind, given in limits.items()
    }


@pytest.mark.parametrize(("seed", "asymmetric"), [(1, False), (1, True), (6, False), (9, True), (14, True)])
def test_a_table_of_pieces_keeps_the_limits(seed: int, asymmetric: bool) -> None:
    """The motion again, instant by instant, and no limit is passed where a spline through the samples would."""
    scene = random_path(seed)
    kinds = ("speed", "acceleration", "effort")
    limits: dict[str, Any] = {kind: dict(getattr(scene.trajectory, kind)) for kind in kinds}
    if asymmetric:
        limits = one_sided(limits, np.random.default_rng(seed), kinds)
        scene = dataclasses.replace(scene, trajectory=dataclasses.replace(scene.trajectory, **limits))
    result, found = inverse(scene), along(scene).trajectory
    table, names = table_of(result), build_model(scene).q_names
    assert table.duration == pytest.approx(found.duration, rel=1e-14)
    times = dense(table.course.knots)
    again, own = (x.motion(times, names, {}) for x in (table, found))
    assert np.abs(again.q - own.q).max() < 1e-10
    assert np.abs(again.qdd - own.qdd).max() <= 3e-8 * np.abs(own.qdd).max()
    use = largest_use(scene, table, limits)
    assert 0.999 < max(use.values()) <= 1.0 + KEPT, use
    spline = TableTrajectory(
        "table",
        None,
        ("t", *names),
        tuple(map(tuple, np.column_stack([result.time, result["q"]]))),
        "quintic",
    )
    assert max(largest_use(scene, spline, limits).values()) > 1.0 + 10.0 * KEPT


SEQUENCE = """
trajectory:
  type: sequence
  segments:
    - {type: fastest, effort: {theta1: [-250, 400], theta2: [-200, 130]}, points: [{q: {theta1: 0, theta2: 0.5}}, {q: {theta1: 1, theta2: 1}}]}
    - {type: quintic, points: [{t: 0, q: {theta1: 1, theta2: 1}}, {t: 0.3, q: {theta1: 1, theta2: 1}}]}
    - {type: fastest, effort: {theta1: [-250, 400], theta2: [-200, 130]}, points: [{q: {theta1: 1, theta2: 1}}, {q: {theta1: 0.2, theta2: 1.4}}]}
"""
PATH = """
trajectory:
  type: fastest
  effort: {theta1: [-250, 420], theta2: [-200, 130]}
  path: {type: path, point: link2.end, speed: 1, acceleration: 4, jerk: 40, start: {position: [1.4, 1.0, 0]}, ik: {branch: elbow_up},
         segments: [{type: line, to: [1.0, 1.2, 0], dwell: 0.2}, {type: line, to: [0.9, 0.9, 0]}]}
"""


@pytest.mark.parametrize("trajectory", [SEQUENCE, PATH], ids=["sequence", "path with a stop"])
def test_sequences_and_paths_as_files(trajectory: str, tmp_path: Path) -> None:
    """Through the result's file, and as a CSV file."""
    write(inverse(load_scene_text(HEAD + trajectory)), tmp_path / "fast.h5")
    with h5py.File(tmp_path / "fast.h5") as file:
        rows, names, tau = file["pieces"][()], list(file["pieces"].attrs["names"]), file["tau"][()]
        times = file["time"][()]
    np.savetxt(tmp_path / "fast.csv", rows, delimiter=",", header=",".join(names), comments="", fmt="%.17g")
    efforts = {"theta1": (-250.0, 400.0 if "sequence" in trajectory else 420.0), "theta2": (-200.0, 130.0)}
    for name in ("fast.h5", "fast.csv"):
        again = load_scene_text(
            f"{HEAD}trajectory: {{type: table, file: {name}}}\n", str(tmp_path / "again.yaml")
        )
        assert largest_use(again, again.trajectory, {"effort": efforts})["effort"] <= 1.0 + KEPT
        result = inverse(again)
        assert result.time == pytest.approx(times, abs=1e-12)
        apart = np.abs(result["tau"] - tau).max(axis=1)
        knots = np.abs(times[:, None] - rows[:, 0]).min(axis=1) < 1e-9
        assert apart[~knots].max() < 1e-5  # at a knot the acceleration is one of two


def test_tables_of_pieces_say_what_is_wrong() -> None:
    rows = f"rows: {[[k, k, 1, 0, 0] for k in range(6)]}"
    for columns, more, message in (
        ("[t, theta1, theta1^1, theta2, theta3^1]", "", "unknown joint 'theta3^1'"),
        ("[t, theta1, theta1^1, theta1^2, theta1^3]", "", "joint 'theta2' is missing"),
        ("[t, theta1, theta1^1, theta2, theta2^1]", ", interpolation: quintic", "allowed: pieces"),
    ):
        text = f"{HEAD}trajectory: {{type: table, columns: {columns}, {rows}{more}}}\n"
        with pytest.raises(SceneError, match=message.replace("^", r"\^")):
            load_scene_text(text)


ARM = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{{name: hinge, type: revolute, axis: [0, 0, 1], limits: {{{limits}}}}}]
  links: [{{name: rod, mass: 1, com: [1, 0, 0], inertia: {{zz: 0.1}}}}]
"""


def hinge(limits: str, rest: str) -> Scene:
    return load_scene_text(ARM.format(limits=limits) + rest)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ("effort: [30, 5]", "low < high"),
        ("speed: [1, 5]", "low < 0 < high"),
        ("acceleration: [-5, -1]", "low < 0 < high"),
        ("effort: [1, 2, 3]", "2 numbers"),
        ("effort: -1", "number > 0"),
    ],
)
def test_limits_say_what_is_wrong(limits: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        hinge(limits, "initial: {q: {hinge: 0}}\n")


def test_an_effort_that_keeps_its_sign() -> None:
    """A rod that is lifted and lowered by a cable that must not go slack: torques from 5 to 30 N m, never less."""
    rest = "trajectory: {type: fastest, points: [{q: {hinge: 0}}, {q: {hinge: 1}}]}\n"
    scene = hinge("effort: [5, 30]", rest)
    result = inverse(scene)
    assert result["tau"].min() >= 5.0 * (1.0 - 1e-5) and result["tau"].max() <= 30.0 * (1.0 + 1e-6)
    wider = inverse(hinge("effort: 30", rest)).time[-1]
    assert result.time[-1] > 1.05 * wider


def test_each_direction_is_warned_of_by_itself() -> None:
    rest = "trajectory: {type: joint, duration: 2, q: {hinge: sin(3*t)}}\n"
    texts = inverse(hinge("effort: [-2, 40], speed: [-2, 4]", rest)).summary["warnings"]
    assert any("effort limit of -2 N m" in text for text in texts)
    assert any("speed limit of -2 rad/s" in text for text in texts)
    assert not any("limit of 4" in text for text in texts)


def test_controllers_and_events_of_a_simulation(tmp_path: Path) -> None:
    """Torques stay between the two sides, the summary tells for how long they are there, and the drawing has both."""
    from robodyn_cli.works.simulate import simulate

    control = "control: {type: pd, gains: {kp: 400, kd: 5}, reference: {type: joint, duration: 3, q: {hinge: sin(2*t)}}}\n"
    rest = f"initial: {{q: {{hinge: 0}}}}\nsimulate: {{duration: 3, samples: 601}}\n{control}"
    result = simulate(hinge("effort: [-4, 25], speed: [-1, 50]", rest))
    torque = result["control/torque"][:, 0]
    assert torque.min() == pytest.approx(-4.0, abs=1e-12) and torque.max() == pytest.approx(25.0, abs=1e-12)
    said = result.summary["control"]
    assert said["limits"] == {"hinge": 25.0} and said["least_limits"] == {"hinge": -4.0}
    at = (torque <= -4.0 + 1e-9) | (torque >= 25.0 - 1e-9)
    assert said["saturated"]["hinge"] == pytest.approx(3.0 * at.mean(), abs=0.05)
    assert "speed limit of -1 to 50 rad/s" in " ".join(result.summary["warnings"])
    stored = {path: item.data.tolist() for path, item in result.group("joint_limits").items()}
    assert stored == {
        "least_effort": [-4.0],
        "largest_effort": [25.0],
        "least_speed": [-1.0],
        "largest_speed": [50.0],
    }


def test_moves_keep_to_the_smaller_side() -> None:
    """A trapezoid of the speed speeds up as it brakes: it takes what both directions allow."""
    rest = "command: inverse\ntrajectory: {type: trapezoid, points: [{q: {hinge: 0}}, {q: {hinge: 2}}]}\n"
    one, other = (
        hinge(limits, rest).trajectory.duration
        for limits in ("speed: [-1, 3], acceleration: [-9, 4]", "speed: 1, acceleration: 4")
    )
    assert one == other


def test_a_trajectory_may_only_narrow_the_limits_of_a_joint() -> None:
    rest = (
        "trajectory: {type: fastest, effort: {hinge: EFFORT}, points: [{q: {hinge: 0}}, {q: {hinge: 1}}]}\n"
    )
    hinge("effort: [-20, 30]", rest.replace("EFFORT", "[-15, 30]"))
    for effort in ("25", "[-15, 31]"):
        with pytest.raises(SceneError, match="allowed: within -20 to 30"):
            hinge("effort: [-20, 30]", rest.replace("EFFORT", effort))


def test_figures_of_the_least_time_do_not_depend_on_samples(tmp_path: Path) -> None:
    """Torques jump at hundreds of knots: peaks and means of few samples beside those of very many in each piece, along
    the path and along the table that it gives."""
    scene = load_scene(TRAJECTORIES / "fastest_2r.yaml")
    found = inverse(scene)
    write(found, tmp_path / "result.h5")
    law = along(scene).trajectory.scaling.law
    ends, w = np.polynomial.legendre.leggauss(6)
    h = np.diff(law.knots)[:, None]
    times = (
        law.knots[:-1, None] + 0.5 * h * (1.0 + np.sort(np.append(ends, [-1.0 + 1e-6, 1.0 - 1e-6])))
    ).ravel()
    motion = along(scene).trajectory
    program = program_of(scene)
    tau = program.evaluate(program.plan(times), program.compile(len(times))).tau.reshape(len(h), 8, 2)
    rms = np.sqrt((0.5 * h[..., None] * w[:, None] * tau[:, 1:-1] ** 2).sum(axis=(0, 1)) / motion.duration)
    table = f"trajectory: {{type: table, file: {tmp_path / 'result.h5'}}}"
    for text, samples in ((None, 11), (None, 400), (table, 11), (table, 3000)):
        own = inverse(scene if text is None else load_scene_text(HEAD + text), samples=samples).summary[
            "joints"
        ]
        for k, name in enumerate(("theta1", "theta2")):
            figures, errors = own[name], own[name]["errors"]
            assert errors["peak_torque"] < 1e-4 and errors["rms_torque"] < 1e-5 and errors["energy"] < 1e-5
            away = (
                1e-4 if text else 1e-9
            )  # accelerations of a table are those of the path to 1e-8 of the largest
            peak = float(np.abs(tau[..., k]).max())
            assert -away <= figures["peak_torque"] - peak <= errors["peak_torque"] + 1e-3
            assert abs(figures["rms_torque"] - rms[k]) <= errors["rms_torque"] + away
