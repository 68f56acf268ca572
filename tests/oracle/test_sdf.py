"""What an SDF means, told from its text alone: frames, inertias, loops and couplings, each frame turned and off.

Bodies move by products of exponentials about axes as they stand in the file, which the program does not do.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robodyn_cli import simulate
from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.kinematics import poses, transforms, world_pose
from robodyn_cli.model.build import build_model
from robodyn_cli.scene.load import load_scene
from robodyn_cli.scene.types import Scene
from tests.numeric import assert_close, first_derivative
from tests.sdf_robots import Text, axis, joint, link, matrix, pose, random_pose, words


def loaded(tmp_path: Path, sdf: str, more: str = "") -> Scene:
    (tmp_path / "robot.sdf").write_text(sdf, encoding="utf-8")
    path = tmp_path / "scene.yaml"
    path.write_text(
        f"schema: 1\ngravity: [0.3, -0.2, -9.81]\nrobot: robot.sdf\n{more}simulate: {{duration: 0.2, samples: 5}}\n"
    )
    return load_scene(path)


def frame_pose(scene: Scene, q: list[float], name: str) -> np.ndarray:
    """Return the pose of a named frame by the program's kinematics."""
    model = build_model(scene)
    at = world_pose(model, poses(model, transforms(model, np.array(q))), model.frames[name])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.array(at.R, dtype=float), np.array(at.p, dtype=float)
    return T


def chain(rng: np.random.Generator, kinds: tuple[str, ...], old: bool = False) -> str:
    """Return a chain of joints from the world on, with frames in frames; ``old`` : without those of 1.7."""
    threads = ("<screw_thread_pitch>0.7</screw_thread_pitch>", "<thread_pitch>-9</thread_pitch>")
    text = "" if old else f'<frame name="off">{pose(rng)}</frame>'
    for k, kind in enumerate(kinds, 1):
        relative = ("", "off", f"L{k - 1}", f"J{k - 1}")[k % 4] if k > 1 and not old else ""
        frame = ("", "__model__", "off", f"L{k}")[k % 4] if not old else ""
        in_model = f"<use_parent_model_frame>{k % 2}</use_parent_model_frame>" if old else ""
        inside = axis(rng, in_model, frame=frame) + pose(rng, "off" if k % 3 == 2 and not old else "")
        inside += threads[old] if kind == "screw" else ""
        text += link(f"L{k}", rng, relative) + joint(
            f"J{k}", kind, f"L{k - 1}" if k > 1 else "world", f"L{k}", inside
        )
        text += "" if old else f'<frame name="F{k}" attached_to="L{k}">{pose(rng)}</frame>'
    return text


@pytest.mark.parametrize("version", ["1.5", "1.6", "1.7", "1.8", "1.9", "1.10", "1.11", "1.12"])
def test_frames_of_each_version(tmp_path: Path, version: str) -> None:
    """Frames in all sorts of frames, axes in all sorts of frames, and where joints take them."""
    rng = np.random.default_rng(int(version[2:]))
    old = version in ("1.5", "1.6")
    kinds = ("revolute", "prismatic", "screw", "continuous", "revolute")
    sdf = f'<sdf version="{version}"><model name="m">{pose(rng)}{chain(rng, kinds, old)}</model></sdf>'
    scene, text = loaded(tmp_path, sdf), Text(sdf)
    q = [float(x) for x in rng.uniform(-1, 1, len(kinds))]
    steps = [(f"J{k}", x) for k, x in enumerate(q, 1)]
    for k in range(1, len(kinds) + 1):
        if not old:
            assert_close(frame_pose(scene, q, f"F{k}"), text.moved(f"F{k}", steps[:k]), 1e-13)
    check_masses(scene, text, [f"L{k}" for k in range(1, len(kinds) + 1)], q, steps)


