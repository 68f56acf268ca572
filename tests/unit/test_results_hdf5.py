"""Result files: what goes in comes out, in a form that other readers know, and foreign files are refused."""

from __future__ import annotations

import json
import os
import signal
import time
import tracemalloc
from pathlib import Path

import h5py
import numpy as np
import pytest

from robodyn_cli.errors import OutputError, ResultFileError
from robodyn_cli.foreign import survive
from robodyn_cli.results import catalogue, hdf5
from robodyn_cli.results.hdf5 import ResultWriter, read, reader, write
from robodyn_cli.results.result import Result
from tests.unit.synthetic_results import four_bar_result, inverse_result

GOLDEN = Path(__file__).parents[1] / "golden"


def awkward_result() -> Result:
    """Values and texts that a careless format would lose; also the content of golden/result_v1.h5."""
    result = Result("simulate", "Tüftelei, 試験, <$x_1$>", "ok", "schema: 1\ntitle: 試験\n")
    result.add("time", [0.0, 0.1, 1.0 / 3.0])
    data = [[np.pi, -0.0, 5e-324], [np.nan, np.inf, -np.inf], [1e308, 2.0**-1074, 0.1 + 0.2]]
    result.add("q", data, units="rad", names=("a", "größe", "c"))
    result.add("skeleton/a", np.arange(18.0).reshape(3, 2, 3))
    result.add("skeleton/b", np.arange(27.0).reshape(3, 3, 3))
    result.add("extra/scalar", 42.5, units="kg", long_name="a number", dims=())
    result.add("extra/spectrum", [1.0, 2.0], units="1", long_name="no time here", dims=("mode",))
    result.events = [{"time": 0.1, "name": "pin", "kind": "lock", "impulse": [1.0, 2.0], "note": "é"}]
    result.summary = {
        "status": "ok",
        "termination": {"reason": "end", "time": 1.0},
        "nested": {"x": [1, None]},
    }
    result.attributes = {
        "seed": 7,
        "integrator": "gauss",
        "counters": {"steps": 12},
        "own": 1.5,
        "list": [1, 2],
    }
    return result


def same(a: Result, b: Result) -> None:
    assert (a.command, a.title, a.status, a.scene_text) == (b.command, b.title, b.status, b.scene_text)
    assert list(a.variables) == list(b.variables)
    for path, variable in a.variables.items():
        other = b.variables[path]
        assert variable.data.tobytes() == other.data.tobytes(), path
        assert (variable.units, variable.long_name, variable.names) == (
            other.units,
            other.long_name,
            other.names,
        )
        assert len(variable.dims) == len(other.dims)
    assert a.events == b.events
    assert a.summary == b.summary


def test_round_trip_loses_nothing(tmp_path: Path) -> None:
    result = awkward_result()
    back = read(write(result, tmp_path / "result.h5"))
    same(result, back)
    for name, value in result.attributes.items():
        assert back.attributes[name] == value
    again = read(write(back, tmp_path / "again.h5"))
    same(back, again)
    assert [v.dims for v in again.variables.values()] == [v.dims for v in back.variables.values()]


def test_a_file_of_format_1_stays_readable() -> None:
    same(awkward_result(), read(GOLDEN / "result_v1.h5"))


def test_every_dataset_says_what_it_is(tmp_path: Path) -> None:
    write(four_bar_result(), tmp_path / "result.h5")
    with h5py.File(tmp_path / "result.h5") as file:
        assert file["time"].is_scale

        def check(path: str, item: object) -> None:
            if not isinstance(item, h5py.Dataset) or b"netCDF dimension" in item.attrs.get("NAME", b""):
                return
            assert item.attrs["units"] and item.attrs["long_name"], path
            for dimension in [] if item.is_scale else item.dims:
                assert len(dimension) == 1, path
            known = catalogue.lookup(path)
            if known and known.dims[0] == "time" and path != "time":
                assert item.dims[0][0] == file["time"], path

        file.visititems(check)
        assert list(file["q"].attrs["names"]) == ["theta1", "phi1", "phi2"]
        assert [text.decode() for text in file["joint"][:]] == ["theta1", "phi1", "phi2"]


