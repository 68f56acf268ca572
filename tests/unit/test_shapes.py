"""Shapes that links are drawn with: read, made small, stored with results, painted; the equations ignore them."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.report.drawing.build import make_drawing
from robodyn_cli.report.drawing.camera import View, along_axis, default_camera
from robodyn_cli.report.drawing.record import Drawing
from robodyn_cli.report.drawing.strokes import strokes
from robodyn_cli.report.movie.frames import Frames, plan_movie
from robodyn_cli.report.page.page import Shown, write_page
from robodyn_cli.results.hdf5 import read, write
from robodyn_cli.results.result import Result
from robodyn_cli.scene.descriptions import load_description
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.scene.mesh.files import (
    MOST_FACES,
    TRIANGLE,
    Mesh,
    MeshError,
    obj_text,
    read_obj,
    simplified,
    small_mesh,
)
from robodyn_cli.scene.mesh.surfaces import surface_of
from robodyn_cli.scene.robot_parts import Shape
from robodyn_cli.works.inverse import inverse

SCENE = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1], origin: {xyz: [0, 0, 0.3]}}
    - {name: b, type: revolute, axis: [0, 1, 0], origin: {xyz: [0.2, 0, 0]}}
  links:
    - name: lower
      mass: 1
      com: [0.1, 0, 0]
      inertia: {xx: 0.1, yy: 0.1, zz: 0.1, xy: 0, xz: 0, yz: 0}
      visual: [{mesh: ball.stl, scale: [0.001, 0.002, 0.003], origin: {xyz: [0.1, 0, 0], rpy: [0, 0, 90 deg]}}]
    - name: upper
      mass: 1
      com: [0.1, 0, 0]
      inertia: {xx: 0.1, yy: 0.1, zz: 0.1, xy: 0, xz: 0, yz: 0}
      visual:
        - {box: [0.2, 0.04, 0.06], origin: {xyz: [0.1, 0, 0]}}
        - {sphere: 0.05}
        - {cylinder: [0.03, 0.2], origin: {xyz: [0.2, 0, 0], z: [1, 0, 0], x: [0, 1, 0]}}
command: inverse
trajectory: {type: joint, duration: 1, q: {a: "sin(t)", b: "0.5*t"}}
inverse: {samples: 21}
"""


def ball(steps: int, radius: float = 50.0) -> Mesh:
    """Return a sphere of triangles with common corners, counterclockwise from outside."""
    surface = surface_of(Shape(sphere=radius))
    assert surface is not None
    box, unit = surface
    points = [tuple(p) for p in unit.places(box)]
    faces = [(f[0], a, b) for f in unit.faces for a, b in zip(f[1:], f[2:])]
    for _ in range(steps):  # every triangle becomes four, pushed out onto the sphere
        finer = []
        for a, b, c in faces:
            ab, bc, ca = (len(points) + k for k in range(3))
            for p, q in ((a, b), (b, c), (c, a)):
                middle = np.add(points[p], points[q]) / 2
                points.append(tuple(middle * radius / np.linalg.norm(middle)))
            finer += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = finer
    return Mesh(np.array(points), np.array(faces))


def stl_bytes(mesh: Mesh) -> bytes:
    rows = np.zeros(len(mesh.faces), TRIANGLE)
    rows["corners"] = mesh.points[mesh.faces]
    return b"solid by some programs too".ljust(80) + len(rows).to_bytes(4, "little") + rows.tobytes()


def stl_text(mesh: Mesh) -> str:
    lines = ["solid ball"]
    for face in mesh.points[mesh.faces].tolist():
        lines += ["facet normal 0 0 0", "outer loop", *(f"  vertex {x!r} {y!r} {z!r}" for x, y, z in face)]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid ball"])


def volume(mesh: Mesh) -> float:
    a, b, c = mesh.points[mesh.faces].transpose(1, 0, 2)
    return float(np.sum(a * np.cross(b, c))) / 6.0


