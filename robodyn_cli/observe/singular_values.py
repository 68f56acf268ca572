"""Samples of a mechanism whose constraint rows depend on each other: all rows at once, by singular values.

The motion is unique, the multipliers are not: they are those of least norm. With M = L L^T and Y = L^-1 Psi^T =
P S Q^T, of which the first r singular values count:

    lambda = -Q_r S_r^-2 Q_r^T (gamma + Psi M^-1 f),   v-dot = M^-1 (f + Psi^T lambda)

Nothing here depends on the combinations of rows that the integration uses.

Singular values of the loops' Psi and of its passive block along samples, as datasets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.algorithms import bands
from robodyn_cli.algorithms.kinematics import moved
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.spatial.algebra import Array

# part of the largest singular value below which one counts as zero: the rank also falls at a singular pose on the way
VANISHED = 1e-9


def equations_of(problem: Problem) -> dict[str, Sequence[Scalar]]:
    """Return the parts of the equations of motion, by output."""
    return {
        "M": list(problem.mass_matrix.ravel()),
        "f": list(problem.applied - problem.bias),
        "gamma": problem.constraints.gamma,
        "eta": problem.constraints.eta,
        "eta_rate": problem.constraints.velocity_residual(problem.v),
        "psi": list(problem.psi.ravel()),
    }


class LeastNorm:
    """Accelerations, multipliers and corrections at samples.

    Parameters
    ----------
    more : further outputs to evaluate at the samples.
    """

    def __init__(self, problem: Problem, more: Mapping[str, Sequence[Scalar]] | None = None) -> None:
        self.problem = problem
        self.rank = len(problem.independent_rows.rows)
        contacts, latches = problem.contact_joints, [latch for latch in problem.latches if latch.rigid]
        # what is held while a parameter is 1: rows (n, nv), and the coordinates whose own these are
        self.held = len(contacts) + len(latches)
        self.joints = [*(joint.v for joint in contacts), *(latch.v for latch in latches)]
        own = [row for joint in contacts for row in np.eye(problem.model.nv)[joint.v].tolist()]
        held = {
            "hold": [*(joint.hold for joint in contacts), *(latch.hold for latch in latches)],
            "held": [*own, *(x for latch in latches for x in latch.psi)],
            "held_gamma": [*[0.0] * len(contacts), *(latch.gamma for latch in latches)],
        }
        held = held if self.held else {}
        self.function = SampleKernel({**equations_of(problem), **held, **(more or {})}, STATE_GROUPS)

    def evaluate(self, samples: int, groups: Mapping[str, Array]) -> dict[str, Array]:
        """Return the outputs with ``qdd`` (T, nv), ``lam`` (T, m); prescribed joints' multipliers enter ``tau``."""
        values = self.function.evaluate(samples, groups)
        nv = self.problem.model.nv
        psi = self._psi(values)
        M = values.pop("M").reshape(samples, nv, nv)
        f, gamma, m = values.pop("f"), values.pop("gamma"), psi.shape[1]
        if self.held:  # they have rows of their own
            hold, own = values.pop("hold"), values.pop("held").reshape(samples, self.held, nv)
            psi = np.concatenate([psi, hold[..., None] * own], axis=1)
            gamma = np.concatenate([gamma, hold * values.pop("held_gamma")], axis=1)
        L = np.linalg.cholesky(M)
        Y = np.linalg.solve(L, np.swapaxes(psi, 1, 2))
        b = np.linalg.solve(L, f[..., None])
        rhs = -(gamma[..., None] + np.swapaxes(Y, 1, 2) @ b)
        _, S, Qt = self._leading(Y, self.rank + self.held)
        Q = np.swapaxes(Qt, 1, 2)
        lam = Q @ (S[..., None] ** 2 * (Qt @ rhs))
        values["lam"] = lam[:, :m, 0]
        values["qdd"] = np.linalg.solve(np.swapaxes(L, 1, 2), b + Y @ lam)[..., 0]
        for k, joint in enumerate(self.joints):
            if joint is not None:
                values["qdd"][:, joint] *= 1.0 - hold[:, k]
        for i in self.problem.constraints.prescribed if "tau" in values else ():
            values["tau"] = values["tau"] + psi[:, i] * values["lam"][:, i, None]
        return values

    def _psi(self, values: Mapping[str, Array]) -> Array:
        return values["psi"].reshape(len(values["psi"]), -1, self.problem.model.nv)

    def _leading(self, A: Array, rank: int) -> tuple[Array, Array, Array]:
        """Return U_r, the inverses of the r singular values that count, and V_r^T."""
        U, S, Vt = np.linalg.svd(A, full_matrices=False)
        U, S, Vt = U[..., :rank], S[..., :rank], Vt[..., :rank, :]
        kept = VANISHED * S[..., :1] < S
        return U, np.where(kept, 1.0 / np.where(kept, S, 1.0), 0.0), Vt

    def _solve(self, psi: Array, residual: Array) -> Array:
        """Return the smallest x with Psi x = residual."""
        U, S, Vt = self._leading(psi, self.rank)
        inner = S[..., None] * (np.swapaxes(U, 1, 2) @ residual[..., None])
        return np.asarray((np.swapaxes(Vt, 1, 2) @ inner)[..., 0])

    def correct(self, samples: int, groups: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return one Newton step onto eta = 0 and the step onto Psi v + eta_t = 0, both (T, nv)."""
        values = self.function.evaluate(samples, groups)
        psi = self._psi(values)
        return -self._solve(psi, values["eta"]), -self._solve(psi, values["eta_rate"])

    def moved(self, q: Array, dq: Array) -> Array:
        """Return q (T, nq) after steps dq (T, nv) along the joints' manifolds."""
        if not any(body.joint.quasi for body in self.problem.model.bodies):
            return q + dq
        return self._step.evaluate(len(q), {"q": q, "a": dq})["q"]

    @cached_property
    def _step(self) -> SampleKernel:
        problem = self.problem
        return SampleKernel({"q": moved(problem.model, problem.q, problem.a)}, ("q", "a"))


def singular_values(
    psi: Array | bands.Scattered, passive: Sequence[int] = (), rank: int | None = None
) -> dict[str, Array]:
    """Return datasets by path: those of Psi (T, m, nv), and with ``passive`` coordinates those of their block.

    rank : how many count, where the others are zero in every pose.
    """
    if isinstance(psi, bands.Scattered):
        return _of_some(psi, passive, rank)
    found = [_of_some(psi[part], passive, rank) for part in bands.parts(psi.shape)]
    return {path: np.concatenate([data[path] for data in found]) for path in found[0]}


def _of_some(psi: Array | bands.Scattered, passive: Sequence[int], rank: int | None) -> dict[str, Array]:
    data = {"singularity/psi": bands.singular_values(psi)[:, :rank]}
    if passive:
        block = psi.of_columns(passive) if isinstance(psi, bands.Scattered) else psi[:, :, list(passive)]
        data["singularity/passive"] = bands.singular_values(block)[:, :rank]
        if block.shape[1] == block.shape[2]:
            data["singularity/determinant"] = bands.determinants(block)
    return data
