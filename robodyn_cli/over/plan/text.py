"""The plan as text: names and numbers as phrases, the table for the terminal, data that are missing or idle."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import zip_longest
from typing import Any

from robodyn_cli.errors import plural_of
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import PARAMETER_GROUP, UNKNOWN_GROUP, Model, unknown_among
from robodyn_cli.record import record
from robodyn_cli.scene import types as sc

SHOWN = 6  # names in a list before it is cut short


def listed(names: Iterable[str]) -> str:
    """Return names as a phrase; long lists are cut short."""
    names = list(dict.fromkeys(names))
    if len(names) > SHOWN:
        return f"{', '.join(names[: SHOWN - 1])} and {len(names) - SHOWN + 1} more"
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def plural(count: int, word: str) -> str:
    """Return ``2 joints``, ``1 joint``, ``no joint``; ``3 moving bodies``."""
    return f"{count or 'no'} {plural_of(word) if count > 1 else word}"


def listed_data(names: Iterable[str]) -> str:
    """Return names such as ``inertia.xx of link2`` as a phrase, links with the same data together."""
    of_link: dict[str, list[str]] = {}
    for name in names:
        datum, _, link = name.partition(" of ")
        of_link.setdefault(link, []).append(datum)
    same: dict[tuple[str, ...], list[str]] = {}
    for link, whats in of_link.items():
        same.setdefault(tuple(whats), []).append(link)
    return "; ".join(f"{', '.join(_short(whats))} of {listed(links)}" for whats, links in same.items())


def _short(whats: Sequence[str]) -> list[str]:
    """Return ``inertia.xx, yy`` for ``inertia.xx``, ``inertia.yy``."""
    tensor = [w.partition(".")[2] for w in whats if w.startswith("inertia.")]
    plain = [w for w in whats if not w.startswith("inertia.")]
    return [*plain, f"inertia.{tensor[0]}", *tensor[1:]] if tensor else plain


WIDTH, NARROWEST = 100, 48  # columns
TERM = 0.36  # of the columns
NUMBER = 11
INDENT = "  "
LOOPS = (
    ("the open tree, loops cut", "open_tree"),
    ("terms of the loops", "loop_terms"),
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
            "Kept: operations that leaving a term out would save. Left out: operations that it would add in general "
            "form. Terms share work, so these figures do not add up to the total."
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


TENSOR = ("xx", "yy", "zz", "xy", "xz", "yz")


def unknown_data(model: Model, outputs: Sequence[Scalar]) -> tuple[list[str], list[str]]:
    """Return the data of the bodies that the scene does not give: those that the outputs need, and the others."""
    unknown = [e.value[0] for e in model.graph.nodes if e.op == "sym" and e.value[1] == UNKNOWN_GROUP]
    needed = unknown_among(outputs)
    return [n for n in unknown if n in needed], [n for n in unknown if n not in needed]


def idle_constants(scene: sc.Scene, outputs: Callable[[Model], Sequence[Scalar]]) -> list[str]:
    """Return given data without effect: made symbols, they do not occur in the finished graph."""
    names = _given(scene)
    model = build_model(scene, list(names))
    used = {e.value[0] for e in free_symbols(outputs(model)) if e.value[1] == PARAMETER_GROUP}
    return [text for path, text in names.items() if path not in used]


def _given(scene: sc.Scene) -> dict[str, str]:
    """Return the paths of the links' data that are given and not zero, with their names in messages."""
    paths: dict[str, str] = {}
    for link in scene.robot.links:
        path = f"links.{link.name}"
        if link.mass:
            paths[f"{path}.mass"] = f"mass of {link.name}"
        for k, x in enumerate(link.com or ()):
            if x:
                paths[f"{path}.com.{k}"] = f"com[{k}] of {link.name}"
        for key in TENSOR:
            if getattr(link.inertia, key):
                paths[f"{path}.inertia.{key}"] = f"inertia.{key} of {link.name}"
    return paths
