"""The states that many runs start from: given ones of open chains, closed ones of mechanisms.

Loops are closed for all runs at once, by the Gauss-Newton steps of ``solve/closure.py`` on arrays. Coordinates without
an initial value start from where they are in the structure's own pose, so that all runs are on its branch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.control.control import NOISE
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.many import Expressions, ManyNumbers
from robodyn_cli.over.many.groups import Built
from robodyn_cli.over.many.keys import START
from robodyn_cli.over.many.structure import Structure
from robodyn_cli.ready.prepare import held_columns
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closing.assembly import Assembled
from robodyn_cli.solve.closing.descent import starts_around
from robodyn_cli.solve.closure import CLOSED, SAME, Numbers, has_full_rank, least_steps, newton_of_many
from robodyn_cli.solve.independent_rows import RANK_TOLERANCE
from robodyn_cli.spatial.algebra import Array

EQUAL = 1e-6  # relative difference of distances by which the nearest pose is not sure
REGULAR = (
    1e-3  # ratio of singular values of the unknown coordinates below which branches are near to each other
)
LEAP = 0.7  # rad, or part of the size, from the structure's own pose: farther on another branch may be meant
AGREES = 1e-10  # of rates with the constraints, relative
Rows = NDArray[np.bool_]


@record
class Starts:
    """Starts of many runs: q (N, nq), v (N, nv), and for which of them this is what the run would start from."""

    q: Array
    v: Array
    sound: Rows

    def states(self, structure: Structure, numbers: ManyNumbers) -> Array:
        """Return the integrator's states (N, nx)."""
        system = structure.motion.system
        x = np.tile(structure.motion.start, (len(self.q), 1))  # states of a controller among them
        x[:, list(system.q_places)], x[:, list(system.v_places)] = self.q, self.v
        if structure.begun is not None and system.updates is not None:
            groups = {
                "q": self.q.T,
                "v": self.v.T,
                "p": list(system.parameters),
                NOISE: system.updates.noise[0],
            }
            first = system.size - system.further
            x[:, first : first + system.updates.count] = numbers.evaluate(structure.begun, groups)
        return x


class Begun(Protocol):
    """The start of the structure's own row: the equations, the scene, the pose in which the loops close."""

    @property
    def problem(self) -> Problem: ...
    @property
    def scene(self) -> Scene: ...
    @property
    def assembled(self) -> Assembled: ...


def starts_of(
    structure: Built, begun: Begun, values: Array, q: Array | None = None, qd: Array | None = None
) -> Starts:
    """Return the starts of runs with rows of values (N, keys).

    Parameters
    ----------
    begun : of the structure. q, qd : initial positions (N, nq) and rates (N, nv) in place of the scene's.
    """
    model, scene, count = begun.problem.model, begun.scene, len(values)
    own = {"q": begun.assembled.q, "qd": begun.assembled.v}
    given = {
        "q": _given(structure, "q", model.q_names, scene.initial.q, values, q),
        "qd": _given(structure, "qd", model.v_names, scene.initial.qd, values, qd),
    }
    rows = {}
    for name, columns in (("q", model.q_names), ("qd", model.v_names)):
        nominal = own[name] if name == "q" else np.zeros(model.nv)
        rows[name] = np.broadcast_to(nominal, (count, len(nominal))).copy()
        for k, column in enumerate(columns):
            if column in given[name]:
                rows[name][:, k] = given[name][column]
    if not begun.problem.constraints.rows:
        return Starts(rows["q"], rows["qd"], np.ones(count, dtype=bool))
    closing = ManyClosing(begun, structure.numbers(values), given["q"], given["qd"])
    closing.varies |= any(key.sort == START for key in structure.keys)
    if q is None and qd is None and not closing.varies:
        same_q, same_v = (np.broadcast_to(x, (count, len(x))).copy() for x in own.values())
        return Starts(same_q, same_v, np.ones(count, dtype=bool))
    starts = closing.close(rows["q"], rows["qd"])
    if q is None and qd is None:
        # a run that is the structure's own starts where that does, to the bit
        alike = (values == structure.row).all(axis=1)
        starts.q[alike], starts.v[alike], starts.sound[alike] = own["q"], own["qd"], True
    return starts


