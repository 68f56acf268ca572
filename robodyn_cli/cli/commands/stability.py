"""``robodyn stability``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from robodyn_cli.cli.offers import begun_by, listed_of
from robodyn_cli.cli.options import SharedOptions, file
from robodyn_cli.cli.runner import begun, output, publish, run_scene, show, store
from robodyn_cli.cli.words import error_text, table
from robodyn_cli.errors import FAILED, SceneError, of_option
from robodyn_cli.summaries.facts import rounded_up

EXAMPLES = (
    "stability configs/double_pendulum.yaml",
    "stability configs/stick_slip.yaml --json",
    "stability --suite --cases spring_1e6,nearly_singular_mass",
)


def _cases(incomplete: str) -> list[str]:
    from robodyn_cli.over.stability.cases import CASES

    return begun_by(case.name for case in CASES)(incomplete)


def command(
    scene: Annotated[
        Path | None,
        typer.Argument(
            metavar="SCENE.yaml",
            callback=file,
            show_default=False,
            help="Scene to report on; none with --suite.",
        ),
    ] = None,
    suite: Annotated[
        bool, typer.Option("--suite", help="Run the suite of stiff and extreme cases instead of a scene.")
    ] = False,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick", help="Smaller budgets: one method of each family, seconds instead of minutes."
        ),
    ] = False,
    cases: Annotated[
        str | None,
        typer.Option(
            "--cases",
            metavar="A,B",
            autocompletion=listed_of(_cases),
            help="Cases of the suite to run. [default: all]",
        ),
    ] = None,
    *,
    shared: SharedOptions,
) -> int:
    """Report on a scene, or run the suite; return the exit code."""
    if suite == (scene is not None):
        raise SceneError("stability: give either a scene or --suite")
    if scene is not None:
        if cases is not None:
            raise of_option("--cases", "only with --suite")
        return run_scene(shared.job("stability", scene, options={"quick": quick}), shared.console, describe)
    if shared.overrides:
        raise of_option("--set", "not with --suite, whose cases have their own settings")
    return run_suite(cases.split(",") if cases else None, quick, shared)


def run_suite(cases: Sequence[str] | None, quick: bool, shared: SharedOptions) -> int:
    """Run the suite; return 1 where a case misses its expectation."""
    from robodyn_cli.over.stability.suite import suite
    from robodyn_cli.results.atomic import write_bytes
    from robodyn_cli.tools.progress import Stopwatch

    watch = Stopwatch()
    console, drawings = shared.console, shared.drawings("stability")
    with (
        console.waiting(lambda: "the suite"),
        output(shared.directory(None, "stability-suite"), None, console) as directory,
        begun(directory, console),
    ):
        try:
            result = suite(quick, cases, console.progress, console.note)
        finally:
            console.clear()
        store(result, directory)
        for case in result.summary["cases"]:
            write_bytes(directory.new / f"{case['name']}.yaml", case.pop("scene").encode())
        publish(result, directory, drawings, console, watch)
    show(result, directory, console, describe_suite)
    return 0 if result.summary["missed"] == 0 else FAILED


def small(x: Any) -> str:
    """Return a number in few characters."""
    return "-" if x is None else f"{x:.2g}"


def small_error(x: Any) -> str:
    """Return an error in few characters, rounded up."""
    return small(None if x is None else rounded_up(x))


def describe(summary: Mapping[str, Any], verbose: bool = True) -> str:
    """Return the report for the terminal."""
    wrong = [
        f"  {m['method']}: {m['message']}"
        for m in summary["methods"]
        if m["message"] and m["status"] not in ("stable", *(() if verbose else ("unsupported",)))
    ]
    rows = _method_rows(summary)
    shown = rows if verbose else [row[:4] + row[5:6] for row in rows]
    lines = [*_reference_lines(summary, verbose), table(shown), *wrong, *_gain_lines(summary)]
    return "\n".join([str(summary["title"]), *lines])


def _reference_lines(summary: Mapping[str, Any], verbose: bool) -> list[str]:
    """Return lines about the reference and the linearised motion."""
    lines = []
    ref, spectrum = summary["reference"], summary["spectrum"]
    if ref is None:
        lines.append("  reference          none: no two methods get through at tight tolerance")
    else:
        lines.append(
            f"  reference          {ref['methods'][0]} and {ref['methods'][1]} agree to {ref['digits']:.1f} digits "
            f"up to t = {ref['until']:.4g} s"
        )
        if ref["ends_early"]:
            lines.append(f"  the motion ends    {ref['ends_early']}")
    if verbose and spectrum is not None:
        lines.append(
            f"  spectrum           stiffness ratio up to {spectrum['stiffness_ratio']:.3g}; fastest decay "
            f"{spectrum['fastest_decay']:.3g} 1/s, oscillation {spectrum['fastest_oscillation']:.3g} rad/s, growth "
            f"{spectrum['fastest_growth']:.3g} 1/s"
        )
        limits = ", ".join(
            f"{x['method']} {small(x['largest_step'])} s" for x in summary["step_limits"] if x["largest_step"]
        )
        lines.append(f"  largest steps      {limits or 'no limit'}")
    return lines


def _method_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Return the table of the methods."""
    growth = {g["method"]: g for g in summary["energy_growth"]["methods"]}
    rows = [
        [
            "method",
            "status",
            "error / range",
            "estimate",
            "steps",
            "time [ms]",
            "energy, 1000 periods",
            "grows as",
        ]
    ]
    for m in summary["methods"]:
        g = growth.get(m["method"])
        name = f"auto ({m['chosen']})" if m["method"] == "auto" and m["chosen"] else m["method"]
        exponent = g["exponent"] if g else None
        rows.append(
            [
                name,
                m["status"].replace("_", " "),
                small_error(m["relative"]),
                small_error(m["estimate"]),
                str(m["steps"]),
                f"{1e3 * m['seconds']:.3g}",
                _energy(g, summary["energy_growth"]["period"]["seconds"]),
                "-" if exponent is None else f"t^{round(exponent, 1) + 0.0:.1f}",
            ]
        )
    return rows


