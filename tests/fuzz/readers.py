"""Mutated files of every kind that the program reads, through the reader alone: thousands in a minute."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from robodyn_cli.results.hdf5 import read
from robodyn_cli.results.summary import read_summary
from robodyn_cli.scene.descriptions import load_description
from robodyn_cli.scene.load import load_scene
from tests.fuzz.mutate import Mutator, dump, spoil

ROOT = Path(__file__).resolve().parents[2]
Files = dict[str, bytes]
SHORT = 1500  # characters of scenes that are read: long ones take their time
CORNERS = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
FACES = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
DAE = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="metre" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array><technique_common>
<accessor source="#a" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2 0 1 3 0 2 3 1 2 3</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene>
</COLLADA>"""  # fmt: skip
PARTS = (
    b"name,type,mass,torque_constant,resistance,voltage,max_current,max_speed,rotor_inertia,peak,thermal.max_temperature\n"
    b"small,dc,0.02,0.0138,6.85,12,1.26,1000,5.5e-08,,125\n\n# a motor by its envelope\n"
    b"wide,envelope,1.1,,,,,,0.00045,0 14; 36 14; 60 4.5,\n"
)
MJCF = """<mujoco model="m">
<compiler angle="radian"/>
<option gravity="0 0 -9.81"/>
<worldbody>
<body name="crank" pos="0 0 1" quat="1 0.1 0 0">
<joint name="drive" axis="0 1 0" pos="0.1 0 0" ref="0.2" range="-1 1" damping="0.1" armature="0.01"/>
<inertial pos="0.1 0 0" mass="1" fullinertia="1 1 1 0.1 0 0"/>
<body name="rod" pos="1 0 0" euler="0.1 0 0">
<joint name="pin" type="ball"/>
<geom type="box" size="0.1 0.2 0.3" density="100"/>
<site name="tip" pos="0.1 0.2 0.3"/>
</body>
</body>
<replicate count="2" offset="1 0 0">
<body name="slider" pos="2 0 1">
<joint name="slide" type="slide" axis="1 0 0" stiffness="3" springref="0.1" frictionloss="0.1"/>
<geom size="0.1"/>
</body>
</replicate>
</worldbody>
<equality>
<connect body1="rod" body2="slider0" anchor="0.1 0 0"/>
<joint joint1="slide1" joint2="drive" polycoef="0.1 2 0 0 0"/>
</equality>
<actuator>
<motor joint="drive" gear="3" ctrlrange="-2 2"/>
</actuator>
</mujoco>
"""
SHAPE = '<visual><geometry><mesh filename="shape.{}" scale="1 1 1"/></geometry></visual>'


def _triangles() -> bytes:
    records = b"".join(
        struct.pack("<12fH", 0, 0, 1, *(x for k in face for x in CORNERS[k]), 0) for face in FACES
    )
    return b"solid".ljust(80, b"\0") + struct.pack("<I", len(FACES)) + records


def _stl_text() -> bytes:
    facets = "".join(
        "facet normal 0 0 1\nouter loop\n"
        + "".join("vertex {} {} {}\n".format(*CORNERS[k]) for k in face)
        + "endloop\nendfacet\n"
        for face in FACES
    )
    return f"solid x\n{facets}endsolid x\n".encode()


def _obj() -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + [f"f {a + 1} {b + 1}/1 {c + 1}" for a, b, c in FACES]
    return "\n".join(lines).encode()


MESHES: Mapping[str, tuple[Callable[[], bytes], ...]] = {
    "stl": (_triangles, _stl_text), "obj": (_obj,), "dae": (DAE.encode,)
}  # fmt: skip


