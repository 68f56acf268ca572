"""What every method of integration owes: a line in the registry is enough to be held to all of it."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest

from robodyn_cli.errors import NumericalError
from robodyn_cli.expr import functions as f
from robodyn_cli.formulations.events import EventFunction
from robodyn_cli.formulations.system import Corrections, System
from robodyn_cli.integration_methods import METHODS as METHODS_TABLE
from robodyn_cli.integrators.methods.explicit import ExplicitRungeKutta
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime import engine
from robodyn_cli.integrators.runtime import integrator as module
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.kernels import compiler, lower
from tests import systems
from tests.methods import (
    ADAPTIVE,
    ADAPTIVE_FAMILIES,
    FAMILIES,
    METHODS,
    TAYLOR,
    each_adaptive,
    each_adaptive_family,
    each_family,
    each_method,
    each_pair,
    taking,
)
from tests.systems import (
    CASES,
    Case,
    advance,
    collect,
    integrate,
    is_low,
    samples,
    settings,
    step_ends,
    system,
    within_reach,
)

FOR_STIFF = {m for m in METHODS if methods[m].needs_jacobian}
EXPLODING = {m for m in METHODS if not methods[m].adaptive} - FOR_STIFF
each_family_that_takes_velocities = pytest.mark.parametrize(
    "method", taking("accelerations from velocities", FAMILIES)
)
# the control of errors is tried on all cases by one method a family, and on pendulums by each
OTHERS = tuple(m for m in ADAPTIVE if m not in FAMILIES)
each_error = each_pair((ADAPTIVE_FAMILIES, CASES), (OTHERS, CASES[-1:]))
ENOUGH = 5_000_000  # steps
BLOW_UP = system(1, lambda t, q, v, z, p: [2.0 * q[0] * q[0] * q[0]])  # q = 1 / (1 - t)


def fine(method: str) -> dict[str, Any]:
    """Options that make any method accurate to about 1e-9."""
    if not methods[method].adaptive:
        return {"step": 2e-4 if is_low(method) else 0.004}
    return {"rtol": 1e-11, "atol": 1e-12}


def fine_error(method: str) -> float:
    """Error that these options leave, with a margin."""
    return 3e-6 if is_low(method) else 1e-8


def largest(x: Any) -> float:
    return float(np.abs(x).max(initial=0.0))


def end_error(case: Case, integrator: Integrator) -> float:
    return largest(integrator.state - case.exact(np.array([integrator.time]))[0])


# -- order ----------------------------------------------------------------------------------------------
# the iteration of these methods stops where the tolerance says, above rounding
FINEST = {"radau13": (1e-15, 1e-16), "gauss12": (1e-14, 1e-15), "gauss14": (1e-14, 1e-15)}


def slope(points: list[tuple[float, float]], order: int) -> float:
    """Return the order that errors over numbers of steps show, where neither rounding nor long steps spoil it."""
    low = 3e-11 if 10 < order < 16 else 3e-12 if order > 10 else 1e-13 + 1e-14 * points[-1][0]
    used = np.array([(n, e) for n, e in points if low < e < (1e-2 if order <= 2 else 1e-5)])
    assert len(used) >= 3, points
    return -float(np.polyfit(np.log(used[:, 0]), np.log(used[:, 1]), 1)[0])


@pytest.mark.parametrize("case", [systems.oscillator(), systems.damped(), systems.controlled()], ids=str)
def test_backward_differences_reach_their_highest_order(case: Case) -> None:
    """Order and step are chosen together, so what counts is how the error falls with the number of steps."""
    points = []
    for k in range(6, 13):
        integrator = Integrator(case.system, "bdf")
        integrator.reset(0.0, case.start, Options(10.0**-k, 10.0**-k))
        integrator.advance(case.end)
        points.append((integrator.counters.steps, end_error(case, integrator)))
    x, y = np.log(np.array(points)).T
    assert 4.3 < -np.polyfit(x, y, 1)[0] < 6.0


@pytest.mark.parametrize("method", [m for m in METHODS if m != "bdf"])
@pytest.mark.parametrize(
    "case", [systems.forced(work=True), systems.kepler(0.3), systems.pendulums(1.0, 2.0)], ids=str
)
def test_the_order_is_what_is_stated(method: str, case: Case, fixed_steps: None) -> None:
    integrator = Integrator(case.system, f"fixed {method}")
    order, dense_order = methods[method].order, methods[method].dense_order
    # very high orders need long runs, or steps long enough to show an error are too long to be solved
    end = case.end * (10.0 if order > 10 else 1.0)
    grid = Grid(0.0, end / 97.618, 98)  # samples that no number of steps has all at ends of steps
    ends: list[tuple[float, float]] = []
    inside: list[tuple[float, float]] = []
    steps = end / 5.0
    most, ratio = (30_000, 1.6) if order <= 2 else (4000, 1.05 if order > 10 else 1.1)
    while steps < most and (not ends or ends[-1][1] > (2e-12 if order > 10 else 5e-13)):
        steps = np.ceil(ratio * steps)
        step = end / steps
        options = Options(*FINEST.get(method, (1e-13, 1e-14)), step=step)
        integrator.reset(0.0, case.start, options)
        errors = []
        try:
            for stop in (0.37, 0.61, 0.83, 1.0):  # the error at one time may happen to vanish
                integrator.advance(stop * end)
                errors.append(end_error(case, integrator))
            integrator.reset(0.0, case.start, options)
            times, states = collect(integrator, end, grid)
        except NumericalError:
            continue  # the iteration of an implicit method does not converge in such long steps
        if integrator.counters.rejected == 0:
            ends.append((steps, max(errors)))
            inside.append((steps, largest(states - case.exact(times))))
    part = 0.75 if method in ("gauss12", "gauss14", *TAYLOR) else 0.88
    # errors of a Taylor series fall faster at first, while steps reach far towards a pole
    more = 7.0 if method in TAYLOR else 5.0 if order > 10 else 2.5
    assert part * order < slope(ends, order) < order + more
    # values between the steps lag by no more than one order of a step
    assert slope(inside, order) > (part if method in TAYLOR else 0.88) * min(order, dense_order + 1)


# -- tolerance ------------------------------------------------------------------------------------------
# the largest error in units of the tolerance: local errors add up, and a Kepler orbit amplifies them
GROWTH = {"Kepler orbit": 1e4}


@each_error
def test_the_error_follows_the_tolerance(method: str, case: Case) -> None:
    bound = GROWTH.get(case.name, 300.0)
    errors = {}
    for tolerance in (1e-1, 1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13, 1e-15):
        integrator = advance(case, method, rtol=tolerance, atol=tolerance)
        errors[tolerance] = end_error(case, integrator)
        if tolerance < 1e-1:
            assert errors[tolerance] <= bound * within_reach(method, tolerance) + 2e-12, errors
        assert np.isfinite(errors[tolerance])
    assert errors[1e-3] >= 1e2 * errors[1e-7], errors
    # down to where rounding takes over
    assert errors[1e-7] < 1e-11 or 1e2 * errors[1e-7] >= 1e3 * min(errors[1e-11], 1e-10), errors


@each_error
@pytest.mark.parametrize("tolerance", [1e-4, 1e-10])
def test_samples_are_as_good_as_the_steps(method: str, case: Case, tolerance: float) -> None:
    grid = Grid(0.0, case.end / 2000, 2001)
    times, states, integrator = samples(case.system, method, case.start, grid, rtol=tolerance, atol=tolerance)
    assert largest(states - case.exact(times)) <= GROWTH.get(case.name, 300.0) * within_reach(
        method, tolerance
    )
    np.testing.assert_allclose(states[-1], integrator.state, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(states[0], case.start)


@each_method
def test_samples_are_continuous_across_steps(method: str) -> None:
    """Where one step's polynomial hands over to the next there is no jump, nor in the slope of q."""
    case = systems.kepler()
    step = 5e-4 if is_low(method) else 0.05 if method == "rk4" else 0.005
    options = {"rtol": 1e-7, "atol": 1e-7} if methods[method].adaptive else {"step": step}
    integrator, ends = step_ends(case, method, 5.0, **options)
    width = 1e-7
    for end in ends[2:12]:
        grid = Grid(end - 4 * width, width, 9)
        _, states, _ = samples(case.system, method, case.start, Grid(0.0, grid.start, 2), **options)
        integrator.reset(0.0, case.start, settings(method, **options))
        times, states = collect(integrator, 6.0, grid)
        smooth = np.polynomial.polynomial.polyfit(times - end, states, 2)
        rough = states - np.polynomial.polynomial.polyval(times - end, smooth).T
        assert largest(rough) < 1e-8
        assert largest(np.diff(states[:, :2], axis=0) / width - states[:-1, 2:]) < (
            3e-3 if is_low(method) else 3e-4
        )


