"""Sticking, slipping, impacts and contact along a motion: what events do to the contact states of joints.

After each event the states of the joints at rest are found anew, all together: each is held with a multiplier within
its bounds, or moves off in a direction in which it does accelerate (a linear complementarity problem).
"""

from __future__ import annotations

import copy
import itertools
from collections import Counter, deque
from collections.abc import Collection
from typing import Any

import numpy as np

from robodyn_cli.equations.contact_joints import UNBOUNDED, ContactJoint
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.formulations.events import Event, Jump, Outcome
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.motion.contact.checks import check_freedom, refuse_blocked, refuse_missed
from robodyn_cli.motion.contact.events import (
    HELD,
    STOPS,
    ContactFunction,
    Transition,
    contact_functions,
    known_sides,
)
from robodyn_cli.motion.contact.impact import Impact, halted, is_lost
from robodyn_cli.motion.motion import Motion, Watcher
from robodyn_cli.ready.singularity import rank_tolerance
from robodyn_cli.spatial.algebra import Array

AT_STOP = 1e-12  # a joint this close to a stop, relative to its position, is at it
AT_REST = 1e-13  # a rate this small, relative to the largest, is zero
FORCE = 1e-9  # a multiplier may pass its bound by this part of the largest one, for rounding
COMBINATIONS = 6561  # of contact states that are tried where pivoting does not end
CASCADE = 1000  # impacts at one instant, each caused by the one before
CROWD, CROWDED = 1000, 1e-5  # so many events within this part of the time so far (or of a second) get nowhere
LATER = 0.1  # a second integration follows bounces longer, or both would come to rest after the same one
FLIGHT = 1 / 8  # the first step after an impact, as a part of the time to the next one


