"""What a run says beside its figures: units, warnings."""

from __future__ import annotations

import os
import re
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
    done = invoke("inverse", CONFIGS / "2r_circle.yaml", "--no-plots", "-v", "--out", tmp_path)
    assert "peak torque [N m]" in done.out and "peak speed [rad/s]" in done.out
    (tmp_path / "mixed.yaml").write_text(MIXED)
    done = invoke("inverse", tmp_path / "mixed.yaml", "--no-plots", "-v", "--out", tmp_path / "out")
    slide, arm = (line for line in done.out.splitlines() if line.startswith(("  slide", "  arm")))
    assert re.search(r"19\.620* \+- \S+ N ", slide) and "m/s" in slide
    assert re.search(r"4\.9050* \+- \S+ N m", arm) and "rad/s" in arm


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


FOUR_BAR = CONFIGS / "four_bar_deploy.yaml"
CIRCLE = CONFIGS / "2r_circle.yaml"


@pytest.mark.parametrize(
    ("command", "scene", "setting", "code", "place", "words"),
    [
        ("simulate", FOUR_BAR, "robot.links.0.mass=null", 2, "robots/four_bar.yaml:10:5: robot.links.0", "mass of crank"),
        ("simulate", FOUR_BAR, "robot.joints.1.a=20", 5, "four_bar_deploy.yaml:9:5: loops.0", "does not close"),
        ("info", FOUR_BAR, "robot.joints.1.a=20", 5, "four_bar_deploy.yaml:9:5: loops.0", "does not close"),
        ("simulate", FOUR_BAR, "initial.qd={theta1: 1, phi1: 1, phi2: 1}", 5, "--set initial.qd=", "contradict"),
        ("deploy", CONFIGS / "double_pendulum.yaml", None, 2, "double_pendulum.yaml:3:1: loops", "closed loops"),
        ("inverse", CIRCLE, "trajectory.ik={}", 2, "--set trajectory.ik={}: trajectory.ik", "in two ways"),
        ("inverse", CIRCLE, "trajectory.center=[9, 9]", 5, "2r_circle.yaml:8:3: trajectory", "cannot reach"),
        ("inverse", CIRCLE, "actuated=[theta1]", 2, "actuated", "lacks 'theta2'"),
        ("simulate", CONFIGS / "stick_slip.yaml", "robot.joints.0.friction={coulomb: 1}", 2, "robot.joints.0", "transition_speed"),
    ],
)  # fmt: skip
def test_what_a_run_finds_wrong_has_its_place(
    command: str, scene: Path, setting: str | None, code: int, place: str, words: str, tmp_path: Path
) -> None:
    settings = () if setting is None else ("--set", setting)
    done = invoke(command, scene, *settings, "--no-plots", "--out", tmp_path / "out", "--json")
    message = done.data["error"]["message"]
    assert done.code == code and place in message and words in message, message
    assert message in done.err
    assert done.data["error"].get("details", done.data["error"])["key"], done.data


@pytest.mark.parametrize(
    ("words", "option", "told"),
    [
        (
            ("linearise", "double_pendulum.yaml", "--at", "balance", "--input", "thata1"),
            "--input",
            "did you mean",
        ),
        (("linearise", "double_pendulum.yaml", "--at", "balance", "--delay", "0.1"), "--delay", "--period"),
        (
            ("linearise", "double_pendulum.yaml", "--along", "--instants", "77"),
            "--instants",
            "outside the motion",
        ),
    ],
)
def test_what_a_run_finds_wrong_with_an_option_is_about_that_alone(
    words: tuple[str, ...], option: str, told: str, tmp_path: Path
) -> None:
    command, scene, *rest = words
    done = invoke(command, CONFIGS / scene, *rest, "--no-plots", "--out", tmp_path / "out", "--json")
    error = done.data["error"]
    assert done.code == 2 and error["option"] == option and told in error["message"], error
    assert error["message"].startswith(option) and "yaml" not in error["message"]


@pytest.mark.parametrize("when", ["from: {time: 0.4}", "until: {time: 0.4}"])
def test_payloads_that_lack_data_and_come_and_go(when: str, tmp_path: Path) -> None:
    """``info`` looks at the state before anything is gripped or released."""
    scene = tmp_path / "ball.yaml"
    ball = f"payloads: [{{name: ball, at: rod.com, mass: 3, {when}}}]\n"
    scene.write_text(MIXED.replace("trajectory:", ball + "initial: {q: {slide: 0, arm: 0}}\ntrajectory:"))
    for words in (("inverse", scene, "--no-plots", "--out", tmp_path / "out"), ("validate", scene)):
        done = invoke(*words)
        assert (
            done.code == 2
            and "payloads.0: " in done.err + done.out
            and "inertia.zz of ball" in done.err + done.out
        )
    held = invoke("info", scene, "--json", "--no-plots", "--out", tmp_path / "out").data["mass_matrix"][0][0]
    assert held == pytest.approx(5.0 if when.startswith("until") else 2.0, rel=1e-12)


def test_strict_names_every_warning(tmp_path: Path) -> None:
    (tmp_path / "odd.yaml").write_text(MIXED.replace("zz: 0.1", "xx: 1, yy: 0.1, zz: 0.1").replace(
        "com: [0, 0, 0]}", "com: [0, 0, 0], inertia: {xx: 1, yy: 0.1, zz: 0.1}}"))  # fmt: skip
    done = invoke("inverse", tmp_path / "odd.yaml", "--no-plots", "--out", tmp_path / "out", "--strict")
    said = next(line for line in done.err.splitlines() if "robodyn: error" in line)
    assert done.code == 2 and "carriage" in said and "rod" in said and "--strict" in said


@pytest.mark.parametrize(
    "words", [("inverse", "2r_drives.yaml"), ("size", "2r_circle.yaml", "--types", "stepper")]
)
def test_what_drives_bear_has_errors(words: tuple[str, ...], tmp_path: Path) -> None:
    """The figures of motors without an electrical model or thermal data are none."""
    command, scene, *rest = words
    told = ["--no-plots", "--out", tmp_path, "--set", "inverse.samples=101"]
    short = invoke(command, CONFIGS / scene, *rest, *told)
    whole = invoke(command, CONFIGS / scene, *rest, *told, "-v")
    assert short.code == whole.code == 0
    rows = [
        re.split(r"\s{2,}", line.strip()) for line in whole.out.splitlines() if line.startswith("  theta")
    ]
    figures = [cell for row in rows for cell in row[1:] if re.match(r"-?\d+\.?\d*(e-?\d+)?( |$)", cell)]
    without = [cell for cell in figures if "+-" not in cell and not cell.isdecimal()]
    assert len(figures) > 20 and without == [], rows
    head, one, _ = [line for line in short.out.splitlines() if "verdict" in line or "suffices" in line]
    assert head.split() == ["joint", "drive", "verdict", "left", "[%]", "of", "limit"] and "+-" in one
    assert "winding [degC]" in whole.out and "winding [degC]" not in short.out
