"""``robodyn linearise``: options, files, and mistakes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from tests.cli.tool import CONFIGS, invoke, run

PENDULUM = CONFIGS / "double_pendulum.yaml"


def test_command_line(tmp_path: Path) -> None:
    out = tmp_path / "out"
    state = ("--at", "theta1=20 deg", "--hold", "--input", "theta1,theta2")
    done = invoke("linearise", PENDULUM, *state, "--out", out)
    assert done.code == 0, done.err
    assert "about the pose, held by constant torques" in done.out and "holding torques" in done.out
    files = {path.name for path in out.iterdir()}
    # all poles are real: two grow, none oscillates; each figure stands in the column of the others
    assert done.out.count("  grows e times\n") == 2 == done.out.count("  decays to 1/e\n")
    assert "1/s grows e times in " in done.out
    columns = {line.index(line[2:].split("  ")[-1].lstrip()) for line in done.out.splitlines() if "  linear model " in line
               or "  stability " in line}  # fmt: skip
    assert columns == {21}
    assert {"result.h5", "summary.json", "poles.png", "mode_shapes.png", "frequency_response.png"} <= files
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["configuration"]["theta1"] == pytest.approx(np.radians(20))
    assert invoke("export", out, "--to", "mat", "--out", tmp_path / "mat").code == 0
    data = loadmat(tmp_path / "mat" / "result.mat")["data"]
    assert data["linear"][0, 0]["A"][0, 0].shape == (4, 4)


def test_along_a_motion(tmp_path: Path) -> None:
    out = tmp_path / "out"
    short = ("--set", "simulate.duration=0.5", "--set", "simulate.samples=51")
    done = invoke("linearise", PENDULUM, "--along", "--instants", "0,0.25", *short, "--out", out)
    assert done.code == 0, done.err
    assert "stability at 0 s " in done.out and "stability at 0.25 s" in done.out
    files = {path.name for path in out.iterdir()}
    assert {"poles.png", "poles_over_time.png", "frequency_response.png"} <= files
    assert "mode_shapes.png" not in files


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--at", "theta9=1"), "--at 'theta9=1': unknown joint 'theta9'"),
        (("--at", "theta1=x y"), "--at 'theta1=x y'"),
        (("--at", "balance", "--along"), "--at balance and --along exclude each other"),
        (("--at", "theta1=1", "--along"), "--at STATE and --along exclude each other"),
        (("--input", "elbow"), "--input elbow: unknown"),
        (("--instants", "1"), "--instants: they are those of a motion; allowed: with --along"),
        (
            ("--along", "--instants", "0,soon"),
            "--instants 0,soon: 'soon' is not a number; allowed: numbers [s]",
        ),
    ],
)
def test_mistakes(options: tuple[str, ...], words: str, tmp_path: Path) -> None:
    done = run("linearise", PENDULUM, *options, "--out", tmp_path / "out")
    assert done.code == 2 and words in done.err
    assert not (tmp_path / "out/result.h5").exists()
