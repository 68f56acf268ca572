"""Forces on points and between bodies in whole runs: closed forms, energy, long chains, loops, bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.build import build_system, is_rolled
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.torques.dynamics import ForwardDynamics, InverseDynamics
from robodyn_cli.works.deploy.deploy import deploy
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate
from tests.systems import integrate

CONFIGS = Path(__file__).parents[2] / "configs"

SLIDER = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0]}]
  links: [{name: cart, mass: 2, com: [0, 0, 0]}]
initial: {q: {x: 0.7}, qd: {x: -0.4}}
simulate: {duration: 3, samples: 31, rtol: 1e-12, atol: 1e-14}
"""

TURNER = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: a, type: revolute, axis: [0, 0, 1]}]
  links: [{name: wheel, mass: 2, com: [0, 0, 0], inertia: {zz: 0.5}}]
initial: {q: {a: 0}, qd: {a: 8}}
simulate: {duration: 3, samples: 31, rtol: 1e-12, atol: 1e-14}
"""

ARM = """
schema: 1
gravity: [1, -9.81, 2]
parameters: {A: 3}
robot:
  base: {rpy: [0.3, -0.2, 0.5], xyz: [0.1, 0.2, 0.3]}
  joints:
    - {name: j1, type: revolute, axis: [0, 0, 1]}
    - {name: j2, type: revolute, origin: {xyz: [0.5, 0.1, 0], rpy: [0.4, 0, 0]}, axis: [0, 1, 0.3]}
    - {name: j3, type: prismatic, origin: {xyz: [0.3, 0, 0.1]}, axis: [1, 0.2, 0]}
    - {name: k1, type: revolute, parent: l1, link: m1, origin: {xyz: [0, 0.4, 0]}, axis: [1, 0, 0]}
  links:
    - {name: l1, mass: 3, com: [0.2, 0.03, 0.01], inertia: {xx: 0.05, yy: 0.06, zz: 0.07, xy: 0.01, xz: -0.005, yz: 0.002}}
    - {name: l2, mass: 2, com: [0.1, 0.05, -0.02], inertia: {xx: 0.03, yy: 0.04, zz: 0.05, xy: 0.004, xz: -0.005, yz: 0.002}}
    - {name: l3, mass: 1, com: [0.1, -0.03, 0.04], inertia: {xx: 0.02, yy: 0.03, zz: 0.025, xy: 0.003, xz: -0.001, yz: 0.002}}
    - {name: m1, mass: 1.5, com: [0.05, 0.1, 0.04], inertia: {xx: 0.02, yy: 0.03, zz: 0.025, xy: 0.003, xz: -0.001, yz: 0.002}}
  points:
    tip: {link: l3, at: [0.2, 0.1, 0.05]}
    side: {link: m1, at: [0, 0.3, 0.1]}
    wall: {link: base, at: [1, 1, 0.2]}
  frames:
    cup: {link: l3, at: [0, 0, 0.1], rpy: [0.2, 0.1, 0]}
    plate: {link: m1, at: [0.1, 0, 0.1], rpy: [0.2, 0.8, 0]}
forces:
  - {name: s1, type: spring, between: [tip, wall], stiffness: 100, length: 0.5, damping: 3}
  - {name: s0, type: spring, between: [side, base.wall], stiffness: 20}
  - {name: cf, type: constant_force, between: [side, l2.origin], force: 8}
  - {name: ts, type: torsional_spring, between: [cup, plate], axis: [0, 1, 1], stiffness: 4, damping: 0.2, rest: 20 deg}
  - {name: bu, type: bushing, between: [cup, plate], stiffness: [10, 20, 30, 4, 5, 6], damping: [1, 2, 3, 0.1, 0.2, 0.3]}
  - {name: f1, type: force, at: tip, force: ["A*sin(t)", 2, "q.j1"]}
  - {name: w1, type: wrench, at: cup, frame: body, force: {table: [[0, 1, 2, 3], [0.31, 0, 3, 4], [2, 5, 5, 5]]}, moment: [1, "qd.k1", 3]}
