"""Robots put together: payloads, tools, further joints, whole robots with prefixes; and lists that --set appends to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import InverseDynamics
from robodyn_cli.errors import SceneError
from robodyn_cli.scene.load import examine, load_scene, load_scene_text
from robodyn_cli.scene.types import Scene
from tests.unit.test_urdf import ARM as URDF

DH = """\
convention: standard
joints:
  - {name: q1, type: revolute, a: 0.5, alpha: 90 deg, d: 0.1}
  - {name: q2, type: revolute, a: 0.4, alpha: 0, d: 0}
links:
  - {name: upper, mass: 3, com: [-0.2, 0, 0.01], com_frame: link, inertia: {xx: 0.01, yy: 0.06, zz: 0.06}}
  - {name: fore, mass: 2, com: [-0.2, 0.02, 0], com_frame: link, inertia: {xx: 0.01, yy: 0.03, zz: 0.03}}
points: {tip: {link: fore, at: end}, door: {link: base, at: [1, 0, 0]}}
"""
TWO = """\
base: {xyz: [0, 0, 0.2], rpy: [0.3, 0, 0]}
joints:
  - {name: open, type: prismatic, axis: [0, 1, 0]}
  - {name: shut, type: prismatic, parent: base, axis: [0, -1, 0]}
links:
  - {name: left, mass: 0.1, com: [0, 0, 0.02]}
  - {name: right, mass: 0.1, com: [0, 0, 0.02]}
