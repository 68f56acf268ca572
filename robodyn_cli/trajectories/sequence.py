"""Motions one after another, once or several times."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.expr.functions import where
from robodyn_cli.expr.graph import Expr
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Integer, ListOf, OrFile, Tagged, key
from robodyn_cli.spatial.algebra import Array, vector
from robodyn_cli.trajectories.base import Lacks, Problems, SceneNames
from robodyn_cli.trajectories.formulas import FORMS
from robodyn_cli.trajectories.joint_space import JointSpaceTrajectory, attitude_places
from robodyn_cli.trajectories.led import QUATERNION, position_columns, with_attitudes
from robodyn_cli.trajectories.motion import JointMotion
from robodyn_cli.trajectories.registry import trajectory_types

MEET = 1e-9  # rad, m, and the same per second: how well segments have to meet


@record
class SequenceTrajectory(JointSpaceTrajectory):
    """Motions one after another; each begins where, and as fast as, the one before it ends.

    Where a segment leads a point or takes the least time, the motion of its joints is found first
    (``ready/in_time.py``); all that needs it asks the sequence of what was found.
    """

    type: str = key(Choice(("sequence",)), doc="Kind of trajectory.")
    segments: tuple[Any, ...] = key(
        ListOf(OrFile(Tagged(lambda: trajectory_types))),
        doc="Trajectories of any kind, in their order; each has times of its own.",
    )
    repeat: int = key(Integer(minimum=1, maximum=10_000), default=1, doc="How many times all of it is done.")

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        wrong = False
        for k, segment in enumerate(self.segments):
            for path, message in segment.problems(scene):
                yield ("segments", k, *path), message
                wrong = True
        if not wrong:
            yield from self.completed(scene).meeting_problems(scene.parameters)

    def meeting_problems(self, parameters: Mapping[str, float]) -> Problems:
        """Report segments that do not meet those before them, as far as their motion is known already."""
        known = [k for k, segment in enumerate(self.segments) if not segment.lacks]
        for k in known:
            others = {*position_columns(self.segments[k].joints)} ^ {*self.joints}
            if others:
                other = min(others)
                yield (
                    ("segments", k),
                    f"leads other joints than the first segment ({other!r}); allowed: the same ones",
                )
                return
        last = len(self.segments) if self.repeat > 1 else len(self.segments) - 1
        for k in range(last):
            after = (k + 1) % len(self.segments)
            if not {k, after} <= {*known}:
                continue
            gap = _gap(self.segments[k], self.segments[after], parameters)
            if gap is not None:
                ends = "the segment before ends" if after > k else "the last one ends"
                yield ("segments", after), f"{gap}, where {ends}; allowed: the same position and rate"

    @property
    def lacks(self) -> Lacks:  # type: ignore[override]
        return Lacks.PARTS if any(segment.lacks for segment in self.segments) else Lacks.NOTHING

    @property
    def least_time(self) -> bool:  # type: ignore[override]
        return any(segment.least_time for segment in self.segments)

    def completed(self, scene: SceneNames) -> SequenceTrajectory:
        return dataclasses.replace(self, segments=tuple(x.completed(scene) for x in self.segments))

    @property
    def joints(self) -> tuple[str, ...]:
        known = next((segment for segment in self.segments if not segment.lacks), None)
        return () if known is None else position_columns(known.joints)

    @property
    def duration(self) -> float:
        """Time of all segments and repetitions [s]."""
        return float(self._starts[-1])

    @cached_property
    def _starts(self) -> Array:
        """When each segment of each repetition begins, and the end of the last one [s]."""
        lengths = [segment.duration for segment in self.segments] * self.repeat
        return np.concatenate([[0.0], np.cumsum(lengths)])

    @property
    def knots(self) -> tuple[float, ...] | None:
        if any(segment.knots is None for segment in self.segments):
            return None
        knots = [*self._starts[1:-1].tolist()]
        for start, segment in zip(self._starts, self.segments * self.repeat):
            knots += [float(start) + knot for knot in segment.knots]
        return tuple(sorted(knots))

    def expressions(self, t: Expr, env: Mapping[str, Any]) -> Mapping[str, Any]:
        starts, count = tuple(self._starts.tolist()), len(self.segments)
        pieces = len(starts) - 1
        own = t.graph.piecewise(t, starts, ((0.0,) * pieces, (1.0,) * pieces))  # time since a segment began
        which = t.graph.piecewise(t, starts, (tuple(float(k % count) for k in range(pieces)),))
        columns: dict[str, Any] = {}
        for k, segment in enumerate(self.segments):
            here = _with_quaternions(segment.expressions(own, {**env, "t": own}))
            for name, value in here.items():
                columns[name] = where(which - (k - 0.5), value, columns[name]) if k else value
        for name, signs in self._signs(env).items():
            columns[name] = columns[name] * t.graph.piecewise(t, starts, (signs,))
        return with_attitudes(columns)

    def _signs(self, env: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
        """Return the signs by column of quaternions, segment by segment, which make them continuous."""
        parameters = {name[2:]: float(x) for name, x in env.items() if name.startswith("p.")}
        columns = position_columns(self.segments[0].joints)
        ends = [_ends(segment, columns, parameters) for segment in self.segments]
        by_column: dict[str, tuple[float, ...]] = {}
        for joint, places in attitude_places(columns).items():
            signs = [1.0]
            for k in range(1, len(self._starts) - 1):
                before, here = ends[(k - 1) % len(ends)].q[1, places], ends[k % len(ends)].q[0, places]
                signs.append(signs[-1] * (-1.0 if before @ here < 0.0 else 1.0))
            if min(signs) < 0.0:
                by_column |= {f"{joint}.{x}": tuple(signs) for x in QUATERNION}
        return by_column


def _with_quaternions(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return columns with the entries of unit quaternions in place of attitudes in any form."""
    columns: dict[str, Any] = {}
    for name, value in given.items():
        joint, _, form = name.rpartition(".")
        if form in FORMS:
            columns |= {f"{joint}.{x}": e for x, e in zip(QUATERNION, FORMS[form](vector(value)))}
        else:
            columns[name] = value
    return columns


def _ends(
    segment: JointSpaceTrajectory, columns: Sequence[str], parameters: Mapping[str, float]
) -> JointMotion:
    """Return the motion at the start and at the end."""
    return segment.motion(np.array([0.0, segment.duration]), columns, parameters)


def _gap(
    first: JointSpaceTrajectory, second: JointSpaceTrajectory, parameters: Mapping[str, float]
) -> str | None:
    """Return in words how the start of a motion differs from the end of another, None where they meet."""
    columns = position_columns(first.joints)
    before, after = _ends(first, columns, parameters), _ends(second, columns, parameters)
    q0, q1 = before.q[1], after.q[0].copy()
    for places in attitude_places(columns).values():
        q1[places] *= -1.0 if q0[places] @ q1[places] < 0.0 else 1.0
    for k, name in enumerate(columns):
        if abs(q1[k] - q0[k]) > MEET * max(1.0, abs(q0[k])):
            return f"{name} begins at {q1[k]:.12g}, not at {q0[k]:.12g}"
    scale, jump = np.abs(before.qd[1]).max(initial=1.0), np.abs(after.qd[0] - before.qd[1])
    if jump.max(initial=0.0) > MEET * scale:
        k = int(np.argmax(jump))
        return f"the motion begins with a rate of {after.qd[0, k]:.6g}, not of {before.qd[1, k]:.6g}"
    return None
