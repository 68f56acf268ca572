"""The linear model under a hold, sampled with a period and late by a delay; the loop of the controller beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypedDict

import numpy as np

from robodyn_cli.errors import of_option
from robodyn_cli.observe.controllers.design import add_design
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.linear import DiscreteModel, LinearSignal, LoopKeys
from robodyn_cli.works.linearise.nominal import Nominal
from robodyn_cli.works.linearise.signals import input_signals, state_signals
from robodyn_cli.works.linearise.systems import OF_ROW, Systems
from robodyn_cli.works.loops.figures import add_loop, closed_loop, loop_margins
from robodyn_cli.works.loops.loop import ControlLoop
from robodyn_cli.works.loops.systems import sampled

SHORT = 1e-9  # of a period: a delay that differs by less is a multiple of it
MOST = 10_000  # periods of a delay


class ModelOptions(TypedDict, total=False):
    """What a linear model has: inputs and outputs by name, period and delay of the one under a hold [s]."""

    inputs: Sequence[str]
    outputs: Sequence[str]
    period: float | None
    delay: float | None


@record
class HoldTimes:
    """A period [s], and a delay as whole periods and the rest [s]."""

    period: float
    whole: int
    rest: float

    @property
    def delay(self) -> float:
        return self.whole * self.period + self.rest

    @property
    def count(self) -> int:
        """How many inputs are on their way."""
        return self.whole + (self.rest > 0.0)


def sampling_of(scene: Scene, period: float | None = None, delay: float | None = None) -> HoldTimes | None:
    """Return the sampling that is asked for, or the controller's; None without any.

    Raises
    ------
    SceneError : a period or a delay that is none, a delay without a period.
    """
    own = scene.control
    if period is None and own is not None and own.period is not None:
        period = float(own.period)
        delay = float(own.delay) if delay is None else delay
    if period is None:
        if delay is not None:
            raise of_option("--delay", "goes with --period, or with a controller that has one")
        return None
    late = 0.0 if delay is None else delay
    if not (math.isfinite(period) and period > 0.0 and 0.0 <= late <= MOST * period):
        raise of_option(
            f"--period {period:g}, --delay {late:g}",
            f"allowed: a period > 0 s, a delay of 0 to {MOST} periods",
        )
    whole = math.floor(late / period + SHORT)
    rest = late - whole * period
    return HoldTimes(period, whole, rest if rest > SHORT * period else 0.0)


def add_sampled(result: Result, systems: Systems, sampling: HoldTimes | None) -> DiscreteModel | None:
    """Store the sampled model of a state, and return what it is: its states are x, then the inputs on their way, the
    last one first."""
    given, linear = systems.given, systems.linear
    if sampling is None or systems.along or not given.inputs:
        return None
    A, B = sampled(linear.A[0], linear.B[0], sampling.period, sampling.whole, sampling.rest)
    n = len(linear.A[0])
    C, D = _measured(systems.C[0], systems.D[0], len(A), n, sampling)
    model = given.problem.model
    inputs = [(x.name, x.unit) for x in input_signals(model, given.inputs)]
    states = [(x.name, x.unit) for x in state_signals(model, given.places)]
    states += [(f"delayed{k + 1}.{name}", unit) for k in range(sampling.count) for name, unit in inputs]
    for name, matrix, rows, columns, signals in (
        ("A", A, "discrete_state", "discrete_state_column", states),
        ("B", B, "discrete_state", "input", inputs),
        ("C", C, "output", "discrete_state", states),
        ("D", D, "output", "input", inputs),
    ):
        result.add(
            f"discrete/{name}", matrix, dims=(rows, columns), names=tuple(x for x, _ in signals),
            column_units=tuple(f"{OF_ROW}, per {unit}" for _, unit in signals),
        )  # fmt: skip
    result.add("discrete/period", np.array(sampling.period))
    result.add("discrete/delay", np.array(sampling.delay))
    return DiscreteModel(sampling.period, sampling.delay, [LinearSignal(*state) for state in states])


def _measured(C: Array, D: Array, size: int, n: int, sampling: HoldTimes) -> tuple[Array, Array]:
    """Return C and D of the samples: what acts at a sample is the newest input that has come by then."""
    full = np.zeros((len(C), size))
    full[:, :n] = C
    late, m = sampling.whole + (sampling.rest > 0.0), D.shape[1]
    if not late:
        return full, D
    full[:, n + m * (late - 1) : n + m * late] = D
    return full, np.zeros_like(D)


def add_closed_loop(result: Result, scene: Scene, given: Nominal, loop: ControlLoop) -> LoopKeys:
    """Store the loop of the controller, and return what the summary says of it."""
    from robodyn_cli.equations.problem import Problem
    from robodyn_cli.ready.integrable import integrable

    control = Problem(integrable(scene)).control
    assert control is not None
    add_design(result, control)
    model = given.problem.model
    add_loop(result, loop, [x.unit for x in state_signals(model, given.places)])
    if loop.system.period is not None:
        result.add("loop/period", np.array(loop.system.period))
        result.add("loop/delay", np.array(float(scene.control.delay)))
    told = closed_loop(loop, given.words, float(scene.control.delay))
    return LoopKeys(loop_margins(loop), told)
