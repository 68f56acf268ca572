"""Scenes made ready to be integrated."""

from __future__ import annotations

from robodyn_cli.model.consistency import refuse_immovable
from robodyn_cli.scene.types import Ready, Scene
from robodyn_cli.tools.progress import Stopwatch
from robodyn_cli.trajectories.led import Follows


def integrable(scene: Scene, watch: Stopwatch | None = None) -> Ready:
    """Return the scene with the motion of joints that follow a path, and with what its controller follows and the
    numbers of its law.

    Baumgarte's gains that are left to the run are chosen by an integration, hence later (``build_motion``).

    Raises
    ------
    SceneError : no joint of the robot moves. RobodynError : see ``with_motion_found`` and ``with_controller_ready``.
    """
    refuse_immovable(scene)
    watch = watch or Stopwatch()
    if any(isinstance(x, Follows) and x.followed is None for x in scene.prescribed.values()):
        from robodyn_cli.ready.in_time import with_motion_found

        with watch.stage("solve"):
            scene = with_motion_found(scene)
    if scene.control is not None:
        from robodyn_cli.ready.controllers import with_controller_ready

        with watch.stage("solve"):
            scene = with_controller_ready(scene)
    return Ready(scene)
