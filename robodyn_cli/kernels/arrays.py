"""Rows of vectors in memory, whose number may be known only to the running code."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.kernels.ir import Function, Int, Value

ALIGNMENT = 64  # bytes, of the widest vector
BYTE = ctypes.c_char


def aligned_zeros(count: int) -> NDArray[np.float64]:
    """Return memory for so many doubles, aligned for vectors."""
    memory = np.zeros(count + ALIGNMENT // 8)
    skip = (-memory.ctypes.data // 8) % (ALIGNMENT // 8)
    return memory[skip : skip + count]


def address(array: NDArray[np.float64]) -> int:
    """Return where the numbers of a column-ordered array lie; ``array.ctypes`` takes three times as long to say so."""
    try:
        return ctypes.addressof(BYTE.from_buffer(array.T))
    except (TypeError, ValueError):  # it may only be read, is empty, or has gaps
        return array.ctypes.data


class Array:
    """Vectors of ``width`` lanes at ``base``, entry k at ``k * stride`` doubles (``width`` by default).

    An index is a Python int in straight-line code, where LLVM turns the entries into registers, or an ``Int``
    in a loop. Vectors are aligned to their size unless the stride is the caller's.
    """

    def __init__(self, f: Function, base: str, width: int = 1, stride: Int | None = None) -> None:
        self.f = f
        self.base = base
        self.width = width
        self.stride = stride

    def at(self, k: Int | int) -> str:
        """Return the address of an entry."""
        return self.f.offset(self.base, k * self.width if self.stride is None else self.stride * k)

    def part(self, first: Int | int) -> Array:
        """Return the entries from ``first`` on."""
        return Array(self.f, self.at(first), self.width, self.stride)

    def __getitem__(self, k: Int | int) -> Value:
        return self.f.load(self.at(k), self.width, 8 * self.width)

    def __setitem__(self, k: Int | int, x: Value | float) -> None:
        self.f.store(self.f.lift(x, self.width), self.at(k), 8 * self.width)


class Total:
    """A sum that a loop, or straight-line code, adds to."""

    def __init__(self, f: Function, width: int = 1) -> None:
        self.f = f
        self.width = width
        self.address = f.slot(width)
        f.store(f.constant(0.0, width), self.address, 8 * width)

    @property
    def value(self) -> Value:
        return self.f.load(self.address, self.width, 8 * self.width)

    def add_product(self, a: Value, b: Value | float) -> None:
        """Add a b, rounded once where the machine fuses."""
        self.f.store(self.f.muladd(a, b, self.value), self.address, 8 * self.width)


def each(f: Function, count: Int | int) -> Iterator[Int | int]:
    """Emit the body of a ``for`` for each index: repeated where the count is a Python int, else as a loop."""
    if isinstance(count, int):
        yield from range(count)
    else:
        with f.count(count) as k:
            yield k
