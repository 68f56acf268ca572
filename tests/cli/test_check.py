"""``robodyn check`` and ``robodyn compare``: results against criteria and against each other."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from robodyn_cli.cli.console import Console
from robodyn_cli.cli.runner import SceneRun, run_scene
from robodyn_cli.scene.load import load_scene
from tests.cli.batch_scenes import arm

PASSES = "expect: {status: ok, peak_torque.swing: < 100}"


def invoke(*words: object) -> tuple[int, str]:
    done = CliRunner().invoke(app, list(map(str, words)))
    return done.exit_code, done.stdout


def make(path: Path, **kind: Any) -> Path:
    scene = arm(path, **kind)
    quiet = Console(quiet=True)
    directory = path.with_suffix("")
    assert run_scene(SceneRun("inverse", scene, directory), quiet, lambda *_: "") == 0
    return directory


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Path]]:
    root = tmp_path_factory.mktemp("results")
    yield {
        "a": make(root / "a.yaml", rest=PASSES),
        "same": make(root / "same.yaml"),
        "other": make(root / "other.yaml", motion="sin(t) + 1e-6*t^2"),
        "longer": make(root / "longer.yaml", samples=41),
    }


def test_criteria_of_the_result_itself(results: dict[str, Path]) -> None:
    for name in (results["a"], results["a"] / "result.h5"):
        code, output = invoke("check", name)
        assert code == 0
        assert output.splitlines()[0] == "ok      status: ok (expected ok)"


def test_criteria_of_another_scene(results: dict[str, Path], tmp_path: Path) -> None:
    scene = arm(tmp_path / "strict.yaml", "expect: {peak_torque.swing: < 0.1, status: ok}")
    code, output = invoke("check", results["a"], scene, "--json")
    report = json.loads(output)
    assert code == 1 and report["status"] == "failed" and report["failed"] == 1
    assert [c["holds"] for c in report["criteria"]] == [False, True]


@pytest.mark.parametrize(
    ("rest", "words"),
    [("", "no criteria"), ("expect: {peak_torqe.swing: 1}", "did you mean 'peak_torque.swing'?")],
)
def test_criteria_that_say_nothing(rest: str, words: str, results: dict[str, Path], tmp_path: Path) -> None:
    scene = arm(tmp_path / "scene.yaml", rest)
    code, output = invoke("check", results["a"], scene, "--json")
    assert code == 2 and words in json.loads(output)["error"]["message"]


def test_what_is_no_result(tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("no HDF5")
    (tmp_path / "empty").mkdir()
    for name in ("text.h5", "empty", "absent"):
        assert invoke("check", tmp_path / name)[0] == 2
        assert invoke("compare", tmp_path / name, tmp_path / name)[0] == 2


def test_a_run_without_a_result_file(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text('{"status": "failed", "error": {"exit_code": 5}}')
    assert invoke("check", tmp_path)[0] == 2
    scene = arm(tmp_path / "scene.yaml", "expect: {exit_code: 5}")
    assert invoke("check", tmp_path, scene)[0] == 0


def test_equal_results(results: dict[str, Path]) -> None:
    code, output = invoke("compare", results["a"], results["same"])
    assert code == 0 and "all agree (rtol 1e-09, atol 1e-12)" in output


def test_different_results(results: dict[str, Path]) -> None:
    code, output = invoke("compare", results["other"], results["same"], "--json")
    report = json.loads(output)
    rows = {row["path"]: row for row in report["datasets"]}
    assert code == 1 and report["status"] == "failed"
    # q differs by 1e-6 t^2: most at the end, t = 2
    assert rows["q"]["verdict"] == "differs" and rows["q"]["column"] == "swing"
    assert rows["q"]["time"] == 2.0 and rows["q"]["error"] == pytest.approx(4e-6, rel=1e-6)
    assert rows["time"]["verdict"] == "equal"
    text = invoke("compare", results["other"], results["same"])[1]
    assert "worst 4e-06 rad of swing at t = 2 s: " in text
    assert invoke("compare", results["other"], results["same"], "--atol", "1e-3")[0] == 0
    assert invoke("compare", results["other"], results["same"], "--rtol", "1e-3")[0] == 0


def test_different_shapes(results: dict[str, Path]) -> None:
    code, output = invoke("compare", results["longer"], results["same"])
    assert code == 1 and "41 samples until 2 s instead of 21 samples until 2 s" in output
    assert "compared at the 21 common times" in output


def test_figures_of_several_results(results: dict[str, Path]) -> None:
    """Differences are to the first, with the sum of both errors; text, CSV and LaTeX say the same."""
    places = [results[name] for name in ("same", "other", "longer")]
    code, output = invoke("compare", *places, "--figures", "--json")
    report = json.loads(output)
    assert code == 0 and report["results"] == ["same", "other", "longer"]
    figures = {one["key"]: one for one in report["figures"]}
    given = [key for key, one in figures.items() if one["given"]]
    assert given == ["trajectory.q.swing", "inverse.samples"]
    torque = figures["joints.swing.peak_torque"]
    assert torque["verdict"] == "differs" and torque["values"][0]["difference"] is None
    first = torque["values"][0]
    for one in torque["values"][1:]:
        assert one["unit"] == "N m" and one["difference"] == one["value"] - first["value"]
        assert one["difference_error"] == one["error"] + first["error"] > 0.0
    assert abs(torque["values"][1]["difference"]) > torque["values"][1]["difference_error"]
    rows = list(csv.DictReader(invoke("compare", *places, "--figures", "--csv")[1].splitlines()))
    assert {row["key"] for row in rows} == set(figures)
    row = next(row for row in rows if row["key"] == "joints.swing.peak_torque")
    assert float(row["other less same"]) == torque["values"][1]["difference"]
    text = invoke("compare", *places, "--figures")[1]
    line = next(line for line in text.splitlines() if "joints.swing.peak_torque" in line)
    assert line.count("±") == 5 and "≠ " in line and " +0 " not in text and " 0 ± " in text
    lines = invoke("compare", *places, "--figures", "--latex")[1].splitlines()
    cells = [line.count("&") for line in lines if line.endswith(r"\\")]
    assert set(cells) == {6} and len(cells) == len(text.splitlines()) - 1
    assert invoke("compare", places[0], places[0], "--figures")[1].endswith(
        "figures are equal in all results\n"
    )


def test_figures_that_are_asked_for_wrongly(results: dict[str, Path]) -> None:
    one = results["same"]
    for words in ([one, "--csv"], [one, "--latex"], [one, one], [one, "--figures", "--csv", "--latex"]):
        assert invoke("compare", one, *words)[0] == 2, words


def test_criteria_are_stored_with_the_result(results: dict[str, Path]) -> None:
    assert list(load_scene(results["a"].with_suffix(".yaml")).expect) == ["status", "peak_torque.swing"]
