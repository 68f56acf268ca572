"""Commented scenes to begin with, one of each kind."""

from __future__ import annotations

import dataclasses

from robodyn_cli.errors import CapabilityError, unknown_name
from robodyn_cli.record import record

_ARM = """\
robot:
  convention: standard # Denavit-Hartenberg: standard or modified (Craig); never guessed
  joints: # each joint moves the link at the same place below and hangs on the one before
    - {name: shoulder, type: revolute, a: 1.0, alpha: 0, d: 0}
    - {name: elbow, type: revolute, a: 0.8, alpha: 0, d: 0}
  links: # what is not known is left out; a run that needs it says so
    - {name: upper_arm, mass: 5.0, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 5.0*1.0^2/12}}
    - {name: forearm, mass: 3.0, com: [0.4, 0, 0], com_frame: joint, inertia: {zz: 3.0*0.8^2/12}}
  points:
    tip: {link: forearm, at: end}
"""

_HEAD = """\
# {what}
#   {usage}
# Units are SI; angles are in radians unless they say degrees.
schema: 1
title: {title}
command: {command} # what `robodyn run` does with this file
gravity: {gravity}
"""


@record
class Starter:
    """One kind of scene: its title, what it shows, the command that runs it and the YAML behind the head."""

    title: str
    what: str
    command: str
    body: str
    gravity: str = "[0, -9.81, 0] # a vector of the world; [0, 0, 0] where there is none"

    def text(self, name: str) -> str:
        """Return the scene for a file of this name."""
        usage = f"robodyn {self.command} {name}"
        return _HEAD.format(usage=usage, **dataclasses.asdict(self)) + self.body


_JOINT = """\
trajectory: # the joints' motion, as formulas of the time t
  type: joint
  duration: 4
  q:
    shoulder: "0.5 + 0.6*sin(1.3*t)"
    elbow: "-0.8 + 0.5*cos(0.9*t)"
inverse: {samples: 401}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  round_trip: < 1e-9
"""

_CIRCLE = """\
trajectory: # a point runs round a circle; the joints follow by inverse kinematics
  type: circle
  point: tip
  center: [1.1, 0.6]
  radius: 0.2
  duration: 4
  ik: {branch: elbow_up} # or elbow_down
inverse: {samples: 401}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  ik_residual: < 1e-9
"""

_PATH = """\
parameters: {r: 0.2} # constants for the formulas
trajectory: # a point follows formulas of the time t; the joints follow by inverse kinematics
  type: cartesian
  point: tip
  duration: 4
  position: ["1.1 + r*cos(pi*t/2)", "0.6 + r*sin(pi*t)"]
  ik: {branch: elbow_up}
inverse: {samples: 401}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  ik_residual: < 1e-9
"""

_WAY_POINTS = """\
trajectory: # from rest to rest through way points, without jumps of the acceleration
  type: quintic
  points:
    - {t: 0, q: {shoulder: 0, elbow: 0}}
    - {t: 1.5, q: {shoulder: 40 deg, elbow: -30 deg}}
    - {t: 3, q: {shoulder: 60 deg, elbow: 20 deg}}
inverse: {samples: 301}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  round_trip: < 1e-9
"""

_STOPS = """\
trajectory: # from stop to stop, as fast as the limits allow; `trapezoid` does without a jerk
  type: s_curve
  speed: {shoulder: 90 deg, elbow: 120 deg}
  acceleration: {shoulder: 4, elbow: 6}
  jerk: {shoulder: 40, elbow: 60}
  points:
    - {q: {shoulder: 0, elbow: 0}}
    - {q: {shoulder: 60 deg, elbow: -30 deg}, dwell: 0.2}
    - {q: {shoulder: 0, elbow: 0}}
inverse: {samples: 501}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  round_trip: < 1e-9
"""

_FRAME = """\
trajectory: # a point runs along lines and arcs, under limits of its own motion
  type: path
  point: tip
  speed: 0.5
  acceleration: 2
  jerk: 40
  start: {position: [1.2, 0.2, 0]}
  segments:
    - {type: line, to: [1.2, 0.6, 0], blend: 0.05} # the corner is rounded
    - {type: line, to: [0.9, 0.6, 0], dwell: 0.3}
    - {type: arc, via: [0.95, 0.3, 0], to: [1.2, 0.2, 0]}
  ik: {branch: elbow_up}
inverse: {samples: 501}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  ik_residual: < 1e-9
"""

