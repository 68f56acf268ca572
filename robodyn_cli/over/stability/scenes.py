"""Scenes of the stability suite, written as YAML: stiff, badly scaled and singular mechanisms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

GRAVITY = "[0, -9.81, 0]"
HANGING = "{q: {theta1: -90 deg, theta2: 45 deg}}"
FALLING = "{q: {theta1: 0, theta2: 45 deg}}"  # sinks slowly against its damper while the spring is fast
# the second link falls onto a stop at 1 rad, bounces and rests
RAISED = "{q: {theta1: 80 deg, theta2: 45 deg}}"
LECTURE_ARM = """\
robot:
  convention: standard
  joints:
    - {name: theta1, type: revolute, a: 1.0, alpha: 0, d: 0%s}
    - {name: theta2, type: revolute, a: 1.0, alpha: 0, d: 0%s}
  links:
    - {name: link1, mass: %.17g, com: [0.773, 0, 0], com_frame: joint, inertia: {zz: %.17g}}
    - {name: link2, mass: %.17g, com: [0.583, 0, 0], com_frame: joint, inertia: {zz: %.17g}}
"""
FOUR_BAR = """\
robot:
  convention: standard
  joints:
    - {name: theta1, type: revolute, parent: base, a: 1.241, alpha: 0, d: 0}
    - {name: phi2, type: revolute, parent: crank, a: 1.2, alpha: 0, d: 0}
    - {name: phi1, type: revolute, parent: base, origin: {xyz: [1.241, 0, 0]}, a: 1.2, alpha: 0, d: 0}
  links:
    - {name: crank, mass: 20.15, com: [1.2, 0, 0], com_frame: joint, inertia: {zz: 9.6}}
    - {name: coupler, mass: 8.25, com: [0.6, 0, 0], com_frame: joint, inertia: {zz: 0.06}}
    - {name: follower, mass: 8.25, com: [0.6, 0, 0], com_frame: joint, inertia: {zz: 0.06}}
loops:
  - {name: pin, type: revolute, between: [coupler.end, follower.end]}
actuated: [theta1]
"""
PARALLELOGRAM = """\
robot:
  convention: standard
  joints:
    - {name: theta1, type: revolute, parent: base, a: 1.0, alpha: 0, d: 0}
    - {name: phi2, type: revolute, parent: crank, a: 2.0, alpha: 0, d: 0}
    - {name: phi1, type: revolute, parent: base, origin: {xyz: [2.0, 0, 0]}, a: 1.0, alpha: 0, d: 0}
  links:
    - {name: crank, mass: 1.0, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 1/12}}
    - {name: coupler, mass: 2.0, com: [1.0, 0, 0], com_frame: joint, inertia: {zz: 8/12}}
    - {name: follower, mass: 1.0, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 1/12}}
loops:
  - {name: pin, type: revolute, between: [coupler.end, follower.end]}
actuated: [theta1]
"""


def scene(
    title: str, body: str, initial: str, duration: float, gravity: str = GRAVITY, torques: str = ""
) -> str:
    """Return a scene of a robot (and loops) with its start, torques and duration, at the default tolerances."""
    drive = f"torques: {torques}\n" if torques else ""
    return (
        f"schema: 1\ntitle: {title}\ncommand: simulate\ngravity: {gravity}\n{body}{drive}"
        f"initial: {initial}\nsimulate: {{duration: {duration:.17g}, samples: 1001}}\n"
    )


def arm(
    title: str,
    duration: float,
    first: str = "",
    second: str = "",
    ratio: float = 1.0,
    **setting: str,
) -> str:
    """Return the lecture's two-link arm with keys added to its joints; mass and inertia of link 2 times ``ratio``.

    setting : ``start``, ``gravity`` and ``torques`` where they are not the usual ones.
    """
    start = setting.pop("start", HANGING)
    body = LECTURE_ARM % (first, second, 12.456, 1.042, 12.456 * ratio, 1.042 * ratio)
    return scene(title, body, start, duration, **setting)


def stiff_arm(
    title: str,
    duration: float,
    stiffness: float = 1e6,
    rest: str = "40 deg",
    ratio: float = 1.0,
    start: str = FALLING,
) -> str:
    """Return the lecture's arm with dampers of 1e4 N m s/rad in its joints and a spring [N m/rad] in the second."""
    damper = ", damper: {damping: 1e4}"
    spring = f", spring: {{stiffness: {stiffness:.17g}, rest: {rest}}}"
    return arm(title, duration, damper, spring + damper, ratio, start=start)


