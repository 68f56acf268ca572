"""Springs to ground points that move, nonlinear springs, and distances of points in formulas."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.model.model import FixedFrame
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.torques.dynamics import InverseDynamics
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate
from tests.unit.test_forces_between import ARM

MOTION = ("0.2*sin(3*t)", "0.1*t^2", "-0.15*cos(2*t)")
AT = (0.4, -0.3, 0.9)
START = "initial: {q: {j1: 0.3, j2: -0.4, j3: 0.1, k1: 0.5}, qd: {j1: 0.5, k1: -1}}\nsimulate: {duration: 1.5, samples: 51}\n"


def arm(forces: str, points: str = "", more: str = "") -> str:
    """Return the arm with forces, and points beside its own."""
    head, _, rest = ARM.partition("  points:\n")
    robot = f"{head}  points:\n{points}"
    kept = rest.partition("initial:")[0].partition("forces:")[0]
    return f"{robot}{kept}{START}{more}\nforces:\n{forces}"


def driven(point: str, forces: str) -> str:
    """Return the arm with a ground point that moves by formulas, or the same point on prescribed slides."""
    if point == "formulas":
        return arm(forces, f"    moved: {{link: base, at: {list(AT)}, motion: [{', '.join(MOTION)}]}}\n")
    axes = ([1, 0, 0], [0, 1, 0], [0, 0, 1])
    joints = "".join(
        f"    - {{name: s{k}, type: prismatic, parent: {'base' if k == 0 else f'c{k - 1}'}, link: c{k}, axis: {axis}"
        + (f", origin: {{xyz: {list(AT)}}}" if k == 0 else "") + "}\n"
        for k, axis in enumerate(axes)
    )  # fmt: skip
    links = "".join(f"    - {{name: c{k}, mass: {int(k == 2)}, com: [0, 0, 0]}}\n" for k in range(3))
    text = arm(forces, "    moved: {link: c2, at: [0, 0, 0]}\n")
    text = text.replace("  links:\n", f"{joints}  links:\n", 1).replace(
        "  points:\n", f"{links}  points:\n", 1
    )
    return text + "\nprescribed: {" + ", ".join(f"s{k}: {x}" for k, x in enumerate(MOTION)) + "}\n"


FORCES = """
  - {name: a, type: spring, between: [moved, tip], stiffness: 80, length: 0.4, damping: 6}
  - {name: b, type: constant_force, between: [m1.com, moved], force: 9}
  - {name: c, type: bushing, between: [moved, l3.com], stiffness: [30, 40, 20, 0, 0, 0], damping: [1, 2, 1, 0, 0, 0]}
"""


def test_a_spring_to_a_moving_ground_point() -> None:
    """The same motion as with a body that prescribed slides move; and the ground's work is in the balance."""
    one, other = (simulate(load_scene_text(driven(x, FORCES))) for x in ("formulas", "slides"))
    assert np.abs(one["q"] - other["q"][:, :4]).max() < 1e-9
    assert one.summary["energy_drift_relative"] < 1e-9
    total = (one["energy/kinetic"] + one["energy/potential"]).ravel()
    assert np.ptp(total) > 1.0  # the ground does work, or the balance would show nothing
    assert np.abs(one["forces/potential"] - other["forces/potential"]).max() < 1e-8


def test_torques_against_a_spring_to_a_moving_point() -> None:
    path = "trajectory: {type: joint, duration: 1.5, q: {j1: 0.3*t, j2: sin(t), j3: 0.1*t, k1: 0.5 - t}}\n"
    one = inverse(load_scene_text(driven("formulas", FORCES).replace("forces:\n", path + "forces:\n", 1)))
    assert one.summary["error_estimate"]["energy_balance_relative"] < 1e-9
    with pytest.raises(CapabilityError, match=r"depend on time \(a, b, c\)"):
        InverseDynamics(load_scene_text(driven("formulas", FORCES)))