class ContactStates(Watcher):
    """The contact states of one run; ``p`` holds the parameters of the equations that say which are on.

    state : of each joint, HELD or its direction of motion. rest : joints at rest. contact : direction in which the stop
    pushes, of joints on one. counts : transitions that have happened, by kind.

    A joint rests on a stop when its next bounce would be lower and slower than the tolerances, or shorter than a fixed
    step resolves.
    """

    functions: tuple[ContactFunction, ...]
    changes_motion = True
    sets_start = True
    slowest = 1.0  # times the rate below which a joint does not bounce any more

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.joints = problem.contact_joints
        self.functions = contact_functions(problem, self)

    def follow(self, motion: Motion) -> None:
        """Make what is evaluated at events; see ``check_freedom`` for what is refused before anything is compiled."""
        self.system, q = motion.system, motion.assembled.q
        psi = self.problem.numbers(self.problem.psi, q).reshape(-1, self.problem.model.nv)
        check_freedom(self.joints, psi, rank_tolerance(self.problem, q))
        rates = {"a": list(self.problem.forward.qdd), "lam": self.problem.holding}
        self._rates = SampleKernel(rates, STATE_GROUPS)
        matrices = {"M": list(self.problem.mass_matrix.ravel()), "psi": list(self.problem.psi.ravel())}
        self._matrices = SampleKernel({k: v for k, v in matrices.items() if v}, STATE_GROUPS)
        self._clear()

    @property
    def kernels(self) -> dict[str, SampleKernel]:
        return {"accelerations and holding forces at events": self._rates, "impacts": self._matrices}

    def _clear(self) -> None:
        self.p = np.array(self.system.parameters)
        self.state: list[int] = [0] * len(self.joints)
        self.rest: set[int] = set()
        self.contact: dict[int, float] = {}
        self._log: list[dict[str, Any]] = []
        self.counts: Counter[str] = Counter()
        self._flight = np.inf
        self._fastest = 0.0
        self._load = 1e-300  # the largest multiplier so far
        self._known_held: set[int] = set()
        self._recent: deque[tuple[float, str]] = deque(maxlen=CROWD)
        self._inertia = np.ones(self.problem.model.nv)

    @property
    def log(self) -> list[dict[str, Any]]:
        return self._log

    def facts(self, end: float) -> dict[str, Any]:
        return {"transitions": dict(self.counts)}

    def again(self) -> ContactStates:
        other = copy.copy(self)
        other.slowest = LATER
        other._clear()
        return other

    # -- places ---------------------------------------------------------------------------------------
    def _q(self, joint: ContactJoint) -> int:
        return self.system.q_places[joint.q]

    def _v(self, joint: ContactJoint) -> int:
        return self.system.v_places[joint.v]

    def rates(self, t: float, x: Array) -> tuple[Array, Array]:
        """Return accelerations (nv,) and multipliers of held joints in the present contact states."""
        values = self._rates.evaluate(1, self._groups(t, x))
        return values["a"][0], values["lam"][0]

    def _groups(self, t: float, x: Array) -> dict[str, Array]:
        """Return the inputs of kernels at a state in the present contact states."""
        return self.system.at(t, x, self.p)

    # -- a run ----------------------------------------------------------------------------------------
    def begin(self, t: float, x: Array, options: Options) -> Array:
        """Find the contact states of the state x that a run starts from; returns x, changed by an impact.

        Raises
        ------
        SceneError : a joint is beyond a stop.
        """
        x = x.copy()
        self._clear()
        self.options = options
        self._settle_speeds(x)
        for k, joint in enumerate(self.joints):
            place = self._q(joint)
            for push, at in joint.stops:
                depth = push * (at - x[place])
                if depth > AT_STOP * max(1.0, abs(at)):
                    raise SceneError(
                        f"{self.problem.scene.path}: initial.q: joint {joint.name!r} starts at {x[place]:.9g}, beyond "
                        f"its stop at {at:.9g}",
                        file=self.problem.scene.path, key="initial.q",
                    )  # fmt: skip
                if abs(depth) <= AT_STOP * max(1.0, abs(at)) and push * x[self._v(joint)] <= 0.0:
                    x = self._strike(t, x, k, push, at)
        self._settle(t, x, {})
        self._write()
        return x

    def _mass_matrix_and_psi(self, t: float, x: Array) -> tuple[Array, Array]:
        """Return the mass matrix (nv, nv) and Psi (m, nv) at a state."""
        values = self._matrices.evaluate(1, self._groups(t, x))
        nv = self.problem.model.nv
        return values["M"].reshape(nv, nv), values.get("psi", np.zeros(0)).reshape(-1, nv)

    def arm(self, x: Array) -> Outcome:
        """Return the present contact states, and the sides from which event functions start."""
        return Jump(x, self.p, known_sides(self.functions, self.state, self.rest, self.contact), self._flight)

    def handle(self, event: Event) -> Outcome:
        """Change contact states and the state at an event; the run goes on."""
        function = event.function
        assert isinstance(function, ContactFunction)
        t, x, k = event.time, event.state.copy(), function.joint
        joint = self.joints[k]
        self._refuse_chatter(t, joint)
        forced: dict[int, int] = {}
        self._flight = np.inf
        if (push := STOPS.get(function.transition)) is not None:
            if k not in self.contact:
                x = self._strike_others(t, self._strike(t, x, k, push, dict(joint.stops)[push]), k)
        elif function.transition is Transition.REST:
            if k not in self.rest:
                self.rest.add(k)
                v = list(self.system.v_places)
                x[v] = halted(
                    self._mass_matrix_and_psi(t, x)[1], x[v], [self.joints[j].v for j in sorted(self.rest)]
                )
        elif k in self.rest:
            forced[k] = -1 if function.transition is Transition.BREAK_HIGH else 1
        self._settle(t, x, forced)
        self._write()
        return self.arm(x)

    def _refuse_chatter(self, t: float, joint: ContactJoint) -> None:
        self._recent.append((t, joint.name))
        if len(self._recent) == CROWD and t - self._recent[0][0] < CROWDED * max(1.0, t):
            names = ", ".join(sorted({name for _, name in self._recent}))
            raise NumericalError(
                f"contacts of {names} change without end at t = {t:.6g} s",
                time=t, status="chatter",
            )  # fmt: skip

    def see(self, t: Array, x: Array) -> None:
        """Refuse states (T, nx) that contradict the contact states, as an event was missed, by a NumericalError."""
        q, v, _ = self.system.split(x)
        self._fastest = max(self._fastest, float(np.abs(v).max(initial=0.0)))
        refuse_missed(self.joints, self.state, t, q, v, self._fastest)

    # -- contact states -------------------------------------------------------------------------------
    def _settle_speeds(self, x: Array) -> None:
        """Sort the joints by their rates: those at rest, and the directions of the others."""
        still = AT_REST * float(np.abs(x[list(self.system.v_places)]).max(initial=0.0))
        for k, joint in enumerate(self.joints):
            place = self._v(joint)
            if abs(x[place]) <= still and (joint.friction is not None or k in self.contact):
                x[place] = 0.0
                self.rest.add(k)
                continue
            self.rest.discard(k)
            self.contact.pop(k, None)
            self.state[k] = int(np.sign(x[place]))

    def _bounds(self, k: int) -> tuple[float, float]:
        """Return the range of the multiplier that can hold a joint."""
        forwards, backwards = self.joints[k].breakaway
        push = self.contact.get(k, 0.0)
        return (-UNBOUNDED if push < 0.0 else -forwards), (UNBOUNDED if push > 0.0 else backwards)

    def _write(self) -> None:
        """Write the contact states into the parameters."""
        for k, joint in enumerate(self.joints):
            held = k in self.rest and self.state[k] == HELD
            direction = 0.0 if held or joint.friction is None else float(self.state[k])
            self.p[joint.place : joint.place + 4] = [float(held), direction, *self._bounds(k)]

    def _settle(self, t: float, x: Array, forced: dict[int, int]) -> None:
        """Find the contact states of the joints at rest; ``forced`` are known to move, in these directions."""
        before = {k: self.state[k] for k in self.rest}
        still = sorted(self.rest)
        for k in still:
            self.state[k] = forced.get(k, HELD)
        if still:
            self._inertia = 1.0 / np.diag(np.linalg.inv(self._mass_matrix_and_psi(t, x)[0]))
            self._pivot(t, x, still)
        for k in still:
            if self.state[k] != HELD:
                self.rest.discard(k)
                left = self.contact.pop(k, None) is not None
                self._note(t, "release" if left else "slip", k, direction=self.state[k])
            elif before.get(k) != HELD or k not in self._known_held:
                self._note(t, "contact" if k in self.contact else "stick", k)
        self._known_held = set(self.rest)

    def _pivot(self, t: float, x: Array, still: list[int]) -> None:
        """Change the state that is most wrong until none is; try all combinations where that goes in circles."""
        seen = set()
        while True:
            wrong = self._wrong(t, x, still)
            if not wrong:
                return
            seen.add(tuple(self.state[k] for k in still))
            _, k, mode = max(wrong)
            self.state[k] = mode
            if tuple(self.state[j] for j in still) in seen:
                break
        options = [[HELD, *self._directions(k)] for k in still]
        for states in itertools.islice(itertools.product(*options), COMBINATIONS):
            for k, mode in zip(still, states):
                self.state[k] = mode
            if not self._wrong(t, x, still):
                return
        names = ", ".join(self.joints[k].name for k in still)
        raise NumericalError(
            f"no contact states of the joints at rest ({names}) are consistent at t = {t:.6g} s",
            time=t, status="modes",
        )  # fmt: skip

    def _directions(self, k: int) -> list[int]:
        """Return the directions in which a joint at rest may move off."""
        push = self.contact.get(k)
        return [1, -1] if push is None else [int(push)]

    def _wrong(self, t: float, x: Array, still: list[int]) -> list[tuple[float, int, int]]:
        """Return what contradicts the contact states: (by how much, joint, the state that it asks for)."""
        self._write()
        a, lam = self.rates(t, x)
        if not (np.all(np.isfinite(a)) and np.all(np.isfinite(lam))):
            names = ", ".join(self.joints[k].name for k in still)
            raise NumericalError(
                f"the forces in the joints at rest ({names}) are not unique at t = {t:.6g} s",
                time=t, status="modes",
            )  # fmt: skip
        strongest = max(float(np.abs(lam).max()), *(max(g.breakaway) for g in self.joints))
        # where a joint leaves its stop the multiplier is zero, and says nothing about the size of forces
        largest = max(strongest, self._load)
        contradictions = []
        for k in still:
            low, high = self._bounds(k)
            if self.state[k] == HELD:
                over, under = float(lam[k] - high) / largest, float(low - lam[k]) / largest
                if max(over, under) > FORCE:
                    contradictions.append((max(over, under), k, -1 if over > under else 1))
                continue
            # the force that would have to be added for the joint not to move against its direction
            short = -self.state[k] * a[self.joints[k].v] * self._inertia[self.joints[k].v] / largest
            if short > FORCE:
                contradictions.append((float(short), k, HELD))
        if not contradictions:
            self._load = largest
        return contradictions

    # -- impacts --------------------------------------------------------------------------------------
    def _strike(self, t: float, x: Array, k: int, push: float, at: float) -> Array:
        """Return the state after joint k has met a stop; it rests there if it would not leave it any more.

        A joint that another one's impact has thrown off may lie behind its stop by rounding while it leaves: it goes on
        or, where that flight would be lost, rests.
        """
        joint, s = self.joints[k], self.system
        x = x.copy()
        x[self._q(joint)] = at
        self._fastest = max(self._fastest, float(np.abs(x[list(s.v_places)]).max()))
        if x[self._v(joint)] == 0.0:
            self.contact[k] = push
            self.rest.add(k)
            return x
        places = list(s.v_places)
        resting = {self.joints[j].v: side for j, side in self.contact.items() if j != k}
        met = Impact(*self._mass_matrix_and_psi(t, x), x[places], joint.v, resting)
        leaves = push * met.v[joint.v] > 0.0
        bounced = x.copy() if leaves else self._struck(x, met, joint.restitution)
        speed = push * bounced[self._v(joint)]
        refuse_blocked(joint, t, met.psi, met.v, bounced[places])
        saved = set(self.rest), dict(self.contact), list(self.state)
        self._settle_speeds(bounced)
        self._write()
        a = self.rates(t, bounced)[0]
        toward = -push * float(a[joint.v])
        height, slow, briefest = self._least_bounce(at)
        low = is_lost(speed, toward, at, height, slow) or speed < briefest * toward
        if speed <= 0.0 or (toward > 0.0 and low):
            self.rest, self.contact, self.state = saved
            # joints that would leave their stops by less than this height rest on, or they would hit each other off
            most = float(np.abs(a).max())
            low_rate = max(np.sqrt(2.0 * height * most), briefest * most)
            free = met.after(0.0)
            bounced = self._struck(x, met, 0.0, [j for j in resting if abs(free[j]) <= low_rate])
            bounced[self._v(joint)] = 0.0
            self.contact[k] = push
            self._settle_speeds(bounced)
        elif toward > 0.0:
            self._flight = FLIGHT * 2.0 * speed / toward
        if not leaves:
            lost = met.lost(bounced[places])
            self._note(t, "impact", k, speed=float(abs(met.v[joint.v])), energy_lost=lost)
        return bounced

    def _struck(self, x: Array, met: Impact, restitution: float, kept: Collection[int] = ()) -> Array:
        """Return the state x (nx,) after an impact: velocities jump, and what energy is lost is work done."""
        y = x.copy()
        y[list(self.system.v_places)] = after = met.after(restitution, kept)
        if self.system.work_place is not None:
            y[self.system.work_place] -= met.lost(after)
        return y

    def _least_bounce(self, at: float) -> tuple[float, float, float]:
        """Return height [rad or m], speed and flight [s] of the least bounce that tolerances or fixed steps resolve."""
        height = self.slowest**2 * (self.options.atol + self.options.rtol * abs(at))
        slow = self.slowest * (self.options.atol + self.options.rtol * self._fastest)
        return height, slow, self.slowest * FLIGHT * (self.options.step or 0.0)

    def _strike_others(self, t: float, x: Array, last: int) -> Array:
        """Return the state after the impacts that an impact of joint ``last`` sets off at the same instant.

        Joints at their stops may throw each other on these again and again, in no time at all; the series ends where
        none runs into its stop any more.
        """
        for _ in range(CASCADE):
            rates = x[list(self.system.v_places)]
            slow = AT_REST * float(np.abs(rates).max(initial=0.0))
            running = [
                (k, push, at)
                for k, joint in enumerate(self.joints)
                for push, at in joint.stops
                if k != last
                and k not in self.contact
                and push * (x[self._q(joint)] - at) <= AT_STOP * max(1.0, abs(at))
                and push * x[self._v(joint)] < -slow
            ]
            if not running:
                return x
            last = running[0][0]
            x = self._strike(t, x, *running[0])
        names = ", ".join(joint.name for joint in self.joints if joint.stops)
        raise NumericalError(
            f"joints throw each other on their rigid stops without end at t = {t:.6g} s ({names})",
            time=t, status="chatter",
        )  # fmt: skip

    def _note(self, t: float, kind: str, k: int, **details: Any) -> None:
        """Note what happens to a joint; states that are found anew at one instant are told once."""
        told = {"time": t, "name": self.joints[k].name, "kind": kind, **details}
        if kind == "impact" or told not in itertools.takewhile(lambda x: x["time"] == t, self._log[::-1]):
            self.counts[kind] += 1
            self._log.append(told)
