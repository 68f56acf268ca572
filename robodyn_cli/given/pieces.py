"""A given motion as polynomials of time from each jump of its accelerations to the next, which a table can give again.

Accelerations are interpolated, not positions: their error is that of the polynomial alone, however short a piece is.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.given.along import MotionAlong
from robodyn_cli.given.motion import by_columns
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.trajectories.course import Course, divided
from robodyn_cli.trajectories.given import power_column
from robodyn_cli.trajectories.led import position_columns

NODES = 0.5 - 0.5 * np.cos(np.pi * (np.arange(4) + 0.5) / 4)  # of a piece, in which accelerations are taken
BETWEEN = np.array([0.01, 0.25, 0.5, 0.75, 0.99])  # and where they are compared
ACCELERATION = 1e-8  # of the largest one of any joint: how far accelerations may be from the motion's
MEET = 1e-11  # rad or m, and of the largest speed: how well pieces meet
PARTS = 4  # into which a piece is divided at once
SHORT = 1e-7  # of the duration: pieces are not divided further
MOST = 20_000  # pieces


def add_pieces(result: Result, problem: Problem) -> None:
    """Add the polynomials of the scene's motion, as the columns and rows of a table."""
    columns, course = pieces_of(problem)
    powers = range(len(course.c))
    end = [
        course(course.knots[-1:], i)[0] / max(1.0, i) for i in range(3)
    ]  # q, qd, qdd/2 where the motion ends
    last = np.zeros((len(powers), 1, len(columns)))
    last[: len(end), 0] = end[: len(powers)]
    c = np.concatenate([course.c, last], axis=1)
    rows = np.column_stack([course.knots, *(c[i, :, k] for k in range(len(columns)) for i in powers)])
    names = ["t", *(power_column(name, i) for name in columns for i in powers)]
    units = dict(zip(problem.model.q_names, problem.model.q_units))
    own = [units[name] + (f"/s^{i}" if i > 1 else "/s" * i) for name in columns for i in powers]
    result.add("pieces", rows, names=names, column_units=("s", *own))


def pieces_of(problem: Problem) -> tuple[tuple[str, ...], Course]:
    """Return the columns of q that the scene's trajectory gives, and their polynomials of degree 5.

    Accelerations are within 1e-8 of the largest one, positions within 1e-11 rad or m.
    """
    trajectory, model = problem.scene.trajectory, problem.model
    led = isinstance(trajectory, TaskSpaceTrajectory)
    columns = tuple(model.q_names) if led else position_columns(trajectory.joints)
    places = [model.q_names.index(name) for name in columns]

    along = MotionAlong(problem)

    def motion(times: Array) -> tuple[Array, Array, Array]:
        q, v, a = by_columns(model, along(times))
        return q[:, places], v[:, places], a[:, places]

    T = float(trajectory.duration)
    t = np.unique([0.0, T, *(x for x in trajectory.knots or () if 0.0 < x < T)])
    while True:
        h = np.diff(t)
        inside = np.sort(np.concatenate([NODES, BETWEEN]))
        times = np.append(np.column_stack([t[:-1], t[:-1, None] + h[:, None] * inside]).ravel(), T)
        q, v, a = motion(times)
        first = np.arange(len(h)) * (len(inside) + 1)
        within = (first[:, None] + 1 + np.searchsorted(inside, NODES)).ravel()
        course = _through(t, q[first], v[first], a[within].reshape(len(h), len(NODES), -1))
        need = _need(course, times, (q, v, a), len(inside) + 1)
        if need.max() <= 1.0 or len(t) > MOST or h[need > 1.0].max() <= SHORT * T:
            return columns, course
        t = divided(t, np.where(h > SHORT * T, np.clip(np.ceil(need), 1.0, PARTS), 1.0))


def _through(t: Array, q: Array, v: Array, a: Array) -> Course:
    """Return the polynomials that begin at q, v (K, n) and have the accelerations a (K, 4, n) at the ``NODES``."""
    bend = np.einsum("ij,kjn->ikn", np.linalg.inv(np.vander(NODES, increasing=True)), a)
    i = np.arange(len(NODES))[:, None, None]
    c = bend / ((i + 1) * (i + 2)) / np.diff(t)[None, :, None] ** i
    return Course(t, np.concatenate([q[None], v[None], c]))


def _need(course: Course, times: Array, motion: tuple[Array, Array, Array], per_piece: int) -> Array:
    """Return into how many parts each piece (K,) would be divided to be as close to the motion as it is to be."""
    K = len(course.knots) - 1
    piece = np.arange(len(times) - 1) // per_piece
    since = (times[:-1] - course.knots[piece])[:, None]
    bend = sum(i * (i - 1) * course.c[i][piece] * since ** (i - 2) for i in range(2, len(course.c)))
    q, v, a = motion
    # of all joints: what one that stands still has is rounding
    quick, fast = (max(float(np.abs(x).max()), 1e-300) for x in (a, v))
    off = np.abs(bend - a[:-1]) / (ACCELERATION * quick)
    off[::per_piece] = 0.0  # where pieces meet the acceleration may jump
    rough = off.reshape(K, per_piece, -1).max(axis=(1, 2))
    h = np.diff(course.knots)[:, None]
    ends = [sum(f * course.c[i] * h ** (i - o) for i, f in factors) for o, factors in enumerate(_FACTORS)]
    after = np.append(np.arange(1, K) * per_piece, len(times) - 1)
    gap = np.maximum(np.abs(ends[0] - q[after]) / MEET, np.abs(ends[1] - v[after]) / (1e2 * MEET * fast))
    return np.asarray(np.maximum(rough**0.25, gap.max(axis=1) ** 0.2))


_FACTORS = ([(i, 1) for i in range(6)], [(i, i) for i in range(1, 6)])  # of positions and rates by power
