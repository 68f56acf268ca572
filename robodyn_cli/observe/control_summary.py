"""What the summary says of a controller: tracking error, saturation, energy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.equations.control.control import Control
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.solve.extremes import largest_magnitude, positive_integral, root_mean_square
from robodyn_cli.solve.quadrature import Breaks
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.drives import ControlKeys, ControlSummary, DrivenWork, Tracking, TrackingErrors
from robodyn_cli.summaries.facts import ABSENT

ROUNDED = 1e-12  # of a time
AT_LIMIT = 1e-12  # of a limit: torques so near to it are on it


def control_keys(
    control: Control, recorder: Recorder, ends: tuple[float, float], events: Sequence[float]
) -> ControlKeys:
    """Return what samples say of a controller in a run between its ends [s]; events : see ``Recorder.breaks``."""
    t, torque = recorder.array("time"), recorder.array("control/torque")
    qd = recorder.array("qd")[:, control.places]
    limits = {
        name: (float(x[0]), float(x[1])) for name, x in zip(control.joints, control.limits) if x is not None
    }
    saturated, unsure = _saturated(t, torque[:, [control.joints.index(name) for name in limits]], limits)
    least = {name: low for name, (low, high) in limits.items() if low != -high}
    sampled = control.period is not None
    updates = 0 if control.period is None else _updates(control.period, *ends)
    power, breaks = torque * qd, recorder.breaks(t, events)
    (driving, off), (braking, _) = (positive_integral(t, x, breaks) for x in (power, -power))
    summary = ControlSummary(
        type=control.controller.type,
        joints=list(control.joints),
        period=ABSENT if control.period is None else float(control.period),
        delay=float(control.controller.delay) if sampled else ABSENT,
        updates=updates if sampled else ABSENT,
        tracking=_tracking(control, recorder, t, breaks) or ABSENT,
        limits={name: high for name, (_, high) in limits.items()} or ABSENT,
        least_limits=least or ABSENT,
        saturated=saturated or ABSENT,
        saturated_error=unsure or ABSENT,
        energy=DrivenWork(float(driving.sum()), float(braking.sum()), float(off.sum())),
    )
    return ControlKeys(summary)


def _saturated(
    t: Array, torque: Array, limits: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return for how long torques (T, n) are at their limits by name, and the errors of that: half of the time between
    the samples of which one is there."""
    low, high = np.array(list(limits.values())).reshape(-1, 2).T
    near = AT_LIMIT * np.maximum(np.abs(low), np.abs(high))
    at = (torque >= high - near) | (torque <= low + near)
    steps = np.diff(t)[:, None]
    long = 0.5 * np.sum(steps * (1.0 * at[1:] + at[:-1]), axis=0)
    off = 0.5 * np.sum(steps * (at[1:] != at[:-1]), axis=0)
    return dict(zip(limits, long.tolist())), dict(zip(limits, off.tolist()))


def _updates(period: float, begun: float, time: float) -> int:
    """Return how many samples lie behind ``begun`` up to ``time`` [s], the one at 0 included where it begins there."""
    last, first = (math.floor(x / period * (1.0 + ROUNDED)) for x in (time, begun))
    return last - first + (begun == 0.0)


def _tracking(control: Control, recorder: Recorder, t: Array, breaks: Breaks) -> dict[str, Tracking]:
    if not control.tracked:
        return {}
    error = recorder.array("control/error")
    (rms, rms_error), peak = root_mean_square(t, error, breaks), largest_magnitude(t, error, breaks)
    return {
        x.name: Tracking(
            float(peak.value[k]),
            float(peak.time[k]),
            float(rms[k]),
            TrackingErrors(float(peak.error[k]), float(peak.time_error[k]), float(rms_error[k])),
            x.unit,
        )
        for k, x in enumerate(control.tracked)
    }
