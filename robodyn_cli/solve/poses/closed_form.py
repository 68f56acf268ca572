"""Closed-form inverse kinematics: which arms have one, the families of these, and what all of them give.

Closed form of arms whose axes are all parallel: planar 2R and 3R arms, SCARA robots, with a slide anywhere.

Two turning joints place a point in the plane across the axes; a third one turns the frame; the slide lifts it.

What the six-axis families share: the first axis with its two sides, then two parallel axes as shoulder and elbow.

Closed form of six-axis arms whose last three axes meet in a point, as of the Puma (Pieper 1968).

The wrist's centre depends on the first three axes alone, of which the second and third are parallel; the first may
have any other direction, and the links any offsets. Then the wrist turns what is left, R = R4 R5 R6.

Closed form of six-axis arms whose second, third and fourth axes are parallel, and whose last two meet, as of the UR.

Where the last two axes meet is known from the target, and so is its height along the parallel axes, which gives q1.
Then h2 . R h6 gives q5, the turn that is left q6, and the three parallel axes remain: two links and a turn.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Protocol

import numpy as np

from robodyn_cli.model.model import Model
from robodyn_cli.record import record
from robodyn_cli.solve.planar_2r import two_bars
from robodyn_cli.solve.poses.screws import (
    Axis,
    Screws,
    angle_between,
    component_angles,
    dots,
    parallel,
    rotations,
    turned,
    turned_back,
)
from robodyn_cli.solve.poses.steps import PoseTask
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import ELBOWS, SIDES, WRISTS


@record
class Branch:
    """One way to reach targets: its name, a word for each choice, and values (T, k) of the axes in their order.

    A target that is out of reach has the values of a pose near it.
    """

    name: tuple[str, ...]
    values: Array


class ArmFamily(Protocol):
    """Arms of one structure. words : for each choice, the words of its two sides; axes : of the arm."""

    @property
    def words(self) -> tuple[tuple[str, str], ...]: ...

    @property
    def screws(self) -> Screws: ...

    def branches(self, p: Array, R: Array) -> list[Branch]:
        """Return all ways to reach targets p (T, 3) and R (T, 3, 3) in base coordinates, R as a turn from zero."""
        ...


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
        branches = []
        for bend, q1, q2 in two_links(first.h, *self.links, lever):
            angles = [q1, q2] if total is None else [q1, q2, total - q1 - q2]
            rest = iter(angles)
            columns = [sign * (next(rest) if axis.turns else lift) for sign, axis in zip(signs, screws.axes)]
            branches.append(Branch((ELBOWS[bend > 0.0],), np.column_stack(columns)))
        return branches


@record
class Shoulder:
    """The first axis and the parallel second one, with a point that the arm carries at a known height along the latter.

    first, second : the axes. end : the point in the zero position. forward : +1 or -1, which side of the first axis
    along (h1 x h2) counts as the front: the one on which the point, or else the elbow, is in the zero position.
    """

    first: Axis
    second: Axis
    end: Array
    forward: float

    @staticmethod
    def of(first: Axis, second: Axis, elbow: Array, end: Array) -> Shoulder:
        """Return the shoulder of an arm whose second and third axes are parallel."""
        front = np.cross(first.h, second.h)
        sides = [float(front @ (x - first.p)) for x in (end, elbow)]
        scale = max(float(np.linalg.norm(end - first.p)), float(np.linalg.norm(elbow - first.p)))
        clear = [x for x in sides if abs(x) > 1e-9 * scale]
        return Shoulder(first, second, end, float(np.sign(clear[0])) if clear else 1.0)

    def angles(self, target: Array) -> Iterator[tuple[str, float, Array]]:
        """Give q1 (T,) for targets (T, 3) of the point: h2 . rot(h1, -q1) x is known.

        Before it come the name of the side to which the arm reaches, and its sign along h1 x h2.
        """
        lever = target - self.first.p
        height = np.full(len(target), float(self.second.h @ (self.end - self.first.p)))
        pair = component_angles(self.second.h, -self.first.h, lever, height)
        # the derivative of the height by q1 is h2 . (-h1 x u) = (h1 x h2) . u: how far in front the point u lies
        sides = ((1.0, pair.plus), (-1.0, pair.minus))
        for name, (sign, q1) in zip(SIDES, sides if self.forward > 0.0 else sides[::-1]):
            yield name, sign, q1


def two_links(h: Array, upper: Array, lower: Array, target: Array) -> Iterator[tuple[float, Array, Array]]:
    """Give the angles (T,) of shoulder and elbow, both about h, for which two links reach a target.

    upper, lower : (3,) in the zero position. target : (T, 3) from the shoulder, at their height along h. The first
    entry is the sign of the bend, that of h . (upper x lower) as they are then.
    """
    flat = target - np.outer(dots(target, h), h)
    u, w = upper - h * (h @ upper), lower - h * (h @ lower)
    bend, lean = two_bars(float(np.linalg.norm(u)), float(np.linalg.norm(w)), np.linalg.norm(flat, axis=1))
    towards, at_zero = angle_between(h, np.broadcast_to(u, flat.shape), flat), angle_between(h, u, w)
    for sign in (1.0, -1.0):
        yield sign, towards - sign * lean, sign * bend - at_zero


def elbow_name(bend: float, side: float) -> str:
    """Return whether the elbow is on the side of h1: the bend's sign about h2, for an arm that reaches to that side."""
    return ELBOWS[0] if bend * side < 0.0 else ELBOWS[1]


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
        branches = []
        for side, sign, q1 in self.shoulder.angles(centre):
            R1 = rotations(first.h, q1)
            lever = turned_back(R1, centre - first.p) + first.p - second.p
            links = two_links(second.h, third.p - second.p, self.centre - third.p, lever)
            for bend, q2, q3 in links:
                R13 = R1 @ rotations(second.h, q2 + q3)
                left = np.swapaxes(R13, 1, 2) @ R
                for wrist, q456 in zip(WRISTS, self._wrist(left)):
                    values = np.column_stack([q1, q2, turn * q3, *q456])
                    branches.append(Branch((side, elbow_name(bend, sign), wrist), values))
        return branches

    def _wrist(self, left: Array) -> list[tuple[Array, Array, Array]]:
        """Return q4, q5 and q6 of both ways to turn by R4 R5 R6 = left (T, 3, 3): h4 . left h6 is known."""
        fourth, fifth, sixth = self.screws.axes[3:]
        end = turned(left, sixth.h)
        pair = component_angles(fourth.h, fifth.h, sixth.h, end @ fourth.h)
        # any direction across the sixth axis shows its angle, in the singular pose too
        across = np.cross(sixth.h, fifth.h)
        ways = []
        for q5 in (pair.plus, pair.minus):
            R5 = rotations(fifth.h, q5)
            q4 = angle_between(fourth.h, turned(R5, sixth.h), end)
            rest = np.swapaxes(rotations(fourth.h, q4) @ R5, 1, 2) @ left
            q6 = angle_between(sixth.h, np.broadcast_to(across, end.shape), turned(rest, across))
            ways.append((q4, q5, q6))
        return ways


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
        branches = []
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
                    branches.append(Branch((side, elbow_name(bend, sign), wrist), values))
        return branches


