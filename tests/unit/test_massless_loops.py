"""Closed mechanisms of bodies without mass: the opened tree's M has no inverse, or a bad one; the mechanism's has."""

from __future__ import annotations

import copy
import json
from typing import Any

import numpy as np
import pytest

from robodyn_cli import (
    Mechanism,
    deploy,
    inverse,
    linearise,
    load_scene,
    load_scene_text,
    sensitivity,
    simulate,
)
from robodyn_cli.errors import NumericalError
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.results.result import Result
from tests.maximal import Maximal, Series, cos
from tests.mechanisms import CONFIGS

Z, ALONG_X, ALONG_Y = [0, 0, 1], [1, 0, 0], [0, 1, 0]
Data = dict[str, Any]


def body(name: str, mass: float, length: float) -> Data:
    zz = mass * length**2 / 12
    return {"name": name, "mass": mass, "com": [length / 2, 0, 0], "inertia": {"zz": zz}}


def nothing(name: str, mass: float = 0.0) -> Data:
    """A body of a mass that is next to nothing, or without any."""
    return {"name": name, "mass": 0} if mass == 0.0 else body(name, mass, 1.0)


def joint(name: str, parent: str, axis: list[int] = Z, at: float = 0.0, **more: Any) -> Data:
    kind = "revolute" if axis is Z else "prismatic"
    origin = {"xyz": [at, 0, 0]}
    return {"name": name, "type": kind, "parent": parent, "axis": axis, "origin": origin, **more}


def scene(
    joints: list[Data], links: list[Data], points: Data, loops: list[list[str]], q: Data, **more: Any
) -> Data:
    return {
        "schema": 1,
        "gravity": [0, -9.81, 0],
        "robot": {"joints": joints, "links": links, "points": points},
        "loops": [{"name": f"p{k}", "type": "revolute", "between": two} for k, two in enumerate(loops)],
        "initial": {"q": q, **more.pop("initial", {})},
        "simulate": {"duration": 0.5, "samples": 11, **more.pop("simulate", {})},
        **more,
    }


def pendulum(mass: float, still: bool = False, **more: Any) -> Data:
    """A point mass on a pivot that slides without mass carry, and that a point of the ground leads."""
    joints = [joint("x", "base", ALONG_X, **more), joint("y", "c1", ALONG_Y), joint("s", "c")]
    point_mass = {"name": "b", "mass": 1, "com": [0, -1, 0], "inertia": {"zz": mass}}
    pivot = {"link": "base", "at": [0, 0, 0]} | ({} if still else {"motion": [0, "0.05*cos(20*t)", 0]})
    links = [nothing("c1", mass), nothing("c", mass), point_mass]
    at = {"x": 0, "y": 0 if still else 0.05, "s": 2.0}
    return scene(joints, links, {"pv": pivot}, [["b.origin", "pv"]], at, initial={"hold": ["s"]})


def slider_crank(mass: float, **more: Any) -> Data:
    """The slider and the pin on it have no mass; the slider is a branch of its own."""
    joints = [
        joint("a", "base"),
        joint("b", "crank", at=0.4),
        joint("x", "base", ALONG_X, **more),
        joint("pin", "slider"),
    ]
    links = [body("crank", 2, 0.4), body("rod", 1, 1.1), nothing("slider", mass), nothing("eye", mass)]
    points = {"tip": {"link": "rod", "at": [1.1, 0, 0]}, "eye": {"link": "eye", "at": [0.05, 0, 0]}}
    # the pin's own angle is free without a load: the eye is tied to the rod
    lock = [{"name": "tie", "terms": {"pin": 1.0, "a": -1.0, "b": -1.0}}]
    q = {"a": 0.7, "b": -0.9, "x": 1.3, "pin": -0.2}
    data = scene(joints, links, points, [["tip", "eye"]], q, initial={"hold": ["a"]})
    return {**data, "couplers": lock}


