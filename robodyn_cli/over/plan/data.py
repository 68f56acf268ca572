"""Which data of the links the equations use: needed but not given, given but without effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import PARAMETER_GROUP, UNKNOWN_GROUP, Model, unknown_among
from robodyn_cli.scene import types as sc

TENSOR = ("xx", "yy", "zz", "xy", "xz", "yz")


def unknown_data(model: Model, outputs: Sequence[Scalar]) -> tuple[list[str], list[str]]:
    """Return the data of the bodies that the scene does not give: those that the outputs need, and the others."""
    unknown = [e.value[0] for e in model.graph.nodes if e.op == "sym" and e.value[1] == UNKNOWN_GROUP]
    needed = unknown_among(outputs)
    return [n for n in unknown if n in needed], [n for n in unknown if n not in needed]


def idle_constants(scene: sc.Scene, outputs: Callable[[Model], Sequence[Scalar]]) -> list[str]:
    """Return given data without effect: made symbols, they do not occur in the finished graph."""
    names = _given(scene)
    model = build_model(scene, list(names))
    used = {e.value[0] for e in free_symbols(outputs(model)) if e.value[1] == PARAMETER_GROUP}
    return [text for path, text in names.items() if path not in used]


def _given(scene: sc.Scene) -> dict[str, str]:
    """Return the paths of the links' data that are given and not zero, with their names in messages."""
    found: dict[str, str] = {}
    for link in scene.robot.links:
        path = f"links.{link.name}"
        if link.mass:
            found[f"{path}.mass"] = f"mass of {link.name}"
        for k, x in enumerate(link.com or ()):
            if x:
                found[f"{path}.com.{k}"] = f"com[{k}] of {link.name}"
        for key in TENSOR:
            if getattr(link.inertia, key):
                found[f"{path}.inertia.{key}"] = f"inertia.{key} of {link.name}"
    return found
