"""Checks of couplers, and of points that move by formulas."""

from __future__ import annotations

from robodyn_cli.joints.registry import joint_types
from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.points import BASE
from robodyn_cli.scene.text.nodes import Path
from robodyn_cli.scene.types import Scene


def check_couplers(scene: Scene, check: Check) -> None:
    """Joints exist and have one coordinate; coefficients are not zero; names stand once, among loops too."""
    paths: list[Path] = [("couplers", k) for k in range(len(scene.couplers))]
    names = [coupler.name for coupler in scene.couplers]
    check.unique(names, "coupler", [(*path, "name") for path in paths])
    kinds = {joint.name: joint.type for joint in scene.robot.joints}
    joints = [name for name, kind in kinds.items() if kind in joint_types and joint_types[kind].nq == 1]
    loops = [loop.name for loop in scene.loops]
    for path, coupler in zip(paths, scene.couplers):
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


def check_moving_points(scene: Scene, check: Check) -> None:
    """Only points of the base move by formulas, and only loops join them."""
    for name, point in scene.robot.points.items():
        with check:
            if point.motion is not None and point.link != BASE:
                check.fail(
                    ("robot", "points", name, "motion"),
                    f"only points on 'base' move by formulas (this one is on {point.link!r}); let a prescribed joint "
                    "move it",
                )
    moving = {name for name, point in scene.robot.points.items() if point.motion is not None}
    moving |= {f"base.{name}" for name in moving}
    for k, force in enumerate(scene.forces):
        with check:
            for reference in force.references:
                if reference in moving:
                    text = f"{reference!r} moves by formulas; forces act on fixed points, loops may join moving ones"
                    check.fail(("forces", k), text)
