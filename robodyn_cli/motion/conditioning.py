"""What rounding of the equations does to a motion, beside that of its states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.model.model import PARAMETER_GROUP
from robodyn_cli.observe.rounding import ENLARGED, Rounded, largest_difference
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

LARGE = 50_000  # operations
VANISHED = 1e-12  # of the largest singular value: smaller ones are those of rows that depend on others


@record
class Conditioning:
    """How far rounding of the equations puts off any acceleration, and coordinates that the loops close [rad, m].

    acceleration : 0 where that is not to be told at little cost: parameters that change on the way, very large
    equations. changes : time in which rates change [s].
    """

    acceleration: float
    closing: float
    changes: float

    @staticmethod
    def of(
        problem: Problem, held: Sequence[int], times: Array, states: tuple[Array, Array, Array]
    ) -> Conditioning:
        """Return the conditioning along a motion.

        Parameters
        ----------
        held : columns of rates that are held at the start. states : q (T, nq), v (T, nv) and z (T, nz) at the times.
        """
        inputs = dict(zip(("t", "q", "v", "z"), (times[:, None], *states)))
        closing = _closing(problem, held, inputs)
        accelerations = list(problem.forward.qdd)
        if any(symbol.value[1] == PARAMETER_GROUP for symbol in free_symbols(accelerations)):
            return Conditioning(0.0, closing, 0.0)
        program = Rounded(accelerations)
        if len(program.nodes) > LARGE:
            return Conditioning(0.0, closing, 0.0)
        draws = program(inputs)
        off = largest_difference(draws)
        if off is None:
            return Conditioning(0.0, closing, 0.0)
        fastest, largest = (float(np.abs(x).max(initial=0.0)) for x in (states[1], draws[0]))
        return Conditioning(off, closing, fastest / max(largest, 1e-300))

    def leaves(self, lasted: Any) -> tuple[Any, Any]:
        """Return what it leaves of positions and rates of runs that lasted so long [s], numbers or arrays.

        Of rates delta(v-dot) over the run; of positions that over the time in which rates change, or what closing the
        loops leaves.
        """
        off = self.acceleration * lasted
        return np.maximum(self.closing, off * np.minimum(lasted, self.changes)), off


def _closing(problem: Problem, held: Sequence[int], inputs: dict[str, Array]) -> float:
    """Return how far rounding of the constraints may have put any coordinate off [rad, m].

    delta(eta) over the smallest singular value of Psi, of the columns that are not ``held`` at the start: rows that
    nearly depend on each other hardly determine the joints that they close. 0 where there are no constraints or their
    number makes it dear.
    """
    return float(np.linalg.norm(closing_steps(*rounded_rows(problem, inputs), held), axis=1).max(initial=0.0))


def rounded_rows(problem: Problem, inputs: dict[str, Array]) -> tuple[Array, Array]:
    """Return Psi (T, m, nv), and how far rounding may have put eta off (T,), at samples (T, n) by group; none (T = 0)
    where there are no constraints or their number makes it dear."""
    rows, nv = problem.constraints.rows, problem.model.nv
    program = Rounded([*(row.eta for row in rows), *problem.psi.ravel()])
    if not rows or len(program.nodes) > LARGE:
        return np.zeros((0, 0, nv)), np.zeros(0)
    draws = program(inputs)
    eta = draws[:, :, : len(rows)]
    off = np.sqrt((np.abs(eta[1:] - eta[0]).max(axis=0) ** 2).sum(axis=1)) / ENLARGED
    return draws[0, :, len(rows) :].reshape(draws.shape[1], len(rows), nv), off


def closing_steps(psi: Array, off: Array, held: Sequence[int]) -> Array:
    """Return the steps (T, nv) by which rounding may have put closed positions off [rad, m].

    They are along the motion that the rows hold least of those that they hold, delta(eta) / sigma long; 0 where
    something is not finite.

    Parameters
    ----------
    psi : (T, m, nv). off : delta(eta) (T,). held : columns of rates that are held.
    """
    columns = np.delete(np.arange(psi.shape[2]), list(held))
    free = psi[:, :, columns]
    if not len(psi) or not free.size:
        return np.zeros((len(psi), psi.shape[2]))
    good = np.isfinite(off) & np.isfinite(free).all(axis=(1, 2))
    _, sigma, Vt = np.linalg.svd(np.where(good[:, None, None], free, 0.0), full_matrices=False)
    least = (sigma > VANISHED * sigma[:, :1]).sum(axis=1)[:, None] - 1
    with np.errstate(all="ignore"):
        size = off / np.take_along_axis(sigma, least, axis=1)[:, 0]
        own = np.take_along_axis(Vt, least[:, :, None], axis=1)[:, 0] * size[:, None]
    steps: Array = np.where(np.isfinite(own) & good[:, None], own, 0.0) @ np.eye(psi.shape[2])[columns]
    return steps
