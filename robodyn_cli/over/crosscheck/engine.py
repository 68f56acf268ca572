"""What another engine has to answer, and the equations of motion from its answers.

Arrays are in our order of coordinates, and in our coordinates: quaternions scalar first, velocities of ball joints and
free bodies in the body's axes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.model.model import BASE, Body, FixedFrame, Loop, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

MISSING = "{} is not installed, which --with {} needs: pip install 'robodyn[oracle]'"


@record
class PeerPlace:
    """A frame of the engine, all in base axes.

    p (3,) : position. R (3, 3) : axes. J (6, nv) : Jacobian, angular rows first. a (6,) : acceleration with v-dot = 0.
    w (3,) : angular velocity.
    """

    p: Array
    R: Array
    J: Array
    a: Array
    w: Array


class PeerEngine(ABC):
    """A mechanism in another engine.

    name, version : of the engine. size : nv. q_places, v_places : of its coordinates among ours.
    """

    name: str
    version: str

    def __init__(self, model: Model) -> None:
        self.size = model.nv
        self.q_places, self.v_places = np.zeros(model.nq, dtype=int), np.zeros(model.nv, dtype=int)

    @abstractmethod
    def torques(self, q: Array, v: Array, a: Array) -> Array:
        """Return M a + h (nv,), rotors included."""

    @abstractmethod
    def free_accelerations(self, q: Array, v: Array, tau: Array) -> Array:
        """Return the accelerations (nv,) of the open tree under torques tau (nv,)."""

    @abstractmethod
    def mass_matrix(self, q: Array) -> Array:
        """Return M (nv, nv), rotors included."""

    @abstractmethod
    def place(self, q: Array, v: Array, frame: FixedFrame) -> PeerPlace:
        """Return a frame fixed to a body."""

    def in_our_order(self, x: Array) -> Array:
        """Return an array whose last axis is in the engine's order of velocities in ours."""
        out = np.empty_like(x)
        out[..., self.v_places] = x
        return out

    def accelerations(self, q: Array, v: Array, tau: Array, loops: Sequence[Loop]) -> Array:
        """Return the accelerations (nv,) with closed loops: M a = tau - h + Psi^T lambda, Psi a + gamma = 0.

        M, h, Psi and gamma are the engine's, the solution (of least norm in lambda) is numpy's.
        """
        free = self.free_accelerations(q, v, tau)
        if not loops:
            return free
        rows = [self._rows(loop, q, v) for loop in loops]
        psi = np.concatenate([psi for psi, _ in rows])
        gamma = np.concatenate([gamma for _, gamma in rows])
        spread = np.linalg.solve(self.mass_matrix(q), psi.T)
        lam, *_ = np.linalg.lstsq(psi @ spread, -gamma - psi @ free, rcond=1e-11)
        return np.asarray(free + spread @ lam)

    def _rows(self, loop: Loop, q: Array, v: Array) -> tuple[Array, Array]:
        """Return Psi (m, nv) and gamma (m,) of a closure: equal points, and no turning about some directions."""
        first, second = self.place(q, v, loop.first), self.place(q, v, loop.second)
        J, a = second.J - first.J, second.a - first.a
        psi, gamma = [*J[3:]], [*a[3:]]
        for u in (first.R @ directions(loop)).T:
            psi.append(u @ J[:3])
            gamma.append(u @ a[:3] + np.cross(first.w, u) @ (second.w - first.w))
        return np.array(psi), np.array(gamma)


def directions(loop: Loop) -> Array:
    """Return the directions (3, n), in the axes of the first frame, about which a closure lets nothing turn."""
    kind = loop.element.type
    if kind == "spherical":
        return np.zeros((3, 0))
    if kind == "fixed":
        return np.eye(3)
    axis = np.array(loop.element.axis, dtype=float)
    return np.linalg.svd(axis[None])[2][1:].T


CLOSURES = ("revolute", "spherical", "fixed")


def mass_properties(body: Body) -> tuple[float, Array, Array]:
    """Return mass [kg], centre of mass [m] and inertia about it [kg m^2], body axes."""
    m, h, I = float(body.inertia.m), real(body.inertia.h), real(body.inertia.I)
    if m == 0.0:
        return 0.0, np.zeros(3), I
    c = h / m
    return m, c, I - m * (c @ c * np.eye(3) - np.outer(c, c))


def real(x: Any) -> Array:
    """Return numbers as an array of floats."""
    return np.array(x, dtype=float)


def children(model: Model) -> dict[int, list[int]]:
    """Return the bodies that hang on each body, and on the base."""
    below: dict[int, list[int]] = {k: [] for k in range(BASE, len(model.bodies))}
    for k, body in enumerate(model.bodies):
        below[body.parent].append(k)
    return below


def depth_first(model: Model) -> list[int]:
    """Return the bodies so that each subtree is contiguous."""
    below = children(model)
    order, stack = [], [BASE]
    while stack:
        k = stack.pop()
        order.append(k)
        stack.extend(reversed(below[k]))
    return order[1:]


def refuse_joint(engine: str, body: Body, known: Sequence[str]) -> CapabilityError:
    """Return the error of a joint that an engine has no counterpart for."""
    return CapabilityError(
        f"joint {body.joint_name!r} is {body.joint.type}, which is not built in {engine}; allowed: {', '.join(known)}"
    )