def check_masses(
    scene: Scene, text: Text, links: list[str], q: list[float], steps: list[tuple[str, float]]
) -> None:
    """Compare the mass matrix with the links' velocities by differences: m v.v + w.I w."""
    inner = np.array([0.1, 0.02, -0.03])
    R0 = Rotation.from_euler("xyz", [0.3, -0.2, 0.5]).as_matrix()
    I = R0 @ np.array([[0.1, 0.01, 0], [0.01, 0.12, -0.01], [0, -0.01, 0.14]]) @ R0.T
    expected = np.zeros((len(q), len(q)))
    for k, name in enumerate(links, 1):
        rates = []
        for j in range(len(q)):

            def at(h: float, j: int = j, k: int = k, name: str = name) -> np.ndarray:
                return text.moved(name, [(n, x + h * (i == j)) for i, (n, x) in enumerate(steps)][:k])

            rates.append(first_derivative(at, 0.05))
        T = text.moved(name, steps[:k])
        v = np.array([rate @ [*inner, 1.0] for rate in rates])[:, :3]
        w = np.array([(T[:3, :3].T @ rate[:3, :3])[[2, 0, 1], [1, 2, 0]] for rate in rates])
        expected += 1.5 * v @ v.T + w @ I @ w.T
    assert_close(crba(build_model(scene), np.array(q)), expected, 1e-9)


def test_nested_models(tmp_path: Path) -> None:
    """Names inside have those of the models before them; a placement frame places the model."""
    rng = np.random.default_rng(4)
    frames = "".join(
        f'<frame name="{name}" attached_to="{to}">{pose(rng)}</frame>'
        for name, to in (("off", ""), ("F1", "L1"), ("F2", "L2"))
    )
    slide = joint("J2", "prismatic", "L1", "L2", axis(rng, frame="off") + pose(rng, "F1"))
    inner = f'<model name="arm">{pose(rng, "post")}{frames}{link("L1", rng)}{link("L2", rng, "F1")}{slide}</model>'
    outer = link("post", rng) + joint("hold", "fixed", "world", "post", pose(rng))
    across = joint("turn", "revolute", "post", "arm::L1", axis(rng, frame="arm::off") + pose(rng, "arm::L2"))
    tip = f'<frame name="tip" attached_to="arm::F2">{pose(rng)}</frame>'
    sdf = f'<sdf version="1.9"><model name="m">{pose(rng)}{outer}{inner}{across}{tip}</model></sdf>'
    scene, text = loaded(tmp_path, sdf), Text(sdf)
    assert [j.name for j in scene.robot.joints] == ["hold", "arm__J2", "turn"]
    q = [0.3, -0.7]
    steps = [("turn", q[1]), ("arm::J2", q[0])]
    assert_close(frame_pose(scene, q, "tip"), text.moved("tip", steps), 1e-13)
    assert_close(frame_pose(scene, q, "arm__F1"), text.moved("arm::F1", steps[:1]), 1e-13)


def test_a_placement_frame_is_where_the_pose_puts_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    bodies = link("L1", rng) + f'<frame name="grip" attached_to="L1">{pose(rng)}</frame>'
    where = random_pose(rng)
    sdf = (
        f'<sdf version="1.8"><model name="m" placement_frame="grip"><pose>{words(where)}</pose>{bodies}'
        f"{joint('J', 'revolute', 'world', 'L1', axis(rng))}</model></sdf>"
    )
    assert_close(frame_pose(loaded(tmp_path, sdf), [0.0], "grip"), matrix(where), 1e-14)


def test_ways_to_write_a_rotation(tmp_path: Path) -> None:
    """Degrees, and quaternions whose real part is last."""
    rng = np.random.default_rng(6)
    x = random_pose(rng)
    turned = Rotation.from_euler("xyz", x[3:])
    forms = (
        f"<pose>{words(x)}</pose>",
        f'<pose degrees="true">{words([*x[:3], *np.degrees(x[3:])])}</pose>',
        f'<pose rotation_format="quat_xyzw">{words([*x[:3], *turned.as_quat()])}</pose>',
    )
    frames = "".join(f'<frame name="F{k}">{form}</frame>' for k, form in enumerate(forms))
    sdf = f'<sdf version="1.9"><model name="m">{link("L", rng)}{frames}</model></sdf>'
    found = loaded(tmp_path, sdf)
    q = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]  # the model is free
    for k in range(3):
        assert_close(frame_pose(found, q, f"F{k}"), Text(f'<sdf><model name="m"><frame name="F">{forms[0]}</frame></model></sdf>').assembled("F"), 1e-14)  # fmt: skip


