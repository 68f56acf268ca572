"""What the summary says of a controller: tracking error, saturation, energy."""

from __future__ import annotations

import math

import numpy as np

from robodyn_cli.equations.control.control import Control
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.solve.quadrature import root_mean_square_over
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.drives import ControlKeys, ControlSummary, DrivenWork, Tracking
from robodyn_cli.summaries.facts import ABSENT

ROUNDED = 1e-12  # of a time
AT_LIMIT = 1e-12  # of a limit: torques so near to it are on it


def control_keys(control: Control, recorder: Recorder, time: float, begun: float) -> ControlKeys:
    """Return what samples say of a controller in a run from ``begun`` to ``time`` [s]."""
    t, torque = recorder.array("time"), recorder.array("control/torque")
    qd = recorder.array("qd")[:, control.places]
    limits = {name: float(x) for name, x in zip(control.joints, control.limits) if np.isfinite(float(x))}
    saturated = {
        name: _integral(t, 1.0 * (np.abs(torque[:, control.joints.index(name)]) >= most * (1.0 - AT_LIMIT)))
        for name, most in limits.items()
    }
    sampled = control.period is not None
    updates = 0 if control.period is None else _updates(control.period, begun, time)
    power = torque * qd
    found = ControlSummary(
        type=control.controller.type,
        joints=list(control.joints),
        period=ABSENT if control.period is None else float(control.period),
        delay=float(control.controller.delay) if sampled else ABSENT,
        updates=updates if sampled else ABSENT,
        tracking=_tracking(control, recorder, t) or ABSENT,
        limits=limits or ABSENT,
        saturated=saturated or ABSENT,
        energy=DrivenWork(
            _integral(t, np.maximum(power, 0.0).sum(axis=1)),
            -_integral(t, np.minimum(power, 0.0).sum(axis=1)),
        ),
    )
    return ControlKeys(found)


def _updates(period: float, begun: float, time: float) -> int:
    """Return how many samples lie behind ``begun`` up to ``time`` [s], the one at 0 included where it begins there."""
    last, first = (math.floor(x / period * (1.0 + ROUNDED)) for x in (time, begun))
    return last - first + (begun == 0.0)


def _tracking(control: Control, recorder: Recorder, t: Array) -> dict[str, Tracking]:
    if not control.tracked:
        return {}
    error = recorder.array("control/error")
    rms, peak = root_mean_square_over(t, error), np.abs(error).argmax(axis=0)
    return {
        x.name: Tracking(float(abs(error[at, k])), float(t[at]), float(rms[k]), x.unit)
        for k, (x, at) in enumerate(zip(control.tracked, peak))
    }


def _integral(t: Array, y: Array) -> float:
    """Return the integral of samples y (T,) by the trapezoidal rule."""
    return float(np.sum(np.diff(t) * 0.5 * (y[1:] + y[:-1])))
