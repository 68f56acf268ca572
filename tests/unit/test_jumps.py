"""Forces that jump with the state: crossed at any tolerance, however little of a step fits beside the jump."""

from __future__ import annotations

import contextlib
from functools import lru_cache

import numpy as np
import pytest

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.errors import NumericalError
from robodyn_cli.over.stability.cases import CASES

# 1e6 N m/rad and a damper that sets in all at once, with accelerations that jump by 260 rad/s^2
TEXT = next(case for case in CASES if case.name == "stiff_stops").text(True)


@lru_cache
def ended(method: str, rtol: float) -> np.ndarray:
    overrides = [
        f"simulate.integrator={method}",
        f"simulate.rtol={rtol}",
        f"simulate.atol={rtol / 100}",
        "simulate.error_estimate=false",
    ]
    result = simulate(load_scene_text(TEXT, overrides=overrides))
    return np.concatenate([result["q"][-1], result["qd"][-1]])


@pytest.mark.parametrize("rtol", [1e-9, 1e-11, 1e-12, 1e-13])
@pytest.mark.parametrize("method", ["gauss", "gauss10", "dop853", "dopri5", "rodas5p", "radau", "radau13"])
def test_stiff_stops_at_tight_tolerances(method: str, rtol: float) -> None:
    """The state may stand on the jump itself, where what switches on it still takes the side it came from.

    Where rounding puts it there a run may be refused as one that chatters: of radau13 near 1e-12 some one in twenty.
    """
    exact, ends = ended("gauss", 1e-10), []
    for tolerance in (rtol, 1.1 * rtol, 1.2 * rtol):
        with contextlib.suppress(NumericalError):
            ends.append(ended(method, tolerance))
    assert len(ends) >= 2 and max(np.abs(end - exact).max() for end in ends) < 3e-7


# a ball thrown up at 5 m/s under g = 10 m/s^2: 1.25 m high, and only the top of its path is beyond the ceiling
CEILING = """
schema: 1
command: simulate
gravity: [0, 0, -10]
robot:
  joints: [{name: z, type: prismatic, axis: [0, 0, 1], limits: {upper: HIGH, stop: STOP}}]
  links: [{name: ball, mass: 1, com: [0, 0, 0]}]
initial: {q: {z: 0}, qd: {z: 5}}
simulate: {duration: 1, samples: 21, integrator: METHOD}
"""


def thrown(stop: str, depth: float, method: str) -> tuple[float, float]:
    """The end as it is found, and the top of the path."""
    text = CEILING.replace("HIGH", repr(1.25 - depth)).replace("STOP", stop).replace("METHOD", method)
    result = simulate(load_scene_text(text))
    return float(result["q"][-1, 0]), float(result["q"][:, 0].max())


@pytest.mark.parametrize("depth", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
@pytest.mark.parametrize(
    "method", ["gauss", "gauss8", "dop853", "dopri5", "rodas5p", "radau", "radau13", "bdf"]
)
def test_a_contact_that_begins_and_ends_within_a_step_is_met(method: str, depth: float) -> None:
    end, top = thrown("{restitution: 0.5}", depth, method)
    speed = np.sqrt(20.0 * depth)  # at the ceiling
    time = 0.5 - speed / 10.0
    left = 1.0 - time
    exact = 1.25 - depth - 0.5 * speed * left - 5.0 * left**2
    assert abs(end - exact) < 1e-6
    assert top < 1.25 - depth + 1e-9


@pytest.mark.parametrize("method", ["gauss", "dop853", "radau13"])
@pytest.mark.parametrize("depth", [1e-3, 1e-4, 1e-5])
def test_short_contacts_with_compliant_stops_are_met(method: str, depth: float) -> None:
    """Half a swing on the spring turns the ball back with the speed it came with."""
    end, _ = thrown("{stiffness: 1e6}", depth, method)
    speed = np.sqrt(20.0 * depth)
    w, pull = 1e3, 10.0 / 1e6  # the weight shifts the spring's rest by g / w^2 away from the ceiling's side
    contact = 2.0 * (np.pi / 2 - np.arctan(pull * w / speed)) / w
    left = 1.0 - (0.5 - speed / 10.0) - contact
    exact = 1.25 - depth - speed * left - 5.0 * left**2
    assert abs(end - exact) < 2e-6