LOOPS = {
    "revolute": ("revolute", "revolute", "revolute", "revolute", "revolute", "prismatic", "revolute"),
    "prismatic": ("revolute",) * 7,
    "ball": ("revolute",) * 7,
    "fixed": ("revolute",) * 7,
    "universal": ("revolute",) * 7,
    "screw": ("revolute",) * 7,
}


@pytest.mark.parametrize("bare", [True, False])
@pytest.mark.parametrize("kind", LOOPS)
def test_loops_are_closed_along_a_motion(tmp_path: Path, kind: str, bare: bool) -> None:
    """A link with two parents: what each joint does is measured from the text. With damping a coordinate stays."""
    rng = np.random.default_rng([len(kind), bare])
    kinds = LOOPS[kind]
    text = chain(rng, kinds)
    text += link("R", rng) + joint("side", "revolute", "world", "R", axis(rng) + pose(rng))
    inside = pose(rng, "off")
    dynamics = "" if bare or kind in ("ball", "fixed") else "<dynamics><damping>0.3</damping></dynamics>"
    if kind not in ("ball", "fixed", "universal"):
        inside += axis(rng, dynamics, frame="L2")
    if kind == "screw":
        inside += "<screw_thread_pitch>0.4</screw_thread_pitch>"
    if kind == "universal":
        u = rng.uniform(-1, 1, 3)
        w = np.cross(u, rng.uniform(-1, 1, 3))
        inside += f'<axis><xyz expressed_in="L2">{words(u)}</xyz>{dynamics}</axis><axis2><xyz expressed_in="L2">{words(w)}</xyz></axis2>'
    cut = "<physics><simbody><must_be_loop_joint>1</must_be_loop_joint></simbody></physics>"
    text += joint("close", kind, f"L{len(kinds)}", "R", inside + cut)
    sdf = f'<sdf version="1.10"><model name="m">{pose(rng)}{text}</model></sdf>'
    scene = loaded(tmp_path, sdf, "initial: {qd: {J1: 0.7, J2: -0.4}}\n")
    kept = kind == "screw" or not (bare or kind in ("ball", "fixed"))
    assert ("close" in {j.name for j in scene.robot.joints}) == kept
    told = "and keep their coordinate" if kept else "joints that close loops: close"
    assert any(told in note for note in scene.notes)
    result = simulate(scene)
    names = [c for j in scene.robot.joints for c in _columns(j)]
    assert np.abs(result["q"][-1] - result["q"][0]).max() > 1e-2
    measured = Text(sdf)
    for sample in result["q"]:
        q = dict(zip(names, sample))
        first = measured.moved("close", [(f"J{k}", q[f"J{k}"]) for k in range(1, len(kinds) + 1)])
        second = measured.moved("close", [("side", q["side"])])
        assert miss(measured, kind, first, second) < 1e-10
    assert np.abs(result["q"][0]).max() < 1e-12  # the file's poses are closed


def _columns(one: object) -> list[str]:
    from robodyn_cli.joints.registry import joint_types

    kind = joint_types[one.type]  # type: ignore[attr-defined]
    return list(kind.coordinates(one.name, kind.names)) if kind.nq else []  # type: ignore[attr-defined]


def miss(text: Text, kind: str, first: np.ndarray, second: np.ndarray) -> float:
    """Return by how much the two images of a joint's frame miss what the joint allows: metres, or sines."""
    J = text.assembled("close")[:3, :3]
    gap = first[:3, :3].T @ (second[:3, 3] - first[:3, 3])
    turn = first[:3, :3].T @ second[:3, :3]
    if kind in ("ball", "fixed"):
        return float(np.abs([*gap, *((turn - np.eye(3)).ravel() if kind == "fixed" else ())]).max())
    u = J.T @ text.axis("close")
    across = gap - u * (u @ gap)
    if kind == "prismatic":
        return float(np.abs([*across, *(turn - np.eye(3)).ravel()]).max())
    if kind == "universal":
        w = J.T @ text.axis("close", "axis2")
        return float(np.abs([*gap, u @ turn @ w]).max())
    if kind == "screw":
        angle = Rotation.from_matrix(turn).as_rotvec() @ u
        return float(np.abs([*across, *np.cross(u, turn @ u), u @ gap - text.lead("close") * angle]).max())
    return float(np.abs([*gap, *np.cross(u, turn @ u)]).max())


