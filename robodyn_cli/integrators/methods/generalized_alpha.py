"""The generalized-alpha method with a fixed step: order 2, with numerical damping of what the step does not resolve.

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

from robodyn_cli.errors import CapabilityError
from robodyn_cli.formulations.events import EventKind
from robodyn_cli.formulations.index3 import first_order_step
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.layout import Real, Whole
from robodyn_cli.integrators.stepping.hermite import HermiteStepper
from robodyn_cli.integrators.stepping.stepper import Attempt
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Value
from robodyn_cli.kernels.program import Program

RHO = 0.8  # spectral radius for infinitely fast oscillations: what is left of them after a step
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


class GeneralizedAlpha(HermiteStepper):
    """Generalized-alpha, spectral radius 0.8, fixed step: order 2; loops at index 3, with multipliers as unknowns."""

    name = "generalized_alpha"
    order = 2
    dense_order = 2
    adaptive = False
    needs_jacobian = True

    def digest(self, system: System) -> str:
        return "" if system.index3 is None or self.obstacle(system) else f" {system.index3.program.digest}"

    def linearisation(self, system: System) -> Program:
        """Return a step of Newton's iteration: at index 3, or for the system as it is."""
        return first_order_step(system.rates, system.nv) if system.index3 is None else system.index3.program

    def obstacle(self, system: System) -> str:
        if system.dynamics.any_size:
            return "a long chain is integrated by loops over its bodies, which have no exact Jacobian"
        if system.layout is not None:
            return "a joint has velocities that are not rates of its coordinates (a ball, a free body)"
        if system.partition is not None:
            return "some rows of the loops depend on each other, or 'stabilisation: independent' chooses coordinates"
        if any(e.kind is EventKind.CONTACT for e in system.events):
            return "a joint has friction with 'law: set_valued' or a rigid stop"
        return ""

    def projects(self, system: System) -> bool:
        return system.index3 is None

    # -- memory: accelerations at the ends of the last two steps, one of which may be taken back --------------
    def dense_size(self, system: System) -> int:
        return super().dense_size(system) + 1 + 2 * self._memory_size(system)

    def _memory_size(self, system: System) -> int:
        rows = 0 if system.index3 is None else system.index3.rows
        return FIRST + 2 * system.nv + system.nz + rows

    def _end(self, w: Writer) -> str:
        return w.f.offset("%dense", super().dense_size(w.system))

    def _memory(self, w: Writer, which: Value | float) -> str:
        """Return the address of memory 0 or 1."""
        f = w.f
        start, size = super().dense_size(w.system) + 1, self._memory_size(w.system)
        if isinstance(which, float):
            return f.offset("%dense", start + int(which) * size)
        return f.offset("%dense", f.to_int(which) * size + start)

    def prepare(self, w: Writer) -> None:
        why = self.obstacle(w.system)
        if why:
            raise CapabilityError(
                f"{self.name!r} does not do this scene: {why}; allowed: auto, gauss, radau13"
            )
        f, s = w.f, w.system
        self.program = self.linearisation(s)
        self.m = len(self.program.outputs["l"])
        self.solved = len(self.program.outputs["a"])  # v-dot and, where they are coupled, z-dot
        self.a, self.l = Array(f, f.slot(1, max(1, s.nv + s.nz))), Array(f, f.slot(1, max(1, self.m)))
        self.x, self.rates = w.array(2, 1), w.array(1, 1)
        self.which, self.round, self.outcome = f.slot(), f.int_slot(), f.slot()
        # where the last run has come to its end there may be a kink: begin anew
        t, end, last = w.get(Real.T), w.get(Real.T_END), f.load(self._end(w))
        arrived = f.compare("ole", f.abs(t - last), f.muladd(f.abs(last), 1e-15, 1e-300))
        with f.when(arrived & f.compare("une", end, last)):
            for which in (0.0, 1.0):
                f.store(0.0, f.offset(self._memory(w, which), STEP))
        f.store(end, self._end(w))

    def _begin(self, w: Writer, t: Value, h: Value) -> None:
        """Find the memory that ends at t; where there is none, v-dot is evaluated and a is set to fit it.

        a belongs to a time that lies (alpha_m - alpha_f) h off, so it is v-dot extrapolated to there; starting with
        v-dot itself would cost an order in the multipliers (Arnold, Bruls and Cardona 2015). Where the step does not
        resolve the fastest decays, which shows in an explicit extrapolation far beyond an implicit one, v-dot at the
        start says nothing of the step: what an implicit Euler step gives takes its place.
        """
        f, s = w.f, w.system

        def fits(which: float) -> Value:
            memory = self._memory(w, which)
            step = f.load(f.offset(memory, STEP))
            near = f.compare("ole", f.abs(f.load(f.offset(memory, STAMP)) - t), step * 1e-6)
            return f.select(near & f.compare("ogt", step, 0.0), f.constant(1.0), f.constant(0.0))

        first, second = fits(0.0), fits(1.0)
        f.store(second, self.which)
        with f.when(f.compare("olt", first + second, 0.5)):
            ahead = h * (ALPHA_F - ALPHA_M)
            w.dynamics(t, w.state, self.rates)
            rates = [self.rates[k] for k in range(s.nv + s.nz)]
            for k in range(s.nv):
                self.x[k] = w.state[k] + ahead * (w.state[s.nq + k] + 0.5 * ahead * rates[k])
            for k, rate in enumerate(rates):
                self.x[s.nq + k] = w.state[s.nq + k] + ahead * rate
            w.dynamics(t + ahead, self.x, self.rates)
            w.count(Whole.EVALUATIONS, 2)
            there = [self.rates[k] for k in range(s.nv)]
            implicit = self._implicit(w, t, h)
            with f.strict():
                far, near = Total(f), Total(f)
                for k in range(s.nv):
                    change = (there[k] - rates[k]) * (1.0 / (ALPHA_F - ALPHA_M))
                    far.add_product(change, change)
                    change = implicit[k] - rates[k]
                    near.add_product(change, change)
                resolved = f.compare("ole", far.value, near.value * STIFF**2) | f.compare(
                    "uno", near.value, 0.0
                )
                a = [f.select(resolved, 2.0 * rates[k] - there[k], implicit[k]) for k in range(s.nv)]
                rates = [
                    f.select(resolved, *pair) for pair in zip(rates, [*implicit, *rates[len(implicit) :]])
                ]
            self._remember(w, self._memory(w, 0.0), t, h, [*rates, *a, *[f.constant(0.0)] * self.m])
            f.store(0.0, f.offset(self._memory(w, 1.0), STEP))

    def _implicit(self, w: Writer, t: Value, h: Value) -> list[Value]:
        """Return v-dot and, where they are coupled, z-dot at the end of an implicit Euler step, linearised."""
        f, s = w.f, w.system
        for k in range(s.size):
            self.x[k] = f.muladd(h, w.state[s.nq + k], w.state[k]) if k < s.nq else w.state[k]
        nothing = [f.constant(0.0)] * (s.nv + s.nz + self.m)
        g = [h * h * 0.5, h, h]
        w.count(Whole.EVALUATIONS)
        return w.evaluate(self.program, t + h, self.x, a=nothing, l=nothing, g=g)["a"]

    def _remember(self, w: Writer, memory: str, t: Value, h: Value, numbers: list[Value]) -> None:
        """Store v-dot, z-dot, a and the multipliers at t."""
        for k, value in enumerate([t, h, *numbers]):
            w.f.store(value, w.f.offset(memory, k))

    # -- the step -------------------------------------------------------------------------------------
    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        f, s = w.f, w.system
        nv, nz = s.nv, s.nz
        self._begin(w, t, h)
        memory = self._memory(w, f.load(self.which))
        kept = [f.load(f.offset(memory, FIRST + k)) for k in range(2 * nv + nz + self.m)]
        rates, a, multipliers = kept[: nv + nz], kept[nv + nz : 2 * nv + nz], kept[2 * nv + nz :]
        with f.strict():
            # a lies off v-dot in proportion to the step
            ratio = h / f.load(f.offset(memory, STEP))
            a = [rate + (x - rate) * ratio for x, rate in zip(a, rates)]
            # a' without the part of v-dot', and what q, v and z gain with it
            fixed = [(ALPHA_F * rate - ALPHA_M * x) * (1.0 / (1.0 - ALPHA_M)) for x, rate in zip(a, rates)]
            g = [h * h * (BETA * SHARE), h * (GAMMA * SHARE), h * 0.5]
            gains = [h * (w.state[s.nq + k] + h * ((0.5 - BETA) * a[k] + BETA * fixed[k])) for k in range(nv)]
            gains += [h * ((1.0 - GAMMA) * a[k] + GAMMA * fixed[k]) for k in range(nv)]
            gains += [g[2] * rates[nv + k] for k in range(nz)]
        for k, rate in enumerate(rates):
            self.a[k] = rate
        for k, multiplier in enumerate(multipliers):
            self.l[k] = multiplier
        self._solve(w, t + h, h, g, gains)
        if self.solved == nv and nz:
            # nothing depends on z, such as work: it follows at the end
            w.dynamics(t + h, self.x, self.rates)
            w.count(Whole.EVALUATIONS)
            for k in range(nz):
                self.a[nv + k] = self.rates[nv + k]
        self.x0, self.rate0 = [w.state[k] for k in range(s.size)], [*gains[:nv], *rates]
        self.increments = self._gained(w, g, gains)
        for k in range(s.size):
            w.new[k] = self.x0[k] + self.increments[k]
        self.start, self.shift = a, fixed
        return Attempt(f.load(self.outcome), f.constant(1.0))

    def _gained(self, w: Writer, g: list[Value], gains: list[Value]) -> list[Value]:
        """Return what the step adds to the state with the present v-dot and z-dot at its end."""
        f, nv = w.f, w.system.nv
        weights = [g[0]] * nv + [g[1]] * nv + [g[2]] * w.system.nz
        rates = [*range(nv), *range(nv), *range(nv, nv + w.system.nz)]
        return [f.muladd(weight, self.a[k], gain) for weight, k, gain in zip(weights, rates, gains)]

    def _solve(self, w: Writer, t: Value, h: Value, g: list[Value], gains: list[Value]) -> None:
        """Iterate v-dot and the multipliers; ``outcome`` is 0 where they converge, 2 where not, and may be NaN."""
        f, s = w.f, w.system
        iterate, onward, solved = (f.label(x) for x in ("iterate", "onward", "solved"))
        f.store_int(0, self.round)
        f.store(0.0, self.outcome)
        f.jump(iterate)
        f.place(iterate)
        self._place(w, g, gains)
        known = [self.a[k] for k in range(self.solved)]
        found = w.evaluate(self.program, t, self.x, a=known, l=[self.l[k] for k in range(self.m)], g=g)
        w.count(Whole.EVALUATIONS)
        moved, size = Total(f), Total(f)
        with f.strict():
            for k, change in enumerate(found["a"]):
                self.a[k] = known[k] + change
                weight = g[0] if k < s.nv else g[2]
                moved.add_product(weight * change, weight * change)
                size.add_product(weight * self.a[k], weight * self.a[k])
            for k, change in enumerate(found["l"]):
                self.l[k] = self.l[k] + change
                moved.add_product(change, 0.0)
            for k in range(s.size):
                x = self.x[k] * h if s.nq <= k < s.nq + s.nv else self.x[k]
                size.add_product(x, x)
            near = f.compare("ole", moved.value, size.value * CONVERGED**2)
        f.branch(near, solved, onward)
        f.place(onward)
        with f.strict():
            f.store(f.muladd(moved.value, 0.0, 2.0), self.outcome)
        more = f.compare_int("slt", f.bump(self.round), ITERATIONS) & f.compare("ord", moved.value, 0.0)
        again = f.label("again")
        end = f.label("end")
        f.branch(more, again, end)
        f.place(again)
        f.store(0.0, self.outcome)
        f.jump(iterate)
        f.place(solved)
        f.jump(end)
        f.place(end)
        self._place(w, g, gains)

    def _place(self, w: Writer, g: list[Value], gains: list[Value]) -> None:
        """Store the state at the end of the step."""
        for k, gained in enumerate(self._gained(w, g, gains)):
            self.x[k] = w.state[k] + gained

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        f, s = w.f, w.system
        rates = [self.a[k] for k in range(s.nv + s.nz)]
        a = [f.muladd(SHARE, rates[k], self.shift[k]) for k in range(s.nv)]
        memory = self._memory(w, 1.0 - f.load(self.which))
        self._remember(w, memory, t + h, h, [*rates, *a, *(self.l[k] for k in range(self.m))])
        super().save_dense(w, t, h)

    def _end_rate(self, w: Writer, t: Value, x: list[Value]) -> list[Value]:
        s = w.system
        return [*x[s.nq : s.nq + s.nv], *(self.a[k] for k in range(s.nv + s.nz))]
