"""The torques that a motor bears at each speed, and how much of them a point of a duty cycle uses.

Temperatures of a motor: the winding and the housing as two bodies, the surroundings as a third.

    C1 x1' = P - (x1 - x2) / R1,    C2 x2' = (x1 - x2) / R1 - x2 / R2,    C1 = tau1 / R1, C2 = tau2 / R2

x are temperatures above the surroundings, P the losses of the winding. Data sheets state R1 (winding to housing), R2
(housing to surroundings), tau1 and tau2. Source: maxon academy, formulae handbook, chapter "Thermal behaviour".
Valid as long as the losses that arise in the housing (iron, bearings) are small beside those of the winding.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.schema.fields import Number, key
from robodyn_cli.spatial.algebra import Array

Points = Sequence[tuple[float, float]]


@record
class Envelope:
    """A curve of torque over speed from standstill to the largest speed, where it falls to zero.

    speeds (n,) [rad/s], torques (n,) [N m], none negative. Every ray from rest crosses the curve once, so that
    ``use`` is defined.
    """

    speeds: Array
    torques: Array

    @staticmethod
    def through(points: Points) -> Envelope:
        """Return the curve through points (speed, torque), closed at the largest speed."""
        last = points[-1]
        closed = [*points, (last[0], 0.0)] if last[1] > 0.0 else list(points)
        speeds, torques = np.array(closed, dtype=float).T
        return Envelope(speeds, torques)

    @property
    def top_speed(self) -> float:
        """The largest speed [rad/s]."""
        return float(self.speeds[-1])

    def use(self, speed: Array, torque: Array) -> Array:
        """Return how much of the curve points (speed [rad/s], torque [N m]) use, shaped as these.

        The number s >= 0 for which (speed / s, torque / s) lies on the curve: up to 1 the point is inside, and a
        motor that is s times as fast and s times as strong just bears it. Signs do not matter.
        """
        w, T = np.broadcast_arrays(np.abs(speed), np.abs(torque))
        angles = np.arctan2(self.torques, self.speeds)[::-1]  # rising
        edge = np.clip(np.searchsorted(angles, np.arctan2(T, w), side="right"), 1, len(angles) - 1)
        k = len(angles) - 1 - edge  # the edge from vertex k to k + 1
        dw, dT = np.diff(self.speeds)[k], np.diff(self.torques)[k]
        use: Array = (w * dT - T * dw) / (self.speeds[k] * dT - self.torques[k] * dw)
        return use


def curve_problems(points: Points) -> Iterable[tuple[tuple[int, ...], str]]:
    """Yield what is wrong with rows of speed and torque: the place of a number, and what is wrong."""
    if points[0][0] != 0.0:
        yield (0, 0), f"the first speed is 0 (value {points[0][0]:g})"
        return
    for k, (speed, torque) in enumerate(points):
        last = k == len(points) - 1
        if torque < 0.0 or (torque == 0.0 and not last):
            allowed = "a number >= 0" if last else "a number > 0, but for the last row"
            yield (k, 1), f"is no torque of an envelope (value {torque:g}); allowed: {allowed}"
            return
        if k and not speed > points[k - 1][0]:
            yield (k, 0), f"speeds must increase (value {speed:g} after {points[k - 1][0]:g})"
            return
        if k > 1 and not math.atan2(torque, speed) < math.atan2(points[k - 1][1], points[k - 1][0]):
            yield (k, 1), f"the torque must not rise faster than the speed (value {torque:g})"
            return


REFERENCE = 25.0  # temperature at which data sheets state resistances [degC]


@record
class Thermal:
    """Two bodies that heat takes time to pass: the winding and the housing."""

    winding_resistance: float = key(
        Number(minimum=0.0, exclusive=True), unit="K/W", doc="Thermal resistance from winding to housing."
    )
    housing_resistance: float = key(
        Number(minimum=0.0, exclusive=True),
        unit="K/W",
        doc="Thermal resistance from housing to surroundings.",
    )
    winding_time: float = key(
        Number(minimum=0.0, exclusive=True), unit="s", doc="Thermal time constant of the winding."
    )
    housing_time: float = key(
        Number(minimum=0.0, exclusive=True), unit="s", doc="Thermal time constant of the housing."
    )
    max_temperature: float = key(
        Number(minimum=REFERENCE, exclusive=True), unit="degC", doc="Largest temperature of the winding."
    )
    coefficient: float = key(
        Number(minimum=0.0),
        default=0.00393,
        unit="1/K",
        doc="Change of the winding's resistance with its temperature, of that at 25 degC; default: copper.",
    )

    @property
    def whole(self) -> float:
        """Thermal resistance from the winding to the surroundings [K/W]."""
        return self.winding_resistance + self.housing_resistance

    def growth(self, temperature: Array) -> Array:
        """Return the winding's resistance at a temperature [degC] over that at 25 degC."""
        return 1.0 + self.coefficient * (temperature - REFERENCE)

    def steady_mean(self, losses: Array, ambient: float) -> Array:
        """Return the mean temperature [degC] after many cycles, with the resistance that the winding has then.

            theta = ambient + R P (1 + alpha (theta - 25)),    R = R1 + R2

        losses : mean losses P with the resistance at 25 degC [W]. Infinite where they grow faster than the heat leaves.
        """
        heat = self.whole * np.asarray(losses)
        rest = 1.0 - self.coefficient * heat
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = ambient + heat * self.growth(np.asarray(ambient)) / rest
        return np.where(rest > 0.0, mean, np.inf)

    def warming(self, losses: Array, times: Array, periodic: bool) -> Array:
        """Return by how much the winding is warmer than the surroundings (..., T) [K] over a cycle.

        The exact solution for losses (..., T) [W] that are linear between samples at times (T,) [s]: in the steady
        periodic state, or beginning with all at the temperature of the surroundings.
        """
        total: Array = np.zeros(np.shape(losses))
        for rate, part in self._modes():
            a, first, second = _weights(rate, np.diff(times))
            given = np.zeros(np.shape(losses))
            given[..., 1:] = first * losses[..., :-1] + second * losses[..., 1:]
            warmth = _accumulated(given, a)
            if periodic:
                since = times - times[0]
                start = warmth[..., -1:] / -math.expm1(-rate * since[-1])
                warmth = warmth + start * np.exp(-rate * since)
            total += part * warmth
        return total

    def _modes(self) -> list[tuple[float, float]]:
        """Return rate of decay [1/s] and part of the winding's response [K/J] of both modes of the network."""
        C1, C2 = self.winding_time / self.winding_resistance, self.housing_time / self.housing_resistance
        a, d = 1.0 / self.winding_time, 1.0 / self.housing_time + 1.0 / (self.winding_resistance * C2)
        bc = 1.0 / (self.winding_resistance * C1) / (self.winding_resistance * C2)
        half, mean = math.hypot(0.5 * (a - d), math.sqrt(bc)), 0.5 * (a + d)
        fast = mean + half
        slow = (1.0 / (self.winding_time * self.housing_time)) / fast  # the determinant, without cancellation
        return [(fast, (fast - d) / (fast - slow) / C1), (slow, (d - slow) / (fast - slow) / C1)]