couplers: [{name: both, terms: {open: 1, shut: -1}}]
frames: {pad: {link: left, rpy: [0, 0, 1]}, plate: {link: base}}
"""
PAYLOAD = "{link: box, to: fore, origin: {xyz: [0.1, 0, 0.02], rpy: [0.2, 0, 0.4]}, mass: 1.5, com: [0, 0.01, 0], inertia: {xx: 0.02, yy: 0.03, zz: 0.04}}"


def scene(tmp_path: Path, robot: str, overrides: tuple[str, ...] = (), more: str = "") -> Scene:
    files = {"arm.yaml": DH, "hand.yaml": TWO, "arm.urdf": URDF}
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    path = tmp_path / "scene.yaml"
    path.write_text(f"schema: 1\ngravity: [0.5, -1, -9.81]\nrobot: {robot}\n{more}", encoding="utf-8")
    return load_scene(path, list(overrides))


def torques(of: Scene) -> np.ndarray:
    rng = np.random.default_rng(1)
    dynamics = InverseDynamics(of)
    n = len(dynamics.joints)
    return dynamics(*rng.normal(size=(3, 4, n)))


def test_a_payload_is_a_link_on_a_fixed_joint(tmp_path: Path) -> None:
    attached = scene(tmp_path, f"{{include: arm.yaml, attach: [{PAYLOAD}]}}")
    by_hand = DH.replace(
        "links:",
        "  - {name: box_joint, type: fixed, parent: fore, link: box, origin: {xyz: [0.1, 0, 0.02], rpy: [0.2, 0, 0.4]}}\nlinks:",
    ).replace(
        "points:",
        "  - {name: box, mass: 1.5, com: [0, 0.01, 0], inertia: {xx: 0.02, yy: 0.03, zz: 0.04}}\npoints:",
    )
    assert (
        attached.robot
        == load_scene_text("schema: 1\ngravity: [0, 0, 0]\nrobot:\n  " + by_hand.replace("\n", "\n  ")).robot
    )
    assert np.abs(torques(attached) - torques(scene(tmp_path, "arm.yaml"))).max() > 1.0
    # the text that results carry holds the whole
    assert load_scene_text(attached.text).robot == attached.robot and "attach" not in attached.text


def test_a_joint_on_an_included_robot(tmp_path: Path) -> None:
    more = "{link: wheel, to: fore, mass: 0.3, com: [0, 0, 0], inertia: {xx: 1e-3, yy: 1e-3, zz: 2e-3}, joint: {name: spin, type: revolute, axis: [0, 0, 1], origin: {xyz: [0, 0, 0.1]}, friction: {viscous: 0.1}}}"
    found = scene(
        tmp_path,
        f"{{include: arm.yaml, attach: [{more}, {{link: cap, to: wheel, mass: 0.1, com: [0.1, 0, 0], inertia: {{xx: 1e-4, yy: 1e-4, zz: 1e-4}}}}]}}",
    )
    assert [(j.name, j.parent, j.link) for j in found.robot.joints[2:]] == [
        ("spin", "fore", "wheel"),
        ("cap_joint", "wheel", "cap"),
    ]
    assert len(torques(found)[0]) == 3


def test_formulas_know_attached_joints(tmp_path: Path) -> None:
    more = "{link: wheel, to: fore, joint: {name: spin, type: revolute, axis: [0, 0, 1]}}"
    found = scene(tmp_path, f"{{include: arm.yaml, attach: [{more}]}}", more='torques: {q1: "-2*qd.spin"}\n')
    assert found.torques["q1"].names == {"qd.spin"}


def test_two_robots_with_prefixes(tmp_path: Path) -> None:
    """Side by side they move as each of them alone; the same robot in two orders of files."""
    pair = "{include: arm.yaml, prefix: left_, attach: [{include: arm.yaml, prefix: right_, origin: {xyz: [0, 1, 0]}}]}"
    both = scene(tmp_path, pair)
    assert [j.name for j in both.robot.joints] == [
        "left_q1",
        "left_q2",
        "right_mount_joint",
        "right_q1",
        "right_q2",
    ]
    assert set(both.robot.points) == {"left_tip", "left_door", "right_tip", "right_door"}
    assert (
        both.robot.points["right_door"].link == "right_mount"
        and both.robot.points["left_door"].link == "base"
    )
    dynamics, one = InverseDynamics(both), InverseDynamics(scene(tmp_path, "arm.yaml"))
    q, v, a = np.random.default_rng(2).normal(size=(3, 5, 4))
    alone = np.hstack([one(q[:, k], v[:, k], a[:, k]) for k in (slice(0, 2), slice(2, 4))])
    assert np.abs(dynamics(q, v, a) - alone).max() < 1e-12


def test_a_hand_on_an_arm_from_a_urdf(tmp_path: Path) -> None:
    """Its base becomes a frame on the arm, its couplers and places come along."""
    robot = "{include: arm.urdf, attach: [{include: hand.yaml, prefix: h_, to: lower, origin: {xyz: [0.3, 0, 0]}}]}"
    found = scene(tmp_path, robot)
    parents = {j.name: (j.parent, j.link) for j in found.robot.joints}
    assert parents["h_mount_joint"] == ("lower", "h_mount") and parents["h_base_frame_joint"] == (
        "h_mount",
        "h_base_frame",
    )
    assert parents["h_open"] == ("h_base_frame", "h_left") and parents["h_shut"] == (
        "h_base_frame",
        "h_right",
    )
    frame = next(j for j in found.robot.joints if j.name == "h_base_frame_joint").origin
    assert frame is not None and frame.xyz == (0, 0, 0.2) and frame.rpy == (0.3, 0, 0)
    assert found.robot.base.xyz == (0, 0, 0)
    assert [(c.name, c.terms) for c in found.couplers] == [("h_both", {"h_open": 1, "h_shut": -1})]
    assert (
        found.robot.frames["h_plate"].link == "h_base_frame" and found.robot.frames["h_pad"].link == "h_left"
    )
    assert found.notes  # those of the URDF


def test_a_urdf_on_a_robot_and_attachments_of_attachments(tmp_path: Path) -> None:
    (tmp_path / "tool.yaml").write_text(
        "include: arm.urdf\nattach: [{link: pen, to: lower, mass: 0.1, com: [0, 0, 0.1], inertia: {xx: 1e-4, yy: 1e-4, zz: 1e-4}}]\n"
    )
    robot = "{include: arm.yaml, attach: [{include: tool.yaml, prefix: a_, to: fore}, {include: arm.urdf, prefix: b_, to: a_pen}]}"
    found = scene(tmp_path, robot)
    names = [link.name for link in found.robot.links]
    assert names == [
        "upper",
        "fore",
        "a_mount",
        "a_base_2",
        "a_upper",
        "a_lower",
        "a_pen",
        "b_mount",
        "b_base_2",
        "b_upper",
        "b_lower",
    ]
    assert len(torques(found)[0]) == 6


def test_set_appends(tmp_path: Path) -> None:
    given = scene(tmp_path, f"{{include: arm.yaml, attach: [{PAYLOAD}]}}")
    assert scene(tmp_path, "arm.yaml", (f"robot.attach+={PAYLOAD}",)).robot == given.robot
    heavier = scene(tmp_path, f"{{include: arm.yaml, attach: [{PAYLOAD}]}}", ("robot.links.box.mass=3",))
    assert heavier.robot.links[2].mass == 3
    both = (
        "robot.links+={name: x, mass: 1}",
        "robot.joints+={name: jx, type: fixed, parent: upper, link: x}",
    )
    assert [link.name for link in scene(tmp_path, "arm.yaml", both).robot.links] == ["upper", "fore", "x"]
    loops = (
        "loops+={name: a, type: distance, between: [tip, door], length: 1}",
        "loops+={name: b, type: spherical, between: [tip, door]}",
    )
    assert [loop.name for loop in scene(tmp_path, "arm.yaml", loops).loops] == ["a", "b"]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (
            "title+=x",
            "title: is '', so nothing can be appended|title: .*nothing can be appended; allowed: a list",
        ),
        ("robot.joints.q1+={a: 1}", "robot.joints.0: is a map, so nothing can be appended"),
        ("robot.joints.q1.a+=1", "nothing can be appended"),
        ("nonsense+=1", "nothing can be appended"),
        ("robot.joints+=3", "is not a map"),
        ("robot.joints+=", "has no value"),
    ],
)
def test_what_cannot_be_appended(override: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=words):
        scene(tmp_path, "arm.yaml", (override,), "title: ''\n")


@pytest.mark.parametrize(
    ("item", "words"),
    [
        ("{to: fore}", "either 'link', a new link, or 'include', a robot"),
        ("{link: a, include: hand.yaml}", "either 'link', a new link, or 'include'"),
        ("3", "either 'link'"),
        ("{link: a, to: foer, mass: 1}", "robot.attach.0.to: unknown link 'foer' .did you mean 'fore'"),
        ("{link: a, mas: 1}", "unknown key 'mas' beside 'link' .did you mean 'mass'"),
        (
            "{include: hand.yaml, mass: 1}",
            "unknown key 'mass' beside 'include'; allowed: include, prefix, to, origin",
        ),
        ("{link: fore, mass: 1}", "has a link 'fore' already; choose another name"),
        ("{include: arm.yaml}", "points.tip: appears twice; give the attached robot a 'prefix'"),
        ("{include: none.yaml}", "there is no such file"),
        ("{include: scene.yaml}", "includes form a cycle"),
        ("{include: hand.yaml, prefix: 3}", "prefix: 3 cannot begin a name"),
        ("{include: hand.yaml, prefix: 3_}", "prefix: '3_' cannot begin a name"),
        (
            "{link: a, joint: {name: j, type: revolute, axis: [0, 0, 1], parent: base}}",
            "parent: is not a key here",
        ),
        (
            "{link: a, origin: {}, joint: {name: j, type: revolute, axis: [0, 0, 1], origin: {}}}",
            "origin: is given beside the joint already",
        ),
        ("{link: a, joint: 3}", "must be a map"),
        ("{link: a, mass: -1}", "too small"),
        (
            "{include: modified.yaml, prefix: m_}",
            "modified D-H parameters, .*standard ones; allowed: one convention",
        ),
    ],
)
def test_what_cannot_be_attached(item: str, words: str, tmp_path: Path) -> None:
    """One error, at the line of the item."""
    (tmp_path / "modified.yaml").write_text(DH.replace("standard", "modified"))
    path = tmp_path / "scene.yaml"
    with pytest.raises(SceneError, match=words):
        scene(tmp_path, f"{{include: arm.yaml, attach: [{item}]}}")
    found = examine(path).errors
    assert len(found) == 1 and (found[0].details["line"] == 3 or found[0].details["file"] != str(path)), found


def test_the_list_itself(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="robot.attach: must be a list"):
        scene(tmp_path, "{include: arm.yaml, attach: {link: a}}")
    assert scene(tmp_path, "{include: arm.yaml, attach: }").robot == scene(tmp_path, "arm.yaml").robot


def test_loops_come_along_with_their_points(tmp_path: Path) -> None:
    """``base`` of the part is the frame that it stands on; the words of every link stay as they are."""
    part = TWO + (
        "points: {pad: {link: left, at: [0, 0.1, 0]}, post: {link: base, at: [0, 0.1, 0]}}\n"
        "loops:\n"
        "  - {name: rod, type: distance, between: [pad, right.com], length: 0.2}\n"
        "  - {name: stay, type: distance, between: [base.post, left.origin], length: 0.2}\n"
        "  - {name: bar, type: distance, between: [base.origin, pad], length: 0.2}\n"
    )
    (tmp_path / "part.yaml").write_text(part.replace("frames:", "# frames:"), encoding="utf-8")
    robot = "{include: arm.yaml, attach: [{include: part.yaml, prefix: h_, to: fore}]}"
    scene_ = scene(tmp_path, robot)
    assert [(x.name, x.between) for x in scene_.loops] == [
        ("h_rod", ("h_pad", "h_right.com")),
        ("h_stay", ("h_post", "h_left.origin")),
        ("h_bar", ("h_base_frame.origin", "h_pad")),
    ]
