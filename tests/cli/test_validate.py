"""``robodyn validate``: everything that is wrong with a scene, at once, with its place."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from robodyn_cli.errors import SceneError, worst
from robodyn_cli.scene.load import examine, load_scene

CONFIGS = Path(__file__).parents[2] / "configs"

BAD = """\
schema: 1
title: [a]
gravity: [0, -9.81]
gravty: 3
robot:
  convention: standard
  joints:
    - {name: j1, type: revolute, a: 1.0, alpa: 0, d: 0}
    - {name: j2, type: revolut, a: 0, alpha: 0}
  links:
    - {name: l1, mass: -1, com: [0.5, 0, 0], com_frame: joint}
    - {name: l2, mass: 1, mass: 2}
torques: {j3: 1, j1: "k*q1"}
initial: {q: {j1: 0.1 deq}}
simulate: {rtol: 0x10, samples: 1.5}
trajectory: nofile.yaml
"""
PLACES = [
    "2:8: title", "3:10: gravity", "4:1: gravty", "8:42: robot.joints.0.alpa", "9:24: robot.joints.1.type",
    "11:24: robot.links.0.mass", "12:27: robot.links.1.mass", "13:22: torques.j1", "14:19: initial.q.j1",
    "15:18: simulate.rtol", "15:33: simulate.samples", "16:13: trajectory",
]  # fmt: skip


def validate(*words: object) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["validate", *map(str, words)])
    return done.exit_code, done.output


def report(*words: object) -> tuple[int, Any]:
    code, output = validate(*words, "--json")
    return code, json.loads(output)


def changed(tmp_path: Path, config: str, *changes: tuple[str, str]) -> Path:
    text = (CONFIGS / f"{config}.yaml").read_text().replace("robots/", f"{(CONFIGS / 'robots').as_posix()}/")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = tmp_path / f"{config}.yaml"
    path.write_text(text)
    return path


def test_scenes_without_faults() -> None:
    code, output = validate(*sorted(CONFIGS.glob("*.yaml")))
    assert code == 0
    assert all(line.endswith(": ok") for line in output.splitlines())


def test_all_errors_at_once(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(BAD)
    code, output = validate(path)
    lines = output.splitlines()
    assert code == 2 and lines[0] == f"{path}: 12 errors"
    found = [re.match(rf"  error: {re.escape(str(path))}:(\d+:\d+: [\w.]+): ", line) for line in lines[1:]]
    assert [match.group(1) for match in found if match] == PLACES
    with pytest.raises(SceneError) as first:
        load_scene(path)
    assert first.value.message.startswith(f"{path}:{PLACES[0]}: ")


def test_errors_between_keys_come_with_those_of_single_keys(tmp_path: Path) -> None:
    path = changed(
        tmp_path, "four_bar_deploy",
        ("actuated: [theta1]", "actuated: [theta9]"), ("between: [coupler, follower]", "between: [cupler, follower]"),
        ("growth: 1000", "growth: 0"), ("duration: 20", "duratoin: 20"),
        ("coupler.end, follower", "coupler.end, folower"),
    )  # fmt: skip
    keys = [error.details["key"] for error in examine(path).errors]
    assert keys == [
        "loops.0.between.1", "actuated.0", "torques.theta1", "simulate.duratoin", "deploy.growth",
        "deploy.latch.between.0",
    ]  # fmt: skip


def test_no_error_follows_from_another(tmp_path: Path) -> None:
    path = changed(tmp_path, "2r_circle", ("robots/planar_2r.yaml", "robots/none.yaml"))
    assert [error.details["key"] for error in examine(path).errors] == ["robot"]


def test_the_loader_raises_the_first_error_of_all(tmp_path: Path) -> None:
    for old, new in (("schema: 1", "schema: 2"), ("point: tip", "point: tap"), ("radius: 0.2", "")):
        path = changed(tmp_path, "2r_circle", (old, new))
        errors = examine(path).errors
        with pytest.raises(SceneError) as first:
            load_scene(path)
        assert [e.message for e in errors] == [first.value.message]


def test_files_that_are_no_scene(tmp_path: Path) -> None:
    (tmp_path / "list.yaml").write_text("- 1\n")
    (tmp_path / "broken.yaml").write_text("a: [1\n")
    (tmp_path / "empty.yaml").write_text("")
    for name in ("list", "broken", "empty", "absent"):
        code, data = report(tmp_path / f"{name}.yaml")
        assert code == 2 and len(data["scenes"][0]["findings"]) == 1, name


def test_loops_that_do_not_close(tmp_path: Path) -> None:
    path = changed(tmp_path, "four_bar_deploy", ("theta1: 0.01, phi1: 0.0102", "theta1: 3.0, phi1: 0.0102"))
    code, output = validate(path)
    assert code == 5 and f"{path}:9:5: loops.0: the loop 'pin' does not close" in output


def test_target_out_of_reach(tmp_path: Path) -> None:
    code, output = validate(changed(tmp_path, "2r_circle", ("[1.2, 1.2]", "[3, 3]")))
    assert code == 5 and "trajectory: point 'tip' cannot reach" in output


@pytest.mark.parametrize("samples", [5, 301, 1601])
@pytest.mark.parametrize("ik", ["branch: elbow_up", "branch: elbow_up, method: newton"])
def test_the_command_says_the_same_of_a_motion_whatever_its_samples(
    tmp_path: Path, ik: str, samples: int
) -> None:
    """Where a path leaves the reach: one message, with one time, in ``validate`` and in the commands."""
    path = changed(
        tmp_path, "2r_circle", ("[1.2, 1.2]", "[1.3, 0.7]"), ("radius: 0.2", "radius: 0.6\n  start: 180 deg"),
        ("branch: elbow_up", ik), ("samples: 1001}", f"samples: {samples}}}\nkinematics: {{samples: {samples}}}"),
    )  # fmt: skip
    code, output = validate(path)
    for command in ("inverse", "kinematics"):
        run = CliRunner().invoke(app, [command, str(path), "--no-plots", "--out", str(tmp_path / "out")])
        told = run.stderr.partition("error: ")[2].strip()
        assert code == run.exit_code == 5 and told in output, (output, run.stderr)
        assert "cannot reach its target at t = " in told


def test_missing_data_that_the_command_needs(tmp_path: Path) -> None:
    robot = (CONFIGS / "robots" / "two_link_arm.yaml").read_text()
    path = changed(tmp_path, "arm_in_plane", ((CONFIGS / "robots").as_posix(), "."))
    (tmp_path / "two_link_arm.yaml").write_text(re.sub(r"\n    mass: .*", "", robot))
    code, data = report(path)
    messages = [f["message"] for f in data["scenes"][0]["findings"]]
    assert code == 2 and messages, messages
    assert all("inverse needs mass of link" in m and "two_link_arm.yaml:" in m for m in messages)


def test_bodies_that_cannot_exist(tmp_path: Path) -> None:
    body = "inertia: {xx: 1.0, yy: 1.0, zz: 2.25}"
    robot = (
        "robot: {convention: modified, joints: [{name: j, type: revolute, a: 0}], links: [{name: slab, mass: 1, "
        f"com: [0, 0, 0], {body}" + "}]}"
    )
    path = tmp_path / "slab.yaml"
    path.write_text(f"schema: 1\ngravity: [0, 0, 0]\n{robot}\ninitial: {{q: {{j: 0}}}}\n")
    code, output = validate(path)
    assert code == 0 and f"{path}: 1 warning" in output
    assert "robot.links.0.inertia: slab: the principal moments" in output and "by 0.25" in output
    assert validate(path, "--strict")[0] == 2
    path.write_text(path.read_text().replace("zz: 2.25", "zz: -1.5"))
    assert "negative" in validate(path)[1]
    path.write_text(path.read_text().replace("zz: -1.5", "zz: 1, xy: 3"))
    assert "not positive semi-definite: principal moment -2 kg m^2" in validate(path)[1]


def test_the_worst_file_decides(tmp_path: Path) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text(BAD)
    open_loop = changed(
        tmp_path, "four_bar_deploy", ("theta1: 0.01, phi1: 0.0102", "theta1: 3.0, phi1: 0.0102")
    )
    good = CONFIGS / "2r_circle.yaml"
    assert report(good, bad)[0] == 2
    code, data = report(bad, open_loop, good)
    assert code == data["exit_code"] == 5
    assert [s["exit_code"] for s in data["scenes"]] == [2, 5, 0]


def test_order_of_badness() -> None:
    assert worst([]) == 0
    assert [worst(pair) for pair in ((0, 1), (3, 1), (3, 2), (2, 4), (4, 5), (5, 70), (70, 130))] == [
        1, 3, 2, 4, 5, 70, 130,
    ]  # fmt: skip


def test_a_bad_name_hides_nothing(tmp_path: Path) -> None:
    """A name that formulas cannot use does not keep the other joints from being checked."""
    path = tmp_path / "names.yaml"
    path.write_text(
        """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: e, type: revolute, axis: [0, 0, 1]}
    - {name: b, type: helical, axis: [0, 0, 0], pitch: 1}
  links: [{name: l1, mass: 1, com: [0, 0, 0]}, {name: l2, mass: 1, com: [0, 0, 0]}]
forces: [{name: s, type: spring, between: [l1.origin, l1.com], stiffness: 3}]
"""
    )
    keys = [error.details["key"] for error in examine(path).errors]
    assert keys == ["robot.joints.0.name", "robot.joints.1.axis", "forces.0.between"]


def test_changes_of_keys_are_checked_as_commands_do(tmp_path: Path) -> None:
    scene = CONFIGS / "double_pendulum.yaml"
    assert validate(scene, "--set", "robot.links.link1.mass=800 gram")[0] == 0
    for change in (
        "robot.links.link1.mass=-1",
        "robot.links.link1.mas=1",
        "robot.links.link1.mass=5 mm",
        "mass",
    ):
        with pytest.raises(SceneError) as refused:
            load_scene(scene, [change])
        code, found = report(scene, "--set", change)
        assert code == 2 and [x["message"] for x in found["scenes"][0]["findings"]] == [refused.value.message]
    code, words = validate(scene, "--set", "study.vary={robot.links.link1.mass: 'uniform(-1, 1)'}")
    assert code == 2 and "is too small" in words
