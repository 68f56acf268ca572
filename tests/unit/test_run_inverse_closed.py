"""Inverse dynamics of mechanisms: closed forms, round trips, sharing, and what stands in the way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli import inverse, load_scene, load_scene_text, simulate
from robodyn_cli.errors import (
    CapabilityError,
    GeometryError,
    RobodynError,
    SceneError,
    SingularConfigurationError,
)
from robodyn_cli.results.result import Result
from robodyn_cli.torques.program import torque_terms
from tests.mechanisms import BENNETT, CONFIGS, SIX_BAR, SLIDER, close
from tests.numeric import first_derivative

MOVES = "{type: joint, duration: 2, q: {crank: '0.2 + 0.5*pi*t + 0.3*sin(2*t)'}}"

# a planar five-bar: two degrees of freedom, two cranks on the ground
FIVE_BAR = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: a, type: revolute, parent: base, a: 0.5, alpha: 0, d: 0}
    - {name: b, type: revolute, parent: left, a: 0.8, alpha: 0, d: 0}
    - {name: c, type: revolute, parent: base, a: 0.5, alpha: 0, d: 0, origin: {xyz: [0.6, 0, 0]}}
    - {name: d, type: revolute, parent: right, a: 0.8, alpha: 0, d: 0}
  links:
    - {name: left, mass: 2, com: [0.2, 0.02, 0], com_frame: joint, inertia: {zz: 0.05}}
    - {name: upper_left, mass: 1, com: [0.4, 0, 0], com_frame: joint, inertia: {zz: 0.06}}
    - {name: right, mass: 1.5, com: [0.25, 0, 0], com_frame: joint, inertia: {zz: 0.04}}
    - {name: upper_right, mass: 1, com: [0.4, -0.03, 0], com_frame: joint, inertia: {zz: 0.06}}
loops: [{name: tip, type: revolute, between: [upper_left.end, upper_right.end]}]
initial: {q: {a: 2.2, b: -1.5, c: 0.9, d: 1.5}}
"""


def solve(text: str, *overrides: str) -> Result:
    text = text if text.lstrip().startswith("schema") else "schema: 1\n" + text
    return inverse(load_scene_text(text, overrides=overrides))


def failure(text: str, *overrides: str) -> RobodynError:
    with pytest.raises(RobodynError) as caught:
        solve(text, *overrides)
    return caught.value


def sums_to_tau(result: Result) -> None:
    close(sum(v.data for v in result.group("torque_terms").values()), result["tau"], 1e-13)


def test_slider_crank_in_closed_form() -> None:
    """tau = J qdd + J' qd^2 / 2 + V' with J and V of one degree of freedom, from geometry written by hand."""
    result = solve(SLIDER, f"trajectory={MOVES}", "torques=null", "inverse.samples=101")
    r, l, g = 0.3, 0.9, 9.81

    def inertia_and_potential(theta: float) -> np.ndarray:
        """Return J and V from velocities per unit rate: all bodies at the angle theta."""
        s, c = np.sin(theta), np.cos(theta)
        tilt = np.arcsin(-r * s / l)
        turn = -r * c / (l * np.cos(tilt))
        x = -r * s - l * np.sin(tilt) * turn
        crank = 0.2 + 3 * 0.1**2
        middle = np.array([-r * s - 0.45 * np.sin(tilt) * turn, r * c + 0.45 * np.cos(tilt) * turn])
        J = crank + 0.07 * turn**2 + 1 * middle @ middle + 2 * x**2
        V = g * (3 * 0.1 * s + 1 * (r * s + 0.45 * np.sin(tilt)))
        return np.array([J, V])

    q, qd, qdd, tau = (result[name][:, 0] for name in ("q", "qd", "qdd", "tau"))
    for k in range(0, 101, 7):
        J, _ = inertia_and_potential(q[k])
        slope = first_derivative(lambda x, k=k: inertia_and_potential(q[k] + x), 1e-2)  # type: ignore[misc]
        close(tau[k], J * qdd[k] + 0.5 * slope[0] * qd[k] ** 2 + slope[1], 1e-10)
    assert np.all(result["tau"][:, 1:] == 0.0)
    assert result.summary["mechanism"]["multipliers"] == "unique"
    assert result.summary["error_estimate"]["closure"]["acceleration"] < 1e-12
    sums_to_tau(result)


