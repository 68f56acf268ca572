"""Files that a scene names: where they are looked for, what they give, and what may go wrong."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.trajectories.given import TableTrajectory

ROBOT = """\
convention: standard
joints:
  - {name: j1, type: revolute, a: 1, alpha: 0, d: 0}
links:
  - {name: l1, mass: 1}
points: {tip: {link: l1, at: end}}
"""
SCENE = "schema: 1\ngravity: [0, 0, 0]\nrobot: parts/robot.yaml\n"
TABLE = "trajectory: {type: table, interpolation: linear, file: data/motion.csv}\n"
CSV = "# recorded\nt, j1\n\n0, 1\n0.5, 1e-1\n 1.0 ,-2\n"


def write(folder: Path, **files: str) -> Path:
    """Write files (``__`` in a name is a folder), return the scene's path."""
    for name, text in files.items():
        stem, _, suffix = name.rpartition("_")
        path = folder / (stem.replace("__", "/") + "." + suffix)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder / "scene.yaml"


def refuse(path: Path) -> SceneError:
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert "\n" not in caught.value.message
    return caught.value


def test_paths_are_relative_to_the_file_that_names_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(
        tmp_path,
        scene_yaml=SCENE + "trajectory: paths/way.yaml\n",
        parts__robot_yaml="deeper/real.yaml",
        parts__deeper__real_yaml=ROBOT,
        paths__way_yaml="{type: table, interpolation: linear, file: ../data/motion.csv}",
        data__motion_csv=CSV,
    )
    scene = load_scene(path)
    assert [os.path.relpath(s, tmp_path) for s in scene.sources] == [
        "scene.yaml",
        os.path.join("parts", "robot.yaml"),
        os.path.join("parts", "deeper", "real.yaml"),
        os.path.join("paths", "way.yaml"),
        os.path.join("data", "motion.csv"),
    ]
    monkeypatch.chdir(tmp_path)
    assert load_scene("scene.yaml") == scene
    assert load_scene("scene.yaml").sources[1] == os.path.join("parts", "robot.yaml")
    assert load_scene_text(path.read_text(), path=str(path)) == scene
    # a text without a file looks in the working directory
    assert load_scene_text(path.read_text()) == scene


def test_the_text_of_a_scene_stands_alone(tmp_path: Path) -> None:
    path = write(tmp_path, scene_yaml=SCENE + TABLE, parts__robot_yaml=ROBOT, data__motion_csv=CSV)
    scene = load_scene(path)
    alone = load_scene_text(scene.text)
    assert alone == scene
    assert alone.text == scene.text
    assert "robot.yaml" not in scene.text and "motion.csv" not in scene.text


def test_csv(tmp_path: Path) -> None:
    path = write(tmp_path, scene_yaml=SCENE + TABLE, parts__robot_yaml=ROBOT, data__motion_csv=CSV)
    table = load_scene(path).trajectory
    assert isinstance(table, TableTrajectory)
    assert table.file is None
    assert table.columns == ("t", "j1")
    assert table.rows == ((0.0, 1.0), (0.5, 0.1), (1.0, -2.0))


@pytest.mark.parametrize(
    ("csv", "place", "words"),
    [
        ("t,j1\n0,1\n1,x\n", ":3:3", "must be a number (value 'x')"),
        ("t,j1\n0,1\n1,\n", ":3:3", "must be a number (value '')"),
        ("t,j1\n0,1\n1,  45 deg\n", ":3:5", "must be a number"),
        ("t,j1\n0,1\n1,true\n", ":3:3", "must be a number"),
        ("t,j1\n0,1\n1,nan\n", ":3:3", "must be a number"),
        ("t,j1\n0,1\n1,.nan\n", ":3:3", "is not finite"),
        ("t,j1\n0,1\n0,2\n", ":3:1", "times must increase"),
        ("t,j1\n1,1\n2,2\n", ":2:1", "first time must be 0"),
        ("t,j1\n0,1\n1,2,3\n", ":3:1", "has 3 numbers; needed: 2"),
        ("t,j2\n0,1\n1,2\n", ":1:3", "unknown joint 'j2'"),
        ("time,j1\n0,1\n1,2\n", ":1:1", "must be 't'"),
        ("t;j1\n0;1\n1;2\n", ":2:1", "must be a number (value '0;1')"),
        ("t,j1\n0,1\n", ":1:1", "has 1 entry"),
        ("# nothing\n\n", ":1:1", "no header row"),
    ],
)
def test_bad_csv(tmp_path: Path, csv: str, place: str, words: str) -> None:
    path = write(tmp_path, scene_yaml=SCENE + TABLE, parts__robot_yaml=ROBOT, data__motion_csv=csv)
    error = refuse(path)
    name = os.path.join(tmp_path, "data", "motion.csv")
    assert error.message.startswith(name + place + ": trajectory"), error.message
    assert words in error.message


