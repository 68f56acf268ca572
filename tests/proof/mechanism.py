"""A random mechanism as plain data: written as a scene for the program, read as numbers by the reference.

Nothing here comes from the program, so that a mistake in reading scenes would show too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

Array = NDArray[np.float64]
# value(t, s, q, v): s is an instant inside the stretch between jumps, which says on which side of them t is
Value = Callable[[float, float, Array, Array], float]
# coordinates and velocities of each kind of joint, in the program's order
COORDINATES = {
    "revolute": ("",), "prismatic": ("",), "helical": ("",), "cylindrical": ("theta", "d"),
    "universal": ("theta1", "theta2"), "planar": ("x", "y", "theta"), "spherical": ("qw", "qx", "qy", "qz"),
    "floating": ("x", "y", "z", "qw", "qx", "qy", "qz"),
}  # fmt: skip
VELOCITIES = {
    **COORDINATES, "spherical": ("wx", "wy", "wz"), "floating": ("vx", "vy", "vz", "wx", "wy", "wz"),
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Formula:
    """A formula as text and as a function; ``breaks`` are the instants [s] at which it or its slope jumps."""

    text: Any
    value: Value
    breaks: tuple[float, ...] = ()


@dataclasses.dataclass
class Body:
    """A link with its joint; ``parent`` is its place in the list, -1 the ground. ``extra`` holds keys of the joint."""

    name: str
    kind: str
    parent: int
    xyz: Array
    rpy: Array
    axis: Array
    axis2: Array | None
    mass: float
    com: Array
    inertia: Array
    pitch: float = 0.0
    extra: dict[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def link(self) -> str:
        return f"l_{self.name}"

    @property
    def scalar(self) -> bool:
        return len(COORDINATES[self.kind]) == 1


@dataclasses.dataclass(frozen=True)
class Point:
    """A point of a body (-1: of the ground), in the frame of its joint [m]."""

    body: int
    at: Array


@dataclasses.dataclass
class Loop:
    """A closure: ``directions`` (k, 3) in which the two points coincide, or the ``length`` of a bar between them."""

    kind: str
    first: Point
    second: Point
    directions: Array | None = None
    length: float = 0.0
    axis: Array | None = None


@dataclasses.dataclass
class Spring:
    """Spring and damper along the line between two points."""

    first: Point
    second: Point
    stiffness: float
    length: float
    damping: float


@dataclasses.dataclass
class Bushing:
    """Bushing between a frame of the ground, turned by ``rpy``, and the axes of a body at a point."""

    ground: Array
    rpy: Array
    at: Point
    stiffness: Array
    damping: Array


@dataclasses.dataclass
class Coupler:
    """The coefficients of joints' coordinates, which sum to ``value``."""

    terms: dict[int, float]
    value: float


@dataclasses.dataclass
class Load:
    """Force (and moment) on a point, in the axes of the world or of the body."""

    at: Point
    force: list[Formula]
    moment: list[Formula] | None
    frame: str


@dataclasses.dataclass
class Branch:
    """A smooth way to move: q = at(x), with v = P(x) xd and its bias Pd xd; x are the coordinates ``free`` of q."""

    free: list[int]
    at: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    bias: Callable[[Array, Array], Array]


@dataclasses.dataclass
class Lock:
    """What ends a deployment: a dead point of the joints ``driven``, or a latch of ``joint`` at a position.

    passive : the joints that the loops move, where it is a dead point.
    """

    driven: list[int]
    passive: list[int] | None = None
    joint: int = 0
    at: float = 0.0


@dataclasses.dataclass
class Law:
    """A controller of scalar ``joints``, tau = kp e + kd e' + s with s' = ki e, at every instant or sampled.

    reference : formulas of position and rate of each joint. period : [s], None where it acts at every instant.
    delay : from a sample to its torques [s]. limit : the largest torque, of a sampled one without ki.
    """

    joints: list[int]
    reference: list[tuple[Formula, Formula]]
    kp: Array
    kd: Array
    ki: Array
    period: float | None = None
    delay: float = 0.0
    limit: float | None = None

    def error(self, t: float, x: Array) -> Array:
        """Return the errors of the joints at positions x (n,)."""
        return np.array([at.value(t, t, x, x) for at, _ in self.reference]) - x

    def torques(self, t: float, x: Array, xd: Array, s: Array) -> Array:
        """Return the torques (n,) at positions x, rates xd and integrals s (n,)."""
        rates = np.array([rate.value(t, t, x, xd) for _, rate in self.reference])
        tau: Array = self.kp * self.error(t, x) + self.kd * (rates - xd) + s
        return tau if self.limit is None else np.clip(tau, -self.limit, self.limit)

    def scene(self, names: list[str], duration: float) -> dict[str, Any]:
        """Return the section ``control``; ``names`` of the joints."""
        gains = {"kp": self.kp, "kd": self.kd} | ({"ki": self.ki} if self.ki.any() else {})
        followed = {name: at.text for name, (at, _) in zip(names, self.reference)}
        keys: dict[str, Any] = {
            "type": "pid" if self.ki.any() else "pd", "joints": names,
            "reference": {"type": "joint", "duration": duration + 1.0, "q": followed},
            "gains": {key: dict(zip(names, _numbers(values))) for key, values in gains.items()},
        }  # fmt: skip
        sampled = {"period": self.period, "delay": self.delay, "limit": self.limit}
        return keys | {key: value for key, value in sampled.items() if value}


