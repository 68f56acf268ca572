"""Each exit code of the contract, provoked for real, and what is left in the output directory."""

from __future__ import annotations

import json
import os
import stat
import subprocess
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.runner import say_failed
from robodyn_cli.report.registry import Drawings, applicable, doubts
from robodyn_cli.results.hdf5 import read
from robodyn_cli.results.output_dir import OutputDirectory
from robodyn_cli.results.result import Result
from tests.cli.tool import COMMAND, CONFIGS, Done, environment, files, invoke, run

FOUR_BAR = CONFIGS / "four_bar_deploy.yaml"
CIRCLE = CONFIGS / "2r_circle.yaml"


def one_message(done: Done) -> str:
    """Return the one line that says what is wrong."""
    assert "Traceback" not in done.err + done.out
    found = [line for line in done.err.splitlines() if line.startswith("robodyn: error: ")]
    assert len(found) == 1, done.err
    return found[0]


# -- 0 and 1 -----------------------------------------------------------------------------------------------
def test_0_done_in_a_process_of_its_own(scene: Path) -> None:
    done = run("simulate", scene, "--no-plots", cwd=scene.parent)
    assert done.code == 0 and done.err == ""
    assert files(scene.parent / "outputs" / "scene" / "simulate") == {"result.h5", "summary.json"}


def test_0_the_entry_point_is_the_module() -> None:
    name = Path(COMMAND[0]).with_name("robodyn")
    if not name.exists():
        pytest.skip("not installed")
    version = subprocess.run([str(name), "--version"], capture_output=True, text=True, check=True)
    assert version.stdout == run("--version").out and version.stdout.startswith("robodyn ")


@pytest.mark.parametrize(
    ("overrides", "status"),
    [
        (["simulate.duration=2", "simulate.samples=21"], "no_lock"),
        (["deploy.criterion=multipliers", "deploy.growth=1e9", "deploy.limit=5"], "overload"),
    ],
)
def test_1_no_lock(overrides: list[str], status: str, tmp_path: Path) -> None:
    words = [word for o in overrides for word in ("--set", o)]
    done = invoke("deploy", FOUR_BAR, *words, "--json", "--no-plots", "--out", tmp_path)
    assert done.code == 1 and done.err == "" and done.data["status"] == status
    assert read(tmp_path / "result.h5").status == status
    if status == "no_lock":
        assert done.data["lock"] is None and done.data["termination"]["time"] == 2.0


