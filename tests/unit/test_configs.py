"""The figures that the scenes in configs/ are there to show, through the Python interface."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import RobodynError, deploy, inverse, load_scene, simulate
from robodyn_cli.results.result import Result

CONFIGS = Path(__file__).parents[2] / "configs"
RUN = {"inverse": inverse, "simulate": simulate, "deploy": deploy}


@cache
def ran(name: str, *overrides: str) -> Result:
    scene = load_scene(CONFIGS / f"{name}.yaml", overrides)
    assert scene.command is not None
    return RUN[scene.command](scene)


def planar_2r(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Return the lecture's torques from its own closed form; q (T, 2)."""
    m, l1, r1, r2, I, g = 12.456, 1.0, 0.773, 0.583, 1.042, 9.81
    c2, s2 = np.cos(q[:, 1]), np.sin(q[:, 1])
    h = m * l1 * r2
    m11 = m * r1**2 + m * (l1**2 + r2**2) + 2 * h * c2 + 2 * I
    m12 = m * r2**2 + h * c2 + I
    m22 = m * r2**2 + I
    g2 = m * r2 * g * np.cos(q.sum(axis=1))
    g1 = (m * r1 + m * l1) * g * np.cos(q[:, 0]) + g2
    tau1 = m11 * qdd[:, 0] + m12 * qdd[:, 1] - h * s2 * (2 * qd[:, 0] * qd[:, 1] + qd[:, 1] ** 2) + g1
    tau2 = m12 * qdd[:, 0] + m22 * qdd[:, 1] + h * s2 * qd[:, 0] ** 2 + g2
    return np.column_stack([tau1, tau2])


# -- the circle --------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("branch", "low", "high"),
    [("elbow_up", (71.868, 62.908), (168.285, 71.606)), ("elbow_down", (209.9, None), (242.1, None))],
)
def test_torques_of_the_circle(
    branch: str, low: tuple[float | None, ...], high: tuple[float | None, ...]
) -> None:
    tau = ran("2r_circle", f"trajectory.ik.branch={branch}")["tau"]
    assert tau.shape == (1001, 2)
    for k in range(2):
        for found, expected in ((tau[:, k].min(), low[k]), (tau[:, k].max(), high[k])):
            if expected is not None:
                tolerance = 6e-4 if branch == "elbow_up" else 1.5
                assert found == pytest.approx(expected, abs=tolerance)


def test_torques_of_the_circle_in_closed_form() -> None:
    result = ran("2r_circle")
    by_hand = planar_2r(result["q"], result["qd"], result["qdd"])
    np.testing.assert_allclose(result["tau"], by_hand, rtol=0, atol=1e-11)


def test_terms_of_the_circle() -> None:
    result = ran("2r_circle")
    terms = {name: item.data for name, item in result.group("torque_terms").items()}
    assert set(terms) == {"inertia", "coriolis", "gravity"}
    np.testing.assert_allclose(sum(terms.values()), result["tau"], rtol=0, atol=1e-12)
    rest = np.zeros_like(result["q"])
    np.testing.assert_allclose(terms["gravity"], planar_2r(result["q"], rest, rest), rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        terms["coriolis"], planar_2r(result["q"], result["qd"], rest) - terms["gravity"], rtol=0, atol=1e-11
    )


def test_the_tip_stays_on_the_circle() -> None:
    result = ran("2r_circle")
    tip = result["points/tip"]
    np.testing.assert_allclose(np.hypot(tip[:, 0] - 1.2, tip[:, 1] - 1.2), 0.2, rtol=0, atol=1e-14)
    q = result["q"]
    by_hand = np.column_stack(
        [np.cos(q[:, 0]) + np.cos(q.sum(axis=1)), np.sin(q[:, 0]) + np.sin(q.sum(axis=1))]
    )
    np.testing.assert_allclose(tip[:, :2], by_hand, rtol=0, atol=1e-14)


def test_rates_of_the_circle_are_derivatives() -> None:
    result = ran("2r_circle")
    h = float(result.time[1])
    for path, rate in (("q", "qd"), ("qd", "qdd")):
        x = result[path]
        slope = (8 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12 * h)
        np.testing.assert_allclose(slope, result[rate][2:-2], rtol=0, atol=1e-7)


# -- the arms ----------------------------------------------------------------------------------------------
def test_what_the_arms_show() -> None:
    plane, weightless = ran("arm_in_plane"), ran("arm_weightless")
    assert "torque_terms/gravity" in plane and "torque_terms/gravity" not in weightless
    np.testing.assert_allclose(
        plane["tau"] - plane["torque_terms/gravity"], weightless["tau"], rtol=0, atol=1e-12
    )


def test_seven_joints_have_all_terms() -> None:
    result = ran("seven_joint_arm")
    assert {"inertia", "coriolis", "gravity", "friction"} <= set(result.group("torque_terms"))
    assert result["tau"].shape == (1001, 7) and result.summary["round_trip"] < 1e-12


# -- all of them -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_scene_states_its_error(path: Path) -> None:
    try:
        summary = ran(path.stem).summary
    except RobodynError as error:
        assert error.exit_code == 4 and path.stem == "parallelogram"
        return
    estimate = summary["error_estimate"]
    if summary.get("integrator"):
        assert 0.0 < estimate["state_max"] < 1e-6 and summary["energy_drift"] < 1e-6
    else:
        assert estimate["round_trip"] < 1e-12


@pytest.mark.parametrize("name", ["2r_circle", "double_pendulum", "four_bar_deploy"])
def test_runs_repeat_to_the_last_bit(name: str) -> None:
    first, second = ran(name), ran(name, "title=again")
    for path in first.variables:
        assert np.array_equal(first[path], second[path], equal_nan=True), path
