"""Joint motion given by formulas in t."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

from robodyn_cli.expr.formula import Formula as FormulaTree
from robodyn_cli.schema.fields import Choice, Formula, MapOf, Number, key
from robodyn_cli.trajectories.base import Problems, SceneNames, joint_problems, led_joints
from robodyn_cli.trajectories.formulas import time_derivatives
from robodyn_cli.trajectories.motion import Array, JointMotion


@dataclasses.dataclass(frozen=True)
class JointTrajectory:
    """q(t) of every moving joint as a formula; rates and accelerations are its exact derivatives."""

    type: str = key(Choice(("joint",)), doc="Kind of trajectory.")
    q: dict[str, FormulaTree] = key(
        MapOf(Formula(("t",)), of="joint"), unit="rad or m", doc="Position of each joint as a formula in t."
    )
    duration: float = key(Number(minimum=0.0, exclusive=True), unit="s", doc="Length of the motion.")

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        names = tuple(self.q)
        yield from joint_problems(names, scene.joints, ("q",), led_joints(names, scene))

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints whose motion it gives."""
        return tuple(self.q)

    def motion(self, times: Array, joints: Sequence[str], parameters: Mapping[str, float]) -> JointMotion:
        """Return the motion of ``joints`` at ``times`` (T,)."""
        return JointMotion(*time_derivatives([self.q[name] for name in joints], times, parameters, joints))
