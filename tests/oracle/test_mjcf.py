"""Robots read from MJCF against MuJoCo's own terms with hard constraints, every frame, reference and anchor off."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from tests.mjcf_robots import compared, inertial

EXACT = 1e-9  # the program closes loops to 1e-13, and the oracle's Jacobian has rates by differences

# two arms of a turned body each, whose joints are off, turned and count from elsewhere
ARMS = f"""
<body name="a" pos="0.1 0.2 0.3" quat="0.9 0.1 0.2 0.3">{inertial(1)}
  <joint name="a1" axis="0.2 0.1 1" pos="0.05 -0.02 0.04" ref="23"/>
  <site name="sa" pos="0.3 -0.1 0.2" euler="30 40 50"/>
  <body name="b" pos="0.4 0.1 -0.2" axisangle="1 2 3 70">{inertial(2)}
    <joint name="b1" type="ball" pos="0.03 0.02 -0.05"/>
    <body name="c" pos="0.2 -0.1 0.1" xyaxes="0.8 0.6 0 0 0.1 1">{inertial(3)}
      <joint name="c1" axis="0 1 0.3" pos="-0.04 0.05 0.06" ref="-17"/>
      <site name="sc" pos="0.2 0.1 -0.1" euler="10 0 70"/>
    </body>
  </body>
</body>
<body name="d" pos="-0.3 0.4 0.1" quat="0.4 -0.3 0.5 0.6">{inertial(4)}
  <joint name="d1" type="slide" axis="1 0.3 -0.2" ref="0.15"/>
  <joint name="d2" axis="0.1 1 0.4" pos="0.02 0.07 -0.03" ref="11"/>
  <site name="sd" pos="-0.2 0.15 0.1" quat="0.3 0.8 -0.2 0.4"/>
  <body name="e" pos="0.3 0.05 0.2" euler="-20 35 15">{inertial(5)}
    <joint name="e1" type="ball" pos="0.06 -0.02 0.01"/>
    <site name="se" pos="0.1 0.05 -0.1" zaxis="1 2 3"/>
  </body>
</body>
"""


def robot(tmp_path: Path, more: str = "", bodies: str = ARMS, settings: str = "") -> Path:
    path = tmp_path / "robot.xml"
    path.write_text(
        f'<mujoco model="m"><option gravity="0.4 -0.3 -9.81"/>{settings}<worldbody>{bodies}</worldbody>{more}</mujoco>'
    )
    return path


def agree(path: Path, tolerance: float = EXACT) -> None:
    own, peer = compared(path)
    assert len(own) == len(peer) and np.abs(own - peer).max() <= tolerance * np.abs(peer).max()


def test_chains_of_all_joints(tmp_path: Path) -> None:
    """Several joints in a body, each off, with ref; springs with springref, damping, armature; frames and a free body."""
    bodies = f"""
    <body name="free" pos="0.5 -0.2 0.7" quat="0.3 0.5 -0.6 0.2"><freejoint name="f"/>{inertial()}
      <frame pos="0.1 0.2 0.3" euler="10 20 30">
        <body name="x" pos="0.2 0.1 -0.1" euler="40 -20 10">{inertial(1)}
          <joint name="x1" type="slide" axis="1 1 0.2" pos="0.1 0.1 0.1" ref="0.2" stiffness="30" springref="0.05" damping="3"/>
          <joint name="x2" axis="0 1 0.5" pos="0.05 0.03 0.1" ref="20" stiffness="4" springref="-35" damping="0.3" armature="0.2"/>
          <joint name="x3" type="slide" axis="0 0.2 1" ref="-0.1" armature="0.7"/>
          <joint name="x4" axis="1 0.2 0" pos="-0.07 0.02 0.04" ref="-30"/>
        </body>
      </frame>
      <body name="y" pos="-0.2 0.3 0.1" quat="1 2 3 4">{inertial(2)}
        <joint name="y1" type="ball" pos="0.1 -0.05 0.02" stiffness="2.5" damping="0.2" armature="0.3"/>
      </body>
    </body>"""
    agree(robot(tmp_path, bodies=bodies))


def test_a_free_body_with_springs(tmp_path: Path) -> None:
    bodies = f"""<body name="free" pos="0.5 -0.2 0.7" quat="0.3 0.5 -0.6 0.2">
    <joint name="f" type="free" damping="0.4" stiffness="3"/>{inertial()}</body>"""
    agree(robot(tmp_path, bodies=bodies))


EQUALITIES = {
    "connect": '<connect name="t" body1="c" body2="e" anchor="0.1 0.15 -0.05"/>',
    "connect to the world": '<connect body1="e" anchor="0.1 0.05 -0.05"/>',
    "connect of sites": '<connect site1="sd" site2="sc"/>',
    "weld at qpos0": '<weld body1="c" body2="e" anchor="0.07 0.02 -0.03"/>',
    "weld by relpose": '<weld body1="c" body2="e" relpose="0.25 -0.3 0.35 0.8 0.2 0.4 -0.4" anchor="0.05 -0.02 0.09"/>',
    "weld of sites": '<weld site1="sa" site2="se"/>',
    "weld of points": '<weld body1="c" body2="e" relpose="0.2 -0.1 0.3 0.8 0.2 0.4 -0.4" anchor="0.05 -0.02 0.09" torquescale="0"/>',
    "weld with torquescale": '<weld body1="c" body2="e" relpose="0.2 -0.1 0.3 0.8 0.2 0.4 -0.4" torquescale="3"/>',
    "joint": '<joint joint1="c1" joint2="d2" polycoef="0.1 -1.7 0 0 0"/>',
    "joint held": '<joint joint1="a1" polycoef="0.2 5 0.3 0 0"/><joint joint1="c1" joint2="a1" polycoef="0.1 0.5 0 0 0"/>',
    "slide held": '<joint joint1="d1" polycoef="-0.1"/><tendon tendon1="t1" tendon2="t3"/>',
    "slide and hinge": '<joint joint1="d1" joint2="a1" polycoef="-0.05 0.3 0 0 0"/>',
    "tendons": '<tendon tendon1="t1" tendon2="t2" polycoef="0.1 0.7 0 0 0"/>',
    "tendon held": '<tendon tendon1="t1" polycoef="-0.2 9 9 0 0"/>',
    "two loops": '<connect body1="c" body2="d" anchor="0.2 0.2 0.1"/><joint joint1="a1" joint2="d2" polycoef="0 0.5 0 0 0"/>',
    "not active": '<weld body1="c" body2="d" active="false"/><joint joint1="c1" joint2="d2"/>',
}  # fmt: skip
TENDONS = """<tendon><fixed name="t1"><joint joint="a1" coef="2"/><joint joint="d2" coef="-0.6"/></fixed>
<fixed name="t2"><joint joint="c1" coef="1.5"/></fixed><fixed name="t3"><joint joint="d1" coef="2"/><joint joint="c1" coef="-1"/></fixed></tendon>"""


@pytest.mark.parametrize("name", EQUALITIES)
def test_equalities(tmp_path: Path, name: str) -> None:
    agree(robot(tmp_path, f"{TENDONS}<equality>{EQUALITIES[name]}</equality>"))


def test_a_keyframe_is_no_reference(tmp_path: Path) -> None:
    """Anchors are at qpos0, whatever a keyframe says, and without the second one the file's poses count."""
    tie = '<equality><connect body1="b" body2="d" anchor="0.1 0.15 -0.05"/></equality>'
    keys = '<keyframe><key qpos="0.5 1 0 0 0 0.3 0.2 0.1 1 0 0 0"/></keyframe>'
    agree(robot(tmp_path, tie + keys))


