"""Paste what the benchmarks printed into the pages that show it.

    python benchmarks/throughput.py > RUNS/throughput.txt      (and so on for the others)
    python docs/make_benchmarks.py RUNS

A page says where: ``<!-- throughput 1 -->`` stands before the first table that ``throughput.txt`` holds, and
``<!-- loops all -->`` before everything below the line on the machine, up to the next heading. Pages keep what they
have where RUNS has no such file. The words around the tables are written by hand: read them again.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

DOCS = Path(__file__).parent
PAGES = ("benchmarks.md", "benchmarks-rows.md", "choosing-an-integrator.md")
MARK = re.compile(r"<!-- (\w+) (\d+|all) -->\n\n?")


def tables(text: str) -> list[str]:
    """Return the Markdown tables of a text."""
    return re.findall(r"(?:^\|.*\n)+", text + "\n", re.MULTILINE)


def body(text: str) -> str:
    """Return a text from its first blank line on."""
    return text.partition("\n\n")[2].strip() + "\n"


def filled(page: str, runs: Path) -> str:
    """Return a page with what the runs printed behind its marks.

    Raises
    ------
    SystemExit : a run has fewer tables than the page shows.
    """
    out, place = [], 0
    for mark in MARK.finditer(page):
        name, which = mark.groups()
        path = runs / f"{name}.txt"
        if not path.exists():
            continue
        text = path.read_text(encoding="utf-8")
        rest = page[mark.end() :]
        if which == "all":
            new, old = body(text), re.split(r"^#", rest, maxsplit=1, flags=re.MULTILINE)[0]
            new += "\n" if len(old) < len(rest) else ""
        else:
            found = tables(text)
            if len(found) < int(which):
                raise SystemExit(f"{path} has {len(found)} tables, and the page shows its table {which}")
            new, old = found[int(which) - 1], (re.match(r"(?:\|.*\n)*", rest) or [""])[0]
        out += [page[place : mark.end()], new]
        place = mark.end() + len(old)
    return "".join([*out, page[place:]])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", type=Path, help="folder with the outputs, NAME.txt of benchmarks/NAME.py")
    runs = parser.parse_args().runs
    for name in PAGES:
        page = DOCS / name
        page.write_text(filled(page.read_text(encoding="utf-8"), runs), encoding="utf-8")


if __name__ == "__main__":
    main()
