"""What the keys of ``reach`` cannot tell one by one."""

from __future__ import annotations

from robodyn_cli.errors import unknown_name
from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.checks.orientation import check_orientation
from robodyn_cli.scene.nested_options import ReachOptions
from robodyn_cli.scene.points import BASE, point_link, point_problem
from robodyn_cli.scene.robot_types import Robot
from robodyn_cli.scene.text.nodes import Path

REACH: Path = ("reach",)


def check_reach(robot: Robot, options: ReachOptions, check: Check) -> None:
    """Refuse a frame that does not exist or does not move, and a pose of which nothing is asked."""
    with check:
        _check_frame(robot, options.frame, check)
    if options.orientation is not None:
        check_orientation(options.orientation, check, (*REACH, "orientation"))
    with check:
        if options.position is None and options.orientation is None:
            check.fail(REACH, "asks for nothing; give 'position', 'orientation', or both")
    with check:
        if options.axis is not None and options.orientation is None:
            check.fail((*REACH, "axis"), "needs 'orientation' beside it")


def _check_frame(robot: Robot, name: str, check: Check) -> None:
    links = {link.name: link.name for link in robot.links}
    frames = {key: frame.link for key, frame in robot.frames.items()}
    link = frames.get(name) or links.get(name)
    if link is None:
        problem = point_problem(robot, name)
        if problem is not None:
            names = [*robot.points, *frames, *links, "LINK.end"]
            check.fail((*REACH, "frame"), problem if "." in name else unknown_name("frame", name, names))
        link = point_link(robot, name)
    if link == BASE:
        check.fail(
            (*REACH, "frame"),
            f"{name!r} is fixed to the base; allowed: points, frames and links that a joint moves",
        )
