"""Joint motion given by formulas in t, and as a Fourier series."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from robodyn_cli.expr.functions import cos, sin
from robodyn_cli.expr.graph import Expr
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Formula, JointMap, ListOf, Number, key
from robodyn_cli.trajectories.base import Problems, SceneNames, joint_problems, led_joints, position_problems
from robodyn_cli.trajectories.formulas import evaluated, texts
from robodyn_cli.trajectories.joint_space import JointSpaceTrajectory
from robodyn_cli.trajectories.motion import with_attitudes


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


def _series(what: str) -> Any:
    return key(
        ListOf(JointMap(Number(angle=True), coordinates="v")),
        default=(),
        unit="rad or m",
        doc=f"Amplitudes of {what}, k = 1, 2, ..., by joint; 0 where a joint is left out.",
    )


@record
class FourierTrajectory(JointSpaceTrajectory):
    """q = offset + sum_k sine_k sin(k w t) + cosine_k cos(k w t) with w = 2 pi / period (Swevers et al. 1997)."""

    type: str = key(Choice(("fourier",)), doc="Kind of trajectory.")
    offset: dict[str, float] = key(
        JointMap(Number(angle=True)), unit="rad or m", doc="Mean position of each joint."
    )
    period: float = key(Number(minimum=0.0, exclusive=True), unit="s", doc="Period of the first harmonic.")
    duration: float = key(Number(minimum=0.0, exclusive=True), unit="s", doc="Length of the motion.")
    sine: tuple[dict[str, float], ...] = _series("sin(k w t)")
    cosine: tuple[dict[str, float], ...] = _series("cos(k w t)")

    knots = ()

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        yield from position_problems(self.offset, scene, ("offset",))
        for name in ("sine", "cosine"):
            for k, amplitudes in enumerate(getattr(self, name)):
                yield from joint_problems(tuple(amplitudes), scene.rates, (name, k), ())
                for joint in amplitudes:
                    if joint in scene.rates and joint not in self.offset:
                        yield (name, k, joint), self._unled(joint, scene)

    def _unled(self, joint: str, scene: SceneNames) -> str:
        if joint.partition(".")[0] in scene.quasi:
            return "an attitude is no sum of angles; it stays as `offset` says, or use type: joint with rpy formulas"
        return f"joint {joint!r} is missing in `offset`; allowed: {', '.join(self.offset)}"

    @property
    def joints(self) -> tuple[str, ...]:
        """The columns of q whose motion it gives."""
        return tuple(self.offset)

    def expressions(self, t: Expr, env: Mapping[str, Any]) -> Mapping[str, Any]:
        w = 2.0 * math.pi / self.period
        found: dict[str, Any] = dict(self.offset)
        for series, wave in ((self.sine, sin), (self.cosine, cos)):
            for k, amplitudes in enumerate(series, start=1):
                for joint, amplitude in amplitudes.items():
                    found[joint] = found[joint] + amplitude * wave(k * w * t)
        return with_attitudes(found)
