"""Dense output of the Gauss method and its defect correction, as code (see ``gauss_tables`` for the mathematics)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.integrators.methods.collocation_tables import (
    GaussTable,
    dense_table,
    dense_width,
    gauss_table,
    padded_width,
)
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.stepper import SLACK, Method, Stepper
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Function, Int, Value
from robodyn_cli.record import mutable_record

if TYPE_CHECKING:
    from robodyn_cli.formulations.residual import Residual

Numbers = NDArray[np.float64]


@mutable_record
class StageRates:
    """What an attempt hands to dense output: the rates at the stages, and their root mean squares."""

    rates: Array
    sizes: Array


class GaussOutput(Stepper[StageRates]):
    """Writes steps of a collocation method, whose rates at the stages are in ``guess``.

    lanes : of a vector of stages. x, fresh : states at the stages, and the rates evaluated there. residual : set where
    rates are found as corrections of a guess.
    """

    def __init__(self, method: Method, w: Writer, stages: int, residual: Residual | None) -> None:
        super().__init__(method, w)
        self.stages = stages
        self.lanes = padded_width(stages)
        self.table = gauss_table(stages)
        self.guess, self.fresh = w.array(1, 1, self.lanes), w.array(1, 1, self.lanes)
        self.x = w.array(2, 1, self.lanes)
        self.residual = residual
        if residual is not None:
            self.factors = Array(w.f, w.f.slot(self.lanes, len(residual.entries)), self.lanes)

    def factorise(self, t: Value) -> None:
        """Factor the mass matrices for corrections of the rates at times t and states ``x``, if these need any."""
        if self.residual is not None:
            for k, entry in enumerate(self.w.evaluate(self.residual.factors, t, self.x)["l"]):
                self.factors[k] = entry

    def evaluate(self, t: Value, guess: Array) -> None:
        """Store the rates at times t and states ``x`` in ``fresh``, or a ``guess`` of them corrected once."""
        w = self.w
        w.count(IntegerSlot.EVALUATIONS)
        if self.residual is None:
            w.dynamics(t, self.x, self.fresh)
            return
        outputs = w.evaluate(self.residual.correction, t, self.x, a=guess, l=self.factors)
        for k, d in enumerate(outputs["d"]):
            self.fresh[k] = guess[k] + d
        for k, rate in enumerate(outputs.get("z", [])):
            self.fresh[w.nv + k] = rate

    def _spread(self, j: Int | int) -> list[Value]:
        """Return rate j of each stage in all lanes: from memory, without shuffling, where calls keep it there."""
        f = self.f
        if self.residual is None:
            rate = self.guess[j]
            return [f.broadcast(rate, i) for i in range(self.stages)]
        return [f.splat(f.load(f.offset(self.guess.at(j), i)), self.lanes) for i in range(self.stages)]

    def _combine(self, a: list[Value], matrix: np.ndarray, factor: Value | None, start: Value) -> Value:
        """Return start + factor (matrix a), lanes being stages; two sums to shorten the chain."""
        f = self.f
        sums: list[Value | None] = [None, None]
        for i in range(self.stages):
            column = f.constant([float(x) for x in matrix[:, i]])
            part = sums[i & 1]
            sums[i & 1] = a[i] * column if part is None else f.muladd(a[i], column, part)
        total = sums[0]
        assert total is not None
        total = total if sums[1] is None else total + sums[1]
        return total if factor is None else f.muladd(factor, total, start)

    # -- what dense output keeps ----------------------------------------------------------------------
    def _polynomial(self, j: Int | int) -> str:
        """Return the address of the monomial coefficients of rate j (accelerations, then z rates)."""
        return self.f.offset("%dense", j * self.lanes)

    def _end(self) -> Array:
        """Return the state at the end of the step, before projection."""
        return Array(self.f, self.f.offset("%dense", self.w.rates * self.lanes))

    def _correction(self, j: Int | int) -> str:
        """Return the address of the correction of rate j: its integral's coefficients, then the double integral's."""
        w = self.w
        return w.f.offset("%dense", w.rates * self.lanes + w.size + j * (2 * dense_width(self.stages)))

    def _rms(self) -> Array:
        """Return the root mean squares of the rates over the last step."""
        w = self.w
        place = w.rates * (self.lanes + 2 * dense_width(self.stages)) + w.size
        return Array(w.f, w.f.offset("%dense", place))

    # -- defect correction ----------------------------------------------------------------------------
    def _products(self, sources: list[str], tables: list[list[tuple[str, Int]]]) -> list[Value]:
        """Return, for each result, the sum over sources of (m x m block of its table) times source.

        ``tables[r][k]`` is the address and block of the table that result r applies to source k, or result r has
        fewer sources. Columns in a loop: this code runs once per step, and unrolled it would be half of all code.
        """
        f, m = self.f, self.lanes
        totals = [f.slot(m) for _ in tables]
        for slot in totals:
            f.store(f.constant(0.0, m), slot, 8 * m)
        with f.count(self.stages) as i:
            scalars = [f.splat(f.load(f.offset(source, i)), m) for source in sources]
            for slot, row in zip(totals, tables):
                total = f.load(slot, m, 8 * m)
                for (table, block), scalar in zip(row, scalars):
                    column = f.load(f.offset(table, block * (m * m) + i * m), m, 8 * m)
                    total = f.muladd(scalar, column, total)
                f.store(total, slot, 8 * m)
        return [f.load(slot, m, 8 * m) for slot in totals]

    def _refine(self, t: Value, h: Value, kept: StageRates) -> None:
        """Correct the collocation polynomial by its residual: between the stages, at them, between them again."""
        f, w, m = self.f, self.w, self.lanes
        tables = _Tables(f, self.table, self.stages)
        # addressed by a running index, so apart from the iterates, which are to stay in registers
        stages, known = w.array(1, 1, m), w.array(1, 1, m)
        residual = [w.array(1, 1, m) for _ in range(2)]
        for j in w.each(w.rates):
            stages[j] = kept.rates[j]
            residual[0][j] = residual[1][j] = 0.0
        wide_h, wide_h2 = f.splat(h, m), f.splat(h * h, m)
        with f.count(3) as round_:
            group = (round_ + 1) & 1  # 1, 0, 1
            c = f.load(f.offset(tables.nodes, group * m), m, 8 * m)
            rows = tables.rows(group)

            def correct(j: Int | int, results: int) -> list[Value]:
                sources = [stages.at(j), residual[0].at(j), residual[1].at(j)]
                sums = self._products(sources, rows[:results])
                known[j] = sums[0]
                self.x[w.nv + j] = f.muladd(wide_h, sums[1], f.splat(w.state[w.nv + j], m))
                return sums

            for j in w.each(w.nv):
                products = correct(j, 3)
                q, v = f.splat(w.state[j], m), f.splat(w.state[w.nv + j], m)
                self.x[j] = f.muladd(wide_h2, products[2], f.muladd(wide_h * c, v, q))
            for j in w.each(w.nz):
                correct(w.nv + j, 2)
            times = f.muladd(wide_h, c, f.splat(t, m))
            self.factorise(times)
            self.evaluate(times, known)
            inside = f.compare_int("eq", group, 0)
            for j in w.each(w.rates):
                d = self.fresh[j] - known[j]
                for k, old in enumerate((residual[0][j], residual[1][j])):
                    residual[k][j] = f.select(inside, old if k else d, d if k else old)
        self._keep_correction(residual)

    def _keep_correction(self, residual: list[Array]) -> None:
        """Store the coefficients of the residual's integral and, for velocities, of its double integral."""
        f, w, m, D = self.f, self.w, self.lanes, dense_table(self.stages)
        rows = D.width // m
        once = f.table("dense.rows1", _row_blocks(D.once_coefficients, m))
        twice = f.table("dense.rows2", _row_blocks(D.twice_coefficients, m))

        def store(j: Int | int, names: list[str]) -> None:
            blocks = [
                [(name, f.integer(k)), (name, f.integer(rows + k))] for name in names for k in range(rows)
            ]
            for k, total in enumerate(self._products([residual[0].at(j), residual[1].at(j)], blocks)):
                f.store(total, f.offset(self._correction(j), k * m))

        for j in w.each(w.nv):
            store(j, [once, twice])
        for j in w.each(w.nz):
            store(w.nv + j, [once])

    # -- dense output ---------------------------------------------------------------------------------
    def _horner(self, coefficients: list[Value], u: Value) -> Value:
        f = self.f
        p = f.splat(coefficients[-1], u.width)
        for c in reversed(coefficients[:-1]):
            p = f.muladd(p, u, f.splat(c, u.width))
        return p

    def save_dense(self, t: Value, h: Value, kept: StageRates) -> None:
        f, w, T = self.f, self.w, self.table
        w.put(DoubleSlot.DENSE_END, t + h)
        w.put(DoubleSlot.DENSE_STEP, h)
        # samples beyond the end belong to the next step
        with f.when(w.due(t + h, 2.0 * SLACK)):
            self._refine(t, h, kept)
        for j in w.each(w.rates):
            nothing = f.constant(0.0, self.lanes)
            f.store(self._combine(self._spread(j), T.M, None, nothing), self._polynomial(j))
        end, rms = self._end(), self._rms()
        for k in w.each(w.size):
            end[k] = w.new[k]
        for j in w.each(w.rates):
            rms[j] = kept.sizes[j]

    def _once(self, j: Int | int, u: Value, h: Value) -> Value:
        """Return the velocity or z of rate j at u: from the end of the step, plus h u sum d_k u^k / (k+1)."""
        w = self.w
        f, d = self.f, self._coefficients(j)
        total = self._horner([x * (1.0 / (k + 1)) for k, x in enumerate(d)], u)
        return f.muladd(u * h, total, self._end()[w.nv + j])

    def _twice(self, j: Int | int, u: Value, h: Value) -> Value:
        """Return position j at u: q1 + h u v1 + h^2 u^2 sum d_k u^k / ((k+1) (k+2))."""
        w = self.w
        f, d, end = self.f, self._coefficients(j), self._end()
        hu = u * h
        total = self._horner([x * (1.0 / ((k + 1) * (k + 2))) for k, x in enumerate(d)], u)
        return f.muladd(hu * hu, total, f.muladd(hu, end[w.nv + j], end[j]))

    def _coefficients(self, j: Int | int) -> list[Value]:
        f = self.f
        address = self._polynomial(j)
        return [f.load(f.offset(address, k)) for k in range(self.stages)]

    def dense(self, u: Value, h: Value, out: Array) -> None:
        w = self.w
        for j in w.each(w.nv):
            out[j] = self._twice(j, u, h)
        for j in w.each(w.rates):
            out[w.nv + j] = self._once(j, u, h)

    def sample(self, u: Value, h: Value, out: Array) -> None:
        """Dense output plus the correction that ``_refine`` left behind."""
        f, w = self.f, self.w
        x = u * 2.0 + 1.0

        def correction(j: Int | int, first: int, count: int) -> Value:
            address = self._correction(j)
            return self._horner([f.load(f.offset(address, first + k)) for k in range(count)], x)

        for j in w.each(w.nv):
            out[j] = f.muladd(
                h * h, correction(j, dense_width(self.stages), 2 * self.stages + 2), self._twice(j, u, h)
            )
        for j in w.each(w.rates):
            out[w.nv + j] = f.muladd(h, correction(j, 0, 2 * self.stages + 1), self._once(j, u, h))


