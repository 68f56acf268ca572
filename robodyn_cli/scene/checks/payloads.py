"""Checks of masses that are picked up and released."""

from __future__ import annotations

from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.payload import Payload
from robodyn_cli.scene.points import BASE, carrier, point_problem
from robodyn_cli.scene.text.nodes import Path
from robodyn_cli.scene.types import Scene


def check_payloads(scene: Scene, check: Check) -> None:
    """Refuse payloads at places that do not move, and times that contradict each other."""
    paths: list[Path] = [("payloads", k) for k in range(len(scene.payloads))]
    check.unique([x.name for x in scene.payloads], "payload", [(*path, "name") for path in paths])
    for path, payload in zip(paths, scene.payloads):
        with check:
            _check_place(scene, payload, path, check)
        _check_instants(payload, path, check)


def _check_place(scene: Scene, payload: Payload, path: Path, check: Check) -> None:
    robot = scene.robot
    problem = None if payload.at in robot.frames else point_problem(robot, payload.at)
    if problem is not None:
        check.fail((*path, "at"), problem + (f", {', '.join(robot.frames)}" if robot.frames else ""))
    if carrier(robot, payload.at) == BASE:
        check.fail((*path, "at"), f"{payload.at!r} is fixed to the ground, which carries all masses alike")


def _check_instants(payload: Payload, path: Path, check: Check) -> None:
    for name, instant in payload.instants.items():
        with check:
            if (instant.time is None) == (instant.when is None):
                check.fail((*path, name), "needs one of 'time' and 'when'")
    with check:
        start, until = (None if x is None else x.time for x in (payload.start, payload.until))
        if start is not None and until is not None and not until > start:
            message = f"must be after 'from' (value {until!r}; gripped at {start!r})"
            check.fail((*path, "until", "time"), message)
    for name in ("velocity", "angular_velocity"):
        with check:
            if payload.start is None and any(getattr(payload, name)):
                check.fail(
                    (*path, name),
                    "is that before it is gripped, and it is carried from the start; add 'from'",
                    True,
                )
