"""Figures of runs in compiled code beside those of whole commands, with other numbers than those of the scene."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.over.many.keys import value_of
from robodyn_cli.over.study.rows import Points, Task
from robodyn_cli.over.study.runs import Compiled, make_one, why_slow
from robodyn_cli.scene.load import Family

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
EXTREMES = ("smallest", "largest", "final")
CASES = {
    "double_pendulum": (
        "robot.links.link1.mass",
        ("qdd.theta2", "points/tip.length", "reactions/theta1.force"),
        ("error_estimate.q_max", "error_estimate.rounding_floor", "tolerances.rtol"),
    ),
    "benchmarks/rbd_four_bar": (
        "robot.links.link1.mass",
        ("qd.gamma", "reactions/gamma.fx"),
        ("error_estimate.state_max",),
    ),
    "four_bar_deploy": (
        "robot.links.crank.mass",
        ("qd.theta1", "base_wrench.force"),
        ("final.q.phi1", "final.qd.phi2", "final.time", "error_estimate.q_max", "error_estimate.q_end"),
    ),
    "mechanisms/solar_array_springs": (
        "deploy.latches.latch2.hold.stiffness",
        ("qdd.hinge2", "reactions/hinge1.mz"),
        ("final.q.hinge1", "lock.angles_deg.hinge3", "energy_drift", "locks.latch2.peak_moment"),
    ),
    "mechanisms/solar_array_in_step": (
        "robot.links.panel1.mass",
        ("qd.hinge4", "latch_loads.latch3"),
        ("final.q.hinge1", "constraint_residual.position", "lock.angles_deg.hinge3"),
    ),
    "mechanisms/kinematic_design": (
        "robot.joints.crank.a",
        ("qdd.rocker", "pressure_angles/drive", "point_velocities/trace.length"),
        (
            "design.dead_points.output.0.first",
            "design.four_bars.pin.joints.rocker.distance",
            "mobility.actual",
        ),
    ),
    "mechanisms/five_bar_circle": (
        "robot.links.crank_left.mass",
        (),
        ("reactions.largest.left.peak_force", "reactions.largest.base_wrench.peak_moment"),
    ),
    "2r_circle": ("robot.links.link2.com.0", (), ("peak_torque.theta1", "joints.theta2.energy")),
}


@pytest.mark.parametrize("name", CASES)
def test_figures_of_compiled_runs_are_those_of_whole_commands(name: str) -> None:
    key, columns, others = CASES[name]
    family = Family(CONFIGS / f"{name}.yaml", ("expect={}",))
    outputs = (*(f"extremes.{column}.{side}" for column in columns for side in EXTREMES), *others)
    task = Task(family, str(family.own.command), (key,), outputs)
    assert not why_slow(task)
    own = value_of(family, key)
    assert own is not None
    values = np.array([[own * part] for part in (0.97, 1.03)])
    compiled = Compiled(task, 1)
    made = compiled.make(Points(np.arange(2), values))
    assert len(made) == 2 and not compiled.left
    for run, row in zip(made.runs.tolist(), made.rows):
        alone = make_one(task, run, values[run])[0].rows[0]
        assert row["code"] == alone["code"]
        for k, output in enumerate(outputs):
            y, expected = float(row["outputs"][k]), float(alone["outputs"][k])
            error, told = float(row["errors"][k]), float(alone["errors"][k])
            if output.startswith(("error_estimate", "energy_drift", "constraint_residual")):
                # what integrations leave differs as rounding does; it is as large
                assert 0.02 * expected <= y <= 50.0 * expected + 1e-15, (output, y, expected)
                continue
            assert math.isnan(error) == math.isnan(told), (output, error, told)
            off = sum(x for x in (error, told) if not math.isnan(x))
            assert abs(y - expected) <= off + 1e-9 * abs(expected), (output, y, expected)
            assert math.isnan(told) or error <= 30.0 * told + 1e-12 * abs(expected), (output, error, told)


def test_a_structure_serves_rows_beside_those_that_do_not_assemble() -> None:
    """At both ends of the range nothing can be built to confirm what lies between."""
    family = Family(CONFIGS / "four_bar_deploy.yaml", ("expect={}",))
    task = Task(family, "deploy", ("robot.joints.phi2.a",), ("lock.time",))
    values = np.linspace(1.15, 1.25, 21)[:, None]
    compiled = Compiled(task, 1)
    made = compiled.make(Points(np.arange(len(values)), values))
    assert 10 in made.runs and len(made) >= 3
    row = made.rows[list(made.runs).index(10)]
    assert abs(row["outputs"][0] - make_one(task, 10, values[10])[0].rows["outputs"][0, 0]) < 1e-8
    told = (
        "their numbers give equations of their own",
        "they do not start or end",
        "equations for many runs",
    )
    assert all(why.startswith(told) for why in compiled.left)
