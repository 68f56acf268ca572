"""What a user may write: mypy checks it, strictly, and a test runs it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import robodyn
from robodyn import Mechanism, Report, Result, load_scene

CONFIGS = Path(__file__).parents[1] / "configs"


def main() -> tuple[Result, Report]:
    """Run a scene with other values, and look at what comes back."""
    scene = load_scene(CONFIGS / "2r_circle.yaml", {"inverse": {"samples": 51}})
    result = robodyn.inverse(scene, set={"robot.links.link1.mass": np.float64(12.0)})
    assert result["tau"].shape == (51, 2)
    study = robodyn.sweep(
        scene,
        vary={"robot.links.link1.mass": [10.0, 12.0]},
        of=["peak_torque.theta1"],
        jobs=1,
        progress=print,
    )
    assert study.summary["runs"] == 2
    found = result.compare(robodyn.inverse(scene), rtol=1e-6)
    assert found.exit_code == 1 and "differ" in str(found)
    assert Mechanism(scene).mass_matrix(np.zeros(2)).shape == (2, 2)
    return result, robodyn.validate(scene, strict=True)
