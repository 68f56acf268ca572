"""Bodies that turn freely or about a point, against closed forms, and what every method owes to quaternions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial import quaternion
from robodyn_cli.works.simulate import simulate
from tests.methods import taking
from tests.systems import Grid, collect

FREE = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{{name: body, type: {kind}}}]
  links: [{{name: b, mass: 2, com: [0, 0, 0], inertia: {{xx: {A}, yy: {B}, zz: {C}}}}}]
  points: {{mark: {{link: b, at: [1, 0, 0]}}}}
initial: {{q: {{body: {q}}}, qd: {{body: {v}}}}}
simulate: {{duration: {T}, samples: 401, rtol: 1e-12, atol: 1e-13, error_estimate: false}}
"""


def rotations(q: np.ndarray) -> np.ndarray:
    return np.array([np.array(quaternion.rotation(row), dtype=float) for row in q])


def test_asymmetric_top_against_jacobis_elliptic_functions() -> None:
    """Free rotation with A < B < C, energy above that of the middle axis: Landau and Lifshitz, Mechanics, section 37."""
    A, B, C = 0.7, 1.1, 1.6
    w1, w3 = 0.8, 2.0
    E2, L2 = (
        A * w1**2 + C * w3**2,
        (A * w1) ** 2 + (C * w3) ** 2,
    )  # twice the energy, and the squared momentum
    assert L2 > E2 * B
    p = np.sqrt((C - B) * (L2 - E2 * A) / (A * B * C))
    k2 = (B - A) * (E2 * C - L2) / ((C - B) * (L2 - E2 * A))
    period = 4 * ellipk(k2) / p
    scene = load_scene_text(
        FREE.format(
            kind="spherical", A=A, B=B, C=C, q="{rpy: [0.3, -0.2, 0.5]}", v=f"[{w1}, 0, {w3}]", T=8 * period
        )
    )
    result = simulate(scene)
    sn, cn, dn, _ = ellipj(p * result.time, k2)
    # released where w2 = 0: w1 = cn, w3 = dn, and w2 runs to the side that the equations say
    exact = np.column_stack(
        [
            np.sqrt((E2 * C - L2) / (A * (C - A))) * cn,
            -np.sqrt((E2 * C - L2) / (B * (C - B))) * sn,
            np.sqrt((L2 - E2 * A) / (C * (C - A))) * dn,
        ]
    )
    exact[:, 1] *= np.sign(result["qd"][1, 1]) * np.sign(exact[1, 1])
    np.testing.assert_allclose(result["qd"], exact, atol=3e-10)
    # momentum and energy keep their values in the world, and Poinsot's plane its distance
    momentum = np.einsum("tij,tj->ti", rotations(result["q"]), result["qd"] * [A, B, C])
    np.testing.assert_allclose(momentum, momentum[:1] + np.zeros((401, 1)), atol=1e-10)
    assert np.ptp(result["energy/total"]) < 1e-11
    distance = np.einsum("tj,tj->t", result["qd"], result["qd"] * [A, B, C])
    np.testing.assert_allclose(distance, E2, rtol=1e-11)
    assert np.abs(np.linalg.norm(result["q"], axis=1) - 1.0).max() < 1e-14


def test_floating_body_is_a_point_mass_and_a_free_top() -> None:
    """Off its centre of mass: that one flies a parabola, the rotation is the one of a spherical joint there."""
    inertia, com = "inertia: {xx: 0.7, yy: 1.1, zz: 1.6, xy: 0.1, yz: -0.05}", [0.3, -0.1, 0.2]
    text = f"""
schema: 1
gravity: [0.5, -3, -9.81]
robot:
  joints: [{{name: body, type: floating, origin: {{xyz: [1, 2, 3], rpy: [0.4, 0.5, 0.6]}}}}]
  links: [{{name: b, mass: 2, com: {com}, {inertia}}}]
  points: {{centre: {{link: b, at: com}}}}
initial:
  q: {{body: {{xyz: [0.1, 0.2, 0.3], rotation_vector: [1, 0.5, -0.3]}}}}
  qd: {{body: [0.3, 0.1, -0.7, 1.3, 2.1, -0.4]}}
simulate: {{duration: 5, samples: 301, rtol: 1e-12, atol: 1e-13, error_estimate: false}}
"""
    result = simulate(load_scene_text(text))
    t = result.time[:, None]
    place = result["points/centre"]
    v, w = result["qd"][:, :3], result["qd"][:, 3:]
    scene = load_scene_text(text)
    frame = np.array(Problem(scene).model.bodies[0].X_tree.E, dtype=float).T
    R = frame @ rotations(result["q"][:, 3:])
    velocity = np.einsum("tij,tj->ti", R, v + np.cross(w, com))
    g = np.array([0.5, -3.0, -9.81])
    np.testing.assert_allclose(place, place[0] + velocity[0] * t + 0.5 * g * t * t, atol=1e-10)
    np.testing.assert_allclose(velocity, velocity[0] + g * t, atol=1e-10)
    top = (
        text.replace("floating", "spherical")
        .replace(str(com), "[0, 0, 0]")
        .replace("xyz: [0.1, 0.2, 0.3], ", "")
    )
    top = top.replace("[0.3, 0.1, -0.7, 1.3, 2.1, -0.4]", "[1.3, 2.1, -0.4]")
    turning = simulate(load_scene_text(top))
    np.testing.assert_allclose(result["q"][:, 3:], turning["q"], atol=2e-10)
    assert np.abs(np.linalg.norm(result["q"][:, 3:], axis=1) - 1.0).max() < 1e-14