@pytest.mark.parametrize("text", [SLIDER, SIX_BAR])
def test_torques_of_a_simulation_come_back(text: str) -> None:
    """What drove a simulation is what its motion needs, through a table of the crank's positions."""
    run = simulate(load_scene_text("schema: 1\n" + text, overrides=[
        'torques={crank: "14 + 3*sin(5*t)"}', "simulate.duration=0.6", "simulate.samples=1201", "simulate.rtol=1e-12",
    ]))  # fmt: skip
    rows = [[float(t), float(x)] for t, x in zip(run.time, run["q"][:, 0])]
    table = f"trajectory={{type: table, columns: [t, crank], rows: {rows}}}"
    result = solve(text, table, "torques=null", "inverse.samples=1201")
    inner = slice(20, -20)
    close(result["q"], run["q"], 1e-10)
    close(result["tau"][inner, 0], 14 + 3 * np.sin(5 * run.time[inner]), 2e-5)
    close(result["constraints/multipliers"][inner], run["constraints/multipliers"][inner], 2e-4)


def test_spatial_mechanism_gives_back_its_torque() -> None:
    """The spatial slider-crank at the states of a simulation: torque and multipliers, to the run's accuracy."""
    from robodyn_cli.equations.problem import Problem
    from robodyn_cli.model.model import MOTION_GROUPS
    from robodyn_cli.observe.evaluation import SampleFunction
    from robodyn_cli.solve.load_sharing import share

    scene = load_scene(
        CONFIGS / "benchmarks" / "spatial_slider_crank.yaml",
        ['torques={crank: "0.02*cos(3*t)"}', "simulate.duration=1", "simulate.samples=51"],
    )
    run = simulate(scene)
    problem = Problem(scene)
    terms = torque_terms(problem)
    psi = [x for row in problem.constraints.rows for x in row.psi]
    found = SampleFunction({**terms, "psi": psi}, MOTION_GROUPS, 51)(
        t=run.time[:, None], q=run["q"], v=run["qd"], a=run["qdd"]
    )
    shared = share(found["psi"].reshape(51, 3, 4), [0], {name: found[name] for name in terms})
    close(shared.tau[:, 0], 0.02 * np.cos(3 * run.time), 1e-9)
    close(shared.multipliers, run["constraints/multipliers"], 1e-7)
    assert shared.freedom == 1 and shared.unique_torques and shared.unique_multipliers


def test_redundant_rows_leave_torques_unique() -> None:
    """Bennett's linkage: energies balance, forward dynamics give the motion back, multipliers are of least norm."""
    moves = "trajectory={type: joint, duration: 2, q: {j1: '1 + t + 0.2*sin(3*t)'}}"
    result = solve(BENNETT, moves, "inverse.samples=201")
    mechanism, errors = result.summary["mechanism"], result.summary["error_estimate"]
    assert mechanism["degrees_of_freedom"] == 1 and "least norm" in mechanism["multipliers"]
    assert mechanism["torques"] == "unique"
    assert errors["round_trip"] < 1e-11 and errors["energy_balance_relative"] < 1e-8
    assert errors["virtual_work_residual"] < 1e-11
    sums_to_tau(result)


def test_more_actuators_share_with_least_norm() -> None:
    moves = [f"trajectory={MOVES}", "torques=null", "initial.q.crank=0.2", "inverse.samples=41"]
    one = solve(SIX_BAR, *moves)
    two = solve(SIX_BAR, *moves, "actuated=[crank, out]")
    assert "least norm" in two.summary["mechanism"]["torques"] and set(two.summary["joints"]) == {
        "crank",
        "out",
    }
    # virtual work: crank alone does what both do; the least norm lies along the ratio of their rates
    rates = two["qd"][:, [0, 4]]
    power = one["tau"][:, 0] * one["qd"][:, 0]
    close(two["tau"][:, [0, 4]], power[:, None] * rates / (rates**2).sum(axis=1)[:, None], 1e-9)
    assert two.summary["round_trip"] < 1e-11
    sums_to_tau(two)


