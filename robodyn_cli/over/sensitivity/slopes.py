"""Sensitivities: derivatives of outputs of a scene's command by keys of the scene, exact or by differences."""

from __future__ import annotations

import math

from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import differences
from robodyn_cli.over.sensitivity.exact import exact_slopes
from robodyn_cli.over.sensitivity.slope import DIFFERENCES, Slope, is_time_of_sample
from robodyn_cli.record import record

JUMPS = Slope(
    math.nan,
    math.nan,
    DIFFERENCES,
    "it is the time of one of the samples, which stays or jumps to another one",
)


@record
class Sensitivities:
    """All derivatives (outputs, keys), and why those by differences are not exact, by the number of the key."""

    asked: AskedSlopes
    slopes: tuple[tuple[Slope, ...], ...]
    obstacles: dict[int, str]


def sensitivities(asked: AskedSlopes, jobs: int = 1) -> Sensitivities:
    """Return the derivatives of all outputs by all keys.

    Parameters
    ----------
    jobs : processes or threads for runs of central differences.
    """
    exact, obstacles = exact_slopes(asked)
    outputs, count = asked.task.outputs, len(asked.keys)
    exact |= {(name, k): JUMPS for name in outputs if is_time_of_sample(name) for k in range(count)}
    rest = [k for k in range(count) if any((name, k) not in exact for name in outputs)]
    others = differences(asked, rest, jobs)
    slopes = tuple(
        tuple(exact.get((name, k)) or others[k][place] for k in range(count))
        for place, name in enumerate(outputs)
    )
    return Sensitivities(asked, slopes, obstacles)