# -- the grid of samples ---------------------------------------------------------------------------------
@each_family
@pytest.mark.parametrize(("start", "step", "count"), [(0.0, 0.1, 101), (0.0, 1 / 3, 31), (-7.3, 0.73, 11), (1e5, 1e-3, 50),
                                                      (-10.0, 0.01, 1001), (0.0, 10.0, 2), (2.5, 1e-4, 7)])  # fmt: skip
def test_sample_times_are_the_grid_and_nothing_else(
    method: str, start: float, step: float, count: int
) -> None:
    case = systems.oscillator()
    grid = Grid(start, step, count)
    for options in ({"rtol": 1e-3, "atol": 1e-3}, {"rtol": 1e-11, "atol": 1e-13}):
        fitting = {} if methods[method].adaptive else {"step": 1e-3 if is_low(method) else 0.01}
        times, states, integrator = samples(case.system, method, case.start, grid, **options, **fitting)
        np.testing.assert_array_equal(times, start + np.arange(count) * step)
        assert integrator.time == times[-1]
    assert largest(states - case.exact(times - start)) < fine_error(method) + 1e-10 * (abs(start) > 1e3)


@each_family
def test_a_grid_may_begin_later_or_end_earlier_or_lie_outside(method: str) -> None:
    case = systems.oscillator()
    for grid, expected in (
        (Grid(3.3, 0.5, 4), [3.3, 3.8, 4.3, 4.8]),
        (Grid(-2.0, 1.5, 5), [1.0, 2.5, 4.0]),
        (Grid(4.0, 1.0, 10), [4.0, 5.0]),
        (Grid(7.0, 1.0, 3), []),
        (Grid(0.0, 1.0, 1), [0.0]),
        (Grid.over(5.0, 1), [0.0]),
        (Grid(-5.0, 1.0, 2), []),
    ):
        integrator = Integrator(case.system, method)
        integrator.reset(0.0, case.start, settings(method, **fine(method)))
        times, states = collect(integrator, 5.0, grid)
        np.testing.assert_allclose(times, expected, rtol=1e-15)
        assert largest(states - case.exact(times)) < fine_error(method)
        assert integrator.time == 5.0


