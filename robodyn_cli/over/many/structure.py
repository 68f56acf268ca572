"""One structure for many motions: its motion is built once."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.time_structure import is_steady
from robodyn_cli.errors import listed
from robodyn_cli.expr.fixed import places, witnessed
from robodyn_cli.expr.graph import reachable
from robodyn_cli.expr.many import Decision, Expressions, ManyNumbers
from robodyn_cli.formulations.events import EventKind
from robodyn_cli.given.along import Interpolated
from robodyn_cli.integration_methods import DEFAULT
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.fleet import Fleet
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.many.groups import Built, first_of
from robodyn_cli.over.many.keys import NUMBER, OPTION, START, Key, settings
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from robodyn_cli.observe.observe import Observer


HOLDS = "a controller holds where the joints start, or begins there what it follows"
LED = "a prescribed motion starts otherwise"
TURNED = "loops with balls or free bodies are closed one by one"
# numbers of a controller in which no function of time has a part
TIMELESS = ("control.gains", "control.limit", "control.rate_limit", "control.sensors", "control.model")
CLOCKS = ("control.period", "control.delay")


class Buildable(Protocol):
    """What a structure needs of a command."""

    def build(self, scene: Scene) -> Motion: ...
    @property
    def follows_events(self) -> bool: ...
    def obstacle(self, motion: Motion) -> str: ...


class Structure(Built):
    """The motion of a scene with one row of values.

    Parameters
    ----------
    command : makes a motion of a scene.

    Raises
    ------
    RobodynError : there is no motion with these values.
    """

    def __init__(self, family: Family, keys: Sequence[Key], row: Array, command: Buildable) -> None:
        scene = family.scene(settings([key.name for key in keys], row))
        with witnessed() as witnesses:
            self.motion = command.build(scene)
            choice = self.motion.choice  # a method that may change is that of a run, not of the structure
            tables = methods[DEFAULT if choice.may_change else choice.method].tables(self.motion.system)
        why = obstacle(self.motion, keys, command.follows_events) or command.obstacle(self.motion)
        super().__init__(keys, row, tables, witnesses, why)
        constraints, quasi = self.motion.problem.constraints, Manifold(self.motion.problem.model).quasi
        self.bound = first_of(
            {
                HOLDS: _holds_start(self.motion),
                LED: bool(constraints.rheonomic),
                TURNED: bool(constraints.rows and quasi),
            }
        )
        # for another duration the motion that a controller follows may be another one
        self.follows |= self.motion.problem.control is not None and any(key.sort == OPTION for key in keys)
        self._fleets: dict[tuple[str, bool, bool], Fleet] = {}
        self._observers: dict[bool, tuple[Observer, list[Decision]]] = {}

    def fleet(self, method: str, watch: bool = True, through: bool = False) -> Fleet:
        """Return the compiled code of a method; through : whether runs go on where the loops come near a loss of
        rank."""
        key = method, watch, through
        if key not in self._fleets:
            # what is only noted on the way ends no run
            noted = (EventKind.MARK, EventKind.RANK_LOSS) if through else (EventKind.MARK,)
            system = self.motion.system.watched_by(lambda e: None if e.kind in noted else e.owner)
            closes = system.closings is not None
            passing = [
                k for k, e in enumerate(system.events)
                if e.is_discontinuity or (closes and e.kind is EventKind.LATCH)
            ]  # fmt: skip
            self._fleets[key] = Fleet(system, method, np.array(system.parameters or [0.0]), watch, passing)
        return self._fleets[key]

    def _observer(self, reactions: bool) -> tuple[Observer, list[Decision]]:
        """What is evaluated at samples, and the comparisons of numbers that its own equations ask for."""
        if reactions not in self._observers:
            with witnessed() as witnesses:
                observer = dataclasses.replace(
                    self.motion, reactions=reactions or self.motion.reactions
                ).observer
            self._observers[reactions] = observer, self.recipe.deciding(witnesses)
        return self._observers[reactions]

    def observed_alike(self, numbers: ManyNumbers, reactions: bool = False) -> NDArray[np.bool_]:
        """Tell in which runs (N,) samples are evaluated by the same equations; reactions : loads are, too."""
        return numbers.decided_alike(self._observer(reactions)[1])

    def observers(self, numbers: ManyNumbers, reactions: bool = False) -> Iterator[Observer]:
        """Yield the observer of samples with the numbers of one run after another; reactions : of loads, too."""
        observer = self._observer(reactions)[0]
        kernels = list(observer.kernels.values())
        tables = [[numbers.table(x) for x in kernel.numbers] for kernel in kernels]
        for k in range(numbers.runs):
            for kernel, own in zip(kernels, tables):
                kernel.take([rows[k] for rows in own])
            yield observer

    @cached_property
    def begun(self) -> Expressions | None:
        """The states of a sampled controller at t = 0 as expressions; None where they are the same in all runs."""
        control = self.motion.problem.control
        return None if control is None or control.period is None else Expressions(control.begun)

    @cached_property
    def psi_at_samples(self) -> SampleKernel:
        """Psi of the loops' rows as a function of samples; its table is that of a run."""
        problem = self.motion.problem
        return SampleKernel({"psi": problem.psi[problem.constraints.of_loops].ravel().tolist()}, STATE_GROUPS)

    @cached_property
    def energies(self) -> Expressions:
        """Kinetic and potential energy as expressions."""
        from robodyn_cli.observe.observe import potential_energy

        return Expressions([self.motion.problem.kinetic, potential_energy(self.motion.problem)])

    @cached_property
    def energies_at_samples(self) -> SampleKernel:
        """The same as a function of samples; its table is that of a run."""
        from robodyn_cli.observe.observe import potential_energy

        problem = self.motion.problem
        outputs = {"kinetic": [problem.kinetic], "potential": [potential_energy(problem)]}
        return SampleKernel(outputs, STATE_GROUPS)

    @cached_property
    def psi_of_loops(self) -> Expressions:
        """Psi of the loops' rows, row by row."""
        problem = self.motion.problem
        return Expressions(problem.psi[problem.constraints.of_loops].ravel().tolist())

    @cached_property
    def jacobian(self) -> Expressions:
        """The Jacobian of (q, v, z)-dot, row by row."""
        return Expressions(self.motion.system.jacobian.J.ravel().tolist())


