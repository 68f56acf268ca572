"""``robodyn compare`` of whole directories, and ``robodyn run --baseline``."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from robodyn_cli.over.batch import reports as baseline_module
from robodyn_cli.results import atomic
from robodyn_cli.results.hdf5 import read, write
from tests.cli.batch_scenes import arm, run
from tests.cli.tool import invoke

PASSES = "expect: {status: ok}"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three scenes and their results."""
    root = tmp_path_factory.mktemp("finished")
    for name, motion in (("a", "sin(t)"), ("b", "cos(t)"), ("deep/c", "t^2")):
        arm(root / "scenes" / f"{name}.yaml", PASSES, motion=motion)
    assert run(root / "scenes", "--out", root / "out")[0] == 0
    return root


@pytest.fixture
def batch(finished: Path, tmp_path: Path) -> Path:
    """Three scenes, of which results lie in ``out`` and, the same, in ``base``."""
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    shutil.copytree(finished / "out", tmp_path / "base", ignore=shutil.ignore_patterns(".lock"))
    return tmp_path


def shift(directory: Path, by: float) -> None:
    """Change a stored torque."""
    path = directory / "result.h5"
    result = read(path)
    result["tau"][3] += by
    write(result, path)


def files(root: Path) -> dict[str, bytes]:
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def compared(batch: Path, *more: str) -> tuple[int, list[dict[str, Any]]]:
    done = invoke("compare", batch / "out", batch / "base", "--json", *more)
    assert done.data["exit_code"] == done.code
    return done.code, done.data["results"]


# -- two directories -------------------------------------------------------------------------------------
def test_directories_that_agree(batch: Path) -> None:
    code, rows = compared(batch)
    assert code == 0 and {(row["result"], row["verdict"]) for row in rows} == {
        (f"{name}/inverse", "equal") for name in "abc"
    }
    assert (
        invoke("compare", batch / "out", batch / "base").out
        == "3 results: 3 agree (rtol 1e-09, atol 1e-12)\n"
    )


def test_worst_first_then_what_is_only_here(batch: Path) -> None:
    shift(batch / "out/a/inverse", 1e-6)
    shift(batch / "out/b/inverse", 1e-3)
    shutil.move(batch / "out/c", batch / "out/d")
    code, rows = compared(batch)
    assert code == 1
    assert [(row["result"], row["verdict"]) for row in rows] == [
        ("c/inverse", "missing"), ("b/inverse", "differs"), ("a/inverse", "differs"), ("d/inverse", "extra")
    ]  # fmt: skip
    worst = rows[1]["datasets"]
    assert [row["path"] for row in worst] == ["tau"] and worst[0]["error"] == pytest.approx(1e-3)
    assert worst[0]["within_stated"] is False and 0.0 < worst[0]["stated"] < 1e-12
    told = invoke("compare", batch / "out", batch / "base").out
    assert told.splitlines()[0] == "missing     c/inverse  only in the baseline"
    assert "tau: worst 0.001 N m of swing at t = 0.3 s" in told and "beyond the stated errors" in told
    assert told.splitlines()[-1].startswith("4 results: 1 missing, 2 differ, 1 extra")
    shutil.rmtree(batch / "base/c")
    assert compared(batch, "--atol", "0.01")[0] == 0, "results that only the new directory has do not matter"


def test_a_damaged_file_does_not_hide_the_others(batch: Path) -> None:
    (batch / "out/a/inverse/result.h5").write_bytes(b"no HDF5")
    shift(batch / "out/b/inverse", 1e-3)
    code, rows = compared(batch)
    assert code == 2 and [row["verdict"] for row in rows] == ["unreadable", "differs", "equal"]
    assert "cannot be read" in rows[0]["message"]


def test_a_run_that_failed_without_samples_has_its_status(batch: Path) -> None:
    for root in ("out", "base"):
        place = batch / root / "a" / "inverse"
        (place / "result.h5").unlink()
        (place / "summary.json").write_text('{"status": "failed", "command": "inverse", "run_id": "1"}')
    assert compared(batch)[0] == 0
    shutil.rmtree(batch / "base")
    shutil.copytree(batch / "out", batch / "base")
    (batch / "base/a/inverse/summary.json").write_text(
        '{"status": "ok", "command": "inverse", "run_id": "1"}'
    )
    code, rows = compared(batch)
    assert code == 1 and rows[0]["datasets"][0]["detail"] == "failed instead of ok"


def test_what_cannot_be_compared(batch: Path) -> None:
    for words in ((batch / "out", batch / "base/a/inverse"), (batch / "base/a/inverse", batch / "out")):
        done = invoke("compare", *words)
        assert done.code == 2 and "is no directory with results below it" in done.err
    (batch / "empty").mkdir()
    done = invoke("compare", batch / "out", batch / "empty")
    assert done.code == 2 and "there is no result in it" in done.err


# -- run --baseline --------------------------------------------------------------------------------------
def again(batch: Path, *words: object) -> tuple[int, dict[str, Any]]:
    return run(batch / "scenes", "--out", batch / "out", "--baseline", batch / "base", *words)


def test_a_batch_that_agrees_with_its_baseline(batch: Path) -> None:
    code, scenes = again(batch)
    assert code == 0 and all(scene["baseline"]["verdict"] == "equal" for scene in scenes.values())
    summary = batch / "out/a/inverse/summary.json"
    before = json.loads(summary.read_text())
    assert before["baseline"]["verdict"] == "equal"
    assert "baseline" not in run(batch / "scenes", "--out", batch / "out")[1]["a"]
    after = json.loads(summary.read_text())
    assert after == {key: value for key, value in before.items() if key != "baseline"}


