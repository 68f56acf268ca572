"""Latches beside payloads, redundant rows of loops, singular poses that are passed, independent coordinates and
prescribed joints: each beside an independent integration from event to event, closed forms, or the same mechanism in
another form."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

from robodyn_cli.errors import RobodynError
from robodyn_cli.results.hdf5 import write
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.works.deploy.deploy import deploy
from tests.oracle.test_latch_stages import Mast

EXPLORE = int(os.environ.get("ROBODYN_EXPLORE", "0"))
SEEDS = range(4) if not EXPLORE else range(1000, 1000 + 12 * EXPLORE)
ORACLE = 1e-10  # of values: what scipy's tolerances leave


def deployed(tree: dict[str, Any], **simulate: Any) -> Result:
    tree = tree | {"simulate": tree["simulate"] | simulate}
    return deploy(load_scene_text(yaml.safe_dump(tree)))


def near(own: Any, error: Any, value: float, factor: float = 1.0) -> None:
    assert abs(own - value) <= error + factor * ORACLE * max(1.0, abs(value)), (own, value, error)


# -- payloads ---------------------------------------------------------------------------------------------
class Arm:
    """Two links on parallel hinges with dampers, driven by constant torques; a latch on the elbow, which opens at a
    time, and a payload that the second link grips and releases at times."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.m, self.c, self.length = (
            rng.uniform(0.5, 3.0, 2),
            rng.uniform(0.2, 0.6, 2),
            rng.uniform(0.6, 1.2),
        )
        self.inertia, self.damping = rng.uniform(0.05, 0.3, 2), rng.uniform(0.05, 0.3, 2)
        self.tau, self.q = np.array([rng.uniform(0.2, 0.6), rng.uniform(-0.6, -0.4)]), np.array([0.0, 2.0])
        self.at, self.load, self.reach = rng.uniform(1.0, 1.6), rng.uniform(0.3, 2.0), rng.uniform(0.4, 1.0)
        self.spin, self.drift = 0.1 * self.load, rng.uniform(-0.3, 0.3, 2)

    def scene(self, moments: dict[str, float]) -> dict[str, Any]:
        joints = [
            {
                "name": name, "type": "revolute", "axis": [0, 0, 1], "damper": {"damping": float(damping)},
                "origin": {"xyz": [x, 0, 0]},
            }
            for name, damping, x in zip(("root", "elbow"), self.damping, (0.0, float(self.length)))
        ]  # fmt: skip
        links = [
            {"name": name, "mass": float(m), "com": [float(c), 0, 0], "inertia": {"zz": float(inertia)}}
            for name, m, c, inertia in zip(("upper", "fore"), self.m, self.c, self.inertia)
        ]
        payload = {
            "name": "load", "at": "tip", "mass": float(self.load), "inertia": {"zz": float(self.spin)},
            "velocity": [*self.drift.tolist(), 0.0], "from": {"time": moments["grip"]},
            "until": {"time": moments["let_go"]},
        }  # fmt: skip
        latch = {
            "name": "catch",
            "joint": "elbow",
            "at": float(self.at),
            "release": f"t - {moments['opens']!r}",
        }
        return {
            "schema": 1, "command": "deploy", "gravity": [0, 0, 0],
            "robot": {"joints": joints, "links": links, "points": {"tip": {"link": "fore", "at": [self.reach, 0, 0]}}},
            "torques": dict(zip(("root", "elbow"), self.tau.tolist())), "payloads": [payload],
            "initial": {"q": dict(zip(("root", "elbow"), self.q.tolist()))},
            "simulate": {"duration": moments["end"], "samples": 61, "rtol": 1e-11, "atol": 1e-13},
            "deploy": {"latches": [latch], "until": "end"},
        }  # fmt: skip

    def points(self, q: Any, carries: bool) -> list[tuple[float, float, Any, Any]]:
        """Return mass, inertia, Jacobian of the centre (2, 2) and of the turn (2,) of each body."""
        (m1, m2), (c1, c2), (i1, i2) = self.m, self.c, self.inertia

        def on(second: float, first: float) -> Any:
            a, b = q[0], q[0] + q[1]
            return np.array([
                [-first * np.sin(a) - second * np.sin(b), -second * np.sin(b)],
                [first * np.cos(a) + second * np.cos(b), second * np.cos(b)],
            ])  # fmt: skip

        bodies = [
            (m1, i1, on(0.0, c1), np.array([1.0, 0.0])),
            (m2, i2, on(c2, self.length), np.array([1.0, 1.0])),
        ]
        if carries:
            bodies.append((self.load, self.spin, on(self.reach, self.length), np.array([1.0, 1.0])))
        return bodies

    def matrix(self, q: Any, carries: bool) -> Any:
        return sum(m * J.T @ J + i * np.outer(w, w) for m, i, J, w in self.points(q, carries))

    def accelerations(self, q: Any, v: Any, carries: bool, holds: bool) -> Any:
        coupling = self.m[1] * self.length * self.c[1] + (
            self.load * self.length * self.reach if carries else 0.0
        )
        h = -coupling * np.sin(q[1])
        bias = np.array([h * v[1] * (2.0 * v[0] + v[1]), -h * v[0] ** 2])
        f, M = self.tau - self.damping * v - bias, self.matrix(q, carries)
        return np.array([f[0] / M[0, 0], 0.0]) if holds else np.linalg.solve(M, f)

    def follow(self, moments: dict[str, float]) -> dict[str, Any]:
        """Integrate from event to event; return closings (time, speed, lost), the energy of the grip, and the end."""
        q, v, t, carries, holds = self.q.copy(), np.zeros(2), 0.0, False, False
        ahead = sorted((time, name) for name, time in moments.items())
        closings, gripped = [], 0.0
        while ahead:
            stop, name = ahead[0]

            def reached(_: float, y: Any) -> float:
                return float(y[1] - self.at)

            leaves = not holds and abs(q[1] - self.at) < 1e-9  # it has opened in its position
            reached.terminal = not (holds or leaves)  # type: ignore[attr-defined]
            run = solve_ivp(
                lambda _, y, carries=carries, holds=holds: np.append(
                    y[2:], self.accelerations(y[:2], y[2:], carries, holds)
                ),
                (t, min(t + 1e-4, stop) if leaves else stop), np.append(q, v), method="DOP853", rtol=1e-13, atol=1e-14, events=reached, max_step=0.05,
            )  # fmt: skip
            met = reached.terminal and len(run.t_events[0])  # type: ignore[attr-defined]
            t, (q, v) = float(run.t[-1]), run.y[:, -1].reshape(2, 2).copy()
            M = self.matrix(q, carries)
            if met:
                after = np.array([M[0] @ v / M[0, 0], 0.0])
                closings.append((t, v[1], 0.5 * (v @ M @ v - after @ M @ after)))
                q[1], v, holds = self.at, after, True
                continue
            if t < stop:
                continue
            ahead.pop(0)
            if name == "grip":
                new, (m, _, J, _) = self.matrix(q, True), self.points(q, True)[2]
                momentum = M @ v + J.T @ (m * self.drift)
                after = np.array([momentum[0] / new[0, 0], 0.0]) if holds else np.linalg.solve(new, momentum)
                gripped = 0.5 * (v @ M @ v + m * self.drift @ self.drift - after @ new @ after)
                v, carries = after, True
            elif name == "let_go":
                carries = False
            elif name == "opens":
                holds = False
        return {"closings": closings, "gripped": gripped, "q": q, "v": v}


