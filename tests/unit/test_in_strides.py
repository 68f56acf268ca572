"""Samples that are solved together are those that are followed one after another, and so are their errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene
from robodyn_cli.errors import RobodynError
from robodyn_cli.over.commands import execute
from robodyn_cli.solve import follow, guided
from robodyn_cli.tools.progress import Stopwatch, no_progress


@pytest.mark.parametrize(
    ("name", "setting"),
    [
        ("mechanisms/four_bar_kinematics", "kinematics.samples=181"),
        ("mechanisms/five_bar_circle", "inverse.samples=181"),
        ("mechanisms/rocker_dead_point", "title=as it stands"),  # ends on the way, with a time
        ("trajectories/pick_and_place", "inverse.samples=401"),  # stops, and corners of an open chain's path
    ],
)
def test_samples_that_are_solved_together_are_those_of_one_after_another(
    name: str, setting: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run() -> tuple[Any, str]:
        scene = load_scene(Path(__file__).resolve().parents[2] / "configs" / f"{name}.yaml", [setting])
        try:
            return execute(scene.command, scene, no_progress, Stopwatch()), ""
        except RobodynError as error:
            return error.result, error.message

    found, message = run()
    for module in (guided, follow):
        monkeypatch.setattr(module, "FEWEST", 10**9)
    alone, same = run()
    assert message == same and len(found.time) == len(alone.time)
    for path in ("q", "qd", "qdd"):
        size = max(1.0, float(np.abs(alone[path]).max()))
        # close to a dead point rates magnify what rounding leaves
        within = 1e-8 if message else 1e-11
        np.testing.assert_allclose(found[path], alone[path], rtol=0.0, atol=within * size)
    steps = [
        next(
            result.summary["counters"][key]
            for key in ("ik_steps", "steps")
            if key in result.summary["counters"]
        )
        for result in (found, alone)
    ]
    assert message or steps[0] < 0.5 * steps[1]
