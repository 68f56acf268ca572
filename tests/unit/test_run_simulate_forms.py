"""Forward dynamics of one mechanism in several descriptions, and of trees against absolute coordinates."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.results.result import Result
from tests.mechanisms import (
    close,
    run,
)
from tests.planar_bodies import GROUND, Motor, Pin, PlanarBodies, turned

THETA = (-1.62889639534037, 0.47749300648073)  # the double pendulum after 10 s


# -- one mechanism, two ways of writing it ----------------------------------------------------------------
STANDARD = """
gravity: [0.5, -3, -9.81]
robot:
  convention: standard
  joints:
    - {name: a, type: revolute, a: 0.3, alpha: 1.1, d: 0.2}
    - {name: b, type: revolute, a: 0.5, alpha: -0.4, d: -0.1, offset: 0.3}
    - {name: c, type: prismatic, a: 0.1, alpha: 0.7, theta: 0.2, offset: 0.25}
    - {name: d, type: revolute, a: 0.2, alpha: 0, d: 0.15}
  links:
    - {name: l1, mass: 2, com: [0.1, 0.02, 0.03], com_frame: joint, inertia: {xx: 0.02, yy: 0.03, zz: 0.04, xy: 0.001}}
    - {name: l2, mass: 1.5, com: [0.2, 0.01, 0], com_frame: joint, inertia: {xx: 0.01, yy: 0.04, zz: 0.04, yz: 0.002}}
    - {name: l3, mass: 1, com: [0.1, 0, 0.1], com_frame: joint, inertia: {xx: 0.01, yy: 0.02, zz: 0.02}}
    - {name: l4, mass: 0.7, com: [0.05, 0.05, 0.05], com_frame: joint, inertia: {xx: 0.01, yy: 0.01, zz: 0.01}}
  points: {tip: {link: l4, at: end}}
torques: {a: "2*sin(t)", c: 12}
initial: {q: {a: 0.1, b: -0.2, c: 0.05, d: 1.0}, qd: {a: 0.3, d: -1}}
simulate: {duration: 1, samples: 21}
"""
# the same in Craig's convention: a and alpha belong to the axis before, d to the joint itself, so that what a
# link has is counted from a frame that is d (or, sliding, the offset) further along its axis
MODIFIED = """
gravity: [0.5, -3, -9.81]
robot:
  convention: modified
  joints:
    - {name: a, type: revolute, a: 0, alpha: 0, d: 0.2}
    - {name: b, type: revolute, a: 0.3, alpha: 1.1, d: -0.1, offset: 0.3}
    - {name: c, type: prismatic, a: 0.5, alpha: -0.4, theta: 0.2, offset: 0.25}
    - {name: d, type: revolute, a: 0.1, alpha: 0.7, d: 0.15}
  links:
    - {name: l1, mass: 2, com: [0.1, 0.02, -0.17], com_frame: link, inertia: {xx: 0.02, yy: 0.03, zz: 0.04, xy: 0.001}}
    - {name: l2, mass: 1.5, com: [0.2, 0.01, 0.1], com_frame: link, inertia: {xx: 0.01, yy: 0.04, zz: 0.04, yz: 0.002}}
    - {name: l3, mass: 1, com: [0.1, 0, 0.1], com_frame: link, inertia: {xx: 0.01, yy: 0.02, zz: 0.02}}
    - {name: l4, mass: 0.7, com: [0.05, 0.05, -0.1], com_frame: link, inertia: {xx: 0.01, yy: 0.01, zz: 0.01}}
  points: {tip: {link: l4, at: [0.2, 0, 0]}}
torques: {a: "2*sin(t)", c: 12}
initial: {q: {a: 0.1, b: -0.2, c: 0.05, d: 1.0}, qd: {a: 0.3, d: -1}}
simulate: {duration: 1, samples: 21}
"""


@pytest.fixture(scope="module")
def arm() -> Result:
    return run(STANDARD)


def same_motion(first: Result, second: Result, tolerance: float = 1e-9) -> None:
    for path in ("q", "qd", "qdd", "tau", "points/tip", "energy/kinetic"):
        close(first[path], second[path], tolerance)


def test_both_conventions_give_one_motion(arm: Result) -> None:
    same_motion(arm, run(MODIFIED))
    assert arm.summary["energy_drift"] < 1e-8


def test_a_tilted_base_is_turned_gravity(arm: Result) -> None:
    rpy = np.array([0.4, -0.7, 1.3])
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    R = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ [[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]
    R = R @ [[1, 0, 0], [0, cr, -sr], [0, sr, cr]]
    gravity = (R @ [0.5, -3, -9.81]).tolist()
    tilted = run(STANDARD, f"gravity={gravity}", f"robot.base={{rpy: {rpy.tolist()}, xyz: [1, 2, 3]}}")
    for path in ("q", "qd", "tau"):
        close(arm[path], tilted[path], 1e-9)
    close(tilted["points/tip"], arm["points/tip"] @ R.T + [1, 2, 3], 1e-9)


def test_origin_and_axis_say_the_same_as_dh() -> None:
    dh = run(
        """
