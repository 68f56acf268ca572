"""Shaking forces, flywheels and fluctuation of speed against reactions, closed forms and energy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene, load_scene_text, simulate
from robodyn_cli.errors import CapabilityError, RobodynError, SceneError
from robodyn_cli.over.checks import inverse as check
from robodyn_cli.report.registry import applicable, draw
from robodyn_cli.results.result import Result
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.kinematics import kinematics
from tests.mechanisms import CONFIGS, close

ENGINE = CONFIGS / "mechanisms" / "flywheel.yaml"


def engine(*overrides: str) -> Result:
    return inverse(load_scene(ENGINE, overrides))


def test_shaking_is_what_the_ground_bears_beside_weight() -> None:
    """Reactions come from the multipliers of the loops, shaking from momentum alone."""
    result = engine("outputs.reactions=true", "outputs.reaction_axes=world")
    names = list(result.variables["shaking"].names)
    ground = result["base_wrench"][:, [list(result.variables["base_wrench"].names).index(n) for n in names]]
    weight = np.zeros_like(ground)
    weight[:, names.index("fy")] = 9.81 * 3.0
    q = result["q"]
    # the weights' lever arms, by hand
    arm = 0.03 * np.cos(q[:, 0])
    rod = 0.1 * np.cos(q[:, 0]) + 0.1 * np.cos(q[:, 0] + q[:, 1])
    weight[:, names.index("mz")] = 9.81 * (arm + 0.8 * rod + 1.2 * q[:, 2])
    close(-result["shaking"], ground - weight, 1e-9)


def test_moment_about_another_point() -> None:
    about = "robot.points.there={link: base, at: [0.2, -0.1, 0]}"
    here, there = engine(), engine(about, "inverse.shaking=there")
    names = list(here.variables["shaking"].names)
    f = here["shaking"][:, :2]
    shifted = here["shaking"][:, names.index("mz")] - (0.2 * f[:, 1] + 0.1 * f[:, 0])
    close(there["shaking"][:, names.index("mz")], shifted, 1e-9)
    assert there.summary["shaking"]["peak_force"] == pytest.approx(here.summary["shaking"]["peak_force"])


def test_counterweights_take_the_shaking_force_off() -> None:
    """Berkof and Lowen: m1 z1 = -m2 a1 (1 - z2/a2), m3 z3 = -m2 a3 z2/a2."""
    m2, z2, a1, a2, a3 = 2.0, complex(0.5, 0.1), 0.4, 1.2, 0.9
    z1, z3 = -m2 * a1 * (1 - z2 / a2) / 4.0, -m2 * a3 * (z2 / a2) / 5.0
    text = f"""
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {{name: crank, type: revolute, axis: [0, 0, 1]}}
    - {{name: coupler, type: revolute, axis: [0, 0, 1], origin: {{xyz: [{a1}, 0, 0]}}}}
    - {{name: rocker, type: revolute, axis: [0, 0, 1], parent: base, origin: {{xyz: [1.0, 0, 0]}}}}
  links:
    - {{name: arm, mass: 4, com: [{z1.real!r}, {z1.imag!r}, 0], com_frame: joint, inertia: {{zz: 0.05}}}}
    - {{name: bar, mass: 2, com: [0.5, 0.1, 0], com_frame: joint, inertia: {{zz: 0.3}}}}
    - {{name: swing, mass: 5, com: [{z3.real!r}, {z3.imag!r}, 0], com_frame: joint, inertia: {{zz: 0.2}}}}
  points: {{pin: {{link: bar, at: [1.2, 0, 0]}}, tip: {{link: swing, at: [0.9, 0, 0]}}}}
loops: [{{name: pin, type: revolute, between: [pin, tip]}}]
actuated: [crank]
initial: {{q: {{crank: 0, coupler: 0.9, rocker: 1.5}}}}
trajectory: {{type: joint, duration: 1, q: {{crank: "2*pi*t"}}}}
inverse: {{samples: 91, shaking: base.origin}}
"""
    result = inverse(load_scene_text(text))
    shaking = result.summary["shaking"]
    assert shaking["peak_force"] <= shaking["errors"]["peak_force"] + 1e-10
    assert shaking["rms_moment"] > 1.0
    for name in applicable(result):
        if "shaking" in name:
            draw(result, name)


WEIGHT = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{name: crank, type: revolute, axis: [0, 0, 1]}]
  links: [{name: arm, mass: 2, com: [0.5, 0, 0], inertia: {zz: 0.1}}]
trajectory: {type: joint, duration: 2, q: {crank: "0.3 - 2*pi*t"}}
inverse: {samples: 101, flywheel: {joint: crank, fluctuation: 0.05}}
"""


@pytest.mark.parametrize("samples", [61, 101, 400])
def test_flywheel_in_closed_form(samples: int) -> None:
    """A weight that is turned: E swings by 2 m g c, whatever the number of cycles and the direction."""
    wheel = inverse(load_scene_text(WEIGHT, overrides=[f"inverse.samples={samples}"])).summary["flywheel"]
    energy = 2 * 2 * 9.81 * 0.5
    assert abs(wheel["energy"] - energy) <= wheel["errors"]["energy"] < 1e-4 * energy
    own, whole = 0.1 + 2 * 0.5**2, energy / (0.05 * (2 * math.pi) ** 2)
    for key, true in (("own_inertia", own), ("whole_inertia", whole), ("inertia", whole - own)):
        assert abs(wheel[key] - true) <= wheel["errors"][key] <= 1e-4 * whole
    assert abs(wheel["mean_torque"]) <= wheel["errors"]["mean_torque"] + 1e-12
    # quickest at the bottom, slowest at the top
    for key, angle in (("fullest_time", -0.5 * math.pi), ("emptiest_time", 0.5 * math.pi)):
        off = math.remainder(0.3 - 2 * math.pi * wheel[key] - angle, 2 * math.pi)
        assert abs(off) <= 2 * math.pi * wheel["errors"][key] + 1e-9


