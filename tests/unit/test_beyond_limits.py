"""Inverse dynamics beyond the limits of joints; what else a scene with loads in time and stops is told."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from robodyn_cli.errors import CapabilityError, NumericalError, SceneError
from robodyn_cli.over.plan.plan import plan
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.works.info import info
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate
from robodyn_cli.works.statics import statics

ARM = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: ball, type: spherical}
    - {name: elbow, type: revolute, axis: [0, 1, 0], origin: {xyz: [0.3, 0, 0]}}
  links:
    - {name: upper, mass: 2, com: [0.15, 0.01, 0], inertia: {xx: 0.003, yy: 0.02, zz: 0.02, xy: 0.001}}
    - {name: fore, mass: 1, com: [0.12, 0, 0.01], inertia: {xx: 0.001, yy: 0.01, zz: 0.011}}
forces: [{name: tool, type: wrench, at: fore.com, force: [0, "2*t", 0]}]
trajectory: {type: joint, duration: 2, q: {ball: {rpy: ["0.3*sin(t)", "0.4*t", 0]}, elbow: "0.6*sin(2*t)"}}
initial: {q: {ball: [1, 0, 0, 0], elbow: 0}}
inverse: {samples: 201}
"""


def arm(limits: str = "") -> str:
    return ARM.replace("[0.3, 0, 0]}}", f"[0.3, 0, 0]}}, limits: {limits}}}") if limits else ARM


@pytest.mark.parametrize("stop, told", [("restitution: 0.5", "ignored"), ("stiffness: 1e3", "press")])
def test_motion_beyond_limits_is_told(stop: str, told: str) -> None:
    scene = load_scene_text(arm(f"{{lower: -0.3, upper: 0.7, stop: {{{stop}}}}}"))
    (warning,) = inverse(scene).summary["warnings"]
    assert "'elbow' is beyond its lower limit of -0.3 rad" in warning
    assert f"{0.6 * math.sin(4.0):.6g} rad at t = 2 s" in warning and told in warning


def test_motion_within_limits_is_not_told() -> None:
    scene = load_scene_text(arm("{lower: -0.6, upper: 0.6, stop: {restitution: 0.5}}"))
    assert "warnings" not in inverse(scene).summary


def test_loads_in_time_are_planned() -> None:
    found = plan(load_scene_text(ARM), "inverse")
    assert "external" in str(found)


def test_no_tolerance_at_zero_is_explained() -> None:
    scene = load_scene_text(ARM, overrides=["simulate={duration: 1, samples: 3, atol: 0}"])
    with pytest.raises(NumericalError, match="with 'atol: 0' .* allowed: an 'atol' such as"):
        simulate(scene)


@pytest.mark.parametrize(
    "state, said",
    [
        ("q=[[1, 0, 0, 0], nan]", "q.elbow: is not a number"),
        ("q=[0.1, 0]", "q.ball: "),
    ],
)
def test_wrong_states_are_told_as_they_were_given(tmp_path: Path, state: str, said: str) -> None:
    path = tmp_path / "arm.yaml"
    path.write_text(ARM)
    with pytest.raises(SceneError) as caught:
        info(path, at=[state])
    assert caught.value.message.startswith(f"--at {state!r}: {said}")


STOPPED = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1], limits: {lower: -0.5, upper: 0.5, stop: {restitution: 0.5}}}
    - {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [0.3, 0, 0]}}
  links:
    - {name: la, mass: 1, com: [0.15, 0, 0], inertia: {zz: 0.01}}
    - {name: lb, mass: 1, com: [0.15, 0, 0], inertia: {zz: 0.01}}
initial: {q: {a: 0.2, b: 0}}
simulate: {duration: 3, samples: 31}
"""


def test_prescribed_motion_into_a_rigid_stop_ends_there() -> None:
    scene = load_scene_text(STOPPED, overrides=["prescribed={a: 'sin(t)'}", "initial.q.a=null"])
    with pytest.raises(NumericalError, match=r"'a' runs into its rigid stop at t = 0\.523599 s"):
        simulate(scene)


def test_a_balance_beyond_a_rigid_stop_is_refused() -> None:
    with pytest.raises(CapabilityError, match=r"'a' would be at -1\.5708, beyond its rigid stop at -0\.5"):
        statics(load_scene_text(STOPPED))
    held = statics(load_scene_text(STOPPED, overrides=["initial.hold=[a]"]))
    assert held.summary["configuration"]["a"] == 0.2


def test_gains_are_not_chosen_for_joints_that_stick() -> None:
    changes = ["loops=[{name: l, type: point_on_plane, between: [base.origin, lb.com], axis: [0, 1, 0]}]"]
    scene = load_scene_text(STOPPED, overrides=[*changes, "simulate.stabilisation=baumgarte"])
    with pytest.raises(CapabilityError, match="allowed: projection, none, Baumgarte's"):
        simulate(scene)


def test_gains_are_chosen_for_couplers_alone() -> None:
    changes = [
        "couplers=[{name: mesh, terms: {a: 1, b: 2}}]",
        "robot.joints.a.limits=null",
        "initial.q.b=null",
    ]
    scene = load_scene_text(STOPPED, overrides=[*changes, "simulate.stabilisation=baumgarte"])
    assert simulate(scene).summary["baumgarte"]["alpha"] > 0.0
