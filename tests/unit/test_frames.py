"""Results as objects of xarray and pandas."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
import xarray

from robodyn_cli import load_scene, simulate
from robodyn_cli.errors import CapabilityError
from robodyn_cli.results.hdf5 import write
from robodyn_cli.results.result import Result
from tests.unit.synthetic_results import inverse_result

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.mark.parametrize("scene", ["tumbling_body", "mechanisms/lift_arm"])
def test_a_dataset_is_that_of_the_file(scene: str, tmp_path: Path) -> None:
    """The reader of netCDF files is another program: paths, values, dimensions, labels and units are the same."""
    from robodyn_cli.over.commands import execute
    from robodyn_cli.tools.progress import Stopwatch, no_progress

    loaded = load_scene(CONFIGS / f"{scene}.yaml")
    result = execute(loaded.command or "", loaded, no_progress, Stopwatch())
    found = result.to_xarray()
    path = write(result, tmp_path / "result.h5")
    groups = sorted({name.rpartition("/")[0] for name in result.variables})
    for group in groups:
        with xarray.open_dataset(path, engine="h5netcdf", group=group or None) as stored:
            for name, variable in stored.variables.items():
                here = f"{group}/{name}" if group else str(name)
                if here not in result.variables:
                    continue
                ours: Any = found[here]
                assert np.array_equal(ours.to_numpy(), variable.to_numpy(), equal_nan=True), here
                assert ours.attrs["units"] == variable.attrs["units"]
                if group != "joint_limits":
                    assert dict(zip(ours.dims, ours.shape)).items() >= {("time", len(result.time))}
                assert ours.shape == variable.shape
    q = result.variables["q"]
    for k, name in enumerate(q.names):
        dim = found["q"].dims[1]
        assert np.array_equal(found["q"].sel({dim: name}), q.data[:, k])
    assert found.attrs["command"] == loaded.command


def test_a_name_for_two_lengths_or_labels_is_two_dimensions() -> None:
    result = Result("x", "title", "ok", "")
    for path, count, names in (
        ("a", 2, ("u", "v")),
        ("b", 2, ()),
        ("c", 3, ()),
        ("d", 2, ("v", "w")),
        ("e", 2, ("s", "s")),
    ):
        result.add(path, np.ones((4, count)), units="m", long_name=path, dims=("row", "corner"), names=names)
    found = result.to_xarray()
    assert {path: found[path].dims[1] for path in "abcde"} == {
        "a": "corner", "b": "corner", "c": "corner_2", "d": "corner_3", "e": "corner"
    }  # fmt: skip
    assert list(found["corner"].values) == ["u", "v"] and list(found["corner_3"].values) == ["v", "w"]


def test_a_frame_has_time_as_index_and_units() -> None:
    result = inverse_result()
    frame = result.to_pandas()
    assert frame.index.name == "time" and np.array_equal(frame.index, result.time)
    assert np.array_equal(frame["q.theta2"], result["q"][:, 1])
    assert np.array_equal(frame["points/tip.z"], result["points/tip"][:, 2])
    assert frame.attrs["units"]["tau.theta1"] == "N m" and frame.attrs["status"] == "ok"
    between = frame.loc[result.time[3] : result.time[5], "qd.theta1"]
    assert len(between) == 3


def test_other_tables_by_their_first_dimension() -> None:
    result = inverse_result()
    result.add("branches/determinant", [1.0, -1.0])
    frame = result.to_pandas("branch")
    assert list(frame["branches/determinant"]) == [1.0, -1.0] and frame.index.name == "branch"
    with pytest.raises(CapabilityError, match="no table 'run'; allowed: samples, branch"):
        result.to_pandas("run")
    study = Result("sweep", "", "ok", "")
    study.add("outputs/x", [1.0, 2.0, 3.0], units="1", long_name="x", dims=("run",))
    assert isinstance(study.to_pandas(), pandas.DataFrame) and len(study.to_pandas()) == 3


@pytest.mark.parametrize("package", ["xarray", "pandas"])
def test_a_missing_package_is_named(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == package else real(name))
    with pytest.raises(CapabilityError, match=rf"pip install 'robodyn\[{package}\]'"):
        getattr(inverse_result(), f"to_{package}")()


def test_a_long_run_takes_no_time() -> None:
    result = simulate(
        load_scene(
            CONFIGS / "double_pendulum.yaml", ["simulate.samples=100001", "simulate.error_estimate=false"]
        )
    )
    assert result.to_xarray()["q"].shape == result.to_pandas().filter(like="q.").shape == (100001, 2)
