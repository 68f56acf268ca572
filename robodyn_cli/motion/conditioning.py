"""What rounding of the equations does to a motion, beside that of its states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.stepping.rounding import last_digits
from robodyn_cli.model.model import PARAMETER_GROUP, unknown_among
from robodyn_cli.observe.rounding import ENLARGED, Rounded, largest_differences
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

LARGE = 50_000  # operations
NOTABLE = 1e-12  # of the largest rate, beyond which rounding is more than is usual
NEGLIGIBLE = 1e-13  # rad/s^2 or m/s^2
VANISHED = 1e-12  # of the largest singular value: smaller ones are those of rows that depend on others


@record
class Conditioning:
    """How far rounding of the equations puts off any acceleration, and coordinates that the loops close [rad, m], of
    runs (N,).

    acceleration : 0 where that is not to be told at little cost: parameters that change on the way, very large
    equations. changes : time in which rates change [s].
    """

    acceleration: Array
    closing: Array
    changes: Array

    @staticmethod
    def of(
        problem: Problem,
        held: Sequence[int],
        times: Array,
        states: tuple[Array, Array, Array],
        runs: ManyNumbers | None = None,
    ) -> Conditioning:
        """Return the conditioning along motions.

        Parameters
        ----------
        held : columns of rates that are held at the start. states : q (N, T, nq), v (N, T, nv) and z (N, T, nz) at the
        times (N, T). runs : numbers of the scene in each, in place of its own.
        """
        inputs = dict(zip(("t", "q", "v", "z"), (times[..., None], *states)))
        closing, nothing = _closing(problem, held, inputs, runs), np.zeros(len(times))
        accelerations = list(problem.forward.qdd)
        if any(symbol.value[1] == PARAMETER_GROUP for symbol in free_symbols(accelerations)):
            return Conditioning(nothing, closing, nothing)
        program = Rounded(accelerations)
        if len(program.nodes) > LARGE:
            return Conditioning(nothing, closing, nothing)
        draws = program(inputs, runs)
        off = largest_differences(draws)
        fastest, largest = (np.abs(x).max(axis=(1, 2), initial=0.0) for x in (states[1], draws[:, 0]))
        good = np.isfinite(off)
        changes = np.where(good, fastest / np.maximum(largest, 1e-300), 0.0)
        return Conditioning(np.where(good, off, 0.0), closing, changes)

    def leaves(self, lasted: Any) -> tuple[Any, Any]:
        """Return what it leaves of positions and rates of runs that lasted so long [s], numbers or arrays.

        Of rates delta(v-dot) over the run; of positions that over the time in which rates change, or what closing the
        loops leaves.
        """
        off = self.acceleration * lasted
        return np.maximum(self.closing, off * np.minimum(lasted, self.changes)), off


def rounding_of_rates(system: System, x: Array) -> float:
    """Return how far rounding of the equations puts accelerations off [rad/s^2, m/s^2] as a motion begins.

    Links of next to no mass between joints make that large: torques are rounded, and divided by their inertia. It is
    measured as on the way (``integrators/stepping/rounding.py``).

    Parameters
    ----------
    x : state (nx,) at t = 0.

    Returns
    -------
    float : of the one that is put off most; 0 where that is no more than is usual, or they are no expressions.
    """
    if system.dynamics.any_size or unknown_among(system.rates):
        return 0.0
    rates = system.rates
    accelerations = [rates[place - system.nq] for place in system.v_places]
    states = np.vstack([x, x + np.maximum(np.abs(x), 1.0) * last_digits(len(x))])
    p = system.parameters_at(0.0, system.split(x)[0])
    groups = {name: values.T for name, values in system.own_groups(np.zeros(1), states, p).items()}
    with np.errstate(all="ignore"):
        values = np.stack([np.zeros(len(states)) + y for y in [0.0, *evaluate(accelerations, groups)]])
        off, largest = np.abs(values[:, 1:] - values[:, :1]).max(), np.abs(values).max()
    return float(off) if max(NOTABLE * largest, NEGLIGIBLE) < off < np.inf else 0.0


def _closing(
    problem: Problem, held: Sequence[int], inputs: dict[str, Array], runs: ManyNumbers | None
) -> Array:
    """Return how far rounding of the constraints may have put any coordinate off (N,) [rad, m].

    delta(eta) over the smallest singular value of Psi, of the columns that are not ``held`` at the start: rows that
    nearly depend on each other hardly determine the joints that they close. 0 where there are no constraints or their
    number makes it dear.
    """
    psi, off = rounded_rows(problem, inputs, runs)
    steps = closing_steps(psi.reshape(off.size, *psi.shape[2:]), off.ravel(), held).reshape(
        *off.shape, psi.shape[3]
    )
    largest: Array = np.linalg.norm(steps, axis=2).max(axis=1, initial=0.0)
    return largest


def rounded_rows(
    problem: Problem, inputs: dict[str, Array], runs: ManyNumbers | None = None
) -> tuple[Array, Array]:
    """Return Psi (N, T, m, nv), and how far rounding may have put eta off (N, T), at samples (N, T, n) by group; none
    (T = 0) where there are no constraints or their number makes it dear. runs : as of ``Conditioning.of``."""
    rows, nv, count = problem.constraints.rows, problem.model.nv, len(inputs["q"])
    program = Rounded([*(row.eta for row in rows), *problem.psi.ravel()])
    if not rows or len(program.nodes) > LARGE:
        return np.zeros((count, 0, 0, nv)), np.zeros((count, 0))
    draws = program(inputs, runs)
    eta = draws[..., : len(rows)]
    off = np.sqrt((np.abs(eta[:, 1:] - eta[:, :1]).max(axis=1) ** 2).sum(axis=2)) / ENLARGED
    return draws[:, 0, :, len(rows) :].reshape(count, draws.shape[2], len(rows), nv), off


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