# -- the cases ------------------------------------------------------------------------------------------------------
def _scene(rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> Files:
    tree = rng.choice(trees)
    text = rng.choice((mutator.text, lambda x: dump(mutator.scene(x)), lambda x: dump(mutator.within(x))))(
        tree
    )
    return {"scene.yaml": text.encode(errors="surrogatepass")}


def _bytes(rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> Files:
    return {"scene.yaml": spoil(dump(rng.choice(trees)).encode(), rng)}


def _table(rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> Files:
    rows = "\n".join(f"{0.1 * k},{0.01 * k * k},{0.02 * k}" for k in range(5))
    tree = {**rng.choice(trees), "trajectory": {"type": "table", "file": "table.csv"}}
    return {"table.csv": spoil(f"t,theta1,theta2\n{rows}\n".encode(), rng), "scene.yaml": dump(tree).encode()}


def _stored(rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> Files:
    folder = stored / rng.choice(sorted(p.name for p in stored.iterdir()))
    files = {name: (folder / name).read_bytes() for name in ("result.h5", "summary.json")}
    name = rng.choice(("result.h5", "result.h5", "summary.json"))
    return files | {name: spoil(files[name], rng)}


def _stored_table(rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> Files:
    tree = {**rng.choice(trees), "trajectory": {"type": "table", "file": "result.h5"}}
    return {**_stored(rng, mutator, trees, stored), "scene.yaml": dump(tree).encode()}


def _urdf(rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> Files:
    """Return a robot with tags, attributes and numbers changed, or with any bytes."""
    text = (ROOT / "configs/robots/lift_arm.urdf").read_text()
    return {"robot.urdf": spoil(text.encode(), rng) if rng.random() < 0.5 else _xml(text, rng)}


def _mjcf(rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> Files:
    """Return a robot as ``_urdf`` does; without the package mujoco all of them are refused."""
    return {"robot.xml": spoil(MJCF.encode(), rng) if rng.random() < 0.5 else _xml(MJCF, rng)}


def _xml(text: str, rng: random.Random) -> bytes:
    lines = text.splitlines()
    for _ in range(rng.choice((1, 1, 2, 4))):
        k = rng.randrange(len(lines))
        kind = rng.randrange(6)
        if kind == 0:
            del lines[k]
        elif kind == 1:
            lines.insert(rng.randrange(len(lines) + 1), lines[k])
        elif kind == 2:
            other = rng.randrange(len(lines))
            lines[k], lines[other] = lines[other], lines[k]
        elif '"' in lines[k]:
            parts = lines[k].split('"')
            value = rng.choice(
                (
                    "",
                    "nan",
                    "1e999",
                    "-1",
                    "0 0 0",
                    "0 0",
                    "x",
                    "1e308 0 0",
                    "revolute",
                    "arm",
                    "&lt;",
                    "9" * 99,
                )
            )
            parts[rng.randrange(len(parts) // 2) * 2 + 1] = value
            lines[k] = '"'.join(parts)
    return "\n".join(lines).encode()


def _mesh(rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> Files:
    kind = rng.choice(list(MESHES))
    text = (ROOT / "configs/robots/lift_arm.urdf").read_text()
    robot = text.replace('<link name="arm">', f'<link name="arm">{SHAPE.format(kind)}')
    shape = spoil(rng.choice(MESHES[kind])(), rng)
    tree = {"schema": 1, "gravity": [0, 0, -9.81], "robot": "robot.urdf"}
    return {f"shape.{kind}": shape, "robot.urdf": robot.encode(), "scene.yaml": dump(tree).encode()}


def _catalogue(rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> Files:
    tree = yaml.safe_load((ROOT / "configs/2r_drives.yaml").read_text())
    tree |= {"robot": str(ROOT / "configs/robots/planar_2r.yaml"), "catalogue": "parts.csv"}
    tree["drives"] = {"theta1": {"motor": "small"}, "theta2": {"motor": "wide"}}
    return {"parts.csv": spoil(PARTS, rng), "scene.yaml": dump(tree).encode()}


def _include(rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> Files:
    tree = rng.choice([t for t in trees if isinstance(t.get("robot"), dict)])
    robot = {"part.yaml": spoil(dump(tree["robot"]).encode(), rng)}
    return {**robot, "scene.yaml": dump({**tree, "robot": "part.yaml"}).encode()}


Maker = Callable[[random.Random, Mutator, list[Any], Path], Files]
# kinds of inputs by how often they are read: those that are short to read more often
MAKERS: Mapping[str, tuple[Maker, int]] = {
    "scene": (_scene, 40), "bytes": (_bytes, 20), "table": (_table, 8), "stored": (_stored, 3),
    "stored_table": (_stored_table, 2), "urdf": (_urdf, 12), "mjcf": (_mjcf, 12), "mesh": (_mesh, 4), "catalogue": (_catalogue, 3),
    "include": (_include, 8),
}  # fmt: skip


def make_reading(rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> tuple[str, Files]:
    """Return a kind of input, and files."""
    kind = rng.choices(list(MAKERS), [weight for _, weight in MAKERS.values()])[0]
    trees = [tree for tree in trees if len(str(tree)) < SHORT]
    return kind, make_files(kind, rng, mutator, trees, stored)


def make_files(kind: str, rng: random.Random, mutator: Mutator, trees: list[Any], stored: Path) -> Files:
    """Return the files of a kind of input."""
    return MAKERS[kind][0](rng, mutator, trees, stored)


def read_files(kind: str) -> None:
    """Read the files of a kind in the current folder.

    Raises
    ------
    RobodynError : they are wrong.
    """
    if kind in ("urdf", "mjcf"):
        load_description("robot.xml" if kind == "mjcf" else "robot.urdf")
    elif kind == "stored":
        read_summary("summary.json")
        read("result.h5")
    else:
        load_scene("scene.yaml")
