"""Gauss collocation of order 16, its eight stages evaluated together in the SIMD lanes.

The stage accelerations solve a = f(t + c h, q + h c v + h^2 A^2 a, v + h A a) (Hairer, Lubich and Wanner 2006,
II.1 and II.2), here by fixed-point iteration from the previous step's polynomial. The method is symplectic and
symmetric; the iteration limits the step on stiff problems, where a linearly implicit method is the right one.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.gauss_dense import WIDTH, dense_table
from robodyn_cli.integrators.gauss_tables import gauss_table
from robodyn_cli.integrators.layout import Real, Whole
from robodyn_cli.integrators.loop import SLACK, Attempt, Stepper, Writer
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
        f, s = w.f, w.system
        self.table = gauss_table(self.stages)
        self.guess = [f.slot(self.stages) for _ in range(s.nv + s.nz)]
        self.weight = [f.slot() for _ in range(s.nv + s.nz)]
        self.before = f.slot()
        self.round = f.int_slot()
        self.primed = f.int_slot()

    def _polynomial(self, w: Writer, j: int) -> str:
        """Return the address of the monomial coefficients of rate j (accelerations, then z rates)."""
        return w.f.offset("%dense", j * self.stages)

    def _end(self, w: Writer, k: int) -> str:
        """Return the address of component k of the state at the end of the step, before projection."""
        return w.f.offset("%dense", (w.system.nv + w.system.nz) * self.stages + k)

    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        f, s, T = w.f, w.system, self.table
        n = s.nv + s.nz
        lanes = self.stages
        nodes = f.constant(list(T.c))
        x0 = [f.load(a) for a in w.state]
        q0, v0, z0 = x0[: s.nq], x0[s.nq : s.nq + s.nv], x0[s.nq + s.nv :]
        self._weigh(w, h, x0, [f.load(self._size(w, j)) for j in range(n)])
        self._predict(w, h)
        wide_h, wide_h2 = f.splat(h, lanes), f.splat(h * h, lanes)
        times = f.muladd(wide_h, nodes, f.splat(t, lanes))
        drift = [f.muladd(wide_h * nodes, f.splat(v, lanes), f.splat(q, lanes)) for q, v in zip(q0, v0)]
        f.store(1e300, self.before)
        # the first step of a run knows no rates yet: one round shows them, then they take part in the weights
        known = f.compare_int("sgt", f.load_int(w.whole(Whole.ACCEPTED)), 0)
        f.store_int(f.select_int(known, 1, 0), self.primed)
        f.store_int(f.select_int(known, 0, ITERATIONS), self.round)
        iterate, onward, enough = f.label("iterate"), f.label("onward"), f.label("solved")
        f.jump(iterate)
        f.place(iterate)
        old = [f.load(a, lanes, 64) for a in self.guess]
        Q = [self._combine(w, old[j], T.A2, wide_h2, drift[j]) for j in range(s.nv)]
        V = [self._combine(w, old[j], T.A, wide_h, f.splat(v0[j], lanes)) for j in range(s.nv)]
        Z = [self._combine(w, old[s.nv + j], T.A, wide_h, f.splat(z0[j], lanes)) for j in range(s.nz)]
        a, zr = w.dynamics(times, [*Q, *V, *Z], lanes)
        fresh = [f.splat(x, lanes) for x in [*a, *zr]]
        w.count(Whole.EVALUATIONS)
        with f.strict():
            square: Value | None = None
            for j in range(n):
                d = (fresh[j] - old[j]) * f.splat(f.load(self.weight[j]), lanes)
                square = d * d if square is None else f.fma(d, d, square)
                f.store(fresh[j], self.guess[j], 64)
            assert square is not None
            update = f.sqrt(f.reduce("add", square))
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
        self._weigh(w, h, x0, [f.sqrt(f.reduce("add", x * x) * (1.0 / lanes)) for x in fresh])
        f.jump(iterate)
        f.place(stuck)
        # an update that no longer shrinks is rounding when it is well below the tolerance
        f.branch(f.compare("olt", update, 0.1), enough, diverged)
        f.place(diverged)
        w.put(Real.H, h * f.select(f.compare("ord", update, 0.0), f.constant(0.5), f.constant(0.1)))
        f.jump(failed)
        f.place(enough)
        final = [f.load(x, lanes, 64) for x in self.guess]
        self._advance(w, h, x0, final)
        return self._judge(w, final, [f.load(x) for x in self.weight])

    def _weigh(self, w: Writer, h: Value, x0: list[Value], sizes: list[Value]) -> None:
        """Set what an error of each rate means for the state over this step, in units of the tolerance.

        A velocity counts as at least what its rate makes of it in the step, so that one that passes zero is not
        held to an absolute standard; a position sets the standard where the motion is slow.
        """
        f, s = w.f, w.system
        rtol, atol = w.get(Real.RTOL), w.get(Real.ATOL)
        with f.strict():
            for j, size in enumerate(sizes):
                speed, gained = f.abs(x0[s.nq + j]), h * size
                largest = f.select(f.compare("ogt", speed, gained), speed, gained)
                weight = h / f.muladd(largest, rtol, atol)
                if j < s.nv:
                    other = h * h / f.muladd(f.abs(x0[j]), rtol, atol)
                    weight = f.select(f.compare("ogt", other, weight), other, weight)
                f.store(weight, self.weight[j])

    def _combine(self, w: Writer, a: Value, matrix: np.ndarray, factor: Value, start: Value) -> Value:
        """Return start + factor (matrix a), lanes being stages; two sums to shorten the chain."""
        f = w.f
        sums: list[Value | None] = [None, None]
        for i in range(self.stages):
            column = f.constant([float(x) for x in matrix[:, i]])
            x = f.broadcast(a, i)
            part = sums[i & 1]
            sums[i & 1] = x * column if part is None else f.muladd(x, column, part)
        assert sums[0] is not None and sums[1] is not None
        return f.muladd(factor, sums[0] + sums[1], start)

    def _predict(self, w: Writer, h: Value) -> None:
        """Extrapolate the previous step's rates to the new stages."""
        f = w.f
        lanes = self.stages
        old_h = w.get(Real.H_OLD)
        stretch = h / old_h
        u = f.splat(stretch, lanes) * f.constant(list(self.table.c))
        for j, slot in enumerate(self.guess):
            address = self._polynomial(w, j)
            p = f.splat(f.load(f.offset(address, self.stages - 1)), lanes)
            for k in reversed(range(self.stages - 1)):
                p = f.muladd(p, u, f.splat(f.load(f.offset(address, k)), lanes))
            f.store(p, slot, 64)

    def _advance(self, w: Writer, h: Value, x0: list[Value], rates: list[Value]) -> None:
        f, s, T = w.f, w.system, self.table
        b, b_bar = f.constant(list(T.b)), f.constant(list(T.b_bar))
        for j in range(s.nv):
            q, v = x0[j], x0[s.nq + j]
            f.store(f.muladd(h * h, f.reduce("add", rates[j] * b_bar), f.muladd(h, v, q)), w.new[j])
            f.store(f.muladd(h, f.reduce("add", rates[j] * b), v), w.new[s.nq + j])
        for j in range(s.nz):
            z = x0[s.nq + s.nv + j]
            rate = f.reduce("add", rates[s.nv + j] * b)
            f.store(f.muladd(h, rate, z), w.new[s.nq + s.nv + j])

    def _judge(self, w: Writer, rates: list[Value], weight: list[Value]) -> Attempt:
        """Estimate the error: the square of the top Legendre coefficients relative to the rate itself.

        The coefficients fall geometrically, and superconvergence squares what they say about a smooth solution.
        """
        f, s, T = w.f, w.system, self.table
        top = f.constant([float(x) for x in T.legendre[-1]])
        below = f.constant([float(x) for x in T.legendre[-2]])
        with f.strict():
            total: Value | None = None
            self.sizes = []
            for j in range(s.nv + s.nz):
                c = f.reduce("add", rates[j] * top)
                d = f.reduce("add", rates[j] * below)
                size = f.sqrt(f.reduce("add", rates[j] * rates[j]) * (1.0 / self.stages))
                self.sizes.append(size)
                e = f.muladd(d * d, SECOND, c * c) * weight[j] / (size + 1e-300)
                total = e * e if total is None else f.muladd(e, e, total)
            assert total is not None
            error = f.sqrt(total * (SCALE * SCALE / len(rates)))
            bounded = f.max(error, 1e-14)
            factor = rough_power(f, bounded, -1.0 / (2 * self.stages - 1)) * SAFETY
            ratio = w.get(Real.MEMORY)
            growth = f.select(f.compare("olt", error, 1e-8), f.constant(4.0), f.constant(1.6))
            factor = f.min(f.max(f.min(factor, BEST_RATIO / (ratio + 1e-9)), 0.3), growth)
        return Attempt(error * (1.0 / ACCEPT), factor)

    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        f, s, T = w.f, w.system, self.table
        # samples beyond the step's end are not this step's business
        with f.when(w.due(t + h, 2.0 * SLACK)):
            self._refine(w, t, h)
        for j in range(s.nv + s.nz):
            a = f.load(self.guess[j], self.stages, 64)
            sums: list[Value | None] = [None, None]
            for i in range(self.stages):
                column = f.constant([float(x) for x in T.M[:, i]])
                x = f.broadcast(a, i)
                part = sums[i & 1]
                sums[i & 1] = x * column if part is None else f.muladd(x, column, part)
            assert sums[0] is not None and sums[1] is not None
            f.store(sums[0] + sums[1], self._polynomial(w, j))
        for k in range(s.size):
            f.store(f.load(w.new[k]), self._end(w, k))
        for j, size in enumerate(self.sizes):
            f.store(size, self._size(w, j))

    def dense(self, w: Writer, u: Value, h: Value) -> list[Value]:
        """q = q1 + h u v1 + h^2 u^2 sum d_k u^k / ((k+1)(k+2)), and so on, from the end of the step."""
        f, s = w.f, w.system
        m = self.stages
        hu = u * h
        q, v, z = [], [], []
        for j in range(s.nv + s.nz):
            d = [f.load(f.offset(self._polynomial(w, j), k)) for k in range(m)]
            once = self._horner(w, [d[k] * (1.0 / (k + 1)) for k in range(m)], u)
            if j >= s.nv:
                z.append(f.muladd(hu, once, f.load(self._end(w, s.nq + s.nv + j - s.nv))))
                continue
            twice = self._horner(w, [d[k] * (1.0 / ((k + 1) * (k + 2))) for k in range(m)], u)
            q1, v1 = f.load(self._end(w, j)), f.load(self._end(w, s.nq + j))
            v.append(f.muladd(hu, once, v1))
            q.append(f.muladd(hu * hu, twice, f.muladd(hu, v1, q1)))
        return [*q, *v, *z]

    def sample(self, w: Writer, u: Value, h: Value) -> list[Value]:
        """Dense output plus the correction that ``_refine`` left behind."""
        f, s = w.f, w.system
        x = u * 2.0 + 1.0
        out = self.dense(w, u, h)
        for j in range(s.nv + s.nz):
            once = [f.load(f.offset(self._correction(w, j), k)) for k in range(2 * self.stages + 1)]
            place = s.nq + j
            out[place] = f.muladd(h, self._horner(w, once, x), out[place])
            if j < s.nv:
                twice = [f.load(f.offset(self._correction(w, j), WIDTH + k)) for k in range(2 * self.stages + 2)]
                out[j] = f.muladd(h * h, self._horner(w, twice, x), out[j])
        return out

    def _correction(self, w: Writer, j: int) -> str:
        """Return the address of the correction of rate j: its integral's coefficients, then the double integral's."""
        s = w.system
        return w.f.offset("%dense", (s.nv + s.nz) * self.stages + s.size + 2 * WIDTH * j)

    def _size(self, w: Writer, j: int) -> str:
        """Return the address of the root mean square of rate j over the last step."""
        s = w.system
        return w.f.offset("%dense", (s.nv + s.nz) * (self.stages + 2 * WIDTH) + s.size + j)

    def _table(self, w: Writer, name: str, data: np.ndarray) -> str:
        """Keep a table in memory, columns one after the other, and return its address."""
        f = w.f
        flat = ", ".join(f"double {literal(x)}" for x in np.asarray(data, dtype=float).ravel())
        f.globals.append(f"@{name} = private unnamed_addr constant [{data.size} x double] [{flat}], align 64")
        return f"@{name}"

    def _products(
        self, w: Writer, sources: list[str], tables: list[list[tuple[str, Int]]]
    ) -> list[Value]:
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
        f, s, m = w.f, w.system, self.stages
        T, D = self.table, dense_table(m)
        rates = s.nv + s.nz

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
        stages = [f.slot(m) for _ in range(rates)]
        for slot, guess in zip(stages, self.guess):
            f.store(f.load(guess, m, 64), slot, 64)
        residual = [[f.slot(m) for _ in range(rates)] for _ in range(2)]
        for slot in (*residual[0], *residual[1]):
            f.store(f.constant(0.0, m), slot, 64)
        x0 = [f.splat(f.load(a), m) for a in w.state]
        wide_h, wide_h2 = f.splat(h, m), f.splat(h * h, m)
        with f.count(3) as round_:
            group = (round_ + 1) & 1  # 1, 0, 1
            c = f.load(f.offset(nodes, group * m), m, 64)
            inner = group * 2
            q: list[Value] = []
            v: list[Value] = []
            z: list[Value] = []
            known: list[Value] = []
            for j in range(rates):
                sources = [stages[j], residual[0][j], residual[1][j]]
                tables = [
                    [(value, group)],
                    [(once, group), (inner_once, inner), (inner_once, inner + 1)],
                    [(twice, group), (inner_twice, inner), (inner_twice, inner + 1)],
                ]
                found = self._products(w, sources, tables[: 3 if j < s.nv else 2])
                known.append(found[0])
                (v if j < s.nv else z).append(f.muladd(wide_h, found[1], x0[s.nq + j]))
                if j < s.nv:
                    q.append(f.muladd(wide_h2, found[2], f.muladd(wide_h * c, x0[s.nq + j], x0[j])))
            acceleration, z_rate = w.dynamics(f.muladd(wide_h, c, f.splat(t, m)), [*q, *v, *z], m)
            w.count(Whole.EVALUATIONS)
            inside = f.compare_int("eq", group, 0)
            for j, fresh in enumerate([*acceleration, *z_rate]):
                d = f.splat(fresh, m) - known[j]
                for k, slot in enumerate((residual[0][j], residual[1][j])):
                    kept = f.load(slot, m, 64)
                    f.store(f.select(inside, kept if k else d, d if k else kept), slot, 64)
        rows = WIDTH // m
        once_rows = self._table(w, "dense.rows1", self._row_blocks(D.once_coefficients))
        twice_rows = self._table(w, "dense.rows2", self._row_blocks(D.twice_coefficients))
        zero = f.emit_int("add i64 0, 0")
        for j in range(rates):
            names = [once_rows, twice_rows] if j < s.nv else [once_rows]
            tables = [[(name, zero + k), (name, zero + (rows + k))] for name in names for k in range(rows)]
            for k, total in enumerate(self._products(w, [residual[0][j], residual[1][j]], tables)):
                f.store(total, f.offset(self._correction(w, j), k * m))

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
