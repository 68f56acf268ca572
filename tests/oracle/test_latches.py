"""Deployments of random arrays of panels with latches beside an independent event-driven integration."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
import yaml

from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.works.deploy.deploy import deploy
from tests.panels import Panels

EXPLORE = int(os.environ.get("ROBODYN_EXPLORE", "0"))
SEEDS = range(6) if not EXPLORE else range(1000, 1000 + 18 * EXPLORE)
ORACLE = 2e-11  # s, rad/s or J, relative to 1 or to the value: what scipy's tolerances leave (measured at looser ones)


def _deployed(panels: Panels, **simulate: Any) -> dict[str, Any]:
    return deploy(load_scene_text(yaml.safe_dump(panels.scene(**simulate)))).summary


@pytest.mark.parametrize("seed", SEEDS)
def test_closings_of_random_arrays_are_within_their_errors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    panels = Panels.random(rng, int(rng.integers(2, 7)))
    expected = panels.deploy()
    for tolerances in ({}, {"rtol": 1e-12, "atol": 1e-14}):
        summary = _deployed(panels, **tolerances)
        locks = summary["locks"]
        assert [f"latch{k}" for k, *_ in expected] == sorted(locks, key=lambda name: locks[name]["time"])
        for k, time, speed, lost in expected:
            own = locks[f"latch{k}"]
            for key, value in (("time", time), ("speed", speed), ("energy_lost", lost)):
                allowed = own["errors"][key] + ORACLE * max(1.0, abs(value))
                assert abs(own[key] - value) <= allowed, (
                    tolerances,
                    key,
                    own[key] - value,
                    own["errors"][key],
                )
            if tolerances:
                assert abs(own["time"] - time) <= 1e-9


@pytest.mark.parametrize("seed", SEEDS[:3])
def test_synchronised_arrays_close_all_latches_at_once(seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    panels = Panels.random(rng, int(rng.integers(2, 7))).synchronised()
    (_, time, _, lost), *others = panels.deploy()
    assert len(others) == len(panels.mass) - 1
    summary = _deployed(panels)
    locks = summary["locks"].values()
    assert len(locks) == len(panels.mass) and {own["order"] for own in locks} == {1}
    for own in locks:
        assert abs(own["time"] - time) <= own["errors"]["time"] + ORACLE * time
        assert abs(own["energy_lost"] - lost) <= own["errors"]["energy_lost"] + ORACLE * max(1.0, lost)
    assert max(abs(x) for x in summary["final"]["qd"].values()) < 1e-12
