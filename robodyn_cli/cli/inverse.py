"""``robodyn inverse``."""

from __future__ import annotations

from robodyn_cli.cli.describe import describe_inverse
from robodyn_cli.cli.scene_command import scene_command

command = scene_command("inverse", "Torques that a motion needs (inverse dynamics).", describe_inverse)
