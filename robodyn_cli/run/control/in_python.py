"""A scene with a controller that is a function in Python."""

from __future__ import annotations

import dataclasses
from typing import Any

from robodyn_cli.errors import SceneError
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.scene.types import Scene


def controlled_by(scene: Scene, function: Any, period: float | None) -> Scene:
    """Return the scene with a function as its controller.

    Raises
    ------
    SceneError : it has a controller of another type, or no period is given or allowed.
    """
    if not callable(function):
        raise SceneError(
            f"{scene.path}: 'period' goes with a controller: simulate(scene, controller=f, period=0.001)"
        )
    given = scene.control
    if given is not None and given.type != "python":
        raise SceneError(
            f"{scene.path}: control.type: the scene has a controller of type {given.type!r}; allowed beside a "
            "function: none, or 'python'",
            file=scene.path, key="control.type",
        )  # fmt: skip
    settings = [] if period is None else [f"control.period={float(period)!r}"]
    if given is None:
        settings.append("control.type=python")
    if settings:
        checked = load_scene_text(scene.text, scene.path, settings)
        given = checked.control
    return dataclasses.replace(scene, control=dataclasses.replace(given, function=function))
