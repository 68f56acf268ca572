"""Masses that are picked up and released: momentum, energy, torques; and what does not go with them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.integrate import trapezoid
from scipy.interpolate import CubicSpline

from robodyn_cli import deploy, inverse, load_scene_text, simulate, statics
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, RobodynError, SceneError
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.works.inverse import program_of

ROOT = Path(__file__).parents[2]

DISC = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: spin, type: revolute, axis: [0, 0, 1]}]
  links: [{name: disc, mass: 2, com: [0, 0, 0], inertia: {zz: 0.4}}]
  points: {rim: {link: disc, at: [0.5, 0, 0]}}
payloads:
  - {name: ball, at: rim, mass: 1.2, inertia: {zz: 0.05}, from: {time: 1}, until: {time: 2}}
initial: {q: {spin: 0}, qd: {spin: 3}}
simulate: {duration: 3, samples: 31}
"""

# mixed axes, a slide, a ball, a tilted base, full inertias, centres of mass off the axes
ARM: dict[str, Any] = yaml.safe_load("""
schema: 1
gravity: [0.3, -0.2, -9.81]
robot:
  base: {xyz: [0.1, 0.2, 0.3], rpy: [0.3, 0.2, -0.4]}
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1]}
    - {name: b, type: spherical, origin: {xyz: [0.1, 0, 0.4], rpy: [0.1, 0.2, 0.3]}}
    - {name: c, type: prismatic, axis: [1, 0, 0.2], origin: {xyz: [0.3, 0.1, 0]}}
    - {name: d, type: revolute, axis: [1, 1, 0], origin: {xyz: [0.2, 0, 0.1]}}
  links:
    - {name: A, mass: 4, com: [0.1, 0, 0.2], inertia: {xx: 0.1, yy: 0.12, zz: 0.08, xy: 0.01, xz: -0.02, yz: 0.005}}
    - {name: B, mass: 3, com: [0.2, 0.05, 0], inertia: {xx: 0.05, yy: 0.09, zz: 0.08, xy: 0.01, xz: -0.01, yz: 0.005}}
    - {name: C, mass: 2, com: [0.1, 0, 0.1], inertia: {xx: 0.02, yy: 0.03, zz: 0.025, xy: 1e-3, xz: -2e-3, yz: 5e-4}}
    - {name: D, mass: 1, com: [0.05, 0.02, 0.1], inertia: {xx: 0.01, yy: 0.012, zz: 0.008, xy: 1e-3, xz: -2e-3}}
  frames: {tool: {link: D, at: [0.1, 0.05, 0.2], rpy: [0.4, -0.3, 0.8]}}
initial: {q: {a: 0, b: [0.9, 0.3, -0.3, 0.1], c: 0.1, d: -0.2}, qd: {a: 1, b: [-0.5, 0.8, 0.4], c: 0.2, d: 0.3}}
torques: {a: 3, c: 15, d: "-2 + sin(2*t)"}
simulate: {duration: 1, samples: 11}
""")
BOX: dict[str, Any] = yaml.safe_load("""
{mass: 2.5, com: [0.05, 0.02, -0.03], inertia: {xx: 0.03, yy: 0.02, zz: 0.04, xy: 0.004, xz: -0.003, yz: 0.002}}
""")
MOVING = {"velocity": [0.2, -0.3, 0.5], "angular_velocity": [1.0, 2.0, -0.5]}
FOUR_BAR = (ROOT / "configs/benchmarks/rbd_four_bar.yaml").read_text(encoding="utf-8")


def scene_of(base: dict[str, Any], **keys: Any) -> Scene:
    return load_scene_text(
        yaml.safe_dump({**base, **keys}, sort_keys=False), str(ROOT / "configs/scene.yaml")
    )


def with_box(base: dict[str, Any], to: str = "D") -> dict[str, Any]:
    """Return a scene with the box as a link, welded where the payload is held."""
    placed = {"xyz": [0.1, 0.05, 0.2], "rpy": [0.4, -0.3, 0.8]}
    attached = {"link": "box", "to": to, "origin": placed, **BOX}
    return {**base, "robot": {**base["robot"], "attach": [attached]}}


