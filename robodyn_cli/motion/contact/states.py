"""Sticking, slipping, impacts and contact along a motion: what events do to the contact states of joints.

After each event the states of the joints at rest are found anew, all together (see ``joint_states``).
"""

from __future__ import annotations

import copy
from collections.abc import Collection

import numpy as np

from robodyn_cli.equations.contact_joints import ContactJoint
from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.formulations.events import Event, Jump, Outcome
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion.contact.checks import refuse_blocked, refuse_missed
from robodyn_cli.motion.contact.events import STOPS, ContactFunction, Transition, known_sides
from robodyn_cli.motion.contact.impact import Impact, halted, is_lost
from robodyn_cli.motion.contact.joint_states import AT_REST, CROWD, JointStates
from robodyn_cli.spatial.algebra import Array

AT_STOP = 1e-12  # a joint this close to a stop, relative to its position, is at it
CASCADE = 1000  # impacts at one instant, each caused by the one before
CROWDED = 1e-5  # the part of the time so far (or of a second) within which a crowd of events gets nowhere
LATER = 0.1  # a second integration follows bounces longer, or both would come to rest after the same one
FLIGHT = 1 / 8  # the first step after an impact, as a part of the time to the next one


class ContactStates(JointStates):
    """The contact states of one run, and what events do to them.

    A joint rests on a stop when its next bounce would be lower and slower than the tolerances, or shorter than a fixed
    step resolves.
    """

    slowest = 1.0  # times the rate below which a joint does not bounce any more

    def again(self) -> ContactStates:
        other = copy.copy(self)
        other.slowest = LATER
        other._clear()
        return other

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
                        f"joint {joint.name!r} starts at {x[place]:.9g}, beyond "
                        f"its stop at {at:.9g}", (self.problem.scene.path, "initial.q"),
                        file=self.problem.scene.path, key="initial.q",
                    )  # fmt: skip
                if abs(depth) <= AT_STOP * max(1.0, abs(at)) and push * x[self._v(joint)] <= 0.0:
                    x = self._strike(t, x, k, push, at)
        self._settle(t, x, {})
        self._write()
        return x

    def arm(self, x: Array) -> Outcome:
        """Return the present contact states, and the sides from which event functions start."""
        return Jump(
            x,
            self.p,
            known_sides(self.functions, self.state, self.rest, self.contact, self.carried),
            self._flight,
        )

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
            over = function.transition is Transition.BREAK_HIGH
            forced[k] = -1 if over else 1
            if self.carried:
                relieved = self._relieve(t, x, k, over)
                if relieved is None:
                    return self.arm(x)
                forced = relieved
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
