"""The columns over time that a run of a scene has, as exports call them (``q.theta1``, ``points/tip.x``), and those
whose extremes a scene asks for.

A vector has its length, ``point_velocities/tip.length``, a wrench its ``force`` and ``moment``.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from robodyn_cli.commands import COMMANDS
from robodyn_cli.errors import did_you_mean
from robodyn_cli.scene.checks.check import EXTREMES, HELD, RESPONSE, Check
from robodyn_cli.scene.checks.robot import column_units, columns
from robodyn_cli.scene.points import BASE, point_link
from robodyn_cli.scene.types import Scene, Signal
from robodyn_cli.summaries.facts import ACCELERATION, LOAD, RATE

if TYPE_CHECKING:
    from robodyn_cli.scene.nested_options import KinematicDesign

LENGTH, FORCE, MOMENT = "length", "force", "moment"
VECTOR = ("x", "y", "z", LENGTH)
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz", FORCE, MOMENT)
DESIGNED = ("poles/", "acceleration_poles/", "relative_rates/", "curvatures/", "ratios/", "pressure_angles/")
LOADS = ("reactions/", "loop_reactions/", "force_wrenches/", "base_wrench")
LARGEST_LOAD = re.compile(r"locks\.(.+?)\.(?:errors\.)?peak_(?:moment|time)")
SAME = 1e-9  # part of a period by which times differ that are equal
WITHOUT_FORCES = ("q.", "qd.", "qdd.", "point", "frames/", "transmission_angle", *DESIGNED)


def column_names(scene: Scene, points: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the columns of runs of a scene's command; ``points`` : of which they tell where they are."""
    names = tuple(units_of_columns(scene, points))
    if scene.command is None:
        return names
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


def units_of_columns(scene: Scene, points: tuple[str, ...]) -> dict[str, str]:
    """Return the units of columns of runs by their names, empty of signals without a stated one."""
    return {
        f"{path}.{name}" if name else path: unit
        for path, own in _datasets(scene, points).items()
        for name, unit in own.items()
    }


def _datasets(scene: Scene, points: tuple[str, ...]) -> Mapping[str, Mapping[str, str]]:
    """Return the units of columns by name, by dataset; the name is empty of a dataset that is a column itself."""
    robot = scene.robot
    q, v = column_units(robot), column_units(robot, velocities=True)
    moving = [name for name in points if _moves(scene, name)]
    elements = [force.name for force in scene.forces]
    tracked, driven = _controlled(scene)
    rates, accelerations, torques = (
        {name: unit_of(unit) for name, unit in v.items()} for unit_of in (RATE, ACCELERATION, LOAD)
    )
    wrench = {name: "N" if name[0] == "f" else "N m" for name in WRENCH}
    twist = {f"{letter}{axis}": unit for letter, unit in (("w", "rad/s"), ("v", "m/s")) for axis in "xyz"}
    signals = {
        name: signal.unit if isinstance(signal, Signal) else ""
        for name, signal in scene.outputs.signals.items()
    }
    of_points = {"velocities": "m/s", "accelerations": "m/s^2"}
    return {
        "q": q, "qd": rates, "qdd": accelerations, "tau": torques,
        **{f"points/{name}": dict.fromkeys(VECTOR, "m") for name in points},
        **{f"point_{kind}/{name}": dict.fromkeys(VECTOR, unit) for kind, unit in of_points.items() for name in moving},
        **{f"frames/{name}/position": dict.fromkeys(VECTOR, "m") for name in robot.frames},
        **{f"frames/{name}/twist": twist for name in robot.frames},
        **{f"signals/{name}": {"": unit} for name, unit in signals.items()},
        **{f"control/{kind}": {name: q.get(name, "m") for name in tracked} for kind in ("reference", "error")},
        "control/torque": {name: torques.get(name, "") for name in driven},
        **_seen(scene, q, rates),
        "forces/potential": dict.fromkeys(elements, "J"), "forces/power": dict.fromkeys(elements, "W"),
        **{f"reactions/{joint.name}": wrench for joint in robot.joints},
        **{f"loop_reactions/{loop.name}": wrench for loop in scene.loops},
        **{f"force_wrenches/{name}": wrench for name in elements},
        "base_wrench": wrench,
        "latch_loads": {x.name: torques.get(x.joint or "", "") for x in scene.deploy.latches},
        **{f"energy/{x}": {"": "J"} for x in ("kinetic", "potential", "total", "work")},
        "transmission_angle": {"": "rad"},
        **designed(scene.kinematics.design, q | v),
    }  # fmt: skip


def designed(design: KinematicDesign | None, units: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """Return the units of columns that kinematic design asks for, by name, by dataset; units : of coordinates."""
    if design is None:
        return {}

    def ratio(pair: tuple[str, ...]) -> str:
        over, under = (units.get(name, "rad") for name in pair)
        return "1" if over == under else f"{over}/{under}"

    place = dict.fromkeys(VECTOR[:3], "m")
    return {
        **{f"{group}/{name}": place for group in ("poles", "acceleration_poles") for name in design.poles},
        **{f"relative_rates/{name}": {"": "rad/s"} for name in design.poles},
        **{f"curvatures/{name}": {"": "1/m"} for name in design.curves},
        **{f"ratios/{name}": {"": ratio(pair)} for name, pair in design.ratios.items()},
        **{f"pressure_angles/{name}": {"": "rad"} for name in design.pressure},
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
    # there are none where a check before this one has refused them
    return (*columns(scene.robot), *led), tuple(scene.control.joints or ())


def _seen(scene: Scene, q: Mapping[str, str], rates: Mapping[str, str]) -> dict[str, Mapping[str, str]]:
    """Return the units of what a controller sees by name, by dataset, where that is not what is."""
    if scene.control is None or scene.control.sensors.exact:
        return {}
    return {"control/measured": q, "control/measured_rates": rates}


def column_of(scene: Scene, key: str) -> str:
    """Return the column that a key of a summary asks the extremes of; nothing where it asks for none."""
    if (peak := LARGEST_LOAD.fullmatch(key)) is not None:
        rigid = any(x.name == peak[1] and x.hold == "rigid" for x in scene.deploy.latches)
        return f"latch_loads.{peak[1]}" if rigid else ""
    return key[len(EXTREMES) :].rpartition(".")[0].removesuffix(".errors") if key.startswith(EXTREMES) else ""


def asking(scene: Scene, keys: Iterable[str]) -> Scene:
    """Return a scene that asks for the extremes that keys of its summary name, too; it records reactions for theirs."""
    keys = list(keys)
    named = [name for key in keys if (name := column_of(scene, key))]
    asked = tuple(dict.fromkeys((*scene.outputs.extremes, *named)))
    loads = scene.outputs.reactions or any(name.startswith(LOADS) for name in asked)
    keys = list(keys)
    asks = (RESPONSE, *HELD) if _hides_torques(scene) else (RESPONSE,)
    responds = scene.outputs.response or any(key.startswith(asks) for key in keys)
    outputs = dataclasses.replace(scene.outputs, extremes=asked, reactions=loads, response=responds)
    return scene if outputs == scene.outputs else dataclasses.replace(scene, outputs=outputs)


def _hides_torques(scene: Scene) -> bool:
    """Tell whether a sampled controller may change its torques twice between two samples of a run."""
    if scene.control is None or scene.control.period is None:
        return False
    apart = scene.simulate.duration / max(scene.simulate.samples - 1, 1)
    return float(scene.control.period) < apart * (1.0 - SAME)


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
