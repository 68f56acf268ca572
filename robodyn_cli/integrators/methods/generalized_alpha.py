"""The generalized-alpha method with a fixed step: order 2, with numerical damping of fast oscillations.

Beside the accelerations v-dot, which obey the equations of motion at the end of each step, the method carries an
auxiliary sequence a (Chung and Hulbert 1993, in the form of Arnold and Bruls 2007):

    (1 - alpha_m) a' + alpha_m a = (1 - alpha_f) v-dot' + alpha_f v-dot
    q' = q + h v + h^2 ((1/2 - beta) a + beta a'),   v' = v + h ((1 - gamma) a + gamma a')

where ' is the end of the step. With loops the equations are those of index 3 (``formulations.index3``): eta = 0 at
every step, and multipliers are unknowns. Each step is solved by Newton's method with the exact Jacobian. Velocities
keep a residual of size h^2, which must stay: projected after each step, the method is of order 1. Samples are
projected.
"""

from __future__ import annotations

from robodyn_cli.formulations.events import EventKind
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.stepping.control import StepAttempt
from robodyn_cli.integrators.stepping.hermite import Ends, HermiteOutput, hermite_size
from robodyn_cli.integrators.stepping.stepper import DERIVATIVES, Method, Stepper, StepProgram
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Block, Value
from robodyn_cli.record import mutable_record

RHO = 0.8  # spectral radius for infinitely fast oscillations: the part of them that remains after a step
ALPHA_M = (2.0 * RHO - 1.0) / (RHO + 1.0)
ALPHA_F = RHO / (RHO + 1.0)
GAMMA = 0.5 + ALPHA_F - ALPHA_M
BETA = 0.25 * (GAMMA + 0.5) ** 2
SHARE = (1.0 - ALPHA_F) / (1.0 - ALPHA_M)  # da'/dv-dot'
# rounds of Newton's iteration, which end with a change of the state below CONVERGED of itself: as the iteration
# converges quadratically, what is left then is below rounding
ITERATIONS, CONVERGED = 15, 1e-10
STIFF = 6.0  # without stiffness the two extrapolations differ by up to 3, the rows of loops being solved for positions
STAMP, STEP, FIRST = 0, 1, 2  # head of a memory: the time it is for, and the step that led there


class GeneralizedAlpha(Method):
    """Generalized-alpha, spectral radius 0.8, fixed step: order 2; loops at index 3, with multipliers as unknowns."""

    dense_order = 2
    has_history = True

    def linearisation(self, system: System) -> StepProgram:
        """Return a step of Newton's iteration: at index 3, or for the system as it is."""
        program = system.first_order_step if system.index3 is None else system.index3.program
        return StepProgram(DERIVATIVES, program)

    def obstacle(self, system: System) -> str:
        if system.layout is not None:
            return "a joint has velocities that are not rates of its coordinates (a ball, a free body)"
        if system.partition is not None:
            return "some rows of the loops depend on each other, or 'stabilisation: independent' chooses coordinates"
        if any(e.kind is EventKind.CONTACT for e in system.events):
            return "a joint has friction with 'law: set_valued' or a rigid stop"
        if system.index3 is not None and system.index3.obstacle:
            return system.index3.obstacle
        return super().obstacle(system)

    def projects(self, system: System) -> bool:
        return system.index3 is None

    def dense_size(self, system: System) -> int:
        return hermite_size(system) + 1 + 2 * memory_size(system)

    def stepper(self, w: Writer) -> AlphaStepper:
        return AlphaStepper(self, w)


def memory_size(system: System) -> int:
    """Return the numbers of a memory: its head, v-dot, z-dot, a and the multipliers at the end of a step."""
    rows = 0 if system.index3 is None else system.index3.rows
    return FIRST + 2 * system.nv + system.nz + rows


@mutable_record
class Solved:
    """A step: its start, what it adds to the state, the rates at the start, and a' without the part of v-dot'."""

    x0: list[Value]
    increments: list[Value]
    rate0: list[Value]
    fixed: list[Value]


