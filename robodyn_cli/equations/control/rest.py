"""Where the states of a law rest while its mechanism stands at a pose."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.equations.control.control import NOISE, STATES, Control
from robodyn_cli.equations.linear.residuals import States, by_symbols, evaluated
from robodyn_cli.expr.graph import Expr
from robodyn_cli.spatial.algebra import Array

ROUNDS = 100  # of Newton's method
HALVES = 30  # of one of its steps
SHORTER = 0.9  # so much less drift is worth more torque that is left
DONE = 1e-15  # a step this small, relative, is the last
FREE = 1e-10  # of the largest singular value: along such states nothing drifts


def drifts(control: Control) -> list[Any]:
    """Return by how much the law's own states change: their rates, or what a sample adds."""
    after = control._law.states
    return list(after) if control.period is None else [x - s for x, s in zip(after, control.z)]


def resting(control: Control, states: States, needed: Array, ways: Array) -> Array:
    """Return the states (nc,) of a controller whose mechanism rests at q: what was measured last is what is there, and
    those of the law are where they stay.

    By Newton's method with steps of least norm; along what that leaves free (integrators) its torques go to those
    that are needed, as far as they can. needed : torques (n,) of the driven joints that hold the pose. ways (n, f) :
    their motions by the freedoms.
    """
    z = control.starts
    if control.last:
        z[control.last] = states.q[0]
    # what never changes stays where it starts: an integral without a gain
    own = [k for k, drift in enumerate(drifts(control)) if isinstance(drift, Expr)]
    if not own:
        return z
    symbols, asked = [control.z[k] for k in own], control._law.asked
    drift = [drifts(control)[k] for k in own]
    outputs = {"r": drift, "u": asked, "r_s": by_symbols(drift, symbols), "u_s": by_symbols(asked, symbols)}

    def at(s: Array) -> dict[str, Array]:
        z[own] = s
        return {name: x[0] for name, x in evaluated(outputs, situation(control, states, z)).items()}

    def sizes(found: dict[str, Array]) -> tuple[float, float]:
        return float(np.linalg.norm(found["r"])), float(np.linalg.norm(ways.T @ (needed - found["u"])))

    s = z[own].copy()
    found = at(s)
    for _ in range(ROUNDS):
        step = _step(found, needed, ways)
        if not np.isfinite(step).all() or np.abs(step).max() <= DONE * (1.0 + np.abs(s).max()):
            break
        before = sizes(found)
        for _ in range(HALVES):
            after = at(s + step)
            if _nearer(before, sizes(after), s):
                break
            step = 0.5 * step
        else:
            break
        s, found = s + step, after
    z[own] = s
    return z


def _nearer(before: tuple[float, float], after: tuple[float, float], s: Array) -> bool:
    """Tell whether a step is one towards rest, or at rest one towards the torques that hold; each (drift, lack)."""
    rounding = DONE * (1.0 + float(np.abs(s).max()))
    if after[0] <= rounding or after[0] < SHORTER * before[0]:
        return before[0] > rounding or after[1] <= before[1]
    return after[0] <= before[0] and after[1] < before[1]


def _step(found: dict[str, Array], needed: Array, ways: Array) -> Array:
    """Return the step of least norm to where nothing drifts, and along what is free to where the torques hold."""
    left, sizes, right = np.linalg.svd(found["r_s"])
    count = int((sizes > FREE * max(float(sizes[0]), 1e-300)).sum())
    step: Array = -right[:count].T @ ((left.T @ found["r"])[:count] / sizes[:count])
    free = right[count:].T
    lack = ways.T @ (needed - found["u"] - found["u_s"] @ step)
    step = step + free @ np.linalg.lstsq(ways.T @ found["u_s"] @ free, lack, rcond=FREE)[0]
    return step


def situation(control: Control, states: States, z: Array) -> dict[str, Array]:
    """Return the values of the symbols of a law by group: of a state, with states z (nc,) of the controller."""
    model = control.problem.model
    p = np.zeros((1, 8 * model.nv + len(model.parameters)))
    return {**states.groups, STATES: z[None], NOISE: np.zeros((1, 1)), "p": p}
