"""The Riccati equations of the linear quadratic regulator, continuous and sampled, and their costs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.control.lqr import RANK, SPLIT, costless_mode, hidden, size_of, unreachable_mode
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

TRIALS = 4  # disturbed systems that tell how far rounding moves a gain
SAFETY = 4.0
GROWN, TOO_GROWN = 1e6, 1e12  # times: what grows so much within a period leaves few digits, and none
SHORT, TOO_SHORT = 1e-7, 1e-12  # of the time scale of a system: periods this short leave few digits, and none
ROUNDED = 32.0 * np.finfo(float).eps  # of an entry


@record
class Cost:
    """x^T Q x + 2 x^T N u + u^T R u: its integral over time, or its sum over samples where there is a period."""

    Q: Array
    R: Array
    N: Array


@record
class BestRegulator:
    """u = -K x with the least cost x^T P x, and the closed loop x-dot = L x, or x+ = L x of a sampled one."""

    K: Array
    P: Array
    L: Array


def held(A: Array, B: Array, period: float) -> tuple[Array, Array]:
    """Return F and G of x(T) = F x(0) + G u under an input that is held for a period, by the exponential of
    [A, B; 0, 0] T (Van Loan 1978)."""
    from scipy.linalg import expm

    n, m = B.shape
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = A, B
    step = expm(period * whole)
    return step[:n, :n], step[:n, n:]


def cost_of_period(A: Array, B: Array, cost: Cost, period: float) -> Cost:
    """Return the integral of a cost over a period under a held input, as the cost of a sample (Van Loan 1978).

    With the rates H = [A, B; 0, 0] of (x, u) and the weights W = [Q, N; N^T, R] it is the integral of
    e^(H^T s) W e^(H s), which is E_22^T E_12 of E = exp([-H^T, W; 0, H] T).
    """
    from scipy.linalg import expm

    n, m = B.shape
    size = n + m
    H = np.zeros((size, size))
    H[:n, :n], H[:n, n:] = A, B
    W = np.block([[cost.Q, cost.N], [cost.N.T, cost.R]])
    E = expm(period * np.block([[-H.T, W], [np.zeros_like(H), H]]))
    whole = E[size:, size:].T @ E[:size, size:]
    whole = 0.5 * (whole + whole.T)
    return Cost(whole[:n, :n], whole[n:, n:], whole[:n, n:])


def optimum(A: Array, B: Array, cost: Cost, period: float | None, integral: bool = False) -> BestRegulator:
    """Return the regulator of a system and a cost, in the form that the period asks for (Anderson and Moore 1990).

    integral : whether with a period the integral of the cost is least, not its sum over samples.

    Raises
    ------
    ValueError : in words: some mode that does not decay cannot be reached by the torques, one that stays costs nothing,
    the period hides a mode or is too long or too short for double precision, or there is no solution.
    """
    unreachable = unreachable_mode(A, B)
    if unreachable is not None:
        raise ValueError(
            f"the pair (A, B) cannot be stabilised: the mode {unreachable:.4g} 1/s does not decay, and the driven "
            "joints have no influence on it; allowed: joints that do"
        )
    costless = costless_mode(A, cost.Q)
    if costless is not None:
        raise ValueError(
            f"the mode {costless:.4g} 1/s neither grows nor decays and costs nothing, so it would stay as it is; "
            "allowed: weights `gains.q` and `gains.qd` that see it"
        )
    if period is not None:
        grown = float(np.linalg.eigvals(A).real.max()) * period > math.log(TOO_GROWN)
        if grown or period * size_of(A) < TOO_SHORT:
            raise ValueError(f"the period leaves no regulator: {_of_period(A, period)}")
        _refuse_hiding(A, B, cost, period, integral)
    try:
        own = cost_of_period(A, B, cost, period) if period is not None and integral else cost
        return _solved(A, B, own, period)
    except (np.linalg.LinAlgError, ValueError) as error:
        why = (
            _of_period(A, period)
            or "some mode that does not decay is hardly reached, or costs next to nothing"
        )
        raise ValueError(f"the Riccati equation has no solution that stabilises: {why}") from error


def refuse_unsure(
    A: Array, B: Array, K: Array, period: float | None, apart: Sequence[tuple[Array, Array]]
) -> None:
    """Refuse gains with which rounding decides whether the loop is stable; apart : see ``disturbed``.

    Raises
    ------
    ValueError : so it is, with the reason in words.
    """
    for a, b in [(A, B), *apart]:
        if period is None:
            stable = np.linalg.eigvals(a - b @ K).real.max() < 0.0
        else:
            F, G = held(a, b, period)
            stable = np.abs(np.linalg.eigvals(F - G @ K)).max() < 1.0
        if not stable:
            why = _of_period(A, period) or "some mode is hardly reached, or costs next to nothing"
            raise ValueError(f"rounding decides whether the loop of the best gains is stable: {why}")


def _refuse_hiding(A: Array, B: Array, cost: Cost, period: float, integral: bool) -> None:
    """Refuse periods after which several modes look like one, so that held torques do not reach, or samples do not
    show, what moves (Kalman, Ho and Narendra 1963)."""
    modes = np.linalg.eigvals(A)
    if modes.real.max() * period > math.log(GROWN):
        return  # nothing can be told of ranks there
    F, G = held(A, B, period)
    near = SPLIT * size_of(A)
    kept = [s for s in modes if s.real >= -near and s.imag > near]
    for s in kept:
        z = [complex(np.exp((1j * s.imag + (s.real if s.real > near else 0.0)) * period))]
        turns = s.imag * period / math.tau
        words = f"after a period of {period:g} s the mode {s:.4g} 1/s, {turns:.4g} turns on, "
        if hidden(F, G, z, RANK) is not None:
            raise ValueError(
                f"{words}is not reached by torques that are held; allowed: another control.period"
            )
        if not integral and s.real <= near and hidden(F.T, cost.Q, z, RANK) is not None:
            raise ValueError(
                f"{words}costs nothing at the samples; allowed: another control.period, other weights, or "
                "control.cost: integral"
            )


def _of_period(A: Array, period: float | None) -> str:
    """Return in words why a period leaves double precision nothing to tell gains by; nothing where it does."""
    if period is None:
        return ""
    fastest = max(np.linalg.eigvals(A), key=lambda s: float(s.real))
    growth = float(fastest.real) * period
    if growth > math.log(GROWN):
        return (
            f"within a period of {period:g} s the mode {fastest:.4g} 1/s grows by a factor of "
            f"10^{growth / math.log(10.0):.0f}, of which rounding leaves nothing that the torques could undo; allowed: "
            f"a shorter control.period (it grows tenfold in {math.log(10.0) / fastest.real:.2g} s)"
        )
    if period * size_of(A) < SHORT:
        return (
            f"within a period of {period:g} s nothing moves by more than rounding; allowed: a longer control.period, "
            "or none, for a law that acts at every instant"
        )
    return ""


def _solved(A: Array, B: Array, cost: Cost, period: float | None) -> BestRegulator:
    from scipy.linalg import solve_continuous_are, solve_discrete_are

    across = {"s": cost.N} if cost.N.any() else {}
    if period is None:
        P = solve_continuous_are(A, B, cost.Q, cost.R, **across)
        K = np.linalg.solve(cost.R, B.T @ P + cost.N.T)
        return BestRegulator(K, P, A - B @ K)
    F, G = held(A, B, period)
    P = solve_discrete_are(F, G, cost.Q, cost.R, **across)
    K = np.linalg.solve(cost.R + G.T @ P @ G, G.T @ P @ F + cost.N.T)
    return BestRegulator(K, P, F - G @ K)


def disturbed(A: Array, B: Array, rounding: Array) -> list[tuple[Array, Array]]:
    """Return systems whose entries are off by as much as rounding may put them: A by ``rounding`` (n, n)."""
    random = np.random.default_rng(0)
    return [
        (
            A + rounding * random.choice([-1.0, 1.0], A.shape),
            B * (1.0 + ROUNDED * random.choice([-1.0, 1.0], B.shape)),
        )
        for _ in range(TRIALS)
    ]


def optimum_errors(best: BestRegulator, others: list[BestRegulator]) -> BestRegulator:
    """Return the errors of K, P and L: how far those of disturbed systems are apart, with a margin, and rounding."""

    def error(name: str) -> Array:
        own = getattr(best, name)
        apart = np.max([np.abs(getattr(other, name) - own) for other in others], axis=0)
        found: Array = SAFETY * apart + ROUNDED * np.abs(own)
        return found

    return BestRegulator(error("K"), error("P"), error("L"))
