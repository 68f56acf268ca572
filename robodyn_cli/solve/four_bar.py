"""Closed chains of four links in a plane, with four pins or with three pins and a slide: which links turn fully against
which (Grashof), and where each joint is in a dead point.

With four pins and s, l, p, q the shortest, the longest and the other lengths, the shortest link turns fully against all
others if s + l < p + q. A slide is a pin far away: with lengths a, b and the offset e of its line from the pin that is
not on it, the shorter of a, b turns fully if min(a, b) + e < max(a, b). Equality is a change point: all pins come in
line, and the chain may go on in either way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

ROUNDED = 1e-13  # part of the lengths that rounding leaves of a difference of lengths
TURN = 2.0 * math.pi


@record
class DeadPose:
    """A position of a joint in which the two links beyond it are in line (or across a slide), and its error.

    outer : whether they are stretched, not folded.
    """

    value: float
    error: float
    outer: bool


@record
class JointReach:
    """Where a joint may go: from one dead point to another; both None where it turns fully."""

    low: DeadPose | None
    high: DeadPose | None


@record
class FourBar:
    """Four links in a plane: pins (3 or 4, 2) [m], of which link k joins k and k + 1; slide : the direction (2,) of the
    slide between link 2 and link 3 where there are three pins."""

    pins: Array
    slide: Array | None = None

    @property
    def lengths(self) -> Array:
        """Lengths (4,) of the links [m]; (2,) with a slide, whose links have none."""
        if self.slide is not None:
            return np.asarray(np.linalg.norm(np.diff(self.pins, axis=0), axis=1))
        return np.asarray(np.linalg.norm(np.roll(self.pins, -1, axis=0) - self.pins, axis=1))

    @property
    def across(self) -> Array:
        """The normal (2,) of the slide's line."""
        assert self.slide is not None
        return np.array([-self.slide[1], self.slide[0]])

    @property
    def offset(self) -> float:
        """The distance of pin 2 from pin 0 across the slide, with its sign [m]."""
        return float((self.pins[2] - self.pins[0]) @ self.across)

    @property
    def margin(self) -> tuple[float, float]:
        """p + q - s - l, or max(a, b) - min(a, b) - e [m], and its error: positive where a link turns fully."""
        L = np.sort(self.lengths)
        if self.slide is not None:
            e = abs(self.offset)
            return float(L[1] - L[0] - e), ROUNDED * float(L.sum() + np.abs(self.pins).max())
        return float(L[1] + L[2] - L[0] - L[3]), ROUNDED * float(L.sum() + np.abs(self.pins).max())

    @property
    def is_change_point(self) -> bool:
        """Whether all pins come in line."""
        margin, error = self.margin
        return abs(margin) <= error

    @property
    def turning(self) -> list[int]:
        """The pins that turn fully: those of the shortest link."""
        if self.is_change_point or self.margin[0] < 0.0:
            return []
        k = int(np.argmin(self.lengths))
        return [k, (k + 1) % len(self.pins)]

    def name(self, fixed: int) -> str:
        """Return what the chain is called with a link fixed."""
        if self.is_change_point:
            return self._change_point()
        with_slide = self.slide is not None and fixed >= 2
        own = ([2] if fixed == 2 else [0]) if with_slide else [fixed, (fixed + 1) % len(self.pins)]
        full = len([pin for pin in own if pin in self.turning])
        if with_slide:
            return "crank and slider" if full else "rocker and slider"
        return ("double crank", "crank-rocker", "double rocker", "triple rocker")[
            3 if not self.turning else 2 - full if full != 1 else 1
        ]

    def _change_point(self) -> str:
        """Return the name of a chain with a change point."""
        L, rounding = self.lengths, self.margin[1]
        if self.slide is not None:
            return "change point"
        alike = np.abs(L[:, None] - L) <= rounding
        if alike.all():
            return "change point: rhombus"
        if alike[0, 2] and alike[1, 3]:
            return "change point: parallelogram"
        if (alike[0, 1] and alike[2, 3]) or (alike[1, 2] and alike[3, 0]):
            return "change point: kite"
        return "change point"

    def at_pin(self, k: int) -> tuple[float, JointReach]:
        """Return the angle at a pin, from link k to the one before it, and where it may go [rad].

        At pin 0 of a chain with a slide it is that from the slide's direction to link 0, at pin 2 to link 1.
        """
        if self.slide is None:
            n = len(self.pins)
            L, here = self.lengths, self.pins[k]
            theta = _angle(self.pins[(k + 1) % n] - here, self.pins[k - 1] - here)
            A, D, B, C = L[k - 1], L[k], L[(k + 1) % n], L[(k + 2) % n]
            return theta, _hinge(theta, self._cosine(A, D, B + C), self._cosine(A, D, B - C))
        a, b = self.lengths
        if k == 1:
            theta = _angle(self.pins[2] - self.pins[1], self.pins[0] - self.pins[1])
            return theta, _hinge(theta, (-math.inf, 0.0), self._cosine(a, b, self.offset))
        arm, reach, e = (a, b, self.offset) if k == 0 else (b, a, -self.offset)
        theta = _angle(self.slide, self.pins[1] - self.pins[k])
        doubt = 4.0 * ROUNDED * (a + b + abs(e)) / arm
        return theta, _swing(theta, ((e - reach) / arm, doubt), ((e + reach) / arm, doubt))

    def at_slide(self) -> tuple[float, JointReach]:
        """Return where pin 2 is from pin 0 along the slide, and where it may go [m]."""
        assert self.slide is not None
        x, e, doubt = float((self.pins[2] - self.pins[0]) @ self.slide), self.offset, self.margin[1]
        a, b = self.lengths
        (most, most_off), (least, least_off) = (
            _root(size * size - e * e, 2.0 * (a + b) * doubt) for size in (a + b, a - b)
        )
        outer = DeadPose(most, most_off, True)
        if abs(a - b) < abs(e) - doubt:
            return x, JointReach(_mirrored(outer, -1.0), outer)
        sign = -1.0 if x < 0.0 else 1.0
        ends = _mirrored(DeadPose(least, least_off, False), sign), _mirrored(outer, sign)
        return x, JointReach(*(ends if sign > 0.0 else ends[::-1]))

    def _cosine(self, A: float, D: float, opposite: float) -> tuple[float, float]:
        """Return the cosine between sides A and D of a triangle, and its error."""
        doubt = 4.0 * ROUNDED * (A + D + abs(opposite)) ** 2 / (2.0 * A * D)
        return (A * A + D * D - opposite * opposite) / (2.0 * A * D), doubt

    def dead_pose(self, pin: int, moved: float, fixed: int, outer: bool) -> Array | None:
        """Return the pins with the angle at a pin of the fixed link changed by ``moved``, to a dead point there.

        None where nothing says how the links beyond it lie. With a slide the last one is the foot of its line.
        """
        n, pins = len(self.pins), self.pins.copy()
        if self.slide is not None:
            return self._dead_with_slide(pin, moved, fixed)
        # the neighbour that moves, and the pin of the fixed link beyond ``pin``
        other, beyond, sign = (pin - 1, pin + 1, 1.0) if fixed == pin else (pin + 1, pin - 1, -1.0)
        other, beyond, last = other % n, beyond % n, (pin + 2) % n
        pins[other] = pins[pin] + _turned(pins[other] - pins[pin], sign * moved)
        way = pins[other] - pins[beyond]
        size = float(np.linalg.norm(way))
        if size <= ROUNDED * float(self.lengths.sum()):
            return None
        near, far = (float(np.linalg.norm(self.pins[last] - self.pins[k])) for k in (beyond, other))
        pins[last] = pins[beyond] + (near if outer or near > far else -near) / size * way
        return pins

    def _dead_with_slide(self, pin: int, moved: float, fixed: int) -> Array | None:
        """Return the pins and the foot with a slide: the link that is fixed has its guide (3), or pins 0 and 1 (0)."""
        assert self.slide is not None
        pins, across = self.pins.copy(), self.across
        if fixed == 3:  # link 1 is across the slide
            pins[1] = pins[0] + _turned(pins[1] - pins[0], moved)
            pins[2] = pins[0] + self.offset * across + ((pins[1] - pins[0]) @ self.slide) * self.slide
        elif pin == 0:  # link 1 is across the slide, which has turned
            across = _turned(across, -moved)
            pins[2] = pins[1] + (self.offset - (pins[1] - pins[0]) @ across) * across
        else:  # pin 2 is as near to pin 0 as the slide's line
            pins[2] = pins[1] + _turned(pins[2] - pins[1], -moved)
            if abs(self.offset) <= ROUNDED * float(self.lengths.sum()):
                return None
            across = (pins[2] - pins[0]) / self.offset
        return np.vstack([pins, pins[0] + self.offset * across])

    @property
    def backwards(self) -> FourBar:
        """The same chain with a slide, its pins counted from the other end: links 0 and 1, and 2 and 3, change."""
        assert self.slide is not None
        return FourBar(self.pins[::-1], -self.slide)

    @property
    def drawn(self) -> Array:
        """The pins (4, 2), of a slide the foot of its line from pin 0 the last one."""
        return (
            self.pins
            if self.slide is None
            else np.vstack([self.pins, self.pins[0] + self.offset * self.across])
        )

    def dead_slide(self, end: DeadPose) -> Array | None:
        """Return the pins with the slide in a dead point, both links in a line; None where that has no direction."""
        assert self.slide is not None
        (a, b), pins = self.lengths, self.pins.copy()
        pins[2] = pins[0] + self.offset * self.across + end.value * self.slide
        way = pins[2] - pins[0]
        size = float(np.linalg.norm(way))
        if size <= ROUNDED * float(a + b):
            return None
        pins[1] = pins[0] + (a if end.outer or a > b else -a) / size * way
        return np.vstack([pins, self.drawn[3]])


