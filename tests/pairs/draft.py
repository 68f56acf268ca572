"""A scene in the making: the arm that all begin with, and what features ask of it."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from typing import Any

DURATION = 0.05  # s, of motions and of simulations
SAMPLES = 5
ANGLE, WAY = (0.3, 0.1), (0.12, 0.02)  # start and change of a coordinate
# coordinates of the kinds of joint, each with its start and its change in a motion; an attitude counts as three
COORDINATES: dict[str, dict[str, tuple[float, float]]] = {
    "fixed": {},
    "revolute": {"": ANGLE},
    "prismatic": {"": WAY},
    "helical": {"": ANGLE},
    "cylindrical": {"theta": ANGLE, "d": WAY},
    "universal": {"theta1": ANGLE, "theta2": (0.2, 0.1)},
    "planar": {"x": WAY, "y": (0.05, 0.02), "theta": ANGLE},
    "spherical": {"rpy": (0.2, 0.1)},
    "floating": {"xyz": WAY, "rpy": (0.2, 0.1)},
}
# columns of velocities of joints with an attitude
VELOCITIES = {"spherical": ["wx", "wy", "wz"], "floating": ["vx", "vy", "vz", "wx", "wy", "wz"]}
INERTIA = {"xx": 0.02, "yy": 0.03, "zz": 0.03}
ARM: dict[str, Any] = {
    "schema": 1,
    "gravity": [0, -9.81, 0],
    "robot": {
        "joints": [
            {"name": "a", "type": "revolute", "axis": [0, 0, 1]},
            {"name": "b", "type": "revolute", "axis": [0, 0, 1], "origin": {"xyz": [1, 0, 0]}},
        ],
        "links": [
            {"name": "upper", "mass": 2, "com": [0.5, 0, 0], "inertia": INERTIA},
            {"name": "fore", "mass": 1, "com": [0.4, 0, 0], "inertia": INERTIA},
        ],
        "points": {"tip": {"link": "fore", "at": [0.8, 0, 0]}, "hook": {"link": "base", "at": [0, 1.5, 0]}},
    },
    "simulate": {"duration": DURATION, "samples": SAMPLES},
    "inverse": {"samples": SAMPLES},
    "kinematics": {"samples": SAMPLES},
}


class Draft:
    """The scene as a tree of YAML, and what features that come later need to know of it.

    focus : the joint that features of joints are put on. kinds : kind of every joint by name. starts : positions of
    coordinates that are not where their kind begins. led : joints that motions lead; None for all. tip : where the
    named point ``tip`` is in the start.
    """

    def __init__(self) -> None:
        self.tree: dict[str, Any] = copy.deepcopy(ARM)
        self.focus: dict[str, Any] = self.tree["robot"]["joints"][0]
        self.kinds = {"a": "revolute", "b": "revolute"}
        self.starts = {"b": 0.6}
        self.led: list[str] | None = None
        self.tip = [1.452625, 0.922180]
        self.end = [0.8, 0, 0]  # of the arm, in the frame of its last link
        self.attached = False

    @property
    def robot(self) -> dict[str, Any]:
        """The section ``robot``."""
        found: dict[str, Any] = self.tree["robot"]
        return found

    @property
    def closed(self) -> bool:
        """Whether the scene, or its robot, has a loop."""
        return bool(self.tree.get("loops") or self.robot.get("loops"))

    def section(self, name: str) -> Any:
        """Return a section of the scene, which is begun as a map."""
        return self.tree.setdefault(name, {})

    def listed(self, name: str) -> Any:
        """Return a list of the scene, which is begun empty."""
        return self.tree.setdefault(name, [])

    def add_joint(self, joint: dict[str, Any], link: dict[str, Any]) -> dict[str, Any]:
        """Add a joint with its link to the robot; return the joint, to be written on."""
        self.kinds[joint["name"]] = joint["type"]
        if self.attached:
            parent, origin = joint.pop("parent", "fore"), joint.pop("origin", {})
            entry = {"link": link.pop("name"), "to": parent, "origin": origin, "joint": joint, **link}
            self.robot.setdefault("attach", []).append(entry)
        else:
            self.robot["joints"].append(joint)
            self.robot["links"].append(link)
        return joint

    def moving(self) -> list[str]:
        """Return the joints with coordinates."""
        return [name for name, kind in self.kinds.items() if kind != "fixed"]

    def followed(self) -> list[str]:
        """Return the joints that a motion leads."""
        return (
            self.moving() if self.led is None else [name for name in self.led if self.kinds[name] != "fixed"]
        )

    def single(self) -> list[str]:
        """Return the joints of one coordinate that motions lead."""
        return [name for name in self.followed() if "" in COORDINATES[self.kinds[name]]]

    def at(self, name: str, s: float) -> Any:
        """Return the position of a joint as the scene writes it: at its start for s = 0, moved for s = 1."""
        return self._written(name, lambda x, dx: round(x + s * dx, 12))

    def formula(self, name: str) -> Any:
        """Return formulas of a joint's motion."""
        return self._written(name, lambda x, dx: f"{x} + {dx}*sin(3*t)")

    def _written(self, name: str, write: Callable[[float, float], Any]) -> Any:
        start = self.starts.get(name)
        parts = {
            part: [write(x, 0.0), write(x / 2, dx), write(-x, dx)]
            if part in ("rpy", "xyz")
            else write(start or x, dx)
            for part, (x, dx) in COORDINATES[self.kinds[name]].items()
        }
        return parts.get("", parts)

    def q(self, names: Iterable[str], s: float = 0.0) -> dict[str, Any]:
        """Return positions of joints by name."""
        return {name: self.at(name, s) for name in names}

    def by_velocity(self, name: str, value: Any) -> Any:
        """Return what stands where each velocity of a joint has a value."""
        kind = self.kinds[name]
        parts = VELOCITIES.get(kind) or [part for part in COORDINATES[kind] if part]
        return dict.fromkeys(parts, value) if parts else value

    def velocities(self, name: str) -> list[str]:
        """Return the names of a joint's velocities in formulas, without ``qd.``."""
        value = self.by_velocity(name, 0)
        return [f"{name}.{part}" for part in value] if isinstance(value, dict) else [name]

    def put(self, key: str, value: Any) -> None:
        """Write a key of forces of the joint in focus, by coordinate where the joint has several, to what is there."""
        kind, focus = self.focus["type"], self.focus
        parts = [part for part in COORDINATES[kind] if part]
        if kind == "floating":
            focus[key] = {
                part: {**focus.get(key, {}).get(part, {}), **value} for part in ("translation", "rotation")
            }
        elif kind == "spherical" or not parts:
            focus[key] = {**focus.get(key, {}), **value}
        else:
            focus[key] = {parts[-1]: {**focus.get(key, {}).get(parts[-1], {}), **value}}

    def beside(self, less: float) -> float:
        """Return a position a little below the start of the coordinate in focus, to which gravity pulls."""
        parts = COORDINATES[self.focus["type"]]
        return round((list(parts.values())[-1] if parts else ANGLE)[0] - less, 6)

    def column(self) -> str:
        """Return the name of a coordinate of the joint in focus that has one."""
        kind, name = self.focus["type"], self.focus["name"]
        parts = [part for part in COORDINATES[kind] if part]
        return f"{name}.{parts[-1]}" if parts else name
