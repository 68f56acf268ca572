"""One scene of a batch: what is to be run, and what became of it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from robodyn_cli.exit_codes import FAILED
from robodyn_cli.record import mutable_record
from robodyn_cli.summaries.checks import BaselineReport, JudgedCriterion

if TYPE_CHECKING:
    from robodyn_cli.scene.types import Scene


@mutable_record
class Entry:
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
        found = [str(outcome) for outcome in self.criteria if not outcome.holds]
        return [*([self.message] if self.message else []), *found, *self.differences]
