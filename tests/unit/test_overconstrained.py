"""Linkages that move against every count, through whole turns: their closed forms, energy, and least-norm multipliers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.build import build_system
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.results.result import Result
from robodyn_cli.solve.closure import Numbers
from robodyn_cli.solve.independent_rows import independent_rows
from tests import mechanisms
from tests.mechanisms import SKEW, TWIST, close, run

BENNETT = mechanisms.BENNETT.replace("initial: {", "initial: {qd: {j1: 9}, ")

BODY = "mass: 1, com: [0.4, 0.1, 0.05], com_frame: joint, inertia: {xx: 0.02, yy: 0.09, zz: 0.1, xy: 0.01, xz: 0, yz: 0.005}"

# all bars alike, twisted by a right angle to and fro (Bricard 1897; closed form: Chen, You, Tarnai 2005)
BRICARD = f"""
gravity: [0, 0, 0]
robot:
  convention: standard
  joints:
    - {{name: j1, type: revolute, a: 1, alpha: 90 deg, d: 0}}
    - {{name: j2, type: revolute, a: 1, alpha: -90 deg, d: 0}}
    - {{name: j3, type: revolute, a: 1, alpha: 90 deg, d: 0}}
    - {{name: j4, type: revolute, a: 1, alpha: -90 deg, d: 0}}
    - {{name: j5, type: revolute, a: 1, alpha: 90 deg, d: 0}}
  links: [{{name: l1, {BODY}}}, {{name: l2, {BODY}}}, {{name: l3, {BODY}}}, {{name: l4, {BODY}}}, {{name: l5, {BODY}}}]
  points: {{anchor: {{link: base, at: [-1, 0, 0]}}}}
loops: [{{name: ring, type: revolute, between: [l5.end, base.anchor], axis2: [0, -1, 0]}}]
initial: {{q: {{j1: 60 deg, j2: -1.9, j3: 60 deg, j4: -1.9, j5: 60 deg}}, qd: {{j1: 3}}, hold: [j1]}}
simulate: {{duration: 6, samples: 121}}
"""

# two pairs of hinged plates at right angles: the platform can only go up and down (Sarrus 1853)
SARRUS = """
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: a1, type: revolute, parent: base, axis: [0, 1, 0], origin: {xyz: [1, 0, 0]}}
    - {name: a2, type: revolute, axis: [0, 1, 0], origin: {xyz: [0, 0, 0.6]}}
    - {name: a3, type: revolute, axis: [0, 1, 0], origin: {xyz: [0, 0, 0.6]}}
    - {name: b1, type: revolute, parent: base, axis: [1, 0, 0], origin: {xyz: [0, 1, 0]}}
    - {name: b2, type: revolute, axis: [1, 0, 0], origin: {xyz: [0, 0, 0.6]}}
  links:
    - {name: A1, mass: 1, com: [0, 0, 0.3], com_frame: joint, inertia: {xx: 0.03, yy: 0.03, zz: 0.001}}
    - {name: A2, mass: 1, com: [0, 0, 0.3], com_frame: joint, inertia: {xx: 0.03, yy: 0.03, zz: 0.001}}
    - {name: top, mass: 3, com: [-1, 0, 0], com_frame: joint, inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
    - {name: B1, mass: 1, com: [0, 0, 0.3], com_frame: joint, inertia: {xx: 0.03, yy: 0.03, zz: 0.001}}
    - {name: B2, mass: 1, com: [0, 0, 0.3], com_frame: joint, inertia: {xx: 0.03, yy: 0.03, zz: 0.001}}
  points: {edge: {link: B2, at: [0, 0, 0.6]}, side: {link: top, at: [-1, 1, 0]}, middle: {link: top, at: com}}
loops: [{name: hinge, type: revolute, between: [edge, side], axis: [1, 0, 0]}]
initial: {q: {a1: 0.9, a2: -1.8, a3: 0.9, b1: -0.9, b2: 1.8}, qd: {a1: -1.2}, hold: [a1]}
simulate: {duration: 0.4, samples: 41}
"""

# a triangle on three equal parallel cranks: it moves without turning, and each crank is one too many
CRANKS = """
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: c1, type: revolute, parent: base, a: 0.5, alpha: 0, d: 0}
    - {name: turn, type: revolute, a: 1, alpha: 0, d: 0}
    - {name: c2, type: revolute, parent: base, a: 0.5, alpha: 0, d: 0, origin: {xyz: [1, 0, 0]}}
    - {name: c3, type: revolute, parent: base, a: 0.5, alpha: 0, d: 0, origin: {xyz: [0.3, 0.8, 0]}}
  links:
    - {name: k1, mass: 1, com: [0.25, 0, 0], com_frame: joint, inertia: {zz: 0.02}}
    - {name: plate, mass: 2, com: [0.4, 0.3, 0], com_frame: joint, inertia: {zz: 0.3}}
    - {name: k2, mass: 1, com: [0.25, 0, 0], com_frame: joint, inertia: {zz: 0.02}}
    - {name: k3, mass: 1, com: [0.25, 0, 0], com_frame: joint, inertia: {zz: 0.02}}
  points: {p2: {link: plate, at: [1, 0, 0], frame: joint}, p3: {link: plate, at: [0.3, 0.8, 0], frame: joint}}
