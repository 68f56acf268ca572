"""What is known of latches along a motion: which are closed, what each has done and borne, how near others came."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.latches import refuse_company
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.motion.contact.events import (
    LatchClosing,
    closing_rate,
    contact_functions,
    latch_functions,
)
from robodyn_cli.motion.contact.payloads import Payloads
from robodyn_cli.motion.contact.states import ContactStates
from robodyn_cli.motion.error import TRUSTED
from robodyn_cli.motion.motion import Motion, Watcher
from robodyn_cli.ready.singularity import passive_determinant
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.apart import with_others
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.motion import LatchLock, MissedLatch, MissedLatchErrors

INSIDE = 1e-15  # rad or m, or part of a position: so far beyond the rest of its spring a latch closes
ALIKE = 1.0 + 1e-14  # times a load: another one up to it is no larger
STILL = 1e-11  # rad/s and rad/s^2, or m: what rounding leaves of joints that rest on the spring of a latch
FALLS = 1e-300  # of the growth of a load: one that is zero from some instant on has been largest there
BY_CHANCE = 0.5  # of how far the rates of two runs are apart: one that agrees better does so by chance
RESTARTED = 3.0  # times the errors of a motion, of figures at events
SUMMED = 10.0  # times that, of a position that is a sum
UNCONFIRMED = LatchLock(0)  # what a second run says of a closing that it has not


class LatchStates(ContactStates):
    """What is known of the latches of one run, beside the contact states of its joints.

    closed : numbers of the latches that are, in their order. bearing : those that hold by their own row; what the
    others hold is held by these and the loops already. last : time and state x (nx,) before the last closing. turns :
    times of events, where motions may turn back, and how far latches are from closing there (k,). given : latches that
    an earlier run has closed, by name, with the event at which it did.
    """

    functions: tuple[Any, ...]
    _payloads: Payloads | None = None

    def __init__(self, problem: Problem, passive: Sequence[int] = ()) -> None:
        refuse_company(problem)
        super().__init__(problem)
        self.latches, self.passive = problem.latches, passive
        self.names = [latch.name for latch in self.latches]
        self.given: Mapping[str, Mapping[str, Any]] = {}
        self.values = [
            passive_determinant(problem, passive) if x.closes is None else x.closes for x in self.latches
        ]
        self._own = tuple(latch_functions(problem, self.values, self))
        self.functions = (*self._own, *contact_functions(problem, self))

    def follow(self, motion: Motion) -> None:
        super().follow(motion)
        p = self.problem
        self._rows = SampleKernel(
            {
                "rows": [x for latch in self.latches for x in latch.psi],
                "drift": [latch.gamma for latch in self.latches],
                "values": self.values,
                "rates": [closing_rate(p, latch, value) for latch, value in zip(self.latches, self.values)],
            },
            STATE_GROUPS,
        )
        self._q_of = [None if x.q is None else self.system.q_places[x.q] for x in self.latches]
        self._v_of = [None if x.v is None else self.system.v_places[x.v] for x in self.latches]
        self._names = p.model.q_names
        self._breaks = self.system.breakpoints if any(not x.rigid for x in self.latches) else ()
        # those that come near to closing by motion alone
        self._moved = [
            k
            for k, value in enumerate(self.values)
            if not any(symbol.value[1] == "t" for symbol in free_symbols([value]))
        ]

    def meet(self, others: Sequence[Watcher]) -> None:
        self._payloads = next((x for x in others if isinstance(x, Payloads)), None)
        if self._payloads is not None:
            self._payloads.latches = self

    def _carry(self) -> None:
        """Take over the parameters that say which payloads are carried."""
        if self._payloads is not None:
            self.p[: len(self._payloads.carried)] = self._payloads.carried

    def _groups(self, t: float, x: Array) -> dict[str, Array]:
        self._carry()
        return super()._groups(t, x)

    def held_rows(self, t: float, x: Array) -> Array:
        """Return the rows (k, nv) of latches that bear."""
        return self._look(t, x)[0][self.bearing]

    @property
    def kernels(self) -> dict[str, SampleKernel]:
        return {**super().kernels, "latches at events": self._rows}

    def _clear(self) -> None:
        super()._clear()
        self.closed: list[int] = []
        self.bearing: list[int] = []
        self.closings: dict[int, LatchClosing] = {}
        self.last: tuple[float, Array, int] | None = None
        self._direction, self._rest = np.zeros(len(self.latches)), np.zeros(len(self.latches))
        self._near = np.zeros(len(self.latches))
        self._frozen: set[int] = set()
        self._stands = False  # nothing can move
        self._brisk = 1e-300  # the largest acceleration at a closing so far
        self._just: int | None = None  # that has closed at this event
        self._falls: int | None = None  # whose load has grown again, and falls
        self._asked = 0.0  # until when it has been asked about instants at which formulas of time change
        self._looked_at: tuple[float, bytes] | None = None
        self._known_place: tuple[float, bytes] | None = None
        self.turns: list[tuple[float, Array]] = []
        self._values = np.ones(len(self.latches))

    def facts(self, end: float) -> dict[str, Any]:
        own = super().facts(end) if self.joints else {}
        missed = [k for k in range(len(self.names)) if k not in self.closings and k not in self.closed]
        model = self.problem.model
        locks = {self.names[k]: it.described(self.latches[k], model) for k, it in self.closings.items()}
        return {**own, "locks": locks, "missed": {self.names[k]: self._nearest(k) for k in missed}}

    @property
    def warnings(self) -> list[str]:
        return super().warnings + [
            f"the run ends before the load in the spring of latch {self.names[k]!r} has come to its first peak; "
            "a longer 'simulate.duration' follows it"
            for k in self.closed
            if k in self.closings and not self._has_peaked(k)
        ]

    def _nearest(self, k: int) -> MissedLatch:
        """Return how near a latch came to its condition: at an event, or at the start or the end."""
        distance, time = min((float(values[k]), time) for time, values in self.turns)
        return MissedLatch(
            distance, time, MissedLatchErrors(), self.latches[k].closing_unit(self.problem.model)
        )

    def _look(self, t: float, x: Array) -> tuple[Array, Array]:
        """Note the functions that pass zero where latches close; return the rows (k, nv) and their drift (k,)."""
        state = t, x.tobytes()
        if state != self._looked_at:
            here = self._rows.evaluate(1, self._groups(t, x))
            self._values = here["values"][0]
            self.turns.append((t, np.abs(self._values)))
            rows = here["rows"].reshape(len(self.latches), -1)
            self._looked_at, self._seen_rows = state, (rows, here["drift"][0])
            self._seen_rates = here["rates"][0]
        return self._seen_rows

    def _closing_rates(self, t: float, x: Array) -> Array:
        """Return the rates (k,) of the functions that pass zero where latches close."""
        self._look(t, x)
        return self._seen_rates

    def _halt(self, x: Array, more: Sequence[int] = ()) -> None:
        """Let what latches bear stand exactly still: what rounding leaves would go on."""
        x[[place for j in (*self.bearing, *more) if (place := self._v_of[j]) is not None]] = 0.0

    def jumped(self, t: float, before: Array, x: Array) -> None:
        """Look at what payloads that are gripped or released make of a state, which this may change."""
        self._halt(x)
        for state in (before, x):
            self._look(t, state)
            self._bear_all(t, state)

    # -- loads of springs ------------------------------------------------------------------------------
    def _bear_all(self, t: float, x: Array) -> None:
        """Note the loads of compliant latches at a state, as before and behind a jump."""
        for k in self.closed:
            if k in self.closings and not self.latches[k].rigid:
                self._note_load(t, x, k)

    def _borne(self, k: int, x: Array) -> tuple[float, float]:
        """Return what a compliant latch exerts by its law, and how far beyond its rest it is."""
        s = self._direction[k]
        delta = s * (self._position(k, x) - self._rest[k])
        return float(self.latches[k].law(delta, s * self._rate(k, x))), float(delta)

    def _note_load(self, t: float, x: Array, k: int, enters: bool = False) -> None:
        """Note the load of a compliant latch; enters : its rest is passed here, but for rounding."""
        it, (load, delta) = self.closings[k], self._borne(k, x)
        if load > it.peak * ALIKE and (delta >= 0.0 or enters):
            it.peak, it.peak_time = load, t

    def _position(self, k: int, x: Array) -> float:
        """Return the position that the spring of a latch knows."""
        return float(self.latches[k].position(self.system.split(x)[0]))

    def _rate(self, k: int, x: Array) -> float:
        """Return the rate of this position."""
        return float(self.latches[k].rate(self.system.split(x)[1]))

    def _rest_before(self, k: int, x: Array) -> float:
        """Return the rest of a spring that is met here, so that it pushes at once."""
        at, q = self._position(k, x), self.system.split(x)[0]
        size = abs(at) if self._q_of[k] is not None else SUMMED * float(np.abs(q).max())
        return at - self._direction[k] * INSIDE * max(1.0, size)

    def _least_growth(self, k: int) -> float:
        """Return the growth of the load of a spring that rounding may leave."""
        return STILL * float(self.latches[k].law(1.0, 1.0))

    def _growth(self, t: float, x: Array, k: int) -> float:
        """Return the rate at which the load of a compliant latch grows."""
        s, latch = self._direction[k], self.latches[k]
        rate = s * self._rate(k, x)
        if latch.spec.hold.damping == 0.0:
            return float(latch.law(rate, 0.0))
        return float(latch.law(rate, s * latch.rate(self.rates(t, x)[0])))

    def _see_peaks(self, t: float, x: Array) -> None:
        """See which loads of springs do not grow any more behind an event."""
        for k in self.closed:
            if self._has_peaked(k):
                continue
            self.closings[k].has_peaked = self._stands or self._growth(t, x, k) <= self._least_growth(k)

    def _has_peaked(self, k: int) -> bool:
        """Tell whether the load of a latch has come to its first peak, if it is one that grows."""
        return self.latches[k].rigid or k not in self.closings or self.closings[k].has_peaked

    # -- what is waited for ----------------------------------------------------------------------------
    def _is_met(self) -> bool:
        """Tell whether the run has come to what it goes on until."""
        until = self.problem.scene.deploy.until
        waited = [k for k in self.closed if until in ("all", self.names[k])]
        return until != "end" and self.are_closed and all(map(self._has_peaked, waited))

    @property
    def are_closed(self) -> bool:
        """Whether the latch that is waited for is closed, or all are."""
        until = self.problem.scene.deploy.until
        names = {self.names[k] for k in self.closed}
        return until in names if until not in ("all", "end") else len(names) == len(self.latches)


def _both(lock: LatchLock, other: LatchLock | None) -> bool:
    """Tell whether a latch has closed in both runs."""
    return other is not None and lock.speed is not ABSENT and other.speed is not ABSENT


def is_confirmed(lock: LatchLock, other: LatchLock | None) -> bool:
    """Tell whether the last closing of a latch is that of a second run: it closes as often there, and about then."""
    if other is None or lock.closings != other.closings:
        return False
    if lock.time is ABSENT or other.time is ABSENT:
        return lock.time is other.time
    return abs(other.time - lock.time) <= TRUSTED * lock.time


def doubts(locks: Mapping[str, LatchLock], again: Mapping[str, LatchLock]) -> list[str]:
    """Return warnings about latches whose closings a second run does not confirm."""
    doubtful = []
    for name in sorted({*locks, *again}):
        one, other = locks.get(name), again.get(name)
        if one is None or not is_confirmed(one, other):
            times, others = _closes(one), _closes(other)
            if one is not None and other is not None and one.closings == other.closings:
                times, others = f"at t = {one.time:.4g} s", f"at {other.time:.4g} s"
            doubtful.append(
                f"latch {name!r} closes {times}, and {others} in a second, tighter integration: the motion is too "
                "sensitive to say what it does"
            )
    return doubtful


def _closes(lock: LatchLock | None) -> str:
    count = 0 if lock is None else lock.closings
    return "never" if count == 0 else "once" if count == 1 else f"{count} times"


def beside(one: Mapping[str, Any], two: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """Return ``locks`` and ``missed`` of a run with errors by those of a second one.

    Every closing is a fresh start of the steps, so that errors follow the order of a method less closely than along a
    smooth motion. A speed that agrees by chance says no more than that of the latch that agrees least. What the second
    run does not confirm has errors that are not known (None).

    Parameters
    ----------
    one, two : ``locks`` and ``missed`` of both. factor : times a difference is an error.
    """
    locks = dict(one["locks"])
    again = {
        name: other if is_confirmed(lock, other) else UNCONFIRMED
        for name, lock in locks.items()
        for other in [two["locks"].get(name)]
    }
    missed = {
        name: latch
        if name in two["missed"]
        else dataclasses.replace(latch, errors=MissedLatchErrors(None, None))
        for name, latch in one["missed"].items()
    }
    gaps = [
        abs(lock.speed - again[name].speed) for name, lock in locks.items() if _both(lock, again.get(name))
    ]
    apart = BY_CHANCE * factor * max(gaps, default=0.0)
    for name, lock in locks.items():
        if not _both(lock, again.get(name)) or not lock.speed:
            continue
        part = apart / abs(lock.speed)
        shares = {"speed": 1.0, "energy_lost": 2.0, "angular_impulse": 1.0}
        figures = {key: getattr(lock, key) for key in shares}
        least = {
            k: share * part * abs(figures[k]) for k, share in shares.items() if isinstance(figures[k], float)
        }
        locks[name] = dataclasses.replace(lock, errors=dataclasses.replace(lock.errors, **least))
    own, others = {"locks": locks, "missed": missed}, {"locks": again, "missed": two["missed"]}
    return {key: with_others(own[key], [others[key]], RESTARTED * factor, (key, "LATCH")) for key in own}
