"""Figures of one drive, each by its formula or by an integration of its own."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp, trapezoid

from robodyn_cli.drives.cycle import CycleSamples, Duty, gear_limits
from robodyn_cli.drives.figures import Evaluated
from robodyn_cli.motors.gear import RotaryGear
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.size import search
from robodyn_cli.works.size.size import _asked

SINE = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: j, type: revolute, axis: [0, 0, 1]}]
  links: [{name: l, mass: 1, com: [0, 0, 0], com_frame: joint, inertia: {xx: 1, yy: 1, zz: 0.7}}]
trajectory: {type: joint, duration: 2, q: {j: "0.3*sin(2*pi*t)"}}
inverse: {samples: 401}
drives: {j: {motor: m, gear: g, ambient: 30}}
catalogue:
  motors: {m: {type: dc, torque_constant: 0.1, resistance: 0.5, voltage: 48, max_current: 30, rotor_inertia: 2e-4, thermal: {winding_resistance: 2, housing_resistance: 3, winding_time: 10, housing_time: 300, max_temperature: 120}}}
  gears: {g: {type: gear, ratio: 20, rated_torque: 40, peak_torque: 60, max_speed: 100}}
"""


def run(old: str = "", new: str = "") -> Result:
    return inverse(load_scene_text(SINE.replace(old, new) if old else SINE))


def test_a_gear_is_rated_by_the_cube_of_its_load() -> None:
    """Speed and load rise as t: L_m^3 = (integral of t t^3) / (integral of t) = (1/5) / (1/2)."""
    gear = RotaryGear(type="gear", ratio=1.0, rated_torque=2.0, peak_torque=4.0, max_speed=8.0)
    t = np.linspace(0.0, 1.0, 201)
    uses = gear_limits(gear, -t, t, 3.0, CycleSamples(t))
    assert float(uses["gear_rated"].part) == pytest.approx(0.4 ** (1 / 3) / 2.0, rel=1e-9)
    assert float(uses["gear_peak"].part) == pytest.approx(1.0 / 4.0, rel=1e-9)
    assert float(uses["gear_speed"].part) == pytest.approx(3.0 / 8.0, rel=1e-9)


def test_means_of_a_sine() -> None:
    samples = CycleSamples(np.linspace(0.0, 1.0, 101))
    sine = 3.0 * np.sin(2.0 * np.pi * np.linspace(0.0, 1.0, 101))
    assert float(samples.mean(sine + 0.5)) == pytest.approx(0.5, abs=1e-9)
    assert float(samples.rms(sine)) == pytest.approx(3.0 / math.sqrt(2.0), rel=1e-6)


def test_half_as_many_samples() -> None:
    for count in [41, 40, 3, 2]:
        times = np.linspace(1.0, 3.0, count)
        line = 2.0 * times
        duty = Duty(times, line, 3.0 * line, -line, None, line + 1.0, (0.25 * (count - 1),)).thinned()
        assert len(duty.times) == {41: 21, 40: 20, 3: 2, 2: 2}[count]
        assert duty.hold is None and duty.times[[0, -1]].tolist() == [1.0, 3.0]
        for own, factor, more in (
            (duty.speed, 2, 0),
            (duty.acceleration, 6, 0),
            (duty.load, -2, 0),
            (duty.inertia, 2, 1),
        ):
            assert own is not None and np.allclose(own, factor * duty.times + more, rtol=1e-14)
        assert np.interp(duty.breaks[0], np.arange(len(duty.times)), duty.times) == pytest.approx(
            1.5, rel=1e-14
        )


