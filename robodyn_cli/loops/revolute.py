"""Pin joint that closes a loop."""

from __future__ import annotations

import dataclasses

from robodyn_cli.schema.fields import Choice, ListOf, Name, Text, Vector, key


@dataclasses.dataclass(frozen=True)
class RevoluteLoop:
    """A pin between two links: the points coincide and the axes are parallel.

    Rows of eta: point on the first link minus point on the second, in base axes (3), then the two components
    of the second axis across the first (2). Rows that vanish identically are left out of the equations.
    """

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("revolute",)), doc="Kind of closure.")
    between: tuple[str, ...] = key(
        ListOf(Text(), minimum=2, maximum=2), doc="Two points: `link.end`, `link.origin`, `base.NAME` or a named point."
    )
    axis: tuple[float, ...] = key(Vector(3), default=(0.0, 0.0, 1.0), unit="1", doc="Pin axis in the first link's frame.")
    axis2: tuple[float, ...] | None = key(
        Vector(3), default=None, unit="1", doc="Pin axis in the second link's frame; default: the same components."
    )
