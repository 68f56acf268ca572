"""The plan as a table for the terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

from robodyn_cli.over.plan.words import listed_data, plural
from robodyn_cli.record import record

WIDTH, NARROWEST = 100, 48  # columns
TERM = 0.36  # of the columns
NUMBER = 11
INDENT = "  "
LOOPS = (
    ("the open tree, loops cut", "open_tree"),
    ("what the loops add", "loop_terms"),
    ("together: equation (36)", "operations"),
    ("an open chain of as many joints", "open_chain_of_as_many_joints"),
    ("projection of positions", "projection_of_positions"),
    ("projection of velocities", "projection_of_velocities"),
)


def render(plan: dict[str, Any], columns: int | None = None) -> str:
    """Return the plan as text: kept, left out, totals, programs; on 100 columns, fewer where a terminal has fewer."""
    page = _Page(max(NARROWEST, min(WIDTH, columns or WIDTH)))
    return "\n".join(line.rstrip() for line in page.lines(plan))


@record
class _Page:
    """The text of a plan on so many columns."""

    width: int

    @property
    def term(self) -> int:
        """Columns of the names of terms."""
        return int(TERM * self.width)

    def lines(self, plan: dict[str, Any]) -> Iterator[str]:
        yield from self.wrapped(f"Plan of {plan['command']}: {plan['title'] or 'scene'}")
        yield from self.wrapped(plan["mechanism"], INDENT)
        if plan["missing"]:
            needed = listed_data(plan["missing"])
            yield from self.wrapped(f"This scene cannot run: its equations need {needed}, not given.")
        for title, part, count in (
            ("Kept", "kept", "operations"),
            ("Left out", "left_out", "operations_saved"),
        ):
            yield from self.heading(title, count.removeprefix("operations_"), "why")
            for entry in plan[part]:
                yield from self.row(entry["term"], entry[count], entry["reason"])
        yield ""
        yield from self.wrapped(
            "Kept: what leaving it out would save. Left out: what it would add in general form. Terms share "
            "work, so these figures do not add up to the total."
            if plan["terms_counted"]
            else "Terms are not counted one by one for a model of this size."
        )
        times = f"{plan['ratio']:.1f} times as many" if plan["ratio"] else ""
        yield from ("", f"Operations of the {plan['operations_of']}")
        yield from self.row("this scene", plan["operations"])
        yield from self.row("code for any scene", plan["operations_general"], times)
        if loops := plan.get("equation_36"):
            yield from ("", "Closed loops")
            for name, key in LOOPS:
                compared = key == "operations" and loops["ratio"]
                times = f"{loops['ratio']:.2f} times the open chain of as many joints" if compared else ""
                yield from self.row(name, loops[key], times)
        if plan["kernels"]:
            yield from self.heading("Programs", "operations", "how")
        for k in plan["kernels"]:
            reads = ", ".join(f"{group}[{n}]" for group, n in k["inputs"].items()) or "nothing"
            text = f"{_how(k)}; reads {reads}, {plural(len(k['numbers']), 'number')}; digest {k['digest']}"
            yield from self.row(k["name"], k["operations"], text)
        yield from self.numbers(plan["kernels"])
        if plan["choices"]:
            yield from ("", "Choices")
        for c in plan["choices"]:
            counts = ", ".join(f"{name} {n}" for name, n in c.get("operations", {}).items())
            text = f"{c['choice']}: {c['taken']} ({c['reason']}){'; ' if counts else ''}{counts}"
            yield from textwrap.wrap(text, self.width, initial_indent=INDENT, subsequent_indent=INDENT * 2)

    def wrapped(self, text: str, indent: str = "") -> list[str]:
        return textwrap.wrap(text, self.width, initial_indent=indent, subsequent_indent=indent)

    def heading(self, title: str, number: str, text: str) -> list[str]:
        return ["", f"{title:<{len(INDENT) + self.term}}{number:>{NUMBER}}{INDENT}{text}"]

    def row(self, name: str, number: int | None, text: str = "") -> list[str]:
        """Return one row of a table; name and text wrap inside their columns."""
        figure = "-" if number is None else str(number)
        reason = self.width - len(INDENT) - self.term - NUMBER - len(INDENT)
        names, texts = textwrap.wrap(name, self.term - 1), textwrap.wrap(text, reason)
        columns = zip_longest(names, [figure], texts, fillvalue="")
        return [
            f"{INDENT}{left:<{self.term}}{middle:>{NUMBER}}{INDENT}{right}" for left, middle, right in columns
        ]

    def numbers(self, kernels: list[dict[str, Any]]) -> Iterator[str]:
        """Say what of the scene is a number and what is structure."""
        if not kernels:
            return
        count = len({place for k in kernels for place in k["numbers"]})
        yield from ("", "Numbers")
        yield from self.wrapped(
            f"{plural(count, 'value')} of the scene {'is a number' if count == 1 else 'are numbers'} that the "
            "programs read from a table: another value compiles nothing. Structure: zeros, directions, angles that "
            "place frames, exponents, and values that are the default of their key.",
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
