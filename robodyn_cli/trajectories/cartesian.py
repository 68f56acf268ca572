"""A point, or a frame, whose position and orientation are given by formulas in t."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.formula import FormulaTree
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Formula, ListOf, Number, Section, Text, key
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Array, vector
from robodyn_cli.trajectories.base import Ik, Problems, SceneNames, TaskSpaceTrajectory, relative_key
from robodyn_cli.trajectories.formulas import FORMS, sampled, time_derivatives, time_symbol
from robodyn_cli.trajectories.motion import PointMotion, PoseMotion


def _form(size: int, doc: str) -> Any:
    return key(ListOf(Formula(("t",)), minimum=size, maximum=size), default=(), unit="rad", doc=doc)


@record
class OrientationFormulas:
    """Orientation of a frame as formulas in t, in one of three forms."""

    rpy: tuple[FormulaTree, ...] = _form(3, "Roll, pitch, yaw about fixed axes.")
    rotation_vector: tuple[FormulaTree, ...] = _form(3, "Axis of the rotation times its angle.")
    quaternion: tuple[FormulaTree, ...] = key(
        ListOf(Formula(("t",)), minimum=4, maximum=4),
        default=(),
        unit="1",
        doc="Quaternion, scalar first; it is divided by its length.",
    )

    def given(self) -> list[str]:
        """Return the names of the forms that are given."""
        return [name for name in FORMS if getattr(self, name)]

    def motion(self, times: Array, parameters: Mapping[str, float], name: str) -> tuple[Array, Array, Array]:
        """Return R (T, 3, 3), and w and its derivative (T, 3), at ``times`` (T,); ``name`` is for messages."""
        form = self.given()[0]
        t, env = time_symbol(parameters)
        Q = FORMS[form](vector([formula.evaluate(env) for formula in getattr(self, form)]))
        R = quaternion.rotation(Q)
        w = R @ vector(quaternion.angular_velocity(Q, vector(directional(list(Q), [t], [1.0]))))
        orders = [list(R.flat), list(w), directional(list(w), [t], [1.0])]
        arrays = sampled(orders, times, [[f"{form} of {name}"] * len(x) for x in orders])
        return arrays[0].reshape(-1, 3, 3), arrays[1], arrays[2]


@record
class CartesianTrajectory(TaskSpaceTrajectory):
    """Position of a point in world coordinates as formulas in t; with x and y only, z is left free."""

    type: str = key(Choice(("cartesian",)), doc="Kind of trajectory.")
    point: str = key(Text(), doc="The point that follows: a named point, or `link.end`.")
    position: tuple[FormulaTree, ...] = key(
        ListOf(Formula(("t",)), minimum=2, maximum=3),
        unit="m",
        doc="x, y (and z) in the world frame as formulas in t.",
    )
    duration: float = key(Number(minimum=0.0, exclusive=True), unit="s", doc="Length of the motion.")
    orientation: OrientationFormulas | None = key(
        Section(OrientationFormulas),
        default=None,
        doc="How the frame at the point is turned; default: left free.",
    )
    relative_to: str | None = relative_key()
    ik: Ik = key(Section(Ik), default=Ik(), doc="Options of the inverse kinematics.")

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        yield from super().problems(scene)
        if self.orientation is not None:
            forms = self.orientation.given()
            if len(forms) != 1:
                yield (
                    ("orientation",),
                    f"gives {' and '.join(forms) or 'no form'}; allowed: one of {', '.join(FORMS)}",
                )
            if len(self.position) == 2:
                yield (
                    ("position",),
                    "z is left free, which does not go with an orientation; allowed: x, y and z",
                )
        elif len(self.position) == 2 and self.relative_to is not None:
            yield ("position",), "z is left free, which goes with the world's axes only; allowed: x, y and z"

    def target(self, times: Array, parameters: Mapping[str, float]) -> PointMotion | PoseMotion:
        """Return what is asked of the point at ``times`` (T,)."""
        axes = ("x", "y", "z")[: len(self.position)]
        names = [f"{axis} of {self.point}" for axis in axes]
        place = time_derivatives(self.position, times, parameters, names)
        if self.orientation is None:
            return PointMotion(*place)
        return PoseMotion(*place, *self.orientation.motion(times, parameters, self.point))
