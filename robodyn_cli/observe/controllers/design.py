"""What a controller is, as datasets: gains, Riccati matrix, poles, the pose that it is made for, period and delay."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.control.design import Named, WithErrors
from robodyn_cli.equations.control.control import Control
from robodyn_cli.observe.units import unit_text
from robodyn_cli.results.result import Result


def add_design(result: Result, control: Control) -> None:
    """Add what a controller is to a result."""
    if control.period is not None:
        result.add("control/period", np.array(float(control.period)))
        result.add("control/delay", np.array(float(control.controller.delay)))
    own = control.design
    if own is None:
        return
    _add(result, "control/gains", own.gains, own.columns, "of the row")
    if own.riccati is not None:
        _add(result, "control/riccati", own.riccati, own.columns, "1 over that of the row")
    if own.poles is not None:
        unit = "1/s" if control.period is None else "1"
        for part in ("real", "imag"):
            name = {"real": "real", "imag": "imaginary"}[part]
            result.add(f"control/poles_{name}", getattr(own.poles.values, part), units=unit)
        result.add("control/poles_error", own.poles.errors, units=unit)
    if own.at:
        names = [name for name, _ in own.at]
        result.add("control/equilibrium", [x for _, x in own.at], **_columns(names))
        result.add("control/equilibrium_error", own.at_errors, **_columns(names))
        result.add("control/holding_torques", own.holding, **_columns(own.rows))
        result.add("control/holding_torques_error", own.holding_errors, **_columns(own.rows))


def _columns(named: Any) -> dict[str, Any]:
    units = tuple(x.unit for x in named)
    mixed = {"column_units": units} if len(set(units)) > 1 else {}
    return {"names": tuple(x.name for x in named), "units": unit_text(units), **mixed}


def _add(result: Result, path: str, found: WithErrors, columns: tuple[Named, ...], row: str) -> None:
    for name, data in ((path, found.values), (f"{path}_error", found.errors)):
        result.add(
            name, data, names=tuple(x.name for x in columns), units=f"{row}, over that of the column",
            column_units=tuple(f"{row}, per {x.unit}" for x in columns),
        )  # fmt: skip
