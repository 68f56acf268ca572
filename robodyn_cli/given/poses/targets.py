"""Targets and tasks of inverse kinematics, the positions that it gives, and the compiled steps of a mechanism towards a
pose."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError, did_you_mean, unknown_name
from robodyn_cli.expr.calculus import substitute
from robodyn_cli.expr.functions import absolute, maximum, minimum, sqrt, where
from robodyn_cli.expr.graph import Scalar, is_nonzero
from robodyn_cli.given.poses.criteria import Criterion, Given, PositionLimits, criterion_rows
from robodyn_cli.kernels.program import PARAMETERS
from robodyn_cli.kernels.samples import DATA, STATE, IterationKernel, SampleKernel
from robodyn_cli.model.model import FixedFrame, Model
from robodyn_cli.record import record
from robodyn_cli.scene.points import point_problem, with_points
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import rank, size_number
from robodyn_cli.solve.poses import steps
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Array, Matrix, dot, matrix

SAME = 1e-6  # rad or m, for positions that count as one


@record
class PoseDemand:
    """What is asked of a frame, and how its poses are sought.

    position : the components that are asked for, of ``xyz``. orientation : ``full``; ``axis``, the direction of
    ``axis`` (3,) in the frame's coordinates alone; or ``free``. criterion : what decides between positions: ``nearest``
    (to ``near``), ``away_from_limits``, ``least_torque``. limits : whether the joints' limits are respected.
    method : ``auto``, or ``damped`` for no closed form.
    """

    position: str = "xyz"
    orientation: str = "full"
    axis: Sequence[float] = (0.0, 0.0, 1.0)
    criterion: str = Criterion.NEAREST.value
    limits: bool = True
    method: str = "auto"

    def task(self, frame: FixedFrame) -> steps.PoseTask:
        """Return the task for a frame.

        Raises
        ------
        SceneError : a choice that there is not, or nothing is asked.
        """
        check_choice("orientation", self.orientation, steps.ORIENTATIONS)
        check_choice("method", self.method, ("auto", "damped"))
        check_choice("criterion", self.criterion, tuple(x.value for x in Criterion))
        position, length = self.position, float(np.linalg.norm(self.axis))
        if any(x not in "xyz" for x in position) or len(set(position)) != len(position):
            raise SceneError(f"position {position!r}: the components that are asked for, each once, of xyz")
        if not position and self.orientation == "free":
            raise SceneError("nothing is asked of the frame: neither a position nor an orientation")
        if len(self.axis) != 3 or not length > 0.0:
            raise SceneError(f"axis {list(self.axis)}: three numbers, not all zero")
        x, y, z = (float(x) / length for x in self.axis)
        return steps.PoseTask(
            frame, tuple(sorted("xyz".index(x) for x in position)), self.orientation, (x, y, z)
        )


@record
class Poses:
    """Positions q (T, nq) for T targets (T, 12), and what is left of them.

    targets : position, then rotation row by row. error : the larger of distance [m] and angle [rad] to each target,
    and of what the loops lack (T,). reached : (T,). branch : of each target the place of its branch in ``branch_names``
    of the inverse kinematics, -1 where no closed form found it.
    """

    targets: Array
    q: Array
    error: Array
    reached: Array
    branch: Array


@record
class Way:
    """One way to reach a pose: name, q (nq,), error, and whether it is within the joints' limits."""

    name: str
    q: Array
    error: float
    within_limits: bool


def packed_targets(task: steps.PoseTask, position: Array, rotation: Array | None) -> Array:
    """Return targets (T, 12) of positions and rotations as ``InverseKinematics.solve`` takes them.

    Raises
    ------
    SceneError : of another shape, or no rotation.
    """
    p = np.atleast_2d(np.asarray(position, dtype=float))
    if p.ndim != 2 or p.shape[1] != 3:
        raise SceneError(f"targets need positions of three numbers, here of shape {np.shape(position)}")
    if rotation is None:
        if task.orientation != "free":
            raise SceneError("a target with an orientation needs a rotation; or choose orientation: free")
        rotation = np.eye(3)
    R = np.asarray(rotation, dtype=float)
    if R.shape[-1] == 4:
        R = quaternion.rotations(R)
    if R.shape[-2:] != (3, 3) or R.ndim > 3 or np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max() > 1e-9:
        raise SceneError(f"targets need rotations (3, 3) or unit quaternions (4,), here of shape {R.shape}")
    T = max(len(p), len(R) if R.ndim == 3 else 1)
    return packed(np.broadcast_to(p, (T, 3)), np.broadcast_to(R, (T, 3, 3)))


