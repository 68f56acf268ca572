"""Springs, friction, gears and stops in joints with several coordinates, and in ball joints and free bodies.

A joint with several coordinates is compared with a chain of joints with one each, whose links between have no mass: the
same forces have to give the same motion.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import RobodynError, SceneError
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.scene.robot_types import FREEDOMS
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate

BODY = "mass: 2.1, com: [0.11, -0.07, 0.23], inertia: {xx: 0.05, yy: 0.07, zz: 0.04, xy: 0.004, xz: -0.003, yz: 0.006}"
PLACE = "origin: {xyz: [0.3, -0.2, 0.1], rpy: [0.4, -0.3, 0.8]}"
AXES = {
    "theta1": [0, 0, 1],
    "theta2": [1, 0, 0],
    "theta": [0, 0, 1],
    "d": [0, 0, 1],
    "x": [1, 0, 0],
    "y": [0, 1, 0],
}
ORDER = {"universal": ("theta1", "theta2"), "cylindrical": ("theta", "d"), "planar": ("x", "y", "theta")}
START = {"theta1": 0.3, "theta2": -0.5, "theta": 0.4, "d": 0.2, "x": 0.1, "y": -0.15}
RATE = {"theta1": 1.1, "theta2": -0.7, "theta": -1.3, "d": 0.5, "x": 0.6, "y": -0.4}


def scene(kind: str, forces: dict[str, str], wide: bool, more: str = "") -> str:
    """Return a body on a joint with several coordinates, or on a chain of joints with one each."""
    names = ORDER[kind]
    if wide:
        axes = {"universal": "axis: [0, 0, 1], axis2: [1, 0, 0]", "cylindrical": "axis: [0, 0, 1]",
                "planar": "axis: [0, 0, 1], axis2: [1, 0, 0]"}[kind]  # fmt: skip
        given: dict[str, list[str]] = {}
        for name in names:
            for key, value in (part.split("=", 1) for part in forces[name].split("; ")):
                given.setdefault(key, []).append(f"{name}: {value}")
        keys = "".join(f", {key}: {{{', '.join(values)}}}" for key, values in given.items())
        joints = [f"{{name: j, type: {kind}, link: body, {PLACE}, {axes}{keys}}}"]
        links = [f"{{name: body, {BODY}}}"]
        column = "j: {%s}"
        q, qd = (column % ", ".join(f"{n}: {table[n]}" for n in names) for table in (START, RATE))
    else:
        joints, links = [], []
        for k, name in enumerate(names):
            sort = "revolute" if name.startswith("theta") else "prismatic"
            place = f"{PLACE}, " if k == 0 else ""
            keys = "".join(
                f", {key}: {value}"
                for key, value in (part.split("=", 1) for part in forces[name].split("; "))
            )
            joints.append(f"{{name: {name}, type: {sort}, {place}axis: {AXES[name]}{keys}}}")
            links.append(f"{{name: l{k}, mass: 0}}" if k + 1 < len(names) else f"{{name: body, {BODY}}}")
        q, qd = (", ".join(f"{n}: {table[n]}" for n in names) for table in (START, RATE))
    return (
        f"schema: 1\ngravity: [0.3, -0.5, -9.7]\nrobot:\n  joints:\n    - {joints[0]}\n"
        + "".join(f"    - {joint}\n" for joint in joints[1:])
        + "  links:\n" + "".join(f"    - {link}\n" for link in links)
        + f"initial: {{q: {{{q}}}, qd: {{{qd}}}}}\nsimulate: {{duration: 0.6, samples: 61}}\n" + more
    )  # fmt: skip


SMOOTH = "spring={stiffness: %g, rest: %g}; damper={damping: %g}; friction={viscous: 0.2, coulomb: 0.3, transition_speed: 0.05}"
LAWS = {
    "smooth": [SMOOTH % (60 + 7 * k, 0.1 * k - 0.1, 0.4 + 0.1 * k) for k in range(3)],
    "rotors": [f"gear_ratio={20 - 45 * k}; rotor_inertia={1e-3 / (1 + 3 * k)}; "
               "friction={viscous: 2e-3, coulomb: 1e-2, side: motor, transition_speed: 0.1}" for k in range(3)],
    "stops": ["limits={lower: -0.2, upper: 0.35, stop: {stiffness: 2e3, damping: 10}}"] * 3,
    "rigid": ["limits={lower: -0.7, upper: 0.45, stop: {restitution: 0.4}}; spring={stiffness: 40}"] * 3,
    "stick": ["friction={coulomb: 1.5, static: 2, law: set_valued}; damper={damping: 1}; spring={stiffness: 50}"] * 3,
}  # fmt: skip


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", ORDER)
def test_a_wide_joint_moves_like_a_chain_of_single_ones(kind: str, law: str) -> None:
    forces = dict(zip(ORDER[kind], LAWS[law]))
    one, chain = (simulate(load_scene_text(scene(kind, forces, wide))) for wide in (True, False))
    assert np.abs(one["q"] - chain["q"]).max() < 1e-8
    assert (
        np.abs(one["energy/potential"] - chain["energy/potential"]).max()
        < 1e-7 * np.abs(chain["energy/potential"]).max()
    )
    for result in (one, chain):
        assert result.summary["energy_drift_relative"] < 1e-7


@pytest.mark.parametrize("kind", ORDER)
def test_torques_of_a_wide_joint_are_those_of_a_chain(kind: str) -> None:
    """Every element at once, gears with losses too."""
    elements = (
        "spring={stiffness: 9, rest: 0.2}; friction={viscous: 1e-3, coulomb: {positive: 0.02, negative: -0.03}, "
        "side: motor}; gear_ratio=-30; rotor_inertia=2e-3; gear={efficiency: 0.8, back_driving: 0.6}; "
        "limits={upper: 0.2, stop: {stiffness: 300, law: hunt_crossley, exponent: 1.5, damping: 3}}"
    )
    forces = dict.fromkeys(ORDER[kind], elements)
    path = "trajectory: {type: joint, duration: 2, q: {%s}}\ninverse: {samples: 201}\n"
    formulas = {
        name: f"{START[name]} + {0.2 + 0.1 * k} * sin({3 + k} * t)" for k, name in enumerate(ORDER[kind])
    }
    inside = ", ".join(f"{name}: {formula}" for name, formula in formulas.items())
    one = inverse(load_scene_text(scene(kind, forces, True, path % f"j: {{{inside}}}")))
    chain = inverse(load_scene_text(scene(kind, forces, False, path % inside)))
    size = np.abs(chain["tau"]).max()
    assert size > 1.0
    assert np.abs(one["tau"] - chain["tau"]).max() < 1e-12 * size
    for term in ("passive", "friction", "gear", "stops"):
        found = one[f"torque_terms/{term}"]
        assert np.abs(found).max() > 0.0
        assert np.abs(found - chain[f"torque_terms/{term}"]).max() < 1e-12 * size


BALL = """
schema: 1
gravity: [0.3, -0.5, -9.7]
robot:
  joints: [{name: ball, type: %s, origin: {xyz: [0.3, -0.2, 0.1], rpy: [0.4, -0.3, 0.8]}, %s}]
  links: [{name: body, %s}]
