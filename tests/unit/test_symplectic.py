"""Symplectic partitioned methods: what they refuse, and that they run backwards."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import robodyn_cli
from robodyn_cli.errors import CapabilityError
from robodyn_cli.integration_methods import FIXED_STEP
from robodyn_cli.integration_methods import METHODS as NAMES
from robodyn_cli.integrators.methods.symplectic import COMPOSITIONS, composed
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.works.simulate import simulate
from tests import systems
from tests.systems import system

PARTITIONED = [m for m in methods if m == "verlet" or m.startswith("symplectic")]
CONFIGS = Path(robodyn_cli.__file__).resolve().parent.parent / "configs"
GANTRY = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  convention: standard
  joints:
    - {name: x, type: prismatic, theta: 0, a: 0, alpha: 90 deg, spring: {stiffness: 40, rest: 0}}
    - {name: y, type: prismatic, theta: 0, a: 0, alpha: 90 deg, spring: {stiffness: 90, rest: 0.1}}
  links:
    - {name: bridge, mass: 3, com: [0, 0, 0], com_frame: joint}
    - {name: trolley, mass: 1, com: [0, 0, 0], com_frame: joint}
initial: {q: {x: 0.2, y: 0.1}, qd: {x: 0, y: 0.3}}
simulate: {duration: 10, samples: 101, integrator: METHOD, step: 0.005}
"""


def test_scenes_know_the_same_methods() -> None:
    assert set(NAMES) == set(methods)
    assert set(FIXED_STEP) == {m for m in methods if not methods[m].adaptive}


@pytest.mark.parametrize("name", PARTITIONED)
def test_a_mass_matrix_that_changes_is_refused(name: str) -> None:
    scene = load_scene(
        CONFIGS / "double_pendulum.yaml", [f"simulate.integrator={name}", "simulate.step=0.01"]
    )
    with pytest.raises(
        CapabilityError, match=f"'{name}' does not do this scene: .* on positions and time only.*velocit"
    ):
        simulate(scene)


@pytest.mark.parametrize(
    ("rates", "nz"),
    [
        (lambda t, q, v, z, p: [-q[0] - 0.1 * v[0]], 0),
        (lambda t, q, v, z, p: ([-q[0] - z[0]], [q[0]]), 1),
        (lambda t, q, v, z, p: ([-q[0]], [q[0] - z[0]]), 1),
    ],
)
def test_what_cannot_be_split_is_refused(rates: object, nz: int) -> None:
    with pytest.raises(CapabilityError, match="here they depend on"):
        Integrator(system(1, rates, nz=nz), "verlet")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", PARTITIONED)
def test_a_gantry_swings_on_its_springs(name: str) -> None:
    """Joint axes at right angles have a constant mass matrix: the closed form is a cosine each."""
    result = simulate(load_scene_text(GANTRY.replace("METHOD", name)))
    q = result["q"]
    t = result["time"]
    bound = {"verlet": 3e-3, "symplectic4": 1e-6}.get(name, 1e-9)
    rest = -9.81 * 4 / 40  # the first axis is vertical
    assert np.abs(q[:, 0] - rest - (0.2 - rest) * np.cos(np.sqrt(40 / 4) * t)).max() < bound
    assert result.summary["error_estimate"]["state_max"] < 30 * bound


@pytest.mark.parametrize("name", PARTITIONED)
def test_they_run_backwards_to_where_they_came_from(name: str) -> None:
    case = systems.kepler(0.3)
    integrator = Integrator(case.system, name)
    integrator.reset(0.0, case.start, Options(step=0.02))
    integrator.advance(10.0)
    state = integrator.state
    integrator.reset(0.0, [*state[:2], *-state[2:]], Options(step=0.02))
    integrator.advance(10.0)
    back = integrator.state * [1.0, 1.0, -1.0, -1.0]
    assert np.abs(back - case.start).max() < 1e-11


def test_tables_are_checked() -> None:
    assert len(COMPOSITIONS[8]) == 17 and sum(COMPOSITIONS[8]) == pytest.approx(1.0, abs=1e-15)
    with pytest.raises(ArithmeticError, match="condition of order 3"):
        composed(4, 0.3, 0.3)