initial: {q: {j1: 0.3, j2: -0.4, j3: 0.1, k1: 0.5}, qd: {j1: 0.1, k1: 1}}
simulate: {duration: 1, samples: 51}
trajectory: {type: joint, duration: 1, q: {j1: "0.3 + t^2", j2: "sin(t)", j3: "0.1*cos(2*t)", k1: "0.5 - t"}}
inverse: {samples: 101}
"""


def run(text: str, forces: str = "", *overrides: str):  # type: ignore[no-untyped-def]
    return simulate(load_scene_text(f"{text}\n{forces}", overrides=overrides))


def test_a_mass_on_a_spring_and_damper() -> None:
    k, c, m, l0 = 50.0, 6.0, 2.0, 0.25
    spring = f"{{name: s, type: spring, between: [base.origin, cart.com], stiffness: {k}, length: {l0}, damping: {c}}}"
    found = run(SLIDER, f"forces: [{spring}]")
    t = found["time"]
    decay, w = c / (2 * m), np.sqrt(k / m - (c / (2 * m)) ** 2)
    a, b = 0.7 - l0, (-0.4 + decay * (0.7 - l0)) / w
    x = l0 + np.exp(-decay * t) * (a * np.cos(w * t) + b * np.sin(w * t))
    assert np.abs(found["q"][:, 0] - x).max() < 1e-11
    assert np.abs(found["forces/potential"][:, 0] - k * (x - l0) ** 2 / 2).max() < 1e-10
    assert np.abs(found["forces/power"][:, 0] + c * found["qd"][:, 0] ** 2).max() < 1e-10
    assert found.summary["energy_drift"] < 1e-11


def test_a_constant_force_and_a_force_against_it() -> None:
    forces = """forces:
  - {name: coil, type: constant_force, between: [cart.origin, base.origin], force: 3}
  - {name: push, type: force, at: cart.com, force: [3 + 2*t, 100, 0]}
