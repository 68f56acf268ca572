"""What a controller asks of the equations of its mechanism and of its model."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from robodyn_cli.algorithms.kinematics import Pose
from robodyn_cli.equations.linear.protocol import Equations as Linearised
from robodyn_cli.expr.graph import Expr
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array, Transform, Values, Vector


class Equations(Linearised, Protocol):
    """The equations of a scene (satisfied by ``Problem``)."""

    scene: Scene
    t: Expr

    @property
    def environment(self) -> dict[str, Any]: ...
    @property
    def gravity(self) -> Vector | None: ...
    @property
    def X(self) -> list[Transform]: ...
    @property
    def pose(self) -> dict[int, Pose]: ...
    @property
    def inverse_dynamics(self) -> Vector: ...
    def newton_euler(self, v: Values, a: Values, gravity: Vector | None) -> Vector: ...
    def passive_forces(self, smooth: bool) -> dict[str, Vector]: ...
    def numbers(self, entries: Any, q: Array) -> Array: ...

    @property
    def of(self) -> Callable[[Scene], Equations]:
        """What gives the equations of another scene."""
        ...
