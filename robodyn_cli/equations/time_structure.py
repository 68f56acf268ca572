"""Where a function of time changes too fast for steps to notice: jumps of its value or slope, and features much
shorter than the run.

``discontinuities`` finds where formulas with ``abs``, ``if`` and the like switch, but ``sqrt((t - 1)^2)`` or
``atan2(sin(t), cos(t))`` jump as well, and no method sees a pulse that is shorter than the gaps between its stages.
Both are found before the run, by bisection with interval bounds of the function and of its slope: an interval is halved
until the function is smooth in it and nearly a straight line.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.graph import Expr, Scalar, reachable
from robodyn_cli.expr.intervals import Bounds, bounds
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

Flags = NDArray[np.bool_]
STRAIGHT = 0.25  # part of its range by which a function may bend within an interval that is not halved
TURNED = 0.05  # part of the steepest slope by which its slope must change for an interval to count as bent
ROUNDING = 1e-13
BENT = 1e-3  # part of its range by which a function really bends in an interval that is short for it
SHORT = 1 / 256  # part of the duration: shorter features are reported
FINEST = 2.0**-44  # part of the duration at which bisection ends: a point
STEADY = frozenset({"sym", "const", "add", "sub", "mul", "neg", "sin", "cos"})
MOST = 20_000  # intervals of one length that are examined for one function
MOST_POINTS = 1_000
FINER = 8.0  # from one scale of features to the next
BESIDE_POINTS = 64.0  # lengths from a point within which an interval is short because of it
BESIDE = 1e-7  # part of the duration: distance from a point at which both sides are evaluated
FOUND_TO = 1e-9  # part of the duration to which bisection locates a point
APART = 1e-3  # by how much sides differ, over what the function does nearby, to count as a jump


@record
class TimeStructure:
    """points : times at which the value or the slope jumps [s]. edges : times between which the function changes on
    another scale [s].

    resolved : whether all of it was found within the work allowed.
    """

    points: tuple[float, ...]
    edges: tuple[float, ...]
    resolved: bool = True


def functions_of_time(outputs: Iterable[Scalar], t: Expr) -> list[Expr]:
    """Return the largest parts of expressions that depend on time alone, but for t itself, each once."""
    nodes = reachable(outputs)
    of_time: dict[int, bool] = {}
    for node in nodes:
        of_time[node.index] = node is t if node.op == "sym" else any(of_time[a.index] for a in node.args)
        if node.op not in ("sym", "const") and not all(
            a.op == "const" or of_time[a.index] for a in node.args
        ):
            of_time[node.index] = False
    used = {a.index for node in nodes if of_time[node.index] for a in node.args}
    return [n for n in nodes if of_time[n.index] and n is not t and n.index not in used]


def is_steady(function: Expr) -> bool:
    """Tell whether a function of time is made of sums and products of t and of sines: whatever its numbers are, it
    neither jumps nor bends, and has no pulse that steps may miss, for it varies all along the run."""
    return all(node.op in STEADY for node in reachable([function]))


def structure(function: Expr, t: Expr, duration: float) -> TimeStructure:
    """Return where an expression of t alone is not smooth, or has features much shorter than ``duration`` [s]."""
    slope = jacobian([function], [t])[0].get(0, 0.0)
    if not isinstance(slope, Expr) and not _switches_inside(function):
        return TimeStructure((), ())
    span = _Span(function, t, duration)
    leaves: list[Array] = []
    points: list[Array] = []
    low, high, rough_before = np.zeros(1), np.full(1, duration), np.zeros(1, dtype=bool)
    resolved = True
    while len(low):
        value, rate = bounds(function, t, low, high), bounds(slope, t, low, high)
        rough = value.rough | rate.rough
        plain = ~rough & _nearly_straight(value, rate, high - low, span.widened(0.5 * (low + high)))
        leaves.append(np.stack([low[plain], high[plain], rough_before[plain]]))
        low, high, rough = low[~plain], high[~plain], rough[~plain]
        if not len(low):
            break
        if len(low) > MOST or (high - low)[0] <= FINEST * duration:
            points.append(_centres(low, high, duration))
            resolved = len(points[-1]) <= MOST_POINTS
            break
        middle = 0.5 * (low + high)
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        rough_before = np.concatenate([rough, rough])
    doubtful = points[0].tolist() if points and resolved else []
    unsmooth = [x for x in doubtful if _is_rough(function, slope, x, duration)]
    ends = np.concatenate(leaves, axis=1)
    ends = ends[:, np.argsort(ends[0])]
    bent = _really_bent(function, ends[0], ends[1], span.widened(ends[0]))
    edges = np.array(_edges(ends, bent, doubtful, duration))
    # a step must not end where a quotient of two zeros has no value
    (there,) = _values([function], edges)
    return TimeStructure(tuple(unsmooth), tuple(edges[np.isfinite(there)].tolist()), resolved)


def _really_bent(function: Expr, low: Array, high: Array, span: float) -> Flags:
    """Tell in which intervals a function bends, in its value or its slope; its bounds may be far too wide."""
    ends = [low, 0.75 * low + 0.25 * high, 0.5 * (low + high), 0.25 * low + 0.75 * high, high]
    y = np.array([_values([function], x)[0] for x in ends])
    with np.errstate(all="ignore"):
        bend = np.abs(y[:-2] - 2.0 * y[1:-1] + y[2:]).max(axis=0)
        slopes = (y[2::2] - y[:-2:2]) / (0.5 * (high - low))
        steepest = np.abs(slopes[np.isfinite(slopes)]).max(initial=0.0)
        turn = np.abs(slopes[1] - slopes[0])
        seen = bend > ROUNDING * np.abs(y).max(axis=0)
        bent: Flags = (bend > BENT * span) | ((turn > TURNED * steepest) & seen)
    return bent


def _nearly_straight(value: Bounds, rate: Bounds, length: Array, span: float) -> Flags:
    """Tell in which intervals a function bends by a small part of its span, and cannot jump."""
    with np.errstate(all="ignore"):
        bend = (rate.high - rate.low) * length
        steepest = np.maximum(np.abs(rate.low), np.abs(rate.high)) * length
        straight: Flags = (bend <= STRAIGHT * span) & (
            value.high - value.low <= STRAIGHT * span + 4.0 * steepest
        )
    return straight


class _Span:
    """How far a function ranges, by all values seen so far."""

    def __init__(self, function: Expr, t: Expr, duration: float) -> None:
        self.function, self.t = function, t
        self.low, self.high = np.inf, -np.inf
        self.widened(np.linspace(0.0, duration, 1025))

    def widened(self, times: Array) -> float:
        """Return the span, values at ``times`` included; no less than the rounding of the values."""
        (values,) = _values([self.function], times)
        values = values[np.isfinite(values)]
        if len(values):
            self.low, self.high = min(self.low, float(values.min())), max(self.high, float(values.max()))
        size = max(abs(self.low), abs(self.high))
        return max(self.high - self.low, 1e-9 * size, 1e-300) if np.isfinite(size) else 1.0


def beside(corners: TimeStructure, known: Collection[float], duration: float) -> list[float]:
    """Return the times at which a step has to end for a structure, without those that are ``known`` more exactly."""
    near = FOUND_TO * duration
    points = [x for x in corners.points if not any(abs(x - other) < near for other in known)]
    return [*points, *corners.edges]


def _switches_inside(function: Expr) -> bool:
    return any(
        node.op in ("atan2", "sign", "where", "table", "min", "max", "abs") for node in reachable([function])
    )


def _values(entries: list[Scalar], times: Array) -> list[Array]:
    with np.errstate(all="ignore"):
        arrays = evaluate(entries, {"t": [times]})
    return [np.asarray(x, dtype=float) * np.ones(len(times)) for x in arrays]


def _centres(low: Array, high: Array, duration: float) -> Array:
    """Return the middles of the stretches that intervals of one length cover, without the ends of the run."""
    order = np.argsort(low)
    low, high = low[order], high[order]
    first = np.append(True, low[1:] > high[:-1] + FINEST * duration)
    starts, ends = low[first], high[np.append(first[1:], True)]
    middles = 0.5 * (starts + ends)
    return middles[(starts > 0.0) & (ends < duration)]


def _is_rough(function: Expr, slope: Scalar, time: float, duration: float) -> bool:
    """Tell whether value or slope really jump at ``time``; a quotient of two zeros may be smooth."""
    step = BESIDE * duration
    value, rate = _values([function, slope], time + step * np.array([-2.0, -1.0, 1.0, 2.0]))
    if not (np.all(np.isfinite(value)) and np.all(np.isfinite(rate))):
        return True
    # carried on from the left, and from the right, to the middle
    left, right = 2.0 * value[1] - value[0], 2.0 * value[2] - value[3]
    level, steep = np.abs(value).max() + step * np.abs(rate).max(), np.abs(rate).max()
    jump = abs(right - left) > APART * max(level, 1e-300) * 1e-3 + 4.0 * step * steep
    bend = abs(rate[2] - rate[1]) > APART * max(steep, 1e-300) + 4.0 * max(
        abs(rate[1] - rate[0]), abs(rate[3] - rate[2])
    )
    return bool(jump or bend)


def _edges(leaves: Array, bent: Flags, points: Sequence[float], duration: float) -> tuple[float, ...]:
    """Return the ends of the stretches of short intervals (3, n), for each scale: a step then begins where one begins.

    Intervals that are short only because one of the ``points`` that are not smooth lies beside them do not count, nor
    do stretches in which the function does not bend.
    """
    low, high, beside = leaves
    near = np.zeros(len(low), dtype=bool)
    for x in points:
        near |= np.abs(0.5 * (low + high) - x) < BESIDE_POINTS * (high - low)
    length = np.where((beside > 0.0) | near, np.inf, high - low)
    edges: set[float] = set()
    limit = SHORT * duration
    while limit > FINEST * duration:
        short = np.concatenate([[False], length < limit, [False]])
        if not short.any():
            break
        (begins,) = np.nonzero(short[1:-1] & ~short[:-2])
        (ends,) = np.nonzero(short[1:-1] & ~short[2:])
        for first, last in zip(begins.tolist(), ends.tolist()):
            if bent[first : last + 1].any():
                edges.update((float(low[first]), float(high[last])))
        limit /= FINER
    return tuple(sorted(x for x in edges if 0.0 < x < duration))