def _angle(first: Array, second: Array) -> float:
    """Return the angle from one vector (2,) to another, in (-pi, pi]."""
    return math.atan2(first[0] * second[1] - first[1] * second[0], float(first @ second))


def _turned(x: Array, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * x[0] - s * x[1], s * x[0] + c * x[1]])


def _mirrored(point: DeadPose, sign: float) -> DeadPose:
    return DeadPose(sign * point.value, point.error, point.outer)


def _root(square: float, error: float) -> tuple[float, float]:
    """Return a length from its square, and its error."""
    root, most = math.sqrt(max(square, 0.0)), math.sqrt(max(square, 0.0) + error)
    return root, max(most - root, root - math.sqrt(max(square - error, 0.0)))


def _inverse(value: float, doubt: float, function: str) -> tuple[float, float]:
    """Return the arc of a cosine or sine, and its error, which is a root where the curve is flat."""
    arc = math.acos if function == "acos" else math.asin
    middle, *ends = (arc(min(1.0, max(-1.0, x))) for x in (value, value - doubt, value + doubt))
    # rounding takes as much beyond the end as it leaves before it
    return middle, max(
        max(abs(x - middle) for x in ends), math.sqrt(2.0 * doubt) * (abs(value) > 1.0 - doubt)
    )


def _hinge(theta: float, outer: tuple[float, float], inner: tuple[float, float]) -> JointReach:
    """Return where an angle may go between the cosines of the stretched and of the folded pose."""
    has_outer, has_inner = outer[0] > -1.0 - outer[1], inner[0] < 1.0 + inner[1]
    most = DeadPose(*_inverse(*outer, "acos"), True) if has_outer else None
    least = DeadPose(*_inverse(*inner, "acos"), False) if has_inner else None
    sign = -1.0 if theta < 0.0 else 1.0
    if most is None and least is None:
        return JointReach(None, None)
    if least is None:
        assert most is not None
        return JointReach(_mirrored(most, -1.0), most)
    if most is None:
        most = DeadPose(TURN - least.value, least.error, False)
    ends = _mirrored(least, sign), _mirrored(most, sign)
    return JointReach(*(ends if sign > 0.0 else ends[::-1]))


def _swing(theta: float, low: tuple[float, float], high: tuple[float, float]) -> JointReach:
    """Return where an angle may go whose sine has bounds, each with its error."""
    below, above = low[0] > -1.0 - low[1], high[0] < 1.0 + high[1]
    least, most = (_inverse(*side, "asin") for side in (low, high))
    if not below and not above:
        return JointReach(None, None)
    if below and above:
        ends = [(least, most), ((math.pi - most[0], most[1]), (math.pi - least[0], least[1]))]
    elif below:
        ends = [(least, (math.pi - least[0], least[1]))]
    else:
        ends = [((math.pi - most[0], most[1]), (TURN + most[0], most[1]))]
    return _around(theta, ends)


def _around(theta: float, ends: Sequence[tuple[tuple[float, float], tuple[float, float]]]) -> JointReach:
    """Return that interval, moved by whole turns, which holds an angle, or is nearest to it."""
    moved = [(one, two, turn) for one, two in ends for turn in (-TURN, 0.0, TURN)]
    one, two, turn = min(moved, key=lambda x: max(x[0][0] + x[2] - theta, theta - x[1][0] - x[2], 0.0))
    return JointReach(DeadPose(one[0] + turn, one[1], True), DeadPose(two[0] + turn, two[1], True))
