"""Loops and couplings of URDF dialects: what closes is told from the file's text alone, by 4 x 4 matrices.

Every frame is turned and off its link's origin: published files have neither and would pass a wrong reading.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robodyn_cli import simulate
from robodyn_cli.errors import SceneError
from robodyn_cli.scene.descriptions import load_description
from robodyn_cli.scene.load import load_scene
from robodyn_cli.scene.ties import rpy_of
from robodyn_cli.scene.types import Scene
from tests.exported_robots import Equations

MASS = (
    '<inertial><origin xyz="0.1 0.02 -0.03"/><mass value="1.5"/>'
    '<inertia ixx="0.1" ixy="0.01" ixz="0" iyy="0.12" iyz="-0.01" izz="0.14"/></inertial>'
)
JOINTS = 9  # 1 to 5 in one branch, 6 to 9 in the other


def words(numbers: object) -> str:
    return " ".join(repr(float(x)) for x in numbers)  # type: ignore[attr-defined]


def matrix(xyz: object, rpy: object) -> np.ndarray:
    """Return the 4 x 4 matrix of an origin: roll, pitch and yaw about fixed axes."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    T[:3, 3] = xyz
    return T


def origin(T: np.ndarray, tag: str = "origin") -> str:
    rpy = Rotation.from_matrix(T[:3, :3]).as_euler("xyz")
    return f'<{tag} xyz="{words(T[:3, 3])}" rpy="{words(rpy)}"/>'


def tree(rng: np.random.Generator) -> str:
    """Return links and joints of two branches of a robot, with turned frames and skew axes."""
    text = '<link name="ground"/>'
    for k in range(1, JOINTS + 1):
        parent = "ground" if k in (1, 6) else f"link{k - 1}"
        T = matrix(rng.uniform(-0.4, 0.4, 3), rng.uniform(-1, 1, 3))
        text += (
            f'<link name="link{k}">{MASS}</link><joint name="j{k}" type="continuous"><parent link="{parent}"/>'
            f'<child link="link{k}"/>{origin(T)}<axis xyz="{words(rng.uniform(-1, 1, 3))}"/></joint>'
        )
    return text


def pose(urdf: str, link: str, q: dict[str, float]) -> np.ndarray:
    """Return the pose of a link's frame, from the text of a file."""
    joints = {j.find("child").get("link"): j for j in ElementTree.fromstring(urdf).findall("joint")}  # type: ignore[union-attr]
    T = np.eye(4)
    while link in joints:
        joint = joints[link]
        place, axis = joint.find("origin"), joint.find("axis")
        assert place is not None and axis is not None
        xyz, rpy = ([float(x) for x in place.get(k, "0 0 0").split()] for k in ("xyz", "rpy"))
        u = np.array([float(x) for x in axis.get("xyz", "").split()])
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(q[joint.get("name", "")] * u / np.linalg.norm(u)).as_matrix()
        T = matrix(xyz, rpy) @ turn @ T
        link = joint.find("parent").get("link")  # type: ignore[union-attr]
    return T


def loaded(tmp_path: Path, urdf: str, q: dict[str, float], beside: str = "") -> Scene:
    (tmp_path / "robot.urdf").write_text(urdf, encoding="utf-8")
    if beside:
        (tmp_path / "robot.yaml").write_text(beside, encoding="utf-8")
    start = ", ".join(f"{name}: {x!r}" for name, x in q.items())
    path = tmp_path / "scene.yaml"
    path.write_text(
        f"schema: 1\ngravity: [0, 0, -9.81]\nrobot: robot.urdf\ninitial: {{q: {{{start}}}}}\n"
        "simulate: {duration: 0.2, samples: 5}\n",
        encoding="utf-8",
    )
    return load_scene(path)


