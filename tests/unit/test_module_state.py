"""What outlives every object, names of modules, of the interpreter and of libraries, is changed by a few functions alone."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator

import pytest

from tests.source import PACKAGE, Function, files, functions, tree_of

pytestmark = pytest.mark.usefixtures("source_trees")
# Beside each stands why threads do not disturb each other. The list may only shrink: state belongs to objects.
WRITERS = {
    "cli/interrupts.py: _raise": "a signal handler: runs in the main thread",
    "cli/interrupts.py: end": "main thread of the command line",
    "cli/interrupts.py: leave_at_once": "main thread of the command line",
    "cli/interrupts.py: tidy_up_first": "main thread of the command line",
    "cli/offers.py: words_whole": "main thread of the command line",
    "cli/progress_line.py: ProgressLine.clear": "behind a lock",
    "cli/progress_line.py: ProgressLine.write": "behind a lock",
    "cli/main.py: prepare_process": "main thread, before there are others",
    "expr/fixed.py: _made": "behind a lock",
    "expr/fixed.py: witnessed": "a context variable",
    "joints/base.py: Joint.__init_subclass__": "while a module is imported, once",
    "kernels/compiler.py: compile_module": "`setdefault`: all threads get the module that is kept",
    "kernels/cache.py: CompileReport.spend": "a context variable",
    "record.py: _equip": "while a module is imported, once",
    "report/canvas.py: print_figure": "NOT SAFE, as matplotlib: docs/python.md",
    "report/format.py: formatted": "a context variable",
    "report/style.py: styled": "NOT SAFE, as matplotlib: docs/python.md",
    "results/atomic.py: uninterrupted": "in the main thread alone",
    "foreign.py: survive": "the child only asks a library, h5py holds its own lock across a fork",
    "scene/mjcf/compiled.py: _Compiler.telling": "behind a lock",
    "tools/progress.py: Stopwatch.listen": "main thread of the command line",
    "over/study/cluster.py: _code_of": "behind a lock",
    "threads.py: without_main": "behind a lock, while processes begin",
    "over/study/runs.py: _serve": "of a worker process, before its first run",
    "over/study/design.py: Sobol.rows": "main thread of the command `sweep`",
}
# Functions that keep what they have returned: pure, so that it does not matter which thread's result is kept.
KEEPERS = {
    "cli/python.py: function",
    "integrators/methods/collocation_tables.py: dense_table",
    "integrators/methods/collocation_tables.py: gauss_table",
    "integrators/methods/collocation_tables.py: radau_table",
    "integrators/methods/stability_region.py: limits",
    "kernels/cache.py: code_digest",
    "kernels/compiler.py: _llvm",
    "kernels/compiler.py: code_version",
    "kernels/compiler.py: machine",
    "kernels/rolled/recursion.py: make_recursion",
    "report/drawing/build.py: _model_of",
    "report/drawing/build.py: _stored_scene",
    "report/drawing/strokes.py: _lit",
    "report/figures.py: _columns",
    "results/summary.py: cpu_name",
    "expr/units.py: of",
    "expr/units.py: table",
    "fastest/profile.py: _passes",
    "over/sensitivity/motion/variational.py: integrals",
    "algorithms/polynomials.py: to_powers",
    "solve/quadrature.py: _weights",
    "summaries/keys.py: _headlines",
    "summaries/keys.py: fields_at",
    "summaries/keys.py: leaf_of",
    "summaries/keys.py: leaves_of",
    "torques/checks.py: _hermite",
}
# functions of libraries that change the process
PROCESS = frozenset({
    "np.seterr", "os.chdir", "os.fork", "os.umask", "signal.signal", "sys.setrecursionlimit",
    "sys.setswitchinterval", "warnings.catch_warnings", "warnings.filterwarnings", "warnings.simplefilter",
})  # fmt: skip
CHANGES = frozenset({
    "add", "append", "appendleft", "clear", "discard", "extend", "insert", "pop", "popitem", "popleft", "remove",
    "reset", "reverse", "set", "setdefault", "sort", "update",
})  # fmt: skip


def bound(body: Iterable[ast.stmt]) -> tuple[set[str], set[str]]:
    """Return the names that a module binds to modules, and to other objects."""
    modules: set[str] = set()
    others: set[str] = set()
    for node in body:
        if isinstance(node, ast.Import):
            modules |= {alias.asname or alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            others |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            others |= {x.id for target in targets for x in ast.walk(target) if isinstance(x, ast.Name)}
        elif isinstance(node, ast.ClassDef):
            others.add(node.name)
        elif isinstance(node, (ast.If, ast.Try)):
            inner = bound([*node.body, *node.orelse])
            modules, others = modules | inner[0], others | inner[1]
    return modules, others


def root(node: ast.AST) -> str:
    """Return the name at the beginning of a.b[c].d; nothing where there is none."""
    while isinstance(node, (ast.Attribute, ast.Subscript)):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


def own_nodes(function: Function) -> Iterator[ast.AST]:
    """Yield the nodes of a function without those of functions inside of it."""
    pending: list[ast.AST] = [*function.body]
    while pending:
        node = pending.pop()
        yield node
        if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            pending += ast.iter_child_nodes(node)


def writes(function: Function, modules: set[str], others: set[str]) -> bool:
    """Tell whether a function changes an object that a name of its module leads to, or binds such a name."""
    nodes = list(own_nodes(function))
    local = {x.id for x in nodes if isinstance(x, ast.Name) and isinstance(x.ctx, ast.Store)}
    local |= {x.arg for x in ast.walk(function.args) if isinstance(x, ast.arg)} - {"cls"}
    everywhere = (modules | others | {"cls"}) - local
    for node in nodes:
        if isinstance(node, ast.Global):
            return True
        stored = isinstance(node, (ast.Attribute, ast.Subscript)) and not isinstance(node.ctx, ast.Load)
        if stored and root(node) in everywhere:
            return True
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        held, name = node.func.value, node.func.attr
        function_of_module = isinstance(held, ast.Name) and root(held) in modules  # np.insert changes nothing
        if (
            f"{root(held)}.{name}" in PROCESS
            if function_of_module
            else name in CHANGES and root(held) in everywhere
        ):
            return True
    return False


def keeps(function: Function) -> bool:
    """Tell whether functools keeps what a function returns."""
    decorators = {ast.unparse(x).partition("(")[0] for x in function.decorator_list}
    return bool({name.rpartition(".")[2] for name in decorators} & {"cache", "lru_cache"})


def test_state_of_modules_is_known() -> None:
    named = [
        (f"{path.relative_to(PACKAGE).as_posix()}: {name}", function, names)
        for path in files()
        for names in [bound(tree_of(path).body)]
        for name, function in functions(tree_of(path))
    ]
    assert {name for name, function, _ in named if keeps(function)} == KEEPERS
    assert {name for name, function, names in named if writes(function, *names)} == set(WRITERS)


@pytest.mark.parametrize(
    "body",
    [
        "global x; x = 1", "table['a'] = 1", "del table['a']", "table.setdefault('a', 1)", "REPORT.now = ''",
        "os.environ['a'] = 'b'", "os.environ.pop('a')", "signal.signal(2, None)", "Kind.units = ()",
    ],
)  # fmt: skip
def test_what_counts_as_a_change_of_a_module(body: str) -> None:
    head = "import os, signal\nfrom a import REPORT\ntable = {}\nclass Kind: pass\n"
    for text, changes in (
        (body, True),
        (f"os = table = REPORT = signals = Kind = {{}}; {body}", "global" in body),
    ):
        tree = ast.parse(f"{head}def f():\n    {text}")
        ((_, function),) = functions(tree)
        assert writes(function, *bound(tree.body)) == (changes or body.startswith("signal"))
