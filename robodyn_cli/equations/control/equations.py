"""What a controller asks of the equations of its mechanism and of its model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from robodyn_cli.algorithms.kinematics import Pose
from robodyn_cli.equations.constraints import Combination, Constraints, Dependence
from robodyn_cli.equations.linear.residuals import LinearisedEquations
from robodyn_cli.expr.graph import Expr
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Transform, Values, Vector


class ControlledEquations(LinearisedEquations, Protocol):
    """The equations of a scene (satisfied by ``Problem``)."""

    scene: Scene
    t: Expr
    keep_rows: Sequence[int] | None
    dependent: tuple[Dependence, ...]
    braces: Mapping[int, float]

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

    @property
    def elimination_order(self) -> list[int]: ...
    @property
    def combinations(self) -> list[Combination]: ...
    @property
    def independent_rows(self) -> Constraints: ...

    @property
    def of(self) -> Callable[..., ControlledEquations]:
        """What gives the equations of another scene."""
        ...