"""
    found = run(SLIDER, forces)
    t = found["time"]
    # a few steps over 3 s: what rounding leaves of their dense output
    assert np.abs(found["q"][:, 0] - (0.7 - 0.4 * t + t**3 / 6)).max() < 3e-12
    assert np.abs(found["forces/potential"][:, 0] - 3 * found["q"][:, 0]).max() < 1e-12


@pytest.mark.parametrize(
    ("joint", "start"),
    [
        ("type: cylindrical", "{q: {a: [0, 0]}, qd: {a: [8, 0]}}"),
        ("type: planar", "{q: {a: [0, 0, 0]}, qd: {a: [0, 0, 8]}}"),
        ("type: helical, pitch: 1e-9", "{q: {a: 0}, qd: {a: 8}}"),
    ],
)
def test_a_torsional_spring_counts_full_turns_of_every_joint_about_its_axis(joint: str, start: str) -> None:
    """A wheel on a joint that also slides turns as one on a hinge does."""
    spring = (
        "forces: [{name: s, type: torsional_spring, between: [base.origin, wheel.origin], stiffness: 0.5}]"
    )
    text = TURNER.replace("type: revolute", joint).replace("{zz: 0.5}", "{xx: 1, yy: 1, zz: 0.5}")
    found = run(text.replace("{q: {a: 0}, qd: {a: 8}}", start), spring)
    turned = found["q"][:, {"planar": 2}.get(joint.split()[1], 0)]
    assert turned.max() > 2 * np.pi
    assert np.abs(turned - run(TURNER, spring)["q"][:, 0]).max() < 1e-9


def test_a_torsional_spring_counts_full_turns() -> None:
    k, J = 0.5, 0.5
    spring = f"{{name: s, type: torsional_spring, between: [base.origin, wheel.origin], stiffness: {k}, rest: 90 deg}}"
    found = run(TURNER, f"forces: [{spring}]")
    t, w = found["time"], np.sqrt(k / J)
    expected = np.pi / 2 - np.pi / 2 * np.cos(w * t) + 8 / w * np.sin(w * t)
    assert expected.max() > 2 * np.pi
    assert np.abs(found["q"][:, 0] - expected).max() < 1e-11
    assert found.summary["energy_drift"] < 1e-11


def test_a_bushing_about_one_axis_is_a_torsional_spring() -> None:
    kind = "{name: s, type: bushing, between: [base.origin, wheel.origin], stiffness: [9, 9, 9, 8, 8, 0.5], damping: [0, 0, 0, 0, 0, 0.1]}"
    other = "{name: s, type: torsional_spring, between: [base.origin, wheel.origin], stiffness: 0.5, damping: 0.1}"
    slow = ("initial.qd.a=1.5",)
    a, b = (run(TURNER, f"forces: [{x}]", *slow) for x in (kind, other))
    assert np.abs(a["q"] - b["q"]).max() < 1e-12


def test_energy_balances_work_with_every_kind_at_once() -> None:
    found = run(ARM)
    assert found.summary["energy_drift_relative"] < 1e-9
    assert found["forces/potential"].shape == (51, 7)
    assert np.abs(found["forces/power"]).max(axis=0)[[1, 2]].max() == 0.0


def test_what_inverse_finds_is_what_forward_needs() -> None:
    scene = load_scene_text(ARM)
    found = inverse(scene)
    assert {"passive", "external"} <= {
        p.split("/")[1] for p in found.variables if p.startswith("torque_terms/")
    }
    assert found.summary["round_trip"] < 1e-12
    assert abs(found.summary["error_estimate"]["energy_balance_relative"]) < 1e-6
    # the same from the parts of the equations, at one time
    k = 40
    problem = Problem(scene)
    f = problem.passive_forces(smooth=False)
    rest = list(problem.inverse_dynamics - f["passive"] - f["external"])
    at = {
        "t": [found["time"][k]],
        **{g: found[n][k].tolist() for g, n in (("q", "q"), ("v", "qd"), ("a", "qdd"))},
    }
    assert np.abs(np.array(evaluate(rest, at), dtype=float) - found["tau"][k]).max() < 1e-11


def test_reactions_in_joints_bear_the_forces_too() -> None:
    """About its axis a joint transmits the actuator's torque and nothing else."""
    found = inverse(load_scene_text(ARM, overrides=["outputs={reactions: true}"]))
    assert np.abs(found["reactions/j1"][:, 5] - found["tau"][:, 0]).max() < 1e-11
    assert np.abs(found["reactions/k1"][:, 3] - found["tau"][:, 3]).max() < 1e-11


def test_a_tip_wrench_on_the_lecture_arm() -> None:
    """The external part of the torques is -J^T F, with J by differences of the tip along the motion."""
    push = "forces=[{name: push, type: wrench, at: tip, force: [12, -5, 3], moment: [1, 2, 4]}]"
    scene = load_scene(CONFIGS / "2r_circle.yaml", [push])
    found, free = inverse(scene), inverse(load_scene(CONFIGS / "2r_circle.yaml"))
    q = free["q"]
    x = np.cumsum(q, axis=1)
    J = np.stack([[-np.sin(x).sum(axis=1), np.cos(x).sum(axis=1)], [-np.sin(x[:, 1]), np.cos(x[:, 1])]])
    expected = -np.einsum("jkt,k->tj", J, [12.0, -5.0]) - 4.0
    assert np.abs(found["torque_terms/external"] - expected).max() < 1e-12
    assert np.abs(found["tau"] - free["tau"] - expected).max() < 1e-11