_TABLE = """\
trajectory: # measured or computed elsewhere; a spline runs through the rows
  type: table
  # file: motion.csv would read the same from a file with a header row
  columns: [t, shoulder, elbow]
  rows:
    - [0.0, 0.00, 0.00]
    - [0.5, 0.10, -0.05]
    - [1.0, 0.30, -0.20]
    - [1.5, 0.55, -0.40]
    - [2.0, 0.70, -0.55]
    - [2.5, 0.75, -0.60]
inverse: {samples: 251}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  round_trip: < 1e-9
"""

_SIMULATE = """\
torques: {shoulder: "-0.5*qd.shoulder"} # a number, a formula of t, positions and rates, or a table
initial: # every joint of an open chain needs a position; rates are 0 where not given
  q: {shoulder: -90 deg, elbow: 45 deg}
simulate: {duration: 5, samples: 501, rtol: 1e-10, atol: 1e-12}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  error_estimate.q_max: < 1e-7
"""

_BODY = """\
robot:
  joints: # revolute, prismatic, helical, cylindrical, universal, planar, spherical, floating or fixed
    - {name: body, type: floating} # free in space: position and unit quaternion
    - {name: ball, type: spherical, origin: {xyz: [0.2, 0, 0]}} # turns about a point of the link before
  links: # com and inertia in the link's own axes, inertia about the centre of mass
    - {name: craft, mass: 12, com: [0, 0, 0], inertia: {xx: 0.3, yy: 0.4, zz: 0.5}}
    - {name: arm, mass: 2, com: [0.15, 0, 0], inertia: {xx: 0.002, yy: 0.02, zz: 0.02}}
  points:
    tip: {link: arm, at: [0.3, 0, 0]}
torques: {ball: [0, 0, -0.05*qd.ball.wz]} # moments about the link's own axes: wx, wy, wz
initial: # an attitude as rpy, rotation_vector or quaternion; rates in the link's own axes, 0 where not given
  q: {body: {xyz: [0, 0, 1], rpy: [0, 0, 30 deg]}, ball: {quaternion: [1, 0, 0, 0]}}
  qd: {body: {vx: 0.1, wz: 0.5}, ball: [0, 1, 2]}
simulate: {duration: 5, samples: 501, rtol: 1e-10, atol: 1e-12}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  error_estimate.q_max: < 1e-7
"""

_FOUR_BAR = """\
robot:
  convention: standard
  joints: # two chains on the base; the loop below closes them
    - {name: theta1, type: revolute, parent: base, a: 1.0, alpha: 0, d: 0}
    - {name: phi2, type: revolute, parent: crank, a: 1.6, alpha: 0, d: 0}
    - {name: phi1, type: revolute, parent: base, origin: {xyz: [2.5, 0, 0]}, a: 1.6, alpha: 0, d: 0}
  links:
    - {name: crank, mass: 1.0, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 1.0*1.0^2/12}}
    - {name: coupler, mass: 1.6, com: [0.8, 0, 0], com_frame: joint, inertia: {zz: 1.6*1.6^2/12}}
    - {name: follower, mass: 1.6, com: [0.8, 0, 0], com_frame: joint, inertia: {zz: 1.6*1.6^2/12}}
loops:
  - {name: pin, type: revolute, between: [coupler.end, follower.end]}
actuated: [theta1]
"""

_DEPLOY = """\
torques: {theta1: "2.5 - 0.5*theta1"} # a preloaded torsion spring unfolds the mechanism
# theta1 is kept as it is; the loop is closed by the others, near the values given for them
initial: {q: {theta1: 20 deg, phi2: 28 deg, phi1: 108 deg}, hold: [theta1]}
simulate: {duration: 10, samples: 1001, rtol: 1e-10, atol: 1e-12}
deploy: # it locks where coupler and follower come in line: the crank has no grip there
  criterion: dead_point
  latch: {between: [coupler, follower]}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  status: locked
"""

_CLOSED = """\
torques: {theta1: "3*sin(2*t)"}
# theta1 is kept as it is; the loop is closed by the others, near the values given for them
initial: {q: {theta1: 70 deg, phi2: -51 deg, phi1: 114 deg}, hold: [theta1]}
simulate: {duration: 3, samples: 301, rtol: 1e-10, atol: 1e-12}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  constraint_residual.position: < 1e-10
"""

