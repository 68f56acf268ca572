"""Which colour and dash a joint has, and with it its link and its motor: the same in all pictures of a result.

A look follows from the place of a name in the scene, not from which columns a picture keeps or how many there are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import count
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.report.style import dashed_style, line_styles
from robodyn_cli.results.result import Result, column_names

JOINTS, POINTS = "joints", "points"  # what has places of its own


@record
class Looks:
    """The places of a result's names, by what they are of: joints by their coordinates, with the loops behind them, and
    named points."""

    places: Mapping[str, Mapping[str, int]]

    def placed(self, names: Sequence[str], of: str = JOINTS) -> list[int]:
        """Return the place of each name; names that are of something else come behind, or first where all are."""
        known = self.places.get(of, {})
        own = [_own(name, known) for name in names]
        further = count(len(known) if any(k is not None for k in own) else 0)
        return [next(further) if k is None else k for k in own]

    def lines(self, names: Sequence[str], of: str = JOINTS) -> list[dict[str, Any]]:
        """Return colour, dash and width of the line of each name; many lines are thinner."""
        width = line_styles(len(names))[0]["linewidth"] if names else 0.0
        return [{**dashed_style(k), "linewidth": width} for k in self.placed(names, of)]

    def colour(self, name: str, of: str = JOINTS) -> str:
        """Return the colour of a name."""
        return str(self.lines([name], of)[0]["color"])


def looks_of(result: Result) -> Looks:
    """Return the looks of a result: of joints and points in the order of its scene."""
    found = result.variables
    coordinates = [name for path in ("q", "qd", "tau") if path in found for name in column_names(found[path])]
    joints: dict[str, int] = {}
    for name in (*coordinates, *result.group("reactions"), *result.group("loop_reactions")):
        if _own(name, joints) is None:
            joints[name] = len(joints)
    return Looks({JOINTS: joints, POINTS: {name: k for k, name in enumerate(result.group("points"))}})


def _own(name: str, places: Mapping[str, int]) -> int | None:
    """Return the place of a name: a rate goes by its position (``ball.wx`` by ``ball.qx``), a joint with several
    coordinates by the first of them; None of a name that has none."""
    if name in places:
        return places[name]
    joint, _, coordinate = name.partition(".")
    for position in (f"{joint}.{coordinate[1:]}", f"{joint}.q{coordinate[1:]}"):
        if coordinate[:1] in ("v", "w") and position in places:
            return places[position]
    if coordinate:
        return None
    return min((k for other, k in places.items() if other.startswith(f"{joint}.")), default=None)
