"""Stiff problems with known solutions, by every method that solves with a Jacobian."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli.expr import functions as f
from robodyn_cli.formulations.build import build_system
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.over.stability.scenes import HANGING, stiff_arm
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.scene.load import load_scene_text
from tests.systems import samples, system

STIFF = [m for m in methods if methods[m].needs_jacobian]
each_stiff = pytest.mark.parametrize("method", STIFF)
each_adaptive = pytest.mark.parametrize("method", [m for m in STIFF if methods[m].adaptive])


@each_stiff
@pytest.mark.parametrize("decay", [1e2, 1e4, 1e8])
def test_prothero_and_robinson(method: str, decay: float) -> None:
    """z-dot = -decay (z - cos t) - sin t from z(0) = 1 has the solution cos t, however stiff it is."""

    def rates(t: Any, q: Any, v: Any, z: Any, p: Any) -> Any:
        return [-q[0]], [-decay * (z[0] - f.cos(t)) - f.sin(t)]

    body = system(1, rates, nz=1)
    for tolerance in (1e-4, 1e-6):
        grid = Grid(0.0, 0.05, 201)
        times, states, integrator = samples(
            body, method, (1.0, 0.0, 1.0), grid, rtol=tolerance, atol=tolerance
        )
        assert np.abs(states[:, 2] - np.cos(times)).max() < 100 * tolerance
        assert integrator.counters.steps < (200_000 if method == "rosenbrock23" else 2000)


@each_adaptive
def test_van_der_pol(method: str) -> None:
    """The relaxation oscillation with eps = 1e-6; reference digits of the test set of Bari at t = 2."""
    body = system(1, lambda t, q, v, z, p: [((1.0 - q[0] * q[0]) * v[0] - q[0]) * 1e6])
    integrator = Integrator(body, method)
    tolerance = 1e-7 if method == "rosenbrock23" else 1e-9
    integrator.reset(0.0, (2.0, 0.0), Options(tolerance, tolerance, max_steps=200_000))
    integrator.advance(2.0)
    expected = (1.706167732170469, -0.8928097010248125)
    bound = 1e-3 if method == "rosenbrock23" else 2e-6
    np.testing.assert_allclose(integrator.state, expected, rtol=bound)


PENDULUM = stiff_arm("stiff arm", 10.0, rest="0", start=HANGING)


@each_adaptive
def test_a_double_pendulum_on_a_stiff_spring(method: str) -> None:
    """The largest error along the whole run, transient included, against an explicit method in tiny steps."""
    setup = prepare(load_scene_text(PENDULUM))
    body = build_system(setup.problem, work=False)
    start = np.concatenate([setup.assembled.q, setup.assembled.v])
    grid = Grid(0.0, 1.0 / 128, 129)
    _, exact, _ = samples(body, "dop853", start, grid, rtol=1e-12, atol=1e-13)
    low = method == "rosenbrock23"
    for tolerance in (1e-4, 1e-6) if low else (1e-4, 1e-7, 1e-9):
        integrator = Integrator(body, method)
        integrator.reset(0.0, start, Options(tolerance, tolerance))
        rows: list[np.ndarray] = []
        integrator.run(1.0, grid, lambda t, x: rows.append(x))  # noqa: B023
        error = np.abs(np.concatenate(rows) - exact)
        assert error[:, :2].max() < 30 * tolerance
        assert integrator.counters.attempts < (2000 if low else 1000)


def test_auto_takes_the_method_for_stiff_motion() -> None:
    from robodyn_cli.works.simulate import simulate

    result = simulate(load_scene_text(PENDULUM, overrides=["simulate.samples=51"]))
    assert result.summary["integrator"] == "radau13"
    assert "stiff" in result.summary["integrator_reason"]