def chain(
    title: str,
    duration: float,
    masses: Sequence[float],
    lengths: Sequence[float],
    start: Mapping[str, float],
    rates: Mapping[str, float] | None = None,
) -> str:
    """Return a hanging chain of uniform rods in the plane; joints q1, q2, ... start at 0 unless said."""
    joints = [
        f"    - {{name: q{k + 1}, type: revolute, a: {length:.17g}, alpha: 0, d: 0}}"
        for k, length in enumerate(lengths)
    ]
    links = [
        f"    - {{name: link{k + 1}, mass: {m:.17g}, com: [{length / 2:.17g}, 0, 0], com_frame: joint, "
        f"inertia: {{zz: {m * length**2 / 12:.17g}}}}}"
        for k, (m, length) in enumerate(zip(masses, lengths))
    ]
    body = (
        "robot:\n  convention: standard\n  joints:\n"
        + "\n".join(joints)
        + "\n  links:\n"
        + "\n".join(links)
        + "\n"
    )
    q = ", ".join(f"q{k + 1}: {start.get(f'q{k + 1}', 0.0):.17g}" for k in range(len(masses)))
    qd = ", ".join(f"{name}: {value:.17g}" for name, value in (rates or {}).items())
    return scene(title, body, f"{{q: {{{q}}}, qd: {{{qd}}}}}", duration)


def slider(title: str, duration: float, mass: float, force: str, start: str, **more: str) -> str:
    """Return a mass on a vertical (y) slide under a force that is a formula of y and qd.y.

    more : ``gravity``, and ``keys`` of the joint.
    """
    gravity, keys = more.get("gravity", GRAVITY), more.get("keys", "")
    body = (
        "robot:\n  joints:\n"
        f"    - {{name: y, type: prismatic, origin: {{rpy: [-90 deg, 0, 0]}}, axis: [0, 0, 1]{keys}}}\n"
        f"  links:\n    - {{name: body, mass: {mass:.17g}, com: [0, 0, 0], com_frame: link,\n"
        "       inertia: {xx: 1, yy: 1, zz: 1}}\n"
    )
    return scene(title, body, start, duration, gravity, f'{{y: "{force}"}}' if force else "")


GOVERNOR = """\
robot:
  joints:
    - {name: shaft, type: revolute, axis: [0, 0, 1]}
    - {name: arm, type: revolute, axis: [0, 1, 0]}
  links:
    - {name: hub, mass: 2.0, com: [0, 0, 0], com_frame: link, inertia: {xx: 0.02, yy: 0.02, zz: 0.03}}
    - {name: flyball, mass: 0.5, com: [0.3, 0, 0], com_frame: link, inertia: {xx: 1e-4, yy: 2e-3, zz: 2e-3}}
"""


def governor(title: str, duration: float) -> str:
    """Return a flyball on a driven shaft, held by a damped spring whose stiffness rises tenfold every second."""
    return scene(
        title,
        GOVERNOR,
        "{q: {shaft: 0, arm: 0.6}, qd: {shaft: 5}}",
        duration,
        "[0, 0, -9.81]",
        '{shaft: "0.2*(8 - qd.shaft)", arm: "-10^(t)*(arm - 0.5) - 0.1*10^(t)*qd.arm"}',
    )


SPINNING = """\
robot:
  joints:
    - {name: spin, type: revolute, axis: [0, 0, 1]}
    - {name: tilt, type: revolute, axis: [1, 0, 0], origin: {xyz: [0.1, 0, 0]}}
  links:
    - {name: rotor, mass: 3.0, com: [0, 0, 0], com_frame: link, inertia: {xx: 0.01, yy: 0.01, zz: 0.02}}
    - {name: blade, mass: 0.1, com: [0, 0.05, 0.01], com_frame: link,
       inertia: {xx: 1e-4, yy: 5e-5, zz: 1.2e-4, xy: 1e-5}}
"""


def spinning(title: str, duration: float, speed: float) -> str:
    """Return a rotor at ``speed`` with a blade that swings about its place in the centrifugal field."""
    return scene(
        title,
        SPINNING,
        f"{{q: {{spin: 0, tilt: 0.1}}, qd: {{spin: {speed:.17g}}}}}",
        duration,
        "[0, 0, -9.81]",
    )
