"""How a motion in the least time uses its limits: which of them binds when."""

from __future__ import annotations

import numpy as np

from robodyn_cli.model.model import Model
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.inverse import FastestFigures
from robodyn_cli.torques.program import Sampled
from robodyn_cli.trajectories.fastest import names_of
from robodyn_cli.trajectories.legs import Scaling

BINDS = 1e-3  # of a limit: as near to it the motion is on it


def use_of_limits(scaling: Scaling, model: Model, sampled: Sampled) -> tuple[list[str], Array]:
    """Return the names of the limits, ``joint kind``, and how much of each is used (T, n), 1 on the limit."""
    limits = names_of(scaling.limits, model.v_names)
    values = {"speed": sampled.motion.qd, "acceleration": sampled.motion.qdd, "effort": sampled.tau}
    columns = [
        np.abs(values[kind][:, model.v_names.index(name)]) / scaling.limits[kind][name]
        for kind, name in limits
    ]
    return [f"{name} {kind}" for kind, name in limits], np.column_stack(columns)


def add_limits(result: Result, scaling: Scaling, model: Model, sampled: Sampled) -> None:
    """Add the use of each limit, and the limit that binds at each sample, -1 where none does."""
    names, use = use_of_limits(scaling, model, sampled)
    result.add("limits/use", use, names=names)
    result.add("limits/binding", _binding(use))


def _binding(use: Array) -> Array:
    return np.where(use.max(axis=1) >= 1.0 - BINDS, use.argmax(axis=1), -1).astype(float)


def warnings(scaling: Scaling) -> list[str]:
    """Return what is to be said of a duration that is less exact than was asked for."""
    relative = scaling.error / scaling.law.duration
    if scaling.tolerance is None or relative <= scaling.tolerance:
        return []
    return [
        f"the least time is known to {relative:.1e} of it only, with {scaling.intervals} intervals of the path; "
        f"trajectory.tolerance asks for {scaling.tolerance:.1e}"
    ]


def figures(scaling: Scaling, model: Model, sampled: Sampled) -> FastestFigures:
    """Return the figures of a motion."""
    names, use = use_of_limits(scaling, model, sampled)
    binding = _binding(use)
    parts = {name: float(np.mean(binding == k)) for k, name in enumerate(names)}
    return FastestFigures(
        duration=scaling.law.duration,
        duration_error=scaling.error,
        largest_use=float(use.max()),
        binding={name: x for name, x in parts.items() if x > 0.0},
        intervals=scaling.intervals,
    )
