"""What formulas ask of points (``tip.x``, ``speed(tip)``, ``angle(a, b, c)``): against places, differences, closed forms."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import load_scene, load_scene_text, simulate
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from tests.oracle.test_point_motion import tree

CONFIGS = Path(__file__).parents[2] / "configs"
SIGNALS = """
outputs:
  signals:
    x: p4.x
    y: p4.y
    z: p4.z
    vx: p4.vx
    vy: p4.vy
    vz: p4.vz
    speed: speed(p4)
    angle: "angle(p1, p4, base.origin)"
    com: l3.com.x
    other: "p3.z - p2.vy*length(p1, p3)"
"""


def angle(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """The angle at b by the law of cosines."""
    sides = [np.linalg.norm(x - y) for x, y in ((a, b), (c, b), (a, c))]
    return math.acos((sides[0] ** 2 + sides[1] ** 2 - sides[2] ** 2) / (2.0 * sides[0] * sides[1]))


@pytest.mark.parametrize("seed", range(4))
def test_signals_of_a_tree_are_its_points(seed: int) -> None:
    """Trees with full inertias and a turned base; places and velocities themselves are held against Pinocchio."""
    scene = load_scene_text(tree(seed, 401) + SIGNALS)
    result = simulate(scene)
    h = result.time[1] - result.time[0]
    p, v = result["points/p4"], result["point_velocities/p4"]
    for k, axis in enumerate("xyz"):
        assert np.abs(result[f"signals/{axis}"] - p[:, k]).max() < 1e-13
        assert np.abs(result[f"signals/v{axis}"] - v[:, k]).max() < 1e-12
        slopes = (8.0 * (p[3:-1, k] - p[1:-3, k]) - (p[4:, k] - p[:-4, k])) / (12.0 * h)
        assert np.abs(slopes - result[f"signals/v{axis}"][2:-2]).max() < 1e-6 * (1.0 + np.abs(v).max())
    assert np.abs(result["signals/speed"] - np.linalg.norm(v, axis=1)).max() < 1e-12
    origin = np.array([float(x) for x in Problem(scene).model.base.r])
    places = zip(result["points/p1"], p, result["signals/angle"])
    assert max(abs(angle(a, b, origin) - found) for a, b, found in places) < 1e-7
    apart = np.linalg.norm(result["points/p1"] - result["points/p3"], axis=1)
    other = result["points/p3"][:, 2] - result["point_velocities/p2"][:, 1] * apart
    assert np.abs(result["signals/other"] - other).max() < 1e-12


def test_points_of_a_loop_and_on_a_moving_base() -> None:
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml", ["simulate.duration=1", "simulate.samples=101"])
    names = [name for name, point in scene.robot.points.items() if point.link != "base"]
    settings = [f"outputs.signals.s{k}={name}.y" for k, name in enumerate(names)]
    result = simulate(
        load_scene(
            CONFIGS / "four_bar_deploy.yaml", ["simulate.duration=1", "simulate.samples=101", *settings]
        )
    )
    assert names
    for k, name in enumerate(names):
        assert np.abs(result[f"signals/s{k}"] - result[f"points/{name}"][:, 1]).max() < 1e-12
    moving = simulate(load_scene_text(MOVING))
    t = moving.time
    assert np.abs(moving["signals/x"] - np.cos(0.3) * 0.2 * np.sin(3.0 * t)).max() < 1e-13
    assert np.abs(moving["signals/vx"] - np.cos(0.3) * 0.6 * np.cos(3.0 * t)).max() < 1e-12
    assert np.abs(moving["signals/speed"] - np.abs(0.6 * np.cos(3.0 * t))).max() < 1e-12


MOVING = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  base: {rpy: [0, 0, 0.3]}
  joints: [{name: a, type: revolute, axis: [0, 1, 0]}]
  links: [{name: l, mass: 1, com: [0.5, 0, 0], inertia: {yy: 0.1}}]
  points: {hook: {link: base, at: [0, 0, 0], motion: [0.2*sin(3*t), 0, 0]}, tip: {link: l, at: [1, 0, 0]}}
initial: {q: {a: 0}}
outputs: {signals: {x: hook.x, vx: hook.vx, speed: speed(hook)}}
simulate: {duration: 1, samples: 51}
"""

