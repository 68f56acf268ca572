"""Write the tables of datasets and attributes in docs/hdf5.md from the catalogue of the format.

    python docs/make_hdf5_reference.py            rewrite the tables
    python docs/make_hdf5_reference.py --check    exit 1 if a table is out of date

A table stands between ``<!-- catalogue: NAME -->`` and ``<!-- end -->``; the text around it is written by hand.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from robodyn_cli.results.catalogue import ATTRIBUTES, ENTRIES, EVENT_ENTRIES

PAGE = Path(__file__).parent / "hdf5.md"
TABLE = re.compile(r"(<!-- catalogue: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Yield the rows of a table, its heading first."""
    if name == "attributes":
        yield "attribute", "kind", "meaning"
        yield from ((f"`{one.name}`", one.kind, one.meaning) for one in ATTRIBUTES)
        return
    yield "path", "dimensions", "units", "meaning"
    for entry in (*ENTRIES, *EVENT_ENTRIES):
        yield f"`/{entry.path}`", ", ".join(entry.dims), entry.units, entry.long_name


def table(name: str) -> str:
    """Return a table of the page."""
    heading, *others = rows(name)
    rule = "|---" * len(heading) + "|"
    lines = [f"| {' | '.join(cells)} |" for cells in (heading, *others)]
    return "\n".join([lines[0], rule, *lines[1:]]) + "\n"


def rewritten(text: str) -> str:
    """Return the page with its tables made anew."""
    return TABLE.sub(lambda m: m.group(1) + table(m.group(2)) + m.group(3), text)


def main(arguments: list[str]) -> int:
    """Rewrite the page, or check it."""
    old = PAGE.read_text(encoding="utf-8")
    new = rewritten(old)
    if arguments == ["--check"]:
        return int(old != new)
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