@record
class ClosedForm:
    """The closed form of one arm and one task."""

    family: ArmFamily

    @staticmethod
    def of(model: Model, task: PoseTask) -> ClosedForm | None:
        """Return the closed form of an arm for a task, None where there is none."""
        screws = Screws.of(model, task.frame)
        if screws is None or len(task.position) != 3:
            return None
        if task.orientation == "full":
            six: ArmFamily | None = SphericalWrist.recognise(screws) or ThreeParallel.recognise(screws)
            if six is not None:
                return ClosedForm(six)
        arm: ArmFamily | None = ParallelAxes.recognise(screws, task.orientation)
        return None if arm is None else ClosedForm(arm)

    @property
    def names(self) -> list[tuple[str, ...]]:
        """All branches by name, those of the first choice together."""
        names: list[tuple[str, ...]] = [()]
        for pair in self.family.words:
            names = [(*name, word) for name in names for word in pair]
        return names

    def branches(self, p: Array, R: Array, others: Array) -> dict[tuple[str, ...], Array]:
        """Return q (T, nq) of each branch for targets p (T, 3) and R (T, 3, 3) of the world.

        others : (T, nq) positions, of which the joints keep theirs that do not move the frame.
        """
        screws = self.family.screws
        branches = {}
        for branch in self.family.branches(*screws.in_base(p, R)):
            q = np.array(np.broadcast_to(others, (len(p), screws.nq)), dtype=float)
            for axis, column in zip(screws.axes, branch.values.T):
                q[:, axis.place] = column
            branches[branch.name] = q
        return branches
