"""What the commands that run a scene have in common: scene in, directory of results out."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robodyn_cli.cli.console import Console, width
from robodyn_cli.cli.interrupts import tidy_up_first
from robodyn_cli.commands import COMMANDS
from robodyn_cli.errors import OF_STATUS, REPLACING, RobodynError, SceneError, StrictError
from robodyn_cli.record import record

if TYPE_CHECKING:
    from robodyn_cli.motion.going_on import Journal
    from robodyn_cli.report.registry import Drawings
    from robodyn_cli.results.hdf5.writer import ResultWriter
    from robodyn_cli.results.in_memory import Output
    from robodyn_cli.results.result import Result
    from robodyn_cli.scene.types import Scene
    from robodyn_cli.tools.progress import Stopwatch

# the summary of a result in words, and whether all is told (--verbose); of a command with headlines a third argument
# are the lines with its main figures
Describe = Callable[..., str]


# stages that a run may spend most of its time on, and what a user may know then; told from so many seconds on
MOSTLY = {"plots": "for plots: --no-plots", "compile": "for compiling, which is kept for the next run"}
LONG = 1.0


def default_directory(scene: Path | None, command: str) -> Path:
    """Return outputs/<scene stem>/<command>; without a scene outputs/<command>."""
    return Path("outputs") / (scene.stem if scene is not None else "") / command


@record
class SceneRun:
    """A command on a scene, as it was asked for on the command line.

    scene : its file; for a program in Python what ``load_scene`` takes. directory : of its results; None where they
    stay in memory. overrides : ``key.path=value`` texts. drawings : None for none. options : what the command has of
    its own, as its function in ``works/`` takes it (``quick`` of ``stability``). resume : go on with a long run that
    was killed.
    """

    command: str
    scene: Path
    directory: Path | None
    overrides: Sequence[str] = ()
    drawings: Drawings | None = None
    strict: bool = False
    resume: bool = False
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def run_scene(job: SceneRun, console: Console, describe: Describe) -> int:
    """Run one scene, write its results, print its summary; return the exit code."""
    from robodyn_cli.tools.progress import Stopwatch

    watch = Stopwatch()
    with console.waiting(watch.doing), output(job.directory, job.scene, console) as directory:
        scene = _load(job, watch, console)
        with begun(directory, console), contextlib.ExitStack() as stack:
            writer = _writer(job, scene, directory, stack)
            try:
                with contextlib.ExitStack() as running:  # it ends before its file is removed
                    journal = _journal(job, scene, directory, running, console)
                    result, failure = _compute(job, scene, writer, watch, console, journal)
            except RobodynError as error:
                if error.exit_code in REPLACING:
                    directory.replace_old(_failed(job.command, scene.title, error))
                raise
            with watch.stage("write"):
                store(result, directory, writer)
            publish(result, directory, job.drawings, console, watch)
    if failure is not None:
        until = "" if isinstance(failure, StrictError) else " until then"
        if directory.lasts:
            console.note(f"results{until}: {directory.path}")
        _show_data(directory, console)
        return console.failed(failure)
    show(result, directory, console, describe)
    code = OF_STATUS.get(result.status, 0)
    if code and console.for_people:
        say_failed(result, console)
    return code


@contextlib.contextmanager
def output(target: Path | None, scene: Path | None, console: Console) -> Iterator[Output]:
    """Give the output directory of a run, which begins with ``begun`` when there is something to compute; target :
    None for one in memory.

    Where the block fails, say so of earlier results that stay as they were.
    """
    if target is None:
        from robodyn_cli.results.in_memory import InMemory

        with InMemory() as none:
            yield none
        return
    from robodyn_cli.report.registry import plot_files
    from robodyn_cli.results.output_dir import OutputDirectory

    directory = OutputDirectory(target, plot_files(), scene if isinstance(scene, Path) else None)
    before = directory.stored_run()
    try:
        yield directory
    except BaseException:
        if before is not None and directory.stored_run() == before:
            console.note(f"the results of an earlier run stay as they were: {target}")
        raise


@contextlib.contextmanager
def begun(directory: Output, console: Console) -> Iterator[None]:
    """Hold an output directory; say whose results are there where it is another scene's."""
    tidy_up_first()
    with directory:
        if directory.warning is not None:
            console.warn(directory.warning)
        if (other := directory.other_scene()) is not None:
            console.warn(
                f"{directory.path} holds results of another scene, {other}, "
                "which this run replaces when it has its own"
            )
        yield


