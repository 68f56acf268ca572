"""More joints with exact friction than freedoms: whether they stick, and the motion, are those of Coulomb's law."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from robodyn_cli import deploy, load_scene, load_scene_text, simulate
from robodyn_cli.errors import CapabilityError
from robodyn_cli.motion.contact.events import HELD
from robodyn_cli.motion.contact.sticking import RestingJoints, replacement
from robodyn_cli.results.result import Result
from tests.mechanisms import BENNETT, CONFIGS, SLIDER, close

JOINTS = ("crank", "rod", "slide")
START = "initial={{q: {{crank: {!r}, rod: -0.3, slide: 1.1}}, hold: [crank]}}"


def run(text: str, keys: Mapping[str, str], *overrides: str) -> Result:
    """Simulate a mechanism with further keys of joints."""
    for name, own in keys.items():
        text, found = re.subn(rf"(\{{name: {name}, type.*)\}}\n", rf"\1, {own}}}\n", text)
        assert found == 1
    return simulate(load_scene_text("schema: 1\n" + text, overrides=overrides))


def sticking(coulomb: float, static: str = "") -> str:
    return f"friction: {{law: set_valued, coulomb: {coulomb!r}{static}}}"


def kinds(result: Result) -> set[str]:
    return {str(event["kind"]) for event in result.events}


@pytest.mark.parametrize("seed", [0, 5])
def test_all_pins_break_away_together(seed: int) -> None:
    """A slowly loaded slider-crank goes when the crank's torque is the sum of all break-away levels by the ratios of the
    rates, of their own sign for each direction (virtual work)."""
    rng = np.random.default_rng(seed)
    coulomb = rng.uniform(0.2, 1.5, 3)
    static = coulomb * rng.uniform(1.0, 3.0, (2, 3))
    way = (-1) ** seed
    levels = [
        f", static: {{positive: {float(plus)!r}, negative: {-float(minus)!r}}}" for plus, minus in static.T
    ]
    keys = {name: sticking(float(c), s) for name, c, s in zip(JOINTS, coulomb, levels)}
    start = START.format(rng.uniform(0.0, 6.2))
    load = f"torques={{crank: '{4 * way}*t'}}"
    found = run(SLIDER, keys, load, start, "gravity=[0, 0, 0]", "simulate={duration: 4, samples: 21}")
    theta, turn = found["q"][0, 0], found["q"][0, :2].sum()
    rate = -0.3 * np.cos(theta) / (0.9 * np.cos(turn))
    rates = way * np.array([1.0, rate - 1.0, -0.3 * np.sin(theta) - 0.9 * np.sin(turn) * rate])
    needed = np.abs(rates) @ np.where(rates > 0.0, *static)
    slips = [event for event in found.events if event["kind"] == "slip"]
    assert abs(slips[0]["time"] - needed / 4) < 1e-11
    assert {e["name"]: e["direction"] for e in slips[:3]} == dict(zip(JOINTS, np.sign(rates)))
    assert found.summary["multipliers"]["choice"] == "not determined while crank, slide, rod stick together"
    assert "how they share their friction" in found.summary["warnings"][0]


@pytest.mark.parametrize("text", [SLIDER, BENNETT], ids=["slider", "redundant rows"])
def test_the_smooth_law_comes_near_as_it_becomes_steep(text: str) -> None:
    """Its error falls with the speed over which it is smoothed; the energy is balanced."""
    names = JOINTS if text is SLIDER else ("j1", "j2", "j3")
    options = [f"torques={{{names[0]}: '6*sin(3*t)'}}", "simulate={duration: 1.2, samples: 31}"]
    levels = dict(zip(names, (1.3, 0.9, 0.7)))
    exact = run(text, {name: sticking(c) for name, c in levels.items()}, *options)
    assert {"stick", "slip"} <= kinds(exact) and exact.summary["energy_drift_relative"] < 1e-8
    off = []
    for speed in (1e-3, 1e-4):
        smooth = {
            name: f"friction: {{coulomb: {c}, transition_speed: {speed}}}" for name, c in levels.items()
        }
        off.append(np.abs(run(text, smooth, *options)["q"] - exact["q"]).max())
    assert off[1] < 0.3 * off[0] < 0.03


def test_what_a_stop_brings_to_rest_sticks_too() -> None:
    """A crank on its rigid stop holds the rod, whose friction changes when the crank is drawn off."""
    keys = {"crank": "limits: {lower: 0, upper: 1.2, stop: {restitution: 0}}", "rod": sticking(3.0)}
    options = [START.format(0.3), "torques={crank: '9*sin(2*t)'}", "simulate={duration: 4, samples: 41}"]
    found = run(SLIDER, keys, *options)
    assert {"contact", "release", "stick", "slip"} <= kinds(found)
    assert found.summary["error_estimate"]["state_max"] < 1e-6
    assert found.summary["energy_drift_relative"] < 1e-8


@pytest.mark.parametrize("seed", range(20))
def test_states_obey_coulombs_law(seed: int) -> None:
    """Joints that are held stand still under torques within their bounds, of which as many as there are freedoms are
    inside; those that move do so against a torque at its bound."""
    rng = np.random.default_rng(seed)
    f, n = int(rng.integers(1, 4)), int(rng.integers(2, 9))
    columns, root = rng.normal(size=(f, n)), rng.normal(size=(f, f))
    inertia = root @ root.T + 0.1 * np.eye(f)
    low, high = -rng.uniform(0.1, 1.0, n), rng.uniform(0.1, 1.0, n)
    free = columns.T @ rng.normal(size=f) * 10.0 ** rng.uniform(-1.5, 0.5)
    rest = RestingJoints(columns, inertia, free, low, high)
    found = rest.settled()
    bearing = [k for k in range(n) if found.states[k] == HELD and k not in found.carried]
    lam = np.array([found.carried.get(k, 0.0) for k in range(n)])
    moving = np.array(found.states) != HELD
    lam[moving] = np.where(np.array(found.states) > 0, low, high)[moving]
    D = columns.T @ np.linalg.solve(inertia, columns)
    lam[bearing] = np.linalg.lstsq(D[np.ix_(bearing, bearing)], -(free + D @ lam)[bearing], rcond=None)[0]
    a = free + D @ lam
    assert np.all(lam >= low - 1e-9) and np.all(lam <= high + 1e-9)
    close(a[~moving], np.zeros(int((~moving).sum())), 1e-9 * np.abs(free).max())
    assert np.all(np.sign(a[moving]) == np.array(found.states)[moving])
    assert all(min(abs(x - low[k]), abs(x - high[k])) < 1e-12 for k, x in found.carried.items())


def test_a_carried_joint_takes_the_place_of_one_at_its_bound() -> None:
    """Two equal joints share one freedom: the one that has come to its upper bound is relieved by one at its lower
    bound, and not by one at its upper one, with which it goes."""
    columns = np.array([[1.0, 1.0]])
    assert replacement(columns, [0], 0, True, {1: True}) == (1, [1])
    assert replacement(columns, [0], 0, True, {1: False}) == (None, [1])


def test_loads_that_are_not_determined_are_refused() -> None:
    keys = {name: sticking(1.0) for name in JOINTS}
    asked: Sequence[str] = ("outputs.reactions=true", "outputs={extremes: [loop_reactions/pin.fx]}")
    for key in asked:
        with pytest.raises(CapabilityError, match="more joints than there are degrees of freedom"):
            run(SLIDER, keys, key)
    with pytest.raises(CapabilityError, match="in crank, slide, rod: loops and prescribed motion"):
        run(SLIDER, keys, "prescribed={crank: '0.2 + t'}", "torques=null")
    friction = [f"robot.joints.{k}.friction={{law: set_valued, coulomb: 0.1}}" for k in range(3)]
    unfolds = CONFIGS / "four_bar_deploy.yaml"
    with pytest.raises(CapabilityError, match="counts the multipliers, which are not determined"):
        deploy(load_scene(unfolds, [*friction, "deploy.criterion=either"]))
    lock = deploy(load_scene(unfolds, friction)).summary["lock"]
    assert lock["kind"] == "dead_point" and lock["multipliers"] is None
