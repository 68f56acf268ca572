"""Stops of joints, compliant and rigid: closed forms, energy, contact that lasts, impacts in trees and loops."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.motion.contact.impact import Impact
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.works.simulate import simulate
from tests.mechanisms import SLIDER

BALL = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints: [{name: z, type: prismatic, axis: [0, 0, 1], limits: {lower: 0, stop: {restitution: 0.7}}}]
  links: [{name: ball, mass: 2, com: [0, 0, 0]}]
initial: {q: {z: 1}}
simulate: {duration: 4, samples: 401}
"""
CART = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0], limits: {upper: 0.5, stop: %s}}]
  links: [{name: cart, mass: 2, com: [0, 0, 0]}]
initial: {q: {x: 0}, qd: {x: 3}}
simulate: {duration: 0.5, samples: 501, rtol: 1e-11, atol: 1e-13}
"""
ARM = """
schema: 1
gravity: [1, 2, -9.81]
robot:
  joints:
    - {name: j1, type: revolute, axis: [0, 0, 1]}
    - {name: j2, type: revolute, origin: {xyz: [0.5, 0.1, 0], rpy: [0.4, 0, 0]}, axis: [0, 1, 0.3], limits: {lower: -0.5, upper: 1, stop: {restitution: 0.6}}}
    - {name: j3, type: revolute, origin: {xyz: [0.3, 0, 0.1]}, axis: [1, 0.2, 0], limits: {lower: -0.4, upper: 0.5, stop: {restitution: 0.3}}}
  links:
    - {name: l1, mass: 3, com: [0.2, 0.03, 0.01], inertia: {xx: 0.05, yy: 0.06, zz: 0.07, xy: 0.01, xz: -0.005, yz: 0.002}}
    - {name: l2, mass: 2, com: [0.1, 0.05, -0.02], inertia: {xx: 0.03, yy: 0.04, zz: 0.05, xy: 0.004, xz: -0.005, yz: 0.002}}
    - {name: l3, mass: 1, com: [0.1, -0.03, 0.04], inertia: {xx: 0.02, yy: 0.03, zz: 0.025, xy: 0.003, xz: -0.001, yz: 0.002}}
torques: {j1: "4*sin(3*t)", j2: "3*cos(2*t)"}
initial: {q: {j1: 0.3, j2: 0.8, j3: 0.1}, qd: {j1: 1}}
simulate: {duration: 3, samples: 301}
"""

FLOATING = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: ball, type: floating}
    - {name: arm, type: revolute, axis: [0, 1, 0.2], origin: {xyz: [0.3, 0, 0]}, limits: {lower: -0.5, upper: 0.5, stop: {restitution: 0.7}}, friction: {law: set_valued, coulomb: 0.05}}
  links:
    - {name: body, mass: 3, com: [0.02, 0.03, 0.01], inertia: {xx: 0.05, yy: 0.06, zz: 0.07, xy: 0.01, xz: -0.005, yz: 0.002}}
    - {name: tail, mass: 0.6, com: [0.1, 0.05, -0.02], inertia: {xx: 0.003, yy: 0.004, zz: 0.005}}
  points: {hook: {link: base, at: [0, 0, 1]}, eye: {link: body, at: [0.1, 0.05, 0.1]}}
forces:
  - {name: cord, type: spring, between: [hook, eye], stiffness: 200, length: 0.6, damping: 1}
  - {name: bush, type: bushing, between: [base.origin, tail.com], stiffness: [3, 4, 5, 0.2, 0.3, 0.1], damping: [0.1, 0.1, 0.1, 0.01, 0.01, 0.01]}
  - {name: push, type: force, at: tail.com, force: ["sin(3*t)", "q.arm", "qd.arm"]}
initial: {q: {ball: {xyz: [0,0,0], rpy: [0,0,0]}, arm: 0.1}, qd: {arm: 1}}
simulate: {duration: 1, samples: 51}
outputs: {reactions: true}
"""


def run(text: str, *overrides: str) -> Any:
    return simulate(load_scene_text(text, overrides=overrides))


def of_kind(found: Any, kind: str) -> list[dict[str, Any]]:
    return [event for event in found.events if event["kind"] == kind]


