"""Motors, gears and brakes against closed forms, and drives in scenes against what they stand for."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp, trapezoid

from robodyn_cli.drives.cycle import CycleSamples, ShaftDuty, motor_cycle
from robodyn_cli.errors import SceneError
from robodyn_cli.motors.electric import Supply
from robodyn_cli.motors.heat import Envelope, Thermal
from robodyn_cli.motors.kinds import BrushlessMotor, DcMotor
from robodyn_cli.over.findings import findings
from robodyn_cli.results.summary import dumps
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate

THERMAL = Thermal(
    winding_resistance=2.3,
    housing_resistance=5.1,
    winding_time=14.0,
    housing_time=420.0,
    max_temperature=155.0,
)
DC = DcMotor(
    type="dc", torque_constant=0.05, resistance=0.8, voltage=24.0, max_current=20.0, rotor_inertia=1e-5,
    coulomb=0.004, viscous=3e-6, thermal=THERMAL,
)  # fmt: skip


def summary_of(text: str, command: Any = inverse) -> dict[str, Any]:
    """Return the summary of a scene as it is stored."""
    found: dict[str, Any] = json.loads(dumps(command(load_scene_text(text)).summary))
    return found


# -- motors ----------------------------------------------------------------------------------------------------
def test_a_dc_motor_at_constant_speed() -> None:
    """U = R I + k w and k I = T + T_c + b w hold on the line that the voltage draws, and the current is cut before."""
    curves = DC.curves(Supply())
    speeds, torques = curves.driving.speeds, curves.driving.torques
    assert torques[0] == pytest.approx(0.05 * 20.0 - 0.004)
    corner = (24.0 - 0.8 * 20.0) / 0.05
    assert speeds[1] == pytest.approx(corner, rel=1e-12)
    free = speeds[-1]
    assert 0.05 * (24.0 - 0.05 * free) / 0.8 == pytest.approx(0.004 + 3e-6 * free)
    for w in np.linspace(1.01 * corner, 0.99 * free, 7):
        T = float(np.interp(w, speeds, torques))
        current = float(DC.current(np.array(T), np.array(w)))
        assert 0.8 * current + 0.05 * w == pytest.approx(24.0, rel=1e-12)
        assert float(curves.driving.use(np.array(w), np.array(T))) == pytest.approx(1.0, rel=1e-12)
    braking = curves.braking.torques
    assert braking[0] == pytest.approx(0.05 * 20.0 + 0.004) and np.all(np.diff(braking[:-1]) > 0.0)


def test_the_current_that_a_winding_bears_for_ever_heats_it_to_its_limit() -> None:
    current = DC.continuous_current(Supply(ambient=40.0))
    losses = np.array(0.8 * current**2)
    assert float(THERMAL.steady_mean(losses, 40.0)) == pytest.approx(155.0, rel=1e-12)
    assert float(THERMAL.steady_mean(np.array(1e4), 40.0)) == math.inf


def test_a_brushless_motor_keeps_to_its_voltage() -> None:
    """On the curve beyond the corner the phase voltage is U / sqrt(6), by phasors; losses and power balance."""
    motor = BrushlessMotor(
        type="brushless", torque_constant=0.9, resistance=4.0, voltage=320.0, max_current=9.0, rated_current=3.0,
        inductance=0.012, pole_pairs=4, coulomb=0.02, viscous=1e-4,
    )  # fmt: skip
    for sense, curve in ((1.0, motor.curves(Supply()).driving), (-1.0, motor.curves(Supply()).braking)):
        limited = 0
        for w, T in zip(curve.speeds[1:-1], curve.torques[1:-1]):
            current = (T + sense * (0.02 + 1e-4 * w)) / 0.9
            phasor = sense * 0.9 * w / 3.0 + 2.0 * current + 1j * 4 * w * 0.006 * current
            assert abs(phasor) <= 320.0 / math.sqrt(6.0) * (1.0 + 1e-12) and current <= 9.0 * (1.0 + 1e-12)
            at_voltage = abs(phasor) == pytest.approx(320.0 / math.sqrt(6.0), rel=1e-12)
            assert at_voltage or current == pytest.approx(9.0, rel=1e-12)
            limited += at_voltage
        assert limited > 5 or sense < 0.0
    # three phases: terminal power = shaft + friction + copper
    w, current = 100.0, 2.5
    terminal = 3.0 * (0.9 * w / 3.0 + 2.0 * current) * current
    shaft = 0.9 * current - float(motor.friction(np.array(w)))
    assert terminal == pytest.approx(
        shaft * w + float(motor.friction(np.array(w))) * w + float(motor.copper(np.array(current)))
    )


def test_use_scales_speed_and_torque_together() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        speeds = np.concatenate([[0.0], np.cumsum(rng.uniform(1.0, 30.0, 4))])
        torques = np.sort(rng.uniform(0.2, 5.0, 5))[::-1]
        curve = Envelope.through(list(zip(speeds.tolist(), torques.tolist())))
        w, T = rng.uniform(0.0, 150.0, 200), rng.uniform(-8.0, 8.0, 200)
        s = curve.use(w, T)
        inside = (w / s <= speeds[-1] * (1 + 1e-12)) & (
            np.abs(T) / s <= np.interp(w / s, speeds, torques) * (1.0 + 1e-9)
        )
        assert np.all(inside)
        beyond = np.abs(T) / (0.999 * s) > np.interp(w / (0.999 * s), speeds, torques)
        assert np.all(beyond | (w / (0.999 * s) > speeds[-1]))
    assert float(curve.use(np.array(0.0), np.array(0.0))) == 0.0


# -- heat ------------------------------------------------------------------------------------------------------
def network(t: float, x: Any, losses: Any) -> list[float]:
    C1, C2 = 14.0 / 2.3, 420.0 / 5.1
    flow = (x[0] - x[1]) / 2.3
    return [(losses(t) - flow) / C1, (flow - x[1] / 5.1) / C2]


def test_a_step_of_losses_warms_the_winding_as_the_network_does() -> None:
    times = np.linspace(0.0, 900.0, 4501)
    found = THERMAL.warming(np.full(4501, 9.0), times, periodic=False)
    exact = solve_ivp(
        network, (0.0, 900.0), [0.0, 0.0], args=(lambda t: 9.0,), t_eval=times, rtol=1e-11, atol=1e-11
    )
    assert np.allclose(found, exact.y[0], rtol=0.0, atol=1e-7)
    assert np.allclose(
        THERMAL.warming(np.full((2, 11), 9.0), 3.0 * np.arange(11.0), periodic=True), 9.0 * 7.4, rtol=1e-12
    )


def test_after_many_cycles_the_temperature_is_periodic() -> None:
    period, losses = 20.0, lambda t: 30.0 * np.sin(np.pi * t / 20.0) ** 4
    times = np.linspace(0.0, period, 2001)
    found = THERMAL.warming(losses(times), times, periodic=True)
    exact = solve_ivp(
        network, (0.0, 400 * period), [80.0, 55.0], args=(losses,), rtol=1e-9, atol=1e-9, max_step=2.0
    )
    last = solve_ivp(
        network,
        (0.0, period),
        exact.y[:, -1],
        args=(losses,),
        t_eval=times,
        rtol=1e-11,
        atol=1e-11,
        max_step=1.0,
    )
    # losses linear between samples: 30 pi^2 h^2 / 12 / period^2 of them
    assert np.allclose(found, last.y[0], rtol=0.0, atol=2e-4)
    assert found[0] == pytest.approx(found[-1], rel=1e-12)


# -- drives in scenes --------------------------------------------------------------------------------------------
ARM = """
schema: 1
gravity: [1.3, -2.1, -9.2]
robot:
  {convention}
  joints:
    - {{name: a, type: revolute, {first}{a}}}
    - {{name: s, type: prismatic, {second}{s}}}
    - {{name: b, type: revolute, {third}{b}}}
  links:
    - {{name: A, mass: 3.0, com: [0.2, 0.05, -0.1], com_frame: joint, inertia: {{xx: 0.2, yy: 0.3, zz: 0.25, xy: 0.02, xz: -0.01, yz: 0.03}}}}
    - {{name: S, mass: 2.0, com: [0.1, -0.05, 0.1], com_frame: joint, inertia: {{xx: 0.1, yy: 0.2, zz: 0.15, xy: 0.01, xz: 0.02, yz: -0.03}}}}
    - {{name: B, mass: 1.0, com: [0.3, 0.02, 0.04], com_frame: joint, inertia: {{xx: 0.05, yy: 0.06, zz: 0.07, xy: 0.004, xz: 0.003, yz: 0.002}}}}
{attach}
trajectory:
  type: joint
  duration: 3
  q: {{a: "0.8*sin(2*pi*t/3)", s: "0.3 + 0.1*cos(2*pi*t/3)", b: "0.5*sin(4*pi*t/3) + 0.2*cos(2*pi*t/3)"}}
