"""A point whose position is given by formulas in t."""

from __future__ import annotations

from collections.abc import Mapping

from robodyn_cli.expr.formula import Formula as FormulaTree
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Formula, ListOf, Number, Section, Text, key
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import Ik, Problems, SceneNames, point_problems
from robodyn_cli.trajectories.formulas import time_derivatives
from robodyn_cli.trajectories.motion import PointMotion


@record
class CartesianTrajectory:
    """Position of a point in world coordinates as formulas in t; with x and y only, z is left free."""

    type: str = key(Choice(("cartesian",)), doc="Kind of trajectory.")
    point: str = key(Text(), doc="The point that follows: a named point, or `link.end`.")
    position: tuple[FormulaTree, ...] = key(
        ListOf(Formula(("t",)), minimum=2, maximum=3),
        unit="m",
        doc="x, y (and z) in the world frame as formulas in t.",
    )
    duration: float = key(Number(minimum=0.0, exclusive=True), unit="s", doc="Length of the motion.")
    ik: Ik = key(Section(Ik), default=Ik(), doc="Options of the inverse kinematics.")

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        yield from point_problems(self.point, self.ik, scene)

    def target(self, times: Array, parameters: Mapping[str, float]) -> PointMotion:
        """Return what is asked of the point at ``times`` (T,)."""
        axes = ("x", "y", "z")[: len(self.position)]
        names = [f"{axis} of {self.point}" for axis in axes]
        return PointMotion(*time_derivatives(self.position, times, parameters, names))
