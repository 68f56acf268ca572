"""Links of next to no mass between joints: rounding of their accelerations is far above usual tolerances.

The Delta robot has balls of three pins each, with spheres of 1e-11 kg m^2 between them. Motions by methods that share
neither their stages nor their estimates agree within their errors, and take steps of the length that the motion asks for.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import Result, load_scene, load_scene_text, simulate
from robodyn_cli.integrators.runtime.memory import DoubleSlot
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.motion import Motion
from robodyn_cli.observe.rounding import ENLARGED, Rounded
from robodyn_cli.scene.types import Scene

CONFIGS = Path(__file__).parents[2] / "configs"
DELTA = CONFIGS / "published" / "delta.yaml"
SPHERES = ["sphere", *(f"sphere_{k}" for k in range(2, 7))]
DURATION = 0.3
# of a second: hundreds of times as many were taken when rounding counted as an error
MOST_STEPS = {"gauss": 3000, "dop853": 3000, "dopri5": 10_000}
OFTEN = 1e-3  # s


def delta(lighter: float, gravity: Sequence[float], method: str, atol: float = 1e-12) -> Scene:
    """Return the robot let loose, with spheres so much lighter than those of the file."""
    inertia = dict.fromkeys(("xx", "yy", "zz"), 1.636e-11 * lighter)
    spheres = {name: {"mass": 6.545e-6 * lighter, "inertia": inertia} for name in SPHERES}
    return load_scene(
        DELTA,
        {
            "gravity": list(gravity),
            "robot": {"links": spheres},
            "simulate": {"duration": DURATION, "samples": 61, "integrator": method, "atol": atol},
        },
    )


@lru_cache
def motion() -> Motion:
    return build_motion(delta(1.0, (0.0, 0.0, -9.81), "gauss"))  # type: ignore[arg-type]


def errors(result: Result) -> tuple[float, float]:
    estimate = result.summary["error_estimate"]
    return estimate["q_max"], estimate["qd_max"]


@pytest.mark.parametrize(
    ("lighter", "gravity"),
    [(1.0, (0.0, 0.0, -9.81)), (1e-3, (0.0, 0.0, -9.81)), (0.1, (0.2, 0.15, -9.81))],
)
def test_methods_agree_within_their_errors(lighter: float, gravity: Sequence[float]) -> None:
    """With the lightest spheres rounding loses more energy than tolerances explain, and the runs count all the same."""
    # steps of implicit methods are not kept from getting short, so that another one takes long with very light spheres
    others = ["radau13"] if lighter == 1.0 else []
    results = {m: simulate(delta(lighter, gravity, m)) for m in [*MOST_STEPS, *others]}
    for method, most in MOST_STEPS.items():
        assert results[method].summary["counters"]["steps"] < most * DURATION
    first = results[next(reversed(results))]
    for method in results:
        for name, own, other in zip(("q", "qd"), errors(results[method]), errors(first)):
            away = np.abs(results[method][name] - first[name]).max()
            assert away < own + other < 1e-2


def test_rounding_is_measured_as_on_the_graph() -> None:
    own = motion()
    assert own.system.is_rounded
    driver, program = Driver(own.system, "dop853", own.options), Rounded(own.system.acceleration)
    driver.start(0.0, own.start)
    for k in range(1, 60):
        driver.advance(k * OFTEN)
        x, t = driver.state, np.array([[driver.time]])
        p = own.system.parameters_at(driver.time, own.system.split(x)[0])
        draws = program(own.system.own_groups(t, x[None], p[None]))[:, 0]
        on_graph = np.abs(draws[1:] - draws[0]).max() / ENLARGED
        measured = driver.integrator.w[DoubleSlot.ROUNDING]
        # of few draws, at a state of up to four steps ago
        assert 0.03 * on_graph < measured < 30.0 * on_graph
    assert 0.0 < driver.rounded < 1e-6 * driver.time


def test_a_tolerance_above_rounding_is_kept() -> None:
    coarse = simulate(delta(1.0, (0.0, 0.0, -9.81), "gauss", atol=1e-6))
    fine = simulate(delta(1.0, (0.0, 0.0, -9.81), "gauss"))
    assert coarse.summary["counters"]["steps"] <= fine.summary["counters"]["steps"]
    assert np.abs(coarse["q"] - fine["q"]).max() < errors(coarse)[0] + errors(fine)[0]


@pytest.mark.parametrize("name", ["double_pendulum", "four_bar_deploy", "benchmarks/stewart_platform"])
def test_usual_scenes_are_not_watched(name: str) -> None:
    """Their code is without it, and as quick as ever."""
    assert not build_motion(load_scene(CONFIGS / f"{name}.yaml")).system.is_rounded  # type: ignore[arg-type]


@pytest.mark.parametrize("link", ["link1", "link2"])
def test_a_light_link_of_a_chain_is_no_reason(link: str) -> None:
    """Torques on it are as small as it is, and so is their rounding."""
    scene = load_scene(CONFIGS / "double_pendulum.yaml", {f"robot.links.{link}.mass": 1e-9})
    assert not build_motion(scene).system.is_rounded  # type: ignore[arg-type]


ROD = """
schema: 1
command: simulate
gravity: [0, 0, -9.81]
robot:
  joints:
    - {{name: crank, type: revolute, parent: base, link: crank, axis: [0, 1, 0]}}
    - {{name: ball, type: spherical, parent: crank, link: rod, origin: {{xyz: [0.2, 0, 0]}}}}
    - {{name: rocker, type: revolute, parent: base, link: rocker, origin: {{xyz: [0.6, 0.1, 0]}}, axis: [0.3, 1, 0]}}
  links:
    - {{name: crank, mass: 1, com: [0.1, 0, 0], inertia: {{xx: 0.001, yy: 0.01, zz: 0.01}}}}
    - {{name: rod, mass: 0.5, com: [0.3, 0, 0], inertia: {{xx: {axial}, yy: 0.02, zz: 0.02}}}}
    - {{name: rocker, mass: 1, com: [0, 0, 0.15], inertia: {{xx: 0.01, yy: 0.01, zz: 0.001}}}}
  points: {{tip: {{link: rod, at: [0.62, 0, 0]}}, top: {{link: rocker, at: [0, 0, 0.3]}}}}
loops: [{{name: loop, type: spherical, between: [tip, top]}}]
initial: {{q: {{crank: 0.3}}}}
simulate: {{duration: 2, samples: 101, integrator: {method}}}
"""


@pytest.mark.parametrize("axial", [1e-12, 1e-10])
def test_a_slender_rod_between_balls_spins_by_rounding_and_nothing_else_does(axial: float) -> None:
    """Nothing turns it about itself but rounding, 1e-5 rad/s^2 with the least inertia; crank and rocker are as exact as
    ever. Without its spin being known for what it is, 300 000 steps a second were taken."""
    results = [simulate(load_scene_text(ROD.format(axial=axial, method=m))) for m in ("gauss", "dop853")]
    places = [0, 5]  # of crank and rocker
    assert np.abs(results[0]["q"][:, places] - results[1]["q"][:, places]).max() < 1e-8
    for result in results:
        assert result.summary["counters"]["steps"] < 30_000
        assert errors(result)[0] < 0.1
