"""Checks of loops, couplers, forces and payloads, and of the points that formulas name."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from robodyn_cli.expr.formula import formulas_at, points_of
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.points import BASE, carrier, point_link, point_problem
from robodyn_cli.scene.text.nodes import Path
from robodyn_cli.scene.types import Robot, Scene

if TYPE_CHECKING:
    from robodyn_cli.scene.robot_parts import Coupler


def check_elements(scene: Scene, check: Check) -> Scene:
    """Return the scene with the couplers and loops of its robot among its own.

    Few scenes have any of what is checked here.
    """
    couplers, loops = parts_of(scene, "couplers"), parts_of(scene, "loops")
    scene = dataclasses.replace(scene, couplers=tuple(couplers.values()), loops=tuple(loops.values()))
    check_loops(scene.robot, loops, check)
    check_couplers(scene, couplers, check)
    check_forces(scene, check)
    if scene.payloads:
        from robodyn_cli.scene.checks.carried import check_payloads

        check_payloads(scene, check)
    check_points_of_formulas(scene, check)
    return scene


def check_loops(robot: Robot, loops: dict[Path, Any], check: Check) -> None:
    """Names appear once; each loop joins points of two links."""
    check.unique([loop.name for loop in loops.values()], "loop", [(*path, "name") for path in loops])
    for path, loop in loops.items():
        with check:
            for k, reference in enumerate(loop.between):
                problem = point_problem(robot, reference)
                if problem is not None:
                    check.fail((*path, "between", k), problem)
            first, second = (point_link(robot, reference) for reference in loop.between)
            if first == second:
                check.fail((*path, "between"), f"both points are on {first!r}; a loop joins two links")


def parts_of(scene: Scene, kind: str) -> dict[Path, Any]:
    """Return couplers or loops of the robot and of the scene by their places; they are those of the checked scene."""
    robot: dict[Path, Any] = {("robot", kind, k): x for k, x in enumerate(getattr(scene.robot, kind))}
    return robot | {(kind, k): x for k, x in enumerate(getattr(scene, kind))}


def check_couplers(scene: Scene, couplers: dict[Path, Coupler], check: Check) -> None:
    """Joints exist and have one coordinate; coefficients are not zero; names appear once, among loops too."""
    names = [coupler.name for coupler in couplers.values()]
    check.unique(names, "coupler", [(*path, "name") for path in couplers])
    kinds = {joint.name: joint.type for joint in scene.robot.joints}
    joints = [name for name, kind in kinds.items() if kind in joint_types and joint_types[kind].nq == 1]
    loops = [loop.name for loop in scene.loops]
    for path, coupler in couplers.items():
        with check:
            if coupler.name in loops:
                check.fail((*path, "name"), f"{coupler.name!r} is the name of a loop already")
        with check:
            if len(coupler.terms) < 2:
                check.fail(
                    (*path, "terms"), "a coupler relates two joints or more; `prescribed` moves a single one"
                )
        for name, coefficient in coupler.terms.items():
            here: Path = (*path, "terms", name)
            with check:
                if kinds.get(name, "") in joint_types and name not in joints:
                    allowed = ", ".join(joints)
                    text = f"joint {name!r} ({kinds[name]}) has more than one coordinate; allowed: {allowed}"
                    check.fail(here, text, True)
                check.known(name, joints, "joint", here, True)
                if coefficient == 0.0:
                    check.fail(here, "must not be zero (value 0)")


def check_forces(scene: Scene, check: Check) -> None:
    """Refuse forces at unknown places or without effect, and laws that contradict each other."""
    paths: list[Path] = [("forces", k) for k in range(len(scene.forces))]
    check.unique([force.name for force in scene.forces], "force", [(*path, "name") for path in paths])
    for path, force in zip(paths, scene.forces):
        with check:
            _check_places(scene.robot, force, check, path)
        for where, message in force.problems():
            with check:
                check.fail((*path, *where), message)


def check_points_of_formulas(scene: Scene, check: Check) -> None:
    """Points that formulas name exist, and no joint or link has the same name."""
    places: list[tuple[Path, object]] = [
        (("torques", *name.split(".")), x) for name, x in scene.torques.items()
    ]
    places += [(("forces", k), force) for k, force in enumerate(scene.forces)]
    places += [(("payloads", k), payload) for k, payload in enumerate(scene.payloads)]
    places += [(("deploy", "latches", k), latch) for k, latch in enumerate(scene.deploy.latches)]
    places += [(("outputs", "signals", name), x) for name, x in scene.outputs.signals.items()]
    for key in ("law", "state") if scene.control is not None else ():
        places += [(("control", key, name), x) for name, x in getattr(scene.control, key).items()]
    for path, value in places:
        for place, formula in formulas_at(value, path):
            for reference in (point for name in formula.names for point in points_of(name)):
                with check:
                    problem = _clash(scene.robot, reference) or point_problem(scene.robot, reference)
                    if problem:
                        check.fail(place, f"formula {formula.text!r}: {problem}")


def _clash(robot: Robot, reference: str) -> str:
    """Return what else the name of a point may mean in a formula; empty where there is nothing."""
    if reference in [joint.name for joint in robot.joints]:
        point = ", and of a point; rename one of them" if reference in robot.points else ""
        return f"{reference!r} is the name of a joint{point}; a coordinate of a joint is q.{reference}"
    if reference in robot.points and reference in [link.name for link in robot.links]:
        return f"{reference!r} is the name of a point, and of a link; rename one of them"
    return ""


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
