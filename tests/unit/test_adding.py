"""The pages in docs/adding, followed to the letter in a copy of the tree.

A block below a paragraph with "Write `PATH`" becomes that file; a diff below one with "In `PATH`" is applied (each added
line goes below the last line of context, which must stand there); a block of shell commands is run.

All pages are followed in one copy, one after another. A command is a fork of one process that has loaded the libraries,
and nothing of ours, so that each sees the files as they are when it begins.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "adding").glob("*.md"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"(?:Write|[Ii]n)\b[^`]*`([\w/.]+\.\w+)`")  # the paragraph above a block names its file
TREE = ("robodyn", "robodyn_cli", "tests", "docs", "configs")


def steps(page: str) -> Iterator[tuple[str, str, str]]:
    """Yield language, path and content of the blocks of a page, in order; a diff may hold marks of blocks itself."""
    for match in BLOCK.finditer(page):
        before = page[: match.start()].rstrip().rpartition("\n\n")[2]
        found = FILE.search(before)
        yield match.group(1), found.group(1) if found else "", match.group(2)


def apply(text: str, diff: str, where: str) -> str:
    """Return the text with the added lines below the lines of context."""
    lines, position = text.splitlines(), 0
    for line in diff.splitlines():
        if line.startswith("+"):
            lines.insert(position, line[1:])
            position += 1
            continue
        assert line.startswith(" "), f"{where}: {line!r} is neither context nor added"
        places = [k for k, old in enumerate(lines) if old == line[1:] and k >= position]
        assert places, f"{where} has no line {line[1:]!r} (any more): bring the page up to date"
        position = places[0] + 1
    return "\n".join(lines) + "\n"


# reads commands, each a list of words on a line, and answers with the exit code and what the command has printed
SERVER = """
import gc, importlib, json, os, runpy, sys, tempfile
for name in sys.argv[1:]:
    importlib.import_module(name)
gc.freeze()
for line in sys.stdin:
    words = json.loads(line)
    with tempfile.TemporaryFile() as printed:
        child = os.fork()
        if child == 0:
            code = 1
            try:
                for stream in (1, 2):
                    os.dup2(printed.fileno(), stream)
                module, sys.argv = words[0] == "-m", words[words[0] == "-m":]
                run = runpy.run_module if module else runpy.run_path
                run(sys.argv[0], run_name="__main__", **({"alter_sys": True} if module else {}))
                code = 0
            except SystemExit as end:
                code = int(end.code or 0)
            except BaseException:
                import traceback
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        printed.seek(0)
        print(json.dumps([code, printed.read().decode(errors="replace")]), flush=True)
"""
LIBRARIES = (
    "typer", "yaml", "numpy", "scipy.linalg", "scipy.integrate", "scipy.optimize", "h5py", "llvmlite.binding",
    "matplotlib.figure", "matplotlib.backends.backend_agg", "pytest", "_pytest.assertion.rewrite", "hypothesis",
)  # fmt: skip
Run = Callable[[str], tuple[int, str]]


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the tree."""
    tree = tmp_path_factory.mktemp("tree")
    for name in TREE:
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("*.png"))
    for file in (*ROOT.glob("*.md"), ROOT / "pyproject.toml"):
        shutil.copy(file, tree)
    return tree


@pytest.fixture(scope="module")
def run(tree: Path) -> Iterator[Run]:
    """Return what runs a line of shell in the tree, and returns its exit code and what it has printed."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    server = subprocess.Popen(
        [sys.executable, "-c", SERVER, *LIBRARIES],
        cwd=tree, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert server.stdin is not None and server.stdout is not None

    def answer(line: str) -> tuple[int, str]:
        words = shlex.split(line)
        words[:1] = {"robodyn": ["-m", "robodyn_cli"], "python": []}[words[0]]
        server.stdin.write(json.dumps(words) + "\n")
        server.stdin.flush()
        code, printed = json.loads(server.stdout.readline())
        return code, printed

    yield answer
    server.stdin.close()
    assert server.wait(60) == 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="commands are forks of one process")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_page_works(page: Path, tree: Path, run: Run) -> None:
    done, written = set(), []
    for language, path, content in steps(page.read_text("utf-8")):
        done.add(language)
        target = tree / path
        if language == "sh":
            for line in content.splitlines():
                code, printed = run(line)
                assert code == 0, f"{line}\n{printed[-8000:]}"
        elif language == "diff":
            target.write_text(apply(target.read_text("utf-8"), content, path), encoding="utf-8")
        else:
            assert not target.exists(), f"{path} is there already"
            target.write_text(content, encoding="utf-8")
            written += [path] if language == "python" else []
    assert {"sh", "diff", "python"} <= done
    for words in (("check",), ("format", "--diff")):  # new code is in our style, as all code
        ended = subprocess.run(
            [sys.executable, "-m", "ruff", *words, *written], cwd=tree, capture_output=True, text=True
        )
        assert ended.returncode == 0, ended.stdout + ended.stderr


def test_every_page_is_named_in_the_guide() -> None:
    guide = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    assert PAGES and all(f"docs/adding/{page.name}" in guide for page in PAGES)
