"""``robodyn kinematics``."""

from __future__ import annotations

from robodyn_cli.cli.describe_mechanism import describe_kinematics
from robodyn_cli.cli.scene_command import scene_command

command = scene_command(
    "kinematics",
    "Motion without forces, mobility, transmission.",
    describe_kinematics,
)
