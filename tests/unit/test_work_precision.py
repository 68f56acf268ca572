"""Work-precision: references that do not agree, methods that cannot, gains of the curves."""

from __future__ import annotations

from pathlib import Path

import pytest

from robodyn_cli import load_scene
from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.build import build_system
from robodyn_cli.run.driver.prepare import prepare
from robodyn_cli.run.numerics import work_precision as module
from robodyn_cli.run.numerics.work_precision import reference, work_precision

CONFIGS = Path(__file__).parents[2] / "configs"


def test_methods_that_cannot_are_told_once() -> None:
    found = work_precision(
        load_scene(CONFIGS / "double_pendulum.yaml"), ["gauss", "verlet"], [1e-6, 1e-9], repeats=1
    )
    runs = [r for r in found.summary["runs"] if r["method"] == "verlet"]
    assert [r["status"] for r in runs] == ["unsupported"]
    assert runs[0]["tolerance"] is None and runs[0]["step"] is None and runs[0]["error"] is None
    assert all(r["status"] == "ok" for r in found.summary["runs"] if r["method"] == "gauss")


def test_loops_are_compared_with_chosen_gains() -> None:
    found = work_precision(load_scene(CONFIGS / "four_bar_deploy.yaml"), ["gauss"], [1e-8], repeats=1).summary
    assert {r["formulation"] for r in found["runs"]} >= {"projection", "baumgarte", "none"}
    assert found["baumgarte"]["met"] and found["baumgarte"]["alpha"] == found["baumgarte"]["beta"]
    assert all(r["error"] < 1e-5 for r in found["runs"])


def test_references_that_never_agree_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    setup = prepare(load_scene(CONFIGS / "double_pendulum.yaml"))
    system = build_system(setup.problem, work=False)
    monkeypatch.setattr(module, "REFERENCES", (("gauss", 1e-13), ("rk4", 1e-13)))
    with pytest.raises(NumericalError, match="there is no reference"):
        reference(system, system.join(setup.assembled.q, setup.assembled.v), 10.0)