class _Tables:
    """The tables of ``gauss_tables`` in memory: of m x m blocks, columns one after the other."""

    def __init__(self, f: Function, T: GaussTable, stages: int) -> None:
        D = dense_table(stages)
        self.nodes = f.table("dense.nodes", np.concatenate([T.c, D.extra]))
        self.value = f.table("dense.value", _columns(np.eye(T.lanes), D.value))
        self.once = f.table("dense.once", _columns(T.A, D.once))
        self.twice = f.table("dense.twice", _columns(T.A2, D.twice))
        self.inner_once = f.table("dense.inner1", _pairs(D.inner_once))
        self.inner_twice = f.table("dense.inner2", _pairs(D.inner_twice))

    def rows(self, group: Int) -> list[list[tuple[str, Int]]]:
        """Return what gives rates, integrals and double integrals at a group: of the stages, then the residuals."""
        inner = group * 2
        return [
            [(self.value, group)],
            [(self.once, group), (self.inner_once, inner), (self.inner_once, inner + 1)],
            [(self.twice, group), (self.inner_twice, inner), (self.inner_twice, inner + 1)],
        ]


def _columns(*blocks: Numbers) -> Numbers:
    return np.concatenate([b.T.ravel() for b in blocks])


def _pairs(table: Numbers) -> Numbers:
    return _columns(*(table[a, b] for a in (0, 1) for b in (0, 1)))


def _row_blocks(coefficients: Numbers, m: int) -> Numbers:
    """Return the tables (group, width, m) as m x m blocks, each stored by columns."""
    return _columns(*(g[row : row + m] for g in coefficients for row in range(0, g.shape[0], m)))
