"""Linearly implicit methods for stiff motion: no iteration, one factored matrix a step, exact Jacobian."""

from __future__ import annotations

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.factors import RealFactors
from robodyn_cli.integrators.layout import Real, Whole
from robodyn_cli.integrators.loop import SLACK, Attempt, Stepper
from robodyn_cli.integrators.rosenbrock_tables import RODAS5P, ROSENBROCK23, RosenbrockTable
from robodyn_cli.integrators.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Value
from robodyn_cli.kernels.mathematics import rough_power
from robodyn_cli.kernels.program import Program

SAFETY = 0.9
PROBE = 0.25  # part of a step at which the rate of z is looked at once more for dense output


class Rosenbrock(Stepper):
    """Rosenbrock method given by its table; dense output from the states and accelerations at both ends."""

    table: RosenbrockTable
    needs_jacobian = True

    def linearisation(self, system: System) -> Program:
        return system.linearisation

    def dense_size(self, system: System) -> int:
        return 2 * (system.size + system.nv + system.nz) + system.nz

    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        f, s, T = w.f, w.system, self.table
        stages = len(T.m)
        x0 = [w.state[c] for c in range(s.size)]
        factors = RealFactors(w, t, w.state, (1.0 / T.gamma) / h)
        w.count(Whole.EVALUATIONS, stages + 1)
        per_h = 1.0 / h
        U: list[list[Value]] = []
        self.rate0: list[Value] = []
        for i in range(stages):
            x = [self._sum(w, T.a[i], U, c, x0[c]) for c in range(s.size)]
            rate = self._rate(w, f.muladd(h, float(T.alpha[i]), t), x)
            if i == 0:
                self.rate0 = rate
            right = []
            for c, ft in enumerate(factors.ft):
                total = f.muladd(per_h, self._sum(w, T.C[i], U, c, None), rate[c]) if i else rate[c]
                if ft is not None and T.gamma_sums[i] != 0.0:
                    total = f.muladd(h * float(T.gamma_sums[i]), ft, total)
                right.append(total)
            U.append(factors.solve(right))
        # increments apart: in short steps dense output would lose their digits in the difference of two states
        self.increments = [self._sum(w, T.m, U, c, None) for c in range(s.size)]
        x1 = [x + d for x, d in zip(x0, self.increments)]
        for k in range(s.size):
            w.new[k] = x1[k]
        self.x0 = x0
        return self._judge(w, x0, x1, [self._sum(w, T.e, U, c, None) for c in range(s.size)])

    def _rate(self, w: Writer, t: Value, x: list[Value]) -> list[Value]:
        """Return x-dot at a state that is not in memory."""
        here, rates = w.array(2, 1), w.array(2, 1)
        for k, value in enumerate(x):
            here[k] = value
        w.rate(t, here, rates)
        return [rates[k] for k in range(len(x))]

    def _sum(
        self, w: Writer, weights: tuple[float, ...], U: list[list[Value]], c: int, start: Value | None
    ) -> Value:
        f = w.f
        total = start
        for weight, u in zip(weights, U):
            if weight != 0.0:
                total = u[c] * weight if total is None else f.muladd(u[c], weight, total)
        return f.constant(0.0) if total is None else total

    def _judge(self, w: Writer, x0: list[Value], x1: list[Value], e: list[Value]) -> Attempt:
        f, s = w.f, w.system
        n = s.size
        with f.strict():
            rtol, atol = w.get(Real.RTOL), w.get(Real.ATOL)
            total: Value | None = None
            for c in range(n):
                d = e[c] / f.muladd(f.max(f.abs(x0[c]), f.abs(x1[c])), rtol, atol)
                total = d * d if total is None else f.muladd(d, d, total)
            assert total is not None
            error = total * (1.0 / n)
            bounded = f.max(error, 1e-20)
            factor = rough_power(f, bounded, -0.5 / self.table.error_order) * SAFETY
            after_reject = f.compare_int("sgt", f.load_int(w.whole(Whole.REJECTED_IN_ROW)), 0)
            factor = f.min(f.max(factor, 0.2), f.select(after_reject, f.constant(1.0), f.constant(6.0)))
        return Attempt(error, factor)

    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        f, s = w.f, w.system
        wanted = f.compare_int(
            "sle", f.load_int(w.whole(Whole.NEXT_SAMPLE)), f.load_int(w.whole(Whole.LAST_SAMPLE))
        )
        watched = f.compare_int("ne", f.load_int(w.whole(Whole.WATCH)), 0)
        with f.when(wanted | watched), f.when(w.due(t + h, 2.0 * SLACK) | watched):
            x1 = [w.new[k] for k in range(s.size)]
            rate1 = self._rate(w, t + h, x1)
            w.count(Whole.EVALUATIONS)
            kept = [*self.x0, *self.increments, *self.rate0[s.nq :], *rate1[s.nq :]]
            for k, value in enumerate(kept):
                f.store(value, f.offset("%dense", k))
            self._probe(w, t, h, len(kept))

    def _probe(self, w: Writer, t: Value, h: Value, place: int) -> None:
        """Store what the cubic polynomials of z miss: the coefficients of x^2 (1 - x)^2."""
        f, s = w.f, w.system
        if not s.nz:
            return
        for j in range(s.nz):
            f.store(0.0, f.offset("%dense", place + j))
        there, rates = w.array(2, 1), w.array(1, 1)
        self.dense(w, f.constant(PROBE - 1.0), h, there)
        w.dynamics(f.muladd(h, PROBE, t), there, rates)
        w.count(Whole.EVALUATIONS)
        x = PROBE
        for j in range(s.nz):
            (_, gained), (r0, r1) = self._ends(w, s.nv + j, h, 1)
            slope = 6.0 * x * (1.0 - x) * gained
            slope = slope + (1.0 - x) * (1.0 - 3.0 * x) * r0 + x * (3.0 * x - 2.0) * r1
            missed = (h * rates[s.nv + j] - slope) * (1.0 / (2.0 * x * (1.0 - x) * (1.0 - 2.0 * x)))
            f.store(missed, f.offset("%dense", place + j))

    def _ends(
        self, w: Writer, j: int, h: Value, width: int
    ) -> tuple[tuple[Value, Value], tuple[Value, Value]]:
        """Return state j (of v, then z) at the start and what it gains, and h times its rate at both ends."""
        f, s = w.f, w.system
        n = s.nv + s.nz
        at = (s.nq + j, s.size + s.nq + j, 2 * s.size + j, 2 * s.size + n + j)
        y0, gained, r0, r1 = (f.splat(f.load(f.offset("%dense", k)), width) for k in at)
        return (y0, gained), (r0 * h, r1 * h)

    def dense(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        """Hermite polynomials of degree 5 for q (from q, v, a), their derivatives for v, and of degree 4 for z."""
        f, s = w.f, w.system
        n = s.nv + s.nz
        x = u + 1.0

        def get(k: int) -> Value:
            return f.splat(f.load(f.offset("%dense", k)), u.width)

        for j in range(s.nq):
            q0, gained = get(j), get(s.size + j)
            (v0, faster), (a0, a1) = self._ends(w, j, h, u.width)
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
            (z0, gained), (r0, r1) = self._ends(w, j, h, u.width)
            cubic = z0 + gained * x * x * (3.0 - 2.0 * x) - x * u * (-u * r0 - x * r1)
            out[s.nq + j] = cubic + get(2 * (s.size + n) + j - s.nv) * (x * x) * (u * u)


class Rodas5P(Rosenbrock):
    """Steinebach's Rodas5P: order 5, L-stable, for stiff springs and dampers."""

    name = "rodas5p"
    order = 5
    dense_order = 4
    table = RODAS5P


class Rosenbrock23(Rosenbrock):
    """Shampine and Reichelt's pair of MATLAB's ode23s: order 2, L-stable, for stiff motion at loose tolerances."""

    name = "rosenbrock23"
    order = 2
    dense_order = 2
    proportion = 2.0 / 3.0
    table = ROSENBROCK23
