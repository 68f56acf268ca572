"""Work of torques that a sampled controller holds, and how long they are at limits.

Between two changes a torque is one number, so its net work there is exactly tau (q_2 - q_1); only where the rate
changes its sign is it driving and braking. Samples of a run may lie on the changes, and then look smooth: what jumps
between them shows in no difference of theirs. So each stretch between two samples is taken apart where the torque
changes, at a place that is known:

    |---- s ----|-- r --|      q is a cubic on either side, with the stated position, rate and acceleration at its own
    t_1         u      t_2     sample; position and rate are the same on both sides of u, which decides both jerks

Nothing is said where a torque acts between two samples that neither of them shows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.control.control import Control
from robodyn_cli.record import record
from robodyn_cli.solve.extremes import Extreme
from robodyn_cli.spatial.algebra import Array

AT = 1e-9  # of a period: samples so near to a change show what it has set
ROUNDED = 4e-16  # of a position
LEAST = 4  # samples that have third differences


@record
class HeldStretches:
    """What lies between samples of held torques.

    s, r : how long the torque of the first sample acts, then that of the second (N,) [s]. hidden : where others
    act too.
    """

    s: Array
    r: Array
    hidden: Array

    @staticmethod
    def of(control: Control, t: Array) -> HeldStretches:
        """Return the stretches between samples at times (T,) of the torques of a sampled controller."""
        assert control.period is not None
        period = float(control.period)
        passed = np.floor((t - control.rest) / period + AT)  # number of the last change
        h = np.diff(t)
        changes = np.diff(passed)
        s = np.where(changes > 0.0, (passed[:-1] + 1.0) * period + control.rest - t[:-1], h)
        s = np.where(h - s < AT * period, h, np.maximum(s, 0.0))
        return HeldStretches(s, h - s, changes > 1.0)

    def at_limits(self, at: Array) -> tuple[Array, Array]:
        """Return how long (n,) what samples (T, n) tell is so, none of which hides a torque, and how far that may be
        off [s]."""
        s, r = self.s[:, None], self.r[:, None]
        long = s * at[:-1] + r * at[1:]
        return long.sum(axis=0), np.sum(AT * (s + r) * (at[1:] != at[:-1]), axis=0)


@record
class HeldJoints:
    """Driven joints at samples: position, rate, acceleration and the torque that is held (T, n)."""

    q: Array
    v: Array
    a: Array
    tau: Array

    def at(self, which: slice) -> HeldJoints:
        """Return some of the samples."""
        return HeldJoints(self.q[which], self.v[which], self.a[which], self.tau[which])


def driven_paths(control: Control) -> dict[str, list[int]]:
    """Return the datasets of position, rate, acceleration and torque of the driven joints, with their columns."""
    names = control.problem.model.q_names
    q, tau = [names.index(name) for name in control.joints], list(range(len(control.joints)))
    return {"q": q, "qd": control.places, "qdd": control.places, "control/torque": tau}


def held_work(
    between: HeldStretches, driven: HeldJoints, t: Array, events: Sequence[float]
) -> tuple[float, float, float]:
    """Return the work while held torques drive and while they brake, and how far either may be off [J].

    between : the stretches of samples at times t (T,), none of which hides a torque. events : times [s] at which rates
    may jump.
    """
    one, two = driven.at(slice(None, -1)), driven.at(slice(1, None))
    net, size, off = _works(between, one, two)
    h = np.diff(t)[:, None]
    most = np.abs(one.tau) + np.abs(two.tau)
    met = np.diff(np.searchsorted(np.sort(events), t, side="right"))[:, None] > 0
    fastest = np.maximum(np.abs(one.v), np.abs(two.v)) + h * np.maximum(np.abs(one.a), np.abs(two.a))
    off = off + met * h * most * fastest
    off = off + ROUNDED * most * np.abs(driven.q).max(axis=0, initial=0.0)
    return 0.5 * float((size + net).sum()), 0.5 * float((size - net).sum()), float(off.sum())


def tracked_between(t: Array, y: Array, rms_error: Array, peak: Extreme) -> tuple[Array, Extreme]:
    """Return errors of root mean squares (n,), and largest magnitudes, of y (T, n) with second derivatives that may
    jump at every sample (T,): |D| / 8 more, D the third differences.

    A second derivative that jumps by J at each sample, h apart, has D = J h^2, and parts from a smooth function through
    the samples by less than J h^2 / 100; one jump has D = J h^2 / 2, and parts by less than J h^2 / 16.
    """
    if len(t) < LEAST:
        return rms_error, peak
    third = np.pad(np.abs(np.diff(y, 3, axis=0)) / 8.0, ((3, 3), (0, 0)))
    own = np.max([third[k : k + len(t)] for k in range(4)], axis=0)  # of the samples that take part in each
    at = np.clip(np.searchsorted(t, peak.time), 1, len(t) - 2)
    columns = np.arange(y.shape[1])
    size = np.abs(y)
    near, bend = (
        own[at, columns],
        np.abs(size[at + 1, columns] - 2.0 * size[at, columns] + size[at - 1, columns]),
    )
    # a magnitude that falls from the first sample, or rises to the last, is largest there whatever lies between
    falls = (peak.time == t[0]) & (size[0] - size[1] > 4.0 * near)
    rises = (peak.time == t[-1]) & (size[-1] - size[-2] > 4.0 * near)
    ends = falls | rises
    more = np.where(ends, 0.0, near)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.where(more > 0.0, np.minimum(1.0, 4.0 * near / bend), 0.0) * np.diff(t).max()
    elsewhere = np.where(ends, 0.0, (size + own).max(axis=0) - peak.value)
    value = np.maximum(peak.error + more, elsewhere)
    return rms_error + np.sqrt(np.mean(own**2, axis=0)), dataclasses.replace(
        peak, error=value, time_error=peak.time_error + away
    )


def _works(between: HeldStretches, one: HeldJoints, two: HeldJoints) -> tuple[Array, Array, Array]:
    """Return the work of each stretch (N, n), the integral of the magnitude of its power, and how far these are off:
    by what polynomials of one degree less give otherwise."""
    s, r = between.s[:, None], between.r[:, None]
    h, whole = s + r, (r == 0.0) & np.ones_like(one.q, dtype=bool)
    cut, front = np.where(r > 0.0, r, 1.0), np.where(s > 0.0, s, 1.0)
    change = two.v - two.a * r - one.v - one.a * s
    gap = two.q - two.v * r + 0.5 * two.a * r**2 - one.q - one.v * s - 0.5 * one.a * s**2
    behind = 6.0 * (gap - change * s / 3.0) / (cut**2 * h)
    before = np.where(s > 0.0, (2.0 * change + behind * r**2) / front**2, 0.0)
    # in one piece the acceleration at its end is that behind a change: position and rate there decide
    beyond = two.q - one.q - one.v * h
    bend = 6.0 * (0.5 * (two.v - one.v) * h - beyond) / h**3
    first = np.where(whole, [one.v, (two.v - one.v) / h - bend * h, bend], [one.v, one.a, 0.5 * before])
    second = np.where(whole, 0.0, [two.v, -two.a + 0.0 * behind, 0.5 * behind])  # backwards in time
    rough = np.where(whole, 3.0 * (beyond - 0.5 * one.a * h**2) / h**3, 0.0)
    net_1, size_1 = _moved(first, s)
    net_2, size_2 = _moved(second, r)
    like_1, turns_1 = _moved(np.array([one.v, one.a, rough]), s)
    like_2, turns_2 = _moved(np.array([second[0], second[1], 0.0 * rough]), r)
    shared = like_1 + (two.q - one.q - like_1 - like_2) * s**3 / (s**3 + r**3)
    off = np.where(whole, 0.0, np.abs(two.tau - one.tau) * np.abs(net_1 - shared))
    for tau, net, size, like, turns in (
        (one.tau, net_1, size_1, like_1, turns_1),
        (two.tau, net_2, size_2, like_2, turns_2),
    ):
        back, back_like = (
            size - np.abs(net),
            turns - np.abs(like),
        )  # twice the way that is gone against the other
        off = off + np.abs(tau) * np.abs(back - back_like)
    work = one.tau * net_1 + two.tau * net_2
    return work, np.abs(one.tau) * size_1 + np.abs(two.tau) * size_2, off


def _moved(rate: Array, long: Array) -> tuple[Array, Array]:
    """Return the integrals (N, n) from 0 to ``long`` of rates c_0 + c_1 x + c_2 x^2 (3, N, n), and of their
    magnitudes."""
    c0, c1, c2 = rate
    root = np.sqrt(np.maximum(c1**2 - 4.0 * c2 * c0, 0.0))
    half = -0.5 * (c1 + np.where(c1 < 0.0, -root, root))
    with np.errstate(divide="ignore", invalid="ignore"):
        zeros = np.nan_to_num(np.array([half / c2, c0 / half]), nan=0.0, posinf=0.0, neginf=0.0)
    places = np.sort(np.clip(zeros, 0.0, long), axis=0)
    x = np.array([np.zeros_like(c0), *places, long + np.zeros_like(c0)])
    primitive = x * (c0 + x * (0.5 * c1 + x * c2 / 3.0))
    steps = np.diff(primitive, axis=0)
    return steps.sum(axis=0), np.abs(steps).sum(axis=0)