def test_a_bouncing_ball() -> None:
    """Bounces at T (1 + 2 e + 2 e^2 + ...), T = sqrt(2 h / g); at rest from T (1 + e) / (1 - e) on."""
    found = run(BALL)
    g, e, fall = 9.81, 0.7, np.sqrt(2 / 9.81)
    hits = of_kind(found, "impact")
    k = np.arange(len(hits))
    times = fall * (1 + 2 * e * (1 - e**k) / (1 - e))
    assert np.abs([h["time"] for h in hits] - times).max() < 1e-12
    assert np.abs(np.array([h["speed"] for h in hits]) - g * fall * e**k).max() < 1e-12
    # e^2 of the energy is left, until the last hit, after which the ball rests
    lost = np.array([h["energy_lost"] for h in hits])[:-1]
    assert np.abs(lost / (2 * g * e ** (2 * k[:-1]) * (1 - e**2)) - 1).max() < 1e-7
    end = fall * (1 + e) / (1 - e)
    (contact,) = of_kind(found, "contact")
    assert 0 < end - contact["time"] < 1e-5
    t = found["time"]
    k = np.searchsorted(times, t, side="right")[t < contact["time"]]
    flying = t[t < contact["time"]]
    since = np.where(k > 0, flying - times[np.maximum(k - 1, 0)], flying)
    expected = np.where(k > 0, g * fall * e**k * since - g * since**2 / 2, 1 - g * flying**2 / 2)
    assert np.abs(found["q"][: len(flying), 0] - expected).max() < 1e-11
    assert np.all(found["q"][t > end] == 0.0) and np.all(found["qd"][t > end] == 0.0)
    assert found.summary["energy_drift_relative"] < 1e-11
    assert found.summary["transitions"]["impact"] == len(hits) < 60


@pytest.mark.parametrize("e", [0.0, 0.95, 1.0])
def test_dead_and_lively_balls(e: float) -> None:
    found = run(BALL, f"robot.joints.z.limits.stop.restitution={e}")
    hits, fall = of_kind(found, "impact"), np.sqrt(2 / 9.81)
    if e == 0.0:
        assert len(hits) == len(of_kind(found, "contact")) == 1
    elif e == 1.0:
        assert np.abs([h["time"] for h in hits] - fall * (1 + 2 * np.arange(len(hits)))).max() < 1e-11
        assert len(hits) == 4 and found.summary["energy_drift_relative"] < 1e-12
    assert np.abs(found.events[0]["time"] - fall) < 1e-13


def test_a_fixed_step_rests_where_it_cannot_follow_the_bounces() -> None:
    found = run(BALL, "simulate.integrator=rk4", "simulate.step=1e-3")
    exact = run(BALL)
    assert len(of_kind(found, "contact")) == 1 and len(of_kind(found, "impact")) < len(
        of_kind(exact, "impact")
    )
    assert np.abs(found["q"] - exact["q"]).max() < 1e-6 and found["qd"][-1, 0] == 0.0


@pytest.mark.parametrize("method", ["rk4", "gauss4"])
def test_a_step_that_nobody_gave_survives_impacts(method: str) -> None:
    """It is a thousandth of the run; what an impact leaves of a step is no measure of the next ones."""
    scene = load_scene_text(BALL)
    options = dataclasses.replace(scene.simulate, integrator=method, duration=2.0, error_estimate=False)
    found = simulate(dataclasses.replace(scene, simulate=options))
    impacts = len(of_kind(found, "impact"))
    assert impacts > 3 and found.summary["counters"]["steps"] < 1100 + 40 * impacts


def test_a_joint_rests_on_its_stop_until_it_is_pulled_off() -> None:
    """m g holds it down; the force 8 t lifts it off at m g / 8."""
    lift = 2 * 9.81 / 8
    found = run(BALL, "initial.q.z=0", "torques={z: '8*t'}")
    assert [e["kind"] for e in found.events] == ["contact", "release"]
    assert abs(found.events[1]["time"] - lift) < 1e-12
    s = np.maximum(found["time"] - lift, 0.0)
    assert np.abs(found["q"][:, 0] - 8 / 2 * s**3 / 6).max() < 1e-11
    # with friction in the joint as well, it must be pulled harder
    friction = run(
        BALL, "initial.q.z=0", "torques={z: '8*t'}", "robot.joints.z.friction={law: set_valued, coulomb: 4}"
    )
    assert abs(friction.events[1]["time"] - lift - 0.5) < 1e-12


