"""Gears, racks and other relations between joint coordinates, and ground points that move by formulas."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli import load_scene_text
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.rebuild import evaluate
from tests.mechanisms import close, failure, run

WHEELS = """
gravity: [0, 0, 0]
robot:
  joints:
    - {name: pinion, type: revolute, parent: base, axis: [0, 0, 1]}
    - {name: wheel, type: revolute, parent: base, axis: [0, 0, 1], origin: {xyz: [0.3, 0, 0]}}
  links:
    - {name: small, mass: 1, com: [0, 0, 0], com_frame: joint, inertia: {zz: 0.02}}
    - {name: large, mass: 4, com: [0, 0, 0], com_frame: joint, inertia: {zz: 0.3}}
couplers: [{name: mesh, terms: {pinion: 20, wheel: 40}, value: 4}]
torques: {pinion: 0.5}
initial: {q: {pinion: 0, wheel: 0.1}, qd: {pinion: 3}, hold: [pinion]}
simulate: {duration: 2, samples: 21}
"""


def test_a_pair_of_gears() -> None:
    found = run(WHEELS)
    t = found["time"]
    a = 0.5 / (0.02 + 0.3 / 4)
    close(found["q"][:, 0], 3 * t + a * t**2 / 2, 1e-10)
    close(20 * found["q"][:, 0] + 40 * found["q"][:, 1], 4.0, 1e-12)
    # 40 lambda drives the wheel
    close(found["constraints/multipliers"][:, 0], 0.3 * (-a / 2) / 40, 1e-12)
    assert found.variables["constraints/multipliers"].names == ("mesh.coupling",)
    assert found.summary["energy_drift"] < 1e-10


def test_a_planetary_gear() -> None:
    """Sun, carrier with a planet, fixed ring: Willis's equation, and the inertia that the sun feels."""
    found = run("""
gravity: [0, 0, 0]
parameters: {zs: 12, zp: 18, zr: 48}
robot:
  joints:
    - {name: sun, type: revolute, parent: base, axis: [0, 0, 1]}
    - {name: carrier, type: revolute, parent: base, axis: [0, 0, 1]}
    - {name: planet, type: revolute, parent: arm, axis: [0, 0, 1], origin: {xyz: [0.15, 0, 0]}}
  links:
    - {name: s, mass: 1, com: [0, 0, 0], com_frame: joint, inertia: {zz: 0.01}}
    - {name: arm, mass: 1, com: [0, 0, 0], com_frame: joint, inertia: {zz: 0.05}}
    - {name: p, mass: 2, com: [0, 0, 0], com_frame: joint, inertia: {zz: 0.02}}
couplers:
  - {name: inner, terms: {sun: 12, carrier: -12, planet: 18}}
  - {name: ring, terms: {planet: 18, carrier: 48}}
torques: {sun: 1}
initial: {q: {sun: 0, carrier: 0, planet: 0}, hold: [sun]}
simulate: {duration: 1, samples: 11}
""")
    ratio = 12 / (12 + 48)  # carrier over sun, ring fixed
    turn = -48 / 18 * ratio  # planet relative to the carrier
    inertia = 0.01 + (0.05 + 2 * 0.15**2) * ratio**2 + 0.02 * (ratio + turn) ** 2
    close(found["q"][-1], [0.5 / inertia, 0.5 / inertia * ratio, 0.5 / inertia * turn], 1e-10)


def test_a_rack_that_is_pulled_by_a_formula() -> None:
    """Rack, pinion, and a relation that moves by itself: its force from the rack's and the pinion's inertia."""
    found = run("""
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: pinion, type: revolute, parent: base, axis: [0, 0, 1]}
    - {name: rack, type: prismatic, parent: base, axis: [0, 1, 0]}
  links:
    - {name: p, mass: 1, com: [0, 0, 0], com_frame: joint, inertia: {zz: 0.02}}
    - {name: r, mass: 3, com: [0, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
couplers: [{name: teeth, terms: {pinion: 0.1, rack: -1}, value: "0.05*sin(4*t)"}]
initial: {q: {pinion: 0, rack: 0}, hold: [pinion]}
simulate: {duration: 2, samples: 21}
""")
    t = found["time"]
    # 0.02 p'' = 0.1 lam, 3 r'' = -29.43 - lam, 0.1 p'' - r'' = s''
    second = -0.05 * 16 * np.sin(4 * t)
    lam = (second - 9.81) / (0.1**2 / 0.02 + 1 / 3)
    close(found["constraints/multipliers"][:, 0], lam, 1e-9)
    close(found["qdd"][:, 0], 5 * lam, 1e-9)
    close(0.1 * found["q"][:, 0] - found["q"][:, 1], 0.05 * np.sin(4 * t), 1e-13)
    assert found.summary["energy_drift"] < 1e-9


SHAKEN = """
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: x, type: prismatic, parent: base, axis: [1, 0, 0]}
    - {name: y, type: prismatic, axis: [0, 1, 0]}
    - {name: turn, type: revolute, axis: [0, 0, 1]}
  links:
    - {name: a, mass: 0, com: [0, 0, 0], com_frame: joint}
    - {name: b, mass: 0, com: [0, 0, 0], com_frame: joint}
    - {name: bob, mass: 2, com: [0.4, 0.1, 0], com_frame: joint, inertia: {zz: 0.05}}
"""
MOTION = '["0.05*sin(7*t)", "0.02 + 0.1*cos(11*t) - 0.1", 0]'


