"""Fixed steps that an event cuts."""

from __future__ import annotations

import math

from robodyn_cli.integrators.runtime.layout import resolution

CLOSE = 1e-9  # of a fixed step before a jump: a step from there may see the other side
PART = 1e-2  # of what is left to a jump is left again by a step towards it


class Approach:
    """Where steps end before an event.

    step : fixed [s], None without. halves : whether a step that is cut is cut in two.
    """

    def __init__(self, step: float | None, halves: bool) -> None:
        self.step, self.halves = step, halves
        self.last = math.nan

    def stopover(self, start: float, time: float, jumps: bool) -> float | None:
        """Return where a step from ``start`` that an event cuts at ``time`` ends before it, None where it goes there.

        A stage at the end of a step that ends at a jump of the rates may lie beyond it, so steps come close first.
        An event cuts a step to the same length whatever the step asked for: a second integration goes there in two.
        """
        if self.step is None:
            return None
        left = time - start
        if self.halves and start != self.last:
            left *= 0.5
        elif jumps and left > CLOSE * self.step + resolution(start, time):
            left *= PART
        else:
            return None
        self.last = time - left
        return self.last
