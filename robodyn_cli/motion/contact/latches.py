"""Latches along a motion: they close, each where its own condition is met, hold what they hold, and open again.

The states of latches are parameters of the equations, beside those of joints that stick and meet stops, which go on
with what the latches leave them. A rigid latch closes by an impulse, in which joints that rest on stops take part;
those that close at the same instant do so together, by impulses of least norm where these are not unique.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.latches import FIELDS, refuse_company
from robodyn_cli.equations.problem import Problem
from robodyn_cli.formulations.events import GO_ON, Event, Halt, Jump, Outcome
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.motion.contact.checks import forced_on, torn_open
from robodyn_cli.motion.contact.events import (
    ContactFunction,
    LatchChange,
    LatchClosing,
    LatchFunction,
    contact_functions,
    known_sides,
    latch_functions,
)
from robodyn_cli.motion.contact.impact import Impact, shared
from robodyn_cli.motion.contact.states import ContactStates
from robodyn_cli.motion.motion import Motion
from robodyn_cli.ready.singularity import classify, passive_determinant
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.motion import MissedLatch, MissedLatchErrors

TOGETHER = 1e-10  # s, or part of the time: latches that would close so soon after one another close together
AGAIN = 1e-6  # s, or part of the time: so soon after it has opened in its position a latch does not close
NEW = 1e-6  # part of a row that must be independent of the others for its latch to bear anything
TORN = 1e-6  # part of a rate, or of an acceleration, that a closed latch may leave


class Latches(ContactStates):
    """The latches of one run, and the contact states of its joints.

    closed : numbers of the latches that are, in their order. bearing : those that hold by their own row; what the
    others hold is held by these and the loops already. last : time and state x (nx,) before the last closing. turns :
    times of events, where motions may turn back, and how far latches are from closing there (k,). given : latches that
    an earlier run has closed, by name, with the event at which it did.
    """

    functions: tuple[Any, ...]

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
            },
            STATE_GROUPS,
        )
        self._q_of = [None if x.q is None else self.system.q_places[x.q] for x in self.latches]
        self._v_of = [None if x.v is None else self.system.v_places[x.v] for x in self.latches]
        self._names = p.model.q_names

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
        self._since = np.full(len(self.latches), -np.inf)
        self._frozen: set[int] = set()
        self._brisk = 1e-300  # the largest acceleration at a closing so far
        self.turns: list[tuple[float, Array]] = []
        self._values = np.ones(len(self.latches))

    def facts(self, end: float) -> dict[str, Any]:
        own = super().facts(end) if self.joints else {}
        missed = [k for k in range(len(self.names)) if k not in self.closings and k not in self.closed]
        locks = {self.names[k]: it.described(self.latches[k].rigid, end) for k, it in self.closings.items()}
        return {**own, "locks": locks, "missed": {self.names[k]: self._nearest(k) for k in missed}}

    @property
    def warnings(self) -> list[str]:
        return [
            f"the run ends when latch {self.names[k]!r} closes, before its spring bears its largest load; "
            "'deploy.until: end' follows it"
            for k in self.closed
            if self.last is not None and not self.latches[k].rigid and self._is_met() and k == self.last[2]
        ]

    def _nearest(self, k: int) -> MissedLatch:
        """Return how near a latch came to its position: at an event, or at the start or the end."""
        if self.latches[k].closing is None:
            return MissedLatch(None, None, MissedLatchErrors())
        distance, time = min((float(values[k]), time) for time, values in self.turns)
        return MissedLatch(distance, time, MissedLatchErrors())

    # -- a run ----------------------------------------------------------------------------------------
    def begin(self, t: float, x: Array, options: Options) -> Array:
        x = super().begin(t, x, options)
        self._look(t, x)
        self._since[np.abs(self._values) <= TORN] = t
        for k, name in enumerate(self.names):
            if name in self.given:
                self._take_up(x, k, self.given[name])
        if self.closed:
            self._rearrange(t, x)
        return x

    def _take_up(self, x: Array, k: int, event: Mapping[str, Any]) -> None:
        """Close a latch as an earlier run has closed it, at this event."""
        latch, place = self.latches[k], self._v_of[k]
        self.closed.append(k)
        self._direction[k] = 1.0 if event["speed"] >= 0.0 else -1.0
        self._rest[k] = event["rest"]
        if latch.rigid and place is not None:
            x[place] = 0.0

    def _look(self, t: float, x: Array) -> tuple[Array, Array]:
        """Note the functions that pass zero where latches close; return the rows (k, nv) and their drift (k,)."""
        here = self._rows.evaluate(1, self.system.groups(np.array([[t]]), x[None, :], self.p))
        self._values = here["values"][0]
        self.turns.append((t, np.abs(self._values)))
        return here["rows"].reshape(len(self.latches), -1), here["drift"][0]

    def _mass_matrix_and_psi(self, t: float, x: Array) -> tuple[Array, Array]:
        """Return the mass matrix (nv, nv), and Psi (m, nv) with the rows of latches that bear below it."""
        M, psi = super()._mass_matrix_and_psi(t, x)
        return M, np.concatenate([psi, self._look(t, x)[0][self.bearing]]) if self.bearing else psi

    def arm(self, x: Array) -> Outcome:
        sides = {n: 1.0 for n, f in enumerate(self._own) if self._starts_positive(f)} | self._turning(x)
        contacts = known_sides(self.functions[len(self._own) :], self.state, self.rest, self.contact)
        return Jump(
            x, self.p, sides | {n + len(self._own): side for n, side in contacts.items()}, self._flight
        )

    def _turning(self, x: Array) -> dict[int, float]:
        """Return the signs that rates which are zero are going to have, by the numbers of their functions."""
        starts = {}
        for n, function in enumerate(self._own):
            v = self.latches[function.number].closing
            if function.change is LatchChange.TURNS and v is not None and x[self.system.v_places[v]] == 0.0:
                starts[n] = v
        if not starts:
            return {}
        a = self.rates(self.turns[-1][0], x)[0]
        return {n: 1.0 if a[v] >= 0.0 else -1.0 for n, v in starts.items()}

    def _starts_positive(self, function: LatchFunction) -> bool:
        """Tell whether a function at zero is to be watched from the positive side."""
        k = function.number
        if function.change is LatchChange.CLOSES:
            return k not in self.closed and self._values[k] == 0.0
        just = self.last is not None and self.last[2] == k and k in self.closed
        return just and function.change in (LatchChange.MEETS, LatchChange.LETS_GO)

    def handle(self, event: Event) -> Outcome:
        function = event.function
        if isinstance(function, ContactFunction):
            if function.joint in self._frozen:
                return GO_ON
            outcome = super().handle(event)
            self._look(event.time, event.state)
            return outcome
        assert isinstance(function, LatchFunction)
        t, x, k = event.time, event.state.copy(), function.number
        self._flight = np.inf
        if function.change is LatchChange.CLOSES:
            return self._close(t, x, k)
        if function.change is LatchChange.TURNS:
            self._look(t, x)
            return GO_ON
        if k not in self.closed:
            return GO_ON
        if function.change is LatchChange.OPENS:
            return self._open(t, x, k)
        self._bear(t, x, k, function.change)
        return GO_ON

    def see(self, t: Array, x: Array) -> None:
        super().see(t, x)
        self._look(float(t[-1]), x[-1])
        q = self.system.split(x)[0]
        for k in self.closed:
            latch = self.latches[k]
            if not latch.rigid or k in self.bearing or latch.q is None:
                continue
            off = np.abs(q[:, latch.q] - self._rest[k])
            if (wrong := off > TORN * max(1.0, abs(self._rest[k]))).any():
                raise torn_open(self.names[k], float(t[int(np.argmax(wrong))]))

    # -- closing --------------------------------------------------------------------------------------
    def _close(self, t: float, x: Array, k: int) -> Outcome:
        rows, _ = self._look(t, x)
        latch = self.latches[k]
        if k in self.closed or t <= self._since[k] + AGAIN * max(1.0, t):
            return GO_ON
        if latch.closes is None:
            q = self.system.split(x)[0]
            if classify(self.problem, q, self.passive).kind != "dead_point":
                return GO_ON
        before = x.copy()
        if self.problem.constraints.rows:
            self._brisk = max(self._brisk, float(np.abs(self.rates(t, x)[0]).max()))
        places = list(self.system.v_places)
        together = [k, *self._others(t, x, k)] if latch.rigid else [k]
        self.last = (t, before, min(together))
        order = 1 + sum(it.time < t for it in self.closings.values())
        for j in together:
            self._take(t, x, j, float(rows[j] @ x[places]), order)
        if latch.rigid:
            self._strike_latches(t, x, together, rows[together])
        self.closed += together
        self._rearrange(t, x)
        for j in together:
            freedom = len(places) - np.linalg.matrix_rank(self._mass_matrix_and_psi(t, x)[1], tol=1e-9)
            it = self.closings[j]
            facts = {
                "energy_lost": it.lost,
                "degrees_of_freedom": int(freedom),
                "rest": float(self._rest[j]),
                "speed": it.speed,
            }
            self._log.append({"time": t, "name": self.names[j], "kind": "latched", **facts})
        return self._outcome(t, x)

    def _take(self, t: float, x: Array, k: int, speed: float, order: int) -> None:
        """Note a closing, and put a coordinate exactly where its latch holds it."""
        latch, before = self.latches[k], self.closings.get(k)
        place = self._q_of[k]
        if place is not None and latch.is_own:
            x[place] -= float(self._values[k])
        self._rest[k] = 0.0 if place is None else x[place]
        angle = ABSENT if place is None else float(x[place])
        self._direction[k] = 1.0 if speed >= 0.0 else -1.0
        count = 1 if before is None else before.closings + 1
        self.closings[k] = LatchClosing(order, t, angle, speed, closings=count)
        if not latch.rigid:
            self.closings[k].peak, self.closings[k].peak_time = abs(latch.law(0.0, abs(speed))), t

    def _others(self, t: float, x: Array, k: int) -> list[int]:
        """Return the other rigid latches that close at the same instant: their positions are as near as rounding."""
        near = TOGETHER * max(1.0, t)
        others = []
        for j, latch in enumerate(self.latches):
            if j == k or j in self.closed or not latch.rigid or latch.closing is None:
                continue
            rate = float(x[self.system.v_places[latch.closing]])
            way = {"up": rate > 0.0, "down": rate < 0.0}.get(latch.spec.side, True)
            if way and rate != 0.0 and abs(self._values[j]) <= near * abs(rate):
                others.append(j)
        return others

    def _strike_latches(self, t: float, x: Array, together: list[int], rows: Array) -> None:
        """LatchChange the state x by the impulses of rigid latches with these rows (k, nv)."""
        places = list(self.system.v_places)
        M, psi = self._mass_matrix_and_psi(t, x)
        v, rates = x[places], rows @ x[places]
        resting = {self.joints[j].v: side for j, side in self.contact.items()}
        jump = np.concatenate([np.zeros(len(psi)), -rates])
        met = Impact(M, np.concatenate([psi, rows]), v, None, resting, jump)
        after = met.after()
        fastest = max(self._fastest, float(np.abs(v).max()))
        if np.abs(rows @ after).max() > TORN * np.abs(rows).max() * fastest:
            raise forced_on([self.names[j] for j in together], t)
        stay = np.eye(len(v))[[k for k in resting if after[k] == 0.0]]
        for j, share in zip(together, shared(M, np.concatenate([psi, stay]), rows, rates)):
            self.closings[j].impulse, self.closings[j].lost = float(abs(share)), met.lost(after)
        x[places] = after
        self._halt(x, together)
        if self.system.work_place is not None:
            x[self.system.work_place] -= met.lost(after)

    def _halt(self, x: Array, more: Sequence[int] = ()) -> None:
        """Let what latches bear stand exactly still: what rounding leaves would go on."""
        x[[place for j in (*self.bearing, *more) if (place := self._v_of[j]) is not None]] = 0.0

    def _open(self, t: float, x: Array, k: int) -> Outcome:
        """Open a latch; the energy in its spring is lost."""
        latch = self.latches[k]
        q = self.system.split(x)[0]
        if not latch.rigid and self.system.work_place is not None:
            x[self.system.work_place] -= float(latch.stored(q, self._direction[k], self._rest[k]))
        self.closed.remove(k)
        if k in self.closings:
            self.closings[k].opened = t
        self._log.append({"time": t, "name": latch.name, "kind": "opened"})
        self._look(t, x)
        self._since[k] = t
        self._rearrange(t, x)
        return self._outcome(t, x)

    def _rearrange(self, t: float, x: Array) -> None:
        """Choose the latches that bear, and find the contact states that they leave."""
        self.bearing = []
        psi = self._mass_matrix_and_psi(t, x)[1]
        rows, drift = self._look(t, x)
        basis = (
            np.linalg.svd(psi, full_matrices=False)[2][: np.linalg.matrix_rank(psi, tol=1e-9)]
            if len(psi)
            else psi
        )
        idle = []
        for k in (k for k in self.closed if self.latches[k].rigid):
            rest = rows[k] - basis.T @ (basis @ rows[k])
            if np.linalg.norm(rest) > NEW * np.linalg.norm(rows[k]):
                basis = np.vstack([basis, rest / np.linalg.norm(rest)])
                self.bearing.append(k)
            else:
                idle.append(k)
        held = np.einsum("ij,ij->j", basis, basis) > 1.0 - NEW
        self._frozen = {k for k, joint in enumerate(self.joints) if held[joint.v]} if self.closed else set()
        self._settle_speeds(x)
        if self.joints:
            x[:] = self._strike_others(t, x, -1)
            self._settle(t, x, {})
        self._write()
        if idle:
            a = self.rates(t, x)[0]
            for k in idle:
                left = abs(float(rows[k] @ a + drift[k]))
                if not left <= TORN * np.abs(rows[k]).max() * self._brisk:
                    raise torn_open(self.names[k], t)

    def _bear(self, t: float, x: Array, k: int, change: LatchChange) -> None:
        """Note the load of a compliant latch, and whether it has been left."""
        latch, it = self.latches[k], self.closings.get(k)
        s, place, rate = self._direction[k], self._q_of[k], self._v_of[k]
        assert place is not None and rate is not None
        delta, speed = s * (x[place] - self._rest[k]), s * x[rate]
        if change is LatchChange.MEETS:
            if it is not None:
                it.rebounds += speed < 0.0
            delta = 0.0
        load = float(latch.law(delta, speed)) if delta >= 0.0 else 0.0
        if it is not None and load > it.peak:
            it.peak, it.peak_time = load, t

    # -- contact states -------------------------------------------------------------------------------
    def _settle_speeds(self, x: Array) -> None:
        self._halt(x)
        super()._settle_speeds(x)
        for k in self._frozen:
            self.rest.discard(k)
            self.contact.pop(k, None)
            self.state[k] = 0

    def _write(self) -> None:
        super()._write()
        for k, latch in enumerate(self.latches):
            closed, bears = float(k in self.closed), float(k in self.bearing)
            values = (closed, bears, self._direction[k], self._rest[k])
            self.p[latch.place : latch.place + len(FIELDS)] = values

    def _outcome(self, t: float, x: Array) -> Outcome:
        self._look(t, x)
        jump = self.arm(x)
        assert isinstance(jump, Jump)
        return Halt(jump.state, jump.parameters, jump.sides, jump.step) if self._is_met() else jump

    def _is_met(self) -> bool:
        """Tell whether the run has come to what it goes on until."""
        until = self.problem.scene.deploy.until
        return until != "end" and self.are_closed

    @property
    def are_closed(self) -> bool:
        """Whether the latch that is waited for is closed, or all are."""
        until = self.problem.scene.deploy.until
        names = {self.names[k] for k in self.closed}
        return until in names if until not in ("all", "end") else len(names) == len(self.latches)