def test_a_weld_of_drake_joins_frames(tmp_path: Path) -> None:
    """The frames that it names stay together while their links move, whatever the poses of these are."""
    rng = np.random.default_rng(17)
    text = chain(rng, ("revolute",) * 7)
    text += link("R", rng) + joint("side", "revolute", "world", "R", axis(rng) + pose(rng))
    text += f'<frame name="one" attached_to="L7">{pose(rng)}</frame>'
    text += '<frame name="other" attached_to="R"><pose relative_to="one">0 0 0 0 0 0</pose></frame>'
    text += "<drake:weld_constraint><parent>one</parent><child>other</child></drake:weld_constraint>"
    sdf = f'<sdf version="1.9" xmlns:drake="http://drake.mit.edu"><model name="m">{pose(rng)}{text}</model></sdf>'
    result = simulate(loaded(tmp_path, sdf, "initial: {qd: {J1: 0.7, J2: -0.4}}\n"))
    assert np.abs(result["q"][0]).max() < 1e-12 and np.abs(result["q"][-1]).max() > 1e-2
    measured = Text(sdf)
    for sample in result["q"]:
        first = measured.moved("one", [(f"J{k}", float(q)) for k, q in enumerate(sample[:7], 1)])
        assert_close(measured.moved("other", [("side", float(sample[7]))]), first, 1e-10)


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "screw"])
def test_a_joint_from_child_to_parent(tmp_path: Path, kind: str) -> None:
    """A link that hangs in the world by its child only: the joint is taken backward, q stays what it was."""
    rng = np.random.default_rng(len(kind))
    thread = "<screw_thread_pitch>0.5</screw_thread_pitch>" if kind == "screw" else ""
    text = link("A", rng) + link("B", rng) + joint("held", "revolute", "world", "B", axis(rng) + pose(rng))
    text += joint("J", kind, "A", "B", axis(rng, frame="A") + pose(rng) + thread)
    text += f'<frame name="F" attached_to="A">{pose(rng)}</frame>'
    sdf = f'<sdf version="1.7"><model name="m">{text}</model></sdf>'
    scene, measured = loaded(tmp_path, sdf), Text(sdf)
    q = [0.4, -0.6]
    assert [j.name for j in scene.robot.joints] == ["held", "J"]
    moved = measured.step("held", q[0]) @ np.linalg.inv(measured.step("J", q[1])) @ measured.assembled("F")
    assert_close(frame_pose(scene, q, "F"), moved, 1e-13)
    assert any("taken from child to parent: J" in note for note in scene.notes)


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("kind", ["universal", "revolute2"])
def test_crosses(tmp_path: Path, kind: str, backward: bool) -> None:
    """First about the axis that stays with the parent, then about the one that goes with the child."""
    rng = np.random.default_rng(11)
    u = rng.uniform(-1, 1, 3)
    w = np.cross(u, rng.uniform(-1, 1, 3))
    parts = "<dynamics><damping>{}</damping></dynamics><limit><lower>-1</lower><upper>{}</upper></limit>"
    axes = f"<axis><xyz>{words(u)}</xyz>{parts.format(0.2, 2)}</axis><axis2><xyz>{words(w)}</xyz>{parts.format(0.5, 3)}</axis2>"
    ends = ("A", "B") if backward else ("B", "A")  # B is held
    text = link("A", rng) + link("B", rng) + joint("held", "fixed", "world", "B", "")
    text += joint("J", kind, *ends, axes + pose(rng)) + f'<frame name="F" attached_to="A">{pose(rng)}</frame>'
    sdf = f'<sdf version="1.7"><model name="m">{text}</model></sdf>'
    scene, measured = loaded(tmp_path, sdf), Text(sdf)
    q = {"first": 0.7, "second": -0.5}
    T = np.eye(4)
    at = measured.assembled("J")[:3, 3]
    for tag, x in (("axis", q["first"]), ("axis2", q["second"])):
        S = np.eye(4)
        S[:3, :3] = Rotation.from_rotvec(x * measured.axis("J", tag)).as_matrix()
        S[:3, 3] = at - S[:3, :3] @ at
        T = T @ S
    T = np.linalg.inv(T) if backward else T
    order = [q["second"], q["first"]] if backward else [q["first"], q["second"]]
    assert_close(frame_pose(scene, order, "F"), T @ measured.assembled("F"), 1e-13)
    limits = scene.robot.limits_of("J.theta1"), scene.robot.limits_of("J.theta2")
    assert [x.upper for x in limits] == ([3.0, 2.0] if backward else [2.0, 3.0])