def four_bar(light: str, mass: float, **more: Any) -> Data:
    """Links named in ``light`` have next to no mass."""
    sizes = {"crank": 0.5, "coupler": 1.2, "rocker": 0.9}
    joints = [joint("t1", "base", **more), joint("t2", "crank", at=0.5), joint("t3", "base", at=1.1)]
    links = [nothing(n, mass) if n in light else body(n, 1.5, size) for n, size in sizes.items()]
    points = {"A": {"link": "coupler", "at": [1.2, 0, 0]}, "B": {"link": "rocker", "at": [0.9, 0, 0]}}
    q = {"t1": 1.2, "t2": -0.9, "t3": 1.7}
    return scene(joints, links, points, [["A", "B"]], q, initial={"hold": ["t1"]})


def chain(light: str, mass: float) -> Data:
    """The same four-bar as one chain of three links that is pinned to the ground at its end."""
    sizes = {"crank": 0.5, "coupler": 1.2, "rocker": 0.9}
    joints = [joint("t1", "base"), joint("t2", "crank", at=0.5), joint("t3", "coupler", at=1.2)]
    links = [nothing(n, mass) if n in light else body(n, 1.5, size) for n, size in sizes.items()]
    points = {"A": {"link": "rocker", "at": [0.9, 0, 0]}, "B": {"link": "base", "at": [1.1, 0, 0]}}
    q = {"t1": 1.2, "t2": -0.9, "t3": -1.6}
    return scene(joints, links, points, [["A", "B"]], q, initial={"hold": ["t1"]})


def point_on_coupler() -> Data:
    """A four-bar whose only mass is a point on the coupler: M loses its inverse where crank and point align."""
    data = four_bar("crank coupler rocker", 0.0)
    data["robot"]["links"][1] = {"name": "coupler", "mass": 2, "com": [0.6, 0, 0], "inertia": {"zz": 0}}
    data["initial"]["qd"] = {"t1": 6.0}
    data["initial"]["q"] = {"t1": 1.2, "t2": -0.9, "t3": 1.7}
    return data


def scissor(mass: float) -> Data:
    """Two crossing bars on a slider, a platform of a point mass on slides without mass."""
    joints = [joint("a", "base"), joint("x", "base", ALONG_X), joint("b", "slider"), joint("u", "base", ALONG_X),
              joint("v", "carry", ALONG_Y)]  # fmt: skip
    top = {"name": "top", "mass": 3, "com": [0, 0, 0], "inertia": {"zz": 0.1}}
    links = [nothing("one", mass), nothing("slider", mass), nothing("two", mass), nothing("carry", mass), top]
    points = {"m1": {"link": "one", "at": [0.5, 0, 0]}, "m2": {"link": "two", "at": [0.5, 0, 0]},
              "t1": {"link": "one", "at": [1, 0, 0]}, "t": {"link": "top", "at": [0, 0, 0]}}  # fmt: skip
    # bar one at angle a from the left, bar two at pi - a from the slider at x = cos a; the middle pins agree
    q = {"a": 0.6, "x": np.cos(0.6), "b": np.pi - 0.6, "u": np.cos(0.6), "v": np.sin(0.6)}
    return scene(joints, links, points, [["m1", "m2"], ["t1", "t"]], q, initial={"hold": ["a"]})


def parallel_cranks(mass: float) -> Data:
    """A platform on three parallel cranks without mass: a loop more than it needs, so that rows depend on each other."""
    joints = [
        joint("c1", "base"),
        joint("p", "k1", at=0.5),
        joint("c2", "base", at=0.6),
        joint("c3", "base", at=1.2),
    ]
    links = [nothing("k1", mass), body("table", 2, 1.2), nothing("k2", mass), nothing("k3", mass)]
    points = {f"T{k}": {"link": "table", "at": [0.6 * (k - 1), 0, 0]} for k in (2, 3)}
    points |= {f"K{k}": {"link": f"k{k}", "at": [0.5, 0, 0]} for k in (2, 3)}
    q = {"c1": 1.0, "p": -1.0, "c2": 1.0, "c3": 1.0}
    loops = [["T2", "K2"], ["T3", "K3"]]
    return scene(joints, links, points, loops, q, initial={"hold": ["c1"]}, simulate={"duration": 0.3})


