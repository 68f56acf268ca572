"""The estimate of a simulation's global error by a second, more accurate integration."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.integrator import Counters, Event, Grid, Integrator, Options
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.run.modes import Modes
from robodyn_cli.run.observe import Recorder

Array = NDArray[np.float64]
# the second run of the error estimate: this much tighter, but not below what double precision can resolve
TIGHTER = 50.0
TIGHTEST_RTOL = 3e-14


def tighter(options: Options, mean_step: float) -> tuple[Options, str]:
    """Return the options of the second run of the error estimate, and how it differs in words."""
    if options.step is not None:
        # a step longer than the run is as long as the run
        taken = options.step if options.step < 2.0 * mean_step else mean_step
        return dataclasses.replace(options, step=taken / 2), "step halved"
    if options.rtol >= 1e-12:
        rtol = max(options.rtol / TIGHTER, TIGHTEST_RTOL)
        atol = options.atol * rtol / options.rtol
        return dataclasses.replace(options, rtol=rtol, atol=atol), f"rtol {rtol:.1g}"
    # at the limit of double precision a tighter tolerance says nothing; other steps show the rounding errors
    return other_steps(options, mean_step)


def other_steps(options: Options, mean_step: float) -> tuple[Options, str]:
    """Return the options of a second run with shorter steps, and how it differs in words."""
    return dataclasses.replace(options, max_step=0.6 * mean_step), "steps 0.6 times as long"


def integrate_states(
    problem: Problem, system: System, method: str, start: Array, grid: Grid, end: float, options: Options
) -> tuple[Array, Counters]:
    """Integrate without observing, looking for kinks and modes only; returns states (T, nx) and the counters."""
    watched = tuple(event for event in system.events if event.kink or event.renewal or event.mode)
    if watched and len(watched) < len(system.events):
        system = dataclasses.replace(system, events=watched)
    modes = Modes(problem, system, options) if problem.gates else None
    integrator = Integrator(system, method)
    integrator.reset(grid.start, start if modes is None else modes.start(grid.start, start), options)
    if modes is not None:
        modes.attach(integrator)
    rows: list[Array] = []

    def on_event(event: Event) -> bool:
        return modes is None or not modes.owns(event) or modes.on_event(event)

    integrator.run(end, grid, lambda t, x: rows.append(x), on_event, watch=bool(watched))
    return np.concatenate(rows), integrator.counters


def estimate_error(
    problem: Problem,
    system: System,
    method: str,
    start: Array,
    grid: Grid,
    end: float,
    options: Options,
    recorder: Recorder,
    counters: Counters,
) -> dict[str, Any]:
    """Estimate the global error by a second integration that is more accurate than the first.

    The difference of the two is the error of the first, up to the (much smaller) error of the second: the
    largest over all samples, for q and qd apart. Nothing else about the two runs is shared but the method.
    """
    second, how = tighter(options, end / max(counters.steps, 1))
    grid = grid.every(recorder.every)
    report: dict[str, Any] = {"method": f"difference from a second integration with {how}"}
    try:
        states, more = integrate_states(problem, system, method, start, grid, end, second)
        if more.steps == counters.steps and options.step is None:
            # the tolerance does not decide about the steps, so the same ones were taken once more
            second, how = other_steps(options, end / max(counters.steps, 1))
            report["method"] = f"difference from a second integration with {how}"
            states, more = integrate_states(problem, system, method, start, grid, end, second)
    except NumericalError as error:
        report.update(state_max=None, reason=f"the second integration failed: {error.message}")
        return report
    states = recorder.observer.project(grid.times(0, len(states)), states)
    q, qd = recorder.array("q")[: len(states)], recorder.array("qd")[: len(states)]
    states = states[: len(q)]
    halved = 2.0 ** registry[method].order
    scale = 1.0 if registry[method].adaptive else halved / (halved - 1.0)
    other_q, other_qd, _ = system.split(states)
    dq, dv = scale * np.abs(other_q - q), scale * np.abs(other_qd - qd)
    floor = rounding_floor(q, qd, counters.steps)
    report.update(
        q_max=float(dq.max(initial=0.0)), qd_max=float(dv.max(initial=0.0)),
        state_max=float(max(dq.max(initial=0.0), dv.max(initial=0.0))),
        q_end=float(dq[-1].max(initial=0.0)), qd_end=float(dv[-1].max(initial=0.0)), rounding_floor=floor,
        steps=more.steps,
    )  # fmt: skip
    spread = float(max(np.ptp(q, axis=0).max(initial=0.0), 1e-300))
    if report["state_max"] > 1e-2 * max(spread, float(np.ptp(qd, axis=0).max(initial=0.0))):
        times = recorder.array("time")
        bad = np.flatnonzero(np.max(dq, axis=1) > 1e-2 * spread)
        report["meaningful_until"] = float(times[bad[0]]) if len(bad) else float(times[-1])
    report["at_rounding"] = bool(report["state_max"] < 100 * floor)
    return report


def rounding_floor(q: Array, qd: Array, steps: int) -> float:
    """Return the error that rounding alone is expected to leave: eps times the state, growing as sqrt(steps)."""
    size = max(float(np.abs(q).max(initial=0.0)), float(np.abs(qd).max(initial=0.0)))
    return 1.1e-16 * size * max(1.0, steps) ** 0.5
