"""Charts of a page: zoom into a span of time, lines hidden by the legend, and files of what is seen."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from robodyn_cli.report.page.page import Shown, write_page
from robodyn_cli.results.result import Result
from tests.browser.conftest import Opener
from tests.browser.test_page import four_bar
from tests.unit.synthetic_results import chain_result, inverse_result

PRESSED = "aria-pressed"


def page_of(opened: Opener, result: Result, folder: Path, **options: Any) -> Any:
    """Open the page of a result whose poses are left out: its scene is none."""
    result.variables.pop("q", None)
    write_page([Shown(result.command, result)], folder / "page.html")
    return opened(folder / "page.html", **options)


@pytest.fixture(scope="module")
def planar(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    result, target = four_bar(), tmp_path_factory.mktemp("charts") / "four_bar.html"
    write_page([Shown("deploy", result)], target)
    return result, target


def plot_of(page: Any, name: str) -> Any:
    """Return a plot by its heading, drawn."""
    plot = page.locator("figure.plot").filter(has=page.get_by_role("heading", name=name, exact=True))
    plot.scroll_into_view_if_needed()
    plot.locator(".chart .frame").first.wait_for()
    return plot


def frame_of(plot: Any) -> tuple[float, float, float, float]:
    """Return the left, right, top and bottom [px] of the first panel on the screen."""
    left, top, bottom, right = map(
        float, re.findall(r"-?[\d.]+", plot.locator(".frame").first.get_attribute("d"))
    )
    box = plot.locator(".chart > svg").first.bounding_box()
    return box["x"] + left, box["x"] + right, box["y"] + top, box["y"] + bottom


def drag(page: Any, plot: Any, first: float, last: float) -> None:
    """Drag from one part of the first panel's width to another."""
    plot.locator(".chart").scroll_into_view_if_needed()
    left, right, top, bottom = frame_of(plot)
    page.mouse.move(left + first * (right - left), 0.5 * (top + bottom))
    page.mouse.down()
    page.mouse.move(left + 0.5 * (first + last) * (right - left), 0.5 * (top + bottom))
    page.mouse.move(left + last * (right - left), 0.5 * (top + bottom))
    page.mouse.up()


def across(plot: Any) -> list[float]:
    """Return the numbers below the first panel."""
    words = plot.locator(".chart text[text-anchor=middle]").all_text_contents()
    return [float(word.replace("−", "-")) for word in words if re.fullmatch(r"[−\d.]+", word)]


def saved(page: Any, plot: Any, kind: str) -> bytes:
    with page.expect_download() as download:
        plot.get_by_role("button", name=f"as {kind}").click()
    assert download.value.suggested_filename.endswith(f".{kind.lower()}")
    return Path(download.value.path()).read_bytes()


def table(content: bytes) -> tuple[list[str], np.ndarray]:
    heads, *rows = csv.reader(io.StringIO(content.decode()))
    return heads, np.array([[float(x or "nan") for x in row] for row in rows])


def test_a_drag_zooms_all_charts_of_a_result(planar: tuple[Result, Path], opened: Opener) -> None:
    result, target = planar
    page = opened(target)
    angles = plot_of(page, "Joint angles")
    end = float(result.time[-1])
    drag(page, angles, 0.25, 0.5)
    assert page.locator(".time").input_value() == "0", "a drag that zooms leaves the cursor"
    seen = [float(x) for x in re.findall(r"[\d.]+", angles.locator(".span").inner_text())]
    assert seen == pytest.approx([0.25 * end, 0.5 * end], abs=0.02 * end)
    for name in ("Joint angles", "Singular values"):
        numbers = across(plot_of(page, name))
        assert len(numbers) >= 3 and seen[0] - 0.01 <= min(numbers) and max(numbers) <= seen[1] + 0.01, name
    # upright the curves fill the panel
    path = angles.locator(".chart g[clip-path] path").first
    assert path.evaluate("p => p.getBBox().height") > 0
    # keys: in again, along, out, and all of it
    box = angles.locator(".chart")
    box.press("+")
    inner = [float(x) for x in re.findall(r"[\d.]+", angles.locator(".span").inner_text())]
    assert inner[1] - inner[0] == pytest.approx(0.5 * (seen[1] - seen[0]), rel=0.02)
    box.press("Shift+ArrowRight")
    moved = [float(x) for x in re.findall(r"[\d.]+", angles.locator(".span").inner_text())]
    assert moved[0] - inner[0] == pytest.approx(0.2 * (inner[1] - inner[0]), rel=0.05)
    box.press("End")
    shown = float(re.findall(r"[\d.]+", page.locator(".clock").inner_text())[0])
    assert shown == pytest.approx(moved[1], abs=0.02)
    box.press("ArrowLeft")
    assert float(re.findall(r"[\d.]+", page.locator(".clock").inner_text())[0]) < shown
    box.press("0")
    assert angles.locator(".span").inner_text() == "" and max(across(angles)) > 0.7 * end
    assert not angles.get_by_role("button", name="See all of it").is_visible()
    drag(page, angles, 0.6, 0.9)
    angles.get_by_role("button", name="See all of it").click()
    assert max(across(angles)) > 0.7 * end


