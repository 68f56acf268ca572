"""Criteria of a scene (``expect``) against the summary of its run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from robodyn_cli.commands import COMMANDS
from robodyn_cli.errors import INTERNAL, OF_STATUS, SceneError, did_you_mean
from robodyn_cli.expr.statements import Expectation
from robodyn_cli.summaries.checks import JudgedCriterion
from robodyn_cli.summaries.keys import leaf_of

EXIT_CODE = "exit_code"  # the key of the exit code, which every run has
_ABSENT: Any = object()


def exit_code(summary: Mapping[str, Any]) -> int:
    """Return the exit code with which a run ended, from its summary."""
    error = summary.get("error")
    if isinstance(error, Mapping) and isinstance(error.get("exit_code"), int):
        return int(error["exit_code"])
    return OF_STATUS.get(str(summary.get("status")), INTERNAL)


def judge(
    expect: Mapping[str, Expectation], summary: Mapping[str, Any], place: str = ""
) -> list[JudgedCriterion]:
    """Return the outcome of each criterion.

    Raises
    ------
    SceneError : a key that a summary of this command does not have.
    """
    facts = {**summary, EXIT_CODE: exit_code(summary)}
    outcomes: list[JudgedCriterion] = []
    for key, expected in expect.items():
        value = lookup(facts, key)
        if value is _ABSENT:
            if summary.get("status") != "failed":
                raise _unknown(key, facts, place, f"expect.{key}")
            outcomes.append(
                JudgedCriterion(key, expected.text, None, False, "not there, since the run failed")
            )
            continue
        if isinstance(value, (Mapping, list)):
            inner = ", ".join(
                f"{key}.{name}" for name in (value if isinstance(value, Mapping) else range(len(value)))
            )
            raise SceneError(
                f"{place}expect.{key}: holds several values; name one: {inner}", key=f"expect.{key}"
            )
        if value is None and _is_infinite(summary, key):
            outcomes.append(JudgedCriterion(key, expected.text, None, expected.holds(math.inf), "infinite"))
            continue
        holds, shown = expected.holds(value), expected.shown(value)
        is_exact = expected.low == expected.high
        if not holds and is_exact and isinstance(value, float) and math.isclose(value, expected.low):
            shown += f", off by rounding: {expected.text!r} has no tolerance, '{expected.text} +- 1e-6 %' has"
        outcomes.append(JudgedCriterion(key, expected.text, value, holds, shown))
    return outcomes


def _is_infinite(summary: Mapping[str, Any], key: str) -> bool:
    """Tell whether null under a key stands for a number that is infinite."""
    command = summary.get("command")
    leaf = leaf_of(command, key) if command in COMMANDS else None
    return leaf is not None and leaf.fact.infinite


def lookup(facts: Mapping[str, Any], key: str) -> Any:
    """Return the value under a key path; ``peak_torque.theta1`` stands for ``joints.theta1.peak_torque``."""
    value = _descend(facts, key.split("."))
    if value is not _ABSENT:
        return value
    quantity, _, joint = key.partition(".")
    joints = facts.get("joints")
    if isinstance(joints, Mapping) and joint in joints:
        return _descend(joints[joint], [quantity])
    return _ABSENT


def lookup_number(facts: Mapping[str, Any], key: str) -> float | None:
    """Return the number under a key path, true as 1 and false as 0; None where there is none."""
    value = lookup(facts, key)
    return float(value) if isinstance(value, (bool, int, float)) else None


def refuse_unknown(facts: Mapping[str, Any], key: str, asked: str) -> None:
    """Refuse a key that a summary does not have, unless the run failed before it had one.

    asked : what asks for the key, named first: ``--of final.q.z``.

    Raises
    ------
    SceneError
    """
    if lookup(facts, key) is _ABSENT and facts.get("status") != "failed":
        raise _unknown(key, facts, "", asked)


def _descend(node: Any, steps: list[str]) -> Any:
    """Return what a path leads to; nothing lies below nothing, and names may have dots in them."""
    if not steps or node is None:
        return node
    if isinstance(node, list) and steps[0].isdecimal() and int(steps[0]) < len(node):
        return _descend(node[int(steps[0])], steps[1:])
    if isinstance(node, Mapping):
        for k in range(len(steps), 0, -1):
            name = ".".join(steps[:k])
            if name in node:
                return _descend(node[name], steps[k:])
    return _ABSENT


def _leaves(node: Any, path: str = "") -> Iterator[str]:
    if isinstance(node, Mapping):
        for name, value in node.items():
            yield from _leaves(value, f"{path}.{name}" if path else str(name))
    else:
        yield path


def _unknown(key: str, facts: Mapping[str, Any], place: str, asked: str) -> SceneError:
    options = list(_leaves(facts))
    joints = facts.get("joints")
    for joint, row in joints.items() if isinstance(joints, Mapping) else ():
        options += [f"{quantity}.{joint}" for quantity in row]
    head = key.partition(".")[0]
    near = [name for name in options if name.partition(".")[0] == head]
    hint = did_you_mean(key, options)
    allowed = f"; below {head!r}: {', '.join(near[:12])}" if near and head in facts else ""
    keys = f"; allowed: {', '.join(facts)}" if not allowed else ""
    return SceneError(f"{place}{asked}: the summary has no such key{hint}{allowed}{keys}", key=asked)
