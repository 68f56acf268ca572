"""Write ``robodyn/__init__.pyi``, the types of the functions of ``robodyn``, from the declarations of the commands.

python docs/make_python_stub.py
"""

from __future__ import annotations

import inspect
from pathlib import Path

from robodyn_cli.cli.keywords import OVERRIDES, RESULTS, SCENES, Keyword, gives_result, keywords, own_keywords
from robodyn_cli.commands import COMMANDS, python_name

STUB = Path(__file__).parents[1] / "robodyn" / "__init__.pyi"
HEAD = '''\
"""The functions of robodyn with their types, written by docs/make_python_stub.py."""

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any, TypeAlias

from robodyn_cli.cli.python import RobodynWarning as RobodynWarning
from robodyn_cli.results.report import Report as Report
from robodyn_cli.errors import CapabilityError as CapabilityError
from robodyn_cli.errors import GeometryError as GeometryError
from robodyn_cli.errors import NumericalError as NumericalError
from robodyn_cli.errors import OutputError as OutputError
from robodyn_cli.errors import ResultFileError as ResultFileError
from robodyn_cli.errors import RobodynError as RobodynError
from robodyn_cli.errors import SceneError as SceneError
from robodyn_cli.errors import SingularConfigurationError as SingularConfigurationError
from robodyn_cli.errors import StrictError as StrictError
from robodyn_cli.given.poses.inverse_kinematics import InverseKinematics as InverseKinematics
from robodyn_cli.over.batch.stored import read_result as read_result
from robodyn_cli.over.batch.stored import read_results as read_results
from robodyn_cli.over.many.mechanism import Mechanism as Mechanism
from robodyn_cli.report import draw_all as draw_all
from robodyn_cli.results.hdf5.writer import write as _write
from robodyn_cli.results.result import Result as Result
from robodyn_cli.scene.load import load_scene as load_scene
from robodyn_cli.scene.load import load_scene_text as load_scene_text
from robodyn_cli.scene.types import Scene as Scene
from robodyn_cli.torques.dynamics import ForwardDynamics as ForwardDynamics
from robodyn_cli.torques.dynamics import InverseDynamics as InverseDynamics

__version__: str
write_result = _write

_Path: TypeAlias = str | PathLike[str]
_Scene: TypeAlias = _Path | Mapping[str, Any] | Scene
_Result: TypeAlias = _Path | Result
_Overrides: TypeAlias = Mapping[str, Any] | Sequence[str] | str
_Entries: TypeAlias = Mapping[str, Any] | Sequence[str] | str
_Words: TypeAlias = Sequence[str | float] | str | float
_Progress: TypeAlias = Callable[[float, float], None]
'''
ANY = "Any"


def main() -> None:
    """Write the stub."""
    STUB.write_text(stub(), encoding="utf-8")


def stub() -> str:
    """Return the text of the stub."""
    return "\n".join([HEAD, *map(declared, COMMANDS)])


def declared(command: str) -> str:
    """Return the declaration of the function of a command."""
    arguments = [
        f"    {one.name}: {hint(one)}{default(one)}," for one in keywords(command) if one.is_argument
    ]
    options = [
        f"    {one.name}: {hint(one)}{default(one)}," for one in keywords(command) if not one.is_argument
    ]
    options += [f"    {p.name}: {ANY} = {p.default!r}," for p in own_keywords(command)]
    options.append("    progress: _Progress | None = None,")
    found = "Result" if gives_result(command) else "Report"
    lines = [f"def {python_name(command)}(", *arguments, "    *,", *options, f") -> {found}:"]
    return "\n".join([*lines, f'    """{COMMANDS[command].help}"""', ""])


def hint(one: Keyword) -> str:
    """Return the type of a keyword."""
    text = of_source(one) if one.is_argument else ""
    if one.parameter == OVERRIDES:
        text = "_Overrides"
    elif not text and one.many:
        text = "_Entries" if "=" in one.form else "_Words"
    elif not text and one.kind is Path:
        text = "_Path"
    elif not text and one.kind in (bool, int):
        text = one.kind.__name__
    elif not text and one.kind is float:
        text = "float" if one.info.parser is None else "float | str"
    elif not text:
        text = "_Words" if "," in one.form else "str"
    return f"{text} | None" if one.optional or one.is_file or one.default is None else text


def of_source(one: Keyword) -> str:
    """Return the type of a scene or a result; nothing of other arguments."""
    names = [name for name, of in (("_Scene", SCENES), ("_Result", RESULTS)) if one.parameter in of]
    text = " | ".join(names)
    return f"{text} | Sequence[{text}]" if one.many and names else text


def default(one: Keyword) -> str:
    """Return the default of a keyword."""
    if one.is_required and not one.is_file:
        return ""
    value = None if one.default is inspect.Parameter.empty else one.default
    return f" = {str(value)!r}" if isinstance(value, Path) else f" = {value!r}"


if __name__ == "__main__":
    main()
