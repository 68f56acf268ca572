"""What a sampled controller sees, against noise, rounding and differences worked out beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import simulate
from robodyn_cli.report.overlay import common_plots, draw_over
from robodyn_cli.results.hdf5 import read, write
from robodyn_cli.scene import load_scene_text
from robodyn_cli.scene.checks.columns import column_names
from tests.unit.test_control import ARM, MOTION, NAMES, arm, cart, made

T, STEPS = 0.01, 4  # samples of the run in a period
FREE = ARM.replace("name: a, type: revolute, axis: [0.1, 0.2, 1]", "name: a, type: spherical")


def seen_of(result, sensors: dict, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and rates as they are seen at the samples of the law, of joints of one coordinate."""
    q, qd = result["q"][::STEPS], result["qd"][::STEPS]
    n = q.shape[1]
    normal = np.random.Generator(np.random.Philox(seed)).standard_normal((len(q) + 1, 2 * n))[: len(q)]
    q = q + sensors.get("noise", 0.0) * normal[:, :n]
    if step := sensors.get("resolution"):
        q = step * np.round(q / step)
    if sensors.get("rates") == "differences":
        return q, np.diff(q, axis=0, prepend=q[:1]) / T
    return q, qd + sensors.get("rate_noise", 0.0) * normal[:, n:]


@pytest.mark.parametrize(
    "sensors",
    [
        {"noise": 2e-3},
        {"rate_noise": 0.05, "resolution": 1e-3},
        {"resolution": 2e-4, "noise": 1e-3, "rates": "differences"},
        {"rates": "differences"},
    ],
)
@pytest.mark.parametrize("delay", [0.0, 0.013])
def test_measured_signals_are_what_sensors_give_up_to_the_next_sample(sensors: dict, delay: float) -> None:
    keys = ", ".join(f"{key}: {value}" for key, value in sensors.items())
    law = f"{{type: pd, period: {T}, delay: {delay}, sensors: {{{keys}, seed: 7}}, gains: {{kp: 9, kd: 1}}, reference: {MOTION}}}"
    result = simulate(made(arm(law, 0.2).text, f"simulate.samples={20 * STEPS + 1}"))
    q, v = seen_of(result, sensors, 7)
    for path, true in (("control/measured", q), ("control/measured_rates", v)):
        held = np.repeat(true, STEPS, axis=0)[: len(result.time)]
        assert result.variables[path].names == NAMES
        assert np.abs(result[path] - held).max() < 1e-9
    assert result.variables["control/measured_rates"].column_units[2] == "m/s"


def test_attitudes_are_seen_as_they_are_and_exact_sensors_keep_nothing() -> None:
    law = f"{{type: pd, joints: [b, d], period: {T}, sensors: {{noise: 1e-3}}, gains: {{kp: 9, kd: 1}}}}"
    start = (
        "initial: {q: {a: {rotation_vector: [0.1, 0.2, 0]}, "
        + ", ".join(f"{name}: 0.1" for name in NAMES[1:])
        + "}}"
    )
    text = f"{FREE}{start}\ncontrol: {law}\nsimulate: {{duration: 0.05, samples: 6}}\n"
    seen = simulate(load_scene_text(text))
    q, names = seen["q"], seen.variables["q"].names
    assert seen.variables["control/measured"].names == names and len(names) == len(NAMES) + 3
    attitude = [k for k, name in enumerate(names) if name.startswith("a.")]
    off = np.abs(seen["control/measured"] - q)
    assert off[:, attitude].max() < 1e-9 and off[:, len(attitude) :].min(axis=0).min() > 0.0
    exact = simulate(made(text, "control.sensors=null"))
    assert "control/measured" not in exact
    assert "control/measured.b" in column_names(load_scene_text(text), ())
    assert "control/measured.b" not in column_names(made(text, "control.sensors=null"), ())


def test_runs_of_versions_without_measured_signals_are_gone_on_from(tmp_path: Path) -> None:
    """They stored positions as ``last``, for differences alone."""
    keys = f"period: {T}, delay: 0.013, gains: {{kp: 60, kd: 2, ki: 30}}"
    whole = cart(f"{{type: pid, {keys}, sensors: {{noise: 0.002, rates: differences}}}}", 1.0, 101)
    first = simulate(whole)
    stored = simulate(made(whole.text, "simulate.duration=0.5", "simulate.samples=51"))
    states = stored.variables["control/states"]
    old = [(k, name) for k, name in enumerate(states.names) if not name.startswith("measured_rates")]
    names = tuple(name.replace("measured.", "last.") for _, name in old)
    stored.add("control/states", states.data[:, [k for k, _ in old]], names=names, dims=states.dims)
    write(stored, tmp_path / "result.h5")
    assert "last.x" in read(tmp_path / "result.h5").variables["control/states"].names
    rest = simulate(made(whole.text, f"initial.from={tmp_path}"))
    assert np.abs(rest["q"] - first["q"][50:]).max() < 1e-12
    assert any("what the sensors gave last" in note for note in rest.summary["warnings"])
    exact = simulate(made(whole.text, f"initial.from={tmp_path}", "control.sensors=null"))
    assert "control/measured" not in exact


def test_tracking_of_several_results_is_drawn_in_one_picture() -> None:
    law = f"{{type: pd, period: {T}, gains: {{kp: 60, kd: 4}}, reference: {{type: joint, duration: 1, q: {{x: '0.3'}}}}"
    results = {
        label: simulate(cart(f"{law}{more}}}", 0.3, 31))
        for label, more in (("exact", ""), ("noisy", ", sensors: {noise: 1e-2}"))
    }
    assert "tracking" in common_plots(list(results.values()))
    figure = draw_over(results, "tracking")
    for line, result in zip(figure.axes[0].lines, results.values()):
        assert np.abs(np.asarray(line.get_ydata()) - result["control/error"][:, 0]).max() == 0.0
    assert any("largest error of q" in text.get_text() for text in figure.texts)