def publish(
    result: Result,
    directory: Output,
    drawings: Drawings | None,
    console: Console,
    watch: Stopwatch | None = None,
) -> None:
    """Draw a result that is written, put its files in place of an earlier run's; say what was not drawn."""
    from robodyn_cli.report.registry import doubts, draw_all, not_drawn

    drawn: list[Path] = []
    if drawings is not None and directory.lasts:
        with watch.stage("plots") if watch is not None else contextlib.nullcontext():
            drawn = draw_all(result, directory.new, drawings)
    if watch is not None:
        result.summary["wall_time_s"] = watch.report()
    directory.replace_old(result.summary)
    if drawings is not None and directory.lasts:
        for text in doubts(result, drawings):
            console.warn(text)
        for text in not_drawn(result, drawings, drawn) if console.verbose else ():
            console.note(f"robodyn: {text}")


def show(result: Result, directory: Output, console: Console, describe: Describe) -> None:
    """Print the summary of a result: as JSON where that is asked for, else in words, with what lies where. A program
    in Python gets the result itself."""
    if console.takes(result):
        return
    _show_data(directory, console)
    if not console.for_people:
        return
    console.say(describe(result.summary, console.verbose, *_figures(result, console)))
    if result.events and console.verbose:
        from robodyn_cli.results.moments import moment_lines

        for line in moment_lines(result, width(sys.stdout) or 80):
            console.say(line)
    say_where(directory, console, result.summary)


def _figures(result: Result, console: Console) -> Iterator[list[str]]:
    """Yield the lines with the main figures of a result of a command with headlines."""
    if COMMANDS[result.command].headlines:
        from robodyn_cli.cli.figure_words import figure_lines

        yield figure_lines(result, console.verbose)


def say_failed(result: Result, console: Console) -> None:
    """Say last that a run did not end as it should, and what was found about it."""
    from robodyn_cli.report.page.verdict import verdicts

    told = ", ".join(one.words for one in verdicts(result) if one.alarming)
    console.note(f"robodyn: failed: {told}")


def say_where(directory: Output, console: Console, summary: Mapping[str, Any]) -> None:
    """Print where results are: how many files and what they took, or all of them by name."""
    from robodyn_cli.cli.progress_line import spent

    names, times = directory.outputs, summary.get("wall_time_s", {})
    total = times.get("total")
    took = "" if total is None else f" in {spent(total)}"
    for stage, words in MOSTLY.items():
        if total is not None and times.get(stage, 0.0) > max(0.5 * total, LONG):
            took += f", {spent(times[stage])} of it {words}"
    files = ", ".join(names) if console.verbose else f"{len(names)} files{took}; -v tells more"
    console.say(f"results: {directory.path}  ({files})")


def _show_data(directory: Output, console: Console) -> None:
    """Print what ``summary.json`` holds where JSON is asked for."""
    if console.as_json:
        from robodyn_cli.results.output_dir import SUMMARY_NAME
        from robodyn_cli.results.summary import read_summary

        console.data(read_summary(directory.path / SUMMARY_NAME))


def _load(job: SceneRun, watch: Stopwatch, console: Console) -> Scene:
    from robodyn_cli.scene.load import load_scene

    with watch.stage("load"):
        scene = load_scene(job.scene, list(job.overrides))
        warn(scene, job.strict, console)
    return scene


def _writer(
    job: SceneRun, scene: Scene, directory: Output, stack: contextlib.ExitStack
) -> ResultWriter | None:
    """Return what writes the results of a long run block by block; None for a run that is written at its end."""
    from robodyn_cli.over.commands import streams

    if not directory.lasts or not streams(job.command, scene):
        return None
    from robodyn_cli.results.hdf5.writer import ResultWriter

    return stack.enter_context(
        ResultWriter(directory.result_path, command=job.command, title=scene.title or job.command,
                     scene_text=scene.text)
    )  # fmt: skip


