"""Forward dynamics of mechanisms with loops: against simulations, and derivatives against neighbouring states."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path
from typing import cast

import mpmath
import numpy as np
import pytest

from robodyn_cli import Mechanism, assemble, load_scene, simulate
from robodyn_cli.errors import CapabilityError, GeometryError
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.ready.prepare import passive_coordinates, prepare
from robodyn_cli.ready.singularity import is_dead_point
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.load_sharing import constrained
from robodyn_cli.works.functions.constrained import MANY, ConstrainedDynamics
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


@pytest.mark.parametrize("name", SCENES)
def test_many_states_have_the_accelerations_of_few(name: str) -> None:
    """Many are eliminated in compiled code, also where redundant rows are combined anew along the motion."""
    samples = 700
    scene = SCENES[name]
    longer = dataclasses.replace(scene.simulate, duration=1.5, samples=samples)
    result = simulate(dataclasses.replace(scene, simulate=longer))
    q, v = result["q"], result["qd"]
    tau = np.random.default_rng(3).normal(size=v.shape)
    m = Mechanism(scene)
    at = np.arange(0, samples, 7)
    few = m.forward_dynamics(q[at], v[at], tau[at])
    dynamics = cast(ConstrainedDynamics, m.forward_dynamics)
    assert dynamics._elimination is None, "few states must not compile anything"
    many = m.forward_dynamics(q, v, tau)
    assert dynamics._elimination is not None and samples >= MANY
    assert_close(many[at], few, 1e-8, float(np.abs(few).max()))
    held = dynamics._elimination(q, v, tau)[1]
    assert held.mean() > 0.9, "states that elimination leaves take singular values each"


def test_states_at_which_loops_lose_rank_are_solved_too() -> None:
    """A parallelogram that lies flat at some of many states: elimination fails there, and is seen to."""
    scene = load_scene(CONFIGS / "parallelogram.yaml", ["command=simulate", "expect=null"])
    m = Mechanism(scene)
    q0 = assemble(scene)["q"].ravel()
    closed = Closed(scene)
    free = np.linalg.svd(closed.problem.numbers(closed.problem.psi, q0))[2][-1]
    states = [q0]
    for _ in range(MANY):
        states.append(closed.near(closed.manifold.integrate(states[-1], 0.01 * free), 0.0 * free)[0])
    flat = np.zeros_like(q0)
    states.insert(MANY // 2, flat)
    q = np.array(states)
    zero = np.zeros((len(q), len(m.qd_names)))
    tau = zero + np.arange(1.0, zero.shape[1] + 1.0)
    every = m.forward_dynamics(q, zero, tau)
    assert np.isfinite(every).all()
    some = [0, MANY // 2, MANY]
    assert_close(every[some], m.forward_dynamics(q[some], zero[some], tau[some]), 1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_light_bodies_and_redundant_rows_keep_their_digits(seed: int) -> None:
    """M of bodies from 1e-9 kg to 1 kg, rows that depend on each other, against a solution with 60 digits."""
    rng = np.random.default_rng(seed)
    nv, m, rank = 9, 6, 4
    size = 10.0 ** rng.uniform(-4.5, 0.0, nv)
    A = rng.normal(size=(nv, nv))
    M = size[:, None] * (A @ A.T + nv * np.eye(nv)) * size
    mix = rng.normal(size=(m, rank))
    psi, c = mix @ rng.normal(size=(rank, nv)), mix @ rng.normal(size=rank)
    f = rng.normal(size=nv)
    a, lam = constrained(M[None], psi[None], f[None, :, None], c[None, :, None])
    with mpmath.workdps(60):
        rows = np.linalg.svd(mix)[0][:, :rank].T
        P, right = mpmath.matrix(rows.tolist()) * mpmath.matrix(psi.tolist()), rows @ c
        system = mpmath.zeros(nv + rank)
        for i in range(nv):
            for k in range(nv):
                system[i, k] = M[i, k]
            for k in range(rank):
                system[i, nv + k], system[nv + k, i] = -P[k, i], P[k, i]
        exact = mpmath.lu_solve(system, mpmath.matrix([*f, *right]))
        expected = np.array([float(x) for x in exact[:nv]])
    assert_close(a[0, :, 0], expected, 1e-9, float(np.abs(expected).max()))
    assert_close(M @ a[0] - psi.T @ lam[0], f[:, None], 1e-9, float(np.abs(M @ a[0]).max() + 1.0))


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


def test_joints_that_stick_are_solved_without_their_states() -> None:
    """Friction has the exact sign of the rate, for many states as for few."""
    friction = "robot.joints.theta1.friction={coulomb: 0.3, law: set_valued}"
    scene = load_scene(CONFIGS / "parallelogram.yaml", [*SHORT, "initial.qd={theta1: 1}", friction])
    start = simulate(scene)
    m = Mechanism(scene)
    q, v = (np.tile(start[name][1:2], (MANY + 1, 1)) for name in ("q", "qd"))
    every = m.forward_dynamics(q, v, 0.0 * v)
    assert_close(every[:1], m.forward_dynamics(q[:1], v[:1], 0.0 * v[:1]), 1e-12)
    elimination = cast("ConstrainedDynamics", m.forward_dynamics)._elimination
    assert elimination is not None and elimination(q, v, 0.0 * v)[1].all()  # in compiled code


def test_a_row_between_driven_joints_is_no_dead_point() -> None:
    """The drivers of a gripper are coupled, and both driven."""
    drivers = "torques={right_driver_joint: 0.2, left_driver_joint: 0.2}"
    setup = prepare(load_scene(CONFIGS / "published/gripper_2f85.yaml", [drivers]))
    passive = passive_coordinates(setup.problem)
    assert not is_dead_point(setup.problem, setup.assembled.q, passive, 1e-6)
