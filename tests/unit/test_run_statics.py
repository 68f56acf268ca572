"""Statics: balances against minima of the potential and closed forms, stability, holding torques, reactions."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from robodyn_cli import inverse, load_scene, load_scene_text
from robodyn_cli.errors import CapabilityError, NumericalError, RobodynError, SceneError
from robodyn_cli.results.result import Result
from robodyn_cli.solve.closing.balance import balance
from robodyn_cli.works.statics import statics
from tests.mechanisms import BENNETT, CONFIGS, SLIDER, close

SPRUNG = CONFIGS / "mechanisms" / "balanced_four_bar.yaml"
PENDULUM = CONFIGS / "double_pendulum.yaml"


def of(text: str, *overrides: str) -> Result:
    return statics(load_scene_text("schema: 1\n" + text, overrides=overrides))


def potential(crank: float) -> float:
    """Potential energy of the sprung four-bar by geometry written by hand."""
    a = 0.4 * np.array([np.cos(crank), np.sin(crank)])
    d = a - [1.0, 0.0]
    f = np.linalg.norm(d)
    inner = np.arccos((0.9**2 + f**2 - 1.2**2) / (2 * 0.9 * f))
    rocker = np.arctan2(d[1], d[0]) - inner
    pin = np.array([1.0, 0.0]) + 0.9 * np.array([np.cos(rocker), np.sin(rocker)])
    height = 1 * 0.2 * np.sin(crank) + 3 * (a[1] + pin[1]) / 2 + 2 * 0.45 * np.sin(rocker)
    return float(9.81 * height + 15 * (crank - np.pi / 3) ** 2)


def test_balance_is_the_minimum_of_the_potential() -> None:
    result = statics(load_scene(SPRUNG))
    crank = result["q"][0, 0]
    least = minimize_scalar(potential, bracket=(0.6, 0.9), options={"xtol": 1e-12})
    assert abs(crank - least.x) < 1e-7
    facts = result.summary["equilibrium"]
    assert facts["stability"] == "stable" and facts["residual"] < 1e-10
    # the reduced stiffness is the curvature along the mechanism's motion of unit length
    h = 1e-3
    second = (potential(crank + h) - 2 * potential(crank) + potential(crank - h)) / h**2
    from robodyn_cli.works.kinematics import kinematics

    sweep = f"kinematics={{samples: 2, sweep: {{joint: crank, start: {crank}, stop: {crank + 0.01}}}}}"
    rates = kinematics(load_scene(SPRUNG, [sweep]))["qd"][0]
    assert facts["stiffness"][0] == pytest.approx(second / (rates @ rates), rel=1e-5)


@pytest.mark.parametrize("rest", [0.0, 0.7])
@pytest.mark.parametrize("stiffness", [1e3, 1e9, 1e11])
def test_a_stiff_spring_beside_weights(stiffness: float, rest: float) -> None:
    """Two rods that a spring keeps at an angle, however stiff: their centre of mass hangs below the joint."""
    text = f"""\
gravity: [0, -9.81, 0]
robot:
  joints:
    - {{name: a, type: revolute, axis: [0, 0, 1]}}
    - {{name: b, type: revolute, axis: [0, 0, 1], origin: {{xyz: [0.5, 0, 0]}}, spring: {{stiffness: {stiffness}, rest: {rest}}}}}
  links:
    - {{name: l1, mass: 1, com: [0.25, 0, 0]}}
    - {{name: l2, mass: 1, com: [0.25, 0, 0]}}
initial: {{q: {{a: 80 deg, b: 0}}}}
"""
    result = of(text)
    assert result.summary["equilibrium"]["stability"] == "stable"
    a, b = result["q"][0]
    bent = 9.81 * 0.25 * np.cos(a + b) / stiffness
    assert abs(b - rest + bent) < 1e-12
    assert abs(0.75 * np.cos(a) + 0.25 * np.cos(a + b)) < 1e-12
    with mpmath.workdps(50):
        held = [
            lambda x, y: 9.81 * (0.75 * mpmath.cos(x) + 0.25 * mpmath.cos(x + y)),
            lambda x, y: 9.81 * 0.25 * mpmath.cos(x + y) + stiffness * (y - rest),
        ]
        x, y = mpmath.findroot(held, (a, b))
        bent = 9.81 * 0.25 * mpmath.sin(x + y)
        K = mpmath.matrix([[-9.81 * 0.75 * mpmath.sin(x) - bent, -bent], [-bent, stiffness - bent]])
        facts = result.summary["equilibrium"]
        off = max(
            abs(one - exact) for one, exact in zip(facts["stiffness"], mpmath.eigsy(K, eigvals_only=True))
        )
    assert off <= facts["stiffness_error"] < 1e-3 * facts["stiffness"][0]


def test_the_ground_carries_the_weight() -> None:
    result = statics(load_scene(SPRUNG))
    close(result["base_wrench"][0, :3], [0.0, 6 * 9.81, 0.0], 1e-9)
    spring = 30 * (result["q"][0, 0] - np.pi / 3)
    close(result["reactions/crank"][0, -1], -spring, 1e-9)


def test_stable_unstable_and_held() -> None:
    down = statics(load_scene(PENDULUM))
    close(np.cos(down["q"][0, 0]), 0.0, 1e-12)
    assert (
        np.sin(down["q"][0, 0]) == pytest.approx(-1.0)
        and down.summary["equilibrium"]["stability"] == "stable"
    )
    up = statics(load_scene(PENDULUM, ["initial.q={theta1: 90 deg, theta2: 0}"]))
    assert (
        up.summary["equilibrium"]["stability"] == "unstable" and up.summary["equilibrium"]["iterations"] <= 1
    )
    half = statics(load_scene(PENDULUM, ["initial={q: {theta1: 30 deg, theta2: 0.1}, hold: [theta1]}"]))
    close(np.cos(half["q"][0].sum()), 0.0, 1e-12)
    assert half["q"][0, 0] == pytest.approx(np.pi / 6) and half["tau"][0, 1] == 0.0
    # what holds the first joint is the moment of both weights
    still = statics(
        load_scene(
            PENDULUM, [f"initial.q={{theta1: 30 deg, theta2: {half['q'][0, 1]}}}", "statics.find=hold"]
        )
    )
    close(half["tau"], still["tau"], 1e-10)


def test_torque_against_weight() -> None:
    """A constant torque in the scene is part of the balance: m g a cos(q) = tau."""
    text = """