gravity: [0, 0, -9.81]
robot:
  convention: standard
  joints:
    - {name: a, type: revolute, a: 0.4, alpha: 90 deg, d: 0}
    - {name: b, type: revolute, a: 0.3, alpha: 0, d: 0}
  links:
    - {name: l1, mass: 1, com: [0.2, 0, 0.1], com_frame: joint, inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
    - {name: l2, mass: 1, com: [0.1, 0, 0], com_frame: joint, inertia: {xx: 0.1, yy: 0.2, zz: 0.2}}
  points: {tip: {link: l2, at: end}}
initial: {q: {a: 0, b: 0.3}, qd: {a: 1}}
simulate: {duration: 1, samples: 11}
"""
    )
    placed = run(
        """
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 2]}
    - {name: b, type: revolute, axis: [0, -1, 0], origin: {xyz: [0.4, 0, 0]}}
  links:
    - {name: l1, mass: 1, com: [0.2, 0, 0.1], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
    - {name: l2, mass: 1, com: [0.1, 0, 0], inertia: {xx: 0.1, yy: 0.2, zz: 0.2}}
  points: {tip: {link: l2, at: [0.3, 0, 0]}}
initial: {q: {a: 0, b: 0.3}, qd: {a: 1}}
simulate: {duration: 1, samples: 11}
"""
    )
    same_motion(dh, placed)


WELDED = """
gravity: [0, -9.81, 0]
robot:
  joints:
    - {{name: j1, type: revolute, axis: [0, 0, 1]}}
    {weld}
    - {{name: j2, type: revolute, axis: [0, 0, 1], parent: {carrier}, link: l2, origin: {{xyz: {place}}}}}
  links:
    {links}
    - {{name: l2, mass: 1, com: [0.5, 0, 0], inertia: {{zz: 0.1}}}}
  points: {{tip: {{link: l2, at: [1, 0, 0]}}}}
initial: {{q: {{j1: 0.3, j2: -1}}}}
simulate: {{duration: 2, samples: 21}}
"""


def test_fixed_joints_weld() -> None:
    parts = run(
        WELDED.format(
            weld="- {name: w, type: fixed, parent: l1, link: arm, origin: {xyz: [0.7, 0.1, 0], rpy: [0, 0, 90 deg]}}",
            carrier="arm",
            place="[0.2, 0, 0]",
            links="- {name: l1, mass: 2, com: [0.3, 0, 0], inertia: {zz: 0.2}}\n"
            "    - {name: arm, mass: 3, com: [0.1, 0.2, 0], inertia: {zz: 0.3}}",
        )
    )
    # the second part in the frame of the first: turned by 90 deg about (0.7, 0.1)
    com = np.array([0.7, 0.1]) + [-0.2, 0.1]
    centre = (2 * np.array([0.3, 0]) + 3 * com) / 5
    inertia = 0.5 + 2 * np.sum((centre - [0.3, 0]) ** 2) + 3 * np.sum((centre - com) ** 2)
    whole = run(
        WELDED.format(
            weld="",
            carrier="l1",
            place="[0.7, 0.3, 0]",
            links=f"- {{name: l1, mass: 5, com: [{centre[0]}, {centre[1]}, 0], inertia: {{zz: {inertia}}}}}",
        )
    )
    # the second joint's zero is turned along with its carrier
    close(parts["qd"][0], whole["qd"][0], 0.0)
    whole = run(
        WELDED.format(
            weld="",
            carrier="l1",
            place="[0.7, 0.3, 0], rpy: [0, 0, 90 deg]",
            links=f"- {{name: l1, mass: 5, com: [{centre[0]}, {centre[1]}, 0], inertia: {{zz: {inertia}}}}}",
        )
    )
    same_motion(parts, whole)
    assert parts["q"].shape[1] == 2


def test_order_of_the_joints_is_that_of_the_columns() -> None:
    text = """
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: second, type: revolute, axis: [0, 0, 1], parent: upper, link: lower, origin: {xyz: [1, 0, 0]}}
    - {name: first, type: revolute, axis: [0, 0, 1], parent: base, link: upper}
  links:
    - {name: upper, mass: 12.456, com: [0.773, 0, 0], inertia: {zz: 1.042}}
    - {name: lower, mass: 12.456, com: [0.583, 0, 0], inertia: {zz: 1.042}}