def test_temperatures_of_a_winding() -> None:
    """The network of its two bodies, integrated over one cycle from the surroundings' temperature, and over many."""
    found = run()
    winding = found.summary["drives"]["j"]["winding"]
    current, t = found["drives/current"][:, 0], found.time
    copper = 0.5 * current**2 * (1.0 + 0.00393 * (winding["mean"] - 25.0))

    def rates(time: float, x: np.ndarray) -> list[float]:
        flow = (x[0] - x[1]) / 2.0
        return [(np.interp(time % 2.0, t, copper) - flow) / 5.0, (flow - x[1] / 3.0) / 100.0]

    end = solve_ivp(rates, (0.0, 2.0), [0.0, 0.0], max_step=0.01, rtol=1e-8).y[0, -1]
    assert winding["after_one_cycle"] == pytest.approx(30.0 + end, rel=1e-5)
    mean = 0.5 * float(trapezoid(copper, t))
    assert winding["mean"] == pytest.approx(30.0 + 5.0 * mean, rel=1e-6)
    steady = solve_ivp(rates, (0.0, 2.0), [0.0, 0.0], max_step=0.01, rtol=1e-8)
    ripple = np.ptp(found["drives/winding_temperature"])
    assert winding["mean"] < winding["peak"] < winding["mean"] + ripple and ripple < steady.y[0].max()
    assert 0.0 < winding["error"] < 1e-3


def test_a_margin_within_its_error_is_doubtful() -> None:
    said = "as near to what is asked for as its error"
    found = run()
    drive = found.summary["drives"]["j"]
    assert 0.0 < drive["margin"] < 1.0 and "warnings" not in found.summary
    for least, doubtful in (
        (drive["margin"] - 0.05, False),
        (drive["margin"] + 0.05, False),
        (drive["margin"], True),
    ):
        texts = run("ambient: 30", f"ambient: 30, margin: {least!r}").summary.get("warnings", [])
        assert any(said in text for text in texts) is doubtful, least


def test_losses_of_a_gear_and_its_wind_up() -> None:
    """Half of each period the motor drives: it gives W / 0.8 and gets 0.5 W back."""
    found = run("ratio: 20", "ratio: 20, efficiency: 0.8, back_driving: 0.5, stiffness: 900")
    drive = found.summary["drives"]["j"]
    top = 0.3 * (2.0 * math.pi) ** 2 * 0.7
    work = 0.5 * 0.7 * (0.3 * 2.0 * math.pi) ** 2  # of the body's kinetic energy, four times there and back
    assert drive["joint"]["driving_energy"] == pytest.approx(4.0 * work, rel=1e-6)
    assert drive["gear_loss"] == pytest.approx(
        4.0 * work * (1.0 / 0.8 - 1.0 + 1.0 - 0.5), abs=10 * drive["errors"]["gear_loss"]
    )
    assert drive["gear_loss"] == pytest.approx(4.0 * work * 0.75, rel=1e-3)
    assert drive["wind_up"] == pytest.approx(top / 900.0, rel=1e-6)
    assert drive["errors"]["wind_up"] < 1e-6


def test_a_drive_is_the_same_alone_and_doubled() -> None:
    """Two equal drives share the load: each has half of it, and the joint all."""
    one, two = (
        run().summary["drives"]["j"],
        run("ambient: 30", "ambient: 30, count: 2").summary["drives"]["j"],
    )
    assert two["joint"]["peak_torque"] == pytest.approx(one["joint"]["peak_torque"], rel=1e-9)
    rotor = 20 * 2e-4 * 0.3 * (2.0 * math.pi) ** 2
    assert two["shaft"]["peak_torque"] - rotor == pytest.approx(
        0.5 * (one["shaft"]["peak_torque"] - rotor), rel=1e-6
    )