def closing(kind: str, axis: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
    """Return by how much two frames miss what a closure asks: metres, or sines of angles."""
    gap = first[:3, :3].T @ (second[:3, 3] - first[:3, 3])
    turn = first[:3, :3].T @ second[:3, :3]
    u = axis / np.linalg.norm(axis)
    across = [*(gap - u * (u @ gap))]
    parallel = [*(turn @ u - u)]  # upside down is not closed
    apart = {
        "spherical": [*gap],
        "revolute": [*gap, *parallel],
        "continuous": [*gap, *parallel],
        "planar": [u @ gap, *parallel],
        "prismatic": [*across, *(turn - np.eye(3)).ravel()],
        "fixed": [*gap, *(turn - np.eye(3)).ravel()],
    }[kind]
    return float(np.abs(apart).max())


def element(dialect: str, kind: str, ends: tuple[np.ndarray, np.ndarray], axis: np.ndarray) -> str:
    """Return a closure between link5 and link9 in a dialect."""
    if dialect == "loop":
        return (
            f'<loop name="l" type="{kind}"><predecessor link="link5">{origin(ends[0])}</predecessor>'
            f'<successor link="link9">{origin(ends[1])}</successor><axis xyz="{words(axis)}"/></loop>'
        )
    if dialect == "constraint":
        turn = matrix(
            (0, 0, 0), (0.4, -0.7, 1.1) if kind == "revolute" else (0, 0, 0)
        )  # each end has its own axis
        ends, turned = (ends[0], ends[1] @ turn.T), turn[:3, :3] @ axis
        return (
            f'<constraint name="l" type="{"LINK" if kind == "fixed" else kind}"><parent link="link5"/>'
            f'{origin(ends[0], "parent_origin")}<parent_axis xyz="{words(axis)}"/><child link="link9"/>'
            f'{origin(ends[1], "child_origin")}<child_axis xyz="{words(turned)}"/></constraint>'
        )
    joined = (origin(T, f'link{n} link="link{k}"') for n, k, T in zip((1, 2), (5, 9), ends))
    return f'<loop_joint name="l" type="{kind}">{"".join(joined)}</loop_joint>'


NEW_LINE = "\n"
CASES = [
    *(("loop", kind) for kind in ("revolute", "continuous", "prismatic", "planar", "fixed")),
    *(("constraint", kind) for kind in ("spherical", "revolute", "fixed")),
    ("loop_joint", "spherical"),
]


@pytest.mark.parametrize("dialect, kind", CASES)
def test_frames_are_those_of_the_dialect(tmp_path: Path, dialect: str, kind: str) -> None:
    """The loop is closed at a random pose, from which the scene starts a little away; it is closed along the motion."""
    rng = np.random.default_rng([len(dialect), len(kind)])
    bare, axis = tree(rng), rng.uniform(-1, 1, 3)
    q = {f"j{k}": float(x) for k, x in enumerate(rng.uniform(-1, 1, JOINTS), 1)}
    first = matrix(rng.uniform(-0.3, 0.3, 3), rng.uniform(-1, 1, 3))
    meeting = pose(f"<robot>{bare}</robot>", "link5", q) @ first
    second = np.linalg.inv(pose(f"<robot>{bare}</robot>", "link9", q)) @ meeting
    urdf = f'<robot name="r">{bare}{element(dialect, kind, (first, second), axis)}</robot>'
    result = simulate(loaded(tmp_path, urdf, {k: x + 1e-3 for k, x in q.items()}))
    assert np.abs(result["q"][-1] - result["q"][0]).max() > 1e-3
    for sample in result["q"]:
        at = {f"j{k}": float(x) for k, x in enumerate(sample, 1)}
        frames = pose(urdf, "link5", at) @ first, pose(urdf, "link9", at) @ second
        assert closing(kind, axis, *frames) < 1e-10


@pytest.mark.parametrize("tie", ["3d", "6D"])
def test_loops_of_the_extended_urdf(tmp_path: Path, tie: str) -> None:
    """A name is that of a link, or of the joint that moves it; fixed joints hold the frames."""
    rng = np.random.default_rng(7)
    bare = tree(rng)
    q = {f"j{k}": float(x) for k, x in enumerate(rng.uniform(-1, 1, JOINTS), 1)}
    first = matrix(rng.uniform(-0.3, 0.3, 3), rng.uniform(-1, 1, 3))
    meeting = pose(f"<robot>{bare}</robot>", "link5", q) @ first
    second = np.linalg.inv(pose(f"<robot>{bare}</robot>", "link9", q)) @ meeting
    frames = "".join(
        f'<link name="{name}"/><joint name="{name}_joint" type="fixed"><parent link="{link}"/>'
        f'<child link="{name}"/>{origin(T)}</joint>'
        for name, link, T in (("A/1", "link5", first), ("B/1", "link9", second))
    )
    urdf = f'<robot name="r">{bare}{frames}</robot>'
    beside = f"closed_loop: [[A/1, B/1_joint]]\ntype: ['{tie}']\nname_mot: [j1]\n"
    scene = loaded(tmp_path, urdf, {k: x + 1e-3 for k, x in q.items()}, beside)
    assert str(tmp_path / "robot.yaml") in scene.sources
    assert scene.actuated == ("j1",)
    assert [text.rpartition("robot.urdf: ")[2] for text in scene.notes[-2:]] == [
        "1 loops from robot.yaml beside it",
        "joints with motors: j1",
    ]
    for sample in simulate(scene)["q"]:
        at = {f"j{k}": float(x) for k, x in enumerate(sample, 1)}
        ends = (
            pose(f"<robot>{bare}</robot>", "link5", at) @ first,
            pose(f"<robot>{bare}</robot>", "link9", at) @ second,
        )
        assert closing({"3d": "spherical", "6d": "fixed"}[tie.lower()], np.ones(3), *ends) < 1e-10


def test_a_coupling_counts_all_joints_from_the_common_ancestor(tmp_path: Path) -> None:
    """ratio (q3 + q4 + q5) - (q6 + ... + q9) = 0 between branches; within one only what lies between."""
    bare = tree(np.random.default_rng(3))
    across = '<coupling name="k"><predecessor link="link5"/><successor link="link9"/><ratio value="2.5"/></coupling>'
    within = '<coupling name="m"><predecessor link="link5"/><successor link="link2"/></coupling>'
    found = loaded(tmp_path, f'<robot name="r">{bare}{across}{within}</robot>', {}).couplers
    ahead = {f"j{k}": 2.5 for k in range(1, 6)} | {f"j{k}": -1.0 for k in range(6, 10)}
    assert [dict(sorted(x.terms.items())) for x in found] == [ahead, {"j3": 1.0, "j4": 1.0, "j5": 1.0}]


def test_types_of_joints_beside(tmp_path: Path) -> None:
    """UJOINT_ZY turns about z, then about y of what z has turned; the joint's own axis does not count."""
    bare = tree(np.random.default_rng(5))
    beside = (
        "closed_loop: []\ntype: []\njoint_name: [j1, j2, j9]\njoint_type: [UJOINT_ZY, SPHERICAL, FIXED]\n"
    )
    scene = loaded(tmp_path, f'<robot name="r">{bare}</robot>', {}, beside)
    kinds = {joint.name: joint.type for joint in scene.robot.joints}
    assert (kinds["j1"], kinds["j2"], kinds["j9"], kinds["j3"]) == (
        "universal",
        "spherical",
        "fixed",
        "revolute",
    )
    first = next(joint for joint in scene.robot.joints if joint.name == "j1")
    assert (first.axis, first.axis2) == ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))


