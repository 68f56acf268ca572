"""Gauss collocation of order 2 to 16, its one to eight stages evaluated together in the SIMD lanes.

The stage accelerations solve a = f(t + c h, q + h c v + h^2 A^2 a, v + h A a) (Hairer, Lubich and Wanner 2006,
II.1 and II.2), here by fixed-point iteration from the previous step's polynomial. The method is symplectic and
symmetric; the iteration limits the step on stiff problems, where a linearly implicit method is the right one.

With few stages the Legendre coefficients of the rates say little about the error, while a fixed step is what long-time
energy behaviour wants: symplectic methods keep it only as long as their step stays the same. So orders 2 to 6 have a
fixed step, each solved to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from robodyn_cli.decision import Decision
from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import IntegrationMethod
from robodyn_cli.integrators.methods.collocation_tables import dense_width, padded_width
from robodyn_cli.integrators.methods.gauss_output import GaussOutput, StageRates
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.control import StepAttempt, StepController
from robodyn_cli.integrators.stepping.stepper import Method, StepProgram
from robodyn_cli.integrators.stepping.writer import Writer, placement
from robodyn_cli.kernels.arrays import Total
from robodyn_cli.kernels.ir import Block, Condition, Int, Value

if TYPE_CHECKING:
    from robodyn_cli.formulations.residual import Residual

ITERATIONS = 14
HALFWAY = 4  # rounds after which the iteration is given up if eight more would not suffice
CONVERGED = 0.02  # last update times contraction ratio, in units of the tolerance
SMALLEST_RATIO = 0.01  # one small update by chance does not prove convergence
BEST_RATIO = 0.35  # steps are chosen so that the iteration contracts at least this fast
SAFETY = 0.85
STALE = 0.25  # contraction of the iteration beyond which each round computes new factors
SECOND = 0.1  # weight of the last but one Legendre coefficient in the error estimate
SECOND_STEEP = 1.0  # where coefficients need not fall geometrically: a small last one proves little
SCALE = 3.0
ACCEPT = 100.0  # the estimate is that pessimistic; measured against true errors
ACCEPT_STEEP = 1.0  # not where a front may lie in the step
STEEP = frozenset({"tanh", "exp", "atan"})  # functions of which smooth rates may change abruptly
ROUGH = 1e-11  # relative rounding error of a rate at the ends of a step
SOLVED, SMALLEST = 1e-13, 1e-15  # tolerances of a step's iteration where no error is controlled
SHORT = 200  # operations of the rates up to which corrections take no fewer
ROUNDS = 6  # of the iteration, which a step takes about
BEGUN = 1e300  # stands for the update before the first
FIRST = 1e200  # updates before the first are above this
EDGE = 10.0  # rates at the ends of a step may differ that much from the polynomial, in its last coefficients


class Gauss(Method):
    """Gauss collocation with s stages: order 2 s, symplectic, dense output of order s."""

    def __init__(self, facts: IntegrationMethod) -> None:
        super().__init__(facts)
        self.stages = self.dense_order = facts.order // 2

    @property
    def contraction(self) -> float:
        """How fast the iteration of a step has to contract: to rounding in ITERATIONS rounds where the step is given,
        else as fast as the step is chosen for."""
        return (0.1 * SOLVED) ** (1 / ITERATIONS) if self.facts.fixed_step else BEST_RATIO

    def residual_of(self, system: System) -> Residual | None:
        """Return the system's rates as corrections of a guess, where that takes less than the rates themselves."""
        direct = system.dynamics.program
        if system.dynamics.any_size or direct.operations < SHORT:
            return None
        residual = system.residual
        return residual if residual is not None and residual.pays(direct, ROUNDS) else None

    def dense_size(self, system: System) -> int:
        rates = system.nv + system.nz
        return (self.lanes + 2 * dense_width(self.stages) + 1) * rates + system.size

    @property
    def lanes(self) -> int:  # type: ignore[override]
        """Lanes of a vector of stages."""
        return padded_width(self.stages)

    def programs(self, system: System) -> list[StepProgram]:
        residual = self.residual_of(system)
        if residual is None:
            return [StepProgram("accelerations", system.dynamics.program, self.lanes)]
        programs = [
            StepProgram("corrections of accelerations, each round", residual.correction, self.lanes),
            StepProgram("factors of the mass matrix, once per step", residual.factors, self.lanes),
        ]
        if not self.facts.fixed_step and self.is_steep(system):
            programs.append(StepProgram("accelerations at the ends of steps", system.dynamics.program))
        return programs

    def choices(self, system: System) -> list[Decision]:
        residual = self.residual_of(system)
        if residual is None:
            return super().choices(system)
        return [residual.decision(system.dynamics.program), placement(residual.correction)]

    @staticmethod
    def is_steep(system: System) -> bool:
        """Tell whether smooth rates may change abruptly."""
        return any(i.op in STEEP for i in system.dynamics.program.instructions)

    def stepper(self, w: Writer) -> GaussStepper:
        return GaussStepper(self, w)