@dataclasses.dataclass
class Payload:
    """A mass that a body carries from ``start`` to ``stop`` [s]; None: from the beginning, to the end.

    com : of the mass, from the point. velocity, spin : what it has before it is gripped, in the axes of the world.
    """

    at: Point
    mass: float
    com: Array
    inertia: Array
    start: float | None
    stop: float | None
    velocity: Array
    spin: Array


@dataclasses.dataclass
class Mechanism:
    """All of a scene."""

    bodies: list[Body]
    gravity: Array
    q: Array
    v: Array
    duration: float
    samples: int
    torques: dict[tuple[int, int], Formula] = dataclasses.field(default_factory=dict)
    prescribed: dict[int, tuple[Formula, Formula, Formula]] = dataclasses.field(default_factory=dict)
    springs: list[Spring] = dataclasses.field(default_factory=list)
    loads: list[Load] = dataclasses.field(default_factory=list)
    bushings: list[Bushing] = dataclasses.field(default_factory=list)
    loops: list[Loop] = dataclasses.field(default_factory=list)
    couplers: list[Coupler] = dataclasses.field(default_factory=list)
    hold: list[str] = dataclasses.field(default_factory=list)
    simulate: dict[str, Any] = dataclasses.field(default_factory=dict)
    branch: Branch | None = None
    lock: Lock | None = None
    law: Law | None = None
    payloads: list[Payload] = dataclasses.field(default_factory=list)

    def __post_init__(self) -> None:
        sizes_q = [len(COORDINATES[b.kind]) for b in self.bodies]
        sizes_v = [len(VELOCITIES[b.kind]) for b in self.bodies]
        self.first_q = np.concatenate([[0], np.cumsum(sizes_q)]).astype(int)
        self.first_v = np.concatenate([[0], np.cumsum(sizes_v)]).astype(int)

    @property
    def breaks(self) -> list[float]:
        """Instants [s] at which a formula of time jumps."""
        found: set[float] = set()
        formulas = [*self.torques.values()]
        for load in self.loads:
            formulas += [*load.force, *(load.moment or ())]
        for formula in formulas:
            found.update(formula.breaks)
        return sorted(t for t in found if 0.0 < t < self.duration)

    def scene(self) -> str:
        """Return the scene as YAML."""
        points: dict[str, Any] = {}

        def named(point: Point) -> str:
            name = f"p{len(points)}"
            link = self.bodies[point.body].link if point.body >= 0 else "base"
            points[name] = {"link": link, "at": _numbers(point.at)}
            return name

        forces = [_spring(k, s, named) for k, s in enumerate(self.springs)]
        forces += [_load(k, load, named) for k, load in enumerate(self.loads)]
        forces += [_bushing(k, bushing) for k, bushing in enumerate(self.bushings)]
        loops = [_loop(k, loop, named) for k, loop in enumerate(self.loops)]
        tree: dict[str, Any] = {
            "schema": 1, "command": "simulate", "gravity": _numbers(self.gravity),
            "robot": {"joints": [self._joint(k) for k in range(len(self.bodies))],
                      "links": [_link(b) for b in self.bodies]},
            "initial": {"q": self._by_joint(self.q, self.first_q, set(self.prescribed)),
                        "qd": self._by_joint(self.v, self.first_v, set(self.prescribed)), "hold": self.hold},
            "simulate": {"duration": self.duration, "samples": self.samples, **self.simulate},
        }  # fmt: skip
        if forces:
            tree["forces"] = forces
        if self.bushings:
            tree["robot"]["frames"] = self._frames()
        if self.couplers:
            tree["couplers"] = [
                {
                    "name": f"gear{k}",
                    "terms": {self.bodies[j].name: c for j, c in gear.terms.items()},
                    "value": gear.value,
                }
                for k, gear in enumerate(self.couplers)
            ]
        if loops:
            tree["loops"] = loops
        if self.torques:
            tree["torques"] = self._torques()
        if self.lock is not None:
            tree |= {"command": "deploy", **self._deploy(self.lock)}
        if self.law is not None:
            names = [self.bodies[k].name for k in self.law.joints]
            tree["control"] = self.law.scene(names, self.duration)
        if self.payloads:
            tree["payloads"] = [_payload(k, p, named) for k, p in enumerate(self.payloads)]
        if self.prescribed:
            tree["prescribed"] = {self.bodies[k].name: f[0].text for k, f in self.prescribed.items()}
        if points:
            tree["robot"]["points"] = points
        return str(yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=10000))

    def _joint(self, k: int) -> dict[str, Any]:
        body = self.bodies[k]
        parent = self.bodies[body.parent].link if body.parent >= 0 else "base"
        keys: dict[str, Any] = {
            "name": body.name, "type": body.kind, "parent": parent, "link": body.link,
            "origin": {"xyz": _numbers(body.xyz), "rpy": _numbers(body.rpy)},
        }  # fmt: skip
        if body.kind not in ("spherical", "floating"):
            keys["axis"] = _numbers(body.axis)
        if body.axis2 is not None:
            keys["axis2"] = _numbers(body.axis2)
        if body.kind == "helical":
            keys["pitch"] = body.pitch
        return keys | body.extra

    def _deploy(self, lock: Lock) -> dict[str, Any]:
        actuated = [self.bodies[k].name for k in lock.driven]
        if lock.passive is not None:
            return {"actuated": actuated, "deploy": {"criterion": "dead_point"}}
        body = self.bodies[lock.joint]
        parent = self.bodies[body.parent].link if body.parent >= 0 else "base"
        latch = {"between": [parent, body.link], "at": {body.name: lock.at}}
        return {"actuated": actuated, "deploy": {"criterion": "latch", "latch": latch}}

    def _by_joint(self, values: Array, first: Any, without: set[int]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for k, body in enumerate(self.bodies):
            part = [float(x) for x in values[first[k] : first[k + 1]]]
            if k in without:
                continue
            if first is self.first_q and body.kind in ("spherical", "floating"):
                found[body.name] = {"quaternion": part[-4:]} | ({"xyz": part[:3]} if len(part) > 4 else {})
            else:
                found[body.name] = part[0] if body.scalar else part
        return found

    def _frames(self) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for k, b in enumerate(self.bushings):
            found[f"ground{k}"] = {"link": "base", "at": _numbers(b.ground), "rpy": _numbers(b.rpy)}
            found[f"body{k}"] = {"link": self.bodies[b.at.body].link, "at": _numbers(b.at.at)}
        return found

    def _torques(self) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for (k, c), formula in self.torques.items():
            body = self.bodies[k]
            if body.scalar:
                found[body.name] = formula.text
            else:
                found.setdefault(body.name, {})[VELOCITIES[body.kind][c]] = formula.text
        return found


def _numbers(values: Any) -> list[float]:
    return [float(x) for x in values]


def _link(body: Body) -> dict[str, Any]:
    com = _numbers(body.com)
    return {"name": body.link, "mass": float(body.mass), "com": com, "inertia": _tensor(body.inertia)}


def _tensor(I: Array) -> dict[str, float]:
    names = (("xx", 0, 0), ("yy", 1, 1), ("zz", 2, 2), ("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2))
    return {name: float(I[i, j]) for name, i, j in names}


def _payload(k: int, payload: Payload, named: Callable[[Point], str]) -> dict[str, Any]:
    keys: dict[str, Any] = {
        "name": f"payload{k}", "at": named(payload.at), "mass": payload.mass, "com": _numbers(payload.com),
        "inertia": _tensor(payload.inertia),
    }  # fmt: skip
    if payload.start is not None:
        keys |= {"from": {"time": payload.start}, "velocity": _numbers(payload.velocity),
                 "angular_velocity": _numbers(payload.spin)}  # fmt: skip
    return keys if payload.stop is None else keys | {"until": {"time": payload.stop}}


def _spring(k: int, spring: Spring, named: Callable[[Point], str]) -> dict[str, Any]:
    return {
        "name": f"spring{k}", "type": "spring", "between": [named(spring.first), named(spring.second)],
        "stiffness": spring.stiffness, "length": spring.length, "damping": spring.damping,
    }  # fmt: skip


def _bushing(k: int, bushing: Bushing) -> dict[str, Any]:
    return {
        "name": f"bushing{k}", "type": "bushing", "between": [f"ground{k}", f"body{k}"],
        "stiffness": _numbers(bushing.stiffness), "damping": _numbers(bushing.damping),
    }  # fmt: skip


def _load(k: int, load: Load, named: Callable[[Point], str]) -> dict[str, Any]:
    keys: dict[str, Any] = {
        "name": f"load{k}", "type": "force" if load.moment is None else "wrench", "at": named(load.at),
        "force": [f.text for f in load.force], "frame": load.frame,
    }  # fmt: skip
    return keys if load.moment is None else keys | {"moment": [f.text for f in load.moment]}


def _loop(k: int, loop: Loop, named: Callable[[Point], str]) -> dict[str, Any]:
    keys: dict[str, Any] = {
        "name": f"loop{k}",
        "type": loop.kind,
        "between": [named(loop.first), named(loop.second)],
    }
    if loop.axis is not None:
        keys["axis"] = _numbers(loop.axis)
    if loop.kind == "distance":
        keys["length"] = loop.length
    return keys