def test_the_legend_hides_lines_and_the_axis_follows(tmp_path: Path, opened: Opener) -> None:
    result = inverse_result()
    page = page_of(opened, result, tmp_path)
    torques = plot_of(page, "Torques")
    entries = torques.locator(".legend button[aria-pressed]")
    lines, numbers = torques.locator(".chart g path[fill=none]"), torques.locator(".chart text.end")
    before, written = lines.count(), numbers.all_text_contents()
    entries.nth(0).click()
    assert entries.nth(0).get_attribute(PRESSED) == "false" and lines.count() < before
    assert numbers.all_text_contents() != written
    entries.nth(0).press("Enter")
    assert lines.count() == before and numbers.all_text_contents() == written
    entries.nth(1).click(modifiers=["Shift"])
    assert [entry.get_attribute(PRESSED) for entry in entries.all()].count("true") == 1
    entries.nth(1).click(modifiers=["Shift"])
    assert lines.count() == before


def test_files_hold_what_is_seen(planar: tuple[Result, Path], opened: Opener) -> None:
    result, target = planar
    page = opened(target, color_scheme="dark")
    angles = plot_of(page, "Joint angles")
    angles.get_by_role("button", name="phi2").click()
    drag(page, angles, 0.25, 0.5)
    heads, rows = table(saved(page, angles, "CSV"))
    assert heads == ["time [s]", "theta1 [rad]", "phi1 [rad]"]
    assert 0.2 < rows[0, 0] / result.time[-1] < rows[-1, 0] / result.time[-1] < 0.52
    for k, column in ((1, 0), (2, 1)):
        there = np.isfinite(rows[:, k])
        at = np.searchsorted(result.time, rows[there, 0])
        assert np.array_equal(result.time[at], rows[there, 0]), "times keep all their digits"
        assert rows[there, k] == pytest.approx(result["q"][at, column], rel=1e-7)
    picture = saved(page, angles, "SVG").decode()
    root = ElementTree.fromstring(picture)
    words = ["".join(node.itertext()) for node in root.iter("{http://www.w3.org/2000/svg}text")]
    assert "theta1" in words and "phi2" not in words and f"{result.title}: Joint angles" in words
    assert "var(" not in picture and "color-mix" not in picture and "NaN" not in picture
    assert saved(page, angles, "PNG").startswith(b"\x89PNG")


def test_text_of_a_scene_is_no_formula_of_a_spreadsheet(tmp_path: Path, opened: Opener) -> None:
    result = chain_result(3)
    names = ("=1+1", 'a,"b"', "plain")
    for path in ("q", "qd", "qdd", "tau"):
        result.variables[path].names = names
    page = page_of(opened, result, tmp_path)
    heads, rows = table(saved(page, plot_of(page, "Joint rates"), "CSV"))
    assert heads[1:] == ["'=1+1 [rad/s]", 'a,"b" [rad/s]', "plain [rad/s]"] and len(rows) > 100


def test_a_result_without_a_drawing_has_a_cursor(tmp_path: Path, opened: Opener) -> None:
    result = inverse_result()
    page = page_of(opened, result, tmp_path)
    torques = plot_of(page, "Torques")
    left, right, top, bottom = frame_of(torques)
    page.mouse.click(left + 0.5 * (right - left), 0.5 * (top + bottom))
    half = 0.5 * (result.time[0] + result.time[-1])
    values = [float(x.replace("−", "-")) for x in torques.locator(".legend span").all_inner_texts()[:2]]
    exact = [np.interp(half, result.time, column) for column in result["tau"].T[:2]]
    assert values == pytest.approx(exact, rel=0.05)
    assert torques.locator(".cursor").first.get_attribute("visibility") == "visible"


@pytest.mark.parametrize(
    ("factor", "label", "largest"), [(1e-5, "joint rate [µrad/s]", 20.0), (1.0, "joint rate [rad/s]", 2.0)]
)
def test_axes_have_prefixes_of_units(
    factor: float, label: str, largest: float, tmp_path: Path, opened: Opener
) -> None:
    """Numbers, cursor and axis have the same unit; the table of a file keeps that of the result."""
    result = chain_result(3)
    result["qd"][:] *= factor
    page = page_of(opened, result, tmp_path)
    angles = plot_of(page, "Joint rates")
    assert label in angles.locator(".chart text").all_text_contents()
    numbers = [float(x.replace("−", "-")) for x in angles.locator(".chart text.end").all_text_contents()]
    assert max(numbers) == pytest.approx(largest, rel=0.5)
    heads, rows = table(saved(page, angles, "CSV"))
    assert heads[1] == "joint1 [rad/s]" and np.nanmax(rows[:, 1]) == pytest.approx(2.0 * factor, rel=0.02)


