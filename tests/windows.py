"""Rows of four-bar windows side by side: every pose with all bars on one line loses rank in each window at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import fsolve

from robodyn_cli.spatial.algebra import rotation_rpy

LEVEL = (0.0, 0.0, 0.0)


def windows(
    count: int,
    legs: Sequence[float] = (),
    bars: Sequence[float] = (),
    ground: float | None = None,
    start: float = math.pi / 2,
    speed: float = -1.0,
    rpy: Sequence[float] = LEVEL,
    damping: float = 0.0,
    bob: bool = False,
    duration: float = 3.0,
    samples: int = 101,
    singular: str = "pass",
) -> str:
    """Return a scene of ``count`` windows whose legs turn about ground pivots, uniform rods of 1 kg.

    Parameters
    ----------
    ground : distance of the pivots; by default such that all bars can lie on one line.
    start, speed : of the first leg [rad, rad/s]. rpy : turns the plane of the mechanism. damping : in every joint.
    bob : hang a body on the first leg, on a spherical joint.
    """
    a, b = list(legs) or [1.0] * (count + 1), list(bars) or [1.0] * count
    R = np.array(rotation_rpy(rpy), dtype=float)
    x, th, ph = [0.0], [start], []
    for k in range(count):
        x.append(x[-1] + a[k] + (b[k] if ground is None else ground) - a[k + 1])

        def open_by(angles: np.ndarray, k: int = k) -> list[float]:
            bar, leg = angles
            return [
                x[k] + a[k] * math.cos(th[k]) + b[k] * math.cos(bar) - x[k + 1] - a[k + 1] * math.cos(leg),
                a[k] * math.sin(th[k]) + b[k] * math.sin(bar) - a[k + 1] * math.sin(leg),
            ]

        bar, leg = fsolve(open_by, [0.0, th[k]], xtol=1e-13).tolist()
        ph.append(bar)
        th.append(leg)
    joints, links, points, loops, q = [], [], [], [], []
    more = f", damper: {{damping: {damping}}}" if damping else ""
    for k in range(count + 1):
        place = f"origin: {{xyz: {(R @ [x[k], 0.0, 0.0]).tolist()}, rpy: {list(rpy)}}}"
        joints.append(_hinge(f"th{k}", "base", f"leg{k}", place, more))
        links.append(_rod(f"leg{k}", a[k]))
        q.append(f"th{k}: {th[k]!r}")
        if k < count:
            joints.append(_hinge(f"ph{k}", f"leg{k}", f"bar{k}", f"origin: {{xyz: [{a[k]}, 0, 0]}}", more))
            links.append(_rod(f"bar{k}", b[k]))
            q.append(f"ph{k}: {ph[k] - th[k]!r}")
            points.append(f"R{k}: {{link: bar{k}, at: [{b[k]}, 0, 0]}}")
            points.append(f"T{k + 1}: {{link: leg{k + 1}, at: [{a[k + 1]}, 0, 0]}}")
            loops.append(f"{{name: w{k}, type: revolute, between: [R{k}, T{k + 1}]}}")
    hold = ["th0"]
    if bob:
        joints.append(
            f"{{name: ball, type: spherical, parent: leg0, link: bob, origin: {{xyz: [{a[0]}, 0, 0]}}}}"
        )
        links.append("{name: bob, mass: 1, com: [0.5, 0.1, 0.2], inertia: {xx: 0.05, yy: 0.1, zz: 0.12}}")
        q.append("ball: [0.9210609940028851, 0.0, 0.0, -0.3894183423086505]")
        hold.append("ball")
    return "\n".join(
        [
            "schema: 1",
            "command: simulate",
            f"gravity: {(R @ [0.0, -9.81, 0.0]).tolist()}",
            "robot:",
            *_listed("joints", joints),
            *_listed("links", links),
            "  points:",
            *[f"    {text}" for text in points],
            "loops:",
            *[f"  - {text}" for text in loops],
            f"initial: {{q: {{{', '.join(q)}}}, qd: {{th0: {speed}}}, hold: [{', '.join(hold)}]}}",
            f"simulate: {{duration: {duration}, samples: {samples}, singular: {singular}}}",
        ]
    )


def _listed(key: str, entries: Sequence[str]) -> list[str]:
    return [f"  {key}:", *[f"    - {text}" for text in entries]]


def _hinge(name: str, parent: str, link: str, place: str, more: str) -> str:
    return f"{{name: {name}, type: revolute, parent: {parent}, link: {link}, {place}, axis: [0, 0, 1]{more}}}"


def _rod(name: str, length: float) -> str:
    inertia = length * length / 12
    return f"{{name: {name}, mass: 1, com: [{length / 2}, 0, 0], inertia: {{xx: 0, yy: {inertia}, zz: {inertia}}}}}"
