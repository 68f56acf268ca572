"""Point references: ``tip``, ``link.origin``, ``link.end``, ``link.com``, ``base.origin``, ``base.tip``."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from robodyn_cli.errors import SceneError, did_you_mean, listed
from robodyn_cli.scene.types import Joint, Point, Robot, Scene

BASE = "base"
BUILT_IN = ("origin", "end", "com")


class PartlyRead(dict[str, Point]):
    """The points of a robot of which others could not be read: a name that is not here may be right."""


def joint_of(robot: Robot, link: str) -> Joint | None:
    """Return the joint that moves a link (of a checked robot, where every joint names its link)."""
    return next((joint for joint in robot.joints if joint.link == link), None)


def spot_problem(robot: Robot, link: str, at: str) -> str | None:
    """Tell why a link has no ``origin``, ``end`` or ``com``, or return None."""
    if link == BASE:
        return (
            None
            if at == "origin"
            else f"'base' has no {at!r}; allowed: base.origin, or a point defined on base"
        )
    joint = joint_of(robot, link)
    if at == "end" and joint is not None and not joint.has_dh:
        return (
            f"{link!r} has no 'end', because joint {joint.name!r} has no D-H parameters; "
            f"define a named point: points: {{tip: {{link: {link}, at: [x, y, z]}}}}"
        )
    if at == "end" and joint is not None and robot.convention == "modified":
        return (
            f"{link!r} has no 'end': with modified D-H parameters the link frame lies at the link's own joint, and "
            f"its far end is nowhere given; define a named point: points: {{tip: {{link: {link}, at: [x, y, z]}}}}"
        )
    if at == "com" and next(x for x in robot.links if x.name == link).com is None:
        return f"the centre of mass of {link!r} is not given; add 'com' to that link"
    return None


def point_problem(robot: Robot, reference: str) -> str | None:
    """Tell why a reference to a point does not resolve, or return None.

    Raises
    ------
    SceneError : it may be one that could not be read, so that the error follows from that.
    """
    if reference in robot.points:
        return None
    links = [BASE, *[link.name for link in robot.links]]
    link, dot, at = reference.partition(".")
    if not dot:
        hint = did_you_mean(reference, robot.points)
        if link in links:
            hint = f"; it is a link: write {link + '.origin' if link == BASE else link + '.end'!r}"
        return _unknown(robot, reference, hint)
    if link not in links:
        return f"unknown link {link!r} in {reference!r}{did_you_mean(link, links)}; allowed: {listed(links)}"
    if at in BUILT_IN:
        return spot_problem(robot, link, at)
    if at in robot.points:
        if robot.points[at].link == BASE == link:
            return None
        return f"{reference!r} is no point: {at!r} is fixed to {robot.points[at].link!r}; write {at!r} alone"
    return _unknown(robot, reference, did_you_mean(at, [*BUILT_IN, *robot.points]))


def point_link(robot: Robot, reference: str) -> str:
    """Return the link that carries a point which resolves."""
    return robot.points[reference].link if reference in robot.points else reference.partition(".")[0]


def carrier(robot: Robot, reference: str) -> str:
    """Return the link that carries a named frame or a point which resolves."""
    return robot.frames[reference].link if reference in robot.frames else point_link(robot, reference)


def joints_between(robot: Robot, first: str, second: str) -> set[str]:
    """Return the joints that move one point or frame against another (of a checked robot), fixed ones among them."""
    below: list[set[str]] = []
    for reference in (first, second):
        link, joints = carrier(robot, reference), set()
        while link != BASE and (joint := joint_of(robot, link)) is not None:
            joints.add(joint.name)
            link = joint.parent or BASE
        below.append(joints)
    return below[0] ^ below[1]


def _unknown(robot: Robot, reference: str, hint: str) -> str:
    message = f"unknown point {reference!r}{hint}"
    if isinstance(robot.points, PartlyRead):
        raise SceneError(message, follows=True)
    allowed = ", ".join([*robot.points, "LINK.origin", "LINK.end", "LINK.com", "base.origin"])
    return f"{message}; allowed: {allowed}"


def with_points(scene: Scene, references: Sequence[str]) -> Scene:
    """Return the scene with points that are referred to (as ``link2.end``), and origins of frames, among its points."""
    points = dict(scene.robot.points)
    for reference in references:
        frame = scene.robot.frames.get(reference)
        if frame is not None:  # its origin is a point like others
            points[reference] = Point(link=frame.link, at=frame.at, frame=frame.frame)
            continue
        link, _, at = reference.partition(".")
        # ``base.NAME`` is a named point too
        known = points.get(reference) or points.get(at)
        points[reference] = known or Point(link=link, at=at)
    if len(points) == len(scene.robot.points):
        return scene
    return dataclasses.replace(scene, robot=dataclasses.replace(scene.robot, points=points))
