"""The shape of the source: short functions, few parameters, no import cycles, small folders, fenced libraries."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable
from pathlib import Path

import pytest

from robodyn_cli.commands import COMMANDS
from tests.source import (
    BENCHMARKS,
    PACKAGE,
    Function,
    cycles,
    files,
    functions,
    imported,
    imports,
    modules_of,
    name_of,
    nodes,
    parameters,
    tree_of,
)

pytestmark = pytest.mark.usefixtures("source_trees")
LONGEST_FILE = 400  # lines
LONGEST_FUNCTION = 60  # lines
MOST_PARAMETERS = 6
LARGEST_FOLDER = 16  # files beside __init__.py and the members of registries

# what may import a library: packages and modules of robodyn_cli
FENCES = {
    "typer": ("cli",),
    "click": ("cli",),
    "matplotlib": ("report",),
    "PIL": ("report",),
    "av": ("report",),
    "h5py": ("results",),
    "yaml": ("scene",),
    "llvmlite": ("kernels",),
}


def none(found: Iterable[str], rule: str) -> None:
    """Fail with the list of what breaks a rule."""
    offending = sorted(found)
    assert not offending, f"{rule}:\n  " + "\n  ".join(offending)


def named_functions() -> list[tuple[Path, str, Function]]:
    return [(path, name, node) for path in files() for name, node in functions(tree_of(path))]


# -- length and parameters -------------------------------------------------------------------------------------
def declares_command(path: Path, name: str) -> bool:
    """Tell whether a function is the declaration of a command: its signature is the list of what it takes."""
    return path.is_relative_to(PACKAGE / "cli") and name.rpartition(".")[2] == "command"


def only_stores(node: Function) -> bool:
    """Tell whether a function is the constructor of a plain record, which stores each argument as it is."""
    names = set(parameters(node))
    body = [x for x in node.body if not (isinstance(x, ast.Expr) and isinstance(x.value, ast.Constant))]
    return node.name == "__init__" and all(
        isinstance(x, ast.Assign) and isinstance(x.value, ast.Name) and x.value.id in names for x in body
    )


def length(path: Path, name: str, node: Function) -> int:
    """Return the lines of a function, of a declaration those of its body."""
    first = node.body[0].lineno if declares_command(path, name) else node.lineno
    return (node.end_lineno or first) - first + 1


def test_files_stay_short() -> None:
    lines = {name_of(path): len(path.read_text(encoding="utf-8").splitlines()) for path in files()}
    found = {name for name, count in lines.items() if count > LONGEST_FILE}
    none(found, f"files of more than {LONGEST_FILE} lines")


def test_functions_fit_a_screen() -> None:
    found = {
        f"{name_of(p)}: {name}"
        for p, name, node in named_functions()
        if length(p, name, node) > LONGEST_FUNCTION
    }
    none(found, f"functions of more than {LONGEST_FUNCTION} lines")


def test_functions_take_few_parameters() -> None:
    found = {
        f"{name_of(path)}: {name}"
        for path, name, node in named_functions()
        if len(parameters(node)) > MOST_PARAMETERS
        and not declares_command(path, name)
        and not only_stores(node)
    }
    none(found, f"functions with more than {MOST_PARAMETERS} parameters")


def test_what_counts_as_long_and_as_many() -> None:
    text = "class A:\n def __init__(self, a, *b, c, **d):\n  '''Doc.'''\n  self.a = a\n def f(self):\n  def g(x): pass\n"
    found = dict(functions(ast.parse(text)))
    assert list(found) == ["A.__init__", "A.f", "A.f.g"]
    assert parameters(found["A.__init__"]) == ["a", "c", "b", "d"] and only_stores(found["A.__init__"])
    assert length(PACKAGE / "cli" / "x.py", "f", found["A.f"]) == 2 and not only_stores(found["A.f"])
    assert length(PACKAGE / "cli" / "x.py", "command", found["A.__init__"]) == 2


# -- imports ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("folder", [PACKAGE, BENCHMARKS], ids=lambda p: p.name)
def test_no_file_imports_itself_by_way_of_others(folder: Path) -> None:
    """Imports in functions and for type checking count: files that need each other are one file, or cut wrongly."""
    prefix = "robodyn_cli" if folder == PACKAGE else ""
    found = {" <-> ".join(sorted(group)) for group in cycles(imports(folder, prefix))}
    none(found, "import cycles")


def test_cycles_are_found(tmp_path: Path) -> None:
    for name, text in {
        "__init__": "",
        "a": "def f():\n    from p.b import g\n",
        "b": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .c import x\n",
        "c": "from . import a, d\n",
        "d": "import p.e\n",
        "e": "import numpy\n",
    }.items():
        (tmp_path / "p").mkdir(exist_ok=True)
        (tmp_path / "p" / f"{name}.py").write_text(text, encoding="utf-8")
    graph = imports(tmp_path / "p", "p")
    assert graph["p.c"] == {"p.a", "p.d"} and graph["p.d"] == {"p.e"}
    assert cycles(graph) == [{"p.a", "p.b", "p.c"}]


@pytest.mark.parametrize("library", FENCES)
def test_libraries_stay_behind_their_fences(library: str) -> None:
    """Each library is one package's business, so that it can be replaced, and is imported only by runs that need it."""
    users = {
        name
        for name, path in modules_of(PACKAGE, "robodyn_cli").items()
        if library in {x.partition(".")[0] for x in imported(path, name)}
    }
    inside = {name for name in users if name.split(".")[1:2] and name.split(".")[1] in FENCES[library]}
    assert users - inside == set(), f"{library} belongs into robodyn_cli/{' or '.join(FENCES[library])}"


