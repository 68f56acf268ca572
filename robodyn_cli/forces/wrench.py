"""Forces and moments on a point from outside: constants, formulas or tables, in world or body axes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from robodyn_cli.expr.functions import interpolate
from robodyn_cli.forces.element import Action, Effect, End, ForceElement, Setting
from robodyn_cli.record import record
from robodyn_cli.schema.fields import (
    LOAD,
    Choice,
    Either,
    Formula,
    ListOf,
    Name,
    Section,
    Text,
    Vector,
    key,
    role_key,
)
from robodyn_cli.spatial.algebra import Vector as Components
from robodyn_cli.spatial.algebra import Wrench, vector, zeros


@record
class VectorTable:
    """Three components as a table; linear between rows, held beyond the ends."""

    table: tuple[tuple[float, ...], ...] = key(
        ListOf(Vector(4), minimum=2),
        unit="s, N or N m",
        doc="Rows of time and three components, times increasing.",
    )


COMPONENTS = Either((ListOf(Formula(), minimum=3, maximum=3), Section(VectorTable)))
AXES = Choice(("world", "body"))
AT = "Where it acts: a named point or frame, LINK.origin, LINK.end or LINK.com."
FRAME = "Axes of the components: the world's, or those of the link (of the frame, where `at` names one)."


def _components(value: Any, setting: Setting) -> Components:
    if value is None:
        return zeros(3)
    if isinstance(value, VectorTable):
        times, *columns = zip(*value.table)
        return vector([interpolate(setting.time, tuple(times), tuple(c)) for c in columns])
    return vector([x.evaluate(setting.values) for x in value])


class _FromOutside(ForceElement):
    """A force and a moment on a link, whose power comes from outside."""

    term: ClassVar[str] = "external"
    switching: ClassVar[bool] = True
    at: str
    frame: str
    force: Any
    moment: Any = None

    @property
    def references(self) -> tuple[str, ...]:
        return (self.at,)

    @property
    def _tables(self) -> dict[str, VectorTable]:
        parts = {"force": self.force, "moment": self.moment}
        return {name: x for name, x in parts.items() if isinstance(x, VectorTable)}

    @property
    def breakpoints(self) -> tuple[float, ...]:  # type: ignore[override]
        return tuple(row[0] for table in self._tables.values() for row in table.table)

    def problems(self) -> Iterable[tuple[tuple[Any, ...], str]]:
        """Yield what does not fit together."""
        if self.force is None and self.moment is None:
            yield (), "needs a 'force' or a 'moment'"
        for name, table in self._tables.items():
            times = [row[0] for row in table.table]
            for k, (before, time) in enumerate(zip(times, times[1:]), start=1):
                if not time > before:
                    yield (name, "table", k, 0), f"times must increase (value {time!r} after {before!r})"

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect:
        """Return force and moment; all of their power comes from outside."""
        (end,) = ends
        wrench = Wrench(_components(self.moment, setting), _components(self.force, setting))
        if self.frame == "body":
            power = wrench.dot(end.velocity.rotated(end.R.T))
            return Effect((Action(0, wrench, local=True),), 0.0, power)
        wrench = wrench.rotated(setting.world)
        return Effect((Action(0, wrench),), 0.0, wrench.dot(end.velocity))


@record
class PointForce(_FromOutside):
    """A force through a point of a link."""

    name: str = key(Name(of="force"), doc="Name.")
    type: str = key(Choice(("force",)), doc="Kind of force.")
    at: str = key(Text(), doc=AT)
    force: Any = key(
        COMPONENTS, unit="N", doc="Components: three numbers or formulas in t, q and qd, or a table."
    )
    frame: str = key(AXES, default="world", doc=FRAME)
    role: str = role_key(LOAD)


@record
class PointWrench(_FromOutside):
    """A force through a point of a link and a moment on the link."""

    name: str = key(Name(of="force"), doc="Name.")
    type: str = key(Choice(("wrench",)), doc="Kind of force.")
    at: str = key(Text(), doc=AT)
    force: Any = key(COMPONENTS, default=None, unit="N", doc="Components of the force.")
    moment: Any = key(COMPONENTS, default=None, unit="N m", doc="Components of the moment.")
    frame: str = key(AXES, default="world", doc=FRAME)
    role: str = role_key(LOAD)