initial: {q: {first: -90 deg, second: 45 deg}}
simulate: {duration: 10, samples: 3}
"""
    result = run(text)
    assert result.variables["q"].names == ("second", "first")
    close(result["q"][-1], THETA[::-1], 1e-8)


# -- trees, against absolute coordinates ------------------------------------------------------------------
TREE = """
gravity: [1, -9.81, 0]
robot:
  joints:
    - {name: trunk, type: revolute, axis: [0, 0, 1]}
    - {name: left, type: revolute, axis: [0, 0, 1], parent: body, link: la, origin: {xyz: [0.5, 0.2, 0]}}
    - {name: right, type: revolute, axis: [0, 0, 1], parent: body, link: ra, origin: {xyz: [0.5, -0.2, 0]}}
    - {name: hand, type: revolute, axis: [0, 0, 1], parent: la, link: lh, origin: {xyz: [0.4, 0, 0]}}
  links:
    - {name: body, mass: 4, com: [0.25, 0, 0], inertia: {zz: 0.3}}
    - {name: la, mass: 1, com: [0.2, 0, 0], inertia: {zz: 0.02}}
    - {name: ra, mass: 1.5, com: [0.25, 0.05, 0], inertia: {zz: 0.03}}
    - {name: lh, mass: 0.5, com: [0.1, 0, 0], inertia: {zz: 0.005}}
torques: {left: "2*sin(3*t)", hand: "-0.3*qd.hand", trunk: 4}
initial: {q: {trunk: -1.2, left: 0.5, right: -0.4, hand: 0.2}, qd: {right: 2}}
simulate: {duration: 1.5, samples: 16}
"""


def test_a_tree_with_branches() -> None:
    result = run(TREE)
    bodies = PlanarBodies(
        masses=[4, 1, 1.5, 0.5],
        inertias=[0.3, 0.02, 0.03, 0.005],
        pins=[
            Pin(GROUND, (0, 0), 0, (-0.25, 0)),
            Pin(0, (0.25, 0.2), 1, (-0.2, 0)),
            Pin(0, (0.25, -0.2), 2, (-0.25, -0.05)),
            Pin(1, (0.2, 0), 3, (-0.1, 0)),
        ],
        motors=[
            Motor(GROUND, 0, lambda t, a, w: 4.0),
            Motor(0, 1, lambda t, a, w: 2 * np.sin(3 * t)),
            Motor(1, 3, lambda t, a, w: -0.3 * w),
        ],
        gravity=(1, -9.81),
    )
    angles = np.array([-1.2, -0.7, -1.6, -0.5])
    rates = np.array([0, 0, 2.0, 0])
    trunk = turned(angles[0], (0.25, 0))
    shoulder = {1: turned(angles[0], (0.5, 0.2)), 2: turned(angles[0], (0.5, -0.2))}
    places = [trunk, shoulder[1] + turned(angles[1], (0.2, 0)), shoulder[2] + turned(angles[2], (0.25, 0.05))]
    places.append(shoulder[1] + turned(angles[1], (0.4, 0)) + turned(angles[3], (0.1, 0)))
    arm = turned(angles[2], (0.25, 0.05))
    v = np.zeros(12)
    v[6:9] = [-2 * arm[1], 2 * arm[0], 2.0]
    x = np.concatenate([[*p, a] for p, a in zip(places, angles)])
    eta, psi, _ = bodies.constraints(x, v)
    assert np.abs(eta).max() < 1e-12 and np.abs(psi @ v).max() < 1e-12
    moved, _ = bodies.run(x, v, result.time)
    absolute = moved[:, 2::3]
    relative = np.column_stack(
        [
            absolute[:, 0],
            absolute[:, 1] - absolute[:, 0],
            absolute[:, 2] - absolute[:, 0],
            absolute[:, 3] - absolute[:, 1],
        ]
    )
    assert rates[2] == result["qd"][0, 2]
    close(result["q"], relative, 1e-8)
    assert result.summary["energy_drift"] < 1e-8
