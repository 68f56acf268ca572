"""One body on one joint or force element, against MSC ADAMS.

Data: Project Chrono (data/testing/joints, commit 7689fbc0; licence beside the data), every tenth sample, columns that
are zero throughout left out. A gate is three times the largest deviation of the ADAMS data themselves from an
integration in quadruple precision (springs: DOP853 at 1e-12), and never below half of their last printed digit.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import load_scene, simulate
from robodyn_cli.results.result import Result

CONFIGS = Path(__file__).parents[2] / "configs" / "benchmarks"
DATA = Path(__file__).parent / "data" / "adams_joints"
G = np.array([0.0, 0.0, -9.80665])
DIGIT = 5e-6  # of the largest value of a column: the data have six digits

# scene: data; largest deviation of the ADAMS data in Pos, Vel, Acc, Avel, Aacc, Quat, Rforce
CASES = {
    "revolute": ("Revolute", (5e-6, 5e-6, 6e-4, 5e-6, 4e-4, 5e-7, 6e-4)),
    "prismatic": ("Prismatic", (5e-4, 5e-5, 0.0, 0.0, 0.0, 0.0, 0.0)),
    "distance": ("Distance", (5e-7, 5e-7, 1e-3, 0.0, 0.0, 0.0, 1e-3)),
    "lin_actuator": ("LinActuator", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    # its accelerations, and the reaction that follows them, come with no figure: a part in 3000 of the largest
    "rot_spring": ("RotSpring", (1.3e-6, 5e-6, 1e-3, 5e-6, 6e-4, 5e-7, 1e-3)),
    "tran_spring": ("TranSpring", (5e-6, 5e-6, 5e-6, 0.0, 0.0, 0.0, 5e-5)),
}
# the same, and Rtorque, of cases whose reactions are recorded: the joint on the ground, and data beside it
RECORDED = {
    "spherical": ("Spherical", (8e-4, 3e-3, 0.0, 1e-3, 0.0, 2e-4, 1.3e-2, 0.0), "ball"),
    "universal": ("Universal", (8e-4, 3e-3, 0.0, 1e-3, 0.0, 2e-4, 1.3e-2, 0.0), "cross"),
    "cylindrical": ("Cylindrical", (5e-4, 5e-5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), "sleeve"),
    "rev_spherical": ("RevSpherical", (5e-6, 1.4e-5, 0.0, 3e-5, 0.0, 7e-7, 3e-3, 4e-3), "hinge"),
}
DEVIATIONS = {name: case[1] for name, case in (CASES | RECORDED).items()}
FILES = {name: case[0] for name, case in (CASES | RECORDED).items()}
QUANTITIES = ("Pos", "Vel", "Acc", "Avel", "Aacc", "Quat", "Rforce", "Rtorque")
FORCE = {"lin_actuator": "RforceA"}
every = pytest.mark.parametrize("name", [*CASES, *RECORDED])


@lru_cache
def adams(name: str) -> dict[str, np.ndarray]:
    """Return the columns of a case by name."""
    path = DATA / f"{FILES[name]}.csv"
    with open(path, encoding="utf-8") as stream:
        head = stream.readline().strip().split(",")
    return dict(zip(head, np.loadtxt(path, delimiter=",", skiprows=1).T))


def column(name: str, quantity: str, axes: str = "xyz") -> np.ndarray:
    """Return the vectors of a quantity (T, 3)."""
    data = adams(name)
    zero = np.zeros_like(data["t"])
    return np.column_stack([data.get(f"{quantity}.{axis}", zero) for axis in axes])


@lru_cache
def ours(name: str) -> Result:
    return simulate(load_scene(CONFIGS / f"adams_{name}.yaml"))


def accelerations(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the accelerations of the centre of mass and of the attitude (T, 3) from q'' and the twist."""
    found = ours(name)
    omega, r, qdd = found["frames/body/twist"][:, :3], found["frames/body/position"], found["qdd"]
    if name in ("revolute", "rot_spring"):
        alpha = qdd * np.array([0.0, 1.0, 0.0])
        return np.cross(alpha, r) + np.cross(omega, np.cross(omega, r)), alpha
    return (qdd if qdd.shape[1] == 3 else qdd * np.array([0.0, 0.0, 1.0])), np.zeros_like(r)


