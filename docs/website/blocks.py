"""Run the code of pages as a reader does: ``robodyn`` in ``sh`` blocks, ``python`` blocks, page by page from above.

    python -m website.blocks OUT [PAGE | COMMAND ...]

Pages of ``docs/tutorials`` begin in an empty folder, others in one with ``configs``. Scenes in ``yaml`` blocks are
loaded, whole ones run, by the tests. A command in place of a page stands for the examples in its help; they begin in a
folder with ``configs`` and some results, of their own.
``<!-- not run: why -->`` above a block leaves it out, and so does ``<!-- file: NAME -->``, as the tests run it beside
that file; ``<!-- exit: 2 -->`` tells how it ends.
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

from robodyn_cli.commands import COMMANDS
from website.pages import ROOT, sources
from website.runs import examples

BLOCK = re.compile(
    r"(?:<!-- (not run|exit|file): (.+?) -->\n)?^```(sh|python)\n(.*?)^```$", re.DOTALL | re.MULTILINE
)
LONGEST = 1800  # seconds for a block
# their blocks are followed to the letter by tests/unit/test_adding.py, or by .ci/site itself
ELSEWHERE = ("docs/adding/", "docs/index.md", "CONTRIBUTING.md", "CHANGELOG.md")

HELP = "help"
# what the examples in the help of commands take as there
BEFORE = (
    "inverse configs/2r_circle.yaml --no-plots",
    "simulate configs/double_pendulum.yaml --no-plots",
    *(f"simulate configs/double_pendulum.yaml --no-plots --set initial.q.theta2={q} --out outputs/{name}"
      for q, name in ((0.1, "first"), (0.2, "second"), (0.3, "third"))),
    "deploy configs/four_bar_deploy.yaml --no-plots",
    "run configs/2r_circle.yaml configs/double_pendulum.yaml --no-plots --baseline baseline --update-baseline",
    "export configs/2r_circle.yaml --to mjcf --out robot && cp robot/*.xml robot.xml",
)  # fmt: skip
ENDS = {
    "validate configs --strict": 2,  # published robots whose inertias no bodies can have
    "compare outputs/first outputs/second": 1,  # they differ
    "run configs --no-plots --baseline baseline": 1,  # there are more scenes than results in it
}


def blocks(page: str) -> Iterator[tuple[str, str, int]]:
    """Yield (language, code, exit code) of the blocks of a page that are run."""
    for word, value, language, code in BLOCK.findall((ROOT / page).read_text(encoding="utf-8")):
        if language == "sh":
            # what installs and tests the program is done before and elsewhere
            code = "\n".join(line for line in code.splitlines() if line.startswith("robodyn "))
        if word not in ("not run", "file") and code.strip():
            yield language, code, int(value) if word == "exit" else 0


def code_of(page: str) -> Iterator[tuple[str, str, int]]:
    """Yield (language, code, exit code) of a page, of the examples in the help of a command, or of what these need."""
    if page == HELP:
        yield from (("sh", f"robodyn {words}", 0) for words in BEFORE)
    elif page in COMMANDS:
        yield from (("sh", f"robodyn {words}", ENDS.get(words, 0)) for words in examples(page))
    else:
        yield from blocks(page)


def folder_of(page: str, out: Path) -> Path:
    """Return the folder in which the code of a page begins, made afresh."""
    folder = out / "blocks" / re.sub(r"\W+", "-", page)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    if page in COMMANDS:
        shutil.copytree(out / "blocks" / HELP, folder, dirs_exist_ok=True)
    elif "tutorials/" not in page:
        shutil.copytree(ROOT / "configs", folder / "configs")
    return folder


def environment_of(page: str, folder: Path) -> dict[str, str]:
    """Return the environment in which the code of a page runs: nothing opens a window."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "BROWSER": "true", "MPLBACKEND": "agg"}
    environment.pop("PYTHONPATH", None)
    if page == "cache":  # others need theirs, which its examples would clear
        environment["ROBODYN_CACHE"] = str(folder / "cache")
    return environment


def followed(page: str, out: Path) -> int:
    """Run the code of a page, tell at once what fails, and return how much that is."""
    folder = folder_of(page, out)
    environment = environment_of(page, folder)
    failed = 0
    for language, code, wanted in code_of(page):
        begin = time.monotonic()
        words = ["bash", "-e", "-c", code] if language == "sh" else [sys.executable, "-c", code]
        run = subprocess.run(
            words, cwd=folder, env=environment, capture_output=True, text=True, timeout=LONGEST
        )
        print(f"{time.monotonic() - begin:6.1f} s  {page}: {code.splitlines()[0][:80]}", flush=True)
        if run.returncode != wanted:
            failed += 1
            print(
                f"{page}: exit code {run.returncode} of\n{code}\n{run.stdout[-1000:]}{run.stderr[-1000:]}",
                flush=True,
            )
    return failed


def main(out: Path, pages: list[str]) -> int:
    """Run the code of all pages and the examples of all commands, or of some; return the exit code."""
    written = [p for p in sources() if p.endswith(".md") and not p.startswith(ELSEWHERE)]
    # of commands those that take longest are among the last, and begin first, so that none is left alone at the end
    chosen = pages or ["README.md", *reversed(COMMANDS), *written]
    failed = followed(HELP, out) if set(chosen) & set(COMMANDS) else 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        failed += sum(pool.map(lambda page: followed(page, out), chosen))
    print(f"{failed} blocks fail" if failed else "all code of the pages runs")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).resolve(), sys.argv[2:]))
