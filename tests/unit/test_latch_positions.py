"""Latches that close at a position or at a stop, in open chains and in loops; limits in deploy and statics."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.works.deploy.deploy import deploy
from robodyn_cli.works.simulate import simulate
from robodyn_cli.works.statics import statics

CONFIGS = Path(__file__).parents[2] / "configs"

BOOM = """
schema: 1
command: deploy
gravity: [0.4, -9.81, 0.2]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0.1, 1], spring: {stiffness: 9, rest: 60 deg}}
    - {name: b, type: revolute, origin: {xyz: [0.8, 0.05, 0], rpy: [0.3, 0, 0]}, axis: [0, 0, 1], %sspring: {stiffness: 15, rest: 120 deg}}
    - {name: c, type: prismatic, origin: {xyz: [0.4, 0, 0.1]}, axis: [1, 0.2, 0], spring: {stiffness: 60}}
  links:
    - {name: l1, mass: 3, com: [0.3, 0.03, 0.01], inertia: {xx: 0.05, yy: 0.26, zz: 0.27, xy: 0.01, xz: -0.005, yz: 0.002}}
    - {name: l2, mass: 2, com: [0.2, 0.05, -0.02], inertia: {xx: 0.03, yy: 0.14, zz: 0.15, xy: 0.004, xz: -0.005, yz: 0.002}}
    - {name: l3, mass: 1, com: [0.1, -0.03, 0.04], inertia: {xx: 0.02, yy: 0.03, zz: 0.025, xy: 0.003, xz: -0.001, yz: 0.002}}
initial: {q: {a: -1.2, b: -0.4, c: 0.05}, qd: {b: 0.5}}
simulate: {duration: 1.5, samples: 151}
deploy: {criterion: latch, after: continue, latch: {between: [l1, l2], %s}}
"""
AT = BOOM % ("", "at: {b: 50 deg}")
ANGLE = np.radians(50)


def test_a_latch_at_an_angle_of_an_open_chain() -> None:
    """It closes where a simulation passes the angle; momentum about everything but the hinge is kept."""
    found = deploy(load_scene_text(AT))
    lock = found.summary["lock"]
    assert found.status == "locked"
    assert (lock["kind"], lock["criterion"]) == ("latched", "latch")
    assert lock["angles"]["b"] == pytest.approx(ANGLE, abs=1e-12)
    free = simulate(
        load_scene_text(AT.partition("deploy: {")[0].replace("command: deploy", "")),
    )
    before = free["time"].ravel() < lock["time"]
    assert np.abs(found["q"][: before.sum()] - free["q"][before]).max() < 1e-8
    assert free["q"][before.sum(), 1] > ANGLE > free["q"][before.sum() - 1, 1]
    assert lock["time_error"] < 1e-8
    # the impulse: M (v+ - v-) has no part along a and c, and b stands still behind it
    latch = lock["latch"]
    problem = Problem(load_scene_text(AT))
    q = np.array(list(lock["angles"].values()))
    v, w = (np.array(list(latch[key].values())) for key in ("rates_before", "rates_after"))
    M = problem.numbers(problem.mass_matrix, q)
    jump = M @ (w - v)
    assert abs(w[1]) < 1e-12
    assert np.abs(jump[[0, 2]]).max() < 1e-12 * abs(jump[1])
    assert latch["angular_impulse_vector"]
    assert latch["energy_lost"] == pytest.approx(0.5 * v @ M @ v - 0.5 * w @ M @ w, rel=1e-10)
    assert latch["energy_lost"] > 0.01


def test_the_locked_chain_goes_on_as_one_body() -> None:
    """Behind the lock the motion is that of a chain whose hinge is fixed at the angle."""
    found = deploy(load_scene_text(AT))
    lock = found.summary["lock"]
    after = lock["latch"]["rates_after"]
    fixed = re.sub(
        r"\{name: b, .*?\{stiffness: 15, rest: 120 deg\}\}",
        f"{{name: b, type: fixed, origin: {{xyz: [0.8, 0.05, 0], quaternion: {turned(0.3, ANGLE)}}}}}",
        AT.partition("initial:")[0],
    )
    text = fixed + (
        f"initial: {{q: {{a: {lock['angles']['a']!r}, c: {lock['angles']['c']!r}}}, "
        f"qd: {{a: {after['a']!r}, c: {after['c']!r}}}}}\n"
        f"simulate: {{duration: {1.5 - lock['time']!r}, samples: 2}}\n"
    )  # fmt: skip
    alone = simulate(load_scene_text(text.replace("command: deploy\n", "")))
    assert np.abs(found["q"][-1, [0, 2]] - alone["q"][-1]).max() < 1e-8
    assert np.abs(found["q"][-1, 1] - ANGLE) < 1e-9
    assert found.summary["after_lock"]["degrees_of_freedom"] == 2
    assert np.abs(found["loop_reactions/latch"][-1]).max() > 0.1


def turned(roll: float, yaw: float) -> list[float]:
    """The quaternion of a rotation about x, then about the new z."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_euler("XZ", [roll, yaw]).as_quat()
    return [float(s) for s in (w, x, y, z)]