def find_frame(model: Model, name: str) -> FixedFrame:
    """Return a named point, a named frame or a link's frame.

    Raises
    ------
    SceneError : there is none of that name.
    """
    for known in (model.frames, model.points, model.links):
        if name in known:
            return known[name]
    names = [*model.points, *model.frames, *model.links]
    raise SceneError(unknown_name("frame", name, names))


def with_frame(source: Scene | Problem, frame: str) -> Problem:
    """Return the equations, with a place such as ``LINK.end`` among the points."""
    if isinstance(source, Problem):
        return source
    named = "." in frame and point_problem(source.robot, frame) is None
    return Problem(with_points(source, [frame]) if named else source)


def check_choice(key: str, value: str | None, allowed: Sequence[str | None]) -> None:
    if value not in allowed:
        listed = ", ".join(x for x in allowed if x is not None) or "none: there is no closed form here"
        raise SceneError(
            f"{key} {value!r}{did_you_mean(str(value), [x for x in allowed if x])}; allowed: {listed}"
        )


def nothing_found(targets: Array, near: Array) -> Poses:
    """Return the result before anything is found."""
    T = len(near)
    return Poses(targets, near.copy(), np.full(T, np.inf), np.zeros(T, dtype=bool), np.full(T, -1))


def different(q: Array, rows: Array) -> list[int]:
    """Return the first of each group of rows whose positions q agree."""
    kept: list[int] = []
    for k in rows.tolist():
        if all(float(np.abs(q[k] - q[j]).max()) > SAME for j in kept):
            kept.append(k)
    return kept


RANK_STARTS = 3  # positions at which the freedom left by a task is counted
DAMPING_UP, DAMPING_DOWN = 4.0, 0.5  # of the criterion's steps, where its value grew or fell
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-4, 1e4
SETTLED = 1e-9  # rad, or part of the size of the mechanism: the step that ends them


@record
class Scaled:
    """All rows of loops and task in comparable units: e (m,), J (m, nv), and the measure of what is left."""

    e: list[Scalar]
    J: Matrix
    measure: Scalar


