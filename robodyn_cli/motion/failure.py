"""Why a run could not go on, and what is doubtful about the configuration in which it starts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, RobodynError, SingularConfigurationError
from robodyn_cli.integrators.runtime.memory import DoubleSlot, resolution
from robodyn_cli.integrators.runtime.stopped import rates_at
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.motion import Motion
from robodyn_cli.observe.formulas import TimedState, formula_ending, formula_without_value
from robodyn_cli.ready.mass_matrix import nearly_singular
from robodyn_cli.ready.singularity import driven_dead_point, is_dead_point, psi_at
from robodyn_cli.solve.independent_rows import is_truss
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import rounded_up
from robodyn_cli.trajectories.led import led_joints

# kinds of failure that lie in the motion rather than in what the run may take
BREAKDOWNS = ("step_too_small", "not_finite", "not_solved")
LONG = 1e3  # times the time in which a motion changes that a step cannot be
SOON = 1e-9  # part of the duration ahead of a failure within which a formula that ends is its cause


def explained(error: RobodynError, motion: Motion, driver: Driver) -> RobodynError:
    """Return the error of a run that could not go on, with its cause where that can be told."""
    if not isinstance(error, NumericalError):
        return error
    problem = motion.problem
    q, _, _ = driver.system.split(driver.state)
    pose = driven_dead_point(problem, motion.passive, q, driver.time, motion.scene.simulate.duration)
    if pose is not None:
        time, where, kind, off = pose
        names = ", ".join(led_joints(problem.scene.prescribed))
        event = "dead point" if kind == "dead_point" else "singular configuration"
        return SingularConfigurationError(
            f"{event} at t = {time:.9g} +- {rounded_up(off):.1e} s under the prescribed motion of {names}: the passive "
            "joints cannot follow, and the multipliers diverge",
            time=time, kind=kind, q=where.tolist(),
        )  # fmt: skip
    return with_cause(error, problem, driver)


def with_cause(error: NumericalError, problem: Problem, driver: Driver) -> NumericalError:
    """Return the error with the formula, the joint or the duration that stopped the run, where that can be told."""
    status, duration = str(error.details.get("status")), problem.scene.simulate.duration
    q, v, z = driver.system.split(driver.state)
    if status == "max_steps":
        part = f"; that is {100.0 * driver.time / duration:.3g} % of simulate.duration ({duration:g} s)"
        return NumericalError(
            error.message + part + nearly_singular(problem, q, driver.time), **error.details
        )
    a, z_rate = _rates(driver)
    if status in BREAKDOWNS and (words := _too_long(driver, v, a, duration)):
        return NumericalError(error.message + words, **error.details)
    words, place = breakdown(problem, driver, status)
    at = TimedState(driver.time, q, v, z)
    if status in BREAKDOWNS and (formula := _formula(problem, at, a, z_rate)):
        words = f"; {formula.message}"
    return NumericalError(
        error.message + words + nearly_singular(problem, q, driver.time), **{**place, **error.details}
    )


def _rates(driver: Driver) -> tuple[Array, Array]:
    """Return the accelerations (nv,) and the rates of further states where a run has come to."""
    system = driver.system
    with np.errstate(all="ignore"):
        rates = np.asarray(rates_at(system, driver.time, driver.state, driver.parameters), dtype=float)
    _, a, z_rate = system.split(np.concatenate([np.zeros(system.nq), rates]))
    return a, z_rate


def _too_long(driver: Driver, v: Array, a: Array, duration: float) -> str:
    """Return words where steps that a method chose were given up, still far longer than the motion takes to change."""
    if driver.integrator.options.step is not None:
        return ""
    step = driver.integrator.w[DoubleSlot.H]
    with np.errstate(all="ignore"):
        rate = float(np.maximum(np.abs(v), np.sqrt(np.abs(a))).max(initial=0.0))  # of 1 rad or 1 m
    if not (np.isfinite(rate) and step * rate > LONG and step > LONG * resolution(driver.time, driver.time)):
        return ""
    return (
        f"; the motion changes within some {1.0 / rate:.1g} s there: simulate.duration ({duration:g} s) is so long "
        "that no step, down from a part of it, becomes short enough; allowed: a duration of the order of the motion"
    )


def _formula(problem: Problem, at: TimedState, a: Array, z_rate: Array) -> NumericalError | None:
    """Return the error of the formula of the scene that has no finite value at an instant, or right after it."""
    if (fault := formula_without_value(problem, at)) is not None or not np.all(np.isfinite(a)):
        return fault
    soon = SOON * problem.scene.simulate.duration
    moved = Manifold(problem.model).integrate(at.q, soon * at.v)
    z = None if at.z is None else at.z + soon * z_rate
    return formula_ending(problem, at, TimedState(at.t + soon, moved, at.v + soon * a, z))


def breakdown(problem: Problem, driver: Driver, status: str) -> tuple[str, dict[str, Any]]:
    """Return words for the message of a failed run, and ``joint`` and ``quantity`` for its details.

    Named is the first quantity that is not finite: position, rate, acceleration; where all are, the joint of the
    largest acceleration, over its rate where that is large too.
    """
    if status not in BREAKDOWNS:
        return "", {}
    model = problem.model
    system = driver.system
    q, v, _ = system.split(driver.state)
    a, _ = _rates(driver)
    for quantity, values, names in (
        ("position", q, model.q_names), ("rate", v, model.v_names), ("acceleration", a, model.v_names),
    ):  # fmt: skip
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            joint = str(names[int(bad[0])])
            return f"; joint {joint!r} has no finite {quantity} there", {"joint": joint, "quantity": quantity}
    worst = int(np.argmax(np.abs(a) / (1.0 + np.abs(v))))
    joint = str(model.v_names[worst])
    units = f"{model.v_units[worst]}/s^2"
    words = f"; the largest acceleration there, {abs(a[worst]):.3g} {units}, is that of joint {joint!r}"
    return words, {"joint": joint, "quantity": "acceleration"}


NEAR = 1e-6  # distance from a dead point that counts as none (see ``is_dead_point``)


def start_warnings(problem: Problem, q: Array, passive: Sequence[int]) -> list[str]:
    """Return warnings about the closed configuration ``q`` (nq,) at t = 0.

    A dead point of the input, where the block of Psi of the ``passive`` coordinates is singular, is no obstacle to a
    simulation. But the loops may have closed there because ``initial.q`` left them the choice, and then the input moves
    nothing: the passive joints alone can move, the driven ones at rest.
    """
    if is_truss(psi_at(problem, q)):
        closures = ", ".join(dict.fromkeys(row.closure for row in problem.constraints.loop_rows))
        return [
            f"nothing can move: the loops ({closures}) leave none of the {problem.model.nv} coordinates a freedom, so "
            "that this is a structure at rest"
        ]
    if len(passive) == problem.model.nv or not is_dead_point(problem, q, passive, NEAR):
        return []
    pose = ", ".join(f"{name} {x:.6g}" for name, x in zip(problem.model.q_names, q))
    remedy = (
        ""
        if problem.scene.initial.hold
        else "; if it is not meant, keep joints at their value with initial.hold"
    )
    return [
        f"the loops have closed in a dead point of the input ({pose}): there the driven joints cannot "
        f"move the mechanism, and small errors decide where it goes{remedy}"
    ]