gravity: [0, -9.81, 0]
robot:
  joints: [{name: swing, type: revolute, axis: [0, 0, 1]}]
  links: [{name: rod, mass: 2, com: [0.5, 0, 0], inertia: {zz: 0.1}}]
torques: {swing: TORQUE}
initial: {q: {swing: -0.4}}
"""
    result = of(text.replace("TORQUE", "5"))
    assert result["q"][0, 0] == pytest.approx(-np.arccos(5 / 9.81), abs=1e-12)
    assert result.summary["equilibrium"]["stability"] == "stable" and result["tau"][0, 0] == 5.0
    with pytest.raises(NumericalError, match="no balance found"):
        of(text.replace("TORQUE", "12"))


def test_holding_torques_are_those_of_a_motion_at_rest() -> None:
    held = of(SLIDER, "statics.find=hold", "actuated=[crank]", "torques=null")
    still = "trajectory={type: joint, duration: 1, q: {crank: 0.2}}"
    rest = inverse(
        load_scene_text("schema: 1\n" + SLIDER, overrides=[still, "torques=null", "inverse.samples=3"])
    )
    close(held["tau"], rest["tau"][:1], 1e-12)
    close(held["constraints/multipliers"], rest["constraints/multipliers"][:1], 1e-12)
    shared = of(SLIDER, "statics.find=hold", "actuated=[crank, slide]", "torques=null")
    assert "least norm" in shared.summary["equilibrium"]["torques"]
    assert np.linalg.norm(shared["tau"]) < np.linalg.norm(held["tau"])


def test_redundant_and_rigid_mechanisms() -> None:
    bennett = of(BENNETT, "initial.hold=[]")
    assert bennett.summary["equilibrium"]["stability"] == "stable"
    assert bennett.summary["mobility"]["redundant_rows"] == 3
    rigid = of(SLIDER, "torques=null")
    assert rigid.summary["equilibrium"]["stability"] == "rigid"
    held = of(SLIDER, "statics.find=hold", "actuated=[crank]", "torques=null")
    close(rigid["tau"], held["tau"], 1e-12)


def test_what_is_refused() -> None:
    with pytest.raises(CapabilityError, match="command 1 of them.*more joints in 'actuated'"):
        statics(load_scene(PENDULUM, ["statics.find=hold", "actuated=[theta1]", "torques=null"]))
    with pytest.raises(SceneError, match="inertia|mass"):
        statics(load_scene(CONFIGS / "mechanisms" / "four_bar_kinematics.yaml", ["gravity=[0, -9.81, 0]"]))
    dead = [
        "statics.find=hold",
        "actuated=[slide]",
        "torques=null",
        "initial={q: {crank: 0, rod: 0, slide: 1.2}}",
    ]
    with pytest.raises(RobodynError) as caught:
        of(SLIDER, *dead)
    assert caught.value.exit_code == 4


def test_what_rounding_leaves_of_a_force_is_balanced() -> None:
    """Two hinges beside a bar that carries a weight: what nothing holds is not moved on and on by rounding."""
    rng = np.random.default_rng(5)

    class Bar:
        lengths, sizes = np.ones(3), np.ones(1)

        def at(self, q: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
            return np.array([q[2]]), np.array([[0.0, 0.0, 1.0]])

        def step(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
            return np.array(q + dq)

    class Forces:
        def load(self, q: np.ndarray) -> np.ndarray:
            spring = 1e-3 * np.sin(q[0] - 0.2)
            return np.array([spring, 0.0, 3.0]) + 3e-16 * rng.normal(size=3) * [1, 1, 0]

        def stiffness(self, q: np.ndarray, lam: np.ndarray) -> np.ndarray:
            return np.diag([1e-3 * np.cos(q[0] - 0.2), 0.0, 0.0])

    rest = balance(Bar(), Forces(), np.array([0.9, 0.4, 0.0]))
    assert rest.converged and rest.iterations < 20 and rest.stability == "indifferent"
    assert abs(rest.q[0] - 0.2) < 1e-12 and abs(rest.q[1] - 0.4) < 1e-5


LIMITED = """schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{name: a, type: revolute, axis: [0, 0, 1], limits: {lower: 60 deg, upper: %s deg}}]
  links: [{name: l, mass: 1, com: [0.3, 0, 0], inertia: {xx: 0.01, yy: 0.02, zz: 0.02}}]
initial: {q: {a: 80 deg}}
"""


def test_a_balance_within_the_limits_is_preferred() -> None:
    """Downhill is -90 deg; within the limits the pendulum hangs at 270 deg, or nowhere."""
    summary = statics(load_scene_text(LIMITED % "300")).summary
    assert summary["configuration"]["a"] == pytest.approx(1.5 * np.pi) and "warnings" not in summary
    summary = statics(load_scene_text(LIMITED % "250")).summary
    assert summary["configuration"]["a"] == pytest.approx(-0.5 * np.pi)
    assert "12 starts within the limits of the joints led to no balance there" in summary["warnings"][0]