class PoseEquations:
    """The rows of one mechanism and one task over the symbols q, the data d (target, then a position near) and p.

    limits : of the joints, whose numbers are the parameters p. criterion : what decides where the mechanism is free.
    """

    def __init__(
        self, problem: Problem, task: steps.PoseTask, limits: PositionLimits, criterion: Criterion
    ) -> None:
        self.problem, self.task, self.limits, self.criterion = problem, task, limits, criterion
        model, graph = problem.model, problem.graph
        self.size = size_number(model)
        self.lengths = [self.size if unit == "m" else 1.0 for unit in model.v_units]
        names = [*(f"target{k}" for k in range(steps.TARGET)), *(f"near.{name}" for name in model.q_names)]
        data = graph.symbols(names, DATA)
        self.target, self.near = data[: steps.TARGET], data[steps.TARGET :]
        count = len(limits.places)
        p = graph.symbols([f"limit{k}" for k in range(2 * count)], PARAMETERS)
        self.lower, self.upper = p[:count], p[count:]
        place = dict(zip(limits.velocities, limits.places))
        self.bounds = steps.StepBounds(
            dict(zip(limits.velocities, self.lower)), dict(zip(limits.velocities, self.upper)), place
        )
        self.rows = self._scaled()

    def _scaled(self) -> Scaled:
        problem = self.problem
        task = steps.pose_rows(problem.model, problem.q, self.task, self.target)
        loops, at_start = problem.constraints.rows, dict[int, Scalar]({problem.t.index: 0.0})
        eta = substitute([row.eta for row in loops], at_start)
        e = [*(-x for x in eta), *task.error]
        rows = [*(substitute(list(row.psi), at_start) for row in loops), *task.J]
        lengths = [*(row.kind in ("force", "m") for row in loops), *task.lengths]
        sizes = [self.size if length else 1.0 for length in lengths]
        measure = task.measure
        for x in eta:
            measure = maximum(measure, absolute(x)) if is_nonzero(x) else measure
        J = matrix([x * unit / size for x, unit in zip(row, self.lengths)] for row, size in zip(rows, sizes))
        return Scaled([x / size for x, size in zip(e, sizes)], J, measure)

    @cached_property
    def moving(self) -> list[int]:
        """The velocity coordinates that loops or task depend on."""
        return [k for k, column in enumerate(self.rows.J.T) if any(is_nonzero(x) for x in column)]

    @cached_property
    def freedom(self) -> int:
        """How many freedoms the mechanism keeps when the task is met, in general poses."""
        rng = np.random.default_rng(1)
        model = self.problem.model
        points = rng.uniform(0.2, 0.8, (RANK_STARTS, model.nv))
        q = self.limits.spread(points, model, self.size)
        target = np.concatenate([np.zeros(3), np.eye(3).ravel()])
        return len(self.moving) - rank(np.stack([self.jacobian(x, target) for x in q]))

    def jacobian(self, q: Array, target: Array) -> Array:
        """Return J (m, nv) of all rows in comparable units at q (nq,), for a target (12,)."""
        return self.at(q, target)[1]

    def at(self, q: Array, target: Array) -> tuple[Array, Array]:
        """Return what is left of all rows e (m,), and J, likewise."""
        found = self._at(q=q[None], d=self.data(target[None], q), p=self.limits.numbers)
        return found["e"][0], found["J"].reshape(self.rows.J.shape)

    @cached_property
    def _at(self) -> SampleKernel:
        rows = self.rows
        return SampleKernel({"e": list(rows.e), "J": list(rows.J.flat)}, (STATE, DATA, PARAMETERS))

    @cached_property
    def reach(self) -> IterationKernel:
        """Damped steps onto the rows."""
        problem, rows = self.problem, self.rows
        J = rows.J
        if self.limits.places:
            J = J * self.bounds.free(problem.q, J.T @ np.array(rows.e, dtype=object))
        dq = steps.damped_step(rows.e, J)
        step = steps.position_after(problem.model, problem.q, dq, self.lengths, self.bounds, steps.MOST_STEP)
        return IterationKernel(step, rows.measure)

    @cached_property
    def criterion_rows(self) -> tuple[list[Scalar], Matrix]:
        """The criterion's rows c (k,), and C = dc/dq (k, nv)."""
        given = Given(self.near, self.limits, self.lower, self.upper, self.lengths)
        return criterion_rows(self.criterion, self.problem, given)

    @cached_property
    def value(self) -> SampleKernel:
        """The criterion's value |c|^2 / 2."""
        c, _ = self.criterion_rows
        return SampleKernel({"value": [0.5 * dot(c, c)]}, (STATE, DATA, PARAMETERS))

    @cached_property
    def improve(self) -> IterationKernel:
        """Steps along the poses that meet the rows to the criterion's smallest value."""
        c, C = self.criterion_rows
        C = matrix([x * unit for x, unit in zip(row, self.lengths)] for row in C)
        return self._least(c, C, self.rows.e, self.rows.J)

    @cached_property
    def approach(self) -> IterationKernel:
        """Steps to the pose nearest to a target that is out of reach, to which those of ``reach`` may not settle."""
        e, J = self.rows.e, self.rows.J
        return self._least(e, -J, [], J[:0])

    def _least(self, c: list[Scalar], C: Matrix, e: list[Scalar], J: Matrix) -> IterationKernel:
        """Return steps to the smallest |c|^2 where e vanishes; C = dc/dq.

        The state is q, the steps' damping and the value before; the damping grows where the value did.
        """
        problem = self.problem
        nq = problem.model.nq
        damping, before = (
            problem.graph.symbol(n, STATE, nq + k) for k, n in enumerate(("damping", "before"))
        )
        dq = steps.criterion_step(e, J, c, C, damping)
        if self.limits.places:
            free = self.bounds.free(problem.q, dq)
            dq = steps.criterion_step(e, J * free, c, C * free, damping)
        step = steps.position_after(
            problem.model, problem.q, dq, self.lengths, self.bounds, steps.CRITERION_STEP
        )
        value = 0.5 * dot(c, c) + dot(e, e)
        factor = where(value - before, DAMPING_UP, DAMPING_DOWN)
        after = minimum(maximum(damping * factor, LEAST_DAMPING), MOST_DAMPING)
        left = sqrt(dot(dq, dq))
        return IterationKernel([*step, after, value], maximum(self.rows.measure, left) if e else left)

    def settle(self, kernel: IterationKernel, q: Array, d: Array, rounds: int) -> Array:
        """Return the positions (T, nq) that ``improve`` or ``approach`` lead to from q with data d."""
        begin = np.tile([FIRST_DAMPING, np.inf], (len(q), 1))
        groups = {"q": np.concatenate([q, begin], axis=1), "d": d, "p": self.limits.numbers}
        state, _ = kernel(groups, SETTLED, rounds)
        return state[:, : q.shape[1]]

    def data(self, targets: Array, near: Array) -> Array:
        """Return targets (T, 12) and positions near (T, nq) as the data of samples."""
        return np.concatenate([targets, np.broadcast_to(near, (len(targets), near.shape[-1]))], axis=1)


def packed(position: Array, rotation: Array) -> Array:
    """Return targets (T, 12) of positions (T, 3) and rotations (T, 3, 3)."""
    return np.concatenate([position, rotation.reshape(len(rotation), 9)], axis=1)