def test_an_oscillator_on_a_shaken_ground() -> None:
    """m x'' = k (A sin(w t) - x), from rest: x = A / (1 - r^2) (sin(w t) - r sin(w0 t)), r = w / w0."""
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0]}]
  links: [{name: cart, mass: 2, com: [0, 0, 0]}]
  points: {shaken: {link: base, at: [-5, 0, 0], motion: [0.3*sin(4*t), 0, 0]}}
forces: [{name: s, type: spring, between: [shaken, cart.origin], stiffness: 50, length: 5}]
initial: {q: {x: 0}}
simulate: {duration: 4, samples: 41, rtol: 1e-12, atol: 1e-14}
"""
    found = simulate(load_scene_text(text))
    t, r = found["time"].ravel(), 4 / 5
    exact = 0.3 / (1 - r * r) * (np.sin(4 * t) - r * np.sin(5 * t))
    assert np.abs(found["q"][:, 0] - exact).max() < 1e-11


def test_steps_end_where_the_motion_of_the_ground_bends() -> None:
    text = arm(FORCES, f"    moved: {{link: base, at: {list(AT)}, motion: [abs(t - 0.61), 0, 0]}}\n")
    found = simulate(load_scene_text(text))
    assert found.summary["energy_drift_relative"] < 1e-9
    jump = arm(FORCES, f"    moved: {{link: base, at: {list(AT)}, motion: [step(t - 0.61), 0, 0]}}\n")
    with pytest.raises(SceneError, match=r"moved.*jumps at t = 0\.61 s"):
        simulate(load_scene_text(jump))


def test_a_formula_of_length_and_rate_is_a_spring() -> None:
    plain = (
        "  - {name: a, type: spring, between: [base.origin, tip], stiffness: 80, length: 0.4, damping: 6}\n"
    )
    law = "  - {name: a, type: nonlinear_spring, between: [base.origin, tip], tension: 80*(length - 0.4) + 6*rate}\n"
    spans = (
        "  - {name: a, type: nonlinear_spring, between: [base.origin, tip], "
        "tension: '80*(length(tip, base.origin) - 0.4) + 6*length_rate(base.origin, tip)'}\n"
    )
    one, *others = (simulate(load_scene_text(arm(forces))) for forces in (plain, law, spans))
    for other in others:
        assert np.abs(one["q"] - other["q"]).max() < 1e-9
        assert other.summary["energy_drift_relative"] < 1e-9


TABLE = "[[0.2, -8], [0.5, 0], [0.8, 4], [1.1, 25]]"
PIECES = (
    "if(length < 0.2, -8, if(length < 0.5, -8 + (length - 0.2)*8/0.3, if(length < 0.8, (length - 0.5)*4/0.3, "
    "if(length < 1.1, 4 + (length - 0.8)*21/0.3, 25))))"
)


def test_a_table_over_the_length_has_a_potential() -> None:
    """The same motion as with a formula of pieces, and energy in place of work."""
    damping = "damping: {table: [[-1, -3], [0, 0], [0.5, 0.5], [2, 4]]}"
    between = "type: nonlinear_spring, between: [base.origin, tip]"
    table = simulate(
        load_scene_text(arm(f"  - {{name: a, {between}, tension: {{table: {TABLE}}}, {damping}}}\n"))
    )
    pieces = simulate(load_scene_text(arm(f"  - {{name: a, {between}, tension: '{PIECES}', {damping}}}\n")))
    assert np.abs(table["q"] - pieces["q"]).max() < 1e-9
    assert table.summary["energy_drift_relative"] < 1e-9
    assert pieces.summary["energy_drift_relative"] < 1e-9
    assert np.ptp(table["forces/potential"]) > 0.5
    assert not pieces["forces/potential"].any()
    assert (table["forces/power"] <= 1e-12).all()
    lossless = simulate(load_scene_text(arm(f"  - {{name: a, {between}, tension: {{table: {TABLE}}}}}\n")))
    assert lossless.summary["energy_drift_relative"] < 1e-9
    assert not lossless["forces/power"].any()


def test_distances_and_their_rates_at_random_states() -> None:
    """Against the points' places, and the rate against central differences along the motion."""
    text = arm(
        "  - {name: f, type: force, at: tip, force: ['length(tip, m1.com)', 'length_rate(m1.com, tip)', 0]}\n"
    )
    problem = Problem(load_scene_text(text))
    assert set(problem.of_points) == {"length(tip, m1.com)", "length_rate(m1.com, tip)"}
    rng = np.random.default_rng(5)
    model = problem.model
    tip = model.points["tip"]
    length, rate = problem.of_points["length(tip, m1.com)"], problem.of_points["length_rate(m1.com, tip)"]
    body = next(b for b in model.bodies if b.name == "m1")
    part = body.parts[0]
    com = FixedFrame(model.bodies.index(body), part.frame.point(part.c), tip.R)
    place = [problem.world_point(tip), problem.world_point(com)]
    for _ in range(10):
        q, v = rng.normal(size=4), rng.normal(size=4)

        def distance(q: np.ndarray) -> float:
            a, b = (problem.numbers(p, q) for p in place)
            return float(np.linalg.norm(a - b))

        assert problem.numbers([length], q)[0] == pytest.approx(distance(q), rel=1e-13)
        slope = (distance(q + 1e-5 * v) - distance(q - 1e-5 * v)) / 2e-5
        assert problem.numbers([rate], q, v=v)[0] == pytest.approx(slope, rel=1e-7, abs=1e-8)


