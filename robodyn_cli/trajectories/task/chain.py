"""Segments joined: which are passed without a stop, corners rounded, turns and time laws of each way between stops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.spatial.orientation import rotation_of
from robodyn_cli.trajectories.task.segments import BEYOND, FARTHEST, STILL, Curve, Line, PathProblem, blend
from robodyn_cli.trajectories.task.stretch import (
    Attitudes,
    Facing,
    Stretch,
    Turning,
    Turns,
    step_course,
    turn_between,
)

SAME_WAY = 1e-6  # rad: how well directions have to meet where the frame goes on


@record
class ChainPlan:
    """The ways between stops; when each begins, and the end of the stay behind it [s]."""

    stretches: tuple[Stretch, ...]
    begins: Array
    ends: Array


def planned(
    start: Array,
    R: Array | None,
    facing: Any,
    segments: Sequence[Any],
    law: str,
    limits: Mapping[str, float],
) -> ChainPlan:
    """Return the ways between stops, with their times.

    Parameters
    ----------
    start : position (3,). R : axes (3, 3) at the start, None where they are free or ``facing``. limits : by name.

    Raises
    ------
    PathProblem : what cannot be joined, turned or timed.
    """
    stretches: list[Stretch] = []
    begins, ends, now = [], [], 0.0
    first, curves = 0, _curves(start, segments)
    look = None if facing is None else _facing(facing)
    for last, segment in enumerate(segments):
        if segment.blend is not None and last < len(segments) - 1:
            continue
        here = range(first, last + 1)
        if R is not None:
            stretch, R = _turned(curves[first : last + 1], segments, here, R)
        else:
            stretch = Stretch(_joined(curves[first : last + 1], segments, here)[0], look)
        _check_turning(stretch, facing, last)
        _time(stretch, segments, here, law, limits)
        stretches.append(stretch)
        begins.append(now)
        now += stretch.duration + segment.dwell
        ends.append(now)
        first = last + 1
    return ChainPlan(tuple(stretches), np.array(begins), np.array(ends))


def _curves(start: Array, segments: Sequence[Any]) -> list[Curve]:
    """Return the curve of each segment."""
    curves: list[Curve] = []
    for k, segment in enumerate(segments):
        try:
            with np.errstate(all="ignore"):
                curves.append(segment.curve(start))
        except PathProblem as problem:
            raise PathProblem(("segments", k, *problem.path), str(problem)) from None
        if not curves[-1].length < FARTHEST:
            raise PathProblem(("segments", k), f"from {start.tolist()} its end {BEYOND}")
        start = curves[-1].at(np.array([curves[-1].length]))[0, 0]
        if segment.blend is not None:
            if k == len(segments) - 1:
                raise PathProblem(
                    ("segments", k, "blend"), "the path ends here; a blend goes on to another segment"
                )
            for name in ("dwell", "duration"):
                if getattr(segment, name):
                    raise PathProblem(
                        ("segments", k, name), "does not go with 'blend': the frame does not stop here"
                    )
    return curves


def _facing(given: Any) -> Facing:
    point = None if given.to == "tangent" else np.array(given.to)
    return Facing(point, "xyz".index(given.axis), np.array(given.up))


def _joined(curves: Sequence[Curve], segments: Sequence[Any], here: range) -> tuple[list[Curve], list[float]]:
    """Return the curves of segments passed without a stop, corners rounded, and the arc lengths where they meet."""
    joined, meet = [curves[0]], []
    done = 0.0
    for k, curve in zip(here[:-1], curves[1:]):
        where, before = ("segments", k, "blend"), joined[-1]
        for one, place in ((before, k), (curve, k + 1)):
            if one.length <= STILL:
                fault = "is a turn in place, which needs stops before and behind it"
                raise PathProblem(("segments", place), fault)
        distance = segments[k].blend
        if not distance:
            _check_direction(before, curve, where)
            done += before.length
            meet.append(done)
            joined.append(curve)
            continue
        if not (isinstance(before, Line) and isinstance(curve, Line)):
            raise PathProblem(
                where, f"only corners of two lines are rounded (value {distance:g}); allowed here: 0"
            )
        room = min(before.length, curve.length if k + 1 == here[-1] else curve.length - segments[k + 1].blend)
        if distance > room * (1.0 + 1e-12):
            raise PathProblem(
                where, f"{distance:g} m is longer than the lines leave; allowed: up to {max(room, 0.0):.6g}"
            )
        _check_corner(before, curve, where)
        try:
            corner = blend(before, curve, distance)
        except ValueError as problem:
            raise PathProblem(where, f"{distance:g} m round no corner: {problem}") from None
        joined[-1] = before.part(0.0, before.length - distance)
        joined += [corner, curve.part(distance, curve.length)]
        done += joined[-3].length + corner.length
        meet.append(done - 0.5 * corner.length)
    kept = [curve for curve in joined if curve.length > STILL] or joined[:1]
    return kept, meet


def _direction(curve: Curve, s: float) -> Array:
    slope: Array = curve.at(np.array([s]))[1, 0]
    return slope / np.linalg.norm(slope)


def _check_direction(before: Curve, after: Curve, where: tuple[str | int, ...]) -> None:
    angle = 2.0 * np.arcsin(
        min(0.5 * float(np.linalg.norm(_direction(before, before.length) - _direction(after, 0.0))), 1.0)
    )
    if angle > SAME_WAY:
        fault = f"the path turns by {np.degrees(angle):.4g} deg behind this segment, so the frame has to stop there"
        raise PathProblem(
            where, f"{fault}; leave 'blend' out, or round the corner of two lines by a blend > 0"
        )


def _check_corner(before: Line, after: Line, where: tuple[str | int, ...]) -> None:
    if before.direction @ after.direction < -1.0 + 1e-9:
        raise PathProblem(where, "the path turns back here, which cannot be rounded; leave 'blend' out")


def _turned(curves: Sequence[Curve], segments: Sequence[Any], here: range, R: Array) -> tuple[Stretch, Array]:
    """Return a stretch with the turns of its segments, and the axes at its end."""
    joined, meet = _joined(curves, segments, here)
    if any(segments[k].orientations for k in here):
        return _turned_by_points(joined, segments, here, R)
    stretch = Stretch(joined, None)
    places = [0.0, *meet, stretch.size]
    turns, end = [], R
    for k in here:
        given = segments[k].orientation
        to = end if given is None else np.array(rotation_of(given), dtype=float)
        turns.append(turn_between(end, to))
        end = to
    parts = step_course(places[:-1], places[1:], len(curves) > 1, stretch.size)
    turning: Turning = Turns(R, turns, parts)
    return Stretch(joined, turning), end


def _turned_by_points(
    joined: Sequence[Curve], segments: Sequence[Any], here: range, R: Array
) -> tuple[Stretch, Array]:
    """Return a stretch of one spline whose points have orientations, and the axes at its end."""
    k, curve = here[0], joined[0]
    if len(here) > 1:
        k = next(k for k in here if segments[k].orientations)
        fault = "turn the frame at the ends too, so it has to stop there; leave 'blend' out, or give 'orientation'"
        raise PathProblem(("segments", k, "orientations"), fault)
    axes = [R, *(np.array(rotation_of(x), dtype=float) for x in segments[k].orientations)]
    places = np.array([0.0, *curve.knots, curve.length])
    return Stretch(joined, Attitudes(places, axes)), axes[-1]


def _check_turning(stretch: Stretch, facing: Any, last: int) -> None:
    """Refuse a frame that faces nowhere."""
    if facing is None:
        return
    where = ("segments", last)
    if stretch.length <= STILL and facing.to == "tangent":
        raise PathProblem(where, "has no way, so there is no tangent to face along")
    s = np.linspace(0.0, stretch.size, 401)
    p = stretch.position(s)
    assert stretch.turning is not None
    R = stretch.turning.axes(p, s)
    bad = np.flatnonzero(
        ~np.isfinite(R[0]).all(axis=(1, 2)) | (np.abs(R[1]).max(axis=(1, 2)) > 1e6 / stretch.size)
    )
    if bad.size:
        x, y, z = p[0, bad[0]]
        fault = "the axis has no direction there, or is parallel to 'up'"
        raise PathProblem(
            ("facing",), f"at ({x:.4g}, {y:.4g}, {z:.4g}) {fault}; choose another point, or 'up'"
        )


def _time(
    stretch: Stretch, segments: Sequence[Any], here: range, law: str, limits: Mapping[str, float]
) -> None:
    """Choose the time law of a stretch."""
    last = here[-1]
    segment = segments[last]
    moves, duration = stretch.length > STILL, segment.duration
    turns = isinstance(stretch.turning, Turns) and any(x.any() for x in stretch.turning.turns)
    if not moves and not turns:
        raise PathProblem(("segments", last), "nothing moves; a pause is the 'dwell' of the segment before")
    prefix = "" if moves else "angular_"
    needed = {"trapezoid": ("acceleration",), "s_curve": ("acceleration", "jerk")}.get(law, ())
    for name in needed:
        if prefix + name not in limits:
            raise PathProblem(
                (), f"law {law} needs the limit '{prefix}{name}'; give it, or another law with durations"
            )
    if not needed and duration is None and not any(name.startswith("angular_") != moves for name in limits):
        fault = f"law {law} needs a duration, or a limit as '{prefix}speed', to know the time"
        raise PathProblem(("segments", last), fault)
    least = stretch.timed(law, limits, duration)
    if duration is not None and duration < least * (1.0 - 1e-9):
        fault = f"{duration:.6g} s is too short under the limits"
        raise PathProblem(("segments", last, "duration"), f"{fault}; allowed: {least:.9g} s or more")
