"""Paths in the coordinates of links that move, with joints prescribed beside them, and with ball joints in the arm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli.algorithms.kinematics import poses, transforms
from robodyn_cli.errors import RobodynError, SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.ready.doors import along
from robodyn_cli.scene import load_scene_text
from robodyn_cli.spatial import quaternion
from robodyn_cli.trajectories.motion import PoseMotion
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.kinematics import kinematics
from robodyn_cli.works.simulate import simulate
from tests.numeric import assert_close, real
from tests.unit.arms import differences

# an arm of 7 joints with odd axes, offset masses and full inertias; beside it a slide that carries a turning table
ARM = """
  joints:
    - {name: j1, type: revolute, link: l1, parent: base, axis: [0.1, 0, 1], origin: {xyz: [0, 0, 0.3]}}
    - {name: j2, type: revolute, link: l2, parent: l1, axis: [0, 1, 0.1], origin: {xyz: [0.02, 0, 0]}}
    - {name: j3, type: revolute, link: l3, parent: l2, axis: [0, 0, 1], origin: {xyz: [0, 0.03, 0.3]}}
    - {name: j4, type: revolute, link: l4, parent: l3, axis: [0, -1, 0], origin: {xyz: [0, 0, 0.1]}}
    - {name: j5, type: revolute, link: l5, parent: l4, axis: [0, 0.1, 1], origin: {xyz: [0, 0, 0.3], rpy: [0.1, 0, 0]}}
    - {name: j6, type: revolute, link: l6, parent: l5, axis: [0, 1, 0], origin: {xyz: [0, 0, 0.1]}}
    - {name: j7, type: %s, link: l7, parent: l6, %s origin: {xyz: [0.02, 0, 0.08]}}
    - {name: belt, type: prismatic, link: carriage, parent: base, axis: [1, 0.2, 0.1], origin: {xyz: [0.4, 0, 0.3]}}
    - {name: turn, type: revolute, link: table, parent: carriage, axis: [0.1, 0, 1], origin: {xyz: [0, 0.1, 0]}}
  links:
"""
LINK = (
    "    - {{name: {}, mass: {}, com: [0.02, -0.01, 0.05], inertia: {{xx: 0.02, yy: 0.03, zz: 0.015, "
    "xy: 0.002, xz: -0.001, yz: 0.003}}}}\n"
)
FRAMES = """
  frames:
    tool: {link: l7, at: [0.01, 0.02, 0.1], rpy: [0.1, -0.2, 0.3]}
    work: {link: table, at: [0.05, -0.02, 0.1], rpy: [0.2, 0.1, -0.4]}
    wrist: {link: l2, at: [0.05, 0, 0.1], rpy: [0, 0.3, 0]}
  points:
    hand: {link: base, at: [0.45, 0.1, 0.6], motion: ["0.1*sin(t)", "0.05*t^2", "0.03*cos(2*t)"]}
"""
GUESS = {
    "j1": 0.1,
    "j2": 0.5,
    "j3": 0.2,
    "j4": -1.4,
    "j5": 0.3,
    "j6": 1.2,
    "j7": 0.1,
    "belt": 0.0,
    "turn": 0.0,
}
PRESCRIBED = {"belt": "0.1*sin(1.3*t)", "turn": "0.3*t + 0.2*sin(t)"}
TIMES = np.linspace(0.0, 1.0, 201)


def scene(
    path: str,
    reference: str,
    prescribed: dict[str, str] | str,
    seventh: str = "revolute",
    rest: str = "",
    guess: dict[str, Any] | None = None,
) -> Any:
    """Return a scene whose tool follows ``path``, keys of a trajectory in flow style."""
    names = [*(f"l{k}" for k in range(1, 8)), "carriage", "table"]
    axis = "axis: [0.1, 0, 1]," if seventh == "revolute" else ""
    robot = ARM % (seventh, axis) + "".join(LINK.format(name, 1 + k / 3) for k, name in enumerate(names))
    start = {
        name: x for name, x in GUESS.items() if not (isinstance(prescribed, dict) and name in prescribed)
    }
    start |= {} if guess is None else guess
    start |= {"j7": "{quaternion: [1, 0, 0, 0]}" if seventh == "spherical" else GUESS["j7"]}
    flow = lambda values: "{" + ", ".join(f"{k}: {x}" for k, x in values.items()) + "}"  # noqa: E731
    given = prescribed if isinstance(prescribed, str) else flow(prescribed)
    return load_scene_text(
        f"schema: 1\ngravity: [0.3, 0, -9.81]\nrobot:{robot}{FRAMES}prescribed: {given}\n"
        f"initial: {{q: {flow(start)}}}\ntrajectory: {{type: cartesian, point: tool, relative_to: {reference}, {path}}}\n"
        f"kinematics: {{samples: {len(TIMES)}}}\ninverse: {{samples: {len(TIMES)}}}\n{rest}"
    )


def place(model: Any, reference: str, q: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """World position and axes of a place, by plain forward kinematics on numbers."""
    frame = model.place(reference)
    pose = poses(model, transforms(model, q.tolist()))[frame.body]
    p = frame.p
    if reference == "hand":
        p = np.array([0.45 + 0.1 * np.sin(time), 0.1 + 0.05 * time**2, 0.6 + 0.03 * np.cos(2 * time)])
    return real(model.base.point(pose.point(p))), real(model.base.E.T @ pose.R @ frame.R)


def relative(s: Any, result: Any, reference: str) -> tuple[np.ndarray, np.ndarray]:
    """The tool's position (T, 3) and axes (T, 3, 3) as seen from the place of reference."""
    model = build_model(along(s))
    p, R = [], []
    for q, time in zip(result["q"], result.time):
        at, axes = place(model, "tool", q, time)
        origin, turned = place(model, reference, q, time)
        p.append(turned.T @ (at - origin))
        R.append(turned.T @ axes)
    return np.array(p), np.array(R)


