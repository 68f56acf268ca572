"""Limits along a path as rows that are linear in the path's acceleration.

A path q(s) is run through as s(t). With x = s-dot^2 and u = s-double-dot

    q-dot = q' sqrt(x),    q-ddot = q' u + q'' x,    tau = M q' u + f(s, x)

so that each limit, from the middle of its range in halves of it, reads |A u + B x + C| <= 1; f is linear in x but for
forces like viscous friction, and is replaced by its tangent at a profile x(s) then.

Limits of a scene's joints along a path, as rows of the path's acceleration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.schema.spans import Span, sides
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.motion import JointMotion

# places in a segment, in parts of it, at which limits are looked at; the ends count as inside of the segment
PLACES = (0.0, 0.5, 1.0)
FINE = tuple(k / 8 for k in range(9))  # and at which they are checked in the end


@record
class Rows:
    """Limits on K segments at the three places ``PLACES`` of each.

    A, B, C : (K, 3, n), of |A u + B x + C| <= 1. most : (K, 3), the largest x that the limits of speed allow.
    rest : (2, n), C at rest at both ends of the path, where friction does not act: it may help to brake until then.
    """

    A: Array
    B: Array
    C: Array
    most: Array
    rest: Array

    def values(self, u: Array, x: Array) -> Array:
        """Return A u + B x + C (K, 3, n) for u and x (K, 3)."""
        values: Array = self.A * u[..., None] + self.B * x[..., None] + self.C
        return values

    def passed(self, u: Array, x: Array) -> Passed:
        """Return by how much the limits are passed for u and x (K, 3)."""
        at_rest = self.A[[0, -1], [0, -1]] * u[[0, -1], [0, -1]][:, None] + self.rest
        return Passed.of(self.values(u, x), (x / self.most)[..., None], at_rest)


@record
class Passed:
    """By how much limits are passed in each segment, in parts of them; negative where they are not reached.

    over, under : (K, n), in the positive and the negative direction. fast : (K,), x beyond what limits of speed allow.
    """

    over: Array
    under: Array
    fast: Array

    @staticmethod
    def of(values: Array, squares: Array, at_rest: Array) -> Passed:
        """Return it for values (K, places, n), 1 on the limit, squared speeds (K, places, m), values at rest (2, n)."""
        largest, smallest = _peaks(values)
        for k in (0, -1):
            largest[k], smallest[k] = np.maximum(largest[k], at_rest[k]), np.minimum(smallest[k], at_rest[k])
        fast = _peaks(squares)[0].max(axis=1, initial=0.0)
        return Passed(largest - 1.0, -smallest - 1.0, fast - 1.0)

    @property
    def largest(self) -> float:
        """The largest part by which any limit is passed."""
        return float(max(x.max(initial=-1.0) for x in (self.over, self.under, self.fast)))

    def positive(self) -> Passed:
        """Return it with 0 where limits are not reached."""
        return Passed(*(np.maximum(x, 0.0) for x in (self.over, self.under, self.fast)))


def _peaks(values: Array) -> tuple[Array, Array]:
    """Return the largest and the smallest value (K, n) of the parabolas through each three of values (K, places, n)."""
    left, here, right = values[:, :-2:2], values[:, 1::2], values[:, 2::2]
    slope, bend = 0.5 * (right - left), 2.0 * here - left - right
    steep = np.abs(slope)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = here + 0.5 * slope * slope / bend
    largest = np.where(steep < bend, turn, np.maximum(left, right))
    smallest = np.where(steep < -bend, turn, np.minimum(left, right))
    return largest.max(axis=1), smallest.min(axis=1)


INSET = 1e-9  # of a segment: its ends are looked at from inside, as friction and splines may jump there
LINEAR = 1e-9  # of the limits, up to which forces count as linear in x
TINY = 1e-12

Torques = Callable[[Array, Array, Array], Array]


@record
class PathBounds:
    """Limits of one kind: places in v of the joints that have one, the least and the largest value (n,) of each."""

    places: list[int]
    low: Array
    high: Array

    @staticmethod
    def of(limits: Mapping[str, Span], columns: Sequence[str]) -> PathBounds:
        """Return the limits of columns of v."""
        places = [k for k, name in enumerate(columns) if name in limits]
        ends = np.array([sides(limits[columns[k]]) for k in places]).reshape(-1, 2)
        return PathBounds(places, ends[:, 0], ends[:, 1])

    @property
    def half(self) -> Array:
        """Half of each range (n,): the limit where it is the same either way."""
        return np.asarray(0.5 * (self.high - self.low))

    @property
    def middle(self) -> Array:
        return np.asarray(0.5 * (self.high + self.low))

    def parts(self, values: Array) -> Array:
        """Return values (..., n) from the middle of the range in halves of it: 1 and -1 on the limits."""
        return np.asarray((values - self.middle) / self.half)

    def slowness(self, slope: Array) -> Array:
        """Return slopes dq/ds (..., nv) of these joints over the rate that their sign allows: 1 / s-dot at most."""
        slope = slope[..., self.places]
        return np.asarray(slope / np.where(slope < 0.0, self.low, self.high))


@record
class LimitedPath:
    """A path q(s), the torques of its robot, and the limits.

    motion : q, dq/ds and d2q/ds2 at many s. torques : tau (T, nv) of q, qd, qdd.
    """

    motion: Callable[[Array], JointMotion]
    torques: Torques
    speed: PathBounds
    acceleration: PathBounds
    effort: PathBounds

    def at(self, s: Array, places: tuple[float, ...] = PLACES) -> JointMotion:
        """Return the path at places in each segment, K places rows."""
        return self.motion(self.places(s, places))

    def places(self, s: Array, places: tuple[float, ...] = PLACES) -> Array:
        """Return the s of places in each segment (K places,)."""
        inside = np.clip(np.array(places), INSET, 1.0 - INSET)
        return (s[:-1, None] + np.diff(s)[:, None] * inside).ravel()

    def torques_at(self, way: JointMotion, u: Array, x: Array) -> Array:
        """Return the limited torques (T, n) at speeds and accelerations (T,), 1 and -1 on their limits."""
        if not self.effort.places:
            return np.zeros((len(u), 0))
        qd = np.asfortranarray(way.qd * np.sqrt(x)[:, None])
        qdd = np.asfortranarray(way.qd * u[:, None] + way.qdd * x[:, None])
        return self.effort.parts(self.torques(way.q, qd, qdd)[:, self.effort.places])

    def typical(self, way: JointMotion, length: float) -> float:
        """Return an x of the size that the limits allow."""
        zero = np.zeros(len(way.q))
        u = [np.abs(self.torques_at(way, zero + 1.0, zero) - self.torques_at(way, zero, zero))]
        u.append(np.abs(way.qd[:, self.acceleration.places]) / self.acceleration.half)
        steepest = np.concatenate(u, axis=1).max(axis=1)
        return length / float(np.median(steepest)) / 2.0 if np.median(steepest) > 0.0 else 1.0


class PathLimits:
    """The rows of a path on any grid; those of the last grid are kept while only the profile changes."""

    def __init__(self, path: LimitedPath) -> None:
        self.path = path
        self.grid: Array | None = None
        self.typical: float | None = None
        self.fine: tuple[Array, JointMotion] | None = None
        self.linear = True

    def __call__(self, s: Array, x: Array | None) -> Rows:
        """Return the rows on a grid (K + 1,); forces that are not linear in x as tangents at x (K, 3)."""
        if self.grid is None or s is not self.grid:
            self.grid, self.way = s, self.path.at(s)
            if self.typical is None:
                self.typical = self.path.typical(self.way, float(s[-1] - s[0]))
            zero = np.zeros(len(self.way.q))
            self.still = self.path.torques_at(self.way, zero, zero)
            self.inertia = self.path.torques_at(self.way, zero + 1.0, zero) - self.still
        assert self.typical is not None
        at = (
            np.full(len(self.way.q), self.typical)
            if x is None
            else np.maximum(x.ravel(), TINY * self.typical)
        )
        low, high = self._forces(0.5 * at), self._forces(1.5 * at)
        here = 0.5 * (low + high) if x is not None and self.linear else self._forces(at)
        if x is None:
            off = np.abs(0.5 * (low + high) - here) / np.maximum(1.0, np.abs(here))
            self.linear = not off.size or bool(off.max() < LINEAR)
        slope = (high - low) / at[:, None]
        return self._rows(slope, here - slope * at[:, None])

    def passed(self, s: Array, u: Array, x: Array) -> Passed:
        """Return by how much the limits are passed for u and x (K, 9) at the ``FINE`` places, forces as they are."""
        if self.fine is None or self.fine[0] is not s:
            self.fine = s, self.path.at(s, FINE)
        path, way = self.path, self.fine[1]
        flat_u, flat_x = u.ravel()[:, None], x.ravel()[:, None]
        quick = path.acceleration.places
        effort = path.torques_at(way, u.ravel(), np.maximum(x.ravel(), TINY * (self.typical or 0.0)))
        qdd = path.acceleration.parts(way.qd[:, quick] * flat_u + way.qdd[:, quick] * flat_x)
        squares = np.square(path.speed.slowness(way.qd)) * flat_x
        ends = JointMotion(way.q[[0, -1]], way.qd[[0, -1]], way.qdd[[0, -1]])
        still = path.torques_at(ends, flat_u[[0, -1], 0], np.zeros(2))
        values = np.concatenate([effort, qdd], axis=1).reshape(*u.shape, -1)
        at_rest = np.concatenate([still, qdd[[0, -1]]], axis=1)
        return Passed.of(values, squares.reshape(*u.shape, -1), at_rest)

    def _forces(self, x: Array) -> Array:
        return self.path.torques_at(self.way, np.zeros(len(x)), x)

    def _rows(self, slope: Array, offset: Array) -> Rows:
        quick, way = self.path.acceleration, self.way
        rest = quick.parts(np.zeros((len(way.q), len(quick.places))))
        A = np.concatenate([self.inertia, way.qd[:, quick.places] / quick.half], axis=1)
        B = np.concatenate([slope, way.qdd[:, quick.places] / quick.half], axis=1)
        C = np.concatenate([offset, rest], axis=1)
        at_rest = np.concatenate([self.still, rest], axis=1)[[0, -1]]
        with np.errstate(divide="ignore"):
            most = 1.0 / np.square(self.path.speed.slowness(way.qd)).max(axis=1, initial=0.0)
        three = len(PLACES)
        shape = (len(way.q) // three, three, A.shape[1])
        return Rows(A.reshape(shape), B.reshape(shape), C.reshape(shape), most.reshape(shape[:2]), at_rest)
