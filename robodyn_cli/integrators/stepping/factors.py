"""The factors of g E - J inside compiled code, and the triangular sweeps that solve with them.

Small systems have them as straight-line code that skips structural zeros, large ones as loops (``columns``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from robodyn_cli.algorithms.complex import Complex
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.stepping.columns import ComplexArray, ComplexLanes, FactorsInLoops, Real
from robodyn_cli.integrators.stepping.stepper import DERIVATIVES, StepProgram
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Int, Value
from robodyn_cli.kernels.lower import LANES


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
        found = w.evaluate(program, t, x, g=[g])
        self.f = w.f
        self.n = w.system.size
        self.lu = found["lu"]
        self.present = _present(program.outputs["lu"])
        self.ft = [
            value if there else None for value, there in zip(found["ft"], _present(program.outputs["ft"]))
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
        found = w.evaluate(program, w.f.splat(t, g.re.width), wide, g=[g.re, g.im])
        self.f = w.f
        self.n = w.system.size
        self.re, self.im = found["re"], found["im"]
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