def test_a_point_is_led_round_a_circle() -> None:
    circle = "{type: circle, point: upper_left.end, center: [0.3, 0.9], radius: 0.15, duration: 3}"
    result = solve(FIVE_BAR, f"trajectory={circle}", "actuated=[a, c]", "inverse.samples=101")
    assert result.summary["ik_residual"] < 1e-14
    assert result.summary["round_trip"] < 1e-11
    assert result.summary["mechanism"]["degrees_of_freedom"] == 2
    close(result["points/upper_left.end"][:, :2], result["targets/upper_left.end"][:, :2], 1e-14)
    assert abs(result.summary["error_estimate"]["energy_balance"]) < 1e-6
    assert np.abs(result["tau"][:, [1, 3]]).max() == 0.0


def test_prescribed_joints_are_a_motion_too() -> None:
    led = solve(SLIDER, f"trajectory={MOVES}", "torques=null", "inverse.samples=21")
    prescribed = "{crank: '0.2 + 0.5*pi*t + 0.3*sin(2*t)'}"
    same = solve(
        SLIDER, f"prescribed={prescribed}", "torques=null", "simulate.duration=2", "inverse.samples=21"
    )
    close(same["tau"], led["tau"], 1e-12)
    close(same["constraints/multipliers"], led["constraints/multipliers"], 1e-12)


def test_loads_in_the_joints() -> None:
    """Whole weight and inertia of the moving parts hang on the ground."""
    asked = ["outputs.reactions=true", "outputs.reaction_axes=world"]
    result = solve(SLIDER, f"trajectory={MOVES}", "torques=null", "inverse.samples=401", *asked)
    both = result["reactions/crank"][:, :3] + result["reactions/slide"][:, :3]
    close(result["base_wrench"][:, :3], both, 1e-11)
    close(result["reactions/crank"][:, -1], result["tau"][:, 0], 1e-11)


def refusal(kind: Any, match: str, text: str, *overrides: str) -> RobodynError:
    with pytest.raises(kind, match=match) as caught:
        solve(text, *overrides)
    error: RobodynError = caught.value
    return error


def test_what_stands_in_the_way_is_named() -> None:
    none = "torques=null"
    refusal(SceneError, "'trajectory' is missing", SLIDER, none)
    one = "trajectory={type: joint, duration: 1, q: {a: 2.2 + t}}"
    refusal(CapabilityError, "2 degrees of freedom.*leads 1, .*free to move; allowed: lead 2", FIVE_BAR, one)
    both = "trajectory={type: joint, duration: 0.2, q: {a: 2.2 + t, c: 0.9 - t}}"
    refusal(CapabilityError, r"2 degrees of freedom.*\(a\) command 1", FIVE_BAR, both, "actuated=[a]")
    too_much = "trajectory={type: joint, duration: 1, q: {crank: 0.2 + t, slide: 1.19 + 0.1*t}}"
    refusal(GeometryError, "'pin' does not close", SLIDER, too_much, none)
    x = "0.3*cos(0.2) + sqrt(0.81 - 0.09*sin(0.2)^2)"
    too_much = f"trajectory={{type: joint, duration: 1, q: {{crank: 0.2 + t, slide: '{x} + 0.1*t'}}}}"
    error = refusal(
        GeometryError,
        r"cannot be met at t = 0 s: the rates led \(crank, slide\) contradict",
        SLIDER,
        too_much,
        none,
    )
    assert error.exit_code == 5
    # at the start their rates agree, their accelerations do not
    x = "0.3*cos(0.2) + sqrt(0.81 - 0.09*sin(0.2)^2)"
    too_much = f"trajectory={{type: joint, duration: 1, q: {{crank: 0.2 + t^2, slide: '{x} + 0.1*t^2'}}}}"
    refusal(GeometryError, r"cannot be met at t = .*off by", SLIDER, too_much, none)
    circle = "trajectory={type: circle, point: upper_left.end, center: [0.3, 0.9], radius: 0.15, duration: 3}"
    refusal(SceneError, "'actuated'", FIVE_BAR, circle)
    refusal(
        SceneError,
        "by `trajectory` and by `prescribed`",
        SLIDER,
        f"trajectory={MOVES}",
        "prescribed={crank: t}",
        none,
    )


def test_losses_of_a_gear_without_a_drive_are_refused() -> None:
    gear = "robot.joints.slide.gear={efficiency: 0.9}"
    refusal(CapabilityError, "'slide' has a gear", SLIDER, f"trajectory={MOVES}", "torques=null", gear)


