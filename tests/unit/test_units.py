"""Units by a twin: a scene in which each length, mass and time is a power of two as large gives every dataset and figure
times the power of two that its unit says, to the last bit."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.report.figures import declared, errors
from robodyn_cli.results.result import Result, units_of
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.summaries.facts import rounded_up
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.kinematics import kinematics
from robodyn_cli.works.simulate import simulate
from robodyn_cli.works.statics import statics

CONFIGS = Path(__file__).parents[2] / "configs"

# powers of two, so far apart that no unit of mechanics is another one; angles, currents and prices stay
POWERS = {"m": 3, "kg": 7, "s": -1, "rad": 0, "deg": 0, "A": 0, "K": 0, "degC": 0, "1": 0, "": 0}
POWERS |= {"N": POWERS["kg"] + POWERS["m"] - 2 * POWERS["s"], "Hz": -POWERS["s"]}
POWERS |= {"J": POWERS["N"] + POWERS["m"], "W": POWERS["N"] + POWERS["m"] - POWERS["s"]}
ROUNDING = ("round_trip", "torque_rounding")


def power(unit: str) -> int:
    """Return the power of two of a unit: ``kg m^2/s``."""
    total = 0
    for k, part in enumerate(unit.split("/")):
        for factor in part.split():
            name, _, exponent = factor.partition("^")
            total += (-1 if k else 1) * POWERS[name] * int(exponent or 1)
    return total


def twins(text: str, command: Callable[[Any], Result]) -> tuple[Result, Result]:
    """Return the results of a scene whose numbers stand as ``<1.5 kg m^2>``, and of its twin."""

    def scaled(large: int) -> str:
        return re.sub(r"<(\S+) ([^>]*)>", lambda x: repr(float(x[1]) * 2.0 ** (large * power(x[2]))), text)

    one, other = (command(load_scene_text(scaled(large))) for large in (0, 1))
    return one, other


def numbers(value: Any, *steps: str) -> Iterator[tuple[tuple[str, ...], float]]:
    """Yield the numbers of a summary with their keys."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from numbers(inner, *steps, key)
    elif isinstance(value, list):
        for k, inner in enumerate(value):
            yield from numbers(inner, *steps, str(k))
    elif isinstance(value, float):
        yield steps, value


def named(summary: Any) -> Iterator[tuple[str, Any, str]]:
    """Yield the figures whose units a summary itself tells: key, value, unit."""
    if isinstance(summary, dict):
        for quantity, unit in summary.get("units", {}).items():
            for key, value in [*summary.items(), *summary.get("joint", {}).items()]:
                if (key == quantity or key.endswith(f"_{quantity}")) and key != "inertia_ratio":
                    yield key, value, unit
        for inner in summary.values():
            yield from named(inner)


WITH_UNIT = re.compile(r"(-?\d[\d.]*(?:e[-+]?\d+)?) ((?:rad|m|N m|N|s|W|J)\b[/^\w]*)")


def check(text: str, command: Callable[[Any], Result]) -> None:
    """Compare all datasets and figures of a scene and its twin."""
    one, other = twins(text, command)
    assert set(one.variables) == set(other.variables)
    for path, variable in one.variables.items():
        units = units_of(variable)
        if any(unit.startswith("of the row") for unit in units):  # each of its numbers has a unit of its own
            continue
        factors = [2.0 ** power(unit) for unit in units]
        scaled = variable.data * (factors if len(factors) > 1 else factors[0])
        # rates at rest of which only the sign counts have no size
        found, expected = (np.where(np.abs(x) < 1e-90, 0.0, x) for x in (scaled, other[path]))
        np.testing.assert_array_equal(found, expected, f"{path} {units}")
    joints = {"a": "rad", "s": "m"}
    told, again = (
        {steps: x for steps, x in numbers(one.summary) if steps[0] != "wall_time_s"} for one in (one, other)
    )
    assert set(told) == set(again)
    for steps, value in told.items():
        leaf = leaf_of(one.command, ".".join(steps))
        assert leaf is not None, steps
        unit = leaf.unit(joints)
        # the largest of several units, numbers with a unit each, and what rounding leaves
        if " or " in unit or " of the row" in unit or steps[-1] in ROUNDING:
            continue
        scaled = math.ldexp(value, power(unit))
        if steps[:2] == ("control", "tracking") and "errors" in steps:  # they count rounding of all positions
            scaled = pytest.approx(scaled, abs=1e-12)
        assert again[steps] == scaled, (steps, unit)
    for (key, value, unit), (_, moved, _) in zip(named(one.summary), named(other.summary)):
        assert np.all(np.ldexp(value, power(unit)) == np.array(moved)), (key, unit)
    for text, changed in zip(one.summary.get("warnings", []), other.summary.get("warnings", [])):
        own, others = WITH_UNIT.findall(text), WITH_UNIT.findall(changed)
        assert len(own) == len(others) and own, text
        for (value, unit), (moved, _) in zip(own, others):
            assert float(moved) == pytest.approx(math.ldexp(float(value), power(unit)), rel=1e-2), text