def _weights(rate: float, steps: Array) -> tuple[Array, Array, Array]:
    """Return exp(-rate step), and the integrals of exp(-rate (step - s)) (1 - s / step) and of exp(..) s / step, of
    each of steps (T - 1,)."""
    x = rate * steps
    whole = -np.expm1(-x) / rate
    # of s / step: (x - 1 + exp(-x)) / x^2 step; as a series where that cancels
    small, large = x < 1e-4, np.maximum(x, 1e-4)
    second = steps * np.where(small, 0.5 - x / 6.0 + x * x / 24.0, (large + np.expm1(-large)) / large**2)
    return np.exp(-x), whole - second, second


def _accumulated(given: Array, a: Array) -> Array:
    """Return x (..., T) with x_k = a_(k-1) x_(k-1) + given_k: within blocks side by side, then from block to block."""
    samples = given.shape[-1]
    length = math.isqrt(samples - 1) + 1
    blocks = -(-samples // length)
    padded = np.zeros((*given.shape[:-1], blocks * length))
    padded[..., :samples] = given
    x = np.moveaxis(padded.reshape(*given.shape[:-1], blocks, length), -1, 0).copy()  # (length, ..., blocks)
    factors = np.ones(blocks * length)
    factors[1:samples] = a
    factors = factors.reshape(blocks, length).T  # (length, blocks)
    for k in range(1, length):
        x[k] += factors[k].reshape(*[1] * (x.ndim - 2), blocks) * x[k - 1]
    since = np.cumprod(factors, axis=0)
    before = np.zeros(x.shape[1:])  # the last entry of the block before
    for block in range(1, blocks):
        before[..., block] = x[-1][..., block - 1] + since[-1, block - 1] * before[..., block - 1]
    x += since.reshape(length, *[1] * (x.ndim - 2), blocks) * before
    return np.moveaxis(x, 0, -1).reshape(padded.shape)[..., :samples]