def test_plots_that_are_not_over_time_need_no_script(planar: tuple[Result, Path], chromium: Any) -> None:
    context = chromium.new_context(offline=True, java_script_enabled=False, color_scheme="dark")
    page = context.new_page()
    page.goto(planar[1].as_uri())
    words = page.get_by_role("img", name="Tip path").get_by_text("x [m]", exact=True)
    assert words.is_visible() and words.evaluate("x => getComputedStyle(x).fill") == "rgb(228, 228, 228)"
    assert "need JavaScript" in page.locator("body > noscript").inner_text()
    figures = page.locator(":is(figure.motion, figure.plot)")
    for k in range(figures.count()):
        shown = figures.nth(k).locator("svg.picture:visible, img:visible")
        assert shown.count() == 1 and shown.locator("path, image").count() > 3, figures.nth(k).text_content()
    assert not page.locator(".chart:visible, .scene:visible").count()
    context.close()


def test_curves_of_a_picture_are_saved(planar: tuple[Result, Path], opened: Opener) -> None:
    """The path of the tip is not over time: its places are in the file as in the result."""
    result, target = planar
    page = opened(target)
    plot = page.locator("figure.plot").filter(has=page.get_by_role("heading", name="Tip path", exact=True))
    heads, rows = table(saved(page, plot, "CSV"))
    (name,) = result.group("points")
    assert heads == [f"{name}: x [m]", f"{name}: y [m]"]
    places = result[f"points/{name}"][:, :2]
    gaps = np.linalg.norm(rows[:, None] - places, axis=2)
    assert len(rows) > 20 and gaps.min(axis=1).max() < 0.05 and gaps[[0, -1], [0, -1]].max() < 1e-6


def test_the_rows_of_a_map_are_saved(tmp_path: Path, opened: Opener) -> None:
    """Colours tell little; the file has each row's numbers, not those that were scaled for the colours."""
    result = chain_result(30)
    page = page_of(opened, result, tmp_path)
    plot = page.locator("figure.plot").filter(has=page.get_by_role("heading", name="Joint rates", exact=True))
    heads, rows = table(saved(page, plot, "CSV"))
    assert heads[0] == "time [s]" and len(heads) == 31 and heads[3] == "joint3: joint rate [rad/s]"
    at = [int(np.argmin(np.abs(result.time - t))) for t in rows[:, 0]]
    assert len(at) > 100 and rows[:, 1:] == pytest.approx(result["qd"][at], rel=1e-6, abs=1e-12)


def test_a_part_of_a_picture_is_enlarged(planar: tuple[Result, Path], opened: Opener) -> None:
    """By a drag and by keys, and back; a file of its curves is whole all the same."""
    page = opened(planar[1])
    plot = page.locator("figure.plot").filter(has=page.get_by_role("heading", name="Tip path", exact=True))
    plot.scroll_into_view_if_needed()
    picture, back = plot.locator("svg.picture"), plot.get_by_role("button", name="See all of the picture")

    def seen() -> list[float]:
        return [float(x) for x in picture.get_attribute("viewBox").split()]

    whole, box = seen(), picture.bounding_box()
    assert not back.is_visible()
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 0.25 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.6 * box["height"])
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 0.75 * box["height"])
    page.mouse.up()
    assert seen() == pytest.approx(
        [0.25 * whole[2], 0.25 * whole[3], 0.5 * whole[2], 0.5 * whole[3]], rel=0.02
    )
    assert picture.bounding_box() == box and back.is_visible() and plot.locator(".chosen").count() == 0
    # numbers at its rim stand where those of the whole do
    pairs = picture.evaluate(
        """svg => [...svg.querySelectorAll(".marks text[text-anchor=middle]")].flatMap((mark) => {
          const value = (text) => Number(text.textContent.trim().replace("−", "-"));
          const centre = (text) => text.getBBox().x + text.getBBox().width / 2;
          const same = [...svg.querySelectorAll("text")].filter((text) => !text.closest(".marks") && value(text) === value(mark));
          const at = (text) => { const p = text.getCTM(), own = svg.getCTM(); return own.inverse().multiply(p); };
          return same.map((text) => {
            const box = text.getBBox(), place = new DOMPoint(box.x + box.width / 2, box.y).matrixTransform(at(text));
            return [place.x, centre(mark), place.y];
          });
        })"""
    )
    lowest = max(y for *_, y in pairs)
    own = [(x, mark) for x, mark, y in pairs if y > lowest - 1.0]
    assert len(own) >= 2 and all(abs(x - mark) < 1.0 for x, mark in own), pairs
    assert {"x [m]", "y [m]"} <= set(plot.locator(".marks text").all_text_contents())
    frame = plot.locator(".wide")
    frame.press("+")
    frame.press("ArrowRight")
    assert seen()[2] == pytest.approx(0.25 * whole[2], rel=0.02)
    assert seen()[0] == pytest.approx((0.375 + 0.0625) * whole[2], rel=0.02)
    for _ in range(12):
        frame.press("ArrowLeft")
    assert seen()[0] == 0.0, "no further than the picture"
    back.click()
    assert seen() == whole and not back.is_visible()
    assert len(table(saved(page, plot, "CSV"))[1]) > 20