def _gain_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return a line about Baumgarte's gains."""
    lines = []
    for name, words in (("own", "as the scene asks"), ("fixed", "fixed step")):
        gains = (summary.get("baumgarte") or {}).get(name)
        if gains and "chosen" in gains:
            c = gains["chosen"]
            lines.append(
                f"  Baumgarte          {words} ({gains['method']}): alpha = beta = {c['alpha']:.3g} 1/s = "
                f"{c['factor']:.3g}/h with h = {c['step']:.3g} s; drift {error_text(c['drift'])}, "
                f"error {error_text(c['error'])}, of the projected run {error_text(c['integration_error'])}"
            )
    return lines


def _energy(energy: Mapping[str, Any] | None, period: float) -> str:
    """Return the largest error of the energy, and the number of periods if not all were run."""
    if energy is None:
        return "-"
    cut = "" if energy["status"] == "ok" else f" ({energy['until'] / period:.0f})"
    return small_error(energy["largest_relative"]) + cut


def describe_suite(summary: Mapping[str, Any], verbose: bool = True) -> str:
    """Return the suite's verdicts for the terminal."""
    names = summary["methods"]
    rows = [["case", "verdict", *names]]
    for case in summary["cases"]:
        marks = [_mark(case["methods"].get(n)) for n in names]
        rows.append([case["name"], "ok" if case["holds"] else "MISSED", *marks])
    lines = [table(rows), "  errors over the range; ! inaccurate, x diverged, >> too slow, - unsupported"]
    lines += [f"  {case['name']}: {case['found']}" for case in summary["cases"] if not case["holds"]]
    lines.append(
        f"  {len(summary['cases']) - summary['missed']} of {len(summary['cases'])} cases as expected"
    )
    return "\n".join(lines)


def _mark(trial: Mapping[str, Any] | None) -> str:
    if trial is None:
        return ""
    status = trial["status"]
    if status in ("stable", "inaccurate"):
        return (small_error(trial["relative"]) if trial["relative"] is not None else "ran") + (
            "!" if status == "inaccurate" else ""
        )
    return {"diverged": "x", "too_slow": ">>", "unsupported": "-"}[status]
