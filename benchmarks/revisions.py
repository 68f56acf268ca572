"""Two revisions in turns: what became slower by more than 5 %.

    python benchmarks/revisions.py OLD [NEW] [--scripts throughput.py ...] [--rounds N] [--own] [--all] [--json FILE]

Both are checked out side by side (``git worktree``), NEW is this checkout if it is left out; each has a cache of its
own, filled by a round that does not count. The scripts and example scenes of NEW run over both engines, so that what
changed in a script is not taken for a change of the engine; ``--own`` lets each revision run its own, for an old
engine that cannot run those of NEW. They run in turns, old and new, with ``--json``. Of each figure in seconds,
milliseconds or microseconds the least of all rounds counts. What is above 1.05 times the old one, and above every
round of it, is named: a change within the old revision's own rounds (``spread``) is the machine's. ``--all`` prints
every figure. Figures of peers are left out, and what one of the revisions does not measure is counted. Without OLD
this checkout is compared with itself.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import measure

SLOWER = 1.05
SCRIPTS = ("throughput.py", "double_pendulum.py", "time_optimal.py")
SAID = ("tolerance", "asked", "loops")  # numbers that tell rows apart, as words do
PEERS = re.compile(
    "pinocchio|mujoco|exudyn|drake|pydrake|heyoka|casadi|scipy|toppra|funcanimation|robotics toolbox",
    re.IGNORECASE,
)
TOLD = ("note", "reason")  # words about a row that do not name it
UNITS = ("ns", "us", "ms", "seconds", "s")  # the last word of a figure's name

SCRIPTED = ("benchmarks", "configs")  # folders that the old engine takes from the new revision

Figures = dict[tuple[str, ...], float]


@contextmanager
def checkout(revision: str | None) -> Iterator[Path]:
    """Yield a folder with a revision, this one for None; it is gone afterwards."""
    if revision is None:
        yield measure.ROOT
        return
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "tree"
        git = ["git", "-C", str(measure.ROOT), "worktree"]
        subprocess.run([*git, "add", "--detach", str(place), revision], check=True, capture_output=True)
        try:
            yield place
        finally:
            subprocess.run([*git, "remove", "--force", str(place)], check=True, capture_output=True)


def give(source: Path, target: Path) -> None:
    """Put the scripts and scenes of a checkout in place of those of another."""
    for name in SCRIPTED:
        shutil.rmtree(target / name, ignore_errors=True)
        shutil.copytree(source / name, target / name, ignore=shutil.ignore_patterns("__pycache__"))


def run(tree: Path, script: str, cache: str, quick: bool) -> Figures:
    """Return the figures of a script of a checkout, by script, words of their row and name.

    Raises
    ------
    RuntimeError : the script measured nothing.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.json"
        command = [sys.executable, str(tree / "benchmarks" / script), "--json", str(file)]
        environment = {**os.environ, "ROBODYN_CACHE": cache, "PYTHONPATH": str(tree)}
        # a part that fails over one engine is missing there, and the others count
        subprocess.run(command + ["--quick"] * quick, cwd=tree, env=environment, stdout=subprocess.DEVNULL)
        rows = all_rows(json.loads(file.read_text(encoding="utf-8"))) if file.exists() else []
    if not rows:
        raise RuntimeError(
            "it measures nothing over one of the engines: does the old one lack what it asks for (--own)?"
        )
    return {name: x for name, x in figures(script, rows).items() if not any(map(PEERS.match, name[1:]))}


def all_rows(found: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of all tables that a script wrote."""
    tables = [rows for rows in found.values() if isinstance(rows, list)]
    return [row for rows in tables for row in rows if isinstance(row, dict)]


def figures(script: str, rows: list[dict[str, Any]], wanted: Callable[[str], bool] | None = None) -> Figures:
    """Return the times among rows, or what is ``wanted`` by its name; rows of the same words go by their order."""
    wanted = wanted or _is_time
    found: Figures = {}
    seen: dict[tuple[str, ...], int] = defaultdict(int)
    for row in rows:
        words = (
            script,
            *(f"{x}" for key, x in row.items() if key in SAID or (isinstance(x, str) and key not in TOLD)),
        )
        number = seen[words]
        seen[words] += 1
        for name, value in row.items():
            if isinstance(value, (int, float)) and wanted(name) and value > 0.0:
                found[(*words, str(number), name)] = float(value)
    return found


def _is_time(name: str) -> bool:
    words = name.split("_")
    return words[-1] in UNITS or words[0] in UNITS


def compared(old: list[Figures], new: list[Figures]) -> list[dict[str, Any]]:
    """Return a row for each figure that both have: the least of both, their ratio, and the spread of the old ones."""
    rows = []
    for name in old[0]:
        before, after = ([x[name] for x in rounds if name in x] for rounds in (old, new))
        if not after:
            continue
        least = min(before)
        rows.append(
            {
                "figure": ", ".join(name),
                "old": least,
                "new": min(after),
                "ratio": min(after) / least,
                "spread": max(before) / least,
            }
        )
    return sorted(rows, key=lambda row: -row["ratio"])


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("old", nargs="?", metavar="OLD")
    parser.add_argument("new", nargs="?", metavar="NEW")
    parser.add_argument("--scripts", nargs="+", default=list(SCRIPTS), metavar="SCRIPT")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--own", action="store_true", help="let each revision run its own scripts")
    parser.add_argument("--all", action="store_true", help="print every figure")
    options = parser.parse_args()
    scripts = SCRIPTS[:1] if options.quick else options.scripts
    rounds = 2 if options.quick else options.rounds
    lone = 0
    measure.print_machine()
    with measure.reporting(options.json) as report, tempfile.TemporaryDirectory() as caches:
        with checkout(options.old) as old, checkout(options.new) as new:
            if not options.own and old != measure.ROOT:
                give(new, old)
            for script in scripts:
                with report.part(script):
                    found: tuple[list[Figures], list[Figures]] = ([], [])
                    for k in range(rounds + 1):
                        for side, tree, name in zip(found, (old, new), ("old", "new")):
                            own = run(tree, script, f"{caches}/{name}", options.quick)
                            if k:
                                side.append(own)
                    report.rows += compared(*found)
                    lone += len(set(found[0][0]) ^ set(found[1][0]))
        slower = [row for row in report.rows if row["ratio"] > max(SLOWER, row["spread"])]
        shown = report.rows if options.all else slower
        table = [["figure", "old", "new", "ratio", "spread of old"]]
        table += [
            [
                row["figure"],
                *(f"{row[key]:.4g}" for key in ("old", "new")),
                *(f"{row[key]:.2f}" for key in ("ratio", "spread")),
            ]
            for row in shown
        ]
        print("\n" + measure.table(table) if shown else "", flush=True)
        print(f"{len(slower)} of {len(report.rows)} figures became slower by more than 5 %")
        if lone:
            print(f"{lone} figures are of one of the revisions alone")


if __name__ == "__main__":
    main()
