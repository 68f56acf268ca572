"""Planar mechanisms in absolute coordinates: the textbook's saddle-point system, solved by numpy at each instant.

An oracle that shares nothing with the package: no joint coordinates, no graph, no compiler. Body k has
x, y of its centre of mass and its angle; pins, slides and motors act between bodies, -1 is the ground.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

GROUND = -1


@dataclasses.dataclass
class Pin:
    """Point ``at_first`` of one body is point ``at_second`` of the other (local coordinates from the c.o.m.)."""

    first: int
    at_first: tuple[float, float]
    second: int
    at_second: tuple[float, float]


@dataclasses.dataclass
class Slide:
    """Body slides without turning along ``axis`` of the ground, through ``through``."""

    body: int
    axis: tuple[float, float]
    through: tuple[float, float] = (0.0, 0.0)


@dataclasses.dataclass
class Motor:
    """Torque on ``second`` and its opposite on ``first``; a function of t, relative angle and relative rate."""

    first: int
    second: int
    torque: Callable[[float, float, float], float]


def turned(angle: float, p: Sequence[float]) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * p[0] - s * p[1], s * p[0] + c * p[1]])


@dataclasses.dataclass
class PlanarBodies:
    """masses and inertias [kg, kg m^2] by body; pins, slides and motors; gravity [m/s^2]."""

    masses: Sequence[float]
    inertias: Sequence[float]
    pins: Sequence[Pin] = ()
    slides: Sequence[Slide] = ()
    motors: Sequence[Motor] = ()
    gravity: tuple[float, float] = (0.0, 0.0)

    @property
    def n(self) -> int:
        return len(self.masses)

    def mass_matrix(self) -> np.ndarray:
        return np.diag([x for m, I in zip(self.masses, self.inertias) for x in (m, m, I)])

    def constraints(self, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return eta, Psi and gamma = Psi-dot v, pins first (x and y of each), then slides."""
        eta, psi, gamma = [], [], []
        for pin in self.pins:
            row = np.zeros((2, 3 * self.n))
            gap, quick = np.zeros(2), np.zeros(2)
            for sign, body, at in ((1.0, pin.first, pin.at_first), (-1.0, pin.second, pin.at_second)):
                if body == GROUND:
                    gap += sign * np.asarray(at)
                    continue
                r = turned(x[3 * body + 2], at)
                gap += sign * (x[3 * body : 3 * body + 2] + r)
                row[:, 3 * body : 3 * body + 2] += sign * np.eye(2)
                row[:, 3 * body + 2] += sign * np.array([-r[1], r[0]])
                quick += -sign * r * v[3 * body + 2] ** 2
            eta += list(gap)
            psi += list(row)
            gamma += list(quick)
        for slide in self.slides:
            k, normal = 3 * slide.body, np.array([-slide.axis[1], slide.axis[0]])
            across, level = np.zeros(3 * self.n), np.zeros(3 * self.n)
            across[k : k + 2] = normal
            level[k + 2] = 1.0
            eta += [float(normal @ (x[k : k + 2] - slide.through)), x[k + 2]]
            psi += [across, level]
            gamma += [0.0, 0.0]
        return np.array(eta), np.array(psi).reshape(len(eta), 3 * self.n), np.array(gamma)

    def forces(self, t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        f = np.zeros(3 * self.n)
        for k, m in enumerate(self.masses):
            f[3 * k : 3 * k + 2] = m * np.asarray(self.gravity)
        for motor in self.motors:
            angle = x[3 * motor.second + 2] - (x[3 * motor.first + 2] if motor.first != GROUND else 0.0)
            rate = v[3 * motor.second + 2] - (v[3 * motor.first + 2] if motor.first != GROUND else 0.0)
            torque = motor.torque(t, angle, rate)
            f[3 * motor.second + 2] += torque
            if motor.first != GROUND:
                f[3 * motor.first + 2] -= torque
        return f

    def accelerations(self, t: float, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return accelerations and multipliers of M a = f + Psi^T lambda, Psi a + gamma = 0."""
        _, psi, gamma = self.constraints(x, v)
        m = len(psi)
        K = np.block([[self.mass_matrix(), -psi.T], [psi, np.zeros((m, m))]])
        found = np.linalg.lstsq(K, np.concatenate([self.forces(t, x, v), -gamma]), rcond=None)[0]
        return found[: 3 * self.n], found[3 * self.n :]

    def energy(self, x: np.ndarray, v: np.ndarray) -> float:
        """Return kinetic energy and that of gravity."""
        weight = sum(m * np.dot(self.gravity, x[3 * k : 3 * k + 2]) for k, m in enumerate(self.masses))
        return float(0.5 * v @ self.mass_matrix() @ v - weight)

    def impulse(self, x: np.ndarray, v: np.ndarray, locked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the rates after further rows ``locked`` have come to rest at once, and all rows' impulses."""
        _, psi, _ = self.constraints(x, v)
        rows = np.vstack([psi, locked])
        m = len(rows)
        K = np.block([[self.mass_matrix(), -rows.T], [rows, np.zeros((m, m))]])
        found = np.linalg.lstsq(K, np.concatenate([self.mass_matrix() @ v, np.zeros(m)]), rcond=None)[0]
        return found[: 3 * self.n], found[3 * self.n :]

    def closed(self, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x put on the constraints and v on their rates (for states that are nearly so)."""
        for _ in range(20):
            eta, psi, _ = self.constraints(x, v)
            x = x - np.linalg.lstsq(psi, eta, rcond=None)[0]
        _, psi, _ = self.constraints(x, v)
        return x, v - np.linalg.lstsq(psi, psi @ v, rcond=None)[0]

    def run(self, x: np.ndarray, v: np.ndarray, times: np.ndarray, rtol: float = 1e-12) -> Any:
        """Integrate from a consistent state; returns x (T, 3n) and v (T, 3n)."""
        from scipy.integrate import solve_ivp

        n = 3 * self.n

        def rate(t: float, y: np.ndarray) -> np.ndarray:
            return np.concatenate([y[n:], self.accelerations(t, y[:n], y[n:])[0]])

        found = solve_ivp(
            rate, (times[0], times[-1]), np.concatenate([x, v]), method="DOP853", t_eval=times, rtol=rtol,
            atol=1e-13,
        )  # fmt: skip
        assert found.success
        return found.y[:n].T, found.y[n:].T
