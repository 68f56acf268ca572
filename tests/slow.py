"""Write ``tests/slow.txt``, the test functions that ``pytest -m quick`` leaves out, from the times of a run of all tests.

    python -m pytest -n auto --junitxml=times.xml && python tests/slow.py times.xml [SECONDS]

A function is slow if its first case takes longer than SECONDS (default 0.35, so that the others together stay below
90 s).
"""

from __future__ import annotations

import sys
from pathlib import Path
from xml.etree import ElementTree

LIST = Path(__file__).with_name("slow.txt")


def slow(report: Path, limit: float) -> list[str]:
    """Return the functions of a JUnit report whose first case takes longer than the limit [s]."""
    first: dict[str, float] = {}
    for case in ElementTree.parse(report).iter("testcase"):
        name = f"{case.get('classname')}.{case.get('name', '').partition('[')[0]}"
        first.setdefault(name, float(case.get("time", 0.0)))
    return sorted(name for name, seconds in first.items() if seconds > limit)


if __name__ == "__main__":
    found = slow(Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 0.35)
    LIST.write_text("\n".join(found) + "\n", encoding="utf-8")
