"""Deployments: mechanisms that run into a dead point of their input or a latch, and when they really do."""

from __future__ import annotations

import dataclasses

import numpy as np

from tests.proof import scenes
from tests.proof.mechanism import Array, Lock, Mechanism
from tests.proof.reference import LockedError, Reference
from tests.proof.scenes import Rng, rounded

DOUBT = 10.0  # times the doubt of the reference: an error of the time below it cannot be told
ROUNDING = 1e-12  # of the time, likewise


def deployments(rng: Rng) -> Mechanism:
    """Return a mechanism whose driven joints unfold it until the passive ones lock, or until a latch closes."""
    if rng.uniform() < 0.6:
        m = scenes.planar_loop(rng)
        chain = len(m.bodies) - 1
        driven = [0] if chain == 2 else [0, chain]
        latched = rng.uniform() < 0.3
    else:
        m = scenes.tree(rng, 3, scenes.SCALAR)
        driven, latched = list(range(len(m.bodies))), True
    m.duration = float(rounded(rng.uniform(0.8, 2.5), 2))
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=rng.uniform() < 0.3)
    if rng.uniform() < 0.5:
        m.torques[0, 0] = scenes.smooth_formula(rng, 0, m.bodies[0].name, 20.0)
    m.torques = {key: formula for key, formula in m.torques.items() if key[0] in driven}
    m.loads.clear()
    passive = [k for k in range(len(m.bodies)) if k not in driven]
    if latched:
        k = int(rng.choice(driven))
        away = float(rounded(rng.uniform(0.05, 0.6) * rng.choice((-1, 1))))
        m.lock = Lock(driven, joint=k, at=round(float(m.q[m.first_q[k]]) + away, 4))
    else:
        m.lock = Lock(driven, passive=passive)
    return m


@dataclasses.dataclass
class LockTruth:
    """When a mechanism locks [s], None where it does not; the doubt about that [s]."""

    time: float | None
    doubt: float = 0.0


def lock_truth(m: Mechanism, q: Array, v: Array, times: Array, tolerances: tuple[float, float]) -> LockTruth:
    """Integrate twice until the lock.

    Raises
    ------
    UndecidedError : the two do not agree whether there is one.
    """
    from tests.proof.reference import UndecidedError

    found: list[float | None] = []
    for tol in tolerances:
        try:
            Reference(m, tol, 1e-2 * tol, 10.0).run(q, v, times)
            found.append(None)
        except LockedError as locked:
            found.append(locked.time)
    tight, loose = found
    if (tight is None) != (loose is None):
        raise UndecidedError("a lock at one tolerance only")
    if tight is None or loose is None:
        return LockTruth(None)
    return LockTruth(tight, 0.2 * abs(tight - loose) + 1e-15 * tight)


def compare(lock: dict[str, float] | None, true: LockTruth) -> tuple[str, float, float]:
    """Return verdict, true error and printed error [s] of a lock's time; ``lock`` from the summary, None without."""
    if true.time is None or lock is None:
        return ("rounding" if true.time is None and lock is None else "silent"), np.nan, np.nan
    off, printed = abs(lock["time"] - true.time), lock["time_error"]
    least = max(DOUBT * true.doubt, ROUNDING * true.time)
    if off <= least:
        return ("high" if printed > 10.0 * least else "rounding"), off, printed
    ratio = printed / off
    return ("low" if ratio < 0.1 else "high" if ratio > 10.0 else "ok"), off, printed
