"""Impacts of joints on rigid stops, and of latches that close: impulses through the mass matrix, closed loops
included."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

ROUNDS = 64
LOWEST = 1e-14  # a bounce this low, relative to the joint's position or to 1, is rounding


@record
class Impact:
    """A joint meets a stop, or latches close.

    M, psi : (nv, nv), (m, nv). v : before the impact (nv,), with Psi v as it has to be. joint : its velocity index,
    None where none meets a stop. resting : push of the stop by velocity index, for joints that rest on one already.
    jump : by how much the rates Psi v change (m,), None: they stay.
    """

    M: Array
    psi: Array
    v: Array
    joint: int | None
    resting: Mapping[int, float]
    jump: Array | None = None

    def after(self, restitution: float = 0.0, kept: Collection[int] = ()) -> Array:
        """Return the velocities (nv,) after the impact of joint j, with e the ``restitution``.

            M (v+ - v-) = Psi^T mu + e_j Lambda_j + sum e_k Lambda_k,   Psi (v+ - v-) = jump,   v+_j = -e v-_j

        Joints that rest on stops stay there, or leave them: v+_k and Lambda_k, both away from the stop, are not
        negative, and one of them is zero; those ``kept`` stay in any case. Friction is bounded and has no part in an
        impulse.

        Raises
        ------
        numpy.linalg.LinAlgError : M is singular.
        """
        psi, v, resting = self.psi, self.v, self.resting
        struck = [] if self.joint is None else [self.joint]
        active = list(resting)
        spread = np.linalg.inv(self.M)
        out = v.copy()
        for _ in range(ROUNDS):
            rows = [*struck, *active]
            units = np.zeros((len(rows), len(v)))
            units[np.arange(len(rows)), rows] = 1.0
            G = np.concatenate([psi, units])
            jump = np.zeros(len(psi)) if self.jump is None else self.jump
            target = np.concatenate([jump, -(1.0 + restitution) * v[struck], -v[active]])
            impulse, *_ = np.linalg.lstsq(G @ spread @ G.T, target, rcond=1e-13)
            out = v + spread @ G.T @ impulse
            loads = impulse[len(psi) + len(struck) :]
            pulled = [k for k, load in zip(active, loads) if resting[k] * load < 0.0 and k not in kept]
            entering = [
                k for k in resting if k not in active and resting[k] * out[k] < -1e-12 * np.abs(out).max()
            ]
            if not pulled and not entering:
                break
            active = [k for k in active if k not in pulled[:1]] if pulled else [*active, entering[0]]
        out[struck] = -restitution * v[struck]
        out[active] = 0.0
        return out

    def lost(self, after: Array) -> float:
        """Return the energy that an impact takes which leaves the velocities ``after`` (nv,) [J]."""
        return 0.5 * float(self.v @ self.M @ self.v - after @ self.M @ after)


def shared(gained: Array, psi: Array, rows: Array) -> Array:
    """Return the impulses (k,) of latches with ``rows`` rho (k, nv) that make up generalised impulses with others.

        M (v+ - v-) = rho^T Lambda + Psi^T mu

    Where latches hold the same, those of least norm, whatever mu is.

    Parameters
    ----------
    gained : M (v+ - v-) (nv,). psi : rows Psi (m, nv) of what is held already.
    """
    _, s, basis = np.linalg.svd(psi, full_matrices=False)
    basis = basis[: int((s > 1e-9 * s.max(initial=0.0)).sum())]

    def beside(x: Array) -> Array:
        """Return what Psi leaves of x (nv, ...)."""
        return x - basis.T @ (basis @ x)

    impulses: Array = np.linalg.lstsq(beside(rows.T), beside(gained), rcond=1e-9)[0]
    return impulses


def joined(before: Array, after: Array, psi: Array, v: Array, momentum: Array) -> Array:
    """Return the velocities (nv,) after a mechanism has gripped bodies, which move with it from then on.

        M+ v+ = M- v- + P + Psi^T mu,   Psi (v+ - v-) = 0

    The generalised momentum is that of the mechanism and the bodies together; loops and prescribed motion add impulses.

    Parameters
    ----------
    before, after : M- and M+ (nv, nv), without and with the bodies. psi : (m, nv). v : v- (nv,).
    momentum : P (nv,), of the bodies' own motion, J^T I V summed over them.

    Raises
    ------
    numpy.linalg.LinAlgError : M+ is singular.
    """
    spread = np.linalg.inv(after)
    gained = (before - after) @ v + momentum
    if len(psi):
        impulse, *_ = np.linalg.lstsq(psi @ spread @ psi.T, -(psi @ spread @ gained), rcond=1e-13)
        gained = gained + psi.T @ impulse
    out: Array = v + spread @ gained
    return out


def is_lost(speed: float, toward: float, at: float, height: float, slow: float) -> bool:
    """Tell whether a bounce from a stop ``at`` [rad, m] need not be followed.

    It is lower than ``height`` and slower than ``slow``, or so low that its impact cannot be told from its start.

    toward : acceleration towards the stop.
    """
    rise = speed * speed / (2.0 * toward) if toward > 0.0 else float("inf")
    return (rise < height and speed < slow) or rise < LOWEST * max(1.0, abs(at))


def halted(psi: Array, v: Array, resting: Collection[int]) -> Array:
    """Return the velocities nearest to v (nv,) in which the joints ``resting`` stand still and Psi v is what it was.

    A joint comes to rest within rounding; the others of its loops have to stand still with it, or they drive it on.
    """
    rows = np.concatenate([psi, np.eye(len(v))[list(resting)]])
    target = np.concatenate([np.zeros(len(psi)), -v[list(resting)]])
    out: Array = v + np.linalg.lstsq(rows, target, rcond=1e-13)[0]
    out[list(resting)] = 0.0
    return out
