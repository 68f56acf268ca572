"""Run the code of pages as a reader does: ``robodyn`` in ``sh`` blocks, ``python`` blocks, page by page from above.

    python -m website.blocks OUT [PAGE ...]

Pages of ``docs/tutorials`` begin in an empty folder, others in one with ``configs``. Scenes in ``yaml`` blocks are
loaded, whole ones run, by the tests. ``<!-- not run: why -->`` above a block leaves it out, and so does
``<!-- file: NAME -->``, as the tests run it beside that file; ``<!-- exit: 2 -->`` tells how it ends.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from website.pages import ROOT, sources

BLOCK = re.compile(
    r"(?:<!-- (not run|exit|file): (.+?) -->\n)?^```(sh|python)\n(.*?)^```$", re.DOTALL | re.MULTILINE
)
LONGEST = 1800  # seconds for a block
# their blocks are followed to the letter by tests/unit/test_adding.py, or by .ci/site itself
ELSEWHERE = ("docs/adding/", "docs/index.md", "CONTRIBUTING.md", "CHANGELOG.md")


def blocks(page: str) -> Iterator[tuple[str, str, int]]:
    """Yield (language, code, exit code) of the blocks of a page that are run."""
    for word, value, language, code in BLOCK.findall((ROOT / page).read_text(encoding="utf-8")):
        if language == "sh":
            # what installs and tests the program is done before and elsewhere
            code = "\n".join(line for line in code.splitlines() if line.startswith("robodyn "))
        if word not in ("not run", "file") and code.strip():
            yield language, code, int(value) if word == "exit" else 0


def followed(page: str, out: Path) -> list[str]:
    """Run the code of a page, and return what fails."""
    folder = out / "blocks" / re.sub(r"\W+", "-", page)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    if "tutorials/" not in page:
        shutil.copytree(ROOT / "configs", folder / "configs")
    found = []
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "BROWSER": "true", "MPLBACKEND": "agg"}
    environment.pop("PYTHONPATH", None)
    for language, code, wanted in blocks(page):
        begin = time.monotonic()
        words = ["bash", "-e", "-c", code] if language == "sh" else [sys.executable, "-c", code]
        run = subprocess.run(
            words, cwd=folder, env=environment, capture_output=True, text=True, timeout=LONGEST
        )
        print(f"{time.monotonic() - begin:6.1f} s  {page}: {code.splitlines()[0][:80]}", flush=True)
        if run.returncode != wanted:
            found.append(f"{page}: exit code {run.returncode} of\n{code}\n{run.stderr[-1000:]}")
    return found


def main(out: Path, pages: list[str]) -> int:
    """Run the code of all pages, or of some, and tell what fails."""
    chosen = pages or [
        p for p in [*sources(), "README.md"] if p.endswith(".md") and not p.startswith(ELSEWHERE)
    ]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        failed = [text for found in pool.map(lambda page: followed(page, out), chosen) for text in found]
    print("\n".join(failed) or "all code of the pages runs")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).resolve(), sys.argv[2:]))
