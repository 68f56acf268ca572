"""The scan of a deployment: everything that can stop it, and when."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.index1 import index1, multiplier_norm
from robodyn_cli.formulations.system import GROUPS, EventFunction, System
from robodyn_cli.integrators.runtime.integrator import Event, Grid, Integrator, Options
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.record import mutable_record
from robodyn_cli.run.deploy.growth import GRID, GrowthMonitor, levels_with
from robodyn_cli.run.deploy.latch import LatchImpact, Locked
from robodyn_cli.run.driver.method import choose
from robodyn_cli.run.driver.prepare import Setup, options_for, passive_coordinates, prepare
from robodyn_cli.run.driver.singularity import (
    NEAR_RANK_LOSS,
    classify,
    driven_dead_point,
    loop_rows,
    passive_determinant,
    rank_loss_ahead,
    rank_loss_event,
    refuse_dependent_rows,
    refuse_singular_start,
)
from robodyn_cli.run.observation.least_norm import LeastNorm
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene

Array = NDArray[np.float64]


@mutable_record
class Found:
    """What the scan of the whole motion met, by kind: time and state (q, v, z)."""

    dead_points: list[tuple[float, Array]] = dataclasses.field(default_factory=list)
    bifurcation: tuple[float, Array] | None = None
    stopped: NumericalError | None = None
    driven: bool = False
    growth: GrowthMonitor = dataclasses.field(default_factory=lambda: GrowthMonitor(()))
    end: float = 0.0
    steps: int = 0
    clean_until: float = 0.0
    norm_at_end: float = 0.0

    @property
    def dead_point(self) -> tuple[float, Array] | None:
        """The first one."""
        return self.dead_points[0] if self.dead_points else None


class Deployment:
    """One deployment: the mechanism, its singularity functions, the scan and the run."""

    def __init__(self, scene: Scene, watch: Stopwatch) -> None:
        self.scene = scene
        # what the report finds out about the latch, for what follows the lock
        self.latch: Locked | None = None
        self.impact: LatchImpact | None = None
        if not scene.loops and not scene.couplers:
            raise CapabilityError(
                f"{scene.path}: deploy needs a mechanism with closed loops; this scene has none"
            )
        self.setup: Setup = prepare(scene, watch)
        self.problem: Problem = self.setup.problem
        with watch.stage("equations"):
            self.passive = passive_coordinates(self.problem) or []
            self.determinant: Scalar | None = None
            try:
                self.determinant = passive_determinant(self.problem, self.passive)
            except CapabilityError:
                if scene.deploy.criterion != "multipliers":
                    raise
            events = rank_loss_event(self.problem)
            if self.determinant is not None:
                events = (*events, EventFunction("dead_point", self.determinant, terminal=False))
            self.system: System = index1(self.problem, scene.simulate.stabilisation, events)
            self.options: Options = options_for(scene)
            self.start = self.system.join(self.setup.assembled.q, self.setup.assembled.v)
        refuse_singular_start(self.problem, self.setup.assembled.q, self.passive)
        with watch.stage("method"):
            self.choice = choose(scene, self.problem, self.system, self.start, self.options)
            self.method = self.choice.method

    def scan(self, options: Options, multipliers: bool = True, progress: Progress = no_progress) -> Found:
        """Integrate until everything that can stop the deployment has fired, or to the end of the duration.

        The motion is followed on the uniform 1 ms grid, free of the criterion, so that the report can say when
        each criterion fired. A dead point ends the scan once the multipliers have been judged up to it.
        """
        scene, problem = self.scene, self.problem
        found = Found(growth=GrowthMonitor(levels_with(scene.deploy.growth), scene.deploy.limit))
        lam = self._loop_multipliers() if multipliers else None
        rows = loop_rows(problem)
        integrator = Integrator(self.system, self.method)
        integrator.reset(0.0, self.start, options)
        duration = scene.simulate.duration
        integrator.tick = lambda time: progress(time, duration)
        grid = Grid(0.0, GRID, int(duration / GRID * (1 + 1e-12)) + 1)

        def emit(t: Array, x: Array) -> None:
            if lam is None:
                return
            values = lam.evaluate(len(t), self.system.groups(t, x, np.zeros(1)))["lam"]
            norm = multiplier_norm(values[:, rows])
            found.norm_at_end = float(norm[-1])
            found.growth.take(t, norm)

        def on_event(event: Event) -> bool:
            if self.system.events[event.index].kink:
                return True
            if event.name == NEAR_RANK_LOSS:
                found.clean_until = event.time
                found.bifurcation = rank_loss_ahead(problem, self.system, self.method, event, options)
                if found.bifurcation is not None:
                    time, state = found.bifurcation
                    refuse_dependent_rows(problem, self.system.split(state)[0], time)
                return found.bifurcation is None
            kind = classify(problem, self.system.split(event.state)[0], self.passive).kind
            if kind == "dead_point":
                found.dead_points.append((event.time, event.state))
                # a criterion on the multipliers may still fire beyond the dead point
                return scene.deploy.criterion == "multipliers" and self.multiplier_time(found) is None
            return True

        try:
            integrator.run(duration, grid, emit, on_event, block=4096)
        except NumericalError as error:
            found.stopped = error
            self._driven_dead_point(found, integrator)
        found.end, found.steps = integrator.time, integrator.counters.steps
        return found

    def _loop_multipliers(self) -> SampleKernel | LeastNorm:
        if self.problem.dependent:
            return LeastNorm(self.problem)
        return SampleKernel({"lam": list(self.problem.forward.lam)}, GROUPS)

    def multiplier_time(self, found: Found) -> float | None:
        """Return when the criterion on the multipliers fired."""
        times = [found.growth.times.get(self.scene.deploy.growth), found.growth.limit_time]
        fired = [t for t in times if t is not None]
        return min(fired) if fired else None

    def _driven_dead_point(self, found: Found, integrator: Integrator) -> None:
        """Note the singular pose that a prescribed motion has run into, if that is what stopped the scan."""
        state = integrator.state
        q, _, _ = self.system.split(state)
        pose = driven_dead_point(self.problem, self.passive, q, integrator.time, self.scene.simulate.duration)
        if pose is None:
            return
        time, q, kind = pose
        state[list(self.system.q_places)] = q
        found.driven = True
        if kind == "bifurcation":
            found.bifurcation = (time, state)
        elif kind == "dead_point":
            found.dead_points.append((time, state))

    def stop_time(self, found: Found) -> tuple[float | None, str]:
        """Return when the scene's criterion stops the run, and which criterion it was."""
        dead = found.dead_point[0] if found.dead_point else None
        multipliers = self.multiplier_time(found)
        criterion = self.scene.deploy.criterion
        if criterion == "dead_point":
            return dead, "dead_point"
        if criterion == "multipliers":
            return multipliers, "multipliers"
        candidates = [
            (t, name) for t, name in ((dead, "dead_point"), (multipliers, "multipliers")) if t is not None
        ]
        return min(candidates) if candidates else (None, "either")
