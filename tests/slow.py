"""Write which tests are left out of some runs, from the times of a run of all of them.

    python -m pytest -n auto -m 'not benchmarks' --junitxml=times.xml && python tests/slow.py times.xml

Times are those of the processor, which ``conftest.py`` adds to the report, so that other load does not count; they are
about those of an idle core. ``slow.txt``: the functions that ``pytest -m quick`` leaves out, as their first case takes
longer than ``SLOW``, so that the others together stay below 90 s on two cores. ``further.txt``: the cases that ``.ci/run``
leaves to ``.ci/release``, so that what each change waits for takes no more than ``BUDGET``. The longest go first, never the
first of a function; one that brings a value of its own, such as the only one with some method, or is each tenth, counts
``OWN`` of its time.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

SLOW = 0.35  # s
BUDGET = 900.0  # s
SHORT = 0.03  # s: what leaving out shorter ones would give is not worth a line
OWN = 0.2  # part of its time that a case with a value of its own counts
SPREAD = 10  # of many cases each so many counts as one of these: they are a sample of the whole


class Case(NamedTuple):
    """A case of a test function: its name with its function's, its time [s], whether it has a value of its own."""

    name: str
    time: float
    own: bool

    @property
    def weight(self) -> float:
        return self.time * OWN if self.own else self.time


def times(report: Path) -> dict[str, list[Case]]:
    """Return the cases of each function of a JUnit report, in their order."""
    found: dict[str, list[Case]] = {}
    for case in ElementTree.parse(report).iter("testcase"):
        if not case.get("classname"):
            continue  # what could not be collected
        properties = {one.get("name"): one.get("value", "") for one in case.iter("property")}
        name = f"{case.get('classname')}.{case.get('name', '')}"
        time = float(properties.get("processor", case.get("time", "0")))
        cases = found.setdefault(name.partition("[")[0], [])
        cases.append(Case(name, time, "own" in properties or len(cases) % SPREAD == 0))
    return found


def left_to_a_release(taken: dict[str, list[Case]]) -> list[Case]:
    """Return the cases without which the others stay within the budget, or come as near to it as may be."""
    excess = sum(case.time for cases in taken.values() for case in cases) - BUDGET
    later = [case for cases in taken.values() for case in cases[1:] if case.weight > SHORT]
    left: list[Case] = []
    for case in sorted(later, key=lambda case: -case.weight):
        if excess <= 0.0:
            break
        left.append(case)
        excess -= case.time
    return left


def write(name: str, lines: list[str]) -> None:
    """Write a list beside this file, one sorted line each."""
    Path(__file__).with_name(name).write_text(
        "".join(f"{line}\n" for line in sorted(lines)), encoding="utf-8"
    )


if __name__ == "__main__":
    taken = times(Path(sys.argv[1]))
    left = left_to_a_release(taken)
    write("slow.txt", [name for name, cases in taken.items() if cases[0].time > SLOW])
    write("further.txt", [case.name for case in left])
    whole = sum(case.time for cases in taken.values() for case in cases)
    print(f"{whole:.0f} s, without {len(left)} cases {whole - sum(case.time for case in left):.0f} s")
