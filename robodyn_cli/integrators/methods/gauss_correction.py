"""The defect correction of the Gauss method's dense output, as code (see ``gauss_dense`` for the mathematics)."""

from __future__ import annotations

import numpy as np

from robodyn_cli.formulations.residual import Residual
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.methods.gauss_dense import dense_table, dense_width
from robodyn_cli.integrators.methods.gauss_tables import GaussTable, padded_width
from robodyn_cli.integrators.runtime.layout import Whole
from robodyn_cli.integrators.stepping.stepper import Stepper
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Int, Value, literal

SHORT = 200  # operations of the rates up to which they cannot be had for less
ROUNDS = 6  # of the iteration, which a step takes about


class Corrected(Stepper):
    """A collocation method with ``stages`` stages, whose rates at the stages are in ``guess``."""

    stages: int
    table: GaussTable

    @property
    def lanes(self) -> int:  # type: ignore[override]
        """Lanes of a vector of stages."""
        return padded_width(self.stages)

    guess: Array
    fresh: Array
    x: Array
    residual: Residual | None  # set where rates are found as corrections of a guess
    factors: Array

    def residual_of(self, system: System) -> Residual | None:
        """Return the system's rates as corrections of a guess, where that takes less than the rates themselves."""
        direct = system.dynamics.program
        if system.residual is None or system.dynamics.any_size or direct.operations < SHORT:
            return None
        return system.residual if system.residual.pays(direct, ROUNDS) else None

    def digest(self, system: System) -> str:
        residual = self.residual_of(system)
        return "" if residual is None else f" {residual.digest}"

    def renew(self, w: Writer, t: Value) -> None:
        """Factor what the corrections of the rates at times t and states ``x`` need, if they need anything."""
        if self.residual is not None:
            for k, entry in enumerate(w.evaluate(self.residual.factors, t, self.x)["l"]):
                self.factors[k] = entry

    def rates(self, w: Writer, t: Value, guess: Array) -> None:
        """Store the rates at times t and states ``x`` in ``fresh``, or a ``guess`` of them corrected once."""
        w.count(Whole.EVALUATIONS)
        if self.residual is None:
            w.dynamics(t, self.x, self.fresh)
            return
        found = w.evaluate(self.residual.correction, t, self.x, a=guess, l=self.factors)
        for k, d in enumerate(found["d"]):
            self.fresh[k] = guess[k] + d
        for k, rate in enumerate(found.get("z", [])):
            self.fresh[w.nv + k] = rate

    def _correction(self, w: Writer, j: Int | int) -> str:
        """Return the address of the correction of rate j: its integral's coefficients, then the double integral's."""
        return w.f.offset("%dense", w.rates * self.lanes + w.size + j * (2 * dense_width(self.stages)))

    def _rms(self, w: Writer) -> Array:
        """Return the root mean squares of the rates over the last step."""
        return Array(
            w.f, w.f.offset("%dense", w.rates * (self.lanes + 2 * dense_width(self.stages)) + w.size)
        )

    def _table(self, w: Writer, name: str, data: np.ndarray) -> str:
        """Keep a table in memory, columns one after the other, and return its address."""
        f = w.f
        flat = ", ".join(f"double {literal(x)}" for x in np.asarray(data, dtype=float).ravel())
        f.globals.append(f"@{name} = private unnamed_addr constant [{data.size} x double] [{flat}], align 64")
        return f"@{name}"

    def _products(self, w: Writer, sources: list[str], tables: list[list[tuple[str, Int]]]) -> list[Value]:
        """Return, for each result, the sum over sources of (m x m block of its table) times source.

        ``tables[r][k]`` is the address and block of the table that result r applies to source k, or result r has
        fewer sources. Columns in a loop: this code runs once a step, and unrolled it would be half of all code.
        """
        f, m = w.f, self.lanes
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

    def _refine(self, w: Writer, t: Value, h: Value) -> None:
        """Correct the collocation polynomial by its residual: between the stages, at them, between them again."""
        f, m = w.f, self.lanes
        T, D = self.table, dense_table(self.stages)

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
            c = f.load(f.offset(nodes, group * m), m, 8 * m)
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
            times = f.muladd(wide_h, c, f.splat(t, m))
            self.renew(w, times)
            self.rates(w, times, known)
            inside = f.compare_int("eq", group, 0)
            for j in w.each(w.rates):
                d = self.fresh[j] - known[j]
                for k, kept in enumerate((residual[0][j], residual[1][j])):
                    residual[k][j] = f.select(inside, kept if k else d, d if k else kept)
        rows = D.width // m
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
        """Return the tables (group, width, m) as m x m blocks, each stored by columns."""
        m = self.lanes
        blocks = [
            group[row : row + m].T.ravel() for group in coefficients for row in range(0, group.shape[0], m)
        ]
        return np.concatenate(blocks)

    def _horner(self, w: Writer, coefficients: list[Value], u: Value) -> Value:
        f = w.f
        p = f.splat(coefficients[-1], u.width)
        for c in reversed(coefficients[:-1]):
            p = f.muladd(p, u, f.splat(c, u.width))
        return p
