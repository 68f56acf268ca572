"""Arrays of panels whose latches have springs and open again, and one hinge of which may stick: an oracle by numpy and
scipy alone, which goes from event to event.

The equations are those of ``tests/panels.py``. A spring that was passed in the direction s pushes with
-s (k delta + c delta-dot) while delta = s (theta - at) and that load are positive; the rough hinge slips with constant
friction against its rate, or is held, as its multiplier allows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from tests.panels import TOGETHER, Panels

Key = tuple[str, int]
MAX_STEP = 0.02  # s: events are looked for at the ends of steps


@dataclasses.dataclass
class Closing:
    """What a latch has done since it closed last, with the words of the summary."""

    order: int
    time: float
    speed: float
    energy_lost: float = 0.0
    peak_moment: float = 0.0
    peak_time: float = 0.0
    rebounds: int = 0
    closings: int = 1
    opened: float | None = None
    has_peaked: bool = False


@dataclasses.dataclass
class LatchedPanels:
    """An array and its latches.

    hold, damping : springs of the latches (n,), 0 for a rigid one. opens : when latches open [s], inf: never.
    rough, grip : the hinge with Coulomb friction [N m], -1: none.
    """

    panels: Panels
    hold: np.ndarray
    damping: np.ndarray
    opens: np.ndarray
    rough: int = -1
    grip: float = 0.0

    def scene(self, duration: float, until: str, **simulate: Any) -> dict[str, Any]:
        """Return the same as a scene."""
        tree = self.panels.scene(duration=duration, **simulate)
        for k, latch in enumerate(tree["deploy"]["latches"]):
            if self.hold[k]:
                latch["hold"] = {"stiffness": float(self.hold[k]), "damping": float(self.damping[k])}
            if np.isfinite(self.opens[k]):
                latch["release"] = f"t - {float(self.opens[k])!r}"
        if self.rough >= 0:
            joint = tree["robot"]["joints"][self.rough]
            joint["friction"] = {"law": "set_valued", "coulomb": float(self.grip)}
        tree["deploy"]["until"] = until
        return tree


class Course:
    """One run. theta, speed (n,) : of the hinges, at time t [s].

    latched : hinges that rigid latches hold. sides : the way s in which closed springs were passed. loaded : springs
    that push. slips : the way in which the rough hinge slips, 0 where it is held.
    """

    def __init__(self, case: LatchedPanels) -> None:
        self.case, self.panels = case, case.panels
        n = len(self.panels.mass)
        self.D, self.A = self.panels.turns, self.panels.coefficients()
        self.theta, self.speed, self.t = self.panels.start.copy(), np.zeros(n), 0.0
        self.latched: list[int] = []
        self.sides: dict[int, float] = {}
        self.loaded: set[int] = set()
        self.closings: dict[int, Closing] = {}
        self.slips = 0.0
        self.fired: dict[Key, float] = {}
        self._settle_friction()

    def run(self, end: float, until_all: bool) -> Course:
        """Go from event to event, to the end or until all latches are closed and all loads have had a peak."""
        n = len(self.theta)
        while self.t < end:
            stop = min([end, *(x for x in self.case.opens if x > self.t)])
            key = self._advance(stop)
            if key is not None:
                self._answer(*key)
            else:
                for k in np.flatnonzero(self.case.opens == self.t):
                    self._open(int(k))
            peaked = all(self.closings[k].has_peaked for k in self.sides)
            if until_all and len(self.latched) + len(self.sides) == n and peaked:
                break
        return self

    # -- between events -------------------------------------------------------------------------------
    def load(self, k: int, depth: float, rate: float) -> float:
        """Return k delta + c delta-dot, or its rate."""
        return float(self.sides[k] * (self.case.hold[k] * depth + self.case.damping[k] * rate))

    def accelerations(self, theta: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the accelerations of the hinges (n,), and the torque that holds the rough one."""
        p = self.panels
        phi, rate = np.linalg.solve(self.D, theta), np.linalg.solve(self.D, speed)
        apart = phi[:, None] - phi[None, :]
        tau = -p.stiffness * (theta - p.rest) - p.damping * speed
        for k in self.loaded:
            tau[k] -= self.sides[k] * self.load(k, theta[k] - p.at[k], speed[k])
        held = list(self.latched)
        sticks = self.case.rough >= 0 and self.case.rough not in held and not self.slips
        if sticks:
            held.append(self.case.rough)
        elif self.case.rough >= 0 and self.case.rough not in held:
            tau[self.case.rough] -= self.slips * self.case.grip
        rows = p.rows(held)
        M, force = self.A * np.cos(apart), self.D.T @ tau - (self.A * np.sin(apart)) @ rate**2
        spread, free = np.linalg.solve(M, rows.T), np.linalg.solve(M, force)
        lam, *_ = np.linalg.lstsq(rows @ spread, -rows @ free, rcond=1e-10)
        return self.D @ (free + spread @ lam), float(lam[-1]) if sticks else 0.0

    def _functions(self) -> dict[Key, tuple[Callable[..., float], int]]:
        """Return the event functions of theta and its rate, with their directions."""
        at, functions = self.panels.at, {}
        for k in range(len(at)):
            if k not in self.latched and k not in self.sides:
                functions["closes", k] = (lambda q, v, k=k: q[k] - at[k]), 0
        for k, s in self.sides.items():
            functions["meets", k] = (lambda q, v, k=k, s=s: s * (q[k] - at[k])), 0
            if self.case.damping[k]:
                functions["pushes", k] = (lambda q, v, k=k: self.load(k, q[k] - at[k], v[k])), 0
            functions["largest", k] = (
                lambda q, v, k=k: self.load(k, v[k], self.accelerations(q, v)[0][k]) if k in self.loaded else -1.0
            ), -1  # fmt: skip
        k = self.case.rough
        if k >= 0 and k not in self.latched and self.slips:
            functions["rests", k] = (lambda q, v: self.slips * v[k]), -1
        elif k >= 0 and k not in self.latched:
            functions["breaks", k] = (lambda q, v: self.case.grip - abs(self.accelerations(q, v)[1])), -1
        return functions  # type: ignore[return-value]

    def _advance(self, stop: float) -> Key | None:
        """Integrate up to the next event, whose key is returned, or to a time."""
        n, begun, functions = len(self.theta), self.t, self._functions()

        def watched(key: Key) -> Any:
            value, direction = functions[key]

            def function(t: float, y: np.ndarray) -> float:
                # what has just happened starts behind zero
                return self.fired[key] if t == begun and key in self.fired else value(y[:n], y[n:])

            function.terminal, function.direction = True, direction  # type: ignore[attr-defined]
            return function

        run = solve_ivp(
            lambda _, y: np.concatenate([y[n:], self.accelerations(y[:n], y[n:])[0]]),
            (begun, stop), np.concatenate([self.theta, self.speed]), method="DOP853", rtol=1e-13, atol=1e-14,
            max_step=MAX_STEP, events=[watched(key) for key in functions],
        )  # fmt: skip
        assert run.success, run.message
        self.t, self.theta, self.speed = float(run.t[-1]), run.y[:n, -1], run.y[n:, -1]
        self.fired = {}
        return next((key for key, times in zip(functions, run.t_events) if len(times)), None)

    # -- at events ------------------------------------------------------------------------------------
    def _answer(self, change: str, k: int) -> None:
        s = self.sides.get(k, 0.0)
        if change == "closes":
            self._close(k)
        elif change == "meets":
            inward = s * self.speed[k] > 0.0
            self.theta[k] = self.panels.at[k]
            self.closings[k].rebounds += not inward
            self.loaded.discard(k)
            if inward:
                self.loaded.add(k)
                self._bear(k)
            self.fired = {("meets", k): 1e-300 if inward else -1e-300}
        elif change == "pushes":
            deep = s * (self.theta[k] - self.panels.at[k]) > 0.0
            rises = k not in self.loaded
            self.loaded ^= {k} if deep else set()
            self.fired = {("pushes", k): 1e-300 if rises else -1e-300}
        elif change == "largest":
            self._bear(k)
            self.closings[k].has_peaked = True
            self.fired = {("largest", k): -1e-300}
            if k == self.case.rough and not self.case.damping[k]:  # it comes to rest there
                self._answer("rests", k)
        elif change == "rests":
            self.speed[k] = 0.0
            self._settle_friction()
        else:
            self._settle_friction()

    def _bear(self, k: int) -> None:
        load, it = self.load(k, self.theta[k] - self.panels.at[k], self.speed[k]), self.closings[k]
        if load > it.peak_moment:
            it.peak_moment, it.peak_time = load, self.t

    def _close(self, k: int) -> None:
        """Close a latch, and others of the same kind that come to their positions at the same instant."""
        case, before = self.case, self.speed.copy()
        near = [
            j for j in range(len(self.theta))
            if j not in self.latched and j not in self.sides and case.hold[j] == 0.0
            and abs(self.theta[j] - self.panels.at[j]) < TOGETHER
        ]  # fmt: skip
        closing = [k] if case.hold[k] else near
        order = 1 + sum(it.time < self.t for it in self.closings.values())
        lost = 0.0
        self.theta[closing] = self.panels.at[closing]
        if not case.hold[k]:
            self.latched += closing
            lost = self._strike()
        for j in closing:
            earlier = self.closings[j].closings if j in self.closings else 0
            self.closings[j] = Closing(order, self.t, float(before[j]), lost, closings=earlier + 1)
        if case.hold[k]:
            self.sides[k] = 1.0 if before[k] >= 0.0 else -1.0
            self.loaded.add(k)
            self.closings[k].peak_time = self.t
            self._bear(k)
            self.fired = {("meets", k): 1e-300}
            growth = self.load(k, self.speed[k], self.accelerations(self.theta, self.speed)[0][k])
            self.closings[k].has_peaked = growth <= 0.0
        self._settle_friction()

    def _strike(self) -> float:
        """Take the speeds to those in which latched hinges stand still; return the energy lost."""
        for j in self.loaded:
            self._bear(j)
        phi, rate = np.linalg.solve(self.D, self.theta), np.linalg.solve(self.D, self.speed)
        after = self.panels.struck(phi, rate, self.latched)
        self.speed = self.D @ after
        self.speed[self.latched] = 0.0
        depths = {j: self.theta[j] - self.panels.at[j] for j in self.sides}
        self.loaded = {
            j for j, s in self.sides.items()
            if s * depths[j] > 0.0 and self.load(j, depths[j], self.speed[j]) > 0.0
        }  # fmt: skip
        for j in self.loaded:
            self._bear(j)
        return self.panels.energy(phi, rate) - self.panels.energy(phi, after)

    def _open(self, k: int) -> None:
        if k in self.latched:
            self.latched.remove(k)
            self.theta[k] = self.panels.at[k]  # but for what rounding has moved it
        elif self.sides.pop(k, None) is not None:
            self.loaded.discard(k)
        else:
            return
        self.closings[k].opened = self.t
        self._settle_friction()
        # it closes where it is passed again
        way = self.accelerations(self.theta, self.speed)[0][k] if self.theta[k] == self.panels.at[k] else 0.0
        if way:
            self.fired["closes", k] = float(np.sign(way)) * 1e-300

    def _settle_friction(self) -> None:
        """Find whether the rough hinge sticks or slips, and which way."""
        k = self.case.rough
        if k < 0 or k in self.latched:
            return
        self.slips = float(np.sign(self.speed[k])) if abs(self.speed[k]) > 1e-13 else 0.0
        if self.slips:
            return
        self.speed[k] = 0.0
        holds = self.accelerations(self.theta, self.speed)[1]
        if abs(holds) >= self.case.grip * (1.0 - 1e-9):
            self.slips = -float(np.sign(holds))
            self.fired["rests", k] = 1e-300
