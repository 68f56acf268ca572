"""Backward differentiation of variable order 1 to 5 for stiff motion, the method of MATLAB's ode15s.

Quasi-constant steps with backward differences (Shampine and Reichelt 1997): the differences D_j of the last values,
taken for the present step, are the polynomial through them. A step solves, for d = x - sum D_j,

    f(t + h, x) - (alpha_k / h) (psi + d) = 0,    psi = sum gamma_j D_j / alpha_k

by Newton's method with the exact Jacobian. Two histories are kept: a step that is tried but not taken, because it
contains an event, leaves the other one as it was.
"""

from __future__ import annotations

from collections.abc import Callable

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.methods import bdf_tables as tables
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.control import (
    StepAttempt,
    StepController,
    mean_squares,
    tolerance,
)
from robodyn_cli.integrators.stepping.factors import NewtonLimits, Rounds, derivatives_of, real_factors
from robodyn_cli.integrators.stepping.stepper import Method, Stepper, StepProgram
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Block, Condition, Int, Value
from robodyn_cli.kernels.mathematics import rough_exp2
from robodyn_cli.record import mutable_record

ROWS = tables.ROWS
LIMITS = NewtonLimits(rounds=5, converged=0.003, rounding=0.03, shorter=0.3)
SAFETY = 0.85
HOLD = 1.2  # a step that could grow by less stays as it is
JUMP = 10.0  # a state that differs from the history by more tolerances than this has been replaced
CAUTION = 0.3  # of the first step, which is of order 1, its error being half of this squared
# head of %dense: which history is the latest, where the last run was to end, whether to begin anew, whether begun
LATEST, END, ANEW, BEGUN, HEAD = 0, 1, 2, 3, 8
# head of a history: its time, step, order, steps since a change, order of its last step
STAMP, STEP, ORDER, STEADY, TAKEN, FIRST = 0, 1, 2, 3, 4, 8


class Bdf(Method):
    """Backward differentiation formulas of order 1 to 5 (NDF): stiffly stable, order and step chosen along the run."""

    dense_order = 4
    has_history = True

    def linearisation(self, system: System) -> StepProgram:
        return derivatives_of(system)

    def dense_size(self, system: System) -> int:
        return HEAD + 2 * history_size(system.size)

    def stepper(self, w: Writer) -> BdfStepper:
        return BdfStepper(self, w)


def history_size(n: int) -> int:
    return FIRST + ROWS * n


@mutable_record
class Taken:
    """A step: the order it was taken with, and order and steps since a change for the next one."""

    order: Int
    next_order: Int
    next_steady: Int


