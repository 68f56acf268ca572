"""What the shell is offered to complete a word with, as its script asks for it; nothing heavy is loaded for that."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from robodyn_cli.scene.text.offered import offered_keys
from tests.cli.tool import CONFIGS, ROOT, environment

CODE = "import sys; from robodyn_cli.cli.app import run; run([]); print(*sys.modules, file=sys.stderr)"
HEAVY = {"numpy", "h5py", "matplotlib", "llvmlite", "scipy"}


def offered(line: str) -> list[str]:
    """Return what bash is offered for the last word of a line."""
    asked = environment(
        _ROBODYN_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=str(len(line.split(" ")) - 1)
    )
    done = subprocess.run([sys.executable, "-c", CODE], cwd=ROOT, env=asked, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not HEAVY & set(done.stderr.split())
    return done.stdout.split()


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("robodyn sens", ["sensitivity"]),
        ("robodyn simulate configs/double_pendulum.yaml --plots energy,joint_r", ["energy,joint_rates"]),
        ("robodyn new pat", ["path"]),
        ("robodyn new --from pum", ["puma560"]),
        ("robodyn new --example mechanisms/cra", ["mechanisms/crane"]),
        ("robodyn simulate configs/double_pendulum.yaml --set simulate.sa", ["simulate.samples="]),
        ("robodyn sweep configs/four_bar_deploy.yaml --vary robot.links.cr", ["robot.links.crank."]),
        ("robodyn simulate configs/nowhere.yaml --set ro", []),
    ],
)
def test_the_shell_is_offered(line: str, found: list[str]) -> None:
    assert offered(line) == found


def test_keys_of_an_included_file_and_of_items_by_name() -> None:
    scene = str(CONFIGS / "benchmarks" / "puma560.yaml")  # its robot is a file of its own
    assert {f"robot.links.link{k}." for k in range(1, 7)} == set(offered_keys(scene, "robot.links."))
    assert "robot.links.link2.mass=" in offered_keys(scene, "robot.links.link2.m")
    assert offered_keys(scene, "robot.links.nobody.") == [] == offered_keys(scene, "title.")


def test_a_scene_that_is_wrong_offers_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("robot: {links: [")
    assert offered_keys(str(tmp_path / "a.yaml"), "ro") == []