@pytest.mark.parametrize("seed", SEEDS)
def test_latches_close_and_open_while_payloads_come_and_go(seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    arm = Arm(rng)
    first = Arm.follow(arm, {"grip": 50.0, "end": 20.0}).get("closings")[0][
        0
    ]  # when it closes with nothing carried
    names = ["grip", "opens", "let_go"]
    order = [names, ["grip", "let_go", "opens"], ["opens", "grip", "let_go"]][seed % 3]
    times = first * np.cumsum(rng.uniform(0.2, 0.7, 3)) + first * rng.uniform(0.0, 0.9)
    moments = dict(zip(order, times.tolist())) | {"end": float(times[-1] + 0.4 * first)}
    expected = arm.follow(moments)
    result = deployed(arm.scene(moments))
    summary = result.summary
    closings = [event for event in result.events if event["kind"] == "latched"]
    assert len(closings) == len(expected["closings"]) > 0
    time, speed, lost = expected["closings"][-1]
    own = summary["locks"]["catch"]
    for key, value in (("time", time), ("speed", speed), ("energy_lost", lost)):
        near(own[key], own["errors"][key], value)
    load = summary["payloads"]["load"]
    near(load["energy_lost"], load["energy_lost_error"], expected["gripped"])
    for k, name in enumerate(("root", "elbow")):
        near(summary["final"]["q"][name], summary["error_estimate"]["q_end"], expected["q"][k], 10.0)
        near(summary["final"]["qd"][name], summary["error_estimate"]["qd_end"], expected["v"][k], 10.0)
    assert summary["energy_drift"] < 1e-8


def test_run_goes_on_with_what_is_latched_and_carried(tmp_path: Path) -> None:
    arm = Arm(np.random.default_rng(3))
    first = arm.follow({"grip": 50.0, "end": 20.0})["closings"][0][0]
    moments = {"grip": 0.5 * first, "let_go": 1.5 * first, "opens": 1.7 * first, "end": 2.0 * first}
    tree = arm.scene(moments)
    whole = deployed(tree).summary
    middle = tree | {"simulate": tree["simulate"] | {"duration": 1.3 * first}}
    write(deployed(middle), tmp_path / "result.h5")
    rest = deployed(tree | {"initial": {"from": str(tmp_path)}}).summary
    for name in ("root", "elbow"):
        assert abs(rest["final"]["q"][name] - whole["final"]["q"][name]) < 1e-8
    assert rest["locks"]["catch"]["order"] == 0 and "released" in rest["payloads"]["load"]


# -- loops in space ---------------------------------------------------------------------------------------
def turned(tree: dict[str, Any], R: Any) -> dict[str, Any]:
    """Return a planar mechanism in a plane with another normal, so that rows out of the plane depend on the others."""
    tree = yaml.safe_load(yaml.safe_dump(tree))

    def by(x: Any) -> list[float]:
        return [float(y) for y in R @ np.array(x, dtype=float)]

    for joint in tree["robot"]["joints"]:
        joint["axis"], joint["origin"]["xyz"] = by([0, 0, 1]), by(joint["origin"]["xyz"])
    for link in tree["robot"]["links"]:
        z = link["inertia"]["zz"]
        I = R @ np.diag([0.5 * z, 0.6 * z, z]) @ R.T
        places = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
        link["com"], link["inertia"] = by(link["com"]), {key: float(I[at]) for key, at in places.items()}
    for point in tree["robot"]["points"].values():
        point["at"] = by(point["at"])
    for loop in tree["loops"]:
        loop["axis"] = by([0, 0, 1])
    return tree


def random_turn(rng: np.random.Generator) -> Any:
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return Q * np.sign(np.linalg.det(Q))


def five_bar(**latch: Any) -> dict[str, Any]:
    """Return a five-bar with two freedoms and latches on three of its joints; the first two stop it."""
    axis = [0, 0, 1]
    joints = [
        {"name": name, "type": "revolute", "axis": axis, "parent": parent, "link": link, "origin": {"xyz": [x, 0, 0]}}
        for name, parent, link, x in (
            ("a", "base", "A", 0.0), ("b", "A", "B", 0.8), ("c", "base", "C", 1.0), ("d", "C", "D", 0.7),
        )
    ]  # fmt: skip
    links = [
        {"name": name, "mass": m, "com": [0.4, 0, 0], "inertia": {"zz": 0.06 * m}}
        for name, m in (("A", 1.0), ("B", 1.5), ("C", 1.2), ("D", 0.8))
    ]
    q = {"a": 1.9, "b": -1.0, "c": 1.1, "d": 0.9}
    return {
        "schema": 1, "command": "deploy", "gravity": [0, 0, 0],
        "robot": {
            "joints": joints, "links": links,
            "points": {"pb": {"link": "B", "at": [0.9, 0, 0]}, "pd": {"link": "D", "at": [0.9, 0, 0]}},
        },
        "loops": [{"name": "pin", "type": "revolute", "between": ["pb", "pd"]}],
        "torques": {"a": 0.4, "c": -0.25}, "initial": {"q": q, "hold": ["a", "c"]},
        "simulate": {"duration": 6, "samples": 61, "rtol": 1e-10, "atol": 1e-12},
        "deploy": {
            "latches": [
                {"name": "ka", "joint": "a", "at": 2.1, **latch}, {"name": "kc", "joint": "c", "at": 1.25, **latch},
            ],
            "until": "end",
        },
    }  # fmt: skip


def same(one: dict[str, Any], other: dict[str, Any]) -> None:
    """Compare what latches did in two forms of a mechanism, within the errors of both."""
    assert one["locks"].keys() == other["locks"].keys() and one["status"] == other["status"]
    for name, own in one["locks"].items():
        again = other["locks"][name]
        assert own["order"] == again["order"] and own["redundant"] == again["redundant"]
        for key in ("time", "speed", "energy_lost", "angular_impulse", "peak_moment", "opened"):
            if key in own:
                near(own[key], own["errors"][key] + again["errors"][key], again[key])


SPRING = {"hold": {"stiffness": 60.0, "damping": 1.0}}


@pytest.mark.parametrize(("latch", "at"), [({}, 1.25), (SPRING, 0.9)])
def test_five_bar_in_space_and_in_independent_coordinates_is_the_planar_one(
    latch: dict[str, Any], at: float
) -> None:
    tree = five_bar(**latch)
    tree["deploy"]["latches"][1]["at"] = at
    planar = deployed(tree).summary
    assert planar["status"] == "locked" and len(planar["locks"]) == 2
    same(deployed(tree, stabilisation="independent").summary, planar)
    for seed in SEEDS:
        same(deployed(turned(tree, random_turn(np.random.default_rng(seed)))).summary, planar)


METHODS = {"generalized_alpha": {"step": 1e-3}, "bdf": {}, "radau9": {}, "dopri5": {}}


@pytest.mark.parametrize("method", METHODS)
def test_other_methods_lock_the_same_within_their_errors(method: str) -> None:
    options = METHODS[method] | {"integrator": method}
    arm = Arm(np.random.default_rng(3))
    first = arm.follow({"grip": 50.0, "end": 20.0})["closings"][0][0]
    moments = {"grip": 0.5 * first, "let_go": 1.5 * first, "opens": 1.7 * first, "end": 2.0 * first}
    mast = Mast(np.random.default_rng([1, 8])).scene() | {
        "deploy": {"latches": Mast(np.random.default_rng([1, 8])).latches(1)}
    }
    for tree in (five_bar(), arm.scene(moments), mast):
        tree["simulate"] |= {"rtol": 1e-9, "atol": 1e-11}
        same(deployed(tree, **options).summary, deployed(tree).summary)


def test_what_generalized_alpha_does_not_follow_is_refused() -> None:
    method = {"integrator": "generalized_alpha", "step": 1e-3}
    with pytest.raises(RobodynError, match="latch of a closed mechanism has a spring"):
        deployed(five_bar(**SPRING), **method)
    tree = five_bar()
    tree["deploy"]["latches"] = [{"name": "k", "between": ["B", "D"], "when": "t - 1"}]
    with pytest.raises(RobodynError, match="a rigid latch holds the links of a closure"):
        deployed(tree, **method)


def test_latched_joint_stands_in_independent_coordinates() -> None:
    tree = five_bar()
    tree["deploy"] = {"latches": tree["deploy"]["latches"][:1], "until": "end"}
    result = deployed(tree, stabilisation="independent", duration=4.0)
    closed = result.time > result.summary["locks"]["ka"]["time"]
    assert np.abs(result["q"][closed, 0] - 2.1).max() < 1e-14 and np.ptp(result["q"][closed, 2]) > 0.05
    other = deployed(tree, duration=4.0).summary
    same(result.summary, other)
    for name, value in other["final"]["q"].items():
        near(result.summary["final"]["q"][name], 1e-8, value)


@pytest.mark.parametrize("seed", SEEDS)
def test_mast_in_space_is_the_planar_one(seed: int) -> None:
    rng = np.random.default_rng([seed, 8])
    mast = Mast(rng)
    tree = mast.scene() | {"deploy": {"latches": mast.latches(1)}}
    tree["outputs"] = {"extremes": ["latch_loads.sb1"]}
    one, other = deployed(turned(tree, random_turn(rng))).summary, deployed(tree).summary
    same(one, other)
    near(one["locks"]["sb1"]["time"], one["locks"]["sb1"]["errors"]["time"], mast.time(*mast.angles[:2]))


# -- singular poses that are passed -----------------------------------------------------------------------
@pytest.mark.parametrize("seed", SEEDS)
def test_mast_passes_the_pose_in_line_and_latches_behind_it(seed: int) -> None:
    rng = np.random.default_rng([seed, 9])
    mast = Mast(rng)
    last = float(np.radians(rng.uniform(95.0, 130.0)))
    fin = {"name": "fin", "joint": "b1", "at": float(np.pi - 2.0 * last)}
    tree = mast.scene() | {"deploy": {"latches": [fin]}}
    with pytest.raises(RobodynError, match="bifurcation"):
        deployed(tree)
    summary = deployed(tree, singular="pass").summary
    own = summary["locks"]["fin"]
    assert len(summary["passed"]) == 1 and abs(
        summary["passed"][0] - mast.time(mast.angles[0], np.pi / 2)
    ) <= 1e-7 + (summary["passed_error"] or 0.0)
    near(own["time"], own["errors"]["time"], mast.time(mast.angles[0], last), 10.0)
    near(own["energy_lost"], own["errors"]["energy_lost"], mast.gained(mast.angles[0], last), 100.0)


def parallelogram(*latches: dict[str, Any]) -> dict[str, Any]:
    """Return a parallelogram on the ground, which a torque drives through its flat pose."""
    joints = [
        {
            "name": name, "type": "revolute", "axis": [0, 0, 1], "parent": parent, "link": name.upper(),
            "origin": {"xyz": [x, 0, 0]},
        }
        for name, parent, x in (("a", "base", 0.0), ("b", "A", 1.0), ("c", "base", 2.0))
    ]  # fmt: skip
    links = [
        {"name": name, "mass": m, "com": [x, 0, 0], "inertia": {"zz": 0.1}}
        for name, m, x in (("A", 1.0, 0.5), ("B", 2.0, 1.0), ("C", 1.0, 0.5))
    ]
    return {
        "schema": 1, "command": "deploy", "gravity": [0, 0, 0],
        "robot": {
            "joints": joints, "links": links,
            "points": {"pb": {"link": "B", "at": [2, 0, 0]}, "pc": {"link": "C", "at": [1, 0, 0]}},
        },
        "loops": [{"name": "pin", "type": "revolute", "between": ["pb", "pc"]}], "torques": {"a": 0.5},
        "initial": {"q": {"a": 0.5, "b": -0.5, "c": 0.5}},
        "simulate": {"duration": 20, "samples": 101, "singular": "pass"},
        "deploy": {"latches": list(latches), "until": "all"},
    }  # fmt: skip


TURNED = 2.0 * (0.1 + 0.25) + 2.0  # kg m^2 of the parallelogram about a


@pytest.mark.parametrize("latch", [{"joint": "b", "at": -5.0}, {"joint": "c", "when": "b + 5"}])
def test_parallelogram_latches_behind_its_flat_pose(latch: dict[str, Any]) -> None:
    summary = deployed(parallelogram({"name": "k", **latch})).summary
    own = summary["locks"]["k"]
    assert len(summary["passed"]) == 1
    near(own["time"], own["errors"]["time"], float(np.sqrt(2.0 * 4.5 * TURNED / 0.5)))
    near(own["energy_lost"], own["errors"]["energy_lost"], 0.5 * 4.5)


def test_latch_in_the_pose_itself_is_refused() -> None:
    with pytest.raises(RobodynError, match="cannot be passed: latch k at .*, too close to the pose"):
        deployed(parallelogram({"name": "k", "joint": "a", "at": float(np.pi)}))


# -- prescribed joints ------------------------------------------------------------------------------------
def test_spring_latch_on_a_prescribed_joint_bears_what_its_law_says() -> None:
    axis = [0, 0, 1]
    tree = {
        "schema": 1, "command": "deploy", "gravity": [0, 0, 0],
        "robot": {
            "joints": [
                {"name": "a", "type": "revolute", "axis": axis},
                {"name": "b", "type": "revolute", "axis": axis, "origin": {"xyz": [1, 0, 0]}},
            ],
            "links": [
                {"name": "A", "mass": 1.0, "com": [0.5, 0, 0], "inertia": {"zz": 0.1}},
                {"name": "B", "mass": 1.0, "com": [0.5, 0, 0], "inertia": {"zz": 0.1}},
            ],
        },
        "prescribed": {"a": "0.8*sin(t)"}, "initial": {"q": {"b": 0.3}},
        "simulate": {"duration": 2, "samples": 21},
        "deploy": {
            "latches": [{"name": "k", "joint": "a", "at": 0.5, "hold": {"stiffness": 30.0, "damping": 2.0}}],
            "until": "end",
        },
    }  # fmt: skip
    summary = deployed(tree).summary
    own = summary["locks"]["k"]
    near(own["time"], own["errors"]["time"], float(np.arcsin(0.625)))
    near(own["peak_moment"], own["errors"]["peak_moment"], float(np.hypot(24.0, 1.6) - 15.0))
    tree["deploy"]["latches"][0].pop("hold")
    with pytest.raises(RobodynError, match="prescribed, in a rigid one"):
        deployed(tree)