initial: {q: {ball: {%s}}, qd: {ball: [%s]}}
simulate: {duration: 1, samples: 101}
"""
SPRUNG = "spring: {stiffness: 21, rest: [0.5, -0.2, 0.4]}, damper: {damping: 0.3}, friction: {viscous: 0.1, coulomb: 0.2, transition_speed: 0.05}"


def ball(forces: str, qd: str = "1.1, -2, 0.7") -> str:
    return BALL % ("spherical", forces, BODY, "rpy: [0.3, -0.4, 0.2]", qd)


def test_a_spring_in_a_ball_joint_pulls_back_along_the_rotation_vector() -> None:
    """The torque is -k phi in the body's axes, and the gradient of k phi^2 / 2; phi by the angle and axis of R0^T R."""
    from scipy.spatial.transform import Rotation

    problem = Problem(load_scene_text(ball(SPRUNG)))
    rng = np.random.default_rng(3)
    for _ in range(20):
        turn = Rotation.random(random_state=rng)
        x, y, z, w = turn.as_quat()
        v = rng.normal(size=3)
        phi = (Rotation.from_rotvec([0.5, -0.2, 0.4]).inv() * turn).as_rotvec()
        speed = np.linalg.norm(v)
        terms = problem.passive_forces(smooth=True)
        q = np.array([w, x, y, z])
        passive = problem.numbers(terms["passive"], q, v=v)
        assert np.abs(passive - (-21 * phi - 0.3 * v)).max() < 1e-12 * 21 * np.pi
        friction = problem.numbers(terms["friction"], q, v=v)
        assert np.abs(friction + 0.1 * v + 0.2 * np.tanh(speed / 0.05) * v / speed).max() < 1e-13
        still = problem.numbers(terms["friction"], q, v=1e-3 * v)
        slow = np.tanh(1e-3 * speed / 0.05) * v / speed
        assert np.abs(still + 1e-4 * v + 0.2 * slow).max() < 1e-15
        exact = problem.numbers(problem.joint_forces(smooth=False)["friction"], q, v=v)
        assert np.abs(exact + 0.1 * v + 0.2 * v / speed).max() < 1e-14
        stored = problem.numbers([problem.potential], q)[0]
        still_sprung = 10.5 * phi @ phi
        R = Rotation.from_euler("xyz", [0.4, -0.3, 0.8]).as_matrix()
        height = np.array([0.3, -0.2, 0.1]) + R @ turn.as_matrix() @ np.array([0.11, -0.07, 0.23])
        assert stored == pytest.approx(still_sprung - 2.1 * np.dot([0.3, -0.5, -9.7], height), rel=1e-12)
    at_rest = problem.numbers(problem.joint_forces(smooth=False)["friction"], np.array([1.0, 0, 0, 0]))
    assert not at_rest.any()