_LED = """\
# near these values the loop is closed at the start
initial: {q: {theta1: 70 deg, phi2: -51 deg, phi1: 114 deg}}
trajectory: # as many joints as the mechanism has degrees of freedom; the loop decides about the others
  type: joint
  duration: 4
  q: {theta1: "70 deg + 20 deg * sin(pi*t/2)"}
inverse: {samples: 401}
outputs: {reactions: true} # the load in every joint and in the pin
expect: # what `robodyn run` and `robodyn check` ask of the summary
  round_trip: < 1e-9
"""

_SWEEP = """\
# near these values the loop is closed at the start
initial: {q: {theta1: 50 deg, phi2: -20 deg, phi1: 110 deg}}
kinematics: # no forces, so masses are not needed
  sweep: {joint: theta1, start: 50 deg, stop: 90 deg, rate: 0.5}
  transmission: [coupler.origin, coupler.end, follower.origin] # the angle at the pin
expect: # what `robodyn run` and `robodyn check` ask of the summary
  mobility.actual: 1
  error_estimate.closure.acceleration: < 1e-9
"""

_REST = """\
torques: {theta1: "60*(75 deg - theta1)"} # a torsion spring on the crank holds the weight
# from here downhill to the balance; add hold: [theta1] to find what holds the crank in place
initial: {q: {theta1: 70 deg, phi2: -51 deg, phi1: 114 deg}}
statics: {find: balance} # or hold: the torques of actuated joints that hold the initial configuration
outputs: {reactions: true} # the load in every joint and in the pin
expect: # what `robodyn run` and `robodyn check` ask of the summary
  equilibrium.stability: stable
"""

_BRANCHES = """\
# with theta1 held where it is, in how many ways do the others close the loop?
initial: {q: {theta1: 70 deg, phi2: -51 deg, phi1: 114 deg}, hold: [theta1]}
assemble: {branches: true}
expect: # what `robodyn run` and `robodyn check` ask of the summary
  branch_search.found: 2
  residual.position: < 1e-10
"""

STARTERS = {
    "inverse": Starter(
        "Arm tracing a circle", "Torques that a motion of the tip needs.", "inverse", _ARM + _CIRCLE
    ),
    "joint": Starter("Arm on sines", "Torques that a motion of the joints needs.", "inverse", _ARM + _JOINT),
    "waypoints": Starter(
        "Arm through way points", "Torques on the way through points.", "inverse", _ARM + _WAY_POINTS
    ),
    "stops": Starter("Arm from stop to stop", "Torques of a motion under limits.", "inverse", _ARM + _STOPS),
    "lines": Starter(
        "Arm along lines and arcs", "Torques along a path under limits.", "inverse", _ARM + _FRAME
    ),
    "table": Starter("Arm after a table", "Torques that a sampled motion needs.", "inverse", _ARM + _TABLE),
    "path": Starter("Arm along a path", "Torques along a path of the tip.", "inverse", _ARM + _PATH),
    "simulate": Starter(
        "Arm swinging", "Motion that torques and gravity give.", "simulate", _ARM + _SIMULATE
    ),
    "body": Starter(
        "Body in space", "A free body with an arm on a ball joint.", "simulate", _BODY, "[0, 0, 0]"
    ),
    "loop": Starter("Four-bar mechanism", "Motion of a closed mechanism.", "simulate", _FOUR_BAR + _CLOSED),
    "mechanism": Starter("Four-bar driven", "Torques that drive a mechanism.", "inverse", _FOUR_BAR + _LED),
    "kinematics": Starter(
        "Four-bar in motion", "Motion of a mechanism without forces.", "kinematics", _FOUR_BAR + _SWEEP
    ),
    "statics": Starter("Four-bar at rest", "Where a mechanism balances.", "statics", _FOUR_BAR + _REST),
    "assemble": Starter(
        "Four-bar put together", "The ways in which a loop closes.", "assemble", _FOUR_BAR + _BRANCHES
    ),
    "deploy": Starter(
        "Four-bar deploying",
        "A mechanism unfolds until it locks.",
        "deploy",
        _FOUR_BAR + _DEPLOY,
        "[0, 0, 0]",
    ),
}


def find_starter(kind: str) -> Starter:
    """Return the starter of a kind.

    Raises
    ------
    CapabilityError : there is no such kind.
    """
    if kind not in STARTERS:
        raise CapabilityError(unknown_name("kind", kind, STARTERS))
    return STARTERS[kind]
