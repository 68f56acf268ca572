"""Results in other formats: every number and unit comes back, and mistakes leave nothing behind."""

from __future__ import annotations

import csv
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.cli.app import run
from robodyn_cli.results import export as module
from robodyn_cli.results.export import export, matlab_name, tables
from robodyn_cli.results.hdf5 import write
from robodyn_cli.results.result import Result, units_of
from tests.unit.synthetic_results import pendulum_result


@pytest.fixture(scope="module")
def result() -> Result:
    found = pendulum_result(31)
    rng = np.random.default_rng(5)
    found.add("reactions/theta1", rng.normal(size=(31, 6)), names=("fx", "fy", "fz", "mx", "my", "mz"))
    found.add("frames/hand/twist", rng.normal(size=(31, 6)), names=("wx", "wy", "wz", "vx", "vy", "vz"))
    found.add("skeleton/a", rng.normal(size=(31, 2, 3)))
    found.add("branches/q", rng.normal(size=(4, 2)), units="rad", names=("theta1", "theta2"))
    found.add(
        "tau", 0.1 * rng.normal(size=(31, 2)), units="N m or N", names=("a", "b"), column_units=("N m", "N")
    )
    found["q"][3, 1] = np.nan
    found.events.append({"time": 0.1, "name": "hinge, left", "kind": "impact", "speed": 2.5})
    return found


def heads(result: Result) -> dict[str, dict[str, tuple[str, np.ndarray]]]:
    return {name: {c.label: (c.units, c.data) for c in columns} for name, columns in tables(result).items()}


def test_tables_hold_every_number_once_with_its_unit(result: Result) -> None:
    found = heads(result)
    assert set(found) == {"samples", "branch"}
    assert sum(len(c) for c in found["samples"].values()) > 0
    count = sum(v.data.size for v in result.variables.values())
    assert sum(data.size for table in found.values() for _, data in table.values()) == count
    samples = found["samples"]
    assert samples["time"][0] == "s" and samples["q.theta1"][0] == "rad" and samples["tau.b"][0] == "N"
    assert samples["reactions/theta1.fx"][0] == "N" and samples["reactions/theta1.mz"][0] == "N m"
    assert samples["frames/hand/twist.wy"][0] == "rad/s" and samples["frames/hand/twist.vz"][0] == "m/s"
    assert np.array_equal(samples["skeleton/a.1.z"][1], result["skeleton/a"][:, 1, 2])
    assert units_of(result.variables["tau"]) == ["N m", "N"]


def test_csv_comes_back_to_the_last_bit(result: Result, tmp_path: Path) -> None:
    paths = export(result, "csv", tmp_path)
    assert [path.name for path in paths] == ["samples.csv", "branch.csv", "events.csv"]
    with open(paths[0], encoding="utf-8", newline="") as stream:
        head, *rows = csv.reader(stream)
    for k, (label, (units, data)) in enumerate(heads(result)["samples"].items()):
        assert head[k] == f"{label} [{units}]"
        assert np.array_equal([float(row[k]) for row in rows], data, equal_nan=True)
    with open(paths[2], encoding="utf-8", newline="") as stream:
        _, event = csv.reader(stream)
    assert event[:3] == ["0.1", "hinge, left", "impact"] and json.loads(event[3]) == {"speed": 2.5}


def test_npz_and_mat_come_back_with_units(result: Result, tmp_path: Path) -> None:
    from scipy.io import loadmat

    export(result, "npz", tmp_path)
    with np.load(tmp_path / "result.npz") as stored:
        for path, variable in result.variables.items():
            assert np.array_equal(stored[path], variable.data, equal_nan=True)
        assert json.loads(str(stored["units"]))["tau"] == ["N m", "N"]
        assert json.loads(str(stored["names"]))["q"] == ["theta1", "theta2"]
    export(result, "mat", tmp_path)
    stored = loadmat(tmp_path / "result.mat", simplify_cells=True)
    assert np.array_equal(stored["data"]["q"], result["q"], equal_nan=True)
    assert np.array_equal(stored["data"]["reactions"]["theta1"], result["reactions/theta1"])
    assert stored["units"]["q"] == "rad" and list(stored["units"]["tau"]) == ["N m", "N"]
    assert list(stored["names"]["q"]) == ["theta1", "theta2"]


def test_json_comes_back_with_units(result: Result, tmp_path: Path) -> None:
    (path,) = export(result, "json", tmp_path)
    stored = json.loads(path.read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert stored["command"] == "simulate" and stored["events"][0]["speed"] == 2.5
    for name, variable in result.variables.items():
        own = stored["variables"][name]
        assert np.array_equal(np.array(own["data"], dtype=float), variable.data, equal_nan=True)
        assert own["units"] == (list(variable.column_units) or variable.units)
        assert own["names"] == list(variable.names) and own["dims"] == list(variable.dims)


def test_parquet_comes_back_with_units(result: Result, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    export(result, "parquet", tmp_path)
    table = parquet.read_table(tmp_path / "samples.parquet")
    for label, (units, data) in heads(result)["samples"].items():
        assert np.array_equal(table[label].to_numpy(), data, equal_nan=True)
        assert table.schema.field(label).metadata[b"units"].decode() == units
    assert table.schema.metadata[b"command"] == b"simulate"


def test_names_that_matlab_takes() -> None:
    assert matlab_name("theta1") == "theta1"
    assert matlab_name("2nd-joint.ä") == "x2nd_joint__"
    assert len(matlab_name("a" * 99)) == 63


def test_mistakes_are_one_message_and_leave_nothing(
    result: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = str(write(result, tmp_path / "result.h5"))
    taken = tmp_path / "file"
    taken.write_text("")
    monkeypatch.setattr(module.importlib.util, "find_spec", lambda name: None)
    assert importlib.util.find_spec("pyarrow") is None
    out = tmp_path / "out"
    for words, code, message in (
        ([stored, "--to", "xlsx", "--out", str(out)], 2, "allowed: csv, parquet, mat, npz, json, mcap"),
        ([stored, "--to", "parquet", "--out", str(out)], 2, "pip install 'robodyn[parquet]'"),
        ([str(taken), "--to", "csv", "--out", str(out)], 2, "cannot be read as HDF5"),
        ([stored, "--to", "csv"], 2, "--out"),
        ([stored, "--to", "csv", "--out", str(taken)], 74, "cannot write"),
    ):
        assert run(["export", *words]) == code
        said = capsys.readouterr().err
        assert message in said and said.count("robodyn: error:") == 1
        assert not out.exists()


def test_the_command_reports_its_files(
    result: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = str(write(result, tmp_path / "result.h5"))
    assert run(["export", stored, "--to", "npz", "--out", str(tmp_path / "x"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [str(tmp_path / "x" / "result.npz")]