ARM = """
schema: 1
gravity: [<0.3 m/s^2>, <-9.81 m/s^2>, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1], origin: {xyz: [<0.1 m>, 0, 0]}, friction: {viscous: <0.02 N m s/rad>},
       limits: {speed: <0.3 rad/s>, acceleration: <0.2 rad/s^2>, effort: <0.5 N m>}}
    - {name: s, type: prismatic, axis: [1, 0, 0], friction: {viscous: <0.05 N s/m>},
       limits: {speed: <0.1 m/s>, acceleration: <0.2 m/s^2>, effort: <0.5 N>}}
  links:
    - {name: A, mass: <2 kg>, com: [<0.2 m>, 0, 0], inertia: {zz: <0.3 kg m^2>}}
    - {name: S, mass: <1 kg>, com: [<0.1 m>, <0.02 m>, 0], inertia: {zz: <0.1 kg m^2>}}
  points: {tip: {link: S, at: [<0.2 m>, 0, 0]}}
initial: {q: {a: 0.2, s: <0.3 m>}, qd: {a: <0.4 rad/s>, s: <-0.1 m/s>}}
trajectory:
  type: joint
  duration: <2 s>
  q: {a: "0.8*sin(2*pi*t/<2 s>)", s: "<0.3 m> + <0.1 m>*cos(2*pi*t/<2 s>)"}
inverse: {samples: 41}
kinematics: {samples: 41}
simulate: {duration: <1 s>, samples: 21, integrator: rk4, step: <0.05 s>}
torques: {a: "<3 N m>*sin(t/<1 s>)", s: <1 N>}
"""
DRIVES = """
drives: {a: {motor: m, gear: g, brake: k, count: 2}, s: {motor: m, gear: screw}}
catalogue:
  motors:
    m: {type: dc, mass: <1.7 kg>, cost: 10, torque_constant: <0.2 N m/A>, resistance: <0.9 W/A^2>, voltage: <90 W/A>,
        max_current: 60, rated_current: 20, rotor_inertia: <3e-4 kg m^2>, coulomb: <0.01 N m>, viscous: <2e-5 N m s/rad>,
        thermal: {winding_resistance: <0.4 K/W>, housing_resistance: <0.6 K/W>, winding_time: <20 s>,
                  housing_time: <900 s>, max_temperature: 150}}
  gears:
    g: {type: gear, ratio: 40, efficiency: 0.8, back_driving: 0.5, inertia: <1e-4 kg m^2>, mass: <0.9 kg>, cost: 5,
        peak_torque: <90 N m>, rated_torque: <60 N m>, max_speed: <400 rad/s>, stiffness: <9000 N m/rad>}
    screw: {type: ball_screw, lead: <0.02 m>, efficiency: 0.9, inertia: <2e-4 kg m^2>, mass: <0.8 kg>, cost: 4,
            stiffness: <9000 N/m>, rated_torque: <60 N>}
  brakes:
    k: {holding_torque: <3 N m>, inertia: <5e-5 kg m^2>, mass: <0.4 kg>, cost: 2}
"""


def test_units_of_an_inverse_run() -> None:
    check(ARM + "outputs: {reactions: true}", inverse)


def test_units_of_a_simulation() -> None:
    check(ARM, simulate)


def test_units_of_a_controlled_motion() -> None:
    gains = "kp: {a: <20 N m/rad>, s: <30 N/m>}, kd: {a: <4 N m s/rad>, s: <5 N s/m>}"
    free = ARM.replace("torques:", "parameters:").replace(
        '{a: "<3 N m>*sin(t/<1 s>)", s: <1 N>}', "{unused: 1}"
    )
    check(free + f"control: {{type: pd, joints: [a, s], gains: {{{gains}}}}}\n", simulate)


def test_units_of_kinematics() -> None:
    check(ARM, kinematics)


def test_units_of_drives() -> None:
    check(ARM + DRIVES, inverse)


def at_rest(name: str, *overrides: str) -> Result:
    return statics(load_scene(CONFIGS / "benchmarks" / f"{name}.yaml", list(overrides)))


def test_what_rows_lack_has_a_unit_for_each_kind() -> None:
    """Rows of lengths and rows of angles are no peers; a mechanism in a plane has lengths alone."""
    spatial, planar = at_rest("bennett", "statics.find=hold"), at_rest("slider_crank", "statics.find=hold")
    rows = spatial.variables["constraints/position_residual"]
    largest = {
        unit: max(abs(x) for x, own in zip(rows.data[0].tolist(), units_of(rows)) if own == unit)
        for unit in ("m", "rad")
    }
    told = next(text for text in errors(spatial) if text.startswith("constraints off by"))
    assert (
        told == f"constraints off by {rounded_up(largest['m']):.2g} m, {rounded_up(largest['rad']):.2g} rad"
    )
    assert any(text.startswith("constraints off by") and text.endswith(" m") for text in errors(planar))


def test_errors_of_joints_in_two_units_are_told_as_stated_and_not_how_far_they_move() -> None:
    cart = simulate(load_scene(CONFIGS / "cart_pole_lqr.yaml", ["simulate.duration=1"]))
    told = errors(cart, all_of_them=True)
    for key, words in (("q_max", "largest error of q"), ("qd_max", "largest error of qd")):
        value = rounded_up(cart.summary["error_estimate"][key])
        assert sum(text.startswith(f"{words} {value:.2g} ") for text in told) == 1, told


def test_multipliers_are_told_with_the_unit_of_their_row() -> None:
    for found in (at_rest("bennett", "statics.find=hold"), at_rest("slider_crank", "statics.find=hold")):
        (listed,) = [one for one in declared(found) if one.head[0] == "row"]
        variable = found.variables["constraints/multipliers"]
        wanted = dict(zip(variable.names, units_of(variable)))
        assert {str(row[0]): row[1].unit for row in listed.rows} == wanted
        assert all(row[1].error is not None for row in listed.rows)