@pytest.mark.parametrize(
    ("status", "events", "words"),
    [
        ("no_lock", [], "no lock"),
        (
            "overload",
            [{"time": 2.5, "name": "pin", "kind": "overload"}],
            "overload, pin is overloaded at 2.5 s",
        ),
    ],
)
def test_1_says_last_that_it_failed(
    status: str, events: list[Any], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    say_failed(Result("deploy", "", status, "", events=events), Console())
    assert capsys.readouterr().err == f"robodyn: failed: {words}\n"


@pytest.mark.parametrize(
    ("plots", "words"),
    [
        (
            "joint_angles,four_bars",
            "--plots four_bars: `simulate` does not draw that; allowed: joint_angles, ",
        ),
        ("angels", "no plot 'angels'; did you mean 'joint_angles'"),
    ],
)
def test_2_plots_that_a_command_does_not_draw(plots: str, words: str, tmp_path: Path) -> None:
    done = invoke("simulate", CONFIGS / "double_pendulum.yaml", "--plots", plots, "--out", tmp_path / "out")
    assert done.code == 2 and words in done.err and not (tmp_path / "out").exists()


def test_plots_asked_for_without_data_are_told() -> None:
    result = Result("deploy", "", "locked", "")
    result.add("time", [0.0, 1.0])
    result.add("energy/total", [5.0, 5.0])
    assert doubts(result, Drawings(("energy", "joint_rates"))) == ["no data for the plot joint_rates"]
    assert applicable(result, asked=True) == ["energy", "energy_drift"] and applicable(result) == []


# -- 2 -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "words",
    [
        ["frobnicate"],
        ["simulate"],
        ["simulate", "a.yaml", "b.yaml"],
        ["simulate", "a.yaml", "--frob"],
        ["simulate", "a.yaml", "--set"],
        ["simulate", "missing.yaml"],
        ["simulate", "."],
        ["simulate", str(CONFIGS / "double_pendulum.yaml"), "--set", "simulate.samples"],
        ["simulate", str(CONFIGS / "double_pendulum.yaml"), "--set", "simulate.samples=-1"],
        ["simulate", str(CONFIGS / "double_pendulum.yaml"), "--set", "simulate.integrator=euler"],
        ["deploy", str(CONFIGS / "double_pendulum.yaml")],
        ["inverse", str(CONFIGS / "four_bar_deploy.yaml")],
        ["inverse", str(CONFIGS / "double_pendulum.yaml")],
    ],
    ids=lambda words: " ".join(Path(w).name for w in words),
)
def test_2_usage_and_scenes(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = invoke(*words)
    assert done.code == 2 and done.out == "" and done.err
    assert "Traceback" not in done.err


def test_2_a_plan_of_a_scene_that_lacks_data() -> None:
    tilted = "robot.joints.theta2.origin={rpy: [30 deg, 0, 0]}"
    done = invoke("plan", CONFIGS / "2r_circle.yaml", "--set", tilted, "--json")
    assert done.code == 2 and done.data["status"] == "failed"
    assert "inertia.xx of link2" in done.data["missing"] and "inertia.xx of link2" in done.err


def test_2_a_directory_in_use(scene: Path, tmp_path: Path) -> None:
    with OutputDirectory(tmp_path / "out"):
        done = run("simulate", scene, "--no-plots", "--out", tmp_path / "out")
    message = one_message(done)
    assert done.code == 2 and "in use" in message and str(os.getpid()) in message
    assert invoke("simulate", scene, "--no-plots", "--out", tmp_path / "out").code == 0


@pytest.mark.parametrize("strict", [False, True])
def test_2_strict_takes_warnings_as_errors(strict: bool, tmp_path: Path) -> None:
    words = ["--set", "robot.links.link1.inertia={xx: 0.1, yy: 0.1, zz: 5}", "--out", tmp_path, "--no-plots"]
    done = invoke("inverse", CIRCLE, *words, *(["--strict"] if strict else []))
    assert done.code == (2 if strict else 0)
    assert "link1" in done.err and "triangle" in done.err


# -- 3, 4, 5 -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("torque", ["100*exp(q.j1*q.j1)", "1/(0.7 - t)"])
def test_3_a_motion_that_blows_up(torque: str, scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = invoke("simulate", scene, "--set", f'torques={{j1: "{torque}"}}', "--json", "--out", out)
    assert done.code == 3 and "t = " in one_message(done)
    assert done.data["status"] == "failed" and done.data["error"]["exit_code"] == 3
    assert done.data["error"]["kind"] == "NumericalError"
    whole_and_failed(out, done)


def test_3_a_singular_mass_matrix(scene: Path, tmp_path: Path) -> None:
    done = invoke("simulate", scene, "--set", "robot.links.l2={name: l2, mass: 0}", "--out", tmp_path / "out")
    assert done.code == 3 and "'j2'" in one_message(done)
    assert files(tmp_path / "out") == {"summary.json"}  # nothing was computed


@pytest.mark.parametrize("command", ["validate", "simulate"])
def test_3_numbers_that_leave_nothing_to_solve_with(command: str, tmp_path: Path) -> None:
    """Squared, a distance of 1e300 leaves no inertia of the bodies that can be told from zero."""
    scene = tmp_path / "scene.yaml"
    scene.write_text(FAR)
    done = invoke(
        command, scene, *(["--no-plots", "--out", tmp_path / "out"] if command == "simulate" else [])
    )
    assert done.code == 3 and "too far apart" in done.err + done.out and "Traceback" not in done.err


FAR = """
schema: 1
gravity: [1, -9, -4]
robot:
  joints:
  - {name: t1, type: revolute, axis: [0, 0, 1]}
  - {name: t2, type: revolute, axis: [0, 1, 1], origin: {xyz: [1, 0, 0]}}
  - {name: t3, type: revolute, axis: [1, 0, 0], origin: {xyz: [1, 0, 0]}}
  links:
  - {name: A}
  - {name: B, mass: 2, com: [-1.0e+300, 0, 0], inertia: {xx: 0.01, yy: 0.5, zz: 0.5}}
  - {name: C, mass: 1, com: [0.5, 0, 0], inertia: {xx: 0.01, yy: 0.1, zz: 0.1}}
  points: {pivot: {link: base, at: [2, 0, 0]}, tip: {link: C, at: [0, 0, 0]}}
loops:
- {name: last, type: distance, between: [pivot, tip], length: 1}
initial: {q: {t1: 0.1, t2: 0.2, t3: 0.3}}
"""


@pytest.mark.parametrize("command", ["simulate", "deploy"])
def test_4_a_bifurcation(command: str, tmp_path: Path) -> None:
    done = invoke(command, CONFIGS / "parallelogram.yaml", "--json", "--out", tmp_path)
    assert done.code == 4 and "bifurcation" in one_message(done)
    assert done.data["error"]["kind"] == "SingularConfigurationError"
    whole_and_failed(tmp_path, done)


def whole_and_failed(directory: Path, done: Done) -> None:
    result = read(directory / "result.h5")
    assert result.status == "failed"
    with h5py.File(directory / "result.h5") as file:
        assert file.attrs["status"] == "failed"
        termination = json.loads(file.attrs["termination"])
    assert termination["reason"] == done.data["error"]["message"] and termination["time"] > 0
    lengths = {len(v.data) for v in result.variables.values() if v.dims[0] == "time"}
    assert lengths == {len(result.time)} and len(result.time) > 1
    assert 0.0 < result.time[-1] <= termination["time"] * (1 + 1e-9)
    assert np.all(np.isfinite(result["q"])) and np.all(np.isfinite(result["qd"]))
    assert {"result.h5", "summary.json", "joint_angles.png"} <= files(directory)


@pytest.mark.parametrize(
    ("command", "name", "override", "words"),
    [
        ("deploy", "four_bar_deploy", "robot.joints.phi1.origin.xyz=[10, 0, 0]", ("'pin'", "6.35907 m")),
        ("simulate", "four_bar_deploy", "robot.joints.phi1.origin.xyz=[10, 0, 0]", ("'pin'", "6.35907 m")),
        ("simulate", "four_bar_deploy", "initial.qd={theta1: 1, phi1: 9}", ("rates", "pin.")),
        ("inverse", "2r_circle", "trajectory.center=[3, 0]", ("tip", "t = ", " m")),
        ("inverse", "2r_circle", "trajectory.radius=1.9", ("tip", "t = ", " m")),
    ],
)
def test_5_geometry(command: str, name: str, override: str, words: tuple[str, ...], tmp_path: Path) -> None:
    done = invoke(command, CONFIGS / f"{name}.yaml", "--set", override, "--out", tmp_path, "--no-plots")
    message = one_message(done)
    assert done.code == 5 and done.out == ""
    for word in words:
        assert word in message
    assert files(tmp_path) == set()


def test_5_an_unreachable_circle_says_when_and_by_how_much(tmp_path: Path) -> None:
    done = invoke("inverse", CIRCLE, "--set", "trajectory.center=[1.9, 0]", "--out", tmp_path, "--json")
    assert done.code == 5
    # the arm reaches 2 m; the circle starts at x = 2.1 m
    assert "t = 0 s" in one_message(done) and "0.1 m" in done.err


# -- 70 and 74 ---------------------------------------------------------------------------------------------
def test_70_an_internal_error_is_reported_in_one_line(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Something that must not happen: a module of the run is broken."""
    import robodyn_cli.works.simulate as module

    def broken(*args: Any, **more: Any) -> None:
        raise AssertionError("the impossible")

    monkeypatch.setattr(module, "build_motion", broken)
    done = invoke("simulate", scene, "--json", "--out", tmp_path / "out")
    message = one_message(done)
    assert done.code == 70 and "internal error" in message and "the impossible" in message
    assert "ROBODYN_DEBUG" in message and done.data["status"] == "failed"
    assert files(tmp_path / "out") == set()


def test_74_out_is_a_file(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    done = invoke("simulate", scene, "--json", "--out", tmp_path / "out")
    assert done.code == 74 and str(tmp_path / "out") in one_message(done)
    assert done.data["error"]["kind"] == "OutputError" and (tmp_path / "out").read_text() == "mine"


def test_74_below_a_file(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert invoke("simulate", scene, "--out", tmp_path / "file" / "deep").code == 74


def test_74_read_only(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    out.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        if os.access(out, os.W_OK):
            pytest.skip("this user may write anywhere")
        assert invoke("simulate", scene, "--out", out).code == 74
    finally:
        out.chmod(stat.S_IRWXU)


def test_74_a_drawing_that_cannot_be_replaced(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "joint_angles.png").mkdir()
    done = invoke("simulate", scene, "--out", tmp_path)
    assert done.code == 74 and "joint_angles.png" in one_message(done)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("option", ["--json", "--no-plots"])
def test_74_standard_output_is_full(option: str, scene: Path) -> None:
    with open("/dev/full", "w") as full:
        done = run("simulate", scene, "--no-plots", option, cwd=scene.parent, stdout=full)
    assert done.code == 74 and "standard output" in one_message(done)


def test_no_space_left(scene: Path, tmp_path: Path) -> None:
    """A file system without room: nothing half-written stays behind."""
    small = tmp_path / "small"
    small.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(small)], capture_output=True
    )
    if mounted.returncode != 0:
        pytest.skip("cannot mount")
    try:
        done = run("simulate", scene, "--set", "simulate.samples=5001", "--no-plots", "--out", small / "out")
        assert done.code == 74 and one_message(done)
        assert "result.h5" not in files(small / "out") and not list((small / "out").glob(".*tmp"))
    finally:
        subprocess.run(["umount", str(small)], check=True)


# -- a mistake does not cost a result ----------------------------------------------------------------------
def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir() if path.name != ".lock"}


@pytest.mark.parametrize(
    ("override", "code"),
    [
        ("simulate.rtol=none", 2),
        ("simulate.smaples=3", 2),
        ("gravity=[0, 0]", 2),
        ("robot.links.l1.mass=null", 2),
    ],
)
def test_a_mistake_leaves_earlier_results(override: str, code: int, scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert invoke("simulate", scene, "--out", out).code == 0
    (out / "notes.txt").write_text("mine")
    before = contents(out)
    assert {"result.h5", "joint_angles.png"} <= set(before)
    done = invoke("simulate", scene, "--set", override, "--out", out)
    assert done.code == code and "stay as they were" in done.err and str(out) in done.err
    assert contents(out) == before


def test_geometry_that_cannot_be_met_leaves_earlier_results(tmp_path: Path) -> None:
    assert invoke("inverse", CIRCLE, "--no-plots", "--out", tmp_path).code == 0
    before = contents(tmp_path)
    done = invoke("inverse", CIRCLE, "--set", "trajectory.center=[3, 0]", "--out", tmp_path)
    assert done.code == 5 and "stay as they were" in done.err and contents(tmp_path) == before


def test_an_internal_error_leaves_earlier_results(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert invoke("simulate", scene, "--no-plots", "--out", tmp_path / "out").code == 0
    before = contents(tmp_path / "out")
    monkeypatch.setattr("robodyn_cli.works.simulate.build_motion", None)
    done = invoke("simulate", scene, "--out", tmp_path / "out")
    assert done.code == 70 and "stay as they were" in done.err and contents(tmp_path / "out") == before


@pytest.mark.parametrize("words", [["--methods", "x"], ["--set", "simulate.x=1"]])
def test_work_precision_too(words: list[str], scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert invoke("simulate", scene, "--no-plots", "--out", out).code == 0
    before = contents(out)
    done = invoke("work-precision", scene, *words, "--out", out)
    assert done.code == 2 and "stay as they were" in done.err and contents(out) == before


def test_a_failure_of_the_numerics_replaces_earlier_results(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert invoke("simulate", scene, "--out", out).code == 0
    (out / "notes.txt").write_text("mine")
    done = invoke("simulate", scene, "--set", "robot.links.l2={name: l2, mass: 0}", "--out", out)
    assert done.code == 3 and "stay as they were" not in done.err
    assert files(out) == {"summary.json", "notes.txt"}
    assert json.loads((out / "summary.json").read_text())["status"] == "failed"


def test_results_of_another_scene_are_not_replaced_in_silence(scene: Path, tmp_path: Path) -> None:
    other = tmp_path / "elsewhere" / scene.name
    other.parent.mkdir()
    other.write_text(scene.read_text())
    out = tmp_path / "out"
    assert invoke("simulate", scene, "--no-plots", "--out", out).err == ""
    assert invoke("simulate", scene, "--no-plots", "--out", out).err == ""
    done = invoke("simulate", other, "--no-plots", "--out", out)
    assert done.code == 0 and "another scene" in done.err and str(scene) in done.err


def test_files_of_two_runs_are_recognised(scene: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert invoke("simulate", scene, "--no-plots", "--out", tmp_path / name).code == 0
    (tmp_path / "a" / "result.h5").replace(tmp_path / "b" / "result.h5")
    for words in (["check", tmp_path / "b", scene], ["compare", tmp_path / "b", tmp_path / "b"]):
        done = invoke(*words)
        assert done.code == 2 and "not of the same run" in one_message(done)
    done = invoke("check", tmp_path / "a", scene)
    assert done.code == 2 and "not of the same run" in one_message(done)


def test_a_failure_that_kept_results_leaves_only_its_own(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert invoke("simulate", scene, "--out", out).code == 0
    done = invoke("simulate", scene, "--set", 'torques={j1: "1/(0.5 - t)"}', "--no-plots", "--out", out)
    assert done.code == 3 and files(out) == {"result.h5", "summary.json"}
    assert read(out / "result.h5").time[-1] < 0.51


def test_a_scene_that_cannot_be_read_creates_no_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = invoke("simulate", "missing.yaml")
    assert done.code == 2 and list(tmp_path.iterdir()) == []


def test_results_do_not_depend_on_where_the_command_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(CONFIGS.parent)
    from_root = invoke("inverse", "configs/2r_circle.yaml", "--no-plots", "--json", "--out", tmp_path / "a")
    monkeypatch.chdir(tmp_path)
    elsewhere = invoke("inverse", CIRCLE, "--no-plots", "--json", "--out", "b")
    assert from_root.code == elsewhere.code == 0
    first, second = (read(tmp_path / d / "result.h5") for d in "ab")
    assert np.array_equal(first["tau"], second["tau"])


def test_python_with_all_warnings_as_errors(scene: Path) -> None:
    done = run(
        "simulate", scene, cwd=scene.parent, env=environment(PYTHONWARNINGS="error", PYTHONDEVMODE="1")
    )
    assert done.code == 0, done.err
