"""What implicit methods share in a step: Newton's rounds, and the factors of g E - J with the triangular sweeps that
solve with them, straight-line code that skips structural zeros for small systems, loops for large ones.

Columns of J are derivatives of the rates along the axes of the state, LANES of them at once (``System.tangents``). What
takes most time in straight-line code, the elimination of a hundred rows, takes three short loops here. They pass over
zeros of the upper triangle when they meet them; since the rows of q-dot = v come first, that leaves the elimination of
a matrix of the size of the rates.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Generic, Protocol, TypeVar

from robodyn_cli.algorithms.linear import Complex
from robodyn_cli.formulations.linearisation import DIRECTION
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.memory import DoubleSlot
from robodyn_cli.integrators.stepping.stepper import DERIVATIVES, StepProgram
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Block, Condition, Function, Int, LoopBlock, Value
from robodyn_cli.kernels.lower import LANES
from robodyn_cli.record import record

BEGUN = 1e300  # in place of the update before the first
FIRST = 1e200  # updates before the first are above this
UNKNOWN_RATIO = 0.5  # of the first two updates, where nothing is remembered
LEAST_RATIO = 0.01
BROKEN = 0.1  # factor of the next step where an update is not finite


@record
class NewtonLimits:
    """What ends the rounds of a step; updates are in units of the tolerance.

    rounds : how many there may be. converged : what may be left, as far as the ratio r of two updates tells: the
    last update times r / (1 - r). rounding : the update below which one that no longer shrinks is rounding.
    shorter : factor of the next step where they do not converge. remembers : whether the first ratio is taken from the
    step before (``DoubleSlot.CONTRACTION``), so that one round can be enough.
    """

    rounds: int
    converged: float
    rounding: float
    shorter: float
    remembers: bool = False


class Rounds:
    """The rounds of a method; ``done`` is the place of the number of rounds beyond the first."""

    def __init__(self, w: Writer, limits: NewtonLimits) -> None:
        self.w, self.limits = w, limits
        self.before, self.done = w.f.slot(), w.f.int_slot()

    @contextlib.contextmanager
    def repeat(self, h: Value, failed: Block) -> Iterator[Callable[[Value], None]]:
        """Emit the body as a round, at whose end what is yielded is called with the norm of the update.

        Code goes on where the step is solved; else ``failed`` is left, with a shorter step than ``h`` stored.
        """
        f = self.w.f
        f.store(BEGUN, self.before)
        f.store_int(0, self.done)
        with f.loop() as loop:
            yield lambda update: self._judge(loop, update, h, failed)

    def _judge(self, loop: LoopBlock, update: Value, h: Value, failed: Block) -> None:
        """Emit the end of a round: the step is solved, or there is another round, or it is given up."""
        w, f, limits = self.w, self.w.f, self.limits
        with f.strict():
            last = f.load(self.before)
            f.store(update, self.before)
            first = f.compare("ogt", last, FIRST)
            ratio = f.select(first, self._expected(), update / last)
            if limits.remembers:
                # the remembered ratio fades, so that steps that one round solves still end after one
                fading = f.select(first, ratio * 0.5, ratio)
                w.put(DoubleSlot.CONTRACTION, f.select(f.compare("ord", ratio, 0.0), fading, 1.0))
            left = update * ratio / f.max(1.0 - ratio, LEAST_RATIO)
            small = f.compare("olt", left, limits.converged)
            growing = f.compare("uge", ratio, 1.0) & ~first
        loop.leave(small)
        finite = f.compare("ord", update, 0.0)
        loop.again(f.compare_int("slt", f.bump(self.done), limits.rounds) & finite & ~growing)
        loop.leave(f.compare("olt", update, limits.rounding))
        w.put(DoubleSlot.H, h * f.select(finite, f.constant(limits.shorter), f.constant(BROKEN)))
        if limits.remembers:
            w.put(DoubleSlot.CONTRACTION, 1.0)
        failed.leave()

    def _expected(self) -> Value:
        """Return the ratio to reckon with before there are two updates."""
        f = self.w.f
        if not self.limits.remembers:
            return f.constant(UNKNOWN_RATIO)
        return f.max(self.w.get(DoubleSlot.CONTRACTION), LEAST_RATIO)


Number = TypeVar("Number", Value, Complex)


class FactorNumbers(Protocol[Number]):
    """Real or complex numbers in memory."""

    def __getitem__(self, k: Int | int) -> Number: ...
    def __setitem__(self, k: Int | int, x: Number) -> None: ...


class Field(Protocol[Number]):
    """The numbers that a matrix consists of."""

    def room(self, count: int) -> FactorNumbers[Number]:
        """Return memory of the run for so many numbers."""

    def number(self, x: Value | float) -> Number:
        """Return a real number as one of these."""

    def is_nonzero(self, x: Number) -> Condition: ...


class Real:
    """Real numbers."""

    def __init__(self, w: Writer) -> None:
        self.w = w

    def room(self, count: int) -> Array:
        return self.w.room(count, 1)

    def number(self, x: Value | float) -> Value:
        return self.w.f.lift(x, 1)

    def is_nonzero(self, x: Value) -> Condition:
        return self.w.f.compare("une", x, 0.0)


class ComplexLanes:
    """Complex numbers, one in each lane."""

    def __init__(self, w: Writer, lanes: int) -> None:
        self.w = w
        self.lanes = lanes

    def room(self, count: int) -> ComplexArray:
        return ComplexArray(self.w.room(count, 2 * self.lanes))

    def number(self, x: Value | float) -> Complex:
        return Complex(self.w.f.lift(x, self.lanes), self.w.f.constant(0.0, self.lanes))

    def is_nonzero(self, x: Complex) -> Condition:
        f = self.w.f
        return (f.compare("une", x.re, 0.0) | f.compare("une", x.im, 0.0)).any()


class ComplexArray:
    """Complex numbers in an array: real parts in the lower half of the lanes, imaginary parts in the upper one."""

    def __init__(self, array: Array) -> None:
        self.array = array

    def __getitem__(self, k: Int | int) -> Complex:
        return halves(self.array.f, self.array[k])

    def __setitem__(self, k: Int | int, x: Complex) -> None:
        self.array[k] = joined(self.array.f, x)


def halves(f: Function, x: Value) -> Complex:
    """Return the lower half of the lanes as real parts, and the upper one as imaginary parts."""
    width = x.width // 2
    if width == 1:
        return Complex(f.lane(x, 0), f.lane(x, 1))
    return Complex(f.shuffle(x, x, range(width)), f.shuffle(x, x, range(width, 2 * width)))


def joined(f: Function, x: Complex) -> Value:
    """Return real and imaginary parts as one vector, the real ones in the lower lanes."""
    width = x.re.width
    if width == 1:
        return f.pack([x.re, x.im], 2)
    return f.shuffle(x.re, x.im, range(2 * width))


class JacobianInLoops:
    """J at a time and state, row by row for v-dot and z-dot; column n is df/dt."""

    def __init__(self, w: Writer, t: Value, x: Array) -> None:
        f, n = w.f, w.system.size
        self.length = -(-(n + 1) // LANES) * LANES
        self.J = w.room((w.system.nv + w.system.nz) * self.length, 1)
        wide, direction = w.room(n, LANES), w.room(self.length, LANES)
        with f.count(n) as c:
            wide[c] = f.splat(x[c], LANES)
        with f.count(self.length) as c:
            direction[c] = 0.0
        axes = [f.constant([float(k == lane) for lane in range(LANES)]) for k in range(LANES)]
        with f.count(self.length, step=LANES) as first:
            for k, axis in enumerate(axes):
                direction[first + k] = axis
            rows = w.evaluate(w.system.tangents, t, wide, **{DIRECTION: direction})["d"]
            for row, derivatives in enumerate(rows):
                f.store(derivatives, f.offset(self.J.base, first + row * self.length), 8)
            for k in range(LANES):
                direction[first + k] = 0.0

    def at(self, row: Int, column: Int | int) -> Value:
        """Return the derivative of a rate (v-dot, then z-dot) by a state, or by t (column n)."""
        return self.J[row * self.length + column]


class FactorsInLoops(Generic[Number]):
    """g E - J at time t and state x, factored without pivoting.

    B : column after column L below the diagonal, U above it, and the inverted diagonal of U.
    """

    def __init__(self, w: Writer, t: Value, x: Array, g: Number, field: Field[Number]) -> None:
        self.f, self.n = w.f, w.system.size
        self.field: Field[Number] = field
        self.jacobian = JacobianInLoops(w, t, x)
        self.B: FactorNumbers[Number] = field.room(self.n * self.n)
        self._assemble(w.system.nv, w.system.nz, g)
        self._eliminate()

    def _assemble(self, nv: int, nz: int, g: Number) -> None:
        f, n, B, number = self.f, self.n, self.B, self.field.number
        with f.count(n * n) as k:
            B[k] = number(0.0)
        with f.count(nv) as k:
            B[(k + nv) * n + k] = number(-1.0)  # q-dot = v
        with f.count(n) as column, f.count(nv + nz) as row:
            B[column * n + row + nv] = number(-self.jacobian.at(row, column))
        with f.count(n) as k:
            B[k * (n + 1)] = B[k * (n + 1)] + g

    def _eliminate(self) -> None:
        f, n, B = self.f, self.n, self.B
        with f.count(n) as k:
            below = k + 1
            inverse = 1.0 / B[k * (n + 1)]
            B[k * (n + 1)] = inverse
            with f.count(n, start=below) as i:
                B[k * n + i] = B[k * n + i] * inverse
            with f.count(n, start=below) as column:
                u = B[column * n + k]
                with f.when(self.field.is_nonzero(u)), f.count(n, start=below) as i:
                    B[column * n + i] = B[column * n + i] - B[k * n + i] * u

    def solve(self, x: FactorNumbers[Number]) -> None:
        """Put (g E - J)^-1 x in the place of x."""
        f, n, B = self.f, self.n, self.B
        with f.count(n) as k:
            known = x[k]
            with f.count(n, start=k + 1) as i:
                x[i] = x[i] - B[k * n + i] * known
        with f.count(n, down=True) as k:
            known = x[k] * B[k * (n + 1)]
            x[k] = known
            with f.count(k) as i:
                x[i] = x[i] - B[k * n + i] * known


def derivatives_of(system: System, complex_g: bool = False) -> StepProgram:
    """Return the program that the factors of a system are made with."""
    if system.in_columns:
        return StepProgram(DERIVATIVES, system.tangents, LANES, "columns")
    return StepProgram(DERIVATIVES, system.complex_linearisation if complex_g else system.linearisation)


class RealFactors(Protocol):
    """g E - J, factored."""

    def solve(self, x: Array) -> None:
        """Put (g E - J)^-1 x in the place of x (n,)."""

    def time_derivative(self, c: Int | int) -> Value | None:
        """Return df/dt of a component, None where it vanishes."""


class ComplexFactors(Protocol):
    """g E - J for complex g, one g in each lane, factored."""

    def solve(self, x: ComplexArray) -> None:
        """Put (g E - J)^-1 x in the place of x (n,), lane by lane."""


def real_factors(w: Writer, t: Value, x: Array, g: Value) -> RealFactors:
    """Emit the factors of g E - J at time t and state x."""
    return _RealInLoops(w, t, x, g) if w.system.in_columns else _Real(w, t, x, g)


def complex_factors(w: Writer, t: Value, x: Array, g: Complex) -> ComplexFactors:
    """Emit the factors of g E - J at time t and state x, for as many g as there are lanes."""
    if w.system.in_columns:
        return FactorsInLoops(w, t, x, g, ComplexLanes(w, g.re.width))
    return _Complex(w, t, x, g)


class _RealInLoops(FactorsInLoops[Value]):
    def __init__(self, w: Writer, t: Value, x: Array, g: Value) -> None:
        super().__init__(w, t, x, g, Real(w))
        self.nv = w.system.nv

    def time_derivative(self, c: Int | int) -> Value | None:
        f = self.f
        # q-dot = v does not depend on time
        is_rate = f.compare_int("sge", c, self.nv)
        row = f.select_int(is_rate, f.integer(0) + c - self.nv, 0)
        return f.select(is_rate, self.jacobian.at(row, self.n), 0.0)


def _present(entries: Sequence[int | float]) -> list[bool]:
    """Tell which entries are structurally nonzero."""
    return [not (isinstance(e, float) and e == 0.0) for e in entries]


class _Real:
    def __init__(self, w: Writer, t: Value, x: Array, g: Value) -> None:
        program = w.system.linearisation
        values = w.evaluate(program, t, x, g=[g])
        self.f = w.f
        self.n = w.system.size
        self.lu = values["lu"]
        self.present = _present(program.outputs["lu"])
        self.ft = [
            value if there else None for value, there in zip(values["ft"], _present(program.outputs["ft"]))
        ]

    def time_derivative(self, c: Int | int) -> Value | None:
        assert isinstance(c, int)
        return self.ft[c]

    def solve(self, x: Array) -> None:
        f, n = self.f, self.n
        b = [x[i] for i in range(n)]
        for i in range(n):
            for k in range(i):
                if self.present[i * n + k]:
                    b[i] = f.muladd(-self.lu[i * n + k], b[k], b[i])
        for i in reversed(range(n)):
            for k in range(i + 1, n):
                if self.present[i * n + k]:
                    b[i] = f.muladd(-self.lu[i * n + k], b[k], b[i])
            b[i] = b[i] * self.lu[i * n + i]
            x[i] = b[i]


class _Complex:
    def __init__(self, w: Writer, t: Value, x: Array, g: Complex) -> None:
        program = w.system.complex_linearisation
        wide = w.array(2, 1, g.re.width)
        for c in w.each(w.size):
            wide[c] = w.f.splat(x[c], g.re.width)
        values = w.evaluate(program, w.f.splat(t, g.re.width), wide, g=[g.re, g.im])
        self.f = w.f
        self.n = w.system.size
        self.re, self.im = values["re"], values["im"]
        self.has_re, self.has_im = _present(program.outputs["re"]), _present(program.outputs["im"])

    def _times(self, place: int, x: Complex) -> Complex | None:
        """Return an entry of the factors times x, or None where it is zero."""
        f, a, b = self.f, self.re[place], self.im[place]
        if not self.has_im[place]:
            return Complex(a * x.re, a * x.im) if self.has_re[place] else None
        return Complex(f.muladd(a, x.re, -(b * x.im)), f.muladd(a, x.im, b * x.re))

    def _less(self, x: Complex, place: int, y: Complex) -> Complex:
        product = self._times(place, y)
        return x if product is None else x - product

    def solve(self, x: ComplexArray) -> None:
        n = self.n
        b = [x[i] for i in range(n)]
        for i in range(n):
            for k in range(i):
                b[i] = self._less(b[i], i * n + k, b[k])
        for i in reversed(range(n)):
            for k in range(i + 1, n):
                b[i] = self._less(b[i], i * n + k, b[k])
            scaled = self._times(i * n + i, b[i])
            assert scaled is not None
            x[i] = b[i] = scaled
