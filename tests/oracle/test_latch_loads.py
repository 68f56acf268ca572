"""The loads that rigid latches bear, beside independent equations of motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import yaml
from scipy.optimize import minimize_scalar

from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.works.deploy.deploy import deploy
from tests.panels import Panels

MASS, COM, INERTIA, LENGTH, SPRING, TORQUE, AT = 2.0, 0.4, 0.1, 1.2, 6.0, 0.5, 0.9


def deployed(tree: dict[str, Any]) -> Result:
    return deploy(load_scene_text(yaml.safe_dump(tree)))


def arm(hold: Any = "rigid", **latch: Any) -> dict[str, Any]:
    """Return a panel that a torque drives to its latch, and another one that swings on a spring at its end."""
    z = {"type": "revolute", "axis": [0, 0, 1]}
    joints = [
        {"name": "root", **z},
        {"name": "elbow", **z, "origin": {"xyz": [LENGTH, 0, 0]}, "spring": {"stiffness": SPRING}},
    ]
    links = [
        {"name": "panel", "mass": 3.0, "com": [0.5, 0, 0], "inertia": {"zz": 0.3}},
        {"name": "fore", "mass": MASS, "com": [COM, 0, 0], "inertia": {"zz": INERTIA}},
    ]
    return {
        "schema": 1, "gravity": [0, 0, 0], "robot": {"joints": joints, "links": links}, "torques": {"root": TORQUE},
        "initial": {"q": {"root": 0, "elbow": 1.1}}, "simulate": {"duration": 20, "samples": 501},
        "deploy": {"latches": [{"name": "catch", "joint": "root", "at": AT, "hold": hold, **latch}], "until": "end"},
        "outputs": {"extremes": ["latch_loads.catch"]},
    }  # fmt: skip


def of_swing(q: Any, v: Any) -> Any:
    """Return what the latch bears: the rate of the angular momentum of the swinging panel about the root, less TORQUE."""
    own = INERTIA + MASS * COM**2
    a = -SPRING * q / own
    return own * a + MASS * LENGTH * COM * (np.cos(q) * a - np.sin(q) * v**2) - TORQUE


def test_load_of_a_latch_is_the_rate_of_angular_momentum() -> None:
    result = deployed(arm())
    own = result.summary["locks"]["catch"]
    load = result["latch_loads"][:, 0]
    after = result.time > own["time"]
    q, v = result["q"][:, 1], result["qd"][:, 1]
    assert not load[result.time < own["time"]].any() and after.sum() > 300
    assert np.abs(load[after] - of_swing(q, v)[after]).max() < 1e-12 * 20.0
    # the swing is harmonic, and goes through all phases
    rate = np.sqrt(SPRING / (INERTIA + MASS * COM**2))
    width = np.hypot(q[-1], v[-1] / rate)

    def at(phase: float) -> float:
        return -abs(of_swing(width * np.cos(phase), -width * rate * np.sin(phase)))

    grid = np.linspace(0.0, 2.0 * np.pi, 400)
    best = grid[np.argmin([at(x) for x in grid])]
    peak = -minimize_scalar(
        at, bounds=(best - 0.02, best + 0.02), method="bounded", options={"xatol": 1e-9}
    ).fun
    assert abs(own["peak_moment"] - peak) <= own["errors"]["peak_moment"] + 1e-9
    assert own["errors"]["peak_moment"] < 1e-7 and own["errors"]["peak_time"] < 20.0
    extreme = result.summary["extremes"]["latch_loads.catch"]
    assert own["peak_moment"] == max(extreme["largest"], -extreme["smallest"])


@pytest.mark.parametrize("samples", [11, 57, 2001])
def test_largest_load_does_not_depend_on_samples(samples: int) -> None:
    whole = deployed(arm()).summary["locks"]["catch"]
    tree = arm()
    tree["simulate"]["samples"] = samples
    own = deployed(tree).summary["locks"]["catch"]
    allowed = own["errors"]["peak_moment"] + whole["errors"]["peak_moment"]
    assert abs(own["peak_moment"] - whole["peak_moment"]) <= allowed


def test_stiff_springs_tend_to_a_rigid_latch() -> None:
    def pressed(hold: Any) -> Result:
        """The torque is so large that the latch never has to pull, which a spring does not."""
        return deployed({**arm(hold), "torques": {"root": 60.0}, "outputs": {}})

    rigid = pressed("rigid")
    assert rigid["latch_loads"][rigid.time > 1.0].max() < 0.0
    late = rigid.time > 15.0
    apart = []
    for stiffness in (1e5, 1e6):
        soft = pressed({"stiffness": stiffness, "damping": 0.01 * stiffness})
        apart.append(np.abs(soft["latch_loads"][late, 0] - rigid["latch_loads"][late, 0]).max())
    assert apart[1] < 0.2 * apart[0] < 0.02 * np.abs(rigid["latch_loads"][late]).max()


@pytest.mark.parametrize("seed", range(4))
def test_loads_of_random_arrays_beside_their_equations(seed: int) -> None:
    rng = np.random.default_rng([seed, 7])
    panels = Panels.random(rng, int(rng.integers(2, 7)))
    tree = panels.scene(duration=12.0)
    tree["deploy"]["until"] = "end"
    result = deployed(tree)
    closed = {int(name.removeprefix("latch")): own["time"] for name, own in result.summary["locks"].items()}
    assert len(closed) > 1
    for t, q, v, loads in zip(result.time, result["q"], result["qd"], result["latch_loads"]):
        held = [k for k, time in closed.items() if time < t]
        expected = panels.loads(q, v, held)
        assert np.abs(loads - expected).max() <= 1e-10 * max(1.0, np.abs(expected).max())


def test_latch_in_a_closure_bears_what_that_of_one_latch_does() -> None:
    with open("configs/four_bar_deploy.yaml", encoding="utf-8") as file:
        tree = yaml.safe_load(file)
    with open("configs/robots/four_bar.yaml", encoding="utf-8") as file:
        tree["robot"] = yaml.safe_load(file)
    del tree["expect"]
    tree["simulate"] = {**tree["simulate"], "duration": 20.0, "samples": 201}
    tree["torques"] = {"theta1": "1.9 + 0.5*sin(3*t)"}
    where = {"between": ["coupler", "follower"], "at": {"theta1": 1.5}}
    several = deployed({**tree, "deploy": {"latches": [{"name": "pin", **where}], "until": "end"}})
    one = deployed({**tree, "deploy": {"criterion": "latch", "latch": where, "after": "continue"}})
    time = several.summary["locks"]["pin"]["time"]
    moment = dict(zip(one.variables["loop_reactions/latch"].names, one["loop_reactions/latch"].T))["mz"]
    t, own = several.time, several["latch_loads"][:, 0]
    both = np.intersect1d(np.round(t[t > time], 9), np.round(one.time, 9))
    mine = own[np.isin(np.round(t, 9), both)]
    other = moment[np.isin(np.round(one.time, 9), both)]
    assert len(both) > 50
    assert np.abs(mine + other).max() < 1e-6 * np.abs(other).max()
