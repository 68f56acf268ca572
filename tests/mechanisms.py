"""What tests of simulations share: scenes as text, runs, errors, and mechanisms that appear more than once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene, load_scene_text, simulate
from robodyn_cli.errors import RobodynError
from robodyn_cli.results.result import Result

CONFIGS = Path(__file__).parents[1] / "configs"


def pendulum(*overrides: str) -> Result:
    """Simulate the lecture's double pendulum."""
    return simulate(load_scene(CONFIGS / "double_pendulum.yaml", overrides))


def run(text: str, *overrides: str) -> Result:
    """Simulate a scene given as text, without its first line."""
    return simulate(load_scene_text("schema: 1\n" + text, overrides=overrides))


def failure(text: str, *overrides: str) -> RobodynError:
    """Return the error that a scene ends with."""
    with pytest.raises(RobodynError) as caught:
        run(text, *overrides)
    return caught.value


def close(got: Any, expected: Any, tolerance: float) -> None:
    """Fail unless the largest difference is below the tolerance."""
    assert np.abs(np.asarray(got) - np.asarray(expected)).max() <= tolerance


# a slider-crank
SLIDER = """
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: crank, type: revolute, a: 0.3, alpha: 0, d: 0}
    - {name: rod, type: revolute, a: 0.9, alpha: 0, d: 0}
    - {name: slide, type: prismatic, parent: base, link: piston, a: 0, alpha: 0, theta: 0, origin: {rpy: [0, 90 deg, 0]}}
  links:
    - {name: disc, mass: 3, com: [0.1, 0, 0], com_frame: joint, inertia: {zz: 0.2}}
    - {name: bar, mass: 1, com: [0.45, 0, 0], com_frame: joint, inertia: {zz: 0.07}}
    - {name: piston, mass: 2, com: [0, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
loops: [{name: pin, type: revolute, between: [bar.end, piston.origin], axis: [0, 0, 1], axis2: [-1, 0, 0]}]
torques: {crank: 5}
initial: {q: {crank: 0.2, rod: -0.3, slide: 1.1}, hold: [crank]}
simulate: {duration: 3, samples: 31}
"""

# Watt's six-bar: two four-bars that share the rocker; the second loop also closes between two branches
SIX_BAR = """
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: crank, type: revolute, parent: base, a: 0.4, alpha: 0, d: 0}
    - {name: c1, type: revolute, parent: link1, a: 1.2, alpha: 0, d: 0}
    - {name: rocker, type: revolute, parent: base, a: 0.9, alpha: 0, d: 0, origin: {xyz: [1.0, 0, 0]}}
    - {name: c2, type: revolute, parent: link3, a: 1.1, alpha: 0, d: 0}
    - {name: out, type: revolute, parent: base, a: 0.8, alpha: 0, d: 0, origin: {xyz: [2.1, 0, 0]}}
  links:
    - {name: link1, mass: 2, com: [0.2, 0, 0], com_frame: joint, inertia: {zz: 0.05}}
    - {name: link2, mass: 1, com: [0.6, 0, 0], com_frame: joint, inertia: {zz: 0.12}}
    - {name: link3, mass: 1.5, com: [0.45, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
    - {name: link4, mass: 1, com: [0.55, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
    - {name: link5, mass: 1, com: [0.4, 0, 0], com_frame: joint, inertia: {zz: 0.06}}
loops:
  - {name: first, type: revolute, between: [link2.end, link3.end]}
  - {name: second, type: revolute, between: [link4.end, link5.end]}
torques: {crank: "14 - 0.5*qd.crank"}
initial: {q: {crank: 1.0, c1: -0.6, rocker: 1.4, c2: -1.4, out: 1.4}, hold: [crank]}
simulate: {duration: 2, samples: 21}
"""

# a spatial loop with one degree of freedom against every count: three of its five rows are redundant
TWIST, SKEW = 0.5, 1.1
LONG = np.sin(SKEW) / np.sin(TWIST)
BENNETT = f"""
gravity: [0, 0, -9.81]
robot:
  convention: standard
  joints:
    - {{name: j1, type: revolute, a: 1, alpha: {TWIST}, d: 0}}
    - {{name: j2, type: revolute, a: {LONG}, alpha: {SKEW}, d: 0}}
    - {{name: j3, type: revolute, a: 1, alpha: {TWIST}, d: 0}}
  links:
    - {{name: l1, mass: 1, com: [0.5, 0, 0.1], com_frame: joint, inertia: {{xx: 0.01, yy: 0.1, zz: 0.1}}}}
    - {{name: l2, mass: 1, com: [0.5, 0, 0.1], com_frame: joint, inertia: {{xx: 0.01, yy: 0.1, zz: 0.1}}}}
    - {{name: l3, mass: 1, com: [0.5, 0, 0.1], com_frame: joint, inertia: {{xx: 0.01, yy: 0.1, zz: 0.1}}}}
  points: {{anchor: {{link: base, at: [{-LONG}, 0, 0]}}}}
loops:
  - name: ring
    type: revolute
    between: [l3.end, base.anchor]
    axis2: [0, {np.sin(SKEW)}, {np.cos(SKEW)}]
initial: {{q: {{j1: 1.0}}, hold: [j1]}}
simulate: {{duration: 5, samples: 101}}
"""