@each_family
@pytest.mark.parametrize("case", [systems.forced(work=True), systems.chain(4)], ids=str)
def test_blocks_and_slices_change_nothing(method: str, case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    """However often the compiled loop comes back, to empty its output or to look up, the run is the same."""
    grid = Grid(0.0, case.end / 300, 301)
    options = {"rtol": 1e-8, "atol": 1e-9} if methods[method].adaptive else {"step": 0.03}
    times, whole, first = samples(case.system, method, case.start, grid, **options)
    for block in (1, 7, 300, 301):
        again, states, integrator = samples(case.system, method, case.start, grid, block=block, **options)
        np.testing.assert_array_equal(again, times)
        np.testing.assert_array_equal(states, whole)
        assert integrator.counters == first.counters
    monkeypatch.setattr(module, "SLICE_TIME", -1.0)
    ticks: list[float] = []
    integrator = Integrator(case.system, method)
    integrator._slice, integrator.tick = 1, ticks.append
    integrator.reset(0.0, case.start, settings(method, **options))
    _, states = collect(integrator, case.end, grid, block=13)
    np.testing.assert_array_equal(states, whole)
    assert integrator.counters == first.counters
    assert ticks == sorted(ticks) and len(ticks) >= 2


@each_family
def test_a_run_may_stop_and_resume(method: str) -> None:
    case = systems.kepler()
    grid = Grid(0.0, 0.05, 201)
    integrator = Integrator(case.system, method)
    for stops in ((3.33, 7.12, 10.0), (0.0, 5.0, 10.0), (1e-3, 2e-3, 10.0)):
        integrator.reset(0.0, case.start, settings(method, **fine(method)))
        parts = [collect(integrator, stop, grid) for stop in stops]
        times, states = (np.concatenate([p[k] for p in parts]) for k in (0, 1))
        # a sample at a stop belongs to both parts
        assert len(times) == 201 + sum(any(stop == grid.times(0, 201)) for stop in stops[:-1])
        np.testing.assert_array_equal(np.unique(times), grid.times(0, 201))
        assert largest(states - case.exact(times)) < 20 * fine_error(method)
        assert integrator.time == 10.0


@each_family_that_takes_velocities
def test_runs_repeat_exactly_after_a_reset(method: str) -> None:
    case = systems.controlled()
    integrator = Integrator(case.system, method)
    results = []
    for disturb in (False, True, False):
        if disturb:
            integrator.reset(3.0, np.array(case.start) * 7.0, Options(1e-3, 1e-3, 0.1))
            integrator.advance(4.5)
        integrator.reset(0.0, case.start, settings(method, **fine(method)))
        integrator.advance(case.end)
        results.append((integrator.state, integrator.counters))
    for state, counters in results[1:]:
        np.testing.assert_array_equal(state, results[0][0])
        assert counters == results[0][1]


@each_family
def test_integrators_of_the_same_code_share_nothing(method: str) -> None:
    case = systems.kepler()
    alone = advance(case, method, 4.0, **fine(method)).state
    pair = [Integrator(case.system, method) for _ in range(2)]
    for k, integrator in enumerate(pair):
        integrator.reset(
            0.0, case.start, settings(method, **({**fine(method), "atol": 1e-3 * k} if k else fine(method)))
        )
    for stop in (1.0, 2.0, 4.0):
        for integrator in reversed(pair):
            integrator.advance(stop)
    single = Integrator(case.system, method)
    single.reset(0.0, case.start, settings(method, **fine(method)))
    for stop in (1.0, 2.0, 4.0):
        single.advance(stop)
    np.testing.assert_array_equal(pair[0].state, single.state)
    assert largest(pair[0].state - alone) < fine_error(method)


# -- kinks ------------------------------------------------------------------------------------------------
TABLE = (0.0, 0.37, 1.1, 2.9, 4.0), (0.0, 2.0, -1.0, 1.5, 0.0)


def table_case(breakpoints: tuple[float, ...]) -> Case:
    """q'' = -q + piecewise linear torque."""
    body = system(1, lambda t, q, v, z, p: [-q[0] + f.interpolate(t, *TABLE)], breakpoints=breakpoints)

    def exact(t: np.ndarray) -> np.ndarray:
        out = np.zeros((len(t), 2))
        knots = [*TABLE[0], np.inf]
        x = np.array([0.3, -0.2])
        for k, start in enumerate(knots[:-1]):
            b = np.diff(TABLE[1])[k] / np.diff(TABLE[0])[k] if k < len(TABLE[0]) - 1 else 0.0
            a = TABLE[1][k]

            def piece(s: np.ndarray, a: float = a, b: float = b, x: np.ndarray = x) -> np.ndarray:
                c, d = x[0] - a, x[1] - b
                return np.array(
                    [a + b * s + c * np.cos(s) + d * np.sin(s), b - c * np.sin(s) + d * np.cos(s)]
                ).T

            inside = (t >= start) & (t < knots[k + 1])
            out[inside] = piece(t[inside] - start)
            x = piece(np.array([knots[k + 1] - start]))[0] if np.isfinite(knots[k + 1]) else x
        return out

    return Case("table", body, (0.3, -0.2), exact, 6.0)


@each_family
def test_kinks_cost_no_accuracy(method: str) -> None:
    case = table_case(TABLE[0])
    grid = Grid(0.0, 6.0 / 777, 778)
    for tolerance in dict.fromkeys(within_reach(method, x) for x in (1e-5, 1e-8, 1e-11)):
        adaptive = methods[method].adaptive
        step = 0.5 * tolerance ** (1.0 / methods[method].order)
        options = {"rtol": tolerance, "atol": tolerance} if adaptive else {"step": step}
        times, states, integrator = samples(case.system, method, case.start, grid, **options)
        assert largest(states - case.exact(times)) <= 300 * tolerance
        assert integrator.counters.rejected <= 2
        assert end_error(case, integrator) <= 100 * tolerance


def unseen(method: str, ends: np.ndarray) -> float:
    """Return the error that the kinks of the table leave where at most one stage of a step lies beyond them.

    The stages of a Gauss method lie inside the step. A torque whose slope changes by b at a distance d from an end of
    the step, d below that of the second stage, is integrated as if it did not change there: q' is off by b d^2 / 2.
    """
    if not method.startswith("gauss"):
        return 0.0
    nodes = np.polynomial.legendre.leggauss(methods[method].order // 2)[0]
    second = 0.5 * (1.0 + np.sort(nodes)[1])
    slopes = np.concatenate([[0.0], np.diff(TABLE[1]) / np.diff(TABLE[0]), [0.0]])
    error = 0.0
    for kink, change in zip(TABLE[0], np.diff(slopes)):
        k = int(np.searchsorted(ends, kink))
        if 0 < k < len(ends):
            distance = min(ends[k] - kink, kink - ends[k - 1])
            if distance < second * (ends[k] - ends[k - 1]):
                error += 0.5 * abs(change) * distance**2
    return error


@each_adaptive
def test_without_breakpoints_kinks_are_found_by_the_step_control(method: str) -> None:
    """Nothing says where the torque's slope jumps: the estimate of the error has to notice.

    That of the Gauss methods is the decay of the Legendre coefficients: 100 tolerances are accepted in the last, and 1000
    in the last but one, which stands for all where a kink lies in the middle of a step, so that those of odd degree
    vanish. Those that are cut off fall slowly behind a kink, and make up ten times as much. The table has four kinks.
    How a kink lies in its step is chance, which rounding alone decides where a smooth step is exact: hence several runs.
    """
    case, told = table_case(()), table_case(TABLE[0])
    bound = 4 * 1e4 if method.startswith("gauss") else 100.0
    beyond = []
    for tolerance in 1e-10 * (1.0 + 0.01 * np.arange(15)):
        blind, ends = step_ends(case, method, rtol=tolerance, atol=tolerance)
        error = end_error(case, blind) - unseen(method, ends)
        beyond.append(error / (bound * within_reach(method, tolerance)))
    assert np.median(beyond) < 1.0 and max(beyond) < 30.0
    assert advance(told, method, rtol=1e-10, atol=1e-10).counters.evaluations < blind.counters.evaluations


@each_family
@pytest.mark.parametrize(
    "points", [(0.0,), (6.0,), (7.0, 8.0), (-1.0,), (3.0, 3.0), (1e-300,), (3.0, 3.0 + 4e-16)]
)
def test_breakpoints_in_odd_places_do_no_harm(method: str, points: tuple[float, ...]) -> None:
    case = systems.oscillator()
    body = dataclasses.replace(case.system, breakpoints=points)
    times, states, integrator = samples(body, method, case.start, Grid(0.0, 0.5, 13), **fine(method))
    assert integrator.time == 6.0 and len(times) == 13
    assert largest(states - case.exact(times)) < fine_error(method)


@pytest.mark.parametrize("method", [m for m in ADAPTIVE if m.startswith("gauss")])
def test_towards_a_pole_few_steps_are_rejected(method: str) -> None:
    """q = 1/(1 - t): each step may be but a part of the one before it, which its own error does not tell."""
    body = system(1, lambda t, q, v, z, p: [2.0 * q[0] * q[0] * q[0]])
    integrator = Integrator(body, method)
    integrator.reset(0.0, (1.0, 1.0), Options(1e-9, 1e-11))
    integrator.advance(1.0 - 1e-4)
    assert integrator.state[0] == pytest.approx(1e4, rel=1e-3)
    assert integrator.counters.rejected <= 0.1 * integrator.counters.steps


FRONTS = {
    "friction at the turn of a joint": lambda width: (
        lambda t, q, v, z, p: [-q[0] - 0.05 * f.tanh(v[0] / width)]
    ),
    "a stop": lambda width: lambda t, q, v, z, p: [-q[0] - 0.5 * f.tanh(q[0] / width)],
    "a switch in time": lambda width: lambda t, q, v, z, p: [-q[0] + f.tanh((t - 3.3) / width)],
}


@cache
def front(kind: str, width: float) -> tuple[System, np.ndarray]:
    """Return a system, and its state at t = 10 from (1, 0)."""
    body = system(1, FRONTS[kind](width))
    exact = Integrator(body, "dop853")
    exact.reset(0.0, (1.0, 0.0), Options(1e-13, 1e-14, max_step=0.01))
    exact.advance(10.0)
    return body, exact.state


@each_adaptive_family
@pytest.mark.parametrize("width", [1e-2, 1e-4, 9e-6])
@pytest.mark.parametrize("kind", FRONTS)
def test_steep_fronts_are_not_stepped_over(method: str, kind: str, width: float) -> None:
    """Smooth, but so steep that all of it fits between two stages, or between a stage and the end of a step."""
    body, exact = front(kind, width)
    integrator = Integrator(body, method)
    for tolerance in dict.fromkeys(within_reach(method, x) for x in (1e-4, 1e-6, 1e-8, 1e-10)):
        integrator.reset(0.0, (1.0, 0.0), settings(method, tolerance, tolerance * 1e-2))
        integrator.advance(10.0)
        assert largest(integrator.state - exact) < 1e3 * tolerance


# -- parameters -------------------------------------------------------------------------------------------
@each_family_that_takes_velocities
def test_parameters(method: str) -> None:
    body = system(1, lambda t, q, v, z, p: [-p[0] * q[0] + p[2] * f.where(q[0], v[0], 0.0)])
    for w, extra in ((1.0, 0.0), (2.0, 0.0), (1.5, np.nan)):
        start = (1.0, 0.0)
        parameters = np.array([w * w, np.nan, 0.0 * extra])
        if np.isnan(extra):
            with pytest.raises(NumericalError):
                samples(body, method, start, Grid(0.0, 0.5, 9), parameters=parameters, **fine(method))
            continue
        times, states, integrator = samples(
            body, method, start, Grid(0.0, 0.5, 9), parameters=parameters, **fine(method)
        )
        assert largest(states - systems.oscillator(w).exact(times)) < fine_error(method)
        parameters[0] = 77.0
        assert integrator.p[0] == w * w, "the caller's array is his own"
    with pytest.raises(ValueError, match="the system has 3 parameters, got 1"):
        Integrator(body, method, [1.0])


# -- counters and limits ------------------------------------------------------------------------------------
@each_method
def test_counters_add_up(method: str) -> None:
    case = systems.kepler()
    options = {"rtol": 1e-6, "atol": 1e-8} if methods[method].adaptive else {"step": 0.01}
    integrator = advance(case, method, **options)
    counters = integrator.counters
    assert counters.steps > 5 and counters.events == 0 and counters.projections == 0
    assert counters.evaluations >= counters.attempts
    kind = methods[method]
    if isinstance(kind, ExplicitRungeKutta):
        new, tries = kind.table.stages - 1, counters.attempts
        states = 1 if kind.table.first_same_as_last else counters.steps
        assert counters.evaluations == new * tries + states
    assert set(vars(counters)) == {"steps", "rejected", "evaluations", "projections", "events"}
    for limit in (1, 5, counters.steps - 1):
        with pytest.raises(NumericalError, match=f"more than {limit} steps, stopped at t = ") as caught:
            advance(case, method, **options, max_steps=limit)
        assert 0.0 <= caught.value.details["time"] < case.end
    again = advance(case, method, **options, max_steps=counters.attempts)
    assert again.counters == counters


def test_the_last_stage_is_the_first_of_the_next_step() -> None:
    free = advance(systems.kepler(), "dopri5", rtol=1e-8, atol=1e-8).counters
    assert free.evaluations == 6 * free.attempts + 1
    # not where the state is put back on its constraint
    integrator = Integrator(constrained_pendulum(), "dopri5")
    integrator.reset(0.0, (-1.0, 0.0, 0.0, 0.0), Options(1e-8, 1e-8))
    integrator.advance(2.0)
    held = integrator.counters
    assert held.evaluations == 6 * held.attempts + held.steps
    # nor where it was replaced, or another interval begins
    case = systems.oscillator()
    integrator = Integrator(case.system, "dopri5")
    integrator.reset(0.0, (1.0, 0.0), Options(1e-10, 1e-12))
    integrator.advance(1.0)
    integrator.set_state((0.0, 2.0))
    integrator.advance(2.0)
    spent = integrator.counters
    assert spent.evaluations == 6 * spent.attempts + 2
    np.testing.assert_allclose(integrator.state, (2.0 * np.sin(1.0), 2.0 * np.cos(1.0)), atol=1e-8)


@each_adaptive_family
def test_the_longest_step_is_kept(method: str) -> None:
    case = systems.oscillator()
    integrator = advance(case, method, 10.0, rtol=1e-3, atol=1e-3, max_step=0.05)
    assert integrator.counters.steps >= 200
    assert end_error(case, integrator) < (1e-3 if is_low(method) else 1e-4)


def test_fixed_steps_are_counted_exactly() -> None:
    case = systems.oscillator()
    for method in METHODS:
        if methods[method].adaptive:
            continue
        for duration, step, expected in (
            (1.0, 0.1, 10),
            (1.0, 0.3, 4),
            (10.0, 1e-3, 10_000),
            (0.05, 0.1, 1),
            (0.7, 0.1, 7),
        ):
            assert advance(case, method, duration, step=step).counters.steps == expected
        assert advance(case, method, 1.0).counters.steps == 1000  # without a step: a thousandth of the run


@each_family
def test_a_step_may_be_suggested_to_any_method(method: str) -> None:
    case = systems.oscillator()
    step = 1e-4 if is_low(method) else 0.01
    assert end_error(case, advance(case, method, 5.0, rtol=1e-9, atol=1e-9, step=step)) < 100 * within_reach(
        method, 1e-9
    )


# -- failures -----------------------------------------------------------------------------------------------
@each_adaptive_family
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-10])
def test_a_blow_up_in_finite_time_is_caught_where_it_happens(method: str, tolerance: float) -> None:
    integrator = Integrator(BLOW_UP, method)
    integrator.reset(0.0, (1.0, 1.0), settings(method, tolerance, tolerance, max_steps=ENOUGH))
    with pytest.raises(NumericalError) as caught:
        integrator.advance(2.0)
    assert abs(caught.value.details["time"] - 1.0) < 100 * within_reach(method, tolerance)
    assert np.all(np.isfinite(integrator.state))


