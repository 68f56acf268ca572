"""Checks of what links carry: the shapes that they are drawn with, masses that are picked up and released."""

from __future__ import annotations

from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.nested_options import Payload
from robodyn_cli.scene.points import BASE, carrier, point_problem
from robodyn_cli.scene.robot_parts import Shape
from robodyn_cli.scene.robot_types import Link
from robodyn_cli.scene.text.nodes import Path
from robodyn_cli.scene.types import Scene

KINDS = ("box", "sphere", "cylinder", "outline", "mesh", "obj")


def check_shapes(link: Link, check: Check, path: Path) -> None:
    """Refuse shapes that are none or several, without extent, or whose text is no mesh."""
    for k, shape in enumerate(link.visual):
        with check:
            _check(shape, check, (*path, "visual", k))


def _check(shape: Shape, check: Check, path: Path) -> None:
    given = [kind for kind in KINDS if getattr(shape, kind) is not None]
    if len(given) != 1:
        kinds = " and ".join(map(repr, given)) or "none of its kinds"
        check.fail(path, f"a shape has {kinds}; allowed: one of {', '.join(KINDS)}")
    for key in ("box", "cylinder"):
        sizes = getattr(shape, key)
        if sizes is not None and min(sizes) <= 0.0:
            check.fail(
                (*path, key), f"a size is not positive (value {min(sizes):g}); allowed: numbers > 0 [m]"
            )
    if shape.thickness and shape.outline is None:
        check.fail((*path, "thickness"), "is that of an outline; allowed: beside 'outline'")
    if shape.outline is not None:
        from robodyn_cli.scene.mesh.surfaces import outline_problem

        problem = outline_problem(shape.outline)
        if problem:
            check.fail((*path, "outline"), problem)
    if shape.obj:
        from robodyn_cli.scene.mesh.files import MeshError, read_obj

        try:
            read_obj(shape.obj)
        except MeshError as error:
            check.fail((*path, "obj"), f"this is no mesh: {error}; allowed: lines 'v x y z' and 'f i j k'")


def check_payloads(scene: Scene, check: Check) -> None:
    """Refuse payloads at places that do not move, and times that contradict each other."""
    paths: list[Path] = [("payloads", k) for k in range(len(scene.payloads))]
    check.unique([x.name for x in scene.payloads], "payload", [(*path, "name") for path in paths])
    for path, payload in zip(paths, scene.payloads):
        with check:
            _check_place(scene, payload, path, check)
        _check_instants(payload, scene, path, check)
        with check:
            if payload.plane is not None and payload.until is None:
                check.fail((*path, "range"), "ends its flight, and it is not released; add 'until'", True)
            if payload.plane is not None and payload.plane.normal is None and not any(scene.gravity):
                check.fail((*path, "range"), "key 'normal' is missing: without gravity no side is up")


def _check_place(scene: Scene, payload: Payload, path: Path, check: Check) -> None:
    robot = scene.robot
    problem = None if payload.at in robot.frames else point_problem(robot, payload.at)
    if problem is not None:
        check.fail((*path, "at"), problem + (f", {', '.join(robot.frames)}" if robot.frames else ""))
    if carrier(robot, payload.at) == BASE:
        check.fail((*path, "at"), f"{payload.at!r} is fixed to the ground, which carries all masses alike")


def _check_instants(payload: Payload, scene: Scene, path: Path, check: Check) -> None:
    for name, instant in payload.instants.items():
        with check:
            if (instant.time is None) == (instant.when is None):
                check.fail((*path, name), "needs one of 'time' and 'when'")
            check.varies(instant.when, scene.parameters, (*path, name, "when"))
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
