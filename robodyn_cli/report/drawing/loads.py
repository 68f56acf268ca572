"""Forces as arrows: those that act from outside, and recorded reactions of joints and closures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.model.placement import joint_axes
from robodyn_cli.record import record
from robodyn_cli.report.drawing.expressions import Expressions
from robodyn_cli.report.drawing.record import Arrow
from robodyn_cli.results.result import Result, Variable
from robodyn_cli.spatial.algebra import Array, Matrix, zeros

COMPONENTS = ("fx", "fy", "fz")


@record
class Load:
    """A force at a vertex.

    entry : its number among the forces of ``Expressions``; or components : (T, 3) along axes. axes : numbers of three
    directions of ``Expressions``; None for those of the world.
    """

    name: str
    vertex: int
    entry: int | None = None
    components: Array | None = None
    axes: tuple[int, ...] | None = None


def loads(result: Result, expressions: Expressions, samples: Array | None) -> list[Load]:
    """Return the forces of a scene at some samples of its result; without samples only those from outside."""
    found = outside(expressions)
    if samples is not None:
        found += reactions(result, expressions, samples)
    return found


def outside(expressions: Expressions) -> list[Load]:
    """Return the forces that act from outside the mechanism, as expressions."""
    problem, found = expressions.problem, []
    for force, effect in zip(problem.model.forces, problem.elements.effects):
        if force.element.term != "external":
            continue
        end = force.ends[0]
        vertex = expressions.vertex(end.body, end.p)
        for action in effect.actions:
            f = action.wrench.f
            world = expressions.rotated(end.body, end.R @ f) if action.local else problem.model.base.E.T @ f
            entry = expressions.force(world)
            if vertex is not None and entry is not None:
                found.append(Load(force.name, vertex, entry))
    return found


def reactions(result: Result, expressions: Expressions, samples: Array) -> list[Load]:
    """Return the recorded forces in joints (of the parent on the link) and closures (on the first link)."""
    problem = expressions.problem
    in_world = problem.scene.outputs.reaction_axes == "world"
    joints = {joint.name: joint for joint in problem.scene.robot.joints}
    places: list[tuple[str, int, Array, Matrix]] = []
    for k, body in enumerate(problem.model.bodies):
        places.append((f"reactions/{body.joint_name}", k, zeros(3), joint_axes(joints[body.joint_name])))
    for loop in problem.model.loops:
        places.append((f"loop_reactions/{loop.name}", loop.first.body, loop.first.p, loop.first.R))
    found = []
    for path, body_index, p, R in places:
        vertex = expressions.vertex(body_index, p)
        if path not in result.variables or vertex is None:
            continue
        axes = None
        if not in_world:
            numbers = [expressions.axis(body_index, R[:, k]) for k in range(3)]
            axes = tuple(number for number in numbers if number is not None)
        components = _forces(result.variables[path], samples)
        found.append(Load(path.partition("/")[2], vertex, None, components, axes))
    return found


def _forces(wrench: Variable, samples: Array) -> Array:
    """Return the components (T, 3) of a recorded force; those that the scene's data leave open are 0."""
    columns = [wrench.data[samples, wrench.names.index(c)] if c in wrench.names else None for c in COMPONENTS]
    return np.stack([np.zeros(len(samples)) if c is None else c for c in columns], axis=1)


def arrows(found: Sequence[Load], axes: Array, forces: Array) -> tuple[Arrow, ...]:
    """Return the arrows from evaluated axes (T, M, 3) and forces (T, F, 3); those that are never there left out."""
    drawn = []
    for load in found:
        force = _world(load, axes, forces)
        if np.any(np.nan_to_num(force) != 0.0):
            drawn.append(Arrow(load.name, load.vertex, force, load.entry is None))
    return tuple(drawn)


def _world(load: Load, axes: Array, forces: Array) -> Array:
    """Return a force (T, 3) in the world."""
    if load.components is None:
        force: Array = forces[:, load.entry]
        return force
    if load.axes is None:
        return load.components
    turned: Array = np.einsum("tk,tkx->tx", load.components, axes[:, list(load.axes)])
    return turned
