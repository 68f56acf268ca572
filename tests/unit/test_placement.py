"""Each way to place a body leads to the pose of the textbook, and so to that of any other joint at the same pose."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robodyn_cli.algorithms.kinematics import poses, transforms
from robodyn_cli.model.build import build_model
from robodyn_cli.scene import load_scene_text
from tests.numeric import assert_close, real

Matrix = np.ndarray


def about(axis: int, angle: float) -> Matrix:
    """Return the homogeneous matrix of a rotation about x, y or z."""
    T = np.eye(4)
    i, k = (axis + 1) % 3, (axis + 2) % 3
    T[i, i] = T[k, k] = math.cos(angle)
    T[k, i] = math.sin(angle)
    T[i, k] = -T[k, i]
    return T


def along(x: float, y: float, z: float) -> Matrix:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def placement(xyz: Matrix, rpy: Matrix) -> Matrix:
    return along(*xyz) @ about(2, rpy[2]) @ about(1, rpy[1]) @ about(0, rpy[0])


def text(numbers: Matrix) -> str:
    return "[" + ", ".join(repr(float(x)) for x in numbers) + "]"


def rpy_of(T: Matrix) -> Matrix:
    return np.array(
        [
            math.atan2(T[2, 1], T[2, 2]),
            math.atan2(-T[2, 0], math.hypot(T[2, 1], T[2, 2])),
            math.atan2(T[1, 0], T[0, 0]),
        ]
    )


class Case:
    """A body beyond ``origin`` and D-H parameters, all at random."""

    def __init__(self, seed: int, convention: str) -> None:
        rng = np.random.default_rng(seed)
        self.convention = convention
        self.xyz, self.rpy, self.at = rng.normal(size=3), rng.uniform(-1.4, 1.4, 3), rng.normal(size=3)
        self.swing, self.a, self.alpha, self.d, self.theta = map(float, rng.uniform(-1.5, 1.5, 5))
        self.origin = placement(self.xyz, self.rpy)

    @property
    def link(self) -> Matrix:
        """The link frame in the parent's: Craig 2005, equation 3.6; Siciliano et al. 2009, equation 2.52."""
        turn, bend = about(2, self.theta) @ along(0, 0, self.d), along(self.a, 0, 0) @ about(0, self.alpha)
        return self.origin @ (turn @ bend if self.convention == "standard" else bend @ turn)

    def joint_frame(self, way: str) -> Matrix:
        """The frame at the joint: of Rz(theta) alone with standard D-H, but where d is the coordinate."""
        if self.convention == "modified" or "pose" in way:
            return self.link
        return self.origin @ about(2, self.theta) @ along(0, 0, self.d if "prismatic" in way else 0)

    def joint(self, way: str) -> tuple[str, list[float]]:
        """Return the joint as a scene has it, and its coordinates."""
        origin = f"origin: {{xyz: {text(self.xyz)}, rpy: {text(self.rpy)}}}"
        bend, theta, d = f"a: {self.a!r}, alpha: {self.alpha!r}", f"theta: {self.theta!r}", f"d: {self.d!r}"
        whole = self.link
        pose = f"origin: {{xyz: {text(whole[:3, 3])}, rpy: {text(rpy_of(whole))}}}"
        return {
            "fixed": (f"type: fixed, {origin}, {bend}, {theta}, {d}", []),
            "revolute": (f"type: revolute, {origin}, {bend}, {d}", [self.theta]),
            "revolute, offset": (f"type: revolute, {origin}, {bend}, {d}, offset: {self.theta!r}", [0.0]),
            "prismatic": (f"type: prismatic, {origin}, {bend}, {theta}", [self.d]),
            "prismatic, offset": (f"type: prismatic, {origin}, {bend}, {theta}, offset: {self.d!r}", [0.0]),
            "fixed, pose": (f"type: fixed, {pose}", []),
            "revolute, pose": (f"type: revolute, axis: [0.6, 0, 0.8], {pose}", [0.0]),
            "cylindrical, pose": (f"type: cylindrical, axis: [0, 1, 0], {pose}", [0.0, 0.0]),
            "universal, pose": (f"type: universal, {pose}", [0.0, 0.0]),
            "floating, pose": (f"type: floating, {pose}", [0.0] * 3 + [1.0] + [0.0] * 3),
        }[way]


WAYS = tuple(
    f"{kind}{more}"
    for kind, more in (
        ("fixed", ""), ("revolute", ""), ("revolute", ", offset"), ("prismatic", ""), ("prismatic", ", offset"),
        ("fixed", ", pose"), ("revolute", ", pose"), ("cylindrical", ", pose"), ("universal", ", pose"),
        ("floating", ", pose"),
    )
)  # fmt: skip


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("way", WAYS)
def test_every_way_to_place_a_body_gives_its_pose(way: str, convention: str) -> None:
    for seed in range(5):
        case = Case(seed, convention)
        joint, q = case.joint(way)
        scene = load_scene_text(f"""
schema: 1
gravity: [0, 0, 0]
robot:
  convention: {convention}
  joints: [{{name: swing, type: revolute, axis: [0, 0, 1]}}, {{name: j, {joint}}}]
  links: [{{name: rod}}, {{name: tip, com: {text(case.at)}, com_frame: joint}}]
  frames:
    joint: {{link: tip, at: {text(case.at)}, frame: joint}}
    link: {{link: tip, at: {text(case.at)}, frame: link}}
  points: {{centre: {{link: tip, at: com}}}}
""")
        model = build_model(scene)
        pose = poses(model, transforms(model, [case.swing, *q]))
        turned = about(2, case.swing)
        for name, expected in (("joint", case.joint_frame(way)), ("link", case.link)):
            frame = model.frames[name]
            wanted = turned @ expected @ along(*case.at)
            assert_close(real(pose[frame.body].point(frame.p)), wanted[:3, 3], 1e-12, 3.0)
            assert_close(real(pose[frame.body].R @ frame.R), wanted[:3, :3], 1e-12, 1.0)
        centre = model.points["centre"]
        at_joint = turned @ case.joint_frame(way) @ along(*case.at)
        assert_close(real(pose[centre.body].point(centre.p)), at_joint[:3, 3], 1e-12, 3.0)


def test_the_inertia_of_a_fixed_link_turns_with_theta() -> None:
    """A point mass 1 m along x of the second link, which is welded on at a right angle: 2 kg m^2 about the hinge."""
    model = build_model(
        load_scene_text("""
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: swing, type: revolute, a: 1, alpha: 0, d: 0}
    - {name: weld, type: fixed, theta: 90 deg, a: 1}
  links:
    - {name: rod, mass: 0, com: [0, 0, 0], com_frame: joint, inertia: {zz: 0}}
    - {name: tip, mass: 1, com: [1, 0, 0], com_frame: joint, inertia: {zz: 0}}
""")
    )
    assert math.isclose(float(model.bodies[0].inertia.I[2, 2]), 2.0, rel_tol=1e-15)
