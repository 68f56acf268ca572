"""Motions in extended precision, many of one family at a time: what the errors that runs print are held against.

The equations are written down here for each family (planar chains by absolute angles, Euler's equations, the pendulum
that an N-four-bar is), and integrated by Picard's iteration on Chebyshev nodes in numbers of 64 binary places: nothing
is shared with the program but the numbers of the scenes, as doubles. Two integrations with other nodes and windows
vouch for each other.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np

Array = Any  # of numpy.longdouble
LONG = np.longdouble
AVAILABLE = float(np.finfo(LONG).eps) < 1e-18
ROUNDS = 60  # of Picard's iteration, at most


@functools.cache
def nodes(count: int) -> tuple[Array, Array]:
    """Return Chebyshev nodes c (s,) in (0, 1), and the integrals of their polynomials from 0 to each and to 1 (s + 1, s)."""
    with mpmath.workdps(60):
        c = [(1 - mpmath.cos((2 * k + 1) * mpmath.pi / (2 * count))) / 2 for k in range(count)]
        # of shifted Chebyshev polynomials T_j(2x - 1), by the recursion of their integrals
        values = mpmath.matrix(count, count)
        integrals = mpmath.matrix(count + 1, count)

        def chebyshev(j: int, x: Any) -> Any:
            return mpmath.cos(j * mpmath.acos(2 * x - 1))

        def primitive(j: int, x: Any) -> Any:
            if j == 0:
                return x
            if j == 1:
                return x * x - x
            y = chebyshev(j + 1, x) / (j + 1) - chebyshev(j - 1, x) / (j - 1)
            return y / 4

        for j in range(count):
            for i, x in enumerate(c):
                values[j, i] = chebyshev(j, x)
                integrals[i, j] = primitive(j, x) - primitive(j, mpmath.mpf(0))
            integrals[count, j] = primitive(j, mpmath.mpf(1)) - primitive(j, mpmath.mpf(0))
        # f(x) = sum_i f_i l_i(x): the coefficients are values^-T f
        weights = integrals * (values.T) ** -1
        text = [[mpmath.nstr(weights[i, k], 40) for k in range(count)] for i in range(count + 1)]
        return np.array([LONG(mpmath.nstr(x, 40)) for x in c]), np.array(
            [[LONG(x) for x in row] for row in text]
        )


Rate = Callable[[Array], Array]  # states (..., B, n) to their rates


def integrate(rate: Rate, y: Array, times: Array, windows: int, count: int) -> Array:
    """Return the states (T, B, n) at uniform times (T,), with so many windows between two and nodes in each."""
    _, weights = nodes(count)
    h = (LONG(times[-1]) - LONG(times[0])) / LONG(len(times) - 1) / windows
    out = [y]
    k = np.broadcast_to(rate(y), (count, *y.shape))
    for _ in range(len(times) - 1):
        for _ in range(windows):
            before = np.inf
            for _ in range(ROUNDS):
                moved = h * np.tensordot(weights, k, axes=(1, 0))
                new = rate(y + moved[:-1])
                change = np.abs(new - k).max()
                k = new
                if change == 0.0 or (change >= before and change < 1e-15 * (1.0 + np.abs(k).max())):
                    break
                before = change
            y = y + h * np.tensordot(weights[-1], k, axes=(0, 0))
            k = np.broadcast_to(k[-1], k.shape)
        out.append(y)
    return np.stack(out)


@dataclasses.dataclass
class Truth:
    """States (T, B, n) and the doubt about each of them (T, B)."""

    states: Array
    doubt: Array


def truth(rate: Rate, y: Array, times: Array, windows: int) -> Truth:
    """Integrate twice: the tighter one has more windows and more nodes."""
    loose = integrate(rate, y, times, windows, 18)
    tight = integrate(rate, y, times, windows + (windows + 1) // 2, 20)
    return Truth(tight, np.maximum.accumulate(np.abs(tight - loose).max(axis=-1), axis=0))


def solve(A: Array, b: Array) -> Array:
    """Return x of A x = b (..., n), by elimination in the order of the rows: [[M, J^T], [J, 0]] needs no other."""
    A, b = A.copy(), b.copy()
    n = b.shape[-1]
    for k in range(n):
        factor = A[..., k + 1 :, k] / A[..., k, k, None]
        A[..., k + 1 :, k:] -= factor[..., None] * A[..., None, k, k:]
        b[..., k + 1 :] -= factor * b[..., k, None]
    for k in range(n - 1, -1, -1):
        b[..., k] = (b[..., k] - (A[..., k, k + 1 :] * b[..., k + 1 :]).sum(axis=-1)) / A[..., k, k]
    return b


# -- planar chains --------------------------------------------------------------------------------------------------
@dataclasses.dataclass
class Chain:
    """Planar chains of n links each, of which B are computed at a time: lengths, masses, centres of mass as complex
    numbers, moments of inertia about them (B, n); the tip is pinned to ``pin`` (B,) if given. Gravity [m/s^2] acts along -y."""

    length: Array
    mass: Array
    com: Array
    inertia: Array
    gravity: Array
    pin: Array | None = None

    def __post_init__(self) -> None:
        n = self.length.shape[1]
        self.arms = np.zeros(
            (len(self.length), n, n), dtype=np.clongdouble
        )  # of com k from link i: A[:, k, i]
        for k in range(n):
            self.arms[:, k, :k] = self.length[:, :k]
            self.arms[:, k, k] = self.com[:, k]
        self.M = np.einsum("bk,bki,bkj->bij", self.mass, self.arms.conj(), self.arms)
        self.first = np.einsum("bk,bki->bi", self.mass, self.arms)

    def rate(self, y: Array) -> Array:
        """Return the rates of absolute angles and their rates (..., B, 2n)."""
        n = self.length.shape[1]
        a, w = y[..., :n], y[..., n:]
        e = np.cos(a) + 1j * np.sin(a)
        turned = self.M * (e.conj()[..., :, None] * e[..., None, :])
        M = turned.real + np.eye(n, dtype=LONG) * self.inertia[:, None, :]
        # d/dt of sum A e^{ia} i w is sum A e^{ia} (i wd - w^2); projected on conj(i A e^{ia})
        h = (turned.imag * (w * w)[..., None, :]).sum(axis=-1)
        g = -self.gravity[:, None] * (self.first * e).real
        rest = g + h
        if self.pin is None:
            return np.concatenate([w, solve(M, rest)], axis=-1)
        tip = self.length * e  # i tip w = 0
        J = np.stack([-tip.imag, tip.real], axis=-2)
        bias = (tip * (w * w)).sum(axis=-1)
        whole = np.zeros((*M.shape[:-2], n + 2, n + 2), dtype=LONG)
        whole[..., :n, :n], whole[..., n:, :n], whole[..., :n, n:] = M, J, np.swapaxes(J, -1, -2)
        x = solve(whole, np.concatenate([rest, bias.real[..., None], bias.imag[..., None]], axis=-1))
        return np.concatenate([w, x[..., :n]], axis=-1)

    def start(self, q: Array, qd: Array) -> Array:
        """Return the state of joint coordinates and rates (B, n), closed by the last two links where a pin is."""
        a, w = np.cumsum(LONG(q), axis=1), np.cumsum(LONG(qd), axis=1)
        if self.pin is None:
            return np.concatenate([a, w], axis=1)
        for _ in range(6):
            e = self.length * (np.cos(a) + 1j * np.sin(a))
            a[:, -2:] -= self._two(e, e.sum(axis=1) - self.pin)
        e = self.length * (np.cos(a) + 1j * np.sin(a))
        w[:, -2:] -= self._two(e, (1j * e * w).sum(axis=1))
        return np.concatenate([a, w], axis=1)

    @staticmethod
    def _two(e: Array, gap: Array) -> Array:
        """Return x of i e_1 x_1 + i e_2 x_2 = gap for the last two links (B, 2)."""
        (a, b), g = (1j * e[:, -2], 1j * e[:, -1]), gap
        det = a.real * b.imag - a.imag * b.real
        return (
            np.stack([g.real * b.imag - g.imag * b.real, a.real * g.imag - a.imag * g.real], axis=1)
            / det[:, None]
        )

    @staticmethod
    def joints(states: Array) -> tuple[Array, Array]:
        """Return joint coordinates and rates (T, B, n) of states."""
        n = states.shape[-1] // 2
        a, w = states[..., :n], states[..., n:]
        return np.diff(a, axis=-1, prepend=0), np.diff(w, axis=-1, prepend=0)


# -- tumbling bodies ------------------------------------------------------------------------------------------------
def tumbling(moments: Array) -> Rate:
    """Return the rates of a free body of principal moments (B, 3): states are x, quaternion (w, x, y, z), v and omega in
    the body's own axes, as a floating joint has them: (..., B, 13) in the order x, quaternion, omega, v."""

    def rate(y: Array) -> Array:
        p, w, v = y[..., 3:7], y[..., 7:10], y[..., 10:]
        s, u = p[..., :1], p[..., 1:]
        unit = np.sqrt((p * p).sum(axis=-1, keepdims=True))
        s1, u1 = s / unit, u / unit
        xd = v + 2 * np.cross(u1, np.cross(u1, v) + s1 * v)
        pd = np.concatenate([-(u * w).sum(axis=-1, keepdims=True), s * w + np.cross(u, w)], axis=-1) / 2
        wd = -np.cross(w, moments * w) / moments
        vd = -np.cross(w, v)
        return np.concatenate([xd, pd, wd, vd], axis=-1)

    return rate


# -- N-four-bars ----------------------------------------------------------------------------------------------------
def n_four_bar(windows: int, gravity: float = 9.81) -> Rate:
    """Return the rates of th and its rate (..., B, 2): all legs of length and mass 1 stay parallel, all bars level."""
    N = LONG(windows)
    factor = LONG(gravity) * ((N + 1) / 2 + N) / ((N + 1) / 3 + N)

    def rate(y: Array) -> Array:
        return np.stack([y[..., 1], -factor * np.cos(y[..., 0])], axis=-1)

    return rate
