"""Many columns: rows on scales of their own, in which each motion is seen."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli.report import draw
from robodyn_cli.report.style import MANY
from robodyn_cli.results.result import Result


def _result(path: str, data: Any, names: tuple[str, ...] | None = None) -> Result:
    result = Result("simulate", "", "ok", "")
    result.add("time", np.linspace(0.0, 1.0, len(data)))
    units = {"q": "rad", "qd": "rad/s"}[path]
    names = names or tuple(f"joint{k}" for k in range(data.shape[1]))
    result.add(path, data, names=names, units=units)
    return result


def _image(figure: Any) -> Any:
    return np.asarray(figure.axes[0].images[0].get_array())


@pytest.mark.parametrize("seed", range(3))
def test_each_row_fills_its_scale_and_states_it(seed: int) -> None:
    """Columns of sizes from 1e-3 to 1e3 with offsets: the change of each is seen, and its size is beside it."""
    rng = np.random.default_rng(seed)
    count, t = MANY + int(rng.integers(1, 20)), np.linspace(0.0, 1.0, 101)[:, None]
    size = 10.0 ** rng.uniform(-3.0, 3.0, count)
    q = 50.0 * rng.standard_normal(count) + size * np.sin(2.0 * np.pi * t * rng.uniform(1.0, 4.0, count))
    figure = draw(_result("q", q), "joint_angles")
    image = _image(figure)
    assert np.allclose(np.abs(image).max(axis=1), 1.0) and np.allclose(image[:, 0], 0.0)
    written = [float(note.get_text().replace("·10", "e").translate(RAISED)) for note in figure.axes[0].texts]
    assert np.allclose(written, np.abs(q - q[0]).max(axis=0), rtol=0.06)
    names = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert names == [f"joint{k}" for k in range(count)]


RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")


def test_rates_are_about_zero_and_rounding_is_nothing() -> None:
    rng = np.random.default_rng(0)
    data = rng.standard_normal((51, 30)) + 2.0
    data[:, 3] *= 1e-17
    figure = draw(_result("qd", data), "joint_rates")
    image = _image(figure)
    assert not image[3].any() and figure.axes[0].texts[3].get_text() == "0"
    kept = [k for k in range(30) if k != 3]
    assert np.allclose(image[kept], (data / np.abs(data).max(axis=0)).T[kept])


def test_long_names_are_cut_at_their_end_and_stay_on_the_page() -> None:
    names = tuple(f"a_very_long_name_of_a_joint_on_one_side_{k}" for k in range(30))
    figure = draw(_result("q", np.random.default_rng(0).random((20, 30)), names), "joint_angles")
    figure.canvas.draw()
    labels = figure.axes[0].get_yticklabels()
    assert all(label.get_text() == "a_very_long_name_of_a_joint_o…" for label in labels)
    assert min(label.get_window_extent().x0 for label in labels) >= 0.0
