"""robodyn: inverse dynamics and simulation of robots and closed-loop mechanisms described in YAML.

The public API, imported when used:

>>> from robodyn_cli import load_scene, simulate
>>> result = simulate(load_scene("configs/double_pendulum.yaml"))
>>> result["q"][-1], result.summary["error_estimate"]["state_max"]
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from robodyn_cli.version import __version__


_HOME = {
    "load_scene": "robodyn_cli.scene.load",
    "load_scene_text": "robodyn_cli.scene.load",
    "inverse": "robodyn_cli.run.inverse",
    "simulate": "robodyn_cli.run.simulate",
    "deploy": "robodyn_cli.run.deploy",
    "plan": "robodyn_cli.run.plan",
    "InverseDynamics": "robodyn_cli.run.dynamics",
    "ForwardDynamics": "robodyn_cli.run.dynamics",
    "Result": "robodyn_cli.results.result",
    "read_result": "robodyn_cli.results.hdf5",
    "write_result": "robodyn_cli.results.hdf5",
    "draw_all": "robodyn_cli.report",
    "RobodynError": "robodyn_cli.errors",
    "SceneError": "robodyn_cli.errors",
    "GeometryError": "robodyn_cli.errors",
    "NumericalError": "robodyn_cli.errors",
}
_RENAMED = {"read_result": "read", "write_result": "write"}

__all__ = ["__version__", *_HOME]

if TYPE_CHECKING:
    from robodyn_cli.errors import GeometryError, NumericalError, RobodynError, SceneError
    from robodyn_cli.report import draw_all
    from robodyn_cli.results.hdf5 import read as read_result
    from robodyn_cli.results.hdf5 import write as write_result
    from robodyn_cli.results.result import Result
    from robodyn_cli.run.deploy import deploy
    from robodyn_cli.run.dynamics import ForwardDynamics, InverseDynamics
    from robodyn_cli.run.inverse import inverse
    from robodyn_cli.run.plan import plan
    from robodyn_cli.run.simulate import simulate
    from robodyn_cli.scene.load import load_scene, load_scene_text


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(home), _RENAMED.get(name, name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
