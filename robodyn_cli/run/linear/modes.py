"""Poles of a linear system, its modes, what its inputs reach and its outputs show."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.control.reachable import reached
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

ZERO = 1e-7  # a pole this small beside the largest is rounding: a double pole at 0 is known to its root
ROUNDING = 1e-12  # part of a pole this small beside the largest pole
BLIND = 1e-8  # a mode this weakly reached or shown, relative, is not reached or shown at all
POINTS = 400  # of a frequency response
BEYOND = 10.0  # how far it goes beyond the slowest and the fastest pole


@record
class Mode:
    """A pole s of x-dot = A x, with its mode; a pair of complex poles is one mode, with the one above the real axis.

    real, imaginary : of s [1/s]. frequency : |s| / 2 pi [Hz], of an undamped oscillation. damping : -Re s / |s|, 1 of a
    decay without oscillation; None at 0. time : 1 / |Re s|, in which it decays or grows e times [s]; None without.
    shape : by coordinate of the mechanism, amplitude and phase [rad], the largest amplitude 1. reached, shown : whether
    the inputs reach it, and the outputs show it.
    """

    real: float
    imaginary: float
    frequency: float
    damping: float | None
    time: float | None
    shape: dict[str, list[float]]
    reached: bool
    shown: bool


def modes_of(A: Array, B: Array, C: Array, dq: Array, names: Sequence[str]) -> list[Mode]:
    """Return the modes, slowest first; dq (nv, n) : all coordinates, with ``names``, by the independent ones."""
    poles, vectors = np.linalg.eig(A) if len(A) else (np.zeros(0, dtype=complex), np.zeros((0, 0)))
    largest = float(np.abs(poles).max(initial=0.0))
    found = []
    for k in sorted(range(len(poles)), key=lambda k: (abs(poles[k]), poles[k].real)):
        s = complex(poles[k])
        s = complex(*(x if abs(x) > ROUNDING * largest else 0.0 for x in (s.real, s.imag)))
        if abs(s) <= ZERO * largest:
            s = 0j
        if s.imag < 0.0:
            continue
        shape = _shape(dq @ vectors[: dq.shape[1], k], names)
        size = abs(s)
        found.append(
            Mode(
                s.real, s.imag, size / math.tau, 0.0 - s.real / size if size else None,
                1.0 / abs(s.real) if abs(s.real) > BLIND * size else None,
                shape, reached(A, B, s, BLIND), reached(A.T, C.T, s, BLIND),
            )
        )  # fmt: skip
    return found


def _shape(motion: Array, names: Sequence[str]) -> dict[str, list[float]]:
    """Return amplitude and phase of each coordinate, relative to the largest."""
    if not len(motion):
        return {}
    k = int(np.argmax(np.abs(motion)))
    relative = motion / motion[k] if motion[k] else motion
    return {name: [float(abs(x)), float(np.angle(x))] for name, x in zip(names, relative)}


def stability_of(modes: Sequence[Mode]) -> str:
    """Return ``stable``, ``unstable``, or ``marginal``: some modes neither decay nor grow."""
    size = max((math.hypot(m.real, m.imaginary) for m in modes), default=0.0)
    largest = max((m.real for m in modes), default=0.0)
    if largest > ZERO * size:
        return "unstable"
    return "stable" if largest < -ZERO * size else "marginal"


def frequencies_for(modes: Sequence[Mode]) -> Array:
    """Return angular frequencies (F,) [rad/s] that show what the modes do."""
    sizes = [math.tau * m.frequency for m in modes if m.frequency > 0.0] or [1.0]
    return np.geomspace(min(sizes) / BEYOND, max(sizes) * BEYOND, POINTS)


def response(A: Array, B: Array, C: Array, D: Array, frequencies: Array) -> Array:
    """Return C (j w E - A)^-1 B + D (F, outputs, inputs) at angular frequencies (F,) [rad/s]."""
    left = 1j * frequencies[:, None, None] * np.eye(len(A)) - A
    found: Array = C @ np.linalg.solve(left, np.broadcast_to(B, (len(frequencies), *B.shape))) + D
    return found
