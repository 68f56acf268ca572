"""``robodyn statics``."""

from __future__ import annotations

from robodyn_cli.cli.describe_mechanism import describe_statics
from robodyn_cli.cli.scene_command import scene_command

command = scene_command(
    "statics",
    "The balanced configuration, its stability and its loads, or the torques that hold one.",
    describe_statics,
)