@each_family
def test_samples_before_a_failure_are_kept(method: str) -> None:
    integrator = Integrator(BLOW_UP, method)
    options = fine(method)
    integrator.reset(0.0, (1.0, 1.0), settings(method, **options, max_steps=ENOUGH))
    blocks: list[tuple[Any, Any]] = []
    with pytest.raises(NumericalError):
        integrator.run(2.0, Grid(0.0, 0.01, 201), lambda t, x: blocks.append((t, x)), block=10)
    times, states = (np.concatenate([b[k] for b in blocks]) for k in (0, 1))
    assert 0.98 <= times[-1] <= 1.05
    np.testing.assert_allclose(
        states[times < 0.9, 0], 1 / (1 - times[times < 0.9]), rtol=1e-5 if is_low(method) else 1e-6
    )


FAILING = {
    "from the start": (lambda t, q, v, z, p: [f.sqrt(q[0] - 2.0)], 0.0),
    "at a time": (lambda t, q, v, z, p: [f.log(1.0 - t)], 1.0),
    "beyond a place": (lambda t, q, v, z, p: [-q[0] + 0.0 * t + 1e-3 * f.asin(q[0])], None),
    "in the second equation": (lambda t, q, v, z, p: [-q[0], f.sqrt(1.5 - t)], 1.5),
}


