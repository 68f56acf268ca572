"""Sticking, slipping, impacts and contact along a simulation: what events do to the modes of joints.

After each event the modes of the joints at rest are found anew, all together: each is held with a multiplier within its
bounds, or moves off in a direction in which it does accelerate (a linear complementarity problem).
"""

from __future__ import annotations

import itertools
from collections import Counter, deque
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.modes import UNBOUNDED, Gate
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError, SceneError
from robodyn_cli.formulations.index1 import mode_events
from robodyn_cli.formulations.system import GROUPS, System
from robodyn_cli.integrators.runtime.integrator import Event, Integrator, Options
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.run.driver.impact import impact

Array = NDArray[np.float64]
HELD = 0  # the mode of a joint that is held; the others are the direction of motion, +1 or -1
AT_STOP = 1e-12  # a joint this close to a stop, relative to its position, is at it
AT_REST = 1e-13  # a rate this small, relative to the largest, is zero
FORCE = 1e-9  # a multiplier may pass its bound by this part of the largest one, for rounding
MISSED = 1e-6  # what has gone past an event by this part of its scale was missed
COMBINATIONS = 6561  # of modes that are tried where pivoting does not end
CROWD = 1000  # so many events within this part of the time so far (or of a second) get nowhere
CROWDED = 1e-5
FLIGHT = 1 / 8  # the first step after an impact, as a part of the time to the next one


