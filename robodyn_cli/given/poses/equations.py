"""A mechanism's steps towards a pose, compiled: what its loops and the task ask together."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.calculus import substitute
from robodyn_cli.expr.functions import absolute, maximum, minimum, sqrt, where
from robodyn_cli.expr.graph import Scalar, is_nonzero
from robodyn_cli.given.poses.criteria import Criterion, Given, PositionLimits, criterion_rows
from robodyn_cli.kernels.program import PARAMETERS
from robodyn_cli.kernels.samples import DATA, STATE, IterationKernel, SampleKernel
from robodyn_cli.record import record
from robodyn_cli.solve.closure import rank, size_number
from robodyn_cli.solve.poses.steps import (
    CRITERION_STEP,
    MOST_STEP,
    TARGET,
    PoseTask,
    StepBounds,
    criterion_step,
    damped_step,
    pose_rows,
    position_after,
)
from robodyn_cli.spatial.algebra import Array, Matrix, dot, matrix

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
        self, problem: Problem, task: PoseTask, limits: PositionLimits, criterion: Criterion
    ) -> None:
        self.problem, self.task, self.limits, self.criterion = problem, task, limits, criterion
        model, graph = problem.model, problem.graph
        self.size = size_number(model)
        self.lengths = [self.size if unit == "m" else 1.0 for unit in model.v_units]
        names = [*(f"target{k}" for k in range(TARGET)), *(f"near.{name}" for name in model.q_names)]
        data = graph.symbols(names, DATA)
        self.target, self.near = data[:TARGET], data[TARGET:]
        count = len(limits.places)
        p = graph.symbols([f"limit{k}" for k in range(2 * count)], PARAMETERS)
        self.lower, self.upper = p[:count], p[count:]
        place = dict(zip(limits.velocities, limits.places))
        self.bounds = StepBounds(
            dict(zip(limits.velocities, self.lower)), dict(zip(limits.velocities, self.upper)), place
        )
        self.rows = self._scaled()

    def _scaled(self) -> Scaled:
        problem = self.problem
        task = pose_rows(problem.model, problem.q, self.task, self.target)
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
        kernel = self._jacobian
        d = self.data(target[None], q)
        return kernel(q=q[None], d=d, p=self.limits.numbers)["J"].reshape(self.rows.J.shape)

    @cached_property
    def _jacobian(self) -> SampleKernel:
        return SampleKernel({"J": list(self.rows.J.flat)}, (STATE, DATA, PARAMETERS))

    @cached_property
    def reach(self) -> IterationKernel:
        """Damped steps onto the rows."""
        problem, rows = self.problem, self.rows
        J = rows.J
        if self.limits.places:
            J = J * self.bounds.free(problem.q, J.T @ np.array(rows.e, dtype=object))
        dq = damped_step(rows.e, J)
        step = position_after(problem.model, problem.q, dq, self.lengths, self.bounds, MOST_STEP)
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
        dq = criterion_step(e, J, c, C, damping)
        if self.limits.places:
            free = self.bounds.free(problem.q, dq)
            dq = criterion_step(e, J * free, c, C * free, damping)
        step = position_after(problem.model, problem.q, dq, self.lengths, self.bounds, CRITERION_STEP)
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
