"""Drake's elements of URDF and SDF, told from the file's text alone: frames are turned, points and axes anywhere."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robodyn_cli import simulate
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from robodyn_cli.scene.descriptions import load_description
from robodyn_cli.scene.load import load_scene
from robodyn_cli.scene.types import Scene
from tests.exported_robots import Equations
from tests.oracle.test_urdf_loops import MASS, matrix, origin, pose, tree, words

GRAVITY = "schema: 1\ngravity: [0.3, -0.2, -9.81]\n"


def scene(tmp_path: Path, text: str, more: str = "", name: str = "robot.urdf") -> Scene:
    (tmp_path / name).write_text(text, encoding="utf-8")
    path = tmp_path / "scene.yaml"
    path.write_text(f"{GRAVITY}robot: {name}\n{more}", encoding="utf-8")
    return load_scene(path)


def urdf(body: str) -> str:
    return f'<robot name="r" xmlns:drake="http://drake.mit.edu">{body}</robot>'


def one_joint(rng: np.random.Generator, kind: str, inside: str = "") -> tuple[str, np.ndarray]:
    """Return a robot with one of Drake's joints on a turned origin, and the pose of that origin."""
    T = matrix(rng.uniform(-0.4, 0.4, 3), rng.uniform(-1, 1, 3))
    joint = f'<drake:joint name="j" type="{kind}"><parent link="a"/><child link="b"/>{origin(T)}{inside}</drake:joint>'
    return urdf(f'<link name="a"/><link name="b">{MASS}</link>{joint}'), T


def link_pose(scene: Scene, q: Any) -> np.ndarray:
    """Return the pose of the moving link by the program's kinematics."""
    model = Problem(scene).model
    (body,) = model.bodies
    X, frame = body.joint.transform(np.array(q)) @ body.X_tree, model.links["b"]
    T, inside = np.eye(4), np.eye(4)
    T[:3, :3], T[:3, 3] = np.array(X.E, dtype=float).T, np.array(X.r, dtype=float)
    inside[:3, :3], inside[:3, 3] = np.array(frame.R, dtype=float), np.array(frame.p, dtype=float)
    return T @ inside


def about(*turns: tuple[str, float]) -> np.ndarray:
    T = np.eye(4)
    for axis, angle in turns:
        T[:3, :3] = T[:3, :3] @ Rotation.from_euler(axis, angle).as_matrix()
    return T


def least_turn(axis: Any) -> np.ndarray:
    """Return the least rotation that takes z to an axis, about x where that may be any."""
    u, T = np.array(axis) / np.linalg.norm(axis), np.eye(4)
    normal = np.cross([0, 0, 1], u)
    angle = math.atan2(float(np.linalg.norm(normal)), u[2])
    about = normal / np.linalg.norm(normal) if normal.any() else np.array([1.0, 0, 0])
    T[:3, :3] = Rotation.from_rotvec(angle * about).as_matrix()
    return T


