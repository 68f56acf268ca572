"""Forward dynamics of mechanisms with loops: against simulations, and derivatives against neighbouring states."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import Mechanism, load_scene, simulate
from robodyn_cli.errors import CapabilityError, GeometryError
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from tests.numeric import assert_close

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SHORT = [
    "simulate.duration=0.3",
    "simulate.samples=7",
    "simulate.error_estimate=false",
    "command=simulate",
    "expect=null",
]
# in the plane, in space, with rows that depend on each other, with quaternions
SCENES = {
    "four-bar": load_scene(CONFIGS / "benchmarks/drake_four_bar.yaml", SHORT),
    "slider-crank": load_scene(CONFIGS / "benchmarks/spatial_slider_crank.yaml", SHORT),
    "bennett": load_scene(CONFIGS / "benchmarks/bennett.yaml", SHORT),
    "parallelogram": load_scene(CONFIGS / "parallelogram.yaml", [*SHORT, "initial.qd={theta1: 1}"]),
    "stewart": load_scene(CONFIGS / "benchmarks/stewart_platform.yaml", SHORT),
}


@cache
def run_of(name: str) -> Result:
    return simulate(SCENES[name])


class Closed:
    """States of a mechanism that satisfy its loops, by steps of least norm."""

    def __init__(self, scene: Scene) -> None:
        self.mechanism = Mechanism(scene)
        self.problem = self.mechanism._problem
        self.manifold = Manifold(self.problem.model)

    def near(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        problem = self.problem
        for _ in range(4):
            eta = problem.numbers(np.array(problem.constraints.eta, dtype=object), q)
            q = self.manifold.integrate(q, -np.linalg.pinv(problem.numbers(problem.psi, q), rcond=1e-7) @ eta)
        psi = problem.numbers(problem.psi, q)
        return q, v - np.linalg.pinv(psi, rcond=1e-7) @ (psi @ v)


@pytest.mark.parametrize("name", SCENES)
def test_accelerations_are_those_of_a_simulation(name: str) -> None:
    scene = SCENES[name]
    result = run_of(name)
    tau = result["tau"] if "tau" in result else np.zeros_like(result["qd"])
    m = Mechanism(scene)
    found = m.forward_dynamics(result["q"], result["qd"], tau)
    assert_close(found, result["qdd"], 1e-7)
    one = m.forward_dynamics(result["q"][3], result["qd"][3], tau[3])
    assert_close(one, found[3], 1e-13)


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_are_those_of_neighbouring_states(name: str) -> None:
    """Along random changes that keep the loops closed, of positions, rates and torques together."""
    closed = Closed(SCENES[name])
    result = run_of(name)
    m, manifold, rng = closed.mechanism, closed.manifold, np.random.default_rng(5)
    nv, h = len(m.qd_names), 1e-5
    q, v = closed.near(result["q"][4], result["qd"][4])
    tau = rng.normal(size=nv)
    found = m.forward_dynamics_derivatives(q, v, tau)
    for _ in range(3):
        x, y, u = rng.normal(size=(3, nv))
        x, y = 0.1 * x, float(np.abs(v).max() + 1.0) * y
        sides = [closed.near(manifold.integrate(q, s * h * x), v + s * h * y) for s in (1.0, -1.0)]
        dq = (manifold.difference(q, sides[0][0]) - manifold.difference(q, sides[1][0])) / (2.0 * h)
        dv = (sides[0][1] - sides[1][1]) / (2.0 * h)
        a = [m.forward_dynamics(*side, tau + s * h * u) for side, s in zip(sides, (1.0, -1.0))]
        change = (a[0] - a[1]) / (2.0 * h)
        parts = [found.dq @ dq, found.dqd @ dv, found.dtau @ u]
        assert_close(sum(parts), change, 1e-6, max(float(np.abs(part).max()) for part in parts))


@pytest.mark.parametrize("name", SCENES)
def test_what_torques_cause(name: str) -> None:
    """dtau is symmetric, leaves the loops closed, and M^-1 for the free directions: dtau M dtau = dtau."""
    closed = Closed(SCENES[name])
    result = run_of(name)
    m = closed.mechanism
    q, v, tau = result["q"], result["qd"], np.zeros_like(result["qd"])
    W, M, psi = m.forward_dynamics_derivatives(q, v, tau).dtau, m.mass_matrix(q), m.constraint_jacobian(q)
    size = float(np.abs(W).max())
    assert_close(W, np.swapaxes(W, 1, 2), 1e-10, size)
    assert_close(psi @ W, np.zeros_like(psi @ W), 1e-10, size * float(np.abs(psi).max()))
    assert_close(W @ M @ W, W, 1e-9, size)


def test_what_is_refused() -> None:
    scene = SCENES["four-bar"]
    m = Mechanism(scene)
    q = np.array(run_of("four-bar")["q"][0])
    zero = np.zeros(len(q))
    with pytest.raises(GeometryError, match="the loops are open at state 1: row .* is off by .*`assemble`"):
        m.forward_dynamics(np.array([q, q + 0.3]), [zero, zero], [zero, zero])
    with pytest.raises(GeometryError, match="rates open the loops at state 0"):
        m.forward_dynamics(q, zero + [1.0, *zero[1:]], zero)
    given = Mechanism(CONFIGS / "four_bar_prescribed.yaml")
    names = len(given.qd_names)
    with pytest.raises(CapabilityError, match="takes no prescribed joints .*; use `simulate`"):
        given.forward_dynamics(*np.zeros((3, names)))