class BdfStepper(Stepper[Taken]):
    """Writes steps of variable order.

    D, next : differences before and after the step, ROWS a component, component by component within a row. predicted,
    psi, d : as in the equation above.
    """

    def __init__(self, method: Bdf, w: Writer) -> None:
        super().__init__(method, w)
        f = w.f
        self.n = w.system.size
        self.masks = f.table("bdf.masks", tables.masks().ravel())
        self.histories = f.table("bdf.histories", tables.histories().ravel())
        self.alpha = f.table("bdf.alpha", [*tables.ALPHA, 0.0, 0.0])
        self.error = f.table("bdf.error", [*tables.ERROR, 0.0, 0.0])
        self.D, self.next = w.array(2 * ROWS, ROWS), w.array(2 * ROWS, ROWS)
        self.predicted, self.psi, self.d, self.x, self.rates, self.changes = (w.array(2, 1) for _ in range(6))
        self.steady, self.next_order, self.next_steady = (f.int_slot() for _ in range(3))
        self.factor = f.slot()
        self.rounds = Rounds(w, LIMITS)
        self.control = StepController(1.0, safety=SAFETY, floor=1e-10, least=0.2, most=10.0)
        # where the last run has come to its end there may be a discontinuity: begin anew
        t, end, last = w.get(DoubleSlot.T), w.get(DoubleSlot.T_END), self._head(END)
        arrived = f.compare("ole", f.abs(t - last), f.muladd(f.abs(last), 1e-15, 1e-300))
        begun = f.compare("ogt", self._head(BEGUN), 0.5)
        anew = arrived & begun & f.compare("une", end, last)
        self._set_head(ANEW, f.select(anew, f.constant(1.0), self._head(ANEW)))
        self._set_head(END, end)

    # -- history --------------------------------------------------------------------------------------
    def _head(self, place: int) -> Value:
        return self.f.load(self.f.offset("%dense", place))

    def _set_head(self, place: int, x: Value | float) -> None:
        self.f.store(x, self.f.offset("%dense", place))

    def _history(self, which: Value) -> str:
        """Return the address of history 0 or 1."""
        f = self.f
        return f.offset("%dense", f.to_int(which) * history_size(self.n) + HEAD)

    def _ends_at(self, history: str, t: Value) -> Condition:
        f = self.f
        gap = f.abs(f.load(f.offset(history, STAMP)) - t)
        # a step may be as short as a few roundings of the time
        return f.compare("ole", gap, f.max(f.load(f.offset(history, STEP)) * 1e-6, f.abs(t) * 2.3e-16))

    def _begin(self, t: Value, h: Value, failed: Block) -> str:
        """Return the address of the history that ends at t; where there is none, one is begun at order 1."""
        f = self.f
        latest = self._head(LATEST)
        fits = self._ends_at(self._history(latest), t)
        other_fits = self._ends_at(self._history(1.0 - latest), t)
        chosen = f.select(fits, latest, 1.0 - latest)
        history = self._history(chosen)
        known = (fits | other_fits) & self._continues(history)
        with f.when(~known):
            h1 = self._first_step(t, h)
            f.store(-1e300, f.offset(self._history(1.0 - chosen), STAMP))
            self._start_history(history, t, h1)
            for place, value in ((LATEST, chosen), (ANEW, 0.0), (BEGUN, 1.0)):
                self._set_head(place, value)
            with f.when(f.compare("olt", h1, h * 0.999)):
                # only the first step of a history is proposed anew here, nothing was rejected
                self.w.put(DoubleSlot.H, h1)
                self.w.count(IntegerSlot.REJECTED, -1)
                self.w.count(IntegerSlot.REJECTED_IN_ROW, -1)
                failed.leave()
        return history

    def _continues(self, history: str) -> Condition:
        """Return whether the state is still where a history ends, and nothing asks for a new one."""
        f, w = self.f, self.w
        total = Total(f)
        with f.strict():
            for c in w.each(w.size):
                gap = f.load(f.offset(history, FIRST + c)) - w.state[c]
                gap = gap / tolerance(w, c, f.abs(w.state[c]))
                total.add_product(gap, gap)
        same = f.compare("olt", total.value, JUMP * JUMP)
        valid = f.compare("olt", self._head(ANEW), 0.5)
        return valid & same & f.compare("ogt", self._head(BEGUN), 0.5)

    def _first_step(self, t: Value, h: Value) -> Value:
        """Return the length of a first step, at most h, and leave the rates in ``d``."""
        f, w, n = self.f, self.w, self.n
        w.rate(t, w.state, self.rates)
        w.count(IntegerSlot.EVALUATIONS, 2)
        small = h * 1e-4
        for c in w.each(w.size):
            self.x[c] = f.muladd(small, self.rates[c], w.state[c])
            self.d[c] = self.rates[c]
        w.rate(t + small, self.x, self.rates)
        with f.strict():
            bend = Total(f)
            for c in w.each(w.size):
                size = f.max(f.abs(w.state[c]), f.abs(h * self.d[c]) * 1e-3)
                second = (self.rates[c] - self.d[c]) / (small * tolerance(w, c, size))
                bend.add_product(second, second)
            curvature = f.sqrt(bend.value * (1.0 / n))
            h1 = f.min(h, CAUTION / f.sqrt(f.max(curvature, 1e-300)))
            return f.select(f.compare("ord", h1, 0.0), h1, h * 0.1)

    def _start_history(self, history: str, t: Value, h: Value) -> None:
        """Store the history of order 1 for steps of length h, from the rates in ``d``."""
        f, w, n = self.f, self.w, self.n
        for place, value in ((STAMP, t), (STEP, h), (ORDER, 1.0), (STEADY, 0.0), (TAKEN, 1.0)):
            f.store(value, f.offset(history, place))
        for c in w.each(w.size):
            for row in range(ROWS):
                start = w.state[c] if row == 0 else h * self.d[c] if row == 1 else 0.0
                f.store(start, f.offset(history, FIRST + row * n + c))

    def _load(self, history: str, h: Value) -> Int:
        """Take a history over, for steps of length h; return its order."""
        f, w, n = self.f, self.w, self.n
        k = f.to_int(f.load(f.offset(history, ORDER)))
        f.store_int(f.to_int(f.load(f.offset(history, STEADY))), self.steady)
        for c in w.each(w.size):
            for row in range(ROWS):
                self.D[row * n + c] = f.load(f.offset(history, FIRST + row * n + c))
            self.D[c] = w.state[c]
        r = h / f.load(f.offset(history, STEP))
        with f.when(f.compare("ogt", f.abs(r - 1.0), 1e-10)):
            f.store_int(0, self.steady)
            self._rescale(k, r)
        return k

    def _rescale(self, k: Int, r: Value) -> None:
        """Turn the differences into those for steps r times as long."""
        f, w, n, rows = self.f, self.w, self.n, range(tables.HIGHEST + 1)
        mask = self._row(self.masks, k)
        polynomials = tables.rescaling()
        with f.strict():
            for c in w.each(w.size):
                old = [self.D[j * n + c] * mask[j] for j in rows]
                for j in rows[1:]:
                    total: Value | None = None
                    for m in rows[j:]:
                        weight = self._polynomial(polynomials[j][m], r)
                        total = weight * old[m] if total is None else f.muladd(weight, old[m], total)
                    assert total is not None
                    self.D[j * n + c] = total

    def _row(self, table: str, k: Int) -> list[Value]:
        """Return what a table has for order k."""
        f = self.f
        return [f.load(f.offset(table, k * ROWS + j)) for j in range(tables.HIGHEST + 1)]

    def _polynomial(self, coefficients: list[float], r: Value) -> Value:
        p = self.f.constant(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            p = self.f.muladd(p, r, c)
        return p

    # -- the step -------------------------------------------------------------------------------------
    def attempt(self, t: Value, h: Value, failed: Block) -> StepAttempt[Taken]:
        f, w, n = self.f, self.w, self.n
        k = self._load(self._begin(t, h, failed), h)
        mask, past = self._row(self.masks, k), self._row(self.histories, k)
        for c in w.each(w.size):
            x, psi = self.D[c], f.constant(0.0)
            for j in range(1, tables.HIGHEST + 1):
                x = f.muladd(mask[j], self.D[j * n + c], x)
                psi = f.muladd(past[j], self.D[j * n + c], psi)
            self.predicted[c], self.psi[c], self.d[c] = x, psi, 0.0
        g = f.load(f.offset(self.alpha, k)) / h
        self._iterate(t + h, h, g, failed)
        for c in w.each(w.size):
            w.new[c] = self.predicted[c] + self.d[c]
        self._difference(k)
        square = self._norm(lambda c: self.d[c], k)
        self._choose_order(square, k)
        taken = Taken(k, f.load_int(self.next_order), f.load_int(self.next_steady))
        return StepAttempt(square, taken, factor=f.load(self.factor))

    def _iterate(self, t: Value, h: Value, g: Value, failed: Block) -> None:
        """Solve for d by Newton's method; ``failed`` is left where it does not converge."""
        f, w, n = self.f, self.w, self.n
        factors = real_factors(w, t, self.predicted, g)
        w.count(IntegerSlot.EVALUATIONS)
        with self.rounds.repeat(h, failed) as judge:
            for c in w.each(w.size):
                self.x[c] = self.predicted[c] + self.d[c]
            w.rate(t, self.x, self.rates)
            w.count(IntegerSlot.EVALUATIONS)
            for c in w.each(w.size):
                self.changes[c] = self.rates[c] - g * (self.psi[c] + self.d[c])
            factors.solve(self.changes)
            with f.strict():
                square = Total(f)
                for c in w.each(w.size):
                    change = self.changes[c]
                    self.d[c] = self.d[c] + change
                    size = f.max(f.abs(w.state[c]), f.abs(self.predicted[c] + self.d[c]))
                    e = change / tolerance(w, c, size)
                    square.add_product(e, e)
                update = f.sqrt(square.value * (1.0 / n))
            judge(update)

    # -- error and order ------------------------------------------------------------------------------
    def _difference(self, k: Int) -> None:
        """Set the differences at the new time, from the highest down."""
        f, w, n = self.f, self.w, self.n
        for row in range(ROWS):
            for c in w.each(w.size):
                self.next[row * n + c] = self.D[row * n + c]
        top = k + 1
        for c in w.each(w.size):
            d, old = self.d[c], self.D[top * n + c]
            self.next[top * n + n + c] = d - old
            self.next[top * n + c] = d
        with f.count(top, down=True) as j:
            for c in w.each(w.size):
                self.next[j * n + c] = self.next[j * n + c] + self.next[j * n + n + c]

    def _norm(self, difference: Callable[[Int | int], Value], order: Int) -> Value:
        """Return the mean square of error coefficient times differences, in units of the tolerance."""
        f = self.f
        constant = f.load(f.offset(self.error, order))
        with f.strict():
            return mean_squares(self.w, 1, lambda c: [constant * difference(c)])[0]

    def _could(self, square: Value, order: Int) -> Value:
        """Return by what factor steps of an order with this error could change."""
        f = self.f
        with f.strict():
            size = self.control.log_error(self.w, square)
            return rough_exp2(f, self.control.log_factor(size, f.to_double(order + 1)))

    def _choose_order(self, square: Value, k: Int) -> None:
        """Choose the order of the next step, and by what factor its length changes.

        Both stay until as many steps as the order and one more were taken with them; a step that could hardly grow
        stays as it is.
        """
        f, n = self.f, self.n
        present = self._could(square, k)
        steady = f.load_int(self.steady) + 1
        f.store_int(steady, self.next_steady)
        f.store_int(k, self.next_order)
        f.store(f.min(f.max(present, self.control.least), 0.9), self.factor)
        accepted = f.compare("olt", square, 1.0)
        with f.when(accepted):
            f.store(1.0, self.factor)
        with f.when(accepted & f.compare_int("sgt", steady, k)):
            lower = self._norm(lambda c: self.next[k * n + c], k - 1)
            higher = self._norm(lambda c: self.next[k * n + 2 * n + c], k + 1)
            nothing = f.constant(0.0)
            down = f.select(f.compare_int("sgt", k, 1), self._could(lower, k - 1), nothing)
            up = f.select(f.compare_int("slt", k, tables.HIGHEST), self._could(higher, k + 1), nothing)
            best = f.max(present, f.max(down, up))
            falls = f.compare("oge", down, best)
            rises = f.compare("oge", up, best) & ~falls
            growth = f.min(best, f.select(self.w.rejected_before(), 1.0, f.constant(self.control.most)))
            held = f.compare("olt", growth, HOLD) & f.compare("oge", growth, 0.9)
            growth = f.select(held, f.constant(1.0), f.max(growth, self.control.least))
            changed = f.compare("une", growth, 1.0) | falls | rises
            f.store(growth, self.factor)
            f.store_int(f.select_int(falls, k - 1, f.select_int(rises, k + 1, k)), self.next_order)
            f.store_int(f.select_int(changed, 0, steady), self.next_steady)

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, t: Value, h: Value, kept: Taken) -> None:
        f, w, n = self.f, self.w, self.n
        # the step came from the latest history, or from the one before an event was found
        latest = self._head(LATEST)
        used = f.select(self._ends_at(self._history(latest), t), latest, 1.0 - latest)
        history = self._history(1.0 - used)
        for place, number in ((ORDER, kept.next_order), (STEADY, kept.next_steady), (TAKEN, kept.order)):
            f.store(f.to_double(number), f.offset(history, place))
        for place, value in ((STAMP, t + h), (STEP, h)):
            f.store(value, f.offset(history, place))
        for row in range(ROWS):
            for c in w.each(w.size):
                f.store(self.next[row * n + c], f.offset(history, FIRST + row * n + c))
        self._set_head(LATEST, 1.0 - used)

    def dense(self, u: Value, h: Value, out: Array) -> None:
        f, w, n = self.f, self.w, self.n
        history = self._history(self._head(LATEST))
        mask = self._row(self.masks, f.to_int(f.load(f.offset(history, TAKEN))))
        weights: list[Value] = []
        product = f.constant(1.0, u.width)
        for j in range(1, tables.HIGHEST + 1):
            product = product * (u + float(j - 1)) * (1.0 / j)
            weights.append(product * f.splat(mask[j], u.width))
        for c in w.each(w.size):
            x = f.splat(f.load(f.offset(history, FIRST + c)), u.width)
            for j, weight in enumerate(weights, 1):
                x = f.muladd(f.splat(f.load(f.offset(history, FIRST + j * n + c)), u.width), weight, x)
            out[c] = x