def test_joints_in_the_order_in_which_their_drives_are_felt(monkeypatch: pytest.MonkeyPatch) -> None:
    """A joint bears what stands behind it: first those that bear no other; none where two bear each other."""

    def order(felt: dict[str, set[str]]) -> list[str] | None:
        monkeypatch.setattr(search, "influences", lambda responses, name: felt[name])
        responses: Any = SimpleNamespace(joints=list(felt))
        return search.order_of(responses)

    assert order({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == ["c", "b", "a"]
    assert order({"a": {"b"}, "b": {"a"}, "c": set()}) is None
    assert order({"a": {"a"}}) is None


def test_temperatures_that_half_as_many_samples_do_not_have() -> None:
    """At the edge of where losses grow faster than the heat leaves: no error can be told."""
    known, unknown = (SimpleNamespace(_temperatures=x) for x in ((50.0, 40.0, 30.0), None))
    for own, half, quarter in ((known, unknown, known), (unknown, known, known), (known, known, unknown)):
        fewer = SimpleNamespace(_temperatures=half._temperatures, half=quarter)
        one: Any = SimpleNamespace(_temperatures=own._temperatures, half=fewer)
        assert Evaluated._winding(one) is ABSENT


def test_a_search_for_better_drives_begins_where_there_is_room() -> None:
    for left, begun in ((6, True), (5, False)):
        together: Any = object.__new__(search.Together)
        candidates = {"j": SimpleNamespace(masses=np.zeros(2))}
        together.search = SimpleNamespace(responses=SimpleNamespace(times=np.zeros(3)), candidates=candidates)
        together.order, together.left, together.done, calls = ["j"], left, True, []
        together._extend = lambda *given, calls=calls: calls.append(given)
        together.run(lambda text: None)
        assert (together.done, bool(calls)) == (begun, begun)


def test_joints_without_a_drive_may_have_a_gear_of_their_own() -> None:
    text = SINE.partition("drives:")[0].replace(
        "axis: [0, 0, 1]}", "axis: [0, 0, 1]}, {name: k, type: revolute, axis: [0, 0, 1], gear_ratio: 2}"
    )
    text = text.replace(
        "zz: 0.7}}", "zz: 0.7}}, {name: m, mass: 1, com: [0, 0, 0], inertia: {xx: 1, yy: 1, zz: 1}}"
    )
    text = text.replace("q: {j:", "q: {k: 0, j:")
    assert list(_asked(load_scene_text(text + "actuated: [j]\n"), None)) == ["j"]


GANTRY = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: x, type: prismatic, axis: [0.6, 0.8, 0]}
    - {name: y, type: prismatic, axis: [-0.8, 0.6, 0]}
  links: [{name: cart, mass: 3}, {name: lift, mass: 2}]
  points: {tip: {link: lift, at: [0, 0, 0]}}
catalogue:
  motors: {m: {type: dc, torque_constant: 0.2, resistance: 0.9, voltage: 90, max_current: 60, rated_current: 20, coulomb: 0.05}}
  gears: {s: {type: ball_screw, lead: 0.02, efficiency: 0.8, back_driving: 0.6}}
drives: {x: {motor: m, gear: s}, y: {motor: m, gear: s}}
initial: {q: {x: 0.362, y: 0.134}}
trajectory:
  type: path
  point: tip
  law: quintic
  start: {position: [0.11, 0.37, 0]}
  segments: [{type: line, to: [0.29, 0.61, 0], duration: 0.5}, {type: line, to: [0.17, 0.45, 0], duration: 0.5}]
inverse: {samples: 101}
"""


def test_rounding_decides_about_no_loss_of_a_drive_at_rest() -> None:
    """A path along one joint leaves the other rates of 1e-16 of both signs; it holds the lift's weight, without losses."""
    result = inverse(load_scene_text(GANTRY))
    rates = result["qd"][:, 1]
    assert 0.0 < np.abs(rates).max() < 1e-15
    figures = result.summary["drives"]["y"]
    held = 2.0 * 9.81 * 0.6 * 0.02 / (2.0 * math.pi)
    assert figures["shaft"]["peak_torque"] == pytest.approx(held, rel=1e-12)
    assert figures["shaft"]["errors"]["peak_torque"] < 1e-12 * held and figures["gear_loss"] == 0.0
    assert figures["electrical"]["rms_current"] == pytest.approx(held / 0.2, rel=1e-12)
