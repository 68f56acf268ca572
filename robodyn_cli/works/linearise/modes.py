"""Poles of a linear system, its modes, what its inputs reach and its outputs show."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.control.lqr import reached
from robodyn_cli.equations.linear.reduce import Linear
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.linear import Mode

TRIALS = 8  # disturbed systems that tell how far rounding moves the poles
SAFETY = 4.0
PARALLEL = 1e-6  # so little may the motions of a mode at 0 differ: its position and its rate have a pole each
BLIND = 1e-8  # a mode this weakly reached or shown, relative, is not reached or shown at all
POINTS = 400  # of a frequency response
BEYOND = 10.0  # how far it goes beyond the slowest and the fastest pole


def pole_errors(A: Array, rounding: Array, poles: Array) -> Array:
    """Return how far poles (n,) of A may move where its entries change by no more than ``rounding`` (n, n) [1/s].

    The farthest that disturbed systems have none nearer, with the rounding of the eigenvalue solver. That of a multiple
    pole goes with a root of the disturbance, which no derivative would tell.
    """
    from scipy.linalg import matrix_balance

    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    reach = rounding / scale[:, None] * scale + np.finfo(float).eps * np.abs(balanced).max(initial=0.0)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (TRIALS, *A.shape))
    moved = np.linalg.eigvals(balanced + signs * reach)
    gaps = np.abs(poles[:, None] - moved[:, None, :]).min(axis=2, initial=np.inf)
    found: Array = SAFETY * gaps.max(axis=0, initial=0.0)
    return found


def without_rounding(poles: Array, errors: Array) -> Array:
    """Return poles with those parts 0 that are no larger than the error of the pole."""
    real, imaginary = (np.where(np.abs(part) > errors, part, 0.0) for part in (poles.real, poles.imag))
    return real + 1j * imaginary


def poles_along(linear: Linear) -> tuple[Array, Array]:
    """Return the poles (T, 2n) of linear systems, from left to right, and their errors (T, 2n) [1/s]."""
    raw = np.linalg.eigvals(linear.A)
    errors = np.array([pole_errors(*each) for each in zip(linear.A, linear.rounding, raw)]).reshape(raw.shape)
    poles = without_rounding(raw, errors)
    order = np.lexsort((poles.imag, poles.real), axis=-1)
    return np.take_along_axis(poles, order, axis=-1), np.take_along_axis(errors, order, axis=-1)


def modes_of(linear: Linear, sample: int, C: Array, names: Sequence[str]) -> list[Mode]:
    """Return the modes of the system at a sample, slowest first; C (outputs, 2n), names : of all coordinates.

    A free motion, of position and rate, is one mode at 0, of multiplicity 2.
    """
    A, B, dq = linear.A[sample], linear.B[sample], linear.dq[sample]
    raw, vectors = np.linalg.eig(A)
    errors = pole_errors(A, linear.rounding[sample], raw)
    poles = without_rounding(raw, errors)
    found: list[Mode] = []
    free: list[tuple[int, Array]] = []  # modes at 0 by their place among those found
    for k in sorted(range(len(poles)), key=lambda k: (abs(poles[k]), poles[k].real)):
        s, motion = complex(poles[k]), dq @ vectors[: dq.shape[1], k]
        if s.imag < 0.0:
            continue
        if not s:
            same = next((place for place, other in free if _parallel(motion, other)), None)
            if same is not None:
                found[same] = dataclasses.replace(found[same], multiplicity=found[same].multiplicity + 1)
                continue
            free.append((len(found), motion))
        size = abs(s)
        found.append(
            Mode(
                s.real, s.imag, float(errors[k]), 1, size / math.tau, 0.0 - s.real / size if size else None,
                1.0 / abs(s.real) if abs(s.real) > BLIND * size else None,
                _shape(motion, names), reached(A, B, s, BLIND), reached(A.T, C.T, s, BLIND),
            )
        )  # fmt: skip
    return found


def _parallel(a: Array, b: Array) -> bool:
    """Tell whether two motions are the same but for their size."""
    sizes = float(np.linalg.norm(a) * np.linalg.norm(b))
    return bool(abs(np.vdot(a, b)) >= (1.0 - PARALLEL) * sizes)


def _shape(motion: Array, names: Sequence[str]) -> dict[str, list[float]]:
    """Return amplitude and phase of each coordinate, relative to the largest."""
    if not len(motion):
        return {}
    k = int(np.argmax(np.abs(motion)))
    relative = motion / motion[k] if motion[k] else motion
    return {name: [float(abs(x)), float(np.angle(x))] for name, x in zip(names, relative)}


def stability_of(modes: Sequence[Mode]) -> str:
    """Return ``stable``, ``unstable``, or ``marginal``: some modes neither decay nor grow."""
    if any(m.real > 0.0 for m in modes):
        return "unstable"
    return "stable" if all(m.real < 0.0 for m in modes) else "marginal"


def frequencies_for(modes: Sequence[Mode]) -> Array:
    """Return angular frequencies (F,) [rad/s] that show what the modes do."""
    sizes = [math.tau * m.frequency for m in modes if m.frequency > 0.0] or [1.0]
    return np.geomspace(min(sizes) / BEYOND, max(sizes) * BEYOND, POINTS)


def response(A: Array, B: Array, C: Array, D: Array, frequencies: Array) -> Array:
    """Return C (j w E - A)^-1 B + D (F, outputs, inputs) at angular frequencies (F,) [rad/s]."""
    left = 1j * frequencies[:, None, None] * np.eye(len(A)) - A
    found: Array = C @ np.linalg.solve(left, np.broadcast_to(B, (len(frequencies), *B.shape))) + D
    return found
