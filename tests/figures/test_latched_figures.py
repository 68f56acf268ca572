"""Loads, extremes and margins of random arrays and four-bars with latches stay within their errors, whatever the samples,
tolerances and methods are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from robodyn_cli.scene.load import load_scene
from robodyn_cli.works.deploy.deploy import deploy
from tests.figures.judge import OFTEN, TIMES, figures_of, moves, runs_of
from tests.panels import Panels

NEAR = 1e-6  # of a figure, that its error may be


def array(seed: int) -> dict[str, Any]:
    """Return panels that springs unfold, with friction in the hinges and margins of the springs."""
    rng = np.random.default_rng(seed)
    tree = Panels.random(rng, 2 + seed % 2).scene()
    for k, joint in enumerate(tree["robot"]["joints"]):
        joint["spring"]["role"] = "drive"
        joint["friction"] = {"coulomb": 0.02 + 0.01 * k, "transition_speed": 0.01}
    tree["motorisation"] = {"factors": {"friction": 3}}
    return asked(tree, "hinge0", ["hinge0", "hinge1"])


def four_bar(seed: int) -> dict[str, Any]:
    """Return a closed chain that a spring drives to its latch, and to a stop by a second one that is a spring."""
    rng = np.random.default_rng(seed)
    r, c, s, b = np.array([0.25, 0.6, 0.5, 0.7]) * rng.uniform(0.9, 1.1, 4)
    z: dict[str, Any] = {"type": "revolute", "axis": [0, 0, 1]}
    joints = [
        {"name": "crank", **z, "parent": "base", "spring": {"stiffness": 0.12, "rest": 5.0, "role": "drive"},
         "friction": {"coulomb": 0.01, "transition_speed": 0.01}},
        {"name": "coup", **z, "parent": "arm", "origin": {"xyz": [float(r), 0, 0]}},
        {"name": "rock", **z, "parent": "base", "origin": {"xyz": [float(b), 0, 0]}},
    ]  # fmt: skip
    links = [
        {
            "name": name,
            "mass": float(m * rng.uniform(0.8, 1.2)),
            "com": [float(x), 0.01, 0],
            "inertia": {"zz": 0.02},
        }
        for name, m, x in (("arm", 1.2, r / 2), ("bar", 0.8, c / 2), ("swing", 0.6, s / 2))
    ]
    points = {
        "pin": {"link": "bar", "at": [float(c), 0, 0]},
        "tip": {"link": "swing", "at": [float(s), 0, 0]},
    }
    hold: Any = {"stiffness": 40, "damping": 0.3} if seed % 2 else "rigid"
    tree = {
        "schema": 1, "command": "deploy", "gravity": [0, 0, 0],
        "robot": {"joints": joints, "links": links, "points": points},
        "loops": [{"name": "close", "type": "revolute", "between": ["pin", "tip"]}], "actuated": ["crank"],
        "initial": {"q": {"crank": 0.35, "coup": 0.9, "rock": 1.8}, "hold": ["crank"]},
        "simulate": {"duration": 4},
        "deploy": {"latches": [{"name": "catch", "joint": "crank", "at": 1.2, "hold": hold}], "until": "end"},
        "motorisation": {"factors": {"friction": 3}},
    }  # fmt: skip
    return asked(tree, "close", ["crank", "rock"])


def asked(tree: dict[str, Any], part: str, joints: list[str]) -> dict[str, Any]:
    """Return a scene that asks for reactions, extremes, the fluctuation of a rate, and loads that are too large."""
    path = "reactions" if part.startswith("hinge") else "loop_reactions"
    columns = [f"{name}.{joint}" for name in ("q", "qd", "qdd") for joint in joints]
    tree["outputs"] = {"reactions": True, "extremes": [*columns, f"{path}/{part}.force", "energy/kinetic"]}
    tree["simulate"]["fluctuation"] = joints[:1]
    tree["deploy"]["loads"] = {part: {"force": 0.5}}
    return tree


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("scene", [array, four_bar])
def test_figures_of_latched_motions_stay_within_their_errors(scene: Any, seed: int, tmp_path: Path) -> None:
    path = tmp_path / "latched.yaml"
    path.write_text(yaml.safe_dump(scene(seed)), encoding="utf-8")
    runs = runs_of(path, "deploy", 21)
    assert len(runs) == 5
    other = deploy(load_scene(path, ["simulate.integrator=dop853", "simulate.samples=21"]))
    runs["another method"] = figures_of("deploy", other.summary)
    found = moves(runs)
    kinds = {x.kind.split(".")[0] for x in found}
    assert {"extremes", "motorisation", "reactions", "locks", "overload", "fluctuation"} <= kinds
    # where next to nothing resists, a ratio has no bound, and says so by an error of null
    told = [x for x in found if not (x.kind.startswith("motorisation") and None in x.errors)]
    assert len(told) > 0.9 * len(found) and not [str(x) for x in told if x.ratio > TIMES]
    beyond = [str(x) for x in found if x.ratio > 1.0]
    assert len(beyond) <= OFTEN * len(found), beyond
    for x in found:  # samples do not matter
        if x.kind.startswith("reactions") and "rtol 1e-6" not in x.runs:
            assert None not in x.errors and max(x.errors) < NEAR * max(1.0, abs(x.values[0])), str(x)