def test_impacts_in_a_spatial_arm() -> None:
    """Each impact takes (1 - e^2) / 2 v^2 / (M^-1)_jj, the effective kinetic energy; all balances at the end."""
    scene = load_scene_text(ARM)
    found = simulate(scene)
    problem = Problem(scene)
    hits = of_kind(found, "impact")
    assert {h["name"] for h in hits} == {"j2", "j3"} and len(hits) > 6
    # what the last and slowest impacts lose is below the rounding of the arm's energy
    free = [
        h
        for h in hits
        if h["speed"] > 1e-4 and not any(c["time"] <= h["time"] for c in of_kind(found, "contact"))
    ]
    assert free
    for hit in free:
        j = ("j1", "j2", "j3").index(hit["name"])
        k = int(np.searchsorted(found["time"], hit["time"]))
        # the mass matrix at the impact, from the samples beside it
        q = [
            np.interp(hit["time"], found["time"][k - 1 : k + 1], found["q"][k - 1 : k + 1, i])
            for i in range(3)
        ]
        q[j] = next(x for x in (-0.5, 1.0, -0.4, 0.5) if abs(x - q[j]) < 0.1)
        M = np.array(evaluate(list(problem.mass_matrix.ravel()), {"q": [float(x) for x in q]}), dtype=float)
        e = (0.6, 0.3)[j - 1]
        expected = (1 - e**2) / 2 * hit["speed"] ** 2 / np.linalg.inv(M.reshape(3, 3))[j, j]
        assert abs(hit["energy_lost"] / expected - 1) < 2e-2
    assert found.summary["energy_drift_relative"] < 1e-9
    q = found["q"]
    assert q[:, 1].min() > -0.5 - 1e-9 and q[:, 1].max() < 1 + 1e-9 and np.abs(q[:, 2]).max() < 0.5 + 1e-9


