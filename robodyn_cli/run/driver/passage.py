"""The passage of a configuration in which the loops' constraints lose rank.

In the pose itself equation (36) decides nothing, close to it forces are known to few digits, and a method whose
stages happen to fall there may leave the branch that the motion is on. Along its branch the motion is smooth all
the same. So the pose is stepped over: one step of the 8-stage Gauss method, from where the constraints come near
to losing rank to as far behind, with the pose in the middle and no stage within a twelfth of the step of it. Stages are
put onto the constraints before they are evaluated, so that every one lies on the branch.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.dependence import closeness
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SingularConfigurationError
from robodyn_cli.formulations.system import GROUPS, EventFunction, System
from robodyn_cli.integrators.methods.gauss_tables import gauss_table
from robodyn_cli.integrators.runtime.integrator import Counters, Event, Grid, Integrator
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.record import record
from robodyn_cli.run.driver.singularity import singular_ratio
from robodyn_cli.run.observation.observe import Observer

Array = NDArray[np.float64]
NEAR_PASSAGE = "near_passage"
NEAR = 0.03  # ratio of singular values from which on a pose to pass is looked for ahead
LOST = 0.03  # part of the ratio at the start of the step that may be left in its middle
STAGES = 8
ITERATIONS = 80
SETTLED = 1e-12  # change of the stages, over their size, at which the iteration ends
SMOOTH = 1e-5  # part of the rates that the last of the step's polynomials may have
BALANCE = 1e-6  # of the kinetic energy, by which its balance may change


def passage_event(problem: Problem) -> tuple[EventFunction, ...]:
    """Return the event of coming near a loss of rank that is to be passed."""
    rows = problem.loop_psi
    if not len(rows):
        return ()
    return (EventFunction(NEAR_PASSAGE, closeness(rows) - NEAR * NEAR, direction=-1, terminal=False),)


@record
class Crossing:
    """A step over a pose: from ``start`` [s] over ``length``; state x0 and, over it, its rates as a Legendre series."""

    start: float
    length: float
    x0: Array
    integral: Array
    end: Array

    def states(self, t: Array) -> Array:
        """Return the states (T, nx) within the step."""
        s = 2.0 * (t - self.start) / self.length - 1.0
        return self.x0 + 0.5 * self.length * np.polynomial.legendre.legval(s, self.integral).T.reshape(
            len(t), -1
        )


class Passage:
    """Integration that steps over poses in which the loops lose rank. ``crossed`` : their times [s]."""

    def __init__(self, problem: Problem, system: System, observer: Observer) -> None:
        self.problem, self.system, self.observer = problem, system, observer
        self.rates = SampleKernel({"a": system.acceleration, "z": system.z_rate}, GROUPS)
        self.crossed: list[float] = []

    def run(
        self,
        integrator: Integrator,
        end: float,
        grid: Grid,
        emit: Callable[[Array, Array], None],
        on_event: Callable[[Event], bool] | None = None,
        done: Callable[[Counters], None] = lambda counters: None,
    ) -> None:
        """Integrate as ``Integrator.run`` does; ``done`` is told the counters of each stretch between poses.

        Raises
        ------
        SingularConfigurationError : a pose that cannot be stepped over.
        """
        crossing: Crossing | None = None

        def handle(event: Event) -> bool:
            nonlocal crossing
            if event.name != NEAR_PASSAGE:
                return on_event(event) if on_event else not integrator.system.events[event.index].terminal
            crossing = self.cross(event.time, event.state)
            return crossing is None

        while True:
            crossing = None
            integrator.run(end, grid, emit, handle)
            if crossing is None:
                return
            behind = min(crossing.start + crossing.length, end)
            if crossing.start + 0.5 * crossing.length <= end:
                self.crossed.append(crossing.start + 0.5 * crossing.length)
            first, last = grid.first_at(crossing.start), min(grid.first_at(behind), grid.count)
            first += grid.begins_by(first, crossing.start)
            if last > first:
                times = grid.times(first, last)
                emit(times, crossing.states(times))
            done(integrator.counters)
            state = crossing.end if behind < end else crossing.states(np.array([end]))[0]
            integrator.reset(behind, state, integrator.options)

    def _rates(self, t: Array, x: Array) -> Array:
        """Return x-dot (T, nx) at states (T, nx)."""
        s = self.system
        values = np.asfortranarray(x)
        found = self.rates.evaluate(len(t), s.own_groups(t, values, self._parameters(t, x)))
        return np.concatenate([x[:, s.nq : s.nq + s.nv], found["a"], found["z"]], axis=1)

    def _parameters(self, t: Array, x: Array) -> Array:
        chart = self.system.chart
        if chart is None:
            return self.observer.parameters
        middle = len(t) // 2
        chosen = chart.choose(float(t[middle]), self.system.split(x[middle])[0], None)
        return np.concatenate([np.zeros(chart.first), chosen])

    def _half(self, t: float, x: Array) -> float | None:
        """Return the time to the loss of rank ahead [s], None where the motion only comes near one."""

        def ratio(at: Array) -> float:
            return singular_ratio(self.problem, self.system.split(at)[0])

        F = self._rates(np.array([t]), x[None])[0]
        here, speed = ratio(x), float(np.abs(F[: self.system.nq]).max(initial=0.0))
        if self.system.layout is not None:
            speed = max(speed, float(np.abs(self.system.split(F)[0]).max(initial=0.0)))
        if speed == 0.0:
            return None
        step = 1e-3 * here / speed
        bend = (self._rates(np.array([t + step]), (x + step * F)[None])[0] - F) / step
        slope = (ratio(x + step * F) - here) / step
        if not slope < 0.0:
            return None

        def path(time: float) -> float:
            return ratio(x + time * (F + 0.5 * time * bend))

        times = np.linspace(0.0, -3.0 * here / slope, 61)
        k = int(np.argmin([path(time) for time in times]))
        low, high = times[max(k - 1, 0)], times[min(k + 1, 60)]
        for _ in range(40):
            a, b = low + 0.382 * (high - low), low + 0.618 * (high - low)
            low, high = (low, b) if path(a) < path(b) else (a, high)
        middle = 0.5 * (low + high)
        return middle if path(middle) < LOST * here else None

    def cross(self, t: float, x: Array) -> Crossing | None:
        """Return the step over the pose ahead of (t, x), None where there is none.

        Raises
        ------
        SingularConfigurationError : the step's stages do not settle, or it is not smooth, or loses energy.
        """
        half = self._half(t, x)
        if half is None:
            return None
        T, length = gauss_table(STAGES), 2.0 * half
        times = t + length * T.c
        F0 = self._rates(np.array([t]), x[None])
        stages = x + length * T.c[:, None] * F0
        size = 1.0 + np.abs(stages).max()
        change = np.inf
        for _ in range(ITERATIONS):
            F = self._rates(times, self.observer.project(times, stages.copy()))
            new = x + length * (T.A @ F)
            change, stages = float(np.abs(new - stages).max()), new
            if not change > SETTLED * size:
                break
        series = np.polynomial.legendre.legfit(2.0 * T.c - 1.0, F, STAGES - 1)
        last, whole = np.abs(series[-2:]).max(), np.abs(series).max()
        end = x + length * (T.b @ F)
        behind = self.observer.project(np.array([t + length]), end[None].copy())[0]
        if not change <= 1e3 * SETTLED * size:
            raise self._failure(t + half, f"the iteration does not settle (change {change:.1g})")
        if not last <= SMOOTH * whole:
            raise self._failure(
                t + half, f"the motion is not smooth there ({last / whole:.1g} of it in the last terms)"
            )
        lost, kinetic = self._lost(t, x, t + length, behind)
        if not abs(lost) <= BALANCE * max(kinetic, 1e-300):
            raise self._failure(t + half, f"energy would change by {lost:.3g} J")
        return Crossing(
            t,
            length,
            x.copy(),
            np.asarray(np.polynomial.legendre.legint(series, lbnd=-1), dtype=float),
            behind,
        )

    def _lost(self, t0: float, x0: Array, t1: float, x1: Array) -> tuple[float, float]:
        """Return by how much the balance of energy changes between two states, and the kinetic energy [J]."""
        data: dict[str, Any] = self.observer.observe(np.array([t0, t1]), np.array([x0, x1]), project=False)
        balance = data["energy/total"] - data.get("energy/work", np.zeros(2))
        return float(balance[1] - balance[0]), float(data["energy/kinetic"].max())

    def _failure(self, time: float, why: str) -> SingularConfigurationError:
        loops = ", ".join(self.problem.model.closures)
        return SingularConfigurationError(
            f"the singular configuration at t = {time:.9g} s, in which the constraints of {loops} lose rank, cannot be "
            f"passed: {why}",
            time=time, kind="bifurcation",
        )  # fmt: skip
