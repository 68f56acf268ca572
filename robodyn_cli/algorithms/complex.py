"""Complex numbers whose parts are numbers or expressions."""

from __future__ import annotations

from typing import Any

from robodyn_cli.record import record


@record
class Complex:
    """re + i im; parts that are float zeros leave nothing behind in a product."""

    re: Any
    im: Any = 0.0

    def __add__(self, other: Complex) -> Complex:
        return Complex(self.re + other.re, self.im + other.im)

    def __sub__(self, other: Complex) -> Complex:
        return Complex(self.re - other.re, self.im - other.im)

    def __mul__(self, other: Complex) -> Complex:
        return Complex(
            self.re * other.re - self.im * other.im,
            self.re * other.im + self.im * other.re,
        )

    def __rtruediv__(self, number: float) -> Complex:
        """Return number / self."""
        size = self.re * self.re + self.im * self.im
        return Complex(number * self.re / size, -(number * self.im) / size)