def test_friction_anywhere_is_borne() -> None:
    rough = [
        "robot.joints.crank.friction={viscous: 0.4, coulomb: 0.3}",
        "robot.joints.slide.damper={damping: 2}",
    ]
    result = solve(SLIDER, f"trajectory={MOVES}", "torques=null", "inverse.samples=401", *rough)
    assert {"friction", "passive"} <= set(result.group("torque_terms"))
    assert result.summary["round_trip"] < 1e-12
    assert abs(result.summary["error_estimate"]["energy_balance_relative"]) < 1e-8
    sums_to_tau(result)


def test_dead_point_of_the_motion() -> None:
    """The slide is led beyond its stroke: crank and rod align at 1.2 m, where the crank's rate has no bound."""
    moves = "trajectory={type: joint, duration: 1, q: {slide: '1.1 + 0.2*t'}}"
    error = failure(SLIDER, moves, "torques=null", "initial.q={crank: 0.7, rod: -0.9}", "initial.hold=[]")
    assert isinstance(error, SingularConfigurationError) and error.exit_code == 4
    assert abs(error.details["time"] - 0.5) < 1e-6
    assert error.details["joint"] in ("crank", "rod") and error.details["loop"] == "pin"


def test_dead_point_of_the_actuators() -> None:
    """The crank is led through the dead point of the slide that is to drive it."""
    moves = "trajectory={type: joint, duration: 2, q: {crank: '-0.5 + 0.5*t'}}"
    error = failure(SLIDER, moves, "torques=null", "actuated=[slide]", "initial.q={crank: -0.5, rod: 0.6}")
    assert isinstance(error, SingularConfigurationError)
    assert "dead point of the actuators at t = 1 s" in error.message and error.details["kind"] == "dead_point"
    between = failure(
        SLIDER,
        moves,
        "torques=null",
        "actuated=[slide]",
        "initial.q={crank: -0.5, rod: 0.6}",
        "inverse.samples=100",
    )
    assert "between t = 0.989" in between.message and between.details["joint"] in ("crank", "rod")


def test_stewart_platform() -> None:
    """Six slides lead a platform that floats: six loops, balls and quaternions, and back by forward dynamics."""
    lengths = dict.fromkeys(range(1, 7), 0.6857)
    moves = ", ".join(f"slide{k}: '{x} + 0.03*sin({2 + 0.3 * k}*t)'" for k, x in lengths.items())
    scene = load_scene(
        CONFIGS / "benchmarks" / "stewart_platform.yaml",
        [
            f"trajectory={{type: joint, duration: 1, q: {{{moves}}}}}", "torques=null", "inverse.samples=41",
            "outputs={reactions: true, reaction_axes: world}",
        ],
    )  # fmt: skip
    result = inverse(scene)
    summary = result.summary
    assert summary["mechanism"]["degrees_of_freedom"] == 6 and summary["mechanism"]["torques"] == "unique"
    assert summary["round_trip"] < 1e-11 and max(summary["error_estimate"]["closure"].values()) < 1e-11
    assert abs(summary["error_estimate"]["energy_balance_relative"]) < 1e-5
    quaternion = result["q"][:, [k for k, name in enumerate(result.variables["q"].names) if ".q" in name]]
    close((quaternion**2).sum(axis=1), 1.0, 1e-13)
    # what the six legs bear on the base is what the ground gives
    base = sum(result[f"reactions/cross{k}"][:, :3] for k in range(1, 7))
    close(result["base_wrench"][:, :3], base, 1e-9)


def test_couplers_count_as_loops() -> None:
    """Two wheels on one mesh: the pinion's torque moves both, as through a gear."""
    text = """
gravity: [0, 0, 0]
robot:
  joints:
    - {name: pinion, type: revolute, parent: base, axis: [0, 0, 1]}
    - {name: wheel, type: revolute, parent: base, axis: [0, 0, 1], origin: {xyz: [0.3, 0, 0]}}
  links:
    - {name: small, mass: 1, com: [0, 0, 0], inertia: {zz: 0.02}}
    - {name: large, mass: 3, com: [0, 0, 0], inertia: {zz: 0.3}}
couplers: [{name: mesh, terms: {pinion: 20, wheel: 40}}]
trajectory: {type: joint, duration: 1, q: {pinion: sin(3*t)}}
initial: {q: {pinion: 0, wheel: 0}}
inverse: {samples: 31}
"""
    result = solve(text)
    close(result["tau"][:, 0], (0.02 + 0.3 / 4) * result["qdd"][:, 0], 1e-12)
    close(result["q"][:, 1], -0.5 * result["q"][:, 0], 1e-13)
    assert result.summary["round_trip"] < 1e-12