@pytest.mark.parametrize(
    "element, words",
    [
        ('<loop name="l" type="screw"/>', "unknown type 'screw'"),
        ('<loop name="l" type="revolute"><successor link="link9"/></loop>', "needs <predecessor link=...>"),
        ('<loop name="l" type="fixed"><predecessor link="lonk5"/><successor link="link9"/></loop>', "'lonk5' is no link"),
        ('<constraint name="c" type="position"><predecessor link="link5"/></constraint>', "a draft of URDF"),
        ('<coupling name="k"><predecessor link="link1"/><successor link="ground"/></coupling>', "relates 1 joint"),
        ('<loop_joint name="s" type="revolute"/>', "unknown type 'revolute'"),
        ('<loop_joint name="s" type="spherical"><link1 link="link5"/>\n<link1 link="link9"/></loop_joint>', "a second <link1> and no <link2>"),
        ('<loop name="l" type="fixed"><predecessor link="link5"/><successor link="link9"/>\n<limit lower="1"/></loop>',
         "<limit> in <loop> is not known; read: predecessor, successor, axis"),
        ('<loop name="l" type="fixed"><predecessor link="link5">\n<orign/></predecessor><successor link="link9"/></loop>',
         "<orign> in <predecessor> is not known (did you mean 'origin'?); read: origin"),
        ('<coupling name="k"><predecessor link="link5"/><successor link="link9"/>\n<offset value="1"/></coupling>',
         "<offset> in <coupling> is not known"),
        ('<constraint name="c" type="fixed"><parent link="link5"/><child link="link9"/>\n<stiffness/></constraint>',
         "<stiffness> in <constraint> is not known"),
        ('<loop_joint name="s" type="spherical"><link1 link="link5"/><link2 link="link9"/>\n<limit/></loop_joint>', "<limit> in"),
        ('<loop_joint name="s" type="spherical">\n<link1 link="link5" pos="1 0 0"/><link2 link="link9"/></loop_joint>',
         "'pos' of <link1> is not known; read: link, xyz, rpy"),
        ('<constraint name="c" type="fixed"><parent link="link5">\n<origin/></parent><child link="link9"/></constraint>',
         "<origin> in <parent> is not known; read: nothing"),
        ('<coupling name="k"><predecessor link="link5"/><successor link="link9"/>\n<ratio value="1" offset="2"/></coupling>',
         "'offset' of <ratio> is not known"),
        ('<Loop name="l"/>', "<Loop> in <robot> is not known (did you mean 'loop'?)"),
        ('<loop_closure name="l"/>', "<loop_closure> in <robot> is not read, and may act on the motion"),
        ('<group>\n<loop name="l"/></group>', "<loop> in <group> is not read, and may act"),
        ('<link name="more">\n<loop name="l"/></link>', "<loop> in <link> is not read, and may act"),
        ('<ball_constraint/>', "<ball_constraint> in <robot> is not known"),
        ('<gazebo><plugin name="p">\n<mimicJoint>a</mimicJoint></plugin></gazebo>', "<mimicJoint> in <plugin> is not read"),
    ],
)  # fmt: skip
def test_what_is_refused_is_named_with_its_line(tmp_path: Path, element: str, words: str) -> None:
    urdf = f'<robot name="r">{tree(np.random.default_rng(1))}\n{element}\n</robot>'
    with pytest.raises(SceneError, match=rf"robot\.urdf:{2 + element.count(NEW_LINE)}:1: ") as caught:
        loaded(tmp_path, urdf, {})
    assert words in str(caught.value)
    with pytest.raises(SceneError):
        load_description(tmp_path / "robot.urdf", {})


