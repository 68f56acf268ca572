"""robodyn: inverse dynamics and simulation of robots and closed-loop mechanisms described in YAML.

The package ``robodyn`` has each command as a function with the words of its command line. Here are functions of loaded
scenes, which they call, imported when used:

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
    "inverse": "robodyn_cli.works.inverse",
    "simulate": "robodyn_cli.works.in_python",
    "deploy": "robodyn_cli.works.deploy.deploy",
    "kinematics": "robodyn_cli.works.kinematics",
    "statics": "robodyn_cli.works.statics",
    "assemble": "robodyn_cli.works.assemble",
    "linearise": "robodyn_cli.works.linearise.linearise",
    "reach": "robodyn_cli.works.reach",
    "InverseKinematics": "robodyn_cli.given.poses.inverse_kinematics",
    "sensitivity": "robodyn_cli.over.sensitivity.report",
    "optimise": "robodyn_cli.over.search.report",
    "plan": "robodyn_cli.over.plan.plan",
    "Mechanism": "robodyn_cli.over.many.mechanism",
    "InverseDynamics": "robodyn_cli.torques.dynamics",
    "ForwardDynamics": "robodyn_cli.torques.dynamics",
    "Result": "robodyn_cli.results.result",
    "read_result": "robodyn_cli.over.batch.stored",
    "write_result": "robodyn_cli.results.hdf5",
    "draw_all": "robodyn_cli.report",
    "RobodynError": "robodyn_cli.errors",
    "SceneError": "robodyn_cli.errors",
    "GeometryError": "robodyn_cli.errors",
    "NumericalError": "robodyn_cli.errors",
}
_RENAMED = {"write_result": "write"}

__all__ = ["__version__", *_HOME]

if TYPE_CHECKING:  # "as" makes a name part of the API for type checkers
    from robodyn_cli.errors import GeometryError as GeometryError
    from robodyn_cli.errors import NumericalError as NumericalError
    from robodyn_cli.errors import RobodynError as RobodynError
    from robodyn_cli.errors import SceneError as SceneError
    from robodyn_cli.given.poses.inverse_kinematics import InverseKinematics as InverseKinematics
    from robodyn_cli.over.batch.stored import read_result as read_result
    from robodyn_cli.over.many.mechanism import Mechanism as Mechanism
    from robodyn_cli.over.plan.plan import plan as plan
    from robodyn_cli.over.search.report import optimise as optimise
    from robodyn_cli.over.sensitivity.report import sensitivity as sensitivity
    from robodyn_cli.report import draw_all as draw_all
    from robodyn_cli.results import hdf5
    from robodyn_cli.results.result import Result as Result
    from robodyn_cli.scene.load import load_scene as load_scene
    from robodyn_cli.scene.load import load_scene_text as load_scene_text
    from robodyn_cli.torques.dynamics import ForwardDynamics as ForwardDynamics
    from robodyn_cli.torques.dynamics import InverseDynamics as InverseDynamics
    from robodyn_cli.works.assemble import assemble as assemble
    from robodyn_cli.works.deploy.deploy import deploy as deploy
    from robodyn_cli.works.in_python import simulate as simulate
    from robodyn_cli.works.inverse import inverse as inverse
    from robodyn_cli.works.kinematics import kinematics as kinematics
    from robodyn_cli.works.linearise.linearise import linearise as linearise
    from robodyn_cli.works.reach import reach as reach
    from robodyn_cli.works.statics import statics as statics

    write_result = hdf5.write


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(home), _RENAMED.get(name, name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
