"""Joint motion given by formulas in t."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Formula, JointMap, Number, key
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.attitudes import joint_expressions, texts
from robodyn_cli.trajectories.base import Problems, SceneNames, joint_problems, led_joints
from robodyn_cli.trajectories.formulas import sampled, time_symbol
from robodyn_cli.trajectories.motion import JointMotion


@record
class JointTrajectory:
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
        if missing and not scene.closed:
            yield ("q",), f"joint {missing[0]!r} is missing; needed here: {', '.join(scene.quasi)}"
        for joint in attitudes if scene.closed else ():
            yield (
                ("q", joint),
                f"joint {joint!r} cannot be led in a mechanism with loops; lead joints of one axis",
            )

    @property
    def joints(self) -> tuple[str, ...]:
        """The columns of q whose motion it gives."""
        return tuple(self.q)

    def motion(self, times: Array, joints: Sequence[str], parameters: Mapping[str, float]) -> JointMotion:
        """Return the motion of ``joints`` (columns of q) at ``times`` (T,)."""
        t, env = time_symbol(parameters)
        found = joint_expressions(self.q, joints, t, env)
        whose = [texts(self.q, column) for column in joints]
        if len(found.v) < len(found.q):  # quasi-velocities: a column has no formula of its own
            every = "; ".join(dict.fromkeys(whose))
            names = [whose, [every] * len(found.v), [every] * len(found.v)]
        else:
            names = [whose] * 3
        return JointMotion(*sampled([found.q, found.v, found.a], times, names))
