"""Reactions along runs: closed forms, balances, frames, missing data, files and drawings."""

from __future__ import annotations

import numpy as np

from robodyn_cli import inverse, load_scene, load_scene_text, simulate
from robodyn_cli.expr.functions import sin
from robodyn_cli.expr.graph import Graph
from robodyn_cli.model.model import UNKNOWN_GROUP, are_known, unknown_among
from robodyn_cli.report.registry import draw
from robodyn_cli.results.hdf5 import read
from robodyn_cli.results.hdf5 import write as write_result
from robodyn_cli.results.result import Result
from tests.mechanisms import CONFIGS, SIX_BAR, SLIDER, close

ASKED = "outputs.reactions=true"
WORLD = "outputs.reaction_axes=world"

PENDULUM = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{name: swing, type: revolute, axis: [0, 0, 1]}]
  links: [{name: rod, mass: 2, com: [0.5, 0, 0.1], inertia: {xx: 0.1, yy: 0.2, zz: 0.25}}]
initial: {q: {swing: 0.3}, qd: {swing: 1.5}}
simulate: {duration: 1, samples: 21}
outputs: {reactions: true, reaction_axes: AXES}
"""


def column(result: Result, path: str, name: str) -> np.ndarray:
    return result[path][:, result.variables[path].names.index(name)]


def test_pendulum_by_hand() -> None:
    """The pin pulls with m (g + a) and holds the moment of the centre of mass that lies off the plane."""
    for axes in ("joint", "world"):
        result = simulate(load_scene_text(PENDULUM.replace("AXES", axes)))
        q, qd, qdd = (result[x][:, 0] for x in ("q", "qd", "qdd"))
        along, across = np.stack([np.cos(q), np.sin(q)]), np.stack([-np.sin(q), np.cos(q)])
        force = 2 * (0.5 * (qdd * across - qd**2 * along) + np.array([[0], [9.81]]))
        if axes == "joint":
            force = np.stack([(force * along).sum(axis=0), (force * across).sum(axis=0)])
        for k, name in enumerate(("fx", "fy")):
            close(column(result, "reactions/swing", name), force[k], 1e-11)
        # the force acts at the height of the centre of mass, 0.1 above the pin's origin
        close(column(result, "reactions/swing", "mx"), -0.1 * force[1], 1e-11)
        close(column(result, "reactions/swing", "my"), 0.1 * force[0], 1e-11)
        close(column(result, "reactions/swing", "mz"), 0.0, 1e-11)


def test_axial_component_is_the_torque_of_the_joint() -> None:
    """Of the actuator, less what friction and the rotor take."""
    scene = load_scene(CONFIGS / "seven_joint_arm.yaml", [ASKED])
    result = inverse(scene)
    for k, joint in enumerate(scene.robot.joints):
        rotor = joint.gear_ratio**2 * joint.rotor_inertia * result["qdd"][:, k]
        own = result["tau"][:, k] - result["torque_terms/friction"][:, k] - rotor
        close(column(result, f"reactions/{joint.name}", "mz"), own, 1e-10)
    close(result["base_wrench"][:, :3], _world_force(result), 1e-9)


def _world_force(result: Result) -> np.ndarray:
    """The first joint's force in world axes: its frame turns about the world's z by q1."""
    q, f = result["q"][:, 0], result["reactions/q1"][:, :3]
    return np.stack(
        [np.cos(q) * f[:, 0] - np.sin(q) * f[:, 1], np.sin(q) * f[:, 0] + np.cos(q) * f[:, 1], f[:, 2]], 1
    )


def test_planar_scenes_need_no_data_of_the_plane() -> None:
    result = simulate(load_scene_text("schema: 1\n" + SIX_BAR, overrides=[ASKED]))
    assert result.variables["reactions/crank"].names == ("fx", "fy", "fz", "mz")
    assert result.summary["reactions"]["not_determined"]["crank"] == ["mx", "my"]
    assert np.all(np.isfinite(result["base_wrench"]))


def test_multipliers_are_the_force_of_the_pin() -> None:
    result = simulate(load_scene_text("schema: 1\n" + SLIDER, overrides=[ASKED, WORLD]))
    rows = result.variables["constraints/multipliers"].names
    lam = result["constraints/multipliers"]
    for axis in "xy":
        close(column(result, "loop_reactions/pin", f"f{axis}"), lam[:, rows.index(f"pin.{axis}")], 1e-10)
    # the ground holds crank and slide together
    both = result["reactions/crank"][:, :3] + result["reactions/slide"][:, :3]
    close(result["base_wrench"][:, :3], both, 1e-10)


def test_file_and_drawing(tmp_path) -> None:  # type: ignore[no-untyped-def]
    result = simulate(load_scene_text("schema: 1\n" + SLIDER, overrides=[ASKED]))
    write_result(result, tmp_path / "result.h5")
    again = read(tmp_path / "result.h5")
    assert again.variables["reactions/crank"].names == result.variables["reactions/crank"].names
    assert "what base exerts on disc" in again.variables["reactions/crank"].long_name
    assert len(draw(again, "reactions").axes) == 2


def test_not_recorded_unless_asked_for() -> None:
    result = simulate(load_scene_text("schema: 1\n" + SLIDER))
    assert not result.group("reactions") and "reactions" not in result.summary


def test_what_depends_on_missing_data_is_told_for_many_entries_at_once() -> None:
    graph = Graph()
    q, m = graph.symbol("q", "q"), graph.symbol("mass of a link", UNKNOWN_GROUP)
    entries = [2.0, q, m, q * m + 1.0, q * q, sin(q + m), 0.0 * m]
    assert are_known(entries) == [not unknown_among([e]) for e in entries]
    assert are_known(entries) == [True, True, False, False, True, False, True]


FORCED = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: one, type: revolute, axis: [0, 0, 1]}
    - {name: two, type: revolute, axis: [0, 0, 1], origin: {xyz: [1, 0, 0]}}
  links: [{name: a, mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.1}}, {name: b, mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.1}}]
  points:
    tip: {link: b, at: [1, 0, 0]}
    eye: {link: a, at: [0.3, 0.2, 0]}
    post: {link: base, at: [0.4, 2, 0]}
    mid: {link: a, at: [1, 0, 0]}
forces:
  - {name: coil, type: spring, between: [eye, tip], stiffness: 5, length: 0.4, damping: 0.3}
  - {name: rope, type: constant_force, between: [post, tip], force: 3}
  - {name: twist, type: torsional_spring, between: [a.origin, tip], stiffness: 2, rest: 0.1}
  - {name: bush, type: bushing, between: [mid, b.origin], stiffness: [0, 0, 0, 0, 0, 1.5]}
  - {name: push, type: force, at: tip, force: [1, -2, 0]}
  - {name: own, type: force, at: tip, force: [1, -2, 0], frame: body}
  - {name: turn, type: wrench, at: tip, moment: [0, 0, 0.1]}
initial: {q: {one: 0.3, two: 0.8}, qd: {one: 1, two: -0.5}}
simulate: {duration: 0.4, samples: 21}
outputs: {reactions: true, extremes: [force_wrenches/coil.force, force_wrenches/twist.mz]}
"""