@pytest.fixture
def result(tmp_path: Path) -> Result:
    """A result that was stored, and whose mesh was deleted since."""
    (tmp_path / "ball.stl").write_bytes(stl_bytes(ball(2)))
    (tmp_path / "scene.yaml").write_text(SCENE)
    scene = load_scene(tmp_path / "scene.yaml")
    assert str(tmp_path / "ball.stl") in scene.sources and not scene.notes
    write(inverse(scene), tmp_path / "result.h5")
    (tmp_path / "ball.stl").unlink()
    return read(tmp_path / "result.h5")


def viewed(drawing: Drawing, flat: bool = False) -> View:
    view = View(drawing, along_axis(1) if flat else default_camera(drawing))
    view.fit(400.0, 300.0)
    return view


# -- files ---------------------------------------------------------------------------------------------------
def test_formats_hold_the_same_mesh(tmp_path: Path) -> None:
    mesh = ball(0)
    for name, content in (
        ("a.stl", stl_bytes(mesh)),
        ("b.STL", stl_text(mesh).encode()),
        ("c.obj", obj_text(mesh).encode()),
        ("d.obj", obj_text(mesh).replace("\nf ", "\nvn 0 0 1\nf ").encode()),
    ):
        (tmp_path / name).write_bytes(content)
        found = read_obj(small_mesh(str(tmp_path / name)))
        assert volume(found) == pytest.approx(volume(simplified(mesh, MOST_FACES)), rel=1e-3), name
    quads = read_obj("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4/1 -3//2 -2/1/1 -1\n")
    assert quads.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.001"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="{count}">{points}</float_array><technique_common>