def test_csv_beside_rows(tmp_path: Path) -> None:
    both = "trajectory: {type: table, file: data/motion.csv, columns: [t, j1]}\n"
    path = write(tmp_path, scene_yaml=SCENE + both, parts__robot_yaml=ROBOT, data__motion_csv=CSV)
    error = refuse(path)
    assert error.message.startswith(f"{path}:4:27: trajectory.file: give either 'file' or 'columns'")


@pytest.mark.parametrize("wrong", ["3", "[a.csv]", "{a: b}", "true"])
def test_csv_path_must_be_text(tmp_path: Path, wrong: str) -> None:
    path = write(
        tmp_path, scene_yaml=SCENE + TABLE.replace("data/motion.csv", wrong), parts__robot_yaml=ROBOT
    )
    assert "trajectory.file: must be the path of a CSV or HDF5 file" in refuse(path).message


def test_errors_name_the_included_file(tmp_path: Path) -> None:
    path = write(tmp_path, scene_yaml=SCENE, parts__robot_yaml=ROBOT.replace("mass", "mas"))
    error = refuse(path)
    name = os.path.join(tmp_path, "parts", "robot.yaml")
    assert error.message.startswith(
        f"{name}:5:16: robot.links.0.mas: unknown key 'mas' (did you mean 'mass'?)"
    )
    assert error.details["file"] == name


def test_broken_yaml_and_duplicates_in_an_included_file(tmp_path: Path) -> None:
    name = os.path.join(tmp_path, "parts", "robot.yaml")
    path = write(tmp_path, scene_yaml=SCENE, parts__robot_yaml="joints: [")
    assert refuse(path).message.startswith(f"{name}:2:1: robot: this is not YAML")
    path = write(tmp_path, scene_yaml=SCENE, parts__robot_yaml="joints: []\njoints: []\n")
    assert refuse(path).message.startswith(f"{name}:2:1: robot.joints: key 'joints' appears twice")
    path = write(tmp_path, scene_yaml=SCENE, parts__robot_yaml="")
    assert refuse(path).message.startswith(f"{name}:1:1: robot: there is nothing in it")
    path = write(tmp_path, scene_yaml=SCENE, parts__robot_yaml="[1, 2]")
    assert refuse(path).message.startswith(f"{name}:1:1: robot: is not a map")


def test_missing_file_is_placed_where_it_is_named(tmp_path: Path) -> None:
    path = write(tmp_path, scene_yaml=SCENE)
    error = refuse(path)
    name = os.path.join(tmp_path, "parts", "robot.yaml")
    assert error.message == f"{path}:3:8: robot: cannot read '{name}': there is no such file"


@pytest.mark.parametrize("value", ["parts", "3", "true", "[robot.yaml]", "''", '"a\\0b"'])
def test_what_is_no_readable_file(tmp_path: Path, value: str) -> None:
    (tmp_path / "parts").mkdir()
    error = refuse(write(tmp_path, scene_yaml=SCENE.replace("parts/robot.yaml", value)))
    assert error.message.startswith(f"{tmp_path / 'scene.yaml'}:3:8: robot: ")


def test_cycle_is_refused_with_its_chain(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        scene_yaml=SCENE,
        parts__robot_yaml="deep/a.yaml",
        parts__deep__a_yaml="b.yaml",
        parts__deep__b_yaml="../robot.yaml",
    )
    error = refuse(path)
    files = [
        ("scene.yaml",),
        ("parts", "robot.yaml"),
        ("parts", "deep", "a.yaml"),
        ("parts", "deep", "b.yaml"),
    ]
    names = [os.path.join(tmp_path, *parts) for parts in [*files, ("parts", "robot.yaml")]]
    assert error.message == f"{names[3]}:1:1: robot: includes form a cycle: {' -> '.join(names)}"


def test_a_scene_that_includes_itself(tmp_path: Path) -> None:
    path = write(tmp_path, scene_yaml=SCENE.replace("parts/robot.yaml", "./scene.yaml"))
    assert f"includes form a cycle: {path} -> {path}" in refuse(path).message


def test_long_chains_are_refused(tmp_path: Path) -> None:
    files = {f"f{k}_yaml": f"f{k + 1}.yaml" for k in range(40)}
    path = write(tmp_path, scene_yaml=SCENE.replace("parts/robot.yaml", "f0.yaml"), **files)
    assert "nested more than 20 deep" in refuse(path).message


