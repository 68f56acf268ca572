"""Rates that close the loops."""

from __future__ import annotations

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

AGREES = 1e-10  # part of the largest terms, up to which rates satisfy the loops


@record
class RatesByLoops:
    """How rates follow from the loops: of those asked (nv,) as few as possible change.

    given, hold : velocity coordinates with a rate, and those whose position stays. cut : ratio of singular values below
    which a direction is left alone.
    """

    asked: Array
    given: frozenset[int]
    hold: frozenset[int]
    cut: float

    def __call__(self, psi: Array, eta_t: Array) -> tuple[Array, Array, bool]:
        """Return rates with Psi v + eta_t = 0, what they leave of it (m,), and whether that is nothing."""
        scale = max(float(np.abs(psi).max()), 1e-300) * max(float(np.abs(self.asked).max()), 1.0)
        enough = max(AGREES, self.cut) * scale
        tries = (self.given | self.hold, self.given) if self.given else (self.hold, frozenset[int]())
        for fixed in tries:
            free = [k for k in range(len(self.asked)) if k not in fixed]
            v = self.asked.copy()
            residual = psi @ v + eta_t
            for _ in range(3 if free else 0):
                step, *_ = np.linalg.lstsq(psi[:, free], -residual, rcond=self.cut)
                v[free] += step
                residual = psi @ v + eta_t
            closed = bool(np.abs(residual).max() <= enough)
            if closed:
                break
        return v, residual, closed