def test_a_latch_at_a_stop() -> None:
    """The latch takes the joint as it comes to the stop, before this throws it back."""
    stop = BOOM % ("limits: {upper: 50 deg, stop: {restitution: 0.5}}, ", "at_limit: {b: upper}")
    one, other = (deploy(load_scene_text(text)).summary["lock"] for text in (stop, AT))
    assert one["time"] == pytest.approx(other["time"], abs=1e-9)
    for key in ("rates_before", "rates_after"):
        assert list(one["latch"][key].values()) == pytest.approx(list(other["latch"][key].values()), abs=1e-7)
    assert one["latch"]["energy_lost"] == pytest.approx(other["latch"]["energy_lost"], rel=1e-7)


def test_a_latch_at_the_limit_of_one_of_several_coordinates() -> None:
    """It closes where it does at the position that the limit has."""
    hinge = "b, type: revolute, origin: {xyz: [0.8, 0.05, 0], rpy: [0.3, 0, 0]}, axis: [0, 0, 1], "
    assert hinge in BOOM
    text = BOOM.replace(hinge, hinge.replace("revolute", "universal") + "limits: {theta1: {upper: 5 deg}}, ").replace(
        "spring: {stiffness: 15, rest: 120 deg}", "spring: {theta1: {stiffness: 15, rest: 120 deg}}"
    )  # fmt: skip
    text = text.replace("b: -0.4", "b: [-0.4, 0]").replace("qd: {b: 0.5}", "qd: {b: [0.5, 0]}")
    one, other = (
        deploy(load_scene_text(text % ("", given))).summary["lock"]
        for given in ("at_limit: {b: {theta1: upper}}", "at: {b: {theta1: 5 deg}}")
    )
    assert one == other and one["kind"] == "latched"
    assert one["angles"]["b.theta1"] == pytest.approx(np.radians(5), abs=1e-12)
    with pytest.raises(SceneError, match="has no such limit"):
        load_scene_text(text % ("", "at_limit: {b: {theta2: upper}}"))


def test_friction_in_the_latched_hinge_ends_with_its_motion() -> None:
    """A hinge that sticks while it is free has no say once the latch holds it: the same motion as without."""
    sticky = AT.replace("b, type: revolute,", "b, type: revolute, friction: {coulomb: 0.4, law: set_valued},")
    smooth = AT.replace(
        "b, type: revolute,", "b, type: revolute, friction: {coulomb: 0.4, transition_speed: 1e-9},"
    )
    one, other = (deploy(load_scene_text(text)) for text in (sticky, smooth))
    assert one.summary["lock"]["time"] == pytest.approx(other.summary["lock"]["time"], abs=1e-8)
    assert np.abs(one["q"][-1] - other["q"][-1]).max() < 1e-6


