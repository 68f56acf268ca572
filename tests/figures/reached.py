"""Figures of ``reach`` beside those of fifty digits: arms at random, half of them near a singular pose."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import mpmath as mp
import numpy as np

from robodyn_cli.errors import GeometryError
from robodyn_cli.scene import load_scene_text
from robodyn_cli.solve.closure import mechanism_size
from robodyn_cli.tools.progress import Stopwatch
from robodyn_cli.works.reach import reach as reach_of
from robodyn_cli.works.reach import reached
from tests.figures.judge import Figure, Move, figures_of
from tests.pose_oracle import DIGITS, KINDS, Arm

RUNS = ("this run", f"{DIGITS} digits")
NEAREST = 8.0  # of the logarithm of the distance to a singular pose


def arm_of(seed: int) -> Arm:
    """Return an arm at random."""
    rng = np.random.default_rng(seed)
    kind = list(KINDS)[seed % len(KINDS)]
    singular = 10.0 ** -rng.uniform(1.0, NEAREST) if rng.random() < 0.5 else 0.0
    return Arm(rng, KINDS[kind], kind, singular)


def reached_moves(seed: int) -> list[Move]:
    """Return how far the figures of an arm are from exact ones; none of one that does not reach its target."""
    arm = arm_of(seed)
    scene = load_scene_text(arm.scene())
    try:
        summary = reach_of(scene).summary
    except GeometryError:  # rounding of the target may put it out of reach
        return []
    figures, size = figures_of("reach", summary), mechanism_size(reached(scene, Stopwatch())[0].model)
    ways = {"": summary["configuration"]}
    ways |= {
        f"branches.{k}.": x["configuration"]
        for k, x in enumerate(summary.get("branches", []))
        if x["reached"]
    }
    exact: dict[str, Any] = {}
    for prefix, q in ways.items():
        try:
            there = arm.exact(list(q.values()))
        except (ValueError, ZeroDivisionError):  # of a target that is out of reach by a rounding
            continue
        exact |= {f"{prefix}configuration.{name}": x for name, x in zip(q, there)}
        if not prefix:
            exact["singular_ratio"] = arm.singular_ratio(there, size)
    return list(_moves(figures, exact))


def _moves(figures: Mapping[str, Figure], exact: Mapping[str, Any]) -> Iterator[Move]:
    for key, true in exact.items():
        own = figures[key]
        with mp.workdps(DIGITS):
            apart = float(abs(mp.mpf(own.value) - true))
        ratio = 0.0 if not apart else apart / own.error if own.error else math.inf
        yield Move(key, own.kind, RUNS, (own.value, float(true)), (own.error, 0.0), ratio)
