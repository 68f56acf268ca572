"""Every command on scenes with a controller: it does its work, or says why not; none of them breaks."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.tool import CONFIGS, PENDULUM, invoke

LAWS = {
    "lqr": "{type: lqr, pose: {j1: -90 deg, j2: 0}}",
    "computed_torque": "{type: computed_torque, period: 0.01, gains: {kp: 50, kd: 10}}",
    "feed_forward": "{type: feed_forward, gains: {kp: 50, kd: 10}}",
    "pid": "{type: pid, gains: {kp: 50, kd: 10, ki: 5}}",
}
FOLLOWED = "trajectory: {type: quintic, points: [{t: 0, q: {j1: -1, j2: 0.3}}, {t: 1, q: {j1: 0, j2: 1}}]}\n"
# the laws by which stability tries methods: a regulator, one that is sampled, one with states of its own
TRIED = ("lqr", "computed_torque", "pid")
COMMANDS = {
    "validate": 0,
    "plan": 0,
    "info": 0,
    "simulate": 0,
    "linearise": 0,
    "stability": 0,
    "statics": 2,  # a balance under a controller
}


@pytest.fixture(params=LAWS)
def scene(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    law = request.param
    path = tmp_path / "scene.yaml"
    followed = "" if law == "lqr" else FOLLOWED
    path.write_text(f"{PENDULUM}control: {LAWS[law]}\n{followed}", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("scene", "command"),
    [(law, command) for law in LAWS for command in COMMANDS if command != "stability" or law in TRIED],
    indirect=["scene"],
)
def test_commands_know_controllers(command: str, scene: Path, tmp_path: Path) -> None:
    plots = () if command in ("validate", "plan", "info") else ("--no-plots", "--out", tmp_path / "out")
    quick = ("--quick",) if command == "stability" else ()
    done = invoke(command, scene, *plots, *quick)
    assert done.code == COMMANDS[command], done.err


def test_a_configuration_is_held_without_its_controller(scene: Path, tmp_path: Path) -> None:
    held = [
        invoke("statics", scene, "--set", "statics.find=hold", *more, "--no-plots", "--json", "--out", tmp_path / str(k)).data["torques_of_joints"]
        for k, more in enumerate([(), ("--set", "control=null")])
    ]  # fmt: skip
    assert held[0] == held[1]


def test_motions_are_looked_at_without_their_controller(tmp_path: Path) -> None:
    for command in ("inverse", "kinematics"):
        done = invoke(command, CONFIGS / "controlled_arm.yaml", "--no-plots", "--out", tmp_path / command)
        assert done.code == 0, done.err


@pytest.mark.parametrize("key", ["pose", "gains.q", "gains.qd", "gains.tau"])
def test_a_regulator_knows_its_joints(key: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(f"{PENDULUM}control: {LAWS['lqr']}\n", encoding="utf-8")
    done = invoke("plan", path, "--set", f"control.{key}={{j3: 1}}")
    assert done.code == 2
    assert f"control.{key}.j3: unknown joint" in done.err