def start_at(reference: str, prescribed: Any, seventh: str = "revolute") -> tuple[str, str]:
    """Position and roll, pitch, yaw of the tool in the reference's coordinates at the guess, as texts."""
    s = scene("position: [0, 0, 0], duration: 1", reference, prescribed, seventh)
    model = build_model(along(s))
    names = {name: GUESS.get(name, 0.0) for name in model.q_names}
    q = np.array([1.0 if name.endswith(".qw") else names[name] for name in model.q_names])
    at, axes = place(model, "tool", q, 0.0)
    origin, turned = place(model, reference, q, 0.0)
    p, R = turned.T @ (at - origin), turned.T @ axes
    rpy = [np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0]), np.arctan2(R[1, 0], R[0, 0])]
    moves = ("0.05*sin(3*t)", "0.04*(1 - cos(2*t))", "0.03*t^2")
    turns = ("0.2*sin(t)", "-0.1*t^2", "0.3*t")
    position = ", ".join(f'"{x:.12f} + {move}"' for x, move in zip(p, moves))
    attitude = ", ".join(f'"{x:.12f} + {turn}"' for x, turn in zip(rpy, turns))
    return f"position: [{position}], duration: 1", f", orientation: {{rpy: [{attitude}]}}"


CASES = [
    ("work", PRESCRIBED, True),  # a table that is led
    ("work", PRESCRIBED, False),  # the same for a point: three joints are free to choose
    ("work", {"turn": PRESCRIBED["turn"]}, True),  # the belt is moved by the path as well
    ("work", {}, True),  # and so is the table
    ("wrist", {}, False),  # a link of the same arm
    ("hand", {}, True),  # a point of the base that moves by formulas
    ("hand", {"j3": "0.2 + 0.1*t", **PRESCRIBED}, True),  # a joint of the arm is led too
    ("base.origin", {"j1": "0.1 + 0.2*t"}, True),
]


@pytest.mark.parametrize(("reference", "prescribed", "oriented"), CASES)
@pytest.mark.parametrize("seventh", ["revolute", "spherical"])
def test_the_tool_follows_its_path_as_seen_from_a_moving_place(
    reference: str, prescribed: dict[str, str], oriented: bool, seventh: str
) -> None:
    position, attitude = start_at(reference, prescribed, seventh)
    s = scene(position + attitude * oriented, reference, prescribed, seventh)
    result = kinematics(s)
    target = s.trajectory.target(result.time, {})
    p, R = relative(s, result, reference)
    assert_close(p, target.p, 1e-10)
    if oriented:
        assert isinstance(target, PoseMotion)
        assert np.abs(quaternion.logarithm(target.R @ np.swapaxes(R, 1, 2))).max() < 1e-10
    names = result.variables["q"].names
    for name, text in prescribed.items():
        t = result.time
        want = {"belt": 0.1 * np.sin(1.3 * t), "turn": 0.3 * t + 0.2 * np.sin(t), "j1": 0.1 + 0.2 * t,
                "j3": 0.2 + 0.1 * t}[name]  # fmt: skip
        assert_close(result["q"][:, names.index(name)], want, 1e-15)
        assert text
    h = TIMES[1] - TIMES[0]
    single = [k for k, name in enumerate(result.variables["qd"].names) if name in names]
    columns = [names.index(result.variables["qd"].names[k]) for k in single]
    assert_close(differences(result["q"][:, columns], h), result["qd"][4:-4, single], 2e-9)
    assert_close(differences(result["qd"], h), result["qdd"][4:-4], 1e-7)


