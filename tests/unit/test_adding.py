"""The pages in docs/adding, followed to the letter in a copy of the tree.

A block below a paragraph with "Write `PATH`" becomes that file; a diff below one with "In `PATH`" is applied (each added
line goes below the last line of context, which must stand there); a block of shell commands is run.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "adding").glob("*.md"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"(?:Write|[Ii]n)\b[^`]*`([\w/.]+\.\w+)`")  # the paragraph above a block names its file
TREE = ("robodyn_cli", "tests", "docs", "configs")


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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_page_works(page: Path, tmp_path: Path) -> None:
    for name in TREE:
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("*.png"))
    for file in (*ROOT.glob("*.md"), ROOT / "pyproject.toml"):
        shutil.copy(file, tmp_path)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = set()
    for language, path, content in steps(page.read_text("utf-8")):
        done.add(language)
        target = tmp_path / path
        if language == "sh":
            for line in content.splitlines():
                words = shlex.split(line)
                words[:1] = (
                    [sys.executable, "-m", "robodyn_cli"] if words[0] == "robodyn" else [sys.executable]
                )
                ended = subprocess.run(
                    words, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=240
                )
                assert ended.returncode == 0, f"{line}\n{ended.stdout[-4000:]}\n{ended.stderr[-4000:]}"
        elif language == "diff":
            target.write_text(apply(target.read_text("utf-8"), content, path), encoding="utf-8")
        else:
            assert not target.exists(), f"{path} is there already"
            target.write_text(content, encoding="utf-8")
    assert {"sh", "diff", "python"} <= done


def test_every_page_is_named_in_the_guide() -> None:
    guide = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    assert PAGES and all(f"docs/adding/{page.name}" in guide for page in PAGES)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_new_code_of_a_page_is_in_our_style(page: Path) -> None:
    """Formatted and without findings of the linter, as all code."""
    for language, path, content in steps(page.read_text("utf-8")):
        for words in (("check",), ("format", "--diff")) if language == "python" else ():
            command = [sys.executable, "-m", "ruff", *words, "--stdin-filename", path, "-"]
            ended = subprocess.run(command, cwd=ROOT, input=content, capture_output=True, text=True)
            assert ended.returncode == 0, ended.stdout + ended.stderr
