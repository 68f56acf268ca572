"""Comparison of two results, and the catalogue that names their paths."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from robodyn_cli.results import catalogue
from robodyn_cli.results.compare import compare
from robodyn_cli.results.hdf5 import read, write
from robodyn_cli.results.result import Result
from tests.unit.synthetic_results import inverse_result


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


def test_datasets_of_one_number() -> None:
    a, b = Result("x", "", "ok", ""), Result("x", "", "ok", "")
    for result in (a, b):
        result.add("control/period", 0.01)
    assert compare(a, b, rtol=0.0, atol=0.0).agrees
    b.variables["control/period"].data = np.array(0.02)
    found = compare(a, b)
    assert not found.agrees and found.differences[0].error == pytest.approx(0.01)


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


def test_lookup_asks_few_patterns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those with the same first part and as many parts; large results hold thousands of paths."""
    asked: list[str] = []
    fits = catalogue._fits

    def count(path: str, pattern: str) -> bool:
        asked.append(pattern)
        return fits(path, pattern)

    monkeypatch.setattr(catalogue, "_fits", count)
    entries = catalogue.ENTRIES
    for entry in entries:
        path = "/".join("a b" if len(x) > 1 and x.isupper() else x for x in entry.path.split("/"))
        found = [one for one in entries if one.path == path] + [
            one for one in entries if fits(path, one.path)
        ]
        assert catalogue.lookup(path) is found[0], path
        assert catalogue.lookup(entry.path) is entry
    assert len(asked) < 3 * len(entries)
    asked.clear()
    assert catalogue.lookup("points/tip") is not None and len(asked) <= 2


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


def stating(**summary: Any) -> Result:
    """Return a short result that says this in its summary."""
    result = Result("simulate", "", "ok", "", summary=summary)
    result.add("time", [0.0, 1.0, 2.0])
    result.add("q", np.array([[0.0, 1.0], [1.0, 2.0], [2.0, 3.0]]), names=("a", "b"))
    result.add("energy/total", [5.0, 5.0, 5.0])
    result.add("points/tip", np.ones((3, 3)))
    return result


def test_a_difference_stands_beside_the_errors_that_both_results_state() -> None:
    first, second = (stating(error_estimate={"q_max": error}) for error in (1e-6, 3e-6))
    first["q"][1, 0] += 3.9e-6
    first["points/tip"][2, 1] += 1e-3
    found = {item.path: item for item in compare(first, second).differences}
    assert found["q"].verdict == "differs" and found["q"].stated == pytest.approx(4e-6)
    assert found["q"].within_stated is True and "within the stated errors, 4e-06" in found["q"].text
    # the largest difference is judged, not the one that is worst beside its column
    first["q"][2, 1] += 4.1e-6
    worst = compare(first, second).differences[1]
    assert (worst.path, worst.column, worst.within_stated) == ("q", "a", False)
    assert "beyond the stated errors" in worst.text
    assert found["points/tip"].stated is None is found["points/tip"].within_stated
    assert "no error stated" in found["points/tip"].text


def test_both_results_must_state_an_error() -> None:
    first, second = stating(error_estimate={"q_max": 1e-3}), stating(error_estimate=None)
    first["q"][1, 0] += 1e-6
    assert compare(first, second).differences[0].stated is None
    # the structure behind a lock states its own
    lock: dict[str, Any] = {
        "error_estimate": {"q_max": 1e-9},
        "after_lock": {"error_estimate": {"q_max": 2e-9}},
    }
    found = {item.path: item.stated for item in compare(stating(**lock), stating(**lock)).differences}
    assert found["q"] == pytest.approx(6e-9)
    lock["after_lock"] = {"error_estimate": None}
    assert all(item.stated is None for item in compare(stating(**lock), stating(**lock)).differences)


def test_drift_is_the_error_of_an_energy_that_stays_the_same() -> None:
    for balance, known in (("kinetic + potential", True), ("kinetic + potential - work", False)):
        result = stating(energy_drift=1e-8, energy_balance=balance)
        found = {item.path: item for item in compare(result, result).differences}
        assert (found["energy/total"].stated == pytest.approx(2e-8)) is known
        assert (found["energy/total"].within_stated is None) is not known


