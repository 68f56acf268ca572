"""The arrays of a report on stability, as datasets of its result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.integrators.methods.stability_region import limits
from robodyn_cli.over.stability.energy_growth import EnergyGrowth
from robodyn_cli.over.stability.spectrum import Spectrum
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.stability import GainKeys, MethodTrial


@record
class GainPlane:
    """What a method made of the plane of gains [1/s]: drift, error and steps (n, n), rows by alpha."""

    keys: GainKeys
    gain: Array | None = None
    drift: Array | None = None
    error: Array | None = None
    steps: Array | None = None


def add_spectrum(result: Result, found: Spectrum | None) -> None:
    """Store eigenvalues, stiffness ratios and step limits along the run."""
    if found is None:
        return
    result.add(
        "stability/time", found.times, units="s", long_name="instants of the spectrum", dims=("instant",)
    )
    for name, part in (("real", found.eigenvalues.real), ("imaginary", found.eigenvalues.imag)):
        result.add(
            f"stability/eigenvalues_{name}",
            part,
            units="1/s",
            dims=("instant", "eigenvalue"),
            long_name=f"{name} parts of the eigenvalues of the linearised equations of motion",
        )
    result.add(
        "stability/stiffness_ratio",
        found.ratios(),
        units="1",
        dims=("instant",),
        long_name="fastest decay over the slowest rate of the run",
    )
    result.add(
        "stability/step_limit",
        found.step_limits,
        units="s",
        long_name="largest stable step",
        dims=("instant", "method"),
        names=tuple(limit.method for limit in limits()),
    )


def add_trials(result: Result, trials: Sequence[MethodTrial]) -> None:
    """Store the figures of the table of methods; their words are in the summary."""
    names = ("error", "relative", "estimate", "steps", "evaluations", "seconds", "until")
    rows = [[np.nan if getattr(t, n) is None else float(getattr(t, n)) for n in names] for t in trials]
    result.add(
        "stability/methods",
        np.array(rows).reshape(len(trials), len(names)),
        units="rad or m, 1, 1, s",
        long_name="what each method did, in the order of summary.methods",
        dims=("trial", "quantity"),
        names=names,
    )


def add_energy(result: Result, energy: EnergyGrowth) -> None:
    """Store the error of the energy balance over many periods."""
    for g in energy.growths:
        if not len(g.times):
            continue
        dims = (f"{g.method}_sample",)
        result.add(
            f"energy_growth/{g.method}/periods",
            g.times / energy.period.seconds,
            units="1",
            long_name="time in periods",
            dims=dims,
        )
        result.add(
            f"energy_growth/{g.method}/error",
            g.error,
            units="1",
            dims=dims,
            long_name="error of the energy balance over the energy exchanged",
        )


def add_gains(result: Result, planes: Mapping[str, GainPlane]) -> None:
    """Store what happened over the planes of gains; rows and columns are alpha and beta."""
    for name, plane in planes.items():
        if plane.gain is None:
            continue
        for path, data, units, meaning in (
            ("drift", plane.drift, "rad or m", "largest distance of the positions from the constraints"),
            ("error", plane.error, "rad or m", "largest error of any q"),
            ("steps", plane.steps, "1", "steps taken"),
        ):
            result.add(
                f"baumgarte/{name}/{path}", data, units=units, long_name=meaning, dims=("alpha", "beta")
            )
        result.add(
            f"baumgarte/{name}/gain",
            plane.gain,
            units="1/s",
            long_name="values of alpha and of beta",
            dims=("alpha",),
        )
