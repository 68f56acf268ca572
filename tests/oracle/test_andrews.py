"""Andrews' squeezer mechanism against the Test Set for IVP Solvers (andrews.f).

Of the 16 digits published, an independent recomputation in quadruple precision confirms 7e-11 (relative) in beta,
3e-8 in the rates, 1e-6 in accelerations and multipliers; no comparison can be closer than that.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from robodyn_cli import load_scene, simulate
from robodyn_cli.results.result import Result

SCENE = Path(__file__).parents[2] / "configs" / "benchmarks" / "andrews.yaml"
# beta, Theta, gamma, Phi, delta, Omega, epsilon at 0.03 s, their rates and accelerations
Q = (15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948, 0.5244099658805304,
     0.5347301163226948, 1.048080741042263)  # fmt: skip
V = (1139.920302151208, -1424.379294994111, 11.03291221937134, 19.29337464421385, 0.5735699284790808,
     -19.29337464421385, 0.3231791658026955)  # fmt: skip
A = (-24631.76316945196, 51850.37701610329, 324102.5686413781, 566749.3645176213, 16743.62929479361,
     -566749.3645176222, 9826.520791458422)  # fmt: skip
LAMBDA = (199.1753333731910, -29.75531228015052, 23.06654119098399, 31.45271365475927, 22.64249232082739,
          11.61740700019673)  # fmt: skip


@lru_cache
def result() -> Result:
    return simulate(load_scene(SCENE))


def test_consistent_start() -> None:
    found = result()
    start = [14222.4439199541, -10666.83293996559, 0, 0, 0, 0, 0]
    np.testing.assert_allclose(found["qdd"][0], start, rtol=1e-12, atol=1e-8)
    # published multipliers stand on the other side of the equation: M qdd + G^T lambda = f
    expected = [-98.5668703962410896, 6.12268834425566265, 0, 0, 0, 0]
    np.testing.assert_allclose(found["constraints/multipliers"][0], expected, rtol=1e-12, atol=1e-10)


def test_end() -> None:
    found = result()
    np.testing.assert_allclose(found["q"][-1], Q, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(found["qd"][-1], V, rtol=1e-7)
    np.testing.assert_allclose(found["qdd"][-1], A, rtol=3e-6)
    np.testing.assert_allclose(found["constraints/multipliers"][-1], -np.array(LAMBDA), rtol=3e-6)


def test_the_torque_of_gamma_is_that_of_the_spring() -> None:
    """Its work is the loss of c0 (|CD| - l0)^2 / 2."""
    found = result()
    gamma, beta = found["q"][:, 2], found["q"][:, 0]
    c, s = np.cos(gamma), np.sin(gamma)
    D = np.column_stack([-0.03635 + 0.02 * c + 0.018 * s, 0.03273 + 0.02 * s - 0.018 * c])
    energy = 2265.0 * (np.linalg.norm(D - [0.014, 0.072], axis=1) - 0.07785) ** 2
    total = found["energy/kinetic"] + energy - 0.033 * beta
    assert np.ptp(total) < 1e-11 * found["energy/kinetic"].max()
