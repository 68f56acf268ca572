"""What methods are judged by: a solution that two of them agree on; when a run counts as too slow."""

from __future__ import annotations

import time

import numpy as np

from robodyn_cli.errors import NumericalError, RobodynError
from robodyn_cli.integration_methods import METHODS
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.stability import ReferenceKeys

SAMPLES = 257  # instants at which solutions are compared


def tight(name: str) -> float:
    """Return the tolerance of a reference by this method."""
    return 1e-12 if METHODS[name].stiff else 3e-14


class Deadline:
    """Callback that ends a run whose time is up; time counts from its first call, so that compiling does not count."""

    def __init__(self, seconds: float) -> None:
        self.end: float | None = None
        self.seconds = seconds

    def __call__(self, done: float, total: float = 0.0, unit: str = "s") -> None:
        if self.end is None:
            self.end = time.perf_counter() + self.seconds
        if time.perf_counter() > self.end:
            raise NumericalError(
                f"not done after {self.seconds:g} s of computing, stopped at t = {done:.6g} s",
                time=done, status="too_slow",
            )  # fmt: skip


def ran_out(error: RobodynError) -> bool:
    """Tell whether a run ended because its steps or its time were used up."""
    return error.details.get("status") in ("max_steps", "too_slow")


@record
class TrialReference:
    """A solution that two methods at tight tolerance agree on.

    times (T,), states (T, n) as far as they agree; scale (n,) : range of each quantity. until [s] : how far that
    is. digits : to which they agree, relative to the range; apart : the same as the largest difference of any quantity.
    methods : which they are. ends_early : why the motion itself ends before its duration (a singular configuration),
    else empty.
    """

    times: Array
    states: Array
    scale: Array
    until: float
    digits: float
    apart: float
    methods: tuple[str, str]
    ends_early: str = ""

    @property
    def keys(self) -> ReferenceKeys:
        """What the summary says of it."""
        return ReferenceKeys(list(self.methods), round(self.digits, 2), self.until, self.ends_early)


def agreed(
    times: Array,
    x: Array,
    y: Array,
    scale: Array,
    bound: float,
    methods: tuple[str, str],
) -> TrialReference | None:
    """Return states x (T, n) as far as another run's y agree within ``bound`` of the scale, None where they do not."""
    apart = np.abs(x - y)
    relative = np.maximum.accumulate(np.max(apart / scale, axis=1))
    good = np.flatnonzero(relative <= bound)
    if len(good) < 2:
        return None
    count = int(good[-1]) + 1
    digits = -float(np.log10(max(relative[count - 1], 1e-16)))
    largest = float(apart[:count].max())
    return TrialReference(times[:count], x[:count], scale, float(times[count - 1]), digits, largest, methods)
