"""robodyn: inverse dynamics and simulation of robots and closed-loop mechanisms described in YAML, as functions.

Each command is a function with the words of its command line, imported when it is used:

>>> import robodyn
>>> result = robodyn.simulate("configs/double_pendulum.yaml", set={"simulate.duration": 5})
>>> result["q"][-1], result.summary["error_estimate"]["state_max"]
"""

from __future__ import annotations

import importlib
from typing import Any

from robodyn_cli.commands import COMMANDS, python_name
from robodyn_cli.version import __version__

_FUNCTIONS = {python_name(command) for command in COMMANDS}
_HOME = {
    "load_scene": "scene.load",
    "load_scene_text": "scene.load",
    "read_result": "over.batch.stored",
    "read_results": "over.batch.stored",
    "write_result": "results.hdf5",
    "draw_all": "report",
    "Mechanism": "over.many.mechanism",
    "InverseDynamics": "torques.dynamics",
    "ForwardDynamics": "torques.dynamics",
    "InverseKinematics": "given.poses.inverse_kinematics",
    "Result": "results.result",
    "Scene": "scene.types",
    "Report": "results.report",
    "RobodynWarning": "cli.python",
    "RobodynError": "errors",
    "SceneError": "errors",
    "CapabilityError": "errors",
    "GeometryError": "errors",
    "NumericalError": "errors",
    "SingularConfigurationError": "errors",
    "StrictError": "errors",
    "OutputError": "errors",
    "ResultFileError": "errors",
}
_RENAMED = {"write_result": "write"}

__all__ = ["__version__", *sorted(_FUNCTIONS), *_HOME]


def __getattr__(name: str) -> Any:
    if name in _FUNCTIONS:
        from robodyn_cli.cli.python import function

        value: Any = function(name)
    elif name in _HOME:
        home = importlib.import_module(f"robodyn_cli.{_HOME[name]}")
        value = getattr(home, _RENAMED.get(name, name))
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
