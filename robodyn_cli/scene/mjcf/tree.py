"""The robot of a compiled MJCF as the tree of a scene's ``robot``: every value knows the line that it comes from.

The poses of the file are q = 0: what MuJoCo counts from ``ref`` is that much more. A body with several joints is a
chain of massless links, one for each joint but the last. A link has the axes of its body, and its origin where the
joint that turns it last is.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.scene.dialects import RobotTree
from robodyn_cli.scene.mjcf.acting import SINGLE, Acting
from robodyn_cli.scene.mjcf.compiled import MjcfModel
from robodyn_cli.scene.mjcf.ties import MjcfEnds, ties_of
from robodyn_cli.scene.sdf.frames import cleaned
from robodyn_cli.scene.text.nodes import Faults, plain, sequence
from robodyn_cli.scene.text.nodes import Mapping as MappingNode
from robodyn_cli.scene.ties import rpy_of, tie_entries
from robodyn_cli.scene.urdf.elements import Inertial, UrdfLink, UrdfPose, UrdfShape
from robodyn_cli.scene.urdf.tree import LinkEntries, moved_along, origin_of
from robodyn_cli.scene.urdf.xml import GROUND, XmlElement, joint_names, link_names, scene_names
from robodyn_cli.spatial.algebra import Array

TYPES = {"free": "floating", "ball": "spherical", "slide": "prismatic", "hinge": "revolute"}
_ROUNDING = 1e-15
_MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")


@record
class MjcfJoint:
    """A joint of the tree, the ``number``-th of the file, None for one that holds a body; its names are whole ones.

    origin : of the link that it moves, in the frame of its parent.
    """

    number: int | None
    name: str
    body: int
    parent: str
    link: str
    origin: UrdfPose


def robot_tree(compiled: MjcfModel, acting: Acting, faults: Faults) -> RobotTree:
    """Return the tree of a model; what of it is not read and acts on the motion is reported."""
    return _MjcfTree(compiled, acting, faults).tree()


class _MjcfTree:
    def __init__(self, compiled: MjcfModel, acting: Acting, faults: Faults) -> None:
        self.compiled, self.m, self.acting, self.faults = compiled, compiled.model, acting, faults
        m = self.m
        self.bodies = _named((compiled.name("body", b) for b in range(m.nbody)), lambda b: f"body{b}")
        still = [b for b in range(1, m.nbody) if not m.body_jntnum[b]]
        owners = [*m.jnt_bodyid, *still]
        kinds = [*acting.types, *("fixed" for _ in still)]
        given = [*(compiled.name("joint", j) for j in range(m.njnt)), *("" for _ in still)]
        self.names = _named(given, lambda k: f"{self.bodies[owners[k]]}_{kinds[k]}")
        self.fixed = dict(zip(still, self.names[m.njnt :]))
        self.seats: list[Array] = [np.zeros(3)]
        self.taken = {*self.bodies}
        self.steps = [step for b in range(1, m.nbody) for step in self.steps_to(b)]
        self.joints = joint_names(self.names)
        self.links = {self.bodies[0]: GROUND} | link_names(step.link for step in self.steps)
        self.remarks: dict[str, list[str]] = {}

    def steps_to(self, b: int) -> Iterator[MjcfJoint]:
        """Yield the joints of a body, and note where the origin of its link is in its frame."""
        m, body = self.m, self.bodies[b]
        parent, above = self.bodies[m.body_parentid[b]], self.seats[m.body_parentid[b]]
        first = pose(m.body_pos[b], m.body_quat[b])
        start = int(m.body_jntadr[b])
        numbers: list[int | None] = [*range(start, start + int(m.body_jntnum[b]))]
        numbers = numbers or [None]
        seat = np.zeros(3)
        for j in numbers:
            before = seat
            if j is not None and self.acting.types[j] in ("hinge", "ball"):
                seat = m.jnt_pos[j]
            name = self.fixed[b] if j is None else self.names[j]
            link = body if j == numbers[-1] else f"{body}::{name}"
            while link != body and link in self.taken:
                link += "_"
            self.taken.add(link)
            if j == numbers[0]:
                moved = m.body_pos[b] - above + (first.rotation @ seat if seat.any() else 0.0)
                origin = pose(moved, m.body_quat[b])
            else:
                origin = pose(seat - before)
            yield MjcfJoint(j, name, b, parent, link, origin)
            parent = link
        self.seats.append(seat)

    def tree(self) -> RobotTree:
        source = self.compiled.source
        place = source.root.place
        own = [self.link(b) for b in range(1, self.m.nbody)]
        folder = os.path.dirname(os.path.abspath(place.source.name))
        shapes = {link.name: [(shape, "") for shape in link.visual or link.collision] for link in own}
        written = LinkEntries(self.links, shapes, folder, "MJCF")
        moved = {link.name: link for link in own}
        links = [
            written.link(moved[step.link]) if step.link in moved else self.between(step, written)
            for step in self.steps
        ]
        ends = MjcfEnds(self.bodies, self.seats, [self.joints[x] for x in self.names[: self.m.njnt]])
        ties, held = ties_of(self.compiled, self.acting, ends, self.faults)
        joints = [self.joint(step, held.get(self.joints[step.name])) for step in self.steps]
        entries: dict[str, Any] = {"joints": sequence(place, joints), "links": sequence(place, links)}
        entries |= tie_entries(ties, self.joints.values(), self.links)
        frames = self.frames(entries.get("points", ()))
        entries |= {"frames": frames} if frames else {}
        return RobotTree(plain(place, entries), self.remarks, written.remarks)

    # -- links ------------------------------------------------------------------------------------------
    def between(self, step: MjcfJoint, written: LinkEntries) -> MappingNode:
        """Return a link between two joints of a body."""
        name = self.links[step.link]
        written.remarks[name] = [f"massless: between two joints of {self.bodies[step.body]!r}"]
        return plain(self.element("body", step.body).place, {"name": name, "mass": 0.0})

    def link(self, b: int) -> UrdfLink:
        m, element = self.m, self.element("body", b)
        inertial = None
        if m.body_mass[b]:
            R = pose((), m.body_iquat[b]).rotation
            tensor = R @ np.diag(m.body_inertia[b]) @ R.T
            tensor[np.abs(tensor) < _ROUNDING * np.trace(tensor)] = 0.0
            moments = {key: float(tensor["xyz".index(key[0]), "xyz".index(key[1])]) for key in _MOMENTS}
            given = next(iter(element.all("inertial")), element)
            at = UrdfPose(tuple(float(x) + 0.0 for x in m.body_ipos[b] - self.seats[b]))
            inertial = Inertial(given, float(m.body_mass[b]), at, moments)
        start = int(m.body_geomadr[b])
        shapes = [x for g in range(start, start + int(m.body_geomnum[b])) for x in self.shape(g)]
        visual, collision = (tuple(x for x, collides in shapes if collides == c) for c in (False, True))
        return UrdfLink(element, self.bodies[b], inertial, visual, collision)

    def shape(self, g: int) -> Iterator[tuple[UrdfShape, bool]]:
        """Yield the shape of a geom that can be drawn, and whether it collides."""
        import mujoco

        m, kinds = self.m, mujoco.mjtGeom
        size = [float(x) for x in m.geom_size[g]]
        shapes = {
            int(kinds.mjGEOM_BOX): ("box", tuple(2.0 * x for x in size)),
            int(kinds.mjGEOM_SPHERE): ("sphere", (size[0],)),
            int(kinds.mjGEOM_CYLINDER): ("cylinder", (size[0], 2.0 * size[1])),
            int(kinds.mjGEOM_CAPSULE): ("cylinder", (size[0], 2.0 * size[1])),
        }
        if (number := int(m.geom_type[g])) in shapes:
            kind, sizes = shapes[number]
            place = pose(m.geom_pos[g] - self.seats[m.geom_bodyid[g]], m.geom_quat[g])
            collides = bool(m.geom_contype[g] or m.geom_conaffinity[g])
            yield UrdfShape(self.element("geom", g), kind, sizes, pose=place), collides

    def frames(self, points: Iterable[str]) -> dict[str, MappingNode]:
        """Return the sites with names as ``frames``."""
        m = self.m
        sites = {self.compiled.name("site", s): s for s in range(m.nsite)}
        sites.pop("", None)
        frames = {}
        for name, new in scene_names(sites, points).items():
            s = sites[name]
            b = m.site_bodyid[s]
            placed = pose(m.site_pos[s] - self.seats[b], m.site_quat[s])
            rpy = [cleaned(x) for x in rpy_of(placed.rotation.tolist())]
            entry = {"link": self.links[self.bodies[b]], "at": placed.xyz, "rpy": rpy}
            frames[new] = plain(self.element("site", s).place, entry)
        return frames

    def element(self, kind: str, number: int) -> XmlElement:
        return self.compiled.elements[kind].get(number, self.compiled.source.root)

    # -- joints -----------------------------------------------------------------------------------------
    def joint(self, step: MjcfJoint, held: float | None) -> MappingNode:
        """Return a joint; one that is ``held`` at a position is fixed there."""
        name, j = self.joints[step.name], step.number
        remarks = self.remarks.setdefault(name, [])
        element = self.element("body", step.body) if j is None else self.element("joint", j)
        if j is not None and (given := self.compiled.name("joint", j)) not in ("", name):
            remarks.append(f"in the MJCF: {given!r}")
        origin, own = step.origin, {}
        kind = "fixed" if j is None or held is not None else TYPES[self.acting.types[j]]
        if j is not None and held is not None:
            remarks.append(f"held at {held!r} by an equality of the MJCF")
            origin = moved_along(origin, self.m.jnt_axis[j], held, self.acting.types[j] == "slide")
        elif j is not None:
            if self.acting.types[j] in SINGLE:
                own["axis"] = tuple(float(x) + 0.0 for x in self.m.jnt_axis[j])
            with self.faults:
                own |= self.acting.of(j, element, remarks)
        names = {"name": name, "type": kind, "parent": self.links[step.parent], "link": self.links[step.link]}
        return plain(element.place, {**names, **origin_of(element.place, origin), **own})


def _named(given: Iterable[str], invented: Any) -> list[str]:
    """Return names, each once, with others in the place of those that are empty."""
    names = list(given)
    taken = set(names)
    for k, name in enumerate(names):
        if not name:
            wanted = new = invented(k)
            number = 1
            while new in taken:
                number += 1
                new = f"{wanted}{number}"
            taken.add(new)
            names[k] = new
    return names


def pose(xyz: Any, quaternion: Any = (1.0, 0.0, 0.0, 0.0)) -> UrdfPose:
    """Return a pose of the compiler's numbers; those of no rotation are left out."""
    turned = tuple(float(x) for x in quaternion)
    none = abs(turned[0]) == 1.0 and not any(turned[1:])
    return UrdfPose(tuple(float(x) + 0.0 for x in xyz), quaternion=None if none else turned)