def test_a_difference_is_a_failure_of_its_scene(batch: Path) -> None:
    shift(batch / "base/b/inverse", 1e-3)
    xml, text = batch / "junit.xml", batch / "report.md"
    code, scenes = again(batch, "--junit", xml, "--markdown", text)
    assert code == 1
    assert {name: scene["verdict"] for name, scene in scenes.items()} == {"a": "ok", "b": "failed", "c": "ok"}
    found = scenes["b"]["baseline"]
    assert found["directory"] == str(batch / "base") and found["verdict"] == "differs"
    assert found["datasets"][0]["path"] == "tau" and found["datasets"][0]["within_stated"] is False
    # reports of the result find it in its summary
    assert json.loads((batch / "out/b/inverse/summary.json").read_text())["baseline"] == found
    failure = ElementTree.parse(xml).find(".//failure")
    assert failure is not None and "baseline: tau: worst 0.001" in failure.attrib["message"]
    assert "- b: baseline: tau: worst 0.001" in text.read_text()
    assert again(batch, "--atol", "0.01")[0] == 0


def test_a_scene_without_a_baseline_fails(batch: Path) -> None:
    shutil.rmtree(batch / "base/a")
    code, scenes = again(batch)
    assert code == 1 and scenes["a"]["verdict"] == "failed" and scenes["a"]["baseline"]["verdict"] == "extra"
    assert "--update-baseline" in scenes["a"]["baseline"]["message"]


def test_an_unreadable_baseline_is_an_error(batch: Path) -> None:
    (batch / "base/a/inverse/result.h5").write_bytes(b"no HDF5")
    code, scenes = again(batch)
    assert code == 2 and scenes["a"]["verdict"] == "error" and scenes["b"]["verdict"] == "ok"


def test_update_stores_what_differs_and_is_new_and_nothing_else(batch: Path) -> None:
    shift(batch / "base/b/inverse", 1e-3)
    shutil.rmtree(batch / "base/a")
    arm(batch / "scenes/wrong.yaml", "expect: {status: locked}")
    before = files(batch / "base/c")
    code, scenes = again(batch, "--update-baseline")
    assert code == 1, "an expectation does not hold"
    assert {name: scene["baseline"]["updated"] for name, scene in scenes.items()} == {
        "a": True, "b": True, "c": False, "wrong": False
    }  # fmt: skip
    assert files(batch / "base/c") == before
    assert not (batch / "base/wrong").exists(), "what is wrong becomes no baseline"
    for name in "ab":
        # the result file alone: a summary or drawings of an older run beside it would be of another one
        assert files(batch / "base" / name) == {
            "inverse/result.h5": (batch / "out" / name / "inverse/result.h5").read_bytes()
        }
    (batch / "scenes/wrong.yaml").unlink()
    code, scenes = again(batch)
    assert code == 0 and all(scene["baseline"]["verdict"] == "equal" for scene in scenes.values())


def test_an_update_says_what_it_did(batch: Path) -> None:
    shift(batch / "base/b/inverse", 1e-3)
    shutil.rmtree(batch / "base/a")
    arm(batch / "scenes/wrong.yaml", "expect: {status: locked}")
    words = ("--out", batch / "out", "--baseline", batch / "base", "--no-plots")
    told = invoke("run", batch / "scenes", *words, "--update-baseline").out
    assert f"baseline {batch / 'base'}: 1 new, 1 replaced, 1 equal, 1 left as it was, not ok: wrong\n" in told
    assert "baseline: new" in told and "--update-baseline stores" not in told


def test_an_update_makes_the_directory(batch: Path) -> None:
    shutil.rmtree(batch / "base")
    done = invoke("run", batch / "scenes", "--out", batch / "out", "--baseline", batch / "base", "--no-plots")
    assert done.code == 2 and "--update-baseline makes one" in done.err
    assert again(batch, "--update-baseline")[0] == 0
    assert sorted(files(batch / "base")) == [f"{name}/inverse/result.h5" for name in "abc"]
    assert again(batch)[0] == 0


def test_a_baseline_is_not_half_written(batch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk is full when the last of three results is copied."""
    for name in "abc":
        shift(batch / "base" / name / "inverse", 1e-3)
    before = files(batch / "base")
    copies: list[Path] = []

    def copyfile(source: Path, target: Path) -> None:
        copies.append(target)
        target.write_bytes(source.read_bytes()[:100])
        if len(copies) == 3:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(baseline_module.shutil, "copyfile", copyfile)
    words = ("--out", batch / "out", "--baseline", batch / "base", "--update-baseline", "--no-plots")
    done = invoke("run", batch / "scenes", *words)
    assert len(copies) == 3 and done.code == 74 and "No space left" in done.err
    assert files(batch / "base") == before
    assert not any(atomic.is_temporary(path) for path in (batch / "base").rglob("*"))


def test_a_run_that_is_expected_to_leave_nothing(batch: Path) -> None:
    """A stored result of a scene that ends without any now is a difference; an update removes it."""
    text = (batch / "scenes/a.yaml").read_text()
    (batch / "scenes/a.yaml").write_text(
        text.replace("mass: 1.2, ", "").replace("{status: ok}", "{exit_code: 2}")
    )
    code, scenes = again(batch)
    assert code == 1 and scenes["a"]["baseline"]["verdict"] == "missing"
    assert again(batch, "--update-baseline")[0] == 0 and files(batch / "base/a") == {}
    code, scenes = again(batch)
    assert code == 0 and "baseline" not in scenes["a"]


def test_wrong_usage(batch: Path) -> None:
    done = invoke("run", batch / "scenes", "--update-baseline")
    assert done.code == 2 and "needs --baseline DIR" in done.err
    done = invoke("run", batch / "scenes", "--out", batch / "out", "--baseline", batch / "out")
    assert done.code == 2 and "where the results of this batch go" in done.err
