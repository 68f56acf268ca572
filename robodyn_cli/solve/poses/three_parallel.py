"""Closed form of six-axis arms whose second, third and fourth axes are parallel, and whose last two meet, as of the UR.

Where the last two axes meet is known from the target, and so is its height along the parallel axes, which gives q1.
Then h2 . R h6 gives q5, the turn that is left q6, and the three parallel axes remain: two links and a turn.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.solve.poses.family import Branch
from robodyn_cli.solve.poses.screws import Screws, parallel
from robodyn_cli.solve.poses.shoulder import Shoulder, elbow_name, two_links
from robodyn_cli.solve.poses.subproblems import (
    angle_between,
    component_angles,
    rotations,
    turned,
    turned_back,
)
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import ELBOWS, SIDES, WRISTS


@record
class ThreeParallel:
    """Such an arm. centre : where the last two axes meet in the zero position, base coordinates."""

    screws: Screws
    shoulder: Shoulder
    centre: Array
    words: ClassVar[tuple[tuple[str, str], ...]] = (SIDES, ELBOWS, WRISTS)

    @staticmethod
    def recognise(screws: Screws) -> ThreeParallel | None:
        """Return the arm, None if it has another structure."""
        if len(screws.axes) != 6 or len(screws.turning) != 6:
            return None
        first, second, third, fourth, fifth, sixth = screws.axes
        centre = screws.meet(fifth, sixth)
        if centre is None or not parallel(second, third) or not parallel(second, fourth):
            return None
        if parallel(first, second) or parallel(fourth, fifth):
            return None
        links = (third.p - second.p, fourth.p - third.p)
        if any(float(np.linalg.norm(np.cross(x, second.h))) <= 1e-12 * screws.scale for x in links):
            return None
        # the fifth axis may pass the fourth at a distance, which turns with the three parallel axes
        return ThreeParallel(screws, Shoulder.of(first, second, third.p, centre), centre)

    def branches(self, p: Array, R: Array) -> list[Branch]:
        """Return the eight ways to reach targets."""
        first, second, third, fourth, fifth, sixth = self.screws.axes
        signs = [float(second.h @ axis.h) for axis in (third, fourth)]
        centre = p + turned(R, self.centre - self.screws.p)
        found = []
        for side, sign, q1 in self.shoulder.angles(centre):
            R1 = rotations(first.h, q1)
            left = np.swapaxes(R1, 1, 2) @ R
            pair = component_angles(second.h, fifth.h, sixth.h, turned(left, sixth.h) @ second.h)
            for wrist, q5 in zip(WRISTS, (pair.plus, pair.minus)):
                R5 = rotations(fifth.h, q5)
                # R5^T h2 is turned by R6^T to left^T h2
                height = np.broadcast_to(second.h, p.shape)
                q6 = angle_between(-sixth.h, turned_back(R5, height), turned_back(left, height))
                R234 = left @ np.swapaxes(R5 @ rotations(sixth.h, q6), 1, 2)
                q234 = angle_between(second.h, np.broadcast_to(fifth.h, p.shape), turned(R234, fifth.h))
                lever = turned_back(R1, centre - first.p) + first.p - second.p
                lever = lever - turned(rotations(second.h, q234), self.centre - fourth.p)
                for bend, q2, q3 in two_links(second.h, third.p - second.p, fourth.p - third.p, lever):
                    q4 = signs[1] * (q234 - q2 - q3)
                    values = np.column_stack([q1, q2, signs[0] * q3, q4, q5, q6])
                    found.append(Branch((side, elbow_name(bend, sign), wrist), values))
        return found
