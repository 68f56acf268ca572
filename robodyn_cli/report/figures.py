"""The main figures of a result, each with its error beside it, as small tables of text."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robodyn_cli.commands import COMMANDS
from robodyn_cli.report.cells import Figure, Table, figure, is_number, spaced
from robodyn_cli.report.control_figures import control_tables, loop_note
from robodyn_cli.results.result import Result, column_names, units_of
from robodyn_cli.results.sampling import is_sparse, sparse_words
from robodyn_cli.results.stated_errors import Stated, stated
from robodyn_cli.summaries.control import POLE_UNIT
from robodyn_cli.summaries.deploy import NORM
from robodyn_cli.summaries.facts import Fact, for_coordinate, rounded_up
from robodyn_cli.summaries.keys import Leaf, leaf_of, leaves_of
from robodyn_cli.summaries.study import QUANTILES

KEPT = ("constraint_residual.position", "constraint_residual.velocity")  # of rows that have multipliers
WHEN = "at"  # head of a column of times, which are those of the column before
MOST_ROWS = 12  # that a small table shows
Summary = Mapping[str, Any]


def tables(result: Result) -> list[Table]:
    """Return the main figures of a result; none of a command that has no small tables."""
    if result.command not in COMMANDS:
        return []
    listed = TABLES.get(result.command, _declared)(result, result.summary)
    return [table for table in [*listed, *control_tables(result.summary)] if table.rows]


def alarms(result: Result) -> list[str]:
    """Return what nobody should miss of a result, a sentence each: why it failed, warnings."""
    failed = [f"failed: {_at(result.summary, 'termination', 'reason')}"] if result.status == "failed" else []
    sparse = [f"{sparse_words(result)}: plots draw dots there"] if is_sparse(result) else []
    return [*failed, *(f"warning: {text}" for text in [*result.summary.get("warnings", ()), *sparse])]


def notes(result: Result) -> list[str]:
    """Return what else is to be known of a result, a sentence each: its lock, its errors."""
    summary = result.summary
    sentences = [*_lock(summary), *loop_note(summary)]
    sentences += errors(result)
    estimate = summary.get("error_estimate")
    if isinstance(estimate, Mapping) and estimate.get("reason"):
        sentences.append(f"no error estimate: {estimate['reason']}")
    return sentences


def errors(result: Result, all_of_them: bool = False) -> list[str]:
    """Return the errors and residuals that a result states in words, each with its unit; the main ones, or all."""

    def amounts(one: Stated) -> str:
        parts = one.statement.by_unit(result, one.value) or {unit_of_error(result, one): one.value}
        return ", ".join(f"{rounded_up(x):.2g}{spaced(u)}" for u, x in parts.items())

    told = (one for one in stated(result.summary) if one.statement.is_main or all_of_them)
    return [f"{one.words} {amounts(one)}" for one in told]


def unit_of_error(result: Result, one: Stated) -> str:
    """Return the unit of an error that a result states; that of its joints where these have one."""
    unit = one.statement.unit_in(result)
    return shown_units(result)(".".join(one.statement.key)) or unit if " or " in unit else unit


def _at(summary: Any, *keys: str) -> Any:
    """Return what lies under a path of keys; None where there is nothing."""
    for key in keys:
        summary = summary.get(key) if isinstance(summary, Mapping) else None
    return summary


def _lock(summary: Summary) -> list[str]:
    lock = summary.get("lock")
    if not isinstance(lock, Mapping):
        return []
    kind = str(lock.get("kind", "lock")).replace("_", " ")
    return [f"locked at t = {figure(lock.get('time'), lock.get('time_error'), 's')}: {kind}"]


def headlines(result: Result) -> list[Table]:
    """Return those of the main figures that a result is told by where there is room for few, as its command declares
    them."""
    if result.command not in COMMANDS:
        return []
    leads = COMMANDS[result.command].headlines
    return _tables(
        result, {steps: leaf for steps, leaf in _columns(result.command).items() if ".".join(steps) in leads}
    )


@functools.cache
def _columns(command: str) -> Mapping[tuple[str, ...], Leaf]:
    """Return the figures of a command that have a heading, those first that its results are told by."""
    leads = {key: k for k, key in enumerate(COMMANDS[command].headlines)}
    headed = {steps: leaf for steps, leaf in leaves_of(command) if leaf.fact.column}
    return {x: headed[x] for x in sorted(headed, key=lambda x: leads.get(".".join(x), len(leads)))}


def declared(result: Result) -> list[Table]:
    """Return the tables of all figures that have a heading, those first that the result is told by."""
    return _tables(result, _columns(result.command)) if result.command in COMMANDS else []


def _declared(result: Result, summary: Summary) -> list[Table]:
    return [*declared(result), *drive_verdicts(summary), *drive_figures(summary)]


def _tables(result: Result, columns: Mapping[tuple[str, ...], Leaf]) -> list[Table]:
    """Return a table of single figures, and one for each kind of names (joints, points), of those that there are."""
    summary, coordinates = result.summary, _coordinates(result)
    single: list[list[str | Figure]] = [
        [leaf.fact.column, _cell(result, steps, leaf, "", coordinates)]
        for steps, leaf in columns.items()
        if not _named(steps) and _at(summary, *steps) is not None
    ]
    groups: dict[Any, dict[tuple[str, ...], Leaf]] = {}
    for steps, leaf in columns.items():
        if (k := _named(steps)) and (names := _at(summary, *steps[:k])):
            groups.setdefault((_kind(steps), tuple(names)), {})[steps] = leaf
    listed = [Table(("", ""), single)]
    for (kind, names), own in groups.items():
        rows: list[list[str | Figure]] = [
            [name, *(_cell(result, *column, name, coordinates) for column in own.items())] for name in names
        ]
        head = (kind[-1].lower(), *(leaf.fact.column for leaf in own.values()))
        listed.append(Table(head, rows, meanings_of([leaf.fact for leaf in own.values()])))
    return [table for table in listed if table.rows]


def meanings_of(columns: Sequence[Fact]) -> dict[str, str]:
    """Return what columns are by their heads, as declared; nothing of those whose heads say it."""
    told = {fact.column: fact.doc.partition("; `null`")[0] for fact in columns}
    return {head: doc for head, doc in told.items() if head not in doc and head != WHEN}


def _named(steps: Sequence[str]) -> int:
    """Return which step of a key is that of names, 0 if none is."""
    return next((k for k, step in enumerate(steps) if step.isupper()), 0)


def _kind(steps: tuple[str, ...]) -> tuple[str, ...]:
    """Return what the columns of one table share: the kind of their names, below a section where they lie too."""
    k = _named(steps)
    if k == 1:
        return steps[k : k + 1]
    return steps[: k + 1] if steps[k + 1 :] else (*steps[: k - 1], steps[k])


def _cell(
    result: Result, steps: tuple[str, ...], leaf: Leaf, name: str, coordinates: Mapping[str, str]
) -> Figure:
    """Return a figure, with its error and unit as declared, of what has the name (``ball.qw``) if there is one."""

    def named(steps: Sequence[str]) -> tuple[str, ...]:
        return tuple(name if step.isupper() else step for step in steps)

    summary, place = result.summary, named(steps)
    own = dataclasses.replace(leaf, names=(name,), key=".".join(steps))
    above = {True: place[:-1], False: ()}
    error = _larger(
        *(
            _at(summary, *above[key.startswith(".")], *named(key.removeprefix(".").split(".")))
            for key in leaf.fact.errors
        )
    )
    if " or " in (unit := own.unit(coordinates)):
        unit = _the_one(unit, own, result)
    return Figure(_at(summary, *place), error, unit, leaf.fact.infinite)


def _coordinates(result: Result) -> dict[str, str]:
    """Return the units of coordinates, ``rad`` or ``m``, by their names."""
    rates = {name: unit.removesuffix("/s") for name, unit in _units(result, "qd").items()}
    control = result.summary.get("control") or {}
    columns = {**(control.get("tracking") or {}), **(result.summary.get("extremes") or {})}
    return {**rates, **_units(result, "q"), **{name: str(row["unit"]) for name, row in columns.items()}}


def shown_units(result: Result) -> Callable[[str], str]:
    """Return what gives the unit of a key of the summary, empty where it is none; the word ``unit`` is in it where it
    stands beside the key."""
    coordinates = _coordinates(result)

    def unit_of(key: str) -> str:
        leaf = leaf_of(result.command, key) if result.command in COMMANDS else None
        unit = leaf.unit(coordinates) if leaf is not None and leaf.is_number else ""
        if leaf is not None and (" or " in unit or unit == NORM):
            unit = ", ".join(_the_one(one, leaf, result) for one in unit.split(", "))
        if unit == POLE_UNIT:
            unit = "per sample" if "period" in result.summary[key.partition(".")[0]] else "1/s"
        return "" if unit == "1" else unit

    return unit_of


def _the_one(unit: str, leaf: Leaf, result: Result) -> str:
    """Return which of several units a number of a result has; all of them where nothing tells.

    Those of joints, where that of angles stands first, follow from the joints; those of closures from their
    multipliers, by the row that the key names or by all that are kept.
    """
    if leaf.key.startswith("overload."):
        quantity = _at(result.summary, "overload", "quantity")
        return for_coordinate(unit, {"force": "m", "moment": "rad"}.get(str(quantity), ""))
    loads, row = _units(result, "constraints/multipliers"), ".".join(leaf.names)
    if row in loads or unit == NORM or leaf.key in KEPT:
        rows = _at(result.summary, "lock", "multipliers", "rows") if unit == NORM else None
        kinds = {loads.get(name, "") for name in ([row] if row in loads else rows or loads)}
        kind = {"N": "m", "N m": "rad"}.get(kinds.pop(), "") if len(kinds) == 1 else ""
        return for_coordinate(unit.replace(" and ", " or "), kind) if kind else unit
    if unit.partition(" or ")[0].startswith(("rad", "N m")):
        joints = {one.removesuffix("/s") for one in _units(result, "qd").values()}
        return for_coordinate(unit, joints.pop()) if len(joints) == 1 else unit
    return unit


def shown_errors(result: Result) -> Callable[[str], Sequence[str]]:
    """Return what gives the keys of the summary that state the error of a key, as they are declared."""

    def errors_of(key: str) -> Sequence[str]:
        leaf = leaf_of(result.command, key) if result.command in COMMANDS else None
        return leaf.errors if leaf is not None and leaf.is_number else ()

    return errors_of


def _larger(*errors: Any) -> float | None:
    """Return the largest error of those that are known."""
    return max((x for x in errors if is_number(x)), default=None)


# of the table of drives: heading, its key below a drive, that of its error, unit
BORNE = (
    ("peak torque", ("shaft", "peak_torque"), ("shaft", "errors", "peak_torque"), "N m"),
    ("RMS torque", ("shaft", "rms_torque"), ("shaft", "errors", "rms_torque"), "N m"),
    ("peak speed", ("shaft", "peak_speed"), ("shaft", "errors", "peak_speed"), "rad/s"),
    ("RMS current", ("electrical", "rms_current"), ("electrical", "errors", "rms_current"), "A"),
    ("winding", ("winding", "peak"), ("winding", "error"), "degC"),
)


def drive_verdicts(summary: Summary) -> list[Table]:
    """Return whether each drive bears its duty, and the margin of what decides, with its error."""
    rows: list[list[str | Figure]] = []
    for name, drive in (summary.get("drives") or {}).items():
        errors = drive["errors"]
        parts = " + ".join(drive[key] for key in ("motor", "gear", "brake") if drive[key] is not None)
        at = f" at {figure(drive['time'], errors.get('time'), 's')}" if "time" in drive else ""
        rows.append(
            [
                name,
                parts if drive["count"] == 1 else f"{drive['count']} x {parts}",
                "suffices" if drive["passes"] else "too small",
                margin(drive["margin"], errors["margin"]),
                drive["decides"].replace("_", " ") + at,
            ]
        )
    return [Table(("joint", "drive", "verdict", "left", "of limit"), rows)] if rows else []


def margin(part: float, error: float | None) -> Figure:
    """Return the part of a limit that is left; where more than twice the limit is asked for, how much."""
    percent = None if error is None else 100.0 * error
    return Figure(100.0 * part, percent, "%") if part >= -1.0 else Figure(1.0 - part, error, "x limit")


def drive_figures(summary: Summary) -> list[Table]:
    """Return what motors bear, each with its error."""
    drives = summary.get("drives") or {}
    rows: list[list[str | Figure]] = [
        [name, *(Figure(_at(one, *key), _at(one, *error), unit) for _, key, error, unit in BORNE)]
        for name, one in drives.items()
    ]
    return [Table(("joint", *(head for head, *_ in BORNE)), rows)] if rows else []


def _units(result: Result, path: str) -> dict[str, str]:
    variable = result.variables.get(path)
    return {} if variable is None else dict(zip(column_names(variable), units_of(variable)))


def _study(result: Result, summary: Summary) -> list[Table]:
    head = ["output", "as it stands", "smallest", "largest"]
    if "sampler" in summary:
        head += ["mean", "standard deviation", *(f"quantile {name}" for name in QUANTILES)]
    rows = []
    for name, spread in summary.get("results", {}).items():
        if spread is None:
            continue
        worst, unit = spread.get("largest_error"), spread["unit"]
        row = [name, *(figure(spread[key], worst, unit) for key in ("nominal", "minimum", "maximum"))]
        if "sampler" in summary:
            row += [figure(spread.get(key), spread.get(f"{key}_error"), unit) for key in ("mean", "sd")]
            levels, errors = spread.get("quantiles", {}), spread.get("quantile_errors", {})
            row += [figure(levels.get(name), errors.get(name), unit) for name in QUANTILES]
        rows.append(row)
    return [Table(head, rows)]


def _search(result: Result, summary: Summary) -> list[Table]:
    """Return the values that were found and what comes of them."""
    keys = [
        [
            name,
            figure(key["value"], key["uncertainty"], key["unit"]),
            str(key.get("choices") or key["bounds"]) + (f" ({key['at']})" if "at" in key else ""),
        ]
        for name, key in summary.get("keys", {}).items()
    ]
    limits = summary.get("limits", {})
    outputs = [
        [
            name,
            figure(found["value"], found["error"], found["unit"]),
            str(found.get("target") or _at(limits, name, "limit") or summary["goal"].partition(" ")[0]),
        ]
        for name, found in summary.get("figures", {}).items()
    ]
    return [Table(("key", "value", "bounds"), keys), Table(("output", "value", "asked for"), outputs)]


def _slopes(result: Result, summary: Summary) -> list[Table]:
    """Return the derivatives of each output, the weightiest first."""
    return [
        Table(
            (f"d {output} by", "derivative", "normalised"),
            [
                [key, figure(one["derivative"], one["error"], one["unit"]), figure(one["normalised"])]
                for key, one in slopes.items()
            ],
        )
        for output, slopes in summary.get("sensitivities", {}).items()
    ]


def _modes(result: Result, summary: Summary) -> list[Table]:
    """Return the poles, an error beside each."""
    rows = []
    for mode in summary.get("modes", ()):
        beside = f" ± {mode['imaginary']:.6g}i" if mode["imaginary"] else ""
        pole = f"{mode['real']:.6g}{beside} 1/s"
        off = rounded_up(mode["error"], 1) if is_number(mode["error"]) else None
        rows.append([pole, "-" if off is None else f"{off:.1g} 1/s", figure(mode["damping"])])
    pole = "pole without control" if "closed_loop" in summary else "pole"
    return [*_declared(result, summary), Table((pole, "off by", "damping"), rows)]


def _crosschecked(result: Result, summary: Summary) -> list[Table]:
    """Return the largest differences beside the errors of both; of an engine at its own settings the gaps."""
    rows = [
        [one["quantity"], f"{one['difference']:.2g}", _off(one["our_error"]), _off(one["their_error"])]
        for one in summary.get("compared", ())
    ]
    gaps = [
        [one["closure"], f"{one['largest']:.3g} {one['unit']}", _off(one["here"])]
        for one in summary.get("closures", ())
    ]
    head = ("quantity", "largest difference", "error here", f"error in {summary.get('engine')}")
    return [Table(head, rows), Table(("gap", f"in {summary.get('engine')}", "here"), gaps)]


def _best(result: Result, summary: Summary) -> list[Table]:
    """Return the fastest method at each level of error."""
    rows = [
        [f"{one['level']:.0e}", one["method"], _off(one["error"]), f"{1e3 * one['run_time_s']:.3g} ms"]
        for one in summary.get("best", ())
    ]
    return [Table(("error below", "best method", "error", "time"), rows)]


def _trials(result: Result, summary: Summary) -> list[Table]:
    """Return what each method makes of a scene; of a suite the verdicts."""
    cases = [[case["name"], "ok" if case["holds"] else "missed"] for case in summary.get("cases", ())]
    tried = summary.get("methods", ()) if not cases else ()
    rows = [[one["method"], one["status"].replace("_", " "), _off(one["relative"])] for one in tried]
    return [Table(("method", "status", "error / range"), rows), Table(("case", "verdict"), cases)]


def _off(error: float | None) -> str:
    return f"{rounded_up(error):.2g}" if error is not None and is_number(error) else "-"


# tables that are more than the columns of their records
TABLES: dict[str, Callable[[Result, Summary], list[Table]]] = {
    "sweep": _study,
    "optimise": _search,
    "sensitivity": _slopes,
    "linearise": _modes,
    "crosscheck": _crosschecked,
    "work-precision": _best,
    "stability": _trials,
}
