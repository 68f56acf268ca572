"""``simulate`` for Python, with a function as the controller."""

from __future__ import annotations

import dataclasses
from typing import Any

from robodyn_cli.errors import SceneError
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.tools.progress import Progress, no_progress
from robodyn_cli.works import simulate as command


def controlled_by(scene: Scene, function: Any, period: float | None) -> Scene:
    """Return the scene with a function as its controller.

    Raises
    ------
    SceneError : it has a controller of another type, or no period is given or allowed.
    """
    if not callable(function):
        fault = f"the controller is no function (value {function!r})"
        if function is None:
            fault = "'period' goes with a controller"
        raise SceneError(f"{fault}; allowed: simulate(scene, controller=f, period=0.001)", (scene.path,))
    given = scene.control
    if given is not None and given.type != "python":
        raise SceneError(
            f"the scene has a controller of type {given.type!r}; allowed beside a "
            "function: none, or 'python'", (scene.path, "control.type"),
            file=scene.path, key="control.type",
        )  # fmt: skip
    settings = [] if period is None else [f"control.period={float(period)!r}"]
    if given is None:
        settings.append("control.type=python")
    if settings:
        scene = load_scene_text(scene.text, scene.path, settings)
        given = scene.control
    return dataclasses.replace(scene, control=dataclasses.replace(given, function=function))


def simulate(
    scene: Scene,
    progress: Progress = no_progress,
    *,
    controller: Any = None,
    period: float | None = None,
    **options: Any,
) -> Result:
    """Integrate the scene over its duration.

    Parameters
    ----------
    progress : called with the time that has been reached and the last one, while the run goes on.
    controller : a function ``f(t, q, qd)`` that gives the torques (n,) of the driven joints [N m or N] for what is
        measured of all joints at each sample: q (nq,), qd (nv,). Where it has a method ``reset``, that is called before
        each integration; there are two where the error is estimated, and more with extremes.
    period : time between two samples [s], where ``control`` in the scene says none.
    options : those of ``run.simulate.simulate``.

    Returns
    -------
    A Result with the contract's datasets (``docs/hdf5.md``) and its error estimate in the summary.

    Raises
    ------
    RobodynError : with ``result`` holding what was computed until then; NumericalError where the function fails.
    """
    if controller is not None or period is not None:
        scene = controlled_by(scene, controller, period)
    return command.simulate(scene, progress, **options)
