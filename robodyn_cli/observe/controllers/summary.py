"""What the summary says of a controller: tracking error, saturation, energy."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.control.design import Named
from robodyn_cli.equations.control.control import Control
from robodyn_cli.observe.controllers.held import (
    HeldJoints,
    HeldStretches,
    driven_paths,
    held_work,
    tracked_between,
)
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.solve.extremes import largest_magnitude, positive_integral, root_mean_square
from robodyn_cli.solve.quadrature import Breaks
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.control import (
    ControlKeys,
    ControlSummary,
    DrivenWork,
    Equilibrium,
    EquilibriumErrors,
    LoopPole,
    Tracking,
    TrackingErrors,
)
from robodyn_cli.summaries.facts import ABSENT

ROUNDED = 1e-12  # of a time
STEP = 1e-6  # of differences [rad or m]
AT_LIMIT = 1e-12  # of a limit: torques so near to it are on it


def control_keys(
    control: Control, recorder: Recorder, ends: tuple[float, float], events: Sequence[float]
) -> ControlKeys:
    """Return what samples say of a controller in a run between its ends [s]; events : see ``Recorder.breaks``."""
    t, sampled, limits = recorder.array("time"), control.period is not None, _limits(control)
    least = {name: low for name, (low, high) in limits.items() if low != -high}
    updates = 0 if control.period is None else _updates(control.period, *ends)
    keys = ControlKeys(
        ControlSummary(
            type=control.controller.type,
            joints=list(control.joints),
            period=ABSENT if control.period is None else float(control.period),
            delay=float(control.controller.delay) if sampled else ABSENT,
            updates=updates if sampled else ABSENT,
            tracking=_tracking(control, recorder, t, recorder.breaks(t, events)) or ABSENT,
            limits={name: high for name, (_, high) in limits.items()} or ABSENT,
            least_limits=least or ABSENT,
            saturated=ABSENT,
            saturated_error=ABSENT,
            energy=ABSENT,
        )
    )
    if sampled:
        return with_held(keys, control, t, recorder.array, events)
    saturated, unsure = _saturated(control, t, recorder.array("control/torque"), limits)
    own = dataclasses.replace(
        keys.control,
        saturated=saturated or ABSENT,
        saturated_error=unsure or ABSENT,
        energy=_energy(control, recorder, events),
    )
    return ControlKeys(own)


def _energy(control: Control, recorder: Recorder, events: Sequence[float]) -> DrivenWork:
    """Return the work of the joints that a continuous controller drives."""
    t = recorder.array("time")
    power = recorder.array("control/torque") * recorder.array("qd")[:, control.places]
    breaks = recorder.breaks(t, events)
    (driving, off), (braking, _) = (positive_integral(t, x, breaks) for x in (power, -power))
    return DrivenWork(float(driving.sum()), float(braking.sum()), float(off.sum()))


def with_held(
    keys: ControlKeys, control: Control, t: Array, read: Callable[[str], Array], events: Sequence[float]
) -> ControlKeys:
    """Return the keys with what follows from torques that are held between samples, where these show all of them.

    t : times (T,) of the samples, that ``read`` gives by the path of a dataset. events : see ``held_work``.
    """
    later = np.append(True, np.diff(t) > 0.0)
    t = t[later]
    between = HeldStretches.of(control, t)
    if between.hidden.any():
        return keys
    driven = HeldJoints(*(read(path)[later][:, places] for path, places in driven_paths(control).items()))
    told: dict[str, Any] = {"energy": DrivenWork(*held_work(between, driven, t, events))}
    limits = _limits(control)
    if limits:
        times, errors = between.at_limits(_at_limits(control, driven.tau, limits))
        told["saturated"] = dict(zip(limits, times.tolist()))
        told["saturated_error"] = dict(zip(limits, errors.tolist()))
    return ControlKeys(dataclasses.replace(keys.control, **told))


def with_doubts(
    keys: ControlKeys, control: Control, one: Recorder, other: Recorder, factor: float, floor: float
) -> ControlKeys:
    """Return the keys of a run with what the figures of a second one do not tell.

    Both may have the same error, or round alike: what is left of a small error of tracking is no surer than the motion.
    factor : times a difference of both is an error. floor : of positions, by rounding.
    """
    ways, told = ways_of(control, one), keys.control.tracking
    if isinstance(told, Mapping):
        own = {}
        for name, x in told.items():
            off = floor * ways[name]
            errors = dataclasses.replace(x.errors, peak=x.errors.peak + off, rms=x.errors.rms + off)
            own[name] = dataclasses.replace(x, errors=errors)
        keys = ControlKeys(dataclasses.replace(keys.control, tracking=own))
    first, second = ((x.array("time"), x.array("control/torque")) for x in (one, other))
    return with_doubtful_limits(keys, control, first, second, factor)


def with_doubtful_limits(
    keys: ControlKeys, control: Control, one: tuple[Array, Array], other: tuple[Array, Array], factor: float
) -> ControlKeys:
    """Return the keys with errors of times at limits for how near to a limit torques come.

    one, other : times (T,) and torques (T, n) of two runs, which are off from each other by what they are off. Torques
    that are at a limit hide by how much they would be beyond it; so those that are not count twice.
    """
    unsure, limits = keys.control.saturated_error, _limits(control)
    if not isinstance(unsure, Mapping) or len(one[0]) < 2:
        return keys
    (t, tau), (times, twin) = one, other
    last = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 1)
    off = factor * np.maximum.accumulate(np.abs(twin[last] - tau), axis=0)
    at = _at_limits(control, tau, limits)
    near = _at_limits(control, tau + off, limits) | _at_limits(control, tau - off, limits)
    long = np.gradient(t)[:, None] * (near & ~at)
    more = dict(zip(limits, (2.0 * long.sum(axis=0)).tolist()))
    found = {name: x + more[name] for name, x in unsure.items()}
    return ControlKeys(dataclasses.replace(keys.control, saturated_error=found))


def ways_of(control: Control, recorder: Recorder) -> dict[str, float]:
    """Return by how much each coordinate that is led moves at most, at the end, for a unit of all positions."""
    q, time = recorder.array("q")[-1], float(recorder.array("time")[-1])
    if not control.controller.at_point:
        return {x.name: 1.0 for x in control.tracked}
    entries = [x.actual for x in control.tracked]

    def places(q: Array) -> Array:
        found: Array = control.problem.numbers(entries, q, time)
        return found

    moved = [np.abs(places(q + step) - places(q)) / STEP for step in STEP * np.eye(len(q))]
    return dict(zip((x.name for x in control.tracked), np.maximum(1.0, np.sum(moved, axis=0)).tolist()))


def with_design(keys: ControlKeys, control: Control) -> ControlKeys:
    """Return the keys with what the controller is, as far as its kind has gains, poles and a pose of its own."""
    own = control.design
    if own is None:
        return keys
    rows, columns = own.rows, own.columns
    told: dict[str, Any] = {
        "gains": _by_name(own.gains.values, rows, columns),
        "gain_errors": _by_name(own.gains.errors, rows, columns) if own.gains.errors.any() else ABSENT,
        "row_units": {x.name: x.unit for x in rows},
        "column_units": {x.name: x.unit for x in columns},
    }
    if own.riccati is not None:
        told["riccati"] = _by_name(own.riccati.values, columns, columns)
        told["riccati_errors"] = _by_name(own.riccati.errors, columns, columns)
    if own.poles is not None:
        told["poles"] = [
            LoopPole(float(s.real), float(s.imag), float(error))
            for s, error in zip(own.poles.values, own.poles.errors)
        ]
    if own.at:
        torques = dict(zip((row.name for row in rows), own.holding))
        positions = [name.name for name, _ in own.at]
        errors = EquilibriumErrors(
            dict(zip(positions, own.at_errors)), dict(zip(torques, own.holding_errors))
        )
        told["equilibrium"] = Equilibrium({name.name: x for name, x in own.at}, torques, errors)
    return ControlKeys(dataclasses.replace(keys.control, **told))


def _by_name(matrix: Array, rows: Sequence[Named], columns: Sequence[Named]) -> dict[str, dict[str, float]]:
    """Return the entries of a matrix by the names of rows and columns; a driven joint may have its own name only."""
    return {
        row.name: dict(zip((column.name for column in columns), entries.tolist()))
        for row, entries in zip(rows, matrix)
    }


def _limits(control: Control) -> dict[str, tuple[float, float]]:
    """Return least and largest torque of the joints that have limits."""
    return {
        name: (float(x[0]), float(x[1])) for name, x in zip(control.joints, control.limits) if x is not None
    }


def _at_limits(control: Control, torque: Array, limits: Mapping[str, tuple[float, float]]) -> Array:
    """Tell which torques (T, n) are at their limits (T, limits)."""
    torque = torque[:, [control.joints.index(name) for name in limits]]
    low, high = np.array(list(limits.values())).reshape(-1, 2).T
    near = AT_LIMIT * np.maximum(np.abs(low), np.abs(high))
    at: Array = (torque >= high - near) | (torque <= low + near)
    return at


def _saturated(
    control: Control, t: Array, torque: Array, limits: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return for how long torques (T, n) of a continuous controller are at their limits by name, and the errors of
    that: half of the time between the samples of which one is there."""
    at = _at_limits(control, torque, limits)
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
    if control.period is not None:
        rms_error, peak = tracked_between(t, error, rms_error, peak)
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