def test_grounds_that_move_do_work() -> None:
    """A slider-crank whose slide's line is shaken: energies balance with the work of the ground."""
    text = SLIDER.replace("loops:", "#").replace("torques:", "# ")
    shaken = """
loops: [{name: pin, type: point_on_line, between: [line, bar.end], axis: [1, 0, 0]}]
"""
    robot = "robot.points={line: {link: base, at: [0, 0, 0], motion: [0, '0.05*sin(4*t)', 0]}}"
    moves = "trajectory={type: joint, duration: 2, q: {crank: '0.2 + t', slide: 1.1}}"
    result = solve(
        text + shaken, robot, moves, "initial={q: {crank: 0.2, rod: -0.3, slide: 1.1}}", "inverse.samples=401"
    )
    assert result.summary["error_estimate"]["energy_balance_relative"] == pytest.approx(0.0, abs=1e-7)
    assert result.summary["round_trip"] < 1e-11
    tip = result["q"][:, 0] + result["q"][:, 1]
    close(0.3 * np.sin(result["q"][:, 0]) + 0.9 * np.sin(tip), 0.05 * np.sin(4 * result.time), 1e-12)


def test_figures_do_not_hang_on_few_samples() -> None:
    """All five samples of a crank that turns twice lie at dead centres, where no torque is needed."""
    text = """
gravity: [0, 0, 0]
robot:
  joints:
    - {name: crank, type: revolute, parent: base, axis: [0, 0, 1]}
    - {name: rod, type: revolute, axis: [0, 0, 1], origin: {xyz: [0.1, 0, 0]}}
    - {name: slide, type: prismatic, parent: base, axis: [1, 0, 0]}
  links:
    - {name: crank_l, mass: 0, inertia: {zz: 0.01}}
    - {name: rod_l, mass: 0}
    - {name: piston, mass: 2, com: [0, 0, 0]}
  points: {small_end: {link: rod_l, at: [0.3, 0, 0]}}
loops: [{name: wrist, type: revolute, between: [small_end, piston.origin]}]
trajectory: {type: joint, duration: 1, q: {crank: "2*pi*2*t"}}
actuated: [crank]
initial: {q: {crank: 0, rod: 0, slide: 0.4}}
"""
    many = inverse(load_scene_text("schema: 1" + text), samples=2001).summary["joints"]["crank"]
    result = inverse(load_scene_text("schema: 1" + text), samples=5)
    few = result.summary["joints"]["crank"]
    assert len(result.time) == 5 and np.abs(result["tau"]).max() < 1e-12
    assert many["peak_torque"] > 2.0
    for key in ("peak_torque", "rms_torque", "peak_power", "energy"):
        assert abs(few[key] - many[key]) <= few["errors"][key] + many["errors"][key] + 1e-9, key
        assert abs(few[key] - many[key]) < 0.01 * many[key], key


def test_runs_made_together_look_between_few_samples_too() -> None:
    from robodyn_cli import Mechanism

    text = """schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0]}]
  links: [{name: block, mass: 2}]
trajectory: {type: joint, duration: 1, q: {x: "sin(4*pi*t)"}}
inverse: {samples: 5}
"""
    scene = load_scene_text(text)
    one = inverse(scene).summary["joints"]["x"]["peak_torque"]
    assert abs(one - 2 * (4 * np.pi) ** 2) < 1e-3 * one
    runs = Mechanism(scene, ["robot.links.block.mass"]).inverse_many(
        {"robot.links.block.mass": [2.0, 4.0]}, of=["peak_torque.x"], samples=5
    )
    assert runs.outputs["peak_torque.x"] == pytest.approx([one, 2 * one], rel=1e-12)
    assert runs.samples["tau"].shape[1] == 5 and runs.samples["time"][0].tolist() == [
        0.0,
        0.25,
        0.5,
        0.75,
        1.0,
    ]