def test_a_free_model_starts_where_the_file_puts_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(13)
    text = link("A", rng) + link("B", rng) + joint("J", "ball", "B", "A", pose(rng))
    sdf = f'<sdf version="1.7"><model name="m">{pose(rng)}{text}<frame name="F" attached_to="A">{pose(rng)}</frame></model></sdf>'
    scene = loaded(tmp_path, sdf)
    root = scene.robot.joints[0]
    assert (root.name, root.type, root.link) == ("root_joint", "floating", "B")
    assert any("no joint ties to the world, so free: B" in note for note in scene.notes)
    neutral = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    assert_close(frame_pose(scene, neutral, "F"), Text(sdf).assembled("F"), 1e-13)


def test_couplings(tmp_path: Path) -> None:
    """q = multiplier (leader - reference) + offset; a gearbox counts angles from its reference body by its axes."""
    rng = np.random.default_rng(2)
    mimic = '<mimic joint="{}"><multiplier>-2.5</multiplier><offset>0.3</offset><reference>0.1</reference></mimic>'
    u = rng.uniform(-1, 1, 3)
    along = f'<axis><xyz expressed_in="__model__">{words(u)}</xyz></axis>'
    against = f'<axis><xyz expressed_in="__model__">{words(-2 * u)}</xyz></axis>'
    text = "".join(link(name, rng) for name in "ABCDE")
    text += joint("a", "revolute", "world", "A", along + pose(rng))
    text += joint("b", "revolute", "A", "B", against + pose(rng))
    text += joint("c", "revolute", "A", "C", along + pose(rng))
    text += joint("d", "prismatic", "world", "D", axis(rng, mimic.format("a")))
    text += joint("s", "prismatic", "C", "E", axis(rng))
    gear = along + against.replace("axis>", "axis2>")
    text += joint(
        "g",
        "gearbox",
        "B",
        "E",
        f"{gear}<gearbox_ratio>4</gearbox_ratio><gearbox_reference_body>A</gearbox_reference_body>",
    )
    text += joint(
        "h",
        "gearbox",
        "A",
        "C",
        f"{gear}<gearbox_ratio>3</gearbox_ratio><gearbox_reference_body>world</gearbox_reference_body>",
    )
    sdf = f'<sdf version="1.11"><model name="m">{text}</model></sdf>'
    found = {x.name: x for x in loaded(tmp_path, sdf).couplers}
    mimics = found["d_mimic"]
    assert mimics.terms == {"d": 1.0, "a": 2.5}
    assert math.isclose(float(mimics.value.evaluate({"t": 0.0})), 0.3 - (-2.5) * 0.1)  # type: ignore[union-attr]
    # theta1 about u: b turns about -u; theta2 about -u: c turns about u: -qc + 4 (-qb) = 0
    assert found["g"].terms == {"b": -4.0, "c": -1.0}
    # theta1 from the world: qa; theta2 about -u: -(qa + qc): 3 qa - qa - qc = 0
    assert found["h"].terms == {"a": 2.0, "c": -1.0}


