"""The Riccati equations of the linear quadratic regulator, continuous and sampled, and their costs."""

from __future__ import annotations

import numpy as np

from robodyn_cli.control.lqr import costless_mode, unreachable_mode
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

TRIALS = 4  # disturbed systems that tell how far rounding moves a gain
SAFETY = 4.0
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


def optimum(A: Array, B: Array, cost: Cost, period: float | None) -> BestRegulator:
    """Return the regulator of a system and a cost, in the form that the period asks for (Anderson and Moore 1990).

    Raises
    ------
    ValueError : in words: some mode that does not decay cannot be reached by the torques, one that stays costs nothing,
    or there is no solution.
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
    try:
        return _solved(A, B, cost, period)
    except np.linalg.LinAlgError as error:
        raise ValueError(
            f"the Riccati equation has no solution that stabilises: {error} (a mode that costs nothing and does not "
            "decay needs a weight)"
        ) from error


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
