"""A point led by an arm that carries what a coupler ties: the arm moves as an open chain, the fingers rest."""

from __future__ import annotations

import pytest

from robodyn_cli import inverse, kinematics, load_scene_text
from robodyn_cli.errors import SceneError
from tests.numeric import assert_close

ARM = ("a", "b", "c")
FINGERS = ("left", "right")
SCENE = (
    "schema: 1\ngravity: [0, -9.81, 0]\nrobot:\n  joints:\n"
    "    - {name: a, type: revolute, parent: base, link: one, axis: [0, 0, 1]}\n"
    "    - {name: b, type: revolute, parent: one, link: two, axis: [0, 0, 1], origin: {xyz: [1, 0, 0]}}\n"
    "    - {name: c, type: revolute, parent: two, link: hand, axis: [0, 0, 1], origin: {xyz: [0.8, 0, 0]}}\n"
    "    - {name: left, type: TYPE, parent: hand, link: thumb, axis: [0, 1, 0], origin: {xyz: [0.2, THUMB, 0]}}\n"
    "    - {name: right, type: TYPE, parent: hand, link: digit, axis: [0, -1, 0], origin: {xyz: [0.2, DIGIT, 0]}}\n"
    "  links:\n"
    "    - {name: one, mass: 2, com: [0.5, 0, 0], inertia: {zz: 0.1}}\n"
    "    - {name: two, mass: 1.5, com: [0.4, 0, 0], inertia: {zz: 0.08}}\n"
    "    - {name: hand, mass: 1, com: [0.1, 0, 0], inertia: {zz: 0.01}}\n"
    "    - {name: thumb, mass: 0.2, com: [0, 0, 0], inertia: {zz: 1e-4}}\n"
    "    - {name: digit, mass: 0.3, com: [0, 0, 0], inertia: {zz: 1e-4}}\n"
    "  points: {tip: {link: hand, at: [0.3, 0, 0]}}\n"
    "initial: {q: {a: 0.4, b: 0.9, c: -0.5}}\n"
    "trajectory: {type: cartesian, point: tip, duration: 1, position: [1.2 + 0.2*t^2, 1.2 - 0.3*t^2]}\n"
    "inverse: {samples: 21}\nkinematics: {samples: 21}\n"
)
OPEN = (
    SCENE.replace("THUMB", "0.03")
    .replace("DIGIT", "-0.03")
    .replace("TYPE", "fixed")
    .replace(", axis: [0, 1, 0]", "")
    .replace(", axis: [0, -1, 0]", "")
)
GRIPPER = (
    SCENE.replace("THUMB", "0").replace("DIGIT", "0").replace("TYPE", "prismatic").replace(
        "c: -0.5}", "c: -0.5, left: 0.03}"
    )
    + "couplers: [{name: mimic, terms: {right: 1, left: -1}}]\n"
)  # fmt: skip


def test_the_arm_moves_as_it_does_with_fixed_fingers() -> None:
    fixed, whole = inverse(load_scene_text(OPEN)), inverse(load_scene_text(GRIPPER))
    names = list(whole.variables["q"].names)
    arm, fingers = ([names.index(name) for name in some] for some in (ARM, FINGERS))
    for key in ("q", "qd", "qdd", "tau"):
        assert_close(whole[key][:, arm], fixed[key], 1e-10)
    assert_close(whole["q"][:, fingers], 0.03 + 0.0 * whole["q"][:, fingers], 1e-15)
    assert not whole["qd"][:, fingers].any()
    assert not whole["tau"][:, names.index("right")].any(), "the follower of a coupler has no actuator"
    assert whole.summary["round_trip"] < 1e-10
    moved = kinematics(load_scene_text(GRIPPER))
    assert_close(moved["q"][:, arm], fixed["q"], 1e-10)


def test_a_chain_that_a_coupler_ties_is_a_mechanism() -> None:
    tied = GRIPPER.replace("{right: 1, left: -1}", "{right: 1, c: -1}")
    with pytest.raises(SceneError, match="the scene must say which joints drive"):
        inverse(load_scene_text(tied))