def test_root_attributes_are_those_of_the_catalogue(tmp_path: Path) -> None:
    write(inverse_result(), tmp_path / "result.h5")
    with h5py.File(tmp_path / "result.h5") as file:
        # the id of a run is given by who puts its files in place
        listed = [entry for entry in catalogue.ATTRIBUTES if entry.name != "run_id"]
        assert set(file.attrs) == {entry.name for entry in listed}
        for entry in listed:
            value = file.attrs[entry.name]
            if entry.kind == "integer":
                assert isinstance(value, np.int64)
            else:
                assert isinstance(value, str)
                if entry.kind == "JSON":
                    json.loads(value)
        assert file.attrs["filetype"] == "robodyn.result"
        assert len(file.attrs["scene_sha256"]) == 64


def test_xarray_reads_every_group(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    result = four_bar_result()
    path = write(result, tmp_path / "result.h5")
    with xarray.open_dataset(path, engine="h5netcdf") as root:
        assert root.q.dims == ("time", "joint")
        assert np.array_equal(root.q.sel(joint="phi1").values, result["q"][:, 1])
        assert root.q.attrs["units"] == "rad"
    for group in ("constraints", "singularity", "events"):
        with xarray.open_dataset(path, engine="h5netcdf", group=group) as data:
            assert data.sizes
    with xarray.open_dataset(path, engine="h5netcdf", group="constraints") as data:
        assert data.multipliers.dims == ("time", "constraint")
    if hasattr(xarray, "open_datatree"):
        with xarray.open_datatree(path, engine="h5netcdf") as tree:
            chosen = tree["constraints"].multipliers.sel(constraint="pin.x", time=slice(1.0, 2.0))
            assert chosen.size == np.count_nonzero((result.time >= 1.0) & (result.time <= 2.0))


def test_names_and_texts_of_any_size(tmp_path: Path) -> None:
    result = Result("inverse", "many", "ok", "# line\n" * 200_000)
    result.add("time", [0.0, 1.0])
    names = tuple(f"joint_{index}" for index in range(6000))
    result.add("q", np.zeros((2, 6000)), units="rad", names=names)
    back = read(write(result, tmp_path / "result.h5"))
    assert back.scene_text == result.scene_text
    assert back.variables["q"].names == names


def test_repeated_and_different_labels_keep_their_names(tmp_path: Path) -> None:
    result = Result("inverse", "", "ok", "")
    result.add("time", [0.0])
    result.add("q", [[1.0, 2.0]], names=("a", "a"))
    result.add("qd", [[1.0, 2.0, 3.0]], names=("a", "b", "c"))
    result.add("tau", [[1.0, 2.0, 3.0]], names=("a", "b", "d"))
    back = read(write(result, tmp_path / "result.h5"))
    assert [back.variables[path].names for path in ("q", "qd", "tau")] == [
        ("a", "a"),
        ("a", "b", "c"),
        ("a", "b", "d"),
    ]
    assert len({back.variables[path].dims[1] for path in ("q", "qd", "tau")}) == 3


def test_blocks_give_the_same_file_as_whole_arrays(tmp_path: Path) -> None:
    result = inverse_result(1001)
    with ResultWriter(tmp_path / "blocks.h5", command="inverse", title=result.title) as writer:
        for start in range(0, 1001, 64):
            for path, variable in result.variables.items():
                meta = {"units": variable.units, "names": variable.names} if start == 0 else {}
                writer.append(path, variable.data[start : start + 64], **meta)
        assert writer.samples == 1001
        writer.finish(summary=result.summary)
    back = read(tmp_path / "blocks.h5")
    for path, variable in result.variables.items():
        assert np.array_equal(back[path], variable.data), path
        assert back.variables[path].dims == variable.dims


def test_a_million_samples_in_little_memory(tmp_path: Path) -> None:
    count, block = 1_000_000, 2000
    tracemalloc.start()
    try:
        with ResultWriter(tmp_path / "long.h5", command="simulate") as writer:
            buffer = np.empty((block, 4))
            for start in range(0, count, block):
                index = np.arange(start, start + block, dtype=float)
                # The same buffer each time: the writer must not keep a view of it.
                buffer[:] = index[:, None] + [0.0, 0.25, 0.5, 0.75]
                writer.append("time", index * 1e-3)
                writer.append("q", buffer, units="rad", names=("a", "b", "c", "d"))
            writer.finish()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 8e6
    with h5py.File(tmp_path / "long.h5") as file:
        assert file["q"].shape == (count, 4)
        assert file["q"].chunks and file["q"].maxshape[0] is None
        assert file["q"].dims[0][0] == file["time"]
        assert np.array_equal(file["q"][::1000, 3], np.arange(0.0, count, 1000.0) + 0.75)
        assert file["time"][-1] == (count - 1) * 1e-3


@pytest.mark.parametrize("rows", [100, 200_000])
def test_a_failed_run_is_cut_to_common_samples(tmp_path: Path, rows: int) -> None:
    with pytest.raises(ZeroDivisionError), ResultWriter(tmp_path / "r.h5", command="simulate") as writer:
        try:
            writer.append("time", np.arange(float(rows)))
            writer.append("q", np.ones((rows - 30, 2)), units="rad")
            writer.append("qd", np.ones((rows - 50, 2)), units="rad/s")
            raise ZeroDivisionError
        except ZeroDivisionError:
            writer.finish(status="failed", summary={"termination": {"reason": "singular", "time": 1.5}})
            raise
    back = read(tmp_path / "r.h5")
    assert back.status == "failed"
    assert back.attributes["termination"] == {"reason": "singular", "time": 1.5}
    assert [len(back[path]) for path in ("time", "q", "qd")] == [rows - 50] * 3
    assert np.array_equal(back.time, np.arange(rows - 50.0))


def test_unequal_lengths_of_a_good_run_are_an_error(tmp_path: Path) -> None:
    with (
        pytest.raises(ValueError, match="time 3, q 2"),
        ResultWriter(tmp_path / "r.h5", command="simulate") as writer,
    ):
        writer.put("time", [0.0, 1.0, 2.0])
        writer.put("q", np.ones((2, 1)))
        writer.finish()
    assert not list(tmp_path.iterdir())


def test_misuse_of_the_writer_is_named(tmp_path: Path) -> None:
    with ResultWriter(tmp_path / "r.h5", command="simulate") as writer:
        writer.put("time", [0.0])
        with pytest.raises(ValueError, match="already"):
            writer.put("time", [0.0])
        with pytest.raises(ValueError, match="units"):
            writer.put("unheard/of", [0.0])
        writer.append("q", np.ones((1, 2)))
        with pytest.raises(ValueError, match="block of shape"):
            writer.append("q", np.ones((1, 3)))
        writer.finish()
        with pytest.raises(RuntimeError, match="twice"):
            writer.finish()
        with pytest.raises(RuntimeError, match="finished"):
            writer.put("q2", [0.0], units="1", long_name="late")


def test_empty_results_are_files_too(tmp_path: Path) -> None:
    result = Result("simulate", "", "failed", "")
    result.add("time", [])
    result.add("q", np.zeros((0, 2)), names=("a", "b"))
    back = read(write(result, tmp_path / "r.h5"))
    assert back["q"].shape == (0, 2)
    assert read(write(Result("plan", "", "ok", ""), tmp_path / "none.h5")).variables == {}


def test_select_reads_only_what_is_asked_for(tmp_path: Path) -> None:
    write(inverse_result(), tmp_path / "r.h5")
    assert list(read(tmp_path / "r.h5", select=lambda path: path in ("time", "tau")).variables) == [
        "time",
        "tau",
    ]


def reject(path: Path) -> str:
    with pytest.raises(ResultFileError) as caught:
        read(path)
    assert caught.value.exit_code == 2
    assert str(path) in caught.value.message
    return caught.value.message


def test_the_reader_refuses_what_is_not_a_result(tmp_path: Path) -> None:
    assert "no such file" in reject(tmp_path / "none.h5")
    assert "directory" in reject(tmp_path)
    text = tmp_path / "text.h5"
    text.write_text("time,q\n0,1\n")
    reject(text)
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["time"] = [0.0]
    assert "not a result of robodyn" in reject(tmp_path / "foreign.h5")
    whole = write(inverse_result(), tmp_path / "r.h5").read_bytes()
    cut = tmp_path / "cut.h5"
    for size in (0, 40, len(whole) // 2, len(whole) - 100):
        cut.write_bytes(whole[:size])
        reject(cut)


def test_the_reader_refuses_a_newer_format(tmp_path: Path) -> None:
    write(inverse_result(), tmp_path / "r.h5")
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        file.attrs["format_version"] = 2
    assert "update robodyn" in reject(tmp_path / "r.h5")


def test_a_missing_directory_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="none") as caught:
        write(inverse_result(), tmp_path / "none" / "r.h5")
    assert caught.value.exit_code == 74


DAMAGED = 30


def test_damage_anywhere_is_an_error_with_a_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten bytes at random places are spoilt: the result is read, or refused; the library's endless loops are ended."""
    monkeypatch.setattr("robodyn_cli.results.hdf5.reader.SECONDS", 0.4)
    good = write(inverse_result(), tmp_path / "good.h5").read_bytes()
    rng = np.random.default_rng(1)
    path = tmp_path / "damaged.h5"
    refused = 0
    for k in range(DAMAGED):
        data = bytearray(good)
        start = int(rng.integers(len(data) - 10))
        data[start : start + 10] = b"\xff" * 10 if k % 2 else rng.bytes(10)
        path.write_bytes(data)
        try:
            read(path)
        except ResultFileError as error:
            assert str(path) in error.message
            refused += 1
    assert 0 < refused < DAMAGED


def test_an_endless_loop_and_a_crash_in_the_library_are_errors() -> None:
    def crash() -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    with pytest.raises(TimeoutError, match="does not end"):
        survive(lambda: time.sleep(60), 0.05, "the library")
    with pytest.raises(RuntimeError, match="crashes on it .SIGKILL"):
        survive(crash, 10.0, "the library")
    survive(lambda: 1 / 0, 10.0, "the library")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="nothing is tried where processes cannot be forked")
