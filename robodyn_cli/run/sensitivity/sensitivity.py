"""Sensitivities: derivatives of outputs of a scene's command by keys of the scene, exact or by differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robodyn_cli.record import record
from robodyn_cli.run.sensitivity.asked import Asked
from robodyn_cli.run.sensitivity.differences import differences
from robodyn_cli.run.sensitivity.exact import exact_slopes
from robodyn_cli.run.sensitivity.slope import Slope


@record
class Sensitivities:
    """All derivatives (outputs, keys), and why those by differences are not exact, by the number of the key."""

    asked: Asked
    slopes: tuple[tuple[Slope, ...], ...]
    obstacles: dict[int, str]


def sensitivities(
    asked: Asked, jobs: int = 1, tell: Callable[[int, int], None] | None = None
) -> Sensitivities:
    """Return the derivatives of all outputs by all keys.

    Parameters
    ----------
    jobs : processes or threads for runs of central differences. tell : is told how many of how many keys are done.
    """
    exact, obstacles = exact_slopes(asked)
    outputs = asked.task.outputs
    rest = [k for k in range(len(asked.keys)) if any((name, k) not in exact for name in outputs)]
    others: dict[int, Sequence[Slope]] = {}
    for done, k in enumerate(rest):
        if tell is not None:
            tell(done, len(rest))
        others[k] = differences(asked, k, jobs)
    slopes = tuple(
        tuple(exact.get((name, k)) or others[k][place] for k in range(len(asked.keys)))
        for place, name in enumerate(outputs)
    )
    return Sensitivities(asked, slopes, obstacles)
