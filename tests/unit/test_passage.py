"""Singular configurations that are passed: the motion keeps its branch, with any method, or the run says why not."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli import load_scene, load_scene_text, simulate
from robodyn_cli.errors import SingularConfigurationError
from robodyn_cli.run.driver import passage
from robodyn_cli.spatial.algebra import rotation_rpy
from tests.mechanisms import CONFIGS, close

DOUBLE = CONFIGS / "benchmarks" / "four_bar_n2.yaml"
AT_5 = -15.08355715985858581  # theta of the reference (80-bit Taylor integration)
SHORT = ["simulate.duration=5", "simulate.samples=501", "simulate.error_estimate=false"]


@pytest.mark.parametrize(
    ("method", "rtol", "tolerance"),
    [
        ("gauss", 1e-6, 1e-5),
        ("gauss", 1e-12, 1e-9),
        ("dop853", 1e-12, 1e-9),
        ("dopri5", 1e-12, 1e-7),
        ("rodas5p", 1e-8, 1e-4),
    ],
)
def test_the_double_four_bar_stays_a_parallelogram(method: str, rtol: float, tolerance: float) -> None:
    found = simulate(load_scene(DOUBLE, [*SHORT, f"simulate.integrator={method}", f"simulate.rtol={rtol}"]))
    q = found["q"]
    close(q[-1, 0], AT_5, tolerance)
    close(np.sin((q[:, [0, 0]] - q[:, [2, 4]]) / 2), 0.0, 1e-12)
    # all bars horizontal: the leg's angle there is a multiple of pi
    passed = found.summary["passed"]
    assert len(passed) == 5
    legs = np.interp(passed, found["time"], q[:, 0]) / np.pi
    close(legs, np.round(legs), 1e-3)
    residual = found.summary["constraint_residual"]
    assert residual["position"] < 1e-12 and residual["velocity"] < 1e-11


def test_an_overconstrained_one_passes_too() -> None:
    """The same mechanism in an oblique plane, where three rows of each pin are redundant."""
    rpy = (0.4, -0.7, 1.1)
    R = np.array(rotation_rpy(rpy), dtype=float)
    text = DOUBLE.read_text()
    for k in (1, 2):
        place = f"origin: {{xyz: {(R @ [k, 0, 0]).tolist()}, rpy: {list(rpy)}}}"
        text = text.replace(f"origin: {{xyz: [{k}, 0, 0]}}", place)
    text = text.replace(
        "leg0, type: revolute, parent: base,",
        f"leg0, type: revolute, parent: base, origin: {{rpy: {list(rpy)}}},",
    )
    text = text.replace("[0, -9.81, 0]", str((R @ [0, -9.81, 0]).tolist()))
    text = text.replace("{zz: 1/12}", "{xx: 0, yy: 1/12, zz: 1/12}")
    found = simulate(load_scene_text(text, overrides=SHORT))
    assert not found.summary["multipliers"]["unique"] and len(found.summary["passed"]) == 5
    close(found["q"][-1, 0], AT_5, 1e-8)


def test_work_is_carried_over_the_pose() -> None:
    """The parallelogram of the crank's torque: [2/3 + 2] theta'' = 1 exactly, through its flat poses."""
    scene = load_scene(CONFIGS / "parallelogram.yaml", ["simulate.singular=pass", "simulate.duration=8"])
    found = simulate(scene)
    t = found["time"]
    inertia = 2 / 3 + 2.0
    close(found["q"][:, 0], np.pi / 6 + t**2 / (2 * inertia), 1e-8)
    close(found["energy/work"], t**2 / (2 * inertia), 1e-8)
    assert len(found.summary["passed"]) == 3
    assert found.summary["error_estimate"]["state_max"] < 1e-7


def test_a_pose_that_is_only_near_is_not_stepped_over() -> None:
    """A coupler a little longer than the ground: the four-bar comes near its flat pose, and no more."""
    text = (CONFIGS / "parallelogram.yaml").read_text().replace("a: 2.0,", "a: 2.002,")
    text = text.replace("phi2: -30 deg, phi1: 30 deg", "phi2: -30.1 deg, phi1: 30.1 deg")
    found = simulate(load_scene_text(text, overrides=["simulate.singular=pass", "simulate.duration=3.9"]))
    sigma = found["singularity/psi"]
    assert (sigma[:, -1] / sigma[:, 0]).min() < 0.05
    assert found.summary["passed"] == []
    assert found.summary["energy_drift"] < 1e-7


def test_a_step_that_is_not_smooth_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passage, "SMOOTH", 0.0)
    with pytest.raises(
        SingularConfigurationError, match=r"window0, window1 .* cannot be passed: the motion is not"
    ) as caught:
        simulate(load_scene(DOUBLE, SHORT))
    assert caught.value.exit_code == 4
    close(caught.value.details["time"], 0.7143980367, 1e-6)
