"""Loops of many runs, of pages and of C close where those of a single run do: from rough values, and from none."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import integers

from robodyn_cli.errors import GeometryError, RobodynError
from robodyn_cli.over.live.structure import LiveStructure, motion_commands
from robodyn_cli.over.many.keys import value_of
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.over.many.start import starts_of
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.scene.load import Family, load_scene
from tests.bars import Bars, random_bars
from tests.exported_c import needs_compiler
from tests.exported_loop import ExportedLoop
from tests.live import random_rows, run_live
from tests.node import needs_node
from tests.numeric import examples

SAME = 1e-8  # rad: both close to 1e-11, near singular poses less


def single(family: Family, ranges: dict[str, tuple[float, float]], row: np.ndarray) -> np.ndarray | None:
    """Return where the command starts, None where its loops do not close."""
    overrides = [f"{name}={x!r}" for name, x in zip(ranges, row.tolist())]
    try:
        return prepare(load_scene(family.path, overrides)).assembled.q
    except GeometryError:
        return None


def agree(got: list[np.ndarray | None], wanted: list[np.ndarray | None]) -> None:
    for ours, theirs in zip(got, wanted, strict=True):
        assert (ours is None) == (theirs is None)
        if ours is not None and theirs is not None:
            assert np.abs(ours - theirs).max() <= SAME


def closing(folder: Path, seed: int, count: int) -> tuple[Bars, Family]:
    """Return the first random bars from a seed on whose own loops close."""
    for more in itertools.count():
        bars = random_bars(np.random.default_rng(seed + 1000 * more), count)
        family = bars.family(folder)
        try:
            prepare(family.own)
        except RobodynError:
            continue
        return bars, family


@examples(24)
@given(seed=integers(0, 1_000_000))
def test_many_runs_start_where_single_ones_do(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    bars, family = closing(tmp_path_factory.mktemp("bars"), seed, 3 + seed % 2)
    mechanism = Mechanism(family, list(bars.ranges))
    own = np.array([value_of(family, name) for name in bars.ranges], dtype=float)
    structure = motion_commands()["simulate"].structure(family, mechanism.keys, own)
    rows = random_rows(bars.ranges, 6, seed)
    starts = starts_of(structure, structure.motion, rows)
    agree(
        [q if sound else None for q, sound in zip(starts.q, starts.sound)],
        [single(family, bars.ranges, row) for row in rows],
    )


@needs_compiler
@needs_node
def test_c_and_pages_start_where_single_runs_do(tmp_path: Path) -> None:
    """A four-bar whose rough values Newton's steps alone lead nowhere from, with ranges at whose ends nothing closes."""
    bars, family = closing(tmp_path, 5, 3)
    rows = random_rows(bars.ranges, 8, 5)
    wanted = [single(family, bars.ranges, row) for row in rows]
    assert 2 <= sum(q is not None for q in wanted) < len(wanted)
    live = LiveStructure(family, bars.ranges)
    assert live.closing is not None and not live.closing.missing
    places = list(live.system.q_places)
    runs = run_live(live, rows, tmp_path)
    agree(
        [None if "refused" in run else np.array([run["columns"][k][0] for k in places]) for run in runs],
        wanted,
    )
    loop = ExportedLoop(family, bars.ranges, tmp_path)
    agree([loop.start(row) for row in rows], wanted)
