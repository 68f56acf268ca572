"""Inverse dynamics of many runs gives what single runs of their own scenes give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import Mechanism, inverse, load_scene, load_scene_text
from robodyn_cli.errors import CapabilityError
from robodyn_cli.over.many.command import number_of
from robodyn_cli.over.study.rows import Points, Task
from robodyn_cli.over.study.runs import Compiled, beyond
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.torques.checks import FIGURES
from tests.many import compare_all
from tests.unit.test_mechanism import around, own_scene, varied

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
CHAIN = """
schema: 1
command: inverse
gravity: [0.3, -9.0, -2.0]
robot:
  convention: modified
  links:
    - {name: a, mass: 3.1, com: [0.2, 0.05, -0.1], inertia: {xx: 0.11, yy: 0.2, zz: 0.25, xy: 0.01, xz: -0.02, yz: 0.03}}
    - {name: b, mass: 1.7, com: [0.1, -0.04, 0.3], inertia: {xx: 0.08, yy: 0.06, zz: 0.07, xy: -0.01, xz: 0.01, yz: 0.02}}
  joints:
    - {name: j1, type: revolute, alpha: 0.4, a: 0.6, d: 0.1, friction: {viscous: 0.2, coulomb: 0.3}}
    - {name: j2, type: prismatic, alpha: 1.1, a: 0.2, theta: 0.3, spring: {stiffness: 40.0, rest: 0.1}}
