"""The states that many runs start from: given ones of open chains, closed ones of mechanisms.

Loops are closed for all runs at once, as ``assemble`` closes those of each (``solve/closing/together.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.control.control import NOISE
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.over.many.groups import Built
from robodyn_cli.over.many.keys import START
from robodyn_cli.over.many.structure import Structure
from robodyn_cli.ready.prepare import held_columns
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closing.assembly import Assembled
from robodyn_cli.solve.closing.together import ManyClosing
from robodyn_cli.spatial.algebra import Array

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
    problem, scene, count = begun.problem, begun.scene, len(values)
    model, loops = problem.model, bool(problem.constraints.rows)
    own = {"q": begun.assembled.q, "qd": begun.assembled.v}
    given = {
        "q": _given(structure, "q", model.q_names, scene.initial.q, values, q),
        "qd": _given(structure, "qd", model.v_names, scene.initial.qd, values, qd),
    }
    rows = {}
    for name, columns in (("q", model.q_names), ("qd", model.v_names)):
        # an open chain has values for all; what a loop has none for is found
        nominal = (Manifold(model).neutral() if loops else own["q"]) if name == "q" else np.zeros(model.nv)
        rows[name] = np.broadcast_to(nominal, (count, len(nominal))).copy()
        for k, column in enumerate(columns):
            if column in given[name]:
                rows[name][:, k] = given[name][column]
    if not loops:
        return Starts(rows["q"], rows["qd"], np.ones(count, dtype=bool))
    held = held_columns(scene, problem)
    closing = ManyClosing(problem, structure.numbers(values), given["q"], given["qd"], held)
    closing.varies |= any(key.sort == START for key in structure.keys)
    if q is None and qd is None and not closing.varies:
        same_q, same_v = (np.broadcast_to(x, (count, len(x))).copy() for x in own.values())
        return Starts(same_q, same_v, np.ones(count, dtype=bool))
    starts = Starts(*closing.close(rows["q"], rows["qd"]))
    if problem.constraints.rheonomic:  # rates that agree with a prescribed motion are the command's to find
        starts.sound[:] = False
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
