"""A row of a sweep states the figures of the command alone, and the same errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.over.many.command import ended, error_of, number_of
from robodyn_cli.over.study.rows import Points, Task
from robodyn_cli.over.study.runs import Compiled, run_points, suits
from robodyn_cli.scene.load import Family, load_scene

# single runs are compared with many to the last digits
pytestmark = pytest.mark.usefixtures("lasting_code")

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
FIGURES = (
    "peak_torque", "peak_torque_time", "rms_torque", "torque_range.0", "torque_range.1", "peak_speed", "peak_power",
    "energy", "energy_net",
)  # fmt: skip
ARM = """
schema: 1
command: inverse
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, parent: base, axis: [0, 0, 1], friction: {coulomb: 0.3}}
    - {name: b, type: prismatic, parent: l1, axis: [1, 0, 0]}
  links:
    - {name: l1, mass: 2, com: [0.2, 0, 0], inertia: {zz: 0.02}}
    - {name: l2, mass: 1.3, com: [0.4, 0.1, 0], inertia: {zz: 0.02}}
trajectory: {type: joint, duration: 2, q: {a: "sin(3*t)", b: "0.4*t^2"}}
inverse: {samples: 61}
"""


def rows_and_alone(
    family: Family, command: str, keys: tuple[str, ...], outputs: tuple[str, ...], values: Any
) -> Any:
    """Return the rows of a study, whether compiled code made them, and figures and errors of the command alone."""
    from robodyn_cli.over.commands import execute
    from robodyn_cli.over.many.keys import settings
    from robodyn_cli.tools.progress import Stopwatch, no_progress

    task = Task(family, command, keys, outputs)
    rows = run_points(task, Points(np.arange(len(values)), values), 1)
    made = Compiled(task, 1).make(Points(np.arange(len(values)), values)) if suits(task) else ()
    alone = []
    for row in values:
        scene = family.scene(settings(keys, row))
        summary = ended(lambda scene=scene: execute(command, scene, no_progress, Stopwatch())).summary  # type: ignore[misc]
        alone.append([[f(summary, key) for key in outputs] for f in (number_of, error_of)])
    return rows.rows[np.argsort(rows.runs)], len(made), np.array(alone)


def test_rows_of_compiled_torques_state_the_errors_of_inverse(tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    path.write_text(ARM)
    joints = ("a", "b")
    outputs = (*(f"joints.{j}.{f}" for j in joints for f in FIGURES), "peak_torque.a")
    values = np.array([[2.0, 1.3], [2.2, 1.1], [0.3, 5.0]])
    keys = ("robot.links.l1.mass", "robot.links.l2.com.1")
    rows, made, alone = rows_and_alone(Family(path, []), "inverse", keys, outputs, values)
    assert made == len(values)
    np.testing.assert_allclose(rows["outputs"], alone[:, 0], rtol=1e-11, atol=1e-13)
    assert np.all(np.isfinite(rows["errors"])) and np.all(rows["errors"] >= 0.0)
    # rounding of the figures themselves changes the differences of samples that errors are made of
    np.testing.assert_allclose(rows["errors"], alone[:, 1], rtol=1e-3, atol=1e-11)


def test_errors_that_rounding_makes_are_those_of_each_run(tmp_path: Path) -> None:
    """With heavy links the torques' rounding is their largest error, and follows the masses of the run."""
    path = tmp_path / "arm.yaml"
    path.write_text(ARM.replace("samples: 61", "samples: 2001"))
    values = np.array([[1.0], [10.0], [1e6]])
    rows, made, alone = rows_and_alone(
        Family(path, []), "inverse", ("robot.links.l1.mass",), ("peak_torque.a",), values
    )
    assert made == len(values)
    # here differences of samples are made of rounding, which differs in lanes of vectors
    np.testing.assert_allclose(rows["errors"], alone[:, 1], rtol=0.3)
    assert rows["errors"][2, 0] > 1e4 * rows["errors"][0, 0]


def test_errors_of_figures_are_outputs_like_others(tmp_path: Path) -> None:
    """``joints.a.errors.peak_torque`` ends like a figure; a study of it gave nothing once."""
    path = tmp_path / "arm.yaml"
    path.write_text(ARM)
    rows, made, alone = rows_and_alone(
        Family(path, []),
        "inverse",
        ("robot.links.l1.mass",),
        ("joints.a.errors.peak_torque",),
        np.array([[2.0]]),
    )
    assert made == 1 and rows["outputs"][0, 0] > 0.0
    assert rows["outputs"][0, 0] == pytest.approx(alone[0, 0, 0], rel=1e-9)


@pytest.mark.parametrize(
    "file, command, key, outputs",
    [
        ("double_pendulum.yaml", "simulate", "robot.links.link2.mass", ("final.q.theta1", "final.qd.theta2", "final.time")),
        ("four_bar_deploy.yaml", "deploy", "robot.links.crank.mass", ("lock.time",)),
        ("2r_circle.yaml", "kinematics", "trajectory.radius", ("joints.theta1.peak_speed", "joints.theta2.largest")),
        ("parallelogram.yaml", "statics", "robot.links.crank.mass", ()),
    ],
)  # fmt: skip
def test_rows_of_other_commands_state_the_errors_of_one(
    file: str, command: str, key: str, outputs: tuple[str, ...]
) -> None:
    family = Family(CONFIGS / file, [])
    scene = load_scene(CONFIGS / file)
    if not outputs:
        outputs = tuple(f"torques_of_joints.{j.name}" for j in scene.robot.joints[:1])
    value = {"trajectory.radius": 0.3}.get(key, 1.7)
    if key.startswith("robot.links."):
        link = next(link for link in scene.robot.links if link.name == key.split(".")[2])
        assert link.mass is not None
        value = 1.01 * link.mass
    rows, _, alone = rows_and_alone(family, command, (key,), outputs, np.array([[value]]))
    np.testing.assert_allclose(rows["outputs"], alone[:, 0], rtol=1e-9)
    np.testing.assert_allclose(rows["errors"], alone[:, 1], rtol=1e-4)