@each_family
@pytest.mark.parametrize("kind", FAILING)
def test_rates_that_are_no_numbers_are_never_accepted(method: str, kind: str) -> None:
    rates, where = FAILING[kind]
    nv = 2 if kind.startswith("in the") else 1
    body = system(nv, rates)
    integrator = Integrator(body, method)
    options = {"rtol": 1e-6, "atol": 1e-6} if methods[method].adaptive else {"step": 0.01}
    integrator.reset(
        0.0, [0.9, 0.1, 1.5, 0.0][: 2 * nv] if nv == 2 else [0.9, 1.5], settings(method, **options)
    )
    with pytest.raises(NumericalError) as caught:
        integrator.advance(3.0)
    assert np.all(np.isfinite(integrator.state)) and np.isfinite(integrator.time)
    if where is not None:
        assert abs(caught.value.details["time"] - where) <= 0.02
    if where == 0.0:
        assert "finite" in caught.value.message


@each_family
@pytest.mark.parametrize("place", [0, 1])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_start_that_is_no_number_is_caught(method: str, place: int, value: float) -> None:
    integrator = Integrator(systems.oscillator().system, method)
    start = [1.0, 0.0]
    start[place] = value
    integrator.reset(0.0, start, Options())
    with pytest.raises(NumericalError, match="finite"):
        integrator.advance(1.0)


