"""Mechanisms with fewer actuators than degrees of freedom: torques exist where passive freedoms take the motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robodyn_cli import inverse, load_scene_text, simulate, statics
from robodyn_cli.errors import CapabilityError
from tests.mechanisms import SLIDER, close

# a slider-crank whose piston falls, with a pendulum on it that nothing drives; its centre of mass lies beside the rod
PENDULUM = "    - {name: bob, type: revolute, parent: piston, a: 0.4, alpha: 0, d: 0, origin: {rpy: [0, -90 deg, 0]}}\n"
WEIGHT = "    - {name: weight, mass: 0.7, com: [0.3, 0.02, 0], com_frame: joint, inertia: {zz: 0.02}}\n"
HANGS = -math.atan2(0.02, 0.3)
SCENE = (
    ("schema: 1\n" + SLIDER)
    .replace("  links:", PENDULUM + "  links:")
    .replace("loops:", WEIGHT + "loops:")
    .replace("[0, -9.81, 0]", "[9.81, 0, 0]")
)
CRANK = "0.2 + 0.5*pi*t + 0.3*sin(2*t)"


def overrides(bob: float, *more: str) -> list[str]:
    moves = f"trajectory={{type: joint, duration: 1, q: {{crank: '{CRANK}', bob: '{bob!r}'}}}}"
    return [moves, "torques=null", f"initial.q.bob={bob!r}", "inverse.samples=41", *more]


def test_passive_freedoms_that_take_the_motion_leave_torques() -> None:
    """The pendulum hangs still: the crank alone gives what crank and pendulum's motor together do, and what a
    simulation with the crank prescribed needs."""
    one = inverse(load_scene_text(SCENE, overrides=overrides(HANGS, "actuated=[crank]")))
    two = inverse(load_scene_text(SCENE, overrides=overrides(HANGS, "actuated=[crank, bob]")))
    close(one["tau"], two["tau"], 1e-12)
    assert one.summary["mechanism"]["torques"] == "unique"
    assert one.summary["error_estimate"]["virtual_work_residual"] < 1e-12
    led = [
        "torques=null",
        f"prescribed={{crank: '{CRANK}'}}",
        f"initial.q.bob={HANGS!r}",
        "initial.qd={bob: 0}",
    ]
    run = simulate(
        load_scene_text(
            SCENE, overrides=[*led, "simulate.duration=1", "simulate.samples=41", "actuated=[crank]"]
        )
    )
    close(run["q"][:, 3], np.full(41, HANGS), 1e-9)
    close(run["tau"][:, 0], one["tau"][:, 0], 1e-7)


def test_the_least_that_is_left_is_told() -> None:
    """A pendulum held aside needs m g c sin, as the piston accelerates: no torque of the crank gives it."""
    with pytest.raises(CapabilityError, match=r"command 1 of them.*N m in joint 'bob' at t = ") as caught:
        inverse(load_scene_text(SCENE, overrides=overrides(HANGS + 0.1, "actuated=[crank]")))
    both = inverse(load_scene_text(SCENE, overrides=overrides(HANGS + 0.1, "actuated=[crank, bob]")))
    close(caught.value.details["residual"], np.abs(both["tau"][:, 3]).max(), 1e-9)


def test_joints_that_a_motion_leaves_free_are_told() -> None:
    moves = f"trajectory={{type: joint, duration: 1, q: {{crank: '{CRANK}'}}}}"
    with pytest.raises(
        CapabilityError, match="leads 1, which leaves bob free to move; allowed: lead 2 joints"
    ):
        inverse(load_scene_text(SCENE, overrides=[moves, "torques=null", "initial.q.bob=0"]))


def test_a_pose_is_held_where_passive_freedoms_balance() -> None:
    hold = ["actuated=[crank]", "statics={find: hold}", "torques=null"]
    given = "initial={{q: {{crank: 0.2, rod: -0.3, slide: 1.1, bob: {!r}}}, hold: [crank, bob]}}"
    held = statics(load_scene_text(SCENE, overrides=[*hold, given.format(HANGS)]))
    both = statics(load_scene_text(SCENE, overrides=[*hold, given.format(HANGS), "actuated=[crank, bob]"]))
    close(held["tau"], both["tau"], 1e-12)
    with pytest.raises(CapabilityError, match=r"leave 0.\d+ N m in joint 'bob'; allowed: .*balance"):
        statics(load_scene_text(SCENE, overrides=[*hold, given.format(0.4)]))
