"""Joint motion given by samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, CsvFile, ListOf, Text, Vector, key
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import (
    Problems,
    SceneNames,
    attitude_problems,
    joint_problems,
    led_joints,
    time_problems,
)
from robodyn_cli.trajectories.motion import JointMotion, column_order

DEGREES = {"linear": 1, "cubic": 3, "quintic": 5}


@record
class TableTrajectory:
    """Positions of all joints at increasing times, in rad or m; the duration is the last time.

    Between the rows runs the spline of degree k (5, 3 or 1) with not-a-knot ends, which reproduces
    polynomials up to degree k; it needs k + 1 rows. Linear: rates jump at the rows, and accelerations are 0
    between them. The loader replaces ``file`` by the ``columns`` and ``rows`` that it contains.
    """

    type: str = key(Choice(("table",)), doc="Kind of trajectory.")
    file: str | None = key(
        CsvFile(), default=None, doc="CSV file: a header row `t, joint names`, then numbers."
    )
    columns: tuple[str, ...] = key(
        ListOf(Text(), minimum=2),
        default=(),
        doc="Column names: `t`, then the joints, or their coordinates as `slide.d`.",
    )
    rows: tuple[tuple[float, ...], ...] = key(
        ListOf(Vector(0), minimum=2), default=(), unit="s, rad or m", doc="Rows of numbers, times from 0."
    )
    interpolation: str = key(
        Choice(("quintic", "cubic", "linear")), default="quintic", doc="Spline between the rows."
    )

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        yield from attitude_problems("table", scene)
        if not self.columns or not self.rows:
            yield (), "a table needs 'file', or both 'columns' and 'rows'"
            return
        if self.columns[0] != "t":
            yield ("columns", 0), f"the first column must be 't' (value {self.columns[0]!r})"
        yield from self._column_problems(scene)
        for k, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                yield ("rows", k), f"has {len(row)} numbers; needed: {len(self.columns)}, one per column"
        if all(self.rows):
            places = [("rows", k, 0) for k in range(len(self.rows))]
            yield from time_problems([row[0] for row in self.rows], places)
        least = DEGREES[self.interpolation] + 1
        if len(self.rows) < least:
            fits = " or ".join(name for name, k in DEGREES.items() if k < len(self.rows))
            yield (
                ("rows",),
                f"has {len(self.rows)} rows; {self.interpolation} interpolation needs {least}, "
                f"with fewer rows use interpolation: {fits}",
            )

    def _column_problems(self, scene: SceneNames) -> Problems:
        for k, name in enumerate(self.columns):
            if name in self.columns[:k]:
                yield ("columns", k), f"column {name!r} appears twice"
            elif k and name not in scene.joints:
                yield ("columns", k), f"unknown joint {name!r}; allowed: {', '.join(scene.joints)}"
        if set(self.joints) <= set(scene.joints):
            yield from joint_problems(self.joints, scene.joints, ("columns",), led_joints(self.joints, scene))

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints whose motion it gives."""
        return tuple(self.columns[1:])

    @property
    def duration(self) -> float:
        """Time of the last row [s]."""
        return self.rows[-1][0]

    def motion(self, times: Array, joints: Sequence[str], parameters: Mapping[str, float]) -> JointMotion:
        """Return the motion of ``joints`` at ``times`` (T,)."""
        from scipy.interpolate import make_interp_spline  # takes 0.4 s to import: only where a table is used

        data = np.array(self.rows, dtype=float)
        columns = [self.columns.index(name) for name in joints]
        degree = DEGREES[self.interpolation]
        spline = make_interp_spline(data[:, 0], data[:, columns], k=degree)
        found = [
            spline,
            spline.derivative(1),
            spline.derivative(2) if degree > 1 else lambda t: 0.0 * spline(t),
        ]
        q, qd, qdd = (column_order(list(np.asarray(f(times)).T), len(times)) for f in found)
        return JointMotion(q, qd, qdd)
