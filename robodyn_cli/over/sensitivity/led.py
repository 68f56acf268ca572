"""How the motion that a trajectory, a sweep or prescribed joints give changes with keys of the scene.

What a trajectory asks at a sample is a formula of its own numbers; its derivatives are differences (``given_changes``).
The joints follow from it by the implicit function theorem, level by level: with the rows F(q, t, k) = 0 of the loops
and of what is led, and their rates,

    J dq = -F_k,   J dv = -(J v)_q dq - (J v)_k,   J da = -(J v-dot + gamma)_q dq - (...)_v dv - (...)_k
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.algorithms.kinematics import position_rates
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.many import ByKeys
from robodyn_cli.given.loop_conditions import Lead, LoopConditions, lead_of
from robodyn_cli.given.motion import plan_motion
from robodyn_cli.kernels.program import Program
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import NARROWER, extrapolated
from robodyn_cli.over.sensitivity.gradients import Along, MotionGradients
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.guided import SINGULAR
from robodyn_cli.spatial.algebra import Array, identity
from robodyn_cli.trajectories.base import TaskSpaceTrajectory

WIDEST = 1e-3  # part of a key's value by which it is changed
LEVELS = 3
ROUNDED = 1e-14  # of the largest entry of an array
JUMPS = 1e-5  # error of a derivative, of the largest one, beyond which what is asked jumps at a sample
LOADS = ("robot.links.", "forces.", "gravity")  # keys of what moves along, and of what acts on it
Arrays = Sequence[Array]


def given_changes(
    asked: AskedSlopes, numbers: Sequence[int], own: Arrays, give: Callable[[Scene], Arrays]
) -> list[Array]:
    """Return the derivatives (..., K) of arrays that a scene gives, by some of the keys.

    Parameters
    ----------
    own : the arrays of the scene as it stands. give : those of a scene: formulas of its numbers, without anything that
        is solved.

    Raises
    ------
    CapabilityError : an array jumps.
    """
    changes = [np.zeros((*x.shape, len(numbers))) for x in own]
    if _alike(own, give(asked.changed(numbers, WIDEST))):
        return changes
    for place, k in enumerate(numbers):
        if _alike(own, give(asked.changed([k], WIDEST))):
            continue
        for array, slope in zip(changes, _slopes(asked, k, give)):
            array[..., place] = slope
    return changes


def _slopes(asked: AskedSlopes, k: int, give: Callable[[Scene], Arrays]) -> list[Array]:
    """Return the derivatives of arrays by one key."""
    slopes = []
    parts = [WIDEST / NARROWER**level for level in range(LEVELS)]
    steps = [2.0 * part * (abs(asked.values[k]) or 1.0) for part in parts]
    sides = [[give(asked.changed([k], way * part)) for way in (1.0, -1.0)] for part in parts]
    for arrays in zip(*(zip(*pair) for pair in sides)):
        if len({a.shape for pair in arrays for a in pair}) > 1:
            raise CapabilityError(
                "the motion is cut at other places when the key changes, as where joints turn back"
            )
        raw = np.array([(a - b) / step for (a, b), step in zip(arrays, steps)])
        size = max(float(np.abs(a).max(initial=0.0)) for pair in arrays for a in pair)
        noise = np.array([np.full(raw[0].shape, ROUNDED * size / step) for step in steps])
        slope, error = extrapolated(raw, noise)
        if np.any(error > JUMPS * float(np.abs(slope).max(initial=0.0)) + noise[-1].max(initial=0.0)):
            raise CapabilityError(
                "the motion that the trajectory gives jumps at a sample when the key changes"
            )
        slopes.append(slope)
    return slopes


def _alike(one: Arrays, two: Arrays) -> bool:
    return all(x.shape == y.shape and np.array_equal(x, y) for x, y in zip(one, two))


class LedCourse:
    """What a scene asks of its motion at times (T,): of the joints or the point that lead, or of all joints.

    Parameters
    ----------
    times_of : gives the times, which may take a motion that is followed. lead : without it the trajectory leads an open
        chain, a point of it or all joints.
    """

    def __init__(self, problem: Problem, times_of: Callable[[], Array], lead: Lead | None) -> None:
        point = lead is None and isinstance(problem.scene.trajectory, TaskSpaceTrajectory)
        self.problem, self._times_of = problem, times_of
        self.lead = lead_of(problem) if point else lead

    @cached_property
    def times(self) -> Array:
        return self._times_of()

    @cached_property
    def arrays(self) -> list[Array]:
        """The times, and positions or values, rates and accelerations (T, k) that are asked for."""
        if self.lead is not None:
            return [self.times, *self.lead.asked(self.times)]
        motion = plan_motion(self.problem, self.times).motion
        return [self.times, motion.q, motion.qd, motion.qdd]


class LedSlopes:
    """The derivatives of the motion that a scene asks for, by some keys, which are named by their numbers.

    Parameters
    ----------
    course_of : what a scene asks for.

    Raises
    ------
    CapabilityError : an operation, or a number, has no derivative, or the motion has no times of its own.
    """

    def __init__(
        self,
        asked: AskedSlopes,
        scene: Scene,
        numbers: Sequence[int],
        course_of: Callable[[Scene], LedCourse],
    ) -> None:
        if scene.trajectory is not None and not scene.trajectory.in_time:
            raise CapabilityError("limits of torques or paths decide the motion")
        self.asked, self.numbers, self.course_of = asked, numbers, course_of
        self.course = course_of(scene)
        self.places = asked.places(numbers)
        self.motion: LedMotion | None = None
        if self.course.lead is not None:
            self.motion = LedMotion(self.course.problem, self.course.lead, self.places)

    @property
    def programs(self) -> list[Program]:
        """The code of values and derivatives."""
        return [] if self.motion is None else [self.motion.gradients.program]

    def moved(self, groups: Mapping[str, Array]) -> dict[str, Array]:
        """Return the derivatives (T, n, K) of t, q, v and v-dot along a motion."""
        if self.motion is None and any(place.startswith("prescribed.") for place in self.places):
            raise CapabilityError(
                "a prescribed motion changes, and only those of trajectories have exact derivatives"
            )
        dt, *given = self._given_changes()
        if self.motion is None:
            return {"t": dt[:, None], **dict(zip(("q", "v", "a"), given))}
        along = self.motion.gradients(groups)
        return self.motion.changes(along, dt[:, None], [*given, self.course.arrays[1]])

    def _given_changes(self) -> list[Array]:
        """Return the derivatives of the times, and of what is asked for, by the keys."""
        own = self.course.arrays
        found = [np.zeros((*x.shape, len(self.numbers))) for x in own]
        moving = [place for place, k in enumerate(self.numbers) if not self._leaves_the_motion(k)]
        if moving:
            some = [self.numbers[place] for place in moving]
            changes = given_changes(self.asked, some, own, lambda scene: self.course_of(scene).arrays)
            for array, change in zip(found, changes):
                array[..., moving] = change
        return found

    def _leaves_the_motion(self, k: int) -> bool:
        """Tell whether a motion that conditions determine knows nothing of a key: a number of links and forces that
        these do not read."""
        place = self.places[self.numbers.index(k)]
        if self.motion is None or not place.startswith(LOADS):
            return False
        by_key = ByKeys({place: 0})
        return not any(by_key(x) for program in self.programs for x in program.numbers)


class LedMotion:
    """The derivatives of a motion that conditions determine.

    Raises
    ------
    CapabilityError : an operation, or a number, has no derivative.
    """

    def __init__(self, problem: Problem, lead: Lead, places: Sequence[str]) -> None:
        self.conditions, self.nv = LoopConditions(problem, lead, np.zeros(1)), problem.model.nv
        if lead.led is None and not set(lead.joints) <= set(lead.positions):
            raise CapabilityError("attitudes of joints are led")
        levels = dict(zip((*LEVELS_OF, "J"), self.conditions.levels()))
        self.gradients = MotionGradients(problem, {**levels, "N": velocity_map(problem)}, places)

    def changes(self, along: Along, dt: Array, asked: Arrays = ()) -> dict[str, Array]:
        """Return the derivatives (T, n, K) of t, q, v and v-dot.

        Parameters
        ----------
        along : ``gradients`` along the motion. dt : of the times of the samples (T, 1, K). asked : of the values, rates
            and accelerations that are asked for (T, k, K), and these values (T, k) themselves; nothing where no key
            changes what is asked for.

        Raises
        ------
        CapabilityError : the conditions do not determine the motion.
        """
        conditions = self.conditions
        sizes = conditions.sizes[:, None]
        J = along["J"].reshape(len(dt), -1, self.nv) * conditions.lengths / sizes
        s = np.linalg.svd(J, compute_uv=False)
        if s.shape[1] < self.nv or np.any(s[:, -1] < SINGULAR * s[:, 0]):
            raise CapabilityError(
                "the led joints or point leave joints free, which go the way with the least rates"
            )
        back = conditions.lengths[:, None] * np.linalg.pinv(J)
        moved = {"t": dt}
        N = along["N"].reshape(len(dt), -1, self.nv)
        for level, (name, group) in enumerate(LEVELS_OF.items()):
            rows = self._rows(along[name], along.change(name, moved))
            if conditions.led and asked:
                rows[:, -conditions.led :] -= self._asked_rows(asked, level)
            step = -(back @ (rows / sizes))
            moved[group] = N @ step if level == 0 else step
        return moved

    def _rows(self, values: Array, change: Array) -> Array:
        """Return the change of the rows (T, m, K): of a pose that of its attitude as a rotation; none of led joints."""
        conditions = self.conditions
        m, led = len(conditions.names), conditions.lead.led
        if led is None and change.shape[1] < m:
            joints = np.zeros((len(change), m - change.shape[1], change.shape[2]))
            return np.concatenate([change, joints], axis=1)
        if change.shape[1] == m:
            return change
        return np.concatenate([change[:, : m - 3], _turned(values[:, m - 3 :], change[:, m - 3 :])], axis=1)

    def _asked_rows(self, asked: Arrays, level: int) -> Array:
        """Return the change of what is asked for, in rows (T, led, K)."""
        change, lead = asked[level], self.conditions.lead
        if level:
            return change
        if lead.led is None:
            return change[:, [lead.positions.index(name) for name in lead.joints]]
        if not lead.led.oriented:
            return change
        return np.concatenate([change[:, :-AXES], _turned(asked[3][:, -AXES:], change[:, -AXES:])], axis=1)


AXES = 9  # of a pose, at the end of its values
LEVELS_OF = {"values": "q", "rates": "v", "accelerations": "a"}  # names of levels, and what each determines


def velocity_map(problem: Problem) -> list[Scalar]:
    """Return N (nq nv,) of q-dot = N v, row by row."""
    columns = [position_rates(problem.model, problem.q, unit) for unit in identity(problem.model.nv)]
    return [column[i] for i in range(problem.model.nq) for column in columns]


def _turned(R: Array, change: Array) -> Array:
    """Return w (T, 3, K) of a change of axes: dR R^T = [w x]."""
    R = R.reshape(-1, 3, 3)
    dR = np.moveaxis(change.reshape(len(R), 3, 3, -1), 3, 1)
    W = dR @ np.swapaxes(R, 1, 2)[:, None]
    w = np.stack(
        [W[..., 2, 1] - W[..., 1, 2], W[..., 0, 2] - W[..., 2, 0], W[..., 1, 0] - W[..., 0, 1]], axis=1
    )
    return 0.5 * w
