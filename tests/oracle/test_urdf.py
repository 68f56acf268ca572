"""Robots read from URDF against Pinocchio's reading of the same file: dynamics, frames, friction, mimic joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.model.build import build_model
from tests.numeric import assert_close
from tests.urdf_robots import GRAVITY, Differences, compare, random_urdf, real, scene_of

pin = pytest.importorskip("pinocchio")

# a hundred roundings of chains of a dozen bodies; the accelerations have the condition of the mass matrix beside it
EXACT = 1e-13
SOLVED = 1e-9

ARM = """\
<robot name="arm">
  <link name="base"><inertial><mass value="4"/><inertia ixx="0.1" ixy="0.01" ixz="0.02" iyy="0.2" iyz="0" izz="0.2"/></inertial></link>
  <joint name="shoulder" type="continuous">
    <parent link="base"/><child link="upper arm"/>
    <origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/><axis xyz="0 0 -2"/>
    <dynamics damping="0.3"/>
  </joint>
  <link name="upper arm">
    <inertial>
      <origin xyz="0.1 0.02 -0.03" rpy="0.5 -0.4 1.3"/><mass value="2.5"/>
      <inertia ixx="0.03" ixy="0.002" ixz="-0.004" iyy="0.05" iyz="0.006" izz="0.04"/>
    </inertial>
  </link>
  <joint name="flange" type="fixed"><parent link="upper arm"/><child link="9-tool"/><origin rpy="1 2 3" xyz="0.4 0 0"/></joint>
  <link name="9-tool">
    <inertial>
      <origin xyz="0 0.05 0" quat_xyzw="0.5 0.5 0.5 0.5"/><mass value="0.7"/>
      <inertia ixx="0.001" ixy="0.0001" ixz="0" iyy="0.002" iyz="0.0002" izz="0.0025"/>
    </inertial>
  </link>
  <joint name="slide" type="prismatic">
    <parent link="9-tool"/><child link="finger"/><axis xyz="0.3 0.1 -5"/>
    <limit lower="0" upper="0.1" effort="20" velocity="0.2"/><dynamics damping="2" friction="0.5"/>
  </joint>
  <link name="finger"><inertial><mass value="0.2"/><inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
</robot>
"""


def within(found: Differences) -> None:
    assert max(found.torques, found.mass, found.frames, found.drag) < EXACT, found
    assert found.residual is not None and found.residual < EXACT, found
    assert found.acceleration is not None and found.acceleration < SOLVED, found


def test_an_arm_of_all_that_matters(tmp_path: Path) -> None:
    """A base called base, names that scenes do not allow, the two forms of an orientation, friction."""
    path = tmp_path / "arm.urdf"
    path.write_text(
        ARM.replace(' quat_xyzw="0.5 0.5 0.5 0.5"', ' rpy="1.5707963267948966 0 1.5707963267948966"')
    )
    within(compare(path))
    rpy = build_model(scene_of(path))
    path.write_text(ARM)  # Pinocchio knows no quaternions: rpy is the same rotation
    given = build_model(scene_of(path))
    assert_close(real(given.bodies[0].inertia.I), real(rpy.bodies[0].inertia.I), 1e-15)


@pytest.mark.parametrize("seed", range(12))
def test_random_robots(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    path = tmp_path / "random.urdf"
    path.write_text(random_urdf(rng, int(rng.integers(1, 16))))
    found = compare(path, seed)
    if found.joints:
        within(found)


@pytest.mark.parametrize("seed", range(4))
def test_random_robots_with_mimics(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng([7, seed])
    path = tmp_path / "random.urdf"
    path.write_text(random_urdf(rng, 8, mimic=True))
    found = compare(path, seed)
    within(found)
    assert found.mimics > 0 and found.coupled is not None and found.coupled < EXACT


def test_joints_held_by_mimics_of_what_does_not_move(tmp_path: Path) -> None:
    """A mimic of a fixed joint, and one of that mimic: both are constants, in Pinocchio joints that stay where they are."""
    text = random_urdf(np.random.default_rng([11, 0]), 9)
    for joint, kind in (("j1", "fixed"), ("j2", "prismatic"), ("j3", "revolute")):
        assert f'name="{joint}" type="{kind}"' in text
    for joint, leader in (("j2", "j1"), ("j3", "j2")):
        start = text.index("</joint>", text.index(f'name="{joint}"'))
        text = f'{text[:start]}<mimic joint="{leader}" multiplier="0.5" offset="0.4"/>{text[start:]}'
    path = tmp_path / "held.urdf"
    path.write_text(text)
    found = compare(path)
    within(found)
    assert not {"j2", "j3"} & set(build_model(scene_of(path)).joint_names) and found.mimics == 0


PLANAR = """\
<robot name="cart">
  <link name="floor"/>
  <joint name="drive" type="planar">
    <parent link="floor"/><child link="cart"/><origin xyz="0.1 0.2 0.3" rpy="0.3 -0.2 0.5"/><axis xyz="AXIS"/>
  </joint>
  <link name="cart">
    <inertial>
      <origin xyz="0.1 -0.2 0.05" rpy="0.3 0.2 0.1"/><mass value="3"/>
      <inertia ixx="0.3" ixy="0.02" ixz="0.01" iyy="0.4" iyz="-0.03" izz="0.5"/>
    </inertial>
  </link>
