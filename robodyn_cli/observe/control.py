"""What is recorded of a controller, and of the signals that a scene asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.equations.control.control import MEASURED, MEASURED_RATES
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.observe.units import joint_columns, unit_text
from robodyn_cli.scene.types import Signal
from robodyn_cli.spatial.algebra import Array

SIGNALS = "signals"
SEEN = {MEASURED: "q", MEASURED_RATES: "qd"}  # datasets of what a controller sees, and of what it sees there
GROUPS = ("reference", "error", "torque", *SEEN, "states")


def control_outputs(problem: Problem) -> dict[str, Sequence[Scalar]]:
    """Return the expressions that are evaluated at the samples: ``control.GROUP`` and ``signals``."""
    outputs: dict[str, Sequence[Scalar]] = {}
    control = problem.control
    if control is not None:
        tracked = control.tracked
        outputs["control.reference"] = [x.wanted for x in tracked]
        outputs["control.error"] = [x.wanted - x.actual for x in tracked]
        outputs["control.torque"] = list(control.torques)
        outputs |= {f"control.{name}": control.group(name) for name in SEEN}
        outputs["control.states"] = list(control.z)
    outputs[SIGNALS] = signals_of(problem)
    return {name: entries for name, entries in outputs.items() if entries}


def signals_of(problem: Problem) -> list[Any]:
    """Return the values of the signals that a scene asks for."""
    given = problem.scene.outputs.signals
    if not given:
        return []
    names = problem.environment if problem.control is None else problem.control.exact.names()
    names = names | {f"tau.{name}": x for name, x in zip(problem.model.v_names, problem.actuator_torques)}
    return [_formula(signal).evaluate(names) for signal in given.values()]


def _formula(signal: Any) -> Any:
    return signal.value if isinstance(signal, Signal) else signal


def control_data(problem: Problem, arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Return the datasets of evaluated expressions, by path."""
    data = {f"control/{name}": arrays[f"control.{name}"] for name in GROUPS if f"control.{name}" in arrays}
    if SIGNALS in arrays:
        data |= {f"signals/{name}": x for name, x in zip(problem.scene.outputs.signals, arrays[SIGNALS].T)}
    return data


def control_columns(problem: Problem) -> dict[str, dict[str, Any]]:
    """Return units, meanings and names of the datasets, by path (arguments of ``Result.add``)."""
    columns: dict[str, dict[str, Any]] = {}
    control = problem.control
    if control is not None:
        names = tuple(x.name for x in control.tracked)
        units = tuple(x.unit for x in control.tracked)
        columns["control/reference"] = _column("reference of the controller", "tracked", names, units)
        columns["control/error"] = _column("reference less motion", "tracked", names, units)
        columns["control/torque"] = _column(
            "torque of the controller", "driven", control.joints, control.units
        )
        if control.group(MEASURED):
            for name, path in SEEN.items():
                given = joint_columns(problem.model)[path].described()
                columns[f"control/{name}"] = {**given, "long_name": f"{path} as the controller saw it last"}
        ones = ("1",) * len(control.names)
        columns["control/states"] = _column("states of the controller", "control_state", control.names, ones)
    for name, signal in problem.scene.outputs.signals.items():
        unit = signal.unit if isinstance(signal, Signal) else "1"
        columns[f"signals/{name}"] = {
            "units": unit, "long_name": f"signal {name}: {_formula(signal).text}", "dims": ("time",)
        }  # fmt: skip
    return columns


def _column(meaning: str, dimension: str, names: tuple[str, ...], units: tuple[str, ...]) -> dict[str, Any]:
    mixed = units if len(set(units)) > 1 else ()
    return {
        "units": unit_text(units) if units else "1",
        "long_name": meaning,
        "dims": ("time", dimension),
        "names": names,
        "column_units": mixed,
    }
