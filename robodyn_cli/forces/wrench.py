"""Forces and moments on a point from outside: constants, formulas or tables, in world or body axes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from robodyn_cli.expr.functions import interpolate
from robodyn_cli.forces.element import Action, Effect, End, Setting
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Either, Formula, ListOf, Name, Section, Text, Vector, key
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


def _problems(name: str, value: Any) -> Iterable[tuple[tuple[Any, ...], str]]:
    if isinstance(value, VectorTable):
        times = [row[0] for row in value.table]
        for k in range(1, len(times)):
            if not times[k] > times[k - 1]:
                yield (
                    (name, "table", k, 0),
                    f"times must increase (value {times[k]!r} after {times[k - 1]!r})",
                )


def _components(value: Any, setting: Setting) -> Components:
    if value is None:
        return zeros(3)
    if isinstance(value, VectorTable):
        times, *columns = zip(*value.table)
        return vector([interpolate(setting.time, tuple(times), tuple(c)) for c in columns])
    return vector([x.evaluate(setting.values) for x in value])


def _times(value: Any) -> tuple[float, ...]:
    return tuple(row[0] for row in value.table) if isinstance(value, VectorTable) else ()


def _effect(wrench: Wrench, end: End, frame: str, setting: Setting) -> Effect:
    if frame == "body":
        power = wrench.dot(end.velocity.rotated(end.R.T))
        return Effect((Action(0, wrench, local=True),), 0.0, power)
    wrench = wrench.rotated(setting.world)
    return Effect((Action(0, wrench),), 0.0, wrench.dot(end.velocity))


@record
class PointForce:
    """A force through a point of a link."""

    term: ClassVar[str] = "external"

    name: str = key(Name(of="force"), doc="Name.")
    type: str = key(Choice(("force",)), doc="Kind of force.")
    at: str = key(Text(), doc=AT)
    force: Any = key(
        COMPONENTS, unit="N", doc="Components: three numbers or formulas in t, q and qd, or a table."
    )
    frame: str = key(AXES, default="world", doc=FRAME)

    @property
    def references(self) -> tuple[str, ...]:
        return (self.at,)

    def problems(self) -> Iterable[tuple[tuple[Any, ...], str]]:
        """Yield what does not fit together."""
        yield from _problems("force", self.force)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which the slope of the table jumps."""
        return _times(self.force)

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect:
        """Return the force; all of its power comes from outside."""
        wrench = Wrench(zeros(3), _components(self.force, setting))
        return _effect(wrench, ends[0], self.frame, setting)


@record
class PointWrench:
    """A force through a point of a link and a moment on the link."""

    term: ClassVar[str] = "external"

    name: str = key(Name(of="force"), doc="Name.")
    type: str = key(Choice(("wrench",)), doc="Kind of force.")
    at: str = key(Text(), doc=AT)
    force: Any = key(COMPONENTS, default=None, unit="N", doc="Components of the force.")
    moment: Any = key(COMPONENTS, default=None, unit="N m", doc="Components of the moment.")
    frame: str = key(AXES, default="world", doc=FRAME)

    @property
    def references(self) -> tuple[str, ...]:
        return (self.at,)

    def problems(self) -> Iterable[tuple[tuple[Any, ...], str]]:
        """Yield what does not fit together."""
        if self.force is None and self.moment is None:
            yield (), "needs a 'force' or a 'moment'"
        yield from _problems("force", self.force)
        yield from _problems("moment", self.moment)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which the slopes of the tables jump."""
        return (*_times(self.force), *_times(self.moment))

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect:
        """Return force and moment; all of their power comes from outside."""
        wrench = Wrench(_components(self.moment, setting), _components(self.force, setting))
        return _effect(wrench, ends[0], self.frame, setting)
