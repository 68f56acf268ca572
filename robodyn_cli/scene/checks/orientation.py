"""Checks of how frames are turned: one form, and a rotation."""

from __future__ import annotations

from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.robot_types import Orientation
from robodyn_cli.scene.text.nodes import Path
from robodyn_cli.spatial.orientation import orientation_problems


def check_orientation(given: Orientation, check: Check, path: Path) -> None:
    """Refuse an orientation in no form, in several, or that is no rotation."""
    for where, message in orientation_problems(given):
        with check:
            check.fail((*path, *where), message)