def test_one_process_tries_all_files_that_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a damaged one among them, each is tried alone: the library may loop forever or refuse it."""
    forks = []
    fork = os.fork
    monkeypatch.setattr(os, "fork", lambda: forks.append(1) or fork())
    paths = [write(inverse_result(), tmp_path / f"{k}.h5") for k in range(5)]
    results = hdf5.read_all(paths)
    assert len(forks) == 1 and len(results) == 5
    for result in results:
        same(result, inverse_result())
    paths[2].write_bytes(paths[2].read_bytes()[:3000])
    with pytest.raises(ResultFileError, match="2.h5 cannot be read"):
        hdf5.read_all(paths)
    (tmp_path / "2.h5").unlink()
    with pytest.raises(ResultFileError, match="2.h5: no such file"):
        hdf5.read_all(paths)
    assert hdf5.read_all([]) == []


def test_of_files_that_crash_the_library_it_says_which(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [write(inverse_result(), tmp_path / f"{k}.h5") for k in range(3)]
    ours = os.getpid()

    def crashing(path: Path, select: object) -> Result:
        if path == paths[1] and os.getpid() != ours:
            os.kill(os.getpid(), signal.SIGKILL)
        return read_here(path, select)

    read_here = reader._read
    monkeypatch.setattr(reader, "_read", crashing)
    with pytest.raises(ResultFileError, match="1.h5 cannot be read as HDF5: the HDF5 library crashes"):
        hdf5.read_all(paths)


def test_a_pipe_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    for path in (tmp_path / "pipe.h5", Path("/dev/zero")):
        with pytest.raises(ResultFileError, match="pipe or a device"):
            read(path)


def test_a_dataset_that_is_not_there_is_named_with_those_that_are() -> None:
    result = Result("simulate", "x", "ok", "")
    result.add("time", np.zeros(2))
    with pytest.raises(KeyError, match=r"no dataset 'tine' \(did you mean 'time'\?\); allowed: time"):
        result["tine"]