def shaken(t: Series) -> list[Any]:
    return [0.0, 0.05 * cos(20.0 * t)]


SPRING = {"spring": {"stiffness": 40, "rest": 0.2}, "damper": {"damping": 1.5}}
FAMILY = {
    "pendulum on a moving point": pendulum(0.0),
    "pendulum, spring on a slide": pendulum(0.0, **SPRING),
    "slider-crank, spring and damper on the slider": slider_crank(0.0, **SPRING),
    "four-bar, coupler": four_bar("coupler", 0.0),
    "four-bar, crank and rocker, spring": four_bar("crank rocker", 0.0, **SPRING),
    "four-bar, point on the coupler": point_on_coupler(),
    "chain, coupler and rocker": chain("coupler rocker", 0.0),
    "scissor": scissor(0.0),
    "parallel cranks": parallel_cranks(0.0),
    "light pendulum on a moving point": pendulum(1e-12),
    "slider-crank, light slider": slider_crank(1e-12),
    "four-bar, light rocker": four_bar("rocker", 1e-12),
    "four-bar, rocker of 1e-6": four_bar("rocker", 1e-6),
    "light scissor": scissor(1e-12),
}


def run(data: Data, **options: Any) -> Result:
    data = copy.deepcopy(data)
    data["simulate"] |= options
    return simulate(load_scene_text(json.dumps(data)))


def reference(data: Data) -> Maximal:
    return Maximal(data, {"pv": shaken} if "motion" in data["robot"]["points"].get("pv", {}) else None)


@pytest.mark.parametrize("name", FAMILY)
def test_motion_and_accelerations_are_those_in_maximal_coordinates(name: str) -> None:
    """The reference knows no trees: it solves for all bodies and all joints' forces at once."""
    data = FAMILY[name]
    result, maximal = run(data), reference(data)
    q, qd, t = result["q"], result["qd"], result.time
    expected = np.array([maximal.joint_accelerations(*x) for x in zip(t, q, qd)])
    assert np.abs(result["qdd"] - expected).max() < 1e-11 * (1.0 + np.abs(expected).max())
    assert np.abs(q - maximal.motion(q[0], qd[0], t, 1e-9)).max() < 1e-8
    assert result.summary["error_estimate"]["q_max"] < 1e-10
    assert result.summary["energy_drift_relative"] < 1e-10 and result.summary["counters"]["steps"] < 60


def test_methods_and_formulations_agree() -> None:
    data = FAMILY["four-bar, crank and rocker, spring"]
    expected = run(data)["q"]
    for options in (
        {"integrator": "radau9"},
        {"stabilisation": "independent"},
        {"stabilisation": {"alpha": 5, "beta": 5}},
        {"singular": "pass"},
    ):
        assert np.abs(run(data, **options)["q"] - expected).max() < 1e-9


@pytest.mark.parametrize("limits", [{"friction": {"coulomb": 6, "law": "set_valued"}},
                                    {"limits": {"lower": 1.2, "upper": 2, "stop": {"restitution": 0.5}}}])  # fmt: skip
def test_a_slider_without_mass_sticks_and_meets_stops(limits: Data) -> None:
    """What remains of a small mass is of its size: impacts share the impulse by the same inertias."""
    none, light = (run(slider_crank(mass, **limits)) for mass in (0.0, 1e-8))
    assert none.events and len(none.events) == len(light.events)
    assert np.abs(none["q"] - light["q"]).max() < 1e-7 and none.summary["energy_drift_relative"] < 1e-10


