"""Every scene in configs/ through the command line: exit code, files, summary, HDF5, drawings."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from robodyn_cli.results.hdf5 import read
from tests.cli.tool import CONFIGS, Done, files, invoke
from tests.leaves import undeclared

SCENES = sorted(path.stem for path in CONFIGS.glob("*.yaml"))
EXIT = {"parallelogram": 4}
INVERSE = {"joint_angles", "joint_rates", "joint_accelerations", "torques", "torque_terms", "tip_path", "point_coordinates",
           "energy", "mechanism"}  # fmt: skip
SIMULATE = {
    "joint_angles",
    "joint_rates",
    "tip_path",
    "point_coordinates",
    "energy",
    "energy_drift",
    "mechanism",
}
DEPLOY = {"joint_angles", "multipliers", "constraint_residual", "singular_values", "mechanism"}
DRAWINGS = {
    "2r_drives": INVERSE | {"drives"},
    "cart_pole_lqr": SIMULATE | {"torques", "tracking"},
    "controlled_arm": SIMULATE | {"torques", "tracking"},
    "deployable_hinge": (INVERSE - {"tip_path", "point_coordinates"}) | {"motorisation"},
    "double_pendulum": SIMULATE,
    "four_bar_deploy": (DEPLOY - {"constraint_residual"}) | {"tip_path", "point_coordinates"},
    "four_bar_prescribed": (DEPLOY - {"constraint_residual"}) | {"tip_path", "point_coordinates"},
    "parallelogram": DEPLOY,
    "spinning_top": SIMULATE,
    "bouncing_pendulum": SIMULATE,
    "catching_arm": SIMULATE,
    "stick_slip": SIMULATE | {"torques", "multipliers", "constraint_residual"},
    "tumbling_body": SIMULATE,
}
SUMMARY = {
    "inverse": {"joints", "ik_residual", "round_trip"},
    "simulate": {"energy_drift", "integrator", "tolerances"},
    "deploy": {"energy_drift", "constraint_residual", "criteria", "integrator"},
}
ALWAYS = {"status", "command", "title", "termination", "error_estimate", "counters", "wall_time_s", "outputs"}
MOTION = {"time", "q", "qd", "qdd", "tau"}
DATASETS = {
    "inverse": MOTION | {"torque_terms/inertia", "energy/kinetic", "energy/potential", "energy/total"},
    "simulate": MOTION | {"energy/kinetic", "energy/potential", "energy/total"},
    "deploy": MOTION
    | {"constraints/multipliers", "constraints/position_residual", "constraints/velocity_residual"}
    | {"energy/kinetic", "energy/potential", "energy/total", "energy/work"}
    | {"singularity/psi", "singularity/passive", "singularity/determinant"},
}
ATTRIBUTES = {
    "filetype", "format_version", "robodyn_version", "robodyn_code_sha256", "command", "title", "status", "scene", "scene_sha256",
    "versions", "cpu", "seed", "integrator", "termination", "counters", "wall_time_s", "summary",
}  # fmt: skip


@dataclasses.dataclass
class Ran:
    name: str
    command: str
    done: Done
    directory: Path


@pytest.fixture(scope="module", params=SCENES)
def ran(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Ran:
    name = request.param
    text = (CONFIGS / f"{name}.yaml").read_text()
    command = next(line for line in text.splitlines() if line.startswith("command: ")).split()[1]
    directory = tmp_path_factory.mktemp(name) / "out"
    return Ran(
        name, command, invoke(command, CONFIGS / f"{name}.yaml", "--json", "--out", directory), directory
    )


def test_every_number_of_the_summary_is_declared(ran: Ran) -> None:
    assert undeclared(ran.done.data) == []


def test_exit_code_and_streams(ran: Ran) -> None:
    assert ran.done.code == EXIT.get(ran.name, 0), ran.done.err
    assert isinstance(ran.done.data, dict)  # standard output is one JSON document and nothing else
    if ran.done.code == 0:
        assert ran.done.err == ""
    else:
        message = [line for line in ran.done.err.splitlines() if line.startswith("robodyn: error: ")]
        assert len(message) == 1 and "Traceback" not in ran.done.err


def test_files(ran: Ran) -> None:
    drawings = {f"{name}.png" for name in DRAWINGS.get(ran.name, INVERSE)}
    # paths of points are drawn where the scene names points
    assert files(ran.directory) == {"result.h5", "summary.json"} | drawings
    assert set(ran.done.data["outputs"]) == files(ran.directory)
    for name in drawings:
        assert (ran.directory / name).read_bytes().startswith(b"\x89PNG\r\n\x1a\n")


def test_summary(ran: Ran) -> None:
    text = (ran.directory / "summary.json").read_text()
    assert text.strip() == ran.done.out.strip()
    summary = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    expected = ALWAYS | SUMMARY[ran.command]
    if ran.command == "inverse" and "inverse_kinematics" not in summary:
        expected -= {"ik_residual"}
    assert expected <= set(summary)
    assert summary["command"] == ran.command and summary["title"]
    assert summary["wall_time_s"]["total"] > 0.0
    status = {"inverse": "ok", "simulate": "ok", "deploy": "locked"}[ran.command]
    assert summary["status"] == ("failed" if ran.done.code else status)
    assert ("error" in summary) == bool(ran.done.code)
    if ran.done.code:
        assert summary["error"]["exit_code"] == ran.done.code and summary["error"]["message"]
        assert summary["termination"]["time"] > 0.0


def test_hdf5_with_our_reader(ran: Ran) -> None:
    result = read(ran.directory / "result.h5")
    assert DATASETS[ran.command] <= set(result.variables)
    assert result.status == ran.done.data["status"] and result.command == ran.command
    samples = len(result.time)
    for path, variable in result.variables.items():
        assert variable.units and variable.long_name, path
        if variable.dims[:1] == ("time",):
            assert len(variable.data) == samples, path
    joints = result.variables["qd"].names
    assert joints and all(result.variables[path].names == joints for path in ("qdd", "tau"))
    quaternions = any(name.endswith(".qw") for name in result.variables["q"].names)
    assert quaternions or result.variables["q"].names == joints
    assert np.all(np.isfinite(result["q"])) and np.all(np.isfinite(result["tau"]))


def test_hdf5_with_h5py(ran: Ran) -> None:
    with h5py.File(ran.directory / "result.h5") as file:
        assert set(file.attrs) >= ATTRIBUTES
        assert file.attrs["filetype"] == "robodyn.result" and file.attrs["format_version"] == 1
        assert file["time"].is_scale and file["q"].dims[0][0] == file["time"]
        for path in DATASETS[ran.command]:
            assert file[path].attrs["units"] and file[path].attrs["long_name"]
        assert {"time", "name", "kind", "details"} <= set(file["events"])
        assert json.loads(file.attrs["summary"])["status"] == file.attrs["status"]
        assert "schema: 1" in file.attrs["scene"]


def test_times_are_uniform_up_to_the_last(ran: Ran) -> None:
    result = read(ran.directory / "result.h5")
    time, steps = result.time, np.diff(result.time)
    assert time[0] == 0.0 and np.all(steps > 0.0)
    np.testing.assert_allclose(steps[:-1], steps[0], rtol=1e-9)
    if ran.command == "deploy":
        # the end lies between two samples and is there too
        assert steps[-1] <= steps[0] * (1 + 1e-9)
        lock = ran.done.data.get("lock")
        if lock is None or not lock["driven"]:
            assert time[-1] == ran.done.data["termination"]["time"]
    else:
        assert steps[-1] == pytest.approx(steps[0], rel=1e-9)
        assert time[-1] == pytest.approx(ran.done.data["termination"]["time"], rel=1e-15)


def test_parts_sum_to_the_whole(ran: Ran) -> None:
    result = read(ran.directory / "result.h5")
    np.testing.assert_allclose(
        result["energy/total"], result["energy/kinetic"] + result["energy/potential"], rtol=0, atol=1e-12
    )
    if ran.command == "inverse":
        terms = sum(item.data for item in result.group("torque_terms").values())
        scale = np.abs(result["tau"]).max()
        np.testing.assert_allclose(terms, result["tau"], rtol=0, atol=1e-13 * scale)


def test_the_stored_scene_runs_again(ran: Ran, tmp_path: Path) -> None:
    scene = tmp_path / "again.yaml"
    scene.write_text(h5py.File(ran.directory / "result.h5").attrs["scene"])
    again = invoke(ran.command, scene, "--json", "--no-plots", "--out", tmp_path / "out")
    assert again.code == ran.done.code
    mine, first = (read(d / "result.h5") for d in (tmp_path / "out", ran.directory))
    for path in ("time", "q", "tau"):
        assert np.array_equal(mine[path], first[path]), path


def test_quiet_says_nothing(ran: Ran, tmp_path: Path) -> None:
    done = invoke(ran.command, CONFIGS / f"{ran.name}.yaml", "--quiet", "--no-plots", "--out", tmp_path)
    assert done.out == "" and (done.code != 0 or done.err == "")
    assert files(tmp_path) == {"result.h5", "summary.json"}


def test_words_for_people(ran: Ran, tmp_path: Path) -> None:
    done = invoke(ran.command, CONFIGS / f"{ran.name}.yaml", "--no-plots", "--out", tmp_path)
    if done.code == 0:
        assert str(tmp_path) in done.out and ran.done.data["title"] in done.out and done.err == ""
        assert "nan" not in done.out.lower().replace("finance", "") and "None" not in done.out
    else:
        assert done.out == "" or str(tmp_path) in done.out