def test_a_lock_states_the_error_of_its_time() -> None:
    locked = [
        stating(lock={"time": 2.0, "time_error": 1e-3}),
        stating(lock={"time": 2.002, "time_error": 1e-3}),
    ]
    locked[1]["time"][2] = 2.002
    for result in locked:
        result.events = [
            {"time": 0.5, "name": "a", "kind": "stick"},
            {"time": result.time[2], "name": "pin", "kind": "lock"},
        ]
    found = {item.path: item for item in compare(*locked).differences}
    for path in ("time", "events/time"):
        assert found[path].stated == pytest.approx(2e-3) and found[path].within_stated
    locked[0].events[0]["time"] = 0.4
    found = {item.path: item for item in compare(*locked).differences}
    assert found["events/time"].column == "stick of a" and found["events/time"].stated is None


def test_a_study_states_the_error_of_each_run() -> None:
    studies = []
    for shift in (0.0, 1e-5):
        result = Result("sweep", "", "ok", "")
        result.add("outputs/x", [1.0, 2.0 + shift, 3.0 + shift], units="1", long_name="x", dims=("run",))
        result.add("errors/x", [1e-6, 1e-6, 1e-3], units="1", long_name="error of x", dims=("run",))
        studies.append(result)
    worst = compare(*studies).differences[0]
    assert (worst.path, worst.column, worst.within_stated) == ("outputs/x", "run 1", False)
    assert worst.stated == pytest.approx(2e-6)


def test_status_comes_first_and_clocks_are_left_out() -> None:
    first, second = stating(), stating()
    first.status, first.variables["q"].units = "no_lock", "deg"
    for result, seconds in ((first, 1.0), (second, 2.0)):
        result.add("stability/methods", [[1e-3, seconds]], units="1, s", long_name="", dims=("trial", "quantity"),
                   names=("error", "seconds"))  # fmt: skip
    found = compare(first, second).differences
    assert [(item.path, item.verdict) for item in found[:2]] == [("status", "entries"), ("q", "units")]
    assert found[0].detail == "no_lock instead of ok"
    assert {item.path: item.verdict for item in found}["stability/methods"] == "equal"


def over_time(times: Any, **summary: Any) -> Result:
    """Return a result whose angle is the square of the time."""
    result = Result("simulate", "x", "ok", "", summary=summary)
    result.add("time", times)
    result.add("q", np.square(times)[:, None], names=("a",), units="rad", dims=("time", "joint"))
    return result


@pytest.mark.parametrize(
    ("times", "others", "common"),
    [
        (np.linspace(0, 10, 1001), np.linspace(0, 20, 1001), 501),
        (np.linspace(0, 1, 5), np.linspace(0, 1, 3), 3),
        (np.array([0.0, 0.3, 0.3, 0.5]), np.array([0.0, 0.3, 0.3, 0.6]), 1),
        (np.array([0.1]), np.array([0.2]), 0),
    ],
)
def test_samples_at_other_times_are_compared_at_common_ones(times: Any, others: Any, common: int) -> None:
    found = compare(over_time(times), over_time(others)).differences
    assert found[0].path == "time" and not found[0].agrees
    assert (f"the {common} common times" if common else "no common time") in found[0].text
    assert found[1].path == "q" and found[1].verdict == "equal"
    changed = over_time(times)
    changed["q"][0] += 1e-3
    worst = compare(changed, over_time(others)).differences[1]
    assert worst.agrees is (common == 0)
    if common:
        assert (
            worst.time == 0.0 and worst.error == pytest.approx(1e-3) and "worst 0.001 rad of a" in worst.text
        )


def test_results_of_other_lengths_say_so_first(tmp_path: Path) -> None:
    for name, count in (("long", 5), ("short", 3)):
        result = over_time(np.linspace(0.0, 1.0, count))
        for k in range(8):
            result.add(f"rows/{k}", np.zeros(count + 1), units="1", dims=("row",), long_name="no motion")
        result.title = name
        write(result, tmp_path / f"{name}.h5")
    done = CliRunner().invoke(app, ["compare", str(tmp_path / "long.h5"), str(tmp_path / "short.h5")])
    assert done.exit_code == 1
    lines = done.output.splitlines()
    assert lines[0] == "scenes    'long' instead of 'short'"
    assert lines[1].split()[:2] == ["shape", "time"] and "5 samples until 1 s instead of 3" in lines[1]
    assert lines[2].endswith("rows/5 and 2 more  (6,) instead of (4,)") and lines[3].split()[:2] == [
        "equal",
        "q",
    ]
    assert lines[4].startswith("10 datasets: 9 differ")