def test_a_state_of_the_wrong_length_is_an_error() -> None:
    with pytest.raises(ValueError, match="2 components"):
        Integrator(systems.oscillator().system).reset(0.0, [1.0], Options())


# -- scales -------------------------------------------------------------------------------------------------
@each_adaptive_family
@pytest.mark.parametrize(
    ("rate", "size"), [(1e-8, 1e-9), (1e-8, 1e9), (1e-3, 1.0), (1e4, 1e9), (1e9, 1e-9), (1e9, 1e9)]
)
def test_units_do_not_matter(method: str, rate: float, size: float) -> None:
    """The same motion in other units of length and time takes the same steps and has the same relative error."""
    w = rate

    def pendulum(t: Any, q: Any, v: Any, z: Any, p: Any) -> list[Any]:
        return [-(w * w * size) * f.sin(q[0] / size)]

    integrator = Integrator(system(1, pendulum), method)
    integrator.reset(0.0, (1.5 * size, 0.0), settings(method, 1e-9, 1e-9 * min(size, size * w)))
    integrator.advance(10.0 / w)
    got = integrator.state / [size, size * w]
    expected = systems.pendulums(1.5).exact(np.array([10.0]))[0]
    assert largest(got - expected) < 1e3 * within_reach(method, 1e-9)
    # the tolerance is absolute for positions and velocities alike, so one of the two may be held tighter
    assert (
        integrator.counters.steps
        < 40 * advance(systems.pendulums(1.5), method, 10.0, rtol=1e-9, atol=1e-9).counters.steps
    )


# between the ends of a step: the powers of a polynomial through seven or eight stages multiply rounding by some 1e4
ROUNDING = {"gauss": 1e-11, "radau13": 1e-11}


@each_adaptive
@pytest.mark.parametrize("duration", [1e-12, 1e-9, 1e-6])
def test_short_runs(method: str, duration: float) -> None:
    case = systems.pendulums(1.0)
    grid = Grid.over(duration, 11)
    times, states, integrator = samples(case.system, method, case.start, grid)
    assert len(times) == 11 and integrator.time == times[-1]
    np.testing.assert_allclose(integrator.state[1], -np.sin(1.0) * duration, rtol=1e-12)
    np.testing.assert_allclose(states[:, 1], -np.sin(1.0) * times, rtol=ROUNDING.get(method, 1e-12))


@each_adaptive_family
@pytest.mark.parametrize("start", [-1e6, 1e6])
def test_far_from_time_zero(method: str, start: float) -> None:
    body = system(1, lambda t, q, v, z, p: [-q[0] + f.sin(3.0 * (t - start))])
    case = systems.forced()
    times, states, _ = samples(body, method, case.start, Grid(start, 0.125, 81), rtol=1e-9, atol=1e-9)
    # a time near 1e6 is known to 1e-10
    assert largest(states - case.exact(times - start)) < 200 * within_reach(method, 1e-9)


@each_adaptive_family
def test_a_tolerance_of_zero_for_what_is_zero(method: str) -> None:
    """atol = 0 with components that start at zero, pass it, or stay there."""
    case = systems.oscillator()
    for start in ((1.0, 0.0), (0.0, 1.0)):
        integrator = Integrator(case.system, method)
        integrator.reset(0.0, start, settings(method, 1e-9, 0.0, max_steps=ENOUGH))
        integrator.advance(10.0)
        expected = case.exact(np.array([10.0]))[0] if start[0] else [np.sin(10.0), np.cos(10.0)]
        assert largest(integrator.state - expected) < 100 * within_reach(method, 1e-9)
    idle = system(2, lambda t, q, v, z, p: [-q[0], -q[1] * (1.0 + q[0])])
    integrator = Integrator(idle, method)
    integrator.reset(0.0, (1.0, 0.0, 0.0, 0.0), settings(method, 1e-9, 0.0, max_steps=ENOUGH))
    integrator.advance(10.0)
    assert largest(integrator.state[[0, 2]] - case.exact(np.array([10.0]))[0]) < 100 * within_reach(
        method, 1e-9
    )
    np.testing.assert_array_equal(integrator.state[[1, 3]], 0.0)


@each_adaptive_family
def test_a_quadrature_faster_than_the_motion_is_resolved(method: str) -> None:
    body = system(1, lambda t, q, v, z, p: ([-q[0]], [f.cos(20.0 * t)]), nz=1)
    for tolerance in (1e-4, 1e-7, within_reach(method, 1e-10)):
        integrator = Integrator(body, method)
        integrator.reset(0.0, (1.0, 0.0, 0.0), settings(method, tolerance, tolerance))
        integrator.advance(20.0)
        assert abs(integrator.state[2] - np.sin(400.0) / 20.0) < 100 * tolerance


