"""Comparison of two results, and the catalogue that names their paths."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.results import catalogue
from robodyn_cli.results.compare import compare
from robodyn_cli.results.hdf5 import read, write
from robodyn_cli.results.result import Result
from tests.unit.synthetic_results import inverse_result

DOC = Path(__file__).parents[2] / "docs" / "hdf5.md"


def test_equal_results_agree_exactly() -> None:
    found = compare(inverse_result(), inverse_result(), rtol=0.0, atol=0.0)
    assert found.agrees
    assert {item.verdict for item in found.differences} == {"equal"}


def test_the_worst_sample_is_named() -> None:
    result, baseline = inverse_result(), inverse_result()
    result["tau"][123, 1] += 1e-3
    result["q"][5, 0] += 1e-15
    found = compare(result, baseline, rtol=1e-9, atol=1e-12)
    worst = found.differences[0]
    assert not found.agrees
    assert (worst.path, worst.verdict, worst.column) == ("tau", "differs", "theta2")
    assert worst.time == baseline.time[123]
    assert worst.error == pytest.approx(1e-3)
    assert worst.value - worst.expected == pytest.approx(1e-3)
    assert worst.ratio == pytest.approx(1e-3 / (1e-12 + 1e-9 * np.abs(baseline["tau"][:, 1]).max()))
    assert all(item.verdict == "equal" for item in found.differences[1:])


def test_a_zero_crossing_is_no_trap() -> None:
    result, baseline = inverse_result(), inverse_result()
    result["qd"][:] += 1e-12
    assert compare(result, baseline, rtol=1e-9, atol=0.0).agrees
    baseline["qd"][7] = result["qd"][7] = 0.0
    result["qd"][7] += 1e-12
    assert not compare(result, baseline, rtol=1e-9, atol=0.0, relative_to="sample").agrees


def test_what_cannot_be_compared_says_why() -> None:
    result, baseline = inverse_result(), inverse_result()
    result.variables["q"].units = "deg"
    result.variables["qd"].names = ("b", "a")
    result.variables["tau"].data = result["tau"][:-1]
    del result.variables["qdd"]
    result.add("energy/total", result.time)
    verdicts = {item.path: item.verdict for item in compare(result, baseline).differences}
    assert [verdicts[path] for path in ("q", "qd", "tau", "qdd", "energy/total")] == [
        "units",
        "names",
        "shape",
        "missing",
        "extra",
    ]


def test_numbers_that_are_none() -> None:
    a, b = Result("x", "", "ok", ""), Result("x", "", "ok", "")
    for result in (a, b):
        result.add("time", [0.0, np.nan, np.inf, -np.inf])
    assert compare(a, b, rtol=0.0, atol=0.0).agrees
    a["time"][0] = np.nan
    found = compare(a, b)
    assert not found.agrees and found.differences[0].error == np.inf


def test_lookup_finds_names_from_the_scene() -> None:
    assert catalogue.lookup("/q") is catalogue.lookup("q")
    assert catalogue.lookup("points/tip").path == "points/NAME"
    assert catalogue.lookup("frames/tool 1/twist").names[0] == "wx"
    assert catalogue.lookup("points/a/b") is None
    assert catalogue.lookup("pointsx/tip") is None


def test_result_takes_what_is_missing_from_the_catalogue() -> None:
    result = Result("x", "", "ok", "")
    result.add("points/tip", np.zeros((2, 3)))
    variable = result.variables["points/tip"]
    assert (variable.units, variable.dims, variable.names) == ("m", ("time", "axis"), ("x", "y", "z"))
    with pytest.raises(ValueError, match="dimensions"):
        result.add("q", np.zeros(3))
    with pytest.raises(ValueError, match="names"):
        result.add("q", np.zeros((1, 3)), names=("a",))
    assert list(result.group("points")) == ["tip"]


def test_the_reference_lists_exactly_the_paths_of_the_catalogue() -> None:
    rows = re.findall(r"^\| `/([^`]+)` \| (.*) \| (.*) \| (.*) \|$", DOC.read_text(encoding="utf-8"), re.M)
    documented = {path: (dims, units, meaning) for path, dims, units, meaning in rows}
    entries = (*catalogue.ENTRIES, *catalogue.EVENT_ENTRIES)
    assert documented == {e.path: (", ".join(e.dims), e.units, e.long_name) for e in entries}


def test_the_reference_lists_exactly_the_attributes_of_the_catalogue() -> None:
    rows = re.findall(r"^\| `([^/`]+)` \| (.*) \| (.*) \|$", DOC.read_text(encoding="utf-8"), re.M)
    assert rows == [(entry.name, entry.kind, entry.meaning) for entry in catalogue.ATTRIBUTES]


def test_events_are_compared_by_order_and_time() -> None:
    result, baseline = inverse_result(), inverse_result()
    for one in (result, baseline):
        one.events = [
            {"time": 0.1, "name": "hinge", "kind": "stick"},
            {"time": 0.3, "name": "hinge", "kind": "slip"},
        ]
    assert compare(result, baseline).agrees
    result.events[1]["time"] = 0.3001
    worst = compare(result, baseline).differences[0]
    assert (worst.path, worst.verdict, worst.column, worst.time) == (
        "events/time",
        "differs",
        "slip of hinge",
        0.3,
    )
    result.events[1]["kind"] = "impact"
    worst = compare(result, baseline).differences[0]
    assert worst.verdict == "shape" and "impact of hinge instead of slip of hinge" in worst.detail
    del result.events[1]
    assert compare(result, baseline).differences[0].detail == "1 events instead of 2"


def test_datasets_without_numbers_are_compared_entry_by_entry(tmp_path: Path) -> None:
    """Text, truth values and whatever else HDF5 holds, in a file that somebody has added to."""
    import h5py

    def stored(name: str, add: Mapping[str, Any]) -> Result:
        path = write(inverse_result(), tmp_path / name)
        with h5py.File(path, "r+") as file:
            for key, data in add.items():
                file[key] = data
        return read(path)

    text = {"notes/who": ["Ada", "Emmy"], "flag": np.array([True, False])}
    baseline = stored("a.h5", text)
    same = {item.path: item.verdict for item in compare(stored("b.h5", text), baseline).differences}
    assert same["notes/who"] == same["flag"] == "equal"
    for key, changed, verdict in (
        ("notes/who", ["Ada", "Emma"], "entries"),
        ("notes/who", ["Ada"], "shape"),
        ("flag", np.array([True, True]), "entries"),
    ):
        found = compare(stored("c.h5", {**text, key: changed}), baseline)
        assert not found.agrees
        assert (found.differences[0].path, found.differences[0].verdict) == (key, verdict)
    assert not compare(read(write(inverse_result(), tmp_path / "d.h5")), baseline).agrees
