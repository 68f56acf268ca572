"""What a run says beside its figures: units, warnings."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.tool import CONFIGS, environment, invoke, run

MIXED = """\
schema: 1
title: A slide with an arm
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: slide, type: prismatic, axis: [0, 1, 0]}
    - {name: arm, type: revolute, axis: [0, 0, 1]}
  links:
    - {name: carriage, mass: 1, com: [0, 0, 0]}
    - {name: rod, mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.1}}
trajectory: {type: joint, duration: 2, q: {slide: 0.1*sin(t), arm: t}}
"""


def test_figures_have_units(tmp_path: Path) -> None:
    done = invoke("inverse", CONFIGS / "2r_circle.yaml", "--no-plots", "--out", tmp_path)
    assert "peak torque [N m]" in done.out and "peak speed [rad/s]" in done.out
    (tmp_path / "mixed.yaml").write_text(MIXED)
    done = invoke("inverse", tmp_path / "mixed.yaml", "--no-plots", "--out", tmp_path / "out")
    slide, arm = (line for line in done.out.splitlines() if line.startswith(("  slide", "  arm")))
    assert "19.62 N " in slide and "m/s" in slide and "4.905 N m" in arm and "rad/s" in arm


@pytest.mark.parametrize(
    ("q", "warned"), [("{theta1: 150.46230228 deg}", True), ("{theta1: 150 deg}", False)]
)
def test_a_start_that_has_closed_in_a_dead_point(q: str, warned: bool, tmp_path: Path) -> None:
    words = (
        "--set",
        f"initial={{q: {q}}}",
        "--set",
        "simulate.duration=0.1",
        "--no-plots",
        "--out",
        tmp_path,
    )
    done = invoke("simulate", CONFIGS / "four_bar_deploy.yaml", *words, "--json")
    assert done.code == 0
    assert (
        ("warnings" in done.data)
        == warned
        == ("robodyn: warning: the loops have closed in a dead point" in done.err)
    )
    if warned:
        assert "initial.hold" in done.data["warnings"][0] and "theta1 2.626" in done.data["warnings"][0]


@pytest.mark.skipif(os.name != "posix", reason="rights as POSIX has them")
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("simulate", "double_pendulum.yaml"), 1),
        (("run", "double_pendulum.yaml", "spinning_top.yaml", "--jobs", "2"), 1),
        (("work-precision", "double_pendulum.yaml", "--methods", "gauss", "--repeats", "1"), 1),
        (("simulate", "double_pendulum.yaml", "--quiet"), 0),
        (("validate", "double_pendulum.yaml"), 0),
    ],
)
def test_a_place_that_others_may_write_to_is_told_once(
    words: tuple[str, ...], told: int, tmp_path: Path
) -> None:
    """Not as a warning about the result, which is the same."""
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    given = [CONFIGS / word if word.endswith(".yaml") else word for word in words]
    out = [] if words[0] == "validate" else ["--no-plots", "--out", tmp_path / "out"]
    done = run(*given, *out, env=environment(ROBODYN_CACHE=str(shared)))
    assert done.code == 0 and done.err.count("compiled code is not kept") == told
    assert not list(shared.iterdir())
    for summary in (tmp_path / "out").rglob("summary.json"):
        assert "compiled code" not in summary.read_text()
