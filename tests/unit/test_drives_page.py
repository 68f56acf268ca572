"""The worked page on drives says what the commands print."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

import robodyn
from robodyn_cli.cli.app import run

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "drives.md").read_text(encoding="utf-8")
BLOCKS = [
    block.strip("\n").splitlines() for block in re.findall(r"```\n(\$ robodyn .*?)```", PAGE, re.DOTALL)
]


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block[0])
def test_what_is_shown_is_printed(
    block: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    assert run([*shlex.split(block[0])[2:], "--no-plots", "--out", str(tmp_path)]) == 0
    printed = [_rounded(line) for line in capsys.readouterr().out.splitlines()]
    assert len(block) > 2 and [line for line in block[1:] if _rounded(line) not in printed] == []


def test_energies_of_the_shoulder_are_those_of_the_summary() -> None:
    summary = robodyn.inverse(ROOT / "configs" / "2r_drives.yaml").summary
    drive, joint = summary["drives"]["theta1"], summary["joints"]["theta1"]
    current = drive["electrical"]
    spent = [current["energy"], current["regenerated"]]
    left = [joint["energy_net"], drive["gear_loss"], current["copper_loss"], current["friction_loss"]]
    shown = re.findall(r"^\| .+ \| (-?\d+\.\d\d) \|$", PAGE, re.MULTILINE)
    assert shown == [f"{energy:.2f}" for energy in (*spent, *left)]
    assert f"{shown[0]} - {shown[1]} = {' + '.join(shown[2:])}" in PAGE


def _rounded(line: str) -> list[str]:
    """Return the words of a line: of figures that are known to more than four decimals these alone, since rounding
    decides on their errors."""
    return re.sub(r"(\.\d{4})\d+ \+- \de-\d+", r"\1", line).split()