@pytest.mark.parametrize(("C", "within"), [(0.001, 2e-4), (0.02, 4e-3), (0.1, 2e-2)])
def test_the_flywheel_does_what_was_asked(C: float, within: float) -> None:
    """With its inertia on the crank and the mean torque alone, the simulated engine fluctuates as asked, but for
    terms of second order in C and in how its own inertia varies, which is a fourth of the wheel's at C = 0.1."""
    result = engine(f"inverse.flywheel.fluctuation={C}")
    wheel, given = result.summary["flywheel"], result["flywheel/energy"]
    # quicker at the start than the mean by what the wheel takes up until then
    start = 100 * (1 + (0.5 * (given.max() + given.min()) - given[0]) / (wheel["whole_inertia"] * 1e4))
    scene = load_scene(
        ENGINE,
        ["command=simulate", "trajectory=null", "inverse=null", "expect=null", "simulate.duration=0.12",
         "simulate.samples=51", "simulate.fluctuation=[crank]", f"initial.qd={{crank: {start}}}", "initial.hold=[crank]",
         f"robot.joints.crank.rotor_inertia={wheel['inertia']}", "outputs=null"],
    )  # fmt: skip
    found = simulate(scene).summary["fluctuation"]["crank"]
    assert found["coefficient"] == pytest.approx(C, rel=within)
    assert found["error"] < 1e-8


def test_fluctuation_of_a_turning_pendulum() -> None:
    """From energy: w^2 = w0^2 - 2 m g c (1 + sin q) / I; one that swings to and fro has no coefficient."""
    text = WEIGHT.replace("trajectory", "torques: {}\n#")
    text = text.replace("inverse:", "simulate: {duration: 1.5, samples: 31, fluctuation: [crank]}\n#")
    start = "initial={q: {crank: -90 deg}, qd: {crank: 12}}"
    told = simulate(load_scene_text(text, overrides=[start])).summary["fluctuation"]["crank"]
    inertia = 0.1 + 2 * 0.25
    low = math.sqrt(144 - 4 * 2 * 9.81 * 0.5 / inertia)
    assert abs(told["coefficient"] - (12 - low) / (0.5 * (12 + low))) <= told["error"] + 1e-12 < 1e-7
    swings = simulate(load_scene_text(text, overrides=["initial={q: {crank: 0}}"])).summary["fluctuation"][
        "crank"
    ]
    assert swings["coefficient"] is None and swings["error"] is None


REFUSED = [
    (["trajectory.q.crank=0.3+sin(t)"], CapabilityError, "constant rate"),
    (["trajectory.duration=0.7"], CapabilityError, "turns; a flywheel follows from a cycle"),
    (["inverse.flywheel.joint=nobody"], SceneError, "nobody"),
    (["inverse.flywheel.fluctuation=0"], SceneError, "fluctuation"),
    (["inverse.shaking=arm.origin"], SceneError, "moves; allowed"),
    (["outputs.abscissa=arm"], SceneError, "arm"),
    (["simulate.fluctuation=[x]"], SceneError, "x"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "kind", "words"), REFUSED)
def test_refusals(change: list[str], kind: type[RobodynError], words: str) -> None:
    with pytest.raises(kind, match=words) as caught:
        inverse(load_scene_text(WEIGHT, overrides=change))
    if kind is CapabilityError:
        with pytest.raises(kind) as again:
            check(load_scene_text(WEIGHT, overrides=change))
        assert str(again.value) == str(caught.value)


# -- plots over a joint ----------------------------------------------------------------------------------------------
def _x(figure: Any) -> list[str]:
    return [ax.get_xlabel() for ax in figure.axes if ax.get_xlabel()]


def test_any_plot_over_a_joint() -> None:
    """Each point of a curve stays at its value, and moves from its time to the joint's position."""
    with_time = kinematics(
        load_scene(CONFIGS / "mechanisms" / "kinematic_design.yaml", ["outputs.abscissa=null"])
    )
    over = kinematics(load_scene(CONFIGS / "mechanisms" / "kinematic_design.yaml"))
    for name in (
        "joint_angles",
        "joint_rates",
        "velocity_ratios",
        "constraint_residual",
        "point_coordinates",
    ):
        figures = [draw(result, name) for result in (with_time, over)]
        assert _x(figures[0]) == ["time [s]"] and _x(figures[1]) == ["crank [deg]"]
        for first, second in zip(*(figure.axes for figure in figures)):
            for one, other in zip(first.lines, second.lines):
                if len(one.get_xdata()) > 10:
                    close(np.degrees(2.0 * np.asarray(one.get_xdata())), other.get_xdata(), 1e-9)
                    close(np.nan_to_num(one.get_ydata()), np.nan_to_num(other.get_ydata()), 0.0)
    back = kinematics(
        load_scene(CONFIGS / "mechanisms" / "kinematic_design.yaml", ["outputs.abscissa=rocker"])
    )  # which turns back
    low, high = draw(back, "joint_rates").axes[0].get_xlim()
    ends = np.degrees([back["q"][:, 2].min(), back["q"][:, 2].max()])
    close([low, high], ends, 1e-9)
