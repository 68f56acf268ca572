"""Losses of gears: in inverse dynamics by the flow of power, in simulations by the drive's torque."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.errors import CapabilityError
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.torques.dynamics import ForwardDynamics, InverseDynamics
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate

CONFIGS = Path(__file__).parents[2] / "configs"
JOINT = "robot.joints.theta1."
DRIVE = [
    JOINT + "gear_ratio=-50",
    JOINT + "rotor_inertia=2e-3",
    JOINT + "friction={viscous: 1e-3, coulomb: 0.02, side: motor}",
    JOINT + "damper={damping: 3}",
]
HOIST = """
schema: 1
gravity: [0, 0, -10]
robot:
  joints: [{name: z, type: prismatic, axis: [0, 0, 1], gear: {efficiency: 0.8, back_driving: 0.5, transition_speed: 1e-4}}]
  links: [{name: load, mass: 3, com: [0, 0, 0]}]
torques: {z: 45}
initial: {q: {z: 0}}
simulate: {duration: 1, samples: 101, integrator: dop853}
"""


def test_what_the_actuator_gives_goes_through_the_gear() -> None:
    """tau = rotor + motor friction + L / eta while it drives, eta L while it is driven."""
    ideal = inverse(load_scene(CONFIGS / "2r_circle.yaml", DRIVE))
    found = inverse(load_scene(CONFIGS / "2r_circle.yaml", [*DRIVE, JOINT + "gear={efficiency: 0.8}"]))
    qd = ideal["qd"][:, 0]
    outside = 50**2 * 2e-3 * ideal["qdd"][:, 0] + 50**2 * 1e-3 * qd + 50 * 0.02 * np.sign(qd)
    load = ideal["tau"][:, 0] - outside
    assert (load * qd > 0).any() and (load * qd < 0).any()
    expected = outside + np.where(load * qd > 0, load / 0.8, np.where(qd == 0, load, 0.8 * load))
    assert np.abs(found["tau"][:, 0] - expected).max() < 1e-11
    assert np.abs(found["torque_terms/gear"][:, 0] - (expected - ideal["tau"][:, 0])).max() < 1e-11
    assert np.abs(found["tau"][:, 1] - ideal["tau"][:, 1]).max() == 0.0
    assert np.all(found["torque_terms/gear"][:, 0] * qd >= 0.0)  # it always costs power
    assert found.summary["round_trip"] < 1e-12
    kernel = InverseDynamics(
        load_scene(CONFIGS / "2r_circle.yaml", [*DRIVE, JOINT + "gear={efficiency: 0.8}"])
    )
    assert np.abs(kernel(found["q"], found["qd"], found["qdd"]) - found["tau"]).max() < 1e-11


@pytest.mark.parametrize(
    ("torque", "acceleration"),
    [(45.0, 0.8 * 45 / 3 - 10), (12.0, 12 / 0.5 / 3 - 10)],  # the motor lifts; the load drives the motor
)
def test_a_hoist(torque: float, acceleration: float) -> None:
    found = simulate(load_scene_text(HOIST, overrides=[f"torques.z={torque}"]))
    t = found["time"]
    assert np.abs(found["q"][:, 0] - acceleration * t**2 / 2).max() < 2e-4  # the smoothed start
    late = t > 0.2
    assert np.abs(found["qdd"][late, 0] - acceleration).max() < 1e-9
    assert found.summary["energy_drift_relative"] < 1e-8


FIVE_BAR = CONFIGS / "mechanisms" / "five_bar_circle.yaml"


def test_gears_of_a_mechanism_pass_on_what_its_actuators_share() -> None:
    """L are the torques of the mechanism without rotors and motor friction; the motor gives L / eta or eta' L beside
    what its rotor and friction take."""
    eta, back, N, J, level = 0.8, 0.55, 40.0, 2e-4, 0.7
    drive = [
        f"robot.joints.left.gear={{efficiency: {eta}, back_driving: {back}}}",
        f"robot.joints.left.gear_ratio={N}",
        f"robot.joints.left.rotor_inertia={J}",
        f"robot.joints.left.friction={{coulomb: {level}, side: motor}}",
        "robot.joints.right.gear={efficiency: 0.7}",
    ]
    found, bare = inverse(load_scene(FIVE_BAR, drive)), inverse(load_scene(FIVE_BAR))
    L, v, a = bare["tau"], found["qd"], found["qdd"]
    left = np.where(L[:, 0] * v[:, 0] > 0.0, 1.0 / eta, back) * L[:, 0]
    left += N * N * J * a[:, 0] + N * level * np.sign(v[:, 0])
    assert np.abs(found["tau"][:, 0] - left).max() < 1e-9
    right = np.where(L[:, 2] * v[:, 2] > 0.0, 1.0 / 0.7, 0.7) * L[:, 2]
    assert np.abs(found["tau"][:, 2] - right).max() < 1e-9
    assert np.all(found["torque_terms/gear"] * v >= 0.0) and np.any(L[:, 0] * v[:, 0] < 0.0)
    errors = found.summary["error_estimate"]
    assert errors["round_trip"] < 1e-11 and abs(errors["energy_balance_relative"]) < 1e-3


def test_a_gear_without_an_actuator_in_a_mechanism() -> None:
    with pytest.raises(CapabilityError, match="'bend_left' has a gear with losses but no actuator"):
        inverse(load_scene(FIVE_BAR, ["robot.joints.bend_left.gear={efficiency: 0.8}"]))


def test_what_cannot_be_done_says_so() -> None:
    with pytest.raises(CapabilityError, match="transition_speed"):
        simulate(load_scene_text(HOIST.replace(", transition_speed: 1e-4", "")))
    with pytest.raises(CapabilityError, match="rotor_inertia"):
        simulate(load_scene_text(HOIST, overrides=["robot.joints.z.rotor_inertia=1"]))
    with pytest.raises(CapabilityError, match="locks itself"):
        simulate(load_scene_text(HOIST, overrides=["robot.joints.z.gear.back_driving=0"]))
    with pytest.raises(CapabilityError, match="gear"):
        ForwardDynamics(load_scene_text(HOIST))
