"""A scene's equations with changes: what decides them, ready to be changed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import Any

from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.equations.dependence import Dependence
from robodyn_cli.equations.problem import Constraints, Problem
from robodyn_cli.expr.graph import Graph, is_nonzero
from robodyn_cli.loops.base import Row
from robodyn_cli.model.model import PARAMETER_GROUP, Body, Model
from robodyn_cli.record import record
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import Matrix, Vector, matrix, vector, zeros


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
    """What decides the equations, ready to be changed.

    velocity_terms, accelerations : whether rigid bodies feel qd and qdd. drives : a symbol as torque on each
    joint without one. driven_joint : whether the first joint's motion is prescribed, as symbols. rows : names
    of the constraint rows to keep (all by default). dependent : rows that are combined. still : joints that are
    kept at zero.
    """

    scene: sc.Scene
    model: Model
    velocity_terms: bool = True
    accelerations: bool = True
    drives: bool = False
    driven_joint: bool = False
    rows: tuple[str, ...] | None = None
    dependent: tuple[Dependence, ...] = ()
    still: tuple[str, ...] = ()

    def with_scene(self, **changes: Any) -> Variant:
        return dataclasses.replace(self, scene=dataclasses.replace(self.scene, **changes))

    def with_model(self, **changes: Any) -> Variant:
        return dataclasses.replace(self, model=dataclasses.replace(self.model, **changes))

    def with_bodies(self, change: Callable[[Body], Body]) -> Variant:
        return self.with_model(bodies=tuple(change(b) for b in self.model.bodies))

    def problem(self) -> Problem:
        """Return the equations of this variant."""
        return VariantProblem(self)


class VariantProblem(Problem):
    """The equations with a variant's changes; for the scene as it is, exactly those of ``Problem``."""

    def __init__(self, variant: Variant) -> None:
        super().__init__(variant.scene, model=variant.model, dependent=variant.dependent)
        self.variant = variant
        for name in variant.still:
            body = self.model.body_of(name)
            nothing: Any = 0.0
            self.q[body.q] = self.v[body.v] = self.a[body.v] = nothing

    def _rates(self) -> Any:
        return self.v if self.variant.velocity_terms else zeros(self.model.nv)

    @cached_property
    def bias(self) -> Vector:
        return rnea(self.model, self.q, self._rates(), zeros(self.model.nv), self.gravity, self.X)

    @cached_property
    def inverse_dynamics(self) -> Vector:
        a: Any = self.a if self.variant.accelerations else zeros(self.model.nv)
        return rnea(self.model, self.q, self._rates(), a, self.gravity, self.X)

    @cached_property
    def actuator_torques(self) -> Vector:
        tau = super().actuator_torques
        symbols = Symbols(self.graph)
        if self.variant.drives:
            for k in range(self.model.nv):
                if not is_nonzero(tau[k]):
                    tau[k] = symbols.one()
        return tau

    @cached_property
    def constraints(self) -> Constraints:
        found = super().constraints
        if self.variant.rows is not None:
            found = found.only([i for i, r in enumerate(found.rows) if r.name in self.variant.rows])
        if self.variant.driven_joint:
            body = self.model.bodies[0]
            psi = zeros(self.model.nv)
            psi[body.v] = 1.0
            x, rate, second = Symbols(self.graph).vector()
            row = Row("prescribed", self.q[body.q] - x, psi, -second, -rate)
            last = len(found.rows)
            found = Constraints((*found.rows, row), found.dropped, (*found.prescribed, last))
        return found
