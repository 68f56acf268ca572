"""What the shell is offered to complete a word with, as its script asks for it; nothing heavy is loaded for that."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from robodyn_cli.scene.text.offered import offered_keys
from tests.cli.tool import CONFIGS, ROOT, environment

CODE = """
import contextlib, json, os, sys
from robodyn_cli.cli.app import run
for asked in json.loads(sys.argv[1]):
    os.environ.update(asked)
    print("next:", flush=True)
    with contextlib.suppress(SystemExit):
        run([])
print(*sys.modules, file=sys.stderr)
"""
HEAVY = {"numpy", "h5py", "matplotlib", "llvmlite", "scipy"}
ARM = "configs/2r_circle.yaml"

OFFERED = {
    "sens": "sensitivity",
    "help sens": "sensitivity",
    "simulate configs/double_pendulum.yaml --plots energy,joint_r": "energy,joint_rates",
    "new pat": "path",
    "new --from pum": "puma560",
    "new --example mechanisms/cra": "mechanisms/crane",
    "simulate configs/double_pendulum.yaml --set simulate.sa": "simulate.samples=",
    "simulate configs/nowhere.yaml --set ro": "",
    "report outputs/a --live robot.links.link1.ma": "",  # no scene is on the line
    f"sensitivity {ARM} --of joints.theta1.peak_to": "joints.theta1.peak_torque joints.theta1.peak_torque_time",
    f"sweep {ARM} --of peak_torque.": "peak_torque.theta1 peak_torque.theta2",
    "optimise configs/four_bar_deploy.yaml --reach lock.ti": "lock.time= lock.time_error=",
    f"sensitivity {ARM} --to robot.links.link2.ma": "robot.links.link2.mass",
    f"linearise {ARM} --output theta1,qd.theta": "theta1,qd.theta1 theta1,qd.theta2",
    f"size {ARM} --types dc,br": "dc,brushless",
    "plot outputs/a --style pa": "paper",
    "plan a.yaml --for dep": "deploy",
    "work-precision a.yaml --methods bdf,rodas": "bdf,rodas5p",
}


def asked(line: str, shell: str) -> dict[str, str]:
    """Return what the script of a shell puts into the environment when it asks for the last word of a line."""
    words = {
        "bash": {"COMP_WORDS": line, "COMP_CWORD": str(len(line.split(" ")) - 1)},
        "zsh": {"_TYPER_COMPLETE_ARGS": line},
        "fish": {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
        "pwsh": {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_WORD_TO_COMPLETE": line.split(" ")[-1]},
    }
    return {"_ROBODYN_COMPLETE": f"complete_{shell}", **words[shell]}


def offered(lines: list[str], shell: str, light: bool = True) -> list[str]:
    """Return what a shell is told of the last word of each line; light : nothing heavy may be loaded for it."""
    told = json.dumps([asked(f"robodyn {line}", shell) for line in lines])
    done = subprocess.run(
        [sys.executable, "-c", CODE, told], cwd=ROOT, env=environment(), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    loaded = set(done.stderr.split())
    assert "typer" in loaded and not (light and HEAVY & loaded)
    return [text.strip() for text in done.stdout.split("next:\n")[1:]]


def test_the_shell_is_offered() -> None:
    found = offered([*OFFERED], "bash")
    assert {line: " ".join(text.split()) for line, text in zip(OFFERED, found)} == OFFERED


VALUES = {
    "simulate configs/double_pendulum.yaml --set simulate.integrator=gauss1": "gauss10 gauss12 gauss14",
    "simulate configs/double_pendulum.yaml --set simulate.error_estimate=": "true false",
    f"inverse {ARM} --set trajectory.type=ci": "circle",
    "simulate configs/four_bar_deploy.yaml --set kinematics.sweep.joint=ph": "phi2 phi1",
    f"size {ARM} --set drives.theta1.brake=brake3": "brake36",
    f"sweep {ARM} --vary robot.links.link2.mass=lin": "linspace(",
    "simulate configs/double_pendulum.yaml --set simulate.duration=": "",
    "simulate configs/double_pendulum.yaml --set simulate.nothing=a": "",
}


@pytest.mark.parametrize("cut", [False, True])
def test_the_words_that_a_key_may_be_are_offered_behind_it(cut: bool) -> None:
    """Bash may cut at the sign, and then takes what stands behind it."""
    lines = [line.replace("=", " = ").rstrip() if cut else line for line in VALUES]
    found = offered(lines, "bash", light=False)
    for (line, words), told in zip(VALUES.items(), found):
        before = "" if cut else f"{line.split(' ')[-1].partition('=')[0]}="
        assert told.split() == [before + word for word in words.split()], line


@pytest.mark.parametrize("shell", ["zsh", "fish", "pwsh"])
def test_other_shells_are_offered_the_same(shell: str) -> None:
    (told,) = offered(["sweep configs/four_bar_deploy.yaml --vary robot.links.crank.m"], shell)
    assert "robot.links.crank.mass=" in told and "robot.links.coupler" not in told


def test_keys_of_an_included_file_and_of_items_by_name() -> None:
    scene = str(CONFIGS / "benchmarks" / "puma560.yaml")  # its robot is a file of its own
    assert {f"robot.links.link{k}." for k in range(1, 7)} == set(offered_keys(scene, "robot.links."))
    assert "robot.links.link2.mass=" in offered_keys(scene, "robot.links.link2.m")
    assert offered_keys(scene, "robot.links.nobody.") == [] == offered_keys(scene, "title.")


def test_where_one_key_is_left_those_below_it_are_offered() -> None:
    """A shell goes on to the next word behind a single one, which would be cut off at its dot."""
    found = offered_keys(str(CONFIGS / "four_bar_deploy.yaml"), "robot.links.cr")
    assert found and all(
        key.startswith("robot.links.crank.") and key != "robot.links.crank." for key in found
    )


def test_a_scene_that_is_wrong_offers_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("robot: {links: [")
    assert offered_keys(str(tmp_path / "a.yaml"), "ro") == []
