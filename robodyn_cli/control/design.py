"""What a controller is, in figures: its gains, and of a regulator what it is the best of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


@record
class Named:
    """A row or a column of a matrix: its name, and its unit."""

    name: str
    unit: str


@record
class Leading:
    """What a controller leads: joints, or the axes of a point, with their units [rad or m] and those of their loads."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    loads: tuple[str, ...]


@record
class WithErrors:
    """Numbers with their errors, of the same shape."""

    values: Array
    errors: Array

    @staticmethod
    def exact(values: Array) -> WithErrors:
        return WithErrors(values, np.zeros(values.shape))


@record
class ControlDesign:
    """What a controller is.

    gains : (rows, columns): what rows give for each unit by which columns are off. poles : (n,) complex, of the loop
    that the controller is made for, in 1/s, or of a sampled one per sample; errors are distances in the complex plane.
    riccati : P (columns, columns), with x^T P x the least cost from x. at : position of each coordinate, holding :
    torque of each row, there where the gains belong to a pose; and the errors of these.
    """

    rows: tuple[Named, ...]
    columns: tuple[Named, ...]
    gains: WithErrors
    poles: WithErrors | None = None
    riccati: WithErrors | None = None
    at: tuple[tuple[Named, float], ...] = ()
    holding: tuple[float, ...] = ()
    at_errors: tuple[float, ...] = ()
    holding_errors: tuple[float, ...] = ()


def columns_of(of: Leading, integrals: bool = False) -> tuple[Named, ...]:
    """Return the columns of gains: positions, rates, and time integrals of positions."""
    named = list(zip(of.names, of.units))
    columns = [Named(name, unit) for name, unit in named]
    columns += [Named(f"qd.{name}", f"{unit}/s") for name, unit in named]
    if integrals:
        columns += [Named(f"integral.{name}", f"{unit} s") for name, unit in named]
    return tuple(columns)


def diagonal(of: Leading, *gains: Any) -> Array:
    """Return gains of each coordinate (n, n len(gains)): numbers for all, or maps by name."""
    return np.concatenate([np.diag(_of_each(gain, of.names)) for gain in gains], axis=1)


def _of_each(gain: Any, names: Sequence[str]) -> Array:
    return np.array([float(gain[name] if isinstance(gain, dict) else gain) for name in names])
