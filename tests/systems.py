"""Systems with exact solutions, built directly from expressions, and short ways to integrate them."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.special import ellipj, ellipk

from robodyn_cli.errors import NumericalError
from robodyn_cli.expr import functions as f
from robodyn_cli.expr.graph import Graph
from robodyn_cli.formulations.dynamics import Expanded
from robodyn_cli.formulations.events import GO_ON, STOP, Event, EventFunction, Outcome
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.summaries.motion import Counters

Array = np.ndarray


def system(
    nv: int, rates: Callable[..., Any], nz: int = 0, events: Callable[..., Any] | None = None, **more: Any
) -> System:
    """Build a system from ``rates(t, q, v, z, p)`` -> accelerations, or (accelerations, z rates)."""
    graph = Graph()
    t = graph.symbol("t", "t")
    q, v, z, p = (graph.symbols([f"{g}{k}" for k in range(n)], g) for g, n in zip("qvzp", (nv, nv, nz, 4)))
    found = rates(t, q, v, z, p)
    a, zr = found if isinstance(found, tuple) else (found, [])
    functions = tuple(events(t, q, v, z, p)) if events else ()
    return System(nv, nv, Expanded(tuple(a), tuple(zr)), nz, events=functions, **more)


@dataclasses.dataclass(frozen=True)
class Case:
    """A system, its state at t = 0, the exact states (T, nx) at times (T,), and a time to integrate to.

    kind : of the system, as ``tests/methods.py`` tells them apart by who refuses them.
    """

    name: str
    system: System
    start: tuple[float, ...]
    exact: Callable[[Array], Array]
    end: float
    kind: str = "accelerations from positions and time"

    def __str__(self) -> str:
        return self.name


def _columns(*columns: Any) -> Array:
    return np.array(columns).T


def oscillator(w: float = 1.0) -> Case:
    body = system(1, lambda t, q, v, z, p: [-w * w * q[0]])
    return Case(
        "oscillator", body, (1.0, 0.0), lambda t: _columns(np.cos(w * t), -w * np.sin(w * t)), 20.0 / w
    )


def kepler(e: float = 0.5) -> Case:
    def rates(t: Any, q: Any, v: Any, z: Any, p: Any) -> list[Any]:
        r2 = q[0] * q[0] + q[1] * q[1]
        return [-x / (r2 * f.sqrt(r2)) for x in q]

    def exact(t: Array) -> Array:
        E = np.asarray(t, dtype=float).copy()
        for _ in range(60):
            E = E - (E - e * np.sin(E) - t) / (1 - e * np.cos(E))
        b, dE = np.sqrt(1 - e * e), 1 / (1 - e * np.cos(E))
        return _columns(np.cos(E) - e, b * np.sin(E), -np.sin(E) * dE, b * np.cos(E) * dE)

    return Case("Kepler orbit", system(2, rates), tuple(exact(np.zeros(1))[0]), exact, 6 * np.pi)


def forced(work: bool = False) -> Case:
    """q'' = -q + sin 3t from (1, 0); the work of the force as a further state."""

    def exact(t: Array) -> Array:
        q = np.cos(t) + 3 / 8 * np.sin(t) - np.sin(3 * t) / 8
        v = -np.sin(t) + 3 / 8 * np.cos(t) - 3 / 8 * np.cos(3 * t)
        z = -(np.sin(2 * t) / 2 - np.sin(4 * t) / 4) / 2
        z = (
            z
            + 3 / 16 * ((1 - np.cos(4 * t)) / 4 + (1 - np.cos(2 * t)) / 2)
            - 3 / 16 * (1 - np.cos(6 * t)) / 6
        )
        return _columns(q, v, z) if work else _columns(q, v)

    force: Callable[..., Any] = lambda t, q, v, z, p: [-q[0] + f.sin(3 * t)]  # noqa: E731
    if not work:
        return Case("forced", system(1, force), (1.0, 0.0), exact, 20.0)
    both = system(1, lambda t, q, v, z, p: (force(t, q, v, z, p), [v[0] * f.sin(3 * t)]), nz=1)
    return Case("forced, with its work", both, (1.0, 0.0, 0.0), exact, 20.0)


def damped() -> Case:
    body = system(1, lambda t, q, v, z, p: [-4.04 * q[0] - 0.4 * v[0]])

    def exact(t: Array) -> Array:
        q = np.exp(-0.2 * t) * (np.cos(2 * t) + 0.1 * np.sin(2 * t))
        return _columns(q, np.exp(-0.2 * t) * (-2.02) * np.sin(2 * t))

    return Case("damped", body, (1.0, 0.0), exact, 12.0, "accelerations from velocities")


def linear(name: str, A: Array, body: System, start: Sequence[float], end: float) -> Case:
    values, vectors = np.linalg.eig(A)
    weights = np.linalg.solve(vectors, np.array(start, dtype=complex))

    def exact(t: Array) -> Array:
        return ((vectors * weights) @ np.exp(np.outer(values, t))).real.T

    return Case(name, body, tuple(start), exact, end)


def controlled() -> Case:
    """A state z that feeds back into the acceleration: an integral controller."""
    body = system(1, lambda t, q, v, z, p: ([-4 * q[0] - v[0] - 1.5 * z[0]], [q[0] - 0.5 * z[0]]), nz=1)
    A = np.array([[0.0, 1.0, 0.0], [-4.0, -1.0, -1.5], [1.0, 0.0, -0.5]])
    case = linear("controlled", A, body, (1.0, 0.0, 0.3), 12.0)
    return dataclasses.replace(case, kind="accelerations from velocities")


def chain(n: int = 5) -> Case:
    """Masses on springs in a row between two walls."""

    def rates(t: Any, q: Any, v: Any, z: Any, p: Any) -> list[Any]:
        row = [0.0, *q, 0.0]
        return [row[k] - 2 * row[k + 1] + row[k + 2] for k in range(n)]

    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, np.zeros((n, n))]])
    start = [0.1 * (k + 1) * (-1) ** k for k in range(n)] + [0.0] * n
    return linear(f"chain of {n}", A, system(n, rates), start, 15.0)


def pendulums(*amplitudes: float) -> Case:
    """Uncoupled pendulums theta'' = -sin theta, released at rest."""
    n = len(amplitudes)
    body = system(n, lambda t, q, v, z, p: [-f.sin(x) for x in q])

    def exact(t: Array) -> Array:
        angles, rates = [], []
        for amplitude in amplitudes:
            k = np.sin(amplitude / 2)
            sn, cn, *_ = ellipj(ellipk(k * k) - t, k * k)
            angles.append(2 * np.arcsin(k * sn))
            rates.append(-2 * k * cn)
        return _columns(*angles, *rates)

    return Case(f"{n} pendulums", body, (*amplitudes, *[0.0] * n), exact, 15.0)


CASES = (
    oscillator(), kepler(), forced(), forced(work=True), damped(), controlled(), chain(4), chain(5),
    pendulums(0.5, 1.5, 2.5),
)  # fmt: skip


# -- accuracy -------------------------------------------------------------------------------------------
# a multistep method adds up errors that all point the same way: ten to thirty tolerances
GENEROUS = {"bdf": 30.0}
FINEST = 1e-8  # that is asked of methods of low order, which take many steps for it


def is_low(method: str) -> bool:
    """Tell whether a method is of so low an order that high accuracy takes very many steps."""
    return methods[method].order <= 2


def within_reach(method: str, accuracy: float) -> float:
    """Return an accuracy, or the finest that is asked of the method."""
    return max(accuracy, FINEST if is_low(method) else 1e-13 if method in GENEROUS else 0.0)


def settings(method: str, rtol: float = 1e-10, atol: float = 1e-12, **more: Any) -> Options:
    """Return options in which the tolerances are what the errors are to be.

    A method whose error falls more slowly than its tolerance gets tolerances that make up for it.
    """
    if method in GENEROUS:
        finer = max(rtol / GENEROUS[method], 1e-15)
        rtol, atol = finer, atol * (finer / rtol)
    power = methods[method].proportion
    if power < 1.0:
        finer = max(within_reach(method, rtol) ** (1.0 / power), 1e-15)
        rtol, atol = finer, atol * (finer / rtol)
    return Options(rtol, atol, **more)


# -- runs -----------------------------------------------------------------------------------------------
def advance(case: Case, method: str, end: float | None = None, **options: Any) -> Integrator:
    """Integrate a case without samples."""
    integrator = Integrator(case.system, method)
    integrator.reset(0.0, case.start, settings(method, **options))
    integrator.advance(case.end if end is None else end)
    return integrator


def step_ends(case: Case, method: str, end: float | None = None, **options: Any) -> tuple[Integrator, Array]:
    """Integrate a case step by step; returns the integrator and the ends of its steps (n,)."""
    integrator = Integrator(case.system, method)
    integrator.reset(0.0, case.start, settings(method, **options))
    ends = [0.0]
    stop = case.end if end is None else end
    while integrator.time < stop:
        integrator.options = dataclasses.replace(
            integrator.options, max_steps=integrator.counters.attempts + 1
        )
        with contextlib.suppress(NumericalError):
            integrator.advance(stop)
        ends += [integrator.time] if integrator.time > ends[-1] else []
    return integrator, np.array(ends)


def samples(
    body: System,
    method: str,
    start: Sequence[float],
    grid: Grid,
    end: float | None = None,
    block: int = 65536,
    parameters: Any = (),
    on_event: Any = None,
    **options: Any,
) -> tuple[Array, Array, Integrator]:
    """Integrate over a grid; returns times, states and the integrator."""
    integrator = Integrator(body if on_event is None else told(body, on_event), method, parameters)
    integrator.reset(grid.start, start, settings(method, **options))
    times, states = collect(integrator, grid.times(0, grid.count)[-1] if end is None else end, grid, block)
    return times, states, integrator


class Telling:
    """Owns event functions and tells a function of each event, which returns whether the run is to go on."""

    def __init__(self, react: Callable[[Event], bool]) -> None:
        self.react = react

    def handle(self, event: Event) -> Outcome:
        return GO_ON if self.react(event) else STOP

    def again(self) -> Telling:
        return self


def told(body: System, react: Callable[[Event], bool]) -> System:
    """Return a system whose events are told to a function."""
    owner = Telling(react)
    return body.watched_by(lambda function: owner)


def collect(integrator: Integrator, end: float, grid: Grid, block: int = 65536) -> tuple[Array, Array]:
    """Run and gather what is emitted."""
    blocks: list[tuple[Array, Array]] = []
    integrator.run(end, grid, lambda t, x: blocks.append((t, x)), block)
    if not blocks:
        return np.zeros(0), np.zeros((0, integrator.system.size))
    return np.concatenate([t for t, _ in blocks]), np.concatenate([x for _, x in blocks])


def events_of(
    body: System,
    method: str,
    start: Sequence[float],
    end: float,
    at: float = 0.0,
    react: Callable[[Integrator, Event], bool] | None = None,
    **options: Any,
) -> tuple[list[Event], Integrator]:
    """Integrate and gather the events; they do not stop the run unless ``react`` returns False."""
    found: list[Event] = []

    def on_event(event: Event) -> bool:
        found.append(event)
        return react(integrator, event) if react else True

    integrator = Integrator(told(body, on_event), method)
    integrator.reset(at, start, settings(method, **options))
    integrator.run(end, Grid(at, 2 * (end - at), 1), lambda t, x: None)
    return found, integrator


__all__ = ["CASES", "Case", "EventFunction", "Grid", "Integrator", "Options", "advance", "collect", "events_of",
           "samples", "system", "told"]  # fmt: skip


def integrate(
    system: System,
    method: str,
    state: Any,
    grid: Grid,
    options: Options,
    parameters: Any = (),
) -> tuple[Array, Array, Counters]:
    """Integrate over a grid and return times (T,), states (T, nx) and counters."""
    integrator = Integrator(system, method, parameters)
    integrator.reset(grid.start, state, options)
    times: list[Array] = []
    states: list[Array] = []

    def emit(t: Array, x: Array) -> None:
        times.append(t)
        states.append(x)

    integrator.run(grid.start + (grid.count - 1) * grid.step, grid, emit)
    return np.concatenate(times), np.concatenate(states), integrator.counters
