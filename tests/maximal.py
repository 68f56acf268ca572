"""Planar mechanisms in maximal coordinates (x, y, angle of each body), by Taylor series: an independent reference.

Constraints and centres of mass are written once, as functions of position and time. Along y + v s + a s^2 / 2 their second
derivative is J a + gamma, of which all is read off. The equations are solved with every multiplier at once, so bodies
without mass are no trouble. The mechanism is read from the plain data of a scene: revolute joints about z, slides along x or
y, closures of type revolute, couplers, springs and dampers in joints, constant torques.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

Array = np.ndarray[Any, np.dtype[np.float64]]


@dataclasses.dataclass
class Series:
    """c0 + c1 s + c2 s^2, each an array with an entry for each acceleration that is tried."""

    c: tuple[Any, Any, Any]

    def __add__(self, other: Any) -> Series:
        o = _series(other).c
        return Series((self.c[0] + o[0], self.c[1] + o[1], self.c[2] + o[2]))

    __radd__ = __add__

    def __neg__(self) -> Series:
        return Series((-self.c[0], -self.c[1], -self.c[2]))

    def __sub__(self, other: Any) -> Series:
        return self + -_series(other)

    def __rsub__(self, other: Any) -> Series:
        return -self + other

    def __mul__(self, other: Any) -> Series:
        a, b = self.c, _series(other).c
        return Series((a[0] * b[0], a[0] * b[1] + a[1] * b[0], a[0] * b[2] + a[1] * b[1] + a[2] * b[0]))

    __rmul__ = __mul__

    def function(self, f: Any, f1: Any, f2: Any) -> Series:
        """Return f of the series, with its derivatives f1 and f2 there."""
        a = self.c
        return Series((f, f1 * a[1], f1 * a[2] + 0.5 * f2 * a[1] * a[1]))


def _series(x: Any) -> Series:
    return x if isinstance(x, Series) else Series((x, 0.0, 0.0))


def sin(x: Series) -> Series:
    s, c = np.sin(x.c[0]), np.cos(x.c[0])
    return x.function(s, c, -s)


def cos(x: Series) -> Series:
    s, c = np.sin(x.c[0]), np.cos(x.c[0])
    return x.function(c, -s, -c)


class Maximal:
    """The mechanism of a scene's data.

    grounds : positions of moving ground points as functions of time, written with ``sin`` and ``cos`` from here.
    """

    def __init__(
        self, scene: dict[str, Any], grounds: dict[str, Callable[[Series], list[Any]]] | None = None
    ):
        robot = scene["robot"]
        self.joints, self.links = robot["joints"], robot["links"]
        self.n = 3 * len(self.links)
        self.names = [link["name"] for link in self.links]
        self.points, self.grounds = robot.get("points", {}), grounds or {}
        self.loops, self.couplers = scene.get("loops", []), scene.get("couplers", [])
        self.gravity = scene.get("gravity", [0, 0, 0])
        self.torques = scene.get("torques", {})

    def parent(self, k: int) -> int:
        name = self.joints[k].get("parent", self.names[k - 1] if k else "base")
        return self.names.index(name) if name != "base" else -1

    # -- functions of position --------------------------------------------------------------------------
    def place(self, y: list[Series], body: int, at: list[float]) -> list[Any]:
        if body < 0:
            return [at[0], at[1]]
        x, z, angle = y[3 * body : 3 * body + 3]
        c, s = cos(angle), sin(angle)
        return [x + c * at[0] - s * at[1], z + s * at[0] + c * at[1]]

    def named(self, y: list[Series], t: Series, name: str) -> list[Any]:
        if name in self.grounds:
            return self.grounds[name](t)
        if name in self.points:
            point = self.points[name]
            return self.place(
                y, self.names.index(point["link"]) if point["link"] != "base" else -1, point["at"]
            )
        return self.place(y, self.names.index(name.partition(".")[0]), [0.0, 0.0])

    def angle(self, y: list[Series], body: int) -> Any:
        return y[3 * body + 2] if body >= 0 else 0.0

    def coordinate(self, y: list[Series], k: int) -> Any:
        """Return the joint's own coordinate, an angle or a length."""
        p, joint = self.parent(k), self.joints[k]
        if joint["type"] == "revolute":
            return self.angle(y, k) - self.angle(y, p)
        dx, dy, u, _ = self._along(y, k)
        return dx * u[0] + dy * u[1]

    def _along(self, y: list[Series], k: int) -> tuple[Any, Any, list[Any], list[Any]]:
        p, joint = self.parent(k), self.joints[k]
        ours, theirs = y[3 * k : 3 * k + 2], self.place(y, p, joint.get("origin", {}).get("xyz", [0, 0, 0]))
        c, s = (cos(self.angle(y, p)), sin(self.angle(y, p))) if p >= 0 else (1.0, 0.0)
        u, n = [c, s], [-s, c]
        if joint["axis"][1]:
            u, n = [-s, c], [-c, -s]
        return ours[0] - theirs[0], ours[1] - theirs[1], u, n

    def rows(self, y: list[Series], t: Series) -> list[Any]:
        found: list[Any] = []
        for k, joint in enumerate(self.joints):
            dx, dy, _, n = self._along(y, k)
            if joint["type"] == "revolute":
                found += [dx, dy]
            else:
                found += [dx * n[0] + dy * n[1], self.angle(y, k) - self.angle(y, self.parent(k))]
        for loop in self.loops:
            one, two = (self.named(y, t, name) for name in loop["between"])
            found += [a - b for a, b in zip(one, two)]
        names = [joint["name"] for joint in self.joints]
        for coupler in self.couplers:
            found.append(sum(c * self.coordinate(y, names.index(j)) for j, c in coupler["terms"].items()))
        return found

    # -- dynamics ---------------------------------------------------------------------------------------
    def accelerations(self, t: float, y: Array, v: Array) -> Array:
        n = self.n
        tried = np.concatenate([np.zeros((1, n)), np.eye(n)])
        path = [Series((y[k], v[k], 0.5 * tried[:, k])) for k in range(n)]
        time = Series((t, 1.0, 0.0))

        def split(x: Any) -> tuple[Array, float]:
            """Return the row J (n,) and gamma of a function."""
            second = 2.0 * np.broadcast_to(np.asarray(_series(x).c[2], dtype=float), n + 1)
            return second[1:] - second[0], float(second[0])

        rows = [split(x) for x in self.rows(path, time)]
        J, gamma = np.array([r for r, _ in rows]), np.array([g for _, g in rows])
        M, f = np.zeros((n, n)), np.zeros(n)
        for k, link in enumerate(self.links):
            mass = link.get("mass", 0.0)
            for x, g in zip(self.place(path, k, link.get("com", [0, 0, 0])), self.gravity):
                Jc, bias = split(x)
                M += mass * np.outer(Jc, Jc)
                f += mass * Jc * (g - bias)
            M[3 * k + 2, 3 * k + 2] += link.get("inertia", {}).get("zz", 0.0)
        for k, joint in enumerate(self.joints):
            own = _series(self.coordinate(path, k))
            Jc, x, rate = split(own)[0], float(np.ravel(own.c[0])[0]), float(np.ravel(own.c[1])[0])
            spring, damper = joint.get("spring", {}), joint.get("damper", {}).get("damping", 0.0)
            force = -spring.get("stiffness", 0.0) * (x - spring.get("rest", 0.0)) - damper * rate
            f += Jc * (force + self.torques.get(joint["name"], 0.0))
        whole = np.block([[M, -J.T], [J, np.zeros((len(J), len(J)))]])
        a: Array = np.linalg.lstsq(whole, np.concatenate([f, -gamma]), rcond=1e-13)[0][:n]
        return a

    def bodies(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """Return y and v of the bodies for the joints' coordinates and rates."""
        y: list[Series] = []
        for k, joint in enumerate(self.joints):
            p, x = self.parent(k), Series((q[k], qd[k], 0.0))
            at = self.place(y, p, joint.get("origin", {}).get("xyz", [0, 0, 0]))
            turn = _series(self.angle(y, p))
            if joint["type"] == "prismatic":
                u = [-sin(turn), cos(turn)] if joint["axis"][1] else [cos(turn), sin(turn)]
                y += [_series(at[0]) + u[0] * x, _series(at[1]) + u[1] * x, turn]
            else:
                y += [_series(at[0]), _series(at[1]), turn + x]
        return np.array([s.c[0] for s in y], dtype=float), np.array([s.c[1] for s in y], dtype=float)

    def joint_accelerations(self, t: float, q: Array, qd: Array) -> Array:
        """Return the second derivatives of the joints' coordinates."""
        y, v = self.bodies(q, qd)
        a = self.accelerations(t, y, v)
        path = [Series(x) for x in zip(y, v, 0.5 * a)]
        return np.array([2.0 * _series(self.coordinate(path, k)).c[2] for k in range(len(self.joints))])

    def motion(self, q: Array, qd: Array, times: Array, rtol: float = 1e-11) -> Array:
        """Return the joints' coordinates at times, from q and qd at the first."""
        y, v = self.bodies(q, qd)

        def rate(t: float, x: Array) -> Array:
            return np.concatenate([x[self.n :], self.accelerations(t, x[: self.n], x[self.n :])])

        span = (times[0], times[-1])
        found = solve_ivp(rate, span, np.concatenate([y, v]), "DOP853", times, rtol=rtol, atol=rtol)
        states = [[Series((x, 0.0, 0.0)) for x in column[: self.n]] for column in found.y.T]
        return np.array(
            [[_series(self.coordinate(y, k)).c[0] for k in range(len(self.joints))] for y in states]
        )