@pytest.mark.parametrize("seed", range(2))
def test_joints_of_other_kinds(seed: int, tmp_path: Path) -> None:
    """universal: x of the joint's frame, then the y that it carries; planar: x, y, then z; ball: any turn."""
    rng = np.random.default_rng(seed)
    text, T = one_joint(rng, "universal", '<axis xyz="0 0 1"/>')  # which means nothing for it
    a, b = rng.uniform(-2, 2, 2)
    found = link_pose(scene(tmp_path, text), [a, b])
    np.testing.assert_allclose(found, T @ about(("x", a), ("y", b)), atol=1e-14)
    x, y, theta = rng.uniform(-2, 2, 3)
    move = about(("z", theta))
    move[:3, 3] = x, y, 0.0
    # along x without an axis; the frame that moves is that of the joint, turned by the least from z to the axis
    for given in (None, [0, 0, 2], [0, 0, -1], [*rng.normal(size=3)], [1e-7, 2e-7, -1]):
        text, T = one_joint(rng, "planar", "" if given is None else f'<axis xyz="{words(given)}"/>')
        turned = least_turn([1, 0, 0] if given is None else given)
        found = link_pose(scene(tmp_path, text), [x, y, theta])
        np.testing.assert_allclose(
            found, T @ turned @ move @ turned.T, atol=1e-9 if given and given[0] == 1e-7 else 1e-14
        )
    text, T = one_joint(rng, "screw", '<axis xyz="1 2 -0.4"/><drake:screw_thread_pitch value="0.3"/>')
    u = np.array([1, 2, -0.4]) / np.linalg.norm([1, 2, -0.4])
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = Rotation.from_rotvec(a * u).as_matrix(), 0.3 * a / math.tau * u
    np.testing.assert_allclose(link_pose(scene(tmp_path, text), [a]), T @ move, atol=1e-14)
    text, T = one_joint(rng, "ball")
    turn = Rotation.random(random_state=seed)
    x, y, z, w = turn.as_quat()
    move = np.eye(4)
    move[:3, :3] = turn.as_matrix()
    np.testing.assert_allclose(link_pose(scene(tmp_path, text), [w, x, y, z]), T @ move, atol=1e-14)


THREAD = '<drake:screw_thread_pitch value="0.2"/>'


@pytest.mark.parametrize(
    ("kind", "damping", "torque"),
    [
        ("universal", "0.3", [-0.3, -0.3]),
        ("planar", "0.3 0.5 0.7", [-0.3, -0.5, -0.7]),
        ("ball", "0.3", [-0.3, -0.3, -0.3]),
        ("screw", "0.3", [-0.3]),
    ],
)
def test_damping_of_joints_of_other_kinds(
    kind: str, damping: str, torque: list[float], tmp_path: Path
) -> None:
    """By coordinate; in a ball against the angular velocity."""
    rng = np.random.default_rng(3)
    bare, damped = (
        scene(tmp_path, one_joint(np.random.default_rng(3), kind, THREAD * (kind == "screw") + inside)[0])
        for inside in ("", f'<dynamics damping="{damping}"/>')
    )
    model = Problem(bare).model
    q, v = np.array(model.bodies[0].joint.neutral()), rng.uniform(1, 2, model.nv)
    apart = Equations.of(bare, q, v).h - Equations.of(damped, q, v).h
    np.testing.assert_allclose(apart, np.array(torque) * v, rtol=1e-12)


ROTOR = (
    '<transmission name="t"><type>SimpleTransmission</type><joint name="j3"/><actuator name="m">'
    '<drake:rotor_inertia value="0.02"/><drake:gear_ratio value="7"/></actuator></transmission>'
)


def test_rotors_of_transmissions(tmp_path: Path) -> None:
    """They add N^2 J on the diagonal; not where an effort of 0 says that there is no motor."""
    rng = np.random.default_rng(4)
    text = tree(rng)
    bare, geared = scene(tmp_path, urdf(text)), scene(tmp_path, urdf(text + ROTOR))
    n = Problem(bare).model.nv
    q, v = rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)
    apart = Equations.of(geared, q, v).M - Equations.of(bare, q, v).M
    expected = np.zeros((n, n))
    expected[2, 2] = 49 * 0.02
    np.testing.assert_allclose(apart, expected, atol=1e-13)
    assert not any("<transmission>" in note for note in geared.notes)
    unpowered = text.replace(
        '<joint name="j3" type="continuous">', '<joint name="j3" type="continuous"><limit effort="0"/>'
    )
    same = scene(tmp_path, urdf(unpowered + ROTOR))
    np.testing.assert_allclose(Equations.of(same, q, v).M, Equations.of(bare, q, v).M, atol=1e-13)


def test_acceleration_limits(tmp_path: Path) -> None:
    text = tree(np.random.default_rng(5)).replace(
        '<joint name="j2" type="continuous">',
        '<joint name="j2" type="continuous"><limit effort="2" velocity="3" drake:acceleration="4"/>',
    )
    limits: Any = scene(tmp_path, urdf(text)).robot.limits_of("j2")
    assert (limits.effort, limits.speed, limits.acceleration) == (2.0, 3.0, 4.0)


