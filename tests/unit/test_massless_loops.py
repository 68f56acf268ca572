"""Closed mechanisms of bodies without mass: the opened tree's M has no inverse, or a bad one; the mechanism's has."""

from __future__ import annotations

import copy
import json
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.results.result import Result
from tests.maximal import Maximal, Series, cos

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
    "pendulum on a point": pendulum(0.0, still=True),
    "pendulum, spring on a slide": pendulum(0.0, **SPRING),
    "slider-crank": slider_crank(0.0),
    "slider-crank, spring and damper on the slider": slider_crank(0.0, **SPRING),
    "four-bar, crank": four_bar("crank", 0.0),
    "four-bar, rocker": four_bar("rocker", 0.0),
    "four-bar, coupler": four_bar("coupler", 0.0),
    "four-bar, crank and rocker, spring": four_bar("crank rocker", 0.0, **SPRING),
    "four-bar, point on the coupler": point_on_coupler(),
    "chain, rocker": chain("rocker", 0.0),
    "chain, coupler and rocker": chain("coupler rocker", 0.0),
    "scissor": scissor(0.0),
    "parallel cranks": parallel_cranks(0.0),
}
LIGHT = {
    "pendulum on a moving point": pendulum,
    "slider-crank": slider_crank,
    "four-bar, rocker": lambda mass: four_bar("rocker", mass),
    "chain, coupler and rocker": lambda mass: chain("coupler rocker", mass),
    "scissor": scissor,
    "parallel cranks": parallel_cranks,
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
    assert np.abs(result["qdd"] - expected).max() < 1e-8 * (1.0 + np.abs(expected).max())
    motion = maximal.motion(q[0], qd[0], t)
    assert np.abs(q - motion).max() < 1e-8 + 10.0 * result.summary["error_estimate"]["q_max"]
    assert result.summary["energy_drift_relative"] < 1e-8 and result.summary["counters"]["steps"] < 500


@pytest.mark.parametrize("name", LIGHT)
def test_light_bodies_move_as_those_without_mass(name: str) -> None:
    """What a mass of 1e-12 changes is of its own size, and so it is at 1e-6; neither takes more steps."""
    none = run(LIGHT[name](0.0))
    for mass in (1e-12, 1e-6):
        light = run(LIGHT[name](mass))
        scale = 1.0 + np.abs(none["qdd"]).max()
        assert np.abs(light["qdd"] - none["qdd"]).max() < (100.0 * mass + 1e-8) * scale
        assert light.summary["counters"]["steps"] < 2 * none.summary["counters"]["steps"] + 20
