"""Pin joint that closes a loop."""

from __future__ import annotations

import dataclasses

from robodyn_cli.loops.base import LoopFrame, Row
from robodyn_cli.schema.fields import Choice, ListOf, Name, Text, Vector, key
from robodyn_cli.spatial.algebra import cross, dot, rotation_to_z, vector


@dataclasses.dataclass(frozen=True)
class RevoluteLoop:
    """A pin between two links: the points coincide and the axes are parallel.

    Rows of eta: point on the first link minus point on the second (3), then the components of the second axis
    along two directions of the first link across its axis (2). Rows that vanish identically, as in a planar
    mechanism, are left out of the equations.
    """

    name: str = key(Name(of="loop"), doc="Name.")
    type: str = key(Choice(("revolute",)), doc="Kind of closure.")
    between: tuple[str, ...] = key(
        ListOf(Text(), minimum=2, maximum=2), doc="Two points: `link.end`, `link.origin`, `base.NAME` or a named point."
    )
    axis: tuple[float, ...] = key(
        Vector(3), default=(0.0, 0.0, 1.0), unit="1", doc="Pin axis in the first link's frame."
    )
    axis2: tuple[float, ...] | None = key(
        Vector(3), default=None, unit="1", doc="Pin axis in the second link's frame; default: the same components."
    )

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the five scalar constraints.

        Position: eta = p1 - p2, gamma = a1 - a2. Axis: eta = u.n with u fixed in the first link and n the
        second axis, Psi = (u x n)^T (Jw1 - Jw2).
        """
        found = []
        for k, axis in enumerate("xyz"):
            found.append(
                Row(
                    f"{self.name}.{axis}",
                    first.p[k] - second.p[k],
                    first.Jv[k] - second.Jv[k],
                    first.a[k] - second.a[k],
                )
            )
        across = first.R @ rotation_to_z(self.axis)
        length = sum(x * x for x in (self.axis2 or self.axis)) ** 0.5
        n = second.R @ vector([x / length for x in (self.axis2 or self.axis)])
        relative = first.w - second.w
        for k in range(2):
            u = across[:, k]
            lever = cross(u, n)
            rate = cross(cross(first.w, u), n) + cross(u, cross(second.w, n))
            found.append(
                Row(
                    f"{self.name}.axis{k + 1}",
                    dot(u, n),
                    lever @ (first.Jw - second.Jw),
                    dot(lever, first.wd - second.wd) + dot(rate, relative),
                    kind="moment",
                )
            )
        return found