def test_heavy_symmetric_top_precesses_steadily_at_the_rate_of_the_closed_form() -> None:
    """A root W of A W^2 cos(theta) - C w3 W + m g l = 0 (Goldstein, section 5.7): inclination and rate stay."""
    m, g, l, C = 0.5, 9.81, 0.06, 4e-4
    A = 2.5e-4 + m * l * l
    theta, spin = 0.6, 220.0
    W = (C * spin - np.sqrt((C * spin) ** 2 - 4 * A * np.cos(theta) * m * g * l)) / (2 * A * np.cos(theta))
    # inclined by a turn about x; precession about z, the rest of w3 about the top's axis, in its own axes
    v = [0.0, float(W * np.sin(theta)), spin]
    scene = load_scene_text(f"""
schema: 1
gravity: [0, 0, -{g}]
robot:
  joints: [{{name: point, type: spherical}}]
  links: [{{name: top, mass: {m}, com: [0, 0, {l}], inertia: {{xx: 2.5e-4, yy: 2.5e-4, zz: {C}}}}}]
  points: {{peg: {{link: top, at: [0, 0, 1]}}}}
initial: {{q: {{point: {{rpy: [{theta}, 0, 0]}}}}, qd: {{point: {v}}}}}
simulate: {{duration: 3, samples: 301, rtol: 1e-12, atol: 1e-13, error_estimate: false}}
""")
    peg = simulate(scene)["points/peg"]
    np.testing.assert_allclose(peg[:, 2], np.cos(theta), atol=1e-9)
    turned = np.unwrap(np.arctan2(peg[:, 1], peg[:, 0]))
    np.testing.assert_allclose(turned - turned[0], W * np.linspace(0, 3, 301), atol=1e-8)


def test_nut_on_a_screw_falls_as_the_closed_form_says() -> None:
    """I w' = -m g h - m h^2 w': the nut turns faster and faster, friction apart."""
    m, I, h, g = 0.3, 2e-4, 0.01, 9.81
    scene = load_scene_text(f"""
schema: 1
gravity: [0, 0, -{g}]
robot:
  joints: [{{name: screw, type: helical, axis: [0, 0, 1], pitch: {h}}}]
  links: [{{name: nut, mass: {m}, com: [0, 0, 0], inertia: {{zz: {I}}}}}]
  points: {{nut: {{link: nut, at: [0, 0, 0]}}}}
initial: {{q: {{screw: 0.4}}, qd: {{screw: 2}}}}
simulate: {{duration: 2, samples: 101, error_estimate: false}}
""")
    result = simulate(scene)
    t, alpha = result.time, -m * g * h / (I + m * h * h)
    np.testing.assert_allclose(result["q"][:, 0], 0.4 + 2 * t + 0.5 * alpha * t**2, rtol=1e-10)
    np.testing.assert_allclose(result["points/nut"][:, 2], h * result["q"][:, 0], atol=1e-14)


# -- every method -------------------------------------------------------------------------------------------
PENDULUM = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints: [{name: ball, type: spherical}, {name: hinge, type: revolute, origin: {xyz: [0, 0, -0.5]}, axis: [1, 0, 0]}]
  links:
    - {name: rod, mass: 1, com: [0.02, 0, -0.3], inertia: {xx: 0.03, yy: 0.04, zz: 0.02, xy: 0.002}}
    - {name: bob, mass: 0.5, com: [0, 0.03, -0.2], inertia: {xx: 0.01, yy: 0.02, zz: 0.012}}
