"""Paste what the benchmarks printed into the pages that show it, or keep what they measured as a release's record.

    python benchmarks/throughput.py --json RUNS/throughput.json > RUNS/throughput.txt      (and so on for the others)
    python docs/make_benchmarks.py RUNS                  # the pages
    python docs/make_benchmarks.py RUNS --record         # benchmarks/history/VERSION.json
    python docs/make_benchmarks.py RUNS --run --record   # runs all scripts whole before, one after another
    python docs/make_benchmarks.py --history [WORD ...]  # figures over releases

``--run`` goes on where it was ended: what RUNS has of this revision stays. A file tells how long it took (``took_s``).

A page says where: ``<!-- throughput 1 -->`` stands before the first table that ``throughput.txt`` holds, and
``<!-- loops all -->`` before everything below the line on the machine, up to the next heading. Pages keep what they
have where RUNS has no such file. The words around the tables are written by hand: read them again.

A record has what each script wrote, to four digits, with its revision, the machine and the versions of peers. Over
releases the ratios to peers count, which depend least on the machine: they are shown (how many times as long the peer
takes; of ``startup`` how many times as long as the bare imports robodyn does), or with WORDs every figure whose row has
all of them.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
HISTORY = DOCS.parent / "benchmarks" / "history"
sys.path.insert(0, str(HISTORY.parent))

import measure  # noqa: E402
import revisions  # noqa: E402

RATIOS = {  # to peers, by script: the names of the figures
    "throughput": ("faster",),
    "model_functions": ("faster",),
    "ensembles": ("to_batch", "to_batch_error", "to_batch_error_99"),
    "c_functions": ("ratio",),
    "loops_corpus": ("pinocchio_faster", "mujoco_faster", "pydrake_faster"),
    "startup": ("cpu_ratio",),
}
LEADS = ("against_peers", "double_pendulum")  # scripts with an error and a time a row
ERRORS = (1e-3, 1e-7, 1e-10, 1e-12)
COMPARE = ("revisions",)  # scripts whose rows are no figures of a release
OPTIONS = {  # of scripts that are run for the pages and the record
    "against_peers": ["--cold"],
    "time_optimal": ["--random", "50"],
    "reference": ["--quick"],  # the whole one writes a file of this repository
}
OF_OTHERS = ("urdf_corpus", "loops_corpus")  # the pages show robots that are not in this repository
PAGES = ("benchmarks.md", "benchmarks-rows.md", "choosing-an-integrator.md")
MARK = re.compile(r"<!-- (\w+) (\d+|all) -->\n\n?")


def tables(text: str) -> list[str]:
    """Return the Markdown tables of a text."""
    return re.findall(r"(?:^\|.*\n)+", text + "\n", re.MULTILINE)


def body(text: str) -> str:
    """Return a text from its first blank line on."""
    return text.partition("\n\n")[2].strip() + "\n"


def filled(page: str, runs: Path) -> str:
    """Return a page with what the runs printed behind its marks.

    Raises
    ------
    SystemExit : a run has fewer tables than the page shows.
    """
    out, place = [], 0
    for mark in MARK.finditer(page):
        name, which = mark.groups()
        path = runs / f"{name}.txt"
        if not path.exists():
            continue
        text = path.read_text(encoding="utf-8")
        rest = page[mark.end() :]
        if which == "all":
            new, old = body(text), re.split(r"^#", rest, maxsplit=1, flags=re.MULTILINE)[0]
            new += "\n" if len(old) < len(rest) else ""
        else:
            found = tables(text)
            if len(found) < int(which):
                raise SystemExit(f"{path} has {len(found)} tables, and the page shows its table {which}")
            new, old = found[int(which) - 1], (re.match(r"(?:\|.*\n)*", rest) or [""])[0]
        out += [page[place : mark.end()], new]
        place = mark.end() + len(old)
    return "".join([*out, page[place:]])


def is_whole(file: Path, revision: str) -> bool:
    """Tell whether a script has written all of its figures, of this revision."""
    if not file.exists():
        return False
    found = json.loads(file.read_text(encoding="utf-8"))
    return not found["failed"] and found["machine"]["revision"] == revision and "took_s" in found


def measured(runs: Path, scripts: Path, more: list[str]) -> list[str]:
    """Run the scripts of a folder, each in a process of its own; return the names of those that failed.

    more : options for all of them.
    """
    runs.mkdir(parents=True, exist_ok=True)
    failed, revision = [], measure.revision()
    for script in sorted(scripts.glob("*.py")):
        name, file = script.stem, runs / f"{script.stem}.json"
        if name in COMPARE or "\nif __name__ ==" not in script.read_text(encoding="utf-8"):
            continue
        if is_whole(file, revision):
            print(f"{name}: there", flush=True)
            continue
        began = time.perf_counter()
        command = [sys.executable, str(script), "--json", str(file), *OPTIONS.get(name, ()), *more]
        told = os.devnull if name in OF_OTHERS else runs / f"{name}.txt"
        with open(told, "w", encoding="utf-8") as out:
            done = subprocess.run(command, cwd=DOCS.parent, stdout=out)
        took = time.perf_counter() - began
        if done.returncode or not file.exists():
            failed.append(name)
        else:
            found = json.loads(file.read_text(encoding="utf-8")) | {"took_s": round(took)}
            file.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
        print(f"{name}: {took / 60.0:.1f} min{', failed' * (name in failed)}", flush=True)
    return failed


def recorded(runs: Path) -> dict[str, Any]:
    """Return what the scripts wrote as ``NAME.json``, as a release keeps it.

    Raises
    ------
    SystemExit : there is none, a part failed, or they are not of one machine and set of versions.
    """
    files = {
        path.stem: json.loads(path.read_text(encoding="utf-8"))
        for path in sorted(runs.glob("*.json"))
        if path.stem not in COMPARE
    }
    if not files:
        raise SystemExit(f"{runs} has no NAME.json of a benchmark")
    scripts, machines = {}, []
    for name, found in files.items():
        if found["failed"]:
            raise SystemExit(f"{name}.json: {', '.join(found['failed'])} failed")
        machine = found.pop("machine")
        scripts[name] = {**{key: machine.pop(key, None) for key in ("revision", "load")}, **found}
        machines.append(machine)
        for key, value in machine.items():
            if value != machines[0].get(key):
                raise SystemExit(f"{name}.json: {key} {value}, the others {machines[0].get(key)}")
    return {"version": machines[0].pop("robodyn"), "machine": machines[0], "scripts": scripts}


def text_of(record: dict[str, Any]) -> str:
    """Return a record as JSON with numbers of four digits, a row of figures a line."""

    def short(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: short(x) for key, x in value.items()}
        if isinstance(value, list):
            return [short(x) for x in value]
        return float(f"{value:.4g}") if isinstance(value, float) else value

    text = json.dumps(short(measure.finite(record)), indent=1, allow_nan=False)
    return re.sub(r"\{[^{}]*\}", lambda row: re.sub(r"\n\s*", " ", row[0]), text) + "\n"


def records(folder: Path = HISTORY) -> dict[str, dict[str, Any]]:
    """Return the records of releases, oldest first."""

    def order(path: Path) -> list[int]:
        return [int(number) for number in re.findall(r"\d+", path.stem)]

    paths = sorted(folder.glob("*.json"), key=order)
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in paths}


def released(changelog: str) -> list[str]:
    """Return the versions of a changelog that are released."""
    return re.findall(r"^## (\d\S*) \((?!unreleased\))", changelog, re.MULTILINE)


def leads(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Return how many times as long as robodyn each engine takes to reach an error, by work, engine and error."""
    best: dict[str, dict[str, dict[float, float]]] = {}
    for row in rows:
        if {"work", "engine", "error", "us"} <= set(row) and row["us"] and row["error"] is not None:
            engine = row["engine"].split()[0].rstrip(",")
            times = best.setdefault(row["work"], {}).setdefault(engine, {})
            for error in ERRORS:
                if row["error"] <= error:
                    times[error] = min(row["us"], times.get(error, row["us"]))
    return {
        f"{work}, {engine} to {error:.0e}": time / engines["robodyn"][error]
        for work, engines in best.items()
        for engine, times in engines.items()
        for error, time in times.items()
        if engine != "robodyn" and error in engines.get("robodyn", {})
    }


