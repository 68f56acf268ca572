"""``robodyn stability`` as a program: files, exit codes, and the suite."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import pytest

from robodyn_cli.over.stability import suite as stability_suite
from robodyn_cli.over.stability.cases import CASES, Case
from robodyn_cli.over.stability.suite import judge
from robodyn_cli.results.hdf5 import read
from robodyn_cli.summaries.stability import MethodTrial
from tests.cli.tool import files, invoke

CONFIGS = Path(__file__).parents[2] / "configs"


OTHERS = 3  # methods that a case is tried by beside auto


@pytest.fixture
def in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the suite try each case by auto and by some of the other methods, each of them in many cases."""
    places = itertools.count()
    attempts = stability_suite.attempts

    def some(scene: Any, ref: Any, budget: Any, names: list[str]) -> Any:
        first, others = OTHERS * next(places), names[1:]
        return attempts(
            scene, ref, budget, [names[0], *(others[(first + k) % len(others)] for k in range(OTHERS))]
        )

    monkeypatch.setattr(stability_suite, "attempts", some)


@pytest.mark.further
def test_suite_quick(in_turn: None, tmp_path: Path) -> None:
    """Every case does what is expected of it; nothing hangs, returns NaN or is wrong without saying so."""
    done = invoke("stability", "--suite", "--quick", "--json", "--out", tmp_path)
    summary = done.data
    assert done.code == 0, [c["found"] for c in summary["cases"] if not c["holds"]]
    assert summary["missed"] == 0 and len(summary["cases"]) == len(CASES)
    for case in summary["cases"]:
        for name, trial in case["methods"].items():
            assert trial["status"] in ("stable", "inaccurate", "diverged", "too_slow", "unsupported"), name
    tried = [name for case in summary["cases"] for name in case["methods"]]
    assert tried.count("auto") == len(CASES)
    counts = {name: tried.count(name) for name in tried}
    assert set(counts) == set(summary["methods"]) and min(counts.values()) >= 7, counts
    assert (tmp_path / "stability_suite.png").stat().st_size > 10_000
    assert (tmp_path / "spring_1e6.yaml").exists()
    assert read(tmp_path / "result.h5")["suite/relative_error"].shape[0] == len(CASES)


def test_scene(tmp_path: Path) -> None:
    scene = CONFIGS / "benchmarks" / "simple_pendulum.yaml"
    done = invoke("stability", scene, "--quick", "-v", "--out", tmp_path)
    assert done.code == 0 and "largest steps" in done.out
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert {"load", "reference", "spectrum", "methods", "energy", "write", "plots"} <= set(
        summary["wall_time_s"]
    )
    assert {"stability_spectrum.png", "stability_methods.png", "energy_growth.png"} <= set(summary["outputs"])


def test_a_scene_that_cannot_start(scene: Path, tmp_path: Path) -> None:
    """What is wrong with a scene is told, and kept, as by every other command on scenes."""
    out = tmp_path / "out"
    flaws = ("robot.links.l1.inertia={xx: 0.1, yy: 0.1, zz: 5}", "robot.links.l2={name: l2, mass: 0}")
    done = invoke("stability", scene, "--quick", "--set", flaws[0], "--set", flaws[1], "--out", out)
    assert done.code == 3 and "warning" in done.err and "triangle" in done.err and "'j2'" in done.err
    assert files(out) == {"summary.json"}
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["command"], summary["status"]) == ("stability", "failed")
    assert summary["error"]["kind"] == "NumericalError" and "'j2'" in summary["error"]["message"]


def test_usage(tmp_path: Path) -> None:
    assert invoke("stability").code == 2
    assert invoke("stability", CONFIGS / "double_pendulum.yaml", "--suite").code == 2
    done = invoke("stability", "--suite", "--cases", "nonsense", "--out", tmp_path)
    assert done.code == 2 and "spring_1e6" in done.err


def test_a_missed_expectation_is_found() -> None:
    case = Case("x", lambda quick: "", "stable")
    good = MethodTrial("auto", relative=1e-9)
    hidden = MethodTrial("rk4", status="inaccurate", relative=0.1, error=0.1, estimate=1e-9, honest=False)
    assert "no reference" in judge(case, [good], None)[0]
    assert judge(Case("y", lambda quick: "", "stops", stops="NumericalError"), [good], None)
    assert "hides" in judge(case, [good, hidden], None)[-1]