<accessor source="#a" count="{corners}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="{faces}"><input semantic="VERTEX" source="#v" offset="0"/><vcount>{sizes}</vcount><p>{numbers}</p></polylist>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node>
<translate>10 0 0</translate><rotate>0 0 1 90</rotate><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def test_collada_is_read_in_its_unit_with_its_nodes_placed(tmp_path: Path) -> None:
    """A box of 20 x 40 x 60 mm by faces of four corners, turned by its node about z and moved by 10 mm."""
    pytest.importorskip("collada")
    corners = [(x, y, z) for x in (0, 20) for y in (0, 40) for z in (0, 60)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    text = DAE.format(
        count=24, corners=8, faces=6, sizes=" ".join("4" * 6),
        points=" ".join(str(x) for corner in corners for x in corner),
        numbers=" ".join(str(k) for face in faces for k in face),
    )  # fmt: skip
    (tmp_path / "box.dae").write_text(text)
    found = read_obj(small_mesh(str(tmp_path / "box.dae")))
    assert abs(volume(found)) == pytest.approx(0.02 * 0.04 * 0.06, rel=1e-3)
    assert found.points.min(axis=0) == pytest.approx([0.01 - 0.04, 0, 0], abs=1e-5)
    assert found.points.max(axis=0) == pytest.approx([0.01, 0.02, 0.06], abs=1e-5)


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robodyn_cli.scene.mesh.files.PACKAGE", "no_such_package")
    (tmp_path / "box.dae").write_text("<COLLADA/>")
    with pytest.raises(MeshError, match="pip install 'robodyn.collada.'"):
        small_mesh(str(tmp_path / "box.dae"))


def test_a_small_mesh_is_closed_and_like_the_large_one() -> None:
    mesh = ball(3)
    found = simplified(
        Mesh(mesh.points[mesh.faces].reshape(-1, 3), np.arange(mesh.faces.size).reshape(-1, 3)), MOST_FACES
    )
    assert len(mesh.faces) > 20_000 and 100 <= len(found.faces) <= MOST_FACES
    assert volume(found) == pytest.approx(4 / 3 * math.pi * 50.0**3, rel=0.15)
    made = surface_of(Shape(obj=obj_text(found)))
    assert made is not None and made[1].closed
    inside_out = surface_of(Shape(obj=obj_text(Mesh(found.points, found.faces[:, ::-1]))))
    assert inside_out is not None and inside_out[1].faces == made[1].faces, "turned outwards"
    opened = surface_of(Shape(obj=obj_text(Mesh(found.points, found.faces[:-1]))))
    assert opened is not None and not opened[1].closed


@pytest.mark.parametrize(
    "name, content, words",
    [
        ("a.stl", b"solid", "no STL: 5 bytes"),
        ("a.stl", stl_bytes(ball(0))[:-7], "cut off"),
        ("a.stl", b"version https://git-lfs.github.com/spec/v1\n" * 4, "cut off"),
        ("a.stl", b"solid x\nfacet\nvertex 1 2\n", "line 3: a vertex needs three numbers"),
        ("a.stl", b"solid x\nfacet\nvertex 1 2 3\n", "cut off"),
        ("a.stl", b"\0" * 84, "no triangles"),
        ("a.stl", stl_bytes(Mesh(np.full((3, 3), np.inf), np.array([[0, 1, 2]]))), "not finite"),
        ("a.obj", b"v 1 2 inf\n", "line 1: a corner is not finite"),
        ("a.obj", b"v 1e308 0 0\nv -1e308 0 0\nv 0 1 0\nf 1 2 3\n", "too far from another one"),
        ("a.obj", b"v 1 2\n", "line 1: 'v' needs three numbers"),
        ("a.obj", b"v 1 2 3\nf 1 2 0\n", "line 2: '0' is no number of a corner"),
        ("a.obj", b"v 1 2 3\nf 1 1\n", "line 2: a face needs three corners"),
        ("a.obj", b"v 1 2 3\nf 1 2 3\n", "corner 3 of 1"),
        ("a.ply", b"ply", "allowed: .stl, .obj, .dae"),
        ("a.dae", b"<COLLADA", "no COLLADA that pycollada reads"),
        ("a.dae", b'<!DOCTYPE x [<!ENTITY y "z">]><COLLADA/>', "a document type"),
        ("none.stl", None, "No such file"),
    ],
)
def test_a_file_that_cannot_be_drawn_is_told_and_left_out(
    name: str, content: bytes | None, words: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshError, match=words.replace(".", "[.]").replace("(", "[(]")):
        small_mesh(str(tmp_path / name))
    text = SCENE.replace("ball.stl", name)
    scene = load_scene_text(text, str(tmp_path / "scene.yaml"))
    assert len(scene.notes) == 1 and words in scene.notes[0] and name in scene.notes[0]
    drawing = make_drawing(inverse(scene))
    assert drawing.shaped == {"upper"}, "the other link is drawn as if it had no shape"


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("sphere: 0.05", "sphere: 0", "robot.links.1.visual.1.sphere"),
        ("sphere: 0.05", "sphere: 0.05, box: [1, 1, 1]", "'box' and 'sphere'; allowed: one of box, sphere"),
        ("{sphere: 0.05}", "{scale: [1, 1, 1]}", "allowed: one of box, sphere"),
        ("sphere: 0.05", "outline: [[0, 0], [1, 0]]", "at least 3"),
        ("sphere: 0.05", "outline: [[0, 0], [1, 1], [2, 2]]", "encloses no area"),
        ("sphere: 0.05", "outline: [[0, 0], [1, 1], [1, 0], [0, 1.2]]", "sides 0 and 2 cross"),
        ("sphere: 0.05", "sphere: 0.05, thickness: 1", "visual.1.thickness"),
        ("box: [0.2,", "box: [-0.2,", "not positive (value -0.2)"),
        ("sphere: 0.05", 'obj: "v 1 2"', "this is no mesh: line 1"),
        ("x: [0, 1, 0]}", "x: [1, 0, 0]}", "visual.2.origin"),
        ("mesh: ball.stl", "mesh: [1]", "STL, OBJ or DAE"),
    ],
)
def test_wrong_shapes_name_their_place(old: str, new: str, words: str) -> None:
    assert old in SCENE
    with pytest.raises(SceneError) as caught:
        load_scene_text(SCENE.replace(old, new))
    assert words in str(caught.value)


