"""The configurations in which loops close, found from many starts.

Newton's method runs from quasi-random starts (Halton 1960); solutions that differ by whole turns count as one. The
search finds configurations with a sizeable region of attraction. It does not prove that there are no others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.solve.closure import CLOSED, SAME
from robodyn_cli.spatial.algebra import Array

FEWEST = 48  # starts at least
PATIENCE = 16  # starts without anything new, for each branch found


@record
class ClosureSearch:
    """Configurations (nq,) in the order of discovery, the number of starts, and how many of them closed the loops."""

    found: list[Array]
    starts: int
    closed: int


def halton(count: int, dimensions: int) -> Array:
    """Return the first ``count`` points (count, dimensions) of Halton's sequence in the unit cube, 0 left out."""
    primes: list[int] = []
    candidate = 2
    while len(primes) < dimensions:
        if all(candidate % p for p in primes):
            primes.append(candidate)
        candidate += 1
    points = np.zeros((count, dimensions))
    for column, base in enumerate(primes):
        for k in range(count):
            n, weight = k + 1, 1.0 / base
            while n:
                points[k, column] += weight * (n % base)
                n, weight = n // base, weight / base
    return points


def search(
    close: Callable[[Array], tuple[Array, float]],
    starts: Iterable[Array],
    signature: Callable[[Array], Array],
    accepted: Callable[[Array], bool],
) -> ClosureSearch:
    """Return the configurations that close, in the order in which the starts lead to them.

    Parameters
    ----------
    close : gives the configuration that a start leads to, and what is left of the conditions there.
    starts : configurations (nq,) to begin with; the search ends early when nothing new turns up.
    signature : numbers that agree, to ``SAME``, if and only if configurations do.
    accepted : whether a closed configuration has the attitudes that the closures ask for.
    """
    poses: list[Array] = []
    marks: list[Array] = []
    closed, last, count = 0, 0, 0
    for count, start in enumerate(starts, start=1):
        q, residual = close(start)
        if residual <= CLOSED and accepted(q):
            closed += 1
            mark = signature(q)
            if not any(float(np.abs(mark - other).max(initial=0.0)) < SAME for other in marks):
                poses.append(q)
                marks.append(mark)
                last = count
        if count >= FEWEST and count - last > PATIENCE * (len(poses) + 1):
            break
    return ClosureSearch(poses, count, closed)
