"""Loops and couplings that a description of a robot holds beside its tree, as loops and couplers of a scene's robot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import Faults, Node, located, plain
from robodyn_cli.scene.urdf.elements import X_AXIS, UrdfPose
from robodyn_cli.scene.urdf.xml import scene_names

WITH_AXES = ("revolute", "prismatic", "planar", "universal")


@record
class LoopEnd:
    """One end of a closure: a frame on a link, and the closure's axis in that frame."""

    link: str
    pose: UrdfPose = UrdfPose()
    axis: tuple[float, ...] = X_AXIS


@record
class Closure:
    """Two frames that a closure of some ``type`` joins; ``place`` : where it is written; ``length`` : of a bar."""

    place: Node
    name: str
    type: str
    ends: tuple[LoopEnd, LoopEnd]
    length: float = 0.0


@record
class Coupling:
    """The sum of coefficient times q over joints that move is ``value``; ``place`` : where it is written."""

    place: Node
    name: str
    terms: dict[str, float]
    value: float = 0.0


@record
class Ties:
    """What a robot has beside its tree; ``motors`` : joints that have one, None where that is not said."""

    closures: tuple[Closure, ...]
    couplings: tuple[Coupling, ...]
    motors: tuple[str, ...] | None = None

    @property
    def names(self) -> list[str]:
        return [*(x.name for x in self.couplings), *(x.name for x in self.closures)]

    def check_names(self, faults: Faults) -> None:
        """Report names that appear twice."""
        seen: set[str] = set()
        ties: list[Closure | Coupling] = [*self.couplings, *self.closures]
        for tie in ties:
            with faults:
                if tie.name in seen:
                    raise located(tie.place, "", f"{tie.name!r} names two loops or couplings; allowed: one")
                seen.add(tie.name)


def loop_of(closure: Closure, name: str, links: Mapping[str, str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a closure as an entry of ``loops``, and the points that it joins.

    links : names of links in the scene. A point at the origin of its link's frame needs no name.
    """
    points: dict[str, Any] = {}
    between = []
    for end, role in zip(closure.ends, ("predecessor", "successor")):
        link, at = links[end.link], list(end.pose.xyz)
        if any(at):
            points[f"{name}_{role}"] = {"link": link, "at": at}
        between.append(f"{name}_{role}" if any(at) else f"{link}.origin")
    entry: dict[str, Any] = {"name": name, "type": closure.type, "between": between}
    turned = [end.pose.rotation for end in closure.ends]
    axes = [[float(x) for x in R @ list(end.axis)] for R, end in zip(turned, closure.ends)]
    if closure.type == "distance":
        entry["length"] = closure.length
    if closure.type in WITH_AXES:
        entry["axis"] = axes[0]
    if closure.type == "universal" or (closure.type in ("revolute", "planar") and axes[0] != axes[1]):
        entry["axis2"] = axes[1]
    if closure.type in ("prismatic", "fixed"):
        rpy = rpy_of((turned[0] @ turned[1].T).tolist())
        entry |= {"rpy": rpy} if any(rpy) else {}
    return entry, points


def tie_entries(ties: Ties, joints: Iterable[str], links: Mapping[str, str]) -> dict[str, Any]:
    """Return the keys ``couplers``, ``points``, ``loops`` and ``actuated`` of a robot, those that have something.

    joints, links : their names in the scene.
    """
    names = scene_names(ties.names, joints)
    couplers: list[Node] = []
    loops: list[Node] = []
    points: dict[str, Node] = {}
    for tie in ties.couplings:
        value = {"value": tie.value} if tie.value else {}
        couplers.append(plain(tie.place, {"name": names[tie.name], "terms": tie.terms, **value}))
    for closure in ties.closures:
        loop, joined = loop_of(closure, names[closure.name], links)
        loops.append(plain(closure.place, loop))
        points |= {name: plain(closure.place, point) for name, point in joined.items()}
    entries: dict[str, Any] = {"couplers": couplers, "points": points, "loops": loops}
    motors = {} if ties.motors is None else {"actuated": ties.motors}
    return {key: entry for key, entry in entries.items() if entry} | motors


def motors_by_effort(efforts: Mapping[str, float | None]) -> tuple[str, ...] | None:
    """Return the joints that have a motor; None where no effort is 0, or none another number, which says nothing.

    efforts : the largest of each joint, None where that is not stated.
    """
    if 0.0 not in efforts.values() or not any(efforts.values()):
        return None
    return tuple(name for name, effort in efforts.items() if effort != 0.0)


def rpy_of(R: list[list[float]]) -> list[float]:
    """Return roll, pitch, yaw [rad] of a rotation, to rounding at a pitch of 90 degrees too."""
    yaw = math.atan2(R[1][0], R[0][0])
    c, s = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-R[2][0], c * R[0][0] + s * R[1][0])
    roll = math.atan2(s * R[0][2] - c * R[1][2], c * R[1][1] - s * R[0][1])
    return [roll, pitch, yaw]