# -- drawings ------------------------------------------------------------------------------------------------
def test_a_stored_result_draws_the_mesh_where_the_link_is(result: Result) -> None:
    drawing = make_drawing(result)
    assert drawing.shaped == {"lower", "upper"}
    part = next(part for part in drawing.parts if part.kind == "shape" and part.name == "lower")
    assert part.surface is not None and len(part.surface.faces) <= MOST_FACES
    for k in (0, 20):
        a = result["q"][k, 0]
        turned = np.array([[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0, 0, 1]])
        centre = turned @ [0.1, 0.0, 0.0] + [0.0, 0.0, 0.3]
        # the mesh's x is y of the link
        local = (part.surface.places(drawing.vertices[k, list(part.vertices)]) - centre) @ turned
        assert np.abs(local).max(axis=0) == pytest.approx([0.1, 0.05, 0.15], rel=0.1)
        assert (np.linalg.norm(local / [0.1, 0.05, 0.15], axis=1) <= 1.001).all()


def test_bodies_are_painted_in_their_order(result: Result) -> None:
    drawing = make_drawing(result)
    without = make_drawing(
        inverse(
            load_scene_text(SCENE.replace("visual:", "visual: [] #").replace("        - {", "        # {"))
        )
    )
    assert not without.shaped and {part.name for part in without.links} == drawing.shaped
    view = viewed(drawing)
    found = [stroke for stroke in strokes(view, 3) if stroke.closed and stroke.layer == 4]
    assert len(found) > 100
    assert all(a.depth <= b.depth for a, b in zip(found, found[1:]))
    flat = [
        stroke for stroke in strokes(viewed(drawing, flat=True), 3) if stroke.closed and stroke.layer == 4
    ]
    assert 4 <= len(flat) < 20, "one outline for each shape"
    for part in drawing.parts:
        if part.kind == "shape":
            corners = view.corners[3, list(part.vertices), :2]
            assert np.isfinite(corners).all() and (corners >= view.low).all() and (corners <= view.high).all()


@pytest.mark.parametrize("shape", [Shape(box=(1.0, 2.0, 3.0)), Shape(sphere=0.7), Shape(cylinder=(0.5, 2.0))])
def test_faces_look_outwards(shape: Shape) -> None:
    made = surface_of(shape)
    assert made is not None
    box, surface = made
    points = surface.places(box)
    for face in surface.faces:
        a, b, c = points[list(face[:3])]
        assert np.cross(b - a, c - a) @ (points[list(face)].mean(axis=0)) > 0.0
    exact = {"box": 6.0, "sphere": 4 / 3 * math.pi * 0.7**3, "cylinder": math.pi * 0.5}
    fans = np.array([(f[0], a, b) for f in surface.faces for a, b in zip(f[1:], f[2:])])
    kind = next(k for k in exact if getattr(shape, k) is not None)
    assert volume(Mesh(points, fans)) == pytest.approx(exact[kind], rel=1e-12 if kind == "box" else 0.06)


HOOK = ((0.0, 0.0), (0.3, 0.0), (0.3, 0.2), (0.25, 0.2), (0.25, 0.05), (0.0, 0.05))


@pytest.mark.parametrize("corners", [HOOK, HOOK[::-1], (*HOOK[4:], *HOOK[:4])])
def test_a_plate_has_its_outline(corners: tuple[tuple[float, float], ...]) -> None:
    """Faces look outwards however the corners go round, and each tells its plane by its first corners."""
    made = surface_of(Shape(outline=corners, thickness=0.02))
    assert made is not None
    box, surface = made
    points = surface.places(box)
    area = 0.3 * 0.05 + 0.05 * 0.15
    normals = {round(float(np.ptp(points[list(f)], axis=0)[2]), 9): 0 for f in surface.faces}
    assert set(normals) == {0.0, 0.02} and len(surface.faces) == 8
    top, bottom = (points[list(surface.faces[k])] for k in (0, 1))
    for face, up in ((top, 1.0), (bottom, -1.0)):
        assert np.cross(face[1] - face[0], face[2] - face[0])[2] * up > 0.0
        x, y = face[:, 0], face[:, 1]
        assert 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)) == pytest.approx(up * area, rel=1e-12)
    fans = np.array([(f[0], a, b) for f in surface.faces for a, b in zip(f[1:], f[2:])])
    assert volume(Mesh(points, fans)) == pytest.approx(0.02 * area, rel=1e-9)


