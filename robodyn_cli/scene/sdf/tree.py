"""The robot of an SDF as the tree of a scene's ``robot``: every value knows the line that it comes from.

The file's poses are q = 0. A link's frame here has the axes of the link in the file, and its origin where the joint
that turns it is; links that slide, are fixed or float keep their own.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from robodyn_cli.errors import unknown_name
from robodyn_cli.scene.dialects import Packages, RobotTree
from robodyn_cli.scene.sdf.elements import SdfLink, SdfRobot
from robodyn_cli.scene.sdf.frames import WORLD, Scope, between, cleaned, matrix, pose_between
from robodyn_cli.scene.sdf.joints import CROSS, SINGLE, SdfAxis, SdfJoint
from robodyn_cli.scene.sdf.structure import Move, SdfStructure
from robodyn_cli.scene.text.nodes import Faults, plain, sequence
from robodyn_cli.scene.text.nodes import Mapping as MappingNode
from robodyn_cli.scene.ties import Closure, Coupling, LoopEnd, Ties, motors_by_effort, tie_entries
from robodyn_cli.scene.urdf.closures import OF_DRAKE
from robodyn_cli.scene.urdf.elements import Inertial, UrdfLink, UrdfPose, UrdfShape
from robodyn_cli.scene.urdf.meshes import drawn_shapes
from robodyn_cli.scene.urdf.tree import ROOT_JOINT, LinkEntries, origin_of, rotor_entries
from robodyn_cli.scene.urdf.xml import GROUND, XmlElement, joint_names, link_names, scene_names

TYPES = {"continuous": "revolute", "ball": "spherical", "screw": "helical", "revolute2": "universal"}
_STAYS = ("fixed", "prismatic")  # the origin of the link's frame is its own
_RIGHT = 1e-3  # cosine up to which axes count as at right angles, and what is left of 1 as parallel


def robot_tree(robot: SdfRobot, structure: SdfStructure, packages: Packages, faults: Faults) -> RobotTree:
    """Return the tree of a robot; what is wrong with frames, axes and couplings is reported."""
    return _SdfTree(robot, structure, faults).tree(packages)


class _SdfTree:
    def __init__(self, robot: SdfRobot, structure: SdfStructure, faults: Faults) -> None:
        self.robot, self.structure, self.faults = robot, structure, faults
        self.file = robot.element.place.source.name
        moves = structure.moves
        self.ends = [move for move in moves if move.end]
        self.above = {move.link: move for move in moves if not move.end}
        self.joints = joint_names(move.joint.name for move in moves)
        links = (*(link.name for link in robot.links), *(move.end for move in self.ends))
        self.links = {WORLD: GROUND} | link_names(links)
        roots = (*structure.floating, *structure.held)
        wanted = [f"root_{name}" for name in roots] if len(roots) > 1 else [ROOT_JOINT]
        self.roots = dict(zip(roots, scene_names(wanted, self.joints.values()).values()))
        self.remarks: dict[str, list[str]] = {}
        self.seats = self._seats()

    def _seats(self) -> dict[str, Any]:
        """Return the pose (4, 4) in the world of the frame that each link has here."""
        frames = self.robot.frames
        seats = {WORLD: frames.pose(frames.frames[WORLD])}
        for link in self.robot.links:
            seats[link.name] = frames.pose(link.frame).copy()
        for move in self.structure.moves:
            T = frames.pose(frames.frames[move.link]).copy()
            if move.joint.type not in _STAYS:
                T[:3, 3] = frames.pose(move.joint.frame)[:3, 3]
            seats[move.end or move.link] = T
        return seats

    def tree(self, packages: Packages) -> RobotTree:
        place = self.robot.element.place
        own = [self.link(link) for link in self.robot.links]
        shapes = {link.name: drawn_shapes(link, self.file, packages) for link in own}
        written = LinkEntries(self.links, shapes, os.path.dirname(os.path.abspath(self.file)), "SDF")
        links = [written.link(link) for link in own]
        links += [plain(m.joint.element.place, {"name": self.links[m.end], "mass": 0.0}) for m in self.ends]
        for move in self.ends:
            closing, tied = self.joints[move.joint.name], self.links[move.link]
            written.remarks[self.links[move.end]] = [
                f"massless, welded to {tied}: so joint {closing} closes a loop and keeps its coordinate"
            ]
        joints = [*self.root_joints()]
        for move in self.structure.moves:
            with self.faults:
                joints.append(self.joint(move))
        entries: dict[str, Any] = {"joints": sequence(place, joints), "links": sequence(place, links)}
        couplings = tuple(self.couplings())
        efforts = {
            self.joints[move.joint.name]: move.joint.axes[0].limits.get("effort", math.inf)
            for move in self.structure.moves
            if move.joint.type in SINGLE
        }
        ties = Ties(tuple(self.closures()), couplings, motors_by_effort(efforts))
        ties.check_names(self.faults)
        entries |= tie_entries(ties, self.joints.values(), self.links)
        frames = self.frames(entries.get("points", ()))
        entries |= {"frames": frames} if frames else {}
        return RobotTree(plain(place, entries), self.remarks, written.remarks)

    # -- links and frames -------------------------------------------------------------------------------
    def link(self, link: SdfLink) -> UrdfLink:
        """Return a link with everything in the frame that it has here."""
        own = between(self.seats[link.name], self.robot.frames.pose(link.frame))
        moved = tuple(float(x) for x in own[:3, 3])
        inertial, pose = link.inertial, link.inertial.pose
        xyz = tuple(cleaned(x + d) for x, d in zip(pose.xyz, moved))
        shifted = Inertial(
            inertial.element, inertial.mass, UrdfPose(xyz, pose.rpy, pose.quaternion), inertial.inertia
        )
        shapes = []
        for kind in (link.visual, link.collision):
            placed = []
            for shape, frame in kind:
                T = between(self.seats[link.name], self.robot.frames.pose(frame))
                placed.append(UrdfShape(shape.element, shape.kind, shape.sizes, shape.file, pose_between(T)))
            shapes.append(tuple(placed))
        return UrdfLink(link.element, link.name, shifted, shapes[0], shapes[1])

    def frames(self, points: Iterable[str]) -> dict[str, MappingNode]:
        """Return the named frames of the file as ``frames``."""
        frames = {}
        names = scene_names((frame.name for frame in self.robot.named), points)
        with self.faults:
            for frame in self.robot.named:
                body = self.robot.frames.body(frame)
                pose = pose_between(between(self.seats[body], self.robot.frames.pose(frame)))
                entry = {"link": self.links[body], "at": pose.xyz, "rpy": pose.rpy}
                frames[names[frame.name]] = plain(frame.element.place, entry)
        return frames

    # -- joints -----------------------------------------------------------------------------------------
    def root_joints(self) -> Iterator[MappingNode]:
        for link in self.robot.links:
            if link.name not in self.roots:
                continue
            name, free = self.roots[link.name], link.name in self.structure.floating
            entries = {"name": name, "type": "floating" if free else "fixed", "parent": GROUND}
            place = link.element.place
            pose = pose_between(self.seats[link.name])
            yield plain(place, entries | {"link": self.links[link.name]} | origin_of(place, pose))
            self.remarks[name] = [
                "no joint of the SDF ties this link to the world: it is free; type: fixed here holds it"
                if free
                else "the model is static"
            ]

    def joint(self, move: Move) -> MappingNode:
        joint, place = move.joint, move.joint.element.place
        name, link = self.joints[joint.name], move.end or move.link
        remarks = self.remarks.setdefault(name, [])
        if name != joint.name:
            remarks.append(f"in the SDF: {joint.name!r}")
        if move.backward:
            remarks.append(
                "from its child to its parent in the SDF, with the axis turned round: q is the same"
            )
        entries: dict[str, Any] = {
            "name": name,
            "type": TYPES.get(joint.type, joint.type),
            "parent": self.links[move.parent],
            "link": self.links[link],
        }
        entries |= origin_of(place, pose_between(between(self.seats[move.parent], self.seats[link])))
        axes = self.axes(move)
        for key, axis in zip(("axis", "axis2"), axes):
            entries[key] = plain(place, self.direction(joint, axis, link, -1.0 if move.backward else 1.0))
        if joint.type == "screw":
            entries["pitch"] = joint.pitch
        if joint.type in CROSS:
            first, second = (self.direction(joint, axis, link) for axis in axes)
            cosine = sum(a * b for a, b in zip(first, second))
            if abs(cosine) > _RIGHT:
                raise joint.element.error(
                    f"joint {joint.name!r}: its axes have the cosine {cosine:.4g}; allowed: axes at right angles"
                )
        parts = [_acting(axis, remarks) for axis in axes]
        if joint.type in SINGLE:
            entries |= parts[0] | rotor_entries(joint.rotor)
        for key in ("limits", "friction", "spring") if joint.type in CROSS else ():
            by_coordinate = {f"theta{k}": part[key] for k, part in enumerate(parts, 1) if key in part}
            entries |= {key: by_coordinate} if by_coordinate else {}
        return plain(place, entries)

    def axes(self, move: Move) -> tuple[SdfAxis, ...]:
        """Return the axes of a joint from its parent here on."""
        return move.joint.axes[::-1] if move.backward else move.joint.axes

    def direction(self, joint: SdfJoint, axis: SdfAxis, seat: str, sign: float = 1.0) -> tuple[float, ...]:
        """Return the unit vector of an axis in the frame of a link at q = 0."""
        frames = self.robot.frames
        given = joint.frame
        if axis.expressed_in:
            if axis.expressed_in not in frames.frames:
                raise axis.element.error(
                    f"joint {joint.name!r}: {unknown_name('frame', axis.expressed_in, frames.frames)}"
                )
            given = frames.frames[axis.expressed_in]
        turned = between(self.seats[seat], frames.pose(given))[:3, :3] @ list(axis.xyz)
        return tuple(cleaned(sign * float(x)) + 0.0 for x in turned)

    # -- loops ------------------------------------------------------------------------------------------
    def closures(self) -> Iterator[Closure]:
        """Yield the joints that close loops, and the welds of those that keep their coordinate."""
        for move in self.structure.closing:
            with self.faults:
                yield self.closure(move)
        for move in self.ends:
            at = between(self.seats[move.link], self.seats[move.end])[:3, 3]
            ends = LoopEnd(move.end), LoopEnd(move.link, UrdfPose(tuple(float(x) for x in at)))
            yield Closure(move.joint.element.place, f"{move.joint.name}_weld", "fixed", ends)
        for element, scope in self.robot.ties:
            with self.faults:
                yield self.tie(OF_DRAKE[element.tag](element), element, scope)

    def tie(self, closure: Closure, element: XmlElement, scope: Scope) -> Closure:
        """Return a constraint of Drake with its points in the frames that the links have here."""
        frames, ends = self.robot.frames, []
        for end in closure.ends:
            name = scope.whole(end.link)
            if name not in frames.frames:
                raise element.error(f"<{element.tag}>: {unknown_name('link or frame', name, frames.frames)}")
            body = frames.body(frames.frames[name])
            T = between(self.seats[body], frames.pose(frames.frames[name]) @ matrix(end.pose))
            ends.append(LoopEnd(body, pose_between(T)))
        return Closure(closure.place, closure.name, closure.type, (ends[0], ends[1]), closure.length)

    def closure(self, move: Move) -> Closure:
        joint = move.joint
        kind = TYPES.get(joint.type, joint.type)
        J = self.robot.frames.pose(joint.frame)
        ends = []
        axes = joint.axes if kind == "universal" else (joint.axes or (None,)) * 2
        turn = between(self.seats[move.link], self.seats[move.parent])
        for k, (body, axis) in enumerate(zip((move.parent, move.link), axes)):
            pose = pose_between(between(self.seats[body], J))
            # both frames have the axes of the first link, so that the attitude of the second follows
            rpy = pose_between(turn).rpy if k == 1 and kind in ("prismatic", "fixed") else (0.0, 0.0, 0.0)
            direction = (1.0, 0.0, 0.0) if axis is None else self.direction(joint, axis, body)
            ends.append(LoopEnd(body, UrdfPose(pose.xyz, rpy), direction))
        return Closure(joint.element.place, joint.name, kind, (ends[0], ends[1]))

    # -- couplers ---------------------------------------------------------------------------------------
    def couplings(self) -> Iterator[Coupling]:
        """Yield relations between joints that move."""
        coupled = {move.joint.name: move.joint for move in self.structure.moves if move.joint.type in SINGLE}
        for move in self.structure.moves:
            for axis in move.joint.axes:
                mimic = axis.mimic
                with self.faults:
                    if mimic is not None:
                        _check_mimic(move.joint, axis, coupled)
                        terms = {
                            self.joints[move.joint.name]: 1.0,
                            self.joints[mimic.joint]: -mimic.multiplier,
                        }
                        value = mimic.offset - mimic.multiplier * mimic.reference
                        yield Coupling(mimic.element.place, f"{move.joint.name}_mimic", terms, value)
        for joint in self.structure.gearboxes:
            with self.faults:
                yield self.gearbox(joint)

    def gearbox(self, joint: SdfJoint) -> Coupling:
        """Return theta2 + ratio theta1 = 0 of the angles from the reference body to the parent and to the child."""
        terms: dict[str, float] = {}
        frames = self.robot.frames
        for name, axis, factor in zip((joint.parent, joint.child), joint.axes, (joint.ratio, 1.0)):
            for known in (name, joint.reference):
                if known not in frames.frames:
                    raise joint.element.error(
                        f"joint {joint.name!r}: {unknown_name('frame', known, frames.frames)}"
                    )
            start, end = (frames.body(frames.frames[one]) for one in (joint.reference, name))
            for coupled, sign in self.angle(joint, axis, start, end):
                terms[coupled] = terms.get(coupled, 0.0) + sign * factor
        terms = {name: x for name, x in terms.items() if x}
        if len(terms) < 2:
            raise joint.element.error(
                f"gearbox {joint.name!r} relates {len(terms)} joint(s) that turn; allowed: two or more"
            )
        return Coupling(joint.element.place, joint.name, terms)

    def angle(self, gearbox: SdfJoint, axis: SdfAxis, start: str, end: str) -> Iterator[tuple[str, float]]:
        """Yield the joints between two links that turn about an axis, and by which sign they count."""
        ways = [list(self.chain(start)), list(self.chain(end))]
        while all(ways) and ways[0][-1] == ways[1][-1]:
            ways = [way[:-1] for way in ways]
        tops = [way[-1].parent if way else link for way, link in zip(ways, (start, end))]
        if tops[0] != tops[1]:
            raise gearbox.element.error(f"gearbox {gearbox.name!r}: no joints lead from {start!r} to {end!r}")
        for way, sign in zip(ways, (-1.0, 1.0)):
            for move in way:
                joint = move.joint
                if joint.type in _STAYS:
                    continue
                cosine = 0.0
                if joint.type in SINGLE:
                    own = self.direction(joint, joint.axes[0], move.link, -1.0 if move.backward else 1.0)
                    wanted = self.direction(gearbox, axis, move.link)
                    cosine = sum(a * b for a, b in zip(own, wanted))
                if abs(abs(cosine) - 1.0) > _RIGHT**2:
                    raise gearbox.element.error(
                        f"gearbox {gearbox.name!r}: joint {joint.name!r} between {start!r} and {end!r} does not turn "
                        "about its axis; allowed: joints with one axis, along that of the gearbox"
                    )
                yield self.joints[joint.name], sign if cosine > 0.0 else -sign

    def chain(self, link: str) -> Iterator[Move]:
        """Yield the joints from a link to the root."""
        while link in self.above:
            yield self.above[link]
            link = self.above[link].parent


def _check_mimic(joint: SdfJoint, axis: SdfAxis, coupled: Mapping[str, SdfJoint]) -> None:
    mimic = axis.mimic
    assert mimic is not None
    if joint.name not in coupled:
        raise mimic.element.error(
            f"joint {joint.name!r} mimics another, but is {joint.type}; allowed: one axis"
        )
    if mimic.joint not in coupled or mimic.joint == joint.name:
        others = [name for name in coupled if name != joint.name]
        problem = unknown_name("joint with one axis", mimic.joint, others)
        raise mimic.element.error(f"joint {joint.name!r}: its mimic: {problem}")
    if mimic.multiplier == 0.0:
        raise mimic.element.error(
            f"joint {joint.name!r}: the multiplier of its mimic is 0; allowed: another number"
        )


def _acting(axis: SdfAxis, remarks: list[str]) -> dict[str, Any]:
    """Return limits, friction and spring of a coordinate."""
    limits = dict(axis.limits)
    if axis.crossed:
        lower, upper = limits.pop("lower"), limits.pop("upper")
        remarks.append(f"its limits {lower:g} and {upper:g} leave no room: taken as not stated")
    for k in ("effort", "velocity"):
        if limits.get(k) == 0.0:
            remarks.append(f"{k} {limits.pop(k):g}: taken as not stated")
    order = {"lower": "lower", "upper": "upper", "speed": "velocity", "effort": "effort"}
    stated = {name: limits[k] for name, k in order.items() if k in limits}
    friction: dict[str, Any] = {"viscous": axis.damping} if axis.damping else {}
    if axis.friction:
        friction |= {"coulomb": axis.friction, "law": "set_valued"}
    spring = {"stiffness": axis.stiffness, "rest": axis.rest} if axis.stiffness else {}
    parts = {"limits": stated, "friction": friction, "spring": spring}
    return {key: part for key, part in parts.items() if part}
