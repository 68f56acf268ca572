"""Checks of the shapes that links are drawn with."""

from __future__ import annotations

from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.robot_parts import Shape
from robodyn_cli.scene.robot_types import Link
from robodyn_cli.scene.text.nodes import Path

KINDS = ("box", "sphere", "cylinder", "outline", "mesh", "obj")


def check_shapes(link: Link, check: Check, path: Path) -> None:
    """Refuse shapes that are none or several, without extent, or whose text is no mesh."""
    for k, shape in enumerate(link.visual):
        with check:
            _check(shape, check, (*path, "visual", k))


def _check(shape: Shape, check: Check, path: Path) -> None:
    given = [kind for kind in KINDS if getattr(shape, kind) is not None]
    if len(given) != 1:
        what = " and ".join(map(repr, given)) or "none of its kinds"
        check.fail(path, f"a shape has {what}; allowed: one of {', '.join(KINDS)}")
    for key in ("box", "cylinder"):
        sizes = getattr(shape, key)
        if sizes is not None and min(sizes) <= 0.0:
            check.fail(
                (*path, key), f"a size is not positive (value {min(sizes):g}); allowed: numbers > 0 [m]"
            )
    if shape.thickness and shape.outline is None:
        check.fail((*path, "thickness"), "is that of an outline; allowed: beside 'outline'")
    if shape.outline is not None:
        from robodyn_cli.scene.mesh.surfaces import outline_problem

        problem = outline_problem(shape.outline)
        if problem:
            check.fail((*path, "outline"), problem)
    if shape.obj:
        from robodyn_cli.scene.mesh.files import MeshError, read_obj

        try:
            read_obj(shape.obj)
        except MeshError as error:
            check.fail((*path, "obj"), f"this is no mesh: {error}; allowed: lines 'v x y z' and 'f i j k'")
