"""What the commands that run a scene have in common: scene in, directory of results out."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robodyn_cli.cli.console import Console
from robodyn_cli.errors import RobodynError, SceneError

if TYPE_CHECKING:
    from robodyn_cli.results.output_dir import OutputDirectory
    from robodyn_cli.results.result import Result

# status of a finished run that is not a success -> exit code
EXIT = {"ok": 0, "locked": 0, "no_lock": 1, "overload": 1}


def default_directory(scene: Path, command: str) -> Path:
    """Return outputs/<scene stem>/<command>."""
    return Path("outputs") / scene.stem / command


def run_scene(
    command: str,
    scene_path: Path,
    out: Path | None,
    overrides: Sequence[str] | None,
    no_plots: bool,
    strict: bool,
    console: Console,
    describe: Callable[[dict[str, Any]], str],
    **options: Any,
) -> int:
    """Run one scene, write its results, print its summary; return the exit code.

    ``options`` are those that the command has of its own (``quick`` of ``stability``).
    """
    import importlib

    from robodyn_cli.results.hdf5 import write
    from robodyn_cli.results.output_dir import OutputDirectory
    from robodyn_cli.results.writer import ResultWriter
    from robodyn_cli.run.commands import execute, streams
    from robodyn_cli.run.stopwatch import Stopwatch
    from robodyn_cli.scene.commands import SCENE_COMMANDS
    from robodyn_cli.scene.load import load_scene

    watch = Stopwatch()
    plots = importlib.import_module(SCENE_COMMANDS[command].plots)
    target = out or default_directory(scene_path, command)
    try:
        with watch.stage("load"):
            scene = load_scene(scene_path, list(overrides or ()))
            warn(scene, strict, console)
    except RobodynError as error:
        _replace_old(target, plots.plot_files(), _failed(command, scene_path.stem, error))
        raise
    with OutputDirectory(target, drawings=plots.plot_files()) as directory, contextlib.ExitStack() as stack:
        failure: RobodynError | None = None
        writer = None
        if streams(command, scene):
            writer = stack.enter_context(
                ResultWriter(directory.result_path, command=command, title=scene.title or command,
                             scene_text=scene.text)
            )  # fmt: skip
        try:
            result = execute(command, scene, console.progress, watch, writer, **options)
        except RobodynError as error:
            from robodyn_cli.results.result import Result

            if not isinstance(error.result, Result):
                directory.write_summary(_failed(command, scene.title, error))
                raise
            failure = error
            result = error.result
        console.clear()
        for text in result.summary.get("warnings", ()):
            console.note(f"robodyn: warning: {text}")
        summary = {"status": result.status, "command": command, "title": result.title, **result.summary}
        if failure is not None:
            summary["error"] = {
                "kind": type(failure).__name__,
                "message": failure.message,
                "exit_code": failure.exit_code,
            }
        result.summary = summary
        with watch.stage("write"):
            if writer is not None:
                writer.finish(status=result.status, summary=summary, events=result.events)
            else:
                write(result, directory.result_path)
        if not no_plots:
            with watch.stage("plots"):
                directory.record(plots.draw_all(result, directory.path))
        summary["wall_time_s"] = watch.report()
        written = directory.write_summary(summary)
    if failure is not None:
        console.note(f"results until then: {directory.path}")
        text = written.read_text(encoding="utf-8").rstrip()
        console.fail(failure, failure.exit_code, failure.message, text)
    show(written, directory, console, describe(summary))
    return EXIT.get(result.status, 0)


def finish(
    result: Result,
    directory: OutputDirectory,
    draw: Callable[[Result, Path], Iterable[str | Path]] | None,
    console: Console,
    describe: Callable[[dict[str, Any]], str],
) -> None:
    """Draw a result that is written, write its summary and print it; ``draw`` None draws nothing."""
    if draw is not None:
        directory.record(draw(result, directory.path))
    written = directory.write_summary(result.summary)
    show(written, directory, console, describe(result.summary))


def show(summary: Path, directory: OutputDirectory, console: Console, text: str) -> None:
    """Print the summary in its file, where JSON is asked for, else ``text`` and what lies where."""
    console.data(summary.read_text(encoding="utf-8").rstrip())
    console.say(text)
    console.say(f"results: {directory.path}  ({', '.join(directory.outputs)})")


def _replace_old(target: Path, drawings: Sequence[str], summary: dict[str, Any]) -> None:
    """Leave no result of an earlier run where a scene could not be loaded: it would pass for this one's."""
    from robodyn_cli.results.output_dir import RESULT_NAME, SUMMARY_NAME, OutputDirectory

    if any((target / name).exists() for name in (RESULT_NAME, SUMMARY_NAME)):
        # what is wrong with the scene is worth more than what is wrong with the directory
        with contextlib.suppress(RobodynError), OutputDirectory(target, drawings=drawings) as directory:
            directory.write_summary(summary)


def warn(scene: Any, strict: bool, console: Console) -> None:
    """Report what is physically wrong with the scene; an error with ``--strict``."""
    from robodyn_cli.model.consistency import physical_warnings

    warnings = physical_warnings(scene)
    for text in warnings:
        console.note(f"robodyn: warning: {text}")
    if warnings and strict:
        raise SceneError(f"{scene.path}: {warnings[0]} (an error because of --strict)", warnings=warnings)


def _failed(command: str, title: str, error: RobodynError) -> dict[str, Any]:
    from robodyn_cli.results.summary import jsonable

    return {
        "status": "failed",
        "command": command,
        "title": title,
        "termination": {"reason": error.message},
        "error": {
            "kind": type(error).__name__,
            "message": error.message,
            "exit_code": error.exit_code,
            "details": jsonable(error.details),
        },
    }