def test_wrenches_of_forces_are_those_of_their_laws() -> None:
    """Each on its last place, in world axes, by hand from positions and rates."""
    result = simulate(load_scene_text(FORCED))
    q, qd = result["q"], result["qd"]
    turn = q.sum(axis=1)
    tip = np.column_stack([np.cos(q[:, 0]) + np.cos(turn), np.sin(q[:, 0]) + np.sin(turn)])
    c, s = np.cos(q[:, 0]), np.sin(q[:, 0])
    eye = np.column_stack([0.3 * c - 0.2 * s, 0.3 * s + 0.2 * c])
    back = eye - tip
    length = np.linalg.norm(back, axis=1)
    v_eye = qd[:, :1] * np.column_stack([-eye[:, 1], eye[:, 0]])
    v_tip = qd[:, :1] * np.column_stack([-s, c]) + qd.sum(axis=1)[:, None] * np.column_stack(
        [-np.sin(turn), np.cos(turn)]
    )
    tension = 5 * (length - 0.4) + 0.3 * np.einsum("ij,ij->i", back, v_eye - v_tip) / length
    up = np.array([0.4, 2.0]) - tip
    ct, st = np.cos(turn), np.sin(turn)
    by_hand = {
        "coil": back * (tension / length)[:, None],
        "rope": 3 * up / np.linalg.norm(up, axis=1)[:, None],
        "push": np.tile([1.0, -2.0], (len(q), 1)),
        "own": np.column_stack([ct + 2 * st, st - 2 * ct]),
    }
    for name, force in by_hand.items():
        wrench = result[f"force_wrenches/{name}"]
        np.testing.assert_allclose(wrench[:, :2], force, atol=1e-12)
        np.testing.assert_allclose(wrench[:, 2:], 0.0, atol=1e-12)
    for name, moment in (("twist", -2 * (q[:, 1] - 0.1)), ("bush", -1.5 * q[:, 1]), ("turn", 0.1 + 0 * turn)):
        np.testing.assert_allclose(result[f"force_wrenches/{name}"][:, 5], moment, atol=1e-12)
    assert "coil" not in result.summary["reactions"]["largest"]
    most = result.summary["extremes"]["force_wrenches/coil.force"]
    assert most["unit"] == "N" and most["largest"] >= np.abs(tension).max() - most["errors"]["largest"]