def constraint(kind: str, ends: Any, more: str = "") -> str:
    tag = f"drake:{kind}_constraint"
    parts = "".join(
        f'<{tag}_body_{b} name="{link}"/><{tag}_p_{p} value="{words(at)}"/>'
        for b, p, (link, at) in zip("AB", ("AP", "BQ"), ends)
    )
    return f"<{tag}>{parts}{more}</{tag}>"


@pytest.mark.parametrize("kind", ["ball", "distance"])
def test_constraints_between_points(kind: str, tmp_path: Path) -> None:
    """Points of turned links stay together, or at their distance, while they move."""
    rng = np.random.default_rng(6)
    text = tree(rng)
    q = {f"j{k}": float(x) for k, x in enumerate(rng.uniform(-0.6, 0.6, 9), 1)}
    points = {"link5": rng.uniform(-0.3, 0.3, 3), "link9": rng.uniform(-0.3, 0.3, 3)}
    start = {link: pose(text_of(text), link, q) @ [*p, 1.0] for link, p in points.items()}
    length = float(np.linalg.norm(start["link5"] - start["link9"]))
    if kind == "ball":  # put the second point where the first one is
        inside = np.linalg.inv(pose(text_of(text), "link9", q)) @ start["link5"]
        points["link9"], length = inside[:3], 0.0
    more = f'<drake:distance_constraint_distance value="{length!r}"/>' if kind == "distance" else ""
    given = ", ".join(f"{name}: {x!r}" for name, x in q.items())
    run = f"initial: {{q: {{{given}}}}}\nsimulate: {{duration: 0.2, samples: 5}}\n"
    result = simulate(scene(tmp_path, urdf(text + constraint(kind, [*points.items()], more)), run))
    moved = result["q"]
    assert np.abs(moved[-1] - moved[0]).max() > 1e-2
    for row in moved:
        at = dict(zip(q, row))
        first, second = (pose(text_of(text), link, at) @ [*p, 1.0] for link, p in points.items())
        assert math.isclose(float(np.linalg.norm(first - second)), length, abs_tol=1e-9)


def text_of(body: str) -> str:
    return f'<robot name="r">{body}</robot>'


SDF = """<sdf version="1.9" xmlns:drake="http://drake.mit.edu"><model name="m">
  <link name="a"><pose>0.1 0.2 0.3 0.4 -0.5 0.6</pose></link><link name="b"><pose>0.5 -0.1 0.2 -0.7 0.2 1.1</pose></link>
  <joint name="j" type="revolute"><parent>world</parent><child>a</child><pose>0.05 0.1 0 0 0 0</pose>
    <axis><xyz>0.2 0.3 1</xyz></axis>ROTOR</joint>
  <joint name="k" type="revolute"><parent>world</parent><child>b</child><pose>0.3 0 0.1 0.1 0 0</pose>
    <axis><xyz>1 0.1 0</xyz></axis>MIMIC</joint>BALL</model></sdf>"""


def sdf(tmp_path: Path, **parts: str) -> Scene:
    text = SDF
    for name in ("ROTOR", "MIMIC", "BALL"):
        text = text.replace(name, parts.get(name, ""))
    return scene(tmp_path, text, name="robot.sdf")


