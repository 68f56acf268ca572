"""Write the tables of summary keys in docs/cli.md, and of datasets and attributes in docs/hdf5.md, from what declares
them.

    python docs/make_summary_reference.py            rewrite the tables
    python docs/make_summary_reference.py --check    exit 1 if a table is out of date

A table stands between ``<!-- summary: MODULE:RECORD -->``, ``<!-- datasets: GROUP -->`` ``<!-- format: attributes
-->`` or ``<!-- headlines -->`` and ``<!-- end -->``; the text around it is written by hand.
"""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

from robodyn_cli.commands import COMMANDS
from robodyn_cli.results.catalogue import ATTRIBUTES, GROUPS
from robodyn_cli.results.stated_errors import error_places
from robodyn_cli.summaries.facts import Fact
from robodyn_cli.summaries.keys import fields_at, leaves_of

PAGE, FILES = (Path(__file__).parent / name for name in ("cli.md", "hdf5.md"))
TABLE = re.compile(r"(<!-- summary: (\w+:\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
ATTRIBUTE_TABLE = re.compile(r"(<!-- format: attributes -->\n).*?(<!-- end -->)", re.DOTALL)
HEADLINES = re.compile(r"(<!-- headlines -->\n).*?(<!-- end -->)", re.DOTALL)
DATASETS = re.compile(r"(<!-- datasets: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def table(place: str) -> str:
    """Return the table of the keys of a record, those of the records in it behind each."""
    rows = ["| key | unit | meaning | error |", "|---|---|---|---|"]
    rows += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in _rows(place, "")]
    return "\n".join(rows) + "\n"


def dataset_table(group: str) -> str:
    """Return the table of a group of datasets."""
    rows = ["| path | dimensions | units | meaning | error |", "|---|---|---|---|---|"]
    for entry in GROUPS[group]:
        errors = ", ".join(f"`{place}`" for place in error_places(entry.path))
        rows.append(
            f"| `/{entry.path}` | {', '.join(entry.dims)} | {entry.units} | {entry.long_name} | {errors} |"
        )
    return "\n".join(rows) + "\n"


def attribute_table() -> str:
    """Return the table of the attributes of a file's root."""
    rows = ["| attribute | kind | meaning |", "|---|---|---|"]
    rows += [f"| `{entry.name}` | {entry.kind} | {entry.meaning} |" for entry in ATTRIBUTES]
    return "\n".join(rows) + "\n"


def headline_table() -> str:
    """Return the table of the keys by which the results of commands are told, with the words for them."""
    rows = ["| command | told by |", "|---|---|"]
    for name, row in COMMANDS.items():
        leaves = {".".join(steps): leaf for steps, leaf in leaves_of(name)} if row.headlines else {}
        told = ", ".join(f"{leaves[key].fact.column} (`{key}`)" for key in row.headlines)
        rows += [f"| `{name}` | {told} |"] if told else []
    return "\n".join(rows) + "\n"


def _rows(place: str | type, path: str) -> Iterator[tuple[str, str, str, str]]:
    for name, (kind, fact) in fields_at(place).items():
        yield from _of_field(f"{path}{name}", kind, fact)


def _of_field(key: str, kind: Any, fact: Fact) -> Iterator[tuple[str, str, str, str]]:
    """Yield the row of a field, and those of the records that it holds."""
    unit = str(fact.unit) if _inner(kind) & {float, int} else ""
    beside = key.rpartition(".")[0]
    errors = ", ".join(f"`{beside if error[0] == '.' else ''}{error}`" for error in fact.errors)
    yield f"`{_with_names(key, kind, fact)}`", unit, fact.doc, errors
    for below, record in _records(key, kind, fact):
        yield from _rows(record, f"{below}.")


def _inner(kind: Any) -> set[Any]:
    """Return the types that a value may have, in lists and maps too."""
    return {kind, *(x for inner in get_args(kind) for x in _inner(inner))}


def _with_names(key: str, kind: Any, fact: Fact) -> str:
    """Return a key as it is written where it stands for a value in a map."""
    plain = any(get_origin(one) is dict and one in (dict[str, float], dict[str, int]) for one in _inner(kind))
    return f"{key}.{fact.names[0]}" if plain and len(fact.names) == 1 else key


def _records(key: str, kind: Any, fact: Fact) -> Iterator[tuple[str, type]]:
    """Yield the records that a value holds, each with the key that leads to it."""
    if dataclasses.is_dataclass(kind):
        yield key, kind  # type: ignore[misc]
    elif get_origin(kind) is dict:
        name = fact.names[0] if fact.names[0].isupper() else "NAME"
        yield from _records(f"{key}.{name}", get_args(kind)[1], fact)
    elif get_origin(kind) is list:
        yield from _records(f"{key}.N", get_args(kind)[0], fact)
    else:
        for inner in get_args(kind):
            yield from _records(key, inner, fact)


def rewritten(text: str) -> str:
    """Return a page with its tables made anew."""
    text = TABLE.sub(lambda m: m.group(1) + table(m.group(2)) + m.group(3), text)
    text = HEADLINES.sub(lambda m: m.group(1) + headline_table() + m.group(2), text)
    text = ATTRIBUTE_TABLE.sub(lambda m: m.group(1) + attribute_table() + m.group(2), text)
    return DATASETS.sub(lambda m: m.group(1) + dataset_table(m.group(2)) + m.group(3), text)


def main(arguments: list[str]) -> int:
    """Rewrite the pages, or check them."""
    pages = {page: page.read_text(encoding="utf-8") for page in (PAGE, FILES)}
    if arguments == ["--check"]:
        return int(any(rewritten(text) != text for text in pages.values()))
    for page, text in pages.items():
        page.write_text(rewritten(text), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
