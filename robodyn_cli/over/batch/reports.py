"""What commands on many scenes print (records, comparisons and reports in JSON, Markdown and JUnit), and the baseline
that their results are compared with."""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

from robodyn_cli.errors import FAILED, CapabilityError, RobodynError, of_option, worst
from robodyn_cli.over.batch.entries import BatchEntry
from robodyn_cli.over.batch.stored import Compared, compare_stored, is_run
from robodyn_cli.record import record
from robodyn_cli.results.atomic import (
    discard,
    output_errors,
    publish,
    temporary_path,
    uninterrupted,
    write_bytes,
)
from robodyn_cli.results.compare import Comparison, Difference
from robodyn_cli.results.output_dir import RESULT_NAME, SUMMARY_NAME, set_in_summary
from robodyn_cli.results.summary import as_keys
from robodyn_cli.summaries import checks
from robodyn_cli.summaries.checks import BaselineReport
from robodyn_cli.summaries.facts import ABSENT


def batch_of(entries: Sequence[BatchEntry], exit_code: int) -> checks.BatchReport:
    """Return how a batch ended."""
    return checks.BatchReport(_status(exit_code), exit_code, [_scene(entry) for entry in entries])


def _scene(entry: BatchEntry) -> checks.SceneReport:
    return checks.SceneReport(
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


def check_of(criteria: list[checks.JudgedCriterion]) -> checks.CheckReport:
    """Return how a result meets its criteria."""
    failed = sum(not criterion.holds for criterion in criteria)
    return checks.CheckReport(_status(failed), failed, criteria)


def validation_of(scenes: list[checks.SceneFindings], exit_code: int) -> checks.ValidationReport:
    """Return what is wrong with scenes."""
    return checks.ValidationReport(_status(exit_code), exit_code, scenes)


def _status(wrong: int) -> str:
    return "failed" if wrong else "ok"


def datasets_of(items: Iterable[Difference]) -> list[checks.DatasetReport]:
    """Return how datasets compare."""
    return [_dataset(item) for item in items]


def _dataset(item: Difference) -> checks.DatasetReport:
    if item.verdict not in ("equal", "differs"):
        return checks.DatasetReport(item.path, item.verdict, detail=item.detail or ABSENT)
    return checks.DatasetReport(
        item.path, item.verdict, item.error, item.ratio, item.value, item.expected, item.time,
        item.column or None, item.stated, item.within_stated,
    )  # fmt: skip


def comparison_of(comparison: Comparison, rtol: float, atol: float) -> checks.ComparisonReport:
    """Return what ``compare`` says of two results."""
    return checks.ComparisonReport(
        "ok" if comparison.agrees else "failed", rtol, atol, datasets_of(comparison.differences)
    )


def trees_of(compared: Sequence[Compared], rtol: float, atol: float) -> checks.TreeReport:
    """Return what ``compare`` says of two directories with results."""
    code = worst(item.exit_code for item in compared)
    results = [
        checks.ResultReport(item.name, item.verdict, item.message or None, datasets_of(item.differing))
        for item in compared
    ]
    return checks.TreeReport("failed" if code else "ok", code, rtol, atol, results)


# characters that XML 1.0 has no way to write
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_reports(entries: Sequence[BatchEntry], junit_file: Path | None, markdown_file: Path | None) -> None:
    """Write the reports that are asked for."""
    if junit_file is not None:
        write_bytes(junit_file, junit(entries))
    if markdown_file is not None:
        write_bytes(markdown_file, markdown(entries).encode(errors="backslashreplace"))


def tally(entries: Sequence[BatchEntry]) -> str:
    """Return ``9 scenes: 7 ok (2 unchanged), 1 failed, 1 error``."""
    count = {
        verdict: sum(e.verdict == verdict for e in entries)
        for verdict in ("ok", "failed", "error", "stopped")
    }
    unchanged = sum(e.unchanged for e in entries)
    parts = [f"{n} {verdict}" for verdict, n in count.items() if n]
    note = f" ({unchanged} unchanged)" if unchanged else ""
    return f"{len(entries)} scene{'s' if len(entries) != 1 else ''}: {', '.join(parts)}{note}"


def junit(entries: Sequence[BatchEntry]) -> bytes:
    """Return a JUnit report: a test case a scene; criteria are failures, everything else that is wrong an error.

    Elements and attributes are those of the schema by which Jenkins' xUnit plugin checks reports (junit-10.xsd); the
    other readers are not so strict.
    """
    count = {
        verdict: sum(e.verdict == verdict for e in entries) for verdict in ("failed", "error", "stopped")
    }
    totals = {
        "tests": str(len(entries)), "failures": str(count["failed"]), "errors": str(count["error"]),
        "time": f"{sum(e.seconds for e in entries):.3f}",
    }  # fmt: skip
    root = ElementTree.Element("testsuites", {"name": "robodyn", **totals})
    suite = ElementTree.SubElement(
        root, "testsuite", {"name": "robodyn run", **totals, "skipped": str(count["stopped"])}
    )
    for e in entries:
        case = ElementTree.SubElement(
            suite, "testcase",
            {"name": _clean(e.name), "classname": f"robodyn.{e.command or 'scene'}", "time": f"{e.seconds:.3f}"},
        )  # fmt: skip
        if e.verdict == "stopped":
            ElementTree.SubElement(case, "skipped", {"message": "stopped before it was done"})
        elif e.verdict != "ok":
            kind = "failure" if e.verdict == "failed" else "error"
            problems = [_clean(text) for text in e.problems]
            node = ElementTree.SubElement(
                case,
                kind,
                {
                    "message": problems[0] if problems else f"exit code {e.exit_code}",
                    "type": f"exit code {e.exit_code}",
                },
            )
            node.text = "\n".join(problems)
        note = "\nunchanged: the result of an earlier run" if e.unchanged else ""
        ElementTree.SubElement(case, "system-out").text = f"{_clean(str(e.path))}{note}"
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _clean(text: str) -> str:
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)


