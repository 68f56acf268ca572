"""Joint motion given by samples."""

from __future__ import annotations

import math

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, CsvFile, ListOf, Text, Vector, key
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import (
    Problems,
    SceneNames,
    joint_problems,
    time_problems,
)
from robodyn_cli.trajectories.course import Course, hermite_cubic
from robodyn_cli.trajectories.joint_space import CourseTrajectory, attitude_places, the_shorter_way
from robodyn_cli.trajectories.way_points import monotone_rates

# rows that an interpolation needs
LEAST = {"linear": 2, "monotone": 2, "cubic": 4, "quintic": 6}
UNIT = 1e-3  # tolerance of a quaternion's length 1: three digits


@record
class TableTrajectory(CourseTrajectory):
    """Positions of all joints at increasing times, in rad or m; the duration is the last time.

    Between the rows runs the spline of degree k (5, 3 or 1) with not-a-knot ends, which reproduces
    polynomials up to degree k; it needs k + 1 rows. Linear: rates jump at the rows, and accelerations are 0
    between them. Monotone: cubics that do not overshoot, whose accelerations jump at the rows. The loader replaces
    ``file`` by the ``columns`` and ``rows`` that it contains.
    """

    type: str = key(Choice(("table",)), doc="Kind of trajectory.")
    file: str | None = key(
        CsvFile(),
        default=None,
        doc="CSV file: a header row `t, joint names`, then numbers; or HDF5: a result, or a dataset a column.",
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
        Choice(("quintic", "cubic", "monotone", "linear")), default="quintic", doc="Spline between the rows."
    )

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
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
        yield from self._attitude_problems()
        least = LEAST[self.interpolation]
        if len(self.rows) < least:
            fits = " or ".join(name for name, k in LEAST.items() if k <= len(self.rows))
            yield (
                ("rows",),
                f"has {len(self.rows)} rows; {self.interpolation} interpolation needs {least}, "
                f"with fewer rows use interpolation: {fits}",
            )

    def _column_problems(self, scene: SceneNames) -> Problems:
        for k, name in enumerate(self.columns):
            if name in self.columns[:k]:
                yield ("columns", k), f"column {name!r} appears twice"
            elif k and name not in scene.columns:
                yield ("columns", k), f"unknown joint {name!r}; allowed: {', '.join(scene.columns)}"
        if set(self.joints) <= set(scene.columns):
            led = {name.partition(".")[0] for name in self.joints}
            whole = [
                x for x in scene.columns if x in self.joints or x.partition(".")[0] in {*scene.quasi} & led
            ]
            needed = whole if scene.some else scene.columns
            yield from joint_problems(self.joints, scene.columns, ("columns",), needed)

    def _attitude_problems(self) -> Problems:
        for joint, places in attitude_places(self.joints).items() if all(map(len, self.rows)) else ():
            for k, row in enumerate(self.rows):
                length = math.hypot(*(row[1 + place] for place in places if 1 + place < len(row)))
                if abs(length - 1.0) > UNIT:
                    what = f"the quaternion of joint {joint!r} has length {length:.6g}"
                    yield ("rows", k), f"{what}; needed: length 1, to three digits"
                    break

    @property
    def joints(self) -> tuple[str, ...]:
        """The columns of q whose motion it gives."""
        return tuple(self.columns[1:])

    @property
    def duration(self) -> float:
        """Time of the last row [s]."""
        return self.rows[-1][0]

    def make_course(self) -> Course:
        data = np.array(self.rows, dtype=float)
        t, q = data[:, 0], the_shorter_way(self.joints, data[:, 1:])
        if self.interpolation == "linear":
            return Course(t, [q[:-1], np.diff(q, axis=0) / np.diff(t)[:, None]])
        if self.interpolation == "monotone":
            return hermite_cubic(t, q, monotone_rates(t, q))
        return _spline(t, q, LEAST[self.interpolation] - 1)


def _spline(t: Array, q: Array, degree: int) -> Course:
    """Return the spline with not-a-knot ends through ``q`` (N, n)."""
    from scipy.interpolate import make_interp_spline  # takes 0.4 s to import: only where a table is used

    spline = make_interp_spline(t, q, k=degree)
    knots = np.unique(spline.t)
    return Course(knots, [spline(knots[:-1], nu=i) / math.factorial(i) for i in range(degree + 1)])
