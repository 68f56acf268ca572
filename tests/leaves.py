"""The values in a summary, and whether their keys are declared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from robodyn_cli.commands import COMMANDS
from robodyn_cli.summaries.keys import leaf_of


def leaves(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the keys of a summary, with what stands there."""
    items = node.items() if isinstance(node, Mapping) else enumerate(node) if isinstance(node, list) else None
    if items is None:
        yield path, node
        return
    for name, value in items:
        yield from leaves(value, f"{path}.{name}" if path else str(name))


def undeclared(summary: Mapping[str, Any]) -> list[str]:
    """Return the keys of a summary that its records do not declare, and the numbers that have no meaning or unit."""
    command = summary["command"]
    assert COMMANDS[command].summary, f"{command} has no records of its summary"
    found = []
    for key, value in leaves(summary):
        leaf = leaf_of(command, key)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if leaf is None or (number and not (leaf.is_number and leaf.fact.doc and leaf.unit({}))):
            found.append(key)
    return found
