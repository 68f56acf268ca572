"""Scenes: YAML files read, checked and typed. Imported on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robodyn_cli.scene.load import load_scene, load_scene_text
    from robodyn_cli.scene.types import Scene

__all__ = ["Scene", "load_scene", "load_scene_text"]


def __getattr__(name: str) -> Any:
    if name in ("load_scene", "load_scene_text"):
        from robodyn_cli.scene import load

        return getattr(load, name)
    if name == "Scene":
        from robodyn_cli.scene.types import Scene

        return Scene
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