@pytest.mark.parametrize("kind", ["spherical", "floating"])
def test_energy_is_balanced_in_a_ball_joint_and_a_free_body(kind: str) -> None:
    if kind == "spherical":
        text = ball(SPRUNG)
    else:
        forces = (
            "spring: {translation: {stiffness: 90, rest: [0.1, 0, 0.2]}, rotation: {stiffness: 11}}, damper: "
            "{translation: {damping: 0.6}, rotation: {damping: 0.1}}, friction: {translation: {coulomb: 0.4, "
            "transition_speed: 0.1, static: 0.6, stribeck_speed: 0.3}}"
        )
        text = BALL % (
            "floating",
            forces,
            BODY,
            "xyz: [0, 0.1, 0], rpy: [0.3, -0.4, 0.2]",
            "1, 0.4, -1, 0.6, -0.7, 1",
        )
    result = simulate(load_scene_text(text))
    assert result.summary["status"] == "ok"
    assert result.summary["energy_drift_relative"] < 1e-9
    total = result["energy/kinetic"] + result["energy/potential"]
    assert total[-1] < total[0] - 0.1  # something is lost


def test_the_spring_of_a_ball_joint_about_one_axis_is_that_of_a_hinge() -> None:
    body = "mass: 1.3, com: [0, 0, 0.1], inertia: {xx: 0.02, yy: 0.03, zz: 0.01, xy: 0, xz: 0, yz: 0}"
    forces = "damper: {damping: 0.02}, spring: {stiffness: 0.4, rest: %s}"
    start = "initial: {q: {j: %s}, qd: {j: %s}}\nsimulate: {duration: 3, samples: 31}"
    head = (
        "schema: 1\ngravity: [0, 0, -9.81]\nrobot:\n  joints: [{name: j, %s}]\n  links: [{name: b, "
        + body
        + "}]\n"
    )
    free = simulate(load_scene_text(
        head % ("type: spherical, " + forces % "[0, 0, 20 deg]")
        + start % ("{rotation_vector: [0, 0, 0.8]}", "[0, 0, 1.5]")
    ))  # fmt: skip
    hinge = simulate(load_scene_text(
        head % ("type: revolute, axis: [0, 0, 1], " + forces % "20 deg") + start % ("0.8", "1.5")
    ))  # fmt: skip
    angle = 2.0 * np.arctan2(free["q"][:, 3], free["q"][:, 0])
    assert np.abs(angle - hinge["q"][:, 0]).max() < 1e-9