</robot>
"""


@pytest.mark.parametrize("axis", ["0 0 1", "0 3 0", "0.5 -1 2"])
def test_planar_joints_move_across_their_axis(axis: str, tmp_path: Path) -> None:
    """As two slides and a hinge in a row, with massless links between: Pinocchio's planar joint ignores the axis."""
    path = tmp_path / "cart.urdf"
    path.write_text(PLANAR.replace("AXIS", axis))
    model = build_model(scene_of(path))
    R = real(model.bodies[0].X_tree.E).T  # x, y and the axis in the frame of the floor
    joints = []
    hinge = pin.JointModelRevoluteUnaligned(R[:, 2])
    chain = pin.Model()
    place = pin.SE3(np.eye(3), np.array([0.1, 0.2, 0.3]))
    for column in (0, 1):
        joint = pin.JointModelPrismaticUnaligned(R[:, column])
        joints.append(chain.addJoint(joints[-1] if joints else 0, joint, place, f"slide{column}"))
        place = pin.SE3.Identity()
    last = chain.addJoint(joints[-1], hinge, place, "hinge")
    floor = pin.rpy.rpyToMatrix(0.3, -0.2, 0.5)
    turned = pin.rpy.rpyToMatrix(0.3, 0.2, 0.1)
    I = np.array([[0.3, 0.02, 0.01], [0.02, 0.4, -0.03], [0.01, -0.03, 0.5]])
    own = pin.Inertia(3.0, np.array([0.1, -0.2, 0.05]), turned @ I @ turned.T)
    chain.appendBodyToJoint(last, own, pin.SE3(floor, np.zeros(3)))
    chain.gravity.linear = np.array(GRAVITY)
    rng = np.random.default_rng(3)
    q, v, a = rng.normal(size=(3, 3))
    data = chain.createData()
    expected = pin.rnea(chain, data, q, v, a)
    assert_close(real(rnea(model, list(q), list(v), list(a), model.gravity)), expected, 1e-13)
    M = np.triu(pin.crba(chain, data, q))
    assert_close(real(crba(model, list(q))), M + np.triu(M, 1).T, 1e-13)
    cosine = np.abs(floor @ (axis_of(axis)) - R[:, 2]).max()
    assert cosine < 1e-15


def axis_of(text: str) -> np.ndarray:
    axis = np.array([float(x) for x in text.split()])
    return axis / np.linalg.norm(axis)
