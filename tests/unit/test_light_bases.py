"""Loops of pins in a tilted plane on bases that move and turn, with mass and without: many of the rows are redundant.

The oracle is the saddle-point system of all bodies in space, solved in the null space of every joint's and every pin's
conditions at once: it knows no trees, no rows of loops and none of the program's functions.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from robodyn_cli import Mechanism, load_scene_text
from robodyn_cli.integrators.runtime.stopped import rates_at
from robodyn_cli.motion.build import build_motion
from robodyn_cli.over.plan.plan import plan
from robodyn_cli.ready.integrable import integrable
from tests.mechanisms import close

Data = dict[str, Any]
FLIP = Rotation.from_euler("x", np.pi)  # of the right branch, whose axes point the other way
BASES = ("fixed", "revolute", "spherical", "floating")


def mechanism(seed: int, mass: float, base: str, loops: int = 1) -> Data:
    """Return five-bars in tilted planes on a base; the pins are put where the tips of two branches meet."""
    rng = np.random.default_rng(seed)
    root: Data = {"name": "root", "type": base, "parent": "base", "link": "hub"}
    q: Data = {}
    if base == "revolute":
        root |= {"axis": [0.3, 0.2, 1.0]}
        q["root"] = 0.2
    if base == "spherical":
        q["root"] = {"rpy": [0.1, 0.2, 0.3]}
    if base == "floating":
        q["root"] = {"xyz": [0, 0, 1], "rpy": [0.1, 0.2, 0.3]}
    hub: Data = {"name": "hub", "mass": 0}
    if mass:
        hub = {
            "name": "hub",
            "mass": mass,
            "com": [0, 0, 0],
            "inertia": dict.fromkeys(("xx", "yy", "zz"), mass * 0.01),
        }
    joints, links, points, pins, qd = [root], [hub], {}, [], {}
    for n in range(loops):
        mount = Rotation.random(random_state=rng)
        ends = []
        for side, sign in (("l", 1.0), ("r", -1.0)):
            place, turn = rng.uniform(-0.1, 0.1, 3) * [1, 1, 0], Rotation.identity() if sign > 0 else FLIP
            T = (mount.apply(place + [0.2 * sign, 0, 0]), mount * turn)
            parent = "hub"
            for k in (1, 2):
                name, angle = f"{side}{k}{n}", rng.uniform(0.4, 1.2) * (-1) ** k
                rpy = [float(x) for x in T[1].as_euler("xyz")] if k == 1 else [0, 0, 0]
                xyz = T[0].tolist() if k == 1 else [0.25, 0, 0]
                joints.append({"name": name, "type": "revolute", "parent": parent, "axis": [0, 0, sign],
                               "link": f"b{name}", "origin": {"xyz": xyz, "rpy": rpy}})  # fmt: skip
                links.append({"name": f"b{name}", "mass": float(rng.uniform(0.2, 0.5)), "com": [0.12, 0, 0],
                              "inertia": {"xx": 2e-4, "yy": 2e-3, "zz": 2.1e-3}})  # fmt: skip
                q[name], parent = angle, f"b{name}"
                at = T[0] if k == 1 else T[0] + T[1].apply([0.25, 0, 0])
                T = (at, T[1] * Rotation.from_rotvec([0, 0, sign * angle]))
            ends.append((parent, T))
        meet = ends[0][1][0] + mount.apply([*rng.uniform(0.1, 0.2, 2), 0.0])
        for side, (link, (p, R)) in zip("lr", ends):
            points[f"{side}{n}"] = {"link": link, "at": R.inv().apply(meet - p).tolist()}
        pins.append({"name": f"pin{n}", "type": "revolute", "between": [f"l{n}", f"r{n}"],
                     "axis": [0, 0, 1], "axis2": [0, 0, -1]})  # fmt: skip
        qd[f"l1{n}"] = float(rng.normal())
    hold = list(q)
    qd |= (
        {"root": rng.normal(size={"spherical": 3, "floating": 6}[base]).tolist()}
        if base in ("spherical", "floating")
        else {}
    )
    if base == "revolute":
        qd["root"] = float(rng.normal())
    return {
        "schema": 1, "gravity": [0.5, -1.0, -9.0],
        "robot": {"joints": joints, "links": links, "points": points},
        "loops": pins, "torques": {f"l1{n}": 0.3 for n in range(loops)},
        "initial": {"q": q, "qd": qd, "hold": hold}, "simulate": {"duration": 0.1, "samples": 2},
    }  # fmt: skip


def accelerations(data: Data, q: dict[str, Any], v: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the accelerations of all joints from those of all bodies in space, by joint.

    q : angle, or attitude and place of the base. v : rates, those of the base in its own axes.
    """
    robot, ground = data["robot"], {"p": np.zeros(3), "R": Rotation.identity(), "w": np.zeros(3)}
    bodies: dict[str, Data] = {"base": ground}
    number = {link["name"]: k for k, link in enumerate(robot["links"])}
    n = 6 * len(number)
    rows: list[tuple[np.ndarray, np.ndarray]] = []

    def columns(name: str, of_place: Any, of_turn: Any) -> np.ndarray:
        J = np.zeros((3, n))
        if name in number:
            k = 6 * number[name]
            J[:, k : k + 3], J[:, k + 3 : k + 6] = of_place, of_turn
        return J

    def skew(x: Any) -> np.ndarray:
        return np.cross(np.eye(3), x)

    def join(first: str, second: str, meet: np.ndarray | None, axis: np.ndarray | None) -> None:
        """Add that a place of two bodies stays the same, and that these turn about an axis of the first alone."""
        A, B = bodies[first], bodies[second]
        if meet is not None:
            J, drift = np.zeros((3, n)), np.zeros(3)
            for sign, name, X in ((1, first, A), (-1, second, B)):
                arm = meet - X["p"]
                J += sign * columns(name, np.eye(3), -skew(arm))
                drift += sign * np.cross(X["w"], np.cross(X["w"], arm))
            rows.append((J, drift))
        if axis is not None:
            turn = columns(second, np.zeros((3, 3)), np.eye(3)) - columns(first, np.zeros((3, 3)), np.eye(3))
            w = B["w"] - A["w"]
            rows.append((skew(axis).T @ turn, np.cross(w, np.cross(A["w"], axis))))

    tau = np.zeros(n)
    for joint in robot["joints"]:
        A, name, origin = bodies[joint["parent"]], joint["link"], joint.get("origin", {})
        p = A["p"] + A["R"].apply(origin.get("xyz", np.zeros(3)))
        R = A["R"] * Rotation.from_euler("xyz", origin.get("rpy", np.zeros(3)))
        own, rate = q.get(joint["name"]), v.get(joint["name"])
        if joint["type"] == "revolute":
            u = np.array(joint["axis"]) / np.linalg.norm(joint["axis"])
            axis = R.apply(u)
            B = {"p": p, "R": R * Rotation.from_rotvec(u * own), "w": A["w"] + axis * rate}
            bodies[name] = B
            join(joint["parent"], name, p, axis)
            torque = data["torques"].get(joint["name"], 0.0) * axis
            for body, sign in ((name, 1.0), (joint["parent"], -1.0)):
                if body in number:
                    tau[6 * number[body] + 3 :][:3] += sign * torque
        else:
            place, R = own if own is not None else (p, R)
            speed = np.zeros(6) if rate is None else rate
            bodies[name] = {"p": place, "R": R, "w": R.apply(speed[3:]), "v": R.apply(speed[:3])}
            if joint["type"] != "floating":
                join("base", name, place, None)
            if joint["type"] == "fixed":
                rows.append((columns(name, np.zeros((3, 3)), np.eye(3)), np.zeros(3)))
    for pin in data["loops"]:
        first, second = (robot["points"][x] for x in pin["between"])
        A = bodies[first["link"]]
        meet = A["p"] + A["R"].apply(first["at"])
        join(first["link"], second["link"], meet, A["R"].apply(pin["axis"]))

    M, f = np.zeros((n, n)), tau
    for link in robot["links"]:
        B, k, m = bodies[link["name"]], 6 * number[link["name"]], link["mass"]
        c = B["R"].apply(link.get("com", [0, 0, 0]))
        inertia = link.get("inertia", {"xx": 0.0, "yy": 0.0, "zz": 0.0})
        R = B["R"].as_matrix()
        central = R @ np.diag([inertia[x] for x in ("xx", "yy", "zz")]) @ R.T
        to_com = np.hstack([np.eye(3), -skew(c)])
        M[k : k + 6, k : k + 6] += m * to_com.T @ to_com
        M[k + 3 : k + 6, k + 3 : k + 6] += central
        force = m * (np.array(data["gravity"]) - np.cross(B["w"], np.cross(B["w"], c)))
        f[k : k + 6] += to_com.T @ force
        f[k + 3 : k + 6] -= np.cross(B["w"], central @ B["w"])
    J, drift = np.vstack([x for x, _ in rows]), np.concatenate([x for _, x in rows])
    least = np.linalg.lstsq(J, -drift, rcond=1e-11)[0]
    assert np.abs(J @ least + drift).max() < 1e-9  # the state obeys all conditions
    N = null_space(J, rcond=1e-11)
    a = least + N @ np.linalg.solve(N.T @ M @ N, N.T @ (f - M @ least))
    found = {}
    for joint in robot["joints"]:
        A, B, name = bodies[joint["parent"]], bodies[joint["link"]], joint["name"]
        own = a[6 * number[joint["link"]] :][:6]
        back = B["R"].inv()
        if joint["type"] == "revolute":
            axis = A["R"] * Rotation.from_euler("xyz", joint.get("origin", {}).get("rpy", np.zeros(3)))
            before = a[6 * number[joint["parent"]] + 3 :][:3] if joint["parent"] in number else np.zeros(3)
            found[name] = np.array([axis.apply(joint["axis"]) @ (own[3:] - before)]) / np.linalg.norm(
                joint["axis"]
            )
        elif joint["type"] == "spherical":
            found[name] = back.apply(own[3:])
        elif joint["type"] == "floating":
            found[name] = np.concatenate(
                [back.apply(own[:3] - np.cross(B["w"], B["v"])), back.apply(own[3:])]
            )
    return found


