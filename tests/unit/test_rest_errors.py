"""Errors of configurations at rest cover what fifty digits tell of mechanisms at random, near folds of their balances too."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import mpmath as mp
import numpy as np
import pytest
import yaml

from robodyn_cli.errors import (
    CapabilityError,
    GeometryError,
    NumericalError,
    SceneError,
    SingularConfigurationError,
)
from robodyn_cli.over.many.command import error_of, number_of
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.report.cells import Figure
from robodyn_cli.report.figures import declared
from robodyn_cli.scene import load_scene_text
from robodyn_cli.tools.progress import Stopwatch
from robodyn_cli.works.linearise.linearise import linearise
from robodyn_cli.works.statics import statics

G = 9.81


def chain(rng: np.random.Generator, joints: int) -> tuple[str, Any, list[str]]:
    """Return pendulums one behind another with springs and the gradient of their potential, by q."""
    names = [f"joint{k}" for k in range(joints)]
    lengths, masses, stiffness = (
        rng.uniform(0.2, 1.5, joints),
        rng.uniform(0.2, 3.0, joints),
        10.0 ** rng.uniform(-1, 2, joints),
    )
    rests, starts = rng.uniform(-3, 3, joints), rng.uniform(-3, 3, joints)
    places = rng.uniform(0.1, 1.0, joints)
    scene = {
        "schema": 1, "gravity": [0, -G, 0],
        "robot": {
            "joints": [
                {"name": name, "type": "revolute", "axis": [0, 0, 1], "origin": {"xyz": [float(lengths[k - 1]) if k else 0, 0, 0]},
                 "spring": {"stiffness": float(stiffness[k]), "rest": float(rests[k])}} for k, name in enumerate(names)
            ],
            "links": [
                {"name": f"link{k}", "mass": float(masses[k]), "com": [float(places[k]), 0, 0], "com_frame": "joint", "inertia": {"zz": 1}}
                for k in range(joints)
            ],
        },
        "initial": {"q": dict(zip(names, starts.tolist()))}, "statics": {"find": "balance"},
    }  # fmt: skip

    def forces(*q: Any) -> list[Any]:
        angle, out = mp.mpf(0), []
        angles = [angle := angle + x for x in q]
        for i in range(joints):
            total = mp.mpf(stiffness[i]) * (q[i] - mp.mpf(rests[i]))
            for k in range(i, joints):
                arm = mp.mpf(places[k]) * mp.cos(angles[k])
                arm += sum(mp.mpf(lengths[j]) * mp.cos(angles[j]) for j in range(i, k))
                total += mp.mpf(masses[k]) * mp.mpf(G) * arm
            out.append(total)
        return out

    return yaml.safe_dump(scene), forces, names


def covered(value: float, true: Any, error: float) -> float:
    """Return how much of an error a figure is off by; it may be all of it."""
    off = abs(float(mp.mpf(value) - true))
    assert off <= error, (value, off, error)
    return off / error if error else 0.0


@pytest.mark.parametrize("seed", range(60))
def test_chains_with_springs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    text, forces, names = chain(rng, 1 + seed % 3)
    try:
        summary = statics(load_scene_text(text)).summary
    except NumericalError:
        pytest.skip("no balance")
    q, off = (
        [own[name] for name in names]
        for own in (summary["configuration"], summary["error_estimate"]["configuration"])
    )
    with mp.workdps(50):
        true = mp.findroot(forces if len(q) > 1 else lambda x: forces(x)[0], [mp.mpf(x) for x in q])
        true = list(true) if len(q) > 1 else [true]
        for value, exact, error in zip(q, true, off):
            covered(value, exact, error)
        H = mp.matrix(len(q), len(q))
        for j in range(len(q)):
            for i in range(len(q)):
                H[i, j] = mp.diff(lambda x, i=i, j=j: forces(*true[:j], x, *true[j + 1 :])[i], true[j])
        values = sorted(mp.eigsy((H + H.T) / 2, eigvals_only=True))
        for value, exact in zip(summary["equilibrium"]["stiffness"], values):
            covered(value, exact, summary["equilibrium"]["stiffness_error"])
    assert max(off) < 1e-9


JOINTS = ("first", "second", "third")


def spring_four_bar(rng: np.random.Generator, seed: int, find: str) -> tuple[str, Any]:
    """Return a four-bar with weights and springs, and its potential and closure by q: ``dV/dq`` and ``(x, y)``."""
    lengths, pivot = rng.uniform(0.4, 1.6, 3), float(rng.uniform(0.3, 1.5))
    masses, places = rng.uniform(0.2, 3.0, 3), rng.uniform(0.1, 1.0, 3)
    stiffness, rests = 10.0 ** rng.uniform(-1, 2, 3), rng.uniform(-3, 3, 3)
    starts = rng.uniform(-3, 3, 3)
    a, b, c = lengths
    if seed % 3 == 0:  # near a dead point: coupler and rocker almost in line
        reach = (b + c) * (1.0 - 10.0 ** -rng.uniform(2.0, 9.0))
        starts[0] = np.arccos(np.clip((a**2 + pivot**2 - reach**2) / (2.0 * a * pivot), -1.0, 1.0))
    joints = [
        {"name": name, "type": "revolute", "axis": [0, 0, 1], "parent": parent, "origin": {"xyz": [x, 0, 0]},
         "link": f"bar{k}", "spring": {"stiffness": float(stiffness[k]), "rest": float(rests[k])}}
        for k, (name, parent, x) in enumerate(zip(JOINTS, ("base", "bar0", "base"), (0.0, float(a), pivot)))
    ]  # fmt: skip
    links = [
        {
            "name": f"bar{k}",
            "mass": float(masses[k]),
            "com": [float(places[k]), 0, 0],
            "com_frame": "joint",
            "inertia": {"zz": 1},
        }
        for k in range(3)
    ]
    points = {
        "one": {"link": "bar1", "at": [float(b), 0, 0]},
        "two": {"link": "bar2", "at": [float(c), 0, 0]},
    }
    scene = {
        "schema": 1, "gravity": [0, -G, 0], "robot": {"joints": joints, "links": links, "points": points},
        "loops": [{"name": "pin", "type": "revolute", "between": ["one", "two"]}], "outputs": {"reactions": True},
        "initial": {"q": dict(zip(JOINTS, starts.tolist())), **({"hold": ["first"]} if find == "hold" else {})},
        "statics": {"find": find}, **({"actuated": ["first"]} if find == "hold" else {}),
    }  # fmt: skip
    a, b, c, m, s, k, rest = (
        *map(mp.mpf, lengths),
        *([mp.mpf(x) for x in own] for own in (masses, places, stiffness, rests)),
    )

    def parts(first: Any, second: Any, third: Any) -> tuple[list[Any], list[Any], list[list[Any]]]:
        """Return dV/dq, the closure, and its derivatives."""
        both, g = first + second, mp.mpf(G)
        arm = m[1] * s[1] * mp.cos(both)
        loads = [
            g * (m[0] * s[0] * mp.cos(first) + m[1] * a * mp.cos(first) + arm),
            g * arm,
            g * m[2] * s[2] * mp.cos(third),
        ]
        loads = [x + kk * (q - r) for x, kk, q, r in zip(loads, k, (first, second, third), rest)]
        closure = [a * f(first) + b * f(both) - c * f(third) for f in (mp.cos, mp.sin)]
        closure[0] -= mp.mpf(pivot)
        J = [[-a * mp.sin(first) - b * mp.sin(both), -b * mp.sin(both), c * mp.sin(third)],
             [a * mp.cos(first) + b * mp.cos(both), b * mp.cos(both), -c * mp.cos(third)]]  # fmt: skip
        return loads, closure, J

    return yaml.safe_dump(scene), parts


def exact(parts: Any, q: Sequence[float], find: str) -> tuple[list[Any], list[Any], Any]:
    """Return positions, forces in the pin and the torque of the crank."""

    def balance(first: Any, second: Any, third: Any, x: Any, y: Any) -> list[Any]:
        loads, closure, J = parts(first, second, third)
        return [*(u - x * jx - y * jy for u, jx, jy in zip(loads, *J)), *closure]

    def held(second: Any, third: Any) -> list[Any]:
        return list(parts(mp.mpf(q[0]), second, third)[1])

    if find == "hold":
        q = [mp.mpf(q[0]), *mp.findroot(held, [mp.mpf(x) for x in q[1:]])]
    loads, _, J = parts(*map(mp.mpf, q))
    pin = mp.lu_solve(mp.matrix([[J[0][1], J[1][1]], [J[0][2], J[1][2]]]), mp.matrix(loads[1:]))
    if find == "balance":
        *q, x, y = mp.findroot(balance, [*map(mp.mpf, q), *pin])
        pin, loads, J = [x, y], *(parts(*q)[k] for k in (0, 2))
    return list(q), list(pin), loads[0] - pin[0] * J[0][0] - pin[1] * J[1][0]


@pytest.mark.parametrize("find", ["balance", "hold"])
@pytest.mark.parametrize("seed", range(40))
def test_four_bars_with_springs(seed: int, find: str) -> None:
    text, parts = spring_four_bar(np.random.default_rng(seed), seed, find)
    try:
        summary = statics(load_scene_text(text)).summary
    except (GeometryError, SingularConfigurationError, NumericalError):
        pytest.skip("bars that do not reach, or in line")
    with mp.workdps(50):
        q, pin, torque = exact(parts, list(summary["configuration"].values()), find)
        off = summary["error_estimate"]
        for name, true in zip(JOINTS, q):
            covered(summary["configuration"][name], true, off["configuration"][name])
        if find == "hold":
            covered(summary["torques_of_joints"]["first"], torque, off["torques_of_joints"]["first"])
        for value, true, error in zip(
            *(own.values() for own in (summary["multipliers"],)), pin, off["multipliers"].values()
        ):
            covered(abs(value), abs(true), error)
        load = summary["reactions"]["largest"]["pin"]
        covered(load["peak_force"], mp.sqrt(pin[0] ** 2 + pin[1] ** 2), load["force_error"])
        rank, sizes = summary["mobility"], mp.svd(mp.matrix(parts(*q)[2]), compute_uv=False)
        covered(rank["smallest_kept"], sizes[1] / sizes[0], rank["smallest_kept_error"])
    assert max(off["configuration"].values()) < 1e-6


def test_errors_of_several_four_bars_cover_and_are_small() -> None:
    """Those of loads and torques too, which have no more digits than multipliers."""
    ratios = []
    for seed, find in itertools.product(range(1, 9), ("balance", "hold")):
        text, parts = spring_four_bar(np.random.default_rng(seed), seed, find)
        try:
            summary = statics(load_scene_text(text)).summary
        except (GeometryError, SingularConfigurationError, NumericalError):
            continue
        with mp.workdps(50):
            q, pin, torque = exact(parts, list(summary["configuration"].values()), find)
            off, load = summary["error_estimate"], summary["reactions"]["largest"]["pin"]
            force, rank = mp.sqrt(pin[0] ** 2 + pin[1] ** 2), summary["mobility"]
            sizes = mp.svd(mp.matrix(parts(*q)[2]), compute_uv=False)
            told = [
                *((summary["configuration"][x], true, off["configuration"][x]) for x, true in zip(JOINTS, q)),
                *((abs(x), abs(true), off["multipliers"][row]) for (row, x), true in zip(summary["multipliers"].items(), pin)),
                (load["peak_force"], force, load["force_error"]),
                (rank["smallest_kept"], sizes[1] / sizes[0], rank["smallest_kept_error"]),
            ]  # fmt: skip
            if find == "hold":
                told.append(
                    (summary["torques_of_joints"]["first"], torque, off["torques_of_joints"]["first"])
                )
            ratios += [covered(*one) for one in told]
            assert load["force_error"] < 1e-8 * max(1.0, load["peak_force"])
            assert max(off["multipliers"].values()) < 1e-8 * max(1.0, load["peak_force"])
    assert len(ratios) > 60 and np.median(ratios) > 1e-3


@pytest.mark.parametrize("about", ["balance", "hold"])
@pytest.mark.parametrize("seed", range(12))
def test_what_holds_a_linear_model(seed: int, about: str) -> None:
    text, parts = spring_four_bar(np.random.default_rng(seed), seed, "hold")
    try:
        summary = linearise(load_scene_text(text), about=about).summary
    except (GeometryError, SingularConfigurationError, NumericalError, CapabilityError):
        pytest.skip("bars that do not reach, or in line")
    with mp.workdps(50):
        q, _, torque = exact(parts, list(summary["configuration"].values()), "hold")
        for name, true in zip(JOINTS, q):
            covered(summary["configuration"][name], true, summary["error_estimate"]["configuration"][name])
        covered(summary["largest_acceleration"], mp.mpf(0), summary["largest_acceleration_error"])
        error = summary["holding_torques_error"]["first"]
        covered(summary["holding_torques"]["first"], torque, error)
    assert error < 1e-6 * max(1.0, abs(torque))


@pytest.mark.parametrize("seed", range(0, 60, 3))
def test_the_pose_of_a_regulator_near_dead_points(seed: int) -> None:
    text, parts = spring_four_bar(np.random.default_rng(seed), seed, "hold")
    scene = yaml.safe_load(text)
    pose, gains = (
        {"first": scene["initial"]["q"]["first"]},
        {key: {"first": 1.0} for key in ("q", "qd", "tau")},
    )
    control = {"type": "lqr", "joints": ["first"], "pose": pose, "gains": gains}
    scene |= {"command": "simulate", "simulate": {"duration": 0.01}, "control": control}
    del scene["statics"]
    try:
        design = integrable(load_scene_text(yaml.safe_dump(scene)), Stopwatch()).control.design
    except (GeometryError, SingularConfigurationError, SceneError):
        pytest.skip("bars that do not reach, or a pose that cannot be kept")
    at = [x for _, x in design.at]
    with mp.workdps(50):
        q, _, torque = exact(parts, at, "hold")
        for value, true, error in zip(at, q, design.at_errors):
            covered(value, true, error)
        assert max(design.at_errors) < 1e-6
        covered(design.holding[0], torque, design.holding_errors[0])


@pytest.mark.parametrize("seed", range(12))
def test_joints_that_are_held_are_where_they_are(seed: int) -> None:
    """Nothing is left of solving for them beside the others."""
    scene = yaml.safe_load(spring_four_bar(np.random.default_rng(seed), seed, "balance")[0])
    scene["initial"]["q"]["first"], scene["initial"]["hold"] = 0.0, ["first"]
    try:
        summary = statics(load_scene_text(yaml.safe_dump(scene))).summary
    except (GeometryError, SingularConfigurationError, NumericalError):
        pytest.skip("bars that do not reach, or in line")
    for own in (summary["configuration"], summary["error_estimate"]["configuration"]):
        assert own["first"] == 0.0


@pytest.mark.parametrize("find", ["balance", "hold"])
def test_many_runs_state_the_errors_of_single_ones(find: str) -> None:
    text, _ = spring_four_bar(np.random.default_rng(7), 7, find)
    keys = [
        "configuration.second",
        "torques_of_joints.first",
        "multipliers.pin.x",
        "reactions.largest.pin.peak_force",
        "mobility.smallest_kept",
    ]
    keys += ["equilibrium.stiffness.0"] if find == "balance" else []
    mechanism = Mechanism(load_scene_text(text), vary=["robot.links.bar1.mass"])
    masses = [0.5, 0.9, 1.4]
    runs = mechanism.statics_many({"robot.links.bar1.mass": masses}, of=keys)
    for k, mass in enumerate(masses):
        summary = statics(load_scene_text(text, overrides=[f"robot.links.bar1.mass={mass}"])).summary
        for key in keys:
            assert runs.outputs[key][k] == pytest.approx(number_of(summary, key), abs=1e-9)
            # rounding of either, which is drawn, is not the same
            assert runs.errors[key][k] == pytest.approx(error_of(summary, key), rel=0.9, abs=1e-16)


INDIFFERENT = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{{name: a, type: revolute, axis: [0, 0, 1]{spring}}}]
  links: [{{name: l, mass: 1, com: [{com}], com_frame: joint, inertia: {{zz: 1}}}}]
initial: {{q: {{a: 0.3}}}}
{torques}
"""


