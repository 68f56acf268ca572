"""How runs are made and judged elsewhere: the rules of ``many`` and ``motion.error``, recorded as data.

Each rule is recorded along the run of the scene itself. Which runs there are, and in which order, is the runner's
(``report/page/runner.js``); when one is made, with which options, and what is made of it is here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.formulations.events import EventKind
from robodyn_cli.integrators.runtime.fleet import Fleet, FleetLimits, Runs, Sampling
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, Status
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion.conditioning import closing_steps
from robodyn_cli.motion.error import (
    TRUSTED,
    Courses,
    First,
    difference,
    integrate_again,
    remainder,
    time_errors,
)
from robodyn_cli.motion.method import FAST_DECAYS
from robodyn_cli.motion.motion import Motion
from robodyn_cli.motion.stiffness import FIRST_LOOK, WORTH
from robodyn_cli.over.commands import locks
from robodyn_cli.over.live.closing import record_closing
from robodyn_cli.over.live.inertia import at_start
from robodyn_cli.over.live.keys import cannot
from robodyn_cli.over.live.rules import Recorded, Tape
from robodyn_cli.over.many.course import samplings
from robodyn_cli.over.many.integrate import SOUND, RunBatch, balances
from robodyn_cli.over.many.simulate import MotionCommand
from robodyn_cli.ready.mass_matrix import INDEFINITE, negative_part
from robodyn_cli.solve.closing.together import ManyClosing
from robodyn_cli.solve.closure import has_full_rank
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.apart import ROUNDED
from robodyn_cli.works.deploy.growth import rounding_at_lock

SQUARINGS = 6  # of the Jacobian, whose norm bounds its eigenvalues


class JudgedStructure(Protocol):
    """What is judged: the motion of a scene as one run of a batch, its code, and the equations that a page has."""

    command: MotionCommand
    motion: Motion
    batch: RunBatch
    fleet: Fleet
    method: str
    in_page: bool
    closing: ManyClosing | None
    where: str

    @property
    def equations(self) -> Mapping[str, Any]: ...


class Judging:
    """The rules of one structure, with examples from the run of the scene.

    shown : stretches between samples that a picture takes.
    """

    def __init__(self, live: JudgedStructure, shown: int) -> None:
        self.live, self.shown = live, shown
        self.motion, self.batch, self.fleet = live.motion, live.batch, live.fleet
        self.system, self.options = self.motion.system, self.batch.options
        self.deploys = locks(live.command.name)
        self.rules: dict[str, Any] = {}
        self.examples: dict[
            str, tuple[dict[str, Array], dict[str, Array]]
        ] = {}  # inputs and outputs, for tests
        self.most = self.options.max_steps
        if self.motion.choice.may_change:
            self.most = min(self.most, FIRST_LOOK + WORTH)
        self.sampling, self.judged = Sampling(), slice(0)
        if not self.deploys:
            self.sampling, _, self.judged = samplings(self.batch, live.method, shown)
        self.first = self._drive(self.options, FleetLimits(steps=np.array([self.most])), self.sampling)
        if not self._ended(self.first):
            raise CapabilityError(f"its own run is left to the command{self._stopped_by}", cannot(live.where))

    def _drive(self, options: Options, limits: FleetLimits, sampling: Sampling) -> Runs:
        """Make the run of the scene as a page does: by the loop of single runs, whatever the samples."""
        batch = self.batch
        numbers = self.fleet.tables.numbers[None]
        runs = self.fleet.begin(batch.states, numbers, batch.ends, options, limits, sampling)
        self.fleet.drive_one_by_one(runs)
        return runs

    def _ended(self, runs: Runs) -> bool:
        if not self.deploys:
            return bool(runs.arrived[0])
        event = self.system_events[int(runs.n[0, IntegerSlot.EVENT])].kind if self.system_events else None
        return runs.status[0] == Status.EVENT and event is EventKind.DEAD_POINT

    @property
    def _stopped_by(self) -> str:
        """Words about the event with which the run of the scene leaves compiled code, if it is one."""
        if self.first.status[0] != Status.EVENT:
            return ""
        name = self.system_events[int(self.first.n[0, IntegerSlot.EVENT])].name
        return f" from t = {self.first.time[0]:.6g} s on: what happens to {name} there is found in Python"

    @property
    def system_events(self) -> Any:
        return self.fleet.system.events

    # -- what a page gets -----------------------------------------------------------------------------
    def data(self) -> dict[str, Any]:
        """Return runs, rules and what their reasons are called."""
        self._record_start()
        if self.fleet.passing and self.live.in_page:
            self._record_passed()
        shared: dict[str, Any] = {
            "first": self._first(),
            "second": self._attempts("second", self._first_of(Tape())[1]),
            "dead": [k for k, e in enumerate(self.system_events) if e.kind is EventKind.DEAD_POINT],
            "reasons": REASONS,
        }
        if self.deploys:
            self._record_lock()
            shared |= {"picture": self._picture(), "shown": self.shown}
        else:
            self._record_course()
            third = self._first_of(Tape())[1].once_more(self.motion.is_steep)
            shared |= {
                "third": self._attempts("third", third), "samples": self.sampling_count,
                "shown": self.shown, "every": self.sampling_count // self.shown,
            }  # fmt: skip
        return {**shared, "rules": self.rules}

    @property
    def sampling_count(self) -> int:
        return self.sampling.count

    def _keep(self, name: str, tape: Tape, outputs: Mapping[str, Any]) -> None:
        """Keep a rule; outputs : recorded arrays, or values that are always the same."""
        own = {key: tape.lift(x) for key, x in outputs.items()}
        self.rules[name] = {"code": list(tape.code), "outputs": {key: x.place for key, x in own.items()}}
        self.examples[name] = tape.examples, {key: x.example for key, x in own.items()}

    # -- runs -----------------------------------------------------------------------------------------
    def _first(self) -> dict[str, Any]:
        tape = Tape()
        self._keep("first", tape, self._row(tape, self.options, tape.lift(self.batch.ends), None))
        return self._spec("first", self.options.draw, self._counts(self.sampling), self.most)

    def _first_of(self, tape: Tape) -> tuple[Tape, First]:
        """Return first runs whose steps and time are given."""
        steps: Any = tape.input("steps", self.first.steps)
        went: Any = tape.input("time", self.first.time) if self.deploys else self.batch.ends
        return tape, First(self.options, self.live.method, steps, went)

    def _row(
        self, tape: Tape, options: Options, ends: Any, step: Any, sampling: Sampling | None = None
    ) -> dict[str, Any]:
        """Return a row of doubles that a run begins with."""
        own = self.sampling if sampling is None else sampling
        begun = self.fleet.begin(
            self.batch.states, self.fleet.tables.numbers[None], self.batch.ends, options, sampling=own
        )
        w: Any = tape.constant(begun.w)
        self.fleet.set_steps(w, ends, options, step)
        if sampling is not None:
            w[:, DoubleSlot.SAMPLE_STEP] = ends / sampling.count
        return {"w": w}

    def _counts(self, sampling: Sampling, watch: bool = True) -> list[int]:
        """Return a row of integers that a run begins with."""
        fleet = self.fleet if watch else self.batch.structure.fleet(self.live.method, False)
        begun = fleet.begin(
            self.batch.states,
            self.fleet.tables.numbers[None],
            self.batch.ends,
            self.options,
            sampling=sampling,
        )
        return [int(x) for x in begun.n[0]]

    @staticmethod
    def _spec(rule: str, draw: int, counts: list[int], most: Any) -> dict[str, Any]:
        return {"rule": rule, "draw": draw, "n": counts, "most": most}

    def _attempts(self, name: str, first: First) -> list[dict[str, Any]]:
        """Return the second (or third) integrations in their order, each with the rule that says when it is made."""
        steps: Any = first.steps
        tape, counts = steps.tape, self._counts(self.sampling)
        specs: list[dict[str, Any]] = []

        def once(attempt: Any) -> tuple[Any, Any]:
            k = len(specs)
            when = attempt.rows if isinstance(attempt.rows, Recorded) else np.ones(1)
            outputs = self._row(tape, attempt.options, self.batch.ends, attempt.step)
            self._keep(f"{name}.{k}", tape, {**outputs, "when": when, "most": attempt.most})
            specs.append(self._spec(f"{name}.{k}", attempt.options.draw, counts, None))
            return tape.input("again.steps", np.array([1.9 * self.first.steps[0]])), tape.input(
                "again.given_up", np.zeros(1, dtype=bool)
            )

        integrate_again(first, once)
        return specs

    def _picture(self) -> dict[str, Any]:
        """Return the run up to the lock with samples."""
        tape = Tape()
        sampling, watch = Sampling(self.shown), any(e.is_discontinuity for e in self.system_events)
        ends = tape.input("time", self.first.time)
        self._keep("picture", tape, self._row(tape, self.options, ends, None, sampling))
        return self._spec("picture", self.options.draw, self._counts(sampling, watch), self.options.max_steps)

    # -- the start ------------------------------------------------------------------------------------
    def _record_start(self) -> None:
        closing, motion = self.live.closing, self.motion
        if closing is not None:
            record_closing(closing, self.batch.starts, self._keep)
        if "inertia" in self.live.equations:
            tape, (M, rows) = Tape(), at_start(motion)
            psi = tape.input("psi", rows) if rows.size else rows
            self._keep("definite", tape, {"good": negative_part(tape.input("mass", M), psi) <= INDEFINITE})
        if motion.choice.may_change:
            tape = Tape()
            n = self.system.size
            J = tape.input("jacobian", self._evaluated(self.batch.structure.jacobian))
            slow = _bound_of_decays(J.reshape(1, n, n)) * self.batch.ends < FAST_DECAYS
            self._keep("slow", tape, {"good": slow})
        if self.deploys:
            self._record_regular("regular.start", motion.passive)
            self._record_regular("regular.lock", ())
            self._record_beside()

    def _record_regular(self, name: str, columns: tuple[int, ...]) -> None:
        tape = Tape()
        psi = self._psi(tape)
        self._keep(name, tape, {"good": has_full_rank(psi[:, :, list(columns)] if columns else psi, SOUND)})

    def _psi(self, tape: Tape) -> Any:
        values = self._evaluated(self.batch.structure.psi_of_loops)
        return tape.input("psi", values.reshape(1, -1, self.motion.problem.model.nv))

    def _record_beside(self) -> None:
        """Record ``closed_otherwise``: by how much positions are others that close the loops as well."""
        _, off = self.motion.start_rounding
        if len(off):
            tape = Tape()
            steps = closing_steps(self._psi(tape), off[:1], self.motion.held)
            self._keep("beside", tape, {"step": steps})

    def _evaluated(self, expressions: Any) -> Array:
        system, x = self.system, self.batch.states
        groups = {"t": [0.0], "q": x.T[: system.nq], "v": x.T[system.nq : system.nq + system.nv],
                  "z": x.T[system.nq + system.nv :], "p": []}  # fmt: skip
        if expressions is self.batch.structure.psi_of_loops:
            groups["q"] = self.batch.starts.q.T
        return self.batch.numbers.evaluate(expressions, groups)

    def _record_passed(self) -> None:
        """Record the error of the time at which both runs passed an event."""
        tape, first = self._first_of(Tape())
        time, again = (tape.input(name, np.ones(1)) for name in ("passed", "again.passed"))
        steps = tape.input("again.steps", 2 * self.first.steps)
        self._keep("passed", tape, {"error": time_errors(first, np.abs(again - time), steps, time)})

    # -- the course -----------------------------------------------------------------------------------
    def _record_course(self) -> None:
        system = self.system
        if "energies" in self.live.equations:
            tape = Tape()
            start, end = (tape.input(name, np.ones((2, 1))) for name in ("energies.start", "energies.end"))
            work = tape.input("work", np.zeros(1))
            change = end[0] - start[0], end[1] - start[1], work
            kept = balances(
                change, start[0] + end[0], end[1], tape.input("steps", self.first.steps), self.options.rtol
            )
            self._keep("balance", tape, {"good": kept})
        for name in ("second", "third"):
            tape, first = self._first_of(Tape())
            x0 = tape.input("start", self.batch.states)
            own = self._course(tape, x0, "first")
            scale = remainder(first, tape.input("again.steps", 2 * self.first.steps))
            # the last sample is of the end, too
            apart = difference(own, self._course(tape, x0, "again"), sampled_end=True)
            courses = Courses(system, own, apart, scale)
            floor = courses.floor(first.steps, self.batch.ends, lambda near: self._conditioning())
            settled, _ = courses.settled(floor)  # a third is made without a doubt
            if name == "third":
                third = difference(own, self._course(tape, x0, "third"), sampled_end=True)
                settled = settled.beside(third, np.ones(1, dtype=bool), self.motion.is_steep)
            self._keep(f"errors.{name}", tape, {"end": settled.at_end(floor)})

    def _course(self, tape: Tape, start: Recorded, name: str) -> Any:
        """Return the states (1, T, nx) of a run that are judged."""
        samples = tape.input(f"{name}.out", self.first.out).transpose(0, 2, 1)[:, self.judged]
        end = tape.input(f"{name}.end", self.first.y)
        return np.concatenate([start[:, None], samples, end[:, None]], axis=1)

    def _conditioning(self) -> Any:
        own = self.first.out.transpose(0, 2, 1)[:, self.judged]
        states = np.concatenate([self.batch.states[:, None], own, self.first.y[:, None]], axis=1)
        step = self.first.w[0, DoubleSlot.SAMPLE_STEP]
        times = (
            self.first.w[0, DoubleSlot.SAMPLE_START]
            + step * np.arange(1, self.sampling.count + 1)[self.judged]
        )
        return self.motion.conditioning(np.array([[0.0, *times, self.batch.ends[0]]]), states)

    # -- the lock -------------------------------------------------------------------------------------
    def _record_lock(self) -> None:
        """Record the rules of ``Deploy.drive``."""
        tape, first = self._first_of(Tape())
        time: Any = first.went
        again: Any = tape.input("again.time", self.first.time)
        steps: Any = tape.input("again.steps", 2 * self.first.steps)
        y: Any = tape.input("first.end", self.first.y)
        other: Any = tape.input("again.end", self.first.y)
        paced = np.rint(steps * (time / np.maximum(again, 1e-300)))
        errors = time_errors(first, np.abs(again - time), paced, time)
        apart = remainder(first, paced)[:, None] * np.abs(other - y) + ROUNDED * np.abs(y)
        apart = apart + rounding_at_lock(self.system, y)
        self._keep("lock", tape, {"time_error": errors, "end": apart, "good": errors <= TRUSTED * time})


def _bound_of_decays(J: Any) -> Any:
    """Return a bound of all eigenvalues of Jacobians (N, n, n) [1/s]: the m-th root of the norm of J^m (Gelfand)."""
    total, power = np.zeros(J.shape[0]), 1.0
    for _ in range(SQUARINGS):
        size = np.maximum(np.abs(J).max(axis=(1, 2)), 1e-300)
        total = total + np.log(size) * power
        J = J / size[:, None, None]
        J, power = J @ J, 0.5 * power
    size = np.maximum(np.sqrt((J**2).sum(axis=(1, 2))), 1e-300)
    return np.exp(total + np.log(size) * power)


# why a page leaves values to the command, by what did not hold
REASONS = {
    "range": "a value is outside its range",
    "special": "at this very value the equations are others",
    "structure": "these values have other equations",
    "closed": "the loops do not close from the start that is given, or not in one pose for sure",
    "definite": "the mass matrix is not positive at the start: there are no bodies with these inertias",
    "slow": "the motion may be stiff there",
    "balance": "the balance of energy is lost",
    "regular.start": "the loops are near a singular pose at the start",
    "regular.lock": "the loops are near a singular pose of another kind at the lock",
    "second": "no second run confirms the motion",
    "lock": "the time of the lock is not certain",
    "no lock": "there is no lock within the duration",
    "ended": "the run ended otherwise",
}