def at_start(data: Data, stabilisation: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray]:
    """Return the motion of a scene, q, v, and the accelerations of the equations that are integrated."""
    chosen = {**data, "simulate": {**data["simulate"], "stabilisation": stabilisation}}
    motion = build_motion(integrable(load_scene_text(json.dumps(chosen))))
    system, q, v = motion.system, motion.assembled.q, motion.assembled.v
    x = system.join(q, v)
    rates = rates_at(system, 0.0, x, system.parameters_at(0.0, q))
    return motion, q, v, np.concatenate([x[system.nq : system.nq + system.nv], rates])[list(system.v_places)]


CASES = [*((base, mass, 1) for base in BASES for mass in (0.0, 0.05, 1.0)), ("floating", 1e-4, 2)]


@pytest.mark.parametrize(("base", "mass", "loops"), CASES)
def test_accelerations_are_those_of_all_bodies_in_space(base: str, mass: float, loops: int) -> None:
    """All formulations, and the functions of states, at starts in which everything moves and turns."""
    data = mechanism(len(base), mass, base, loops)
    ours = Mechanism(load_scene_text(json.dumps(data)))
    expected = None
    for stabilisation in ("none", "projection", {"alpha": 5, "beta": 5}):
        motion, q, v, qdd = at_start(data, stabilisation)
        if expected is None:
            expected = oracle(data, motion.problem.model, q, v)
            tau = np.array([data["torques"].get(name, 0.0) for name in motion.problem.model.v_names])
            close(ours.forward_dynamics(q, v, tau), expected, 1e-9 * np.abs(expected).max())
        close(qdd, expected, 1e-9 * np.abs(expected).max())
    assert len(motion.problem.dependent) == loops


