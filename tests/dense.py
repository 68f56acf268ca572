"""Spatial algebra in dense 6x6 arithmetic, angular rows first (Featherstone 2008, chapter 2)."""

from __future__ import annotations

import numpy as np

from robodyn_cli.spatial.algebra import Transform, Twist, Wrench, vector
from robodyn_cli.spatial.inertia import ArticulatedInertia, RigidInertia
from tests.numeric import real


def tilde(a: np.ndarray) -> np.ndarray:
    """Return the matrix of a x ."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def twist(m: np.ndarray) -> Twist:
    """Return six numbers as a motion vector."""
    return Twist(vector(m[:3].tolist()), vector(m[3:].tolist()))


def wrench(f: np.ndarray) -> Wrench:
    """Return six numbers as a force vector."""
    return Wrench(vector(f[:3].tolist()), vector(f[3:].tolist()))


def motion_transform(X: Transform) -> np.ndarray:
    """Return the 6x6 matrix that takes motions in A coordinates to B coordinates."""
    E, r = real(X.E), real(X.r)
    return np.block([[E, np.zeros((3, 3))], [-E @ tilde(r), E]])


def spatial_inertia(body: RigidInertia) -> np.ndarray:
    """Return the 6x6 matrix of a rigid body's inertia."""
    m, H = float(body.m), tilde(real(body.h))
    return np.block([[real(body.I), H], [H.T, m * np.eye(3)]])


def articulated(inertia: ArticulatedInertia) -> np.ndarray:
    """Return the 6x6 matrix of an articulated inertia."""
    H = real(inertia.H)
    return np.block([[real(inertia.A), H], [H.T, real(inertia.M)]])


def velocity_product(v: np.ndarray) -> np.ndarray:
    """Return the 6x6 matrix of v x, on motions."""
    w, u = tilde(v[:3]), tilde(v[3:])
    return np.block([[w, np.zeros((3, 3))], [u, w]])


def star(v: np.ndarray) -> np.ndarray:
    """Return the 6x6 matrix of v x*, on forces."""
    return -velocity_product(v).T
