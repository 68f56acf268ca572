"""Formats of figures: their width, their fonts, and headings that go into the metadata."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from robodyn_cli.cli.app import run
from robodyn_cli.report import draw_all
from robodyn_cli.report.format import FORMATS
from robodyn_cli.report.registry import PLOTS, Drawings, applicable
from robodyn_cli.report.style import styled
from robodyn_cli.results.hdf5 import write
from robodyn_cli.results.result import Result
from tests.unit.synthetic_results import chain_result, four_bar_result, inverse_result


@pytest.mark.parametrize("result", [inverse_result(), four_bar_result(), chain_result(7, 51)])
@pytest.mark.parametrize("width", [2.5, 3.5, 12.0])
def test_figures_are_as_wide_as_asked_for(result: Result, width: float, tmp_path: Path) -> None:
    for path in draw_all(result, tmp_path, Drawings(width=width)):
        assert Image.open(path).size[0] == round(120 * width), path.name


def test_all_that_stands_beside_panels_stays_on_the_page() -> None:
    """Legends wrap, and words that stay without titles do, too."""
    result = four_bar_result()
    result.status = "failed"
    result.summary["termination"] = {"reason": "the constraints cannot be met at this pose " * 3, "time": 1.0}
    for name in applicable(result):
        with styled(FORMATS["paper"]):
            figure = PLOTS[name].draw(result)
            canvas: Any = FigureCanvasAgg(figure)
            edge = figure.bbox.width
            seen = [*figure.legends, *(text for text in figure.texts if text.get_visible())]
            assert any("Run failed" in text.get_text() for text in figure.texts if text.get_visible())
            assert all(one.get_window_extent(canvas.get_renderer()).x1 < 1.03 * edge for one in seen), name


def test_a_heading_that_is_left_out_is_in_the_metadata(tmp_path: Path) -> None:
    result = inverse_result()
    result.title = "Arm: Ärmel"
    path = draw_all(result, tmp_path, Drawings(("torques",), no_titles=True))[0]
    words = Image.open(path).text  # type: ignore[attr-defined]
    assert words["Title"] == "Arm: Ärmel" and "torques" in words["Description"]
    low = Image.open(path).size[1]
    assert low < Image.open(draw_all(result, tmp_path, Drawings(("torques",)))[0]).size[1]


def test_fonts_are_embedded_as_truetype(tmp_path: Path) -> None:
    path = draw_all(inverse_result(), tmp_path, Drawings(("torques",), "pdf", "paper"))[0]
    content = path.read_bytes()
    assert b"/FontFile2" in content and b"/Type3" not in content


@pytest.mark.parametrize(
    ("words", "inches"), [("3.5in", 3.5), ("89mm", 89 / 25.4), ("8.9 cm", 8.9 / 2.54), ("252pt", 3.5)]
)
def test_widths_in_units(words: str, inches: float, tmp_path: Path) -> None:
    stored = write(inverse_result(), tmp_path / "r.h5")
    assert (
        run(["plot", str(stored), "--width", words, "--plots", "torques", "--out", str(tmp_path), "-q"]) == 0
    )
    assert Image.open(tmp_path / "torques.png").size[0] == int(120 * inches)


@pytest.mark.parametrize("words", ["3.5", "1in", "30in", "wide", "-4in", "nan in"])
def test_other_widths_are_refused(words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stored = write(inverse_result(), tmp_path / "r.h5")
    assert run(["plot", str(stored), f"--width={words}", "--out", str(tmp_path / "p")]) == 2
    assert "allowed: 2.5 to 20 in" in capsys.readouterr().err.replace("\n", " ")
    assert not (tmp_path / "p").exists()
