"""One scene of a batch: what is to be run, and what became of it.

The scenes of a batch: loaded, found finished by an earlier run, judged by their criteria.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from robodyn_cli.commands import SCENE_COMMANDS
from robodyn_cli.errors import FAILED, ResultFileError, RobodynError, SceneError, worst
from robodyn_cli.kernels.cache import code_digest
from robodyn_cli.over.batch.criteria import EXIT_CODE, exit_code, judge
from robodyn_cli.record import mutable_record
from robodyn_cli.results.output_dir import RESULT_NAME, SUMMARY_NAME, same_run
from robodyn_cli.results.summary import read_summary, sha256
from robodyn_cli.scene.load import load_scene
from robodyn_cli.scene.types import Scene
from robodyn_cli.summaries.checks import BaselineReport, JudgedCriterion


@mutable_record
class BatchEntry:
    """One scene of a batch and what became of it.

    ``stopped`` : not done, as all are at first. ``unchanged`` : an earlier result was kept. ``replaced`` : another
    scene, whose results were in the directory. ``has_result`` : the directory holds what this run, or an earlier one of
    the same scene, left. ``baseline``, ``differences`` : how that compares with a stored result, for programs and in
    words. ``verdict`` is ``ok``, ``failed`` (a criterion, or no lock),
    ``error`` or ``stopped``.
    """

    path: Path
    name: str
    directory: Path | None = None
    scene: Scene | None = None
    exit_code: int = 0
    unchanged: bool = False
    stopped: bool = False
    seconds: float = 0.0
    message: str = ""
    replaced: Path | None = None
    has_result: bool = False
    criteria: list[JudgedCriterion] = dataclasses.field(default_factory=list)
    baseline: BaselineReport | None = None
    differences: list[str] = dataclasses.field(default_factory=list)

    @property
    def command(self) -> str:
        """The command of the scene, empty where there is none."""
        return (self.scene.command if self.scene is not None else None) or ""

    @property
    def verdict(self) -> str:
        """How the scene ended, in a word."""
        if self.stopped:
            return "stopped"
        return {0: "ok", FAILED: "failed"}.get(self.exit_code, "error")

    @property
    def problems(self) -> list[str]:
        """What went wrong, in words."""
        texts = [str(outcome) for outcome in self.criteria if not outcome.holds]
        return [*([self.message] if self.message else []), *texts, *self.differences]


def listed(paths: Sequence[Path]) -> list[BatchEntry]:
    """Return the scenes of a batch, of which nothing is done yet."""
    return [BatchEntry(path, name, stopped=True) for path, name in zip(paths, unique_names(paths))]


def load(entries: Sequence[BatchEntry], out: Path, overrides: Sequence[str] = ()) -> None:
    """Load the scenes and give each its output directory; what is wrong with one is an error of its own.

    ``overrides`` are ``key.path=value`` texts, applied to every scene.
    """
    for entry in entries:
        try:
            entry.scene = load_scene(entry.path, overrides)
            if entry.scene.command is None:
                raise SceneError(
                    f"key 'command' is missing: it says what to run; allowed: {', '.join(SCENE_COMMANDS)}",
                    (str(entry.path),),
                )
            entry.directory = out / entry.name / entry.scene.command
        except RobodynError as error:
            entry.exit_code, entry.message = error.exit_code, error.message


def unique_names(paths: Sequence[Path]) -> list[str]:
    """Return the stems of the files; where two are the same, with as much of their folders as tells them apart.

    Capitals tell none apart: on macOS and Windows ``A`` and ``a`` are one folder.
    """
    stems, alike = [path.stem for path in paths], [path.stem.casefold() for path in paths]
    if len(set(alike)) == len(stems):
        return stems
    full = [Path(os.path.abspath(path)) for path in paths]
    try:
        root = os.path.commonpath([path.parent for path in full])
    except ValueError:  # on different drives
        return [f"{stem}-{k}" if alike.count(alike[k]) > 1 else stem for k, stem in enumerate(stems)]
    places = [path.relative_to(root) for path in full]
    bare = [place.with_suffix("") for place in places]
    names = []
    for stem, low, place, short in zip(stems, alike, places, bare):
        # x.yaml and x.yml in one folder keep their suffixes
        distinct = place if bare.count(short) > 1 else short
        names.append(stem if alike.count(low) == 1 else distinct.as_posix())
    return names


def finished(entry: BatchEntry, drawn: Sequence[str]) -> dict[str, Any] | None:
    """Return the summary of an earlier, whole result of the same scene and code, None if there is none.

    drawn : ends of names of drawings that it must have (``.png``, ``torques.svg``). A failed run is not finished,
    unless the scene expects its exit code.
    """
    from robodyn_cli.results.hdf5 import read

    assert entry.directory is not None and entry.scene is not None
    summary = read_summary(entry.directory / SUMMARY_NAME)
    outputs = summary.get("outputs")
    if not isinstance(outputs, list) or RESULT_NAME not in outputs or summary.get("command") != entry.command:
        return None
    if not all((entry.directory / str(name)).exists() for name in outputs):
        return None
    if not all(any(str(name).endswith(end) for name in outputs) for end in drawn):
        return None
    expected = entry.scene.expect.get(EXIT_CODE)
    if summary.get("status") == "failed" and not (expected and expected.holds(exit_code(summary))):
        return None
    try:
        result = read(entry.directory / RESULT_NAME, select=lambda path: False)
    except ResultFileError:
        return None
    same = (
        sha256(result.scene_text) == sha256(entry.scene.text)
        and result.attributes.get("robodyn_code_sha256") == code_digest()
        and result.status == summary.get("status")
        and same_run(summary, result.attributes)
    )
    return summary if same else None


def settle(entry: BatchEntry, code: int, summary: dict[str, Any]) -> None:
    """Judge a run by its exit code and the criteria of its scene."""
    assert entry.scene is not None
    error = summary.get("error")
    message = str(error.get("message", "")) if isinstance(error, dict) else ""
    try:
        entry.criteria = judge(entry.scene.expect, summary, f"{entry.path}: ")
    except SceneError as wrong:
        entry.exit_code, entry.message = worst([code, wrong.exit_code]), wrong.message
        return
    if any(o.key == EXIT_CODE and o.holds for o in entry.criteria):
        code = 0
    elif code != 0:
        entry.message = message or str(summary.get("termination", {}).get("reason", ""))
    entry.exit_code = worst([code, *(FAILED for o in entry.criteria if not o.holds)])