def test_the_impulse_equations() -> None:
    """Random M and Psi: constraints kept, restitution met, the energy lost known, joints at rest not pushed through."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        n, m = 6, 2
        A = rng.normal(size=(n, n))
        M, psi = A @ A.T + 0.1 * np.eye(n), rng.normal(size=(m, n))
        v = rng.normal(size=n)
        v -= np.linalg.pinv(psi) @ psi @ v
        new = Impact(M, psi, v, 3, {}).after(0.5)
        assert np.abs(psi @ new).max() < 1e-10 and new[3] == -0.5 * v[3]
        # what acts on the joint with the constraints kept
        S = np.linalg.inv(M) - np.linalg.inv(M) @ psi.T @ np.linalg.inv(
            psi @ np.linalg.inv(M) @ psi.T
        ) @ psi @ np.linalg.inv(M)
        lost = Impact(M, psi, v, 3, {}).lost(new)
        assert abs(lost - 0.75 / 2 * v[3] ** 2 / S[3, 3]) < 1e-9 * lost
        v[0] = 0.0
        new = Impact(M, np.zeros((0, n)), v, 3, {0: 1.0}).after(0.5)
        impulse = M @ (new - v)
        assert np.abs(np.delete(impulse, [0, 3])).max() < 1e-9
        assert new[0] >= 0.0 and impulse[0] > -1e-9 and abs(new[0] * impulse[0]) < 1e-9


def test_a_stop_in_a_closed_loop() -> None:
    """A slider-crank whose piston meets a stop: the loop stays closed and energy balances."""
    text = "schema: 1\n" + SLIDER.replace(
        "theta: 0, origin", "theta: 0, limits: {lower: 0.7, stop: {restitution: 0.5}}, origin", 1
    )
    found = run(text)
    assert len(of_kind(found, "impact")) >= 2
    assert found["q"][:, 2].min() > 0.7 - 1e-9
    assert found.summary["constraint_residual"]["velocity"] < 1e-9
    assert found.summary["energy_drift_relative"] < 1e-8


def test_an_elastic_stop_is_half_an_oscillation() -> None:
    k, m = 2e4, 2.0
    found = run(CART % f"{{stiffness: {k}}}")
    w, hit, t = np.sqrt(k / m), 0.5 / 3, found["time"]
    inside = (t > hit) & (t < hit + np.pi / w)
    x = np.where(
        t < hit, 3 * t, np.where(inside, 0.5 + 3 / w * np.sin(w * (t - hit)), 0.5 - 3 * (t - hit - np.pi / w))
    )
    assert np.abs(found["q"][:, 0] - x).max() < 1e-10
    assert found.summary["energy_drift"] < 1e-9
    assert np.abs(found["energy/potential"].max() - 9.0) < 2e-2
    assert found.summary["counters"]["steps"] < 150


def test_a_spring_and_damper_never_pulls() -> None:
    """The contact ends when k delta + c delta-dot falls to zero, with a known speed (closed form)."""
    k, c, m = 2e4, 60.0, 2.0
    found = run(CART % f"{{stiffness: {k}, damping: {c}}}")
    decay, w = c / (2 * m), np.sqrt(k / m - (c / (2 * m)) ** 2)
    # delta = 3/w e^(-decay s) sin(w s); the force, -m delta'', vanishes first at tan(w s) = 2 decay w / (decay^2 - w^2)
    s = np.arctan2(2 * decay * w, decay**2 - w**2) / w
    speed = 3 * np.exp(-decay * s) * (np.cos(w * s) - decay / w * np.sin(w * s))
    assert np.abs(found["qd"][-1, 0] - speed) < 1e-8
    assert found.summary["energy_drift"] < 1e-9
    assert abs(found["energy/work"][-1] - (speed**2 - 9) * m / 2) < 1e-7
    assert found.summary["error_estimate"]["state_max"] < 1e-8


def test_hunt_and_crossley_lose_what_their_law_says() -> None:
    """For small losses v- - v+ = (2/3) (c/k) v-^2 (Hunt and Crossley 1975), for any exponent."""
    for n in (1.0, 1.5):
        found = run(CART % f"{{stiffness: 1e5, damping: 200, law: hunt_crossley, exponent: {n}}}")
        assert abs((3 + found["qd"][-1, 0]) / (2 / 3 * 200 / 1e5 * 9) - 1) < 2e-2
        assert found.summary["energy_drift_relative"] < 1e-9


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ("{lower: 1, upper: 0, stop: {restitution: 0.5}}", "above 'lower'"),
        ("{stop: {restitution: 0.5}}", "'lower' or 'upper'"),
        ("{lower: 0, stop: {}}", "restitution"),
        ("{}", "needs one of 'lower', 'upper', 'speed'"),
        ("{speed: 0}", "too small"),
        ("{lower: 0, stop: {restitution: 1.5}}", "too large"),
        ("{lower: 0, stop: {restitution: 0.5, stiffness: 10}}", "either"),
        ("{lower: 0, stop: {stiffness: 10, exponent: 1.5}}", "hunt_crossley"),
    ],
)
def test_limits_that_do_not_fit_together(limits: str, words: str) -> None:
    with pytest.raises(SceneError, match=words) as caught:
        load_scene_text(BALL.replace("{lower: 0, stop: {restitution: 0.7}}", limits))
    assert caught.value.details["key"].startswith("robot.joints.0.limits")


def test_a_start_beyond_a_stop_is_refused() -> None:
    with pytest.raises(SceneError, match="beyond its stop"):
        run(BALL, "initial.q.z=-0.1")


def test_a_floating_body_with_forces_and_a_tail_that_sticks_and_bounces() -> None:
    """Quaternions, forces between bodies, friction and stops together: energy balances."""
    found = run(FLOATING)
    assert {"impact", "slip"} <= set(found.summary["transitions"])
    assert found.summary["energy_drift_relative"] < 1e-10
    assert found.summary["error_estimate"]["state_max"] < 1e-8


CORNER = """
schema: 1
gravity: [{x:.3f}, -9.81, 0]
robot:
  joints:
    - {{name: a, type: revolute, axis: [0, 0, 1], limits: {{lower: -0.5, stop: {{restitution: {e:.2f}}}}}}}
    - {{name: b, type: revolute, axis: [0, 0, 1], origin: {{xyz: [1, 0, 0]}},
        limits: {{lower: -0.4, stop: {{restitution: {f:.2f}}}}}}}
  links:
    - {{name: l, mass: {m:.3f}, com: [0.5, 0, 0], inertia: {{zz: 0.1}}}}
    - {{name: m, mass: {n:.3f}, com: [{c:.3f}, 0, 0], inertia: {{zz: {i:.3f}}}}}
