"""The plan as a table for the terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from itertools import zip_longest
from typing import Any

from robodyn_cli.run.plan.programs import how
from robodyn_cli.run.plan.words import listed_data, plural

WIDTH = 100
TERM = 36
NUMBER = 11
INDENT = "  "


def render(plan: dict[str, Any]) -> str:
    """Return the plan as text of at most 100 columns: kept, left out, totals, programs."""
    lines = [*_head(plan), "", *_table("Kept", "operations", plan["kept"], "operations"), ""]
    lines += [*_table("Left out", "saved", plan["left_out"], "operations_saved"), ""]
    if plan["terms_counted"]:
        lines += _wrapped(
            "Kept: what leaving it out would save. Left out: what it would add in general form. Terms share "
            "work, so these figures do not add up to the total."
        )
    else:
        lines += _wrapped("Terms are not counted one by one for a model of this size.")
    lines += [*_totals(plan), *_equation_36(plan.get("equation_36") or {}), *_kernels(plan["kernels"])]
    lines += _numbers(plan["kernels"])
    lines += _choices(plan["choices"])
    return "\n".join(line.rstrip() for line in lines)


def _wrapped(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent)


def _head(plan: dict[str, Any]) -> list[str]:
    lines = _wrapped(f"Plan of {plan['command']}: {plan['title'] or 'scene'}")
    lines += _wrapped(plan["mechanism"], INDENT)
    if plan["missing"]:
        lines += _wrapped(
            f"This scene cannot run: its equations need {listed_data(plan['missing'])}, not given."
        )
    return lines


def _number(value: int | None) -> str:
    return "-" if value is None else str(value)


def _table(title: str, heading: str, entries: Iterable[dict[str, Any]], key: str) -> list[str]:
    """Return a table of terms: name, operations, reason."""
    lines = [f"{title:<{len(INDENT) + TERM}}{heading:>{NUMBER}}{INDENT}why"]
    for entry in entries:
        lines += _row(entry["term"], _number(entry[key]), entry["reason"])
    return lines


def _row(name: str, number: str, text: str) -> list[str]:
    """Return one row of a table; name and text wrap inside their columns."""
    names = textwrap.wrap(name, TERM - 1)
    texts = textwrap.wrap(text, WIDTH - len(INDENT) - TERM - NUMBER - len(INDENT))
    return [
        f"{INDENT}{left or '':<{TERM}}{number if k == 0 else '':>{NUMBER}}{INDENT}{right or ''}"
        for k, (left, right) in enumerate(zip_longest(names, texts))
    ]


def _totals(plan: dict[str, Any]) -> list[str]:
    what = "torques" if plan["command"] == "inverse" else "accelerations"
    total, general = plan["operations"], plan["operations_general"]
    lines = ["", f"Operations of the {what}", f"{INDENT}{'this scene':<{TERM}}{total:>{NUMBER}}"]
    times = f"{INDENT}{plan['ratio']:.1f} times as many" if plan["ratio"] else ""
    lines.append(f"{INDENT}{'code for any scene':<{TERM}}{general:>{NUMBER}}{times}")
    return lines


def _equation_36(block: dict[str, Any]) -> list[str]:
    if not block:
        return []
    rows = [
        ("the open tree, loops cut", block["open_tree"]),
        ("what the loops add", block["loop_terms"]),
        ("together: equation (36)", block["operations"]),
        ("an open chain of as many joints", block["open_chain_of_as_many_joints"]),
        ("projection of positions", block["projection_of_positions"]),
        ("projection of velocities", block["projection_of_velocities"]),
    ]
    lines = ["", "Closed loops"]
    lines += [f"{INDENT}{name:<{TERM}}{_number(value):>{NUMBER}}" for name, value in rows]
    if block["ratio"]:
        lines[4] += f"{INDENT}{block['ratio']:.2f} times the open chain of as many joints"
    return lines


def _kernels(kernels: list[dict[str, Any]]) -> list[str]:
    if not kernels:
        return []
    lines = ["", f"{'Programs':<{len(INDENT) + TERM}}{'operations':>{NUMBER}}{INDENT}how"]
    for k in kernels:
        reads = ", ".join(f"{group}[{n}]" for group, n in k["inputs"].items())
        text = f"{how(k)}; reads {reads or 'nothing'}, {plural(len(k['numbers']), 'number')}; digest {k['digest']}"
        lines += _row(k["name"], _number(k["operations"]), text)
    return lines


def _numbers(kernels: list[dict[str, Any]]) -> list[str]:
    """Say what of the scene is a number and what is structure."""
    if not kernels:
        return []
    count = len({place for k in kernels for place in k["numbers"]})
    text = (
        f"{plural(count, 'value')} of the scene {'is a number' if count == 1 else 'are numbers'} that the programs "
        "read from a table: another value compiles nothing. Structure: zeros, directions, angles that place frames, "
        "exponents, and values that are the default of their key."
    )
    return ["", "Numbers", *_wrapped(text, INDENT)]


def _choices(choices: list[dict[str, Any]]) -> list[str]:
    if not choices:
        return []
    lines = ["", "Choices"]
    for c in choices:
        text = f"{c['choice']}: {c['taken']} ({c['reason']})"
        counts = c.get("operations")
        if counts:
            text += "; " + ", ".join(f"{name} {n}" for name, n in counts.items())
        lines += textwrap.wrap(text, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT * 2)
    return lines
