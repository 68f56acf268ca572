"""Figures as SVG inside a page: they obey its policy, keep their words, marks and colours, and get in nobody's way."""

from __future__ import annotations

import re
from typing import Any
from xml.etree import ElementTree

import numpy as np
from matplotlib.figure import Figure

from robodyn_cli.report.page.pictures import LARGEST_SVG, picture, themed
from robodyn_cli.report.registry import draw
from tests.unit.synthetic_results import inverse_result

MARKS = 40


def figure() -> Figure:
    """A map, a line in black, a dark line, marks, words in bold and a hatched area."""
    made = Figure()
    ax, beside = made.subplots(1, 2)
    ax.pcolormesh(np.array([[0.0, 1.0], [2.0, 3.0]]), cmap="gray")
    beside.plot([0, 1], [0, 1], color="#000000")
    beside.plot([0, 1], [1, 0], color="#440154", linewidth=3.25)
    beside.plot(np.arange(MARKS), np.arange(MARKS), "o", color="#E69F00")
    beside.axvspan(0.2, 0.4, facecolor="none", edgecolor="#009E73", hatch="//")
    beside.set_title("a < b & 'c'", fontweight="bold")
    return made


def tree(drawn: Any) -> ElementTree.Element:
    return ElementTree.fromstring(str(drawn))


def test_a_picture_is_an_element_without_styles_whose_names_are_its_own() -> None:
    drawn = [picture(figure(), "both", place) for place in (1, 2)]
    for one in drawn:
        names = [node.attrib["id"] for node in tree(one).iter() if "id" in node.attrib]
        used = re.findall(r'(?:href="|url\()#([\w-]+)', str(one))
        assert len(names) == len(set(names)) and set(used) <= set(names) and used
        assert not any("style" in node.attrib for node in tree(one).iter())
        assert not re.search("<(style|metadata|script)|https?:", str(one))
    first, second = (set(re.findall(r' id="([\w-]+)"', str(one))) for one in drawn)
    assert not first & second, "two pictures of a page share no name"


def test_words_marks_and_colours_are_kept() -> None:
    root = tree(picture(figure(), "both", 1))
    words = {"".join(node.itertext()): node for node in root.iter("text")}
    assert words["a < b & 'c'"].attrib["font-weight"] == "bold"
    assert next(root.iter("svg")).attrib["fill"] == "var(--ink)", "what is black follows the theme"
    assert not any("fill" in node.attrib for node in words.values())
    colours = [node.attrib.get("stroke", "") for node in root.iter("path")]
    assert "var(--ink)" in colours and any("#440154" in x and "--lift" in x for x in colours)
    cells = next(node for node in root.iter("g") if node.attrib.get("fill") == "#000000")
    own = {node.attrib.get("fill", "#000000") for node in cells.iter("path")}
    assert {"#000000", "#ffffff"} <= own and not any("var" in x for x in own), "colours of values stay"
    orange = [node for node in root.iter("g") if node.attrib.get("fill") == "#e69f00"]
    assert sum(len(node.findall("use")) for node in orange) == MARKS
    assert len(str(picture(figure(), "both", 1))) < 25_000


def test_lines_end_where_those_of_the_figure_end() -> None:
    drawn = draw(inverse_result(), "tip_path")
    line = max(drawn.axes[0].lines, key=lambda one: len(one.get_xdata()))
    _, height = drawn.get_size_inches() * 72
    ends = line.get_transform().transform(np.transpose(line.get_data())[[0, -1]]) * 72 / drawn.dpi
    root = tree(picture(drawn, "path", 1))
    top = float(next(root.iter("svg")).attrib["viewBox"].split()[3])
    paths = [re.findall(r"-?[\d.]+", node.attrib["d"]) for node in root.iter("path") if node.attrib.get("d")]
    found = [np.array([path[:2], path[-2:]], dtype=float) for path in paths if len(path) > 3]
    # measured from below: the heading is cut off above
    wanted = np.stack([ends[:, 0], top - ends[:, 1]], axis=1)
    assert min(np.abs(x - wanted).max() for x in found) < 0.2 and top < height


def test_too_many_marks_become_pixels() -> None:
    made = Figure()
    x = np.random.default_rng(1).normal(size=(10_000, 2))
    made.subplots().plot(*x.T, ".")
    drawn = str(picture(made, "cloud", 1))
    assert drawn.startswith("<img") and "data:image/png" in drawn and len(drawn) < LARGEST_SVG


def test_colours_follow_the_theme() -> None:
    assert themed("#000000") == "var(--ink)" and themed("#e69f00") == "#e69f00"
    assert themed("#123456") == "color-mix(in srgb, #123456, #ffffff var(--lift))"
