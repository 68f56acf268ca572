"""Proof of the printed errors: ``python -m tests.proof --seed 1 --scenes 600 --runs 12 --seconds 3600 --out DIR``.

Each seed is one scene, run several times with methods and tolerances of its own. Outcomes are appended to
``DIR/runs.jsonl``; seeds that are in it already are not run again, so a stopped proof goes on where it was. ``--report``
only counts what is there; ``--show SEED`` prints a scene.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from tests.proof.families import make
from tests.proof.judge import try_seed

BAD = ("low", "silent", "crash")
JUDGED = ("ok", "low", "high")


def read(path: Path) -> list[dict[str, Any]]:
    """Return the runs in a file; a last line that a kill has cut is left out."""
    found = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            found.append(json.loads(line))
        except ValueError:
            continue
    return found


def words(run: dict[str, Any]) -> str:
    """Return a run in one line."""
    setting = " ".join(f"{k}={v}" for k, v in run["setting"].items())
    ratio = "" if run["ratio"] is None else f" ratio {run['ratio']:.2g}"
    figures = f"true {run['true']:.2e} printed {run['estimate']:.2e}{ratio}"
    return (
        f"{run['verdict']:11} {run['seed']} {run['family']} {setting}: {run['key']} {figures} {run['note']}"
    )


def report(runs: list[dict[str, Any]]) -> str:
    """Return counts, the distribution of ratios, and what is bad, as text."""
    verdicts = collections.Counter(r["verdict"] for r in runs)
    judged = [r for r in runs if r["verdict"] in JUDGED]
    ratios = sorted(r["ratio"] for r in judged if r["ratio"] is not None)
    lines = [f"{len(runs)} runs of {len({r['seed'] for r in runs})} scenes: "
             + ", ".join(f"{count} {name}" for name, count in verdicts.most_common())]  # fmt: skip
    if ratios:
        lines.append(
            f"printed over true error: median {statistics.median(ratios):.2f}, from {ratios[0]:.2g} to {ratios[-1]:.2g}"
        )
        high = verdicts["high"] / len(judged)
        lines.append(
            f"below a tenth: {verdicts['low']}; above ten times: {verdicts['high']} ({high:.2%} of {len(judged)} with an error that can be told)"
        )
    by = collections.defaultdict(collections.Counter)
    for r in runs:
        by[r["family"]][r["verdict"]] += 1
    lines += [
        f"  {family:16} " + ", ".join(f"{n} {v}" for v, n in c.most_common())
        for family, c in sorted(by.items())
    ]
    lines += [words(r) for r in runs if r["verdict"] in (*BAD, "high")]
    return "\n".join(lines)


def main() -> int:
    """Run; return 1 where an error was hidden."""
    parser = argparse.ArgumentParser(prog="python -m tests.proof", description=__doc__)
    parser.add_argument("--seed", type=int, default=1, help="the first seed")
    parser.add_argument("--scenes", type=int, default=sys.maxsize)
    parser.add_argument("--runs", type=int, default=12, help="of each scene")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "robodyn-proof")
    parser.add_argument("--report", action="store_true")
    parser.add_argument("--show", type=int)
    arguments = parser.parse_args()
    if arguments.show is not None:
        print(make(arguments.show)[1].scene())
        return 0
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "runs.jsonl"
    done = {r["seed"] for r in read(path)}
    end = time.monotonic() + (0.0 if arguments.report else arguments.seconds)
    for seed in range(arguments.seed, min(sys.maxsize, arguments.seed + arguments.scenes)):
        if time.monotonic() > end:
            break
        if seed in done:
            continue
        found = [dataclasses.asdict(run) for run in try_seed(seed, arguments.runs)]
        with path.open("a") as file:
            file.writelines(json.dumps(run) + "\n" for run in found)
        for run in found:
            if run["verdict"] in BAD:
                print(words(run), flush=True)
    runs = read(path)
    print(report(runs))
    return 1 if any(r["verdict"] in BAD for r in runs) else 0


if __name__ == "__main__":
    sys.exit(main())
