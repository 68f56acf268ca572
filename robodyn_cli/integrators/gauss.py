"""Gauss collocation of order 16, its eight stages evaluated together in the SIMD lanes.

The stage accelerations solve a = f(t + c h, q + h c v + h^2 A^2 a, v + h A a) (Hairer, Lubich and Wanner 2006,
II.1 and II.2), here by fixed-point iteration from the previous step's polynomial. The method is symplectic and
symmetric; the iteration limits the step on stiff problems, where a linearly implicit method is the right one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.gauss_dense import WIDTH, dense_table
from robodyn_cli.integrators.gauss_tables import gauss_table
from robodyn_cli.integrators.layout import Real, Whole
from robodyn_cli.integrators.loop import SLACK, Attempt, Stepper
from robodyn_cli.integrators.writer import Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Int, Value, literal
from robodyn_cli.kernels.mathematics import rough_power

ITERATIONS = 14
CONVERGED = 0.02  # last update times contraction ratio, in units of the tolerance
SMALLEST_RATIO = 0.01  # a luckily small update must not pass for convergence
BEST_RATIO = 0.35  # steps are chosen so that the iteration contracts at least this fast
SAFETY = 0.85
SECOND = 0.1  # weight of the last but one Legendre coefficient in the error estimate
SCALE = 3.0
ACCEPT = 100.0  # the estimate is that pessimistic; measured against true errors


class Gauss(Stepper):
    """Gauss method with 8 stages: order 16, dense output of order 8."""

    name = "gauss"
    order = 16
    dense_order = 8
    stages = 8

    def dense_size(self, system: System) -> int:
        rates = system.nv + system.nz
        return self.stages * rates + system.size + 2 * WIDTH * rates + rates

    def prepare(self, w: Writer) -> None:
        f = w.f
        self.table = gauss_table(self.stages)
        self.guess = w.array(1, 1, self.stages)
        self.drift = w.array(1, 0, self.stages)
        self.x = w.array(2, 1, self.stages)
        self.fresh = w.array(1, 1, self.stages)
        self.weight = w.array(1, 1)
        self.sizes = w.array(1, 1)
        self.before = f.slot()
        self.round = f.int_slot()
        self.primed = f.int_slot()

    def _polynomial(self, w: Writer, j: Int | int) -> str:
        """Return the address of the monomial coefficients of rate j (accelerations, then z rates)."""
        return w.f.offset("%dense", j * self.stages)

    def _end(self, w: Writer) -> Array:
        """Return the state at the end of the step, before projection."""
        return Array(w.f, w.f.offset("%dense", w.rates * self.stages))

    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        f, T = w.f, self.table
        lanes = self.stages
        nodes = f.constant(list(T.c))
        rms = self._rms(w)
        self._weigh(w, h, lambda j: rms[j])
        self._predict(w, h)
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
            old = self.guess[j]
            self.x[j] = self._combine(w, old, T.A2, wide_h2, self.drift[j])
            self.x[w.nv + j] = self._combine(w, old, T.A, wide_h, f.splat(w.state[w.nv + j], lanes))
        for j in range(w.system.nz):
            start = f.splat(w.state[w.nv * 2 + j], lanes)
            self.x[w.nv * 2 + j] = self._combine(w, self.guess[w.nv + j], T.A, wide_h, start)
        w.dynamics(times, self.x, self.fresh)
        w.count(Whole.EVALUATIONS)
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
        unfinished = f.compare_int("slt", f.bump(self.round), ITERATIONS) & f.compare("ord", update, 0.0)
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
        return self._judge(w)

    def _mean(self, w: Writer, x: Value) -> Value:
        """Return the root mean square over the stages."""
        f = w.f
        return f.sqrt(f.reduce("add", x * x) * (1.0 / self.stages))

    def _weigh(self, w: Writer, h: Value, size_of: Callable[[Int | int], Value]) -> None:
        """Set what an error of each rate means for the state over this step, in units of the tolerance.

        A velocity counts as at least what its rate makes of it in the step, so that one that passes zero is not
        held to an absolute standard; a position sets the standard where the motion is slow.
        """
        f = w.f
        rtol, atol = w.get(Real.RTOL), w.get(Real.ATOL)

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

    def _combine(self, w: Writer, a: Value, matrix: np.ndarray, factor: Value | None, start: Value) -> Value:
        """Return start + factor (matrix a), lanes being stages; two sums to shorten the chain."""
        f = w.f
        sums: list[Value | None] = [None, None]
        for i in range(self.stages):
            column = f.constant([float(x) for x in matrix[:, i]])
            x = f.broadcast(a, i)
            part = sums[i & 1]
            sums[i & 1] = x * column if part is None else f.muladd(x, column, part)
        assert sums[0] is not None and sums[1] is not None
        total = sums[0] + sums[1]
        return total if factor is None else f.muladd(factor, total, start)

    def _predict(self, w: Writer, h: Value) -> None:
        """Extrapolate the previous step's rates to the new stages."""
        f = w.f
        lanes = self.stages
        old_h = w.get(Real.H_OLD)
        stretch = h / old_h
        u = f.splat(stretch, lanes) * f.constant(list(self.table.c))
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

    def _judge(self, w: Writer) -> Attempt:
        """Estimate the error: the square of the top Legendre coefficients relative to the rate itself.

        The coefficients fall geometrically, and superconvergence squares what they say about a smooth solution.
        """
        f, T = w.f, self.table
        top = f.constant([float(x) for x in T.legendre[-1]])
        below = f.constant([float(x) for x in T.legendre[-2]])
        with f.strict():
            total = Total(f)
            for j in w.each(w.rates):
                rate = self.guess[j]
                c = f.reduce("add", rate * top)
                d = f.reduce("add", rate * below)
                size = self._mean(w, rate)
                self.sizes[j] = size
                e = f.muladd(d * d, SECOND, c * c) * self.weight[j] / (size + 1e-300)
                total.add_product(e, e)
            error = f.sqrt(total.value * (SCALE * SCALE) / w.number(w.rates))
            bounded = f.max(error, 1e-14)
            factor = rough_power(f, bounded, -1.0 / (2 * self.stages - 1)) * SAFETY
            ratio = w.get(Real.MEMORY)
            growth = f.select(f.compare("olt", error, 1e-8), f.constant(4.0), f.constant(1.6))
            factor = f.min(f.max(f.min(factor, BEST_RATIO / (ratio + 1e-9)), 0.3), growth)
        return Attempt(error * (1.0 / ACCEPT), factor)

    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        f, T = w.f, self.table
        # samples beyond the step's end are not this step's business
        with f.when(w.due(t + h, 2.0 * SLACK)):
            self._refine(w, t, h)
        for j in w.each(w.rates):
            nothing = f.constant(0.0, self.stages)
            f.store(self._combine(w, self.guess[j], T.M, None, nothing), self._polynomial(w, j))
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
            out[j] = f.muladd(h * h, correction(j, WIDTH, 2 * self.stages + 2), self._twice(w, j, u, h))
        for j in w.each(w.rates):
            out[w.nv + j] = f.muladd(h, correction(j, 0, 2 * self.stages + 1), self._once(w, j, u, h))

    def _correction(self, w: Writer, j: Int | int) -> str:
        """Return the address of the correction of rate j: its integral's coefficients, then the double integral's."""
        return w.f.offset("%dense", w.rates * self.stages + w.size + j * (2 * WIDTH))

    def _rms(self, w: Writer) -> Array:
        """Return the root mean squares of the rates over the last step."""
        return Array(w.f, w.f.offset("%dense", w.rates * (self.stages + 2 * WIDTH) + w.size))

    def _table(self, w: Writer, name: str, data: np.ndarray) -> str:
        """Keep a table in memory, columns one after the other, and return its address."""
        f = w.f
        flat = ", ".join(f"double {literal(x)}" for x in np.asarray(data, dtype=float).ravel())
        f.globals.append(f"@{name} = private unnamed_addr constant [{data.size} x double] [{flat}], align 64")
        return f"@{name}"

    def _products(self, w: Writer, sources: list[str], tables: list[list[tuple[str, Int]]]) -> list[Value]:
        """Return, for each result, the sum over sources of (8 x 8 block of its table) times source.

        ``tables[r][k]`` is the address and block of the table that result r applies to source k, or result r has
        fewer sources. Columns in a loop: this code runs once a step, and unrolled it would be half of all code.
        """
        f, m = w.f, self.stages
        totals = [f.slot(m) for _ in tables]
        for slot in totals:
            f.store(f.constant(0.0, m), slot, 64)
        with f.count(m) as i:
            scalars = [f.splat(f.load(f.offset(source, i)), m) for source in sources]
            for slot, row in zip(totals, tables):
                total = f.load(slot, m, 64)
                for (table, block), scalar in zip(row, scalars):
                    column = f.load(f.offset(table, block * (m * m) + i * m), m, 64)
                    total = f.muladd(scalar, column, total)
                f.store(total, slot, 64)
        return [f.load(slot, m, 64) for slot in totals]

    def _refine(self, w: Writer, t: Value, h: Value) -> None:
        """Correct the collocation polynomial by its residual: between the stages, at them, between them again."""
        f, m = w.f, self.stages
        T, D = self.table, dense_table(m)

        def columns(*blocks: np.ndarray) -> np.ndarray:
            return np.concatenate([b.T.ravel() for b in blocks])

        def pairs(table: np.ndarray) -> np.ndarray:
            return columns(*(table[a, b] for a in (0, 1) for b in (0, 1)))

        nodes = self._table(w, "dense.nodes", np.concatenate([T.c, D.extra]))
        value = self._table(w, "dense.value", columns(np.eye(m), D.value))
        once = self._table(w, "dense.once", columns(T.A, D.once))
        twice = self._table(w, "dense.twice", columns(T.A2, D.twice))
        inner_once = self._table(w, "dense.inner1", pairs(D.inner_once))
        inner_twice = self._table(w, "dense.inner2", pairs(D.inner_twice))
        # addressed by a running index, so apart from the iterates, which are to stay in registers
        stages, known = w.array(1, 1, m), w.array(1, 1, m)
        residual = [w.array(1, 1, m) for _ in range(2)]
        for j in w.each(w.rates):
            stages[j] = self.guess[j]
            residual[0][j] = residual[1][j] = 0.0
        wide_h, wide_h2 = f.splat(h, m), f.splat(h * h, m)
        with f.count(3) as round_:
            group = (round_ + 1) & 1  # 1, 0, 1
            c = f.load(f.offset(nodes, group * m), m, 64)
            inner = group * 2
            tables = [
                [(value, group)],
                [(once, group), (inner_once, inner), (inner_once, inner + 1)],
                [(twice, group), (inner_twice, inner), (inner_twice, inner + 1)],
            ]

            def correct(j: Int | int, results: int) -> list[Value]:
                sources = [stages.at(j), residual[0].at(j), residual[1].at(j)]
                found = self._products(w, sources, tables[:results])
                known[j] = found[0]
                self.x[w.nv + j] = f.muladd(wide_h, found[1], f.splat(w.state[w.nv + j], m))
                return found

            for j in w.each(w.nv):
                found = correct(j, 3)
                q, v = f.splat(w.state[j], m), f.splat(w.state[w.nv + j], m)
                self.x[j] = f.muladd(wide_h2, found[2], f.muladd(wide_h * c, v, q))
            for j in range(w.system.nz):
                correct(w.nv + j, 2)
            w.dynamics(f.muladd(wide_h, c, f.splat(t, m)), self.x, self.fresh)
            w.count(Whole.EVALUATIONS)
            inside = f.compare_int("eq", group, 0)
            for j in w.each(w.rates):
                d = self.fresh[j] - known[j]
                for k, kept in enumerate((residual[0][j], residual[1][j])):
                    residual[k][j] = f.select(inside, kept if k else d, d if k else kept)
        rows = WIDTH // m
        once_rows = self._table(w, "dense.rows1", self._row_blocks(D.once_coefficients))
        twice_rows = self._table(w, "dense.rows2", self._row_blocks(D.twice_coefficients))
        zero = f.emit_int("add i64 0, 0")

        def store(j: Int | int, names: list[str]) -> None:
            blocks = [[(name, zero + k), (name, zero + (rows + k))] for name in names for k in range(rows)]
            for k, total in enumerate(self._products(w, [residual[0].at(j), residual[1].at(j)], blocks)):
                f.store(total, f.offset(self._correction(w, j), k * m))

        for j in w.each(w.nv):
            store(j, [once_rows, twice_rows])
        for j in range(w.system.nz):
            store(w.nv + j, [once_rows])

    def _row_blocks(self, coefficients: np.ndarray) -> np.ndarray:
        """Return the tables (group, 24, 8) as 8 x 8 blocks, each stored by columns."""
        m = self.stages
        blocks = [group[row : row + m].T.ravel() for group in coefficients for row in range(0, WIDTH, m)]
        return np.concatenate(blocks)

    def _horner(self, w: Writer, coefficients: list[Value], u: Value) -> Value:
        f = w.f
        p = f.splat(coefficients[-1], u.width)
        for c in reversed(coefficients[:-1]):
            p = f.muladd(p, u, f.splat(c, u.width))
        return p