def oracle(data: Data, model: Any, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the accelerations of the oracle in the model's order."""
    own: Data = {}
    rates: Data = {}
    for body in model.bodies:
        at, rate = q[body.q : body.q + body.joint.nq], v[body.v : body.v + body.joint.nv]
        if body.joint_name == "root" and body.joint.nv > 1:
            place, turn = (at[:3], at[3:]) if len(at) == 7 else (np.zeros(3), at)
            own["root"] = place, Rotation.from_quat([*turn[1:], turn[0]])
            rates["root"] = rate if len(rate) == 6 else np.concatenate([np.zeros(3), rate])
        else:
            own[body.joint_name], rates[body.joint_name] = at[0], rate[0]
    there = accelerations(data, own, rates)
    return np.concatenate([there[b.joint_name] for b in sorted(model.bodies, key=lambda b: b.v)])


CONTROLLERS = [
    {"type": "pd", "gains": {"kp": 100, "kd": 20}},
    {"type": "gravity", "gains": {"kp": 100, "kd": 20}},
    {"type": "feed_forward", "gains": {"kp": 100, "kd": 20}},
    {"type": "computed_torque", "gains": {"kp": 100, "kd": 20}},
    {"type": "computed_torque", "gains": {"kp": 100, "kd": 20}, "period": 0.001, "delay": 0.0005},
    {
        "type": "computed_torque",
        "gains": {"kp": 100, "kd": 20},
        "model": {"set": {"robot.links.bl10.mass": 0.35}},
    },
]


@pytest.mark.parametrize("control", CONTROLLERS)
def test_controllers_of_redundant_loops_have_a_plan(control: Data) -> None:
    """A page shows the plan, which also counts what terms would cost that the scene does not have."""
    data = mechanism(3, 1.0, "fixed")
    goal = {name: data["initial"]["q"][name] for name in ("l10", "r10")}
    points = [{"t": 0, "q": goal}, {"t": 0.1, "q": {name: x + 0.1 for name, x in goal.items()}}]
    data |= {"trajectory": {"type": "quintic", "points": points}, "torques": {}, "actuated": list(goal)}
    scene = load_scene_text(json.dumps({**data, "control": control}))
    assert "prescribed motion" in json.dumps(plan(scene, "simulate"), default=str)
