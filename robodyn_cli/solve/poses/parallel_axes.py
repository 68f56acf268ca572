"""Closed form of arms whose axes are all parallel: planar 2R and 3R arms, SCARA robots, with a slide anywhere.

Two turning joints place a point in the plane across the axes; a third one turns the frame; the slide lifts it.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.solve.poses.family import Branch
from robodyn_cli.solve.poses.screws import Screws, parallel
from robodyn_cli.solve.poses.shoulder import two_links
from robodyn_cli.solve.poses.subproblems import angle_between, rotations, turned
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import ELBOWS


@record
class ParallelAxes:
    """Such an arm; elbow_up is the bend against the first axis, as of the planar arm theta2 < 0."""

    screws: Screws
    words: ClassVar[tuple[tuple[str, str], ...]] = (ELBOWS,)

    @staticmethod
    def recognise(screws: Screws, orientation: str) -> ParallelAxes | None:
        """Return the arm if a task with this orientation determines its joints, else None."""
        turning = screws.turning
        if len(turning) != {"full": 3, "free": 2}.get(orientation) or len(screws.axes) > len(turning) + 1:
            return None
        if any(not parallel(turning[0], axis) for axis in screws.axes):
            return None
        arm = ParallelAxes(screws)
        links = [link - turning[0].h * (turning[0].h @ link) for link in arm.links]
        if any(float(np.linalg.norm(x)) <= 1e-12 * screws.scale for x in links):
            return None
        return arm

    @property
    def links(self) -> tuple[Array, Array]:
        """The two links in the zero position: to the second turning axis, and on to the third, or the frame."""
        turning = self.screws.turning
        points = [axis.p for axis in turning] + ([self.screws.p] if len(turning) == 2 else [])
        return points[1] - points[0], points[2] - points[1]

    def branches(self, p: Array, R: Array) -> list[Branch]:
        """Return both ways to reach targets."""
        screws = self.screws
        turning = screws.turning
        first = turning[0]
        signs = [float(first.h @ axis.h) for axis in screws.axes]
        total = None
        lever = p - first.p
        if len(turning) == 3:
            helper = np.eye(3)[int(np.argmin(np.abs(first.h)))]
            total = angle_between(first.h, np.broadcast_to(helper, p.shape), turned(R, helper))
            lever = lever - turned(rotations(first.h, total), screws.p - turning[2].p)
        lift = (p - screws.p) @ first.h
        found = []
        for bend, q1, q2 in two_links(first.h, *self.links, lever):
            angles = [q1, q2] if total is None else [q1, q2, total - q1 - q2]
            rest = iter(angles)
            columns = [sign * (next(rest) if axis.turns else lift) for sign, axis in zip(signs, screws.axes)]
            found.append(Branch((ELBOWS[bend > 0.0],), np.column_stack(columns)))
        return found
