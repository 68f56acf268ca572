"""Torques of ``inverse`` fed to ``simulate`` reproduce the motion: random arms, and mechanisms with loops, with friction,
springs, geared rotors and losses of gears by the direction of power."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.works.inverse import inverse
from tests.numeric import assert_close
from tests.random_models import random_inertia
from tests.unit.test_control_loops import CASES

ROWS = 501  # of the table of torques, straight between its rows
DURATION = 0.25
# a joint that never stops takes friction and losses with the full sign at every instant
FRICTION = {"friction": {"viscous": 0.2, "coulomb": 0.4, "transition_speed": 0.005}}
# losses of a gear beside a rotor's own inertia are for `inverse` alone
ROTOR = FRICTION | {"gear_ratio": 30, "rotor_inertia": 2e-5}
GEAR = FRICTION | {"gear": {"efficiency": 0.85, "back_driving": 0.7, "transition_speed": 0.005}}


def motion(starts: dict[str, float], sizes: dict[str, float]) -> dict[str, Any]:
    """Return a motion from some positions, in which no joint comes to rest."""
    q = {
        name: f"{start!r} + {size}*({1.2 - 0.3 * (k % 3)}*t + 0.1*sin({3 + k}*t))"
        for k, ((name, start), size) in enumerate(zip(starts.items(), sizes.values()))
    }
    return {"type": "joint", "duration": DURATION, "q": q}


def random_arm(seed: int) -> dict[str, Any]:
    """Return a random chain of hinges and slides with full inertias, with rotors, gears, springs and dampers in the joints."""
    rng = np.random.default_rng(seed)
    joints, links = [], []
    for k in range(int(rng.integers(2, 5))):
        mass, com, J = random_inertia(rng)
        joint = {"name": f"j{k}", "type": str(rng.choice(["revolute", "revolute", "prismatic"]))}
        joint["axis"] = rng.normal(size=3).tolist()
        joint["origin"] = {"xyz": rng.uniform(-0.3, 0.3, 3).tolist(), "rpy": rng.uniform(-1, 1, 3).tolist()}
        extras = [ROTOR, GEAR, {"spring": {"stiffness": 8.0}, "damper": {"damping": 0.3}}, {}]
        joints.append(joint | extras[int(rng.integers(4))])
        entries = {
            a + b: float(J["xyz".index(a), "xyz".index(b)]) for a, b in ("xx", "yy", "zz", "xy", "xz", "yz")
        }
        links.append({"name": f"l{k}", "mass": float(mass), "com": com.tolist(), "inertia": entries})
    starts = {f"j{k}": float(x) for k, x in enumerate(rng.uniform(-1, 1, len(joints)))}
    return {
        "schema": 1,
        "gravity": [0.8, -1.4, -9.3],
        "robot": {"joints": joints, "links": links},
        "trajectory": motion(starts, dict.fromkeys(starts, 0.8)),
    }


def meets(text: str, settings: list[str], trajectory: dict[str, Any]) -> None:
    """Fail unless the torques of the motion give the motion.

    A straight line between rows h apart is off by up to h^2 / 8 tau''; what that does to the motion is estimated by
    putting every other row on the line between its neighbours, in a table as long: its code is the same.
    """
    follow = [*settings, f"trajectory={json.dumps(trajectory)}", f"inverse={{samples: {ROWS}}}"]
    torques = inverse(load_scene_text(text, overrides=follow))
    names, rates = torques.variables["q"].names, torques.variables["qd"].names
    scene = load_scene_text(text, overrides=settings)
    driven = scene.actuated or tuple(rates)
    start: dict[str, Any] = {}
    for name, x in zip(names, torques["q"][0].tolist()):
        joint, _, column = name.partition(".")
        start[joint] = [*start.get(joint, []), x] if column else x
    speed = {name: torques["qd"][0, rates.index(name)] for name in driven}
    found = []
    t, rows = torques.time.tolist(), torques["tau"]
    straight = rows.copy()
    straight[1::2] = 0.5 * (rows[:-1:2] + rows[2::2])
    for tau in (straight, rows):
        tables = {name: {"table": list(zip(t, tau[:, rates.index(name)].tolist()))} for name in driven}
        initial = f"initial={json.dumps({'q': start, 'qd': speed})}"
        run = (
            f"simulate={{duration: {DURATION}, samples: 51, rtol: 1e-10, atol: 1e-12, error_estimate: false}}"
        )
        free = [*settings, initial, run, f"torques={json.dumps(tables)}"]
        found.append(simulate(load_scene_text(text, overrides=free)))
    coarse, fine = (np.abs(x["q"] - torques["q"][:: (ROWS - 1) // 50]).max() for x in found)
    assert np.ptp(torques["q"], axis=0).max() > 0.05
    assert fine < 8e-6 and (fine < 0.4 * coarse or fine < 1e-9)
    assert_close(found[1]["qd"][-1], torques["qd"][-1], 1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_random_arms(seed: int) -> None:
    scene = random_arm(seed)
    trajectory = scene.pop("trajectory")
    meets(json.dumps(scene), [], trajectory)


# what a rotor or a gear adds to a joint knows nothing of the loops: random arms have both, and each mechanism one
@pytest.mark.parametrize(("name", "drive"), [("five_bar", GEAR), ("slider", ROTOR), ("delta", GEAR)])
def test_mechanisms_with_loops(name: str, drive: dict[str, Any]) -> None:
    case = CASES[name]
    drives = [
        f"robot.joints.{joint}.{key}={json.dumps(value)}"
        for joint in case.driven
        for key, value in drive.items()
    ]
    start = case.start
    starts = {joint: start[joint] for joint in case.driven}
    meets(case.text, [*case.settings(), *drives], motion(starts, dict.fromkeys(starts, 0.5)))
