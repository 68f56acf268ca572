"""A scene's equations with changes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import Any

from robodyn_cli.equations.braces import Braces
from robodyn_cli.equations.constraints import Constraints
from robodyn_cli.equations.dependence import Dependence
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Graph
from robodyn_cli.model.model import PARAMETER_GROUP, Body, Model
from robodyn_cli.record import record
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import Matrix, Values, Vector, matrix, vector, zeros


class Symbols:
    """Parameters without a value, each a new one."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph

    def one(self) -> Any:
        number = len(self.graph.nodes)
        return self.graph.symbol(f"general {number}", PARAMETER_GROUP, number)

    def vector(self) -> Vector:
        return vector([self.one() for _ in range(3)])

    def matrix(self) -> Matrix:
        return matrix([list(self.vector()) for _ in range(3)])

    def symmetric(self) -> Matrix:
        xx, yy, zz, xy, xz, yz = (self.one() for _ in range(6))
        return matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@record
class Variant:
    """Everything that decides the equations, ready to be changed.

    velocity_terms, accelerations : whether the rigid bodies' equations contain qd and qdd. rows : names of the
    constraint rows to keep (all by default). dependent : rows that are combined.
    braces : inertias that prescribed joints need beside their own.
    """

    scene: sc.Scene
    model: Model
    velocity_terms: bool = True
    accelerations: bool = True
    rows: tuple[str, ...] | None = None
    dependent: tuple[Dependence, ...] = ()
    braces: Braces | None = None

    def with_scene(self, **changes: Any) -> Variant:
        return dataclasses.replace(self, scene=dataclasses.replace(self.scene, **changes))

    def with_model(self, **changes: Any) -> Variant:
        return dataclasses.replace(self, model=dataclasses.replace(self.model, **changes))

    def with_bodies(self, **fields: Callable[[Body], Any]) -> Variant:
        """Return the variant with fields of every body, each as a function of the body."""
        bodies = (
            dataclasses.replace(b, **{name: value(b) for name, value in fields.items()})
            for b in self.model.bodies
        )
        return self.with_model(bodies=tuple(bodies))

    @property
    def symbols(self) -> Symbols:
        return Symbols(self.model.graph)

    def problem(self) -> Problem:
        """Return the equations of this variant."""
        return VariantProblem(self)


class VariantProblem(Problem):
    """The equations with a variant's changes; for the scene as it is, exactly those of ``Problem``."""

    def __init__(self, variant: Variant) -> None:
        super().__init__(
            variant.scene, model=variant.model, dependent=variant.dependent, braces=variant.braces
        )
        self.variant = variant

    def newton_euler(self, v: Values, a: Values, gravity: Vector | None) -> Vector:
        rest = zeros(self.model.nv)
        v = v if self.variant.velocity_terms else rest
        return super().newton_euler(v, a if self.variant.accelerations else rest, gravity)

    @cached_property
    def constraints(self) -> Constraints:
        found, rows = super().constraints, self.variant.rows
        if rows is None:
            return found
        return found.only([i for i, name in enumerate(found.names) if name in rows])