def times_vary(keys: Sequence[Key]) -> bool:
    """Tell whether functions of time may switch at other times, or over another duration, in other runs."""
    sections = ("parameters.", "torques.", "forces.", "control.", "trajectory.", "prescribed.")
    return any(
        key.sort == OPTION
        or (key.sort == NUMBER and key.place.startswith(sections) and not key.place.startswith(TIMELESS))
        for key in keys
    )


def varying_times(motion: Motion, keys: Sequence[Key]) -> list[str]:
    """Return the keys with which steps may have to end at other times: those that have a part in a function of time
    that steps may have to end for, where there are tables all that ``times_vary`` tells, and options."""
    switching = motion.problem.switching
    if not (motion.system.breakpoints or switching.time_structures):
        return []
    # given motions are followed at their own numbers, steady or not
    ends = [f for key, f in switching.of_time if not (key.startswith("torques.") and is_steady(f))]
    timed = set(places(node.value for node in reachable(ends) if node.op == "const"))
    return [
        key.name
        for key in keys
        if key.sort == OPTION
        or (key.sort == NUMBER and key.place in timed)
        or (bool(switching.tabled) and times_vary([key]))
    ]


def obstacle(motion: Motion, keys: Sequence[Key], follows_events: bool = False) -> str:
    """Return why runs of a motion are made one by one, by the driver in Python; nothing where compiled code does.

    keys : that vary between runs. follows_events : whether runs are handed to their watchers at events.
    """
    system, problem = motion.system, motion.problem
    constraints, control = problem.constraints, problem.control
    begins = any(watcher.sets_start for watcher in motion.watchers)
    times = varying_times(motion, keys)
    reasons = {
        "a long chain is integrated by loops over its bodies": system.dynamics.any_size,
        "independent coordinates or rows are chosen along the motion": system.partition is not None,
        "contact states begin and change in Python": not follows_events
        and (begins or bool(system.parameters)),
        **_of_samples(motion, keys),
        HOLDS: _holds_start(motion) and any(key.sort == START and key.place.startswith("q.") for key in keys),
        "states of a controller start otherwise": control is not None
        and any(key.place.startswith("control.state") for key in keys),
        f"steps have to end at times that formulas or tables give, which may be others with {listed(times)}": bool(
            times
        ),
        "steps have to end at more times of formulas than were found": any(
            not corners.resolved for _, corners in problem.switching.time_structures
        ),
        "fixed steps end at times that formulas or tables give": bool(system.breakpoints)
        and motion.options.step is not None,
        LED: bool(constraints.rheonomic) and any(key.sort == START for key in keys),
        "rows of the loops depend on each other": bool(problem.dependent or motion.assembled.redundant),
        "Baumgarte's gains are found by trial runs": motion.gains is not None,
        "the run goes on from a stored one": motion.scene.initial.source is not None,
        "fixed steps come close to jumps in Python": not follows_events
        and motion.options.step is not None
        and any(event.is_discontinuity for event in system.events),
    }
    return first_of(reasons)


def _holds_start(motion: Motion) -> bool:
    """Tell whether numbers of a controller may follow from where the joints start."""
    control = motion.problem.control
    if control is None:
        return False
    if control.reference.motion is None:
        return not set(motion.problem.model.q_names) <= set(control.controller.pose)
    return isinstance(control.reference.motion, Interpolated) or control.controller.directions is not None


def _of_samples(motion: Motion, keys: Sequence[Key]) -> dict[str, bool]:
    """Return the reasons of a sampled controller, and which of them hold."""
    control = motion.problem.control
    if control is None or control.period is None:
        return {}
    lasts = any(key.sort == OPTION for key in keys)
    return {
        "a function in Python controls": control.function is not None,
        "a controller samples at other times": any(key.place.startswith(CLOCKS) for key in keys),
        "sensors are noisy for another duration": bool(control.channels) and lasts,
    }