def test_a_latch_at_an_angle_of_a_loop() -> None:
    """A four-bar locks at an angle before its dead point."""
    found = deploy(load_scene(CONFIGS / "four_bar_deploy.yaml", FOUR_BAR))
    lock = found.summary["lock"]
    assert (found.status, lock["kind"]) == ("locked", "latched")
    assert lock["multipliers"]["at_lock"] > 0.0
    usual = deploy(load_scene(CONFIGS / "four_bar_deploy.yaml")).summary["lock"]
    assert lock["time"] < usual["time"]


FOUR_BAR = ["deploy={criterion: latch, latch: {between: [coupler, follower], at: {theta1: 120 deg}}}"]


def test_a_position_that_is_never_reached() -> None:
    found = deploy(load_scene_text(BOOM % ("", "at: {b: 400 deg}")))
    assert found.status == "no_lock"
    assert found.summary["criteria"]["latch"] is None


REFUSED = {
    "at: {b: 1}, at_limit: {a: upper}": "names more than one joint",
    "at: {a: 1, b: 1}": "names more than one joint",
    "at: {d: 1}": "unknown joint with a coordinate",
    "at_limit: {b: upper}": "has no such limit",
    "at_limit: {b: middle}": ".",
    "at_limit: {b.x: upper}": "cannot be the name of a joint",
    "at_limit: {b: {x: upper}}": "b",
}


@pytest.mark.parametrize("given", REFUSED)
def test_what_is_refused(given: str) -> None:
    with pytest.raises(SceneError, match=REFUSED[given]):
        load_scene_text(BOOM % ("", given))


def test_a_position_goes_with_its_criterion() -> None:
    with pytest.raises(SceneError, match="'latch' needs a position"):
        load_scene_text((BOOM % ("", "")).replace("l2], ", "l2]"))
    with pytest.raises(SceneError, match="goes with 'criterion: latch'"):
        load_scene_text(AT.replace("criterion: latch", "criterion: either"))
    with pytest.raises(CapabilityError, match="allowed in an open chain"):
        deploy(load_scene_text(AT.partition("deploy: {")[0]))


def test_limits_are_told_in_deploy_up_to_its_end() -> None:
    limited = BOOM % ("limits: {upper: 20 deg, speed: 0.9}, ", "at: {b: 50 deg}")
    found = deploy(load_scene_text(limited))
    upper = [text for text in found.summary["warnings"] if "passes its upper limit of 0.349066 rad" in text]
    assert len(upper) == 1
    time = float(upper[0].rpartition("t = ")[2].split()[0])
    samples = found["time"].ravel()
    k = int(np.searchsorted(samples, time))
    assert found["q"][k - 1, 1] <= np.radians(20) <= found["q"][k, 1]
    assert any("'b' passes its speed limit" in text for text in found.summary["warnings"])
    beyond = BOOM % ("limits: {upper: 51 deg}, ", "at: {b: 50 deg}")  # passed behind the lock only
    assert "warnings" not in deploy(load_scene_text(beyond)).summary


def test_limits_are_told_in_statics() -> None:
    text = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{name: a, type: revolute, axis: [0, 0, 1], limits: {upper: -1, effort: 3}}]
  links: [{name: rod, mass: 2, com: [0.5, 0, 0]}]
initial: {q: {a: -0.5}}
statics: {find: hold}
"""
    warnings = statics(load_scene_text(text)).summary["warnings"]
    assert "joint 'a' at rest is beyond its upper limit of -1 rad: -0.5 rad" in warnings
    assert any("effort limit of 3 N m: 8.6" in text for text in warnings)
    assert (
        "warnings" not in statics(load_scene_text(text.replace("upper: -1, effort: 3", "upper: 0"))).summary
    )