@pytest.mark.parametrize(
    "beside, words",
    [
        ("closed_loop: [[link5, link10]]\ntype: [3d]\n", "2: unknown link or joint 'link10'"),
        ("closed_loop: [[link5, link9]]\ntype: [4d]\n", "unknown type '4d'"),
        ("closed_loop: [[link5, link9]]\ntype: []\n", "has 0 entries; allowed: 1"),
        ("closed_loop: []\njoint_name: [j1]\njoint_type: [UJOINT_ZZ]\n", "is no type of a joint"),
        ("closed_loop: []\nloops: 3\n", "unknown key 'loops'"),
        (
            "closed_loops: [[link5, link9]]\ntype: [3d]\n",
            "unknown key 'closed_loops' (did you mean 'closed_loop'?)",
        ),
        (
            "Closed_loop: [[link5, link9]]\ntype: [3d]\n",
            "unknown key 'Closed_loop' (did you mean 'closed_loop'?)",
        ),
        (
            "closed_loop: []\nname_mot: [j1]\njoint_name: [j1]\njoint_type: [FIXED]\n",
            "'j1' is fixed; allowed: j2",
        ),
    ],
)
def test_what_is_refused_beside(tmp_path: Path, beside: str, words: str) -> None:
    urdf = f'<robot name="r">{tree(np.random.default_rng(1))}</robot>'
    with pytest.raises(SceneError, match=r"robot\.yaml:\d+:\d+: ") as caught:
        loaded(tmp_path, urdf, {}, beside)
    assert words.removeprefix("2: ") in str(caught.value)


def test_quaternions_have_their_real_part_last(tmp_path: Path) -> None:
    """In URDF 1.1: the same equations as with roll, pitch and yaw."""
    bare = tree(np.random.default_rng(8))

    def quaternion(match: re.Match[str]) -> str:
        turn = Rotation.from_euler("xyz", [float(x) for x in match[1].split()])
        return f'quat_xyzw="{words(turn.as_quat())}"'

    q, v = np.random.default_rng(9).uniform(-1, 1, (2, JOINTS))
    one, other = (
        Equations.of(loaded(tmp_path, f'<robot name="r" version="1.1">{text}</robot>', {}), q, v)
        for text in (bare, re.sub('rpy="([^"]*)"', quaternion, bare))
    )
    assert np.abs(one.M - other.M).max() < 1e-13 * np.abs(one.M).max()
    assert np.abs(one.h - other.h).max() < 1e-13 * np.abs(one.h).max()
    for version in ("2.0", "", "1.x"):
        with pytest.raises(SceneError, match=r"robot\.urdf:1:1: version '.*' of URDF; allowed: 1\.0 and"):
            loaded(tmp_path, f'<robot name="r" version="{version}">{bare}</robot>', {})


@pytest.mark.parametrize("pitch", [0.3, math.pi / 2, -math.pi / 2, math.pi / 2 - 1e-9])
def test_roll_pitch_yaw_of_a_rotation(pitch: float) -> None:
    R = Rotation.from_euler("xyz", [0.4, pitch, -1.1]).as_matrix()
    back = Rotation.from_euler("xyz", rpy_of(R.tolist())).as_matrix()
    assert np.abs(back - R).max() < 1e-15 * 8
