"""Events: found, located to the accuracy of the states, in order, once each; jumps and stops at them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli.expr import functions as f
from robodyn_cli.formulations.events import Event, EventFunction, Stopping
from robodyn_cli.integrators.event_location.events import LocatedRoots, Root, first_roots
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.memory import Status
from robodyn_cli.integrators.runtime.options import Grid
from tests.methods import each_adaptive_family, each_family
from tests.systems import collect, events_of, is_low, settings, system, told, within_reach


def options(method: str, tolerance: float = 1e-10) -> dict[str, Any]:
    if methods[method].adaptive:
        return {"rtol": tolerance, "atol": tolerance * 1e-2}
    return {"step": 2e-4 if is_low(method) else 0.01}


def accuracy(method: str, tolerance: float = 1e-10) -> float:
    return (
        300 * within_reach(method, tolerance)
        if methods[method].adaptive
        else 2e-8
        if not is_low(method)
        else 1e-6
    )


def oscillator(*events: Any) -> Any:
    """q = sin t; ``events`` are (value of (t, q, v), direction) pairs."""
    return system(
        1, lambda t, q, v, z, p: [-q[0]],
        events=lambda t, q, v, z, p: [
            EventFunction(f"e{k}", value(t, q[0], v[0]), direction) for k, (value, direction) in enumerate(events)
        ],
    )  # fmt: skip


def ball(*heights: float, floor: Any = None) -> Any:
    """Balls falling with g = 10, each with an event at the floor."""
    n = len(heights)
    return system(
        n, lambda t, q, v, z, p: [-10.0 + 0.0 * q[0]] * n,
        events=lambda t, q, v, z, p: [EventFunction(f"ball {k}", q[k], -1) for k in range(n)],
    )  # fmt: skip


# -- accuracy and direction -------------------------------------------------------------------------------
@each_family
@pytest.mark.parametrize("direction", [-1, 0, 1])
@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-6, 1e-10])
def test_all_zeros_of_a_sine(method: str, direction: int, tolerance: float) -> None:
    """At loose tolerances several zeros of both signs lie in one step."""
    body = oscillator((lambda t, q, v: q, direction))
    found, integrator = events_of(body, method, (0.0, 1.0), 31.0, **options(method, tolerance))
    expected = [k * np.pi for k in range(1, 10) if direction == 0 or (direction < 0) == (k % 2 == 1)]
    assert len(found) == len(expected)
    factor = {"dopri5": 30.0, "rodas5p": 30.0, "rosenbrock23": 30.0, "bdf": 30.0}.get(method, 3.0)
    bound = factor * within_reach(method, tolerance) if methods[method].adaptive else accuracy(method)
    for event, time in zip(found, expected):
        assert abs(event.time - time) < bound + 1e-13 * time
        # stages of rodas5p are combined with coefficients up to 165, so its steps carry more rounding
        noise = 1e-14 if methods[method].needs_jacobian else 1e-15
        assert abs(event.state[0]) <= noise * max(1.0, time) + 4e-16 * time
        assert 0.0 <= event.time_error <= 1e-15 * time
    assert integrator.time == 31.0
    assert integrator.counters.events == len(found)


@each_family
def test_an_event_at_a_given_time_and_one_at_a_given_speed(method: str) -> None:
    body = oscillator((lambda t, q, v: t - 2.5, 0), (lambda t, q, v: v - 0.5, -1))
    found, _ = events_of(body, method, (0.0, 1.0), 6.0, **options(method))
    assert [e.name for e in found] == ["e1", "e0"]
    assert found[0].time == pytest.approx(np.pi / 3, abs=accuracy(method))
    assert found[1].time == pytest.approx(2.5, abs=5e-16)
    np.testing.assert_allclose(found[1].state, [np.sin(2.5), np.cos(2.5)], atol=accuracy(method))


# -- several at once ----------------------------------------------------------------------------------------
@each_family
@pytest.mark.parametrize("gap", [1e-2, 1e-6, 1e-9, 1e-13])
def test_events_close_together_come_in_the_order_of_time(method: str, gap: float) -> None:
    """The function listed first crosses last; all lie in one step, in one eighth of it."""
    body = oscillator(*((lambda t, q, v, k=k: t - (1.0 + (3 - k) * gap), 0) for k in range(3)))
    found, _ = events_of(body, method, (0.0, 1.0), 3.0, **options(method, 1e-3))
    assert [e.name for e in found] == ["e2", "e1", "e0"]
    np.testing.assert_allclose(
        [e.time for e in found], [1.0 + gap, 1.0 + 2 * gap, 1.0 + 3 * gap], rtol=0, atol=1e-15
    )


@each_family
def test_simultaneous_events_are_all_told(method: str) -> None:
    body = oscillator(
        (lambda t, q, v: q, 0), (lambda t, q, v: -2.0 * q, 0), (lambda t, q, v: q, 1), (lambda t, q, v: q, -1)
    )
    found, _ = events_of(body, method, (0.0, 1.0), 7.0, **options(method))
    assert [e.name for e in found] == ["e0", "e1", "e3", "e0", "e1", "e2"]
    times = np.array([e.time for e in found]).reshape(2, 3)
    assert np.ptp(times, axis=1).max() <= 4e-15
    np.testing.assert_allclose(times[:, 0], [np.pi, 2 * np.pi], atol=accuracy(method))


@each_family
def test_balls_that_land_together_all_bounce(method: str) -> None:
    """A jump at one event must not hide another at the same time."""
    body = ball(5.0, 5.0, 5.0)

    def bounce(integrator: Integrator, event: Event) -> bool:
        state = integrator.state
        assert np.array_equal(state, event.state), "an event sees the jumps of those before it"
        state[event.index] = 0.0
        state[3 + event.index] *= -0.5
        integrator.set_state(state)
        return True

    found, integrator = events_of(
        body, method, (5.0, 5.0, 5.0, 0.0, 0.0, 0.0), 2.6, react=bounce, **options(method)
    )
    assert [e.index for e in found] == [0, 1, 2, 0, 1, 2, 0, 1, 2]
    np.testing.assert_allclose([e.time for e in found], np.repeat([1.0, 2.0, 2.5], 3), atol=accuracy(method))
    assert np.ptp(integrator.state[:3]) < 1e-12 and integrator.state[0] > 0.0


# -- jumps ----------------------------------------------------------------------------------------------
@each_family
@pytest.mark.parametrize("restitution", [1.0, 0.9, 0.5])
def test_a_bouncing_ball_follows_the_closed_form(method: str, restitution: float) -> None:
    def bounce(integrator: Integrator, event: Event) -> bool:
        integrator.set_state([0.0, -restitution * event.state[1]])
        return len(impacts) < 12

    impacts: list[float] = []

    def react(integrator: Integrator, event: Event) -> bool:
        impacts.append(-event.state[1])
        return bounce(integrator, event)

    fine = options(method) if methods[method].adaptive else {"step": 1e-3}
    found, integrator = events_of(ball(5.0), method, (5.0, 0.0), 100.0, react=react, **fine)
    flights = 2.0 * restitution ** np.arange(1, 12)
    times = 1.0 + np.concatenate([[0.0], np.cumsum(flights)])
    np.testing.assert_allclose(
        [e.time for e in found], times, rtol={"rk4": 1e-8, "bdf": 1e-9}.get(method, 1e-11)
    )
    speeds = 10.0 * restitution ** np.arange(12)
    np.testing.assert_allclose(impacts, speeds, rtol=1e-7 if method == "bdf" else 1e-10)
    assert integrator.time == found[-1].time, "the run stops at the event that says so"


@each_family
def test_samples_around_a_jump_belong_to_their_side(method: str) -> None:
    body = oscillator((lambda t, q, v: t - 1.05, 0))

    def jump(event: Event) -> bool:
        integrator.set_state(event.state + [0.0, 10.0])
        return True

    integrator = Integrator(told(body, jump), method)
    integrator.reset(0.0, (0.0, 1.0), settings(method, **options(method)))
    times, states = collect(integrator, 2.0, Grid(0.0, 0.1, 21), block=4)
    np.testing.assert_array_equal(times, np.arange(21) * 0.1)
    expected = np.sin(times) + np.where(times > 1.05, 10.0 * np.sin(times - 1.05), 0.0)
    np.testing.assert_allclose(states[:, 0], expected, atol=accuracy(method))
    late = Integrator(told(body, lambda e: (late.set_state(e.state + [1.0, 0.0]), True)[1]), method)
    late.reset(0.0, (0.0, 1.0), settings(method, **options(method)))
    times, states = collect(late, 2.0, Grid(0.0, 0.35, 6))
    # the sample at the very time of the jump shows the state before it
    assert states[3, 0] == pytest.approx(np.sin(1.05), abs=1e-7)
    assert states[4, 0] == pytest.approx(np.sin(1.4) + np.cos(0.35), abs=1e-7)


@each_family
def test_a_jump_across_the_event_is_not_an_event(method: str) -> None:
    body = oscillator((lambda t, q, v: q - 0.5, 0), (lambda t, q, v: t - 0.1, 0))

    def react(integrator: Integrator, event: Event) -> bool:
        if event.name == "e1":
            integrator.set_state([0.8, 0.0])  # beyond the threshold at once
        return True

    found, _ = events_of(body, method, (0.0, 1.0), 1.5, react=react, **options(method))
    assert [e.name for e in found] == ["e1", "e0"]
    assert found[1].time == pytest.approx(0.1 + np.arccos(0.5 / 0.8), abs=accuracy(method))


# -- beginnings and ends ------------------------------------------------------------------------------------
@each_family
@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_starting_at_zero_is_no_event(method: str, speed: float) -> None:
    body = oscillator((lambda t, q, v: q, 0))
    found, _ = events_of(body, method, (0.0, speed), 4.0, **options(method))
    np.testing.assert_allclose([e.time for e in found], [np.pi], atol=accuracy(method))


@each_family
def test_staying_at_zero_is_no_event(method: str) -> None:
    body = oscillator(
        (lambda t, q, v: 0.0 * t, 0), (lambda t, q, v: q, 0), (lambda t, q, v: f.maximum(q, 0.0), 0)
    )
    found, _ = events_of(body, method, (0.0, 0.0), 5.0, **options(method))
    assert found == []


@each_family
@pytest.mark.parametrize("at", [0.0, -1e3, 1e3])
def test_an_event_exactly_at_the_end_is_told_once(method: str, at: float) -> None:
    body = system(
        1, lambda t, q, v, z, p: [0.0 * q[0] + 0.0],
        events=lambda t, q, v, z, p: [EventFunction("end", t - (at + 2.0), +1)],
    )  # fmt: skip
    found, integrator = events_of(body, method, (0.0, 1.0), at + 2.0, at, **options(method))
    assert [e.time for e in found] == [at + 2.0]
    integrator.run(at + 3.0, Grid(at, 100.0, 1), lambda t, x: None)
    assert len(found) == 1, "and not again by the run that goes on from there"
    before, _ = events_of(body, method, (0.0, 1.0), at + 1.9, at, **options(method))
    assert before == []


@each_family
def test_an_event_at_a_breakpoint_or_where_a_run_resumes_is_not_lost(method: str) -> None:
    """A step ends with the function exactly at zero: which way it went shows in the next one."""
    body = system(
        1, lambda t, q, v, z, p: [0.0 * q[0] + 0.0], breakpoints=(1.0, 2.0),
        events=lambda t, q, v, z, p: [
            EventFunction("rises", t - 1.0, 0), EventFunction("touches", -(t - 2.0) * (t - 2.0), 0),
            EventFunction("is passed over", t - 0.5, -1),
        ],
    )  # fmt: skip
    found, _ = events_of(body, method, (0.0, 1.0), 3.0, **options(method))
    assert [(e.name, e.time) for e in found] == [("rises", 1.0)]
    plain = system(
        1, lambda t, q, v, z, p: [0.0 * q[0] + 0.0],
        events=lambda t, q, v, z, p: [EventFunction("pass", q[0] - 0.75, +1)],
    )  # fmt: skip
    times: list[float] = []
    integrator = Integrator(told(plain, lambda e: (times.append(e.time), True)[1]), method)
    integrator.reset(0.0, (0.0, 1.0), settings(method, **options(method)))
    for end in (0.25, 0.5, 0.75, 1.0):
        integrator.run(end, Grid(0.0, 9.0, 1), lambda t, x: None)
    assert times == pytest.approx([0.75], abs=1e-13)


# -- what is no crossing ----------------------------------------------------------------------------------
@each_family
def test_a_grazing_touch(method: str) -> None:
    """sin t - (1 + offset) touches, misses or crosses twice; in one run, each is told of by itself."""
    offsets = (0.0, 1e-3, -1e-3, 1e-6)
    body = oscillator(*((lambda t, q, v, offset=offset: q - (1.0 + offset), 0) for offset in offsets))
    found, _ = events_of(body, method, (0.0, 1.0), 6.0, max_step=0.01, **options(method))
    touching, _, crossing, _ = ([e.time for e in found if e.name == f"e{k}"] for k in range(4))
    assert {e.name for e in found} <= {"e0", "e2"}
    t = np.arcsin(1.0 - 1e-3)
    np.testing.assert_allclose(crossing, [t, np.pi - t], atol=1e-6)
    # exactly at the top rounding decides; a pair at the same place is all that may come of it
    assert len(touching) in (0, 2) and all(abs(time - np.pi / 2) < 1e-4 for time in touching)


@each_family
def test_a_jumping_event_function_is_located_too(method: str) -> None:
    body = oscillator((lambda t, q, v: f.sign(q - 0.25), 0))
    found, _ = events_of(body, method, (0.0, 1.0), 4.0, **options(method))
    np.testing.assert_allclose(
        [e.time for e in found], [np.arcsin(0.25), np.pi - np.arcsin(0.25)], atol=accuracy(method)
    )


# -- stops -------------------------------------------------------------------------------------------------
@each_family
@pytest.mark.parametrize("terminal", [True, False])
def test_an_event_ends_the_run_if_its_owner_says_so(method: str, terminal: bool) -> None:
    body = system(
        1,
        lambda t, q, v, z, p: [-q[0]],
        events=lambda t, q, v, z, p: [
            EventFunction("zero", q[0], -1, owner=Stopping() if terminal else None)
        ],
    )
    integrator = Integrator(body, method)
    integrator.reset(0.0, (0.0, 1.0), settings(method, **options(method)))
    times, states = collect(integrator, 5.0, Grid(0.0, 0.5, 11))
    assert integrator.time == pytest.approx(np.pi if terminal else 5.0, abs=accuracy(method))
    assert len(times) == (7 if terminal else 11) and integrator.counters.events == 1
    np.testing.assert_allclose(states[:, 0], np.sin(times), atol=accuracy(method))
    if terminal:
        # going on from there does not meet the same event again
        times, states = collect(integrator, 9.0, Grid(0.0, 0.5, 19))
        assert times[0] == 3.5 and times[-1] == 9.0
        assert integrator.counters.events == 1


@each_family
def test_events_can_be_left_unwatched(method: str) -> None:
    body = oscillator((lambda t, q, v: q, 0))
    seen: list[float] = []
    integrator = Integrator(told(body, lambda e: (seen.append(e.time), True)[1]), method)
    integrator.reset(0.0, (0.0, 1.0), settings(method, **options(method)))
    integrator.run(4.0, Grid(0.0, 9.0, 1), lambda t, x: None, watch=False)
    integrator.run(7.0, Grid(0.0, 9.0, 1), lambda t, x: None)
    integrator.advance(10.0)
    integrator.run(13.0, Grid(0.0, 9.0, 1), lambda t, x: None)
    np.testing.assert_allclose(seen, [2 * np.pi, 4 * np.pi], atol=10 * accuracy(method))


@each_family
def test_trials_are_counted_too(method: str) -> None:
    integrator = Integrator(oscillator((lambda t, q, v: q, 0)), method)
    integrator.reset(0.0, (0.0, 1.0), settings(method, **options(method)))
    spent = np.zeros(3, dtype=int)

    def counting(function: Any) -> Any:
        def call(*arguments: Any) -> Status:
            before = np.array(list(vars(integrator.counters).values())[:3])
            status: Status = function(*arguments)
            spent[:] += np.array(list(vars(integrator.counters).values())[:3]) - before
            return status

        return call

    for name in ("run_to_event", "trial_step"):
        setattr(integrator.engine, name, counting(getattr(integrator.engine, name)))
    integrator.run(10.0, Grid(0.0, 0.5, 21), lambda t, x: None)
    assert list(vars(integrator.counters).values())[:3] == spent.tolist()


@each_family
def test_watching_costs_few_evaluations_and_no_accuracy(method: str) -> None:
    never = oscillator((lambda t, q, v: q - 2.0, 0))
    found, watched = events_of(never, method, (0.0, 1.0), 20.0, **options(method))
    plain = Integrator(oscillator(), method)
    plain.reset(0.0, (0.0, 1.0), settings(method, **options(method)))
    plain.advance(20.0)
    assert not found and watched.counters.steps == plain.counters.steps
    np.testing.assert_array_equal(watched.state, plain.state)


@each_adaptive_family
def test_what_lies_before_a_failure_is_still_found(method: str) -> None:
    """q = 1 / (1 - t) passes 50 before it blows up."""
    body = system(
        1, lambda t, q, v, z, p: [2.0 * q[0] * q[0] * q[0]],
        events=lambda t, q, v, z, p: [EventFunction("fifty", q[0] - 50.0, 0)],
    )  # fmt: skip
    found, integrator = events_of(body, method, (1.0, 1.0), 2.0, react=lambda i, e: False, **options(method))
    assert [e.time for e in found] == [pytest.approx(1.0 - 1 / 50, abs=1e-7)]
    assert integrator.time == found[0].time


# -- the search itself ------------------------------------------------------------------------------------
BOTH = EventFunction("both", 0.0)


@pytest.mark.parametrize(("before", "after", "direction", "expected"), [
    (-1.0, 1.0, 0, True), (-1.0, 1.0, 1, True), (-1.0, 1.0, -1, False), (1.0, -1.0, 0, True), (1.0, -1.0, 1, False),
    (1.0, -1.0, -1, True), (0.0, 1.0, 0, False), (-1.0, 0.0, 0, False), (1.0, 2.0, 0, False), (-1.0, np.nan, 0, False),
])  # fmt: skip
def test_crossing(before: float, after: float, direction: int, expected: bool) -> None:
    assert EventFunction("e", 0.0, direction).crosses(before, after) is expected


CURVES = {
    "a line": (lambda t: t - 0.3, 0.3),
    "a steep tanh": (lambda t: np.tanh(1e6 * (t - 0.7)), 0.7),
    "a jump": (lambda t: np.sign(t - 0.2) + 0.5 * (t < 0.2), 0.2),
    "a flat power": (lambda t: (t - 0.4) ** 9, 0.4),
    "a root near the start": (lambda t: t - 1e-12, 1e-12),
    "a root near the end": (lambda t: t - (1.0 - 1e-13), 1.0 - 1e-13),
    "tiny values": (lambda t: 1e-290 * (t - 0.6), 0.6),
    "huge values": (lambda t: 1e290 * (t - 0.6), 0.6),
    "an exponential": (lambda t: np.exp(50.0 * t) - np.exp(25.0), 0.5),
}


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.parametrize("armed", [None, 1e-300, 1e300])
def test_roots_are_found_to_the_last_digits(name: str, armed: float | None) -> None:
    curve, root = CURVES[name]
    calls: list[float] = []

    def values(time: float) -> np.ndarray:
        calls.append(time)
        return np.array([float(curve(time))])

    start = np.array([np.sign(curve(0.0)) * armed if armed else curve(0.0)])
    found = first_roots([BOTH], values, start, 0, (0.0, 0.0, 1.0))
    (r,) = found.roots
    assert abs(found.time - root) <= (4e-16 if name != "a flat power" else 1e-15)
    assert r.low <= r.high == found.time and r.sign == np.sign(curve(1.0))
    assert len(calls) < 130


def test_what_dense_output_alone_has_seen_is_no_event() -> None:
    assert first_roots(
        [BOTH], lambda t: np.array([1.0]), np.array([1.0]), 0, (0.0, 0.25, 0.5)
    ) == LocatedRoots(0.5)


def test_a_crossing_before_the_bracket_is_found() -> None:
    found = first_roots([BOTH], lambda t: np.array([t - 0.125]), np.array([-1.0]), 0, (0.0, 0.25, 0.5))
    assert found.roots[0].high == 0.125


def test_an_event_that_stood_at_zero_happens_where_it_stood() -> None:
    found = first_roots([BOTH], lambda t: np.array([t]), np.array([-1.0]), 0, (0.0, 0.0, 0.5))
    assert found == LocatedRoots(0.0, (Root(0, 0.0, 0.0, 1.0),))


def test_where_the_motion_cannot_be_followed_the_search_stops_before() -> None:
    def values(time: float) -> np.ndarray:
        return np.array([np.nan if time > 0.4 else 1.0])

    found = first_roots([BOTH], values, np.array([1.0]), 0, (0.0, 0.0, 1.0))
    assert not found.roots and 0.4 - 1e-15 <= found.time <= 0.4
    crossing = first_roots(
        [BOTH], lambda t: np.array([np.nan if t > 0.4 else 0.3 - t]), np.array([1.0]), 0, (0.0, 0.0, 1.0)
    )
    assert crossing.roots[0].high == pytest.approx(0.3, abs=1e-16)


def test_grid_of_a_run_that_begins_between_samples_has_its_beginning_first() -> None:
    grid = Grid.over(2.0, 21).from_time(0.73)
    assert grid.times(0, grid.count)[:3] == pytest.approx([0.73, 0.8, 0.9]) and grid.count == 14
    for first, last in ((0, 1), (1, 4), (3, 14), (2, 2)):
        np.testing.assert_array_equal(grid.times(first, last), grid.times(0, grid.count)[first:last])
    for n in (2, 4, 13):
        coarse = grid.every(n)
        np.testing.assert_allclose(coarse.times(0, coarse.count), grid.times(0, grid.count)[::n], rtol=1e-15)
    assert [grid.first_at(t) for t in (0.0, 0.73, 0.75, 0.8, 1.95)] == [0, 0, 1, 1, 13]
    assert grid.begins_by(0, 0.73) and not grid.begins_by(1, 0.79)
    on_grid = Grid.over(2.0, 21).from_time(0.7)
    assert on_grid.head is None and on_grid.count == 14
