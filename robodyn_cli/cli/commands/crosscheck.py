"""``robodyn crosscheck``."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robodyn_cli.cli.offers import one_of
from robodyn_cli.cli.options import SceneFile, SharedOptions, number
from robodyn_cli.cli.runner import begun, output, placed, publish, show, store
from robodyn_cli.cli.words import error_text, table
from robodyn_cli.errors import FAILED, listed, of_option

if TYPE_CHECKING:
    from robodyn_cli.scene.types import Scene
    from robodyn_cli.summaries.crosscheck import CrosscheckReport


EXAMPLES = (
    "crosscheck configs/2r_circle.yaml --with pinocchio",
    "crosscheck configs/four_bar_deploy.yaml --with mujoco --json",
    "crosscheck configs/four_bar_deploy.yaml --with mujoco --own-settings --out outputs/soft",
)


VERDICTS = {
    "ok": "the answers agree within their errors",
    "differs": "the answers DIFFER beyond their errors",
    "open": "the errors are TOO LARGE to prove anything",
}


def command(
    scene: SceneFile,
    engine: Annotated[
        str,
        one_of(
            "--with",
            "pinocchio",
            "mujoco",
            "drake",
            metavar="ENGINE",
            help="The other engine: pinocchio, mujoco or drake.",
        ),
    ],
    asked: Annotated[
        str | None,
        one_of(
            "--command",
            "inverse",
            "simulate",
            metavar="NAME",
            help="What to compare: inverse or simulate; default: the scene's command.",
        ),
    ] = None,
    own: Annotated[
        bool,
        typer.Option(
            "--own-settings",
            help="Tell how far mujoco or drake is off as its users run it, by its own steps and closures.",
        ),
    ] = False,
    step: Annotated[
        float | None,
        typer.Option(
            "--step",
            metavar="SECONDS",
            parser=number("a number > 0", lambda x: 0.0 < x < math.inf),
            help="Time step of the other engine, with --own-settings. [default: the engine's]",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="With --own-settings: directory for datasets and the picture.",
        ),
    ] = None,
    *,
    shared: SharedOptions,
) -> int:
    """Compare a scene with another engine; return the exit code, 1 where they differ or that proves nothing."""
    from robodyn_cli.over.crosscheck.crosscheck import compared_command, crosscheck, refuse_choice
    from robodyn_cli.results.result import Result
    from robodyn_cli.results.summary import as_keys, jsonable
    from robodyn_cli.scene.load import load_scene

    for name, given in (("--step", step), ("--out", out), ("--plots", shared.plots)):
        if given is not None and not own:
            raise of_option(name, "only with --own-settings")
    console, overrides = shared.console, shared.overrides or ()
    loaded = load_scene(scene, overrides)
    command = asked or compared_command(loaded)
    refuse_choice(engine, own, command)
    if own:
        return _own_settings(loaded, scene, engine, step, shared)
    with console.waiting(lambda: f"comparing with {engine}"), placed(scene, overrides, command):
        try:
            report = crosscheck(loaded, engine, command, console.progress)
        finally:
            console.clear()
    result = Result(
        "crosscheck", loaded.title or command, report.status, loaded.text, summary=as_keys(report)
    )
    if not console.takes(result):
        console.data(jsonable(result.summary))
        console.say(describe(report))
    return 0 if report.agrees else FAILED


def _own_settings(loaded: Scene, path: Path, engine: str, step: float | None, shared: SharedOptions) -> int:
    """Tell how far an engine is off at its own settings; write it where a directory is given."""
    from robodyn_cli.over.crosscheck.own_settings import own_settings
    from robodyn_cli.results.summary import jsonable
    from robodyn_cli.tools.progress import Stopwatch

    console, drawings, watch = shared.console, shared.drawings("crosscheck"), Stopwatch()
    with contextlib.ExitStack() as stack:
        stack.enter_context(console.waiting(watch.doing))
        directory = None
        if shared.out is not None:
            directory = stack.enter_context(output(shared.out, path, console))
            stack.enter_context(begun(directory, console))
        try:
            with placed(path, shared.overrides or (), "simulate"):
                result = own_settings(loaded, engine, step, console.progress, watch)
        finally:
            console.clear()
        if directory is not None:
            store(result, directory)
            publish(result, directory, drawings, console, watch)
    if directory is not None:
        show(result, directory, console, describe_own)
    elif not console.takes(result):
        console.data(jsonable(result.summary))
        console.say(describe_own(result.summary))
    return 0


def describe(report: CrosscheckReport) -> str:
    """Return the comparison for the terminal."""
    rows = [["", "largest difference", "at", "here", "there", "error here", "error there"]]
    for one in report.compared:
        rows.append(
            [
                one.quantity, f"{one.difference:.2e}", f"{one.column}, t = {one.time:.6g} s", f"{one.ours:.12g}",
                f"{one.theirs:.12g}", error_text(one.our_error), error_text(one.their_error),
            ]
        )  # fmt: skip
    lines = [
        f"{report.title}: {report.command} here and in {report.engine} {report.version}: {VERDICTS[report.status]}",
        table(rows),
    ]
    for one in report.compared:
        if one.agrees is None:
            lines.append(
                f"  {one.quantity} proves nothing: differences up to {one.allowed:.2g} are allowed, and the answer "
                f"here is of size {one.size:.2g}"
            )
    if isinstance(report.compared_until, float):
        lines.append(
            f"  compared until             t = {report.compared_until:.6g} s: behind it the motion passes a singular "
            "pose, from which it may go on in more than one way"
        )
    if report.by_own_formulas:
        lines.append(f"  by formulas of the check   {', '.join(report.by_own_formulas)}")
    if report.handed_over:
        lines.append(f"  handed over, not checked   {', '.join(report.handed_over)}")
    return "\n".join(lines)


def describe_own(summary: Mapping[str, Any], verbose: bool = True) -> str:
    """Return for the terminal how far an engine is off at its own settings."""
    ended, settings = summary["termination"], {"step": f"{summary['step']:g} s", **summary["settings"]}
    lines = [
        f"{summary['title']}: {summary['engine']} {summary['version']} at its own settings",
        f"  settings           {', '.join(f'{name} {x}' for name, x in settings.items())}",
        f"  run                {summary['steps']} steps to t = {ended['time']:.6g} s: {ended['reason']}",
        table([["", "largest", "relative", "at", "at the end", "error", "here"], *_own_rows(summary)]),
    ]
    if summary["closures"]:
        lines.append("  gaps are readings of the engine's own states; a pin is two points there")
    for words, key in (
        ("handed over in each step", "handed_over"), ("of the engine itself", "of_the_engine"),
        ("got a millionth of the least mass", "with_small_mass"),
    ):  # fmt: skip
        if summary[key]:
            lines.append(f"  {words}: {listed(summary[key])}")
    return "\n".join(lines)


def _own_rows(summary: Mapping[str, Any]) -> Iterator[list[str]]:
    """Yield the rows of the table: gaps, accelerations, energy, joints."""
    for one in summary["closures"]:
        factor, unit = (1e3, "mm") if one["unit"] == "m" else (1.0, "rad")
        yield [
            f"gap of {one['closure']} [{unit}]", f"{factor * one['largest']:.3g}", "-", f"t = {one['time']:.6g} s",
            f"{factor * one['final']:.3g}", "reading", f"{factor * one['here']:.1g}",
        ]  # fmt: skip
    a, energy = summary["accelerations"], summary["energy"]
    off = error_text(a["error"])
    at = f"{a['column']}, t = {a['time']:.6g} s"
    for name, size, part, place in (
        ("accelerations at the start", a["start"], a["start_relative"], a["start_column"]),
        ("accelerations", a["largest"], a["relative"], at),
    ):
        yield [name, f"{size:.3g}", _percent(part), place, "-", off, "-"]
    yield [
        "energy made [J]", f"{energy['largest']:+.3g}", _percent(energy["relative"]), f"t = {energy['time']:.6g} s",
        f"{energy['final']:+.3g}", error_text(energy["error"]), f"{energy['here']:.1g}",
    ]  # fmt: skip
    for one in summary["joints"]:
        error = "-" if one["error"] is None else error_text(one["error"])
        yield [
            f"joints off the motion [{one['unit']}]", f"{one['largest']:.3g}", "-",
            f"{one['column']}, t = {one['time']:.6g} s", f"{one['final']:.3g}", error, "-",
        ]  # fmt: skip


def _percent(x: float | None) -> str:
    return "-" if x is None else f"{100.0 * x:.3g} %"
