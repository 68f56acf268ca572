"""``robodyn deploy``."""

from __future__ import annotations

from robodyn_cli.cli.describe import describe_deploy
from robodyn_cli.cli.scene_command import scene_command

command = scene_command(
    "deploy", "Simulate a mechanism with loops until it locks.", describe_deploy, integrates=True
)
