"""``compare --figures``: figures of several results and their differences to the first, as text, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from robodyn_cli.errors import CapabilityError, of_option
from robodyn_cli.foreign import spreadsheet_cell
from robodyn_cli.over.batch.stored import Stored, is_tree, read_all, runs_below
from robodyn_cli.report.page.compared import (
    DIFFER,
    OPEN,
    WITHIN,
    SideBySide,
    compared,
    error_of,
    judged,
    unit_of,
)
from robodyn_cli.report.page.tables import Quantity, written
from robodyn_cli.results.output_dir import path_ends
from robodyn_cli.summaries.checks import VariantFigure, VariantsReport, VariantValue
from robodyn_cli.works.equations.names import latex_text

FEWEST = 2  # results of which there are differences
VERDICTS = {DIFFER: "differs", WITHIN: "within", OPEN: "open", "": "equal"}
SIGNS = {DIFFER: "≠ ", WITHIN: "≈ "}
_NOTHING = re.compile(r"0(?![.\d])")
_POWER = re.compile("·10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)")
_DIGITS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def variants(stored: Sequence[Stored]) -> VariantsReport:
    """Return the figures of results, with their differences to the first; a directory with many means all below it.

    Raises
    ------
    ResultFileError : a result cannot be read. CapabilityError : there are fewer than two.
    """
    places: list[Stored] = []
    for one in stored:
        below = sorted(runs_below(one)) if isinstance(one, Path) and is_tree(one) else ()
        places += [one / name for name in below] if isinstance(one, Path) and below else [one]
    if len(places) < FEWEST:
        raise of_option("--figures", "there is one result; allowed: two and more", CapabilityError)
    paths, results = zip(*read_all(places))
    return VariantsReport("ok", path_ends(paths), [_figure(one) for one in compared(results)])


def _figure(one: SideBySide) -> VariantFigure:
    return VariantFigure(
        one.name, one.given, VERDICTS[one.mark], [_value(one, k) for k in range(len(one.values))]
    )


def _value(one: SideBySide, k: int) -> VariantValue:
    value = one.values[k]
    plain = value.value if isinstance(value, Quantity) else value
    off = one.difference(k) if k else None
    less = (None, None) if off is None else (off.value, off.error)
    return VariantValue(plain, unit_of(value), error_of(value), *less)


# -- text -----------------------------------------------------------------------------------------------------
def text_rows(report: VariantsReport) -> list[list[str]]:
    """Return the rows of a table for the terminal: what is equal in all results is left out."""
    first, *others = report.results
    rows = [["", first, *(word for name in others for word in (name, f"less {first}"))]]
    return rows + [_row(one, _plain, True) for one in report.figures if one.verdict != "equal"]


def _row(figure: VariantFigure, set_as: Callable[[str], str], units: bool) -> list[str]:
    """Return the key of a figure, its values, and behind each but the first the difference."""
    cells = [figure.key]
    for k, one in enumerate(figure.values):
        unit = one.unit if units else ""
        cells.append("" if one.value is None else set_as(written(Quantity(one.value, unit, one.error))))
        if k and one.difference is None:
            cells.append("")
        elif k:
            pair = [Quantity(x.value, x.unit, x.error) for x in (figure.values[0], one)]
            cells.append(set_as(f"{SIGNS.get(judged(pair), '')}{_off(one, unit)}"))
    return cells


def _off(one: VariantValue, unit: str) -> str:
    """Return a difference with its sign, unless nothing but its error is left of it."""
    text = written(Quantity(one.difference, unit, one.difference_error))
    return f"+{text}" if (one.difference or 0.0) > 0.0 and not _NOTHING.match(text) else text


def _plain(text: str) -> str:
    """Return a number as terminals write it: 1e-7 for ten to a power."""
    return _POWER.sub(lambda found: f"e{found[1].translate(_DIGITS)}", text).replace("−", "-")


# -- CSV ------------------------------------------------------------------------------------------------------
def csv_text(report: VariantsReport) -> str:
    """Return all figures with all digits, columns for value, error, difference and its error of each result."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    first, *others = report.results
    head = [f"{first}", f"{first} error"]
    for name in others:
        head += [name, f"{name} error", f"{name} less {first}", f"{name} less {first} error"]
    writer.writerow(["key", "unit", *map(spreadsheet_cell, head)])
    for figure in report.figures:
        cells: list[Any] = []
        for k, one in enumerate(figure.values):
            cells += [one.value, one.error, *((one.difference, one.difference_error) if k else ())]
        row = [figure.key, _units(figure), *cells]
        writer.writerow([spreadsheet_cell(x) if isinstance(x, str) else x for x in row])
    return file.getvalue().rstrip("\n")


def _units(figure: VariantFigure) -> str:
    return " or ".join(dict.fromkeys(one.unit for one in figure.values if one.unit))


# -- LaTeX ----------------------------------------------------------------------------------------------------
def latex_text_of(report: VariantsReport) -> str:
    """Return a ``tabular`` of what is not equal in all results; it needs no package."""
    first, *others = report.results
    head = ["", "unit", latex_text(first)]
    for name in others:
        head += [latex_text(name), rf"$\Delta$ {latex_text(name)}"]
    lines = [
        rf"\begin{{tabular}}{{ll{'r' * (2 * len(others) + 1)}}}",
        r"\hline",
        f"{' & '.join(head)} \\\\",
        r"\hline",
    ]
    for figure in report.figures:
        if figure.verdict != "equal":
            units = _units(figure)
            several = " or " in units
            key, *cells = _row(figure, str, units=several)
            row = [latex_text(key), "" if several else _in_latex(written(Quantity("", units)).strip())]
            lines.append(f"{' & '.join([*row, *map(_in_latex, cells)])} \\\\")
    return "\n".join([*lines, r"\hline", r"\end{tabular}"])


_SIGNS = {
    "−": "$-$",
    "±": r"$\pm$",
    "≠": r"$\ne$",
    "≈": r"$\approx$",
    "·": r"$\cdot$",
    "²": "$^2$",
    "³": "$^3$",
    "–": "--",
}


def _in_latex(text: str) -> str:
    """Return a number with its error, or a unit, in LaTeX."""
    parts = _POWER.split(text)
    words = []
    for k, part in enumerate(parts):
        if k % 2:
            words.append(rf"$\cdot 10^{{{part.translate(_DIGITS)}}}$")
        else:
            words += [_SIGNS.get(letter) or latex_text(letter) for letter in part]
    return "".join(words)
