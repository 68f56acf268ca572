"""A short run of fuzzing; ``python -m tests.fuzz`` goes on for as long as one likes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from robodyn_cli.commands import COMMANDS
from tests.fuzz.cases import SLOW, store_results, try_case
from tests.fuzz.makers import WEIGHTS, make

CASES = 60
BLOCKS = 5
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stored")
    store_results(folder)
    return folder


@pytest.mark.parametrize("block", range(BLOCKS))
def test_whatever_comes_is_done_or_refused(block: int, stored: Path, tmp_path: Path) -> None:
    codes = set()
    for seed in range(1000 * block, 1000 * block + CASES):
        outcome = try_case(make(seed, stored, "both"), tmp_path / "case", seconds=60.0)
        assert not outcome.finding, f"seed {seed}: {outcome.finding}\n{outcome.said}"
        assert outcome.code != SLOW, f"seed {seed} takes a minute"
        codes.add(outcome.code)
    assert {0, 2} <= codes


def test_every_command_is_tried() -> None:
    assert set(WEIGHTS) == set(COMMANDS)
