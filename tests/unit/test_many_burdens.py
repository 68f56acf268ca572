"""``inverse`` for many runs: what drives bear, margins of motorisation, shaking forces and flywheels are those of the
command, its verdict and exit code too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.over.study.rows import Points, Task
from robodyn_cli.over.study.runs import Compiled, make_one, suits
from robodyn_cli.scene.load import Family
from tests.many import compare_all
from tests.mechanisms import CONFIGS

DRIVEN, HINGE = CONFIGS / "2r_drives.yaml", CONFIGS / "deployable_hinge.yaml"
FEWER = ("expect={}", "inverse.samples=101")


@pytest.mark.parametrize(
    ("path", "keys", "group"),
    [
        (DRIVEN, ("robot.links.link2.mass",), "drives"),
        (HINGE, ("robot.links.panel.mass",), "motorisation"),
        (CONFIGS / "mechanisms" / "flywheel.yaml", ("robot.links.piston.mass",), "flywheel"),
        (CONFIGS / "mechanisms" / "flywheel.yaml", ("robot.joints.rod.origin.xyz#1",), "shaking"),
    ],
)
def test_every_figure_is_that_of_the_command(path: Path, keys: tuple[str, ...], group: str) -> None:
    keys_of = compare_all(Task(Family(path, FEWER), "inverse", keys, ()), 2)
    assert group in {key.partition(".")[0] for key in keys_of}


@pytest.mark.parametrize(
    ("path", "key", "small", "large", "of"),
    [
        (DRIVEN, "robot.links.link2.mass", 10.0, 60.0, "drives.theta1.margin"),
        (HINGE, "robot.joints.hinge.spring.stiffness", 2.0, 1.0, "motorisation.hinge.ratio"),
    ],
)
def test_runs_with_drives_or_margins_that_are_too_small(
    path: Path, key: str, small: float, large: float, of: str
) -> None:
    """Their exit code is 1, and a scene may expect their status."""
    values = np.array([[small], [large]])
    for status, holds in (("ok", [True, False]), ("undersized", [False, True])):
        family = Family(path, (f"expect={{status: {status}}}", "inverse.samples=101"))
        asked = Task(family, "inverse", (key,), (of,))
        assert suits(asked)
        rows = Compiled(asked, 1).make(Points(np.arange(2), values))
        assert rows.rows["code"].tolist() == [0, 1] and rows.rows["holds"].tolist() == holds
        for run in range(2):
            one = make_one(asked, run, values[run])[0]
            assert one.rows["code"][0] == rows.rows["code"][run] and one.rows["holds"][0] == holds[run]
            assert one.rows["outputs"][0] == pytest.approx(rows.rows["outputs"][run], rel=1e-9)
            assert one.reasons.get(run) == rows.reasons.get(run)


def test_data_of_drives_that_vary_are_left_to_the_command() -> None:
    asked = Task(Family(DRIVEN, FEWER), "inverse", ("drives.theta1.margin",), ("drives.theta1.margin",))
    compiled = Compiled(asked, 1)
    rows = compiled.make(Points(np.arange(2), np.array([[0.1], [0.2]])))
    for run, row in zip(rows.runs.tolist(), rows.rows):
        one = make_one(asked, run, np.array([[0.1], [0.2]])[run])[0].rows[0]
        assert row["outputs"] == pytest.approx(one["outputs"], rel=1e-9)
