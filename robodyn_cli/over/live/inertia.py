"""Whether keys may make bodies that there are none of, and the equations that tell it at the start of a run."""

from __future__ import annotations

from typing import Any

from robodyn_cli.expr.many import Recipe
from robodyn_cli.model.consistency import doubtful_bodies
from robodyn_cli.model.parts import as_link
from robodyn_cli.motion.motion import Motion
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")


def has_doubtful_inertia(scene: Scene, recipe: Recipe) -> bool:
    """Tell whether a body's inertia follows from keys or is doubtful in the scene."""
    bodies = [*scene.robot.links, *map(as_link, scene.payloads)]
    moments = [getattr(body.inertia, name) for body in bodies for name in MOMENTS]
    return bool(doubtful_bodies(scene)) or any(recipe.varies(x) for x in moments if x is not None)


def inertia_equations(motion: Motion, recipe: Recipe) -> dict[str, Any]:
    """Return M and Psi, by name, where a body's inertia follows from keys or is doubtful in the scene; else nothing."""
    problem = motion.problem
    if not doubtful_bodies(motion.scene) and not has_doubtful_inertia(problem.scene, recipe):
        return {}
    found = {"mass": problem.mass_matrix.ravel().tolist()}
    if problem.constraints.rows:
        found["psi"] = problem.psi.ravel().tolist()
    return found


def at_start(motion: Motion) -> tuple[Array, Array]:
    """Return M (1, nv, nv) and Psi (1, m, nv) at the start of the scene."""
    problem, q = motion.problem, motion.assembled.q
    n = problem.model.nv
    M = problem.numbers(problem.mass_matrix, q).reshape(1, n, n)
    return M, problem.numbers(problem.psi, q).reshape(1, -1, n)
