"""Work-precision: references that do not agree, methods that cannot, gains of the curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from robodyn_cli import deploy, load_scene
from robodyn_cli.errors import NumericalError
from robodyn_cli.motion.build import build_motion
from robodyn_cli.over.work_precision import entries
from robodyn_cli.over.work_precision.work_precision import reference, work_precision

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
    motion = build_motion(load_scene(CONFIGS / "double_pendulum.yaml"), work=False)
    monkeypatch.setattr(entries, "REFERENCES", ("gauss", "implicit_midpoint"))
    with pytest.raises(NumericalError, match="there is no reference"):
        reference(motion, 10.0)


def test_a_deployment_is_compared_by_the_time_of_its_lock() -> None:
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml")
    tolerances = [1e-4, 1e-7, 1e-10]
    found = work_precision(scene, ["gauss", "dop853", "radau13", "rk4"], tolerances, repeats=1).summary
    lock = deploy(scene).summary["lock"]["time"]
    assert found["lock_time"] == pytest.approx(lock, abs=1e-10) == found["compared_until"]
    assert found["reference_digits"] > 11 and "lock" in found["error_norm"]
    ok = [run for run in found["runs"] if run["status"] == "ok"]
    for run in ok:
        assert run["error"] == abs(run["lock_time"] - found["lock_time"]) and run["run_time_s"] > 0.0
        assert 10 < run["steps"] < 200_000
    for method in ("gauss", "dop853", "radau13"):
        for formulation in ("projection", "independent", "baumgarte", "none"):
            errors = [r["error"] for r in ok if (r["method"], r["formulation"]) == (method, formulation)]
            assert len(errors) == 3 and errors[2] < 1e-8 and errors[2] < 1e-2 * errors[0]
    steps = [r["error"] for r in ok if (r["method"], r["formulation"]) == ("rk4", "none")]
    assert steps[4] / steps[5] == pytest.approx(16, rel=0.5)  # of order four


def test_a_mechanism_that_never_locks_is_compared_by_its_motion() -> None:
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml", ["simulate.duration=8"])
    found = work_precision(scene, ["gauss"], [1e-8], repeats=1).summary
    assert "lock_time" not in found and found["compared_until"] == 8.0


@pytest.mark.parametrize(
    ("name", "changes", "methods"),
    [
        ("stick_slip", (), ["gauss", "rodas5p"]),
        ("bouncing_pendulum", ("simulate.duration=1.5",), ["dop853", "rodas5p"]),
        ("benchmarks/four_bar_n2", ("simulate.duration=2",), ["gauss", "dop853"]),
    ],
)
def test_contact_states_and_passages_are_followed(
    name: str, changes: Sequence[str], methods: list[str]
) -> None:
    """Methods agree through sticking, slipping, impacts and singular poses, at the error that they are asked for."""
    scene = load_scene(CONFIGS / f"{name}.yaml", changes)
    found = work_precision(scene, methods, [1e-5, 1e-9], repeats=1).summary
    own = [r for r in found["runs"] if r["formulation"] in ("tree", "projection")]
    assert found["reference_digits"] > 9 and found["compared_until"] > 0.0
    assert [r["status"] for r in own] == ["ok"] * 4
    for loose, tight in zip(own[::2], own[1::2]):
        assert tight["error"] < 1e-4 and tight["error"] < loose["error"]