class Modes:
    """The modes of one run; ``p`` holds the parameters of the equations that say which are on.

    Parameters
    ----------
    options : of the integration; a joint rests on a stop when its next bounce would be lower than the tolerance, or
        shorter than a fixed step resolves.
    """

    def __init__(self, problem: Problem, system: System, options: Options) -> None:
        if problem.dependent:
            raise CapabilityError(
                f"joint {problem.gates[0].joint!r} has friction with 'law: set_valued' or a rigid stop, which needs "
                f"loops without redundant rows (here {', '.join(problem.dependent[0].rows)} depend on each other); "
                "allowed: 'transition_speed', and stops with 'stiffness'"
            )
        self.problem, self.system, self.options = problem, system, options
        self.gates = problem.gates
        self.p = np.array(system.parameters)
        self._rates = SampleKernel({"a": list(problem.forward.qdd), "lam": problem.holding}, GROUPS)
        matrices = {"M": list(problem.mass_matrix.ravel()), "psi": list(problem.psi.ravel())}
        self._matrices = SampleKernel({k: v for k, v in matrices.items() if v}, GROUPS)
        self._first = len(system.events) - len(mode_events(problem))
        self._where = [(k, what) for k, gate in enumerate(self.gates) for what in _events_of(gate)]
        self.mode: list[int] = [0] * len(self.gates)
        self.rest: set[int] = set()
        self.contact: dict[int, float] = {}
        self.log: list[dict[str, Any]] = []
        self.counts: Counter[str] = Counter()
        self._flight = np.inf
        self._integrator: Integrator | None = None
        self._fastest = 0.0
        self._known_held: set[int] = set()
        self._recent: deque[float] = deque(maxlen=CROWD)
        self._inertia = np.ones(problem.model.nv)

    # -- places ---------------------------------------------------------------------------------------
    def _q(self, gate: Gate) -> int:
        return self.system.q_places[gate.q]

    def _v(self, gate: Gate) -> int:
        return self.system.v_places[gate.v]

    def rates(self, t: float, x: Array) -> tuple[Array, Array]:
        """Return accelerations (nv,) and multipliers of held joints in the present modes."""
        found = self._rates.evaluate(1, self.system.groups(np.array([[t]]), x[None, :], self.p))
        return found["a"][0], found["lam"][0]

    # -- a run ----------------------------------------------------------------------------------------
    def start(self, t: float, x: Array) -> Array:
        """Find the modes of the state x that a run starts from; returns the state, changed by an impact.

        Raises
        ------
        SceneError : a joint is beyond a stop. CapabilityError : more joints could stick than the mechanism has
        degrees of freedom, so that their forces would not be unique.
        """
        x = x.copy()
        self._check_freedom(t, x)
        self._settle_speeds(x)
        for k, gate in enumerate(self.gates):
            place = self._q(gate)
            for push, at in gate.stops:
                depth = push * (at - x[place])
                if depth > AT_STOP * max(1.0, abs(at)):
                    raise SceneError(
                        f"{self.problem.scene.path}: initial.q: joint {gate.joint!r} starts at {x[place]:.9g}, beyond "
                        f"its stop at {at:.9g}",
                        file=self.problem.scene.path, key="initial.q",
                    )  # fmt: skip
                if abs(depth) <= AT_STOP * max(1.0, abs(at)) and push * x[self._v(gate)] <= 0.0:
                    x = self._strike(t, x, k, push, at)
        self._settle(t, x, {})
        self._write()
        return x

    def _check_freedom(self, t: float, x: Array) -> None:
        sticking = [gate for gate in self.gates if gate.friction is not None]
        psi = self._numbers(t, x)[1]
        units = np.zeros((len(sticking), psi.shape[1]))
        units[np.arange(len(sticking)), [gate.v for gate in sticking]] = 1.0
        rows = np.concatenate([psi, units])
        if len(sticking) and np.linalg.matrix_rank(rows, tol=1e-9) < len(rows):
            names = ", ".join(gate.joint for gate in sticking)
            free = psi.shape[1] - np.linalg.matrix_rank(psi, tol=1e-9)
            raise CapabilityError(
                f"friction with 'law: set_valued' in {names}: with {free} degrees of freedom left by loops and "
                "prescribed motion, their forces at rest would not be unique; allowed: fewer such joints, none of them "
                "prescribed, or 'transition_speed' in the others"
            )

    def _numbers(self, t: float, x: Array) -> tuple[Array, Array]:
        """Return the mass matrix and Psi."""
        found = self._matrices.evaluate(1, self.system.groups(np.array([[t]]), x[None, :], self.p))
        nv = self.problem.model.nv
        return found["M"].reshape(nv, nv), found.get("psi", np.zeros(0)).reshape(-1, nv)

    def attach(self, integrator: Integrator) -> None:
        """Let an integrator step with the present modes, and its event functions start from their sides."""
        self._integrator = integrator
        integrator.p[:] = self.p
        integrator.set_state(integrator.state, self._signs(), self._flight)

    def owns(self, event: Event) -> bool:
        """Tell whether an event is one of modes."""
        return event.index >= self._first

    def on_event(self, event: Event) -> bool:
        """Change modes and state at an event; the run goes on."""
        assert self._integrator is not None
        t, x = event.time, event.state.copy()
        k, what = self._where[event.index - self._first]
        gate = self.gates[k]
        self._recent.append(t)
        if len(self._recent) == CROWD and t - self._recent[0] < CROWDED * max(1.0, t):
            raise NumericalError(
                f"joint {gate.joint!r} and others change between rest and motion without end at t = {t:.6g} s",
                time=t, status="chatter",
            )  # fmt: skip
        forced: dict[int, int] = {}
        self._flight = np.inf
        if what in ("lower", "upper"):
            push, at = next(s for s in gate.stops if (s[0] > 0.0) == (what == "lower"))
            if push * x[self._v(gate)] <= 0.0 and k not in self.contact:
                x = self._strike(t, x, k, push, at)
        elif what == "rest":
            if k not in self.rest:
                x[self._v(gate)] = 0.0
                self.rest.add(k)
        elif k in self.rest:
            forced[k] = -1 if what == "high" else 1
        self._settle(t, x, forced)
        self._write()
        self._integrator.p[:] = self.p
        self._integrator.set_state(x, self._signs(), self._flight)
        return True

    def check(self, t: Array, x: Array) -> None:
        """Refuse states (T, nx) that contradict the modes: an event was missed.

        Raises
        ------
        NumericalError : with the joint and the time.
        """
        q, v, _ = self.system.split(x)
        self._fastest = max(self._fastest, float(np.abs(v).max(initial=0.0)))
        for k, gate in enumerate(self.gates):
            wrong = np.zeros(len(t), dtype=bool)
            for push, at in gate.stops:
                wrong |= push * (q[:, gate.q] - at) < -MISSED * max(1.0, abs(at))
            if gate.friction is not None:
                wrong |= self.mode[k] * v[:, gate.v] < -MISSED * self._fastest
            if wrong.any():
                when = float(t[int(np.argmax(wrong))])
                raise NumericalError(
                    f"an event of joint {gate.joint!r} before t = {when:.6g} s was missed; a tighter tolerance "
                    "finds it",
                    time=when, status="missed_event",
                )  # fmt: skip

    # -- modes ----------------------------------------------------------------------------------------
    def _settle_speeds(self, x: Array) -> None:
        """Sort the joints by their rates: those at rest, and the directions of the others."""
        v = x[list(self.system.v_places)]
        still = AT_REST * float(np.abs(v).max(initial=0.0))
        for k, gate in enumerate(self.gates):
            place = self._v(gate)
            if abs(x[place]) <= still and (gate.friction is not None or k in self.contact):
                x[place] = 0.0
                self.rest.add(k)
                continue
            self.rest.discard(k)
            self.contact.pop(k, None)
            self.mode[k] = int(np.sign(x[place]))

    def _bounds(self, k: int) -> tuple[float, float]:
        """Return the range of the multiplier that can hold a joint."""
        forwards, backwards = self.gates[k].breakaway
        push = self.contact.get(k, 0.0)
        return (-UNBOUNDED if push < 0.0 else -forwards), (UNBOUNDED if push > 0.0 else backwards)

    def _write(self) -> None:
        """Write the modes into the parameters."""
        for k, gate in enumerate(self.gates):
            held = k in self.rest and self.mode[k] == HELD
            direction = 0.0 if held or gate.friction is None else float(self.mode[k])
            self.p[gate.place : gate.place + 4] = [float(held), direction, *self._bounds(k)]

    def _settle(self, t: float, x: Array, forced: dict[int, int]) -> None:
        """Find the modes of the joints at rest; ``forced`` are known to move, in these directions."""
        before = {k: self.mode[k] for k in self.rest}
        still = sorted(self.rest)
        for k in still:
            self.mode[k] = forced.get(k, HELD)
        if still:
            self._inertia = 1.0 / np.diag(np.linalg.inv(self._numbers(t, x)[0]))
            self._pivot(t, x, still)
        for k in still:
            if self.mode[k] != HELD:
                self.rest.discard(k)
                left = self.contact.pop(k, None) is not None
                self._note(t, "release" if left else "slip", k, direction=self.mode[k])
            elif before.get(k) != HELD or k not in self._known_held:
                self._note(t, "contact" if k in self.contact else "stick", k)
        self._known_held = set(self.rest)

    def _pivot(self, t: float, x: Array, still: list[int]) -> None:
        """Change the mode that is most wrong until none is; try all combinations where that goes in circles."""
        seen = set()
        while True:
            wrong = self._wrong(t, x, still)
            if not wrong:
                return
            seen.add(tuple(self.mode[k] for k in still))
            _, k, mode = max(wrong)
            self.mode[k] = mode
            if tuple(self.mode[j] for j in still) in seen:
                break
        options = [[HELD, *self._directions(k)] for k in still]
        for modes in itertools.islice(itertools.product(*options), COMBINATIONS):
            for k, mode in zip(still, modes):
                self.mode[k] = mode
            if not self._wrong(t, x, still):
                return
        names = ", ".join(self.gates[k].joint for k in still)
        raise NumericalError(
            f"no modes of the joints at rest ({names}) are consistent at t = {t:.6g} s",
            time=t,
            status="modes",
        )

    def _directions(self, k: int) -> list[int]:
        """Return the directions in which a joint at rest may move off."""
        push = self.contact.get(k)
        return [1, -1] if push is None else [int(push)]

    def _wrong(self, t: float, x: Array, still: list[int]) -> list[tuple[float, int, int]]:
        """Return what contradicts the modes: (by how much, joint, the mode that it asks for)."""
        self._write()
        a, lam = self.rates(t, x)
        if not (np.all(np.isfinite(a)) and np.all(np.isfinite(lam))):
            names = ", ".join(self.gates[k].joint for k in still)
            raise NumericalError(
                f"the forces in the joints at rest ({names}) are not unique at t = {t:.6g} s",
                time=t,
                status="modes",
            )
        largest = max(float(np.abs(lam).max()), *(max(g.breakaway) for g in self.gates), 1e-300)
        found = []
        for k in still:
            low, high = self._bounds(k)
            if self.mode[k] == HELD:
                over, under = (lam[k] - high) / largest, (low - lam[k]) / largest
                if max(over, under) > FORCE:
                    found.append((float(max(over, under)), k, -1 if over > under else 1))
                continue
            # the force that would have to be added for the joint not to move against its direction
            short = -self.mode[k] * a[self.gates[k].v] * self._inertia[self.gates[k].v] / largest
            if short > FORCE:
                found.append((float(short), k, HELD))
        return found

    # -- impacts --------------------------------------------------------------------------------------
    def _strike(self, t: float, x: Array, k: int, push: float, at: float) -> Array:
        """Return the state after joint k has met a stop; it rests there if it would not leave it any more."""
        gate, s = self.gates[k], self.system
        x = x.copy()
        x[self._q(gate)] = at
        if x[self._v(gate)] == 0.0:
            self.contact[k] = push
            self.rest.add(k)
            return x
        M, psi = self._numbers(t, x)
        places = list(s.v_places)
        v = x[places]
        resting = {self.gates[j].v: side for j, side in self.contact.items() if j != k}

        def after(e: float, kept: Collection[int] = ()) -> Array:
            new = impact(M, psi, v, gate.v, push, e, resting, kept)
            y = x.copy()
            y[places] = new
            if s.further:
                y[s.size - s.further] += 0.5 * float(new @ M @ new - v @ M @ v)
            return y

        bounced = after(gate.restitution)
        speed = push * bounced[self._v(gate)]
        torn = np.abs(psi @ (bounced[places] - v)).max(initial=0.0)
        if torn > MISSED * np.abs(psi).max(initial=0.0) * abs(v[gate.v]):
            raise NumericalError(
                f"joint {gate.joint!r} runs into its rigid stop at t = {t:.6g} s, and prescribed motion or loops "
                "force it on",
                time=t, status="blocked",
            )  # fmt: skip
        saved = set(self.rest), dict(self.contact), list(self.mode)
        self._settle_speeds(bounced)
        self._write()
        a = self.rates(t, bounced)[0]
        toward = -push * float(a[gate.v])
        height = self.options.atol + self.options.rtol * abs(at)
        # a method of fixed step cannot follow flights that are short beside it
        briefest = FLIGHT * (self.options.step or 0.0)
        low = speed * speed < 2.0 * toward * height or speed < briefest * toward
        if speed <= 0.0 or (toward > 0.0 and low):
            self.rest, self.contact, self.mode = saved
            # joints that would leave their stops by less than this height rest on, or they would hit each other off
            most = float(np.abs(a).max())
            slow = max(np.sqrt(2.0 * height * most), briefest * most)
            bounced = after(0.0)
            bounced = after(0.0, [j for j in resting if abs(bounced[places[j]]) <= slow])
            bounced[self._v(gate)] = 0.0
            self.contact[k] = push
            self._settle_speeds(bounced)
        elif toward > 0.0:
            self._flight = FLIGHT * 2.0 * speed / toward
        lost = 0.5 * float(v @ M @ v - bounced[places] @ M @ bounced[places])
        self._note(t, "impact", k, speed=float(abs(v[gate.v])), energy_lost=lost)
        return bounced

    def _signs(self) -> dict[int, float]:
        """Return the side from which each event function of modes starts, where that is known."""
        signs = {}
        for i, (k, what) in enumerate(self._where):
            held = k in self.rest
            stop = what in ("lower", "upper") and not (
                held and k in self.contact and (self.contact[k] > 0.0) == (what == "lower")
            )
            rest = what == "rest" and not held and self.mode[k] != 0
            hold = what in ("high", "low") and held
            if stop or rest or hold:
                signs[self._first + i] = 1.0
        return signs

    def _note(self, t: float, kind: str, k: int, **details: Any) -> None:
        self.counts[kind] += 1
        self.log.append({"time": t, "name": self.gates[k].joint, "kind": kind, **details})


def _events_of(gate: Gate) -> list[str]:
    """Return what the events of a joint mean, in the order of ``mode_events``."""
    stops = ["lower" if push > 0.0 else "upper" for push, _ in gate.stops]
    return [*stops, *(["rest"] if gate.friction is not None else []), "high", "low"]
