"""How actuators and loop closures share the generalised force u of a motion or of rest.

u = B tau + Psi^T lambda, where B selects the actuated coordinates. With the columns of N spanning the null space of
Psi (the motions that the loops allow), the principle of virtual work gives N^T u = N^T B tau: one equation for each
degree of freedom. The loops bear the rest, u - B tau.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.record import record
from robodyn_cli.solve.closure import RANK
from robodyn_cli.spatial.algebra import Array

FEASIBLE = 1e-9  # of the largest load, up to which what no actuator gives is rounding
KEPT = 1e-7  # the same of the changes of loads
REFINED = 3  # solutions of the same equations, each of what is left by the ones before


class LostRank(Exception):
    """Psi (``what`` is ``loops``) or N^T B (``actuators``) loses rank at a sample.

    weights : (m,) of the rows that become dependent, or (nv,) of the coordinates that the actuators no longer hold.
    passed : whether it happens between this sample and the next.
    """

    def __init__(self, what: str, sample: int, weights: Array, passed: bool = False) -> None:
        super().__init__()
        self.what, self.sample, self.weights, self.passed = what, sample, weights, passed


class Unbalanced(Exception):
    """The actuators command only ``commanded`` of ``freedom`` degrees of freedom, and the others have a load.

    sample : the first with something left. left : (nv,) of the load there that neither they nor the loops can give, in
    the least squares.
    """

    def __init__(self, freedom: int, commanded: int, sample: int, left: Array) -> None:
        super().__init__()
        self.freedom, self.commanded, self.sample, self.left = freedom, commanded, sample, left


@record
class Shared:
    """Torques by term (T, nv), zero without an actuator; multipliers (T, m); N (T, nv, f).

    freedom : degrees of freedom f. commanded : those in which actuators give forces; the load is zero in the others.
    unique_torques, unique_multipliers : whether there is no other way to share;
    otherwise those of least norm are given. residual : largest |u - B tau - Psi^T lambda|. tolerance : ratio of
    singular values of Psi below which its rows depend on each other.
    """

    terms: dict[str, Array]
    multipliers: Array
    N: Array
    freedom: int
    commanded: int
    unique_torques: bool
    unique_multipliers: bool
    residual: float
    tolerance: float = RANK

    @property
    def tau(self) -> Array:
        """Actuator torques (T, nv): the sum of the terms."""
        total: Array = np.sum(list(self.terms.values()), axis=0)
        return total

    @property
    def uniqueness(self) -> tuple[str, str]:
        """In words, whether the torques, and the multipliers, are unique."""
        more = "more actuators than degrees of freedom that they command"
        if self.commanded == self.freedom:
            more = "more actuators than degrees of freedom"
        torques = "unique" if self.unique_torques else f"least norm: {more}"
        return torques, "unique" if self.unique_multipliers else "least norm: redundant rows"


def allowed_motions(psi: Array, tolerance: float = RANK) -> tuple[Array, int]:
    """Return N (T, nv, f), orthonormal columns that Psi (T, m, nv) leaves free, and the rank of Psi.

    Raises
    ------
    LostRank : the rank is not the same at all samples.
    """
    return _freedom(psi, tolerance)[:2]


def null_spaces(psi: Array, tolerance: float = RANK) -> tuple[Array, NDArray[np.int64], Array]:
    """Return U (T, m, m), V^T (T, nv, nv) of Psi = U S V^T, and between them its ranks (T,)."""
    return _decomposed(psi, tolerance)[:3]


def _decomposed(psi: Array, tolerance: float) -> tuple[Array, NDArray[np.int64], Array, Array]:
    """Return U, the ranks and V^T as of ``null_spaces``, and the singular values (T, min(m, nv))."""
    samples, m, nv = psi.shape
    if not m:
        still = np.tile(np.eye(nv), (samples, 1, 1))
        return np.zeros((samples, 0, 0)), np.zeros(samples, dtype=int), still, np.zeros((samples, 0))
    U, s, Vt = np.linalg.svd(psi, full_matrices=True)
    return U, (s > tolerance * s[:, :1]).sum(axis=1), Vt, s


@record
class Hold:
    """How actuators and loops can share any load where a mechanism is: what depends on positions alone.

    psi : (T, m, nv). columns : the actuated velocity coordinates. N : (T, nv, f). inverse : (N^T B)^+ (T, n, f), None
    without freedom or actuators. loops : (Psi^T)^+ (T, m, nv). rank : of Psi. commanded, tolerance : as of ``Shared``.
    """

    psi: Array
    columns: list[int]
    N: Array
    inverse: Array | None
    loops: Array
    rank: int
    commanded: int
    tolerance: float

    @staticmethod
    def of(psi: Array, actuated: Sequence[int], tolerance: float = RANK) -> Hold:
        """Return it for Psi (T, m, nv) and actuated velocity coordinates.

        Raises
        ------
        LostRank
        """
        N, rank, loops = _freedom(psi, tolerance)
        columns = list(actuated)
        A = np.swapaxes(N, 1, 2)[:, :, columns]  # N^T B
        if not N.shape[2] or not columns:
            return Hold(psi, columns, N, None, loops, rank, 0, tolerance)
        if not psi.shape[1]:  # each actuator holds its own joint
            return Hold(psi, columns, N, np.swapaxes(A, 1, 2), loops, rank, len(columns), tolerance)
        U, s, Vt = np.linalg.svd(A, full_matrices=False)
        held = (s > RANK).sum(axis=1)
        commanded = int(held.max(initial=0))
        if np.any(held < commanded):
            sample = int(np.argmin(held))
            weights = N[sample] @ np.linalg.svd(A[sample])[0][:, commanded - 1]
            raise LostRank("actuators", sample, np.abs(weights))
        if len(columns) == N.shape[2] == commanded and rank == psi.shape[1]:
            _refuse_passing(psi, columns, A, N)
        inverse = np.swapaxes(_inverse(U, s, Vt, commanded), 1, 2)
        return Hold(psi, columns, N, inverse, loops, rank, commanded, tolerance)

    def share(self, needed: Mapping[str, Array]) -> Shared:
        """Return how terms of u (T, nv) by name are shared.

        Raises
        ------
        Unbalanced
        """
        samples, nv, freedom = self.N.shape
        terms = {name: np.zeros((samples, nv), order="F") for name in needed}
        if self.inverse is not None:
            for name, u in needed.items():
                free = np.einsum("tvf,tv->tf", self.N, u)
                terms[name][:, self.columns] = np.einsum("taf,tf->ta", self.inverse, free)
        total: Array = np.sum(list(needed.values()), axis=0)
        rest = total - np.sum(list(terms.values()), axis=0)
        lam = np.einsum("tmv,tv->tm", self.loops, rest)
        left = rest - np.einsum("tmv,tm->tv", self.psi, lam)
        residual = float(np.abs(left).max(initial=0.0))
        commanded = self.commanded
        # rows that are left out bear as much as they contradict the others
        feasible = FEASIBLE if self.tolerance == RANK else self.tolerance
        rounding = feasible * float(np.abs([*needed.values()]).max(initial=0.0))
        if commanded < freedom and residual > rounding:
            sample = int((np.abs(left).max(axis=1) > rounding).argmax())
            raise Unbalanced(freedom, commanded, sample, left[sample])
        unique = len(self.columns) <= commanded, self.rank == self.psi.shape[1]
        return Shared(terms, lam, self.N, freedom, commanded, *unique, residual, self.tolerance)


def borne(psi: Array, actuated: Sequence[int], load: Array) -> Array:
    """Return the torques (T, n) of actuators that bear a load u (T, nv) with the loops, of which there are just as many
    as it takes: B tau + Psi^T lambda = u, where (B, Psi^T) has an inverse."""
    found: Array = np.linalg.solve(shared_rows(psi, actuated), load[:, :, None])[:, : len(actuated), 0]
    return found


def shared_rows(psi: Array, actuated: Sequence[int]) -> Array:
    """Return (B, Psi^T) (T, nv, n + m)."""
    count, _, nv = psi.shape
    B = np.broadcast_to(np.eye(nv)[:, list(actuated)], (count, nv, len(actuated)))
    both: Array = np.concatenate([B, np.swapaxes(psi, 1, 2)], axis=2)
    return both


def borne_least(psi: Array, actuated: Sequence[int], load: Array, tolerance: float = RANK) -> Array:
    """Return the torques (T, n) of least norm that bear a load u (T, nv) with the loops, whatever the rank of Psi.

    P = 1 - Psi^+ Psi projects onto the motions that the loops allow: P B tau = P u.
    """
    P = np.eye(psi.shape[2]) - np.linalg.pinv(psi, rcond=tolerance) @ psi
    found: Array = (np.linalg.pinv(P[:, :, list(actuated)], rcond=RANK) @ (P @ load[:, :, None]))[:, :, 0]
    return found


def _freedom(psi: Array, tolerance: float) -> tuple[Array, int, Array]:
    """Return N and the rank as of ``allowed_motions``, and (Psi^T)^+ (T, m, nv)."""
    U, ranks, Vt, s = _decomposed(psi, tolerance)
    rank = int(ranks.max())
    if np.any(ranks < rank):
        sample = int(np.argmin(ranks))
        raise LostRank("loops", sample, np.abs(U[sample][:, rank - 1]))
    N = np.swapaxes(Vt[:, rank:, :], 1, 2)
    return N, rank, _inverse(U, s, Vt, rank)


def _inverse(U: Array, s: Array, Vt: Array, rank: int) -> Array:
    """Return the transpose (T, m, n) of the pseudo-inverse of U S V^T, of so many singular values."""
    inverse: Array = (U[:, :, :rank] / s[:, None, :rank]) @ Vt[:, :rank]
    return inverse


def share(
    psi: Array, actuated: Sequence[int], needed: Mapping[str, Array], tolerance: float = RANK
) -> Shared:
    """Return how actuators and loops share the generalised forces that are needed.

    Parameters
    ----------
    psi : (T, m, nv). actuated : their velocity coordinates. needed : terms of u (T, nv) by name.
    tolerance : ratio of singular values of Psi below which its rows depend on each other.

    Raises
    ------
    Unbalanced, LostRank
    """
    return Hold.of(psi, actuated, tolerance).share(needed)


def _refuse_passing(psi: Array, columns: list[int], A: Array, N: Array) -> None:
    """Raise if N^T B is singular between two samples, where the sign of det (Psi, B^T) changes.

    Raises
    ------
    LostRank
    """
    samples, _, nv = psi.shape
    held = np.tile(np.eye(nv)[columns], (samples, 1, 1))
    sign, _ = np.linalg.slogdet(np.concatenate([psi, held], axis=1))
    passes = np.flatnonzero(sign[1:] * sign[:-1] < 0.0)
    if len(passes):
        sample = int(passes[0])
        U, _, _ = np.linalg.svd(A[sample])
        raise LostRank("actuators", sample, np.abs(N[sample] @ U[:, -1]), passed=True)


def share_change(
    psi: Array, actuated: Sequence[int], shared: Shared, psi_change: Array, load_change: Array
) -> tuple[Array, Array]:
    """Return how torques (T, nv) and multipliers (T, m) change with Psi and with the load, for one change of both.

    With A = N^T B, of full row rank, and the load u = B tau + Psi^T lambda,

        A dtau = N^T (du - dPsi^T lambda),   Psi^T dlambda = du - B dtau - dPsi^T lambda,

    each of least norm like what changes, where the derivative of a pseudo-inverse of constant rank adds
    (1 - P^+ P) dP^T P^+T x to the solution x of P x = b (Golub and Pereyra 1973, "The differentiation of
    pseudo-inverses", SIAM J. Numer. Anal. 10).

    Parameters
    ----------
    psi, psi_change : (T, m, nv). actuated : velocity coordinates. shared : how the load is shared. load_change : of the
        load (T, nv).

    Raises
    ------
    Unbalanced : passive freedoms that the load leaves alone do not stay so.
    """
    columns, N = list(actuated), shared.N
    lam, tau = shared.multipliers, shared.tau
    rest = load_change - np.einsum("tmv,tm->tv", psi_change, lam)
    dtau = np.zeros_like(load_change)
    if N.shape[2]:
        A = np.swapaxes(N, 1, 2)[:, :, columns]
        # any N + dN will do: torques of least norm do not depend on the basis
        held = np.linalg.pinv(psi, rcond=shared.tolerance)
        dN = -held @ psi_change @ N if psi.shape[1] else np.zeros_like(N)
        right = np.einsum("tvf,tv->tf", N, rest)
        dtau[:, columns] = least_norm_change(A, tau[:, columns], np.swapaxes(dN, 1, 2)[:, :, columns], right)
    back = rest - dtau
    dlam = np.zeros(lam.shape)
    if psi.shape[1]:
        dlam = least_norm_change(
            np.swapaxes(psi, 1, 2), lam, np.swapaxes(psi_change, 1, 2), back, shared.tolerance
        )
    left = back - np.einsum("tmv,tm->tv", psi, dlam)
    most = max(float(np.abs(x).max(initial=0.0)) for x in (load_change, rest, dtau))
    if shared.commanded < shared.freedom and np.abs(left).max(initial=0.0) > KEPT * most:
        sample = int(np.abs(left).max(axis=1).argmax())
        raise Unbalanced(shared.freedom, shared.commanded, sample, left[sample])
    return dtau, dlam


def least_norm_change(P: Array, x: Array, dP: Array, right: Array, tolerance: float = RANK) -> Array:
    """Return the change of x = P^+ b (T, n) for P + dP, where P dx = ``right`` (T, m) holds."""
    inverse = np.linalg.pinv(P, rcond=tolerance)
    free = np.einsum("tmn,tm->tn", dP, np.einsum("tnm,tn->tm", inverse, x))
    change: Array = np.einsum("tnm,tm->tn", inverse, right)
    return change + free - np.einsum("tnm,tm->tn", inverse, np.einsum("tmn,tn->tm", P, free))


def constrained(
    M: Array, psi: Array, f: Array, c: Array, tolerance: Array | float = RANK
) -> tuple[Array, Array]:
    """Return a (T, nv, k) and lambda (T, m, k) with M a - Psi^T lambda = f (T, nv, k) and Psi a = c (T, m, k).

    a = Psi^+ c + N z with N^T M N z = N^T (f - M Psi^+ c), lambda = (Psi^T)^+ (M a - f): whatever the rank of Psi,
    whose rows may depend on each other, and for M that has an inverse along the motions N alone. lambda has the least
    norm. tolerance (T,) : ratio of singular values below which rows depend on each other.
    """
    U, s, Vt = np.linalg.svd(psi, full_matrices=True)
    ranks = (s > np.reshape(tolerance, (-1, 1)) * s[:, :1]).sum(axis=1)
    a, lam = np.zeros(f.shape), np.zeros(c.shape)
    different = np.unique(ranks)
    for rank in different:
        at = ranks == rank if len(different) > 1 else slice(None)
        rows, size = np.swapaxes(U[at][:, :, :rank], 1, 2), s[at][:, :rank, None]
        held, free = np.split(Vt[at], [rank], axis=1)
        here, there, N = M[at], psi[at], np.swapaxes(free, 1, 2)
        reduced = free @ here @ N
        for _ in range(REFINED):  # steps from what the ones before have left
            rest = f[at] + np.swapaxes(there, 1, 2) @ lam[at] - here @ a[at]
            own = np.swapaxes(held, 1, 2) @ (rows @ (c[at] - there @ a[at]) / size)
            step = own + N @ np.linalg.solve(reduced, free @ (rest - here @ own))
            a[at] += step
            lam[at] += np.swapaxes(rows, 1, 2) @ (held @ (here @ step - rest) / size)
    return a, lam


def accelerations(M: Array, f: Array, psi: Array, gamma: Array, tolerance: Array | float = RANK) -> Array:
    """Return v-dot (T, nv) of M v-dot = f + Psi^T lambda, Psi v-dot + gamma = 0, whatever the rank of Psi."""
    a, _ = constrained(M, psi, f[:, :, None], -gamma[:, :, None], tolerance)
    return a[:, :, 0]
