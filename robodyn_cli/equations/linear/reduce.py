"""From the equations of a whole mechanism to a linear system in minimal coordinates.

The coordinates are steps dq (nv,) along the joints' manifolds. Psi dq = 0 leaves the directions dq = T p, with the
independent ones as p; rates follow from Psi dv + d(Psi v + eta_t)/dq dq = 0: dv = T w + W p. Accelerations alike, and
T^T projects the forces of the loops away, so rows may depend on each other (Kane's and Maggi's equations; Bauchau,
Flexible Multibody Dynamics, 2011, section 11.2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.equations.linear.residuals import Residuals, States, drift
from robodyn_cli.errors import NumericalError
from robodyn_cli.record import record
from robodyn_cli.solve.closure import RANK as SINGULAR
from robodyn_cli.solve.closure import rank_tolerances
from robodyn_cli.solve.load_sharing import constrained
from robodyn_cli.spatial.algebra import Array

RANK = 1e-9  # a singular value this small beside the largest counts as zero
ROUNDING = 32.0 * np.finfo(float).eps  # of the terms of a sum: what the sum may be off by
PREFERRED = 1e-2  # so much worse may a choice of independent coordinates be that keeps those wished for


@record
class Linear:
    """x-dot = A x + B u, x = (p, p-dot) of n freedoms, along T states.

    A (T, 2n, 2n), B (T, 2n, inputs). rounding (T, 2n, 2n) : how far off A's entries may be. places : the velocity
    coordinates that are p. dq (T, nv, n) : T of each state; dv (T, nv, 2n) : rates of all coordinates by x.
    a (T, nv), lam (T, m) : accelerations and multipliers there.
    """

    A: Array
    B: Array
    rounding: Array
    places: tuple[int, ...]
    dq: Array
    dv: Array
    a: Array
    lam: Array


def independent(psi: Array, wished: Sequence[int], tolerance: float = RANK) -> tuple[int, ...]:
    """Return the places of independent coordinates, ``wished`` among them where that is a good choice; psi (m, nv).

    tolerance : ratio of its singular values below which rows depend on each other.
    """
    from scipy.linalg import qr

    nv = psi.shape[1]
    if not len(psi):
        return tuple(range(nv))
    s = np.linalg.svd(psi, compute_uv=False)
    rank = int((s > tolerance * s[0]).sum())
    best = qr(psi, mode="r", pivoting=True)
    taken = list(best[1][:rank])
    others = [k for k in range(nv) if k not in wished]
    if len(others) >= rank:
        again = qr(psi[:, others], mode="r", pivoting=True)
        sizes = [abs(r[0][rank - 1, rank - 1]) if rank else 1.0 for r in (best, again)]
        if sizes[1] > PREFERRED * sizes[0]:
            taken = [others[k] for k in again[1][:rank]]
    return tuple(k for k in range(nv) if k not in taken)


def tangent(psi: Array, places: Sequence[int], time: float) -> tuple[Array, Array]:
    """Return T (nv, n) with Psi T = 0, the identity at ``places``, and D (nv, m): the step D r is Psi's inverse.

    Raises
    ------
    NumericalError : the coordinates at ``places`` do not determine the others.
    """
    nv = psi.shape[1]
    dependent = [k for k in range(nv) if k not in places]
    inverse = np.zeros((nv, len(psi)))
    T = np.zeros((nv, len(places)))
    T[list(places), range(len(places))] = 1.0
    if dependent:
        s = np.linalg.svd(psi[:, dependent], compute_uv=False)
        if not s[-1] > RANK * s[0]:
            raise NumericalError(
                f"at t = {time:.6g} s the loops are singular: they do not determine the dependent coordinates; "
                "linearise at other states"
            )
        inverse[dependent] = np.linalg.pinv(psi[:, dependent], rcond=RANK)
        T -= inverse @ (psi @ T)
    return T, inverse


def held_by(
    equations: Residuals, states: States, inputs: Sequence[int], places: tuple[int, ...]
) -> tuple[States, Array]:
    """Return a state at rest with the torques of the inputs that hold it best, and the load (f,) that is left along
    the independent coordinates at ``places``."""
    values = equations.values(states)
    T, _ = tangent(values["Psi"][0], places, 0.0)
    load = T.T @ values["load"][0]
    torques = np.linalg.lstsq(T.T[:, list(inputs)], load, rcond=None)[0]
    tau = states.tau.copy()
    tau[0, list(inputs)] = torques
    left = load - T.T[:, list(inputs)] @ torques
    return States(states.times, states.q, states.v, None, tau), left


def accelerations(
    values: Mapping[str, Array], tau: Array, tolerance: Array | float = SINGULAR
) -> tuple[Array, Array]:
    """Return what torques tau (T, nv) cause, from ``Residuals.values``: a (T, nv) and multipliers (T, m).

    tolerance : see ``constrained``.
    """
    force, gap = (tau - values["load"])[:, :, None], -values["gamma"][:, :, None]
    a, lam = constrained(values["M"], values["Psi"], force, gap, tolerance)
    return a[:, :, 0], lam[:, :, 0]


def multipliers(values: Mapping[str, Array], a: Array, tau: Array, tolerance: float = RANK) -> Array:
    """Return the multipliers (T, m) of least norm of a motion with accelerations a and torques tau (T, nv)."""
    needed = values["M"] @ a[:, :, None] + (values["load"] - tau)[:, :, None]
    lam: Array = np.linalg.pinv(np.swapaxes(values["Psi"], 1, 2), rcond=tolerance) @ needed
    return lam[:, :, 0]


def tolerance_at(equations: Residuals, states: States, exact: float = SINGULAR) -> float:
    """Return the ratio of singular values below which rows depend on each other at the first state."""
    problem = equations.problem
    eta = problem.numbers(
        [row.eta for row in problem.constraints.loop_rows], states.q[0], float(states.times[0])
    )
    return float(rank_tolerances(problem.model, np.abs(eta).max(initial=0.0), exact))


def linearise_states(
    equations: Residuals, states: States, inputs: Sequence[int], places: tuple[int, ...]
) -> Linear:
    """Return the linear systems at states; ``inputs`` : velocity coordinates with a torque as input.

    M (T p-ddot + c) + r_q dq + r_v dv = S u for T^T of it, with c from the constraints' second rates.
    """
    nv, n = equations.problem.model.nv, len(places)
    values = equations.values(states)
    if states.a is None:
        a, lam = accelerations(values, states.tau, tolerance_at(equations, states))
    else:
        a = states.a
        lam = multipliers(values, a, states.tau, tolerance_at(equations, states, RANK))
    slopes = equations.derivatives(states, a, lam)
    A, B = np.zeros((len(states), 2 * n, 2 * n)), np.zeros((len(states), 2 * n, len(inputs)))
    rounding = np.zeros_like(A)
    dq, dv = np.zeros((len(states), nv, n)), np.zeros((len(states), nv, 2 * n))
    for k, time in enumerate(states.times):
        T, inverse = tangent(values["Psi"][k], places, float(time))
        here = {name: x[k] for name, x in slopes.items()} | {"M": values["M"][k], "K": drift(slopes, k, nv)}
        dq[k], dv[k] = T, np.concatenate([-inverse @ here["w_q"] @ T, T], axis=1)
        reduced = T.T @ here["M"] @ T
        rates, forces = _parts(here, T, dv[k], inverse)
        A[k, :n] = rates[list(places)]
        A[k, n:] = -np.linalg.solve(reduced, T.T @ forces)
        B[k, n:] = np.linalg.solve(reduced, T.T[:, list(inputs)])
        sizes = {name: np.abs(x) for name, x in here.items()}
        rates, forces = _parts(sizes, abs(T), abs(dv[k]), -abs(inverse))
        rounding[k, :n, :n] = ROUNDING * rates[list(places), :n]
        terms = abs(T.T) @ forces + abs(reduced) @ abs(A[k, n:])
        rounding[k, n:] = ROUNDING * abs(np.linalg.inv(reduced)) @ terms
    return Linear(A, B, rounding, places, dq, dv, a, lam)


def _parts(here: Mapping[str, Array], T: Array, dv: Array, inverse: Array) -> tuple[Array, Array]:
    """Return the rates of steps, dv + K dq, and the forces r_q dq + r_v dv + M c, both (nv, 2n) by x.

    Of magnitudes, with -|D| for D, these are the sums of the magnitudes of all terms, which rounding is a part of.
    """
    step = np.concatenate([T, np.zeros_like(T)], axis=1)
    second = -inverse @ (here["g_q"] @ step + here["g_v"] @ dv)
    return dv + here["K"] @ step, here["r_q"] @ step + here["r_v"] @ dv + here["M"] @ second
