"""True error beside run time: robodyn and other engines on the same problems, in the same run, in turns.

    python benchmarks/against_peers.py [--cases plain stiff ...] [--engines heyoka ...] [--quick] [--json FILE]

Engines that are not installed are left out with a word (`pip install robodyn[peers]` brings them), and one that fails
on a case is a line of the report, beside what the others reach. Each engine is driven in its fastest way
(`benchmarks/peers/`), with several settings; what counts is the shortest time in which it reaches an error. Errors are
against `benchmarks/reference.json` (`reference.py`) and `lock_time.py`. For stiff cases the error is the largest of any
angle along the whole run, transient included. Times are of one run in a process that has everything compiled;
`--cold` also times whole processes.
"""

from __future__ import annotations

import importlib
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import measure

measure.single_thread()

from cases import CASES, Entry  # noqa: E402

# engine: module, function, what it must import
ENGINES = {
    "robodyn": ("peers.robodyn", "entries", "robodyn_cli"),
    "heyoka": ("peers.taylor", "entries", "heyoka"),
    "casadi": ("peers.cvodes", "entries", "casadi"),
    "scipy": ("peers.scipy", "entries", "scipy"),
    "pinocchio": ("peers.scipy", "pinocchio_entries", "pinocchio"),
    "mujoco": ("peers.mujoco", "entries", "mujoco"),
    "exudyn": ("peers.exudyn", "entries", "exudyn"),
    "drake": ("peers.drake", "entries", "pydrake"),
}
TARGETS = {
    "plain": (1e-3, 1e-7, 1e-10, 1e-12),
    "stiff": (1e-5, 1e-7, 1e-9, 1e-11),
    "light": (1e-5, 1e-7, 1e-9, 1e-11),
    "heavy": (1e-3, 1e-5, 1e-9, 1e-12),
    "four_bar": (1e-3, 1e-5, 1e-9, 1e-12),
    "arm": (1e-3, 1e-5, 1e-7, 1e-9),
}
LIMIT = 20.0  # s; a setting that takes longer is measured once


def entries_of(engine: str, case: Any) -> Iterator[Entry]:
    module, function, _ = ENGINES[engine]
    yield from getattr(importlib.import_module(module), function)(case)


def measured(
    report: measure.Report, case: Any, engines: list[str], repeats: int, quick: bool
) -> list[dict[str, Any]]:
    """Return a row for each engine and setting: its error, steps and median time.

    An engine that fails with all its settings, or before the first, has failed on the case.
    """
    rows: list[dict[str, Any]] = []
    runs: list[Callable[[], Any]] = []
    for engine in engines:
        if not report.has(ENGINES[engine][2]):
            continue
        with report.part(f"{case.key}, {engine}"):
            entries = list(entries_of(engine, case))[:: 3 if quick else 1]
            failures = []
            for entry in entries:
                row, failure = first_run(case, entry)
                if failure is not None:
                    failures.append(failure)
                rows.append(row)
                runs.append(entry.run)
            if failures and len(failures) == len(entries):
                raise failures[0]
    timed(rows, runs, repeats)
    return rows


def first_run(case: Any, entry: Entry) -> tuple[dict[str, Any], Exception | None]:
    """Return the row of an engine with a setting, its error not a number where the engine fails, and how it fails."""
    began = time.perf_counter()
    row = {"work": case.title, "case": case.key, "engine": entry.engine, "setting": entry.setting}
    failure = None
    try:
        result, row["steps"] = entry.run()
        row["error"] = case.error(entry, result)
    except Exception as error:  # an engine may fail in ways of its own
        print(f"{entry.engine} {entry.setting}: {error}", file=sys.stderr)
        row["steps"], row["error"], failure = 0, float("nan"), error
    row["first"] = time.perf_counter() - began
    return row, failure


def timed(rows: list[dict[str, Any]], runs: list[Callable[[], Any]], repeats: int) -> None:
    """Add ``us``, the median of alternating timings in processor time; what takes long is called less often."""
    samples: list[list[float]] = [[] for _ in rows]
    for turn in range(repeats):
        for row, run, found in zip(rows, runs, samples):
            if (
                row["error"] != row["error"]
                or (turn and row["first"] > LIMIT)
                or (turn > 2 and row["first"] > 1)
            ):
                continue
            count = max(1, int(2e-3 / max(row.get("each", row["first"]), 1e-6)))
            start = time.process_time()
            for _ in range(count):
                run()
            row["each"] = (time.process_time() - start) / count
            found.append(row["each"])
    for row, found in zip(rows, samples):
        row["us"] = 1e6 * statistics.median(found) if found else float("nan")
        measure.noted(row["engine"], found)
        row.pop("each", None)
        row.pop("first", None)


