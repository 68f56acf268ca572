"""Datasets that the commands on mechanisms have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.loops.base import Row
from robodyn_cli.observe.observe import loop_columns
from robodyn_cli.observe.places import add_places, place_outputs
from robodyn_cli.observe.units import add_motion
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.motion import JointMotion


def add_sample(result: Result, problem: Problem, q: Array, v: Array, a: Array) -> None:
    """Add the one sample q (nq,), v and v-dot (nv,) at t = 0, and the places of points, frames and links, to a
    result."""
    add_motion(result, problem.model, np.zeros(1), JointMotion(q[None], v[None], a[None]))
    places = place_outputs(problem)
    # all at once, for places share most of what they are computed from
    values = problem.numbers([x for entries in places.values() for x in entries], q, v=v)
    ends = np.cumsum([len(entries) for entries in places.values()])
    add_places(result, {path: part[None] for path, part in zip(places, np.split(values, ends[:-1]))})


def add_rows(
    result: Result, rows: Sequence[Row], arrays: Mapping[str, Array], dependent: bool = False
) -> None:
    """Add arrays of the loops' rows (T, m), by path, to a result; ``dependent`` : whether rows depend on each
    other."""
    columns = loop_columns(rows, dependent)
    for path, data in arrays.items():
        column = columns[path]
        result.add(
            path, data, units=column.units, long_name=column.long_name, names=column.names,
            column_units=column.column_units,
        )  # fmt: skip
