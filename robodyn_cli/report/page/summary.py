"""The summary of a result as tables: numbers with unit and error, what is nested in tables of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.report.cells import is_number
from robodyn_cli.report.figures import shown_errors, shown_units
from robodyn_cli.report.page.tables import MOST_ROWS, Html, Quantity, element, named, table, written
from robodyn_cli.results.result import Result

UnitOfKey = Callable[[str], str]
ErrorsOfKey = Callable[[str], Sequence[str]]
EACH = " and "  # between the units of the numbers of a list
BROAD = 12  # columns of a table, to which nested values of a list are spread
FEW = 4  # rows that stand side by side where they have more columns than that
# told elsewhere on the page
APART = ("status", "command", "title", "definitions", "outputs", "scene_file", "run_id", "warnings")
Row = tuple[tuple[str, ...], Mapping[str, Any]]


def no_errors(key: str) -> Sequence[str]:
    """Return the keys that state the error of a key where none is declared."""
    return ()


@record
class SummaryReading:
    """A summary whose numbers get their units and errors from declarations.

    numbers : what stands under each key, whole. beside : keys of errors that stand beside the figures they are of.
    """

    unit_of: UnitOfKey
    errors_of: ErrorsOfKey
    numbers: Mapping[str, Any]
    beside: set[str]

    def value(self, value: Any, key: str = "", own: str = "") -> Any:
        """Return a value with its numbers as quantities; own : the unit that the nearest map around it names."""
        if isinstance(value, Mapping):
            own = str(value["unit"]) if isinstance(value.get("unit"), str) else own
            return {
                name: self.value(item, f"{key}.{name}" if key else name, own) for name, item in value.items()
            }
        if isinstance(value, list | tuple) and any(
            isinstance(item, Mapping | list | tuple) for item in value
        ):
            return [self.value(item, f"{key}.{k}", own) for k, item in enumerate(value)]
        first = value[0] if isinstance(value, list | tuple) and value else value
        if isinstance(first, bool) or not isinstance(first, int | float):
            return value
        return self._quantity(value, f"{key}.0" if first is not value else key, own)

    def _quantity(self, value: Any, key: str, own: str) -> Any:
        symbol, error = self.unit_of(key), self._error(key)
        symbol = own if "unit" in symbol else symbol
        symbol = "" if symbol == "1" else symbol
        if isinstance(value, list | tuple) and len(units := symbol.split(EACH)) > 1:
            return [
                Quantity(x, "" if one == "1" else one) if one != "1" else x
                for x, one in zip(value, units, strict=True)
            ]
        return Quantity(value, symbol, error) if symbol or error is not None else value

    def _error(self, key: str) -> float | None:
        """Return the largest error that is stated of a key, and note those that need no place of their own."""
        keys = [one for one in self.errors_of(key) if one in self.numbers]
        head = key.partition(".")[0]
        self.beside.update(one for one in keys if one != head and one.partition(".")[0] == head)
        return max((self.numbers[one] for one in keys if is_number(self.numbers[one])), default=None)

    def without_beside(self, value: Any, key: str = "") -> Any:
        """Return a value without what stands beside the figures: errors, units of nested maps."""
        if isinstance(value, list):
            return [self.without_beside(item, f"{key}.{k}") for k, item in enumerate(value)]
        if not isinstance(value, Mapping):
            return value
        kept = {}
        for name, item in value.items():
            place = f"{key}.{name}" if key else name
            if place in self.beside or (key and name in ("unit", "units") and _names_units(value, name)):
                continue
            left = self.without_beside(item, place)
            if left != {} or item == {}:
                kept[name] = left
        return kept


def _names_units(value: Mapping[str, Any], name: str) -> bool:
    """Tell whether the numbers of a map have the unit beside them that an entry of it names."""
    if isinstance(value[name], Mapping):
        return all(isinstance(x, str) for x in value[name].values())
    return any(isinstance(x, Quantity) and x.unit == value[name] for x in _all_of(value))


def _all_of(value: Any) -> Iterator[Any]:
    if isinstance(value, Mapping):
        for item in value.values():
            yield from _all_of(item)
    else:
        yield value


def _numbers(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _numbers(item, f"{key}.{name}" if key else name)
    elif isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
        for k, item in enumerate(value):
            yield from _numbers(item, f"{key}.{k}")
    else:
        yield key, value


def told(
    summary: Mapping[str, Any], unit_of: UnitOfKey, errors_of: ErrorsOfKey = no_errors
) -> dict[str, Any]:
    """Return what a summary says, its numbers as quantities; what is told elsewhere on a page is left out."""
    wanted = {key: value for key, value in summary.items() if key not in APART}
    # no yield was asked for, and the scene's criteria are of the scene as it stands
    share = wanted.get("yield")
    if isinstance(share, Mapping) and share.get("share") == 0.0 and "least_yield" not in wanted:
        del wanted["yield"]
    facts = SummaryReading(unit_of, errors_of, dict(_numbers(summary)), set())
    found: dict[str, Any] = facts.without_beside(facts.value(wanted))
    return found


def told_of(result: Result) -> dict[str, Any]:
    """Return what the summary of a result says, its numbers as quantities."""
    return told(result.summary, shown_units(result), shown_errors(result))


def summary_tables(
    summary: Mapping[str, Any], unit_of: UnitOfKey, errors_of: ErrorsOfKey = no_errors
) -> list[Html]:
    """Return the tables of a summary: its plain entries first, then one for each entry that holds several.

    unit_of : the unit of a key, empty where there is none to show. errors_of : the keys that state its error.
    """
    definitions = summary.get("definitions")
    meaning = definitions if isinstance(definitions, Mapping) else {}
    parts = _entry_tables(told(summary, unit_of, errors_of), is_open=True)
    if meaning:
        rows = [(named(key), text) for key, text in meaning.items()]
        parts.append(folded("definitions", [table(("", ""), rows)], is_open=False))
    return parts


def _entry_tables(facts: Mapping[str, Any], is_open: bool) -> list[Html]:
    """Return the table of the plain entries, and below it those of the others, which can be folded away."""
    nested = {key: value for key, value in facts.items() if _holds_several(value)}
    plain = [(named(key), _ranged(key, value)) for key, value in facts.items() if key not in nested]
    parts = [table(("", ""), plain)] if plain else []
    for keys in _alike(nested):
        if len(keys) > 1:
            names = list(nested[keys[0]])
            rows = [[name, *(nested[key][name] for key in keys)] for name in names]
            heads = [named(key) for key in keys]
            parts.append(folded(", ".join(heads), [first_rows(["", *heads], rows)], is_open))
        else:
            parts.append(folded(named(keys[0]), _nested(nested[keys[0]]), is_open))
    return parts


def _alike(nested: Mapping[str, Any]) -> list[list[str]]:
    """Return the keys of nested entries, those of plain maps with the same names together."""
    groups: dict[Any, list[str]] = {}
    for key, value in nested.items():
        plain = isinstance(value, Mapping) and not any(map(_holds_several, value.values()))
        groups.setdefault(tuple(value) if plain else (None, key), []).append(key)
    return list(groups.values())


def _holds_several(value: Any) -> bool:
    if isinstance(value, Mapping):
        return len(value) > 0
    return (
        isinstance(value, Sequence)
        and not isinstance(value, str)
        and any(isinstance(x, Mapping | list | tuple) for x in value)
    )


def _nested(value: Any) -> list[Html]:
    if isinstance(value, Mapping):
        if all(isinstance(item, Mapping) and item for item in value.values()):
            return _records([((name,), item) for name, item in value.items()])
        return _entry_tables(value, is_open=False)
    if all(isinstance(item, Mapping) for item in value):
        return [_listed(value)]
    return [_matrix(value)]


def _matrix(value: Sequence[Any]) -> Html:
    """Return a list of lists as rows and columns with their numbers."""
    rows = [item if isinstance(item, list | tuple) else [item] for item in map(_spread_list, value)]
    width = max(len(row) for row in rows)
    head = ["", *map(str, range(1, width + 1))]
    cells = [[str(k), *row, *[""] * (width - len(row))] for k, row in enumerate(rows, 1)]
    return first_rows(head, cells)


def _spread_list(value: Any) -> Any:
    if isinstance(value, Quantity) and isinstance(value.value, list | tuple):
        return [Quantity(x, value.unit, value.error) for x in value.value]
    return value


def _records(rows: list[Row]) -> list[Html]:
    """Return the tables of maps that are alike, by their names: their plain entries in one, others in one each."""
    while rows and all(_of_maps(item) for _, item in rows):
        rows = [((*names, key), inner) for names, item in rows for key, inner in item.items()]
    keys = list(dict.fromkeys(key for _, item in rows for key in item))
    nested = [key for key in keys if any(_holds_several(item.get(key)) for _, item in rows)]
    parts = [_grid(rows, columns)] if (columns := [key for key in keys if key not in nested]) else []
    for key in nested:
        inner = [(names, item[key]) for names, item in rows if _holds_several(item.get(key))]
        if all(isinstance(item, Mapping) for _, item in inner):
            parts.append(folded(named(key), _records(inner), is_open=False))
        else:
            parts += [
                folded(f"{named(key)} of {' '.join(names)}", _nested(item), is_open=False)
                for names, item in inner
            ]
    return parts


def _of_maps(item: Mapping[str, Any]) -> bool:
    return bool(item) and all(isinstance(value, Mapping) and value for value in item.values())


def _grid(rows: list[Row], columns: Sequence[str]) -> Html:
    """Return rows with their names in front; a few with many columns stand side by side."""
    heads = [named(key) for key in columns]
    cells = [[_ranged(key, item.get(key, "")) for key in columns] for _, item in rows]
    if len(rows) <= FEW and len(columns) > len(rows):
        names = [" ".join(name) for name, _ in rows]
        return table(("", *names), [(head, *column) for head, *column in zip(heads, *cells)])
    deep = max(len(names) for names, _ in rows)
    labels = [(*names, *[""] * (deep - len(names))) for names, _ in rows]
    return first_rows([""] * deep + heads, [[*label, *row] for label, row in zip(labels, cells)])


def _listed(items: Sequence[Mapping[str, Any]]) -> Html:
    """Return a table with an item of a list a row; small maps inside are columns of it."""
    columns: dict[tuple[str, ...], str] = {}
    for item in items[:MOST_ROWS]:
        for key, value in item.items():
            inner = (
                value if isinstance(value, Mapping) and not any(map(_holds_several, value.values())) else {}
            )
            columns |= {(key, name): f"{named(key)}: {name}" for name in inner}
            if not inner:
                columns[(key,)] = named(key)
    plain = {steps[:1]: named(steps[0]) for steps in columns}
    if len(columns) > BROAD:
        columns = plain
    # one that is a map in some items and nothing in others has its columns already
    spread = {steps[0] for steps in columns if len(steps) > 1}
    columns = {steps: head for steps, head in columns.items() if len(steps) > 1 or steps[0] not in spread}
    rows = [[_ranged(steps[0], _inside(item, steps)) for steps in columns] for item in items]
    return first_rows(list(columns.values()), rows)


def _inside(item: Any, steps: Sequence[str]) -> Any:
    for step in steps:
        item = item.get(step, "") if isinstance(item, Mapping) else ""
    return item


def _ranged(key: str, value: Any) -> Any:
    """Return the two ends of a range with a word between them, anything else as it is."""
    inner = value.value if isinstance(value, Quantity) else value
    if key.endswith("range") and isinstance(inner, list | tuple) and len(inner) == 2:
        return written(value).replace(", ", " to ", 1)
    return value


def first_rows(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> Html:
    """Return a table of as many rows as a page may have, which says so where that leaves some out."""
    left_out = f"The first {MOST_ROWS} of {len(rows)} rows; all of them are in the result's files."
    return table(head, rows[:MOST_ROWS], left_out if len(rows) > MOST_ROWS else None)


def folded(title: str, content: list[Html], is_open: bool) -> Html:
    """Return tables that can be folded away; those with several columns go across the page."""
    broad = any("<thead>" in table for table in content)
    return element(
        "details", element("summary", title), content, open=is_open, class_="broad" if broad else None
    )