trajectory: {type: joint, duration: 1.5, q: {j1: "0.3 + 0.9*sin(1.3*t)", j2: "0.2 + 0.3*cos(2*t)"}}
inverse: {samples: 41}
"""
VALUES = {
    "robot.links.a.mass": [3.1, 0.4, 9.0],
    "robot.links.b.inertia.xy": [-0.01, 0.005, 0.01],
    "robot.joints.j1.a": [0.6, 0.1, -0.8],
    "robot.joints.j1.friction.coulomb": [0.3, 0.7, 0.0],
    "robot.joints.j2.spring.stiffness": [40.0, 2000.0, 3.0],
    "gravity.2": [-2.0, 4.0, 0.0],
}


def agree(scene: Scene, values: dict[str, np.ndarray], compiled: bool) -> None:
    """Compare torques and all figures of three runs with those of scenes of their own."""
    mechanism = Mechanism(scene, list(values))
    of = [f"joints.{joint}.{figure}" for joint in mechanism.qd_names for figure in FIGURES]
    found = mechanism.inverse_many(values, of=[*of, f"peak_torque.{mechanism.qd_names[0]}"])
    assert found.ok.all() and found.one_by_one.any() != compiled, found.reason
    for run in range(3):
        single = inverse(own_scene(scene, values, run))
        for name in ("time", "q", "qd", "qdd", "tau"):
            bound = 1e-12 * np.abs(single[name]).max()
            np.testing.assert_allclose(found.samples[name][run], single[name], rtol=0, atol=bound)
        np.testing.assert_allclose(found.q[run], single["q"][-1], rtol=1e-13 if mechanism.scene.loops else 0)
        assert found.time[run] == single.time[-1]
        for key, column in found.outputs.items():
            own = number_of(single.summary, key)
            assert column[run] == pytest.approx(own, rel=1e-9, abs=1e-12, nan_ok=True), key


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", ["arm_tilted", "arm_in_plane", "arm_weightless"])
def test_torques_are_those_of_their_own_scenes(name: str, seed: int) -> None:
    scene = load_scene(str(CONFIGS / f"{name}.yaml"))
    agree(scene, around(scene, varied(scene, 4, seed), 3, seed), True)


def test_forces_in_joints_and_asymmetric_inertias() -> None:
    agree(load_scene_text(CHAIN), {key: np.array(x) for key, x in VALUES.items()}, True)


LOOPS = [
    ("mechanisms/five_bar_circle", ["outputs={}"], ("robot.joints.left.a", "robot.links.arm_left.mass")),
    ("search/counterweights", [], ("robot.joints.coupler.origin.xyz#1", "robot.links.bar.inertia.zz")),
]


@pytest.mark.parametrize(("name", "changes", "keys"), LOOPS)
def test_torques_of_mechanisms_are_those_of_their_own_scenes(
    name: str, changes: list[str], keys: tuple[str, ...]
) -> None:
    scene = load_scene(str(CONFIGS / f"{name}.yaml"), ["inverse.samples=41", *changes])
    agree(scene, around(scene, [keys[1]], 3, 1), True)


@pytest.mark.parametrize(("name", "changes", "keys"), LOOPS)
def test_every_figure_of_a_mechanism_is_that_of_the_command(
    name: str, changes: list[str], keys: tuple[str, ...]
) -> None:
    """Lengths and masses differ; errors are those of the command too."""
    compare_all(Task(Family(CONFIGS / f"{name}.yaml", ("expect={}", *changes)), "inverse", keys, ()), 4)


def test_what_a_mechanism_is_expected_to_be_is_judged_in_batched_runs() -> None:
    path = CONFIGS / "mechanisms" / "five_bar_circle.yaml"
    for changes, made in (((), 2), (("actuated=[left, right, bend_left]",), 0)):
        family = Family(path, ("outputs={}", *changes))
        task = Task(family, "inverse", ("robot.joints.left.a",), ("peak_torque.left",))
        rows = Compiled(task, 1).make(Points(np.arange(2), np.array([[0.5], [0.51]])))
        assert not beyond(task) and len(rows) == made
        assert rows.rows["holds"].all()


@pytest.mark.parametrize(
    ("name", "compiled"),
    [("2r_circle", False), ("mechanisms/five_bar_circle", True), ("trajectories/fastest_2r", False)],
)
def test_motions_that_depend_on_lengths(name: str, compiled: bool) -> None:
    """Those of loops are found for all runs together, others one by one."""
    scene = load_scene(str(CONFIGS / f"{name}.yaml"), ["inverse.samples=41"])
    length = next(key for key in varied(scene, 1000, 3) if key.endswith(".a"))
    agree(scene, around(scene, [length], 3, 3), compiled)


def test_a_trajectory_that_varies_is_structure() -> None:
    mechanism = Mechanism(load_scene_text(CHAIN), ["trajectory.duration"])
    found = mechanism.inverse_many({"trajectory.duration": [1.0, 2.0]})
    np.testing.assert_array_equal(found.time, [1.0, 2.0])
    np.testing.assert_allclose(found.q[:, 0], 0.3 + 0.9 * np.sin([1.3, 2.6]), rtol=1e-14)


def test_a_run_that_fails_is_a_row_with_its_reason() -> None:
    scene = load_scene_text(CHAIN)
    found = Mechanism(scene, ["robot.links.a.mass"]).inverse_many([[2.0], [-1.0], [1.7e308], [3.0]])
    assert found.ok.tolist() == [True, False, False, True]
    assert "robot.links.a.mass" in found.reason[1] and "finite" in found.reason[2]
    assert np.isfinite(found.samples["tau"][3]).all() and np.isnan(found.samples["tau"][1]).all()


def test_samples_are_asked_for() -> None:
    mechanism = Mechanism(load_scene_text(CHAIN))
    assert mechanism.inverse_many(samples=7).samples["tau"].shape == (1, 7, 2)
    with pytest.raises(CapabilityError, match="2 or more"):
        mechanism.inverse_many(samples=1)


def test_a_study_of_figures_takes_compiled_code() -> None:
    from robodyn_cli.over.study.rows import Points, Task
    from robodyn_cli.over.study.runs import Compiled, make_alone

    family = Family.of(load_scene_text(CHAIN))
    task = Task(family, "inverse", ("robot.links.a.mass",), ("peak_torque.j1", "joints.j2.energy"))
    points = Points(np.arange(70), np.linspace(1.0, 4.0, 70)[:, None])
    made = Compiled(task, 1).make(points)
    assert np.array_equal(made.runs, points.runs) and np.array_equal(made.rows["values"], points.values)
    some = [0, 23, 46, 69]
    own = make_alone(task, points.part(some))
    np.testing.assert_allclose(made.rows["outputs"][some], own.rows["outputs"], rtol=1e-9)
    assert (made.rows["code"][some] == own.rows["code"]).all() and made.reasons == own.reasons == {}