@pytest.mark.parametrize("name", ["four-bar, crank and rocker, spring", "scissor", "parallel cranks"])
def test_the_forces_are_those_of_inverse_dynamics(name: str) -> None:
    """By virtual work, which needs no M^-1: torques, reactions in joints and closures, along the same motion."""
    data = copy.deepcopy(FAMILY[name])
    first = data["robot"]["joints"][0]["name"]
    start = data["initial"]["q"][first]
    data |= {"prescribed": {first: f"{start} + 0.2*sin(2*t)"}, "outputs": {"reactions": True}}
    data["initial"].pop("hold")
    data["inverse"] = {"samples": data["simulate"]["samples"]}
    scene = load_scene_text(json.dumps(data))
    forward, backward = simulate(scene), inverse(scene)
    for path in ("qdd", "tau", f"reactions/{first}", "loop_reactions/p0", "base_wrench"):
        scale = 1.0 + np.abs(backward[path]).max()
        assert np.abs(forward[path] - backward[path]).max() < 1e-11 * scale, path


def test_controllers_share_the_torques_of_loops() -> None:
    """Computed torque follows its reference to rounding: the model's M is that of the closed mechanism."""
    data = four_bar("rocker", 0.0)
    points = [{"t": 0, "q": {"t1": 1.2}}, {"t": 0.5, "q": {"t1": 1.5}}]
    data["control"] = {"type": "computed_torque", "joints": ["t1"], "gains": {"kp": 50, "kd": 13},
                       "reference": {"type": "quintic", "points": points}}  # fmt: skip
    result = run(data)
    s = result.time / 0.5
    assert np.abs(result["q"][:, 0] - 1.2 - 0.3 * (10 * s**3 - 15 * s**4 + 6 * s**5)).max() < 1e-11


def test_functions_of_states_and_linear_models() -> None:
    """Forward dynamics of samples and linear models solve with numbers, and need no inverse of the opened tree's M."""
    data = FAMILY["slider-crank, spring and damper on the slider"]
    scene, result = load_scene_text(json.dumps(data)), run(data)
    qdd = Mechanism(scene).forward_dynamics(result["q"], result["qd"], np.zeros_like(result["qd"]))
    assert np.abs(qdd - result["qdd"]).max() < 1e-10
    none, light = (
        linearise(load_scene_text(json.dumps(four_bar("rocker", m))))["linear/A"] for m in (0.0, 1e-6)
    )
    assert np.abs(none - light).max() < 1e-6 * np.abs(none).max()


def test_many_runs_are_single_runs() -> None:
    """Masses down to none: those that need inertias along the rows are other code, each made side by side."""
    text, key, masses = (
        json.dumps(four_bar("rocker", 0.5)),
        "robot.links.rocker.mass",
        [0.5, 0.4, 1e-7, 1e-12, 0.0],
    )
    runs = Mechanism(load_scene_text(text), vary=[key]).simulate_many({key: np.array(masses)})
    assert runs.ok.all() and not runs.one_by_one.any()
    for mass, q in zip(masses, runs.q):
        assert np.abs(simulate(load_scene_text(text, overrides=[f"{key}={mass}"]))["q"][-1] - q).max() < 1e-13


def test_a_mechanism_locks_with_a_latch() -> None:
    """The time is that of a small mass but for its size, and the latch takes the energy of what was moving."""
    results = []
    for mass in (0.0, 1e-7):
        data = four_bar("rocker", mass)
        data |= {"gravity": [0, 0, 0], "torques": {"t3": "-2 - 0.1*q.t3"}, "actuated": ["t3"]}
        data["initial"]["hold"] = ["t3"]
        data["simulate"] = {"duration": 5, "samples": 101}
        data["deploy"] = {"criterion": "dead_point", "latch": {"between": ["crank", "coupler"]}}
        results.append(deploy(load_scene_text(json.dumps(data))))
    none, light = (result.summary["lock"] for result in results)
    assert none["time"] == pytest.approx(light["time"], abs=1e-6)


def test_a_derivative_by_a_mass() -> None:
    data, key = four_bar("rocker", 0.0), "robot.links.coupler.mass"
    data["command"] = "simulate"
    text = json.dumps(data)
    found = sensitivity(load_scene_text(text), to=[key], of=["final.q.t1"])
    exact = found.summary["sensitivities"]["final.q.t1"][key]
    assert exact["method"] == "exact"
    high, low = (
        simulate(load_scene_text(text, overrides=[f"{key}={m}"]))["q"][-1, 0] for m in (1.501, 1.499)
    )
    assert exact["derivative"] == pytest.approx((high - low) / 0.002, rel=1e-6)


