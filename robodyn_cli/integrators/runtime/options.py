"""Options of a run, and its counters."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from robodyn_cli.record import mutable_record, record


@mutable_record
class Counters:
    """Counts of what a run did."""

    steps: int = 0
    rejected: int = 0
    evaluations: int = 0
    projections: int = 0
    events: int = 0

    def __add__(self, other: Counters) -> Counters:
        return Counters(**{k: v + getattr(other, k) for k, v in self.as_dict().items()})

    @property
    def attempts(self) -> int:
        """Steps, rejected ones too."""
        return self.steps + self.rejected

    def as_dict(self) -> dict[str, int]:
        return dataclasses.asdict(self)


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
