"""The error of a simulation, estimated by a second and more accurate integration."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SingularConfigurationError
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.integrators.runtime.integrator import Counters, Event, Grid, Integrator, Options
from robodyn_cli.run.driver.contact_states import Modes
from robodyn_cli.run.driver.passage import NEAR_PASSAGE, Passage
from robodyn_cli.run.observation.recorder import Recorder

Array = NDArray[np.float64]
# the second run: so many times the steps, so that both together take less than three times the first, unless a
# tolerance so much tighter does it with fewer
MORE_STEPS = 1.9
MOST_STEPS = 4
TIGHTER = 50.0
TIGHTEST_RTOL = 1e-14  # not below what double precision can resolve
FINEST_RTOL = 1e-12  # below it, methods of high order are at rounding, where a tighter tolerance says nothing
SHORTER = 0.6
HIGH_ORDER = 7
NOT_MEANINGFUL = (
    1e-2  # part of its range beyond which an estimate of a quantity says no more than that it is lost
)
AT_ROUNDING = 100.0  # times the rounding floor


def tighter(options: Options, mean_step: float, method: str) -> tuple[Options, str]:
    """Return the options of the second run, and how it differs in words.

    A local error falls as h to the power p of the error estimate, so MORE_STEPS times the steps take a tolerance
    MORE_STEPS^p times tighter.
    """
    kind = registry[method]
    if options.step is not None:
        # a step longer than the run is as long as the run
        taken = options.step if options.step < 2.0 * mean_step else mean_step
        return dataclasses.replace(options, step=taken / 2), "step halved"
    factor = min(TIGHTER, MORE_STEPS ** (kind.order / kind.proportion))
    rtol = options.rtol / factor
    fine = options.rtol >= FINEST_RTOL if kind.order >= HIGH_ORDER else rtol >= TIGHTEST_RTOL
    if kind.adaptive and fine:
        return dataclasses.replace(options, rtol=rtol, atol=options.atol / factor), f"rtol {rtol:.1g}"
    # at the limit of double precision a tighter tolerance says nothing; other steps show the rounding errors
    return other_steps(options, mean_step)


def other_steps(options: Options, mean_step: float) -> tuple[Options, str]:
    """Return the options of a second run with shorter steps, and how it differs in words."""
    return dataclasses.replace(options, max_step=SHORTER * mean_step), f"steps {SHORTER:g} times as long"


def integrate_states(
    problem: Problem,
    system: System,
    method: str,
    start: Array,
    grid: Grid,
    end: float,
    options: Options,
    tick: Callable[[float], None] | None = None,
    passage: Passage | None = None,
) -> tuple[Array, Counters]:
    """Integrate without observing; returns states (T, nx) and the counters.

    Of the events only those are looked for that change how the motion goes on: kinks, modes, poses to be passed.
    """
    watched = tuple(e for e in system.events if e.kink or e.renewal or e.mode or e.name == NEAR_PASSAGE)
    if watched and len(watched) < len(system.events):
        system = dataclasses.replace(system, events=watched)
    modes = Modes(problem, system, options) if problem.gates else None
    integrator = Integrator(system, method)
    integrator.tick = tick
    integrator.reset(grid.start, start if modes is None else modes.start(grid.start, start), options)
    if modes is not None:
        modes.attach(integrator)
    rows: list[Array] = []

    def on_event(event: Event) -> bool:
        return modes is None or not modes.owns(event) or modes.on_event(event)

    stretches: list[Counters] = []
    if passage is None:
        integrator.run(end, grid, lambda t, x: rows.append(x), on_event, watch=bool(watched))
    else:
        passage.run(integrator, end, grid, lambda t, x: rows.append(x), on_event, stretches.append)
    return np.concatenate(rows), sum(stretches, integrator.counters)


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
    tick: Callable[[float], None] | None = None,
    passage: Passage | None = None,
) -> dict[str, Any]:
    """Estimate the global error by a second integration that is more accurate than the first.

    The difference of the two, D = e_1 - e_2, is the error of the first up to that of the second, which is smaller by
    (n_1 / n_2)^p for n steps each and order p: e_1 = D / (1 - (n_1 / n_2)^p). Reported are the largest over all
    samples, for q and qd apart. Nothing else about the two runs is shared but the method.
    """
    mean_step = end / max(counters.steps, 1)
    second, how = tighter(options, mean_step, method)
    # more steps than the first are what is asked of it, but not many times as many
    most = min(4 * options.max_steps, MOST_STEPS * counters.steps + 1000)
    second = dataclasses.replace(second, max_steps=most)
    grid = grid.every(recorder.every)
    report: dict[str, Any] = {"method": f"difference from a second integration with {how}"}
    try:
        try:
            states, more = integrate_states(problem, system, method, start, grid, end, second, tick, passage)
        except NumericalError as error:
            if error.details.get("status") != "max_steps" or options.step is not None:
                raise
            # a tolerance that the method cannot keep
            second, how = other_steps(dataclasses.replace(options, max_steps=most), mean_step)
            report["method"] = f"difference from a second integration with {how}"
            states, more = integrate_states(problem, system, method, start, grid, end, second, tick, passage)
        if more.steps <= 1.02 * counters.steps and options.step is None:
            # the tolerance does not decide about the steps, so the same ones were taken once more
            second, how = other_steps(second, mean_step)
            report["method"] = f"difference from a second integration with {how}"
            states, more = integrate_states(problem, system, method, start, grid, end, second, tick, passage)
    except (NumericalError, SingularConfigurationError) as error:
        report.update(state_max=None, reason=f"the second integration failed: {error.message}")
        return report
    states = recorder.observer.project(grid.times(0, len(states)), states)
    q, qd = recorder.array("q")[: len(states)], recorder.array("qd")[: len(states)]
    other_q, other_qd, _ = system.split(states[: len(q)])
    scale = remainder(method, counters.steps, more.steps)
    dq, dv = scale * np.abs(other_q - q), scale * np.abs(other_qd - qd)
    floor = rounding_floor(q, qd, counters.steps)
    report.update(
        q_max=float(dq.max(initial=0.0)), qd_max=float(dv.max(initial=0.0)),
        state_max=float(max(dq.max(initial=0.0), dv.max(initial=0.0))),
        q_end=float(dq[-1].max(initial=0.0)), qd_end=float(dv[-1].max(initial=0.0)), rounding_floor=floor,
        steps=more.steps,
    )  # fmt: skip
    lost = np.zeros(len(dq), dtype=bool)
    for found, motion in ((dq, q), (dv, qd)):
        spread = max(float(np.ptp(motion, axis=0).max(initial=0.0)), 1e-300)
        lost |= found.max(axis=1, initial=0.0) > NOT_MEANINGFUL * spread
    report["at_rounding"] = bool(report["state_max"] < AT_ROUNDING * floor)
    if lost.any() and not report["at_rounding"]:
        report["meaningful_until"] = float(recorder.array("time")[int(np.argmax(lost))])
    return report


def remainder(method: str, steps: int, more: int) -> float:
    """Return 1 / (1 - (n_1 / n_2)^p), at most 2: what the second run's own error hides of the first one's."""
    kind = registry[method]
    # between steps the dense output decides
    power = min(kind.order, kind.dense_order + 1)
    left = min(1.0, steps / max(more, 1)) ** power
    return float(1.0 / (1.0 - min(left, 0.5)))


def rounding_floor(q: Array, qd: Array, steps: int) -> float:
    """Return the error that rounding alone is expected to leave: eps times the state, growing as sqrt(steps)."""
    size = max(float(np.abs(q).max(initial=0.0)), float(np.abs(qd).max(initial=0.0)))
    return 1.1e-16 * size * max(1.0, steps) ** 0.5
