"""The choice of the integrator, and the change to another when a motion turns stiff."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError
from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.graph import Expr, free_symbols
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.integrator import Counters, Event, Grid, Integrator, Options
from robodyn_cli.record import record
from robodyn_cli.run.driver.contact_states import Modes
from robodyn_cli.run.driver.passage import Passage
from robodyn_cli.scene.types import Scene

Array = NDArray[Any]
DEFAULT = "gauss"
STIFF = "radau13"
LARGEST = 12  # velocities up to which an exact Jacobian is worth its code
FAST_DECAYS = 2e3  # decays of the fastest mode within the run from which on stiffness is looked into
TRIAL = 0.02  # part of the run over which two methods are compared
BUDGET = 20_000  # steps of the default method before it is asked again whether the motion is stiff
# what an evaluation costs: eight lanes at once, and those with their share of the linear algebra
COST = {DEFAULT: 1.4, STIFF: 3.0}


@record
class Choice:
    """A method and the reason for it, in words."""

    method: str
    reason: str


def can_be_stiff(problem: Problem) -> bool:
    """Tell whether anything in the scene can damp: without that no mode decays and nothing is stiff."""
    if problem.model.nv > LARGEST:
        return False
    if problem.dissipated or isinstance(problem.elements.power, Expr):
        return True
    rates = {v.index for v in problem.v}
    return any(e.index in rates for tau in problem.actuator_torques for e in free_symbols([tau]))


def fastest_decay(system: System, t: float, x: Array, p: Sequence[float] = ()) -> float:
    """Return the largest -Re of the eigenvalues of the Jacobian of (q, v, z)-dot at a state [1/s]."""
    s = system
    a = [*s.acceleration, *s.z_rate]
    found = {e.value[1:]: e for e in free_symbols(a)}
    columns: list[tuple[int, Expr]] = []
    for group, count, offset in (("q", s.nq, 0), ("v", s.nv, s.nq), ("z", s.nz, s.nq + s.nv)):
        columns += [(offset + k, found[group, k]) for k in range(count) if (group, k) in found]
    rows = jacobian(a, [e for _, e in columns])
    J = np.zeros((s.size, s.size))
    J[: s.nq, s.nq : s.nq + s.nv] = np.eye(s.nq)
    values = {
        group: x.tolist() for group, x in s.own_groups(np.array([t]), x, chart_values(s, t, x, p)).items()
    }
    for i, row in enumerate(rows):
        for k, entry in zip(row, evaluate(list(row.values()), values)):
            J[system.nq + i, columns[k][0]] = entry
    if not np.all(np.isfinite(J)):
        return 0.0
    return float(max(0.0, -np.linalg.eigvals(J).real.min()))


def chart_values(system: System, t: float, x: Array, given: Sequence[float] = ()) -> Array:
    """Return the parameters p at a state: those ``given`` (by default the system's), or what its chart chooses."""
    if system.chart is None:
        return np.array(given if len(given) else system.parameters or [0.0])
    chosen = system.chart.choose(t, system.split(x)[0], None)
    return np.concatenate([np.zeros(system.chart.first), chosen])


def _evaluations(system: System, method: str, start: Array, end: float, options: Options) -> float:
    """Return the cost of a method up to ``end``, infinite where it fails or needs too many steps."""
    integrator = Integrator(system, method)
    integrator.reset(0.0, start, dataclasses.replace(options, max_steps=BUDGET))
    try:
        integrator.advance(end)
    except NumericalError:
        return np.inf
    return COST[method] * integrator.counters.evaluations


def choose(scene: Scene, problem: Problem, system: System, start: Array, options: Options) -> Choice:
    """Return the method that a scene asks for, or for ``auto`` the one that suits the motion.

    Stiff is what the default method finds stiff: where some mode decays thousands of times within the run, both
    methods go a short way, and the one that needs less work there goes on.
    """
    asked = scene.simulate.integrator
    if asked != "auto":
        return Choice(asked, "asked for in simulate.integrator")
    usual = Choice(
        DEFAULT, "collocation of order 16: the fastest at every accuracy where the motion is not stiff"
    )
    if system.dynamics.any_size or not can_be_stiff(problem):
        return usual
    decay = fastest_decay(system, 0.0, start)
    duration = scene.simulate.duration
    if decay * duration < FAST_DECAYS:
        return usual
    trial = max(TRIAL * duration, min(duration, 20.0 / decay))
    slow, fast = (_evaluations(system, m, start, trial, options) for m in (DEFAULT, STIFF))
    if fast < slow:
        return Choice(
            STIFF,
            f"stiff: the fastest mode decays in {1 / decay:.1e} s; an implicit method with the exact "
            f"Jacobian needs {'far less work' if not np.isfinite(slow) else f'{fast / slow:.0%} of the work'} "
            f"of {DEFAULT} over the first {trial:.3g} s",
        )
    return Choice(DEFAULT, f"{usual.reason}; stiffness was looked into (fastest decay {1 / decay:.1e} s)")


class Run:
    """One integration of a scene, which may change its method on the way (``auto`` only)."""

    def __init__(
        self,
        scene: Scene,
        problem: Problem,
        system: System,
        start: Array,
        options: Options,
        tick: Callable[[float], None],
        modes: Modes | None = None,
        passage: Passage | None = None,
    ) -> None:
        self.modes = modes
        self.scene = scene
        self.problem = problem
        self.system = system
        self.options = options
        self.choice = choose(scene, problem, system, start, options)
        self.switches: list[dict[str, Any]] = []
        self.integrator = Integrator(system, self.choice.method)
        self._watchful = (
            scene.simulate.integrator == "auto"
            and self.choice.method == DEFAULT
            and not system.dynamics.any_size
            and can_be_stiff(problem)
        )
        self._done = Counters()
        self.passage = passage
        self.tick = tick
        self.integrator.tick = tick
        self.integrator.reset(0.0, start, self._limited())
        if modes is not None:
            modes.attach(self.integrator)

    def _limited(self) -> Options:
        if self._watchful:
            return dataclasses.replace(self.options, max_steps=min(BUDGET, self.options.max_steps))
        return self.options

    @property
    def counters(self) -> Counters:
        """Counters over all methods used."""
        return self._done + self.integrator.counters

    def run(
        self,
        end: float,
        grid: Grid,
        emit: Callable[[Array, Array], None],
        on_event: Callable[[Event], bool] | None = None,
    ) -> None:
        """Integrate to ``end`` as ``Integrator.run`` does."""
        while True:
            try:
                if self.passage is None:
                    self.integrator.run(end, grid, emit, on_event)
                else:
                    self.passage.run(self.integrator, end, grid, emit, on_event, self._passed)
                return
            except NumericalError as error:
                if not self._watchful or error.details.get("status") != "max_steps":
                    raise
                self._reconsider(end)

    def _passed(self, counters: Counters) -> None:
        """Note the counters of a stretch that ended at a singular configuration."""
        self._done = self._done + counters

    def _reconsider(self, end: float) -> None:
        """After many steps, ask whether the motion has turned stiff; go on from here either way."""
        time, state = self.integrator.time, self.integrator.state
        self._done = self.counters
        pace = max(self._done.steps, 1) / max(time, 1e-300)
        decay = fastest_decay(self.system, time, state, self.integrator.p.tolist())
        # the default method is held to steps of a few times the fastest decay time; where that is what it does
        # while nothing else asks for such steps, the motion is stiff
        if decay > 0.1 * pace:
            self.switches.append({"time": time, "to": STIFF, "fastest_decay": 1.0 / decay})
            self.integrator = Integrator(self.system, STIFF)
            self.integrator.tick = self.tick
            self._watchful = False
        self.integrator.reset(time, state, self._limited())
        if self.modes is not None:
            self.modes.attach(self.integrator)
