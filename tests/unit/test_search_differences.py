"""Differences of a search: smooth outputs, corners, and outputs that jump from run to run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import optimise
from robodyn_cli.over.search.differences import ROUGH, RunsBeside, places_beside, step_beside

CONFIGS = Path(__file__).parents[2] / "configs"
JUMP = 1e-6


def beside(f: Callable[[float], float], x: float, step: float) -> RunsBeside:
    """Runs of f at x, between 0 and 1."""
    steps = np.array([place[0] - x for place in places_beside(np.array([x]), 0, (0.0, 1.0), step)])
    changes = np.array([[f(x + s) - f(x)] for s in steps])
    return RunsBeside(np.array([f(x)]), np.array([1e-13]), steps, changes, np.full_like(changes, 1e-13), 1.0)


def jumps(f: Callable[[float], float], x: float) -> float:
    own = step_beside(np.array([f(x)]), np.array([1e-13]))
    return float(beside(f, x, own).jumps(beside(f, x, ROUGH), None)[0])


def encoder(x: float) -> float:
    """A ramp seen in steps that are small beside it over the whole way, and large from run to run."""
    return 1.0 + 1e-4 * x + JUMP * float(np.random.default_rng(int(1e12 * x)).uniform(-1.0, 1.0))


@pytest.mark.parametrize(
    ("smooth", "x"),
    [
        (lambda x: (x - 0.4) ** 2, 0.4),
        (lambda x: np.sin(3.0 * x), 0.4),
        (lambda x: (x - 0.4) ** 2, 0.40001),
        (lambda x: np.cos(20.0 * x), np.pi / 20.0),
        (lambda x: abs(x - 0.4), 0.4),
        (lambda x: abs(x - 0.4) + x, 0.4),
        (lambda x: 2.0, 0.4),
        (lambda x: np.exp(x), 0.0),  # at a bound both runs are on one side
        (lambda x: (x - 1.0) ** 2, 1.0),
    ],
)
def test_smooth_outputs_and_corners_do_not_jump(smooth: Callable[[float], float], x: float) -> None:
    assert jumps(smooth, x) == 0.0


@pytest.mark.parametrize("x", [0.0, 0.1, 0.35, 0.6, 0.77, 1.0])
def test_derivatives_of_outputs_that_jump_are_known_over_wide_steps(x: float) -> None:
    own, wide = beside(encoder, x, 1e-4), beside(encoder, x, ROUGH)
    found = own.jumps(wide, None)
    assert 0.1 * JUMP < found[0] < 4.0 * JUMP
    slope, error = wide.rough_slope(found)
    assert abs(slope[0] - 1e-4) <= error[0] < 1e-4
    narrow, told = own.slope()
    assert abs(narrow[0] - 1e-4) > told[0]  # as it would be without


def test_what_jumps_elsewhere_does_so_here() -> None:
    wide = beside(encoder, 0.5, ROUGH)
    assert wide.jumps(wide, None)[0] == 0.0
    assert wide.jumps(wide, np.array([True]))[0] == wide.bend[0] > 0.0


def test_a_search_ends_where_its_output_jumps_by_more_than_it_changes() -> None:
    """Encoders round what a controller sees: the end of the motion jumps from run to run, whatever the mass."""
    result = optimise(
        CONFIGS / "controlled_arm.yaml", {"robot.links.link1.mass": "uniform(12.3, 12.6)"}, minimise="final.q.theta1",
        starts=2,
    )  # fmt: skip
    assert result.summary["search"]["runs"] <= 20
    assert "jumps" in result.summary["proof"]["text"]
    assert result.summary["keys"]["robot.links.link1.mass"]["uncertainty"] is None
