"""What is asked of the equations of a mechanism to linearise them."""

from __future__ import annotations

from typing import Protocol

from robodyn_cli.equations.constraints import Constraints
from robodyn_cli.expr.graph import Expr, Graph
from robodyn_cli.model.model import Model
from robodyn_cli.spatial.algebra import Matrix, Vector


class Equations(Protocol):
    """The equations of a mechanism (satisfied by ``Problem``)."""

    model: Model
    graph: Graph
    q: list[Expr]
    v: list[Expr]
    a: list[Expr]

    @property
    def mass_matrix(self) -> Matrix: ...
    @property
    def bias(self) -> Vector: ...
    @property
    def psi(self) -> Matrix: ...
    @property
    def constraints(self) -> Constraints: ...