def at_sample(result: Result, k: int) -> tuple[np.ndarray, np.ndarray]:
    return result["q"][k], result["qd"][k]


def events(result: Result, kind: str) -> list[dict[str, Any]]:
    return [dict(event) for event in result.events if event["kind"] == kind]


def mass_matrix(scene: Scene, q: np.ndarray) -> np.ndarray:
    problem = Problem(scene)
    return problem.numbers(problem.mass_matrix, q)


@pytest.mark.parametrize("speed", [0.0, 2.0])
def test_a_disc_that_takes_up_a_mass(speed: float) -> None:
    """J w = (J + I + m r^2) w' - (m r u + I w0) for a body that comes with u across the radius, turning with w0."""
    turning = 3.0 * speed
    # the rim is at the angle 3 rad when it grips
    u = [-speed * np.sin(3.0), speed * np.cos(3.0), 0.0]
    own = f"velocity: {[float(x) for x in u]}, angular_velocity: [0, 0, {turning}]"
    result = simulate(load_scene_text(DISC.replace("from: {time: 1}", f"{own}, from: {{time: 1}}")))
    before, with_ball = 0.4, 0.4 + 0.05 + 1.2 * 0.25
    after = (before * 3.0 + 1.2 * 0.5 * speed + 0.05 * turning) / with_ball
    qd = result["qd"][:, 0]
    np.testing.assert_allclose(qd[:11], 3.0, rtol=1e-14)  # the sample at the time itself is that of before
    np.testing.assert_allclose(qd[11:], after, rtol=1e-13)  # nothing jumps where it is released
    (grip,) = events(result, "grip")
    lost = 0.5 * (before * 9.0 + 1.2 * speed**2 + 0.05 * turning**2 - with_ball * after**2)
    assert grip["time"] == 1.0 and grip["name"] == "ball"
    assert grip["energy_lost"] == pytest.approx(lost, rel=1e-12)
    assert grip["jump"]["spin"] == pytest.approx(after - 3.0, rel=1e-12)
    facts = result.summary["payloads"]["ball"]
    assert (
        facts["gripped"] == 1.0 and facts["released"] == 2.0 and facts["energy_lost"] == grip["energy_lost"]
    )
    assert result.summary["energy_drift"] < 1e-13 and result.summary["error_estimate"]["qd_max"] < 1e-13


