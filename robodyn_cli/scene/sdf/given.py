"""What elements of an SDF have in common: names in scopes, frames that attributes name, poses, texts and flags."""

from __future__ import annotations

import math

from robodyn_cli.errors import shown, unknown_name
from robodyn_cli.scene.sdf.frames import WORLD, Scope
from robodyn_cli.scene.urdf.elements import UrdfPose, turned_by
from robodyn_cli.scene.urdf.xml import XmlElement

FRAMES_SINCE = 7  # relative_to, attached_to and expressed_in; joints have frames with names


class SdfReading:
    """How elements are read in a version 1.``version`` of SDF."""

    def __init__(self, version: int) -> None:
        self.version = version

    def name(self, element: XmlElement) -> str:
        name = element.text("name", f"a {element.tag}")
        last = name.rpartition("::")[2]
        if last == WORLD or (last.startswith("__") and last.endswith("__")):
            raise element.error(f"{element.tag} {name!r}: this name is reserved; allowed: another one")
        return name

    def reference(self, element: XmlElement, attribute: str, scope: Scope) -> str:
        """Return the whole name of the frame that an attribute names, empty without one."""
        name = element.attributes.get(attribute, "").strip()
        if name and self.version < FRAMES_SINCE:
            problem = f"means nothing in SDF 1.{self.version}; allowed: from 1.{FRAMES_SINCE} on"
            raise element.error(f"{attribute} of <{element.tag}> {problem}")
        return scope.whole(name) if name else ""

    def pose(self, element: XmlElement, owner: str, scope: Scope) -> tuple[UrdfPose, str]:
        """Return the pose of an element, and the whole name of the frame that it is given in, empty without one."""
        pose = element.one("pose", owner)
        if pose is None:
            return UrdfPose(), ""
        relative = self.reference(pose, "relative_to", scope)
        turned = pose.attributes.get("rotation_format", "euler_rpy").strip()
        if turned not in ("euler_rpy", "quat_xyzw"):
            raise pose.error(
                f"{owner}: {unknown_name('rotation_format', turned, ('euler_rpy', 'quat_xyzw'))}"
            )
        if not pose.content.strip():
            return UrdfPose(), relative
        if turned == "euler_rpy":
            numbers = pose.values(owner, 6)
            degrees = is_true(pose, pose.attributes.get("degrees", "false"), owner)
            rpy = tuple(math.radians(x) if degrees else x for x in numbers[3:])
            return UrdfPose(tuple(numbers[:3]), rpy), relative
        numbers = pose.values(owner, 7)
        return turned_by(pose, f"{owner}: the quaternion of <pose>", numbers[:3], numbers[3:]), relative


def text_of(element: XmlElement, tag: str, owner: str) -> str:
    child = element.one(tag, owner)
    if child is None or not child.content.strip():
        raise (child or element).error(f"{owner} needs <{tag}>NAME</{tag}>")
    return child.content.strip()


def is_true(element: XmlElement, text: str, owner: str) -> bool:
    word = text.strip().lower()
    if word not in ("true", "false", "1", "0"):
        raise element.error(f"{owner}: {shown(text.strip())} in <{element.tag}>; allowed: true, false, 1, 0")
    return word in ("true", "1")


def flag(element: XmlElement, tag: str, owner: str, default: bool = False) -> bool:
    child = element.one(tag, owner)
    return default if child is None else is_true(child, child.content, owner)
