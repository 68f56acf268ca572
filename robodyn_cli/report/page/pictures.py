"""Figures that are not over time as SVG inside the page: words are words, colours follow the theme, and no attribute
needs a style that the page's policy forbids."""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Iterator, Sequence
from io import BytesIO
from itertools import groupby
from typing import Any
from xml.etree import ElementTree

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FuncFormatter
from matplotlib.transforms import Bbox

from robodyn_cli.record import record
from robodyn_cli.report.canvas import below_heading, print_figure
from robodyn_cli.report.page.tables import Html, element, markup

LARGEST_SVG = 400_000  # bytes; a picture with more is smaller as pixels
# colours that the theme names; those of maps stand for values and stay
BLACK = "#000000"  # what has no colour
THEME = {
    BLACK: "var(--ink)",
    "#ffffff": "var(--paper)",
    "#0072b2": "var(--blue)",
    "#d55e00": "var(--alarm)",
    "#4d4d4d": "var(--grey)",
    "#5f5f5f": "var(--grey)",
    "#7f7f7f": "var(--grey)",
    "#dedede": "var(--rule)",
}
DARK = 110.0  # luma of colours that are lifted on a dark page
MAPS = ("QuadMesh", "image")  # how names of groups begin that hold colours of values
LEFT_OUT = ("metadata", "style", "title")
FONTS = ("font", "font-family", "font-size", "font-weight", "font-style")
PLACES = ("d", "transform", "x", "y", "width", "height", "points", "stroke-dasharray", "stroke-width")
NOTHING = {"stroke-dashoffset": "0"}
FEW = 3  # elements with the same look are worth a group
POINTS = 72.0  # of an inch
PIXELS = 96.0 / 72.0  # of a printer's point
_NUMBER = re.compile(r"-?\d+\.\d+")
_REFERENCE = re.compile(r"#([\w-]+)")


@record
class _Node:
    """An element of a picture: its tag, its attributes, and the elements or the text in it."""

    tag: str
    given: dict[str, str]
    inside: list[_Node]
    words: str = ""

    def html(self) -> Html:
        content = self.words if self.words else _together(self.inside)
        return element(self.tag, content, **self.given)


def picture(figure: Figure, label: str, place: int) -> Html:
    """Return a figure below its heading as an element of the page, in pixels where it has too many marks for SVG."""
    part = below_heading(figure)
    numbered = [(ax, _scale(ax, "x"), _scale(ax, "y")) for ax in figure.axes]  # before numbers get prefixes
    drawn = _inline(figure, part, label, place)
    if len(drawn) <= LARGEST_SVG:
        top = figure.get_size_inches()[1] if part is None else part.y1
        scales = [[_corners(ax, top), x, y] for ax, x, y in numbered if x or y]
        look = {"class_": "wide", "tabindex": "0", "role": "group", "aria_label": label}
        return element("div", drawn, data_scales=json.dumps(scales) if scales else None, **look)
    data = base64.b64encode(_printed(figure, ".png", part)).decode()
    return element("img", src=f"data:image/png;base64,{data}", alt=label)


def _scale(ax: Axes, name: str) -> list[Any] | None:
    """Return the label, the ends, and whether it is logarithmic, of an axis with plain numbers; None of any other."""
    axis, kind = ax.xaxis if name == "x" else ax.yaxis, ax.get_xscale() if name == "x" else ax.get_yscale()
    low, high = (float(end) for end in axis.get_view_interval())
    plain = kind in ("linear", "log") and not isinstance(
        axis.get_major_formatter(), FixedFormatter | FuncFormatter
    )
    if not (
        plain
        and axis.get_visible()
        and len(axis.get_ticklocs())
        and math.isfinite(high - low)
        and high != low
    ):
        return None
    return [axis.get_label_text(), low, high, kind == "log"]


def _corners(ax: Axes, top: float) -> list[float]:
    """Return left, top, right and bottom of axes in a picture that was drawn, whose upper rim is at a height [in]."""
    box, (width, height) = ax.get_position(), ax.figure.get_size_inches()  # type: ignore[union-attr]
    places = (box.x0 * width, top - box.y1 * height, box.x1 * width, top - box.y0 * height)
    return [round(POINTS * place, 1) for place in places]


def _printed(figure: Figure, suffix: str, part: Bbox | None) -> bytes:
    buffer = BytesIO()
    print_figure(figure, buffer, suffix, part)
    return buffer.getvalue()