def _journal(
    job: SceneRun, scene: Scene, directory: Output, stack: contextlib.ExitStack, console: Console
) -> Journal | None:
    """Return what keeps a long simulation for the case that it is killed, with its blocks if it is to go on."""
    from robodyn_cli.over.commands import keeps_journal

    journal = None
    if directory.lasts and keeps_journal(job.command, scene):
        from robodyn_cli.motion.going_on import Journal
        from robodyn_cli.results.output_dir import UNFINISHED_NAME

        journal = kept = stack.enter_context(Journal(directory.path / UNFINISHED_NAME, scene, job.resume))

        def how_to_go_on(kind: type[BaseException] | None, *_: object) -> None:
            if kind is KeyboardInterrupt and not kept.is_empty:
                where = f"robodyn: {directory.path} keeps what has been computed"
                console.note(f"{where}: the same command with --resume goes on from there")

        stack.push(how_to_go_on)
    if job.resume and (journal is None or not journal.taken):
        console.note(f"robodyn: there is no unfinished run in {directory.path} to go on with; it starts anew")
    return journal


def _compute(
    job: SceneRun,
    scene: Scene,
    writer: ResultWriter | None,
    watch: Stopwatch,
    console: Console,
    journal: Journal | None,
) -> tuple[Result, RobodynError | None]:
    """Return the result with its whole summary, and the error that ended a run half way."""
    from robodyn_cli.over.commands import execute
    from robodyn_cli.results.result import Result

    failure: RobodynError | None = None
    watch.listen(console.note)
    try:
        with placed(job.scene, job.overrides, job.command):
            own = {"journal": journal} if journal is not None else {}
            result = execute(job.command, scene, console.progress, watch, writer, **job.options, **own)
    except RobodynError as error:
        if not isinstance(error.result, Result) or error.exit_code not in REPLACING:
            raise
        failure, result = error, error.result
    warnings = result.summary.get("warnings", ())
    for text in warnings:
        console.warn(text)
    if job.strict and warnings and failure is None:
        failure = StrictError(f"{'; '.join(warnings)} (taken as an error: --strict)", warnings=list(warnings))
        result.status = "failed"
    result.summary = {**result.summary, **result.head, **({"error": failure.facts} if failure else {})}
    return result, failure


@contextlib.contextmanager
def placed(scene: Path, overrides: Sequence[str], command: str) -> Iterator[None]:
    """Let errors of a run say where in the scene's files the key stands that they are about."""
    try:
        yield
    except RobodynError as error:
        place_in_files(error, scene, overrides, command)
        raise


def place_in_files(error: RobodynError, scene: Path, overrides: Sequence[str], command: str) -> None:
    """Put file, line, column and key before the message of an error about a scene; see ``over/commands.py``."""
    from robodyn_cli.over.commands import place
    from robodyn_cli.scene.load import examine

    place(error, lambda: examine(scene, list(overrides)).root, command)


def store(result: Result, directory: Output, writer: ResultWriter | None = None) -> None:
    """Write a result file that says of which run it is, whole or by its writer; nothing of one that stays in memory."""
    from robodyn_cli.results.hdf5 import write
    from robodyn_cli.results.output_dir import RUN_ID

    if directory.lasts:
        result.attributes[RUN_ID] = directory.run_id
    if writer is not None:
        writer.finish(status=result.status, summary=result.summary, events=result.events,
                      attributes=result.attributes)  # fmt: skip
    elif directory.lasts:
        write(result, directory.result_path)


def warn(scene: Scene, strict: bool, console: Console) -> None:
    """Report what is physically wrong with the scene; an error with ``--strict``."""
    from robodyn_cli.model.consistency import physical_warnings

    for text in scene.notes:
        console.note(f"robodyn: {text}")
    warnings = physical_warnings(scene)
    for text in warnings:
        console.warn(text)
    if warnings and strict:
        message = "; ".join(warnings)
        raise SceneError(f"{message} (errors because of --strict)", (scene.path,), warnings=warnings)


def _failed(command: str, title: str, error: RobodynError) -> dict[str, Any]:
    """Return the summary of a run that failed before there was a result."""
    from robodyn_cli.results.summary import jsonable

    return {
        "status": "failed",
        "command": command,
        "title": title,
        "termination": {"reason": error.message},
        "error": {**error.facts, "details": jsonable(error.details)},
    }
