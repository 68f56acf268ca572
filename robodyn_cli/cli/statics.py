"""``robodyn statics``."""

from __future__ import annotations

from robodyn_cli.cli.describe_mechanism import describe_statics
from robodyn_cli.cli.scene_command import scene_command

command = scene_command(
    "statics",
    "Balance and its stability, or torques that hold a pose.",
    describe_statics,
)