SPATIAL = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {{name: a, type: revolute, parent: base, axis: [0, 0, 1]}}
    - {{name: b, type: revolute, parent: base, axis: [1, 0, 0], origin: {{xyz: [1.0, 0.4, 0]}}}}
{joints}
  links:
    - {{name: crank, mass: 1, com: [0.15, 0, 0], inertia: {{xx: 0.001, yy: 0.01, zz: 0.01}}}}
    - {{name: rocker, mass: 1.5, com: [0, 0.1, 0.3], inertia: {{xx: 0.08, yy: 0.08, zz: 0.01}}}}
{links}
  points:
    A: {{link: crank, at: [0.3, 0, 0]}}
    B: {{link: rocker, at: [0, 0.2, 0.6]}}
{points}
loops: [{loop}]
initial: {{q: {{a: 0.4, b: 0.2}}, hold: [a]}}
simulate: {{duration: 0.5, samples: 11}}
"""


def test_a_rod_without_mass_on_a_wrist_without_mass_is_a_bar() -> None:
    bar = SPATIAL.format(
        joints="", links="", points="", loop="{name: l, type: distance, between: [A, B], length: 1.1}"
    )
    wrist = """
    - {name: w1, type: revolute, parent: crank, axis: [0, 0, 1], origin: {xyz: [0.3, 0, 0]}}
    - {name: w2, type: revolute, axis: [0, 1, 0]}"""
    links = "    - {name: m, mass: 0}\n    - {name: rod, mass: 0}"
    ball = "{name: l, type: spherical, between: [C, B]}"
    rod = SPATIAL.format(joints=wrist, links=links, points="    C: {link: rod, at: [1.1, 0, 0]}", loop=ball)
    one, two = (simulate(load_scene_text(text)) for text in (bar, rod))
    assert (
        np.abs(one["q"] - two["q"][:, :2]).max() < 1e-11
        and np.abs(one["qdd"] - two["qdd"][:, :2]).max() < 1e-8
    )
    # on a ball the rod spins about itself, which moves nothing
    joint = "    - {name: w, type: spherical, parent: crank, origin: {xyz: [0.3, 0, 0]}}"
    text = rod.replace(wrist, joint).replace(links, "    - {name: rod, mass: 0}")
    with pytest.raises(NumericalError, match="joint 'w'"):
        simulate(load_scene_text(text))


def free_pin() -> Data:
    data = slider_crank(0.0)
    data["robot"]["points"]["eye"]["at"] = [0, 0, 0]
    return {**data, "couplers": []}


@pytest.mark.parametrize(
    ("data", "joint", "words"),
    [
        (free_pin(), "pin", "moves nothing that has inertia"),
        (four_bar("crank coupler rocker", 0.0), "t1", "and so is the closed mechanism: .* with t2, t3,"),
    ],
)
def test_a_closed_mechanism_without_inertia_is_refused(data: Data, joint: str, words: str) -> None:
    with pytest.raises(NumericalError, match=words) as caught:
        run(data)
    assert caught.value.details["joint"] == joint and caught.value.exit_code == 3


def test_a_mechanism_that_comes_to_have_no_inertia_is_to_blame() -> None:
    """A point mass on the pin of the rocker rests where crank and coupler align; all else is without mass."""
    data = point_on_coupler()
    data["robot"]["links"][1]["com"] = [1.2, 0, 0]
    with pytest.raises(NumericalError, match="the loops let joint 't1' move there with .* of the inertias"):
        run(data, max_steps=2000)


@pytest.mark.parametrize(
    "name", ["four_bar_deploy", "parallelogram", "benchmarks/andrews", "benchmarks/bennett"]
)
def test_mechanisms_with_inertia_have_none_along_rows(name: str) -> None:
    assert not prepare(load_scene(CONFIGS / f"{name}.yaml")).problem.braces
