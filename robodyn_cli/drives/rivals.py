"""Errors of the times and places of the largest figures, where others are as large but for the errors of these.

The errors of samples know of places that samples leave open. Where a motion is integrated, or a ratio bends, its value
has a larger error, and another place within that may be the one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from robodyn_cli.drives.cycle import Use
from robodyn_cli.solve.extremes import rivals
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.drives import MotorisationFigures, Ratio, Side, UsedLimit
from robodyn_cli.summaries.facts import Absent

AnySide = TypeVar("AnySide", bound=Side)
Error = float | Absent | None


def side_with_rivals(side: AnySide, times: Array, torque: Array) -> AnySide:
    """Return the figures of a side with torques (T,) at times (T,)."""
    errors = side.errors
    if errors.peak_torque is None or errors.peak_torque_time is None:
        return side
    least = side.peak_torque - 2.0 * errors.peak_torque
    at = _beside(rivals(times, np.abs(torque), side.peak_torque_time, least), len(times))
    time = _at_least(errors.peak_torque_time, np.abs(times[at] - side.peak_torque_time))
    return dataclasses.replace(side, errors=dataclasses.replace(errors, peak_torque_time=time))


def limit_with_rivals(limit: UsedLimit, use: Use) -> UsedLimit:
    """Return how much of a limit is used with the error of its time."""
    if not isinstance(limit.time_error, float) or limit.use_error is None:
        return limit
    return dataclasses.replace(limit, time_error=max(limit.time_error, use.rivals(limit.use_error)))


def decided(name: str, limits: Mapping[str, UsedLimit]) -> Error:
    """Return the error of the time when the limit of a name decides: others may, for their errors."""
    own = limits[name]
    off = own.time_error
    for limit in limits.values():
        doubt = sum(x for x in (own.use_error, limit.use_error) if x is not None)
        if own.use - limit.use <= doubt:
            off = _wider(off, own.time, limit.time, limit.time_error)
    return off


def ratios_with_rivals(
    figures: MotorisationFigures, times: Array, slopes: Mapping[str, Array], q: Array | None
) -> MotorisationFigures:
    """Return the margins of a joint with positions q (T,), None where it has none; slopes : by kind (T,)."""
    kinds: dict[str, Any] = {
        kind: _ratio_with_rivals(getattr(figures, kind), times, slope, q) for kind, slope in slopes.items()
    }
    least = min(kinds.values(), key=lambda x: np.inf if x.ratio is None else x.ratio)
    time, angle = least.errors.time, least.errors.angle
    for other in kinds.values():
        if other.ratio is not None and least.ratio is not None:
            doubt = sum(x for x in (least.errors.ratio, other.errors.ratio) if x is not None)
            if other.ratio - least.ratio <= doubt:
                time = _wider(time, least.time, other.time, other.errors.time)
                angle = _wider(angle, least.angle, other.angle, other.errors.angle)
    errors = dataclasses.replace(figures.errors, time=time, angle=angle)
    return dataclasses.replace(figures, errors=errors, **kinds)


def _ratio_with_rivals(own: Ratio, times: Array, slope: Array, q: Array | None) -> Ratio:
    """Return the least ratio, the tangent of an angle (T,), with errors of its place."""
    errors = own.errors
    if own.ratio is None or errors.ratio is None or errors.time is None:
        return own
    most = float(np.arctan(own.ratio + 2.0 * errors.ratio))
    at = _beside(rivals(times, -slope, own.time, -most), len(times))
    errors = dataclasses.replace(errors, time=_at_least(errors.time, np.abs(times[at] - own.time)))
    if q is not None and isinstance(own.angle, float) and isinstance(errors.angle, float):
        errors = dataclasses.replace(errors, angle=_at_least(errors.angle, np.abs(q[at] - own.angle)))
    return dataclasses.replace(own, errors=errors)


def _beside(at: Any, samples: int) -> Any:
    """Return samples with those on both sides."""
    return np.clip(np.concatenate([at - 1, at, at + 1]), 0, samples - 1)


def _at_least(error: float, away: Array) -> float:
    return float(away.max(initial=error))


def _wider(error: Error, here: float | Absent, there: float | Absent, off: Error) -> Error:
    """Return the error of a figure that may be another one with an error of its own."""
    if not isinstance(error, float) or not isinstance(here, float) or not isinstance(there, float):
        return error
    return max(error, abs(there - here) + off) if isinstance(off, float) else None