PENDULUM = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{{name: a, type: revolute, axis: [0, 0, 1]}}]
  links: [{{name: l, mass: 2, com: [0.5, 0, 0], inertia: {{zz: 0.3}}}}]
  points: {{tip: {{link: l, at: [0.8, 0, 0]}}}}
initial: {{q: {{a: 0.4}}, qd: {{a: 0.7}}}}
simulate: {{duration: 2, samples: 101}}
{}
"""


@pytest.mark.parametrize(
    "of_point, of_joint",
    [
        ("-3*tip.y + 0.5*tip.vx", "-3*0.8*sin(a) - 0.5*0.8*sin(a)*qd.a"),
        ("-speed(tip)*qd.a", "-0.8*abs(qd.a)*qd.a"),
        ("angle(tip, base.origin, base.below)", "abs(a + pi/2)"),
        ("-l.com.vy", "-0.5*cos(a)*qd.a"),
    ],
)  # fmt: skip
def test_torques_by_points_are_those_by_joints(of_point: str, of_joint: str) -> None:
    below = ["robot.points.below={link: base, at: [0, -1, 0]}"]
    results = [
        simulate(load_scene_text(PENDULUM.format(f'torques: {{a: "{text}"}}'), overrides=below))
        for text in (of_point, of_joint)
    ]
    assert np.abs(results[0]["q"] - results[1]["q"]).max() < 1e-9


CONTROL = """
control:
  type: formulas
  joints: [a]
  law: {{a: "{}"}}
  {}
"""


@pytest.mark.parametrize(
    "sampling", ["", "period: 10 ms\n  delay: 3 ms\n  sensors: {resolution: 0.01, noise: 0.002}"]
)
def test_controllers_see_points_where_they_see_joints(sampling: str) -> None:
    """A law that reads a point gives what one gives that computes it from the joint as the sensors have it."""
    laws = ("-20*(tip.x - 0.5) - 2*tip.vx", "-20*(0.8*cos(q.a) - 0.5) + 2*0.8*sin(q.a)*qd.a")
    results = [simulate(load_scene_text(PENDULUM.format(CONTROL.format(law, sampling)))) for law in laws]
    assert np.abs(results[0]["control/torque"] - results[1]["control/torque"]).max() < 1e-9
    assert np.ptp(results[0]["control/torque"]) > 1.0


@pytest.mark.parametrize("integrator", ["gauss", "radau", "dopri5"])
def test_a_speed_has_a_slope_at_rest(integrator: str) -> None:
    scene = PENDULUM.format('torques: {a: "-speed(tip)*qd.a"}\n')
    rest = ["initial.qd=null", f"simulate.integrator={integrator}", "robot.joints.0.axis=[0.1, 0.2, 1]"]
    result = simulate(
        load_scene_text(scene.replace("{zz: 0.3}", "{xx: 0.2, yy: 0.2, zz: 0.3}"), overrides=rest)
    )
    assert np.isfinite(result["q"]).all() and np.ptp(result["q"]) > 0.1


@pytest.mark.parametrize(
    "changes, words",
    [
        (["torques.a=tip.w"], "unknown name 'tip.w'"),
        (["torques.a=tap.x"], "unknown point 'tap' (did you mean 'tip'?)"),
        (["torques.a=l.end.x"], "'l' has no 'end'"),
        (["torques.a=a.x"], "'a' is the name of a joint; a coordinate of a joint is q.a"),
        (["torques.a=l.x", "robot.points.l={link: l}"], "'l' is the name of a point, and of a link; rename one"),
        (["torques.a=a.x", "robot.points.a={link: l}"], "'a' is the name of a joint, and of a point; rename one"),
        (["outputs.signals.s=tap.x"], "unknown point 'tap'"),
        (["torques.a='angle(tip, l.com)'"], "',' is needed here"),
        (["prescribed.a=tip.x"], "'tip.x' is not allowed here"),
    ],
)  # fmt: skip
def test_what_names_no_point_is_refused(changes: list[str], words: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene_text(PENDULUM.format(""), overrides=changes)
    assert words in caught.value.message
