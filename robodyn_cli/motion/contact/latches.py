"""Latches along a motion: they close, each where its own condition is met, hold what they hold, and open again.

The states of latches are parameters of the equations, beside those of joints that stick and meet stops, which go on
with what the latches leave them. A rigid latch closes by an impulse, in which joints that rest on stops take part;
those that close at the same instant do so together, by impulses of least norm where these are not unique.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.latches import FIELDS, TOGETHER
from robodyn_cli.formulations.events import GO_ON, STOP, Event, Halt, Jump, LatchClosed, Outcome
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion.contact.checks import forced_on, torn_open
from robodyn_cli.motion.contact.events import (
    ContactFunction,
    LatchChange,
    LatchClosing,
    LatchFunction,
    known_sides,
)
from robodyn_cli.motion.contact.impact import Impact, shared
from robodyn_cli.motion.contact.latch_states import FALLS, LatchStates
from robodyn_cli.ready.singularity import classify
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT

IN_PLACE = 1e-9  # rad or m, or part of the largest position: an open latch so near to its position is in it
LEFT = 1e-12  # likewise: so far off rounding does not close it any more
NEW = 1e-6  # part of a row that must be independent of the others for its latch to bear anything
TORN = 1e-6  # part of a rate, or of an acceleration, that a closed latch may leave


class Latches(LatchStates):
    """The latches of one run: what closes and opens them, and what that does to the motion."""

    # -- a run ----------------------------------------------------------------------------------------
    def begin(self, t: float, x: Array, options: Options) -> Array:
        x = super().begin(t, x, options)
        self._asked = t
        self._look(t, x)
        self._stay_open(x, range(len(self.latches)))
        given = [(k, self.given[name]) for k, name in enumerate(self.names) if name in self.given]
        if given:
            self._note_brisk(t, x)
        for k, event in given:
            self._take_up(t, x, k, event)
        self._rearrange(t, x)
        self._bear_all(t, x)
        return x

    def _stay_open(self, x: Array, opened: Iterable[int]) -> None:
        """Let latches that are open in their positions leave these before they close."""
        size = max(1.0, float(np.abs(self.system.split(x)[0]).max()))
        for k in opened:
            off = abs(float(self._values[k]))
            self._near[k] = max(2.0 * off, LEFT * size) if off <= IN_PLACE * size else 0.0

    def _note_brisk(self, t: float, x: Array) -> None:
        """Note accelerations before latches close, beside which those that closed ones leave are rounding."""
        if self.problem.constraints.rows:
            self._brisk = max(self._brisk, float(np.abs(self.rates(t, x)[0]).max()))

    def _take_up(self, t: float, x: Array, k: int, event: Mapping[str, Any]) -> None:
        """Close a latch as an earlier run has closed it, at this event, and tell those that go on from this run."""
        latch, place = self.latches[k], self._v_of[k]
        self.closed.append(k)
        self._direction[k] = 1.0 if event["speed"] >= 0.0 else -1.0
        self._rest[k], self._near[k] = event["rest"], FALLS
        if latch.rigid and place is not None:
            x[place] = 0.0
        angle = ABSENT if self._q_of[k] is None else float(x[self._q_of[k]])
        self.closings[k] = LatchClosing(
            0, ABSENT, angle, ABSENT, ABSENT, peak_time=t, has_peaked=True, closings=0
        )
        facts = {"rest": event["rest"], "speed": event["speed"]}
        self._log.append({"time": t, "name": self.names[k], "kind": "carried", **facts})

    def _mass_matrix_and_psi(self, t: float, x: Array) -> tuple[Array, Array]:
        """Return the mass matrix (nv, nv), and Psi (m, nv) with the rows of latches that bear below it."""
        place = t, x[list(self.system.q_places)].tobytes()
        if place != self._known_place:  # events ask for it again and again
            self._known_place, self._known_matrices = place, super()._mass_matrix_and_psi(t, x)
        M, psi = self._known_matrices
        return M, np.concatenate([psi, self._look(t, x)[0][self.bearing]]) if self.bearing else psi

    def arm(self, x: Array) -> Outcome:
        self._carry()
        sides = {n: 1.0 for n, f in enumerate(self._own) if self._starts_positive(f)} | self._turning(x)
        contacts = known_sides(
            self.functions[len(self._own) :], self.state, self.rest, self.contact, self.carried
        )
        return Jump(
            x, self.p, sides | {n + len(self._own): side for n, side in contacts.items()}, self._flight
        )

    def _turning(self, x: Array) -> dict[int, float]:
        """Return the signs that rates which are zero are going to have, by the numbers of their functions."""
        starts = {}
        for n, function in enumerate(self._own):
            v = self.latches[function.number].closing
            turns = function.change is LatchChange.TURNS and function.number not in self.closed
            if turns and v is not None and x[self.system.v_places[v]] == 0.0:
                starts[n] = v
        if not starts:
            return {}
        a = self.rates(self.turns[-1][0], x)[0]
        return {n: 1.0 if a[v] >= 0.0 else -1.0 for n, v in starts.items()}

    def _starts_positive(self, function: LatchFunction) -> bool:
        """Tell whether a function at zero is to be watched from the positive side."""
        k = function.number
        if function.change is LatchChange.CLOSES:
            return k not in self.closed and self._values[k] == 0.0 and self._near[k] <= 0.0
        if function.change is LatchChange.LARGEST:
            return k == self._falls
        return k == self._just and function.change in (LatchChange.MEETS, LatchChange.LETS_GO)

    def handle(self, event: Event) -> Outcome:
        self._carry()
        function = event.function
        if isinstance(function, ContactFunction):
            if function.joint in self._frozen:
                return GO_ON
            self._bear_all(event.time, event.state)
            outcome = super().handle(event)
            assert isinstance(outcome, Jump)
            self._look(event.time, outcome.state)
            self._bear_all(event.time, outcome.state)
            return self._outcome(event.time, outcome.state)
        assert isinstance(function, LatchFunction)
        t, x, k = event.time, event.state.copy(), function.number
        self._flight = np.inf
        if function.change is LatchChange.CLOSES:
            return self._close(event, x, k)
        if function.change in (LatchChange.TURNS, LatchChange.PASSES):
            self._look(t, x)
            return GO_ON
        if k not in self.closed:
            return GO_ON
        if function.change is LatchChange.OPENS:
            return self._open(t, x, k)
        return self._bear(t, x, k, function.change)

    def stops(self) -> Sequence[float]:
        return [time for time in self._breaks if time > self._asked]

    def at_stop(self, t: float, x: Array) -> Outcome:
        """See which joints come to rest on springs, where a formula of time changes: no event tells."""
        self._asked, outcome = t, GO_ON
        for k in self.closed:
            if not self.latches[k].rigid and abs(self._growth(t, x, k)) <= self._least_growth(k):
                outcome = self._bear(t, x, k, LatchChange.RESTS)
                if outcome.ends:
                    break
        return outcome

    def see(self, t: Array, x: Array) -> None:
        super().see(t, x)
        self._look(float(t[-1]), x[-1])
        self._bear_all(float(t[-1]), x[-1])
        q = self.system.split(x)[0]
        for k in self.closed:
            latch = self.latches[k]
            if not latch.rigid or k in self.bearing or latch.q is None:
                continue
            off = np.abs(q[:, latch.q] - self._rest[k])
            if (wrong := off > TORN * max(1.0, abs(self._rest[k]))).any():
                raise torn_open(self.names[k], float(t[int(np.argmax(wrong))]))

    # -- closing --------------------------------------------------------------------------------------
    def _close(self, event: Event, x: Array, k: int) -> Outcome:
        t = event.time
        rows, _ = self._look(t, x)
        latch = self.latches[k]
        if k in self.closed:
            return GO_ON
        if self._near[k] > 0.0:
            self._near[k] = 0.0
            self._write()
            return self.arm(x)
        if (closed := event.close()) is not None:
            return self._take_over(t, x, k, closed)
        if latch.closes is None and not self._is_dead_point(x):
            return GO_ON
        before = x.copy()
        self._note_brisk(t, x)
        places = list(self.system.v_places)
        together = sorted([k, *self._others(t, x, k)]) if latch.rigid else [k]
        self.last = (t, before, together[0])
        self._bear_all(t, x)
        order = self._order(t)
        for j in together:
            self._take(t, x, j, float(rows[j] @ x[places]), order)
        if latch.rigid:
            self._strike_latches(t, x, together, rows[together])
        self.closed += together
        self._just = None if latch.rigid else k
        self._rearrange(t, x)
        self._bear_all(t, x)
        freedom = len(places) - np.linalg.matrix_rank(self._mass_matrix_and_psi(t, x)[1], tol=1e-9)
        for j in together:
            self.closings[j].redundant = self.latches[j].rigid and j not in self.bearing
            self._tell(t, j, int(freedom))
        return self._outcome(t, x)

    def _take_over(self, t: float, x: Array, k: int, closed: LatchClosed) -> Outcome:
        """Take note of a closing that compiled code has made; x : before it."""
        v = self._v_of[k]
        assert v is not None
        self.last = (t, x.copy(), k)
        order = self._order(t)
        self._take(t, x, k, float(x[v]), order)
        self.closings[k].lost, self.closings[k].impulse = closed.lost, closed.impulse
        self.closed.append(k)
        self.bearing.append(k)
        self._write()
        self._look(t, closed.state)
        self._tell(t, k, len(self.system.v_places) - len(self.closed))
        return STOP if self._is_met() else GO_ON

    def _tell(self, t: float, k: int, freedom: int) -> None:
        """Note a closing in the log."""
        it = self.closings[k]
        facts = {
            "energy_lost": it.lost,
            "degrees_of_freedom": freedom,
            "rest": float(self._rest[k]),
            "speed": it.speed,
        }
        self._log.append({"time": t, "name": self.names[k], "kind": "latched", **facts})

    def _order(self, t: float) -> int:
        """Return the order of a closing in this run."""
        times = [it.time for it in self.closings.values()]
        return 1 + sum(time < t for time in times if isinstance(time, float))

    def _take(self, t: float, x: Array, k: int, speed: float, order: int) -> None:
        """Note a closing, and put a coordinate exactly where its latch holds it."""
        latch, before = self.latches[k], self.closings.get(k)
        place = self._q_of[k]
        if place is not None and latch.is_own:
            x[place] -= float(self._values[k])
        angle = ABSENT if place is None else float(x[place])
        self._direction[k] = 1.0 if speed >= 0.0 else -1.0
        if not latch.rigid:
            self._rest[k], self._near[k] = self._rest_before(k, x), FALLS
        else:
            self._rest[k] = 0.0 if place is None else self._position(k, x)
        count = 1 if before is None else before.closings + 1
        past = None if before is None else before.largest
        self.closings[k] = LatchClosing(order, t, angle, speed, closings=count, past=past)
        if not latch.rigid:
            self.closings[k].peak, self.closings[k].peak_time = abs(latch.law(0.0, abs(speed))), t

    def _others(self, t: float, x: Array, k: int) -> list[int]:
        """Return the other rigid latches that close at the same instant: their positions are as near as rounding."""
        near, rates = TOGETHER * max(1.0, t), self._closing_rates(t, x)
        others = []
        for j, latch in enumerate(self.latches):
            if j == k or j in self.closed or not latch.rigid or self._near[j] > 0.0:
                continue
            way = {"up": rates[j] > 0.0, "down": rates[j] < 0.0}.get(latch.spec.side, True)
            if way and rates[j] != 0.0 and abs(self._values[j]) <= near * abs(rates[j]):
                others.append(j)
        return [j for j in others if self.latches[j].closes is not None or self._is_dead_point(x)]

    def _is_dead_point(self, x: Array) -> bool:
        """Tell whether the mechanism is in a dead point."""
        return classify(self.problem, self.system.split(x)[0], self.passive).kind == "dead_point"

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
        lost = met.lost(after)
        for j, share in zip(together, shared(M @ (after - v), np.concatenate([psi, stay]), rows)):
            self.closings[j].impulse, self.closings[j].lost = float(abs(share)), lost
        x[places] = after
        self._halt(x, together)
        if self.system.work_place is not None:
            x[self.system.work_place] -= lost

    def _open(self, t: float, x: Array, k: int) -> Outcome:
        """Open a latch, which bears nothing more; the energy in its spring is lost."""
        latch = self.latches[k]
        self._bear_all(t, x)
        q = self.system.split(x)[0]
        if not latch.rigid and self.system.work_place is not None:
            x[self.system.work_place] -= float(latch.stored(q, self._direction[k], self._rest[k]))
        self.closed.remove(k)
        if k in self.closings:
            self.closings[k].opened, self.closings[k].has_peaked = t, True
        self._log.append({"time": t, "name": latch.name, "kind": "opened"})
        self._look(t, x)
        self._stay_open(x, [k])
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
            length = math.sqrt(rest @ rest)
            if length > NEW * math.sqrt(rows[k] @ rows[k]):
                basis = np.concatenate([basis, rest[None] / length])
                self.bearing.append(k)
            else:
                idle.append(k)
        stands = len(basis) == basis.shape[1] and not self.problem.constraints.rheonomic
        for k in (k for k in self._moved if k not in self.closed):
            self._near[k] = max(self._near[k], 0.0) or -float(stands)
        if stands or self._stands:  # nothing moves, or has until now; rounding would go on
            x[list(self.system.v_places)] = 0.0
        self._stands = stands
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

    def _bear(self, t: float, x: Array, k: int, change: LatchChange) -> Outcome:
        """Note the load of a compliant latch, and whether it has been left; end a run that went on for its peak."""
        it, waited = self.closings[k], not self._has_peaked(k)
        self._look(t, x)
        if change is LatchChange.LARGEST and self._near[k] > FALLS:
            return self._watch_growth(k, x, FALLS)  # it has grown again, and is largest where that is zero
        inwards, least = self._direction[k] * self._rate(k, x) > 0.0, self._least_growth(k)
        it.rebounds += change is LatchChange.MEETS and not inwards
        it.has_peaked |= change in (LatchChange.LARGEST, LatchChange.RESTS) or not inwards
        if change in (LatchChange.LARGEST, LatchChange.RESTS) or (change is LatchChange.MEETS and inwards):
            self._note_load(t, x, k, enters=change is LatchChange.MEETS)
        if waited and self._is_met():
            return Halt(x, self.p, {}, np.inf)
        if change not in (LatchChange.LARGEST, LatchChange.RESTS):
            return GO_ON
        load = self._borne(k, x)[0]
        at_rest, it.crest = change is LatchChange.RESTS or abs(load - it.crest) <= least, load
        return self._watch_growth(k, x, least) if at_rest else GO_ON

    def _watch_growth(self, k: int, x: Array, least: float) -> Outcome:
        """Go on with another growth below which a load is at rest: rounding must not make peaks of one."""
        self._near[k], self._falls = least, k if least == FALLS else None
        self._write()
        outcome, self._falls = self.arm(x), None
        return outcome

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
            values = (closed, bears, self._direction[k], self._rest[k], self._near[k])
            self.p[latch.place : latch.place + len(FIELDS)] = values

    def _outcome(self, t: float, x: Array) -> Outcome:
        self._look(t, x)
        self._see_peaks(t, x)
        jump, self._just = self.arm(x), None
        assert isinstance(jump, Jump)
        return Halt(jump.state, jump.parameters, jump.sides, jump.step) if self._is_met() else jump
