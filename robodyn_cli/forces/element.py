"""What a force element between bodies gets to know, and what it gives back.

An element acts on one point, or between two. What acts between two bodies is described relative to their last common
ancestor and in its coordinates: it then does not depend on the joints below, and does nothing to them.

Checklist for another kind:

1. ``references`` names the places it acts at: one, or two on different links.
2. ``effect`` returns forces, potential energy and power that belong together: with q-dot the joint rates,
   (sum of J^T f) . q-dot = -d/dt potential + power. ``tests/conformance/test_forces.py`` checks that over the registry.
3. ``term`` is the part of the torques under which ``inverse`` reports it: ``passive`` or ``external``.
4. ``switches`` returns expressions at whose sign changes the force or its rate jumps, so that steps end there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar, Protocol

from robodyn_cli.expr.functions import sqrt
from robodyn_cli.record import record
from robodyn_cli.schema.fields import ListOf, Text, key
from robodyn_cli.spatial.algebra import Matrix, Twist, Vector, Wrench, dot, zeros


@record
class End:
    """A place on a body: origin p [m], axes R (columns), and the body's velocity about that origin."""

    p: Vector
    R: Matrix
    velocity: Twist

    @property
    def v(self) -> Vector:
        """Velocity of the origin [m/s]."""
        return self.velocity.v

    @property
    def w(self) -> Vector:
        """Angular velocity [rad/s]."""
        return self.velocity.w


@record
class Setting:
    """What an element may ask for beside its ends.

    values : t, positions, rates and parameters for formulas (see ``Formula.evaluate``). time : t.
    world : (3, 3) rotation from world coordinates to those of the ends; only for elements with one end.
    turn : angle [rad] by which the second end has turned against the first about an axis (3,) given in the frame of
    each, counted without end, or None where the joints between them allow other rotations.
    """

    values: Mapping[str, Any]
    time: Any
    world: Matrix
    turn: Callable[[tuple[float, ...]], Any]


@record
class Action:
    """A wrench about the origin of an end; ``local``: in the end's own axes."""

    end: int
    wrench: Wrench
    local: bool = False


@record
class Effect:
    """What an element does: actions, potential energy [J] of the conservative part, power [W] of the rest."""

    actions: tuple[Action, ...]
    potential: Any = 0.0
    power: Any = 0.0


class ForceElement(Protocol):
    """A force element of a scene (see the checklist above)."""

    term: ClassVar[str]

    @property
    def name(self) -> str: ...

    @property
    def type(self) -> str: ...

    @property
    def references(self) -> tuple[str, ...]: ...

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect: ...


def between_key() -> Any:
    """Declare the key of the two places that an element acts between."""
    return key(
        ListOf(Text(), minimum=2, maximum=2),
        doc="The two places: named points or frames, LINK.origin, LINK.end, LINK.com, base.origin.",
    )


def idle_problems(stiffness: float, damping: float) -> Iterable[tuple[tuple[str, ...], str]]:
    """Yield what is wrong with a spring and damper that does nothing."""
    if stiffness == 0.0 and damping == 0.0:
        yield (), "needs a 'stiffness' or a 'damping' that is not zero"


def opposite(ends: tuple[End, ...], wrench: Wrench) -> tuple[Action, ...]:
    """Return a wrench on the second end, and its opposite on the first."""
    return Action(1, wrench), Action(0, -wrench.shifted(ends[1].p - ends[0].p))


@record
class Line:
    """The line between two ends: length l [m], its rate [m/s], the vector from the first end to the second."""

    d: Vector
    length: Any
    rate: Any

    @staticmethod
    def of(ends: tuple[End, ...]) -> Line:
        d = ends[1].p - ends[0].p
        length = sqrt(dot(d, d))
        return Line(d, length, dot(d, ends[1].v - ends[0].v) / length)

    def pull(self, tension: Any) -> tuple[Action, ...]:
        """Return the actions of a tension [N], which pulls the ends together where it is positive."""
        force = self.d * (tension / self.length)
        return along(force)


def along(force: Vector) -> tuple[Action, ...]:
    """Return the actions of a force on the first end, and its opposite on the second, along their line."""
    wrench = Wrench(zeros(3), force)
    return Action(0, wrench), Action(1, -wrench)
