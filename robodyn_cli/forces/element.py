"""What a force element between bodies gets to know, and what it gives back.

An element acts on one point, or between two. What acts between two bodies is described relative to their last common
ancestor and in its coordinates: it then does not depend on the joints below, and does nothing to them.

Checklist for another kind:

1. ``references`` names the places it acts at: one, or two on different links.
2. ``effect`` returns forces, potential energy and power that belong together: with q-dot the joint rates,
   (sum of J^T f) . q-dot = -d/dt potential + power. ``tests/conformance/test_forces.py`` checks that over the registry.
   Ends on the ground that move by formulas do work of their own, which ``equations/elements.py`` adds.
3. ``term`` is the part of the torques under which ``inverse`` reports it: ``passive`` or ``external``.
4. ``switching`` says whether the force may jump or bend, as a formula of the scene does: steps then end there.
5. ``role`` is its part in margins of motorisation, with ``role_key`` a key of its own.
6. Where the force jumps at half a turn, ``Effect.half_turns`` says so: steps end there, and the run warns of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar

from robodyn_cli.expr.functions import sqrt
from robodyn_cli.expr.graph import Expr
from robodyn_cli.record import record
from robodyn_cli.schema.fields import LOAD, ListOf, Text, key
from robodyn_cli.spatial.algebra import Matrix, Twist, Vector, Wrench, dot, zeros

HALF_TURN = 1e-9  # 1 + cos(theta) below which an event is at half a turn


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
    each, counted without end, or None where the joints between them allow other rotations. hinge : the axis (3,) in the
    frame of the first about whose parallels all joints between the ends turn, None where they turn about others too.
    """

    values: Mapping[str, Any]
    time: Any
    world: Matrix
    turn: Callable[[Sequence[float]], Any]
    hinge: Callable[[], Any]


@record
class Action:
    """A wrench about the origin of an end; ``local``: in the end's own axes."""

    end: int
    wrench: Wrench
    local: bool = False


@record
class HalfTurn:
    """Where an angle jumps from half a turn to minus half a turn, and the force with it.

    angle : what jumps [rad]. switch : changes its sign there. there : > 0 only there, since a continuous function of
    the attitude changes its sign at one more place (here: 127 deg or more to one side).
    """

    angle: Any
    switch: Any
    there: Any

    @staticmethod
    def of(angle: Any, s: Any, c: Any, r: Any) -> HalfTurn:
        """Return that of a component ``angle`` = a theta of a turn by theta, |a| <= 1.

        It has s = r a sin(theta), c = r cos(theta), r > 0:

        s + 2 (r + c) = r (1 + cos(theta)) (a tan(theta / 2) + 2).
        """
        return HalfTurn(angle, s + 2.0 * (r + c), HALF_TURN * r - (r + c))


@record
class Effect:
    """What an element does: actions, potential energy [J] of the conservative part, power [W] of the rest.

    half_turns : where its angle jumps (see ``HalfTurn``).
    """

    actions: tuple[Action, ...]
    potential: Any = 0.0
    power: Any = 0.0
    half_turns: tuple[HalfTurn, ...] = ()


class ForceElement:
    """Base of the forces on points and between bodies (see the checklist above); their keys fit together in most.

    breakpoints : times at which the slope of the force jumps.
    """

    name: str
    type: str
    role: str = LOAD
    term: ClassVar[str]
    switching: ClassVar[bool] = False
    breakpoints: tuple[float, ...] = ()

    @property
    def references(self) -> tuple[str, ...]:
        """The places that it acts at."""
        raise NotImplementedError

    def problems(self) -> Iterable[tuple[tuple[Any, ...], str]]:
        """Yield what does not fit together: the path of a key, and what is wrong."""
        return ()

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect:
        """Return what it does to its ends."""
        raise NotImplementedError


class InJoint:
    """What most forces in a joint have in common: no potential energy, and keys that always fit together.

    dissipative : whether all of the torque is lost, so that none of it is the gradient of a potential. Such a force may
    act in space: on the angular velocity of a ball joint, or on a velocity. of_load : whether it follows from the load
    on the joint, and not from q and v alone. acts : whether it exerts anything. set_valued, rigid : whether it gives
    the joint a contact state, as friction or as a stop. side : of the gear, on which it acts. role : in a margin of
    motorisation, "" of what takes no part in it.
    """

    dissipative: ClassVar[bool] = False
    of_load: ClassVar[bool] = False
    acts: bool = True
    set_valued: bool = False
    rigid: bool = False
    side: str = "joint"
    role: str = ""

    def problems(self) -> Iterable[tuple[tuple[Any, ...], str]]:
        """Yield what does not fit together: the path of a key, and what is wrong."""
        return ()

    def problems_along(self, in_space: bool) -> Iterable[tuple[tuple[Any, ...], str]]:
        """Yield what does not fit a coordinate, or a rotation or translation in space, as ``problems`` does."""
        if in_space:
            reason = "acts on one coordinate, and this joint turns or moves in any direction"
            yield (), f"{reason}; allowed: joints of one axis, and single coordinates of others"

    def potential(self, q: Any) -> Any:
        """Return the potential energy [J] at position ``q``."""
        return 0.0

    def loss(self, q: Any, qd: Any, gear_ratio: float, smooth: bool) -> Any:
        """Return the part of the torque that is no gradient of the potential, None where there is no such part."""
        return None

    def switches(self, q: Any, qd: Any) -> Sequence[Expr]:
        """Return what changes its sign where the force begins or ends."""
        return ()


class Between(ForceElement):
    """Base of the forces between two places, which most are: they are ``passive``."""

    term: ClassVar[str] = "passive"
    between: tuple[str, ...]

    @property
    def references(self) -> tuple[str, ...]:
        return self.between


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
class LineOfAction:
    """The line between two ends: length l [m], its rate [m/s], the vector from the first end to the second."""

    d: Vector
    length: Any
    rate: Any

    @staticmethod
    def of(ends: tuple[End, ...]) -> LineOfAction:
        d = ends[1].p - ends[0].p
        length = sqrt(dot(d, d))
        return LineOfAction(d, length, dot(d, ends[1].v - ends[0].v) / length)

    def pull(self, tension: Any) -> tuple[Action, ...]:
        """Return the actions of a tension [N], which pulls the ends together where it is positive."""
        force = self.d * (tension / self.length)
        return along(force)


def along(force: Vector) -> tuple[Action, ...]:
    """Return the actions of a force on the first end, and its opposite on the second, along their line."""
    wrench = Wrench(zeros(3), force)
    return Action(0, wrench), Action(1, -wrench)


def half_turn_warning(force: str, time: float) -> str:
    """Return what is said of the first time at which the angle of a force jumps."""
    return (
        f"force {force!r}: its ends are half a turn apart at t = {time:.6g} s, where its angle jumps from one side to "
        "the other and its torque with it; full turns are counted only between bodies that turn about parallels of one "
        "axis"
    )
