"""Whether the quick tests see deliberate faults in the modules that make figures.

    python -m tests.mutants                               all of list.txt; an hour or so
    python -m tests.mutants --only drives/ --only error   those with such text in file or function
    python -m tests.mutants.propose 20 --seed 2           new ones for the list

Needs Python 3.11. Mutants that the list marks as equivalent are passed over; lines that are gone are told (``--check``: no
more than that). One that makes a test run without end counts as caught. The outcomes go to ``results.txt`` in ``--out``, a line
each; a mutant whose outcome is there is not tried again, and with ``--again`` those are that were not caught.
``reach.json`` there keeps what tests call: remove the directory after larger changes.
"""

from __future__ import annotations

import argparse
import collections
import sys
from pathlib import Path

import pytest

from tests.mutants.listed import Mutant, listed
from tests.mutants.rooms import tests
from tests.mutants.runner import Outcome, Runner

REQUIRED = 0.95  # of the mutants that are faults


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", action="append", default=[])
    parser.add_argument("--out", type=Path, default=Path("outputs/mutants"))
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--check", action="store_true")
    asked = parser.parse_args()
    if asked.check:
        gone = [x for x in listed() if x.is_gone]
        print("\n".join(map(str, gone)) or "every line is there")
        return 1 if gone else 0
    asked.out.mkdir(parents=True, exist_ok=True)
    results = asked.out / "results.txt"
    known = _read(results)
    faults = [
        x for x in listed() if not x.equivalent and (not asked.only or any(y in x.place for y in asked.only))
    ]
    left = [x for x in faults if _name(x) not in known or (asked.again and known[_name(x)] != "caught")]

    def tell(mutant: Mutant, outcome: Outcome) -> None:
        known[_name(mutant)] = outcome.verdict
        line = f"{outcome.verdict}\t{_name(mutant)}\t{outcome.seconds:.1f} s\t{outcome.test}"
        print(line, flush=True)
        with results.open("a", encoding="utf-8") as stream:
            stream.write(line + "\n")

    if left:
        words = ["-q", "-s", "-p", "no:cacheprovider", *tests({x.file for x in left})]
        pytest.main(words, plugins=[Runner(left, asked.out, tell)])
    verdicts = collections.Counter(known.get(_name(x), "not tried") for x in faults)
    for mutant in faults:
        if known.get(_name(mutant)) != "caught":
            print(f"\n{known.get(_name(mutant), 'not tried')}: {mutant}", end="")
    share = (verdicts["caught"] + verdicts["timeout"]) / max(len(faults) - verdicts["gone"], 1)
    print(f"\n{len(faults)} faults: {dict(verdicts)}, {share:.1%} caught")
    return 0 if share >= REQUIRED else 1


def _name(mutant: Mutant) -> str:
    """Return a mutant in a line."""
    return f"{mutant.place}: {mutant.line} -> {mutant.becomes}"


def _read(results: Path) -> dict[str, str]:
    """Return the last verdicts of earlier runs."""
    if not results.exists():
        return {}
    rows = [line.split("\t") for line in results.read_text(encoding="utf-8").splitlines()]
    return {row[1]: row[0] for row in rows}


if __name__ == "__main__":
    sys.exit(main())