def test_long_chains_take_forces_along() -> None:
    """The rolled chain with a spring at its tip equals the same chain as one graph of expressions."""
    n = 40
    joints = "\n".join(
        f"    - {{name: j{k}, type: revolute, axis: [{k % 2}, 1, 0.3], origin: {{xyz: [0.1, 0, 0]}}}}"
        for k in range(n)
    )
    links = "\n".join(
        f"    - {{name: l{k}, mass: 0.2, com: [0.05, 0.01, 0], inertia: {{xx: 1e-3, yy: 2e-3, zz: 2.5e-3}}}}"
        for k in range(n)
    )
    start = ", ".join(f"j{k}: {0.02 * (k % 5)}" for k in range(n))
    text = f"""
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
{joints}
  links:
{links}
  points: {{hook: {{link: base, at: [3, 0, 1]}}}}
forces:
  - {{name: s, type: spring, between: [l{n - 1}.com, hook], stiffness: 30, length: 0.4, damping: 0.5}}
  - {{name: f, type: force, at: l20.origin, force: [0, "sin(5*t)", 1]}}
initial: {{q: {{{start}}}}}
simulate: {{duration: 0.2, samples: 5}}
"""
    scene = load_scene_text(text)
    problem = Problem(scene)
    assert is_rolled(problem)
    found = simulate(scene)
    assert found.summary["energy_drift_relative"] < 1e-8
    system = build_system(problem, expanded=True)
    first = np.concatenate([found["q"][0], found["qd"][0], [0.0]])
    _, states, _ = integrate(system, "gauss", first, Grid.over(0.2, 5), Options(1e-10, 1e-12))
    assert np.abs(states[:, :n] - found["q"]).max() < 1e-9


def test_loops_and_deployment_with_a_spring() -> None:
    """A spring along the diagonal of the four-bar: energy balances, and the lock comes at another time."""
    spring = "forces=[{name: s, type: spring, between: [coupler.origin, follower.origin], stiffness: 0.05, length: 1.5}]"
    scene = load_scene(
        CONFIGS / "four_bar_deploy.yaml", [spring, "simulate.duration=5", "simulate.samples=101"]
    )
    found = simulate(scene)
    assert found.summary["energy_drift_relative"] < 1e-9
    assert np.ptp(found["forces/potential"]) > 1e-4
    locked = deploy(load_scene(CONFIGS / "four_bar_deploy.yaml", [spring]))
    assert locked.status == "locked"
    assert abs(locked.summary["lock"]["time"] - 12.283) > 1e-3


def test_functions_of_samples_take_no_time() -> None:
    push = "forces=[{name: push, type: force, at: tip, force: [sin(t), 0, 0]}]"
    scene = load_scene(CONFIGS / "2r_circle.yaml", [push])
    for function in (InverseDynamics, ForwardDynamics):
        with pytest.raises(CapabilityError, match="push"):
            function(scene)


@pytest.mark.parametrize(
    ("forces", "words"),
    [
        ("[{name: s, type: spring, between: [cart.com, cart.origin], stiffness: 1}]", "both places are on 'cart'"),
        ("[{name: s, type: spring, between: [base.origin, cart.com]}]", "stiffness"),
        ("[{name: s, type: spring, between: [base.origin, tipp], stiffness: 1}]", "unknown point 'tipp'"),
        ("[{name: f, type: force, at: base.origin, force: [1, 0, 0]}]", "ground"),
        ("[{name: f, type: force, at: cart.com, force: [1, 0]}]", "3 formulas"),
        ("[{name: f, type: force, at: cart.com, force: {table: [[1, 0, 0, 0], [0, 1, 1, 1]]}}]", "increase"),
        ("[{name: f, type: wrench, at: cart.com}]", "moment"),
        ("[{name: b, type: bushing, between: [base.origin, cart.com]}]", "stiffness"),
        ("[{name: b, type: bushing, between: [base.origin, cart.com], stiffness: [1, 1, 1, 1, 1, -1]}]", "negative"),
        ("[{name: b, type: bushing, between: [base.origin, cart.com], stiffness_matrix: [[1, 2, 0, 0, 0, 0], "
         "[0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]]}]", "symmetric"),
        ("[{name: t, type: torsional_spring, between: [base.origin, cart.com], stiffness: 1, axis: [0, 0, 0]}]", "zero"),
        ("[{name: s, type: rope, between: [base.origin, cart.com]}]", "torsional_spring"),
        ("[{name: s, type: constant_force, between: [base.origin, cart.com], force: 1}, "
         "{name: s, type: constant_force, between: [base.origin, cart.com], force: 1}]", "appears twice"),
    ],
)  # fmt: skip
def test_bad_input_says_where_and_what(forces: str, words: str) -> None:
    with pytest.raises(SceneError, match=words) as caught:
        load_scene_text(f"{SLIDER}\nforces: {forces}")
    assert caught.value.details["key"].startswith("forces.")
