"""Deployments with friction that holds, with rigid stops on the way, and past poses in which loops lose rank."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import deploy, load_scene, load_scene_text, simulate
from robodyn_cli.errors import SingularConfigurationError

CONFIGS = Path(__file__).parents[2] / "configs"
FOUR_BAR = CONFIGS / "four_bar_deploy.yaml"
CRANK, ROD = 1.241, 1.2
END = 2 * np.arcsin(ROD / CRANK)  # where the rods align
BARE = ["expect={}"]


# -- one degree of freedom, by its energy -------------------------------------------------------------------
def dyad_rates(
    crank: float, rods: tuple[float, float], foot: tuple[float, float], branch: int, theta: float
) -> tuple[float, float, float]:
    """Return the coupler's angle, and the rates of coupler and follower for a crank rate of 1."""
    elbow = crank * np.array([np.cos(theta), np.sin(theta)])
    d = np.array(foot) - elbow
    r = float(np.hypot(*d))
    along = (r * r + rods[0] ** 2 - rods[1] ** 2) / (2 * r)
    pin = (
        elbow
        + (along * d + branch * np.sqrt(max(rods[0] ** 2 - along**2, 0.0)) * np.array([-d[1], d[0]])) / r
    )
    b = float(np.arctan2(*(pin - elbow)[::-1]))
    c = float(np.arctan2(*(pin - np.array(foot))[::-1]))
    rows = np.array(
        [[-rods[0] * np.sin(b), rods[1] * np.sin(c)], [rods[0] * np.cos(b), -rods[1] * np.cos(c)]]
    )
    rates = np.linalg.solve(rows, -crank * np.array([-np.sin(theta), np.cos(theta)]))
    return b, float(rates[0]), float(rates[1])


def lecture_inertia(theta: float) -> float:
    """Return the inertia that the crank of the lecture's four-bar feels."""
    b, rb, rc = dyad_rates(CRANK, (ROD, ROD), (CRANK, 0.0), 1, theta)
    J = 0.06 + 8.25 * 0.6**2
    crank = 9.6 + 20.15 * 1.2**2 + 8.25 * CRANK**2
    return float(crank + 2 * 8.25 * CRANK * 0.6 * np.cos(theta - b) * rb + J * (rb * rb + rc * rc))


def duration(
    inertia: Callable[[float], float], energy: Callable[[float], float], start: float, end: float
) -> float:
    """Return the time from start to end, the integral of sqrt(M / 2 T); both ends may be singular."""
    from scipy.integrate import quad

    middle, sign = 0.5 * (start + end), np.sign(end - start)

    def slowness(theta: float) -> float:
        return float(np.sqrt(inertia(theta) / (2 * energy(theta))))

    def from_start(s: float) -> float:
        return 2 * s * slowness(start + sign * s * s)

    def to_end(u: float) -> float:
        return 2 * u * slowness(end - sign * u * u)

    root, tail = float(np.sqrt(abs(middle - start))), 1e-4
    first = quad(from_start, 0, root, epsabs=1e-11, limit=200)[0]
    second = quad(to_end, tail, root, epsabs=1e-10, limit=200)[0]
    return float(first + second + 2 * tail * tail * slowness(end - sign * tail * tail))


def spring(theta: float) -> float:
    """Return the work that the lecture's spring can do up to an angle of the crank."""
    return 1.96 * theta - 0.05 * theta**2


# -- friction -----------------------------------------------------------------------------------------------
def test_set_valued_friction_in_the_crank_is_a_constant_torque_on_the_way() -> None:
    found = deploy(
        load_scene(FOUR_BAR, ["robot.joints.theta1.friction={law: set_valued, coulomb: 0.5}", *BARE])
    )
    lock = found.summary["lock"]
    expected = duration(lecture_inertia, lambda x: spring(x) - spring(0.01) - 0.5 * (x - 0.01), 0.01, END)
    assert found.status == "locked" and lock["kind"] == "dead_point"
    assert lock["time"] == pytest.approx(expected, abs=2e-6)
    assert lock["angles"]["theta1"] == pytest.approx(END, abs=1e-11)
    assert found.summary["transitions"]["slip"] >= 1
    assert found.summary["energy_drift_relative"] < 1e-9
    assert lock["time_error"] < 1e-9 and found.summary["error_estimate"]["state_max"] < 1e-8


