"""The plan as a table for the terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

from robodyn_cli.run.plan.words import listed_data, plural

WIDTH = 100
TERM = 36
NUMBER = 11
INDENT = "  "
REASON = WIDTH - len(INDENT) - TERM - NUMBER - len(INDENT)
LOOPS = (
    ("the open tree, loops cut", "open_tree"),
    ("what the loops add", "loop_terms"),
    ("together: equation (36)", "operations"),
    ("an open chain of as many joints", "open_chain_of_as_many_joints"),
    ("projection of positions", "projection_of_positions"),
    ("projection of velocities", "projection_of_velocities"),
)


def render(plan: dict[str, Any]) -> str:
    """Return the plan as text of at most 100 columns: kept, left out, totals, programs."""
    return "\n".join(line.rstrip() for line in _lines(plan))


def _lines(plan: dict[str, Any]) -> Iterator[str]:
    yield from _wrapped(f"Plan of {plan['command']}: {plan['title'] or 'scene'}")
    yield from _wrapped(plan["mechanism"], INDENT)
    if plan["missing"]:
        needed = listed_data(plan["missing"])
        yield from _wrapped(f"This scene cannot run: its equations need {needed}, not given.")
    for title, part, count in (("Kept", "kept", "operations"), ("Left out", "left_out", "operations_saved")):
        yield from _heading(title, count.removeprefix("operations_"), "why")
        for entry in plan[part]:
            yield from _row(entry["term"], entry[count], entry["reason"])
    yield ""
    yield from _wrapped(
        "Kept: what leaving it out would save. Left out: what it would add in general form. Terms share "
        "work, so these figures do not add up to the total."
        if plan["terms_counted"]
        else "Terms are not counted one by one for a model of this size."
    )
    times = f"{plan['ratio']:.1f} times as many" if plan["ratio"] else ""
    yield from ("", f"Operations of the {'torques' if plan['command'] == 'inverse' else 'accelerations'}")
    yield from _row("this scene", plan["operations"])
    yield from _row("code for any scene", plan["operations_general"], times)
    if loops := plan.get("equation_36"):
        yield from ("", "Closed loops")
        for name, key in LOOPS:
            compared = key == "operations" and loops["ratio"]
            times = f"{loops['ratio']:.2f} times the open chain of as many joints" if compared else ""
            yield from _row(name, loops[key], times)
    if plan["kernels"]:
        yield from _heading("Programs", "operations", "how")
    for k in plan["kernels"]:
        reads = ", ".join(f"{group}[{n}]" for group, n in k["inputs"].items()) or "nothing"
        text = f"{_how(k)}; reads {reads}, {plural(len(k['numbers']), 'number')}; digest {k['digest']}"
        yield from _row(k["name"], k["operations"], text)
    yield from _numbers(plan["kernels"])
    if plan["choices"]:
        yield from ("", "Choices")
    for c in plan["choices"]:
        counts = ", ".join(f"{name} {n}" for name, n in c.get("operations", {}).items())
        text = f"{c['choice']}: {c['taken']} ({c['reason']}){'; ' if counts else ''}{counts}"
        yield from textwrap.wrap(text, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT * 2)


def _wrapped(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent)


def _heading(title: str, number: str, text: str) -> list[str]:
    return ["", f"{title:<{len(INDENT) + TERM}}{number:>{NUMBER}}{INDENT}{text}"]


def _row(name: str, number: int | None, text: str = "") -> list[str]:
    """Return one row of a table; name and text wrap inside their columns."""
    figure = "-" if number is None else str(number)
    columns = zip_longest(textwrap.wrap(name, TERM - 1), [figure], textwrap.wrap(text, REASON), fillvalue="")
    return [f"{INDENT}{left:<{TERM}}{middle:>{NUMBER}}{INDENT}{right}" for left, middle, right in columns]


def _numbers(kernels: list[dict[str, Any]]) -> Iterator[str]:
    """Say what of the scene is a number and what is structure."""
    if not kernels:
        return
    count = len({place for k in kernels for place in k["numbers"]})
    yield from ("", "Numbers")
    yield from _wrapped(
        f"{plural(count, 'value')} of the scene {'is a number' if count == 1 else 'are numbers'} that the programs "
        "read from a table: another value compiles nothing. Structure: zeros, directions, angles that place frames, "
        "exponents, and values that are the default of their key.",
        INDENT,
    )


def _how(kernel: dict[str, Any]) -> str:
    """Say how a program runs."""
    if kernel["engine"] == "interpreted":
        return "interpreted, on blocks of samples"
    lanes, placed = kernel["lanes"], kernel.get("placed", "")
    at_once = "one state at a time" if lanes == 1 else f"{lanes} {kernel['lanes_hold']} at once"
    where = {"inlined": ", inlined in the stepping loop", "function": ", a function in the stepping loop"}
    return f"{kernel['shape']}, {at_once}{where.get(placed, '')}"
