"""Backward differentiation of variable order 1 to 5 for stiff motion, the method of MATLAB's ode15s.

Quasi-constant steps with backward differences (Shampine and Reichelt 1997): the differences D_j of the last values,
taken for the present step, are the polynomial through them. A step solves, for d = x - sum D_j,

    f(t + h, x) - (alpha_k / h) (psi + d) = 0,    psi = sum gamma_j D_j / alpha_k

by Newton's method with the exact Jacobian. Two histories are kept, so that a step that is looked at but not taken (an
event lies in it) leaves the other one as it was.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.methods import bdf_tables as tables
from robodyn_cli.integrators.runtime.layout import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.factors import RealFactors
from robodyn_cli.integrators.stepping.newton import Limits, Rounds
from robodyn_cli.integrators.stepping.stepper import Attempt, Stepper
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Int, Value, literal
from robodyn_cli.kernels.mathematics import rough_power
from robodyn_cli.kernels.program import Program

ROWS = tables.ROWS
LIMITS = Limits(rounds=5, converged=0.003, rounding=0.03, shorter=0.3)
ROUNDING = 1e-15
SAFETY = 0.85
HOLD = 1.2  # a step that could grow by less stays as it is
JUMP = 10.0  # a state that lies so many tolerances off the history has been replaced
CAUTION = 0.3  # of the first step, which is of order 1, its error being half of this squared
# head of %dense: which history is the latest, where the last run was to end, whether to begin anew, whether begun
LATEST, END, ANEW, BEGUN, HEAD = 0, 1, 2, 3, 8
# head of a history: its time, step, order, steps since a change, order of its last step
STAMP, STEP, ORDER, STEADY, TAKEN, FIRST = 0, 1, 2, 3, 4, 8


class Bdf(Stepper):
    """Backward differentiation formulas of order 1 to 5 (NDF): stiffly stable, order and step chosen along the run."""

    name = "bdf"
    order = 5
    dense_order = 4
    needs_jacobian = True

    def linearisation(self, system: System) -> Program:
        return system.linearisation

    def dense_size(self, system: System) -> int:
        return HEAD + 2 * self._history_size(system)

    def _history_size(self, system: System) -> int:
        return FIRST + ROWS * system.size

    def prepare(self, w: Writer) -> None:
        f, n = w.f, w.system.size
        for name, table in (("masks", tables.masks()), ("histories", tables.histories())):
            self._constant(w, name, table)
        self._constant(w, "alpha", np.append(tables.ALPHA, [0.0, 0.0]))
        self._constant(w, "error", np.append(tables.ERROR, [0.0, 0.0]))
        self.D, self.next = Array(f, f.slot(1, ROWS * n)), Array(f, f.slot(1, ROWS * n))
        self.predicted, self.psi, self.d = (Array(f, f.slot(1, n)) for _ in range(3))
        self.x, self.rates = Array(f, f.slot(1, n)), Array(f, f.slot(1, n))
        self.k, self.steady, self.new_k, self.new_steady = (f.int_slot() for _ in range(4))
        self.weight, self.factor = Array(f, f.slot(1, n)), f.slot()
        self.rounds = Rounds(w, LIMITS)
        # where the last run has come to its end there may be a kink: begin anew
        t, end, last = w.get(DoubleSlot.T), w.get(DoubleSlot.T_END), self._head(w, END)
        arrived = f.compare("ole", f.abs(t - last), f.muladd(f.abs(last), 1e-15, 1e-300))
        begun = f.compare("ogt", self._head(w, BEGUN), 0.5)
        anew = arrived & begun & f.compare("une", end, last)
        self._set_head(w, ANEW, f.select(anew, f.constant(1.0), self._head(w, ANEW)))
        self._set_head(w, END, end)

    def _constant(self, w: Writer, name: str, table: np.ndarray) -> None:
        flat = ", ".join(f"double {literal(float(x))}" for x in table.ravel())
        w.f.globals.append(
            f"@bdf.{name} = private unnamed_addr constant [{table.size} x double] [{flat}], align 64"
        )

    def _head(self, w: Writer, place: int) -> Value:
        return w.f.load(w.f.offset("%dense", place))

    def _set_head(self, w: Writer, place: int, x: Value | float) -> None:
        w.f.store(x, w.f.offset("%dense", place))

    def _history(self, w: Writer, which: Value) -> str:
        """Return the address of history 0 or 1."""
        f = w.f
        return f.offset("%dense", f.to_int(which) * self._history_size(w.system) + HEAD)

    # -- history --------------------------------------------------------------------------------------
    def _begin(self, w: Writer, t: Value, h: Value, failed: str) -> str:
        """Return the address of the history that ends at t; where there is none, one is begun at order 1."""
        f, n = w.f, w.system.size
        latest = self._head(w, LATEST)
        chosen = f.slot()
        a, b = self._history(w, latest), self._history(w, 1.0 - latest)

        def fits(history: str) -> Value:
            gap = f.abs(f.load(f.offset(history, STAMP)) - t)
            return f.select(
                f.compare("ole", gap, f.load(f.offset(history, STEP)) * 1e-6),
                f.constant(1.0),
                f.constant(0.0),
            )

        fit_a, fit_b = fits(a), fits(b)
        f.store(f.select(f.compare("ogt", fit_a, 0.5), latest, 1.0 - latest), chosen)
        history = self._history(w, f.load(chosen))
        total = Total(f)
        with f.strict():
            for c in range(n):
                gap = (f.load(f.offset(history, FIRST + c)) - w.state[c]) / self._scale(w, f.abs(w.state[c]))
                total.add_product(gap, gap)
        same = f.compare("olt", total.value, JUMP * JUMP)
        known = f.compare("ogt", fit_a + fit_b, 0.5) & f.compare("olt", self._head(w, ANEW), 0.5) & same
        known = known & f.compare("ogt", self._head(w, BEGUN), 0.5)
        fresh, ready = f.label("fresh"), f.label("ready")
        f.branch(known, ready, fresh)
        f.place(fresh)
        w.rate(t, w.state, self.rates)
        w.count(IntegerSlot.EVALUATIONS, 2)
        small = h * 1e-4
        for c in range(n):
            self.x[c] = f.muladd(small, self.rates[c], w.state[c])
            self.d[c] = self.rates[c]
        w.rate(t + small, self.x, self.rates)
        with f.strict():
            bend = Total(f)
            for c in range(n):
                gained = f.abs(h * self.d[c])
                second = (self.rates[c] - self.d[c]) / (
                    small * self._scale(w, f.max(f.abs(w.state[c]), gained * 1e-3))
                )
                bend.add_product(second, second)
            curvature = f.sqrt(bend.value * (1.0 / n))
            h1 = f.min(h, CAUTION / f.sqrt(f.max(curvature, 1e-300)))
            h1 = f.select(f.compare("ord", h1, 0.0), h1, h * 0.1)
        other = self._history(w, 1.0 - f.load(chosen))
        f.store(-1e300, f.offset(other, STAMP))
        for place, value in ((STAMP, t), (STEP, h1), (ORDER, 1.0), (STEADY, 0.0), (TAKEN, 1.0)):
            f.store(value, f.offset(history, place))
        for c in range(n):
            for row in range(ROWS):
                start = w.state[c] if row == 0 else h1 * self.d[c] if row == 1 else 0.0
                f.store(start, f.offset(history, FIRST + row * n + c))
        self._set_head(w, LATEST, f.load(chosen))
        self._set_head(w, ANEW, 0.0)
        self._set_head(w, BEGUN, 1.0)
        shorter = f.label("shorter")
        f.branch(f.compare("olt", h1, h * 0.999), shorter, ready)
        f.place(shorter)
        # only the first step of a history is proposed anew here, nothing was rejected
        w.put(DoubleSlot.H, h1)
        w.count(IntegerSlot.REJECTED, -1)
        w.count(IntegerSlot.REJECTED_IN_ROW, -1)
        f.jump(failed)
        f.place(ready)
        return self._history(w, f.load(chosen))

    def _load(self, w: Writer, history: str, h: Value) -> None:
        """Take a history over, for steps of length h."""
        f, n = w.f, w.system.size
        k = f.to_int(f.load(f.offset(history, ORDER)))
        f.store_int(k, self.k)
        f.store_int(f.to_int(f.load(f.offset(history, STEADY))), self.steady)
        for c in range(n):
            for row in range(ROWS):
                self.D[row * n + c] = f.load(f.offset(history, FIRST + row * n + c))
            self.D[c] = w.state[c]
        r = h / f.load(f.offset(history, STEP))
        with f.when(f.compare("ogt", f.abs(r - 1.0), 1e-10)):
            f.store_int(0, self.steady)
            mask = [f.load(f.offset("@bdf.masks", k * ROWS + j)) for j in range(tables.HIGHEST + 1)]
            polynomials = tables.rescaling()
            with f.strict():
                for c in range(n):
                    old = [self.D[j * n + c] * mask[j] for j in range(tables.HIGHEST + 1)]
                    for j in range(1, tables.HIGHEST + 1):
                        total: Value | None = None
                        for m in range(j, tables.HIGHEST + 1):
                            weight = self._polynomial(w, polynomials[j][m], r)
                            total = weight * old[m] if total is None else f.muladd(weight, old[m], total)
                        assert total is not None
                        self.D[j * n + c] = total

    def _polynomial(self, w: Writer, coefficients: list[float], r: Value) -> Value:
        p = w.f.constant(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            p = w.f.muladd(p, r, c)
        return p

    # -- the step -------------------------------------------------------------------------------------
    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        f, n = w.f, w.system.size
        history = self._begin(w, t, h, failed)
        self._load(w, history, h)
        k = f.load_int(self.k)
        rows = range(tables.HIGHEST + 1)
        mask = [f.load(f.offset("@bdf.masks", k * ROWS + j)) for j in rows]
        past = [f.load(f.offset("@bdf.histories", k * ROWS + j)) for j in rows]
        for c in range(n):
            x, psi = self.D[c], f.constant(0.0)
            for j in rows[1:]:
                x = f.muladd(mask[j], self.D[j * n + c], x)
                psi = f.muladd(past[j], self.D[j * n + c], psi)
            self.predicted[c], self.psi[c], self.d[c] = x, psi, 0.0
        g = f.load(f.offset("@bdf.alpha", k)) / h
        factors = RealFactors(w, t + h, self.predicted, g)
        w.count(IntegerSlot.EVALUATIONS)
        self._iterate(w, factors, t + h, h, g, failed)
        return self._judge(w, k)

    def _scale(self, w: Writer, size: Value) -> Value:
        f = w.f
        return f.max(
            f.muladd(size, w.get(DoubleSlot.RTOL), w.get(DoubleSlot.ATOL)), f.muladd(size, ROUNDING, 1e-300)
        )

    def _iterate(self, w: Writer, factors: RealFactors, t: Value, h: Value, g: Value, failed: str) -> None:
        """Solve for d by Newton's method; jumps to ``failed`` where it does not converge."""
        f, n = w.f, w.system.size
        self.rounds.begin()
        for c in range(n):
            self.x[c] = self.predicted[c] + self.d[c]
        w.rate(t, self.x, self.rates)
        w.count(IntegerSlot.EVALUATIONS)
        residual = [self.rates[c] - g * (self.psi[c] + self.d[c]) for c in range(n)]
        changes = factors.solve(residual)
        with f.strict():
            square = Total(f)
            for c, change in enumerate(changes):
                self.d[c] = self.d[c] + change
                size = f.max(f.abs(w.state[c]), f.abs(self.predicted[c] + self.d[c]))
                e = change / self._scale(w, size)
                square.add_product(e, e)
            update = f.sqrt(square.value * (1.0 / n))
        self.rounds.judge(update, h, failed)

    # -- error and order ------------------------------------------------------------------------------
    def _judge(self, w: Writer, k: Int) -> Attempt:
        f, n = w.f, w.system.size
        for c in range(n):
            w.new[c] = self.predicted[c] + self.d[c]
            self.weight[c] = 1.0 / self._scale(w, f.max(f.abs(w.state[c]), f.abs(w.new[c])))
            for row in range(ROWS):
                self.next[row * n + c] = self.D[row * n + c]

        def norm(entry: Array, order: Int) -> Value:
            """Return the mean square of error coefficient times an array of differences, in units of the tolerance."""
            constant = f.load(f.offset("@bdf.error", order))
            with f.strict():
                square = Total(f)
                for c in range(n):
                    e = constant * entry[c] * self.weight[c]
                    square.add_product(e, e)
                return f.max(square.value * (1.0 / n), 1e-20)

        error = norm(self.d, k)
        # differences at the new time, from the highest down
        top = k + 1
        for c in range(n):
            d, old = self.d[c], self.D[top * n + c]
            self.next[top * n + n + c] = d - old
            self.next[top * n + c] = d
        with f.count(top, down=True) as place:
            for c in range(n):
                self.next[place * n + c] = self.next[place * n + c] + self.next[place * n + n + c]

        def could(square: Value, order: Int) -> Value:
            return self._power(w, square, order) * SAFETY

        present = could(error, k)
        steady = f.load_int(self.steady) + 1
        f.store_int(steady, self.new_steady)
        f.store_int(k, self.new_k)
        rejected = f.compare_int("sgt", f.load_int(w.integer_at(IntegerSlot.REJECTED_IN_ROW)), 0)
        with f.strict():
            f.store(f.min(f.max(present, 0.2), 0.9), self.factor)
            accepted = f.compare("olt", error, 1.0)
        with f.when(accepted):
            f.store(1.0, self.factor)
        with f.when(accepted & f.compare_int("sgt", steady, k)):
            lower, higher = self.next.part(k * n), self.next.part(k * n + 2 * n)
            down = f.select(f.compare_int("sgt", k, 1), could(norm(lower, k - 1), k - 1), f.constant(0.0))
            up = f.select(
                f.compare_int("slt", k, tables.HIGHEST), could(norm(higher, k + 1), k + 1), f.constant(0.0)
            )
            best = f.max(present, f.max(down, up))
            falls = f.compare("oge", down, best)
            rises = f.compare("oge", up, best) & ~falls
            chosen = f.select_int(falls, k - 1, f.select_int(rises, k + 1, k))
            growth = f.min(best, f.select(rejected, f.constant(1.0), f.constant(10.0)))
            held = f.compare("olt", growth, HOLD) & f.compare("oge", growth, 0.9)
            growth = f.select(held, f.constant(1.0), f.max(growth, 0.2))
            changed = f.compare("une", growth, 1.0) | falls | rises
            f.store(growth, self.factor)
            f.store_int(chosen, self.new_k)
            f.store_int(f.select_int(changed, 0, steady), self.new_steady)
        return Attempt(error, f.load(self.factor))

    def _power(self, w: Writer, square: Value, order: Int) -> Value:
        """Return square ** (-1 / (2 (order + 1)))."""
        f = w.f
        result = rough_power(f, square, -0.25)
        for k in range(2, tables.HIGHEST + 1):
            result = f.select(f.compare_int("eq", order, k), rough_power(f, square, -0.5 / (k + 1)), result)
        return result

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        f, n = w.f, w.system.size
        latest = 1.0 - self._used(w, t)
        history = self._history(w, latest)
        numbers = (
            (STAMP, t + h), (STEP, h), (ORDER, f.to_double(f.load_int(self.new_k))),
            (STEADY, f.to_double(f.load_int(self.new_steady))), (TAKEN, f.to_double(f.load_int(self.k))),
        )  # fmt: skip
        for place, value in numbers:
            f.store(value, f.offset(history, place))
        for row in range(ROWS):
            for c in range(n):
                f.store(self.next[row * n + c], f.offset(history, FIRST + row * n + c))
        self._set_head(w, LATEST, latest)

    def _used(self, w: Writer, t: Value) -> Value:
        """Return which history the step came from: the latest, or the one before an event was found."""
        f = w.f
        latest = self._head(w, LATEST)
        history = self._history(w, latest)
        gap = f.abs(f.load(f.offset(history, STAMP)) - t)
        ends = f.compare("ole", gap, f.load(f.offset(history, STEP)) * 1e-6)
        return f.select(ends, latest, 1.0 - latest)

    def dense(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        f, n = w.f, w.system.size
        history = self._history(w, self._head(w, LATEST))
        k = f.to_int(f.load(f.offset(history, TAKEN)))
        weights: list[Value] = []
        product = f.constant(1.0, u.width)
        for j in range(1, tables.HIGHEST + 1):
            product = product * (u + float(j - 1)) * (1.0 / j)
            weights.append(product * f.splat(f.load(f.offset("@bdf.masks", k * ROWS + j)), u.width))
        for c in range(n):
            x = f.splat(f.load(f.offset(history, FIRST + c)), u.width)
            for j, weight in enumerate(weights, 1):
                x = f.muladd(f.splat(f.load(f.offset(history, FIRST + j * n + c)), u.width), weight, x)
            out[c] = x
