"""Forces that jump with the state: crossed at any tolerance, however little of a step fits beside the jump."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.run.stability_cases import CASES

# 1e6 N m/rad and a damper that sets in all at once, with accelerations that jump by 260 rad/s^2
TEXT = next(case for case in CASES if case.name == "stiff_stops").text(True)


@lru_cache
def ended(method: str, rtol: float) -> np.ndarray:
    overrides = [
        f"simulate.integrator={method}",
        f"simulate.rtol={rtol}",
        f"simulate.atol={rtol / 100}",
        "simulate.error_estimate=false",
    ]
    result = simulate(load_scene_text(TEXT, overrides=overrides))
    return np.concatenate([result["q"][-1], result["qd"][-1]])


@pytest.mark.parametrize("rtol", [1e-9, 1e-11, 1e-12, 1e-13])
@pytest.mark.parametrize("method", ["gauss", "gauss10", "dop853", "dopri5", "rodas5p", "radau", "radau13"])
def test_stiff_stops_at_tight_tolerances(method: str, rtol: float) -> None:
    """The state may stand on the jump itself, where what switches on it still takes the side it came from."""
    exact = ended("gauss", 1e-10)
    assert np.abs(ended(method, rtol) - exact).max() < 3e-7