# -- stiffness --------------------------------------------------------------------------------------------
def stiff(k: float, c: float) -> Case:
    """Two masses, the first a pendulum for small angles, tied by a stiff spring and damper."""

    def rates(t: Any, q: Any, v: Any, z: Any, p: Any) -> list[Any]:
        pull = k * (q[0] - q[1]) + c * (v[0] - v[1])
        return [-q[0] - 1e-3 * pull, pull]

    A = np.zeros((4, 4))
    A[:2, 2:] = np.eye(2)
    A[2], A[3] = [-1.0 - 1e-3 * k, 1e-3 * k, -1e-3 * c, 1e-3 * c], [k, -k, c, -c]
    return systems.linear(
        f"spring {k:g}, damper {c:g}", A, system(2, rates), (1.0, 1.0 + 1e-3, 0.0, 0.0), 0.05
    )


@each_adaptive_family
@pytest.mark.parametrize(
    ("k", "c"), [(1e6, 0.0), (1e6, 1e2), (1e6, 1e4), (1e8, 1e4), (1e9, 0.0), (1e9, 1e6), (0.0, 1e9)]
)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_stiff_motion_is_right_or_refused(method: str, k: float, c: float, tolerance: float) -> None:
    case = stiff(k, c)
    integrator = Integrator(case.system, method)
    limit = 40_000
    integrator.reset(0.0, case.start, settings(method, tolerance, tolerance, max_steps=limit))
    try:
        integrator.advance(case.end)
    except NumericalError as error:
        counters = integrator.counters
        assert "more than" in error.message and counters.attempts == limit
        assert counters.evaluations < 30 * limit
        # a method for stiff motion gets through, unless its order is too low to follow an oscillation
        assert ((is_low(method) or method == "bdf") and c < 1e4) or (c >= 1e6 and method not in FOR_STIFF)
        return
    q, v = integrator.state[:2], integrator.state[2:]
    exact = case.exact(np.array([case.end]))[0]
    cycles = 1.0 if c else 1.0 + np.sqrt(k) * case.end  # an undamped oscillation adds up its errors of phase
    assert largest(q - exact[:2]) < 100 * tolerance * cycles
    assert largest(v - exact[2:]) < 100 * tolerance * cycles * max(1.0, 1e-3 * np.sqrt(k))


@each_adaptive_family
def test_a_stiff_pendulum_agrees_with_radau(method: str) -> None:
    from scipy.integrate import solve_ivp

    def pull(x: Any, u: Any) -> Any:
        return 1e6 * (x[0] - x[1]) + 1e4 * (u[0] - u[1])

    body = system(2, lambda t, q, v, z, p: [-f.sin(q[0]) - 1e-3 * pull(q, v), pull(q, v)])
    grid = Grid(0.0, 0.1, 6)
    _, states, _ = samples(body, method, (1.0, 1.001, 0.0, 0.0), grid, rtol=1e-8, atol=1e-10)
    reference = solve_ivp(
        lambda t, y: [y[2], y[3], -np.sin(y[0]) - 1e-3 * pull(y[:2], y[2:]), pull(y[:2], y[2:])],
        (0.0, 0.5), (1.0, 1.001, 0.0, 0.0), method="Radau", rtol=1e-10, atol=1e-12, t_eval=grid.times(0, 6),
    )  # fmt: skip
    assert largest(states - reference.y.T) < 1e-6


@each_method
def test_fixed_or_not_no_method_returns_what_is_not_finite(method: str) -> None:
    """A step far beyond stability makes an explicit method explode; that is an error, not a result."""
    case = stiff(1e9, 0.0)
    integrator = Integrator(case.system, method)
    integrator.reset(0.0, case.start, settings(method, 1e-6, 1e-6, step=0.01, max_steps=100_000))
    try:
        integrator.advance(5.0)
    except NumericalError as error:
        assert np.all(np.isfinite(integrator.state)) and error.details["time"] < 5.0
    else:
        assert method not in EXPLODING and largest(integrator.state[:2]) < 2.0


@each_adaptive_family
@pytest.mark.parametrize("duration", [1e6, 1e12])
def test_a_very_long_run_starts_well(method: str, duration: float) -> None:
    """The first trial step is a part of the duration, and may be absurd."""
    case = systems.pendulums(1.5)
    integrator = Integrator(case.system, method)
    integrator.reset(0.0, case.start, Options(1e-7, 1e-7, max_steps=3000))
    with pytest.raises(NumericalError, match="more than 3000 steps"):
        integrator.advance(duration)
    assert end_error(case, integrator) < 1e-2
    assert integrator.time > 20.0


# -- projection ---------------------------------------------------------------------------------------------
def constrained_pendulum() -> Any:
    """A point mass on a bar in Cartesian coordinates: x'' = -lambda x, y'' = -g - lambda y."""
    g = 9.81

    def rates(t: Any, q: Any, v: Any, z: Any, p: Any) -> list[Any]:
        x, y = q
        multiplier = (v[0] * v[0] + v[1] * v[1] - g * y) / (x * x + y * y)
        return [-multiplier * x, -g - multiplier * y]

    body = system(2, rates)
    graph = next(a for a in body.acceleration).graph  # type: ignore[union-attr]
    (x, y), (u, w) = graph.symbols(["q0", "q1"], "q"), graph.symbols(["v0", "v1"], "v")
    r2 = x * x + y * y
    gap = (r2 - 1.0) / (2.0 * r2)
    drift = (x * u + y * w) / r2
    return dataclasses.replace(
        body,
        corrections=Corrections(position=(x - gap * x, y - gap * y), velocity=(u - drift * x, w - drift * y)),
    )