loops:
  - {name: second, type: revolute, between: [k2.end, p2]}
  - {name: third, type: revolute, between: [k3.end, p3]}
initial: {q: {c1: 1, turn: -1, c2: 1, c3: 1}, qd: {c1: 12}, hold: [c1]}
simulate: {duration: 3, samples: 61}
"""
# the same motion: one crank that carries the plate as a point mass, and thrice the crank
PENDULUM = """
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints: [{name: c1, type: revolute, a: 0.5, alpha: 0, d: 0}]
  links: [{name: k, mass: 5, com: [0.35, 0, 0], com_frame: joint, inertia: {zz: 0.135}}]
initial: {q: {c1: 1}, qd: {c1: 12}}
simulate: {duration: 3, samples: 61}
"""


def numbers(problem: Problem, entries: Any, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    array = np.asarray(entries, dtype=object)
    values = {"q": q.tolist(), "v": v.tolist(), "t": [0.0], "p": []}
    return np.array(evaluate(list(array.ravel()), values), dtype=float).reshape(array.shape)


def check_equations(text: str, found: Result, rank: int) -> None:
    """Newton-Euler balances the motion with the multipliers, which are the least that do; all rows are closed."""
    problem = Problem(load_scene_text("schema: 1\n" + text))
    size = float(np.abs(found["q"]).max() + 1.0)
    residual = found.summary["constraint_residual"]
    assert residual["position"] < 1e-12 and residual["redundant"] < 1e-12
    assert residual["velocity"] < 1e-12 * max(1.0, float(np.abs(found["qd"]).max())) * size
    columns = zip(found["q"], found["qd"], found["qdd"], found["constraints/multipliers"])
    for q, v, a, lam in list(columns)[::7]:
        psi = numbers(problem, problem.psi, q, v)
        load = numbers(problem, problem.mass_matrix, q, v) @ a - numbers(
            problem, problem.applied - problem.bias, q, v
        )
        scale = max(1.0, float(np.abs(load).max()))
        close(psi.T @ lam, load, 1e-10 * scale)
        close(lam, np.linalg.pinv(psi.T, rcond=1e-9) @ load, 1e-8 * max(1.0, float(np.abs(lam).max())))
        gamma = numbers(problem, problem.constraints.gamma, q, v)
        close(psi @ a, -gamma, 1e-10 * max(1.0, float(np.abs(gamma).max())))
    assert [g["rank"] for g in found.summary["multipliers"]["dependent"]] == [rank]


@pytest.mark.parametrize("method", ["auto", "dop853", "rodas5p"])
def test_bennett_through_whole_turns(method: str) -> None:
    found = run(BENNETT, f"simulate.integrator={method}", "simulate.rtol=1e-9", "simulate.duration=3")
    t1, t2, t3 = found["q"].T
    assert np.ptp(t1) > 6 * np.pi and np.ptp(t2) > 6 * np.pi
    ratio = np.sin((SKEW + TWIST) / 2) / np.sin((SKEW - TWIST) / 2)
    close(np.sin((t1 + t3) / 2), 0.0, 1e-12)
    close(np.sin(t1 / 2) * np.sin(t2 / 2), ratio * np.cos(t1 / 2) * np.cos(t2 / 2), 1e-12)
    assert found.summary["energy_drift_relative"] < 1e-6
    assert found.summary["multipliers"]["renewals"] > 4
    check_equations(BENNETT, found, 2)


def test_bricard_turns_inside_out() -> None:
    found = run(BRICARD)
    q = found["q"]
    assert np.cos(q[:, 0]).min() < -0.45 and np.cos(q[:, 0]).max() > 0.95
    close(q[:, 0], q[:, 2], 1e-11)
    close(q[:, 1], q[:, 3], 1e-11)
    c1, c2 = np.cos(q[:, 0]), np.cos(q[:, 1])
    close(c1 + c2 + c1 * c2, 0.0, 1e-11)
    assert found.summary["energy_drift_relative"] < 1e-8
    check_equations(BRICARD, found, 4)


def test_sarrus_goes_straight_up() -> None:
    found = run(SARRUS)
    a1 = found["q"][:, 0]
    assert np.ptp(a1) > 0.3
    expected = np.column_stack([0 * a1, 0 * a1, 1.2 * np.cos(a1)])
    close(found["points/middle"], expected, 1e-12)
    close(found["q"][:, 3], -a1, 1e-12)
    # energy decides the one rate: plates about their lower and upper edges, the platform up and down
    v, c, s = found["qd"][:, 0], np.cos(a1), np.sin(a1)
    rise = -1.2 * s * v
    lower = 2 * 0.5 * (0.03 + 0.3**2) * v**2
    upper = 2 * 0.5 * (0.03 * v**2 + (0.3 * c * v) ** 2 + (0.9 * s * v) ** 2)
    kinetic = lower + upper + 0.5 * 3 * rise**2
    close(found["energy/kinetic"], kinetic, 1e-10)
    assert found.summary["energy_drift"] < 1e-9
    check_equations(SARRUS, found, 4)


def test_one_crank_too_many_changes_nothing() -> None:
    found, alone = run(CRANKS), run(PENDULUM)
    assert np.ptp(found["q"][:, 0]) > 4 * np.pi
    close(found["q"][:, 0], alone["q"][:, 0], 1e-8)
    close(found["qdd"][:, 0], alone["qdd"][:, 0], 1e-6)
    close(found["q"][:, 0], found["q"][:, 3], 1e-12)
    assert found.summary["multipliers"]["dependent"][0]["loops"] == ["second", "third"]
    assert len(found.summary["assembly"]["redundant_rows"]) == 1
    check_equations(CRANKS, found, 3)


def test_a_crank_that_is_prescribed_gets_its_torque() -> None:
    """tau from the multiplier of the prescribed row: the pendulum's own inverse dynamics."""
    text = (
        CRANKS.split("initial")[0]
        + "prescribed: {c1: 1 + 2*t + sin(3*t)}\ninitial: {q: {turn: -1, c2: 1, c3: 1}}\n"
    )
    found = simulate(load_scene_text("schema: 1\n" + text + "simulate: {duration: 3, samples: 31}\n"))
    t = found["time"]
    angle, second = 1 + 2 * t + np.sin(3 * t), -9 * np.sin(3 * t)
    inertia = 0.135 + 5 * 0.35**2
    close(found["q"][:, 0], angle, 1e-12)
    close(found["tau"][:, 0], inertia * second + 5 * 0.35 * 9.81 * np.cos(angle), 1e-9)
    assert found.summary["energy_drift"] < 1e-7


