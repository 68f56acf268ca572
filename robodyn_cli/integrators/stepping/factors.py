"""Solving with the factors of g E - J inside compiled code: triangular sweeps that skip structural zeros."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Value
from robodyn_cli.kernels.program import Program


def _present(entries: Sequence[int | float]) -> list[bool]:
    """Tell which entries are structurally nonzero."""
    return [not (isinstance(e, float) and e == 0.0) for e in entries]


class RealFactors:
    """g E - J at time t and state x, factored; ``ft`` is df/dt, an entry None where it vanishes."""

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

    def solve(self, b: Sequence[Value]) -> list[Value]:
        """Return (g E - J)^-1 b."""
        f, n = self.f, self.n
        x = list(b)
        for i in range(n):
            for k in range(i):
                if self.present[i * n + k]:
                    x[i] = f.muladd(-self.lu[i * n + k], x[k], x[i])
        for i in reversed(range(n)):
            for k in range(i + 1, n):
                if self.present[i * n + k]:
                    x[i] = f.muladd(-self.lu[i * n + k], x[k], x[i])
            x[i] = x[i] * self.lu[i * n + i]
        return x


Pair = tuple[Value, Value]


class ComplexFactors:
    """g E - J for complex g = (re, im), one g in each lane, factored at time t and state x (of as many lanes)."""

    def __init__(self, w: Writer, t: Value, x: Array, g: Pair) -> None:
        program: Program = w.system.complex_linearisation
        found = w.evaluate(program, t, x, g=list(g))
        self.f = w.f
        self.n = w.system.size
        self.re, self.im = found["re"], found["im"]
        self.has_re, self.has_im = _present(program.outputs["re"]), _present(program.outputs["im"])

    def _times(self, place: int, x: Pair) -> Pair | None:
        """Return an entry of the factors times x, or None where it is zero."""
        f, a, b = self.f, self.re[place], self.im[place]
        if not self.has_im[place]:
            return (a * x[0], a * x[1]) if self.has_re[place] else None
        return f.muladd(a, x[0], -(b * x[1])), f.muladd(a, x[1], b * x[0])

    def _less(self, x: Pair, place: int, y: Pair) -> Pair:
        product = self._times(place, y)
        return x if product is None else (x[0] - product[0], x[1] - product[1])

    def solve(self, b: Sequence[Pair]) -> list[Pair]:
        """Return (g E - J)^-1 b, lane by lane."""
        n = self.n
        x = list(b)
        for i in range(n):
            for k in range(i):
                x[i] = self._less(x[i], i * n + k, x[k])
        for i in reversed(range(n)):
            for k in range(i + 1, n):
                x[i] = self._less(x[i], i * n + k, x[k])
            scaled = self._times(i * n + i, x[i])
            assert scaled is not None
            x[i] = scaled
        return x
