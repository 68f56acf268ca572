"""From scenes that were run, checked or validated to what ``--json`` prints of them."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.over.batch.entry import Entry
from robodyn_cli.summaries.checks import (
    BatchReport,
    CheckReport,
    JudgedCriterion,
    SceneFindings,
    SceneReport,
    ValidationReport,
)
from robodyn_cli.summaries.facts import ABSENT


def batch_of(entries: Sequence[Entry], exit_code: int) -> BatchReport:
    """Return how a batch ended."""
    return BatchReport(_status(exit_code), exit_code, [_scene(entry) for entry in entries])


def _scene(entry: Entry) -> SceneReport:
    return SceneReport(
        scene=str(entry.path),
        name=entry.name,
        command=entry.command or None,
        verdict=entry.verdict,
        exit_code=entry.exit_code,
        unchanged=entry.unchanged,
        seconds=round(entry.seconds, 3),
        message=entry.message or None,
        criteria=entry.criteria,
        directory=None if entry.directory is None else str(entry.directory),
        baseline=entry.baseline or ABSENT,
    )


def check_of(criteria: list[JudgedCriterion]) -> CheckReport:
    """Return how a result meets its criteria."""
    failed = sum(not criterion.holds for criterion in criteria)
    return CheckReport(_status(failed), failed, criteria)


def validation_of(scenes: list[SceneFindings], exit_code: int) -> ValidationReport:
    """Return what is wrong with scenes."""
    return ValidationReport(_status(exit_code), exit_code, scenes)


def _status(wrong: int) -> str:
    return "failed" if wrong else "ok"
