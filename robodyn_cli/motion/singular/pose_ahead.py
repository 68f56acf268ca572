"""Poses ahead of a motion in which the loops' constraints lose rank: where they are, and the leap over them.

The singular values of Psi fall towards such a pose, as the distance does, all those that vanish there at once. They are
followed from one side and extrapolated to zero; where they are about to vanish, a leap (``leap.py``) proves that the
motion goes on along one smooth branch, or is refused: the motion comes near such a pose only, or is not smooth there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robodyn_cli.motion.singular.leap import (
    EPS,
    LOST,
    Collocation,
    LeapEquations,
    LeapState,
    NotSmooth,
    PoseLeap,
)
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

NODES = 16  # of a leap
REACH = 0.4  # joint angle [rad] that a leap covers on either side of the pose, at most
FIRST = 0.02  # first step of the approach, in angle [rad], at most
STEPS = 80  # of the approach
FAR = 3.0  # times the reach of a leap that a pose may be away; the next threshold comes closer
REFUSED = 4  # leaps, each shorter than the one before, after which the pose is not passed
SHORTER = 1 / 3
SETTLED = 0.05  # change of the predicted time of the pose, over the time to it, at which it is believed
CLOSED = 20.0  # roundings of the positions that the constraints may be off between nodes
OPENED = 2e-12  # and what conditioning may add to that, at most [rad, m]
TAIL = 1e-9  # the last coefficients of positions, over their size, at most
SMALL_ROW = 0.1  # part of the largest row of Psi below which a row is not scaled by its own size


@record
class PoseAhead:
    """A pose in which ``lost`` constraint directions vanish at ``time``, and the leap over it."""

    time: float
    lost: int
    leap: PoseLeap

    @property
    def state(self) -> LeapState:
        """The state in the pose."""
        return LeapState(self.time, *(x[0] for x in self.leap.at(np.array([self.time]))))

    @property
    def regular_until(self) -> float:
        """Until when the motion can be integrated as usual [s]."""
        return self.leap.start.time


@record
class Unresolved:
    """A pose that no smooth branch leads over, as far as can be told: the state towards it carried on to it, and why.

    regular_until : until when the motion could be integrated as usual [s].
    """

    state: LeapState
    regular_until: float
    reason: str

    @property
    def time(self) -> float:
        return self.state.time


class PoseApproach:
    """Follows a motion towards a possible loss of rank.

    Parameters
    ----------
    advance : integrates on to a time and returns the state there.
    turning : which velocity coordinates are angular rates.
    nodes, reach : of a leap. check : refuses a leap over a pose at a time (NotSmooth).
    """

    def __init__(
        self,
        equations: LeapEquations,
        advance: Callable[[float], LeapState],
        turning: Array,
        nodes: int,
        reach: float,
        check: Callable[[PoseLeap, float], None] = lambda leap, pose: None,
    ) -> None:
        self.equations, self.advance, self.turning, self.check = equations, advance, turning, check
        self.nodes, self.reach = nodes, reach

    def pose_ahead(self, state: LeapState, end: float) -> PoseAhead | Unresolved | None:
        """Return the pose that the motion from ``state`` runs into before ``end``, None where it passes by.

        The approach itself may go beyond ``end`` by as much as a leap does.
        """
        self.states: list[LeapState] = [state]
        self.sigma: list[Array] = [self._sigma(state)]
        refusals, allowed, reason = 0, np.inf, ""
        predicted: float | None = np.inf
        first = self._first_step(state)
        for _ in range(STEPS):
            here = self.states[-1]
            before, predicted = predicted, self._predicted()
            if predicted is None or before is None:
                return None
            left = predicted - here.time
            if refusals and self.sigma[-1][-1] < LOST * self.sigma[-1][0]:
                return self._unresolved(predicted, reason)
            reach = min(self._reach(here), allowed)
            settled = abs(predicted - before) < SETTLED * left
            if here.time > end or FAR * reach < left < np.inf:
                return None
            if len(self.states) > 3 and left <= reach and settled:
                if here.time + left - 0.1 * left > end:
                    return None
                try:
                    return self._leap(here, predicted)
                except NotSmooth as refusal:
                    reason, refusals = str(refusal), refusals + 1
                    allowed = SHORTER * left
                    if refusals == REFUSED:
                        return self._refused(end, reason)
            self._go_on(min(first if len(self.states) == 1 else 0.25 * left, 0.25 * self._reach(here)))
        return None

    def _unresolved(self, time: float, reason: str) -> Unresolved:
        """Return the pose at ``time`` by carrying on the last two states."""
        before, last = self.states[-2:]
        part = (time - last.time) / (last.time - before.time)
        q, v, z = (
            b + part * (b - a) for a, b in ((before.q, last.q), (before.v, last.v), (before.z, last.z))
        )
        return Unresolved(LeapState(time, q, v, z), last.time, reason)

    def _first_step(self, state: LeapState) -> float:
        """Return a step [s] that is short beside the way to the pose, which may be close after an impact."""
        speed = float(np.abs(state.v).max(initial=0.0))
        away = float(self.sigma[0][-1] / self.sigma[0][0])  # about as many radians
        return min(FIRST, 0.5 * away) / speed if speed > 0.0 else 1e-3

    def _reach(self, state: LeapState) -> float:
        """Return the time in which the joints turn by ``reach`` [s]; without turning joints there is no bound."""
        speed = float(np.abs(state.v[self.turning]).max(initial=0.0))
        return self.reach / speed if speed > 0.0 else np.inf

    def _sigma(self, state: LeapState) -> Array:
        return self.equations.singular_values(np.array([state.time]), state.q[None])[0]

    def _go_on(self, step: float) -> None:
        self.states.append(self.advance(self.states[-1].time + step))
        self.sigma.append(self._sigma(self.states[-1]))

    def _predicted(self) -> float | None:
        """Return when the smallest singular value comes to zero, by a polynomial through the last ones.

        Returns infinity while there are too few of them, None where it grows.
        """
        t = np.array([s.time for s in self.states[-5:]])
        y = np.array([sigma[-1] for sigma in self.sigma[-5:]])
        if len(t) < 2:
            return np.inf
        if not y[-1] < y[-2]:
            return None
        secant = (t[-1] - t[-2]) * y[-1] / (y[-2] - y[-1])
        fit = np.polynomial.Polynomial.fit(t, y, min(3, len(t) - 1))
        roots = fit.roots()
        real = roots[np.abs(roots.imag) < 1e-3 * (np.abs(roots.real - t[-1]) + 1e-300)].real
        ahead = real[real > t[-1]]
        return float(ahead.min()) if len(ahead) else float(t[-1] + secant)

    def _leap(self, here: LeapState, predicted: float) -> PoseAhead | None:
        """Return the pose and the leap centred on it.

        Raises
        ------
        NotSmooth : there is none.
        """
        centre = predicted
        for _ in range(3):
            leap = self._tried(here, 2.0 * (centre - here.time))
            located = self._located(leap, centre)
            if abs(located - centre) < 0.01 * leap.length:
                break
            centre = located
        q = leap.at(np.array([located]))[0]
        sigma = self.equations.singular_values(np.array([located]), q)[0]
        lost = int((sigma < LOST * sigma[0]).sum())
        if not lost:
            raise NotSmooth("the constraints keep their rank")
        self.check(leap, located)
        return PoseAhead(located, lost, leap)

    def _tried(self, here: LeapState, length: float) -> PoseLeap:
        leap = Collocation(self.equations, here, length, self.nodes).solve(self.states)
        size = 1.0 + float(np.abs(here.q).max())
        if not leap.tail <= TAIL * size:
            raise NotSmooth(f"the motion is not smooth there ({leap.tail:.1g} rad or m in its last terms)")
        t = here.time + length * np.linspace(0.0, 1.0, 2 * self.nodes + 1)
        eta, psi = self.equations.constraints(t, leap.at(t)[0])
        rows = np.linalg.norm(psi, axis=2).max(axis=0)
        apart = float((np.abs(eta) / np.maximum(rows, SMALL_ROW * rows.max())).max())
        smallest = float(self.equations.singular_values(leap.middle, leap.at(leap.middle)[0])[:, -1].min())
        allowed = CLOSED * EPS * np.sqrt(len(here.q)) * size + min(3.0 * EPS / smallest, OPENED)
        if not apart <= allowed:
            raise NotSmooth(f"the loops would open by {apart:.1g} rad or m in between")
        return leap

    def _located(self, leap: PoseLeap, centre: float) -> float:
        """Return where the smallest singular value of a leap has its V."""
        h = 0.05 * leap.length
        for _ in range(7):
            t = np.array([centre - h, centre + h])
            low, high = self.equations.singular_values(t, leap.at(t)[0])[:, -1]
            centre += h * float((low - high) / (low + high + 1e-300))
            h /= 3.0
        return float(centre)

    def _refused(self, end: float, reason: str) -> Unresolved | None:
        """Go on in ordinary steps: past a minimum of the singular value, or into the pose."""
        for _ in range(STEPS):
            predicted = self._predicted()
            if predicted is None or self.states[-1].time > end:
                return None
            if self.sigma[-1][-1] < LOST * self.sigma[-1][0]:
                return self._unresolved(predicted, reason)
            self._go_on(0.5 * (predicted - self.states[-1].time))
        return self._unresolved(self.states[-1].time, reason)
