"""Linear systems as datasets: matrices, poles, modes as poses, frequency responses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.linear.reduce import Linear
from robodyn_cli.equations.problem import Problem
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.observe.units import JointColumns
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.solve.closure import mechanism_size
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.linear import LinearSignal, Mode
from robodyn_cli.works.linearise.modes import frequencies_for, poles_along, response
from robodyn_cli.works.linearise.nominal import Nominal
from robodyn_cli.works.linearise.signals import input_signals, state_signals

SWING = 0.25  # rad, or a part of the size of the mechanism: how far a drawn mode goes
CLOSING = 12  # steps that close the loops of a drawn mode

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
    found = np.array([response(linear.A[k], linear.B[k], systems.C[k], systems.D[k], w) for k in samples])
    result.add("linear/frequency", w)
    if along:
        result.add("linear/instant", given.states.times[list(samples)])
    inputs = input_signals(given.problem.model, given.inputs)
    for name, part in (("real", found.real), ("imaginary", found.imag)):
        result.add(
            f"linear/response_{name}", part if along else part[0], names=tuple(s.name for s in inputs),
            units=f"{OF_ROW}, over that of the column", column_units=tuple(f"{OF_ROW}, per {s.unit}" for s in inputs),
            dims=(*(("instant",) if along else ()), "frequency", "output", "input"),
        )  # fmt: skip


def add_poses(result: Result, given: Nominal, modes: Sequence[Mode]) -> None:
    """Store the poses on both sides of each mode."""
    if modes:
        model = given.problem.model
        columns = JointColumns(model.q_names, model.q_units, ("mode", "side", "position"))
        result.add("modes/q", np.array([_swung(given, mode) for mode in modes]), **columns.described())


def _swung(given: Nominal, mode: Mode) -> list[Array]:
    """Return the poses (nq,) on both sides of a mode, with the loops closed."""
    problem, q = given.problem, given.states.q[0]
    model = problem.model
    step = np.array([size * np.cos(phase) for size, phase in mode.shape.values()])
    room = np.array([SWING if unit == "rad" else SWING * mechanism_size(model) for unit in model.v_units])
    step *= 1.0 / max(float((np.abs(step) / room).max(initial=0.0)), 1e-300) if step.any() else 0.0
    manifold = Manifold(model)
    return [_closed(problem, manifold, manifold.integrate(q, side * step)) for side in (1.0, -1.0)]


def _closed(problem: Problem, manifold: Manifold, q: Array) -> Array:
    """Return q with the loops closed by steps of least norm, as far as they go."""
    for _ in range(CLOSING if problem.constraints.rows else 0):
        eta = problem.numbers(problem.constraints.eta, q)
        q = manifold.integrate(q, -np.linalg.pinv(problem.numbers(problem.psi, q), rcond=1e-6) @ eta)
    return q
