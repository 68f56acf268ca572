"""``robodyn simulate``."""

from __future__ import annotations

from robodyn_cli.cli.describe import describe_simulate
from robodyn_cli.cli.scene_command import scene_command

command = scene_command(
    "simulate", "Motion that the torques give (forward dynamics).", describe_simulate, integrates=True
)
