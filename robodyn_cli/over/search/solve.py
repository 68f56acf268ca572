"""One solver's way from a start: SciPy's methods on outputs of runs, with keys and outputs scaled to numbers of size 1.

A goal that is to be reached is a problem of least squares (trust region, bounds by reflection); least and largest
outputs, and constraints, are sequential quadratic programming. A run that fails on the way shortens the step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robodyn_cli.over.search.asked import Constraint, Goal, Search, middle
from robodyn_cli.over.search.points import DesignPoint, OutputSlopes
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

MOST_STEPS = 100  # of a solver
PATIENCE = 10  # points that a solver may take beyond twice those of the first one that met all targets
CORNER = 0.1  # of a derivative: a larger error says that there is none
LAST_STEP = 1e-10  # of the keys: a shorter one is the last, as the next would be about its square
CLOSE = 1e-15  # of scaled numbers: a solver stops when it moves no more
LEAST_CHANGE = 1e-13  # of the scaled output that is minimised, below which its solver stops
INSIDE = 1e-9  # of the size of an output, by which a constraint is kept beside the error of the run
LEVEL = 12  # points in a row that differ by no more than the errors of their runs: a solver learns nothing from more
ROUNDED = 1e-14  # of an output: what runs differ by that are the same
FAILING = 10.0  # times the sizes of outputs: what a failing run counts as, so that the next step is shorter
WELL_MET = 1e-3  # of the error of a run, within which a target needs no further step
MISSED = 1e-6  # of the size of an output: a target without a tolerance of its own is missed beyond


class NoWay(Exception):
    """A solver can go no further from where it is."""


@record
class Asks:
    """What a solver asks of a place u between the bounds: the run there, or derivatives there as well."""

    x: Array
    slopes: bool


Ask = Callable[[Asks], tuple[DesignPoint, OutputSlopes | None]]


@record
class ScaledSearch:
    """The numbers of a search, scaled: keys u from 0 to 1 between their bounds, outputs over their sizes (n,)."""

    search: Search
    values: Array
    sizes: Array

    @property
    def goal(self) -> Goal:
        return self.search.goal

    @property
    def span(self) -> Array:
        """Length of the way between the bounds (n,)."""
        return np.asarray(np.ptp(self.search.bounds, axis=1))

    def jacobian(self, slopes: OutputSlopes) -> Array:
        """Return d output / du (n, len(u)), scaled."""
        return np.asarray(slopes.values[:, list(self.search.continuous)] * self.span / self.sizes[:, None])

    def jumps(self, slopes: OutputSlopes) -> float:
        """Return how far outputs that are looked for jump from run to run, where their derivatives say nothing of where
        to go because of that; else 0."""
        rows, columns = list(self.goal.outputs), list(self.search.continuous)
        values, errors = (x[np.ix_(rows, columns)] for x in (slopes.values, slopes.errors))
        return float(slopes.jumps[rows].max()) if (errors >= np.abs(values)).all() else 0.0

    def residuals(self, y: Array) -> Array:
        """Return what outputs lack to their targets."""
        goal = self.goal
        wanted = np.array([middle(target) for target in goal.targets])
        rows = list(goal.outputs)
        return np.asarray((y[rows] - wanted) / self.sizes[rows])

    def misses(self, point: DesignPoint) -> Array:
        """Return by how much outputs miss their targets, over what they may: at most 1 where they are met."""
        goal, rows = self.goal, list(self.goal.outputs)
        off = np.abs(self.residuals(point.y)) * self.sizes[rows]
        return off / self.tolerances(point, goal)

    def tolerances(self, point: DesignPoint, goal: Goal) -> Array:
        """Return how far outputs may be from their targets: what is asked, else the error of the run and a little."""
        rows = list(goal.outputs)
        own = np.array([0.5 * (target.high - target.low) for target in goal.targets])
        default = np.maximum(np.nan_to_num(point.error[rows]), MISSED * self.sizes[rows])
        return np.where(own > 0.0, own, default)

    def objective(self, y: Array) -> float:
        """Return what is minimised: the output itself, or half the sum of squared residuals."""
        if self.goal.is_reach:
            r = self.residuals(y)
            return 0.5 * float(r @ r)
        k = self.goal.outputs[0]
        return self.goal.sign * float(y[k]) / float(self.sizes[k])

    def gradient(self, y: Array, J: Array) -> Array:
        """Return the derivative of the objective by u."""
        if self.goal.is_reach:
            return np.asarray(self.residuals(y) @ J[list(self.goal.outputs)])
        return np.asarray(self.goal.sign * J[self.goal.outputs[0]])

    @property
    def sides(self) -> list[tuple[Constraint, float, float]]:
        """The sides of the constraints: each with its sign and its bound, sign * (bound - y) >= 0."""
        return [
            (limit, sign, bound)
            for limit in self.search.limits
            for sign, bound in ((1.0, limit.expected.high), (-1.0, limit.expected.low))
            if np.isfinite(bound)
        ]

    def room(self, point: DesignPoint) -> Array:
        """Return how far each side of a constraint is away, the error of the run left out, scaled; negative beyond."""
        return np.array([
            sign * (bound - point.y[limit.output]) / self.sizes[limit.output]
            - float(np.nan_to_num(point.error[limit.output])) / self.sizes[limit.output] - INSIDE
            for limit, sign, bound in self.sides
        ])  # fmt: skip

    def room_slopes(self, J: Array) -> Array:
        """Return the derivative of ``room`` by u."""
        return np.array([-sign * J[limit.output] for limit, sign, _ in self.sides]).reshape(-1, J.shape[1])

    def holds(self, point: DesignPoint) -> bool:
        """Tell whether a run ended well and all constraints hold of it."""
        return point.is_good and all(
            limit.expected.holds(float(point.y[limit.output])) for limit in self.search.limits
        )

    def rank(self, point: DesignPoint) -> tuple[float, float]:
        """Return by what points are compared: what they break, then what is minimised."""
        if not point.is_good:
            return np.inf, np.inf
        broken = [
            max(0.0, limit.excess(point.y[limit.output])) / self.sizes[limit.output]
            for limit in self.search.limits
        ]
        return sum(broken), self.objective(point.y)


@record
class SolverWay:
    """A solver's way: the points that it asked for in their order, and why it ended; converged : at an optimum.

    derived : those with derivatives.
    """

    scaled: ScaledSearch
    points: tuple[DesignPoint, ...]
    derived: tuple[DesignPoint, ...]
    converged: bool
    why: str

    @property
    def best(self) -> DesignPoint:
        """The best point on the way."""
        return min(self.points, key=self.scaled.rank)


class FirstMet:
    """After how many points the first of several solvers met all targets; None as long as none has."""

    points: int | None = None

    def is_long_ago(self, points: int) -> bool:
        """Tell whether a solver that has asked for so many points has taken much longer."""
        return self.points is not None and points > 2 * self.points + PATIENCE


class Solver:
    """A solver from one start u (n,); first : what all solvers of a search share."""

    def __init__(self, scaled: ScaledSearch, start: Array, first: FirstMet) -> None:
        self.scaled, self.start, self.first = scaled, start, first
        self.points: list[DesignPoint] = []
        self.derived: list[DesignPoint] = []
        self._ask: Ask
        self._last: dict[bytes, DesignPoint] = {}
        self._good: DesignPoint | None = None

    def __call__(self, ask: Ask) -> SolverWay:
        """Return the way to an optimum nearby; ask : makes points."""
        self._ask = ask
        try:
            with np.errstate(all="ignore"):
                converged, why = self._solve()
        except LevelGround:
            converged, why = True, f"the last {LEVEL} runs differ by no more than their errors"
        except NoWay as end:
            converged, why = False, str(end)
        return SolverWay(self.scaled, tuple(self.points), tuple(self.derived), converged, why)

    def _solve(self) -> tuple[bool, str]:
        if not self.scaled.goal.is_reach:
            return self._minimise(self.start)
        converged, why = self._least_squares()
        best = min(self.points, key=self.scaled.rank)
        met = best.is_good and bool((self.scaled.misses(best) <= 1.0).all())
        many = len(self.start) > len(self.scaled.goal.outputs)
        if (self.scaled.search.limits and not self.scaled.holds(best)) or (many and not met):
            return self._minimise(self.scaled.search.place(best.x))
        return converged, why

    # -- what SciPy asks for --------------------------------------------------------------------------------
    def _at(self, u: Array) -> DesignPoint:
        x = self.scaled.search.value_of(u, self.scaled.values)
        key = x.tobytes()
        if key not in self._last:
            if self.first.is_long_ago(len(self.points)):
                raise NoWay("another start met the targets long before")
            point, _ = self._ask(Asks(x, False))
            self.points.append(point)
            self._last[key] = point
            if point.is_good:
                self._good = point
            if self._is_level():
                raise LevelGround
        return self._last[key]

    def _is_level(self) -> bool:
        """Tell whether the last points have the same outputs within the errors of their runs."""
        last = self.points[-LEVEL:]
        if len(last) < LEVEL or not all(point.is_good for point in last):
            return False
        scaled = self.scaled
        rows = [*scaled.goal.outputs, *(limit.output for limit in scaled.search.limits)]
        y, error = (np.array(values)[:, rows] for values in ([p.y for p in last], [p.error for p in last]))
        least = np.nan_to_num(error).max(axis=0) + ROUNDED * np.abs(y).max(axis=0)
        return bool((np.ptp(y, axis=0) <= least).all())

    def _jacobian(self, u: Array) -> Array:
        point = self._at(u)
        if not point.is_good:
            raise NoWay(f"runs nearby fail: {point.reason}")
        _, slopes = self._ask(Asks(point.x, True))
        assert slopes is not None
        J = self.scaled.jacobian(slopes)
        if not np.isfinite(J).all():
            raise NoWay("an output has no derivative there: runs on both sides fail")
        if self.scaled.jumps(slopes) and self.scaled.holds(point):
            raise NoWay("what is asked for jumps from run to run by more than it changes with the keys")
        if self.scaled.goal.is_reach and bool((self.scaled.misses(point) <= 1.0).all()):
            sizes, errors = (
                np.abs(x[list(self.scaled.goal.outputs)]).max(axis=1) for x in (slopes.values, slopes.errors)
            )
            if (errors > CORNER * sizes).any():
                raise Met  # at the corner of a magnitude that is zero
        self.derived.append(point)
        return J

    def _least_squares(self) -> tuple[bool, str]:
        from scipy.optimize import least_squares

        scaled, rows = self.scaled, list(self.scaled.goal.outputs)

        def residuals(u: Array) -> Array:
            point = self._at(u)
            if not point.is_good:  # SciPy shortens its step
                return np.full(len(rows), np.inf)
            off = scaled.residuals(point.y)
            if np.all(np.abs(off) * scaled.sizes[rows] <= WELL_MET * np.nan_to_num(point.error[rows])):
                raise Met
            return off

        try:
            found = least_squares(
                residuals, self.start, lambda u: self._jacobian(u)[rows], bounds=(0.0, 1.0), method="dogbox",
                ftol=CLOSE, xtol=LAST_STEP, gtol=CLOSE, max_nfev=MOST_STEPS,
            )  # fmt: skip
        except Met:
            self.first.points = min(self.first.points or MOST_STEPS, len(self.points))
            return True, "all targets are met within the errors of the run"
        except ValueError:  # as SciPy calls a start whose run fails
            return False, "the run of the start fails"
        return found.status > 0, "" if found.status > 0 else f"no end after {MOST_STEPS} steps"

    def _minimise(self, start: Array) -> tuple[bool, str]:
        from scipy.optimize import minimize

        scaled = self.scaled

        def objective(u: Array) -> float:
            point = self._at(u)
            if point.is_good:
                return scaled.objective(point.y)
            if self._good is None:
                raise NoWay(f"the run of the start fails: {point.reason}")
            own = scaled.objective(self._good.y)
            return own + FAILING * max(1.0, abs(own))

        def room(u: Array) -> Array:
            point = self._at(u)
            return scaled.room(point if point.is_good or self._good is None else self._good)

        constraint: Any = {
            "type": "ineq",
            "fun": room,
            "jac": lambda u: scaled.room_slopes(self._jacobian(u)),
        }
        found = minimize(
            objective, start, jac=lambda u: scaled.gradient(self._at(u).y, self._jacobian(u)), method="SLSQP",
            bounds=[(0.0, 1.0)] * len(start), constraints=[constraint] if scaled.sides else (),
            options={"ftol": LEAST_CHANGE, "maxiter": MOST_STEPS},
        )  # fmt: skip
        return bool(found.success), "" if found.success else str(found.message)


class LevelGround(Exception):
    """Outputs no longer change by more than the runs tell."""


class Met(Exception):
    """All targets are met as closely as the runs tell."""


def sizes_of(points: Sequence[DesignPoint]) -> Array:
    """Return the sizes of outputs (n,): how much they differ between points, or their own size where they do not."""
    ys = np.array([point.y for point in points])
    spread, own = np.ptp(ys, axis=0), np.abs(ys).max(axis=0)
    return np.where(spread > 1e-9 * own, spread, np.where(own > 0.0, own, 1.0))
