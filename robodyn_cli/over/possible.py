"""Which numbers the summaries of a command may have, from the records that they are made of.

The run of the scene as it stands does not tell where it has nothing: below ``lock`` where it does not lock, or behind
what made it fail.
"""

from __future__ import annotations

import builtins
import dataclasses
import importlib
import re
import sys
import types
from collections.abc import Collection, Sequence
from typing import Any, Union, get_args, get_origin, get_type_hints

RECORDS = {
    "simulate": ["robodyn_cli.motion.summary:MotionSummary"],
    "deploy": [
        "robodyn_cli.motion.summary:MotionSummary",
        "robodyn_cli.works.deploy.summary:DeploySummary",
    ],
    "inverse": ["robodyn_cli.works.inverse_summary:InverseSummary"],
    "statics": ["robodyn_cli.works.mechanism_summary:StaticsSummary"],
    "kinematics": ["robodyn_cli.works.mechanism_summary:KinematicsSummary"],
    "reach": ["robodyn_cli.works.reach:ReachSummary"],
}
OF_ALL = {"error": Any, "wall_time_s": dict[str, float], "exit_code": int}  # beside a command's own
NUMBERS = (float, int, bool)
Names = Collection[str]


def is_possible(command: str, key: str, text: str) -> bool:
    """Tell whether some run of a scene may have a number under a key of its summary.

    text : of the scene; joints, points and the like have names that stand there.
    """
    fields = dict(OF_ALL)
    for place in RECORDS.get(command, ()):
        module, _, name = place.partition(":")
        fields.update(_fields(getattr(importlib.import_module(module), name)))
    if command not in RECORDS:
        return True
    names = frozenset(re.findall(r"[\w-]+", text))
    head, *steps = key.split(".")
    if head in fields:
        return _leads(fields[head], steps, names)
    return "joints" in fields and _leads(fields["joints"], [*steps, head], names)  # peak_torque.theta1


def _leads(kind: Any, steps: Sequence[str], names: Names) -> bool:
    """Tell whether steps lead from a value of some type to a number."""
    origin, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return True
    if origin in (Union, types.UnionType):
        return any(_leads(x, steps, names) for x in inner)
    if not steps:
        return kind in NUMBERS
    if origin is dict:
        splits = ((".".join(steps[:k]), steps[k:]) for k in range(1, len(steps) + 1))
        return any(_is_name(name, names) and _leads(inner[1], rest, names) for name, rest in splits)
    if origin in (list, tuple):
        return steps[0].isdecimal() and _leads(inner[0], steps[1:], names)
    if dataclasses.is_dataclass(kind):
        fields = _fields(kind)
        return steps[0] in fields and _leads(fields[steps[0]], steps[1:], names)
    return False


def _is_name(name: str, names: Names) -> bool:
    """Tell whether a scene has a name; columns of a joint (``ball.qw``) have more behind a dot, levels are numbers."""
    first = name.partition(".")[0]
    return first in names or first.isdecimal()


def _fields(kind: Any) -> dict[str, Any]:
    """Return the types of a record's fields; ``Any`` where one is not imported when the program runs."""
    there = vars(sys.modules[kind.__module__])

    class Known(dict[str, Any]):
        def __missing__(self, name: str) -> Any:
            return there.get(name, getattr(builtins, name, Any))

    return get_type_hints(kind, localns=Known())