def column(record: dict[str, Any], every: bool) -> dict[str, float]:
    """Return all figures of a record by script, words of their row and name, or the ratios to peers alone."""
    found: dict[str, float] = {}
    for name, script in record["scripts"].items():
        rows, ratios = revisions.all_rows(script), RATIOS.get(name, ())
        some = revisions.figures(name, rows, lambda key: every or key in ratios)  # noqa: B023
        peers = [key for key in some if not every and any(map(revisions.PEERS.match, key[1:-1]))]
        found |= {", ".join(key): value for key, value in some.items() if key not in peers}
        if name in LEADS:
            found |= {f"{name}, {key}": value for key, value in leads(rows).items()}
    return found


def over_releases(found: dict[str, dict[str, Any]], words: list[str]) -> str:
    """Return a table: the figures that have all words, or the ratios to peers, a column a release."""
    columns = [column(record, bool(words)) for record in found.values()]
    names = dict.fromkeys(name for figures in reversed(columns) for name in figures)
    shown = [name for name in names if all(word in name for word in words)]
    heads = [
        version + " (quick)" * all(script["quick"] for script in record["scripts"].values())
        for version, record in found.items()
    ]
    lines = [[name, *(f"{c[name]:.4g}" if name in c else "-" for c in columns)] for name in shown]
    return measure.table([["figure", *heads], *lines])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("runs", type=Path, nargs="?", help="folder with the outputs of benchmarks/NAME.py")
    parser.add_argument(
        "--record", action="store_true", help="keep RUNS/*.json as the record of their version"
    )
    parser.add_argument("--run", action="store_true", help="run all scripts first, whole, for RUNS")
    parser.add_argument("--quick", action="store_true", help="their quick forms: a look, not figures")
    parser.add_argument("--history", nargs="*", metavar="WORD", help="print figures over releases")
    given = parser.parse_args()
    if given.history is not None:
        print(over_releases(records(), given.history))
        return
    if given.runs is None:
        parser.error("RUNS or --history is missing")
    if given.run and (failed := measured(given.runs, HISTORY.parent, ["--quick"] * given.quick)):
        raise SystemExit(f"{', '.join(failed)} failed: nothing is kept")
    if given.record:
        record = recorded(given.runs)
        HISTORY.mkdir(exist_ok=True)
        (HISTORY / f"{record['version']}.json").write_text(text_of(record), encoding="utf-8")
    else:
        for name in PAGES:
            page = DOCS / name
            page.write_text(filled(page.read_text(encoding="utf-8"), given.runs), encoding="utf-8")


if __name__ == "__main__":
    main()