initial: {q: {ball: {rpy: [50 deg, 10 deg, 0]}, hinge: 0.2}, qd: {ball: [0.5, 1, 2]}}
"""
TUMBLING = FREE.format(
    kind="floating",
    A=0.7,
    B=1.1,
    C=1.6,
    q="{xyz: [0, 0, 0], rpy: [0, 0, 0]}",
    v="[0.1, 0, 0.2, 0.1, 3, 0.2]",
    T=1,
)


def start_of(scene: Scene) -> tuple[System, np.ndarray]:
    problem = Problem(scene)
    body = build_system(problem)
    q = [scene.initial.q[name] for name in problem.model.q_names]
    v = [scene.initial.qd.get(name, 0.0) for name in problem.model.v_names]
    return body, body.join(np.array(q), np.array(v))


@pytest.mark.parametrize(
    ("method", "text"),
    [
        *((m, PENDULUM) for m in ("gauss", "dop853", "dopri5", "rk4", "rodas5p")),
        *((m, TUMBLING) for m in ("dop853", "dopri5", "rk4", "rodas5p")),
    ],
    ids=lambda x: x if len(x) < 10 else "pendulum" if "hinge" in x else "tumbling",
)
def test_quaternions_cost_no_order(method: str, text: str, fixed_steps: None) -> None:
    """Gauss is in rounding errors on the tumbling body with the longest steps that its iteration solves."""
    order = methods[method].order
    body, start = start_of(load_scene_text(text))
    # high orders need long runs, or steps long enough to show an error are too long to be solved
    end, steps, more = {16: (6.0, 44.0, 1.05), 8: (10.0, 30.0, 1.12)}.get(order, (2.0, 6.0, 1.2))
    reference = Integrator(body, "dop853")
    reference.reset(0.0, start, Options(1e-15, 1e-15))
    reference.advance(end)
    integrator = Integrator(body, f"fixed {method}")
    points: list[tuple[float, float]] = []
    while steps < 4000 and (not points or points[-1][1] > (2e-12 if order > 10 else 2e-11)):
        steps = np.ceil(more * steps)
        integrator.reset(0.0, start, Options(1e-13, 1e-14, step=end / steps))
        try:
            integrator.advance(end)
        except NumericalError:
            continue  # the iteration of an implicit method does not converge in such long steps
        if integrator.counters.rejected == 0:
            points.append((steps, float(np.abs(integrator.state - reference.state).max())))
    used = np.array([(n, e) for n, e in points if (2e-12 if order > 10 else 2e-11) < e < 1e-5])
    assert len(used) >= 3, points
    slope = -float(np.polyfit(np.log(used[:, 0]), np.log(used[:, 1]), 1)[0])
    assert 0.85 * order < slope < order + 3.5, [(n, f"{e:.1e}") for n, e in points]


@pytest.mark.parametrize(
    ("method", "text"),
    [
        *((m, PENDULUM) for m in sorted(taking("a ball joint"))),
        *((m, TUMBLING) for m in ("gauss", "dop853", "rodas5p")),
    ],
    ids=lambda x: x if len(x) < 20 else "pendulum" if "hinge" in x else "tumbling",
)
def test_every_sample_has_unit_quaternions_and_all_methods_agree(method: str, text: str) -> None:
    more = "step: 0.001" if not methods[method].adaptive else "rtol: 1e-8, atol: 1e-9"
    tail = f"simulate: {{duration: 1.5, samples: 151, integrator: {method}, {more}, error_estimate: false}}"
    lines = [line for line in text.splitlines() if not line.startswith("simulate")]
    found = simulate(load_scene_text("\n".join([*lines, tail])))
    problem = Problem(load_scene_text(text))
    place = problem.model.q_names.index(next(n for n in problem.model.q_names if n.endswith("qw")))
    norms = np.linalg.norm(found["q"][:, place : place + 4], axis=1)
    assert np.abs(norms - 1.0).max() < 1e-14
    body, start = start_of(load_scene_text(text))
    exact: Any = Integrator(body, "gauss")
    exact.reset(0.0, start, Options(1e-13, 1e-14))
    _, states = collect(exact, 1.5, Grid(0.0, 0.01, 151))
    q, v, _ = body.split(states)
    bound = 1e-5 if methods[method].order > 3 else 1e-4
    assert np.abs(found["q"] - q).max() < bound and np.abs(found["qd"] - v).max() < 10 * bound


# -- with everything else ---------------------------------------------------------------------------------
MIXED = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: base, type: spherical}
    - {name: h, type: revolute, axis: [1, 0, 0], origin: {xyz: [0.2, 0.1, 0]}, friction: {coulomb: 0.05, viscous: 0.01, law: set_valued}, limits: {lower: -60 deg, upper: 60 deg, stop: {restitution: 0.5}}}
  links:
    - {name: a, mass: 1.5, com: [0.1, 0.05, -0.2], inertia: {xx: 0.02, yy: 0.03, zz: 0.04, xy: 0.002}}
    - {name: b, mass: 0.5, com: [0.1, 0.05, -0.2], inertia: {xx: 0.02, yy: 0.03, zz: 0.04}}
  points: {tip: {link: b, at: [0, 0.1, 0.4]}, anchor: {link: base, at: [0.5, 0, 0.5]}}
forces: [{name: s, type: spring, between: [anchor, tip], stiffness: 20, length: 0.3}]
initial: {q: {base: {rpy: [40 deg, 0, 0]}, h: 0.1}, qd: {base: [0, 1, 2], h: 2}}
simulate: {duration: 1.2, samples: 121}
"""


def test_friction_and_stops_beside_a_ball() -> None:
    """Sticking, slipping and impacts in one joint while another carries a quaternion: energy balances all along."""
    result = simulate(load_scene_text(MIXED))
    kinds = {event["kind"] for event in result.events}
    assert {"impact", "slip"} <= kinds
    assert result.summary["energy_drift"] < 1e-10
    assert np.abs(np.linalg.norm(result["q"][:, :4], axis=1) - 1.0).max() < 1e-14
    assert result["q"][:, 4].max() < np.pi / 3 + 1e-12
