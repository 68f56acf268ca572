"""Tables of what a result says in words and numbers: its summary, its plan, errors beside figures, where it is from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.report import figures
from robodyn_cli.report.page.markup import Html, element
from robodyn_cli.report.ticks import number
from robodyn_cli.results.result import Result

DIGITS = 6
MOST_ROWS = 200  # of a table of runs
MOST_ITEMS = 60  # of a list in a cell

# what an error or a residual of the summary belongs to: parts of its key, by plot
ERRORS: dict[str, tuple[str, ...]] = {
    "joint_angles": ("q_max", "q_end", "state_max", "ik_residual", "position"),
    "joint_rates": ("qd_max", "qd_end", "state_max", "velocity"),
    "joint_accelerations": ("acceleration", "round_trip"),
    "torques": ("torque", "round_trip", "force_residual"),
    "torque_terms": ("torque", "round_trip"),
    "tip_path": ("q_max", "state_max", "ik_residual", "position"),
    "point_motion": ("qd_max", "state_max", "velocity", "acceleration"),
    "transmission_angle": ("q_max", "position"),
    "energy": ("energy",),
    "energy_drift": ("energy",),
    "multipliers": ("state_max", "multiplier", "acceleration", "position", "velocity"),
    "reactions": ("state_max", "round_trip", "force_residual"),
    "constraint_residual": ("position", "velocity", "redundant"),
    "singular_values": ("q_max", "position"),
    "branches": ("position",),
    "motion": ("q_max", "q_end", "ik_residual", "position"),
}
SOURCES = (
    "error_estimate",
    "energy_drift",
    "energy_drift_relative",
    "constraint_residual",
    "ik_residual",
    "round_trip",
)
# what these figures are, with their units
WORDS = {
    "q_max": "largest error of q [rad, m]",
    "q_end": "error of q at the end [rad, m]",
    "qd_max": "largest error of qd [rad/s, m/s]",
    "qd_end": "error of qd at the end [rad/s, m/s]",
    "state_max": "largest error of the state [rad, m; per s]",
    "position": "positions of the loops [m, rad]",
    "velocity": "velocities of the loops [m/s, rad/s]",
    "acceleration": "accelerations of the loops [m/s², rad/s²]",
    "redundant": "loop rows that were left out [m, rad]",
    "ik_residual": "distance from the target [m]",
    "round_trip": "accelerations of forward after inverse dynamics [1]",
    "torque_rounding": "rounding of any torque [N·m, N]",
    "energy_drift": "energy drift [J]",
    "energy_drift_relative": "energy drift, over the energy exchanged [1]",
    "energy_balance": "work less the change of energy [J]",
    "energy_balance_relative": "work less the change of energy, over the work [1]",
    "energy_quadrature": "energies with every second sample [J]",
    "force_residual": "forces out of balance [N·m, N]",
}
# told elsewhere on the page
APART = ("status", "command", "title", "definitions", "outputs", "scene_file", "run_id")


def written(value: Any) -> str:
    """Return a value as it stands in a cell: numbers with six digits, lists with commas."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "–"
    if isinstance(value, float):
        return number(value, DIGITS) if math.isfinite(value) else str(value)
    if isinstance(value, int):
        return str(value).replace("-", "−")
    if isinstance(value, Sequence) and not isinstance(value, str):
        more = f", and {len(value) - MOST_ITEMS} more" if len(value) > MOST_ITEMS else ""
        return ", ".join(written(item) for item in value[:MOST_ITEMS]) + more or "none"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {written(item)}" for key, item in value.items()) or "none"
    return str(value)


def named(key: str) -> str:
    """Return a key in words, with the seconds that some end with as a unit."""
    words = key.replace("_", " ")
    return f"{words[:-2]} [s]" if words.endswith(" s") else words


def table(head: Sequence[str], rows: Sequence[Sequence[Any]], caption: str | None = None) -> Html:
    """Return a table whose first column names its rows; numbers are set to the right."""
    top = [element("caption", caption)] if caption else []
    if any(head):
        top.append(element("thead", element("tr", [element("th", name, scope="col") for name in head])))
    cells = [[_cell(x, aligned=any(head)) for x in row[1:]] for row in rows]
    body = [element("tr", element("th", row[0], scope="row"), rest) for row, rest in zip(rows, cells)]
    return element("div", element("table", top, element("tbody", body)), class_="wide", tabindex="0")


def _cell(value: Any, aligned: bool) -> Html:
    """Return a cell; numbers of columns that are to be compared are ``aligned`` to the right."""
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    return element("td", written(value), class_="number" if plain and aligned else None)


def main_figures(result: Result) -> Html | None:
    """Return the main figures of a result with their errors, None of a command that has none."""
    found = [table(one.head, one.rows[:MOST_ROWS]) for one in figures.tables(result)]
    return element("div", element("h3", "Main figures"), found) if found else None


