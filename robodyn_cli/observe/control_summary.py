"""What the summary says of a controller: tracking error, saturation, energy."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from robodyn_cli.equations.control.control import Control
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.solve.extremes import largest_magnitude, positive_integral, root_mean_square
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.drives import ControlKeys, ControlSummary, DrivenWork, Tracking, TrackingErrors
from robodyn_cli.summaries.facts import ABSENT

ROUNDED = 1e-12  # of a time
AT_LIMIT = 1e-12  # of a limit: torques so near to it are on it


def control_keys(control: Control, recorder: Recorder, time: float, begun: float) -> ControlKeys:
    """Return what samples say of a controller in a run from ``begun`` to ``time`` [s]."""
    t, torque = recorder.array("time"), recorder.array("control/torque")
    qd = recorder.array("qd")[:, control.places]
    limits = {name: float(x) for name, x in zip(control.joints, control.limits) if np.isfinite(float(x))}
    saturated, unsure = _saturated(t, torque[:, [control.joints.index(name) for name in limits]], limits)
    sampled = control.period is not None
    updates = 0 if control.period is None else _updates(control.period, begun, time)
    power = torque * qd
    (driving, off), (braking, _) = (positive_integral(t, x) for x in (power, -power))
    summary = ControlSummary(
        type=control.controller.type,
        joints=list(control.joints),
        period=ABSENT if control.period is None else float(control.period),
        delay=float(control.controller.delay) if sampled else ABSENT,
        updates=updates if sampled else ABSENT,
        tracking=_tracking(control, recorder, t) or ABSENT,
        limits=limits or ABSENT,
        saturated=saturated or ABSENT,
        saturated_error=unsure or ABSENT,
        energy=DrivenWork(float(driving.sum()), float(braking.sum()), float(off.sum())),
    )
    return ControlKeys(summary)


def _saturated(
    t: Array, torque: Array, limits: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return for how long torques (T, n) are at their limits by name, and the errors of that: half of the time between
    the samples of which one is there."""
    at = np.abs(torque) >= np.array(list(limits.values())) * (1.0 - AT_LIMIT)
    steps = np.diff(t)[:, None]
    long = 0.5 * np.sum(steps * (1.0 * at[1:] + at[:-1]), axis=0)
    off = 0.5 * np.sum(steps * (at[1:] != at[:-1]), axis=0)
    return dict(zip(limits, long.tolist())), dict(zip(limits, off.tolist()))


def _updates(period: float, begun: float, time: float) -> int:
    """Return how many samples lie behind ``begun`` up to ``time`` [s], the one at 0 included where it begins there."""
    last, first = (math.floor(x / period * (1.0 + ROUNDED)) for x in (time, begun))
    return last - first + (begun == 0.0)


def _tracking(control: Control, recorder: Recorder, t: Array) -> dict[str, Tracking]:
    if not control.tracked:
        return {}
    error = recorder.array("control/error")
    (rms, rms_error), peak = root_mean_square(t, error), largest_magnitude(t, error)
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
