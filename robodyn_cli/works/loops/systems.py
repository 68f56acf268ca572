"""Linear systems as state spaces, continuous and sampled: responses, their slopes, loops closed and opened."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


@record
class StateSpace:
    """x-dot = A x + B u, y = C x + D u; with a ``period`` T [s] x(k+1) = A x(k) + B u(k) at the samples."""

    A: Array
    B: Array
    C: Array
    D: Array
    period: float | None = None

    def at(self, frequencies: Array) -> Array:
        """Return the response (F, outputs, inputs) at angular frequencies (F,) [rad/s]."""
        x = self._states(frequencies, self.B)
        found: Array = self.C @ x + self.D
        return found

    def with_slope(self, frequencies: Array) -> tuple[Array, Array]:
        """Return the response and its derivative by the frequency, both (F, outputs, inputs)."""
        x = self._states(frequencies, self.B)
        inner = -1j if self.period is None else -1j * self.period * self._points(frequencies)[:, None, None]
        slope = self.C @ self._states(frequencies, inner * x)
        return self.C @ x + self.D, slope

    def _points(self, frequencies: Array) -> Array:
        """Return s = j w, or z = e^(j w T)."""
        if self.period is None:
            return 1j * np.asarray(frequencies)
        return np.exp(1j * self.period * np.asarray(frequencies))

    def _states(self, frequencies: Array, B: Array) -> Array:
        left = self._points(frequencies)[:, None, None] * np.eye(len(self.A)) - self.A
        right = np.broadcast_to(B, (len(left), *B.shape[-2:]))
        try:
            found: Array = np.linalg.solve(left, right)
        except np.linalg.LinAlgError:  # at a pole itself
            found = np.array([_solved(*each) for each in zip(left, right)])
        return found

    @property
    def last_frequency(self) -> float:
        """The largest frequency [rad/s]: half of the sampling frequency, or infinite."""
        return math.inf if self.period is None else math.pi / self.period

    def closed(self, but: int | None = None) -> StateSpace:
        """Return the system with each output fed back to its input with the sign turned, but for one; D counts as 0."""
        others = [k for k in range(self.B.shape[1]) if k != but]
        A = self.A - self.B[:, others] @ self.C[others]
        left = slice(None) if but is None else slice(but, but + 1)
        return dataclasses.replace(self, A=A, B=self.B[:, left], C=self.C[left], D=self.D[left, left])

    @property
    def sensitivity(self) -> StateSpace:
        """(E + L)^-1 of L with D = 0."""
        return dataclasses.replace(
            self, A=self.A - self.B @ self.C, C=-self.C, D=np.eye(self.B.shape[1]) + self.D
        )

    @property
    def poles(self) -> Array:
        found: Array = np.linalg.eigvals(self.A)
        return found

    @property
    def continuous(self) -> StateSpace | None:
        """The system in s of z = (1 + s) / (1 - s), which maps w to tan(w T / 2); None with a pole at -1."""
        if self.period is None:
            return self
        n = len(self.A)
        sum_ = self.A + np.eye(n)
        if np.linalg.cond(sum_) > 1e12:
            return None
        inverse = np.linalg.inv(sum_)
        A = inverse @ (self.A - np.eye(n))
        B = math.sqrt(2.0) * inverse @ self.B
        C = math.sqrt(2.0) * self.C @ inverse
        return StateSpace(A, B, C, self.D - self.C @ inverse @ self.B)

    def frequency_of(self, s: Array) -> Array:
        """Return the frequencies [rad/s] of imaginary parts of ``continuous``."""
        return s if self.period is None else 2.0 / self.period * np.arctan(s)


def _solved(left: Array, right: Array) -> Array:
    try:
        found: Array = np.linalg.solve(left, right)
    except np.linalg.LinAlgError:
        found = np.full(right.shape, np.inf + 0.0j)
    return found


def hold(A: Array, B: Array, period: float, rest: float = 0.0) -> tuple[Array, Array, Array]:
    """Return F, G_0, G_1 of x(T) = F x(0) + G_0 u_0 + G_1 u_1 where u_0 acts until ``rest``, and u_1 from then on.

    By the exponential of [A, B; 0, 0] (Van Loan 1978; Astrom and Wittenmark 1997, section 2.3).
    """
    from robodyn_cli.control.riccati import held

    F, new = held(A, B, period - rest)
    if not rest:
        return F, np.zeros_like(new), new
    first, old = held(A, B, rest)
    return F @ first, F @ old, new


def sampled(A: Array, B: Array, period: float, whole: int, rest: float) -> tuple[Array, Array]:
    """Return A and B of a plant under a hold, whose input comes ``whole`` periods and ``rest`` [s] late.

    Its states are x, then the inputs of the samples before, the last one first: as many as are on their way.
    """
    F, old, new = hold(A, B, period, rest)
    (n, m), count = B.shape, whole + (rest > 0.0)
    full = np.zeros((n + m * count, n + m * count))
    given = np.zeros((n + m * count, m))
    full[:n, :n] = F
    for G, late in ((new, whole), (old, whole + 1)):
        if late == 0:
            given[:n] += G
        elif late <= count:
            full[:n, n + m * (late - 1) : n + m * late] += G
    if count:
        given[n : n + m] = np.eye(m)
        full[n + m :, n : n + m * (count - 1)] = np.eye(m * (count - 1))
    return full, given


def sampled_apart(
    A: Array, B: Array, period: float, late: Sequence[tuple[int, float]]
) -> tuple[Array, Array]:
    """Return A and B of a plant under a hold as ``sampled``, each input late by its own periods and rest [s].

    Its states are x, then those of each input on their way.
    """
    n = len(A)
    parts = [sampled(A, B[:, [k]], period, *own) for k, own in enumerate(late)]
    size = n + sum(len(F) - n for F, _ in parts)
    full, given, at = np.zeros((size, size)), np.zeros((size, B.shape[1])), n
    for k, (F, G) in enumerate(parts):
        own = slice(at, at + len(F) - n)
        full[:n, :n], full[:n, own], full[own, own] = F[:n, :n], F[:n, n:], F[n:, n:]
        given[:n, k], given[own, k] = G[:n, 0], G[n:, 0]
        at = own.stop
    return full, given
