"""Responses of what a controller leads, from close samples of a run, with errors by more accurate integrations."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from robodyn_cli.equations.control.control import Control
from robodyn_cli.motion.between.extremes import RecordedMotion
from robodyn_cli.motion.between.samples import CloseSamples, to_its_ends
from robodyn_cli.motion.self_check import rounding_of
from robodyn_cli.observe.columns import ChosenColumn, values_of
from robodyn_cli.observe.controllers.held import driven_paths
from robodyn_cli.observe.controllers.summary import ways_of, with_doubtful_limits, with_held
from robodyn_cli.solve.extremes import largest
from robodyn_cli.solve.step_response import NOTHING, SmoothCourse, TimeFigure, rise_of, settling_of
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.apart import with_others
from robodyn_cli.summaries.control import ControlKeys, ControlSummary
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.response import Response, ResponseErrors, ResponseKeys

MOST = 8  # pieces in which the highest point is looked for
ROUNDED = 1e-14  # of an integral


def responses(motion: RecordedMotion, control: Control) -> ResponseKeys:
    """Return the responses of what a controller leads.

    Raises
    ------
    NumericalError, SingularConfigurationError : the motion does not come to its end again.
    """
    off = _off(motion)
    own = ResponseKeys(_of(motion.own, control, off))
    if motion.own.sparse:  # polynomials over several steps tell no error
        return with_others(own, (), 0.0)
    if not motion.others:
        return own
    others = [ResponseKeys(_of(other, control, off)) for other in motion.others]
    told = with_others(own, others, motion.factor)
    return ResponseKeys(_with_floors(told.response, motion, control))


def _with_floors(
    told: Mapping[str, Response], motion: RecordedMotion, control: Control
) -> dict[str, Response]:
    """Return responses with errors no less than those of the motion at its end, and than rounding, which two
    integrations may share."""
    errors = motion.errors
    if errors is None or not isinstance(errors.q_end, float):
        return dict(told)
    ways, least, found = ways_of(control, motion.recorder), rounding_of(errors), {}
    for name, own in told.items():
        off = own.errors
        final = max(off.final_error, errors.q_end * ways[name])
        beyond = off.overshoot
        if beyond is not None and own.step:
            beyond += least * ways[name] / abs(own.step)
        changed = dataclasses.replace(off, final_error=final, overshoot=beyond)
        found[name] = dataclasses.replace(own, errors=changed)
    return found


def with_held_torques(motion: RecordedMotion, control: Control, keys: ControlKeys) -> ControlKeys:
    """Return the keys of a controller with figures of its held torques that the samples of the run leave out.

    Raises
    ------
    NumericalError, SingularConfigurationError : the motion does not come to its end again.
    """
    if control.period is None or keys.control.energy is not ABSENT:
        return keys
    designed = {x.name: ABSENT for x in dataclasses.fields(ControlSummary) if x.default is ABSENT}
    bare = ControlKeys(dataclasses.replace(keys.control, **designed))
    found = _held(motion.own, control, bare)
    if motion.own.sparse:
        found = with_others(found, (), 0.0)
    elif motion.others:
        found = with_others(found, [_held(other, control, bare) for other in motion.others], motion.factor)
        for other in motion.others:
            one, two = _torques(motion.own), _torques(other)
            found = with_doubtful_limits(found, control, one, two, motion.factor)
    told = {name: getattr(found.control, name) for name in ("energy", "saturated", "saturated_error")}
    return ControlKeys(dataclasses.replace(keys.control, **told))


def _held(samples: CloseSamples, control: Control, keys: ControlKeys) -> ControlKeys:
    """Return the keys of a controller with figures of its held torques from close samples."""
    paths = driven_paths(control)
    columns = [
        ChosenColumn("", path, (k,), "") for path, places in paths.items() for k in range(1 + max(places))
    ]
    times = np.concatenate([t for t, _, _ in samples.blocks])
    t, first = np.unique(times, return_index=True)
    values = values_of(samples.observer, columns, samples.blocks)[first]
    ends = np.cumsum([1 + max(places) for places in paths.values()])
    found = dict(zip(paths, np.split(values, ends[:-1], axis=1)))
    return with_held(keys, control, t, found.__getitem__, [one.time for one in samples.met])


def _torques(samples: CloseSamples) -> tuple[Array, Array]:
    """Return times (T,) and torques (T, n) of close samples."""
    times = np.concatenate([t for t, _, _ in samples.blocks])
    t, first = np.unique(times, return_index=True)
    control = samples.observer.problem.control
    assert control is not None
    columns = [ChosenColumn("", "control/torque", (k,), "") for k in range(len(control.joints))]
    return t, values_of(samples.observer, columns, samples.blocks)[first]


def _off(motion: RecordedMotion) -> float:
    """Return by how much the positions of a motion may be off."""
    most = None if motion.errors is None else motion.errors.q_max
    return most if isinstance(most, float) else 0.0


def _of(samples: CloseSamples, control: Control, off: float) -> dict[str, Response]:
    """Return the responses by coordinate, with errors of what lies between samples."""
    tracked = [x.name for x in control.tracked]
    names = [x.name for x in control.tracked if x.name in control.joints]
    columns = [ChosenColumn("", "control/reference", (k,), "") for k in range(len(tracked))]
    columns += [ChosenColumn("", "control/error", (k,), "") for k in range(len(tracked))]
    columns += [ChosenColumn("", "control/torque", (control.joints.index(name),), "") for name in names]
    columns += [ChosenColumn("", "qd", (control.places[control.joints.index(name)],), "") for name in names]
    found, final = samples.pieces(columns)
    parts = [to_its_ends(*part) for part in found if part[3] > part[2]] or [part[:2] for part in found]
    n, m = len(tracked), len(names)
    told = {}
    for k, one in enumerate(control.tracked):
        loads = None
        if one.name in names:
            j = names.index(one.name)
            loads = [(t, y[:, 2 * n + j], y[:, 2 * n + m + j]) for t, y in parts]
        ends = float(final[k]), float(final[n + k])
        course = SmoothCourse([(t, y[:, k] - y[:, n + k]) for t, y in parts])
        told[one.name] = _response(course, ends, off, one.unit, _work(loads))
    return told


Work = tuple[float, float, float, float]  # effort, its error, energy, its error


def _work(loads: list[tuple[Array, Array, Array]] | None) -> Work | None:
    """Return the integrals of torque squared and of the magnitude of power by Simpson's rule, with errors: what every
    second sample gives otherwise."""
    if loads is None:
        return None
    from scipy.integrate import simpson

    total, error = np.zeros(2), np.zeros(2)
    for t, tau, qd in loads:
        if not t[-1] > t[0]:
            continue
        y = np.column_stack([tau**2, np.abs(tau * qd)])
        few = np.unique([*range(0, len(t), 2), len(t) - 1])
        fine, coarse = (simpson(y[k], x=t[k], axis=0) for k in (slice(None), few))
        total += fine
        error += np.abs(fine - coarse) + ROUNDED * np.abs(fine)
    effort, energy, first, second = (float(x) for x in (*total, *error))
    return effort, first, energy, second


def _response(
    course: SmoothCourse, ends: tuple[float, float], off: float, unit: str, work: Work | None
) -> Response:
    """Return the response of a coordinate; ends : reference, and error, at the end of the run."""
    start, end = float(course.pieces[0][1][0]), ends[0]
    step = end - start
    size = max(float(np.abs(y).max()) for _, y in course.pieces)
    rise = settling = beyond = TimeFigure(None, None)
    if abs(step) > NOTHING * max(size, 1.0):
        rise, settling = rise_of(course, start, end, off), settling_of(course, start, end, off)
        beyond = _overshoot(course, start, end)
    effort, effort_error, energy, energy_error = (ABSENT,) * 4 if work is None else work
    errors = ResponseErrors(rise.error, beyond.error, settling.error, 0.0, effort_error, energy_error)
    return Response(step, rise.value, beyond.value, settling.value, ends[1], effort, energy, errors, unit)


def _overshoot(course: SmoothCourse, start: float, end: float) -> TimeFigure:
    """Return how far a coordinate goes beyond the end, over its step."""
    heights = [(y - end) / (end - start) for _, y in course.pieces]
    tops = np.array([float(y.max()) for y in heights])
    best, error = max(0.0, float(tops.max())), 0.0
    # between samples a smooth piece goes no farther than by its second differences
    over = np.array([float(np.abs(np.diff(y, 2)).max(initial=0.0)) for y in heights])
    near = [k for k in np.argsort(-(tops + over))[:MOST].tolist() if tops[k] + over[k] >= best]
    for k in near:
        t = course.pieces[k][0]
        if len(t) > 1 and t[-1] > t[0]:
            most = largest(t, heights[k][:, None])
            best, error = max(best, float(most.value[0])), max(error, float(most.error[0]))
    return TimeFigure(best, error)
