"""Joint motion given by formulas in t."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robodyn_cli.expr.graph import Expr
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Formula, JointMap, Number, key
from robodyn_cli.trajectories.attitudes import evaluated, texts
from robodyn_cli.trajectories.base import Problems, SceneNames, joint_problems, led_joints
from robodyn_cli.trajectories.joint_space import JointSpaceTrajectory


@record
class JointTrajectory(JointSpaceTrajectory):
    """q(t) of every moving joint as a formula; rates and accelerations are its exact derivatives.

    The attitude of a spherical or floating joint is three or four formulas: ``rpy``, ``rotation_vector`` or
    ``quaternion``, which need not have length 1.
    """

    type: str = key(Choice(("joint",)), doc="Kind of trajectory.")
    q: dict[str, Any] = key(
        JointMap(Formula(("t",))), unit="rad or m", doc="Position of each joint as a formula in t."
    )
    duration: float = key(Number(minimum=0.0, exclusive=True), unit="s", doc="Length of the motion.")

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        attitudes = {name.partition(".")[0]: name for name in self.q if name.partition(".")[0] in scene.quasi}
        names = [
            name for name in self.q if name not in scene.quasi and name.partition(".")[0] not in attitudes
        ]
        yield from joint_problems(names, scene.joints, ("q",), led_joints(names, scene))
        missing = [name for name in scene.quasi if name not in attitudes]
        if missing and not scene.some:
            yield ("q",), f"joint {missing[0]!r} is missing; needed here: {', '.join(scene.quasi)}"

    @property
    def joints(self) -> tuple[str, ...]:
        """The columns of q whose motion it gives."""
        return tuple(self.q)

    def expressions(self, t: Expr, env: Mapping[str, Any]) -> Mapping[str, Any]:
        return evaluated(self.q, env)

    def described(self, column: str) -> str:
        return texts(self.q, column)