class GaussStepper(GaussOutput):
    """Writes steps of Gauss collocation.

    steep : whether rates may change abruptly, so that coefficients need not fall geometrically. estimates : whether
    the error is estimated, so that the tolerance of the iteration is that of the step.
    """

    def __init__(self, method: Gauss, w: Writer) -> None:
        super().__init__(method, w, method.stages, method.residual_of(w.system))
        f, self.estimates = w.f, not method.facts.fixed_step
        self.drift = w.array(1, 0, self.lanes)
        self.weight, self.sizes = w.array(1, 1), w.array(1, 1)
        self.before, self.round, self.primed = f.slot(), f.int_slot(), f.int_slot()
        self.rounding = f.slot()  # square of an update that is of rounding alone, where that is measured
        self.steep = method.is_steep(w.system)
        if self.steep:
            self.edge, self.tops = w.array(1, 1), w.array(1, 1)
        self.control = StepController(
            order=2 * self.stages - 1,
            safety=SAFETY,
            floor=1e-14,
            least=0.3,
            most=1.6,
            most_if_tiny=4.0,
            accept=ACCEPT_STEEP if self.steep else ACCEPT,
            # a step with a front may be rejected only after the check at its ends
            held=not self.steep,
            trend_safety=None if self.steep else 1.0,
        )

    # -- the step -------------------------------------------------------------------------------------
    def attempt(self, t: Value, h: Value, failed: Block) -> StepAttempt[StageRates]:
        rms = self._rms()
        self._weigh(h, lambda j: rms[j])
        self._predict(t, h)
        self._iterate(t, h, failed)
        self._advance(h)
        kept = StageRates(self.guess, self.sizes)
        if self.estimates:
            square = self._error(t, h)
            with self.f.strict():
                limit = BEST_RATIO / (self.w.get(DoubleSlot.CONTRACTION) + 1e-9)
            return StepAttempt(square, kept, limit=limit)
        with self.f.strict():
            for j in self.w.each(self.w.rates):
                self.sizes[j] = self._mean(self.guess[j])
        return StepAttempt(None, kept)

    def _iterate(self, t: Value, h: Value, failed: Block) -> None:
        """Solve for the rates at the stages; ``failed`` is left where they do not converge."""
        f, w, lanes = self.f, self.w, self.lanes
        nodes, wide_h, wide_h2 = f.constant(list(self.table.c)), f.splat(h, lanes), f.splat(h * h, lanes)
        times = f.muladd(wide_h, nodes, f.splat(t, lanes))
        for j in w.each(w.nv):
            q, v = f.splat(w.state[j], lanes), f.splat(w.state[w.nv + j], lanes)
            self.drift[j] = f.muladd(wide_h * nodes, v, q)
        f.store(BEGUN, self.before)
        # the first step of a run knows no rates yet: one round shows them, then they take part in the weights
        known = f.compare_int("sgt", f.load_int(w.integer_at(IntegerSlot.ACCEPTED)), 0)
        f.store_int(f.select_int(known, 1, 0), self.primed)
        f.store_int(f.select_int(known, 0, ITERATIONS), self.round)
        with f.loop() as rounds:
            self._place_stages(wide_h, wide_h2)
            if self.residual is not None:
                first = f.compare("ogt", f.load(self.before), FIRST)
                with f.when(first | f.compare("ogt", w.get(DoubleSlot.CONTRACTION), STALE)):
                    self.factorise(times)
            self.evaluate(times, self.guess)
            update, ratio, converged = self._update()
            rounds.leave(converged)
            rounds.again(self._hopeful(update, ratio))
            with f.when(f.compare_int("eq", f.load_int(self.primed), 0)):
                f.store_int(1, self.primed)
                f.store_int(0, self.round)
                f.store(BEGUN, self.before)
                self._weigh(h, lambda j: self._mean(self.guess[j]))
                rounds.again()
            # an update that no longer shrinks is rounding when it is well below the tolerance
            rounding = 0.1 if w.rounded is None else f.sqrt(f.load(self.rounding) + 0.1**2)
            rounds.leave(f.compare("olt", update, rounding))
            shorter = f.select(f.compare("ord", update, 0.0), f.constant(0.5), f.constant(0.1))
            w.put(DoubleSlot.H, h * shorter)
            failed.leave()

    def _place_stages(self, wide_h: Value, wide_h2: Value) -> None:
        """Set the states at the stages from the rates there."""
        f, w, T = self.f, self.w, self.table
        for j in w.each(w.nv):
            old = self._spread(j)
            self.x[j] = self._combine(old, T.A2, wide_h2, self.drift[j])
            self.x[w.nv + j] = self._combine(old, T.A, wide_h, f.splat(w.state[w.nv + j], self.lanes))
        for j in w.each(w.nz):
            start = f.splat(w.state[w.nv * 2 + j], self.lanes)
            self.x[w.nv * 2 + j] = self._combine(self._spread(w.nv + j), T.A, wide_h, start)

    def _update(self) -> tuple[Value, Value, Condition]:
        """Take the new rates over; return the norm of the change, its ratio to the change before, and whether their
        product is below ``CONVERGED``.

        That is told from squares: the processor guesses it wrongly about once a step, and goes on the sooner the sooner
        it knows, without a root and a quotient.
        """
        f, w = self.f, self.w
        with f.strict():
            square = Total(f, self.lanes)
            for j in w.each(w.rates):
                fresh = self.fresh[j]
                d = (fresh - self.guess[j]) * f.splat(self.weight[j], self.lanes)
                square.add_product(d, d)
                self.guess[j] = fresh
            norm2 = f.reduce("add", square.value)
            update, last = f.sqrt(norm2), f.load(self.before)
            f.store(update, self.before)
            ratio = f.min(update / last, 1.0)
            first = f.compare("ogt", last, FIRST)
            remembered = w.get(DoubleSlot.CONTRACTION)
            enough = f.constant(CONVERGED**2)
            if w.rounded is not None:
                enough = enough + f.load(self.rounding)
            square_of_product = norm2 * f.select(first, remembered * remembered, norm2)
            limit = f.select(first, enough, last * last * enough)
            converged = f.compare("olt", square_of_product, limit) | f.compare("olt", norm2, enough)
            converged = converged & f.compare("olt", norm2, enough / SMALLEST_RATIO**2)
            # one round measures no contraction, so the remembered one fades
            measured = f.select(first, remembered * 0.5, ratio)
            if w.rounded is not None:  # updates of rounding neither shrink nor tell how fast others do
                measured = f.select(f.compare("olt", norm2, f.load(self.rounding)), remembered, measured)
            ratio = f.max(f.select(first, remembered, ratio), SMALLEST_RATIO)
            w.put(DoubleSlot.CONTRACTION, f.select(f.compare("ord", ratio, 0.0), measured, f.constant(1.0)))
        return update, ratio, converged

    def _hopeful(self, update: Value, ratio: Value) -> Condition:
        """Return whether another round is worth while."""
        f = self.f
        rounds = f.bump(self.round)
        unfinished = f.compare_int("slt", rounds, ITERATIONS) & f.compare("ord", update, 0.0)
        if not self.method.adaptive or self.steep:
            return unfinished
        eighth = ratio
        for _ in range(3):
            eighth = eighth * eighth
        return unfinished & (f.compare("olt", update * eighth, 10.0) | f.compare_int("slt", rounds, HALFWAY))

    def _mean_square(self, x: Value) -> Value:
        """Return the mean square over the stages."""
        f = self.f
        x = x * f.constant([float(k < self.stages) for k in range(self.lanes)])
        return f.reduce("add", x * x) * (1.0 / self.stages)

    def _mean(self, x: Value) -> Value:
        """Return the root mean square over the stages."""
        return self.f.sqrt(self._mean_square(x))

    def _tolerances(self) -> tuple[Value, Value]:
        """Return the relative and the absolute tolerance to which a step is solved."""
        w = self.w
        if not self.estimates:
            return w.f.constant(SOLVED), w.f.constant(SMALLEST)
        return w.get(DoubleSlot.RTOL), w.get(DoubleSlot.ATOL)

    def _weigh(self, h: Value, size_of: Callable[[Int | int], Value]) -> None:
        """Set what an error of each rate means for the state over this step, in units of the tolerance.

        A velocity counts as at least what its rate makes of it in the step, so that one that passes zero is not
        held to an absolute standard; a position sets the standard where the motion is slow.
        """
        f, w = self.f, self.w
        rtol, atol = self._tolerances()

        def allowed(c: Int | int, size: Value) -> Value:
            own = f.muladd(size, rtol, atol)
            return own if w.rounded is None else f.max(own, w.rounded[c])

        def weight(j: Int | int) -> Value:
            speed, gained = f.abs(w.state[w.nv + j]), h * size_of(j)
            return h / allowed(w.nv + j, f.select(f.compare("ogt", speed, gained), speed, gained))

        with f.strict():
            for j in w.each(w.nv):
                one, other = weight(j), h * h / allowed(j, f.abs(w.state[j]))
                self.weight[j] = f.select(f.compare("ogt", other, one), other, one)
            for j in w.each(w.nz):
                self.weight[w.nv + j] = weight(w.nv + j)
            if w.rounded is not None:
                total = Total(f)
                for j in w.each(w.rates):
                    own = w.rounded[w.nv + j] * self.weight[j]
                    total.add_product(own, own)
                f.store(total.value * (self.lanes / (h * h)), self.rounding)

    def _predict(self, t: Value, h: Value) -> None:
        """Evaluate the rates that are kept at the new stages: of the step before, or of this one before it was cut."""
        f, w = self.f, self.w
        lanes = self.lanes
        length = w.get(DoubleSlot.DENSE_STEP)
        per_length = 1.0 / f.select(f.compare("ogt", length, 0.0), length, h)
        with f.strict():
            ahead = t - w.get(DoubleSlot.DENSE_END)
        stages = f.constant(list(self.table.c))
        u = f.muladd(f.splat(h * per_length, lanes), stages, f.splat(ahead * per_length, lanes))
        for j in w.each(w.rates):
            address = self._polynomial(j)
            p = f.splat(f.load(f.offset(address, self.stages - 1)), lanes)
            for k in reversed(range(self.stages - 1)):
                p = f.muladd(p, u, f.splat(f.load(f.offset(address, k)), lanes))
            self.guess[j] = p

    def _advance(self, h: Value) -> None:
        f, w, T = self.f, self.w, self.table
        b, b_bar = f.constant(list(T.b)), f.constant(list(T.b_bar))
        for j in w.each(w.nv):
            rate, v = self.guess[j], w.state[w.nv + j]
            w.new[j] = f.muladd(h * h, f.reduce("add", rate * b_bar), f.muladd(h, v, w.state[j]))
            w.new[w.nv + j] = f.muladd(h, f.reduce("add", rate * b), v)
        for j in w.each(w.nz):
            place = w.nv * 2 + j
            w.new[place] = f.muladd(h, f.reduce("add", self.guess[w.nv + j] * b), w.state[place])

    def _error(self, t: Value, h: Value) -> Value:
        """Estimate the error: the square of the top Legendre coefficients relative to the rate itself.

        The coefficients fall geometrically, and superconvergence squares what they say about a smooth solution.
        """
        f, w, T = self.f, self.w, self.table
        top = f.constant([float(x) for x in T.legendre[-1]])
        below = f.constant([float(x) for x in T.legendre[-2]])
        second = SECOND_STEEP if self.steep else SECOND
        with f.strict():
            total = Total(f)
            for j in w.each(w.rates):
                rate = self.guess[j]
                c = f.reduce("add", rate * top)
                d = f.reduce("add", rate * below)
                square = self._mean_square(rate)
                self.sizes[j] = f.sqrt(square)
                tail = f.muladd(d * d, second, c * c)
                if w.rounded is not None:
                    off = w.rounded[w.nv + j] / h
                    tail = f.max(tail - off * off, 0.0)
                e = tail * self.weight[j]
                total.add_product(e, e / (square + 1e-300))
                if self.steep:
                    self.tops[j] = f.abs(c) + f.abs(d)
        if self.steep:
            self._look_at_ends(t, h, total)
        with f.strict():
            return total.value * (SCALE * SCALE) / w.number(w.rates)

    def _look_at_ends(self, t: Value, h: Value, total: Total) -> None:
        """Add the error in the first and the last 2 % of the step, where no stage lies.

        A front that falls there, such as smoothed friction at the turn of a joint, leaves no trace in the stages.
        """
        f, w, T = self.f, self.w, self.table
        signs = (-1.0) ** np.arange(self.lanes)
        gap = float(T.c[0]) * self.control.accept / SCALE
        for time, state, row in ((t, w.state, signs @ T.M), (t + h, w.new, T.M[0])):
            w.dynamics(time, state, self.edge)
            w.count(IntegerSlot.EVALUATIONS)
            with f.strict():
                for j in w.each(w.rates):
                    expected = f.reduce("add", self.guess[j] * f.constant([float(x) for x in row]))
                    known = f.muladd(self.sizes[j], ROUGH, self.tops[j] * EDGE)
                    missed = f.abs(self.edge[j] - expected) - known
                    hidden = f.select(f.compare("ole", missed, 0.0), 0.0, missed) * self.weight[j] * gap
                    total.add_product(hidden, hidden)