def test_smooth_friction_tends_to_the_set_valued_one() -> None:
    exact = deploy(
        load_scene(FOUR_BAR, ["robot.joints.theta1.friction={law: set_valued, coulomb: 0.5}", *BARE])
    )
    apart = []
    for speed in (1e-3, 1e-4):
        law = f"robot.joints.theta1.friction={{coulomb: 0.5, transition_speed: {speed}}}"
        smooth = deploy(load_scene(FOUR_BAR, [law, "simulate.error_estimate=false", *BARE]))
        apart.append(exact.summary["lock"]["time"] - smooth.summary["lock"]["time"])
    assert 0.0 < apart[1] < 0.2 * apart[0] and apart[0] < 1e-2


def test_a_crank_that_sticks_on_the_way_locks_later() -> None:
    """The drive pauses from 6 to 20 s, in which friction stops the crank and holds it."""
    torque = "torques={theta1: 'if(t < 6, 1.96 - 0.1*theta1, if(t < 20, 0, 1.96 - 0.1*theta1))'}"
    law = "robot.joints.theta1.friction={law: set_valued, coulomb: 0.8, static: 1.0}"
    changes = [torque, law, "simulate.duration=40", "simulate.samples=4001", *BARE]
    found = deploy(load_scene(FOUR_BAR, changes))
    lock, counts = found.summary["lock"], found.summary["transitions"]
    assert found.status == "locked" and counts["stick"] == 1 and counts["slip"] >= 2
    held = found["qd"][(found.time > 19) & (found.time < 20), 0]
    assert len(held) and np.abs(held).max() < 1e-14
    # the multipliers are those of the state of contact: the motor does not work, and friction holds
    assert np.abs(found["qdd"][(found.time > 19) & (found.time < 20)]).max() < 1e-12
    stop = load_scene(
        FOUR_BAR, [*changes, "command=simulate", "expect=null", f"simulate.duration={lock['time']!r}"]
    )
    again = simulate(stop)
    assert again["q"][-1, 0] == pytest.approx(END, abs=1e-9)
    same = [e for e in again.events if e["time"] < lock["time"] - 1e-6]
    others = [e for e in found.events if e["kind"] in ("stick", "slip") and e["time"] < lock["time"] - 1e-6]
    assert [(e["kind"], e["name"]) for e in same] == [(e["kind"], e["name"]) for e in others]
    assert [e["time"] for e in same] == pytest.approx([e["time"] for e in others], abs=1e-9)


def test_friction_that_never_lets_go_means_no_lock() -> None:
    law = "robot.joints.theta1.friction={law: set_valued, coulomb: 2.5}"
    found = deploy(load_scene(FOUR_BAR, [law, *BARE]))
    assert found.status == "no_lock" and np.ptp(found["q"][:, 0]) < 1e-15


# -- stops --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("restitution", [0.0, 0.6, 1.0])
def test_a_rigid_stop_is_hit_before_the_lock(restitution: float) -> None:
    """The crank swings back against a stop, and the spring takes it from there to the lock."""
    start, stop, rate = 1.0, 0.5, -0.5
    found = deploy(
        load_scene(
            FOUR_BAR,
            [
                f"robot.joints.theta1.limits={{lower: {stop}, upper: 4, stop: {{restitution: {restitution}}}}}",
                f"initial={{q: {{theta1: {start}, phi1: 1.0}}, hold: [theta1], qd: {{theta1: {rate}}}}}",
                *BARE,
            ],
        )
    )
    before = 0.5 * lecture_inertia(start) * rate**2
    at_stop = before + spring(stop) - spring(start)
    after = restitution**2 * at_stop
    impact = duration(lecture_inertia, lambda x: before + spring(x) - spring(start), start, stop)
    last = duration(lecture_inertia, lambda x: after + spring(x) - spring(stop), stop, END)
    hit = next(e for e in found.events if e["kind"] == "impact")
    lock = found.summary["lock"]
    assert hit["time"] == pytest.approx(impact, abs=2e-6)
    assert hit["energy_lost"] == pytest.approx((1 - restitution**2) * at_stop, abs=1e-9)
    assert found.status == "locked" and lock["time"] == pytest.approx(impact + last, abs=4e-6)
    assert found.summary["error_estimate"]["state_max"] < 1e-7