def _given(
    structure: Built,
    name: str,
    columns: Sequence[str],
    scene: Mapping[str, float],
    values: Array,
    array: Array | None,
) -> dict[str, Array | float]:
    """Return what is given of the initial positions or rates, by column."""
    if array is not None:
        return {column: array[:, k] for k, column in enumerate(columns)}
    by_column: dict[str, Array | float] = dict(scene)
    for column in columns:
        own = structure.column(f"{name}.{column}", values)
        if own is not None:
            by_column[column] = own
    return by_column


class ManyClosing:
    """The loops of a structure for many runs: eta (N, m) and Psi (N, m, nv) at positions of their own."""

    def __init__(
        self,
        begun: Begun,
        numbers: ManyNumbers,
        q: Mapping[str, Array | float],
        qd: Mapping[str, Array | float],
    ) -> None:
        problem = self.problem = begun.problem
        self.numbers, self.own = numbers, begun.assembled.q
        rows = problem.constraint_rows
        self.equations = {
            "eta": [row.eta for row in rows],
            "psi": [x for row in rows for x in row.psi],
            "cosines": [row.cosine for row in rows],
        }
        self._eta, self._psi, self._cosines = map(Expressions, self.equations.values())
        self.one = Numbers(problem, ())
        self.lengths, self.sizes = self.one.lengths, self.one.sizes
        equations = (self._eta, self._psi, self._cosines)
        numbers_there = [x for part in equations for x in (*part.constants, *part.outputs)]
        self.varies = any(numbers.recipe.varies(x) for x in numbers_there)  # whether runs have other loops
        model = problem.model
        held = held_columns(begun.scene, problem)
        self.nv = model.nv
        self.missing = [k for k, name in enumerate(model.q_names) if name not in q and name not in held]
        self.free = [k for k, name in enumerate(model.q_names) if name not in held]
        self.held_rates = [k for k, name in enumerate(model.v_names) if name in qd or name in held]

    def _inputs(self, q: Array) -> dict[str, list[Array]]:
        return {"q": list(q.T), "t": [np.zeros(len(q))], "p": []}

    def eta(self, q: Array) -> Array:
        return self.numbers.evaluate(self._eta, self._inputs(q))

    def psi(self, q: Array) -> Array:
        return self.numbers.evaluate(self._psi, self._inputs(q)).reshape(len(q), -1, self.nv)

    def close(self, q: Array, v: Array) -> Starts:
        """Return closed positions and rates that agree with them, from what is given."""
        if (
            self.one.manifold.quasi or len(self.missing) == self.nv
        ):  # the nearest to q = 0 is the command's to find
            return Starts(q, v, np.zeros(len(q), dtype=bool))
        start = q
        if self.missing:
            q = self._newton(q, self.missing)
        q = self._newton(q, self.free)
        sure = np.ones(len(q), dtype=bool)
        if self.missing:
            far = ~self.on_branch(q, self.psi(q))
            if far.any() and (self.one.lengths[self.missing] == 1.0).all():
                alone, certain = self._as_alone(start)
                q[far], sure[far] = alone[far], certain[far]
            else:
                sure = ~far
        cosines = self.numbers.evaluate(self._cosines, self._inputs(q))
        v, sound = self.rates_of_closed(self.eta(q), self.psi(q), cosines, v)
        return Starts(q, v, sound & sure)

    def rates_of_closed(self, eta: Array, psi: Array, cosines: Array, v: Array) -> tuple[Array, Rows]:
        """Return rates (N, nv) that agree with the loops, and where positions close them: by eta (N, m), Psi (N, m, nv)
        and the cosines of attitudes (N, m) there."""
        residual = np.abs(eta / self.sizes).max(axis=1)
        sound = (residual <= CLOSED) & has_full_rank(psi, RANK_TOLERANCE)
        v, agrees = self._rates(np.where(sound[:, None, None], psi, 0.0), v)
        return v, sound & (cosines >= 0.5).all(axis=1) & agrees

    def at_runs(self, q: Array) -> tuple[Array, Array]:
        """Return eta (N, m) and Psi (N, m, nv)."""
        return self.eta(q), self.psi(q)

    def _newton(self, q: Array, columns: Sequence[int]) -> Array:
        return newton_of_many(self, q, columns)[0]

    def _as_alone(self, q: Array) -> tuple[Array, Rows]:
        """Return the closed positions that ``assemble`` takes from q (N, nq), and where they are sure: those nearest to
        q, from q and from starts around it.
        """
        count, missing = len(q), self.missing
        given = [k for k in range(self.nv) if k not in missing]
        steps = [np.zeros(self.nv), *starts_around(self.one, np.zeros(self.nv), missing, np.pi, 1)]
        best, nearest, rank = q.copy(), np.full(count, np.inf), np.full(count, -1)
        sure = np.ones(count, dtype=bool)
        for step in steps:
            closed = self._newton(self._newton(q + step, missing), self.free)
            wrapped = closed.copy()
            turning = [k for k in missing if self.one.lengths[k] == 1.0]
            wrapped[:, turning] = (closed[:, turning] + np.pi) % (2 * np.pi) - np.pi
            fits = (np.abs(self.eta(wrapped) / self.one.sizes).max(axis=1) <= CLOSED)[:, None]
            closed = np.where(fits, wrapped, closed)
            ok = np.abs(self.eta(closed) / self.one.sizes).max(axis=1) <= CLOSED
            cosines = self.numbers.evaluate(self._cosines, self._inputs(closed))
            ok &= (cosines >= 0.5).all(axis=1)
            psi = np.where(ok[:, None, None], self.psi(closed), 0.0)
            own = np.where(ok, has_full_rank(psi, RANK_TOLERANCE), -1)
            moved = np.abs(closed - q) / self.one.lengths
            distance = moved[:, given].sum(axis=1) + 1e-6 * moved[:, missing].sum(axis=1)
            apart = np.abs(closed - best).max(axis=1) > SAME
            with np.errstate(invalid="ignore"):
                doubtful = np.abs(distance - nearest) <= EQUAL * distance
            better = (own > rank) | ((own == rank) & ok & (distance < nearest))
            sure = np.where(better & ~doubtful, True, sure & ~(ok & apart & doubtful & (own == rank)))
            best[better], nearest[better], rank[better] = closed[better], distance[better], own[better]
        return best, sure & (rank > 0)

    def on_branch(self, q: Array, psi: Array) -> Rows:
        """Tell which positions are on the branch of the structure's own pose: near to it, with no branching between."""
        near = (np.abs(q - self.own) / self.one.lengths).max(axis=1) < LEAP
        block, own = psi[:, :, self.missing], self.one.psi(self.own)[:, self.missing]
        regular = has_full_rank(block, REGULAR)
        alike = np.ones(len(q), dtype=bool)
        if own.shape[0] == own.shape[1]:
            alike = np.sign(np.linalg.det(block)) == np.sign(np.linalg.det(own))
        same: Rows = near & regular & alike
        return same

    def _rates(self, psi: Array, v: Array) -> tuple[Array, Rows]:
        """Return rates with Psi v = 0 that keep those given, and where there are such."""
        v = v.copy()
        free = [k for k in range(self.nv) if k not in self.held_rates]
        for _ in range(3):
            if free:
                residual = psi @ v[..., None]
                v[:, free] += least_steps(psi[:, :, free], -residual[..., 0])
        left = np.abs(psi @ v[..., None]).max(axis=(1, 2))
        scale = np.abs(psi).max(axis=(1, 2)) * np.maximum(np.abs(v).max(axis=1), 1.0)
        return v, left <= AGREES * scale
