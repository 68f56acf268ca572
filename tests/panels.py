"""Planar chains of panels with latches in absolute angles, by numpy and scipy alone: an oracle of ``deploy.latches``.

Panel k turns by phi_k against the ground, hinge k by theta_k = phi_k - phi_(k-1). With A_ij of the masses and lengths

    sum_j A_ij cos(phi_i - phi_j) phi_j'' + A_ij sin(phi_i - phi_j) phi_j'^2 = tau_i - tau_(i+1) + (rho^T lambda)_i

and rho theta'' = 0 for the hinges that are latched. It goes from event to event; a latch that closes takes the rates to
those nearest in the metric of M in which its hinge stands still.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

TOGETHER = 1e-9  # rad, within which other latches close at the same instant


@dataclasses.dataclass
class Panels:
    """mass, com, length, inertia (about the com), stiffness, rest, damping, at, start : by panel (n,).

    couplers : rows (m, n) of theta that keep their value.
    """

    mass: np.ndarray
    com: np.ndarray
    length: np.ndarray
    inertia: np.ndarray
    stiffness: np.ndarray
    rest: np.ndarray
    damping: np.ndarray
    at: np.ndarray
    start: np.ndarray
    couplers: np.ndarray

    @staticmethod
    def random(rng: np.random.Generator, n: int) -> Panels:
        """Return a folded array that springs unfold towards beyond their latches."""
        folded = np.array([-np.pi / 2, *[np.pi * (-1) ** k for k in range(n - 1)]])
        start = folded + rng.uniform(-0.1, 0.1, n)
        return Panels(
            rng.uniform(1, 5, n), rng.uniform(0.3, 0.6, n), rng.uniform(0.8, 1.2, n), rng.uniform(0.1, 0.5, n),
            rng.uniform(0.3, 0.9, n), -np.sign(start) * rng.uniform(0.6, 1.2, n), rng.uniform(0.05, 0.2, n),
            rng.uniform(-0.05, 0.05, n), start, np.zeros((0, n)),
        )  # fmt: skip

    def synchronised(self) -> Panels:
        """Return the array folded flat, with couplers that keep the hinges at the same part of their way."""
        n = len(self.mass)
        start = np.array([-np.pi / 2, *[np.pi * (-1) ** k for k in range(n - 1)]])
        rows = np.zeros((n - 1, n))
        rows[:, 0] = 1.0
        rows[np.arange(n - 1), np.arange(1, n)] = -start[0] / start[1:]
        return dataclasses.replace(self, start=start, at=np.zeros(n), couplers=rows)

    def scene(self, **simulate: Any) -> dict[str, Any]:
        """Return the same as a scene."""
        n = len(self.mass)
        joints: list[dict[str, Any]] = []
        for k in range(n):
            joints.append({
                "name": f"hinge{k}", "type": "revolute", "axis": [0, 0, 1], "damper": {"damping": float(self.damping[k])},
                "spring": {"stiffness": float(self.stiffness[k]), "rest": float(self.rest[k])},
            })  # fmt: skip
            if k:
                joints[k]["origin"] = {"xyz": [float(self.length[k - 1]), 0, 0]}
        links = [
            {"name": f"panel{k}", "mass": float(self.mass[k]), "com": [float(self.com[k]), 0, 0],
             "inertia": {"zz": float(self.inertia[k])}}
            for k in range(n)
        ]  # fmt: skip
        couplers = [
            {"name": f"sync{i}", "terms": {f"hinge{k}": float(x) for k, x in enumerate(row) if x},
             "value": float(row @ self.start)}
            for i, row in enumerate(self.couplers)
        ]  # fmt: skip
        return {
            "schema": 1, "command": "deploy", "gravity": [0, 0, 0], "robot": {"joints": joints, "links": links},
            "couplers": couplers,
            "initial": {"q": {f"hinge{k}": float(x) for k, x in enumerate(self.start)}},
            "simulate": {"duration": 200, "samples": 101, **simulate},
            "deploy": {"latches": [
                {"name": f"latch{k}", "joint": f"hinge{k}", "at": float(x)} for k, x in enumerate(self.at)
            ]},
        }  # fmt: skip

    # -- the dynamics ---------------------------------------------------------------------------------
    @property
    def turns(self) -> np.ndarray:
        """The matrix D of theta = D phi."""
        n = len(self.mass)
        return np.eye(n) - np.eye(n, k=-1)

    def coefficients(self) -> np.ndarray:
        n = len(self.mass)
        A = np.zeros((n, n))
        for body in range(n):
            reach = np.where(np.arange(n) < body, self.length, np.where(np.arange(n) == body, self.com, 0.0))
            A += self.mass[body] * np.outer(reach, reach)
        return A + np.diag(self.inertia)

    def rows(self, latched: list[int]) -> np.ndarray:
        return np.vstack([self.couplers, np.eye(len(self.mass))[latched]]) @ self.turns

    def accelerations(self, phi: np.ndarray, rate: np.ndarray, latched: list[int]) -> np.ndarray:
        apart = phi[:, None] - phi[None, :]
        A, D = self.coefficients(), self.turns
        theta, speed = D @ phi, D @ rate
        tau = -self.stiffness * (theta - self.rest) - self.damping * speed
        force = D.T @ tau - (A * np.sin(apart)) @ rate**2
        return self._kept(A * np.cos(apart), force, self.rows(latched))

    def loads(self, theta: np.ndarray, speed: np.ndarray, latched: list[int]) -> np.ndarray:
        """Return what holds the hinges beside springs and dampers, by Newton and Euler: zero but for latched ones."""
        phi, rate = np.linalg.solve(self.turns, theta), np.linalg.solve(self.turns, speed)
        apart, A = phi[:, None] - phi[None, :], self.coefficients()
        inertia = (A * np.cos(apart)) @ self.accelerations(phi, rate, latched) + (A * np.sin(apart)) @ rate**2
        tau = -self.stiffness * (theta - self.rest) - self.damping * speed
        return np.linalg.solve(self.turns.T, inertia) - tau

    def struck(self, phi: np.ndarray, rate: np.ndarray, latched: list[int]) -> np.ndarray:
        """Return the rates after latches have closed."""
        M = self.coefficients() * np.cos(phi[:, None] - phi[None, :])
        return self._kept(M, M @ rate, self.rows(latched))

    @staticmethod
    def _kept(M: np.ndarray, force: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return x with M x = force + rows^T lambda, rows x = 0, least norm where rows depend on each other."""
        free = np.linalg.solve(M, force)
        spread = np.linalg.solve(M, rows.T)
        lam, *_ = np.linalg.lstsq(rows @ spread, -rows @ free, rcond=1e-10)
        return free + spread @ lam

    def energy(self, phi: np.ndarray, rate: np.ndarray) -> float:
        M = self.coefficients() * np.cos(phi[:, None] - phi[None, :])
        return float(0.5 * rate @ M @ rate)

    def deploy(self, end: float = 200.0) -> list[tuple[int, float, float, float]]:
        """Return the closings in their order: latch, time [s], rate [rad/s] and energy lost [J]."""
        n, D = len(self.mass), self.turns
        phi, rate, t = np.linalg.solve(D, self.start), np.zeros(n), 0.0
        latched: list[int] = []
        closings = []
        while len(latched) < n and t < end:
            open_ = [k for k in range(n) if k not in latched]

            def meets(k: int) -> Any:
                def value(_: float, y: np.ndarray, held: list[int]) -> float:
                    return float((D @ y[:n])[k] - self.at[k])

                value.terminal = True  # type: ignore[attr-defined]
                return value

            run = solve_ivp(
                lambda _, y, held: np.concatenate([y[n:], self.accelerations(y[:n], y[n:], held)]),
                (t, end), np.concatenate([phi, rate]), method="DOP853", rtol=1e-13, atol=1e-14, args=(latched,),
                events=[meets(k) for k in open_],
            )  # fmt: skip
            t, phi, rate = float(run.t[-1]), run.y[:n, -1], run.y[n:, -1]
            if not any(len(times) for times in run.t_events):
                break
            closing = [k for k in open_ if abs((D @ phi)[k] - self.at[k]) < TOGETHER]
            speed = D @ rate
            after = self.struck(phi, rate, [*latched, *closing])
            lost = self.energy(phi, rate) - self.energy(phi, after)
            closings += [(k, t, float(speed[k]), lost) for k in closing]
            latched += closing
            rate = after
        return closings