def test_the_same_file_twice_is_no_cycle(tmp_path: Path) -> None:
    path = write(tmp_path, scene_yaml=SCENE, parts__robot_yaml=ROBOT)
    text = path.read_text() + "trajectory: {type: table, interpolation: linear, file: m.csv}\n"
    write(tmp_path, scene_yaml=text, m_csv=CSV)
    assert len(load_scene(path).sources) == 3


# -- include with changes -----------------------------------------------------------------------------
def included(tmp_path: Path, robot: str) -> Scene:
    return load_scene(
        write(tmp_path, scene_yaml=SCENE.replace("parts/robot.yaml", robot), parts__robot_yaml=ROBOT)
    )


def test_include_with_keys_of_its_own(tmp_path: Path) -> None:
    scene = included(
        tmp_path, "{include: parts/robot.yaml, base: {xyz: [1, 2, 3]}, points: {top: {link: l1}}}"
    )
    assert scene.robot.base.xyz == (1.0, 2.0, 3.0)
    assert list(scene.robot.points) == ["tip", "top"]  # loops of the file may join its own
    assert scene.robot.joints[0].name == "j1"


def test_points_beside_include_replace_those_of_their_name(tmp_path: Path) -> None:
    robot = (
        "{include: parts/robot.yaml, points: {tip: {link: l1, at: [1, 2, 3]}}, frames: {hand: {link: l1}}}"
    )
    scene = included(tmp_path, robot)
    assert scene.robot.points["tip"].at == (1.0, 2.0, 3.0) and list(scene.robot.points) == ["tip"]
    assert list(scene.robot.frames) == ["hand"]


CHAIN = ROBOT.replace(
    "links:", "  - {name: j2, type: revolute, a: 1, alpha: 0, d: 0}\nlinks:\n  - {name: l0}"
)


def test_joints_and_links_beside_include_change_by_name(tmp_path: Path) -> None:
    """A map changes the keys of those that it names; a list stands in the place of the file's."""
    scene = included(tmp_path, "{include: parts/robot.yaml, joints: {j1: {a: 2}}, links: {l1: {mass: 3}}}")
    assert scene.robot.joints[0].a == 2.0 and scene.robot.joints[0].type == "revolute"
    assert scene.robot.links[0].mass == 3.0


@pytest.mark.parametrize(
    "own, words",
    [
        ("joints: {k: {a: 2}}", "robot.joints: unknown joint 'k'; allowed: j1, j2"),
        ("links: {l1: 2}", "robot.links.l1: must be a map of the keys that change"),
        ("joints: [{name: j, type: fixed}]", "robot.joints: this list stands in the place of the joints of .*robot.yaml"),
    ],
)  # fmt: skip
def test_bad_changes_beside_include(tmp_path: Path, own: str, words: str) -> None:
    scene = SCENE.replace("parts/robot.yaml", f"{{include: parts/robot.yaml, {own}}}")
    path = write(tmp_path, scene_yaml=scene, parts__robot_yaml=CHAIN)
    with pytest.raises(SceneError, match=f"scene.yaml:3:.*{words}"):
        load_scene(path)


def test_include_is_refused_where_no_file_may_stand(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="unknown key 'include'"):
        load_scene(
            write(tmp_path, scene_yaml=SCENE + "simulate: {include: x.yaml}\n", parts__robot_yaml=ROBOT)
        )


def test_include_must_name_a_map(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"scene\.yaml:3:18: robot\.include: must be the path"):
        included(tmp_path, "{include: [parts/robot.yaml]}")
    scene = write(tmp_path, scene_yaml=SCENE.replace("parts/robot.yaml", "{include: l.yaml}"), l_yaml="[1]")
    assert "l.yaml:1:1: robot: an included file must contain a map" in refuse(scene).message


def test_a_whole_scene_lends_its_robot(tmp_path: Path) -> None:
    """Another scene, or one that `robodyn new` wrote, may stand where a robot is asked for; nothing of it is lost."""
    path = write(tmp_path, scene_yaml=SCENE, parts__robot_yaml=ROBOT)
    plain = load_scene(path).robot
    body = "".join(f"  {line}\n" for line in ROBOT.splitlines())
    whole = f"schema: 1\ntitle: an arm\ngravity: [1, 2, 3]\nrobot:\n{body}"
    write(tmp_path, scene_yaml=SCENE, parts__robot_yaml=whole)
    found = load_scene(path)
    assert found.robot == plain and found.gravity == (0, 0, 0)
    write(tmp_path, scene_yaml=SCENE, parts__robot_yaml=whole + "forces: [{type: damper}]\n")
    error = refuse(path)
    assert "robot.yaml:11" in error.message and "'forces' beside its robot" in error.message