def test_springs_friction_and_limits(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    inside = (
        "<dynamics><damping>0.4</damping><friction>0.2</friction><spring_stiffness>7</spring_stiffness>"
        "<spring_reference>-0.3</spring_reference></dynamics><limit><lower>-1</lower><upper>inf</upper><effort>-1</effort>"
        "<velocity>5</velocity></limit>"
    )
    text = link("A", rng) + joint("J", "revolute", "world", "A", axis(rng, inside))
    scene = loaded(tmp_path, f'<sdf version="1.12"><model name="m">{text}</model></sdf>')
    forces = dict(scene.robot.joints[0].forces)
    assert (forces["spring"].stiffness, forces["spring"].rest) == (7.0, -0.3)
    assert (forces["friction"].viscous, forces["friction"].coulomb, forces["friction"].law) == (
        0.4,
        0.2,
        "set_valued",
    )
    limits = scene.robot.limits_of("J")
    assert (limits.lower, limits.upper, limits.speed, limits.effort) == (-1.0, None, 5.0, None)


@pytest.mark.parametrize("damped", [("elbow",), ("drive", "elbow", "swing", "pin")])
def test_accelerations_of_a_loop(tmp_path: Path, damped: tuple[str, ...]) -> None:
    """Of three bodies in the plane and four pins, by their own coordinates; a damped pin keeps its coordinate."""
    robot = (Path(__file__).parents[2] / "configs/robots/crank_rocker.sdf").read_text(encoding="utf-8")
    damping = "<dynamics><damping>0.01</damping></dynamics>"
    axis = "<xyz>0 0 1</xyz></axis>"
    robot = robot.replace(damping, "").replace(axis, axis.replace("</axis>", f"{damping}</axis>"))
    for name in {"drive", "elbow", "swing", "pin"} - {*damped}:
        head, mark, tail = robot.partition(f'<joint name="{name}"')
        robot = head + mark + tail.replace(damping, "", 1)
    (tmp_path / "robot.sdf").write_text(robot, encoding="utf-8")
    (tmp_path / "scene.yaml").write_text(
        "schema: 1\ngravity: [1, -9.81, 0]\nrobot: robot.sdf\ninitial: {qd: {drive: 2}}\n"
        "simulate: {duration: 0.01, samples: 3}\n"
    )
    scene = load_scene(tmp_path / "scene.yaml")
    result = simulate(scene)
    measured = Text(robot)
    links = ("crank", "coupler", "rocker")
    mass, moment = {}, {}
    com = {}
    for name in links:
        inertial = measured.elements[name][0].find("inertial")
        assert inertial is not None
        mass[name], moment[name] = (float(inertial.findtext(tag) or "nan") for tag in ("mass", "inertia/izz"))
        offset = [float(x) for x in (inertial.findtext("pose") or "").split()]
        com[name] = (measured.assembled(name) @ [*offset[:3], 1.0])[:2]
    pins = {"drive": (None, "crank"), "elbow": ("crank", "coupler"), "swing": (None, "rocker"), "pin": ("coupler", "rocker")}  # fmt: skip
    J, arms = np.zeros((8, 9)), {}
    for row, (pin, ends) in enumerate(pins.items()):
        at = measured.assembled(pin)[:2, 3]
        for sign, end in zip((-1.0, 1.0), ends):
            if end is not None:
                k, r = 3 * links.index(end), at - com[end]
                arms[pin, end] = sign * r
                J[2 * row : 2 * row + 2, k : k + 2] = sign * np.eye(2)
                J[2 * row : 2 * row + 2, k + 2] = sign * np.array([-r[1], r[0]])
    motion = np.linalg.svd(J)[2][-1]
    v = motion * 2.0 / motion[2]
    w = dict(zip(links, v[2::3]), **{"": 0.0})
    force = np.array([x for name in links for x in (mass[name], -9.81 * mass[name], 0.0)])
    gamma = np.zeros(8)
    for row, (pin, (parent, child)) in enumerate(pins.items()):
        for end in (parent, child):
            if end is not None:
                gamma[2 * row : 2 * row + 2] += w[end] ** 2 * arms[pin, end]
        torque = 0.01 * (w[child] - w[parent or ""]) * (pin in damped)
        force[3 * links.index(child) + 2] -= torque
        if parent is not None:
            force[3 * links.index(parent) + 2] += torque
    M = np.diag([x for name in links for x in (mass[name], mass[name], moment[name])])
    a = np.linalg.solve(np.block([[M, J.T], [J, np.zeros((8, 8))]]), np.concatenate([force, gamma]))[:9]
    alpha = dict(zip(links, a[2::3]))
    expected = [alpha["crank"], alpha["coupler"] - alpha["crank"], alpha["rocker"]]
    expected += [alpha["rocker"] - alpha["coupler"]] if "pin" in damped else []
    assert [c for j in scene.robot.joints for c in _columns(j)] == [*pins][: len(expected)]
    assert_close(result["qdd"][0], np.array(expected), 1e-10)
