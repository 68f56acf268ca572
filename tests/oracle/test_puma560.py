"""Puma 560 in standard D-H: gears, rotors, friction on the motor side and a wrench at the tip.

Parameters: Corke and Armstrong-Helouvry, ICRA 1994. Published torques (tolerance 1e-4):
robotics-toolbox-python, tests/test_DHRobot.py. Full digits: recursive Newton-Euler in 40 digits.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.algorithms.kinematics import point_jacobian, poses, transforms
from robodyn_cli.model.build import build_model
from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.torques.dynamics import ForwardDynamics, InverseDynamics
from robodyn_cli.works.inverse import inverse
from tests.numeric import assert_close, real

# d, a, alpha, mass, centre of mass, moments of inertia, rotor inertia, gear ratio, viscous, Coulomb + and -
LINKS = [
    (0.67183, 0, "90 deg", 0, (0, 0, 0), (0, 0.35, 0), 200e-6, -62.6111, 1.48e-3, 0.395, -0.435),
    (0, 0.4318, "0", 17.4, (-0.3638, 0.006, 0.2275), (0.13, 0.524, 0.539),
     200e-6, 107.815, 0.817e-3, 0.126, -0.071),
    (0.15005, 0.0203, "-90 deg", 4.8, (-0.0203, -0.0141, 0.070), (0.066, 0.086, 0.0125),
     200e-6, -53.7063, 1.38e-3, 0.132, -0.105),
    (0.4318, 0, "90 deg", 0.82, (0, 0.019, 0), (1.8e-3, 1.3e-3, 1.8e-3),
     33e-6, 76.0364, 71.2e-6, 11.2e-3, -16.9e-3),
    (0, 0, "-90 deg", 0.34, (0, 0, 0), (0.3e-3, 0.4e-3, 0.3e-3), 33e-6, 71.923, 82.6e-6, 9.26e-3, -14.5e-3),
    (0, 0, "0", 0.09, (0, 0, 0.032), (0.15e-3, 0.15e-3, 0.04e-3), 33e-6, 76.686, 36.7e-6, 3.96e-3, -10.5e-3),
]  # fmt: skip
QN = (0, np.pi / 4, np.pi, 0, np.pi / 4, 0)
ZERO, ONE, FIVE = (0.0,) * 6, (1.0,) * 6, (5.0,) * 6


def puma(gravity: float = 9.81, friction: bool = True, rest: str = "") -> Scene:
    joints, links = [], []
    for k, (d, a, alpha, m, r, I, Jm, G, B, plus, minus) in enumerate(LINKS, 1):
        loss = f", friction: {{viscous: {B}, coulomb: {{positive: {plus}, negative: {minus}}}, side: motor}}"
        joints.append(
            f"{{name: q{k}, type: revolute, a: {a}, alpha: {alpha}, d: {d}, gear_ratio: {G}, "
            f"rotor_inertia: {Jm}{loss if friction else ''}}}"
        )
        links.append(
            f"{{name: link{k}, mass: {m}, com: {list(r)}, com_frame: link, "
            f"inertia: {{xx: {I[0]}, yy: {I[1]}, zz: {I[2]}}}}}"
        )
    return load_scene_text(
        f"schema: 1\ngravity: [0, 0, {-gravity}]\nrobot:\n  convention: standard\n  joints:\n"
        + "".join(f"    - {x}\n" for x in joints) + "  links:\n" + "".join(f"    - {x}\n" for x in links)
        + "  points: {tip: {link: link6, at: end}}\n" + rest
    )  # fmt: skip


# name: q, qd, qdd, gravity, friction, published torques or None, full digits
CASES = {
    "P0": (QN, ZERO, ZERO, 9.81, True, (0, 31.6399, 6.0351, 0, 0.0283, 0),
           (0, 31.63988037835712, 6.035138023010512, 0, 0.0282528, 0)),
    "P1": (QN, ZERO, ONE, 9.81, True, (3.35311, 36.0025, 7.42596, 0.190043, 0.203441, 0.194133),
           (3.353110858063024, 36.0025112439757, 7.42596407735027, 0.1900430345668969, 0.2034409311134147,
            0.1941327899392475)),
    "P2": (QN, ONE, ONE, 9.81, True, (32.4952, 60.867, 17.7436, 1.45452, 1.29911, 0.713781),
           (32.4952427549307, 60.8669884751363, 17.74359491276432, 1.454519026079709, 1.299110410537887,
            0.7137808874836949)),
    "P3": (QN, ONE, ZERO, 9.81, True, (29.1421, 56.5044, 16.3528, 1.26448, 1.12392, 0.519648),
           (29.14213189686768, 56.50435760951772, 16.35276885842456, 1.264475991512812, 1.123922279424472,
            0.5196480975444475)),
    "P4": (QN, ONE, ONE, 0.0, True, (32.4952, 29.2271, 11.7085, 1.45452, 1.27086, 0.713781),
           (32.4952427549307, 29.22710809677918, 11.70845688975381, 1.454519026079709, 1.270857610537887,
            0.7137808874836949)),
    "P6": (ZERO, FIVE, ONE, 9.81, True, None,
           (-0.469565683479, 84.213300886625, 47.996628764299, 3.10394445460944, 3.046597080334,
            1.576977332034)),
    "P7": (ZERO, ZERO, ZERO, 9.81, True, None, (0, 37.48366665, 0.24892875, 0, 0, 0)),
    "P8": (ZERO, FIVE, ONE, 9.81, False, None,
           (-54.210059023233, 23.1442676775, 21.005267212438, 0.19411062612368, 0.244174995657,
            0.194184505668)),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_torques(case: str) -> None:
    q, qd, qdd, gravity, friction, published, digits = CASES[case]
    dynamics = InverseDynamics(puma(gravity, friction))
    tau = dynamics(*(np.array([x], dtype=float) for x in (q, qd, qdd)))[0]
    # the digits of P6 and P8 end at 1e-12
    assert np.abs(tau - np.array(digits)).max() < 2e-12 + 1e-13 * np.abs(digits).max()
    if published is not None:
        assert np.abs(tau - np.array(published)).max() < 1e-4


def test_wrench_at_the_tip() -> None:
    """P5: the end-effector exerts (1, 2, 3, 1, 2, 3) on its surroundings, in frame 6."""
    scene = puma()
    model = build_model(scene)
    q = [float(x) for x in QN]
    pose = poses(model, transforms(model, q))
    frame = model.points["tip"]
    linear, angular = point_jacobian(model, q, pose, frame.body, pose[frame.body].point(frame.p))
    R = pose[frame.body].R @ frame.R
    f, n = R @ np.array([1.0, 2.0, 3.0]), R @ np.array([1.0, 2.0, 3.0])
    rest = InverseDynamics(scene)(*(np.array([x], dtype=float) for x in (QN, ZERO, ZERO)))[0]
    tau = rest + real(linear.T @ f + angular.T @ n)
    published = [0.642756, 29.0866, 4.70321, 2.82843, -1.97175, 3]
    digits = [0.6427562971492311, 29.08664003275677, 4.703212509875562, 2.82842712474619, -1.9717472, 3]
    assert np.abs(tau - published).max() < 1e-4
    assert np.abs(tau - digits).max() < 1e-13 * 30


def test_the_scenes() -> None:
    configs = Path(__file__).parents[2] / "configs" / "benchmarks"
    start = inverse(load_scene(configs / "puma560.yaml"))
    assert_close(start["tau"][0], CASES["P2"][-1], 1e-14)
    held = inverse(load_scene(configs / "puma560_hold.yaml"))
    assert np.abs(held["tau"] - np.array(CASES["P0"][-1])).max() < 1e-12


def test_forward_dynamics_takes_the_torques_back() -> None:
    rng = np.random.default_rng(0)
    q, qd, qdd = (rng.uniform(-2, 2, size=(50, 6)) for _ in range(3))
    scene = puma()
    tau = InverseDynamics(scene)(q, qd, qdd)
    assert_close(ForwardDynamics(scene)(q, qd, tau), qdd, 1e-13)


def test_the_command_gives_the_same_torques() -> None:
    motion = ", ".join(f'q{k + 1}: "{x!r} + 0.5*t^2 + t"' for k, x in enumerate(map(float, QN)))
    result = inverse(puma(rest=f"trajectory: {{type: joint, duration: 1, q: {{{motion}}}}}\n"), samples=11)
    assert_close(result["tau"][0], CASES["P2"][-1], 1e-14)
    assert set(result.group("torque_terms")) == {"inertia", "coriolis", "gravity", "friction"}
    friction = [G**2 * B + abs(G) * plus for *_, G, B, plus, _ in LINKS]
    assert_close(result["torque_terms/friction"][0], friction, 1e-14)
    assert result.summary["round_trip"] < 1e-13
