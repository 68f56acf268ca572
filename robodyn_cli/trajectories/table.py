"""Joint motion given by samples."""

from __future__ import annotations

import dataclasses

from robodyn_cli.schema.fields import Choice, CsvFile, ListOf, Name, Vector, key
from robodyn_cli.trajectories.base import Problems, SceneNames, joint_problems, time_problems


@dataclasses.dataclass(frozen=True)
class TableTrajectory:
    """Positions of all joints at increasing times, in rad or m; the duration is the last time.

    The loader replaces ``file`` by the ``columns`` and ``rows`` that it contains.
    """

    type: str = key(Choice(("table",)), doc="Kind of trajectory.")
    file: str | None = key(
        CsvFile(), default=None, doc="CSV file: a header row `t, joint names`, then numbers."
    )
    columns: tuple[str, ...] = key(
        ListOf(Name(), minimum=2), default=(), doc="Column names: `t`, then the joints."
    )
    rows: tuple[tuple[float, ...], ...] = key(
        ListOf(Vector(0), minimum=2), default=(), unit="s, rad or m", doc="Rows of numbers, times from 0."
    )
    interpolation: str = key(
        Choice(("quintic", "cubic", "linear")), default="quintic", doc="Spline between the rows."
    )

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        if not self.columns or not self.rows:
            yield (), "a table needs 'file', or both 'columns' and 'rows'"
            return
        if self.columns[0] != "t":
            yield ("columns", 0), f"the first column must be 't' (value {self.columns[0]!r})"
        for k, name in enumerate(self.columns):
            if name in self.columns[:k]:
                yield ("columns", k), f"column {name!r} stands twice"
            elif k and name not in scene.joints:
                yield ("columns", k), f"unknown joint {name!r}; allowed: {', '.join(scene.joints)}"
        yield from joint_problems(self.columns[1:], scene.joints, ("columns",))
        for k, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                yield ("rows", k), f"has {len(row)} numbers; needed: {len(self.columns)}, one a column"
        yield from time_problems([r[0] for r in self.rows], [("rows", k, 0) for k in range(len(self.rows))])
