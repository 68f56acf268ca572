"""``kinematics``, ``statics`` and ``assemble`` as programs: files, tables, JSON, exit codes, batches."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from robodyn_cli.over.batch.criteria import judge
from robodyn_cli.results.hdf5 import read
from robodyn_cli.scene.load import load_scene
from tests.cli.tool import invoke

ROOT = Path(__file__).parents[2]
SCENES = ROOT / "configs" / "mechanisms"


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.yaml")), ids=lambda path: path.stem)
def test_scenes_meet_their_expectations(path: Path, tmp_path: Path) -> None:
    scene = load_scene(path)
    assert scene.command is not None and scene.expect
    invoke(scene.command, path, "--out", tmp_path, "--no-plots")
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [str(outcome) for outcome in judge(scene.expect, summary) if not outcome.holds] == []


def test_branches_are_listed_and_drawn(tmp_path: Path) -> None:
    scene = str(SCENES / "four_bar_kinematics.yaml")
    done = invoke("assemble", scene, "--branches", "--at", "q.crank=40 deg", "--out", str(tmp_path))
    assert done.code == 0 and "2 branches found" in done.out and "1 (chosen)" in done.out
    names = {path.name for path in tmp_path.iterdir()}
    assert {
        "branches.png",
        "mechanism.png",
        "result.h5",
        "summary.json",
    } <= names and "joint_angles.png" not in names
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["held"] == ["crank"] and len(summary["branches"]) == 2


def test_a_gap_is_exit_code_5(tmp_path: Path) -> None:
    scene = str(SCENES / "four_bar_kinematics.yaml")
    at = "q.crank=0, q.rocker=0"
    done = invoke("assemble", scene, "--at", at, "--out", str(tmp_path), "--json")
    error = json.loads(done.out)["error"]
    assert done.code == 5 and error["loop"] == "pin" and error["gap"] > 0.1


@pytest.mark.parametrize(("command", "scene", "says"), [
    ("kinematics", "four_bar_kinematics", "transmission to    82.284211"),
    ("statics", "balanced_four_bar", "balanced           stable"),
    ("inverse", "five_bar_circle", "path off by"),
])  # fmt: skip
def test_tables(command: str, scene: str, says: str, tmp_path: Path) -> None:
    done = invoke(command, str(SCENES / f"{scene}.yaml"), "--out", str(tmp_path), "--no-plots", "-v")
    assert done.code == 0 and says in done.out
    assert invoke("validate", str(SCENES / f"{scene}.yaml")).code == 0


def test_a_sweep_that_ends_keeps_its_results(tmp_path: Path) -> None:
    sweep = "kinematics.sweep={joint: rocker, start: 1.5, stop: 3}"
    scene, q = str(SCENES / "four_bar_kinematics.yaml"), "initial.q={crank: 0.6, coupler: 0.2, rocker: 1.5}"
    done = invoke("kinematics", scene, "--set", sweep, "--set", q, "--out", str(tmp_path), "--no-plots")
    assert done.code == 4 and "loop pin lets joint" in done.err
    assert json.loads((tmp_path / "summary.json").read_text())["status"] == "failed"
    assert (tmp_path / "result.h5").exists()


@pytest.mark.parametrize("command", ["simulate", "statics", "inverse"])
def test_multipliers_that_are_not_unique_are_said_to_be_so(command: str, tmp_path: Path) -> None:
    """On the terminal and in the file; nothing is said of a four-bar whose rows are independent."""
    settings = ["statics.find=hold", "simulate.duration=0.2", "simulate.samples=5", "inverse.samples=5"]
    options = [word for setting in settings for word in ("--set", setting)]
    trajectory = "trajectory={type: joint, duration: 0.1, q: {t1: 80 deg + 10 deg * t}}"
    if command == "inverse":
        options += ["--set", trajectory]
    benchmarks = ROOT / "configs" / "benchmarks"
    out = ("--out", tmp_path, "--no-plots")
    done = invoke(command, benchmarks / "bennett.yaml", *options, *out)
    assert done.code == 0 and "least norm" in done.out
    assert "redundant rows" in done.out or "depend on each other" in done.out
    stored = read(tmp_path / "result.h5").variables["constraints/multipliers"]
    assert "least norm" in stored.long_name
    if command == "simulate":
        done = invoke(command, ROOT / "configs" / "four_bar_prescribed.yaml", *options, *out)
        assert done.code == 0 and "least norm" not in done.out


def test_residuals_of_prescribed_joints_are_not_called_those_of_loops(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        "schema: 1\ngravity: [0, -9.81, 0]\nrobot: {joints: [{name: a, type: revolute, axis: [0, 0, 1]}], "
        "links: [{name: l, mass: 1, com: [1, 0, 0], inertia: {zz: 0.1}}]}\n"
        "prescribed: {a: sin(t)}\nsimulate: {duration: 1, samples: 5}\n"
    )
    done = invoke("simulate", scene, "--out", tmp_path / "out", "--no-plots", "-v")
    assert done.code == 0 and " constraints off by" in done.out and "loop" not in done.out