@mutable_record
class Unknowns:
    """How the state at the end of a step depends on v-dot and z-dot there: x' = x + gains + weights times them."""

    weights: list[Value]  # of v-dot in q, of v-dot in v, of z-dot in z
    gains: list[Value]


class AlphaStepper(Stepper[Solved]):
    """Writes steps; a and l hold the accelerations (then z-dot) and multipliers of the iteration.

    Beside dense output two memories are kept, of the ends of the last two steps, one of which may be taken back.
    """

    def __init__(self, method: GeneralizedAlpha, w: Writer) -> None:
        super().__init__(method, w)
        f, s = w.f, w.system
        self.program = method.linearisation(s).program
        self.m = len(self.program.outputs["l"])
        self.solved = len(self.program.outputs["a"])  # v-dot and, where they are coupled, z-dot
        self.a, self.l = Array(f, f.slot(1, max(1, s.nv + s.nz))), Array(f, f.slot(1, max(1, self.m)))
        self.x, self.rates = w.array(2, 1), w.array(1, 1)
        self.which, self.round, self.outcome = f.slot(), f.int_slot(), f.slot()
        self.hermite = HermiteOutput(w)
        # where the last run has come to its end there may be a discontinuity: begin anew
        end_slot = f.offset("%dense", hermite_size(s))
        t, end, last = w.get(DoubleSlot.T), w.get(DoubleSlot.T_END), f.load(end_slot)
        arrived = f.compare("ole", f.abs(t - last), f.muladd(f.abs(last), 1e-15, 1e-300))
        with f.when(arrived & f.compare("une", end, last)):
            for which in (0.0, 1.0):
                f.store(0.0, f.offset(self._memory(which), STEP))
        f.store(end, end_slot)

    # -- memory ---------------------------------------------------------------------------------------
    def _memory(self, which: Value | float) -> str:
        """Return the address of memory 0 or 1."""
        f, s = self.f, self.w.system
        start, size = hermite_size(s) + 1, memory_size(s)
        if isinstance(which, float):
            return f.offset("%dense", start + int(which) * size)
        return f.offset("%dense", f.to_int(which) * size + start)

    def _remember(self, memory: str, t: Value, h: Value, numbers: list[Value]) -> None:
        """Store v-dot, z-dot, a and the multipliers at t."""
        for k, value in enumerate([t, h, *numbers]):
            self.f.store(value, self.f.offset(memory, k))

    def _fits(self, which: float, t: Value) -> Value:
        """Return 1 where a memory ends at t, else 0."""
        f, memory = self.f, self._memory(which)
        step = f.load(f.offset(memory, STEP))
        near = f.compare("ole", f.abs(f.load(f.offset(memory, STAMP)) - t), step * 1e-6)
        return f.select(near & f.compare("ogt", step, 0.0), f.constant(1.0), f.constant(0.0))

    def _begin(self, t: Value, h: Value) -> None:
        """Find the memory that ends at t; where there is none, one is begun."""
        f = self.f
        first, second = self._fits(0.0, t), self._fits(1.0, t)
        f.store(second, self.which)
        with f.when(f.compare("olt", first + second, 0.5)):
            rates, a = self._first_rates(t, h)
            self._remember(self._memory(0.0), t, h, [*rates, *a, *[f.constant(0.0)] * self.m])
            f.store(0.0, f.offset(self._memory(1.0), STEP))

    def _first_rates(self, t: Value, h: Value) -> tuple[list[Value], list[Value]]:
        """Return v-dot and z-dot at the start of a run, and a fitting them.

        a belongs to a time that lies (alpha_m - alpha_f) h off, so it is v-dot extrapolated to there; starting with
        v-dot itself would cost an order in the multipliers (Arnold, Bruls and Cardona 2015). Where the step does not
        resolve the fastest decays, an explicit extrapolation goes far beyond an implicit one; the result of an
        implicit Euler step then replaces v-dot at the start.
        """
        f, w, s = self.f, self.w, self.w.system
        ahead = h * (ALPHA_F - ALPHA_M)
        w.dynamics(t, w.state, self.rates)
        rates = [self.rates[k] for k in range(s.nv + s.nz)]
        for k in range(s.nv):
            self.x[k] = w.state[k] + ahead * (w.state[s.nq + k] + 0.5 * ahead * rates[k])
        for k, rate in enumerate(rates):
            self.x[s.nq + k] = w.state[s.nq + k] + ahead * rate
        w.dynamics(t + ahead, self.x, self.rates)
        w.count(IntegerSlot.EVALUATIONS, 2)
        there = [self.rates[k] for k in range(s.nv)]
        implicit = self._implicit(t, h)
        with f.strict():
            far, near = Total(f), Total(f)
            for k in range(s.nv):
                change = (there[k] - rates[k]) * (1.0 / (ALPHA_F - ALPHA_M))
                far.add_product(change, change)
                change = implicit[k] - rates[k]
                near.add_product(change, change)
            resolved = f.compare("ole", far.value, near.value * STIFF**2)
            resolved = resolved | f.compare("uno", near.value, 0.0)
            a = [f.select(resolved, 2.0 * rates[k] - there[k], implicit[k]) for k in range(s.nv)]
            ends = [*implicit, *rates[len(implicit) :]]
            return [f.select(resolved, *pair) for pair in zip(rates, ends)], a

    def _implicit(self, t: Value, h: Value) -> list[Value]:
        """Return v-dot and, where they are coupled, z-dot at the end of an implicit Euler step, linearised."""
        f, w, s = self.f, self.w, self.w.system
        for k in range(s.size):
            self.x[k] = f.muladd(h, w.state[s.nq + k], w.state[k]) if k < s.nq else w.state[k]
        nothing = [f.constant(0.0)] * (s.nv + s.nz + self.m)
        g = [h * h * 0.5, h, h]
        w.count(IntegerSlot.EVALUATIONS)
        return w.evaluate(self.program, t + h, self.x, a=nothing, l=nothing, g=g)["a"]

    # -- the step -------------------------------------------------------------------------------------
    def attempt(self, t: Value, h: Value, failed: Block) -> StepAttempt[Solved]:
        f, w, s = self.f, self.w, self.w.system
        nv, nz = s.nv, s.nz
        self._begin(t, h)
        memory = self._memory(f.load(self.which))
        kept = [f.load(f.offset(memory, FIRST + k)) for k in range(2 * nv + nz + self.m)]
        rates, a, multipliers = kept[: nv + nz], kept[nv + nz : 2 * nv + nz], kept[2 * nv + nz :]
        with f.strict():
            # a lies off v-dot in proportion to the step
            ratio = h / f.load(f.offset(memory, STEP))
            a = [rate + (x - rate) * ratio for x, rate in zip(a, rates)]
            # a' without the part of v-dot'
            fixed = [(ALPHA_F * rate - ALPHA_M * x) * (1.0 / (1.0 - ALPHA_M)) for x, rate in zip(a, rates)]
        unknowns = self._unknowns(h, rates, a, fixed)
        for k, rate in enumerate(rates):
            self.a[k] = rate
        for k, multiplier in enumerate(multipliers):
            self.l[k] = multiplier
        self._solve(t + h, h, unknowns)
        if self.solved == nv and nz:
            # nothing depends on z (work, for example), so it is computed at the end
            w.dynamics(t + h, self.x, self.rates)
            w.count(IntegerSlot.EVALUATIONS)
            for k in range(nz):
                self.a[nv + k] = self.rates[nv + k]
        x0, increments = [w.state[k] for k in range(s.size)], self._gained(unknowns)
        for k in range(s.size):
            w.new[k] = x0[k] + increments[k]
        rate0 = [*unknowns.gains[:nv], *rates]
        return StepAttempt(f.load(self.outcome), Solved(x0, increments, rate0, fixed))

    def _unknowns(self, h: Value, rates: list[Value], a: list[Value], fixed: list[Value]) -> Unknowns:
        f, w, s = self.f, self.w, self.w.system
        nv = s.nv
        with f.strict():
            g = [h * h * (BETA * SHARE), h * (GAMMA * SHARE), h * 0.5]
            gains = [h * (w.state[s.nq + k] + h * ((0.5 - BETA) * a[k] + BETA * fixed[k])) for k in range(nv)]
            gains += [h * ((1.0 - GAMMA) * a[k] + GAMMA * fixed[k]) for k in range(nv)]
            gains += [g[2] * rates[nv + k] for k in range(s.nz)]
        return Unknowns(g, gains)

    def _gained(self, unknowns: Unknowns) -> list[Value]:
        """Return what the step adds to the state with the present v-dot and z-dot at its end."""
        f, nv, nz = self.f, self.w.system.nv, self.w.system.nz
        g = unknowns.weights
        weights = [g[0]] * nv + [g[1]] * nv + [g[2]] * nz
        rates = [*range(nv), *range(nv), *range(nv, nv + nz)]
        return [f.muladd(g, self.a[k], gain) for g, k, gain in zip(weights, rates, unknowns.gains)]

    def _solve(self, t: Value, h: Value, unknowns: Unknowns) -> None:
        """Iterate v-dot and the multipliers; ``outcome`` is 0 where they converge, 2 where not, and may be NaN."""
        f, w = self.f, self.w
        f.store_int(0, self.round)
        with f.loop() as rounds:
            f.store(0.0, self.outcome)
            self._place(unknowns)
            known = [self.a[k] for k in range(self.solved)]
            l = [self.l[k] for k in range(self.m)]
            changes = w.evaluate(self.program, t, self.x, a=known, l=l, g=unknowns.weights)
            w.count(IntegerSlot.EVALUATIONS)
            moved, size = self._update(known, changes, h, unknowns.weights)
            with f.strict():
                rounds.leave(f.compare("ole", moved, size * CONVERGED**2))
                f.store(f.muladd(moved, 0.0, 2.0), self.outcome)
            more = f.compare_int("slt", f.bump(self.round), ITERATIONS)
            rounds.leave(unless=more & f.compare("ord", moved, 0.0))
        self._place(unknowns)

    def _update(
        self, known: list[Value], changes: dict[str, list[Value]], h: Value, weights: list[Value]
    ) -> tuple[Value, Value]:
        """Take a round's changes over; return the squares of what they do to the state, and of the state."""
        f, s = self.f, self.w.system
        moved, size = Total(f), Total(f)
        with f.strict():
            for k, change in enumerate(changes["a"]):
                self.a[k] = known[k] + change
                weight = weights[0] if k < s.nv else weights[2]
                moved.add_product(weight * change, weight * change)
                size.add_product(weight * self.a[k], weight * self.a[k])
            for k, change in enumerate(changes["l"]):
                self.l[k] = self.l[k] + change
                moved.add_product(change, 0.0)
            for k in range(s.size):
                x = self.x[k] * h if s.nq <= k < s.nq + s.nv else self.x[k]
                size.add_product(x, x)
            return moved.value, size.value

    def _place(self, unknowns: Unknowns) -> None:
        """Store the state at the end of the step."""
        for k, gained in enumerate(self._gained(unknowns)):
            self.x[k] = self.w.state[k] + gained

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, t: Value, h: Value, kept: Solved) -> None:
        f, w, s = self.f, self.w, self.w.system
        rates = [self.a[k] for k in range(s.nv + s.nz)]
        a = [f.muladd(SHARE, rates[k], kept.fixed[k]) for k in range(s.nv)]
        memory = self._memory(1.0 - f.load(self.which))
        self._remember(memory, t + h, h, [*rates, *a, *(self.l[k] for k in range(self.m))])
        with self.used(t, h):
            rate1 = [*(w.new[k] for k in range(s.nq, s.nq + s.nv)), *rates]
            self.hermite.save(t, h, Ends(kept.x0, kept.increments, kept.rate0, rate1))

    def dense(self, u: Value, h: Value, out: Array) -> None:
        self.hermite.dense(u, h, out)
