"""Linear systems as datasets: matrices, poles, frequency responses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.linear.poles import poles_of
from robodyn_cli.equations.linear.reduce import Linear
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.linear import LinearSignal, Mode
from robodyn_cli.works.linearise.nominal import Nominal
from robodyn_cli.works.linearise.signals import input_signals, state_signals

POINTS = 400  # of a frequency response
BEYOND = 10.0  # how far it goes beyond the slowest and the fastest pole


def poles_along(linear: Linear) -> tuple[Array, Array]:
    """Return the poles (T, 2n) of linear systems, from left to right, and their errors (T, 2n) [1/s]."""
    found = [poles_of(*each) for each in zip(linear.A, linear.rounding)]
    return np.array([poles for poles, _ in found]), np.array([errors for _, errors in found])


def frequencies_for(modes: Sequence[Mode]) -> Array:
    """Return angular frequencies (F,) [rad/s] that show what the modes do."""
    sizes = [math.tau * m.frequency for m in modes if m.frequency > 0.0] or [1.0]
    return np.geomspace(min(sizes) / BEYOND, max(sizes) * BEYOND, POINTS)


def response(A: Array, B: Array, C: Array, D: Array, frequencies: Array) -> Array:
    """Return C (j w E - A)^-1 B + D (F, outputs, inputs) at angular frequencies (F,) [rad/s]."""
    left = 1j * frequencies[:, None, None] * np.eye(len(A)) - A
    responses: Array = C @ np.linalg.solve(left, np.broadcast_to(B, (len(frequencies), *B.shape))) + D
    return responses


OF_ROW = "of the row"  # unit of an entry of a matrix, before that of its column


@record
class Systems:
    """x-dot = A x + B u, y = C x + D u at T states: C (T, outputs, 2n), D (T, outputs, inputs), and what y is."""

    given: Nominal
    linear: Linear
    C: Array
    D: Array
    outputs: list[LinearSignal]

    @property
    def along(self) -> bool:
        """Whether the states are those of a motion."""
        return self.given.about == "motion"


def add_matrices(result: Result, systems: Systems) -> None:
    """Store A to D and the poles, of one state or along a motion."""
    given, linear, along = systems.given, systems.linear, systems.along
    model = given.problem.model
    states, inputs = state_signals(model, given.places), input_signals(model, given.inputs)
    for name, matrix, rows, columns, signals in (
        ("A", linear.A, "state", "state", states), ("B", linear.B, "state", "input", inputs),
        ("C", systems.C, "output", "state", states), ("D", systems.D, "output", "input", inputs),
    ):  # fmt: skip
        if not signals:
            continue
        # two axes of a file may not have one name
        row = "of the row per s" if rows == "state" else OF_ROW
        across = f"{columns}_column" if rows == columns else columns
        result.add(
            f"linear/{name}", matrix if along else matrix[0], names=tuple(s.name for s in signals),
            units=f"{row}, over that of the column", column_units=tuple(f"{row}, per {s.unit}" for s in signals),
            dims=(*(("time",) if along else ()), rows, across),
        )  # fmt: skip
    poles, errors = poles_along(linear)
    for name, part in (("real", poles.real), ("imaginary", poles.imag), ("error", errors)):
        dims = ("time", "pole") if along else ("pole",)
        result.add(f"linear/poles_{name}", part if along else part[0], dims=dims)


def add_responses(result: Result, systems: Systems, samples: Sequence[int], modes: Sequence[Mode]) -> None:
    """Store the frequency responses at samples, over frequencies that show what ``modes`` do."""
    given, linear, along = systems.given, systems.linear, systems.along
    if not given.inputs or not samples:
        return
    w = frequencies_for(modes)
    responses = np.array([response(linear.A[k], linear.B[k], systems.C[k], systems.D[k], w) for k in samples])
    result.add("linear/frequency", w)
    if along:
        result.add("linear/instant", given.states.times[list(samples)])
    inputs = input_signals(given.problem.model, given.inputs)
    for name, part in (("real", responses.real), ("imaginary", responses.imag)):
        result.add(
            f"linear/response_{name}", part if along else part[0], names=tuple(s.name for s in inputs),
            units=f"{OF_ROW}, over that of the column", column_units=tuple(f"{OF_ROW}, per {s.unit}" for s in inputs),
            dims=(*(("instant",) if along else ()), "frequency", "output", "input"),
        )  # fmt: skip