def test_inertia_of_geometry(tmp_path: Path) -> None:
    """Bodies without <inertial>: geoms, by density or mass, a mesh, those without mass; inertia balanced."""
    corners = ((0, 0, 0), (0.3, 0, 0), (0, 0.2, 0), (0, 0, 0.4))
    faces = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    rows = [struct.pack("<12fH", 0, 0, 1, *(x for k in face for x in corners[k]), 0) for face in faces]
    (tmp_path / "meshes").mkdir()
    for name in ("wedge", "none"):  # which one of them is without weight
        (tmp_path / f"meshes/{name}.stl").write_bytes(bytes(80) + struct.pack("<I", 4) + b"".join(rows))
    settings = """<compiler meshdir="meshes" balanceinertia="true" eulerseq="ZYX"/><asset><mesh name="w" file="wedge.stl"/>
    <mesh name="none" file="none.stl"/><material name="grey"/></asset>
    <default><default class="seen"><geom type="mesh" contype="0" conaffinity="0" mass="0" material="grey"/></default></default>"""
    bodies = """
    <geom type="plane" size="1 1 1"/>
    <body name="x" pos="0.1 0.2 0.3" euler="10 20 30"><joint name="x1" axis="0 1 1" pos="0 0.1 0"/>
      <geom type="box" size="0.1 0.05 0.2" pos="0.1 0 0" euler="20 0 40" density="900"/><geom type="capsule" size="0.03" fromto="0 0 0 0.2 0.1 0"/>
      <geom class="seen" mesh="none"/>
      <body name="y" pos="0.2 0 0.1"><joint name="y1" axis="1 0.3 0"/><geom type="mesh" mesh="w" pos="0.1 0.1 0" euler="0 30 0"/>
        <body name="z" pos="0.2 0 0.1"><joint name="z1" axis="0 1 0"/><inertial pos="0.1 0 0" mass="2" diaginertia="1 2 4"/>
          <geom type="mesh" mesh="none"/></body></body></body>"""
    agree(robot(tmp_path, bodies=bodies, settings=settings))


def test_includes_replicas_and_radians(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/tie.xml").write_text(
        '<mujocoinclude><equality><connect body1="r2" body2="d" anchor="0.1 0 0.1"/></equality></mujocoinclude>'
    )
    (tmp_path / "parts/body.xml").write_text(
        f"""<mujocoinclude><replicate count="3" offset="0.1 0.2 0" euler="0 0 0.4"><body name="r" pos="0.3 0 0">{inertial()}
        <joint name="q" axis="0 0.3 1" pos="0.01 0 0.02" ref="0.2"/><joint name="s" axis="1 0 0"/></body></replicate></mujocoinclude>"""
    )
    more, settings = '<include file="parts/tie.xml"/>', '<compiler angle="radian"/>'
    agree(robot(tmp_path, more, f'{ARMS}<include file="parts/body.xml"/>', settings))


FLAGS = ("spring", "damper", "gravity", "equality", "constraint")


@pytest.mark.parametrize("flag", FLAGS)
def test_what_is_switched_off(tmp_path: Path, flag: str) -> None:
    bodies = ARMS.replace('ref="11"', 'ref="11" stiffness="5" damping="2"')
    settings = f'<option gravity="0 0 -9"><flag {flag}="disable"/></option>'
    more = '<equality><joint joint1="c1" joint2="d2"/></equality>'
    own, peer = compared(robot(tmp_path, more, bodies, settings))
    assert (np.abs(own - peer).max() <= EXACT * np.abs(peer).max()) == (
        flag != "gravity"
    )  # the scene has its own