def test_an_arm_keeps_the_momentum_of_both() -> None:
    """M+ v+ = M- v- + J^T I V with M of arms with and without a welded box, and J by differences of the tool's pose."""
    payload = {"name": "box", "at": "tool", **BOX, **MOVING, "from": {"time": 0.5}}
    scene = scene_of(ARM, payloads=[payload], torques={"a": 3, "b": [1, -2, 0.5], "c": 15, "d": -2})
    result = simulate(scene)
    q, v = at_sample(result, 5)
    jump = np.array(list(events(result, "grip")[0]["jump"].values()))
    plain, heavy = scene_of(ARM), scene_of(with_box(ARM))
    problem = Problem(plain)
    frame, h = problem.model.frames["tool"], 1e-6

    def pose(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return place and axes of the box in the world."""
        place = problem.pose[frame.body]
        R = problem.numbers(problem.model.base.E.T @ place.R @ frame.R, at)
        return problem.numbers(problem.world_point(frame), at) + R @ np.array(BOX["com"]), R

    manifold, nv = Manifold(problem.model), problem.model.nv
    Jv, Jw = np.zeros((3, nv)), np.zeros((3, nv))
    R = pose(q)[1]
    for k, step in enumerate(h * np.eye(nv)):
        (p1, R1), (p0, R0) = (pose(manifold.integrate(q, s * step)) for s in (1.0, -1.0))
        Jv[:, k] = (p1 - p0) / (2 * h)
        W = (R1 - R0) @ R.T / (2 * h)
        Jw[:, k] = [W[2, 1], W[0, 2], W[1, 0]]
    I = BOX["inertia"]
    I_box = (
        R
        @ np.array([[I["xx"], I["xy"], I["xz"]], [I["xy"], I["yy"], I["yz"]], [I["xz"], I["yz"], I["zz"]]])
        @ R.T
    )
    u, w = np.array(MOVING["velocity"]), np.array(MOVING["angular_velocity"])
    own = Jv.T @ (BOX["mass"] * u) + Jw.T @ (I_box @ w)
    light, full = mass_matrix(plain, q), mass_matrix(heavy, q)
    np.testing.assert_allclose(full @ (v + jump), light @ v + own, rtol=0, atol=3e-9)
    brought = 0.5 * (BOX["mass"] * u @ u + w @ I_box @ w)
    lost = brought + 0.5 * (v @ light @ v - (v + jump) @ full @ (v + jump))
    assert events(result, "grip")[0]["energy_lost"] == pytest.approx(lost, rel=1e-8) and lost > 0
    assert result.summary["energy_drift"] < 1e-8


def test_before_between_and_after_it_is_another_robot() -> None:
    """The motion is that of the arm, of the arm with the box welded on from the jumped state, and of the arm again."""
    payload = {"name": "box", "at": "tool", **BOX, "from": {"time": 0.3}, "until": {"time": 0.7}}
    result = simulate(scene_of(ARM, payloads=[payload]))
    pieces = [(ARM, 0, 3, 0.3), (with_box(ARM), 3, 7, 0.4), (ARM, 7, 10, 0.3)]
    (grip,) = events(result, "grip")
    assert grip["time"] == pytest.approx(0.3, abs=1e-14)
    for base, first, last, duration in pieces:
        q, v = at_sample(result, first)
        if first == 3:
            v = v + np.array(list(grip["jump"].values()))
        start = {"q": {"a": q[0], "b": q[1:5].tolist(), "c": q[5], "d": q[6]},
                 "qd": {"a": v[0], "b": v[1:4].tolist(), "c": v[4], "d": v[5]}}  # fmt: skip
        start = _floats(start)
        since = float(result["time"][first])
        torques = {**base["torques"], "d": f"-2 + sin(2*(t + {since!r}))"}
        alone = simulate(
            scene_of(base, initial=start, torques=torques, simulate={"duration": duration, "samples": 2})
        )
        np.testing.assert_allclose(at_sample(alone, -1)[0], at_sample(result, last)[0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(at_sample(alone, -1)[1], at_sample(result, last)[1], rtol=0, atol=1e-8)


def _floats(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _floats(x) for k, x in value.items()}
    return [float(x) for x in value] if isinstance(value, list) else float(value)


def test_loops_share_the_impact() -> None:
    """In a closed chain, momentum is kept along what the loops allow, and the loops stay closed."""
    base = yaml.safe_load(FOUR_BAR)
    link, joint = base["robot"]["links"][1]["name"], base["robot"]["joints"][1]["name"]
    payload = {"name": "box", "at": f"{link}.com", "mass": 3.0, "inertia": {"zz": 0.2}, "from": {"time": 0.5}}
    options = {"duration": 1.0, "samples": 11}
    scene = scene_of({**base, "expect": {}}, payloads=[payload], simulate=options)
    result = simulate(scene)
    q, v = at_sample(result, 5)
    after = v + np.array(list(events(result, "grip")[0]["jump"].values()))
    problem = Problem(scene)
    psi = problem.numbers(problem.psi, q)
    carried = dataclasses.replace(scene.payloads[0], start=None)
    full = mass_matrix(dataclasses.replace(scene, payloads=(carried,)), q)
    free = np.linalg.svd(psi)[2][np.linalg.matrix_rank(psi) :]
    np.testing.assert_allclose(free @ full @ after, free @ mass_matrix(scene, q) @ v, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(psi @ after, 0.0, atol=1e-11)
    assert result.summary["energy_drift"] < 1e-8 and joint in events(result, "grip")[0]["jump"]
    assert result.summary["constraint_residual"]["velocity"] < 1e-10


def test_events_decide_and_each_happens_once() -> None:
    """A mass is gripped where a formula rises through zero, once, and released at another event."""
    when = DISC.replace(
        "from: {time: 1}, until: {time: 2}", 'from: {when: "sin(q.spin) - 0.5"}, until: {when: "q.spin - 9"}'
    )
    result = simulate(load_scene_text(when.replace("duration: 3", "duration: 12")))
    (grip,), (end,) = events(result, "grip"), events(result, "let_go")
    assert grip["time"] == pytest.approx(np.pi / 6 / 3.0, rel=1e-12)
    after = 3.0 * 0.4 / 0.75
    assert end["time"] == pytest.approx(grip["time"] + (9.0 - np.pi / 6) / after, rel=1e-12)


def test_an_event_begins_what_a_time_ends() -> None:
    """A time after an event releases; a payload whose time is over by then is not gripped any more."""
    text = DISC.replace("from: {time: 1}", 'from: {when: "q.spin - 1.5"}')
    result = simulate(load_scene_text(text))
    facts = result.summary["payloads"]["ball"]
    assert facts["gripped"] == pytest.approx(0.5, rel=1e-12) and facts["released"] == 2.0
    late = simulate(load_scene_text(text.replace("spin - 1.5", "spin - 7.5")))
    assert late.summary["payloads"]["ball"] == {} and late["qd"][-1, 0] == pytest.approx(3.0, rel=1e-14)


def random_chain(seed: int) -> dict[str, Any]:
    """A chain of two to four turning and sliding joints about any axes, with full inertias, and its reference."""
    rng = np.random.default_rng(seed)
    joints: list[dict[str, Any]] = []
    links: list[dict[str, Any]] = []
    for k in range(int(rng.integers(2, 5))):
        moments = rng.uniform(0.05, 0.1, 3)
        off = rng.uniform(-0.01, 0.01, 3)
        joints.append(
            {
                "name": f"q{k}", "type": rng.choice(["revolute", "prismatic"]).item(),
                "axis": rng.normal(size=3).tolist(),
                "origin": {"xyz": rng.normal(0, 0.3, 3).tolist(), "rpy": rng.normal(size=3).tolist()},
            }
        )  # fmt: skip
        links.append(
            {
                "name": f"link{k}", "mass": float(rng.uniform(1, 3)), "com": rng.normal(0, 0.1, 3).tolist(),
                "inertia": dict(zip(("xx", "yy", "zz", "xy", "xz", "yz"), [*moments.tolist(), *off.tolist()])),
            }
        )  # fmt: skip
    start, end = (
        {f"q{k}": float(x) for k, x in enumerate(rng.uniform(-0.5, 0.5, len(joints)))} for _ in "ab"
    )
    frames = {"tool": {"link": links[-1]["name"], "at": [0.1, 0.05, 0.2], "rpy": [0.4, -0.3, 0.8]}}
    return {
        "schema": 1,
        "gravity": [0.3, -0.2, -9.81],
        "robot": {"joints": joints, "links": links, "frames": frames},
        "payloads": [
            {"name": "box", "at": "tool", **BOX, **MOVING, "from": {"time": 0.2}, "until": {"time": 0.4}}
        ],
        "control": {
            "type": "pid",
            "reference": {"type": "quintic", "points": [{"t": 0, "q": start}, {"t": 0.6, "q": end}]},
            "gains": {"kp": 300.0, "kd": 30.0, "ki": 200.0},
        },
        "initial": {"q": start},
        "simulate": {"duration": 0.6, "samples": 601},
    }


@pytest.mark.parametrize("seed", range(6))
def test_a_controller_keeps_its_states_when_a_mass_is_gripped(seed: int) -> None:
    """Its integral is ki times that of the error, past grip and release, and the work done makes up the energy."""
    result = simulate(scene_of(random_chain(seed)))
    assert result.status == "ok" and events(result, "grip") and events(result, "let_go")
    integral = np.zeros_like(result["control/error"])
    for first, last in ((0, 200), (200, 400), (400, 600)):  # its slope bends where velocities jump
        part = slice(first, last + 1)
        error = CubicSpline(result.time[part], result["control/error"][part])
        integral[part] = integral[first] + error.antiderivative()(result.time[part])
    np.testing.assert_allclose(result["control/states"], 200.0 * integral, atol=1e-6)
    assert result.summary["energy_drift"] < 1e-7


def test_what_is_handed_over_is_released_first() -> None:
    """At one time one mass is let go and another gripped: the first has no part in the impact."""
    more = "  - {name: other, at: rim, mass: 1, inertia: {zz: 0}, from: {time: 2}}\ninitial:"
    result = simulate(load_scene_text(DISC.replace("initial:", more)))
    held = 3.0 * 0.4 / 0.75
    assert result["qd"][-1, 0] == pytest.approx(held * 0.4 / 0.65, rel=1e-13)


def test_carried_from_the_start() -> None:
    """A payload without `from` is there at t = 0, for every command; one that is never let go is a link."""
    hung = scene_of(ARM, payloads=[{"name": "box", "at": "tool", **BOX}])
    q = np.array([0.3, 1.0, 0.0, 0.0, 0.0, 0.1, -0.2])
    np.testing.assert_allclose(mass_matrix(hung, q), mass_matrix(scene_of(with_box(ARM)), q), atol=1e-14)
    lift = {**yaml.safe_load(FOUR_BAR), "expect": {}}
    lift["gravity"] = [0, -9.81, 0]
    link = lift["robot"]["links"][1]["name"]
    payload = {"name": "box", "at": f"{link}.com", "mass": 3.0, "inertia": {"zz": 0.2}, "until": {"time": 1}}
    held = statics(
        scene_of(lift, payloads=[payload], torques={}, actuated=[lift["robot"]["joints"][0]["name"]])
    )
    assert held.status == "ok"


def test_torques_of_a_given_motion() -> None:
    """Torques are those of the arm with the box from one time to the other, and of the arm alone else."""
    q = {"a": "0.5*sin(2*t)", "c": "0.1*t", "d": "cos(3*t)"}
    base = {k: x for k, x in ARM.items() if k not in ("torques", "initial")}
    # without the ball joint, whose motion formulas would have to give as a quaternion
    base["robot"] = {**base["robot"], "joints": [
        {**j, "type": "revolute", "axis": [0, 1, 0.3]} if j["name"] == "b" else j for j in base["robot"]["joints"]
    ]}  # fmt: skip
    motion = {"type": "joint", "duration": 1, "q": {**q, "b": "t^2"}}
    common = {"trajectory": motion, "inverse": {"samples": 101}, "outputs": {"reactions": True}}
    payload = {"name": "box", "at": "tool", **BOX, "from": {"time": 0.3}, "until": {"time": 0.7}}
    found = inverse(scene_of(base, payloads=[payload], **common))
    light, heavy = inverse(scene_of(base, **common)), inverse(scene_of(with_box(base), **common))
    t = found["time"]
    inside = (t > 0.3 + 1e-9) & (t < 0.7 + 1e-9)  # a sample at the time itself is that of before
    for path in ("tau", "reactions/b", "energy/potential"):
        expected = np.where(inside[:, None], heavy[path].reshape(len(t), -1), light[path].reshape(len(t), -1))
        np.testing.assert_allclose(found[path].reshape(len(t), -1), expected, rtol=1e-11, atol=1e-10)
    errors = found.summary["error_estimate"]
    assert errors["round_trip"] < 1e-12 and abs(errors["energy_balance"]) < 1e-7
    assert "in motion" in found.summary["warnings"][0]
    assert [event["kind"] for event in found.events] == ["grip", "let_go"]


def led_arm() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the arm with joints of one coordinate, and a motion of them."""
    base = {k: x for k, x in ARM.items() if k not in ("torques", "initial")}
    base["robot"] = {**base["robot"], "joints": [
        {**j, "type": "revolute", "axis": [0, 1, 0.3]} if j["name"] == "b" else j for j in base["robot"]["joints"]
    ]}  # fmt: skip
    motion = {
        "type": "joint",
        "duration": 1,
        "q": {"a": "0.5*sin(2*t)", "c": "0.1*t", "d": "cos(3*t)", "b": "t^2"},
    }
    return base, motion


def test_integrals_of_a_given_motion_end_at_the_jumps() -> None:
    """Energies and RMS torques of 201 samples are those of the motions with and without the box, each in its time."""
    base, motion = led_arm()
    fine = {"trajectory": motion, "inverse": {"samples": 20001}}
    light, heavy = inverse(scene_of(base, **fine)), inverse(scene_of(with_box(base), **fine))
    t, qd = light["time"], light["qd"]
    # at samples, between them, soon after the start, and for a single sample
    for times in [(0.3, 0.7), (0.3037, 0.6012), (0.0011, 0.4999), (0.62, 0.625)]:
        payload = {
            "name": "box",
            "at": "tool",
            **BOX,
            "from": {"time": times[0]},
            "until": {"time": times[1]},
        }
        few = {"trajectory": motion, "inverse": {"samples": 201}}
        summary = inverse(scene_of(base, payloads=[payload], **few)).summary
        carried = ((t > times[0]) & (t <= times[1]))[:, None]
        tau = np.where(carried, heavy["tau"], light["tau"])
        rms, energy, net = (
            trapezoid(y, t, axis=0) for y in (tau**2, np.maximum(tau * qd, 0.0), tau * qd)
        )  # off by the jumps times a step of 5e-5 s
        errors = summary["error_estimate"]
        off = [1e-4 * np.abs(x).max(axis=0) for x in (tau, tau * qd)]
        for k, joint in enumerate(summary["joints"].values()):
            near = [
                x[k] + 3.0 * errors[name] for x, name in zip(off, ("rms_quadrature", "energy_quadrature"))
            ]
            assert joint["rms_torque"] == pytest.approx(np.sqrt(rms[k]), abs=near[0]), times
            assert joint["energy_net"] == pytest.approx(net[k], abs=near[1]), times
            assert joint["energy"] == pytest.approx(energy[k], abs=near[1]), times
        assert errors["rms_quadrature"] < (3e-5 if times[1] - times[0] > 0.1 else 0.1)


def test_compiled_torques_of_a_given_motion_change_with_what_is_carried() -> None:
    """Compiled code, bytecode and interpretation give the same torques, whatever the number of samples."""
    base, motion = led_arm()
    payload = {"name": "box", "at": "tool", **BOX, "from": {"time": 0.3}, "until": {"time": 0.7}}
    scene = scene_of(base, trajectory=motion, payloads=[payload])
    few, many = inverse(scene, samples=101), inverse(scene, samples=100001)
    program = program_of(scene)
    assert not program.compile(101).compiled and program.compile(100001).compiled
    np.testing.assert_allclose(many["tau"][::1000], few["tau"], rtol=1e-9, atol=1e-9)
    graph = program.problem.graph
    p = graph.symbols(["s"], "p")[0]
    t = graph.symbols(["t"], "t")[0]
    kernel = SampleKernel({"x": [p * t, 1.0 - p]}, ("t", "p"))
    times = np.linspace(0.0, 1.0, 37)
    carried = ((times > 0.3) & (times < 0.6)).astype(float)
    found = kernel(t=times[:, None], p=carried[:, None])["x"]
    np.testing.assert_array_equal(found, np.column_stack([carried * times, 1.0 - carried]))
    tables = kernel.of_tables(kernel.program.table[None], 37, {"t": times[:, None], "p": carried[:, None]})
    np.testing.assert_array_equal(tables["x"][0].T, found)


def test_a_run_goes_on_from_a_stored_one(tmp_path: Path) -> None:
    """What is carried at the time of the stored sample follows from the times."""
    from robodyn_cli.results.hdf5 import write

    whole = simulate(load_scene_text(DISC))
    write(whole, tmp_path / "result.h5")
    for at in (0.5, 1.0, 1.5, 2.0):
        text = DISC.replace("initial: {", f"initial: {{from: {tmp_path / 'result.h5'}, at: {at}, ")
        after = simulate(load_scene_text(text))
        np.testing.assert_allclose(after["qd"][-1], whole["qd"][-1], rtol=1e-13)
        assert after["time"][0] == at


REFUSED = [
    ("at: rim", "at: base.origin", "payloads.0.at", "fixed to the ground"),
    ("at: rim", "at: rin", "payloads.0.at", "did you mean 'rim'"),
    ("from: {time: 1}", "from: {}", "payloads.0.from", "one of 'time' and 'when'"),
    ("from: {time: 1}", 'from: {time: 1, when: "t"}', "payloads.0.from", "one of 'time' and 'when'"),
    ("until: {time: 2}", "until: {time: 1}", "payloads.0.until.time", "after 'from'"),
    ("from: {time: 1}, until", "velocity: [1, 0, 0], until", "payloads.0.velocity", "before it is gripped"),
    ("from: {time: 1}", 'from: {when: "q.other"}', "payloads.0.from.when", "unknown name"),
    ("mass: 1.2", "mass: -1", "payloads.0.mass", ">= 0"),
    ("initial:", "  - {name: ball, at: rim, mass: 1}\ninitial:", "payloads.1.name", "twice"),
]


@pytest.mark.parametrize(("old", "new", "key", "words"), REFUSED)
def test_mistakes(old: str, new: str, key: str, words: str) -> None:
    assert old in DISC
    with pytest.raises(SceneError, match=words) as found:
        load_scene_text(DISC.replace(old, new), "disc.yaml")
    assert str(found.value).startswith("disc.yaml:") and f" {key}: " in str(found.value)


def test_data_that_are_not_given_are_asked_for_when_they_matter() -> None:
    with pytest.raises(RobodynError, match="inertia.zz of ball"):
        simulate(load_scene_text(DISC.replace(", inertia: {zz: 0.05}", "")))


def test_refusals() -> None:
    """What cannot follow a change of mass says so."""
    stuck = DISC.replace("axis: [0, 0, 1]}", "axis: [0, 0, 1], friction: {coulomb: 1, law: set_valued}}")
    with pytest.raises(CapabilityError, match="does not go with joints that stick"):
        simulate(load_scene_text(stuck))
    latch = "deploy: {criterion: latch, latch: {between: [disc, base], at: {spin: 2}}}\ninitial:"
    with pytest.raises(CapabilityError, match="deploy does not follow masses"):
        deploy(load_scene_text(DISC.replace("initial:", latch)))
    motion = "trajectory: {type: joint, duration: 3, q: {spin: t}}\ninitial:"
    event = DISC.replace("from: {time: 1}", 'from: {when: "q.spin - 1"}')
    with pytest.raises(SceneError, match=r"payloads\.0\.from\.when.*'time'"):
        inverse(load_scene_text(event.replace("initial:", motion)))


def test_an_event_of_release_before_the_gripping_warns() -> None:
    """The slide falls past -0.1 m at 0.14 s; it grips at 0.3 s."""
    text = (
        "schema: 1\ngravity: [-9.81, 0, 0]\nrobot:\n  joints: [{name: s, type: prismatic, axis: [1, 0, 0]}]\n"
        "  links: [{name: one, mass: 1, com: [0, 0, 0]}]\ninitial: {q: {s: 0}}\nsimulate: {duration: 0.5}\n"
        "payloads: [{name: part, at: one.origin, mass: 1, from: {time: 0.3}, until: {when: -s - 0.1}}]\n"
    )
    result = simulate(load_scene_text(text))
    (warning,) = result.summary["warnings"]
    assert "'part': its event of release happened at 0.142784 s, before it was gripped" in warning
    assert "released" not in result.summary["payloads"]["part"]
