"""Checks of the forces on points and between bodies."""

from __future__ import annotations

from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.points import BASE, point_link, point_problem
from robodyn_cli.scene.text.nodes import Path
from robodyn_cli.scene.types import Robot, Scene


def check_forces(scene: Scene, check: Check) -> None:
    """Refuse forces whose places are unknown or do nothing, and laws that do not fit together."""
    paths: list[Path] = [("forces", k) for k in range(len(scene.forces))]
    check.unique([force.name for force in scene.forces], "force", [(*path, "name") for path in paths])
    for path, force in zip(paths, scene.forces):
        with check:
            _check_places(scene.robot, force, check, path)
        for where, message in force.problems():
            with check:
                check.fail((*path, *where), message)


def _check_places(robot: Robot, force: object, check: Check, path: Path) -> None:
    references: tuple[str, ...] = force.references  # type: ignore[attr-defined]
    one = len(references) == 1
    for k, reference in enumerate(references):
        problem = None if reference in robot.frames else point_problem(robot, reference)
        if problem is not None:
            named = f", {', '.join(robot.frames)}" if robot.frames else ""
            check.fail((*path, "at") if one else (*path, "between", k), problem + named)
    links = [carrier(robot, reference) for reference in references]
    if one and links[0] == BASE:
        check.fail((*path, "at"), f"{references[0]!r} is fixed to the ground, where a force does nothing")
    if not one and links[0] == links[1]:
        check.fail((*path, "between"), f"both places are on {links[0]!r}; a force acts between two links")


def carrier(robot: Robot, reference: str) -> str:
    """Return the link that carries a named frame or a point which resolves."""
    return robot.frames[reference].link if reference in robot.frames else point_link(robot, reference)
