"""Which recorded columns a sampled controller holds between its updates, read off their expressions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.equations.control.control import Control
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.observe.control import control_outputs, signals_of
from robodyn_cli.results.held import NOT_HELD, HeldColumns

LATE = "held"  # the states that change when the torques do, a delay behind the sample


def held_columns(problem: Problem, control: Control) -> dict[str, HeldColumns]:
    """Return when the columns change that depend on nothing but states of a sampled controller, by path.

    An expression of states that change at different instants is not held, and one of no states is constant.
    """
    offsets = {
        z: control.rest if name.startswith(f"{LATE}.") and name not in control.own else 0.0
        for z, name in zip(control.z, control.names)
    }

    def offset(entry: Any) -> float:
        found = {offsets.get(symbol, NOT_HELD) for symbol in free_symbols([entry])}
        return found.pop() if len(found) == 1 else NOT_HELD

    def held(entries: Sequence[Any]) -> HeldColumns:
        return HeldColumns(float(control.period or 0.0), tuple(offset(x) for x in entries))

    signals = dict(zip(problem.scene.outputs.signals, signals_of(problem)))
    table = {name.replace(".", "/"): x for name, x in control_outputs(problem).items() if "." in name}
    table |= {"tau": list(problem.actuator_torques), **{f"signals/{k}": [x] for k, x in signals.items()}}
    found = {path: held(entries) for path, entries in table.items()}
    return {path: one for path, one in found.items() if any(map(one.is_held, range(len(one.offset))))}
