"""Locating events: from a step that contains an event to the state at the event.

The compiled loop looks at dense output only to see that some function changes sign in a step. Here the motion
is integrated to trial times by steps that end there, which have the full order of the method, so that an event
is as accurate as the states themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.events import EventFunction
from robodyn_cli.integrators.runtime.memory import resolution
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

Numbers = Sequence[float] | Array
Values = Callable[[float], Numbers]

Point = tuple[float, float]  # a time, and the value of a function there

TRIALS = 200
RISES = 8  # halvings of a bracket in which a function is looked for that rises from zero and falls again
PATIENCE = 3  # secant steps that may fail to halve the bracket before it is bisected; fewer each time


def chatter(event: EventFunction, time: float) -> NumericalError:
    """Return the error of a function that changes its sign again and again while time stands still."""
    advice = (
        "; make its jump a steep slope, as in tanh(x/0.001) for sign(x)" if event.is_discontinuity else ""
    )
    return NumericalError(
        f"{event.name} keeps switching back and forth (chattering) at t = {time:.6g} s{advice}",
        time=time, status="chatter",
    )  # fmt: skip


@record
class Root:
    """A sign change of function ``index`` in (low, high]; ``sign`` is the one beyond it."""

    index: int
    low: float
    high: float
    sign: float


@record
class LocatedRoots:
    """The time to go to, and the functions that change sign there (none: go there and search on)."""

    time: float
    roots: tuple[Root, ...] = ()


def first_roots(
    events: Sequence[EventFunction],
    values: Values,
    armed: Numbers,
    seen: int,
    times: tuple[float, float, float],
) -> LocatedRoots:
    """Find the first sign change in a step, and all that coincide with it.

    Parameters
    ----------
    values : the event functions at a time; NaN where the motion cannot be followed that far.
    armed : values before the step; at zero, any value of the side that the function came from.
    seen : the function that dense output saw change sign.
    times : start of the step, and the bracket in which dense output saw the change.
    """
    start, low, high = times
    before = armed
    for a, b in ((start, low), (low, high)):
        if b <= a:
            continue
        after = values(b)
        lost = math.isnan(after[seen])
        roots = []
        for k, event in enumerate(events):
            if event.crosses(before[k], after[k]) or (lost and k == seen and before[k] != 0.0):
                bracket = (a, float(before[k])), (b, float(after[k]))
                root = _root(k, values, *bracket, event.is_discontinuity)
                if root is None:
                    # no motion beyond the last time that still has the old sign
                    return LocatedRoots(_last_followed(k, values, a, float(before[k]), b))
                roots.append(root)
        if roots:
            bound = min(r.high for r in roots) + 2.0 * resolution(start, high)
            together = tuple(r for r in roots if r.high <= bound)
            return LocatedRoots(max(r.high for r in together), together)
        before = [x if y == 0.0 else y for x, y in zip(before, after)]
    return LocatedRoots(high)


def _root(index: int, values: Values, low: Point, high: Point, strict: bool = False) -> Root | None:
    """Bracket the sign change between two times by regula falsi; None where there is none.

    low, high : time and value of the function.
    strict : zero counts as the old side. ``where`` takes zero for negative, so a run that stopped exactly at zero
    would go on with the old right-hand side.
    """
    (a, g_a), (b, g_b) = low, high
    sign, side, exact = math.copysign(1.0, g_a) if g_a else 0.0, 0, False
    g_a = float(values(a)[index])
    if g_a * sign < 0.0 or (g_a * sign == 0.0 and not (strict and sign)):
        risen = _risen(index, values, a, b, sign) if g_a == 0.0 and sign else None
        if risen is None:
            return Root(index, a, a, -sign)  # it was zero from the start
        a, g_a = risen
    fine = resolution(a, b)
    goal, patience, wasted = 0.5 * (b - a), PATIENCE, 0
    for _ in range(TRIALS):
        if b - a <= fine or exact:
            break
        if b - a <= goal:
            goal, wasted = 0.5 * (b - a), 0
        middle = 0.5 * (a + b)
        if wasted >= patience:
            patience, wasted = max(patience - 1, 1), 0
        elif math.isfinite(g_b) and g_b != g_a:
            wasted += 1
            secant = b - g_b * (b - a) / (g_b - g_a)
            # a point too close to an end would not shorten the bracket
            middle = min(max(secant, a + 0.5 * fine), b - 0.5 * fine)
        if not a < middle < b:
            break
        g = float(values(middle)[index])
        if g * sign > 0.0 or (strict and g == 0.0):
            g_b *= _weight(g, g_a) if side < 0 else 1.0
            a, g_a, side = middle, g, -1
        else:
            g_a *= _weight(g, g_b) if side > 0 else 1.0
            b, g_b, exact, side = middle, g, g == 0.0, 1
    if exact:
        a = max(a, b - fine)  # the root itself was met
    return Root(index, a, b, -sign) if math.isfinite(g_b) else None


def _risen(index: int, values: Values, a: float, b: float, sign: float) -> Point | None:
    """Return where a function that is zero at ``a`` has taken this sign before it loses it until ``b``; None nowhere.

    A joint that has just bounced leaves its stop from zero and may be back within the step.
    """
    for k in range(1, RISES + 1):
        place = a + 0.5**k * (b - a)
        value = float(values(place)[index])
        if value * sign > 0.0:
            return place, value
    return None


def _weight(new: float, old: float) -> float:
    """Return by how much the value at the end that stayed counts less (Anderson and Bjorck 1973)."""
    weight = 1.0 - new / old if old else 0.5
    return weight if weight > 0.0 else 0.5


def _last_followed(index: int, values: Values, a: float, g_a: float, b: float) -> float:
    """Return the latest time up to which the function keeps its sign and the motion can be followed."""
    while True:
        middle = 0.5 * (a + b)
        if b - a <= resolution(a, b) or not a < middle < b:
            return a
        if values(middle)[index] * g_a > 0.0:
            a = middle
        else:
            b = middle
