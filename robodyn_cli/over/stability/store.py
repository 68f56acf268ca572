"""The arrays of a report on stability, as datasets of its result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.integrators.methods.stability_region import limits
from robodyn_cli.over.stability.energy_growth import EnergyGrowth
from robodyn_cli.over.stability.spectrum import Spectrum
from robodyn_cli.record import record
from robodyn_cli.results.catalogue import TRIAL
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


def add_spectrum(result: Result, spectrum: Spectrum | None) -> None:
    """Store eigenvalues, stiffness ratios and step limits along the run."""
    if spectrum is None:
        return
    result.add("stability/time", spectrum.times)
    for name, part in (("real", spectrum.eigenvalues.real), ("imaginary", spectrum.eigenvalues.imag)):
        result.add(f"stability/eigenvalues_{name}", part)
    result.add("stability/stiffness_ratio", spectrum.ratios())
    result.add("stability/step_limit", spectrum.step_limits, names=tuple(limit.method for limit in limits()))


def add_trials(result: Result, trials: Sequence[MethodTrial]) -> None:
    """Store the figures of the table of methods; their words are in the summary."""
    rows = [[np.nan if getattr(t, n) is None else float(getattr(t, n)) for n in TRIAL] for t in trials]
    result.add("stability/methods", np.array(rows).reshape(len(trials), len(TRIAL)))


def add_energy(result: Result, energy: EnergyGrowth) -> None:
    """Store the error of the energy balance over many periods."""
    for g in energy.growths:
        if not len(g.times):
            continue
        dims = (f"{g.method}_sample",)
        result.add(f"energy_growth/{g.method}/periods", g.times / energy.period.seconds, dims=dims)
        result.add(f"energy_growth/{g.method}/error", g.error, dims=dims)


def add_gains(result: Result, planes: Mapping[str, GainPlane]) -> None:
    """Store what happened over the planes of gains; rows and columns are alpha and beta."""
    for name, plane in planes.items():
        if plane.gain is None:
            continue
        for path in ("drift", "error", "steps", "gain"):
            result.add(f"baumgarte/{name}/{path}", getattr(plane, path))
