"""Prescribed joints of links without mass: their motion is given, so that M need not have an inverse."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from robodyn_cli import inverse, kinematics, load_scene_text, simulate
from robodyn_cli.errors import NumericalError
from robodyn_cli.over.plan.plan import plan
from robodyn_cli.results.result import Result

MASSLESS: dict[str, Any] = {"mass": 0}


def four_bar(seed: int, massless: str, prescribed: str) -> dict[str, Any]:
    """A four-bar with offset centres of mass; one of its links has no mass, one of its ground joints is prescribed."""
    rng = np.random.default_rng(seed)
    crank, coupler, rocker, ground = (rng.uniform([0.5, 1.1, 0.9, 1.0], [0.6, 1.2, 1.0, 1.1])).tolist()

    def body(name: str, length: float) -> dict[str, Any]:
        if name == massless:
            return {"name": name, **MASSLESS}
        com = [length * rng.uniform(0.3, 0.6), 0.1 * rng.normal(), 0.0]
        return {
            "name": name,
            "mass": rng.uniform(0.5, 2),
            "com": com,
            "inertia": {"zz": rng.uniform(0.05, 0.2)},
        }

    axis = [0, 0, 1]
    joints = [
        {"name": "t1", "type": "revolute", "parent": "base", "axis": axis},
        {"name": "t2", "type": "revolute", "axis": axis, "origin": {"xyz": [crank, 0, 0]}},
        {"name": "t3", "type": "revolute", "parent": "base", "axis": axis, "origin": {"xyz": [ground, 0, 0]}},
    ]
    lengths = {"crank": crank, "coupler": coupler, "rocker": rocker}
    start = {"t1": 1.2, "t3": 1.7}[prescribed]
    return {
        "schema": 1,
        "gravity": [0, -9.81, 0],
        "robot": {
            "joints": joints,
            "links": [body(name, length) for name, length in lengths.items()],
            "points": {
                "A": {"link": "coupler", "at": [coupler, 0, 0]},
                "B": {"link": "rocker", "at": [rocker, 0, 0]},
            },
        },
        "loops": [{"name": "pin", "type": "revolute", "between": ["A", "B"]}],
        "prescribed": {prescribed: f"{start} + 0.2*sin({rng.uniform(1, 3)}*t)"},
        "initial": {"q": {"t1": 1.2, "t2": -0.9, "t3": 1.7}},
        "simulate": {"duration": 1, "samples": 101},
        "inverse": {"samples": 101},
        "kinematics": {"samples": 101},
        "outputs": {"reactions": True},
    }


def agree(simulated: Result, other: Result, path: str, relative: float = 1e-8) -> None:
    scale = np.abs(other[path]).max() + 1e-3
    assert np.abs(simulated[path] - other[path]).max() < relative * scale, path


@pytest.mark.parametrize("seed", range(4))
def test_a_massless_rocker(seed: int) -> None:
    """The motion is that of kinematics; the torque, by virtual work, that of inverse dynamics, which needs no M^-1."""
    scene = load_scene_text(json.dumps(four_bar(seed, "rocker", "t3")))
    found, moved, torques = simulate(scene), kinematics(scene), inverse(scene)
    for path in ("q", "qd", "qdd", "point_accelerations/A"):
        agree(found, moved, path)
    for path in ("tau", "loop_reactions/pin", "reactions/t1", "base_wrench"):
        agree(found, torques, path)
    summary = found.summary
    assert summary["energy_drift_relative"] < 1e-9 and summary["counters"]["steps"] < 100


@pytest.mark.parametrize("mass", [1e-12, 1e-6, 1e-3])
def test_a_light_rocker_costs_no_digits(mass: float) -> None:
    """Each digit of its mass that is missing used to be one of the accelerations, and the steps grew with it."""
    text = four_bar(1, "rocker", "t3")
    weightless = simulate(load_scene_text(json.dumps(text)))
    light = {"name": "rocker", "mass": mass, "com": [0.4, 0, 0], "inertia": {"zz": 0.1 * mass}}
    text["robot"]["links"][2] = light
    found = simulate(load_scene_text(json.dumps(text)))
    agree(found, weightless, "qdd", 1e-9)
    agree(found, weightless, "tau", 20.0 * mass + 1e-8)
    assert found.summary["counters"]["steps"] < 2 * weightless.summary["counters"]["steps"]


TIGHT: dict[str, dict[str, Any]] = {
    "dop853": {"rtol": 1e-9, "atol": 1e-11},
    "radau9": {"rtol": 1e-9, "atol": 1e-11},
    "generalized_alpha": {"step": 1e-3},
}


@pytest.mark.parametrize(
    ("method", "stabilisation"),
    [
        *((m, s) for m in ("dop853", "radau9") for s in ("projection", "independent", "baumgarte")),
        ("generalized_alpha", "projection"),
    ],
)
def test_methods_and_formulations_agree(method: str, stabilisation: str) -> None:
    text = four_bar(2, "rocker", "t3")
    asked = inverse(load_scene_text(json.dumps(text)))
    options = {**text["simulate"], "integrator": method, "stabilisation": stabilisation, **TIGHT[method]}
    found = simulate(load_scene_text(json.dumps({**text, "simulate": options})))
    agree(found, asked, "tau", 1e-2 if method == "generalized_alpha" else 1e-5)


def test_a_massless_slider_in_an_open_chain() -> None:
    """A rod hangs on a slide without mass that is shaken: a pendulum with the support's acceleration."""
    text = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: x, type: prismatic, axis: [1, 0, 0]}
    - {name: y, type: prismatic, axis: [0, 1, 0]}
    - {name: q, type: revolute, axis: [0, 1, 0]}
  links:
    - {name: rail, mass: 0}
    - {name: slide, mass: 0}
    - {name: rod, mass: 2, com: [0, 0, -0.5], inertia: {xx: 0.1, yy: 0.2, zz: 0.1}}
prescribed: {x: "0.1*sin(3*t)", y: "0.2*t"}
initial: {q: {x: 0, y: 0, q: 0.4}, qd: {q: 0}}
simulate: {duration: 2, samples: 201}
"""
    found = simulate(load_scene_text(text))
    q, t = found["q"][:, 2], found.time
    # (I + m l^2) q'' = m l x'' cos q - m g l sin q, turned about +y: x of the rod's end is -l sin q
    expected = (2 * 0.5 * (-0.9 * np.sin(3 * t)) * np.cos(q) - 2 * 9.81 * 0.5 * np.sin(q)) / (0.2 + 2 * 0.25)
    assert np.abs(found["qdd"][:, 2] - expected).max() < 1e-9


def test_a_massless_joint_that_nothing_leads_is_refused() -> None:
    """Its acceleration is not determined, whatever is prescribed elsewhere."""
    text = four_bar(0, "crank", "t3")
    text["loops"] = []
    text["robot"]["joints"][1]["parent"] = "base"
    text["initial"]["qd"] = {"t1": 0, "t2": 0}
    with pytest.raises(NumericalError, match="joint 't1' moves nothing that has inertia"):
        simulate(load_scene_text(json.dumps(text)))


def test_the_plan_counts_the_program_that_runs() -> None:
    scene = load_scene_text(json.dumps(four_bar(3, "rocker", "t3")))
    found = plan(scene, "simulate")
    assert found["status"] == "ok" and found["operations"] > 100