@pytest.mark.parametrize("kind", ["advance", "run"])
def test_combinations_are_renewed_whoever_drives(kind: str) -> None:
    """Without samples or events too: what is integrated must not depend on who looks."""
    setup = prepare(load_scene_text("schema: 1\n" + BENNETT))
    system = build_system(setup.problem)
    integrator = Integrator(system, "gauss")
    integrator.reset(0.0, system.join(setup.assembled.q, setup.assembled.v), Options(1e-9, 1e-11))
    if kind == "advance":
        integrator.advance(2.0)
    else:
        integrator.run(2.0, Grid.over(2.0, 3), lambda t, x: None, watch=False)
    q = system.split(integrator.state)[0]
    assert abs(q[0]) > 4 * np.pi and integrator.parameters.repartitions > 4
    assert np.abs(evaluate(setup.problem.constraints.eta, {"q": q.tolist()})).max() < 1e-13


def test_rows_are_chosen_without_steps_at_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of some 160 configurations along the motion each takes a few of Newton's steps, none that rounding refuses."""
    evaluations, at = list[object](), Numbers.at
    monkeypatch.setattr(Numbers, "at", lambda *x: (evaluations.append(x), at(*x))[1])
    scene = load_scene_text(f"schema: 1\n{BENNETT}")
    q = prepare(scene).assembled.q
    evaluations.clear()
    independent_rows(Numbers(Problem(scene), ()), q)
    assert len(evaluations) < 1500