def test_a_rotor_of_a_ball_joint_is_an_inertia_about_all_axes() -> None:
    """On the ground it is the same as one of the link; along a motion and in the torques of one."""
    more = "trajectory: {type: joint, duration: 1, q: {ball: {rpy: [sin(t), 0.3*t, cos(t)]}}}\n"
    moments = dict(re.findall(r"(xx|yy|zz): ([\d.]+)", BODY))
    heavy = re.sub(r"(xx|yy|zz): [\d.]+", lambda m: f"{m[1]}: {float(moments[m[1]]) + 0.7}", BODY)
    texts = ball(f"rotor_inertia: 0.7, {SPRUNG}") + more, ball(SPRUNG).replace(BODY, heavy) + more
    rotor, link = (simulate(load_scene_text(text)) for text in texts)
    assert np.abs(rotor["q"] - link["q"]).max() < 1e-9
    assert (
        np.abs(rotor["energy/kinetic"] - link["energy/kinetic"]).max() < 1e-9 * link["energy/kinetic"].max()
    )
    assert rotor.summary["energy_drift_relative"] < 1e-9
    rotor, link = (inverse(load_scene_text(text)) for text in texts)
    assert np.abs(rotor["tau"] - link["tau"]).max() < 1e-13 * np.abs(link["tau"]).max()


def test_passing_half_a_turn_is_said() -> None:
    result = simulate(load_scene_text(ball("spring: {stiffness: 1}", "0, 0, 30").replace("-9.7]", "0]")))
    assert any("half a turn" in text for text in result.summary["warnings"])


REFUSED = {
    "spring: {stiffness: 1}": ("universal", "robot.joints.0.spring", "belongs to one of its coordinates"),
    "spring: {theta1: {stiffness: 1}, theta3: {stiffness: 1}}": ("universal", "spring.theta3", "did you mean"),
    "spring: {theta1: {stiffness: 1}, y: {stiffness: 2}}": ("universal", "robot.joints.0.spring.y", "allowed: theta1, theta2"),
    "spring: {theta: {stiffness: 1}}": ("revolute", "robot.joints.0.spring.theta", "without a coordinate"),
    "spring: {theta1: {stiffness: 1, rest: [1, 2, 3]}}": ("universal", "rest", "must be one number"),
    "gear_ratio: 5": ("universal", "robot.joints.0.gear_ratio", "belongs to one of its coordinates"),
    "gear_ratio: {theta1: 0}": ("universal", "robot.joints.0.gear_ratio.theta1", "must not be zero"),
    "rotor_inertia: {x: 1}": ("universal", "robot.joints.0.rotor_inertia.x", "allowed: theta1, theta2"),
    "gear_ratio: {theta: 2}": ("revolute", "robot.joints.0.gear_ratio", "allowed: a number"),
    "rotor_inertia: 1": ("floating", "robot.joints.0.rotor_inertia", "takes no"),
    "rotor_inertia: {wx: 1}": ("spherical", "robot.joints.0.rotor_inertia", "allowed: a number"),
    "gear_ratio: 2": ("spherical", "robot.joints.0.gear_ratio", "takes no"),
    "limits: {upper: 1}": ("spherical", "robot.joints.0.limits", "acts on one coordinate"),
    "gear: {efficiency: 0.5}": ("spherical", "robot.joints.0.gear", "acts on one coordinate"),
    "spring: {stiffness: 1, rest: 1}": ("spherical", "robot.joints.0.spring.rest", "three numbers"),
    "friction: {coulomb: 1, law: set_valued}": ("spherical", "robot.joints.0.friction.law", "single coordinates"),
    "friction: {coulomb: {positive: 1, negative: -2}}": ("spherical", "friction.coulomb", "no forwards"),
    "friction: {viscous: 1, side: motor}": ("spherical", "friction.side", "no gear"),
    "damper: {damping: 1}": ("floating", "robot.joints.0.damper", "translation, rotation"),
}  # fmt: skip


@pytest.mark.parametrize("given", REFUSED)
def test_what_makes_no_sense_is_refused(given: str) -> None:
    kind, place, says = REFUSED[given]
    axis = "axis: [0, 0, 1], " if kind in ("universal", "revolute") else ""
    text = f"schema: 1\ngravity: [0, 0, 0]\nrobot:\n  joints: [{{name: j, type: {kind}, {axis}{given}}}]\n  links: [{{name: l}}]\n"
    with pytest.raises(SceneError, match=says) as refused:
        load_scene_text(text)
    assert place in str(refused.value)
    assert isinstance(refused.value, RobodynError)


def test_the_names_of_all_joints_are_known() -> None:
    assert set(FREEDOMS) == {one.name for kind in joint_types.values() for one in kind.freedoms if one.name}
