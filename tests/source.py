"""The source as data, for tests of its structure: functions, imports of one file by another, cycles of them."""

from __future__ import annotations

import ast
import functools
from collections.abc import Container, Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "robodyn_cli"
BENCHMARKS = ROOT / "benchmarks"

Function = ast.FunctionDef | ast.AsyncFunctionDef


def files(folder: Path = PACKAGE) -> list[Path]:
    return sorted(folder.rglob("*.py"))


@functools.cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def _kinds_of(path: Path) -> dict[type[ast.AST], list[Any]]:
    """Return all nodes of a file by their kind: one walk serves all tests of a process."""
    found: dict[type[ast.AST], list[Any]] = {}
    for node in ast.walk(tree_of(path)):
        found.setdefault(type(node), []).append(node)
    return found


def forget() -> None:
    """Free the trees: each search for garbage would go through their million nodes."""
    _kinds_of.cache_clear()
    tree_of.cache_clear()


def nodes(path: Path, *kinds: type[ast.AST]) -> list[Any]:
    """Return the nodes of a file that are of some kinds."""
    return [node for kind in kinds for node in _kinds_of(path).get(kind, [])]


def name_of(path: Path) -> str:
    """Return a path as it is written in messages: from the root of the repository, with slashes."""
    return path.relative_to(ROOT).as_posix()


def functions(node: ast.AST, prefix: str = "") -> Iterator[tuple[str, Function]]:
    """Yield the functions below a node by their qualified names, methods and inner functions too."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            continue  # holds no statement
        inner = prefix
        if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            inner = f"{prefix}{child.name}."
        if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield f"{prefix}{child.name}", child
        yield from functions(child, inner)


def parameters(function: Function) -> list[str]:
    """Return the names that a caller fills: without ``self`` and ``cls``."""
    a = function.args
    packed = [x for x in (a.vararg, a.kwarg) if x is not None]
    names = [x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs, *packed)]
    return names[1:] if names[:1] in (["self"], ["cls"]) else names


def modules_of(folder: Path, prefix: str) -> dict[str, Path]:
    """Return the files below a folder by the names under which they are imported."""
    found = {}
    for path in files(folder):
        parts = path.relative_to(folder).with_suffix("").parts
        parts = parts[:-1] if parts[-1] == "__init__" else parts
        found[".".join((*([prefix] if prefix else ()), *parts))] = path
    return found


def imported(path: Path, module: str, known: Container[str] = ()) -> set[str]:
    """Return the modules that a file imports anywhere in it, in functions and under TYPE_CHECKING too.

    ``from a import b`` imports a.b where that is a ``known`` module, and else a.
    """
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    found: set[str] = set()
    for node in nodes(path, ast.Import, ast.ImportFrom):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        else:
            above = package.rsplit(".", node.level - 1)[0] if node.level else ""
            source = ".".join(x for x in (above, node.module or "") if x)
            members = {f"{source}.{alias.name}" for alias in node.names}
            found |= {x if x in known else source for x in members}
    return found


def imports(folder: Path, prefix: str) -> dict[str, set[str]]:
    """Return which files below a folder each of them imports, by the names of modules."""
    modules = modules_of(folder, prefix)
    return {name: imported(path, name, modules) & (modules.keys() - {name}) for name, path in modules.items()}


def cycles(graph: Mapping[str, set[str]]) -> list[set[str]]:
    """Return the sets of nodes that reach each other (Tarjan's strongly connected components of two or more)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[set[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph[node]):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            group = set(stack[stack.index(node) :])
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(group)

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found
