"""A motion that is to be integrated: its equations, start and options, and who watches it on the way."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.formulations.events import GO_ON, Event, EventFunction, Outcome
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.observe.observe import Observer, all_missing_data
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closing.assembly import Assembled
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.motion import Gains

if TYPE_CHECKING:
    from robodyn_cli.expr.many import ManyNumbers
    from robodyn_cli.motion.conditioning import Conditioning
    from robodyn_cli.results.result import Result


@record
class MethodChoice:
    """A method and the reason for it, in words. may_change : whether the run may go on with another one."""

    method: str
    reason: str
    may_change: bool = False


class Watcher:
    """Follows a motion while it is integrated: owns event functions, and sees the start and every sample.

    functions : what it watches, in the mechanism's symbols; the system is built with them. changes_motion : whether its
    answers may be others than to go on or to stop. sets_start : whether ``begin`` or ``arm`` may change the start.

    A watcher overrides what it needs. One object follows one integration; ``again`` gives that of a second one.
    """

    functions: tuple[EventFunction, ...] = ()
    changes_motion = False
    sets_start = False

    @property
    def log(self) -> list[dict[str, Any]]:
        """What has happened, for the events of the result."""
        return []

    @property
    def warnings(self) -> list[str]:
        """What users are to be warned of after the run."""
        return []

    @property
    def together(self) -> Sequence[str]:
        """Names of joints that have stuck together so that their loads are not determined."""
        return ()

    @property
    def noted(self) -> dict[str, float]:
        """Times [s] of what it has noted on the way, by name, for a run that goes on after it was killed."""
        return {}

    def recall(self, noted: Mapping[str, float]) -> None:
        """Take over what an earlier process has ``noted``."""

    @property
    def rounding(self) -> float:
        """What rounding in its own integrations is expected to leave in the rates [rad/s, m/s]."""
        return 0.0

    def facts(self, end: float) -> dict[str, Any]:
        """Return fields of the summary for a run that came to ``end`` [s]."""
        return {}

    @property
    def kernels(self) -> dict[str, SampleKernel]:
        """What it evaluates beside its event functions, by name, once it has taken the motion."""
        return {}

    def add_to(self, result: Result) -> None:
        """Add datasets of its own to the result of a run."""

    def follow(self, motion: Motion) -> None:
        """Take the motion, once it is built."""

    def meet(self, others: Sequence[Watcher]) -> None:
        """Take note of who follows the same integration."""

    def begin(self, t: float, x: Array, options: Options) -> Array:
        """Look at the state x (nx,) that a run with such options starts from; return the one to start from instead."""
        return x

    def arm(self, x: Array) -> Outcome:
        """Return what an integrator that takes over at x has to be told."""
        return GO_ON

    def see(self, t: Array, x: Array) -> None:
        """Look at samples x (T, nx) at times t (T,), which may be refused."""

    def handle(self, event: Event) -> Outcome:
        """Answer one of its own events."""
        return GO_ON

    def stops(self) -> Sequence[float]:
        """Return times ahead [s] at which it wants to be asked how the run goes on."""
        return ()

    def at_stop(self, t: float, x: Array) -> Outcome:
        """Say how the run goes on from x (nx,) at such a time t."""
        return GO_ON

    def again(self) -> Watcher | None:
        """Return the watcher of a second integration; None for one that does not change the motion."""
        return None


@record
class Beginning:
    """Time [s] and state x (nx,) that a run begins with; told : what users are to be warned of about it."""

    time: float
    state: Array
    told: tuple[str, ...] = ()


@record
class Motion:
    """What is built once of a scene, for every command that integrates it, and for the plan.

    problem : the equations. assembled : the closed configuration at t = 0.
    system : what is integrated; its ``events`` name their owners, among them the ``watchers``; ``dynamics``,
    ``positions``, ``velocities`` and ``switching`` are the programs of the stepping loop.
    choice : the method and why. gains : where ``stabilisation: baumgarte`` left them to us, the scene has them.
    reactions : whether joint reactions are observed whatever the scene's outputs say.
    """

    scene: Scene
    problem: Problem
    assembled: Assembled
    passive: tuple[int, ...]
    system: System
    watchers: tuple[Watcher, ...]
    options: Options
    choice: MethodChoice
    gains: Gains | None = None
    reactions: bool = False

    @property
    def start(self) -> Array:
        """The state x (nx,) at t = 0."""
        q, v, control = self.assembled.q, self.assembled.v, self.problem.control
        if control is None:
            return self.system.join(q, v)
        updates = self.system.updates
        noise = np.zeros(0) if updates is None else updates.noise[0]
        work = np.zeros(1 if self.system.work_done_by else 0)
        own = control.start(q, v, self.system.parameters_at(0.0, q), noise)
        return self.system.join(q, v, np.concatenate([own, work]))

    @property
    def beginning(self) -> Beginning:
        """The start as what a run begins with."""
        return Beginning(0.0, self.start)

    @property
    def sticking_together(self) -> tuple[str, ...]:
        """Names of joints that have stuck together so that their loads were not determined."""
        return tuple(name for watcher in self.watchers for name in watcher.together)

    def with_own_watchers(self, system: System | None = None) -> Motion:
        """Return the motion with watchers of its own, and with another ``system`` of the same events."""
        twins = {id(w): w.again() or copy.copy(w) for w in self.watchers}
        watched = (system or self.system).watched_by(lambda e: twins.get(id(e.owner), e.owner))
        return dataclasses.replace(self, system=watched, watchers=tuple(twins.values()))

    def conditioning(self, times: Array, x: Array, runs: ManyNumbers | None = None) -> Conditioning:
        """Return what rounding of the equations does along states x (N, T, nx) at times (N, T).

        runs : numbers of the scene in each, in place of its own.
        """
        from robodyn_cli.motion.conditioning import Conditioning

        return Conditioning.of(self.problem, self.held, times, self.system.split(x), runs)

    @cached_property
    def is_steep(self) -> bool:
        """Whether rates pass through steep slopes where they change their sign: dry friction that is smoothed."""
        forces = (force for body in self.problem.model.bodies for force in body.forces)
        return any(force.kind == "friction" and force.element.is_smoothed for force in forces)

    @cached_property
    def held(self) -> list[int]:
        """Columns of rates that are held while the loops are closed at the start."""
        from robodyn_cli.ready.prepare import held_columns

        names = held_columns(self.scene, self.problem)
        return [k for k, name in enumerate(self.problem.model.v_names) if name in names]

    @cached_property
    def start_rounding(self) -> tuple[Array, Array]:
        """Psi (1, m, nv) at the start, and how far rounding may have put the rows off there (1,); empty without any."""
        from robodyn_cli.motion.conditioning import rounded_rows

        q, v = self.assembled.q[None, None], self.assembled.v[None, None]
        psi, off = rounded_rows(self.problem, {"t": np.zeros((1, 1, 1)), "q": q, "v": v})
        return psi[0], off[0]

    def closed_otherwise(self) -> Motion:
        """Return the motion from another start that closes the loops as well: as far away as rounding leaves open."""
        from robodyn_cli.motion.conditioning import closing_steps

        q = self.assembled.q
        for step in closing_steps(*self.start_rounding, self.held):
            q = Manifold(self.problem.model).integrate(q, step)
        return dataclasses.replace(self, assembled=dataclasses.replace(self.assembled, q=q))

    @cached_property
    def observer(self) -> Observer:
        """What is evaluated at the samples."""
        with all_missing_data(self.problem, self.system, self.reactions):
            return Observer(self.problem, self.system, self.passive, self.reactions)
