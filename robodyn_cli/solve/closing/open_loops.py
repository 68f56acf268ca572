"""Loops that do not close: the least that is found, in words that claim no more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.errors import GeometryError
from robodyn_cli.record import record
from robodyn_cli.solve.closing.descent import Aligned, descend, starts_around
from robodyn_cli.solve.closure import CLOSED, Numbers, newton, out_of_scale
from robodyn_cli.solve.independent_rows import is_truss
from robodyn_cli.spatial.algebra import Array

BEST = 4  # of the starts that come nearest, from which the least is looked for
GAIN = 1e-5  # part of the sum of squares that its steps must take off
SAME_POSE = 1e-2  # rad, or part of the size, between the least and a pose that closes
BESIDE = 0.1  # likewise: so near to a start another pose than its own is not meant


@record
class Closable:
    """Which coordinates may move while the loops are closed.

    given : whether any has a value. free : velocity coordinates that are not held. missing : those without an initial
    value. turning : places in q of the missing ones that are angles. held : values of the columns of q that are held.
    """

    given: bool
    free: list[int]
    missing: list[int]
    turning: list[int]
    held: dict[str, float]

    @staticmethod
    def of(numbers: Numbers, q: Array, given: Mapping[str, float], hold: Sequence[str]) -> Closable:
        """Return the task of closing the loops from q (nq,); given, hold : columns of q with a value, and those that
        keep theirs."""
        manifold, names = numbers.manifold, numbers.q_names
        # a value for a quaternion counts for all three of its velocities
        columns = [[names[c] for c in manifold.columns(k)] for k in range(numbers.nv)]
        missing = [k for k, own in enumerate(columns) if not any(c in given or c in hold for c in own)]
        place = {k: int(manifold.position[k]) for k in missing}
        return Closable(
            given=bool(given or hold),
            free=[k for k, own in enumerate(columns) if not any(c in hold for c in own)],
            missing=missing,
            turning=[c for k, c in place.items() if c >= 0 and numbers.lengths[k] == 1.0],
            held={name: q[names.index(name)] for name in hold},
        )


def open_loop(numbers: Numbers, task: Closable, tried: Sequence[tuple[float, Array]]) -> GeometryError:
    """Return the error of loops that did not close, with the least sum of squares over all rows [m, rad] near the best
    of what was tried: (residual, configuration) of each start."""
    aligned = Aligned(numbers)
    ones = np.ones(len(aligned.sizes))
    ends = [
        descend(aligned, start, task.free, ones, GAIN)
        for _, start in sorted(tried, key=lambda pair: pair[0])[:BEST]
    ]
    q, least = min(ends, key=lambda end: end[1])
    closed, residual = newton(numbers, q, task.free)
    if (
        residual <= CLOSED
        and np.abs(numbers.manifold.difference(q, closed) / numbers.lengths).max() < SAME_POSE
    ):
        return _closed_elsewhere(numbers, closed)
    start = f"from any of {len(tried)} starts" if len(tried) > 1 else "from where it starts"
    return _other_attitude(numbers, task, q, start) or _smallest_gap(aligned, task, q, least, start)


def _other_attitude(numbers: Numbers, task: Closable, q: Array, start: str) -> GeometryError | None:
    """Return the error of one loop that closes but for its attitude, None where its points do not meet either."""
    if len({row.closure for row in numbers.rows}) > 1:
        return None
    rows = [k for k, row in enumerate(numbers.rows) if row.kind in ("force", "m")]
    turns = [k for k in range(len(numbers.rows)) if k not in rows]
    if not turns:
        return None
    meeting = _Some(numbers, rows)
    starts = [q, *starts_around(numbers, q, task.free, 1.0, 5)] if rows else [q]
    closed = [
        there for there, left in (newton(meeting, start, task.free) for start in starts) if left <= CLOSED
    ]
    if not closed:
        return None
    nearest = min(closed, key=lambda there: float(np.abs(numbers.eta(there)[turns]).max()))
    eta = numbers.eta(nearest)
    worst = max(turns, key=lambda k: abs(eta[k]))
    row, angle = numbers.rows[worst], float(np.arcsin(min(1.0, abs(eta[worst]))))
    return GeometryError(
        f"the loop {row.closure!r} does not close {start}: its points meet, but not in the attitude asked for: the "
        f"nearest found leaves axes {angle:.6g} rad apart (row {row.name}){_condition(task)}; check the axis, the rpy "
        "and the kind of closure",
        loop=row.closure, angle=angle, row=row.name, q=nearest.tolist(),
    )  # fmt: skip


class _Some:
    """The conditions of some rows (see ``Conditions``)."""

    def __init__(self, numbers: Numbers, rows: list[int]) -> None:
        self._numbers, self._rows = numbers, rows
        self.lengths, self.sizes = numbers.lengths, numbers.sizes[rows]

    def at(self, q: Array, t: float) -> tuple[Array, Array]:
        F, J = self._numbers.at(q, t)
        return F[self._rows], J[self._rows]

    def step(self, q: Array, dq: Array) -> Array:
        return self._numbers.step(q, dq)


def _condition(task: Closable) -> str:
    held = ", ".join(f"{name} = {value:.6g}" for name, value in task.held.items())
    return f" with {held} held" if held else ""


def _closed_elsewhere(numbers: Numbers, q: Array) -> GeometryError:
    """Return the error of loops that close, but far from the start or in another attitude."""
    names = ", ".join(numbers.turned(q))
    if not names:
        there = ", ".join(f"{n} {x:.6g}" for n, x in zip(numbers.q_names, q))
        text = (
            f"the loops close only far from 'initial.q', at {there}; give a start near that, or another one"
        )
        return GeometryError(text, gap=0.0, q=q.tolist())
    text = f"the loops closed only with {names} {_turned_words(numbers, q)}"
    return GeometryError(text, loop=names, gap=0.0, q=q.tolist())


def _turned_words(numbers: Numbers, q: Array) -> str:
    turned = numbers.turned(q)
    attitudes = [row.attitude for row in numbers.rows if row.closure in turned and row.attitude is not None]
    if all(x.of_axes for x in attitudes):
        return "upside down: the axes of its two links point opposite ways; check its axis and axis2"
    return "in another attitude than asked for; check its rpy"


def refuse_turned(numbers: Numbers, task: Closable, q: Array, closed: Array, residual: float) -> None:
    """Refuse a start q (nq,) with all its values given that closes there or right beside, but half a turn off.

    No other pose is meant.

    Raises
    ------
    GeometryError
    """
    moved = np.abs(numbers.manifold.difference(q, closed) / numbers.lengths).max(initial=0.0)
    if task.missing or residual > CLOSED or moved > BESIDE or not numbers.turned(closed):
        return
    names = ", ".join(numbers.turned(closed))
    text = f"'initial.q' closes the loops with {names} {_turned_words(numbers, closed)}, or start in another pose"
    raise GeometryError(text, loop=names, gap=0.0, q=closed.tolist())


def _where_free(numbers: Numbers, task: Closable, q: Array) -> str:
    """Return words about where the loops close with nothing held."""
    if not task.held:
        return ""
    free, residual = newton(numbers, q, range(numbers.nv))
    if residual > CLOSED or numbers.turned(free):
        return ""
    free = np.where(np.abs(free) > CLOSED, free, 0.0)  # what is left of a zero
    pose = ", ".join(f"{name} {x:.6g}" for name, x in zip(numbers.q_names, free))
    loops = ", ".join(dict.fromkeys(row.closure for row in numbers.rows))
    stuck = f", where nothing can move: {loops} make a truss" if is_truss(numbers.psi(free)) else ""
    return f"; with nothing held the loops close at {pose}{stuck}"


def _smallest_gap(aligned: Aligned, task: Closable, q: Array, least: float, start: str) -> GeometryError:
    """Return the error of the loop with the largest part of what is left at q, where the loops come nearest to
    closing."""
    numbers = aligned.numbers
    F, _ = aligned.at(q, 0.0)
    parts = {loop: np.zeros(2) for loop in aligned.loops}  # squares of metres and of radians
    for value, loop, size in zip(F, aligned.loops, aligned.units):
        parts[loop][0 if size == "m" else 1] += value**2
    loop = max(parts, key=lambda name: float(parts[name].sum()))
    gap, angle = (float(x) for x in np.sqrt(parts[loop]))
    condition = _condition(task) + _where_free(numbers, task, q)
    eta = numbers.eta(q)
    row = numbers.rows[
        max((k for k, r in enumerate(numbers.rows) if r.closure == loop), key=lambda k: abs(eta[k]))
    ]
    known = {"residual": least, "row": row.name, "q": q.tolist()}
    if loop in numbers.couplers:
        apart = abs(float(eta[numbers.rows.index(row)]))
        text = (
            f"the coupler {loop!r} does not hold {start}: at best its terms miss its offset by {apart:.6g} "
        )
        return GeometryError(f"{text}{row.unit}{condition}", coupler=loop, gap=apart, **known)
    left = " and ".join(
        text
        for x, text in ((gap, f"a gap of {gap:.6g} m"), (angle, f"{angle:.6g} rad between axes"))
        if x > 1e-9
    )
    text = f"the loop {loop!r} does not close {start}: at best {left} remains{condition}"
    if angle > 1e-9 or len(parts) > 1:
        text += (
            f"; the least that was found leaves {least:.5g} over all loops (root of the sum of squares of all rows, m "
            "and rad), which proves nothing about other poses"
        )
    text += out_of_scale(numbers.model)
    return GeometryError(text, loop=loop, gap=gap, angle=angle, **known)
