"""Gauss collocation of order 4 to 16, its two to eight stages evaluated together in the SIMD lanes.

The stage accelerations solve a = f(t + c h, q + h c v + h^2 A^2 a, v + h A a) (Hairer, Lubich and Wanner 2006,
II.1 and II.2), here by fixed-point iteration from the previous step's polynomial. The method is symplectic and
symmetric; the iteration limits the step on stiff problems, where a linearly implicit method is the right one.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.methods.gauss_correction import Corrected
from robodyn_cli.integrators.methods.gauss_dense import dense_width
from robodyn_cli.integrators.methods.gauss_tables import gauss_table
from robodyn_cli.integrators.runtime.layout import Real, Whole
from robodyn_cli.integrators.stepping.stepper import SLACK, Attempt, StepProgram
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Int, Value
from robodyn_cli.kernels.mathematics import rough_exp2, rough_log2

ITERATIONS = 14
HALFWAY = 4  # rounds after which an iteration that would still be far off in eight more is given up
CONVERGED = 0.02  # last update times contraction ratio, in units of the tolerance
SMALLEST_RATIO = 0.01  # a luckily small update must not pass for convergence
BEST_RATIO = 0.35  # steps are chosen so that the iteration contracts at least this fast
SAFETY = 0.85
STALE = 0.25  # contraction of the iteration beyond which factors are renewed in each round
SECOND = 0.1  # weight of the last but one Legendre coefficient in the error estimate
SECOND_STEEP = (
    1.0  # the same where coefficients need not fall geometrically, so that a small last one proves little
)
SCALE = 3.0
RISK = 0.01  # what part of the acceptable error the trend of the last two may promise for the next step
ACCEPT = 100.0  # the estimate is that pessimistic; measured against true errors
ACCEPT_STEEP = 1.0  # not where a front may lie in the step
STEEP = frozenset({"tanh", "exp", "atan"})  # operations with which smooth rates may still change all at once
ROUGH = 1e-11  # of a rate: what rounding may make of it at the ends of a step
EDGE = 10.0  # rates at the ends of a step may differ that much from the polynomial, in its last coefficients


class Gauss(Corrected):
    """Gauss method with 8 stages: order 16, dense output of order 8."""

    name = "gauss"
    order = 16
    dense_order = 8
    stages = 8
    symplectic = True

    def dense_size(self, system: System) -> int:
        rates = system.nv + system.nz
        return (self.lanes + 2 * dense_width(self.stages) + 1) * rates + system.size

    def programs(self, system: System) -> list[StepProgram]:
        residual = self.residual_of(system)
        if residual is None:
            return [StepProgram("accelerations", system.dynamics.program, self.lanes)]
        found = [
            StepProgram("corrections of accelerations, each round", residual.correction, self.lanes),
            StepProgram("factors of the mass matrix, once a step", residual.factors, self.lanes),
        ]
        if self.adaptive and self.is_steep(system):
            found.append(StepProgram("accelerations at the ends of steps", system.dynamics.program))
        return found

    @staticmethod
    def is_steep(system: System) -> bool:
        """Tell whether smooth rates may change all at once."""
        return any(i.op in STEEP for i in system.dynamics.program.instructions)

    def prepare(self, w: Writer) -> None:
        f = w.f
        self.table = gauss_table(self.stages)
        self.guess = w.array(1, 1, self.lanes)
        self.drift = w.array(1, 0, self.lanes)
        self.x = w.array(2, 1, self.lanes)
        self.fresh = w.array(1, 1, self.lanes)
        self.weight = w.array(1, 1)
        self.sizes = w.array(1, 1)
        self.residual = self.residual_of(w.system)
        if self.residual is not None:
            self.factors = Array(f, f.slot(self.lanes, len(self.residual.entries)), self.lanes)
        self.before = f.slot()
        self.round = f.int_slot()
        self.primed = f.int_slot()
        self.steep = self.is_steep(w.system)
        self.accept = ACCEPT_STEEP if self.steep else ACCEPT
        if self.steep:
            self.edge, self.tops = w.array(1, 1), w.array(1, 1)

    def _polynomial(self, w: Writer, j: Int | int) -> str:
        """Return the address of the monomial coefficients of rate j (accelerations, then z rates)."""
        return w.f.offset("%dense", j * self.lanes)

    def _end(self, w: Writer) -> Array:
        """Return the state at the end of the step, before projection."""
        return Array(w.f, w.f.offset("%dense", w.rates * self.lanes))

    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        f, T = w.f, self.table
        lanes = self.lanes
        nodes = f.constant(list(T.c))
        rms = self._rms(w)
        self._weigh(w, h, lambda j: rms[j])
        self._predict(w, t, h)
        wide_h, wide_h2 = f.splat(h, lanes), f.splat(h * h, lanes)
        times = f.muladd(wide_h, nodes, f.splat(t, lanes))
        for j in w.each(w.nv):
            q, v = f.splat(w.state[j], lanes), f.splat(w.state[w.nv + j], lanes)
            self.drift[j] = f.muladd(wide_h * nodes, v, q)
        f.store(1e300, self.before)
        # the first step of a run knows no rates yet: one round shows them, then they take part in the weights
        known = f.compare_int("sgt", f.load_int(w.whole(Whole.ACCEPTED)), 0)
        f.store_int(f.select_int(known, 1, 0), self.primed)
        f.store_int(f.select_int(known, 0, ITERATIONS), self.round)
        iterate, onward, enough = f.label("iterate"), f.label("onward"), f.label("solved")
        f.jump(iterate)
        f.place(iterate)
        for j in w.each(w.nv):
            old = self._spread(w, j)
            self.x[j] = self._combine(w, old, T.A2, wide_h2, self.drift[j])
            self.x[w.nv + j] = self._combine(w, old, T.A, wide_h, f.splat(w.state[w.nv + j], lanes))
        for j in range(w.system.nz):
            start = f.splat(w.state[w.nv * 2 + j], lanes)
            self.x[w.nv * 2 + j] = self._combine(w, self._spread(w, w.nv + j), T.A, wide_h, start)
        if self.residual is not None:
            first = f.compare("ogt", f.load(self.before), 1e200)
            with f.when(first | f.compare("ogt", w.get(Real.MEMORY), STALE)):
                self.renew(w, times)
        self.rates(w, times, self.guess)
        with f.strict():
            square = Total(f, lanes)
            for j in w.each(w.rates):
                fresh = self.fresh[j]
                d = (fresh - self.guess[j]) * f.splat(self.weight[j], lanes)
                square.add_product(d, d)
                self.guess[j] = fresh
            update = f.sqrt(f.reduce("add", square.value))
            last = f.load(self.before)
            f.store(update, self.before)
            ratio = f.min(update / last, 1.0)
            first = f.compare("ogt", last, 1e200)
            remembered = w.get(Real.MEMORY)
            # where the first round is enough nothing is measured, and what is remembered must fade
            measured = f.select(first, remembered * 0.5, ratio)
            ratio = f.max(f.select(first, remembered, ratio), SMALLEST_RATIO)
            w.put(Real.MEMORY, f.select(f.compare("ord", ratio, 0.0), measured, f.constant(1.0)))
            small = f.compare("olt", update * ratio, CONVERGED)
        f.branch(small, enough, onward)
        f.place(onward)
        capped, diverged = f.label("capped"), f.label("diverged")
        rounds = f.bump(self.round)
        unfinished = f.compare_int("slt", rounds, ITERATIONS) & f.compare("ord", update, 0.0)
        if self.adaptive and not self.steep:
            eighth = ratio
            for _ in range(3):
                eighth = eighth * eighth
            hopeful = f.compare("olt", update * eighth, 10.0) | f.compare_int("slt", rounds, HALFWAY)
            unfinished = unfinished & hopeful
        f.branch(unfinished, iterate, capped)
        f.place(capped)
        prime, stuck = f.label("prime"), f.label("stuck")
        f.branch(f.compare_int("eq", f.load_int(self.primed), 0), prime, stuck)
        f.place(prime)
        f.store_int(1, self.primed)
        f.store_int(0, self.round)
        f.store(1e300, self.before)
        self._weigh(w, h, lambda j: self._mean(w, self.guess[j]))
        f.jump(iterate)
        f.place(stuck)
        # an update that no longer shrinks is rounding when it is well below the tolerance
        f.branch(f.compare("olt", update, 0.1), enough, diverged)
        f.place(diverged)
        w.put(Real.H, h * f.select(f.compare("ord", update, 0.0), f.constant(0.5), f.constant(0.1)))
        f.jump(failed)
        f.place(enough)
        self._advance(w, h)
        return self._judge(w, t, h)

    def _mean_square(self, w: Writer, x: Value) -> Value:
        """Return the mean square over the stages."""
        f = w.f
        x = x * f.constant([float(k < self.stages) for k in range(self.lanes)])
        return f.reduce("add", x * x) * (1.0 / self.stages)

    def _mean(self, w: Writer, x: Value) -> Value:
        """Return the root mean square over the stages."""
        return w.f.sqrt(self._mean_square(w, x))

    def _tolerances(self, w: Writer) -> tuple[Value, Value]:
        """Return the relative and the absolute tolerance to which a step is solved."""
        return w.get(Real.RTOL), w.get(Real.ATOL)

    def _weigh(self, w: Writer, h: Value, size_of: Callable[[Int | int], Value]) -> None:
        """Set what an error of each rate means for the state over this step, in units of the tolerance.

        A velocity counts as at least what its rate makes of it in the step, so that one that passes zero is not
        held to an absolute standard; a position sets the standard where the motion is slow.
        """
        f = w.f
        rtol, atol = self._tolerances(w)

        def weight(j: Int | int) -> Value:
            speed, gained = f.abs(w.state[w.nv + j]), h * size_of(j)
            largest = f.select(f.compare("ogt", speed, gained), speed, gained)
            return h / f.muladd(largest, rtol, atol)

        with f.strict():
            for j in w.each(w.nv):
                one, other = weight(j), h * h / f.muladd(f.abs(w.state[j]), rtol, atol)
                self.weight[j] = f.select(f.compare("ogt", other, one), other, one)
            for j in range(w.system.nz):
                self.weight[w.nv + j] = weight(w.nv + j)

    def _spread(self, w: Writer, j: Int | int) -> list[Value]:
        """Return rate j of each stage in all lanes: from memory, without shuffling, where calls keep it there."""
        f = w.f
        if self.residual is None:
            rate = self.guess[j]
            return [f.broadcast(rate, i) for i in range(self.stages)]
        return [f.splat(f.load(f.offset(self.guess.at(j), i)), self.lanes) for i in range(self.stages)]

    def _combine(
        self, w: Writer, a: list[Value], matrix: np.ndarray, factor: Value | None, start: Value
    ) -> Value:
        """Return start + factor (matrix a), lanes being stages; two sums to shorten the chain."""
        f = w.f
        sums: list[Value | None] = [None, None]
        for i in range(self.stages):
            column = f.constant([float(x) for x in matrix[:, i]])
            part = sums[i & 1]
            sums[i & 1] = a[i] * column if part is None else f.muladd(a[i], column, part)
        total = sums[0]
        assert total is not None
        total = total if sums[1] is None else total + sums[1]
        return total if factor is None else f.muladd(factor, total, start)

    def _predict(self, w: Writer, t: Value, h: Value) -> None:
        """Evaluate the rates that are kept at the new stages: of the step before, or of this one before it was cut."""
        f = w.f
        lanes = self.lanes
        length = w.get(Real.DENSE_STEP)
        per_length = 1.0 / f.select(f.compare("ogt", length, 0.0), length, h)
        with f.strict():
            ahead = t - w.get(Real.DENSE_END)
        stages = f.constant(list(self.table.c))
        u = f.muladd(f.splat(h * per_length, lanes), stages, f.splat(ahead * per_length, lanes))
        for j in w.each(w.rates):
            address = self._polynomial(w, j)
            p = f.splat(f.load(f.offset(address, self.stages - 1)), lanes)
            for k in reversed(range(self.stages - 1)):
                p = f.muladd(p, u, f.splat(f.load(f.offset(address, k)), lanes))
            self.guess[j] = p

    def _advance(self, w: Writer, h: Value) -> None:
        f, T = w.f, self.table
        b, b_bar = f.constant(list(T.b)), f.constant(list(T.b_bar))
        for j in w.each(w.nv):
            rate, v = self.guess[j], w.state[w.nv + j]
            w.new[j] = f.muladd(h * h, f.reduce("add", rate * b_bar), f.muladd(h, v, w.state[j]))
            w.new[w.nv + j] = f.muladd(h, f.reduce("add", rate * b), v)
        for j in range(w.system.nz):
            place = w.nv * 2 + j
            w.new[place] = f.muladd(h, f.reduce("add", self.guess[w.nv + j] * b), w.state[place])

    def _judge(self, w: Writer, t: Value, h: Value) -> Attempt:
        """Estimate the error: the square of the top Legendre coefficients relative to the rate itself.

        The coefficients fall geometrically, and superconvergence squares what they say about a smooth solution.
        """
        f, T = w.f, self.table
        top = f.constant([float(x) for x in T.legendre[-1]])
        below = f.constant([float(x) for x in T.legendre[-2]])
        second = SECOND_STEEP if self.steep else SECOND
        with f.strict():
            total = Total(f)
            for j in w.each(w.rates):
                rate = self.guess[j]
                c = f.reduce("add", rate * top)
                d = f.reduce("add", rate * below)
                square = self._mean_square(w, rate)
                self.sizes[j] = f.sqrt(square)
                e = f.muladd(d * d, second, c * c) * self.weight[j]
                total.add_product(e, e / (square + 1e-300))
                if self.steep:
                    self.tops[j] = f.abs(c) + f.abs(d)
        if self.steep:
            self._look_at_ends(w, t, h, total)
        with f.strict():
            error = total.value * (SCALE * SCALE) / w.number(w.rates)
            power = 1.0 / (2 * self.stages - 1)
            # what the next step waits for: in logarithms and without roots
            size = f.max(rough_log2(f, error) * 0.5, math.log2(1e-14))
            own = size * -power + math.log2(SAFETY)
            if not self.steep:
                # also from the trend of the last two errors (Gustafsson 1994): towards a pole steps shrink in
                # proportion; where fronts may hide, a step that is rejected after all is a second look
                last = w.get(Real.MEMORY_2)
                promise = last - size * 2.0 + math.log2(RISK * ACCEPT)
                trend = promise * power + rough_log2(f, h / w.get(Real.H_OLD))
                own = f.select(f.compare("oeq", last, 1.0), own, f.min(own, trend))
            factor = rough_exp2(f, own)
            self.last_error = f.max(size, math.log2(1e-4))
            ratio = w.get(Real.MEMORY)
            growth = f.select(f.compare("olt", error, 1e-16), f.constant(4.0), f.constant(1.6))
            if not self.steep:
                rejected = f.compare_int("sgt", f.load_int(w.whole(Whole.REJECTED_IN_ROW)), 0)
                growth = f.select(rejected, f.constant(1.0), growth)
            factor = f.min(f.max(f.min(factor, BEST_RATIO / (ratio + 1e-9)), 0.3), growth)
        return Attempt(error * (1.0 / self.accept**2), factor)

    def _look_at_ends(self, w: Writer, t: Value, h: Value, total: Total) -> None:
        """Add to the error what may hide where no stage looks: in the first and the last 2 % of the step.

        A front that falls there, such as smoothed friction at the turn of a joint, leaves no trace in the stages.
        """
        f, T = w.f, self.table
        signs = (-1.0) ** np.arange(self.lanes)
        gap = float(T.c[0]) * self.accept / SCALE
        for time, state, row in ((t, w.state, signs @ T.M), (t + h, w.new, T.M[0])):
            w.dynamics(time, state, self.edge)
            w.count(Whole.EVALUATIONS)
            with f.strict():
                for j in w.each(w.rates):
                    expected = f.reduce("add", self.guess[j] * f.constant([float(x) for x in row]))
                    known = f.muladd(self.sizes[j], ROUGH, self.tops[j] * EDGE)
                    missed = f.abs(self.edge[j] - expected) - known
                    hidden = f.select(f.compare("ole", missed, 0.0), 0.0, missed) * self.weight[j] * gap
                    total.add_product(hidden, hidden)

    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        f, T = w.f, self.table
        if self.adaptive:
            w.put(Real.MEMORY_2, self.last_error)
        w.put(Real.DENSE_END, t + h)
        w.put(Real.DENSE_STEP, h)
        # samples beyond the step's end are not this step's business
        with f.when(w.due(t + h, 2.0 * SLACK)):
            self._refine(w, t, h)
        for j in w.each(w.rates):
            nothing = f.constant(0.0, self.lanes)
            f.store(self._combine(w, self._spread(w, j), T.M, None, nothing), self._polynomial(w, j))
        end, rms = self._end(w), self._rms(w)
        for k in w.each(w.size):
            end[k] = w.new[k]
        for j in w.each(w.rates):
            rms[j] = self.sizes[j]

    def _once(self, w: Writer, j: Int | int, u: Value, h: Value) -> Value:
        """Return the velocity or z of rate j at u: from the end of the step, plus h u sum d_k u^k / (k+1)."""
        f, d = w.f, self._coefficients(w, j)
        total = self._horner(w, [x * (1.0 / (k + 1)) for k, x in enumerate(d)], u)
        return f.muladd(u * h, total, self._end(w)[w.nv + j])

    def _twice(self, w: Writer, j: Int | int, u: Value, h: Value) -> Value:
        """Return position j at u: q1 + h u v1 + h^2 u^2 sum d_k u^k / ((k+1) (k+2))."""
        f, d, end = w.f, self._coefficients(w, j), self._end(w)
        hu = u * h
        total = self._horner(w, [x * (1.0 / ((k + 1) * (k + 2))) for k, x in enumerate(d)], u)
        return f.muladd(hu * hu, total, f.muladd(hu, end[w.nv + j], end[j]))

    def _coefficients(self, w: Writer, j: Int | int) -> list[Value]:
        f = w.f
        address = self._polynomial(w, j)
        return [f.load(f.offset(address, k)) for k in range(self.stages)]

    def dense(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        for j in w.each(w.nv):
            out[j] = self._twice(w, j, u, h)
        for j in w.each(w.rates):
            out[w.nv + j] = self._once(w, j, u, h)

    def sample(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        """Dense output plus the correction that ``_refine`` left behind."""
        f = w.f
        x = u * 2.0 + 1.0

        def correction(j: Int | int, first: int, count: int) -> Value:
            address = self._correction(w, j)
            return self._horner(w, [f.load(f.offset(address, first + k)) for k in range(count)], x)

        for j in w.each(w.nv):
            out[j] = f.muladd(
                h * h, correction(j, dense_width(self.stages), 2 * self.stages + 2), self._twice(w, j, u, h)
            )
        for j in w.each(w.rates):
            out[w.nv + j] = f.muladd(h, correction(j, 0, 2 * self.stages + 1), self._once(w, j, u, h))