def markdown(entries: Sequence[BatchEntry]) -> str:
    """Return a summary for people: a table of the scenes, what is wrong with them, and the criteria."""
    lines = ["# robodyn run", "", f"{tally(entries)}.", "", "| scene | command | result | exit code | time |"]
    lines += ["|---|---|---|---|---|"]
    for e in entries:
        verdict = f"{e.verdict} (unchanged)" if e.unchanged else e.verdict
        shown = verdict if e.verdict == "ok" else f"**{verdict}**"
        lines.append(_row(e.name, e.command or "-", shown, str(e.exit_code), f"{e.seconds:.2f} s"))
    wrong = [e for e in entries if e.problems and e.verdict != "ok"]
    if wrong:
        lines += ["", "## Problems", ""]
        lines += [f"- {_cell(e.name)}: {_cell(text)}" for e in wrong for text in e.problems]
    if any(e.criteria for e in entries):
        lines += ["", "## Criteria", "", "| scene | key | found | expected | |", "|---|---|---|---|---|"]
        for e in entries:
            for o in e.criteria:
                lines.append(
                    _row(e.name, f"`{o.key}`", o.shown, o.expected, "ok" if o.holds else "**failed**")
                )
    return "\n".join(lines) + "\n"


def _row(*cells: str) -> str:
    return "| " + " | ".join(_cell(cell) for cell in cells) + " |"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


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
            raise of_option(
                "--baseline",
                f"{self.directory} is no directory; --update-baseline makes one of this batch's results",
                CapabilityError,
            )
        if os.path.realpath(self.directory) == os.path.realpath(self.out):
            raise of_option(
                "--baseline",
                f"{self.directory} is where the results of this batch go (--out); name another directory",
                CapabilityError,
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
        compared = self._compare(entry.directory, entry)
        if compared is None:
            return
        entry.baseline = BaselineReport(
            str(self.directory), compared.verdict, compared.message or None, self.rtol, self.atol,
            datasets_of(compared.differing),
        )  # fmt: skip
        if compared.verdict != "equal":
            new = self.update and compared.verdict == "extra"
            entry.differences = [f"baseline: {line}" for line in (["new"] if new else compared.lines)]
        if not self.update:
            # without a stored result nothing is known of this one
            code = FAILED if compared.verdict == "extra" else compared.exit_code
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


def updates_of(entries: Sequence[BatchEntry], stored: Sequence[BatchEntry]) -> str:
    """Return what an update of a baseline did, ``2 new, 1 replaced, 5 equal, 1 left as it is, for it did not end well:
    a``."""
    new = sum(e.baseline is not None and e.baseline.verdict == "extra" for e in stored)
    equal = sum(
        e.verdict == "ok" and e.baseline is not None and e.baseline.verdict == "equal" for e in entries
    )
    left = [e.name for e in entries if e.verdict != "ok"]
    counts = {"new": new, "replaced": len(stored) - new, "equal": equal}
    parts = [f"{n} {what}" for what, n in counts.items() if n]
    if left:
        parts.append(
            f"{len(left)} left as {'they were' if len(left) > 1 else 'it was'}, not ok: {', '.join(left)}"
        )
    return ", ".join(parts) or "nothing to store"


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
