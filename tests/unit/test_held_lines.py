"""Lines through samples of what a sampled controller holds, against what it holds in between."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import simulate
from robodyn_cli.report.overlay import draw_over
from robodyn_cli.report.registry import draw
from robodyn_cli.results.export import to_xarray
from robodyn_cli.results.hdf5 import read, write
from robodyn_cli.results.held import NOT_HELD, HeldColumns
from tests.unit.test_control import CART, made
from tests.unit.test_control_held import DRIVEN

PERIOD, LATE = 0.01, 0.003  # of DRIVEN: its delay is one period and this


@pytest.mark.parametrize("seed", range(8))
def test_lines_have_the_values_that_samples_show(seed: int) -> None:
    """Between two samples: the first until the next update, the last from the last update on, between them if several."""
    rng = np.random.default_rng(seed)
    period, offset = rng.uniform(0.03, 0.4), rng.uniform()
    held = HeldColumns(period, (NOT_HELD, offset * period))
    t, values = np.sort(rng.uniform(0.0, 2.0, rng.integers(2, 40))), rng.choice([-1.0, 0.5, 0.5, 3.0], 80)

    def number(at: Any) -> Any:
        return np.floor((at - offset * period) / period + 1e-9).astype(int) + 1

    y = values[number(t)]
    x, line = held.line(t, y, 1)
    assert np.all(np.diff(x) >= 0.0) and (x[0], x[-1]) == (t[0], t[-1])
    for at in np.linspace(t[0], t[-1], 57):
        k = min(np.searchsorted(t, at, side="right") - 1, len(t) - 2)
        if min(abs((at / period - offset + 0.5) % 1.0 - 0.5), *abs(t - at)) < 1e-6:
            continue
        seen = {number(t[k]): y[k], number(t[k + 1]): y[k + 1]}
        found = np.interp(at, x, line)
        if number(at) in seen:
            assert found == pytest.approx(seen[number(at)])
        else:
            assert min(y[k], y[k + 1]) - 1e-12 <= found <= max(y[k], y[k + 1]) + 1e-12
    assert held.hides(t, 1) == bool(np.any(np.diff(number(t)) > 1))
    assert held.line(t, y, 0)[1] is y and not held.hides(t, 0)


def drawn(figure: Any, samples: int) -> list[tuple[Any, Any]]:
    """Return the lines of a figure that are no level and no marks."""
    lines = [np.asarray(line.get_data(), dtype=float) for ax in figure.axes for line in ax.lines]
    return [(x, y) for x, y in lines if len(x) > samples]


def test_plots_draw_held_torques_as_steps_at_their_updates(tmp_path: Path) -> None:
    """Also those of stored results and several over one another; samples lie beside the updates."""
    signal = "outputs: {signals: {twice: {value: 2*tau.theta2, unit: N m}, power: tau.theta2*qd.theta2}}\n"
    few, many = (simulate(made(DRIVEN + signal, f"simulate.samples={n}")) for n in (54, 4001))
    back = read(write(few, tmp_path / "result.h5"))
    offsets = {
        "tau": (LATE, LATE),
        "control/torque": (LATE, LATE),
        "control/states": (LATE, LATE, 0.0, 0.0, 0.0, 0.0),
        "signals/twice": (LATE,),
    }
    for result in (few, back):
        held = {path: x.held for path, x in result.variables.items() if x.held is not None}
        assert held.keys() == offsets.keys()
        for path, one in held.items():
            assert one.period == PERIOD and one.offset == pytest.approx(offsets[path])
    assert to_xarray(back)["tau"].attrs["held_period"] == PERIOD
    between = np.abs((many.time - LATE) / PERIOD % 1.0 - 0.5) < 0.49
    for figure in (
        draw(back, "torques"),
        draw(back, "tracking"),
        draw_over({"a": few, "b": back}, "torques"),
    ):
        lines = drawn(figure, 55)
        assert len(lines) == (4 if len(figure.axes) == 2 and figure.axes[0].get_title(loc="left") else 2)
        for k, (x, y) in enumerate(lines):
            true = many["tau"][:, k * 2 // len(lines)]
            assert np.abs(np.interp(many.time, x, y) - true)[between].max() < 1e-6 * np.abs(true).max()


def test_samples_that_miss_held_torques_are_told() -> None:
    for samples, told in ((41, False), (21, True)):
        figure = draw(simulate(made(DRIVEN, f"simulate.samples={samples}")), "torques")
        assert told == any("(simulate.samples)" in text.get_text() for text in figure.texts)


def test_tracking_draws_what_the_sensors_held_and_limits_on_either_side() -> None:
    limits = "damper: {damping: 0.6}, limits: {effort: [-3, 8]}"
    law = "{type: pd, period: 0.1, sensors: {resolution: 0.01}, gains: {kp: 160, kd: 9}, reference: {type: joint, duration: 1, q: {x: 0.5*t}}}"
    text = (
        CART.replace("damper: {damping: 0.6}", limits)
        + f"control: {law}\nsimulate: {{duration: 1, samples: 31}}\n"
    )
    result = simulate(made(text))
    _, error, torque = draw(result, "tracking").axes
    levels = {float(line.get_ydata()[0]) for line in torque.lines if len(line.get_xdata()) == 2}
    assert levels == {-3.0, 8.0}
    (grey,) = [line for line in error.lines if line.get_linewidth() == 0.6 and line.get_alpha() == 0.6]
    x, y = (np.asarray(part) for part in grey.get_data())
    inside = np.linspace(0.301, 0.399, 9)  # one measurement, that at 0.3 s, while the reference goes on
    seen = result["control/measured"][9, 0]
    assert result.time[9] == pytest.approx(0.3)
    np.testing.assert_allclose(np.interp(inside, x, y), 0.5 * inside - seen, atol=1e-12)