def test_elements_in_sdf(tmp_path: Path) -> None:
    """Rotors and mimics of joints, and points that a ball ties, in the frames of the file's links."""
    bare, q, v = sdf(tmp_path), np.array([0.3, -0.4]), np.array([0.2, 0.7])
    rotor = "<drake:rotor_inertia>0.02</drake:rotor_inertia><drake:gear_ratio>7</drake:gear_ratio>"
    apart = Equations.of(sdf(tmp_path, ROTOR=rotor), q, v).M - Equations.of(bare, q, v).M
    np.testing.assert_allclose(apart, np.diag([49 * 0.02, 0.0]), atol=1e-13)
    (coupler,) = sdf(tmp_path, MIMIC='<drake:mimic joint="j" multiplier="3" offset="0.2"/>').couplers
    assert dict(coupler.terms) == {"k": 1.0, "j": -3.0} and coupler.value.constant == 0.2
    tag = "drake:ball_constraint"
    ball = (
        f"<{tag}><{tag}_body_A>a</{tag}_body_A><{tag}_p_AP>0.1 0.2 0.3</{tag}_p_AP>"
        f"<{tag}_body_B>b</{tag}_body_B><{tag}_p_BQ>-0.2 0.1 0.4</{tag}_p_BQ></{tag}>"
    )
    tied = sdf(tmp_path, BALL=ball)
    from robodyn_cli.solve.closure import Numbers

    # at the file's poses the gap between the two points follows from the text
    first = matrix([0.1, 0.2, 0.3], [0.4, -0.5, 0.6]) @ [0.1, 0.2, 0.3, 1.0]
    second = matrix([0.5, -0.1, 0.2], [-0.7, 0.2, 1.1]) @ [-0.2, 0.1, 0.4, 1.0]
    gap = Numbers(Problem(tied), ()).eta(np.zeros(2))
    np.testing.assert_allclose(gap, (first - second)[:3], atol=1e-14)


PLAIN = '<link name="n"/><joint name="x" type="fixed"><parent link="link1"/><child link="n"/>{}</joint>'


@pytest.mark.parametrize(
    ("element", "message"),
    [
        ('<drake:joint name="x" type="curvilinear"/>', "unknown type 'curvilinear'; allowed: ball, planar, screw, universal"),
        ('<drake:joint name="x" type="screw"/>', "joint 'x' is a screw and needs <drake:screw_thread_pitch value=...>"),
        (f'<drake:joint name="x" type="screw">{THREAD.replace("0.2", "0")}</drake:joint>', "a number, not 0 [m per turn]"),
        (PLAIN.format(THREAD), "<drake:screw_thread_pitch> acts on the motion"),
        (PLAIN.format('<drake:rotor_inertia value="1"/>'), "the actuator of a transmission"),
        ("<drake:ball_constraint/>", "ball_constraint needs <drake:ball_constraint_body_A>"),
        (constraint("ball", [("link5", [0, 0, 0]), ("limb", [0, 0, 0])]), "'limb' is no link of this file"),
        (ROTOR.replace("j3", "j33"), "unknown joint with one coordinate 'j33'"),
        (ROTOR.replace("Simple", "Four"), "those of type SimpleTransmission"),
        (ROTOR.replace("0.02", "-1"), "rotor_inertia is negative"),
        (
            constraint("distance", [("link5", [0, 0, 0]), ("link9", [0, 0, 0])],
                       '<drake:distance_constraint_distance value="0"/>'),
            "the distance is 0; allowed: a number > 0",
        ),
    ],
)  # fmt: skip
def test_what_is_refused(element: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(urdf(tree(np.random.default_rng(7)) + element), encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        load_description(tmp_path / "robot.urdf")
    assert message in str(caught.value) and "robot.urdf:1:" in str(caught.value)


def test_threads_of_sdf(tmp_path: Path) -> None:
    """Drake's is in metres per turn and right-handed, as that of SDF 1.10; the old one in rad/m and left-handed."""
    for thread in ("<drake:screw_thread_pitch>0.3</drake:screw_thread_pitch>",
                   "<screw_thread_pitch>0.3</screw_thread_pitch>", f"<thread_pitch>{-math.tau / 0.3}</thread_pitch>"):  # fmt: skip
        text = SDF.replace('"k" type="revolute"', '"k" type="screw"').replace("MIMIC", thread)
        found = scene(tmp_path, text.replace("ROTOR", "").replace("BALL", ""), name="robot.sdf")
        (screw,) = (joint for joint in found.robot.joints if joint.type == "helical")
        assert math.isclose(screw.pitch or 0.0, 0.3 / math.tau, rel_tol=1e-15)
