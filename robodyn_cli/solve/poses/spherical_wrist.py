"""Closed form of six-axis arms whose last three axes meet in a point, as of the Puma (Pieper 1968).

The wrist's centre depends on the first three axes alone, of which the second and third are parallel; the first may
have any other direction, and the links any offsets. Then the wrist turns what is left, R = R4 R5 R6.
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
class SphericalWrist:
    """Such an arm. centre : of the wrist in the zero position, base coordinates."""

    screws: Screws
    shoulder: Shoulder
    centre: Array
    words: ClassVar[tuple[tuple[str, str], ...]] = (SIDES, ELBOWS, WRISTS)

    @staticmethod
    def recognise(screws: Screws) -> SphericalWrist | None:
        """Return the arm, None if it has another structure."""
        if len(screws.axes) != 6 or len(screws.turning) != 6:
            return None
        first, second, third, fourth, fifth, sixth = screws.axes
        centre = screws.meet(fourth, fifth)
        if centre is None or not screws.passes(sixth, centre) or parallel(fifth, sixth):
            return None
        if not parallel(second, third) or parallel(first, second) or screws.passes(third, centre):
            return None
        if float(np.linalg.norm(np.cross(third.p - second.p, second.h))) <= 1e-12 * screws.scale:
            return None
        return SphericalWrist(screws, Shoulder.of(first, second, third.p, centre), centre)

    def branches(self, p: Array, R: Array) -> list[Branch]:
        """Return the eight ways to reach targets."""
        first, second, third, *_ = self.screws.axes
        turn = float(second.h @ third.h)  # of one direction, or of opposite ones
        centre = p + turned(R, self.centre - self.screws.p)
        found = []
        for side, sign, q1 in self.shoulder.angles(centre):
            R1 = rotations(first.h, q1)
            lever = turned_back(R1, centre - first.p) + first.p - second.p
            links = two_links(second.h, third.p - second.p, self.centre - third.p, lever)
            for bend, q2, q3 in links:
                R13 = R1 @ rotations(second.h, q2 + q3)
                left = np.swapaxes(R13, 1, 2) @ R
                for wrist, q456 in zip(WRISTS, self._wrist(left)):
                    values = np.column_stack([q1, q2, turn * q3, *q456])
                    found.append(Branch((side, elbow_name(bend, sign), wrist), values))
        return found

    def _wrist(self, left: Array) -> list[tuple[Array, Array, Array]]:
        """Return q4, q5 and q6 of both ways to turn by R4 R5 R6 = left (T, 3, 3): h4 . left h6 is known."""
        fourth, fifth, sixth = self.screws.axes[3:]
        end = turned(left, sixth.h)
        pair = component_angles(fourth.h, fifth.h, sixth.h, end @ fourth.h)
        # any direction across the sixth axis shows its angle, in the singular pose too
        across = np.cross(sixth.h, fifth.h)
        found = []
        for q5 in (pair.plus, pair.minus):
            R5 = rotations(fifth.h, q5)
            q4 = angle_between(fourth.h, turned(R5, sixth.h), end)
            rest = np.swapaxes(rotations(fourth.h, q4) @ R5, 1, 2) @ left
            q6 = angle_between(sixth.h, np.broadcast_to(across, end.shape), turned(rest, across))
            found.append((q4, q5, q6))
        return found