def _inline(figure: Figure, part: Bbox | None, label: str, place: int) -> Html:
    """Return a part of a figure as an element; ``place`` tells names of pictures apart."""
    with rc_context({"svg.fonttype": "none"}):
        root = ElementTree.fromstring(_printed(figure, ".svg", part))
    width, height = (float(x) for x in root.attrib["viewBox"].split()[2:])
    names = _Names(place)
    return element(
        "svg",
        _together([node for child in root for node in _copied(child, names)]),
        class_="picture",
        viewBox=f"0 0 {_short(width)} {_short(height)}",
        width=round(PIXELS * width),
        height=round(PIXELS * height),
        stroke_linejoin="round",
        fill=THEME[BLACK],
        role="img",
        aria_label=label,
    )


class _Names:
    """Short names for those of one picture, which no other of the page has."""

    def __init__(self, place: int) -> None:
        self.place = place
        self.known: dict[str, str] = {}

    def __call__(self, name: str) -> str:
        return self.known.setdefault(name, f"p{self.place}-{len(self.known)}")


def _copied(node: ElementTree.Element, names: _Names, of_map: bool = False) -> Iterator[_Node]:
    """Give an element with all in it, or what is in a group that says nothing; of_map : whether its colours are
    values."""
    tag, own = node.tag.rpartition("}")[2], node.attrib.get("id", "")
    if tag in LEFT_OUT:
        return
    of_map = of_map or own.startswith(MAPS)
    given: dict[str, str] = {}
    for name, value in node.attrib.items():
        given |= _styles(value) if name == "style" else {name.rpartition("}")[2]: value}
    if tag == "g":
        given.pop("id", None)  # is used by nothing
        if own.startswith(MAPS):
            given["fill"] = BLACK
    if given.get("transform", "").startswith("rotate(-0 "):
        del given["transform"]
    given = {
        name: _attribute(name, x, names, of_map)
        for name, x in given.items()
        if (name, x) not in NOTHING.items()
    }
    inside = [part for child in node for part in _copied(child, names, of_map)]
    if tag == "g" and not given:
        yield from inside
    elif tag != "g" or inside:
        yield _Node(tag, given, inside, "".join(node.itertext()) if tag == "text" else "")


def _together(nodes: Sequence[_Node]) -> Html:
    """Return elements one after another; neighbours of one look share a group that has it."""
    parts: list[Html] = []
    for tag, run in groupby(_merged(nodes), lambda node: node.tag):
        for look, alike in groupby(run, _look):
            same = list(alike)
            if tag != "use" or len(same) < FEW:
                parts += [node.html() for node in same]
                continue
            bare = [_Node(tag, {k: x for k, x in node.given.items() if k in OWN}, []) for node in same]
            parts.append(element("g", [node.html() for node in bare], **dict(look)))
    return markup(parts)


OWN = ("href", "x", "y")  # of an element that is used again


def _look(node: _Node) -> tuple[tuple[str, str], ...]:
    return tuple((name, x) for name, x in node.given.items() if name not in OWN)


def _merged(nodes: Sequence[_Node]) -> Iterator[_Node]:
    """Give elements, with neighbouring groups of the same attributes as one."""
    for (tag, _), run in groupby(nodes, lambda node: (node.tag, node.given)):
        same = list(run)
        if tag == "g" and len(same) > 1:
            yield _Node("g", same[0].given, [part for node in same for part in node.inside])
        else:
            yield from same


def _styles(text: str) -> dict[str, str]:
    """Return the properties of a style as attributes; of a font its size and weight, the page has its own."""
    found: dict[str, str] = {}
    for item in filter(str.strip, text.split(";")):
        name, value = (x.strip() for x in item.split(":", 1))
        if name not in FONTS:
            found[name] = value
            continue
        size = re.search(r"([\d.]+)px", value)
        if size is not None:
            found["font-size"] = size[1]
        if "bold" in value or value == "700":
            found["font-weight"] = "bold"
    return found


def _attribute(name: str, value: str, names: _Names, of_map: bool) -> str:
    """Return the value of an attribute as the page has it."""
    if name == "id":
        return names(value)
    if name in ("fill", "stroke", "stop-color") and re.fullmatch("#[0-9a-fA-F]{6}", value):
        return value if of_map else themed(value.lower())
    if (name == "href" and not value.startswith("data:")) or "url(" in value:
        return _REFERENCE.sub(lambda found: "#" + names(found[1]), value)
    if name in PLACES:
        return " ".join(_NUMBER.sub(lambda number: _short(float(number[0])), value).split())
    return value


def _short(number: float) -> str:
    """Return a number of points: a twentieth is less than is seen, but of marks of a few points."""
    return f"{round(number, 1 if abs(number) > 10.0 else 2):g}"


def themed(colour: str) -> str:
    """Return a colour #rrggbb as the page's theme has it: a dark one is lifted on a dark page."""
    if colour in THEME:
        return THEME[colour]
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    is_dark = 0.299 * red + 0.587 * green + 0.114 * blue < DARK
    return f"color-mix(in srgb, {colour}, #ffffff var(--lift))" if is_dark else colour
