"""Which features do not go together: found by trying, and kept in ``apart.txt`` (``python -m tests.pairs --apart``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from robodyn_cli.over.findings import findings
from tests.pairs.covering import Case, Part
from tests.pairs.judge import write
from tests.pairs.motions import ROWS, scene
from tests.pairs.reasons import reason_of

FILE = Path(__file__).with_name("apart.txt")


def read(row: str) -> dict[frozenset[Part], str]:
    """Return the sets of features that stay apart in a row, with the reason of each."""
    if not FILE.exists():
        return {}
    found = {}
    for line in FILE.read_text(encoding="utf-8").splitlines():
        place, parts, reason = line.split("\t")
        if place == row:
            found[
                frozenset((family, name) for family, _, name in (x.partition("/") for x in parts.split()))
            ] = reason_of(reason) or reason
    return found


def write_all(row: str, apart: Mapping[frozenset[Part], str]) -> None:
    """Replace the lines of a row."""
    every = {name: read(name) for name in ROWS} | {row: dict(apart)}
    lines = [
        f"{name}\t{' '.join(sorted('/'.join(part) for part in group))}\t{reason}"
        for name, groups in every.items()
        for group, reason in groups.items()
    ]
    FILE.write_text("\n".join(sorted(lines)) + "\n", encoding="utf-8")


def refusal(case: Case, commands: Sequence[str], folder: Path) -> str | None:
    """Return why one of the commands refuses a scene before its first step, or None."""
    for command in commands:
        try:
            errors = [f for f in findings(write(scene(case), folder, command)) if f.severity == "error"]
        except Exception as error:
            print("validate", command, case, repr(error), flush=True)
            continue
        if errors:
            return errors[0].message
    return None


def culprit(case: Case, commands: Sequence[str], folder: Path) -> tuple[frozenset[Part], str] | None:
    """Return the least set of a scene's features that are refused together, with the message."""
    message = refusal(case, commands, folder)
    if message is None:
        return None
    for family in list(case):
        fewer = {f: n for f, n in case.items() if f != family}
        other = refusal(fewer, commands, folder)
        if other is not None:
            case, message = fewer, other
    return frozenset(case.items()), reason_of(message) or message.partition(": ")[2]
