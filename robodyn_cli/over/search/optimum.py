"""What holds at the end of a search: which bounds and constraints are active and at what price, how the goal bends,
how far the values may be off; a last step of Newton's method on the conditions of the optimum.

    g = A^T mu,   mu >= 0             first order, with the gradients A of active bounds and constraints
    | H  -A^T | |du|   | g - A^T mu |
    | A    0  | |..| = |     c      |  what is left of it, and what errors of derivatives and constraints may change

(Nocedal and Wright 2006, "Numerical Optimization", chapters 12 and 18).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.over.search.cones import cone_of, off_cone
from robodyn_cli.over.search.points import DesignPoint, OutputSlopes
from robodyn_cli.over.search.solve import CORNER, INSIDE, ScaledSearch, SolverWay
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

AT_BOUND = 1e-7  # part of the way between bounds, within which a key is at one
ACTIVE = 1e-6  # of the size of an output, within which a constraint is active
PRICELESS = 1e-9  # of the largest derivative: a smaller multiplier is zero
CLOSEST = 1e-14  # of that way: a last step that is shorter is none
EXACT_STEP, OTHER_STEP = 1e-4, 1e-2  # of the way between bounds, over which derivatives are compared
LARGEST_MOVE = 0.1  # of that way, by a last step
CORNERED = 0.75  # of the turn of a derivative; a parabola rises by half of it, a corner by all of it
FREE = 1e-6  # share of a key in directions that nothing determines, above which its value may be any
RANK = 1e-10  # smallest over largest singular value of derivatives that count

Derive = Callable[[Sequence[Array]], Sequence[tuple[DesignPoint, OutputSlopes | None]]]


@record
class BoundSides:
    """Bounds and sides of constraints at a place, and their prices: what their shift would change the goal by.

    room : of all sides of constraints (m,); gradients : their derivatives by u (m, n). prices : of these (m,), and
    bound_prices (n,) of bounds, negative at the upper one. left : what of the goal's gradient they leave (n,).
    binding : numbers of the sides with a price. held : keys that a priced bound holds (n,).
    """

    room: Array
    gradients: Array
    prices: Array
    bound_prices: Array
    left: Array
    binding: list[int]
    held: Array

    @staticmethod
    def of(scaled: ScaledSearch, point: DesignPoint, u: Array, J: Array) -> BoundSides:
        """Return those of a point with the derivatives J of its outputs."""
        from scipy.optimize import nnls

        room, gradients = scaled.room(point), scaled.room_slopes(J)
        g = scaled.gradient(point.y, J)
        near = [k for k in range(len(room)) if room[k] <= ACTIVE]
        low, high = np.flatnonzero(u <= AT_BOUND), np.flatnonzero(u >= 1.0 - AT_BOUND)
        unit = np.eye(len(u))
        A = np.concatenate([gradients[near], unit[low], -unit[high]])
        mu = nnls(A.T, g)[0] if A.size and np.isfinite(A).all() and np.isfinite(g).all() else np.zeros(len(A))
        prices, of_bounds = np.zeros(len(room)), np.zeros(len(u))
        prices[near] = mu[: len(near)]
        of_bounds[low] += mu[len(near) : len(near) + len(low)]
        of_bounds[high] -= mu[len(near) + len(low) :]
        least = PRICELESS * float(np.abs(g).max(initial=0.0))
        return BoundSides(
            room, gradients, prices, of_bounds, g - A.T @ mu, [k for k in near if prices[k] > least],
            np.abs(of_bounds) > least,
        )  # fmt: skip

    def lagrangian(self, scaled: ScaledSearch, point: DesignPoint, J: Array) -> Array:
        """Return the derivative of the goal less the priced constraints at another point."""
        return scaled.gradient(point.y, J) - self.prices @ scaled.room_slopes(J)


@record
class Curvatures:
    """How the goal less the priced constraints bends around a place, from its derivatives on both sides along each key.

    H : second derivatives (n, n), and their error; nan where they are not known. Along each key (n,): beside, the mean
    of the goal on both sides; turn, the change of its derivative from one to the other, over the step, which is twice
    as large as the rise that a parabola has there, and as large as that at a corner; lowest, where the tangents from
    both sides meet. cone : what ``cone_of`` gives (n, n).
    """

    H: Array
    H_error: float
    beside: Array
    turn: Array
    lowest: Array
    cone: Array

    def corners(self, value: float) -> NDArray[np.bool_]:
        """Tell along which keys (n,) the goal, which has a value at the place, has a corner and no parabola."""
        rise = self.beside - value
        return np.asarray(rise > CORNERED * np.abs(self.turn)) & np.isfinite(self.lowest)

    @staticmethod
    def unknown(n: int) -> Curvatures:
        """Return those of n keys of which nothing is known."""
        nothing, more = np.full(n, np.nan), np.full((n, n), np.nan)
        return Curvatures(more, np.nan, nothing, nothing, nothing, more)


@record
class Optimum:
    """A point and what is known of it, in the scaled numbers of a search.

    J, J_error : derivatives of outputs by u (n, len(u)) and their errors. at_low, at_high : keys at a bound. off : how
    far each u may be off, and short : by how much a goal nearby may be better, nan where that is not known. free : keys
    that targets do not determine: runs beside the point meet them too. corner : whether the goal has one there, and
    rises from it along each key. jumps : how far it jumps from run to run, where derivatives are not known for that.
    """

    point: DesignPoint
    J: Array
    J_error: Array
    at_low: Array
    at_high: Array
    sides: BoundSides
    curved: Curvatures
    off: Array
    short: float
    free: NDArray[np.bool_]
    corner: bool = False
    jumps: float = 0.0

    @property
    def left(self) -> float:
        """The largest derivative of the goal that bounds and constraints leave."""
        return float(np.abs(self.sides.left).max(initial=0.0))

    @property
    def bends(self) -> Array:
        """Eigenvalues of the second derivatives in the directions that stay free."""
        A = self.sides.gradients[self.sides.binding][:, ~self.sides.held]
        return bending(self.curved.H, ~self.sides.held, A)


class Examiner:
    """Examines the end of a search.

    Parameters
    ----------
    way : that led there. derive : gives runs and derivatives at values of all keys; None for those of a run that fails.
    """

    def __init__(self, way: SolverWay, derive: Derive) -> None:
        self.way, self.scaled, self.derive = way, way.scaled, derive

    def __call__(self, point: DesignPoint) -> Optimum:
        """Return the optimum close to the best point of a search, after a last step where that improves it."""
        ((_, slopes),) = self.derive([point.x])
        optimum, step = self._examined(point, slopes)
        if step is None or not np.abs(step).max(initial=0.0) > CLOSEST:
            return optimum
        u = np.clip(self.scaled.search.place(point.x) + step, 0.0, 1.0)
        ((other, there),) = self.derive([self.scaled.search.value_of(u, self.scaled.values)])
        if there is None or not self.scaled.holds(other) >= self.scaled.holds(point):
            return optimum
        better, _ = self._examined(other, there, optimum)
        return better if better.left <= optimum.left else optimum

    def _examined(
        self, point: DesignPoint, slopes: OutputSlopes | None, known: Optimum | None = None
    ) -> tuple[Optimum, Array | None]:
        """Return what holds at a point, and the last step; known : whose curvatures hold here too."""
        scaled, u = self.scaled, self.scaled.search.place(point.x)
        if slopes is None:
            nothing = np.full((len(point.y), len(point.x)), np.nan)
            slopes = OutputSlopes(nothing, nothing, np.zeros(len(point.y)))
        J, J_error = _scaled(scaled, slopes)
        sides = BoundSides.of(scaled, point, u, J)
        free = np.zeros(len(u), dtype=bool)
        if scaled.goal.is_reach:
            (off, null), step = self._off_of_targets(point, self._before(J, J_error), sides), None
            free = self._free(u, null)
            curved, short = Curvatures.unknown(len(u)), np.nan
        else:
            curved = self._curvatures(u, sides, slopes.exact) if known is None else known.curved
            step, off = self._last_step(point, J_error, sides, curved)
            known_off = np.isfinite(off).all()
            short = self._short(point, sides, curved, off) if known_off else np.nan
        value = scaled.objective(point.y) - float(sides.prices @ sides.room)
        corner = bool(
            np.isfinite(off).all() and curved.corners(value)[~sides.held].all() and not sides.held.all()
        )
        at_low, at_high = u <= AT_BOUND, u >= 1.0 - AT_BOUND
        optimum = Optimum(
            point, J, J_error, at_low, at_high, sides, curved, off, short, free, corner, scaled.jumps(slopes)
        )
        return optimum, step

    def _before(self, J: Array, J_error: Array) -> Array:
        """Return derivatives (n, len(u)), where errors hide them those of the last point before.

        So it is at the corner of a magnitude that is zero at the optimum.
        """
        earlier = [point for point in self.way.derived if point.run != self.way.best.run]
        if not earlier or not (J_error > CORNER * np.abs(J)).any():
            return J
        ((_, slopes),) = self.derive([earlier[-1].x])
        return (
            J if slopes is None else np.where(J_error > CORNER * np.abs(J), self.scaled.jacobian(slopes), J)
        )

    def _off_of_targets(self, point: DesignPoint, J: Array, sides: BoundSides) -> tuple[Array, Array]:
        """Return how far each u may be off where outputs are off their targets by their errors and what is left, and
        the directions (k, len(u)) along which no derivative tells."""
        rows, free = list(self.scaled.goal.outputs), ~sides.held
        off = np.zeros(J.shape[1])
        if not np.isfinite(J).all():
            return np.full(J.shape[1], np.nan), np.zeros((0, J.shape[1]))
        U, s, Vt = np.linalg.svd(J[rows][:, free])
        rank = int((s > RANK * s.max(initial=0.0)).sum())
        back = (Vt[:rank].T / s[:rank]) @ U[:, :rank].T
        lacking = np.nan_to_num(point.error[rows]) / self.scaled.sizes[rows] + np.abs(
            self.scaled.residuals(point.y)
        )
        own = np.abs(back) @ lacking
        own[np.abs(Vt[rank:]).max(axis=0, initial=0.0) > FREE] = np.nan
        off[free] = own
        null = np.zeros((len(Vt) - rank, J.shape[1]))
        null[:, free] = Vt[rank:]
        return off, null

    def _free(self, u: Array, null: Array) -> NDArray[np.bool_]:
        """Return the keys that move along directions (k, len(u)) on which runs beside u meet the targets as well; at a
        magnitude that is zero derivatives vanish in other directions too."""
        scaled, free = self.scaled, np.zeros(len(u), dtype=bool)
        for way in null:
            beside = [np.clip(u + step * way, 0.0, 1.0) for step in (OTHER_STEP, -OTHER_STEP)]
            beside = [x for x in beside if np.abs(x - u).max(initial=0.0) > AT_BOUND]
            made = self.derive([scaled.search.value_of(x, scaled.values) for x in beside])
            if any(point.is_good and (scaled.misses(point) <= 1.0).all() for point, _ in made):
                free |= np.abs(way) > FREE
        return free

    def _curvatures(self, u: Array, sides: BoundSides, exact: bool) -> Curvatures:
        """Return how the goal less the priced constraints bends around a place."""
        scaled, step, n = self.scaled, EXACT_STEP if exact else OTHER_STEP, len(u)
        middles = np.clip(u, step, 1.0 - step)
        places = [
            np.where(np.arange(n) == k, middles + way * step, u) for k in range(n) for way in (1.0, -1.0)
        ]
        made = self.derive([scaled.search.value_of(place, scaled.values) for place in places])
        values, gradients, errors = [], [], []
        for point, slopes in made:
            # of outputs that jump it is not known how they bend
            if slopes is None or not np.isfinite(slopes.values).all() or slopes.jumps.any():
                return Curvatures.unknown(n)
            J, J_error = _scaled(scaled, slopes)
            values.append(scaled.objective(point.y) - float(sides.prices @ scaled.room(point)))
            gradients.append(sides.lagrangian(scaled, point, J))
            errors.append(float(np.abs(J_error[list(scaled.goal.outputs)]).max(initial=0.0)))
        f, g = np.array(values).reshape(n, 2), np.array(gradients).reshape(n, 2, n)
        H = (g[:, 0] - g[:, 1]) / (2.0 * step)
        right, left = (np.diagonal(g[:, side]) for side in (0, 1))
        meet = (f[:, 1] - f[:, 0] + step * (right + left)) / np.where(
            right * left < 0.0, right - left, np.nan
        )
        lowest = f[:, 0] + right * (meet - step)
        level = max((x for x in lowest.tolist() if np.isfinite(x)), default=np.nan)
        return Curvatures(
            0.5 * (H + H.T), max(errors) / step + float(np.abs(H - H.T).max()), f.mean(axis=1),
            0.5 * step * (right - left), lowest, cone_of(f - level, g, step),
        )  # fmt: skip

    def _inside(self, point: DesignPoint, sides: BoundSides) -> Array:
        """Return how far inside the constraints that bind an optimum may lie, scaled.

        They are kept by the error of the run, which may be off by as much again.
        """
        outputs = [self.scaled.sides[k][0].output for k in sides.binding]
        return np.asarray(
            2.0 * np.nan_to_num(point.error[outputs]) / self.scaled.sizes[outputs] + INSIDE, dtype=float
        )

    def _short(self, point: DesignPoint, sides: BoundSides, curved: Curvatures, off: Array) -> float:
        """Return by how much a least or largest value nearby may be better than that of a point, scaled; nan where that
        is not known.

            priced constraints |mu| c + (what is left of the gradient) |du| + |du|^T |H| |du| / 2, and errors
        """
        scaled, value = self.scaled, self.scaled.objective(point.y) - float(sides.prices @ sides.room)
        own = float(point.error[scaled.goal.outputs[0]] / scaled.sizes[scaled.goal.outputs[0]])
        priced = np.abs(sides.prices[sides.binding])
        kept = float(priced @ (self._inside(point, sides) + np.abs(sides.room[sides.binding])))
        corners = curved.corners(value) & ~sides.held
        if corners.any():
            return float(np.abs(value - curved.lowest)[corners].sum()) + kept + own
        free = off > 0.0
        bent = 0.5 * off[free] @ np.abs(curved.H[np.ix_(free, free)]) @ off[free]
        return float(np.abs(sides.left[free]) @ off[free] + bent) + kept + own

    def _last_step(
        self, point: DesignPoint, J_error: Array, sides: BoundSides, curved: Curvatures
    ) -> tuple[Array | None, Array]:
        """Return the step of Newton's method to the optimum, None without one, and how far each u may be off."""
        H, scaled = curved.H, self.scaled
        n, free = len(H), ~sides.held
        step, off = np.zeros(n), np.zeros(n)
        off[free] = np.nan
        A = sides.gradients[sides.binding][:, free]
        M = np.block([[H[np.ix_(free, free)], -A.T], [A, np.zeros((len(A), len(A)))]])
        if not np.isfinite(M).all() or (M.size and np.linalg.cond(M) > 1.0 / RANK):
            return None, off
        back = np.linalg.inv(M)
        right = np.concatenate([-sides.left[free], -sides.room[sides.binding]])
        outputs = [scaled.sides[k][0].output for k in sides.binding]
        goal = np.abs(J_error[list(scaled.goal.outputs)]).max(axis=0, initial=0.0)[free]
        priced = np.abs(J_error[outputs]).T @ sides.prices[sides.binding]
        lacking = [goal + priced[free], self._inside(point, sides)]
        moves = back @ right
        step[free] = moves[: int(free.sum())]
        off[free] = (np.abs(back) @ np.concatenate(lacking) + np.abs(moves))[: int(free.sum())]
        bends = bending(H, free, A)
        value = scaled.objective(point.y) - float(sides.prices @ sides.room)
        if (curved.corners(value) & free).any():  # a magnitude that is zero, which rises on all sides
            above = np.abs(value - curved.lowest[curved.corners(value) & free]).max()
            above += np.nan_to_num(point.error / scaled.sizes).max()
            off[free] = off_cone(curved.cone[np.ix_(free, free)], float(above))
            return None, off
        if np.abs(step).max(initial=0.0) > LARGEST_MOVE or (len(bends) and not bends.min() > 0.0):
            return None, np.where(free, np.nan, 0.0)
        return step, off


def _scaled(scaled: ScaledSearch, slopes: OutputSlopes) -> tuple[Array, Array]:
    """Return scaled derivatives (n, len(u)) and their errors."""
    return scaled.jacobian(slopes), scaled.jacobian(dataclasses.replace(slopes, values=slopes.errors))


def bending(H: Array, free: Array, A: Array) -> Array:
    """Return the eigenvalues of the second derivatives in the directions that bounds and constraints leave free."""
    own = H[np.ix_(free, free)]
    if not own.size or not np.isfinite(own).all():
        return np.zeros(0)
    if len(A):
        _, s, Vt = np.linalg.svd(A)
        Z = Vt[int((s > RANK * s.max(initial=0.0)).sum()) :].T
        own = Z.T @ own @ Z
    return np.asarray(np.linalg.eigvalsh(own)) if own.size else np.zeros(0)
