"""More than CI has time for.

    python -m tests.pairs --sets 3 --seconds 600 --seed 1            triples, in an order by the seed
    python -m tests.pairs --sets 2 --row inverse                     each pair alone
    python -m tests.pairs --array                                    the covering arrays, of which CI runs a part
    python -m tests.pairs --apart                                    write apart.txt, after a change of what is refused

Findings are printed by their class, with the first scene of each, and written to ``--out``.
"""

from __future__ import annotations

import argparse
import collections
import os
import random
import re
import sys
import tempfile
import time
from pathlib import Path

from tests.fuzz.cases import _clock
from tests.pairs.apart import culprit, read, write_all
from tests.pairs.covering import Case, covering, sets_of
from tests.pairs.judge import judged, write
from tests.pairs.motions import MOST, ROWS, families, scene

TOO_LONG = 60.0  # s, of one run


def campaign(row: str, cases: list[Case], until: float, folder: Path, out: Path) -> bool:
    """Run scenes by the commands of a row; print what must not be. Return whether there was anything."""
    seen: dict[str, int] = {}
    codes: collections.Counter[str] = collections.Counter()
    for case in cases:
        for command in ROWS[row][0]:
            if time.monotonic() > until:
                break
            tree = scene(case)
            try:
                with _clock(TOO_LONG):
                    done, found = judged(tree, command, folder)
            except KeyboardInterrupt:
                done, found = None, [f"{command} takes longer than {TOO_LONG:g} s"]
            if done is not None and done.code == 130:
                found = [f"{command} takes longer than {TOO_LONG:g} s"]
            codes[f"{command} {done.code if done else 'slow'}"] += 1
            for text in found:
                kind = re.sub(r"'[^']*'|-?\d+(\.\d+)?(e-?\d+)?", "*", text)[:120]
                seen[kind] = seen.get(kind, 0) + 1
                if seen[kind] == 1:
                    print(
                        f"{command} {' '.join('/'.join(x) for x in case.items())}\n    {text[:600]}",
                        flush=True,
                    )
                    write(tree, out / f"{command}-{len(seen)}", command)
    print(row, dict(sorted(codes.items())), {kind: n for kind, n in seen.items() if n > 1})
    return bool(seen)


def settle(row: str, folder: Path) -> None:
    """Find the sets of features that a row's commands refuse together, until the covering array has none of them."""
    apart = dict(read(row))
    while True:
        added = 0
        for case in covering(families(row), list(apart), MOST[row]):
            if any(group <= set(case.items()) for group in apart):
                continue
            group = culprit(case, ROWS[row][0], folder)
            if group is not None:
                apart[group[0]] = group[1]
                added += 1
                write_all(row, apart)  # it takes minutes, and may be stopped
                print(row, sorted(group[0]), group[1][:150], flush=True)
        if not added:
            break


def main() -> int:
    """Run; return 1 where something was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.pairs", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    parser.add_argument("--sets", type=int, default=3)
    parser.add_argument("--triples", dest="sets", action="store_const", const=3)
    parser.add_argument("--array", action="store_true")
    parser.add_argument("--row", choices=list(ROWS), action="append")
    parser.add_argument("--apart", action="store_true")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "robodyn-pairs")
    arguments = parser.parse_args()
    os.environ["ROBODYN_DEBUG"] = "1"
    found, rows = False, arguments.row or list(ROWS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "scene"
        for row in rows:
            if arguments.apart:
                settle(row, folder)
                continue
            if arguments.array:
                cases = covering(families(row), list(read(row)), MOST[row])
            else:
                cases = [dict(parts) for parts in sets_of(families(row), arguments.sets)]
                random.Random(arguments.seed).shuffle(cases)
            until = time.monotonic() + arguments.seconds / len(rows)
            found |= campaign(row, cases, until, folder, arguments.out)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
