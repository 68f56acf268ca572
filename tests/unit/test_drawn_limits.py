"""Limits of joints in results and in drawings over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.report.lines import LIMIT_NOTE, limits_near
from robodyn_cli.report.registry import draw
from robodyn_cli.results import hdf5
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene
from robodyn_cli.works.inverse import inverse

CIRCLE = Path("configs/2r_circle.yaml")


def limited(**limits: Any) -> Result:
    sets = [f"robot.joints.{key.replace('__', '.limits.')}={value}" for key, value in limits.items()]
    return inverse(load_scene(CIRCLE, sets))


def levels(figure: Any) -> list[float]:
    """Return the heights of the dotted lines across the panels."""
    lines = [line for ax in figure.axes for line in ax.get_lines() if line.get_linewidth() == 1.3]
    return [float(line.get_ydata()[0]) for line in lines]


def words(figure: Any) -> str:
    return " ".join(text.get_text() for text in figure.texts)


def test_results_hold_the_limits_of_the_joints_that_have_some(tmp_path: Path) -> None:
    result = limited(theta1__effort=170, theta1__upper="100 deg", theta2__effort=70, theta2__jerk=5)
    hdf5.write(result, tmp_path / "result.h5")
    stored = hdf5.read(tmp_path / "result.h5")
    effort, upper = stored.variables["joint_limits/effort"], stored.variables["joint_limits/upper"]
    assert (
        effort.names == ("theta1", "theta2")
        and effort.data.tolist() == [170.0, 70.0]
        and effort.units == "N m"
    )
    assert (
        upper.names == ("theta1",)
        and upper.units == "rad"
        and upper.data[0] == pytest.approx(np.radians(100))
    )
    assert "joint_limits/speed" not in stored and "joint_limits/lower" not in stored


def test_a_limit_is_drawn_where_the_motion_comes_near_it() -> None:
    result = limited(theta1__effort=180, theta2__effort=60, theta2__speed=50)
    assert limits_near(result, "tau") == {"theta1": [180.0], "theta2": [60.0]}, "not those on the other side"
    assert limits_near(result, "qd") == {}, "far away"
    figure = draw(result, "torques")
    assert sorted(levels(figure)) == [60.0, 180.0]
    assert LIMIT_NOTE.removeprefix("; ") in words(figure)
    assert LIMIT_NOTE.removeprefix("; ") not in words(draw(result, "joint_rates"))
