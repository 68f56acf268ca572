"""The runs that are compared by ``work-precision``: what each was asked, what it reached, what it cost."""

from __future__ import annotations

import dataclasses
import math
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np

from robodyn_cli.errors import CapabilityError, NumericalError, SingularConfigurationError
from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import REFERENCES
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.kernels.cache import REPORT
from robodyn_cli.motion.build import watched_system
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.method import LARGEST
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.references import Deadline, ran_out, tight
from robodyn_cli.scene.types import Baumgarte
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.stability import TimedRun

T = TypeVar("T")

LONGEST = 400_000  # steps after which a run counts as too slow
SECONDS = 20.0  # as the last resort, the time after which it does; three times that for a reference
FEW_SECONDS = 1.0  # a run that takes longer is made once


def supported(method: str, system: System) -> bool:
    """Tell whether a method can do a system."""
    if registry[method].needs_jacobian and system.nv > LARGEST:
        return False
    return not registry[method].obstacle(system)


def in_formulation(motion: Motion, stabilisation: str | Baumgarte) -> Motion:
    """Return the motion with its loops kept closed in another way, and with watchers of its own."""
    system = watched_system(motion.problem, stabilisation, motion.watchers, work=False)
    other = motion.with_own_watchers(system)
    for watcher in other.watchers:
        watcher.follow(other)
    return other


def driver_of(motion: Motion, method: str, options: Options, seconds: float) -> Driver:
    """Return the driver of a run that is to be over after so many seconds."""
    driver = Driver(motion.system, method, options, motion.watchers)
    driver.integrator.engine.expect(math.inf)  # code whose time counts is the code that lasts
    driver.tick = Deadline(seconds)
    return driver


def tight_runs(motion: Motion, run: Callable[[str, Options], T]) -> Iterator[tuple[str, T]]:
    """Yield what ``run`` makes of a motion by each method for references that gets through at tight tolerance."""
    for method in REFERENCES:
        if not supported(method, motion.system):
            continue
        try:
            outcome = run(method, Options(tight(method), tight(method), max_steps=5 * LONGEST))
        except (NumericalError, SingularConfigurationError):
            continue
        yield method, outcome


def positions_and_rates(system: System, states: Array) -> Array:
    """Return q and v (..., nq + nv) of states (..., nx)."""
    q, v, _ = system.split(states)
    return np.concatenate([q, v], axis=-1)


def run_entry(
    motion: Motion,
    entry: TimedRun,
    judge: Callable[[Driver, TimedRun, Motion], None],
    end: float,
    repeats: int,
) -> TimedRun:
    """Fill in an entry: what ``judge`` makes of a run, median run time without output up to ``end``, counters."""
    tolerance = entry.tolerance or 1e-10
    options = Options(tolerance, tolerance, entry.step, max_steps=LONGEST)
    compiling = REPORT.seconds
    try:
        driver = driver_of(motion, entry.method, options, SECONDS)
        entry.compile_time_s = REPORT.seconds - compiling
        driver.start(0.0, motion.start)
        began = time.perf_counter()
        judge(driver, entry, motion)
        took = time.perf_counter() - began
        entry.steps = driver.counters.steps
        entry.run_time_s = statistics.median(
            _time_without_output(driver, motion, end) for _ in range(repeats if took < FEW_SECONDS else 1)
        )
        # without output there are fewer evaluations: those belong to the time
        entry.evaluations = driver.counters.evaluations
    except CapabilityError:
        entry.status = "unsupported"
    except SingularConfigurationError:
        entry.status = "diverged"
    except NumericalError as error:
        entry.status = "too_slow" if ran_out(error) else "diverged"
    return entry


def _time_without_output(driver: Driver, motion: Motion, end: float) -> float:
    """Return how long a run without samples takes [s]."""
    driver.start(0.0, motion.start)
    began = time.perf_counter()
    if motion.watchers:
        driver.run(end, Grid(end, 0.0, 0), lambda t, x: None)
    else:
        driver.advance(end)
    return time.perf_counter() - began


def values_of(entry: TimedRun, names: Sequence[str]) -> list[float]:
    """Return figures of an entry, NaN where there is none."""
    figures = (getattr(entry, name) for name in names)
    return [np.nan if x is None or x is ABSENT else float(x) for x in figures]


def fields_of(entry: TimedRun) -> dict[str, Any]:
    """Return the fields of an entry by name."""
    return {field.name: getattr(entry, field.name) for field in dataclasses.fields(entry)}