def test_a_torque_by_the_length_of_a_muscle() -> None:
    """A pendulum pulled with k (l - l0) at the lever dl/dq is one with a spring along the same line."""
    text = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{name: a, type: revolute, axis: [0, 0, 1]}]
  links: [{name: rod, mass: 2, com: [0.5, 0, 0], inertia: {zz: 0.2}}]
  points: {hook: {link: rod, at: [1, 0, 0]}, wall: {link: base, at: [0, 1.5, 0]}}
initial: {q: {a: 0.3}}
simulate: {duration: 2, samples: 21}
"""
    # l^2 = 1 + 1.5^2 - 3 sin(q), so dl/dq = -1.5 cos(q) / l
    muscle = "torques: {a: '-30*(length(hook, base.wall) - 0.9)*(-1.5*cos(a)/length(base.wall, hook))'}\n"
    spring = "forces: [{name: s, type: spring, between: [hook, base.wall], stiffness: 30, length: 0.9}]\n"
    one, other = (simulate(load_scene_text(text + x)) for x in (muscle, spring))
    assert np.abs(one["q"] - other["q"]).max() < 1e-9


REFUSED = {
    "tension: 'length(tip, nowhere)'": "unknown point 'nowhere'",
    "tension: 'length(tip)'": "',' is needed here",
    "tension: 'length(tip, 3)'": "a point is needed here",
    "tension: 'rate*speed'": "unknown name 'speed'",
    "tension: {table: [[0.1, 2], [0.1, 3]]}": "must increase",
    "tension: {table: [[-0.1, 2], [0.1, 3]]}": "must not be negative",
    "damping: {table: [[-1, 2], [0, 0], [1, 3]]}": "drives where it should brake",
    "damping: {table: [[-1, -2], [1, 3]]}": r"needs the row \[0, 0\]",
    "damping: 0": "needs a 'tension' or a 'damping'",
}


@pytest.mark.parametrize("given", REFUSED)
def test_what_is_refused(given: str) -> None:
    with pytest.raises(SceneError, match=REFUSED[given]):
        load_scene_text(
            arm(f"  - {{name: a, type: nonlinear_spring, between: [base.origin, tip], {given}}}\n")
        )


@pytest.mark.parametrize(
    "where",
    [
        "prescribed: {j1: 'length(tip, base.origin)'}",
        "couplers: [{name: c, terms: {j1: 1, j2: 1}, value: 'length(tip, base.origin)'}]",
    ],
)
def test_only_torques_and_forces_know_distances(where: str) -> None:
    with pytest.raises(SceneError, match="is not allowed here"):
        load_scene_text(arm("", more=where).replace("\nforces:\n", "\n"))