def at_a_fold(**given: str) -> tuple[float, float, dict[str, Any]]:
    text = INDIFFERENT.format(**{"spring": "", "com": "1, 0, 0", "torques": "", **given})
    summary = statics(load_scene_text(text)).summary
    return (
        summary["configuration"]["a"],
        summary["error_estimate"]["configuration"]["a"],
        summary["equilibrium"],
    )


def test_where_two_balances_meet_the_error_is_their_distance_at_most() -> None:
    """A stiff pendulum beside it is known as well as ever."""
    for beside, below in itertools.product((False, True), (1e-3, 1e-7, 1e-11, 1e-13, 1e-14, 1e-15, 0.0)):
        torque = G * (1.0 - below)
        scene = yaml.safe_load(
            INDIFFERENT.format(spring="", com="1, 0, 0", torques=f"torques: {{a: {torque!r}}}")
        )
        if beside:
            joint = {"name": "b", "type": "revolute", "parent": "base", "link": "m", "axis": [0, 0, 1]}
            scene["robot"]["joints"].append({**joint, "spring": {"stiffness": 1e4, "rest": 0.4}})
            scene["robot"]["links"].append({**scene["robot"]["links"][0], "name": "m"})
            scene["initial"]["q"]["b"] = 0.3
        summary = statics(load_scene_text(yaml.safe_dump(scene))).summary
        q, off, facts = (
            summary["configuration"],
            summary["error_estimate"]["configuration"],
            summary["equilibrium"],
        )
        with mp.workdps(50):
            true = 2 * mp.pi - mp.acos(min(mp.mpf(1), mp.mpf(torque) / mp.mpf(G)))
            covered(q["a"], true, off["a"])
            covered(facts["stiffness"][0], -mp.mpf(G) * mp.sin(true), facts["stiffness_error"])
            if beside:
                other = mp.findroot(
                    lambda b: 10000 * (b - mp.mpf(0.4)) + mp.mpf(G) * mp.cos(b), mp.mpf(q["b"])
                )
                covered(q["b"], other, off["b"])
                assert off["b"] < 1e-13
        assert off["a"] < 1e-6 and facts["stiffness_error"] < 1e-5