@pytest.mark.parametrize("seventh", ["revolute", "spherical"])
def test_the_torques_of_a_path_on_a_moving_table_let_a_simulation_follow_it(seventh: str) -> None:
    position, attitude = start_at("work", PRESCRIBED, seventh)
    s = scene(position + attitude, "work", PRESCRIBED, seventh)
    found = inverse(s)
    assert found.summary["ik_residual"] < 1e-12 and found.summary["attitude_residual"] < 1e-11
    assert found.summary["round_trip"] < 1e-10
    arm = {name: "trajectory" for name in GUESS if name.startswith("j")}
    led = scene(
        position + attitude, "work", {**PRESCRIBED, **arm}, seventh, "simulate: {duration: 1, samples: 101}\n",
        {name: x for name, x in GUESS.items() if name in arm and name != "j7"},
    )  # fmt: skip
    run = simulate(led)
    assert_close(run["q"], found["q"][::2], 1e-10)
    scale = np.abs(found["tau"]).max()
    assert_close(run["tau"] / scale, found["tau"][::2] / scale, 1e-7)


def test_a_path_leads_two_arms_against_each_other_by_the_least_rates() -> None:
    position, attitude = start_at("work", {})
    s = scene(position + attitude, "work", {})
    one = kinematics(s)
    less = np.linalg.norm(one["qd"][0])
    for fixed in ("belt", "turn"):
        held = kinematics(scene(position + attitude, "work", {fixed: "0*t"}))
        assert np.linalg.norm(held["qd"][0]) > less


def test_a_controller_follows_a_path_on_a_turning_table() -> None:
    circle = (
        "{type: circle, point: tip, relative_to: part, center: [0, 0, 0], radius: 0.05, duration: 1, "
        "ik: {branch: elbow_up}}"
    )
    text = """schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: theta1, type: revolute, parent: base, link: one, axis: [0, 0, 1]}
    - {name: theta2, type: revolute, parent: one, link: two, axis: [0, 0, 1], origin: {xyz: [1, 0, 0]}}
    - {name: turn, type: revolute, parent: base, link: table, axis: [0, 0, 1], origin: {xyz: [1.2, 0.6, 0]}}
  links:
    - {name: one, mass: 3, com: [0.5, 0.1, 0], inertia: {zz: 0.3}}
    - {name: two, mass: 2, com: [0.4, 0, 0], inertia: {zz: 0.2}}
    - {name: table, mass: 9, com: [0.05, 0, 0], inertia: {zz: 0.4}}
  points: {tip: {link: two, at: [0.8, 0, 0]}, part: {link: table, at: [0.2, 0, 0]}}
prescribed: {turn: 0.5*t}
initial: {q: {theta1: 1, theta2: -1}}
control: {type: %s, %s reference: %s, gains: {kp: 40000, kd: 2000}}
simulate: {duration: 1, samples: 101}
"""
    driven = "joints: [theta1, theta2],"
    s = load_scene_text(text % ("pd", driven, circle))
    run = simulate(s)
    model = build_model(along(s))
    for q, time in zip(run["q"][30:], run.time[30:]):
        at, (origin, R) = place(model, "tip", q, time)[0], place(model, "part", q, time)
        phi = 2.0 * np.pi * time
        assert np.linalg.norm(R.T @ (at - origin) - 0.05 * np.array([np.cos(phi), np.sin(phi), 0.0])) < 4e-3
    with pytest.raises(RobodynError, match="'part' is on a link that moves"):
        simulate(load_scene_text(text % ("task_pd", driven, circle)))


REFUSED = [
    ("relative_to: l7.origin", {}, "no joint moves 'tool' against"),
    ("relative_to: wrk", {}, "unknown point 'wrk'"),
    ("relative_to: work, ik: {branch: elbow_up}", {}, "which carries 'work', is not prescribed"),
    ("relative_to: wrist, ik: {redundancy: least_torque}", {}, "carries the path too"),
    ("relative_to: work", {"turn": "trajectory"}, "moves the point too"),
    ("relative_to: wrist", {"turn": "trajectory"}, "does not lead joint 'turn'"),
]


@pytest.mark.parametrize(("keys", "prescribed", "words"), REFUSED)
def test_what_cannot_be_is_refused_by_name(keys: str, prescribed: dict[str, str], words: str) -> None:
    reference, _, rest = keys.removeprefix("relative_to: ").partition(",")
    path = "position: [0.5, 0, 0.5], duration: 1" + ("," + rest if rest else "")
    with pytest.raises(SceneError, match=words):
        kinematics(scene(path, reference, prescribed))


def test_the_least_time_along_a_path_on_a_moving_table_is_refused() -> None:
    path = "{type: cartesian, point: tool, relative_to: work, position: [t, 0, 0], duration: 1}"
    s = scene("position: [0.5, 0, 0.5], duration: 1", "work", {})
    text = f"trajectory: {{type: fastest, path: {path}, effort: {{j1: 1}}}}"
    with pytest.raises(SceneError, match="'work' moves; allowed: places that stay where they are"):
        load_scene_text(s.text.replace(s.text[s.text.index("trajectory:") :], text))
