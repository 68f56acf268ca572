"""The baseline of a batch: a directory of stored results that the runs are compared with, and may replace."""

from __future__ import annotations

import dataclasses
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from robodyn_cli.errors import FAILED, CapabilityError, RobodynError, worst
from robodyn_cli.over.batch.entries import BatchEntry
from robodyn_cli.over.batch.reports import datasets_of
from robodyn_cli.over.batch.stored import Compared, compare_stored, is_run
from robodyn_cli.record import record
from robodyn_cli.results.atomic import discard, output_errors, publish, temporary_path, uninterrupted
from robodyn_cli.results.output_dir import RESULT_NAME, SUMMARY_NAME, set_in_summary
from robodyn_cli.results.summary import as_keys
from robodyn_cli.summaries.checks import BaselineReport

KEY = "baseline"  # of the summary: how the result compares


@record
class Baseline:
    """Stored results in ``directory/<scene>/<command>``.

    out : where the runs write. rtol, atol : as of `compare`. update : replace what differs instead of judging it.

    Raises
    ------
    CapabilityError : there is no such directory, or it is ``out``.
    """

    directory: Path
    out: Path
    rtol: float
    atol: float
    update: bool = False

    def __post_init__(self) -> None:
        if not self.update and not self.directory.is_dir():
            raise CapabilityError(
                f"--baseline: {self.directory} is no directory; --update-baseline makes one of this batch's results"
            )
        if os.path.realpath(self.directory) == os.path.realpath(self.out):
            raise CapabilityError(
                f"--baseline: {self.directory} is where the results of this batch go (--out); name another directory"
            )

    def place(self, entry: BatchEntry) -> Path:
        """Return the directory of a scene's stored result."""
        return self.directory / entry.name / entry.command

    def judge(self, entry: BatchEntry) -> None:
        """Compare the result of a scene with the stored one; a difference is a failure unless it is to be replaced.

        A scene that ended in an error has no result to compare.
        """
        if entry.directory is None or entry.exit_code not in (0, FAILED):
            return
        found = self._compare(entry.directory, entry)
        if found is None:
            return
        entry.baseline = BaselineReport(
            str(self.directory), found.verdict, found.message or None, self.rtol, self.atol,
            datasets_of(found.differing),
        )  # fmt: skip
        if found.verdict != "equal":
            entry.differences = [f"baseline: {line}" for line in found.lines]
        if not self.update:
            # without a stored result nothing is known of this one
            code = FAILED if found.verdict == "extra" else found.exit_code
            entry.exit_code = worst([entry.exit_code, code])

    def _compare(self, directory: Path, entry: BatchEntry) -> Compared | None:
        """Return how the result of a run compares; None where it is right that there are none."""
        place, name = self.place(entry), f"{entry.name}/{entry.command}"
        if entry.has_result and is_run(place):
            return compare_stored(name, directory, place, rtol=self.rtol, atol=self.atol)
        if entry.has_result:
            return Compared(
                name, "extra", f"no result of it in {self.directory}; --update-baseline stores this one"
            )
        if is_run(place):
            return Compared(
                name, "missing", f"the run leaves no result, but there is one in {self.directory}"
            )
        return None

    def replace_old(self, entries: Sequence[BatchEntry]) -> list[BatchEntry]:
        """Put the results of scenes that ended well in the place of stored ones that differ: all, or none.

        Returns
        -------
        The scenes whose stored result is a new one.

        Raises
        ------
        OutputError : a file cannot be written; the baseline is as it was.
        """
        changed = [e for e in entries if e.verdict == "ok" and e.baseline and e.baseline.verdict != "equal"]
        copies: dict[Path, Path] = {}
        try:
            for entry in changed:
                copies |= _copied(entry, self.place(entry))
            with uninterrupted():
                for entry in changed:
                    _put(copies, self.place(entry))
        finally:
            for copy in copies.values():
                discard(copy)
        for entry in changed:
            assert entry.baseline is not None
            entry.baseline = dataclasses.replace(entry.baseline, updated=True)
        for entry in entries:
            note(entry)
        return changed


def _copied(entry: BatchEntry, place: Path) -> dict[Path, Path]:
    """Copy what a run left beside where it goes; return the copy by its target, nothing where the run left nothing."""
    if not entry.has_result:
        return {}
    assert entry.directory is not None
    # the result file holds the summary too
    name = RESULT_NAME if (entry.directory / RESULT_NAME).exists() else SUMMARY_NAME
    copy = temporary_path(place / name)
    with output_errors(place / name):
        try:
            place.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(entry.directory / name, copy)
        except BaseException:
            discard(copy)
            raise
    return {place / name: copy}


def _put(copies: Mapping[Path, Path], place: Path) -> None:
    """Put the copies for a directory in the place of what is there; a file without a copy belongs to another run."""
    for target in (place / SUMMARY_NAME, place / RESULT_NAME):
        with output_errors(target):
            if target in copies:
                publish(copies[target], target)
            else:
                target.unlink(missing_ok=True)


def note(entry: BatchEntry) -> None:
    """Store how a result compares in its summary, where reports find it; if it was not compared, nothing stands there.

    A result that is kept from an earlier batch may say how it compared then.
    """
    if not entry.has_result:
        return
    assert entry.directory is not None
    try:
        set_in_summary(entry.directory, KEY, None if entry.baseline is None else as_keys(entry.baseline))
    except RobodynError as error:
        entry.exit_code, entry.message = worst([entry.exit_code, error.exit_code]), error.message
