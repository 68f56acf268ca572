"""``robodyn work-precision``."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from typing import Annotated, Any

import typer

from robodyn_cli.cli.offers import begun_by, listed_of
from robodyn_cli.cli.options import OutDir, Overrides, SceneFile, SharedOptions, number
from robodyn_cli.cli.runner import begun, output, placed, publish, show, store
from robodyn_cli.cli.words import error_text, table
from robodyn_cli.integration_methods import METHODS

COLUMNS = (
    "method", "formulation", "tolerance", "step", "error", "run_time_s", "compile_time_s", "evaluations", "steps",
    "status",
)  # fmt: skip


def tolerances_of(text: str) -> list[float]:
    """Return the tolerances given on the command line."""
    read = number("numbers from 1e-15 to 0.1, for example 1e-6,1e-9", lambda x: 1e-15 <= x <= 0.1)
    return [read(word) for word in text.split(",")]


EXAMPLES = (
    "work-precision configs/double_pendulum.yaml",
    "work-precision configs/four_bar_deploy.yaml",
    "work-precision configs/double_pendulum.yaml --json",
)


def command(
    scene: SceneFile,
    out: OutDir = None,
    overrides: Overrides = None,
    methods: Annotated[
        str | None,
        typer.Option(
            "--methods",
            metavar="A,B",
            autocompletion=listed_of(begun_by(METHODS)),
            help="Methods to compare. [default: all that can]",
        ),
    ] = None,
    tolerances: Annotated[
        Any,  # a list of numbers
        typer.Option(
            "--tolerances",
            metavar="T,T",
            parser=tolerances_of,
            help="Tolerances to run. [default: 1e-2 to 1e-13]",
        ),
    ] = None,
    repeats: Annotated[
        int,
        typer.Option(
            "--repeats",
            metavar="N",
            parser=number("a whole number from 1 to 1000", lambda n: 1 <= n <= 1000, int),
            help="Runs that a median is taken of.",
        ),
    ] = 7,
    *,
    shared: SharedOptions,
) -> int:
    """Compare the methods, write every run, print the best; return the exit code."""
    from robodyn_cli.over.work_precision.work_precision import work_precision
    from robodyn_cli.results.atomic import write_bytes
    from robodyn_cli.scene.load import load_scene
    from robodyn_cli.tools.progress import Stopwatch

    watch = Stopwatch()
    console, drawings = shared.console, shared.drawings("work-precision")
    names = methods.split(",") if methods else None
    with (
        console.waiting(lambda: "comparing methods"),
        output(shared.directory(scene, "work-precision"), scene, console) as directory,
    ):
        loaded = load_scene(scene, list(overrides or ()))
        with begun(directory, console):
            try:
                with placed(scene, overrides or (), "work-precision"):
                    result = work_precision(loaded, names, tolerances, repeats, console.progress)
            finally:
                console.clear()
            store(result, directory)
            write_bytes(directory.new / "runs.csv", as_csv(result.summary["runs"]).encode())
            publish(result, directory, drawings, console, watch)
    show(result, directory, console, describe)
    return 0


def as_csv(runs: list[Mapping[str, Any]]) -> str:
    """Return the runs as CSV."""
    stream = io.StringIO()
    columns = [*COLUMNS, *(["lock_time"] if any("lock_time" in run for run in runs) else [])]
    writer = csv.DictWriter(stream, columns, lineterminator="\n")
    writer.writeheader()
    for run in runs:
        writer.writerow({k: "" if run.get(k) is None else run[k] for k in columns})
    return stream.getvalue()


def describe(summary: Mapping[str, Any], verbose: bool = True) -> str:
    """Return the best method at each error level, for the terminal."""
    until, lock = summary["compared_until"], summary.get("lock_time")
    extent = f"up to t = {until:.4g} s" if lock is None else "about the time of the lock"
    lines = [
        f"{summary['title']}",
        f"  reference          {' and '.join(summary['reference_methods'])} agree to "
        f"{summary['reference_digits']:.1f} digits {extent}",
    ]
    if lock is not None:
        lines.append(f"  lock               t = {lock:.9g} s; its error is compared [s]")
    lines += _limits_of_comparison(summary)
    rows = [
        [
            "error below",
            "best method",
            "formulation",
            "tolerance or step",
            "error",
            "time [ms]",
            "evaluations",
        ]
    ]
    for best in summary["best"]:
        setting = best["tolerance"] if best["tolerance"] is not None else best["step"]
        rows.append(
            [f"{best['level']:.0e}", best["method"], best["formulation"], f"{setting:.1e}", error_text(best['error']),
             f"{1e3 * best['run_time_s']:.4g}", str(best["evaluations"])]
        )  # fmt: skip
    lines.append(table(rows))
    bad = [r for r in summary["runs"] if r["status"] not in ("ok", "unsupported")]
    if bad:
        kinds = ", ".join(
            f"{sum(r['status'] == k for r in bad)} {k}" for k in sorted({r["status"] for r in bad})
        )
        lines.append(f"  not usable         {kinds} of {len(summary['runs'])} runs (see runs.csv)")
    return "\n".join(lines)


def _limits_of_comparison(summary: Mapping[str, Any]) -> list[str]:
    """Return lines about motions that cannot be compared, or not to the end."""
    until, grown = summary["compared_until"], summary["perturbation_growth"]
    lines = []
    if summary["perturbation_grows"] == "exponential":
        lines.append(
            f"  exponential        a small change of the start grows e times in {summary['e_folding_time']:.2g} s, "
            f"{grown:.1e} times in all, as in chaotic motion"
        )
    if not summary["compared_whole_duration"]:
        lines.append(
            f"  compared           up to t = {until:.4g} s; the references no longer agree after that"
        )
    return lines
