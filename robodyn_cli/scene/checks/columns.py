"""The columns over time that a run of a scene has, as exports call them (``q.theta1``, ``points/tip.x``), and those
whose extremes a scene asks for.

A vector has its length, ``point_velocities/tip.length``, a wrench its ``force`` and ``moment``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from robodyn_cli.commands import COMMANDS
from robodyn_cli.errors import did_you_mean
from robodyn_cli.scene.checks.check import EXTREMES, Check
from robodyn_cli.scene.checks.robot import columns
from robodyn_cli.scene.points import BASE, point_link
from robodyn_cli.scene.types import Scene

if TYPE_CHECKING:
    from robodyn_cli.scene.nested_options import KinematicDesign

LENGTH, FORCE, MOMENT = "length", "force", "moment"
VECTOR = ("x", "y", "z", LENGTH)
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz", FORCE, MOMENT)
DESIGNED = ("poles/", "acceleration_poles/", "relative_rates/", "curvatures/", "ratios/", "pressure_angles/")
LOADS = ("reactions/", "loop_reactions/", "base_wrench")
WITHOUT_FORCES = ("q.", "qd.", "qdd.", "point", "frames/", "transmission_angle", *DESIGNED)


def column_names(scene: Scene, points: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the columns of runs of a scene's command; ``points`` : of which they tell where they are."""
    names = _named(scene, points)
    if scene.command is None:
        return tuple(names)
    integrated = COMMANDS[scene.command].streamed
    return tuple(
        name
        for name in names
        if (
            not name.startswith(("transmission_angle", *DESIGNED))
            if integrated
            else name.startswith(WITHOUT_FORCES)
        )
    )


def _named(scene: Scene, points: tuple[str, ...]) -> Iterator[str]:
    for path, own in _datasets(scene, points).items():
        yield from (f"{path}.{name}" if name else path for name in own)


def _datasets(scene: Scene, points: tuple[str, ...]) -> Mapping[str, tuple[str, ...]]:
    """Return the names of columns by dataset; an empty one of a dataset that is a column itself."""
    robot, rates = scene.robot, columns(scene.robot, velocities=True)
    moving = [name for name in points if _moves(scene, name)]
    tracked, driven = _controlled(scene)
    elements = tuple(force.name for force in scene.forces)
    alone = [*(f"energy/{x}" for x in ("kinetic", "potential", "total", "work")), "transmission_angle"]
    return {
        "q": columns(robot), "qd": rates, "qdd": rates, "tau": rates,
        **{f"points/{name}": VECTOR for name in points},
        **{f"point_{kind}/{name}": VECTOR for kind in ("velocities", "accelerations") for name in moving},
        **{f"frames/{name}/position": VECTOR for name in robot.frames},
        **{f"frames/{name}/twist": ("wx", "wy", "wz", "vx", "vy", "vz") for name in robot.frames},
        **{f"signals/{name}": ("",) for name in scene.outputs.signals},
        **{f"control/{kind}": tracked for kind in ("reference", "error")},
        "control/torque": driven,
        "forces/potential": elements, "forces/power": elements,
        **{f"reactions/{joint.name}": WRENCH for joint in robot.joints},
        **{f"loop_reactions/{loop.name}": WRENCH for loop in scene.loops},
        "base_wrench": WRENCH,
        **dict.fromkeys(alone, ("",)),
        **designed(scene.kinematics.design),
    }  # fmt: skip


def designed(design: KinematicDesign | None) -> dict[str, tuple[str, ...]]:
    """Return the names of the columns that kinematic design asks for, by dataset."""
    if design is None:
        return {}
    return {
        **{
            f"{group}/{name}": VECTOR[:3]
            for group in ("poles", "acceleration_poles")
            for name in design.poles
        },
        **{f"relative_rates/{name}": ("",) for name in design.poles},
        **{f"curvatures/{name}": ("",) for name in design.curves},
        **{f"ratios/{name}": ("",) for name in design.ratios},
        **{f"pressure_angles/{name}": ("",) for name in design.pressure},
    }


def _moves(scene: Scene, name: str) -> bool:
    """Tell whether a point is on a moving link."""
    return point_link(scene.robot, name) != BASE


def _controlled(scene: Scene) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what a controller follows: joints, or the point that its motion leads; and the joints that it drives."""
    if scene.control is None:
        return (), ()
    point = None if scene.control.reference is None else scene.control.reference.point
    led = () if point is None else tuple(f"{point}.{axis}" for axis in "xyz")
    return (*columns(scene.robot), *led), tuple(scene.control.joints)


def column_of(key: str) -> str:
    """Return the column that a key of a summary asks the extremes of; nothing where it asks for none."""
    return key[len(EXTREMES) :].rpartition(".")[0].removesuffix(".errors") if key.startswith(EXTREMES) else ""


def asking(scene: Scene, keys: Iterable[str]) -> Scene:
    """Return a scene that asks for the extremes that keys of its summary name, too; it records reactions for theirs."""
    named = [name for key in keys if (name := column_of(key))]
    asked = tuple(dict.fromkeys((*scene.outputs.extremes, *named)))
    loads = scene.outputs.reactions or any(name.startswith(LOADS) for name in asked)
    if asked == scene.outputs.extremes and loads == scene.outputs.reactions:
        return scene
    return dataclasses.replace(
        scene, outputs=dataclasses.replace(scene.outputs, extremes=asked, reactions=loads)
    )


def with_extremes(scene: Scene, points: tuple[str, ...], named: Iterable[str], check: Check) -> Scene:
    """Return a scene that asks for all extremes among the keys of its summary that it names, with those of its outputs
    checked."""
    known = column_names(scene, points)
    for k, name in enumerate(scene.outputs.extremes):
        with check:
            if name not in known:
                head, paths = name.partition(".")[0], _datasets(scene, points)
                near = [x for x in known if x.startswith(f"{head}.")] or [
                    path for path in paths if any(x.startswith(path) for x in known)
                ]
                message = f"no column {name!r}{did_you_mean(name, known)}; allowed: {', '.join(near)}"
                check.fail(("outputs", "extremes", k), message)
    return asking(scene, named)
