"""The frames of an SDF by their whole names: where each is in the world, and what it moves with.

A name inside nested models has the names of these before it, with ``::``. Chains of frames are followed without
recursion, for a file may have any number of them.
"""

from __future__ import annotations

from typing import Any

from robodyn_cli.errors import did_you_mean, shown
from robodyn_cli.record import record
from robodyn_cli.scene.ties import rpy_of
from robodyn_cli.scene.urdf.elements import UrdfPose
from robodyn_cli.scene.urdf.xml import XmlElement

WORLD = "world"
MODEL = "__model__"
_ROUNDING = 1e-15


@record
class Scope:
    """A model or the world: what names inside it begin with, and the name of its own frame."""

    prefix: str
    frame: str
    static: bool = False

    def whole(self, name: str) -> str:
        """Return the whole name of a frame that is named in this scope."""
        if name == WORLD:
            return WORLD
        own = name.removesuffix(f"::{MODEL}")
        return self.frame if own == MODEL else self.prefix + own


@record
class SdfFrame:
    """A frame at ``pose`` in the frame ``relative_to``, which moves with ``attached_to`` (itself: a link).

    placement : of a model, the frame in it whose pose this is; empty for its own.
    """

    element: XmlElement
    name: str
    pose: UrdfPose
    relative_to: str
    attached_to: str
    placement: str = ""


class SdfFrames:
    """All frames of a file; the world is one of them."""

    def __init__(self, root: XmlElement) -> None:
        self.frames = {WORLD: SdfFrame(root, WORLD, UrdfPose(), WORLD, WORLD)}
        self._poses: dict[str, Any] = {WORLD: matrix(UrdfPose())}
        self._bodies = {WORLD: WORLD}
        self._circles: set[str] = set()

    def add(self, frame: SdfFrame) -> None:
        """Add a frame.

        Raises
        ------
        SceneError : its name is taken.
        """
        if frame.name in self.frames:
            raise frame.element.error(
                f"{frame.name!r} names two of the links, joints, frames and models; allowed: one"
            )
        self.frames[frame.name] = frame

    def _known(self, frame: SdfFrame, name: str, why: str) -> str:
        if name not in self.frames:
            hint = did_you_mean(name, self.frames)
            raise frame.element.error(
                f"{frame.name!r} is {why} {shown(name)}, which is no frame of this file{hint}"
            )
        return name

    def pose(self, frame: SdfFrame) -> Any:
        """Return the pose (4, 4) of a frame in the world.

        Raises
        ------
        SceneError : the frames that it is given in go in a circle, or one is not there.
        """
        chain: dict[str, SdfFrame] = {}
        while frame.name not in self._poses:
            if frame.name in chain:
                raise frame.element.error(f"the pose of {frame.name!r} is given relative to itself")
            chain[frame.name] = frame
            frame = self.frames[self._known(frame, frame.relative_to, "placed relative to")]
        for one in reversed(chain.values()):
            self._poses[one.name] = self._poses[one.relative_to] @ self._local(one)
        return self._poses[next(iter(chain), frame.name)]

    def _local(self, frame: SdfFrame) -> Any:
        """Return the pose (4, 4) of a frame in the one that it is given in."""
        if not frame.placement:
            return matrix(frame.pose)
        inner, name = matrix(UrdfPose()), self._known(frame, frame.placement, "placed by")
        passed: set[str] = set()
        while name != frame.name:
            if name == WORLD or name in passed:
                raise frame.element.error(
                    f"the placement frame {shown(frame.placement)} is not in the model's frame"
                )
            passed.add(name)
            one = self.frames[name]
            inner = self._local(one) @ inner
            name = self._known(one, one.relative_to, "placed relative to")
        return matrix(frame.pose) @ inverse(inner)

    def body(self, frame: SdfFrame) -> str:
        """Return the link that a frame moves with, or the world.

        Raises
        ------
        SceneError : the frames that it is attached to go in a circle, or one is not there.
        """
        chain: dict[str, None] = {}
        name = frame.name
        while name not in self._bodies:
            if name in chain or name in self._circles:
                self._circles |= chain.keys()
                raise frame.element.error(f"{name!r} is attached to itself, and to no link")
            chain[name] = None
            above = self._known(frame, frame.attached_to, "attached to")
            if above == name and frame.element.tag == "link":
                self._bodies[name] = name
                break
            name, frame = above, self.frames[above]
        body = self._bodies[name]
        self._bodies |= dict.fromkeys(chain, body)
        return body


# -- poses as matrices -------------------------------------------------------------------------------------
def matrix(pose: UrdfPose) -> Any:
    """Return a pose as a matrix (4, 4)."""
    import numpy as np

    T = np.eye(4)
    T[:3, :3], T[:3, 3] = pose.rotation, pose.xyz
    return T


def inverse(T: Any) -> Any:
    """Return the inverse of a pose (4, 4)."""
    import numpy as np

    back = np.eye(4)
    back[:3, :3], back[:3, 3] = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
    return back


def between(first: Any, second: Any) -> Any:
    """Return the pose (4, 4) of the second frame in the first; what is rounding alone is 0."""
    T = inverse(first) @ second
    scale = max(1.0, *(abs(float(x)) for pose in (first, second) for x in pose[:3, 3]))
    T[:3, 3] = [cleaned(float(x), scale) for x in T[:3, 3]]
    T[:3, :3] = [[cleaned(float(x)) for x in row] for row in T[:3, :3]]
    return T


def cleaned(x: float, scale: float = 1.0) -> float:
    """Return 0, 1 or -1 for what differs from it by rounding, else the number."""
    near = round(x) if abs(x) < 2.0 and scale == 1.0 else 0
    return float(near) if abs(x - near) <= _ROUNDING * scale else x


def pose_between(T: Any) -> UrdfPose:
    """Return a matrix (4, 4) as a pose."""
    xyz = tuple(float(x) for x in T[:3, 3])
    return UrdfPose(xyz, tuple(cleaned(x) for x in rpy_of(T[:3, :3].tolist())))
