"""``reach`` as a program: branches on the terminal and in files, partial poses, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import load_scene, reach
from robodyn_cli.cli.commands.reach import describe
from robodyn_cli.results.hdf5 import read
from tests.cli.tool import ROOT, invoke

ROBOTS = ROOT / "robodyn_cli" / "robots"
PUMA, SCARA, SEVEN = (str(ROBOTS / f"{name}.yaml") for name in ("puma560", "scara", "seven_joint_arm"))
POSE = ("--frame", "link6", "--position", "0.4,0.2,0.9", "--rpy", "0,90 deg,0.3")


def test_all_branches_are_listed_drawn_and_stored(tmp_path: Path) -> None:
    done = invoke("reach", PUMA, *POSE, "--branch", "lefty-elbow_up-flip", "-v", "--out", str(tmp_path))
    assert (
        done.code == 0 and "lefty-elbow_up-flip (chosen)" in done.out and "righty-elbow_down-flip" in done.out
    )
    assert {"branches.png", "mechanism.png", "result.h5"} <= {path.name for path in tmp_path.iterdir()}
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["branch"] == "lefty-elbow_up-flip" and summary["method"] == "analytic"
    assert len(summary["branches"]) == 8 and sum(x["chosen"] for x in summary["branches"]) == 1
    assert summary["error"] < 1e-12 and summary["freedom"] == 0 and 0.0 < summary["singular_ratio"] < 1.0
    stored = read(tmp_path / "result.h5")
    assert stored["branches/q"].shape == (8, 6)
    np.testing.assert_allclose(stored["q"][0], list(summary["configuration"].values()))


def test_a_redundant_arm_reaches_by_a_criterion(tmp_path: Path) -> None:
    pose = ("--frame", "link7", "--position", "0.4,0.2,0.6")
    done = invoke(
        "reach", SEVEN, *pose, "--set", "reach.criterion=least_torque", "--json", "--out", str(tmp_path)
    )
    assert done.code == 0
    assert done.data["freedom"] == 3 and "branches" not in done.data and done.data["method"] == "damped"
    text = invoke("reach", SEVEN, *pose, "--no-plots", "--out", str(tmp_path)).out
    assert "freedom left       3" in text


@pytest.mark.parametrize(
    "words, error",
    [
        (("--frame", "link9", *POSE[2:]), "--frame link9: reach.frame: unknown frame 'link9'"),
        ((*POSE[:3], "0.4,0.2"), "--position 0.4,0.2: reach.position: has 2 entries"),
        ((*POSE[:5], "0,up,0"), "--rpy 0,up,0: reach.orientation.rpy"),
    ],
)
def test_errors_name_the_option_that_was_typed(tmp_path: Path, words: tuple[str, ...], error: str) -> None:
    done = invoke("reach", PUMA, *words, "--out", str(tmp_path / "out"))
    assert done.code == 2 and f"robodyn: error: {error}" in done.err and "--set" not in done.err, done.err


def test_a_scene_asks_for_a_pose(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(
        "schema: 1\ntitle: Reach\ncommand: reach\ngravity: [0, 0, -9.81]\nrobot:\n  convention: standard\n  joints:\n"
        "    - {name: q1, type: revolute, a: 1, alpha: 0, d: 0}\n    - {name: q2, type: revolute, a: 1, alpha: 0, d: 0}\n"
        "    - {name: q3, type: revolute, a: 0.3, alpha: 0, d: 0}\n  links: [{name: l1}, {name: l2}, {name: l3}]\n"
        "reach: {frame: l3.end, position: [1.3, 1, 0], orientation: {rpy: [0, 0, 0]}, branch: elbow_down}\n"
        "expect: {configuration.q1: 0 +- 1e-12, configuration.q2: 90 deg +- 1e-12, error: < 1e-12}\n".replace(
            "90 deg", "1.5707963267948966"
        )
    )
    assert invoke("run", str(path), "--out", str(tmp_path / "out")).code == 0
    found = reach(load_scene(path, ["reach.orientation={z: [0, 0, 1], x: [0, 1, 0]}"]))
    assert found.summary["configuration"]["q3"] + found.summary["configuration"]["q2"] + found.summary[
        "configuration"
    ]["q1"] == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ((PUMA, "--frame", "link7", "--position", "0,0,0"), 2, "unknown frame 'link7' (did you mean 'link6'?)"),
        ((PUMA, "--frame", "base.origin", "--position", "0,0,0"), 2, "fixed to the base"),
        ((PUMA, "--frame", "link6"), 2, "give 'position', 'orientation', or both"),
        ((PUMA,), 2, "key 'reach' is missing"),
        ((PUMA, *POSE, "--branch", "elbow_up"), 2, "allowed: righty-elbow_up-no_flip"),
        ((PUMA, *POSE, "--branch", "left"), 2, "reach.branch"),
        ((PUMA, "--frame", "link6", "--position", "0,0"), 2, "reach.position"),
        ((PUMA, "--frame", "link6", "--position", "0,0,9"), 5, "7.466 m away"),
        ((PUMA, "--frame", "link6", "--position", "0,0,9", "--rpy", "0,0,0"), 5, " m and "),
        ((SCARA, "--frame", "flange", "--position", "0.3,0.2,9"), 5, "beyond its limits"),
        ((SEVEN, "--frame", "link7", "--position", "0.4,0,0.5", "--set", "reach.axis=[0,0,1]"), 2, "needs 'orientation'"),
        ((SEVEN, "--frame", "link7", "--position", "0.4,0,0.5", "--set", "reach.criterion=away_from_limits"), 2, "there are none"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_message(
    arguments: tuple[str, ...], code: int, said: str, tmp_path: Path
) -> None:
    done = invoke("reach", *arguments, "--no-plots", "--out", str(tmp_path))
    assert done.code == code and said in done.err
    assert (
        not (tmp_path / "summary.json").exists()
        or json.loads((tmp_path / "summary.json").read_text())["status"] != "ok"
    )


def test_what_rounding_makes_of_zero_is_shown_as_zero() -> None:
    way = {"name": "1", "configuration": {"a": -3e-19, "b": 0.5}, "errors": {"a": 2e-16, "b": 1e-16},
           "reached": True, "within_limits": True, "chosen": False}  # fmt: skip
    summary = {"title": "arm", "frame": "tip", "error": 0.0, "singular_ratio": 1.0, "singular_ratio_error": 1e-14,
               "freedom": 0, "units": {"a": "rad", "b": "rad"}, "branches": [way]}  # fmt: skip
    lines = describe(summary).splitlines()
    told = "1 0 +- 3e-16 0.5000000000000000 +- 1e-16 yes yes"
    assert [line.split() for line in lines if line.split()[0] == "1"] == [told.split()]
