"""What ``--json`` prints of ``run``, ``check`` and ``validate``: the fields are the documented keys."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.over.batch.compare_records import BaselineReport
from robodyn_cli.over.batch.criteria import Outcome
from robodyn_cli.over.batch.entry import Entry
from robodyn_cli.over.batch.findings import Finding
from robodyn_cli.record import record
from robodyn_cli.results.summary import ABSENT, Absent


@record
class SceneReport:
    """How a scene of a batch ended; seconds : that it took."""

    scene: str
    name: str
    command: str | None
    verdict: str
    exit_code: int
    unchanged: bool
    seconds: float
    message: str | None
    criteria: Sequence[Outcome]
    directory: str | None
    baseline: BaselineReport | Absent

    @staticmethod
    def of(entry: Entry) -> SceneReport:
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


@record
class BatchReport:
    """How a batch ended: the worst exit code."""

    status: str
    exit_code: int
    scenes: Sequence[SceneReport]

    @staticmethod
    def of(entries: Sequence[Entry], exit_code: int) -> BatchReport:
        return BatchReport(_status(exit_code), exit_code, [SceneReport.of(entry) for entry in entries])


@record
class CheckReport:
    """How a result meets its criteria; failed : how many it does not."""

    status: str
    failed: int
    criteria: Sequence[Outcome]

    @staticmethod
    def of(outcomes: Sequence[Outcome]) -> CheckReport:
        failed = sum(not outcome.holds for outcome in outcomes)
        return CheckReport(_status(failed), failed, outcomes)


@record
class SceneFindings:
    """What is wrong with a scene."""

    scene: str
    exit_code: int
    findings: Sequence[Finding]


@record
class ValidationReport:
    """What is wrong with scenes: the worst exit code."""

    status: str
    exit_code: int
    scenes: Sequence[SceneFindings]

    @staticmethod
    def of(scenes: Sequence[SceneFindings], exit_code: int) -> ValidationReport:
        return ValidationReport(_status(exit_code), exit_code, scenes)


def _status(wrong: int) -> str:
    return "failed" if wrong else "ok"
