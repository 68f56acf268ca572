"""Masses that links pick up and release in mid-motion.

Whether a payload is carried is a parameter p of the equations, so one compiled program serves all combinations. Where
one is gripped, velocities jump so that the generalised momentum is kept (a plastic impact, ``impact.joined``); where
one is released they do not.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from robodyn_cli.equations.payloads import FLIGHT, carried_motions, own_motion
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError, SceneError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.events import GO_ON, Event, EventFunction, EventKind, Jump, Outcome
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.model.parts import CarriedMass, changing
from robodyn_cli.motion.contact.flight import Flight, inertia_of
from robodyn_cli.motion.contact.impact import joined
from robodyn_cli.motion.motion import Motion, Watcher
from robodyn_cli.observe.observe import potential_energy
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.motion import AXES, Landing, PayloadFacts

WAITING, CARRIED, RELEASED = "waiting", "carried", "released"
KEYS = {WAITING: ("from", "until"), CARRIED: ("until",), RELEASED: ()}  # of what may end a phase


@record
class Change(EventFunction):
    """The event at which a payload, by its number, is gripped or released."""

    number: int = 0
    grips: bool = True


@record
class PayloadStep:
    """What gripping or releasing payloads does.

    before, after : v- and v+ (nv,). lost : energy that the impact takes [J]. gained : of the mechanism, with what it
    carries [J].
    """

    before: Array
    after: Array
    lost: float
    gained: float


class Holding(Protocol):
    """What holds parts of the mechanism while payloads come and go; p : its parameters, behind those of payloads."""

    p: Array

    def held_rows(self, t: float, x: Array) -> Array: ...
    def jumped(self, t: float, before: Array, x: Array) -> None: ...


class Payloads(Watcher):
    """The payloads of one run. phase : of each of them. latches : that hold joints beside them, if there are any."""

    latches: Holding | None = None
    functions: tuple[Change, ...]
    changes_motion = True
    sets_start = True

    def __init__(self, problem: Problem) -> None:
        _refuse_company(problem)
        self.problem = problem
        self.payloads = changing(problem.model)
        self.functions = tuple(_functions(problem, self))
        instants = (payload.spec.instants for payload in self.payloads)
        self._times = [{name: _on_grid(problem.scene, x.time) for name, x in own.items()} for own in instants]
        self._clear()

    def _clear(self) -> None:
        self.phase = [WAITING if x.spec.start is not None else CARRIED for x in self.payloads]
        self._log: list[dict[str, Any]] = []
        # by number of the payload: times of events of release before gripping, and flights
        self._early: dict[int, float] = {}
        self._flights: dict[int, Flight] = {}

    @property
    def warnings(self) -> list[str]:
        early = [
            f"payload {self.payloads[k].name!r}: its event of release happened at {time:.6g} s, before it was gripped, "
            "and does not count; it is let go when the event happens again"
            for k, time in self._early.items()
        ]
        return early + [
            f"payload {self.payloads[k].name!r}: its flight never comes down to the plane of its 'range'"
            for k in self._flights
            if self.payloads[k].spec.plane is not None and self._landing(k) is None
        ]

    def follow(self, motion: Motion) -> None:
        self.system = motion.system
        self._kernel = SampleKernel(_outputs(self.problem, self.payloads), STATE_GROUPS)

    @property
    def kernels(self) -> dict[str, SampleKernel]:
        return {"gripping": self._kernel}

    @property
    def log(self) -> list[dict[str, Any]]:
        return self._log

    def facts(self, end: float) -> dict[str, Any]:
        facts = {x.name: PayloadFacts() for x in self.payloads}
        for event in self._log:
            name, time = event["name"], event["time"]
            gripped = event["kind"] == "grip"
            more = {"gripped": time, "energy_lost": event["energy_lost"]} if gripped else {"released": time}
            facts[name] = dataclasses.replace(facts[name], **more)
        for k, flight in self._flights.items():
            name = self.payloads[k].name
            landing = self._landing(k) or ABSENT
            facts[name] = dataclasses.replace(facts[name], release=flight.release, landing=landing)
        return {"payloads": facts}

    def _landing(self, k: int) -> Landing | None:
        plane = self.payloads[k].spec.plane
        return None if plane is None else self._flights[k].landing(plane)

    def add_to(self, result: Result) -> None:
        for k, flight in self._flights.items():
            landing = self._landing(k)
            times = flight.times(result.time, None if landing is None else landing.time)
            places, velocities = flight.at(times)
            path = f"flights/{self.payloads[k].name}"
            dims = (f"{self.payloads[k].name}_flight", "axis")
            result.add(f"{path}/time", times, dims=dims[:1])
            result.add(f"{path}/position", places, dims=dims, names=AXES)
            result.add(f"{path}/velocity", velocities, dims=dims, names=AXES)
            if (turning := flight.turning(times)) is not None:
                quaternions, spins = turning
                four = (dims[0], "quaternion")
                result.add(f"{path}/quaternion", quaternions, dims=four, names=("w", *AXES))
                result.add(f"{path}/angular_velocity", spins, dims=dims, names=AXES)

    def again(self) -> Payloads:
        other = copy.copy(self)
        other._clear()
        return other

    # -- a run ----------------------------------------------------------------------------------------
    def stops(self) -> Sequence[float]:
        """Return the times ahead at which payloads may be gripped or released."""
        ahead = [self._times[k].get(key) for k, phase in enumerate(self.phase) for key in KEYS[phase]]
        return [time for time in ahead if time is not None]

    def _next(self, k: int, t: float) -> str | None:
        """Return the phase that payload k enters at a time that is among its own, None where t is none of these.

        One that has not been gripped by then is not gripped any more.
        """
        key = next((key for key in KEYS[self.phase[k]] if self._times[k].get(key) == t), None)
        return None if key is None else CARRIED if key == "from" else RELEASED

    def begin(self, t: float, x: Array, options: Options) -> Array:
        """Find out what is carried at a start later than t = 0; x is that of before anything at t itself.

        Raises
        ------
        SceneError : events decide it, which a run that begins later does not know.
        """
        self._clear()
        for time in sorted(time for time in self.stops() if time < t):
            self.phase = [self._next(k, time) or phase for k, phase in enumerate(self.phase)]
        if t > 0.0 and self.functions:
            path = self.problem.scene.path
            raise SceneError(
                f"whether payload {self.functions[0].name!r} is carried is decided by an event "
                "('when'), which a run that goes on from a stored one does not know; allowed: 'time'",
                (path, "initial.from"), file=path, key="initial.from",
            )  # fmt: skip
        return x

    @property
    def carried(self) -> Array:
        """The parameters that say which payloads are carried now: the first ones of p."""
        return self._p(self.phase)

    def arm(self, x: Array) -> Outcome:
        return Jump(x, self.carried)

    def handle(self, event: Event) -> Outcome:
        change = event.function
        assert isinstance(change, Change)
        if self.phase[change.number] != (WAITING if change.grips else CARRIED):
            if not change.grips and self.phase[change.number] == WAITING:
                self._early.setdefault(change.number, event.time)
            return GO_ON
        return self._go_on(event.time, event.state, {change.number: CARRIED if change.grips else RELEASED})

    def at_stop(self, t: float, x: Array) -> Outcome:
        due = {k: phase for k in range(len(self.phase)) if (phase := self._next(k, t)) is not None}
        # what is handed over is released first
        released = self._go_on(t, x, {k: phase for k, phase in due.items() if phase == RELEASED})
        return self._go_on(t, released.state, {k: phase for k, phase in due.items() if phase == CARRIED})

    def _p(self, phase: Sequence[str]) -> Array:
        """Return the parameters of phases."""
        return np.array([float(one == CARRIED) for one in phase])

    def _go_on(self, t: float, x: Array, changed: Mapping[int, str]) -> Jump:
        """Bring some payloads to new phases; the run goes on with other velocities and another work done on it."""
        phase, s = [changed.get(k, old) for k, old in enumerate(self.phase)], self.system
        step, before = self._step(t, x, phase), x
        x = x.copy()
        x[list(s.v_places)] = step.after
        if self.latches is not None:
            self.latches.jumped(t, before, x)
        if s.work_place is not None:
            x[s.work_place] += step.gained
        for k in changed:
            if CARRIED in (phase[k], self.phase[k]):
                self._note(t, k, phase[k], step)
            if (self.phase[k], phase[k]) == (CARRIED, RELEASED):
                self._flights[k] = self._flight(t, k, before)
        self.phase = phase
        return Jump(x, self._p(phase))

    def _step(self, t: float, x: Array, phase: Sequence[str]) -> PayloadStep:
        """Return velocities and energies when the payloads come to new phases."""
        nv = self.problem.model.nv
        gripped = [k for k, old in enumerate(self.phase) if (old, phase[k]) == (WAITING, CARRIED)]
        old = self._numbers(t, x, self.phase)
        v = x[list(self.system.v_places)]
        new = self._numbers(t, x, phase)
        before, after = (values["M"].reshape(nv, nv) for values in (old, new))
        psi = old["psi"].reshape(-1, nv) if "psi" in old else np.zeros((0, nv))
        if self.latches is not None:
            psi = np.concatenate([psi, self.latches.held_rows(t, x)])
        momentum = old["momentum"].reshape(-1, nv)[gripped].sum(axis=0)
        then = v
        if gripped:
            try:
                then = joined(before, after, psi, v, momentum)
            except np.linalg.LinAlgError as error:
                names = ", ".join(self.payloads[k].name for k in gripped)
                raise NumericalError(
                    f"the mass matrix is singular with payload {names} at t = {t:.6g} s", time=t,
                    status="singular_mass_matrix",
                ) from error  # fmt: skip
        change = 0.5 * float(then @ after @ then - v @ before @ v)
        lost = float(old["own"][gripped].sum()) - change if gripped else 0.0
        return PayloadStep(v, then, lost, change + float(new["potential"][0] - old["potential"][0]))

    def _flight(self, t: float, k: int, x: Array) -> Flight:
        """Return the flight of payload k that begins at t, where the state of its carrier is x."""
        values = self._numbers(t, x, self.phase)["flight"].reshape(-1, FLIGHT)[k]
        place, velocity, spin = values[:9].reshape(3, 3)
        gravity = np.array([float(g) for g in self.problem.scene.gravity])
        I = inertia_of(self.payloads[k].spec)
        return Flight(t, place, velocity, spin, float(values[9]), gravity, values[10:].reshape(3, 3), I)

    def _numbers(self, t: float, x: Array, phase: Sequence[str]) -> dict[str, Array]:
        p = self._p(phase)
        if self.latches is not None:
            p = np.append(p, self.latches.p[len(p) :])
        values = self._kernel.evaluate(1, self.system.at(t, x, p))
        return {name: array[0] for name, array in values.items()}

    def _note(self, t: float, k: int, phase: str, step: PayloadStep) -> None:
        gripped = phase == CARRIED
        details: dict[str, Any] = {}
        if gripped:
            names = self.problem.model.v_names
            details = {
                "energy_lost": step.lost,
                "jump": dict(zip(names, (step.after - step.before).tolist())),
            }
        self._log.append(
            {"time": t, "name": self.payloads[k].name, "kind": "grip" if gripped else "let_go", **details}
        )


def _on_grid(scene: Scene, time: float | None) -> float | None:
    """Return a time as the samples have it, where they have it but for rounding: such a sample is that of before."""
    if time is None:
        return None
    grid = Grid.over(scene.simulate.duration, scene.simulate.samples)
    k = grid.first_at(time)
    return float(grid.times(k, k + 1)[0]) if k < grid.count and grid.begins_by(k, time) else time


def _functions(problem: Problem, owner: Payloads) -> list[Change]:
    changes = []
    for number, payload in enumerate(owner.payloads):
        for name, instant in payload.spec.instants.items():
            if instant.when is not None:
                value = instant.when.evaluate(problem.environment)
                changes.append(
                    Change(payload.name, value, 1, EventKind.PAYLOAD, owner, number, name == "from")
                )
    return changes


def _outputs(problem: Problem, payloads: Sequence[CarriedMass]) -> dict[str, list[Scalar]]:
    """Return M, Psi, the potential energy, of each payload's own motion the generalised momentum and the energy, and of
    its motion with what carries it place, velocity, angular velocity (in the world) and energy."""
    own = [own_motion(problem, payload) for payload in payloads]
    outputs: dict[str, list[Scalar]] = {
        "M": list(problem.mass_matrix.ravel()),
        "psi": list(problem.psi.ravel()),
        "potential": [potential_energy(problem)],
        "momentum": [x for momentum, _ in own for x in momentum],
        "own": [energy for _, energy in own],
        "flight": carried_motions(problem, payloads),
    }
    return {name: entries for name, entries in outputs.items() if entries}


def _refuse_company(problem: Problem) -> None:
    """Refuse what does not go with payloads that are gripped or released.

    Raises
    ------
    CapabilityError
    """
    scene, name = problem.scene, changing(problem.model)[0].name
    if problem.contact_joints:
        raise CapabilityError(
            f"payload {name!r}, which is gripped or released, does not go with joints that stick or meet "
            f"rigid stops (here {problem.contact_joints[0].name!r}), whose forces in an impact would not be known; "
            "allowed: friction with 'transition_speed', and stops with 'stiffness'",
            (scene.path,),
        )
    if scene.simulate.singular == "pass":
        raise CapabilityError(
            f"payload {name!r}, which is gripped or released, does not go with 'simulate.singular: "
            "pass'; allowed: stop",
            (scene.path,),
        )
