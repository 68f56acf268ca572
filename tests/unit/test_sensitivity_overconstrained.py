"""Exact derivatives of loops whose rows depend on each other on the constraints alone, through whole turns, beside
central differences of runs."""

from __future__ import annotations

import pytest

from tests.unit.test_overconstrained import BENNETT, BRICARD, SARRUS
from tests.unit.test_sensitivity import asked, compare_with_differences

TIGHT = "simulate.rtol=1e-11"


@pytest.mark.parametrize(
    ("scene", "key", "duration"),
    [
        (BENNETT, "robot.links.l1.mass", 3.0),
        (BRICARD.replace("[0, 0, 0]", "[0.5, -1, 2]", 1), "initial.qd.j1", 4.0),
        (SARRUS, "robot.links.top.mass", 0.3),
    ],
)
def test_derivatives_stay_on_the_constraints(scene: str, key: str, duration: float) -> None:
    first = "a1" if scene is SARRUS else "j1"
    question = asked(
        f"schema: 1\ncommand: simulate\n{scene}", [key], [f"final.q.{first}", f"final.qd.{first}"], TIGHT,
        "simulate.atol=1e-13", f"simulate.duration={duration}",
    )  # fmt: skip
    compare_with_differences(question)
