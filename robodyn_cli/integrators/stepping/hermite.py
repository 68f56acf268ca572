"""Dense output from states and accelerations at both ends of a step, for methods without an output of their own."""

from __future__ import annotations

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.memory import IntegerSlot
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Value
from robodyn_cli.record import mutable_record

PROBE = 0.25  # part of a step at which dense output evaluates the rate of z once more


def hermite_size(system: System) -> int:
    """Return how many doubles the polynomials take."""
    return 2 * (system.size + system.nv + system.nz) + system.nz


@mutable_record
class Ends:
    """A step by its ends: the state at the start, what the step adds to it, and the rates at the start and the end."""

    x0: list[Value]
    increments: list[Value]
    rate0: list[Value]
    rate1: list[Value]


class HermiteOutput:
    """Dense output from the ends of a step, at the start of ``%dense``."""

    def __init__(self, w: Writer) -> None:
        self.w = w
        self.f = w.f

    def save(self, t: Value, h: Value, ends: Ends) -> None:
        """Store the ends of a step."""
        f, s = self.f, self.w.system
        numbers = [*ends.x0, *ends.increments, *ends.rate0[s.nq :], *ends.rate1[s.nq :]]
        for k, value in enumerate(numbers):
            f.store(value, f.offset("%dense", k))
        self._probe(t, h, len(numbers))

    def _probe(self, t: Value, h: Value, place: int) -> None:
        """Store the error of the cubic polynomials of z: the coefficients of x^2 (1 - x)^2."""
        f, w, s = self.f, self.w, self.w.system
        if not s.nz:
            return
        for j in range(s.nz):
            f.store(0.0, f.offset("%dense", place + j))
        there, rates = w.array(2, 1), w.array(1, 1)
        self.dense(f.constant(PROBE - 1.0), h, there)
        w.dynamics(f.muladd(h, PROBE, t), there, rates)
        w.count(IntegerSlot.EVALUATIONS)
        x = PROBE
        for j in range(s.nz):
            (_, gained), (r0, r1) = self._ends(s.nv + j, h, 1)
            slope = 6.0 * x * (1.0 - x) * gained
            slope = slope + (1.0 - x) * (1.0 - 3.0 * x) * r0 + x * (3.0 * x - 2.0) * r1
            missed = (h * rates[s.nv + j] - slope) * (1.0 / (2.0 * x * (1.0 - x) * (1.0 - 2.0 * x)))
            f.store(missed, f.offset("%dense", place + j))

    def _ends(self, j: int, h: Value, width: int) -> tuple[tuple[Value, Value], tuple[Value, Value]]:
        """Return state j (of v, then z) at the start and what it gains, and h times its rate at both ends."""
        s = self.w.system
        n = s.nv + s.nz
        at = (s.nq + j, s.size + s.nq + j, 2 * s.size + j, 2 * s.size + n + j)
        y0, gained, r0, r1 = (self._number(k, width) for k in at)
        return (y0, gained), (r0 * h, r1 * h)

    def _number(self, k: int, width: int) -> Value:
        return self.f.splat(self.f.load(self.f.offset("%dense", k)), width)

    def dense(self, u: Value, h: Value, out: Array) -> None:
        """Hermite polynomials of degree 5 for q (from q, v, a), their derivatives for v, and of degree 4 for z."""
        f, s = self.f, self.w.system
        n = s.nv + s.nz
        x = u + 1.0
        for j in range(s.nq):
            q0, gained = self._number(j, u.width), self._number(s.size + j, u.width)
            (v0, faster), (a0, a1) = self._ends(j, h, u.width)
            v0, a0, a1 = v0 * h, a0 * h, a1 * h
            # Taylor's polynomial at the start, and what it misses at the end in x^3, x^4, x^5
            d = gained - (v0 + 0.5 * a0)
            e = faster * h - a0
            c = a1 - a0
            c3 = 10.0 * d - 4.0 * e + 0.5 * c
            c4 = 7.0 * e - 15.0 * d - c
            c5 = 6.0 * d - 3.0 * e + 0.5 * c
            tail = f.muladd(f.muladd(c5, x, c4), x, c3)
            out[j] = f.muladd(f.muladd(f.muladd(tail, x, 0.5 * a0), x, v0), x, q0)
            slope = f.muladd(f.muladd(5.0 * c5, x, 4.0 * c4), x, 3.0 * c3)
            out[s.nq + j] = f.muladd(f.muladd(slope, x, a0), x, v0) * (1.0 / h)
        for j in range(s.nv, n):
            (z0, gained), (r0, r1) = self._ends(j, h, u.width)
            cubic = z0 + gained * x * x * (3.0 - 2.0 * x) - x * u * (-u * r0 - x * r1)
            out[s.nq + j] = cubic + self._number(2 * (s.size + n) + j - s.nv, u.width) * (x * x) * (u * u)
