"""Joints at rest of which more could stick than the mechanism has freedoms: which do, and who bears the friction.

With N spanning the motions that constraints leave and B selecting the joints at rest, accelerations follow from the
torques lambda that hold joints (friction, stops) as

    a = a0 + D lambda,   D = B^T N (N^T M N)^-1 N^T B,

and Coulomb's law is the minimum of lambda^T D lambda / 2 + a0^T lambda over the box low <= lambda <= high (Moreau 1966;
Lötstedt 1982): a is unique, and so is which joints move, but lambda is not where D has no inverse. Of the torques that
hold the joints which stay at rest one is taken that is a vertex of those allowed: some joints bear, as many as they
hold freedoms, and are held by the equations; the others are carried, with their friction at a bound. Where the load
brings a bearing joint to its bound, a carried one takes its place, as in the dual simplex method; where none can, the
joints slip.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.equations.contact_joints import UNBOUNDED
from robodyn_cli.motion.contact.events import HELD
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

DEPENDENT = 1e-7  # ratio of singular values below which joints at rest do not move independently
SHIFT = 1e-10  # of D's mean diagonal, added to it: which of equal torques are taken
MOVES = 1e-7  # of the accelerations that friction prevents, from which on a joint moves
AT_BOUND = 1e-12  # of the range of torques, up to which one is at its bound


def motions_left(rows: Array, tolerance: float) -> Array:
    """Return N (nv, f) with orthonormal columns that rows (m, nv) leave."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, s, Vt = np.linalg.svd(rows)
    free: Array = Vt[int((s > tolerance * s[:1]).sum()) :].T
    return free


def bounded(torques: Array) -> Array:
    """Return bounds of torques (n,), infinite where they are beyond every multiplier."""
    out: Array = np.where(np.abs(torques) >= UNBOUNDED, np.copysign(np.inf, torques), torques)
    return out


def independent_count(columns: Array) -> int:
    """Return the rank of motions of joints: columns (f, n) of N^T."""
    if not columns.size:
        return 0
    return int((np.linalg.svd(columns, compute_uv=False) > DEPENDENT).sum())


@record
class Settled:
    """What joints at rest do: the direction in which each moves off, or HELD (n,). carried : the torques of held ones
    that others hold, by their number."""

    states: list[int]
    carried: dict[int, float]


@record
class RestingJoints:
    """Joints at rest at an instant.

    columns : N^T B (f, n). inertia : N^T M N (f, f). free : accelerations a0 (n,) without forces in the joints.
    low, high : bounds of these (n,), some of them infinite.
    """

    columns: Array
    inertia: Array
    free: Array
    low: Array
    high: Array

    def settled(self) -> Settled:
        """Return the states that Coulomb's law gives."""
        n = len(self.free)
        if not n:
            return Settled([], {})
        D = self.columns.T @ np.linalg.solve(self.inertia, self.columns)
        lam = self._torques(D)
        a = self.free + D @ lam
        prevented = max(np.abs(D * lam).max(initial=0.0), np.abs(self.free).max(initial=0.0))
        moving = np.abs(a) > MOVES * prevented
        states = [int(np.sign(x)) if moves else HELD for x, moves in zip(a, moving)]
        stuck = [k for k in range(n) if not moving[k]]
        lam[stuck], bearing = self._vertex(lam, stuck)
        return Settled(states, {k: float(lam[k]) for k in stuck if k not in bearing})

    def _torques(self, D: Array) -> Array:
        """Return torques lambda (n,) at the minimum."""
        mean = float(np.trace(D)) / len(D) or 1.0
        scale = 1.0 / np.sqrt(np.maximum(np.diag(D), SHIFT * mean))  # torques by what they accelerate
        shifted = D * np.outer(scale, scale) + SHIFT * np.eye(len(D))
        root = np.linalg.cholesky(shifted)
        target = -np.linalg.solve(root, self.free * scale)
        from scipy.optimize import lsq_linear

        found = lsq_linear(root.T, target, (self.low / scale, self.high / scale), method="bvls", tol=1e-15)
        torques: Array = found.x * scale
        return torques

    def _vertex(self, lam: Array, stuck: Sequence[int]) -> tuple[Array, list[int]]:
        """Return torques of joints that are stuck which hold them as lam (n,) does, all but those of independent joints
        at a bound, and these joints."""
        lam = lam.copy()
        low, high = self.low, self.high
        room = np.where(np.isfinite(high - low), high - low, np.maximum(np.abs(lam), 1.0))
        bearing = [k for k in stuck if min(lam[k] - low[k], high[k] - lam[k]) > AT_BOUND * room[k]]
        while len(bearing) > independent_count(self.columns[:, bearing]):
            way = np.linalg.svd(self.columns[:, bearing])[2][-1]  # torques along it hold nothing
            step, k, bound = min(
                (
                    ((bound - lam[k]) / x, k, bound)
                    for sign in (1.0, -1.0)
                    for k, x in zip(bearing, sign * way)
                    if abs(x) > DEPENDENT and np.isfinite(bound := high[k] if x > 0.0 else low[k])
                ),
                key=lambda one: one[0],
            )
            sign = 1.0 if (way[bearing.index(k)] > 0.0) == (bound == high[k]) else -1.0
            lam[bearing] += sign * step * way
            lam[k] = bound
            bearing.remove(k)
        rank = independent_count(self.columns[:, stuck])
        for k in stuck:  # those at their bounds hold what is left, or rounding would move it
            if len(bearing) < rank and k not in bearing:
                more = [*bearing, k]
                bearing = more if independent_count(self.columns[:, more]) == len(more) else bearing
        return lam[list(stuck)], bearing


def replacement(
    columns: Array, bearing: Sequence[int], k: int, over: bool, at_low: Mapping[int, bool]
) -> tuple[int | None, list[int]]:
    """Return the carried joint that takes the place of a bearing one k whose torque leaves its bounds, None if none
    can, and the carried joints that move where k does.

    As k is relieved, lambda_k = const - sum of alpha_j lambda_j with alpha from columns_j = columns_bearing alpha_j.

    Parameters
    ----------
    columns : N^T B (f, n). over : whether k is at its upper bound. at_low : of carried joints, whether theirs is at the
    lower one.
    """
    others = list(at_low)
    alpha = np.linalg.lstsq(columns[:, list(bearing)], columns[:, others], rcond=DEPENDENT)[0]
    own = dict(zip(others, alpha[list(bearing).index(k)].tolist()))
    moving = [j for j, x in own.items() if abs(x) > DEPENDENT]
    able = [j for j in moving if ((own[j] > 0.0) == at_low[j]) == over]
    return max(able, key=lambda j: abs(own[j]), default=None), moving
