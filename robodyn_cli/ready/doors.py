"""Scenes made ready for equations along a motion that is given, and for those of a pose.

Nothing else calls the steps that these take, so that each way into the equations takes all of them.
"""

from __future__ import annotations

import dataclasses

from robodyn_cli.given.motion import led_by
from robodyn_cli.scene.types import Ready, Scene


def along(scene: Scene) -> Ready:
    """Return the scene with its trajectory in time, of joints or of a point, and prescribed motions by formulas alone.

    Raises
    ------
    RobodynError : see ``motion_in_time``, of a trajectory that lacks its times, or the motion of joints in its parts.
    """
    trajectory = scene.trajectory
    if trajectory is not None and not trajectory.in_time:
        from robodyn_cli.ready.in_time import motion_in_time

        trajectory = motion_in_time(scene)
    return led_by(scene, trajectory)


def at_rest(scene: Scene) -> Ready:
    """Return the scene without its controller, for a pose of the mechanism itself."""
    return Ready(scene if scene.control is None else dataclasses.replace(scene, control=None))
