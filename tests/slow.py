"""Write which tests are left out of some runs, from the times of a run of all of them.

    python -m pytest -n auto -m 'not benchmarks' --junitxml=times.xml && python tests/slow.py times.xml

``slow.txt``: the functions that ``pytest -m quick`` leaves out, as their first case takes longer than ``SLOW``, so that
the others together stay below 90 s. ``further.txt``: the cases that ``.ci/run`` leaves to ``.ci/release``, as they are
beyond the first of their function and take longer than ``LONG``, so that each change waits less.
"""

from __future__ import annotations

import sys
from pathlib import Path
from xml.etree import ElementTree

SLOW, LONG = 0.35, 0.2  # s


def times(report: Path) -> dict[str, dict[str, float]]:
    """Return for each function of a JUnit report how long its cases took [s], in their order."""
    found: dict[str, dict[str, float]] = {}
    for case in ElementTree.parse(report).iter("testcase"):
        name, bracket, rest = case.get("name", "").partition("[")
        if not case.get("classname"):
            continue  # what could not be collected
        found.setdefault(f"{case.get('classname')}.{name}", {})[bracket + rest] = float(case.get("time", 0.0))
    return found


def write(name: str, lines: list[str]) -> None:
    """Write a list beside this file, one sorted line each."""
    Path(__file__).with_name(name).write_text(
        "".join(f"{line}\n" for line in sorted(lines)), encoding="utf-8"
    )


if __name__ == "__main__":
    taken = times(Path(sys.argv[1]))
    write("slow.txt", [name for name, cases in taken.items() if next(iter(cases.values())) > SLOW])
    write("further.txt", [
        name + case for name, cases in taken.items() for case, t in list(cases.items())[1:] if t > LONG
    ])  # fmt: skip
