"""Independent coordinates: the motion of projection, whatever the dependent ones are given as, through dead points."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli import deploy, load_scene, load_scene_text, simulate
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.build import build_system
from robodyn_cli.ready.prepare import prepare
from tests import mechanisms
from tests.mechanisms import CONFIGS, SIX_BAR, close, failure, run

INDEPENDENT = "simulate.stabilisation=independent"


@pytest.mark.parametrize("method", ["gauss", "dop853", "rodas5p"])
def test_the_motion_is_that_of_projection(method: str) -> None:
    overrides = ["simulate.duration=1", "simulate.error_estimate=false", f"simulate.integrator={method}"]
    projected, found = run(SIX_BAR, *overrides), run(SIX_BAR, *overrides, INDEPENDENT)
    close(found["q"], projected["q"], 1e-6 if method == "rodas5p" else 1e-8)
    residual = found.summary["constraint_residual"]
    assert residual["position"] < 1e-13 and residual["velocity"] < 1e-12
    assert found.summary["energy_drift"] < 1e-5


def test_dependent_coordinates_are_a_first_guess_and_nothing_else() -> None:
    setup = prepare(load_scene_text("schema: 1\n" + SIX_BAR))
    problem, q, v = setup.problem, setup.assembled.q, setup.assembled.v + 0.0
    system = build_system(problem, "independent")
    assert system.partition is not None
    p = system.partition.choose(0.0, q, None)
    w = p[:-1]
    assert sorted(set(w)) == [0.0, 1.0] and w.sum() == len(problem.constraints.rows)

    def rates(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        values = {"t": [0.0], "q": q.tolist(), "v": v.tolist(), "z": [0.0], "p": p.tolist()}
        return np.array(evaluate([*system.acceleration, *system.z_rate], values), dtype=float)

    rng = np.random.default_rng(3)
    exact = rates(q, v)
    off = w * rng.normal(size=len(q))
    close(rates(q + 1e-4 * off, v), exact, 1e-9)
    close(rates(q, v + off), exact, 1e-9)
    assert np.abs(rates(q + 1e-3 * (1 - w), v) - exact).max() > 1e-5


def test_the_choice_is_made_anew_where_it_must() -> None:
    """The lecture's four-bar, left alone, turns back at the dead points of each coordinate in turn."""
    overrides = [
        "simulate.duration=60",
        "simulate.samples=301",
        "simulate.error_estimate=false",
        "simulate.rtol=1e-11",
    ]
    scene = CONFIGS / "four_bar_deploy.yaml"
    projected, found = (simulate(load_scene(scene, [*overrides, *more])) for more in ([], [INDEPENDENT]))
    assert found.summary["repartitions"] > 2
    close(found["q"][:150], projected["q"][:150], 1e-6)
    assert found.summary["energy_drift"] < 1e-6 and found.summary["constraint_residual"]["position"] < 1e-13


def test_a_deployment_locks_where_it_does_with_projection() -> None:
    lock = deploy(load_scene(CONFIGS / "four_bar_deploy.yaml", [INDEPENDENT])).summary["lock"]
    close(lock["time"], 12.282995609629, 1e-9)


def test_quasi_velocities() -> None:
    """A rod on a ball joint, whose end slides on an oblique wall."""
    text = """
gravity: [0, 0, -9.81]
robot:
  joints: [{name: ball, type: spherical, parent: base}]
  links: [{name: rod, mass: 2, com: [0.5, 0.1, 0], com_frame: joint, inertia: {xx: 0.02, yy: 0.2, zz: 0.21, xy: 0.01, xz: 0, yz: 0}}]
  points: {tip: {link: rod, at: [1, 0, 0]}, wall: {link: base, at: [0.6, 0, 0]}}
loops: [{name: contact, type: point_on_plane, between: [base.wall, tip], axis: [1, 0, 0.3]}]
initial: {q: {ball: [0.9, 0.1, 0.4, sqrt(0.02)]}}
simulate: {duration: 2, samples: 21}
"""
    projected, found = run(text), run(text, INDEPENDENT)
    assert np.ptp(projected["q"], axis=0).max() > 0.3
    close(found["q"], projected["q"], 1e-7)
    assert found.summary["constraint_residual"]["position"] < 1e-14


def test_what_it_cannot_do() -> None:
    error = failure(mechanisms.BENNETT, INDEPENDENT)
    assert error.exit_code == 2 and "redundant rows" in error.message and "projection" in error.message