def test_a_flat_view_shows_the_outline_and_not_its_hull() -> None:
    text = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{name: a, type: revolute, axis: [0, 0, 1]}]
  links: [{name: hook, mass: 1, com: [0.1, 0, 0], inertia: {zz: 0.1}, visual: [{outline: HOOK}]}]
command: inverse
trajectory: {type: joint, duration: 1, q: {a: "t"}}
inverse: {samples: 5}
""".replace("HOOK", str([list(x) for x in HOOK]))
    drawing = make_drawing(inverse(load_scene_text(text)))
    view = View(drawing, along_axis(2))
    view.fit(400.0, 300.0)
    found = [x for x in strokes(view, 0) if x.closed and x.fill is not None and len(x.points) == len(HOOK)]
    assert len(found) == 1
    x, y = found[0].points.T
    size = float(np.ptp(x))
    area = abs(0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    assert area / size**2 == pytest.approx((0.3 * 0.05 + 0.05 * 0.15) / 0.3**2, rel=1e-6)


def test_shapes_change_no_number(result: Result) -> None:
    plain = inverse(load_scene_text(SCENE.replace("visual: [{mesh: ball.stl", "visual: [{mesh: none.stl")))
    assert (plain["tau"] == result["tau"]).all()


def test_movie_and_page(result: Result, tmp_path: Path) -> None:
    frames = Frames(result, plan_movie(result, 1.0, 10.0, hundredths=False))
    first, last = frames.picture(0).copy(), frames.picture(len(frames) - 1)
    assert (first != last).any()
    size = write_page([Shown("inverse", result)], tmp_path / "page.html")
    assert size < 400_000


# -- URDF ----------------------------------------------------------------------------------------------------
URDF = """<robot name="arm">
<link name="lower"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
 <visual><origin xyz="0 0 0.1" rpy="0 0 1"/><geometry><mesh filename="package://arm/ball.ply"/></geometry></visual>
 <collision><geometry><mesh filename="package://arm/ball.stl" scale="0.001 0.001 0.001"/></geometry></collision></link>
<link name="upper"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
 <visual><geometry><cylinder radius="0.1" length="0.5"/></geometry></visual>
 <visual><geometry><box size="1 2"/></geometry></visual>
 <visual><geometry><sphere radius="0.2"/></geometry></visual></link>
<joint name="a" type="continuous"><parent link="lower"/><child link="upper"/><axis xyz="0 0 1"/></joint>
</robot>"""


def test_shapes_of_a_urdf(tmp_path: Path) -> None:
    """What is not read falls back on the shapes for collisions; what is wrong is left out, and nothing else is."""
    from tests.cli.tool import invoke

    package = tmp_path / "somewhere"
    package.mkdir()
    for name, content in (("ball.ply", b"ply"), ("ball.stl", stl_bytes(ball(1)))):
        (package / name).write_bytes(content)
    (tmp_path / "arm.urdf").write_text(URDF)
    robot = load_description(tmp_path / "arm.urdf", {"arm": str(package)})[1].robot
    lower, upper = (link.visual for link in robot.links)
    assert [shape.scale for shape in lower] == [(0.001, 0.001, 0.001)] and lower[0].obj
    assert [(shape.cylinder, shape.sphere) for shape in upper] == [((0.1, 0.5), None), (None, 0.2)]
    (tmp_path / "robots").mkdir()
    done = invoke(
        "import", tmp_path / "arm.urdf", tmp_path / "robots" / "arm.yaml", "--package", f"arm={package}"
    )
    assert done.code == 0, done.err
    assert 'mesh: "../somewhere/ball.stl"' in (tmp_path / "robots" / "arm.yaml").read_text()
    text = "schema: 1\ngravity: [0, 0, 0]\nrobot: robots/arm.yaml\n"
    assert load_scene_text(text, str(tmp_path / "scene.yaml")).robot == robot
    shutil.rmtree(package)
    found = load_description(tmp_path / "arm.urdf")
    assert any("2 meshes are not there" in note for note in found[1].notes)
    assert not found[1].robot.links[0].visual
