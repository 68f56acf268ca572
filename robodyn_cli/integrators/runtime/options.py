"""Options of a run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robodyn_cli.record import record


@record
class Options:
    """How to integrate; ``step`` is for methods without step control.

    first : the first steps of a run and behind events, as a part of the usual ones.
    """

    rtol: float = 1e-10
    atol: float = 1e-12
    step: float | None = None
    max_step: float = math.inf
    max_steps: int = 10_000_000
    first: float = 1.0

    def part_of_way(self, step: Any, left: Any) -> Any:
        """Return a step that has so much time left, numbers or arrays.

        Where first steps are shorter, it takes only a part of the way.

        A stretch that is shorter than the steps of two integrations would be one and the same step of both, so that
        they share its error.
        """
        return step if self.first >= 1.0 else np.minimum(step, self.first * left)
