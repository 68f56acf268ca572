"""A short run of fuzzing; ``python -m tests.fuzz`` goes on for as long as one likes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from robodyn_cli.commands import COMMANDS
from tests.fuzz.cases import SLOW, datasets_not_finite, store_results, try_case
from tests.fuzz.makers import WEIGHTS, make

CASES = 20
SEEDS = [1000 * part + k for part in range(5) for k in range(60)]
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stored")
    store_results(folder)
    return folder


@pytest.mark.parametrize("block", range(len(SEEDS) // CASES))
def test_whatever_comes_is_done_or_refused(block: int, stored: Path, tmp_path: Path) -> None:
    codes = set()
    for seed in SEEDS[CASES * block : CASES * (block + 1)]:
        outcome = try_case(make(seed, stored, "both"), tmp_path / "case", seconds=60.0)
        assert not outcome.finding, f"seed {seed}: {outcome.finding}\n{outcome.said}"
        assert outcome.code != SLOW, f"seed {seed} takes a minute"
        codes.add(outcome.code)
    assert {0, 2} <= codes


def test_every_command_is_tried() -> None:
    assert set(WEIGHTS) == set(COMMANDS)


def test_gaps_that_the_format_tells_are_no_findings(tmp_path: Path) -> None:
    """A pole is at infinity, and a torque is a number."""
    import h5py

    with h5py.File(tmp_path / "result.h5", "w") as file:
        file["poles/p"], file["curvatures/tip"] = [0.0, float("nan")], [0.0, float("inf")]
        file["tau"] = [[float("nan")], [1.0]]
    assert datasets_not_finite(tmp_path / "result.h5") == ["curvatures/tip", "tau"]
