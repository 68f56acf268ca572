"""Forces that jump with the state: crossed at any tolerance, however little of a step fits beside the jump."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.over.stability.cases import CASES

# 1e6 N m/rad and a damper that sets in all at once, with accelerations that jump by 260 rad/s^2
TEXT = next(case for case in CASES if case.name == "stiff_stops").text(True)


@lru_cache
def ended(method: str, rtol: float, duration: float = 2.0) -> np.ndarray:
    overrides = [
        f"simulate.integrator={method}",
        f"simulate.rtol={rtol}",
        f"simulate.atol={rtol / 100}",
        f"simulate.duration={duration}",
        "simulate.error_estimate=false",
    ]
    result = simulate(load_scene_text(TEXT, overrides=overrides))
    return np.concatenate([result["q"][-1], result["qd"][-1]])


@pytest.mark.parametrize("rtol", [1e-9, 1e-11, 1e-12, 1e-13])
@pytest.mark.parametrize("method", ["gauss", "gauss10", "dop853", "dopri5", "rodas5p", "radau", "radau13"])
def test_stiff_stops_at_tight_tolerances(method: str, rtol: float) -> None:
    exact = ended("gauss", 1e-10)
    for tolerance in (rtol, 1.1 * rtol, 1.2 * rtol):
        assert np.abs(ended(method, tolerance) - exact).max() < 3e-7


@pytest.mark.parametrize("method", ["radau", "radau9", "radau13"])
def test_rounding_may_put_a_step_on_the_jump_itself(method: str) -> None:
    """There stages lie on either side by chance, so that no step converges; of 75 runs three or four met that."""
    exact = ended("gauss", 1e-13, 0.2)
    ends = [ended(method, 1e-12 * (1.0 + 0.01 * k), 0.2) for k in range(75)]
    assert max(np.abs(end - exact).max() for end in ends) < 1e-10


# a mass of 1 kg comes to x = 1 with speed v and is pushed back from there on: it leaves after 2 v / push, as fast
WALL = """
schema: 1
command: simulate
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0]}]
  links: [{name: mass, mass: 1, com: [0, 0, 0]}]
torques: {x: "if(x > 1, -PUSH, 0)"}
initial: {q: {x: START}, qd: {x: SPEED}}
simulate: {duration: 2, samples: 3, integrator: METHOD, rtol: RTOL, atol: ATOL, error_estimate: false, max_steps: 5000}
"""
PUSH = 300.0


def pushed_back(method: str, rtol: float, speed: float, arrival: float) -> tuple[float, float]:
    """Return the end of the mass that comes to the wall at a time, and where it should be."""
    start = 1.0 - speed * arrival
    numbers = {"PUSH": PUSH, "START": start, "SPEED": speed, "RTOL": rtol, "ATOL": rtol / 100}
    text = WALL.replace("METHOD", method)
    for name, number in numbers.items():
        text = text.replace(name, repr(number))
    left = (1.0 - start) / speed + 2.0 * speed / PUSH
    return float(simulate(load_scene_text(text))["q"][-1, 0]), 1.0 - speed * (2.0 - left)


@pytest.mark.parametrize("rtol", [1e-10, 1e-12, 1e-13])
@pytest.mark.parametrize("speed", [1.0, 1e-2, 1e-3])
@pytest.mark.parametrize("method", ["gauss", "dop853", "rodas5p", "radau9", "radau13"])
def test_jumps_are_passed_however_slowly(method: str, speed: float, rtol: float) -> None:
    """A step that is short enough for the tolerance does not move x at all, by rounding.

    Where rounding puts x off by d, the push sets in d / speed too early or late, and the speed afterwards is off by push
    times that. Some ten roundings are spent, at 1e-10 rather the tolerance.
    """
    if speed < 1e-2 and rtol < 1e-12:
        pytest.skip("roundings of x times the push are more than the balance of energy allows there")
    off = 20.0 * PUSH * 1.1e-16 / speed * 2.0 + 20.0 * rtol
    for k in range(8):
        end, exact = pushed_back(method, rtol, speed, 0.5 + 0.00137 * k)
        assert abs(end - exact) < off


def test_roots_that_rounding_hides_are_met_from_anywhere() -> None:
    """Dense output passes the jump at once, while x moves by a rounding only at the end of the step."""
    for k in range(60):
        end, exact = pushed_back("radau", 1e-10, 1e-2, 0.5 + 0.00137 * k)
        assert abs(end - exact) < 2e-9


@pytest.mark.parametrize("speed", [1.0, 1e-2])
def test_bdf_knows_its_history_after_steps_of_a_few_roundings(speed: float) -> None:
    """Else each step is the first of a new one, and none is longer than the last."""
    end, exact = pushed_back("bdf", 1e-10, speed, 0.5)
    assert abs(end - exact) < 2e-9


@pytest.mark.parametrize("speed", [1.0, 1e-2, 1e-3])
@pytest.mark.parametrize("method", ["gauss", "dop853", "dopri5", "rodas5p", "radau", "radau13"])
def test_runs_start_on_a_jump(method: str, speed: float) -> None:
    end, exact = pushed_back(method, 1e-12, speed, 0.0)
    assert abs(end - exact) < 20.0 * PUSH * 1.1e-16 / speed * 2.0 + 2e-11


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
