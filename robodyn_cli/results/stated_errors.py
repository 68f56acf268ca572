"""The errors that a result states of its own figures, dataset by dataset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

# dataset -> path of the key in the summary that holds its largest error, in the unit of the dataset
STATED: dict[str, tuple[str, ...]] = {
    "q": ("error_estimate", "q_max"),
    "qd": ("error_estimate", "qd_max"),
    "tau": ("error_estimate", "torque_rounding"),
    "energy/total": ("energy_drift",),
    "constraints/position_residual": ("constraint_residual", "position"),
    "constraints/velocity_residual": ("constraint_residual", "velocity"),
}
# the energy balance, as the summary names it, in which the energy is a constant: its drift is its error
CONSERVED = "kinetic + potential"


def stated_error(result: Result, path: str) -> Array:
    """Return the error that a result states of a dataset, to be broadcast to its shape; nan where it states none.

    A lock states the error of its time, and a study the error of each output in each run.
    """
    summary = result.summary
    group, _, key = path.partition("/")
    if path in ("time", "events/time"):
        times = result.time if path == "time" else np.array([event.get("time") for event in result.events])
        at_lock = times == _number(summary, "lock", "time")
        return np.where(at_lock, _number(summary, "lock", "time_error"), np.nan)
    if group == "outputs" and f"errors/{key}" in result:
        return result[f"errors/{key}"]
    if path not in STATED or (path == "energy/total" and summary.get("energy_balance") != CONSERVED):
        return np.array(np.nan)
    # a run that goes on after the lock states its errors phase by phase
    phases = [summary, summary.get("after_lock")]
    return np.array(sum(_number(phase, *STATED[path]) for phase in phases if isinstance(phase, Mapping)))


def _number(summary: Mapping[str, Any], *keys: str) -> float:
    """Return the number under a path of keys; nan where there is none."""
    value: Any = summary
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return float(value) if isinstance(value, int | float) else np.nan