@each_family_that_takes_velocities
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-10])
def test_projection_keeps_the_constraints(method: str, tolerance: float) -> None:
    body = constrained_pendulum()
    integrator = Integrator(body, method)
    options = (
        {"rtol": tolerance, "atol": tolerance}
        if methods[method].adaptive
        else {"step": 0.2 * within_reach(method, tolerance) ** (1.0 / methods[method].order)}
    )
    integrator.reset(0.0, (-1.0, 0.0, 0.0, 0.0), settings(method, **options))
    for stop in np.linspace(0.05, 10.0, 120):
        integrator.advance(float(stop))
        x, y, u, w = integrator.state
        assert abs(x * x + y * y - 1.0) < 1e-14
        assert abs(x * u + y * w) < 2e-14
    assert integrator.counters.projections >= integrator.counters.steps
    exact = (-0.27508746257611686, -0.961419205099125064, 4.17559810095172884, -1.19474905456047527)
    assert largest(integrator.state - exact) < max(2e4 * within_reach(method, tolerance), 3e-9)


# -- geometry of the flow -------------------------------------------------------------------------------------
def test_gauss_does_not_lose_energy() -> None:
    """Symplectic: over 10^4 periods the energy error stays at rounding, 10^-17 a step."""
    case = systems.pendulums(2.0)
    period = 4 * float(systems.ellipk(np.sin(1.0) ** 2))
    integrator = Integrator(case.system, "gauss")
    integrator.reset(0.0, case.start, Options(1e-14, 1e-14, max_step=period / 12))
    energies = []
    for k in range(1, 101):
        integrator.advance(100 * k * period)
        q, v = integrator.state
        energies.append(0.5 * v * v - np.cos(q))
    errors = np.array(energies) + np.cos(2.0)
    assert integrator.counters.steps > 12 * 10_000
    assert largest(errors) < 5e-12


@pytest.mark.parametrize("method", [m for m in METHODS if methods[m].symplectic and not methods[m].adaptive])
def test_fixed_steps_of_symplectic_methods_keep_the_energy_in_bounds(method: str) -> None:
    """The error of the energy swings with the motion, and over 3000 periods nothing is added to it."""
    case = systems.pendulums(2.0)
    period = 4 * float(systems.ellipk(np.sin(1.0) ** 2))
    step = period / {1: 400, 2: 400, 4: 60, 6: 30, 8: 30}[methods[method].order]
    swings = []
    integrator = Integrator(case.system, method)
    integrator.reset(0.0, case.start, Options(step=step))
    for start in (0.0, 3000.0 * period):
        integrator.advance(start) if start else None
        energies = []
        for k in range(1, 60):
            integrator.advance(start + k * step)
            q, v = integrator.state
            energies.append(0.5 * v * v - np.cos(q) + np.cos(2.0))
        swings.append(largest(energies))
    assert 1e-13 < swings[0] < 1e-3
    assert swings[1] < 1.3 * swings[0] + 1e-11


@pytest.mark.parametrize("case", [systems.kepler(), systems.pendulums(2.0, 1.0), systems.chain(4)], ids=str)
def test_gauss_runs_backwards_to_where_it_came_from(case: Case) -> None:
    n = case.system.nv
    integrator = Integrator(case.system, "gauss")
    integrator.reset(0.0, case.start, Options(1e-14, 1e-14, max_step=0.25))
    integrator.advance(10.0)
    state = integrator.state
    integrator.reset(0.0, [*state[:n], *-state[n:]], Options(1e-14, 1e-14, max_step=0.25))
    integrator.advance(10.0)
    back = integrator.state * np.repeat([1.0, -1.0], n)
    assert largest(back - case.start) < 2e-12


# -- shape of the code ----------------------------------------------------------------------------------------
@each_family_that_takes_velocities
def test_long_equations_are_called_and_give_the_same(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBODYN_CACHE", "off")
    body = dataclasses.replace(constrained_pendulum())
    x = body.acceleration[0].graph.symbol("q0", "q", 0)
    body = dataclasses.replace(body, events=(EventFunction("middle", x),))
    grid = Grid(0.0, 0.02, 101)
    runs = []
    for limit in (lower.INLINE_LIMIT, 0):
        monkeypatch.setattr(lower, "INLINE_LIMIT", limit)
        monkeypatch.setattr(compiler, "_loaded", {})
        runs.append(samples(body, method, (-1.0, 0.0, 0.0, 0.0), grid, **fine(method)))
    (_, inline, a), (_, called, b) = runs
    # the same steps give the same states; where rounding has led to other steps, both are as accurate as asked for
    same = a.counters == b.counters
    np.testing.assert_allclose(called, inline, rtol=0, atol=1e-11 if same else fine_error(method))
    assert a.counters.events == b.counters.events == 2
    assert abs(a.counters.steps - b.counters.steps) <= 2 + 0.05 * a.counters.steps


@each_family
def test_without_fused_multiply_add_too(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBODYN_CACHE", "off")
    monkeypatch.setattr(compiler, "_loaded", {})
    host = compiler.machine()
    monkeypatch.setattr(engine, "machine", lambda: dataclasses.replace(host, fused=False))
    case = systems.pendulums(0.5, 1.5)
    assert end_error(case, advance(case, method, 5.0, **fine(method))) < 10 * fine_error(method)


@each_method
def test_steppers_state_what_they_are(method: str) -> None:
    kind = methods[method]
    assert kind.name == method and kind.facts is METHODS_TABLE[method]
    assert kind.order >= 1 and 1 <= kind.dense_order <= kind.order
    assert (kind.__doc__ or "").strip()
    assert kind.dense_size(systems.chain(4).system) > 0


def test_integrate_in_one_call() -> None:
    case = systems.forced(work=True)
    times, states, counters = integrate(case.system, "gauss", case.start, Grid.over(case.end, 51), Options())
    np.testing.assert_array_equal(times, np.arange(51) * (case.end / 50))
    assert largest(states - case.exact(times)) < 1e-9 and counters.steps > 0