@pytest.mark.parametrize("above", [-1e-6, -1e-10, 0.0, 1e-14, 1e-10, 1e-6])
def test_a_column_about_to_buckle(above: float) -> None:
    """k q = m g sin(q): three balances meet where k = m g, and the stiffness vanishes."""
    k = G * (1.0 + above)
    q, error, facts = at_a_fold(spring=f", spring: {{stiffness: {k!r}, rest: 0}}", com="0, 1, 0")
    with mp.workdps(50):
        beside = (
            mp.findroot(lambda x: mp.mpf(k) * x - mp.mpf(G) * mp.sin(x), mp.sqrt(-6 * above))
            if above < 0.0
            else 0
        )
        covered(abs(q), abs(beside), error)
    assert error < 1e-6 and (above != 0.0 or facts["stability"] == "indifferent")


def test_what_nothing_holds_is_the_nearest_of_its_balances() -> None:
    q, error, facts = at_a_fold(com="0, 0, 0")
    assert (q, error, facts["stability"]) == (0.3, 0.0, "indifferent")


BALL = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: ball, type: spherical, spring: {stiffness: 3}}
    - {name: arm, type: revolute, axis: [0,0,1], origin: {xyz: [0.7, 0, 0]}, spring: {stiffness: 2}}
  links:
    - {name: a, mass: 1, com: [0.3,0,0], com_frame: joint, inertia: {xx: 1, yy: 1, zz: 1}}
    - {name: b, mass: 1, com: [0.3,0,0], com_frame: joint, inertia: {xx: 1, yy: 1, zz: 1}}
initial: {q: {ball: {rotation_vector: [0.1,0.2,0.4]}, arm: 0}, hold: [ball]}
statics: {find: balance}
"""


def test_coordinates_of_balls_have_their_errors_in_tables() -> None:
    """Their names have dots, as keys have."""
    found = statics(load_scene_text(BALL))
    joints = [table for table in declared(found) if table.head[0] == "joint"]
    told = {str(row[0]): row[1] for table in joints for row in table.rows}
    off = found.summary["error_estimate"]
    assert {"ball.qw", "ball.wx", "arm"} <= set(told)
    for name, figure in told.items():
        known = [off[key][name] for key in ("configuration", "torques_of_joints") if name in off[key]]
        assert isinstance(figure, Figure) and figure.error in known, name