def test_a_stop_short_of_the_dead_point_means_no_lock() -> None:
    stop = "robot.joints.theta1.limits={lower: -1, upper: 2.0, stop: {restitution: 0}}"
    found = deploy(load_scene(FOUR_BAR, [stop, *BARE]))
    assert found.status == "no_lock" and found["q"][-1, 0] == pytest.approx(2.0, abs=1e-12)
    assert found.summary["transitions"]["contact"] == 1


# -- a pose to pass, and then a lock ------------------------------------------------------------------------
PASSED = """
schema: 1
command: deploy
gravity: [0, 0, 0]
robot:
  convention: standard
  joints:
    - {name: theta, type: revolute, parent: base, a: 1.0, alpha: 0, d: 0}
    - {name: phi2, type: revolute, parent: crank, a: 2.0, alpha: 0, d: 0}
    - {name: phi1, type: revolute, parent: base, origin: {xyz: [2.0, 0, 0]}, a: 1.0, alpha: 0, d: 0}
    - {name: psi2, type: revolute, parent: crank, a: 1.1, alpha: 0, d: 0}
    - {name: psi1, type: revolute, parent: base, origin: {xyz: [0, -1.5, 0]}, a: 1.1, alpha: 0, d: 0}
  links:
    - {name: crank, mass: 1.0, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 1/12}}
    - {name: coupler, mass: 2.0, com: [1.0, 0, 0], com_frame: joint, inertia: {zz: 2/3}}
    - {name: follower, mass: 1.0, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 1/12}}
    - {name: rod, mass: 1.0, com: [0.55, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
    - {name: arm, mass: 1.0, com: [0.55, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
loops:
  - {name: flat, type: revolute, between: [coupler.end, follower.end]}
  - {name: dyad, type: revolute, between: [rod.end, arm.end]}
actuated: [theta]
torques: {theta: 1.0}
initial: {q: {theta: -0.6, phi2: 0.6, phi1: -0.6, psi1: 0.5}, hold: [theta]}
simulate: {duration: 5, samples: 501, rtol: 1e-11, atol: 1e-12, singular: pass}
"""


def test_a_lock_is_found_behind_a_pose_that_is_passed() -> None:
    """A parallelogram passes its flat pose; a dyad on the same crank comes into line afterwards."""
    found = deploy(load_scene_text(PASSED))
    q = found["q"][0]
    elbow, foot = np.array([np.cos(-0.6), np.sin(-0.6)]), np.array([0.0, -1.5])
    d, pin = foot - elbow, foot + 1.1 * np.array([np.cos(q[4]), np.sin(q[4])])
    branch = int(np.sign(d[0] * (pin - elbow)[1] - d[1] * (pin - elbow)[0]))

    def inertia(theta: float) -> float:
        b, rb, rc = dyad_rates(1.0, (1.1, 1.1), (0.0, -1.5), branch, theta)
        J = 0.1 + 0.55**2
        # crank and follower 1/3 each, the coupler of 2 kg moves along without turning
        return float(2 / 3 + 2.0 + 1.0 + 2 * 0.55 * np.cos(theta - b) * rb + J * (rb * rb + rc * rc))

    end = np.arcsin((2.2**2 - 3.25) / 3)
    lock = found.summary["lock"]
    passed = duration(inertia, lambda x: x + 0.6, -0.6, 0.0)
    assert found.status == "locked" and lock["kind"] == "dead_point"
    assert lock["angles"]["theta"] == pytest.approx(end, abs=1e-9)
    assert lock["time"] == pytest.approx(duration(inertia, lambda x: x + 0.6, -0.6, end), abs=2e-6)
    assert found.summary["passed"] == [pytest.approx(passed, abs=1e-4)]
    assert np.abs(found["q"][:, 2] - found["q"][:, 0]).max() < 1e-10  # still a parallelogram
    assert lock["time_error"] < 1e-8
    with pytest.raises(SingularConfigurationError, match="bifurcation"):
        deploy(load_scene_text(PASSED, overrides=["simulate.singular=stop"]))
