"""Which values of keys a scene allows: told from few readings, and as row by row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from robodyn_cli.over.many.keys import Allowed, understand
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from tests.mechanisms import CONFIGS

KEYS = [f"robot.links.link{k}.{x}" for k in (1, 2) for x in ("mass", "com.0")]


def allowed(monkeypatch: pytest.MonkeyPatch) -> tuple[Allowed, list[Sequence[str]]]:
    """Return what is allowed of two links, and the readings that are made."""
    family = Family(CONFIGS / "double_pendulum.yaml")
    found = Allowed(family, [understand(family, key) for key in KEYS])
    read: list[Sequence[str]] = []
    scene = Family.scene

    def counted(self: Family, overrides: Sequence[str]) -> Scene:
        read.append(overrides)
        return scene(self, overrides)

    monkeypatch.setattr(Family, "scene", counted)
    return found, read


def test_all_elements_are_read_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The lowest values of all four keys in one scene, the highest in another; none between them."""
    found, read = allowed(monkeypatch)
    rows = np.random.default_rng(3).uniform(0.2, 2.0, size=(50, 4))
    assert found.refusals(rows) == {}
    assert len(read) == 2
    assert found.refusals(rows[7:9]) == {} and len(read) == 2


def test_rows_are_refused_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mass below zero in some of them, beside what is allowed."""
    found, _ = allowed(monkeypatch)
    rows = np.random.default_rng(3).uniform(0.2, 2.0, size=(6, 4))
    rows[[1, 4], [0, 2]] = -1.0
    refused = found.refusals(rows)
    assert set(refused) == {1, 4} and all("mass" in str(error) for error in refused.values())
    assert found.refusals(rows[[0, 2, 3, 5]]) == {}
