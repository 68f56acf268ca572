"""Captions of pictures state the figures of the summary, which knows what lies between samples, or say that they are of
the samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli.report import draw
from robodyn_cli.report.figures import errors
from robodyn_cli.results.result import Result
from tests.unit.synthetic_results import chain_result, four_bar_result


def words(result: Result, name: str) -> str:
    """Return all that is written around a picture, in one line."""
    figure = draw(result, name)
    legends = [text for legend in figure.legends for text in legend.get_texts()]
    return " ".join(" ".join(text.get_text() for text in [*figure.texts, *legends]).split())


def loaded() -> Result:
    """A result with forces whose samples say 3 N and 5 N."""
    result = four_bar_result(101)
    for path, size in (("reactions/theta1", 3.0), ("loop_reactions/pin", 5.0)):
        data = size * np.sin(np.linspace(0.0, 3.0, 101))[:, None] ** 2 * np.eye(6)[0]
        names = ("fx", "fy", "fz", "mx", "my", "mz")
        result.add(path, data, units=("N",) * 3 + ("N m",) * 3, names=names)
    return result


def peak(force: float, error: float | None = 1e-9) -> dict[str, float | None]:
    return {"peak_force": force, "peak_moment": 0.0, "force_error": error, "moment_error": error}


def test_the_largest_force_is_that_of_the_summary() -> None:
    result = loaded()
    largest = {"theta1": peak(7.0), "pin": peak(5.25), "base_wrench": peak(99.0)}
    result.summary["reactions"] = {"largest": largest}
    assert "largest force 7.000000000 ± 1·10⁻⁹ N in theta1" in words(result, "reactions")
    largest["theta1"] = peak(7.0, None)
    assert "largest force 7 N in theta1" in words(result, "reactions")
    result.summary["after_lock"] = {"largest": {"theta1": peak(6.0), "pin": peak(8.0, 0.1)}}
    assert "largest force 8.0 ± 0.1 N in pin" in words(result, "reactions")


@pytest.mark.parametrize("largest", [None, {}, {"pin": peak(5.25)}])
def test_without_forces_in_the_summary_the_largest_one_is_of_the_samples(largest: Any) -> None:
    result = loaded()
    result.summary["reactions"] = {"largest": largest}
    assert "largest force of the samples 4.9" in words(result, "reactions")


def test_the_largest_multiplier_until_the_lock_is_that_of_the_summary() -> None:
    result = four_bar_result(101)
    assert "largest norm of the samples " in words(result, "multipliers")
    stated = {"rows": ["pin.x", "pin.y"], "largest_until_lock": 2000.0, "errors": {"largest_until_lock": 0.5}}
    result.summary["lock"]["multipliers"] = stated
    assert "largest norm until the lock 2000.0 ± 0.5 N" in words(result, "multipliers")
    stated["largest_until_lock"] = None
    assert "largest norm of the samples " in words(result, "multipliers")


def test_peaks_of_torques_are_of_the_samples_where_the_summary_has_none() -> None:
    result = chain_result(3)
    assert "figures of the samples" in words(result, "torques")
    result.summary["joints"] = {
        f"joint{k}": {"peak_torque": 100.0 + k, "rms_torque": 50.0} for k in (1, 2, 3)
    }
    said = words(result, "torques")
    assert "samples" not in said and "joint3: peak" in said and "103" in said


def test_the_transmission_angle_goes_as_far_as_the_summary_says() -> None:
    result = four_bar_result(101)
    result.add("transmission_angle", np.linspace(1.0, 2.0, 101), units="rad")
    assert "Transmission angle of the samples: from 57.3 to 114.6 deg" in words(result, "transmission_angle")
    errors = {"smallest_deg": 0.01, "largest_deg": 0.1}
    result.summary["transmission_angle"] = {"smallest_deg": 50.0, "largest_deg": 120.0, "errors": errors}
    assert "Transmission angle: from 50.00 ± 0.01 to 120.0 ± 0.1 deg" in words(result, "transmission_angle")
    errors["largest_deg"] = 1e-9
    assert "to 120.000000000 ± 1·10⁻⁹ deg" in words(result, "transmission_angle")


@pytest.mark.parametrize("stated", [True, False])
def test_the_largest_tracking_error_is_that_of_the_summary(stated: bool) -> None:
    result = chain_result(1)
    q = result["q"]
    for path in ("error", "reference", "torque"):
        units = "N m" if path == "torque" else "rad"
        result.add(f"control/{path}", 0.01 * q if path == "error" else q, units=units, names=("joint1",))
    tracking = {"joint1": {"peak": 0.02, "errors": {"peak": 0.001}}}
    result.summary["control"] = {"tracking": tracking} if stated else {}
    said = words(result, "tracking")
    assert ("error up to 0.021 rad" in said) == stated
    assert ("rad at the samples" in said) != stated


def test_pictures_name_the_unit_of_an_error_as_the_terminal_does() -> None:
    result = loaded()
    result.add("qd", result["q"], units="rad/s", names=result.variables["q"].names)
    result.summary["error_estimate"] = {"state_max": 2e-9}
    assert errors(result, all_of_them=True) == ["largest error of the state 2e-09 rad, rad/s"]
    for name in ("multipliers", "reactions"):
        assert "largest error of the state 2·10⁻⁹ rad, rad/s" in words(result, name)
        assert " or " not in words(result, name)
