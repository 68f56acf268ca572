"""What a painter paints: strokes in the plane, in their order."""

from __future__ import annotations

from typing import NamedTuple

from robodyn_cli.spatial.algebra import Array

INK = "#2f2f2f"
PAPER = "#ffffff"
FAINT = "#dcdcdc"
GRID = "#e6e6e6"


class Stroke(NamedTuple):
    """A line or an area: points (N, 2), rows that are no numbers between its pieces; widths in printer's points.

    layer, depth : strokes of higher layers, and within one those nearer to the eye, are painted later.
    """

    points: Array
    colour: str = INK
    width: float = 1.0
    fill: str | None = None
    closed: bool = False
    layer: int = 0
    depth: float = 0.0
    dashed: bool = False


def mixed(colour: str, other: str, part: float) -> str:
    """Return a colour with a part of another one in it: ``part`` 0 is the first, 1 the other."""
    a, b = ([int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in (colour, other))
    return "#" + "".join(f"{round(x + part * (y - x)):02x}" for x, y in zip(a, b))


def body(points: Array, colour: str, width: float, layer: int, depth: float) -> list[Stroke]:
    """Return a body with the corners (N, 2) of its hull: a bar with round ends, or a plate with round corners."""
    dark, light = mixed(colour, INK, 0.35), mixed(colour, PAPER, 0.62)
    rim = min(1.0, 0.25 * width)
    closed = len(points) > 2
    return [
        Stroke(points, dark, width, dark if closed else None, closed, layer, depth),
        Stroke(points, light, width - 2.0 * rim, light if closed else None, closed, layer, depth),
    ]