def summary_tables(summary: Mapping[str, Any]) -> list[Html]:
    """Return the tables of a summary: its plain entries first, then one for each entry that holds several."""
    definitions = summary.get("definitions")
    meaning = definitions if isinstance(definitions, Mapping) else {}
    facts = {key: value for key, value in summary.items() if key not in APART}
    found = _entry_tables("", facts, meaning)
    if meaning:
        rows = [(named(key), text) for key, text in meaning.items()]
        found.append(_folded("what the words mean", [table(("", ""), rows)], False))
    return found


def _entry_tables(title: str, facts: Mapping[str, Any], meaning: Mapping[str, Any]) -> list[Html]:
    """Return the table of the plain entries, and below it the folded ones of the others."""
    nested = {key: value for key, value in facts.items() if _holds_several(value)}
    plain = [(named(key), value) for key, value in facts.items() if key not in nested]
    found = [table(("", ""), plain)] if plain else []
    for key, value in nested.items():
        found.append(_folded(named(key), _nested(value, meaning), not title))
    return found


def _holds_several(value: Any) -> bool:
    if isinstance(value, Mapping):
        return len(value) > 0
    return (
        isinstance(value, Sequence)
        and not isinstance(value, str)
        and any(isinstance(x, Mapping) for x in value)
    )


def _nested(value: Any, meaning: Mapping[str, Any]) -> list[Html]:
    if not isinstance(value, Mapping):
        return [_rows([item for item in value if isinstance(item, Mapping)])]
    if all(isinstance(item, Mapping) and item for item in value.values()):
        return [_rows([{"": name, **item} for name, item in value.items()])]
    return _entry_tables("inside", value, meaning)


def _rows(items: Sequence[Mapping[str, Any]]) -> Html:
    """Return a table with an item a row."""
    columns = list(dict.fromkeys(key for item in items[:MOST_ROWS] for key in item))
    rows = [[item.get(key, "") for key in columns] for item in items[:MOST_ROWS]]
    left = len(items) - MOST_ROWS
    rest = (
        f"The first {MOST_ROWS} of {len(items)} rows; all of them are in the result's files."
        if left > 0
        else None
    )
    return table([named(key) for key in columns], rows, rest)


def _folded(title: str, content: list[Html], is_open: bool) -> Html:
    """Return tables that can be folded away; those with several columns go across the page."""
    broad = any("<thead>" in table for table in content)
    return element(
        "details", element("summary", title), content, open=is_open, class_="broad" if broad else None
    )


def error_table(summary: Mapping[str, Any], plot: str) -> Html | None:
    """Return the errors and residuals that a figure is to be read with, None where the summary has none for it."""
    parts = ERRORS.get(plot, ())
    found: dict[str, float] = {}
    for source in SOURCES:
        for key, value in _flat(source, summary.get(source)):
            if any(part in key for part in parts):
                found.setdefault(key.rpartition(" ")[2], value)
    if not found:
        return None
    rows = [(WORDS.get(name, named(name)), value) for name, value in found.items()]
    return element("div", table(("errors and residuals", ""), rows), class_="errors")


def error_note(summary: Mapping[str, Any]) -> Html | None:
    """Return how the errors beside the figures were estimated; None where they were not."""
    estimate = summary.get("error_estimate")
    method = estimate.get("method") if isinstance(estimate, Mapping) else None
    return element("p", f"Error estimate: {method}.", class_="note") if method else None


def _flat(key: str, value: Any) -> list[tuple[str, float]]:
    """Return the numbers of an entry with their keys, those above included."""
    if isinstance(value, Mapping):
        return [item for name, inner in value.items() for item in _flat(f"{key} {name}", inner)]
    return [(key, value)] if isinstance(value, float) else []


def plan_tables(plan: Mapping[str, Any]) -> list[Html]:
    """Return the terms that the equations keep and leave out, with the operations of each, and why."""
    head = ("term", "operations", "why")
    found = []
    for key, title, cost in (
        ("kept", "Terms kept", "operations"),
        ("left_out", "Terms left out", "operations_saved"),
    ):
        terms = plan.get(key) or []
        rows = [(term.get("term", ""), term.get(cost), term.get("reason", "")) for term in terms]
        found += [table(head, rows, title)] if rows else []
    facts = [("mechanism", plan.get("mechanism")), ("operations of this scene", plan.get("operations")),
             ("of code for any scene", plan.get("operations_general"))]  # fmt: skip
    return [table(("", ""), [fact for fact in facts if fact[1] is not None]), *found]


def provenance_table(summary: Mapping[str, Any], attributes: Mapping[str, Any]) -> Html:
    """Return where a result is from: file of the scene, version, processor, libraries, seconds."""
    versions = attributes.get("versions")
    rows = [
        ("scene file", summary.get("scene_file")),
        ("run", attributes.get("run_id")),
        ("robodyn", attributes.get("robodyn_version")),
        ("processor", attributes.get("cpu")),
        *((versions or {}).items() if isinstance(versions, Mapping) else ()),
    ]
    return table(("", ""), [row for row in rows if row[1] is not None])
