"""The loop of a controller as datasets and as figures of the summary."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.control import LoopPole
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.loops import ClosedLoop, LoopErrors, LoopMargins
from robodyn_cli.works.loops.crossings import circle_candidates, grid
from robodyn_cli.works.loops.delays import delay_margin
from robodyn_cli.works.loops.loop import ControlLoop
from robodyn_cli.works.loops.margins import Margin, StabilityMargins, margins, sensitivity
from robodyn_cli.works.loops.systems import StateSpace

NONE_LEFT = StabilityMargins(
    Margin(1.0), Margin(1.0), Margin(0.0), Margin(0.0), Margin(math.inf, math.nan)
)  # of a loop that is not stable


def loop_margins(loop: ControlLoop) -> dict[str, LoopMargins]:
    """Return the margins of each loop opened in turn, by its joint."""
    stable = loop.stability == "stable"
    found = {}
    for k, name in enumerate(loop.joints):
        opened = loop.system.closed(but=k)
        others = [other.closed(but=k) for other in loop.neighbours]
        found[name] = _told(_margins(loop, k, opened, others) if stable else NONE_LEFT)
    return found


def _margins(loop: ControlLoop, k: int, opened: StateSpace, others: Sequence[StateSpace]) -> StabilityMargins:
    """Return the margins of the loop opened at input k; under a hold the delay is that of the exact models."""
    found, period = margins(opened, others), opened.period
    if period is None:
        return found
    with np.errstate(all="ignore"):
        delay = delay_margin(lambda more: loop.later(k, more), period)
    return dataclasses.replace(found, delay=delay)


def _told(of: StabilityMargins) -> LoopMargins:
    kinds = [("gain", of.gain), ("reduction", of.reduction), ("phase", of.phase), ("delay", of.delay)]
    kinds.append(("sensitivity", of.sensitivity))
    keys = ("gain_margin", "gain_reduction", "phase_margin", "delay_margin", "sensitivity_peak")
    values: dict[str, Any] = {}
    errors: dict[str, float | None] = {}
    for key, (kind, margin) in zip(keys, kinds):
        values[key], values[f"{kind}_frequency"] = _finite(margin.value), _finite(margin.frequency)
        errors[key], errors[f"{kind}_frequency"] = _finite(margin.error), _finite(margin.frequency_error)
    return LoopMargins(**values, errors=LoopErrors(**errors))


def _finite(x: float) -> float | None:
    return x if math.isfinite(x) else None


def closed_loop(loop: ControlLoop, words: str, delay: float) -> ClosedLoop:
    """Return what there is to say of the loop with all inputs closed."""
    stability = loop.stability
    most = sensitivity(loop.system, loop.neighbours) if stability == "stable" else NONE_LEFT.sensitivity
    sampled = loop.system.period is not None
    return ClosedLoop(
        words,
        stability,
        [LoopPole(float(s.real), float(s.imag), float(e)) for s, e in zip(loop.poles, loop.errors)],
        ABSENT if loop.system.period is None else loop.system.period,
        delay if sampled else ABSENT,
        _finite(most.value),
        _finite(most.frequency),
        _finite(most.error),
        _finite(most.frequency_error),
        loop.standing.left or ABSENT,
        list(loop.standing.saturated) or ABSENT,
        list(loop.law.restless) or ABSENT,
    )


def add_loop(result: Result, loop: ControlLoop, units: Sequence[str]) -> None:
    """Store the loop: matrices, poles, the gains of the law, responses of each loop opened in turn, and the singular
    values of the whole one.

    units : of the states of the plant in minimal coordinates.
    """
    system, joints = loop.system, loop.joints
    for name, matrix, dims in (
        ("A", system.A, ("loop_state", "loop_state_column")),
        ("B", system.B, ("loop_state", "input")),
        ("C", system.C, ("output", "loop_state")),
        ("D", system.D, ("output", "input")),
    ):
        result.add(f"loop/{name}", matrix, names=joints if dims[1] == "input" else loop.names, dims=dims)
    gains = -0.0 + loop.law.K
    result.add(
        "loop/gains", gains, names=loop.names[: len(units)],
        column_units=tuple(f"of the row, per {unit}" for unit in units),
    )  # fmt: skip
    unit = "1/s" if system.period is None else "1"
    for name, part in (("real", loop.poles.real), ("imaginary", loop.poles.imag), ("error", loop.errors)):
        result.add(f"loop/poles_{name}", part, units=unit)
    _add_responses(result, loop)


def _add_responses(result: Result, loop: ControlLoop) -> None:
    opened = [loop.system.closed(but=k) for k in range(len(loop.joints))]
    more = np.concatenate([circle_candidates(one) for one in opened])
    frequencies = _thinned(np.unique(np.concatenate([grid(one, more) for one in opened])))
    responses = np.array([one.at(frequencies)[:, 0, 0] for one in opened]).T
    whole = np.isfinite(loop.system.at(frequencies)) & np.isfinite(loop.system.sensitivity.at(frequencies))
    kept = np.isfinite(responses).all(axis=1) & whole.all(axis=(1, 2))
    frequencies, responses = frequencies[kept], responses[kept]
    result.add("loop/frequency", frequencies)
    result.add("loop/response_real", responses.real, names=loop.joints)
    result.add("loop/response_imaginary", responses.imag, names=loop.joints)
    result.add("loop/singular_values", _singular(loop.system, frequencies))
    result.add("loop/sensitivity", _singular(loop.system.sensitivity, frequencies))


MOST = 1200  # frequencies that are stored
CLOSE = 1e-6  # frequencies nearer to each other, relative, are one


def _thinned(frequencies: Array) -> Array:
    """Return frequencies that are apart, no more than can be drawn."""
    apart = np.concatenate([[True], np.diff(frequencies) > CLOSE * frequencies[1:]])
    found = frequencies[apart]
    if len(found) > MOST:
        found = found[np.unique(np.linspace(0, len(found) - 1, MOST).astype(int))]
    return found


def _singular(system: StateSpace, frequencies: Array) -> Array:
    found: Array = np.linalg.svd(system.at(frequencies), compute_uv=False)
    return found