# -- contracts -------------------------------------------------------------------------------------------------
# what may be asked of an object that may not have it; what trajectories, forces, closures and controllers answer stands
# in the bases of their kinds
ASKED_FOR = {
    # of the system, of libraries, and of what users pass
    **dict.fromkeys(("O_BINARY", "O_NOFOLLOW", "O_NONBLOCK"), "flags of opening files, by system"),
    **dict.fromkeys(("fork", "sched_getaffinity", "pthread_kill"), "functions that not every system has"),
    **dict.fromkeys(("encoding", "reconfigure"), "streams that stand for those of the console"),
    "strerror": "errors of the system, and ours",
    "format_message": "errors of the command line's library",
    "CSafeLoader": "a library built without C",
    "__version__": "modules without one",
    "triangleset": "shapes of a library",
    "dtype": "numbers and arrays",
    "reset": "a function of the user's as controller",
    # of classes, and of values of any kind
    "__post_init__": "classes without one",
    "name": "parts of a scene with and without one",
    "kinds": "kinds of a key, one or several",
    "value": "signals: formulas, or records with a unit",
    "unit": "signals: formulas, or records with a unit",
}


def test_nothing_asks_whether_an_object_has_what_its_base_declares() -> None:
    found: dict[str, set[str]] = {}
    for path in files():
        for node in nodes(path, ast.Call):
            asked = isinstance(node.func, ast.Name) and node.func.id in ("getattr", "hasattr")
            if asked and isinstance(node.args[1], ast.Constant):
                found.setdefault(node.args[1].value, set()).add(f"{name_of(path)}:{node.lineno}")
    none(
        {f"{where}: {name}" for name in found.keys() - ASKED_FOR for where in found[name]},
        "asked for by name",
    )
    none(ASKED_FOR.keys() - found, "nobody asks for these any more; this list may only shrink")


# -- folders ---------------------------------------------------------------------------------------------------
def registered() -> set[str]:
    """Return the modules that registries name: by ``module:member``, or by the name of the file alone."""
    found = {f"cli.commands.{name.replace('-', '_')}" for name in COMMANDS}
    for path in files():
        for node in nodes(path, ast.Constant):
            if isinstance(node.value, str):
                place = re.fullmatch(r"([\w.]+):\w+", node.value)
                found |= {place[1]} if place else set()
    return found


def test_folders_stay_small() -> None:
    places = registered()
    counts: dict[str, int] = {}
    for name, path in modules_of(PACKAGE, "robodyn_cli").items():
        member = any(name.endswith(f".{place}") for place in places)
        folder = name_of(path.parent)
        counts[folder] = counts.get(folder, 0) + (path.name != "__init__.py" and not member)
    assert counts["robodyn_cli/joints"] < 5, "members of registries do not count"
    found = {f"{folder}: {count} files" for folder, count in counts.items() if count > LARGEST_FOLDER}
    none(found, f"folders of more than {LARGEST_FOLDER} files that no registry lists")


def test_no_package_is_empty() -> None:
    for path in PACKAGE.rglob("__init__.py"):
        assert any(x != path for x in path.parent.rglob("*.py")), f"{name_of(path.parent)} holds nothing"


# -- names ----------------------------------------------------------------------------------------------------
# classes whose name another class has too; this list only ever shrinks
SHARED_NAMES = {"Joint"}


def test_one_name_of_a_class_means_one_thing() -> None:
    classes = [node.name for path in files() for node in nodes(path, ast.ClassDef)]
    assert {name for name in classes if classes.count(name) > 1} == SHARED_NAMES


# -- doors ----------------------------------------------------------------------------------------------------
def test_scenes_are_made_ready_by_the_doors_alone() -> None:
    """What finds motions before the equations are built, and readies controllers, is imported by the doors only."""
    steps = ("ready.in_time", "ready.controllers")
    users = {
        name
        for name, path in modules_of(PACKAGE, "robodyn_cli").items()
        if any(x.endswith(steps) for x in imported(path, name))
    }
    assert users and all(".ready." in name for name in users), users


# -- one driver ------------------------------------------------------------------------------------------------
def test_runs_build_their_integrator_in_one_place() -> None:
    found = [
        name_of(path)
        for folder in ("ready", "motion", "works", "over")
        for path in files(PACKAGE / folder)
        for node in nodes(path, ast.Call)
        if isinstance(node.func, ast.Name) and node.func.id == "Integrator"
    ]
    assert len(found) == 1, found