def test_a_pendulum_on_a_shaken_pivot() -> None:
    """A ground point that moves by formulas, against the same motion of prescribed joints."""
    ground = run(
        SHAKEN + f"  points: {{pivot: {{link: base, at: [0.5, 0, 0], motion: {MOTION}}}}}\n"
        "loops: [{name: pin, type: revolute, between: [bob.origin, pivot]}]\n"
        "initial: {q: {x: 0.5, y: 0, turn: 0.3}, hold: [turn]}\nsimulate: {duration: 3, samples: 31}\n"
    )
    joints = run(
        SHAKEN + "prescribed: {x: 0.5 + 0.05*sin(7*t), y: 0.02 + 0.1*cos(11*t) - 0.1}\n"
        "initial: {q: {turn: 0.3}}\nsimulate: {duration: 3, samples: 31}\n"
    )
    close(ground["q"], joints["q"], 1e-9)
    close(ground["qdd"], joints["qdd"], 1e-7)
    close(ground["constraints/multipliers"], joints["tau"][:, :2], 1e-7)
    close(ground["energy/work"], joints["energy/work"], 1e-8)
    assert ground.summary["energy_drift"] < 1e-8 and np.ptp(ground["energy/work"]) > 0.1
    assert ground.summary["constraint_residual"]["position"] < 1e-14


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(
    "closure",
    [
        "type: revolute", "type: prismatic", "type: cylindrical, axis: [0.3, 1, 0.2]", "type: spherical", "type: fixed",
        "type: universal, axis: [1, 0, 0], axis2: [0, 1, 0.3]", "type: planar, axis: [1, 2, 0.5]",
        "type: point_on_line, axis: [1, 2, 0.5]", "type: point_on_plane, axis: [1, 2, 0.5]",
        "type: distance, length: 0.9",
    ],
)  # fmt: skip
def test_rows_of_a_moving_ground_point_by_the_graph(closure: str, turned: bool) -> None:
    """d eta/dt = Psi v + eta_t and its derivative for v-dot = 0 is gamma, time's own part included."""
    between = "[pivot, c.origin]" if turned else "[c.origin, pivot]"
    problem = Problem(
        load_scene_text(f"""
schema: 1
gravity: [1, -9, 3]
robot:
  base: {{xyz: [0.1, 0.2, 0.3], rpy: [0.3, -0.2, 0.5]}}
  joints:
    - {{name: j1, type: revolute, parent: base, axis: [1, 0.3, 0.2], origin: {{xyz: [0.1, 0.3, 0.2]}}}}
    - {{name: j2, type: prismatic, axis: [0.2, 0.3, 1], origin: {{xyz: [0.5, 0.1, 0.2], rpy: [0.1, 0.5, 0.2]}}}}
    - {{name: j3, type: revolute, axis: [0, 0.3, 1], origin: {{xyz: [0.1, 0.4, 0.2], rpy: [0.7, 0.5, 0.2]}}}}
  links: [{{name: a, mass: 1}}, {{name: b, mass: 1}}, {{name: c, mass: 1}}]
  points: {{pivot: {{link: base, at: [0.3, 0.2, 0.1], motion: ["t^2", "sin(3*t)", "0.3*t - t^3"]}}}}
loops: [{{name: loop, {closure}, between: {between}}}]
""")
    )
    values = {"t": [0.7], "q": [0.3, -0.2, 0.9], "v": [0.8, -1.1, 0.4], "p": []}
    assert problem.constraints.rows
    for row in problem.constraints.rows:
        exact = directional([row.eta], [*problem.q, problem.t], [*problem.v, 1.0])[0]
        rate = sum((x * v for x, v in zip(row.psi, problem.v)), row.eta_t)
        gamma = directional([exact], [*problem.q, problem.t], [*problem.v, 1.0])[0]
        found = evaluate([exact, rate, gamma, row.gamma], values)
        close(found[0], found[1], 1e-12)
        close(found[2], found[3], 1e-11)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("wheel: 40", "whel: 40", "did you mean 'wheel'"),
        ("pinion: 20, wheel: 40", "pinion: 20", "relates two joints"),
        ("wheel: 40", "wheel: 0", "must not be zero"),
        ("terms:", "term:", "terms"),
        ("value: 4", "value: q.pinion", "q.pinion"),
    ],
)
def test_couplers_that_make_no_sense(old: str, new: str, words: str) -> None:
    with pytest.raises(SceneError, match=words.replace(".", r"\.")) as caught:
        load_scene_text("schema: 1\n" + WHEELS.replace(old, new))
    assert caught.value.details["key"].startswith("couplers.0")


def test_points_that_cannot_move() -> None:
    text = "schema: 1\n" + SHAKEN + "  points: {p: {link: bob, motion: [t, 0, 0]}}\n"
    with pytest.raises(SceneError, match="only points on 'base' move"):
        load_scene_text(text)
    text = SHAKEN + (
        '  points: {pivot: {link: base, motion: ["if(t < 1, 0, 1)", 0, 0]}}\n'
        "loops: [{name: pin, type: revolute, between: [bob.origin, pivot]}]\ninitial: {q: {turn: 0.3}}\n"
    )
    error = failure(text)
    assert error.exit_code == 2 and "jumps at t = 1" in error.message and "pin" in error.message