inverse: {{samples: 1801}}
{drives}
catalogue:
  motors:
    m: {{type: dc, mass: 1.7, cost: 10, torque_constant: 0.2, resistance: 0.9, voltage: 90, max_current: 60, rated_current: 20, rotor_inertia: 3e-4, coulomb: 0.01, viscous: 2e-5, thermal: {{winding_resistance: 0.4, housing_resistance: 0.6, winding_time: 20, housing_time: 900, max_temperature: 150}}}}
  gears:
    g: {{type: gear, ratio: 40, efficiency: 0.8, back_driving: 0.5, inertia: 1e-4, mass: 0.9, cost: 5, peak_torque: 90, rated_torque: 60, max_speed: 400, stiffness: 9000}}
    screw: {{type: ball_screw, lead: 0.02, efficiency: 0.9, inertia: 2e-4, mass: 0.8, cost: 4}}
  brakes:
    k: {{holding_torque: 3, inertia: 5e-5, mass: 0.4, cost: 2}}
"""
PLACED = {
    "axes": ("", "axis: [0.2, 0.3, 1], origin: {xyz: [0.1, 0, 0.3], rpy: [0.2, -0.1, 0.4]}",
             "axis: [1, 0.2, 0], origin: {xyz: [0.4, 0.1, 0], rpy: [0.3, 0, 0.1]}",
             "axis: [0, 1, 0.4], origin: {xyz: [0.1, 0.3, 0.2], rpy: [0, 0.5, 0]}"),
    "standard": ("convention: standard", "a: 0.4, alpha: 0.6, d: 0.2", "a: 0.1, alpha: -0.4, theta: 0.3", "a: 0.3, alpha: 0.2, d: 0.1"),
    "modified": ("convention: modified", "a: 0.4, alpha: 0.6, d: 0.2", "a: 0.1, alpha: -0.4, theta: 0.3", "a: 0.3, alpha: 0.2, d: 0.1"),
}  # fmt: skip
DRIVES = "drives: {a: {motor: m, gear: g, count: 2}, s: {motor: m, gear: screw}, b: {motor: m, gear: g, brake: k, coupling_inertia: 7.0e-5}}"


def arm(placed: str, drives: str = DRIVES, a: str = "", s: str = "", b: str = "", attach: str = "") -> str:
    convention, first, second, third = PLACED[placed]
    return ARM.format(
        convention=convention,
        first=first,
        second=second,
        third=third,
        drives=drives,
        a=a,
        s=s,
        b=b,
        attach=attach,
    )


@pytest.mark.parametrize("placed", PLACED)
def test_rotors_gears_and_masses_are_those_of_a_robot_that_has_them_itself(placed: str) -> None:
    """The same robot with rotors, ratios and point masses written out needs the same torques, and moves alike."""
    joints = {"a": (40.0, 2 * 4e-4), "s": (2 * math.pi / 0.02, 5e-4), "b": (40.0, 5.2e-4)}
    own = {n: f", gear_ratio: {N!r}, rotor_inertia: {J!r}" for n, (N, J) in joints.items()}
    # the drives of s and b are carried by A and S, at the origin of the joints' frames
    low = f"[0.3, {-0.1 * math.sin(0.2)!r}, {0.1 * math.cos(0.2)!r}]"  # a modified frame lies behind a, alpha and d
    placements = {
        "axes": ("[0.4, 0.1, 0]", "[0.1, 0.3, 0.2]"), "standard": ("[0, 0, 0]",) * 2, "modified": ("[0.1, 0, 0]", low)
    }  # fmt: skip
    at = placements[placed]
    masses = "\n".join(
        f"    - {{link: d{k}, to: {link}, origin: {{xyz: {xyz}}}, mass: {mass}, com: [0, 0, 0], com_frame: joint, inertia: {{xx: 0, yy: 0, zz: 0}}}}"
        for k, (link, xyz, mass) in enumerate((("A", at[0], 2.5), ("S", at[1], 3.0)))
    )
    driven = inverse(load_scene_text(arm(placed)))
    other = inverse(load_scene_text(arm(placed, "", **own, attach="  attach:\n" + masses)))
    scale = np.abs(other["tau"]).max()
    assert np.abs(driven["tau"] - other["tau"]).max() < 1e-12 * scale


@pytest.mark.parametrize("placed", ["axes", "standard"])
def test_where_a_mass_is_carried(placed: str) -> None:
    """On the link that the joint moves it is at the same place; `none` leaves it out."""
    none = DRIVES.replace("}", ", mass_on: none}")
    own = {
        "a": ", gear_ratio: 40, rotor_inertia: 8e-4",
        "s": ", gear_ratio: 100*pi, rotor_inertia: 5e-4",
        "b": ", gear_ratio: 40, rotor_inertia: 5.2e-4",
    }
    without = inverse(load_scene_text(arm(placed, none.replace("}, mass_on: none}", "}}"))))["tau"]
    assert np.allclose(without, inverse(load_scene_text(arm(placed, "", **own)))["tau"], rtol=0, atol=1e-11)
    on_b = inverse(load_scene_text(arm(placed, DRIVES.replace("brake: k", "brake: k, mass_on: B"))))["tau"]
    at_b = inverse(load_scene_text(arm(placed)))["tau"]
    # a revolute joint's origin does not move against the link before it: no torque tells them apart
    assert np.allclose(on_b, at_b, rtol=0, atol=1e-11)


def test_a_gear_loses_what_the_key_gear_of_a_joint_loses() -> None:
    """n times the torque of the motors is what `inverse` finds with `gear` in the joint."""
    own = ", gear_ratio: 40, rotor_inertia: 4e-4, gear: {efficiency: 0.8, back_driving: 0.5}"
    drives = "drives: {b: {motor: m, gear: g, mass_on: none}}"
    driven = inverse(load_scene_text(arm("axes", drives)))
    other = inverse(load_scene_text(arm("axes", "", b=own)))
    assert np.allclose(40.0 * driven["drives/torque"][:, 0], other["tau"][:, 2], rtol=0, atol=1e-11)
    lost = other["torque_terms/gear"][:, 2] * other["qd"][:, 2]
    from robodyn_cli.solve.extremes import integral

    loss = summary_of(arm("axes", drives))["drives"]["b"]["gear_loss"]
    assert loss == pytest.approx(float(integral(driven.time, lost[:, None])[0][0]), rel=1e-5)


@pytest.mark.parametrize("placed", PLACED)
def test_energy_from_the_supply_goes_somewhere(placed: str) -> None:
    """electrical = mechanical at the joint + gear + bearings + copper, over a cycle after which rotors turn as before."""
    for name, drive in summary_of(arm(placed))["drives"].items():
        electrical, joint, count = drive["electrical"], drive["joint"], drive["count"]
        supplied = count * (electrical["energy"] - electrical["regenerated"])
        work = joint["driving_energy"] - joint["braking_energy"]
        losses = drive["gear_loss"] + count * (electrical["copper_loss"] + electrical["friction_loss"])
        # kinks where torques and speeds change their signs limit the quadrature, as the stated error says
        bound = 10.0 * (
            electrical["errors"]["energy"] + joint["errors"]["energy"] + 1e-6 * electrical["energy"]
        )
        assert supplied == pytest.approx(work + losses, abs=bound), name
        assert bound < 0.05 * electrical["energy"]


def test_a_sinusoid_of_an_inertia_has_closed_figures() -> None:
    """I A w^2 sin: rms and peak of torque, mean of |sin|, RMS current, mean copper losses."""
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: j, type: revolute, axis: [0, 0, 1]}]
  links: [{name: l, mass: 1, com: [0, 0, 0], com_frame: joint, inertia: {xx: 1, yy: 1, zz: 0.7}}]
trajectory: {type: joint, duration: 2, q: {j: "0.3*sin(2*pi*t)"}}
inverse: {samples: 2001}
drives: {j: {motor: m, gear: g, ambient: 30}}
catalogue:
  motors: {m: {type: dc, torque_constant: 0.1, resistance: 0.5, voltage: 48, max_current: 30, rotor_inertia: 2e-4, thermal: {winding_resistance: 2, housing_resistance: 3, winding_time: 10, housing_time: 300, max_temperature: 120}}}
  gears: {g: {type: gear, ratio: 20}}
"""
    drive = summary_of(text)["drives"]["j"]
    top = 0.3 * (2 * math.pi) ** 2
    assert drive["joint"]["peak_torque"] == pytest.approx(0.7 * top, rel=1e-6)
    assert drive["joint"]["rms_torque"] == pytest.approx(0.7 * top / math.sqrt(2), rel=1e-9)
    motor = (0.7 / 20 + 2e-4 * 20) * top
    assert drive["shaft"]["rms_torque"] == pytest.approx(motor / math.sqrt(2), rel=1e-9)
    assert drive["shaft"]["mean_torque"] == pytest.approx(motor * 2 / math.pi, rel=1e-5)
    assert drive["shaft"]["driving_energy"] == pytest.approx(
        2.0 * motor * 0.3 * 20 * 2 * math.pi / (2 * math.pi), rel=1e-8
    )
    assert drive["shaft"]["braking_energy"] == pytest.approx(drive["shaft"]["driving_energy"], rel=1e-9)
    assert drive["inertia_ratio"] == pytest.approx([0.7 / (400 * 2e-4)] * 2)
    heat = 0.5 * (motor / 0.1) ** 2 / 2
    mean = (30 + 5 * heat * (1 - 0.00393 * 25)) / (1 - 5 * heat * 0.00393)
    assert drive["winding"]["mean"] == pytest.approx(mean, rel=1e-6)
    assert drive["limits"]["winding"]["use"] == pytest.approx((drive["winding"]["peak"] - 30) / 90, rel=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_figures_of_random_motions_are_within_their_errors(seed: int) -> None:
    """Sums over 30 times as many samples, of the formulas of gear, motor and winding; the winding by its network."""
    rng = np.random.default_rng(seed)

    def waves(size: float) -> str:
        parts = [f"{size * rng.normal() / k!r}*sin(2*pi*{k}*t/3 + {rng.uniform(0, 6)!r})" for k in (1, 2, 3)]
        return " + ".join(parts)

    text = arm("axes").replace('"0.8*sin(2*pi*t/3)"', f'"{waves(0.4)}"')
    text = text.replace('"0.3 + 0.1*cos(2*pi*t/3)"', f'"{waves(0.05)}"')
    text = text.replace('"0.5*sin(4*pi*t/3) + 0.2*cos(2*pi*t/3)"', f'"{waves(0.3)}"')
    coarse = summary_of(text.replace("samples: 1801", "samples: 401"))["drives"]
    fine = inverse(load_scene_text(text.replace("samples: 1801", "samples: 12001")))
    t = fine["time"]
    gears = {"a": (40.0, 0.8, 0.5), "s": (2.0 * np.pi / 0.02, 0.9, 0.9), "b": (40.0, 0.8, 0.5)}
    shafts = {"a": 4e-4, "s": 5e-4, "b": 3e-4 + 1e-4 + 5e-5 + 7e-5}  # rotor, gear, brake, coupling
    for k, (name, (n, forward, backward)) in enumerate(gears.items()):
        drive, qd, qdd = coarse[name], fine["qd"][:, k], fine["qdd"][:, k]
        count = drive["count"]
        errors = drive["shaft"]["errors"] | {"rms_current": drive["electrical"]["errors"]["rms_current"]}
        load = (fine["tau"][:, k] - count * n**2 * shafts[name] * qdd) / count
        torque = load * np.where(load * qd >= 0.0, 1.0 / forward, backward) / n + shafts[name] * n * qdd
        w = n * qd
        current = (torque + 0.01 * np.sign(w) + 2e-5 * w) / 0.2
        cold = 0.9 * current**2
        mean = (25.0 + (trapezoid(cold, t) / 3.0) * (1.0 - 0.00393 * 25.0)) / (
            1.0 - (trapezoid(cold, t) / 3.0) * 0.00393
        )
        copper = cold * (1.0 + 0.00393 * (mean - 25.0))
        power = torque * w
        electrical = power + 0.2 * current * w - power + copper
        found = {
            "rms_torque": (drive["shaft"]["rms_torque"], np.sqrt(trapezoid(torque**2, t) / 3.0)),
            "mean_torque": (drive["shaft"]["mean_torque"], trapezoid(np.abs(torque), t) / 3.0),
            "peak_torque": (drive["shaft"]["peak_torque"], np.abs(torque).max()),
            "rms_current": (drive["electrical"]["rms_current"], np.sqrt(trapezoid(current**2, t) / 3.0)),
        }
        energies = {
            "driving_energy": (drive["shaft"], power),
            "braking_energy": (drive["shaft"], -power),
            "energy": (drive["electrical"], electrical),
            "regenerated": (drive["electrical"], -electrical),
        }
        for key, (own, true) in found.items():
            # the largest of samples lies below that at a jump
            assert own == pytest.approx(true, abs=10.0 * errors[key] + 5e-4 * true), (name, key)
            # the largest torque may be at a jump of the gear's losses
            assert errors[key] < (0.1 if key == "peak_torque" else 0.02) * true
        for key, (side, flow) in energies.items():
            true, whole = trapezoid(np.maximum(flow, 0.0), t), trapezoid(np.abs(flow), t)
            assert side[key] == pytest.approx(true, abs=10.0 * side["errors"]["energy"] + 1e-4 * whole), (
                name,
                key,
            )
        assert errors["energy"] < 0.02 * whole


def test_torques_of_inverse_move_the_driven_robot_along_its_motion() -> None:
    """`simulate` has the same rotors and masses: the figures of its drives are those of `inverse`."""
    text = arm("axes")
    found = inverse(load_scene_text(text))
    rows = {n: np.column_stack([found.time, found["tau"][:, k]]).tolist() for k, n in enumerate("asb")}
    start = {n: float(found["q"][0, k]) for k, n in enumerate("asb")}
    rates = {n: float(found["qd"][0, k]) for k, n in enumerate("asb")}
    torques = "torques: " + json.dumps({n: {"table": x} for n, x in rows.items()})
    again = text + torques + f"\ninitial: {json.dumps({'q': start, 'qd': rates})}\n"
    moved = simulate(
        load_scene_text(
            again + "simulate: {duration: 3, samples: 1801, error_estimate: false, rtol: 1e-8, atol: 1e-9}\n"
        )
    )
    # the table is linear between samples: curvature of the torques times h^2 / 8 stays for 3 s
    assert np.abs(moved["q"] - found["q"]).max() < 1e-4
    one, other = found.summary["drives"], moved.summary["drives"]
    for name in "asb":
        assert other[name]["shaft"]["rms_torque"] == pytest.approx(one[name]["shaft"]["rms_torque"], rel=1e-4)
        assert other[name]["winding"]["peak"] == pytest.approx(one[name]["winding"]["peak"], rel=1e-3)


def test_the_inertia_at_the_crank_of_a_four_bar_is_that_of_its_kinetic_energy() -> None:
    text = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: crank, type: revolute, parent: base, a: 0.3, alpha: 0, d: 0}
    - {name: couple, type: revolute, parent: L1, a: 1.0, alpha: 0, d: 0}
    - {name: rocker, type: revolute, parent: base, a: 0.8, alpha: 0, d: 0, origin: {xyz: [0.9, 0, 0]}}
  links:
    - {name: L1, mass: 2, com: [0.1, 0.02, 0], com_frame: joint, inertia: {zz: 0.05}}
    - {name: L2, mass: 1, com: [0.4, 0, 0], com_frame: joint, inertia: {zz: 0.06}}
    - {name: L3, mass: 1.5, com: [0.25, 0, 0], com_frame: joint, inertia: {zz: 0.04}}
