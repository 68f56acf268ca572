"""The reference motion: Dormand and Prince's order 8 at tight tolerance, with events of its own.

It shares nothing with the program but the scene. Events are roots of trial steps; sides of switches are kept between
events, so that no stage of a step lies on the wrong side.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate._ivp import dop853_coefficients as tables
from scipy.optimize import brentq

from tests.proof.equations import Equations, HalfTurnError, Modes, constrained, stop_switches
from tests.proof.mechanism import Array, Law, Mechanism, Payload

STAGES = tables.N_STAGES
A, B, C = tables.A[:STAGES, :STAGES], tables.B, tables.C[:STAGES]
E3, E5 = tables.E3, tables.E5
EVENTS = 400  # after so many the motion is left undecided
AT_REST = 1e-13  # a rate this small is none
LOWEST = 1e-15  # bounces lower than this [rad, m] are none
FLIGHT = 1 / 8  # first step after an impact, as a part of the time to the next one


class UndecidedError(Exception):
    """The reference cannot tell how the motion goes on."""


class LockedError(Exception):
    """The mechanism locks at a ``time`` [s], where its motion ends."""

    def __init__(self, time: float) -> None:
        super().__init__(f"locked at {time:.9g} s")
        self.time = time


@dataclasses.dataclass
class Motion:
    """Samples of q (T, nq) and v (T, nv)."""

    q: Array
    v: Array


class Reference:
    """One integration of a mechanism."""

    def __init__(self, mechanism: Mechanism, rtol: float, atol: float, seconds: float) -> None:
        self.m, self.eq = mechanism, Equations(mechanism)
        self.rtol, self.atol = rtol, atol
        self.modes = Modes()
        self.events, self.evaluations = 0, 0
        self.most = int(seconds / 1.5e-4)
        self.nx = len(mechanism.branch.free) if mechanism.branch else self.eq.nq
        self.nv = self.nx if mechanism.branch else self.eq.nv
        self.first = 1e-3
        self.still: dict[int, float] = {}  # places of held joints
        self._stops = [
            (k, side, limits[name], limits["stop"])
            for k, body in enumerate(mechanism.bodies)
            if (limits := body.extra.get("limits"))
            for side, name in enumerate(("lower", "upper"))
            if name in limits
        ]
        self.dry = [
            k
            for k, b in enumerate(mechanism.bodies)
            if b.extra.get("friction", {}).get("law") == "set_valued"
        ]

    # -- state ----------------------------------------------------------------------------------------
    def q_v(self, y: Array) -> tuple[Array, Array]:
        """Return coordinates and velocities of a state."""
        x, xd = y[: self.nx], y[self.nx : self.nx + self.nv]
        branch = self.m.branch
        return (x, xd) if branch is None else (branch.at(x), branch.slope(x) @ xd)

    def solve(self, t: float, y: Array) -> tuple[Array, dict[int, float]]:
        """Return accelerations of the state's rates, and the forces of joints that are held."""
        self.evaluations += 1
        if self.evaluations > self.most:
            raise UndecidedError("takes too long")
        try:
            return self._solve(t, y)
        except HalfTurnError:
            raise UndecidedError("a bushing comes near half a turn") from None

    def _solve(self, t: float, y: Array) -> tuple[Array, dict[int, float]]:
        q, v = self.q_v(y)
        branch, law = self.m.branch, self.m.law
        if law is not None and law.period is None:
            self._drive(law.torques(t, *self._led(law, q, v), y[self.nx + self.nv :]))
        if branch is None:
            return self.eq.solve(t, q, v, self.modes)
        x, xd = y[: self.nx], y[self.nx :]
        M, h = self.eq.dynamics(t, q, v, self.modes)
        P, bias = branch.slope(x), branch.bias(x, xd)
        held = self.modes.held
        J = self.eq.unit_rows(held)
        a, lam = constrained(P.T @ M @ P, P.T @ (h + M @ bias), [J @ P] if held else [], [J @ bias])
        return a, dict(zip(held, lam))

    def rate(self, t: float, y: Array) -> Array:
        a = self.solve(t, y)[0]
        x, xd, law = y[: self.nx], y[self.nx : self.nx + self.nv], self.m.law
        found = np.concatenate([xd if self.m.branch else self.eq.rates(x, xd), a])
        if law is None or law.period is not None:
            return found
        return np.concatenate([found, law.ki * law.error(t, self._led(law, *self.q_v(y))[0])])

    # -- controllers and payloads ---------------------------------------------------------------------
    def _led(self, law: Law, q: Array, v: Array) -> tuple[Array, Array]:
        """Return positions and rates of the joints that a controller drives."""
        return q[self.m.first_q[law.joints]], v[self.m.first_v[law.joints]]

    def _drive(self, torques: Array) -> None:
        assert self.m.law is not None
        self.modes.drive = dict(zip(self.m.first_v[self.m.law.joints], torques))

    def _schedule(self, end: float) -> list[tuple[float, Callable[[float, Array], Array]]]:
        """Return what happens when: samples of the controller and their torques, payloads that come and go."""
        todo: list[tuple[float, Callable[[float, Array], Array]]] = []
        law = self.m.law
        if law is not None and law.period is not None:
            waiting: list[Array] = []
            integral = np.zeros(len(law.joints))

            def sample(t: float, y: Array) -> Array:
                x, xd = self._led(law, *self.q_v(y))
                waiting.append(law.torques(t, x, xd, integral))
                integral[:] += law.period * law.ki * law.error(t, x)
                return y

            def act(t: float, y: Array) -> Array:
                self._drive(waiting.pop(0))
                return y

            for k in range(math.ceil(end / law.period)):
                todo += [(k * law.period, sample), (k * law.period + law.delay, act)]
        for payload in self.m.payloads:
            todo += self._carried(payload)
        return sorted((entry for entry in todo if entry[0] < end), key=lambda entry: entry[0])

    def _carried(self, payload: Payload) -> list[tuple[float, Callable[[float, Array], Array]]]:
        def grip(t: float, y: Array) -> Array:
            q, v = self.q_v(y)
            return np.concatenate([q, self.eq.gripped(t, q, v, payload, self.modes)])

        def release(t: float, y: Array) -> Array:
            self.eq.carry(payload, -1.0)
            return y

        if payload.start is None:
            self.eq.carry(payload, 1.0)
        return ([] if payload.start is None else [(payload.start, grip)]) + (
            [] if payload.stop is None else [(payload.stop, release)]
        )

    def step(self, t: float, y: Array, h: float, k0: Array) -> tuple[Array, Array, float]:
        """Return the state after a step, its rate, and the scaled error."""
        K = np.empty((STAGES + 1, len(y)))
        K[0] = k0
        for s in range(1, STAGES):
            K[s] = self.rate(t + C[s] * h, y + h * (A[s, :s] @ K[:s]))
        new = y + h * (B @ K[:STAGES])
        K[STAGES] = self.rate(t + h, new)
        scale = self.atol + self.rtol * np.maximum(np.abs(y), np.abs(new))
        e5 = float(np.sum(((E5 @ K) / scale) ** 2))
        e3 = float(np.sum(((E3 @ K) / scale) ** 2))
        size = e5 + 0.01 * e3
        return new, K[STAGES], 0.0 if size == 0.0 else abs(h) * e5 / np.sqrt(size * len(y))

    def tidy(self, t: float, y: Array) -> Array:
        """Return the state put back on loops, prescribed motions and joints that are held."""
        if self.m.branch is not None:
            return y
        q, v = y[: self.nx].copy(), y[self.nx : self.nx + self.nv].copy()
        for k, (at, rate, _) in self.m.prescribed.items():
            q[self.m.first_q[k]] = at.value(t, self.modes.s, q, v)
            v[self.m.first_v[k]] = rate.value(t, self.modes.s, q, v)
        for k, place in self.still.items():
            q[self.m.first_q[k]], v[self.m.first_v[k]] = place, 0.0
        if self.m.loops:
            q, v = self._close(t, q, v)
        return np.concatenate([q, v, y[self.nx + self.nv :]])

    def _close(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        fixed = [*self.m.prescribed, *self.still]
        S = self.eq.unit_rows(fixed)
        for _ in range(3):
            M, _ = self.eq.dynamics(t, q, v, self.modes)
            J, _ = self.eq.loop_rows(q)
            gap = self.eq.gap(q)
            whole = np.concatenate([J, S])
            both = np.linalg.solve(M, whole.T)
            inverse = both @ np.linalg.inv(whole @ both)
            v = v - inverse @ np.concatenate([J @ v, np.zeros(len(fixed))])
            if np.abs(gap).max() < 1e-15:
                break
            dq = -inverse @ np.concatenate([gap, np.zeros(len(fixed))])
            q = self.eq.moved(q, dq)
        return q, v

    # -- events ---------------------------------------------------------------------------------------
    def watched(self, t: float, y: Array) -> dict[tuple[str, int, int], float]:
        """Return the event functions: each is positive as long as the modes hold."""
        q, v = self.q_v(y)
        found: dict[tuple[str, int, int], float] = {}
        for k, side, at, stop in self._stops:
            x, xd = q[self.m.first_q[k]], v[self.m.first_v[k]]
            if "stiffness" in stop:
                for j, value in enumerate(stop_switches(side, at, stop, x, xd)):
                    found["side", k, 2 * side + j] = self.modes.sides[k, 2 * side + j] * value
            elif k not in self.modes.rest:
                found["hit", k, side] = x - at if side == 0 else at - x
        for k, way in self.modes.slip.items():
            if way:
                found["rest", k, 0] = way * v[self.m.first_v[k]]
        if self.modes.held:
            forces = self.solve(t, y)[1]
            for k, force in forces.items():
                if k in self.modes.rest:
                    found["leave", k, 0] = self.modes.rest[k] * force
                else:
                    found["break", k, 0] = self._breakaway(k) - abs(force)
        if self.m.lock is not None:
            found["lock", 0, 0] = self.unlocked * self._lock(q)
        return found

    def _lock(self, q: Array) -> float:
        """Return what vanishes at the lock: the passive determinant of the loops, or the way to the latch."""
        lock = self.m.lock
        assert lock is not None
        if lock.passive is None:
            return float(q[self.m.first_q[lock.joint]] - lock.at)
        self.eq.gap(q)
        J, _ = self.eq.loop_rows(q)
        return float(np.linalg.det(J[:, [self.m.first_v[k] for k in lock.passive]]))

    def _breakaway(self, k: int) -> float:
        extra = self.m.bodies[k].extra
        friction = extra["friction"]
        scale = abs(extra.get("gear_ratio", 1.0)) if friction.get("side") == "motor" else 1.0
        return scale * float(friction.get("static", friction.get("coulomb", 0.0)))

    def begin(self, t: float, y: Array) -> None:
        """Set the modes of a state from which the motion starts."""
        q, v = self.q_v(y)
        if self.m.lock is not None:
            self.unlocked = float(np.sign(self._lock(q)))
        for k, side, at, stop in self._stops:
            if "stiffness" in stop:
                x, xd = q[self.m.first_q[k]], v[self.m.first_v[k]]
                for j, value in enumerate(stop_switches(side, at, stop, x, xd)):
                    self.modes.sides[k, 2 * side + j] = 1.0 if value > 0.0 else -1.0
        for k in self.dry:
            rate = v[self.m.first_v[k]]
            self.modes.slip[k] = float(np.sign(rate)) if abs(rate) > AT_REST else 0.0
            if not self.modes.slip[k]:
                self.still[k] = float(q[self.m.first_q[k]])
        self.settle(t, y)

    def settle(self, t: float, y: Array) -> None:
        """Let joints go that friction cannot hold, one after another."""
        for _ in range(20):
            if not self.modes.held:
                return
            forces = self.solve(t, y)[1]
            over = {k: abs(f) / self._breakaway(k) for k, f in forces.items() if k not in self.modes.rest}
            worst = max(over, key=lambda k: over[k], default=None)
            if worst is None or over[worst] <= 1.0:
                return
            self.modes.slip[worst] = -float(np.sign(forces[worst]))
            self.still.pop(worst, None)
        raise UndecidedError("contacts do not settle")

    def handle(self, t: float, y: Array, key: tuple[str, int, int]) -> Array:
        """Change modes and state at an event."""
        kind, k, side = key
        self.events += 1
        if self.events > EVENTS:
            raise UndecidedError("events without end")
        if kind == "lock":
            raise LockedError(t)
        if kind == "side":
            self.modes.sides[k, side] *= -1.0
        elif kind == "hit":
            y = self.impact(t, y, k, side)
        elif kind == "leave":
            del self.modes.rest[k]
            self.still.pop(k, None)
        elif kind == "rest":
            self.modes.slip[k] = 0.0
            y = self._stop(y, k)
            self.settle(t, y)
        else:
            force = self.solve(t, y)[1][k]
            self.modes.slip[k] = -float(np.sign(force))
            self.still.pop(k, None)
            self.settle(t, y)
        return y

    def _stop(self, y: Array, k: int) -> Array:
        y = y.copy()
        if self.m.branch is None:
            y[self.nx + self.m.first_v[k]] = 0.0
            self.still[k] = float(y[self.m.first_q[k]])
        return y

    def impact(self, t: float, y: Array, k: int, side: int) -> Array:
        """Return the state after an impact of joint k on a stop; where it would hardly bounce, it comes to rest."""
        if self.m.branch is not None:
            raise UndecidedError("an impact on a branch")
        q = y[: self.nx].copy()
        limits = self.m.bodies[k].extra["limits"]
        at, push = (limits["lower"], 1.0) if side == 0 else (limits["upper"], -1.0)
        place = self.m.first_v[k]
        q[self.m.first_q[k]] = at
        e = limits["stop"]["restitution"]
        bounced = self._struck(t, q, y[self.nx :], k, e)
        toward = -push * float(self.solve(t, bounced)[0][place])
        speed = push * float(bounced[self.nx + place])
        if e > 0.0 and speed * speed >= 2.0 * abs(toward) * LOWEST:
            if toward > 0.0:
                self.first = min(self.first, FLIGHT * 2.0 * speed / toward)
            return bounced
        if toward <= 0.0:
            raise UndecidedError("an impact without bounce, and nothing presses on")
        rested = self._struck(t, q, y[self.nx :], k, 0.0)
        self.modes.rest[k] = push
        return self._stop(rested, k)

    def _struck(self, t: float, q: Array, v: Array, k: int, e: float) -> Array:
        """Return the state with the impulse that makes the rate of joint k -e times what it is."""
        M, _ = self.eq.dynamics(t, q, v, self.modes)
        rows = [self.eq.loop_rows(q)[0]] if self.m.loops else []
        rows += [self.eq.unit_rows(list(self.m.prescribed))]
        resting = list(self.modes.rest)
        J = np.concatenate([*rows, self.eq.unit_rows(resting), self.eq.unit_rows([k])])
        jump = np.zeros(len(J))
        jump[-1] = -(1.0 + e) * v[self.m.first_v[k]]
        MJ = np.linalg.solve(M, J.T)
        impulse = np.linalg.solve(J @ MJ, jump)
        loads = impulse[len(J) - 1 - len(resting) :]
        if any(self.modes.rest[j] * load < 0.0 for j, load in zip(resting, loads)):
            raise UndecidedError("an impact lifts another joint off its stop")
        v = v + MJ @ impulse
        for j in self.dry:
            rate = v[self.m.first_v[j]]
            self.modes.slip[j] = float(np.sign(rate)) if abs(rate) > AT_REST else 0.0
            if self.modes.slip[j]:
                self.still.pop(j, None)
        y = np.concatenate([q, v])
        self.settle(t, y)
        return y

    # -- the run --------------------------------------------------------------------------------------
    def run(self, q: Array, v: Array, times: Array) -> Motion:
        """Integrate from the first of the times, at which the state is given, through all of them."""
        y = np.concatenate([q, v])
        if self.m.law is not None and self.m.law.period is None:
            y = np.concatenate([y, np.zeros(len(self.m.law.joints))])
        schedule = self._schedule(float(times[-1]))
        inner = [*self.m.breaks, *(t for t, _ in schedule)]
        marks = np.unique(np.concatenate([times, [b for b in inner if times[0] < b < times[-1]]]))
        samples = set(times.tolist())
        qs, vs = [], []
        self.modes.s = 0.5 * (marks[0] + marks[1])
        self.begin(float(marks[0]), y)
        for start, stop in zip(marks[:-1], marks[1:]):
            if start in samples:
                q, v = self.q_v(y)
                qs.append(q)
                vs.append(v)
            self.modes.s = 0.5 * (start + stop)
            if start in self.m.breaks:
                self.first = min(self.first, 1e-4)
                self.settle(float(start), y)
            while schedule and schedule[0][0] <= start:
                y = schedule.pop(0)[1](float(start), y)
            y = self.advance(float(start), float(stop), y)
        q, v = self.q_v(y)
        return Motion(np.array([*qs, q]), np.array([*vs, v]))

    def advance(self, t: float, end: float, y: Array) -> Array:
        """Integrate to the end of a stretch without jumps."""
        k0 = self.rate(t, y)
        while t < end:
            h = min(self.first, end - t)
            last = h >= end - t
            new, k1, error = self.step(t, y, h, k0)
            if error > 1.0:
                self.first = h * max(0.2, 0.9 * error**-0.125)
                if self.first < 1e-14:
                    raise UndecidedError("steps vanish")
                continue
            key, part = self._first_event(t, y, h, k0, new)
            if key is None and (inside := self._inside(t, h, (y, k0), (new, k1))) is not None:
                key, part = self._first_event(t, y, inside, k0, self.step(t, y, inside, k0)[0])
            grown = h * min(5.0, 0.9 * max(error, 1e-10) ** -0.125)
            if key is None:
                t, y = (end if last else t + h), self.tidy(t + h, new)
                k0 = self.rate(t, y)
                self.first = max(grown, self.first) if last else grown
                continue
            y = self.step(t, y, part, k0)[0]
            t += part
            self.first = min(h, 1e-3)
            y = self.handle(t, self.tidy(t, y), key)
            k0 = self.rate(t, y)
        return y

    def _inside(
        self, t: float, h: float, before: tuple[Array, Array], after: tuple[Array, Array]
    ) -> float | None:
        """Return how far into a step an event function is negative that is positive again at its end.

        before, after : states and rates at the ends of the step, between which Hermite's cubic is looked at.
        """
        (y, k0), (new, k1) = before, after

        def watched(u: float) -> dict[tuple[str, int, int], float]:
            bent = u * (1.0 - u) * ((1.0 - u) * (h * k0 - (new - y)) - u * (h * k1 - (new - y)))
            return self.watched(t + u * h, y + u * (new - y) + bent)

        places = [0.0, 0.25, 0.5, 0.75, 1.0]
        values = [watched(u) for u in places]
        for key in values[0]:
            row = [found[key] for found in values]
            k = int(np.argmin(row[1:-1])) + 1
            low, middle, high = row[k - 1 : k + 2]
            if middle < -1e-13:
                return places[k] * h
            curve = low - 2.0 * middle + high
            if curve > 0.0 and middle < (low - high) ** 2 / (8.0 * curve):
                lowest = places[k] + 0.125 * (low - high) / curve
                if 0.0 < lowest < 1.0 and watched(lowest)[key] < -1e-13:
                    return lowest * h
        return None

    def _first_event(self, t: float, y: Array, h: float, k0: Array, new: Array) -> tuple[Any, float]:
        """Return the event function that is the first to change its sign within the step, and where."""
        now = self.watched(t + h, new)
        wrong = [key for key, value in now.items() if value < 0.0]
        best: Any = None
        part = h
        for key in wrong:

            def value(size: float, key: Any = key) -> float:
                return self.watched(t + size, self.step(t, y, size, k0)[0])[key]

            low = 0.5 * part
            while low > 1e-9 * h and value(low) < 0.0:
                low *= 0.5
            if value(low) < 0.0:
                if now[key] > -1e-13:
                    continue  # it has just been there
                raise UndecidedError(f"{key} is on its wrong side")
            if best is not None and value(part) >= 0.0:
                continue
            root = brentq(value, low, part, xtol=1e-16, rtol=1e-14)
            # a hair beyond, so that it is on the new side
            best, part = key, min(part, root * (1.0 + 4e-15))
        return best, part
