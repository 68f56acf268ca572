"""The errors that a result states of its own figures: one table for plots, pages, notebooks and comparisons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from robodyn_cli.commands import SCENE_COMMANDS
from robodyn_cli.record import record
from robodyn_cli.results.result import Result, column_names, units_of
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.summaries.motion import NOT_MEANINGFUL


@record
class Statement:
    """An error or a residual that a summary may state.

    key : its path in the summary.
    words : what it is.
    about : datasets, or groups of them, that are to be read with it.
    bounds : the dataset whose largest error it is, in the unit of the dataset; empty if there is none.
    is_main : whether it is told where there is room for a few only.
    """

    key: tuple[str, ...]
    words: str
    about: tuple[str, ...]
    bounds: str = ""
    is_main: bool = False

    @property
    def unit(self) -> str:
        """Its unit, as the records of summaries declare it: the same for all commands that have it."""
        leaves = (leaf_of(command, ".".join(self.key)) for command in SCENE_COMMANDS)
        return next((leaf.unit({}) for leaf in leaves if leaf is not None), "1")

    def unit_in(self, result: Result) -> str:
        """Return its unit in a result: that of the dataset alone where all columns of it have the same."""
        path = self.bounds or (self.about[0] if len(self.about) == 1 else "")
        if path not in result.variables or " or " not in self.unit:
            return self.unit
        units = set(units_of(result.variables[path]))
        return units.pop() if len(units) == 1 else self.unit

    @property
    def is_residual(self) -> bool:
        """Whether the dataset that it bounds holds it sample by sample, and not a figure that is off by it."""
        return self.key[0] == "constraint_residual"

    def by_unit(self, result: Result, value: float) -> dict[str, float]:
        """Return what a residual of rows in several units is in each of them, where the samples tell: they have the
        stated value, too."""
        variable = result.variables.get(self.bounds) if self.is_residual else None
        if variable is None or not variable.data.size or len(set(units_of(variable))) < 2:
            return {}
        largest: dict[str, float] = {}
        for unit, x in zip(units_of(variable), np.abs(variable.data).max(axis=0).tolist()):
            largest[unit] = max(x, largest.get(unit, 0.0))
        return largest if max(largest.values()) >= value else {}


def beyond(apart: Any, stated: Any) -> Any:
    """Tell whether values are more apart than the sum of the errors that are stated of them; of arrays where."""
    return abs(apart) > stated


@record
class Stated:
    """What a summary states: the number, and in which phase of the run, in words; empty for the whole run."""

    statement: Statement
    phase: str
    value: float

    @property
    def words(self) -> str:
        """What it is, behind its phase."""
        return f"{self.phase}: {self.statement.words}" if self.phase else self.statement.words


# what is read off positions, velocities and loads of a mechanism
POSES = ("q", "points", "transmission_angle", "singularity", "branches", "four_bars")
RATES = (
    "qd",
    "point_velocities",
    *("poles", "centrodes", "relative_rates", "ratios", "pressure_angles", "curvatures"),
)
LOADS = ("constraints/multipliers", "reactions")
STATEMENTS = (
    Statement(("error_estimate", "q_max"), "largest error of q", POSES, "q", True),
    Statement(("error_estimate", "q_end"), "error of q at the end", ("q",)),
    Statement(("error_estimate", "qd_max"), "largest error of qd", RATES, "qd", True),
    Statement(("error_estimate", "qd_end"), "error of qd at the end", ("qd",)),
    Statement(("error_estimate", "state_max"), "largest error of the state", LOADS),
    Statement(("ik_residual",), "path off by", POSES, is_main=True),
    Statement(("attitude_residual",), "attitude on the path off by", POSES, is_main=True),
    Statement(
        ("error_estimate", "torque_rounding"),
        "rounding of any torque",
        ("tau", "torque_terms", "feed_forward/tau"),
        "tau",
    ),
    Statement(
        ("round_trip",),
        "forward after inverse dynamics: relative error",
        ("qdd", "tau", "torque_terms", "reactions", "shaking", "flywheel"),
        is_main=True,
    ),
    Statement(("energy_drift",), "energy drift", ("energy",), "energy/total", True),
    Statement(("energy_drift_relative",), "energy drift, over the energy exchanged", ("energy",)),
    Statement(("error_estimate", "energy_balance"), "work less the change of energy", ("energy",)),
    Statement(
        ("error_estimate", "energy_balance_relative"),
        "work less the change of energy, over the work",
        ("energy",),
    ),
    Statement(("error_estimate", "energy_quadrature"), "energies with every second sample", ("energy",)),
    Statement(("error_estimate", "rms_quadrature"), "RMS torques with every second sample", ("tau",)),
    Statement(
        ("constraint_residual", "position"),
        "constraints off by",
        (*POSES, "constraints"),
        "constraints/position_residual",
        True,
    ),
    Statement(
        ("constraint_residual", "velocity"),
        "velocities of the constraints off by",
        (*RATES, "constraints"),
        "constraints/velocity_residual",
    ),
    Statement(
        ("constraint_residual", "redundant"),
        "constraint rows that were left out off by",
        ("constraints",),
    ),
    Statement(("error_estimate", "closure", "position"), "loops off by", POSES, is_main=True),
    Statement(("error_estimate", "closure", "velocity"), "velocities of the loops off by", RATES),
    Statement(
        ("error_estimate", "closure", "acceleration"),
        "accelerations of the loops off by",
        ("qdd", "point_accelerations", "constraints/multipliers", "acceleration_poles", "curvatures"),
    ),
    Statement(
        ("error_estimate", "virtual_work_residual"),
        "virtual work of actuators and loads out of balance by",
        ("tau", "constraints/multipliers"),
    ),
    Statement(
        ("error_estimate", "force_residual"),
        "forces out of balance by",
        (),
        is_main=True,
    ),
)
# datasets of one sample whose errors the summary states by the names of their columns: under which key, and what names
BY_COLUMN = {
    "q": ("configuration", "JOINT"),
    "qd": ("rates", "JOINT"),
    "qdd": ("accelerations", "JOINT"),
    "tau": ("torques_of_joints", "JOINT"),
    "constraints/multipliers": ("multipliers", "ROW"),
}
# loads, whose largest magnitudes have their errors beside them
LARGEST = ("reactions", "loop_reactions", "base_wrench")
# a run that goes on after the lock states its errors phase by phase
PHASES = {"": (), "after the lock": ("after_lock",)}
# datasets, and groups of them, that have their errors in another one
BESIDE = {
    "outputs": "errors",
    "derivatives": "derivative_errors",
    "linear/poles_real": "linear/poles_error",
    "linear/poles_imaginary": "linear/poles_error",
    "control/gains": "control/gains_error",
    "loop/poles_real": "loop/poles_error",
    "loop/poles_imaginary": "loop/poles_error",
    "control/riccati": "control/riccati_error",
    "control/equilibrium": "control/equilibrium_error",
    "control/holding_torques": "control/holding_torques_error",
    "control/poles_real": "control/poles_error",
    "control/poles_imaginary": "control/poles_error",
}
# the energy balance, as the summary names it, in which the energy is a constant: its drift is its error
CONSERVED = "kinetic + potential"


def stated(summary: Mapping[str, Any]) -> Iterator[Stated]:
    """Yield what a summary states of its errors."""
    for phase, place in PHASES.items():
        for statement in STATEMENTS:
            value = _number(summary, *place, *statement.key)
            if np.isfinite(value):
                yield Stated(statement, phase, value)


def concerning(summary: Mapping[str, Any], path: str) -> Iterator[Stated]:
    """Yield what a summary states of the errors of a dataset, or of all in a group."""
    for error in stated(summary):
        if any(_is_inside(path, about) or _is_inside(about, path) for about in error.statement.about):
            yield error


def error_places(path: str) -> list[str]:
    """Return where the error of a dataset stands: keys of the summary, or the dataset beside it; none where nowhere."""
    if path in ("time", "events/time"):
        return ["lock.time_error"]
    if path in BESIDE:
        return [f"/{BESIDE[path]}"]
    group, _, name = path.partition("/")
    if group in BESIDE:
        return [f"/{BESIDE[group]}/{name}"]
    places = [".".join(one.key) for one in STATEMENTS if any(_is_inside(path, about) for about in one.about)]
    if path in BY_COLUMN:
        places.append("error_estimate.{}.{}".format(*BY_COLUMN[path]))
    if group in LARGEST:
        places += [f"reactions.largest.{name or group}.{load}_error" for load in ("force", "moment")]
    return places


def _is_inside(path: str, group: str) -> bool:
    return path == group or path.startswith(f"{group}/")


def stated_error(result: Result, path: str) -> Array:
    """Return the error that a result states of a dataset, to be broadcast to its shape; nan where it states none.

    A lock states the error of its time, a study the error of each output in each run, and derivatives have theirs.
    """
    summary = result.summary
    group, _, key = path.partition("/")
    if path in ("time", "events/time"):
        times = result.time if path == "time" else np.array([event.get("time") for event in result.events])
        at_lock = times == _number(summary, "lock", "time")
        return np.where(at_lock, _number(summary, "lock", "time_error"), np.nan)
    beside = BESIDE.get(path) or f"{BESIDE.get(group)}/{key}"
    if beside in result:
        return result[beside]
    if (by_column := _errors_by_column(result, path)) is not None:
        return by_column
    if path == "energy/total" and summary.get("energy_balance") != CONSERVED:
        return np.array(np.nan)
    # one phase without an error leaves the dataset without one
    phases = [place for place in PHASES.values() if not place or isinstance(summary.get(*place), Mapping)]
    keys = [one.key for one in STATEMENTS if one.bounds == path]
    return np.array(
        sum(_number(summary, *place, *key) for place in phases for key in keys) if keys else np.nan
    )


def _errors_by_column(result: Result, path: str) -> Array | None:
    """Return the errors (n,) that the summary of a result of one sample states by columns; None where it does not."""
    estimate = result.summary.get("error_estimate")
    errors = estimate.get(BY_COLUMN[path][0]) if path in BY_COLUMN and isinstance(estimate, Mapping) else None
    if not isinstance(errors, Mapping) or path not in result.variables:
        return None
    return np.array([_number(errors, name) for name in column_names(result.variables[path])])


def meaningful_until(summary: Mapping[str, Any]) -> float:
    """Return the time [s] from which on a motion is lost in its error; infinite where it never is."""
    key = ("error_estimate", "meaningful_until")
    return float(np.fmin.reduce([np.inf, *(_number(summary, *place, *key) for place in PHASES.values())]))


def meaningful_error(result: Result, path: str) -> float:
    """Return the largest error that a result states of a dataset over time while the motion is meaningful; nan where it
    states none."""
    error = stated_error(result, path)
    if error.size != 1 and path not in BY_COLUMN:
        return np.nan
    largest = float(error.max(initial=0.0))
    if path in ("q", "qd") and np.isfinite(meaningful_until(result.summary)):
        # the definition of the time from which on it is larger
        largest = min(largest, NOT_MEANINGFUL * float(np.ptp(result[path], axis=0).max(initial=0.0)))
    return largest


def _number(summary: Mapping[str, Any], *keys: str) -> float:
    """Return the number under a path of keys; nan where there is none."""
    value: Any = summary
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return float(value) if isinstance(value, int | float) else np.nan