initial: {{q: {{a: {q:.3f}, b: {r:.3f}}}}}
simulate: {{duration: 3, samples: 31, error_estimate: false}}
"""


@pytest.mark.parametrize("seed", range(12))
def test_joints_that_throw_each_other_on_their_stops_come_to_rest(seed: int) -> None:
    """Two joints that fall into the corner of their stops: impacts accumulate, or fall together."""
    rng = np.random.default_rng(seed)
    draw = rng.uniform
    text = CORNER.format(
        x=draw(-2, 2), e=draw(0, 0.6), f=draw(0, 0.6) * (seed % 3 > 0), m=draw(0.3, 2), n=draw(0.3, 3),
        c=draw(0.3, 1.2), i=draw(0.01, 0.5), q=draw(-0.4, 0.5), r=draw(-0.3, 0.5),
    )  # fmt: skip
    result = simulate(load_scene_text(text))
    assert result.status == "ok"
    assert (result["q"] >= np.array([-0.5, -0.4]) - 1e-9).all()
    assert result.summary["energy_drift"] < 1e-8
    lost = [event["energy_lost"] for event in result.events if event["kind"] == "impact"]
    assert min(lost) > -1e-12


def chain_between_stops(seed: int) -> str:
    """Return a plane chain of three joints that is thrown to and fro between rigid stops, some of them dead."""
    rng = np.random.default_rng(seed)
    draw = rng.uniform
    joints, links = [], []
    for k in range(3):
        e = float(rng.choice((0.0, 0.5, draw(0.0, 0.7))))
        place = (0.0, 0.0) if k == 0 else (draw(-0.6, 0.6), draw(-0.6, 0.6))
        limits = f"limits: {{lower: {draw(-0.3, 0):.3f}, upper: {draw(0.3, 0.7):.3f}, stop: {{restitution: {e:.2f}}}}}"
        joints.append(
            f"    - {{name: j{k}, type: revolute, axis: [0, 0, 1], origin: {{xyz: [{place[0]:.3f}, {place[1]:.3f}, 0]}}, "
            f"damper: {{damping: {draw(0, 0.4):.3f}}}, {limits}}}"
        )
        com = f"[{draw(-0.3, 0.3):.3f}, {draw(-0.3, 0.3):.3f}, 0]"
        links.append(
            f"    - {{name: l{k}, mass: {draw(0.3, 2):.3f}, com: {com}, inertia: {{zz: {draw(0.01, 1.2):.3f}}}}}"
        )
    return "\n".join(
        [
            "schema: 1",
            f"gravity: [{draw(-4, 4):.3f}, {draw(-4, 4):.3f}, 0]",
            "robot:",
            "  joints:",
            *joints,
            "  links:",
            *links,
            f"initial: {{q: {{j0: 0.1, j1: 0.1, j2: 0.1}}, qd: {{j0: {draw(-2, 2):.3f}, j1: {draw(-2, 2):.3f}}}}}",
            "simulate: {duration: 1.5, samples: 16, error_estimate: false}",
        ]
    )


@pytest.mark.parametrize("seed", [300, 369, *range(6)])
def test_flights_below_rounding_end(seed: int) -> None:
    """At the tightest tolerances joints leave their stops by less than rounding, and steps are below that of time."""
    found = run(
        chain_between_stops(seed), "simulate.rtol=5e-13", "simulate.atol=5e-15", "simulate.max_step=0.005"
    )
    assert found.status == "ok"
    assert found.summary["energy_drift"] < 1e-9
