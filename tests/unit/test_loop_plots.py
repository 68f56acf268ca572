"""Pictures of the loop of a controller: what they explain, and that nothing that they are about lies beyond their edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli.report.registry import draw
from robodyn_cli.works.linearise.linearise import linearise
from tests.unit.test_control import ARM, CART, NAMES, made

STEP = "reference: {type: joint, duration: 1, q: {x: '0.2'}}"
LAWS = {
    "pd": "{type: pd, gains: {kp: 160, kd: 9}",
    "pid": "{type: pid, gains: {kp: 160, ki: 40, kd: 9}",
    "late pid": "{type: pid, period: 0.02, delay: 0.05, gains: {kp: 160, ki: 400, kd: 9}",
    "unstable": "{type: pd, period: 0.2, delay: 0.3, gains: {kp: 160, kd: 9}",
}


def texts(figure: Any) -> str:
    boxes = [text for box in figure.legends for text in (box.get_title(), *box.get_texts())]
    return "\n".join(text.get_text() for text in (*boxes, *figure.texts))


@pytest.mark.parametrize("law", LAWS)
def test_loop_pictures_of_one_joint(law: str) -> None:
    result = linearise(made(f"{CART}control: {LAWS[law]}, {STEP}}}\n"))
    peak = result.summary["loop"]["x"]["sensitivity_peak"]

    figure = draw(result, "nyquist")
    (ax,), told = figure.axes, texts(figure)
    assert "dotted: |L| = 1" in told and ("not stable" in told) == (peak is None)
    circles = [line for line in ax.lines if line.get_linewidth() == 0.7 and len(line.get_xdata()) == 361]
    assert len(circles) == (peak is not None and peak > 1.0) == ("1 / largest sensitivity" in told)
    for line in circles:  # it touches the loop, and the loop nowhere comes nearer to -1
        radius = np.abs(np.asarray(line.get_xdata()) + 1.0 + 1j * np.asarray(line.get_ydata()))
        loop = result["loop/response_real"] + 1j * result["loop/response_imaginary"]
        assert radius == pytest.approx(1.0 / peak)
        assert np.abs(loop + 1.0).min() == pytest.approx(1.0 / peak, rel=1e-3)

    (ax,) = draw(result, "nichols").axes
    dotted = np.concatenate([line.get_xdata() for line in ax.lines if line.get_linestyle() == ":"])
    low, high = ax.get_xlim()
    assert low < dotted.min() and dotted.max() < high and np.ptp(dotted) > 120.0

    axes = draw(result, "poles").axes
    assert len(axes) == 1 + ("period" in LAWS[law])
    for ax, group in ((axes[0], "linear"), (axes[-1], "loop")):
        marks = [np.asarray(line.get_data()).T for line in ax.lines if line.get_marker() == "x"]
        found = np.column_stack([result[f"{group}/poles_{part}"] for part in ("real", "imaginary")])
        assert any(mark.shape == found.shape and np.array_equal(mark, found) for mark in marks)
        (low, high), (bottom, top) = ax.get_xlim(), ax.get_ylim()
        assert np.all(
            (low < found[:, 0]) & (found[:, 0] < high) & (bottom < found[:, 1]) & (found[:, 1] < top)
        )

    assert "of the plant alone" in texts(draw(result, "frequency_response"))
    figure = draw(result, "singular_loop")
    above, below = figure.axes
    assert "smallest" not in texts(figure) and "largest" not in texts(figure)
    w, top = result["loop/frequency"], result["loop/sensitivity"].max()
    left, right = below.get_xlim()
    assert left <= w[np.argmax(result["loop/sensitivity"])] <= right
    assert below.get_yscale() == "linear" and top < below.get_ylim()[1] < 1.3 * max(top, 1.0)
    assert above.get_ylim()[1] <= 1.5e4


def test_loop_pictures_of_many_joints() -> None:
    rest = ", ".join(f"{name}: 0.1" for name in NAMES)
    text = f"{ARM}control: {{type: pd, gains: {{kp: 900, kd: 60}}}}\ninitial: {{q: {{{rest}}}}}\n"
    result = linearise(made(text))
    names = list(result.summary["loop"])
    assert "6 of 7 drawn" in texts(draw(result, "nyquist")) and "6 of 7 drawn" in texts(
        draw(result, "nichols")
    )
    assert all(f"{name}: " in texts(draw(result, "nyquist")) for name in names[:6])
    assert "largest and smallest" in texts(draw(result, "singular_loop"))