loops: [{name: pin, type: revolute, between: [L2.end, L3.end]}]
actuated: [crank]
initial: {q: {crank: 0.5, couple: 0.6, rocker: 1.9}, hold: [crank]}
trajectory: {type: joint, duration: 2, q: {crank: "0.5 + 2.0*t + 0.1*sin(3*t)"}}
inverse: {samples: 401}
drives: {crank: {motor: servo2p4_3000, gear: planet60_20, brake: brake9}}
"""
    found = inverse(load_scene_text(text))
    drive = found.summary["drives"]["crank"]
    reflected = 400 * (0.000124 + 9.1e-6 + 5.5e-5)
    inertia = 2.0 * found["energy/kinetic"] / found["qd"][:, 0] ** 2 - reflected
    assert drive["inertia_ratio"] == pytest.approx(
        [inertia.min() / reflected, inertia.max() / reflected], rel=1e-4
    )
    # what holds it at rest is the slope of the potential energy along the crank
    slope = np.abs(np.gradient(found["energy/potential"], found["q"][:, 0], edge_order=2))
    assert drive["limits"]["brake"]["use"] * 9.0 * 20 == pytest.approx(slope.max(), rel=1e-3)


def test_a_motor_far_too_small_has_finite_figures() -> None:
    drives = "drives: {a: {motor: m}, s: {motor: m, gear: screw}}"
    found = summary_of(arm("axes", drives))
    assert found["status"] == "undersized" and found["drives"]["a"]["passes"] is False
    assert found["drives"]["a"]["margin"] < -1.0
    # its losses grow faster than the heat leaves: no steady temperature, and a warning says so
    assert "winding" not in found["drives"]["a"] and math.isfinite(
        found["drives"]["a"]["limits"]["winding"]["use"]
    )
    assert any("no steady state" in warning for warning in found["warnings"])


def test_a_margin_that_is_asked_for_decides() -> None:
    left = summary_of(arm("axes"))["drives"]["s"]["margin"]
    assert 0.05 < left < 0.95
    for asked, passes in ((left - 0.01, True), (left + 0.01, False)):
        text = arm("axes", DRIVES.replace("gear: screw", f"gear: screw, margin: {asked}"))
        assert summary_of(text)["drives"]["s"]["passes"] is passes


def test_steady_losses_of_a_stepper_do_not_depend_on_its_load() -> None:
    text = arm("axes", "drives: {b: {motor: step, gear: g}}").replace(
        "  gears:\n",
        "    step: {type: stepper, rotor_inertia: 1e-4, pull_out: [[0, 4], [100, 3], [300, 1]], current: 2, resistance: 0.6, thermal: {winding_resistance: 1, housing_resistance: 3, winding_time: 20, housing_time: 900, max_temperature: 130}}\n  gears:\n",
    )
    drive = summary_of(text)["drives"]["b"]
    losses = 2 * 0.6 * 4.0
    mean = (25 + 4 * losses * (1 - 0.00393 * 25)) / (1 - 4 * losses * 0.00393)
    assert drive["winding"]["mean"] == pytest.approx(mean, rel=1e-9)
    assert drive["winding"]["peak"] == pytest.approx(mean, rel=1e-9) and "electrical" not in drive


def test_many_gears_at_once_are_each_alone() -> None:
    """The arrays of many cycles, as sizing has them, hold the cycle of each."""
    rng = np.random.default_rng(2)
    asked = ShaftDuty(*rng.normal(size=(3, 4, 301)), rng.uniform(0, 1e-4, (4, 1)))
    every = motor_cycle(DC, Supply(), asked, CycleSamples(0.01 * np.arange(301.0)))
    for k in range(4):
        alone = motor_cycle(
            DC,
            Supply(),
            ShaftDuty(asked.speed[k], asked.acceleration[k], asked.torque[k], asked.inertia[k, 0]),
            CycleSamples(0.01 * np.arange(301.0)),
        )
        assert every.temperature is not None and alone.temperature is not None
        assert np.allclose(every.temperature[k], alone.temperature, rtol=1e-13)
        assert np.array_equal(every.torque[k], alone.torque)


# -- bad input ---------------------------------------------------------------------------------------------------
BAD = {
    "drives: {q: {motor: m}}": r"drives.q: unknown joint 'q'; allowed: a, s, b",
    "drives: {a: {motor: n}}": r"drives.a.motor: unknown motor 'n'; allowed: m",
    "drives: {a: {motor: m, gear: h}}": r"drives.a.gear: unknown gear 'h'; allowed: g, screw",
    "drives: {a: {motor: m, brake: h}}": r"drives.a.brake: unknown brake 'h'; allowed: k",
    "drives: {a: {gear: g}}": r"drives.a: key 'motor' is missing",
    "drives: {a: {motor: m, gear: screw}}": r"drives.a.gear: joint 'a' turns, and this gear moves a slide; allowed: g",
    "drives: {s: {motor: m}}": r"drives.s: joint 's' needs a gear that moves a slide; allowed: screw",
    "drives: {a: {motor: m, mass_on: Z}}": r"drives.a.mass_on: unknown link 'Z'; allowed: base, A, S, B, none",
    "drives: {a: {motor: m, mass_on: B}}": r"drives.a.mass_on: joint 'a' is not on link 'B'; .*with 'mass_at' beside it",
    "drives: {a: {motor: m, mass_on: none, mass: 2}}": r"drives.a.mass: does nothing with 'mass_on: none'",
    "drives: {a: {motor: m, count: 0}}": r"drives.a.count: .*allowed: a whole number >= 1",
    "drives: {a: {motor: m, voltage: 0.01}}": r"drives.a.voltage: motor 'm' cannot run on this: .*friction",
    "drives: {a: {motor: m, ambient: 160}}": r"drives.a.ambient: motor 'm' cannot run on this: .*too hot",
    "drives: {a: {motor: m, gearing: g}}": r"drives.a.gearing: unknown key 'gearing' \(did you mean 'gear'\?\)",
    "actuated: [s, b]\ndrives: {a: {motor: m}}": r"drives.a: joint 'a' is not in 'actuated'; allowed: s, b",
}


@pytest.mark.parametrize("drives", BAD)
def test_wrong_drives(drives: str) -> None:
    with pytest.raises(SceneError, match=r"<text>:\d+:\d+: " + BAD[drives]):
        load_scene_text(arm("axes", drives))


@pytest.mark.parametrize("key", ["gear_ratio: 3", "rotor_inertia: 1e-4", "gear: {efficiency: 0.9}"])
def test_a_joint_says_nothing_of_its_drive_twice(key: str) -> None:
    name = key.partition(":")[0]
    with pytest.raises(
        SceneError, match=rf"robot.joints.0.{name}: joint 'a': '{name}' says what its drive says too"
    ):
        load_scene_text(arm("axes", a=f", {key}"))


def test_all_that_is_wrong_with_drives_is_told_at_once(tmp_path: Path) -> None:
    own = ", gear_ratio: 3, rotor_inertia: 1e-4, friction: {viscous: 0.1, side: motor}"
    drives = "drives: {a: {motor: x, gear: y, mass_on: z}, s: {motor: m, gear: g}, d: {motor: m}}"
    path = tmp_path / "arm.yaml"
    path.write_text(arm("axes", drives, a=own), encoding="utf-8")
    told = "\n".join(finding.message for finding in findings(path))
    for words in (
        "robot.joints.0.gear_ratio: joint 'a': 'gear_ratio' and 'rotor_inertia' and 'friction.side' say what its drive",
        "drives.a.motor: unknown motor 'x'",
        "drives.a.gear: unknown gear 'y'",
        "drives.a.mass_on: unknown link 'z'",
        "drives.s.gear: joint 's' needs a gear that moves a slide",
        "drives.d: unknown joint 'd'",
    ):
        assert words in told, words


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ratio: 40", "ratio: 0", r"catalogue.gears.g.ratio: is too small \(value 0\); allowed: a number > 0"),
        ("voltage: 90, ", "", r"catalogue.motors.m: key 'voltage' is missing"),
        ("rated_current: 20, ", "", None),
        ("type: dc", "type: ac", r"catalogue.motors.m.type: unknown choice 'ac'.*allowed: dc, brushless, stepper, envelope"),
        ("lead: 0.02", "lead: -1", r"catalogue.gears.screw.lead: .*allowed: a number > 0 \[m\]"),
        ("efficiency: 0.8", "efficiency: 80", r"catalogue.gears.g.efficiency: is too large \(value 80\); allowed: a number >= 0.01 and <= 1"),
        ("holding_torque: 3, ", "", r"catalogue.brakes.k: key 'holding_torque' is missing"),
    ],
)  # fmt: skip
def test_a_wrong_catalogue(old: str, new: str, message: str | None) -> None:
    text = arm("axes").replace(old, new, 1)
    if message is None:  # the thermal data say it
        load_scene_text(text)
        start = text.index(", thermal")
        text = text[:start] + text[text.index("}}", start) + 1 :]
        message = r"catalogue.motors.m: has no continuous envelope: give 'rated_current' or 'thermal'"
    assert DRIVES in text
    for written in (text, text.replace(DRIVES, "")):  # ``size`` looks for drives in it
        with pytest.raises(SceneError, match=r"<text>:\d+:\d+: " + message):
            load_scene_text(written)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("[[1, 2], [3, 1]]", r"peak.0.0: the first speed is 0 \(value 1\)"),
        ("[[0, 2], [0, 1]]", r"peak.1.0: speeds must increase"),
        ("[[0, 2], [3, -1]]", r"peak.1.1: .*allowed: a number >= 0"),
        ("[[0, 2], [3, 1], [4, 5]]", r"peak.2.1: the torque must not rise faster than the speed"),
        ("[[0, 2]]", r"peak: .*has 1 entry"),
    ],
)
def test_a_wrong_envelope(rows: str, message: str) -> None:
    motor = f"    t: {{type: envelope, peak: {rows}, continuous: [[0, 1], [3, 1]]}}\n  gears:\n"
    with pytest.raises(SceneError, match=r"<text>:\d+:\d+: catalogue.motors.t." + message):
        load_scene_text(arm("axes").replace("  gears:\n", motor))


CSV = """\
# plausible figures
name, type, mass, torque_constant, resistance, voltage, max_current, rated_current, ratio, efficiency, peak, continuous, thermal.winding_resistance, thermal.housing_resistance, thermal.winding_time, thermal.housing_time, thermal.max_temperature, holding_torque
m, dc, 1.5, 0.2, 0.9, 90, 60, , , , , , 0.4, 0.6, 20, 900, 150,
t, envelope, , , , , , , , , 0 8; 100 4, 0 3; 100 2, , , , , ,
g, gear, 0.9, , , , , , 40, 0.8, , , , , , , ,
k, brake, 0.4, , , , , , , , , , , , , , , 3
"""


def with_csv(folder: Path, csv: str) -> str:
    (folder / "parts.csv").write_text(csv, encoding="utf-8")
    text = arm("axes", "drives: {a: {motor: m, gear: g}, b: {motor: t, gear: g, brake: k}}")
    return text[: text.index("catalogue:")] + "catalogue: parts.csv\n"


def test_a_catalogue_in_csv_is_one_in_yaml(tmp_path: Path) -> None:
    scene = load_scene_text(with_csv(tmp_path, CSV), str(tmp_path / "scene.yaml"))
    catalogue = scene.catalogue
    assert (
        catalogue.motors["m"].thermal.max_temperature == 150 and catalogue.motors["m"].rated_current is None
    )
    assert catalogue.motors["t"].peak == ((0.0, 8.0), (100.0, 4.0))
    assert catalogue.gears["g"].ratio == 40 and catalogue.brakes["k"].holding_torque == 3
    again = load_scene_text(scene.text, str(tmp_path / "other.yaml"))
    assert again.catalogue == catalogue


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ratio,", "ration,", r"parts.csv:2:\d+: catalogue: unknown column 'ration' \(did you mean 'ratio'\?\); allowed: name, type"),
        ("m, dc", "m, ac", r"parts.csv:3:4: catalogue.type: unknown type of part 'm' .value 'ac'.; allowed: dc, brushless"),
        ("0.4, 0.6, 20", "0.4, x, 20", r"parts.csv:3:\d+: catalogue.motors.m.thermal.housing_resistance: .*'x'"),
        ("g, gear, 0.9, ,", "g, gear, 0.9, 7,", r"parts.csv:5:\d+: catalogue.gears.g.torque_constant: unknown key"),
        (", , 40, 0.8", ", , 0, 0.8", r"parts.csv:5:\d+: catalogue.gears.g.ratio: .*allowed: a number > 0"),
        ("k, brake, 0.4,", "k, brake,", r"parts.csv:6:1: catalogue: has 17 cells; needed: 18"),
        ("t, envelope", "m, envelope", r"parts.csv:4:1: catalogue.motors.m: appears twice"),
    ],
)  # fmt: skip
def test_a_wrong_csv(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        load_scene_text(with_csv(tmp_path, CSV.replace(old, new, 1)), str(tmp_path / "scene.yaml"))


def test_every_motor_of_the_example_catalogue_can_be_driven() -> None:
    scene = load_scene_text(
        arm("axes", "drives: {a: {motor: dc63_300w, gear: wave20_100}}").partition("catalogue:")[0]
    )
    catalogue = scene.catalogue
    assert len(catalogue.motors) >= 40 and len(catalogue.gears) >= 20 and "no products" in catalogue.title
    for motor in catalogue.motors.values():
        curves = motor.curves(Supply())
        assert np.all(np.diff(np.arctan2(curves.driving.torques, curves.driving.speeds)) < 0.0)
        assert motor.mass > 0.0 and motor.cost > 0.0 and motor.rotor_inertia > 0.0
