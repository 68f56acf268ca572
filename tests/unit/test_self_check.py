"""A run checks itself: energy out of balance, and accuracy that was asked for and missed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robodyn_cli import Mechanism, load_scene, load_scene_text, simulate
from robodyn_cli.errors import NumericalError
from robodyn_cli.motion import self_check
from tests.cli.tool import run
from tests.mechanisms import CONFIGS

PENDULUM = CONFIGS / "double_pendulum.yaml"
QUIET = ["simulate.error_estimate=false"]


def test_energy_that_no_tolerance_explains_ends_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tolerances of a run are taken away from the judge, not from the run: what remains is a true drift."""
    scene = load_scene(PENDULUM, [*QUIET, "simulate.rtol=1e-4", "simulate.atol=1e-4"])
    assert simulate(scene).status == "ok"
    monkeypatch.setattr(self_check, "BEYOND", 1e-9)
    with pytest.raises(NumericalError, match="balance of energy is lost from t = ") as caught:
        simulate(scene)
    assert caught.value.exit_code == 3
    assert 0.0 < caught.value.details["time"] < 10.0
    assert caught.value.result is not None and caught.value.result.status == "failed"


@pytest.mark.parametrize("method", ["gauss", "dop853", "dopri5", "rodas5p", "radau", "bdf"])
@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9])
def test_a_motion_within_its_tolerance_is_no_failure(method: str, rtol: float) -> None:
    options = [f"simulate.integrator={method}", f"simulate.rtol={rtol}", f"simulate.atol={rtol}"]
    found = simulate(load_scene(CONFIGS / "four_bar_deploy.yaml", [*QUIET, *options, "simulate.duration=5"]))
    assert found.status == "ok"


def test_a_fixed_step_that_loses_energy_is_a_warning() -> None:
    options = ["simulate.integrator=rk4", "simulate.step=0.2"]
    found = simulate(load_scene(PENDULUM, [*QUIET, *options]))
    assert found.status == "ok"
    (warning,) = [text for text in found.summary["warnings"] if "energy" in text]
    assert "lost from t = " in warning


def test_an_error_beyond_all_use_is_a_warning_and_an_error_where_asked(tmp_path) -> None:  # type: ignore[no-untyped-def]
    options = [
        "--set",
        "simulate.integrator=rk4",
        "--set",
        "simulate.step=0.2",
        "--no-plots",
        "--out",
        str(tmp_path),
    ]
    plain = run("simulate", str(PENDULUM), *options)
    assert plain.code == 0 and "not meaningful after t = " in plain.err
    strict = run("simulate", str(PENDULUM), *options, "--strict")
    assert "results: " in strict.err and "until then" not in strict.err
    assert strict.code == 3 and "taken as an error: --strict" in strict.err


def test_strict_tells_all_warnings(tmp_path) -> None:  # type: ignore[no-untyped-def]
    limits = [f"--set=robot.joints.{joint}.limits.effort=1" for joint in ("theta1", "theta2")]
    words = [
        "inverse",
        str(CONFIGS / "2r_circle.yaml"),
        *limits,
        "--no-plots",
        "--out",
        str(tmp_path),
        "--strict",
    ]
    done = run(*words, "--json")
    assert done.code == 3
    for joint in ("theta1", "theta2"):
        assert f"joint '{joint}' is beyond its effort limit" in done.data["error"]["message"], done.data
    assert done.data["error"]["kind"] == "StrictError" and done.data["joints"]


SWING = """
schema: 1
command: simulate
gravity: [0, -9.81, 0]
robot:
  joints: [{name: swing, type: revolute, axis: [0, 0, 1]}]
  links: [{name: rod, mass: 2.0, com: [0.5, 0, 0], inertia: {zz: 0.1}}]
initial: {q: {swing: -20 deg}}
simulate: {duration: 1, samples: 2, integrator: dop853, rtol: 1e-5, atol: 1e-5, error_estimate: false}
"""


def test_runs_that_are_back_at_their_start_are_judged_along_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a whole period nothing is exchanged between start and end, while the tolerance explains a drift."""
    a, b = 1.0, math.cos(math.radians(70.0) / 2.0)  # the period by the arithmetic-geometric mean
    for _ in range(6):
        a, b = (a + b) / 2.0, math.sqrt(a * b)
    period = 2.0 * math.pi / a * math.sqrt((0.1 + 2.0 * 0.25) / (2.0 * 9.81 * 0.5))
    mechanism = Mechanism(load_scene_text(SWING), ["simulate.duration"])
    ends = period * np.array([[0.5], [1.0], [1.0 + 1e-7], [2.0], [3.0]])
    found = mechanism.simulate_many(ends)
    assert found.ok.all() and not found.one_by_one.any()
    np.testing.assert_allclose(found.q[1:, 0], math.radians(-20.0), atol=1e-3)
    monkeypatch.setattr(self_check, "BEYOND", 1e-9)
    assert (mechanism.simulate_many(ends).code == 3).all()