def gate(name: str, quantity: str) -> float:
    deviation = DEVIATIONS[name][QUANTITIES.index(quantity)]
    largest = max(
        (np.abs(x).max() for key, x in adams(name).items() if key.startswith(quantity)), default=0.0
    )
    return float(max(3.0 * deviation, DIGIT * largest, 1e-12))


def compare(name: str, quantity: str, found: np.ndarray) -> None:
    key = FORCE.get(name, quantity) if quantity == "Rforce" else quantity
    assert np.abs(found[::10] - column(name, key)).max() <= gate(name, quantity), quantity


@every
def test_motion_of_the_body(name: str) -> None:
    found = ours(name)
    assert np.abs(found.time[::10] - adams(name)["t"]).max() < 1e-12
    compare(name, "Pos", found["frames/body/position"])
    compare(name, "Vel", found["frames/body/twist"][:, 3:])
    compare(name, "Avel", found["frames/body/twist"][:, :3])


@pytest.mark.parametrize("name", CASES)
def test_accelerations(name: str) -> None:
    linear, angular = accelerations(name)
    compare(name, "Acc", linear)
    compare(name, "Aacc", angular)


@every
def test_attitude(name: str) -> None:
    """Quaternions q and -q are one attitude."""
    theirs = np.column_stack([adams(name)[f"Quat.e{k}"] for k in range(4)])
    mine = ours(name)["frames/body/quaternion"][::10]
    overlap = np.abs(np.sum(theirs * mine, axis=1))
    assert np.abs(overlap - 1.0).max() <= gate(name, "Quat")


@pytest.mark.parametrize("name", CASES)
def test_reactions(name: str) -> None:
    """What the joint alone bears is m (g - a) of the body on the ground; a bar and an actuator report it themselves."""
    found = ours(name)
    if name == "distance":
        # the multiplier is the force that pushes the ends of the bar apart, the first of which is on the ground
        along = found["frames/body/position"] / 2.0
        force = -found["constraints/multipliers"] * along
    elif name == "lin_actuator":
        force = found["tau"] * np.array([0.0, 0.0, 1.0])
    elif name == "tran_spring":
        q, qd = found["q"], found["qd"]
        force = (10.0 * q + 0.5 * qd) * np.array([0.0, 0.0, 1.0])
    else:
        force = G - accelerations(name)[0]
        if name == "prismatic":
            force[:, 2] = 0.0  # along the guide there is nothing that could bear
    compare(name, "Rforce", force)


@pytest.mark.parametrize("name", RECORDED)
def test_recorded_reactions(name: str) -> None:
    """The force and the moment of the first link on the ground, about the joint's origin; theirs of the ground's point."""
    wrench = -ours(name)[f"reactions/{RECORDED[name][2]}"][::10]
    suffix = "_Body1" if name == "rev_spherical" else ""
    force, moment = column(name, f"Rforce{suffix}"), column(name, f"Rtorque{suffix}")
    assert np.abs(wrench[:, :3] - force).max() <= gate(name, "Rforce")
    if name != "cylindrical":
        assert np.abs(wrench[:, 3:] - moment).max() <= gate(name, "Rtorque")


def test_force_of_the_ball_joint_at_the_end_of_the_rod() -> None:
    """Theirs is the force on the body."""
    found = ours("rev_spherical")["reactions/ball"][::10]
    assert np.abs(found[:, :3] - column("rev_spherical", "Rforce_Body2")).max() <= gate(
        "rev_spherical", "Rforce"
    )
    assert np.abs(found[:, 3:]).max() <= 1e-9


def test_torque_of_the_spring_in_the_hinge() -> None:
    """k theta + c theta', on the ground, about the hinge's axis."""
    found = ours("rot_spring")
    torque = (200.0 * found["q"] + 10.0 * found["qd"])[::10, 0]
    assert np.abs(torque - adams("rot_spring")["Rtorque.y"]).max() <= 3 * 1.4e-4
