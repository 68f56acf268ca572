"""What a sampled controller does between its samples, and what it measures, against dense closed forms of a linear
plant."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import simulate
from tests.unit.test_control import cart, error_of, made, step_of

T, KP, KD, WANTED, LIMIT, UPDATES = 0.01, 160.0, 2.0, -0.3, 8.0, 60
FINE = 500  # steps of the closed form in a period


@dataclasses.dataclass
class Dense:
    """Sums of the cart under held forces."""

    driving: float = 0.0
    braking: float = 0.0
    saturated: float = 0.0
    squares: float = 0.0
    peak: float = 0.0


def dense(delay: float) -> Dense:
    """Return the sums of a PD with a limit by the exact steps of the plant, many a period."""
    whole, rest = divmod(round(delay / T, 9), 1.0)
    x, pending, acts, found = np.array([0.3, -0.2]), [0.0] * int(whole), 0.0, Dense(peak=0.6)
    for _ in range(UPDATES):
        pending.append(float(np.clip(KP * (WANTED - x[0]) - KD * x[1], -LIMIT, LIMIT)))
        new = pending.pop(0)
        for h, u in ((rest * T, acts), ((1.0 - rest) * T, new)):
            if not h:
                continue
            F, G = step_of(h / FINE)
            found.saturated += h * (abs(u) == LIMIT)
            for _ in range(FINE):
                then = F @ x + G * u
                middle = 0.5 * (x[0] + then[0]) - WANTED - (then[1] - x[1]) * h / FINE / 8.0
                work = u * (then[0] - x[0])
                found.driving += max(work, 0.0)
                found.braking += max(-work, 0.0)
                found.squares += (
                    h / FINE / 6.0 * ((x[0] - WANTED) ** 2 + 4.0 * middle**2 + (then[0] - WANTED) ** 2)
                )
                found.peak = max(found.peak, abs(then[0] - WANTED))
                x = then
        acts = new
    return found


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.013])
def test_figures_of_held_torques_are_covered_whatever_the_samples(delay: float) -> None:
    """Samples on the updates see nothing of what jumps there; those beside them all of it."""
    true, duration = dense(delay), UPDATES * T
    control = f"{{type: pd, period: {T}, delay: {delay}, limit: {LIMIT}, gains: {{kp: {KP}, kd: {KD}}}"
    control += f", reference: {{type: joint, duration: 1, q: {{x: '{WANTED}'}}}}}}"
    for samples in (UPDATES + 1, UPDATES + 2, 2 * UPDATES + 1, 3 * UPDATES - 1, 4 * UPDATES + 3):
        result = simulate(cart(control, duration, samples))
        told, turns = result.summary["control"], 1e-8  # turning points inside the steps of the closed form
        work, off = told["energy"], error_of(result)
        assert abs(work["driving"] - true.driving) <= work["error"] + turns
        assert abs(work["braking"] - true.braking) <= work["error"] + turns
        assert work["error"] < 1e-4 * true.braking
        assert abs(told["saturated"]["x"] - true.saturated) <= told["saturated_error"]["x"] + 1e-12
        assert told["saturated_error"]["x"] < 1e-9
        way = told["tracking"]["x"]
        assert abs(way["rms"] - np.sqrt(true.squares / duration)) <= way["errors"]["rms"] + off
        assert abs(way["peak"] - true.peak) <= way["errors"]["peak"] + off


def test_torques_between_samples_that_show_not_all_of_them_are_told_where_asked() -> None:
    control = f"{{type: pd, period: {T}, limit: {LIMIT}, gains: {{kp: {KP}, kd: {KD}}}, reference: {{type: joint, duration: 1, q: {{x: '{WANTED}'}}}}}}"
    rare = simulate(cart(control, 0.6, 21)).summary["control"]
    assert "energy" not in rare and "saturated" not in rare
    close = simulate(cart(control, 0.6, 6001)).summary["control"]
    for key in ("control.energy.driving", "control.saturated.x"):
        asked = simulate(cart(control, 0.6, 21, f"expect: {{{key}: < 100}}\n"))
        told = asked.summary["control"]
        assert abs(told["energy"]["driving"] - close["energy"]["driving"]) <= told["energy"]["error"] + 1e-9
        assert told["saturated"]["x"] == pytest.approx(close["saturated"]["x"], abs=1e-9)
        assert told["energy"]["driving"] > 0.0 and told["energy"]["error"] < 1e-7


ARM = Path(__file__).parents[2] / "configs" / "robots" / "planar_2r.yaml"
DRIVEN = f"""\
schema: 1
gravity: [0, -9.81, 0]
robot: {ARM}
drives:
  theta1: {{motor: servo2p4_3000, gear: wave40_100, brake: brake9, mass_on: none}}
  theta2: {{motor: servo1p27_3000, gear: wave32_100, brake: brake2, mass_on: none}}
initial: {{q: {{theta1: 0.2, theta2: 0.5}}}}
control:
  {{type: pd, joints: [theta1, theta2], period: 0.01, delay: 0.013, gains: {{kp: 900, kd: 40}},
    reference: {{type: joint, duration: 2, q: {{theta1: '0.5*sin(3*t)', theta2: '0.5+t'}}}}}}
simulate: {{duration: 0.4, samples: 41}}
"""


def test_drives_that_held_torques_move_have_the_figures_of_dense_samples() -> None:
    few, many = simulate(made(DRIVEN)), simulate(made(DRIVEN, "simulate.samples=16001"))
    t, load, rate = many["time"], many["drives/load"], many["qd"]
    for k, name in enumerate(("theta1", "theta2")):
        told = few.summary["drives"][name]["joint"]
        square, power = load[:, k] ** 2, load[:, k] * rate[:, k]
        near = 2e-3  # one side of each jump of the samples
        rms = np.sqrt(np.trapezoid(square, t) / t[-1])
        assert abs(told["rms_torque"] - rms) <= told["errors"]["rms_torque"] + near * rms
        for key, sign in (("driving_energy", 1.0), ("braking_energy", -1.0)):
            work = np.trapezoid(np.maximum(sign * power, 0.0), t)
            assert abs(told[key] - work) <= told["errors"]["energy"] + 1e-3 * abs(power).max() * t[-1]
        peak = np.abs(load[:, k]).max()
        assert peak * (1.0 - 1e-9) <= told["peak_torque"] + told["errors"]["peak_torque"] <= 1.001 * peak
        speed = np.abs(rate[:, k]).max()
        assert abs(told["peak_speed"] - speed) <= told["errors"]["peak_speed"] + 1e-6 * speed
        assert told["errors"]["rms_torque"] < 1e-3 * told["rms_torque"]