def reached(rows: list[dict[str, Any]], targets: tuple[float, ...]) -> list[list[str]]:
    """Return a table of the shortest time [us] in which each engine reached each error, and robodyn's lead."""
    families = list(dict.fromkeys(row["engine"].split()[0] for row in rows))
    lines = [["engine", *(f"{t:.0e}" for t in targets)]]
    best: dict[str, list[float]] = {}
    for family in families:
        mine = [row for row in rows if row["engine"].split()[0].rstrip(",") == family.rstrip(",")]
        best[family] = [
            min((r["us"] for r in mine if r["error"] <= target), default=float("nan")) for target in targets
        ]
    own = best.get("robodyn", [float("nan")] * len(targets))
    for family, times in best.items():
        cells = []
        for x, y in zip(times, own):
            ratio = "" if family == "robodyn" or x != x or y != y else f" ({x / y:.3g} x)"
            cells.append("-" if x != x else f"{x:.4g}{ratio}")
        lines.append([family.rstrip(","), *cells])
    return lines


# -- whole processes -------------------------------------------------------------------------------------------

ONE = """
import sys
sys.path.insert(0, {folder!r})
import against_peers, cases
cases.Wanted.setting = {setting!r}
for entry in against_peers.entries_of({engine!r}, against_peers.CASES[{case!r}]()):
    if entry.setting == {setting!r}:
        print(entry.run())
        break
"""


def children() -> float:
    """Return the processor time of all processes that were waited for."""
    import resource

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


# settings that reach about 1e-9
COLD = {
    "robodyn": "rtol 1e-09", "heyoka": "tol 1e-09", "casadi": "rtol 1e-10", "scipy": "rtol 1e-10",
    "pinocchio": "rtol 1e-10", "mujoco": "step 0.001", "exudyn": "tol 1e-12", "drake": "accuracy 1e-09",
}  # fmt: skip


def cold(case: str, engines: list[str], repeats: int) -> list[dict[str, Any]]:
    """Time whole processes: start Python, import, build, compile, run once. robodyn with and without its cache.

    Processor time, so that waiting for other people's programs does not count.
    """
    import tempfile

    jobs = [(engine, engine, {}) for engine in engines]
    with tempfile.TemporaryDirectory() as cache:
        if "robodyn" in engines:
            jobs[0:1] = [
                ("robodyn, nothing cached", "robodyn", {"ROBODYN_CACHE": "off"}),
                ("robodyn, cached", "robodyn", {"ROBODYN_CACHE": cache}),
            ]
        times: dict[str, list[float]] = {}
        for turn in range(repeats + 1):
            for name, engine, more in jobs:
                code = ONE.format(
                    folder=str(measure.ROOT / "benchmarks"), engine=engine, case=case, setting=COLD[engine]
                )
                environment = {**os.environ, "PYTHONPATH": measure.search_path(), **more}
                # bytecode is kept, as in any installed package
                environment.pop("PYTHONDONTWRITEBYTECODE", None)
                environment["PYTHONPYCACHEPREFIX"] = os.path.join(cache, "bytecode")
                start = children()
                done = subprocess.run(
                    [sys.executable, "-c", code], env=environment, capture_output=True, text=True
                )
                if done.returncode or not done.stdout.strip():
                    continue
                if turn:
                    times.setdefault(name, []).append(children() - start)
    return [
        {"engine": name, "setting": COLD[name.split(",")[0]], "ms": 1e3 * statistics.median(t)}
        for name, t in times.items()
    ]


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--engines", nargs="+", choices=list(ENGINES), default=list(ENGINES))
    parser.add_argument("--cold", action="store_true", help="time whole processes too (double pendulum)")
    options = parser.parse_args()
    repeats = 3 if options.quick else 11
    measure.print_machine()
    print(f"medians of {repeats} alternating repeats, processor time")
    with measure.reporting(options.json) as report:
        report.more["repeats"] = repeats
        for key in options.cases:
            with report.part(key):
                case = CASES[key]()
                rows = measured(report, case, options.engines, repeats, options.quick)
                report.rows += rows
                print_case(case, rows, TARGETS[key])
        if options.cold:
            engines = [engine for engine in options.engines if report.has(ENGINES[engine][2])]
            processes = report.more["processes"] = cold("plain", engines, repeats // 2 + 2)
            print("\nwhole process, double pendulum, to about 1e-9\n")
            lines = [[r["engine"], r["setting"], f"{r['ms']:.0f}"] for r in processes]
            print(measure.table([["engine", "setting", "CPU ms"], *lines], left=2))


def print_case(case: Any, rows: list[dict[str, Any]], targets: tuple[float, ...]) -> None:
    print(f"\n{case.title}: microseconds to a true error of at most (times robodyn's)\n")
    print(measure.table(reached(rows, targets)))
    head = [["engine", "setting", "error", "us", "steps"]]
    body = [[r["engine"], r["setting"], f"{r['error']:.1e}", f"{r['us']:.4g}", str(r["steps"])] for r in rows]
    print("\n" + measure.table(head + body, left=2), flush=True)


if __name__ == "__main__":
    main()
