"""What a page draws of a mechanism: where all of it is, as expressions."""

from __future__ import annotations

from typing import Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.scene.types import Scene


def picture_of(scene: Scene, problem: Problem) -> dict[str, list[Any]]:
    """Return vertices and axes as the drawing numbers them, and named points; nothing where they depend on more than
    positions and rates."""
    from robodyn_cli.report.drawing.build import drawn_things

    entries = drawn_things(scene, problem)[0].entries
    outputs = {kind: [x for entry in entries[kind] for x in entry] for kind in ("vertices", "axes")}
    outputs["points"] = [x for frame in problem.model.points.values() for x in problem.world_point(frame)]
    unknown = {symbol.value[1] for part in outputs.values() for symbol in free_symbols(part)} - {"q", "v"}
    return {} if unknown else outputs
