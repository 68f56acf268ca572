"""Checks of the figures that a scene asks for: keys of summaries that it expects, searches for or studies; extremes."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from robodyn_cli.commands import SCENE_COMMANDS
from robodyn_cli.expr.statements import Expectation
from robodyn_cli.scene.checks.check import EXTREMES, HELD, LOCKS, RESPONSE, Check, key_place
from robodyn_cli.scene.checks.robot import column_units, columns
from robodyn_cli.scene.text.nodes import Mapping as MappingNode
from robodyn_cli.scene.text.nodes import Path, find
from robodyn_cli.scene.types import Scene

if TYPE_CHECKING:
    from robodyn_cli.loops.base import LoopClosure
    from robodyn_cli.summaries.keys import Leaf, Names


def check_figures(scene: Scene, check: Check) -> Scene:
    """Return the scene with the extremes that it asks for, by ``outputs`` or by keys of the summary."""
    if scene.search is not None:
        from robodyn_cli.scene.checks.options import check_search

        check_search(scene.search, check)
    named = [key for key, *_ in named_keys(scene)]
    turning = scene.simulate.fluctuation
    if turning or scene.inverse.shaking or scene.inverse.flywheel or scene.outputs.abscissa:
        from robodyn_cli.scene.checks.options import check_fluctuation

        check_fluctuation(scene, check)
        # a coefficient of fluctuation is that of the extremes of a rate
        named += [f"{EXTREMES}qd.{name}.largest" for name in turning]
    if scene.outputs.extremes or any(key.startswith((EXTREMES, LOCKS, RESPONSE, *HELD)) for key in named):
        from robodyn_cli.scene.checks.columns import with_extremes

        scene = with_extremes(scene, places_of(scene), named, check)
    if len(named) > len(turning):
        _check_keys(scene, check)
    return scene


def _check_keys(scene: Scene, check: Check) -> None:
    """Refuse keys of summaries that no run has; without a command, those that no command has."""
    from robodyn_cli.summaries.keys import leaf_of

    commands = [name for name in SCENE_COMMANDS if scene.command in (None, name)]
    names_of = functools.cache(lambda of_columns: key_names(scene, of_columns))  # the same for all keys
    for key, expected, section in named_keys(scene):
        number = expected is None or section[0] == "search" or expected.numeric
        leaves = [leaf for name in commands if (leaf := leaf_of(name, key)) is not None]
        if number:
            leaves = [leaf for leaf in leaves if leaf.is_number]
        known = leaves and leaves[0].kind is not Any
        if expected is not None and known and (fault := _unit_fault(scene, key, expected, leaves)):
            with check:
                check.fail(key_place(check.root, section, key), fault)
        names = names_of(key.startswith(EXTREMES)) if not leaves or leaves[0].names else {}
        if not leaves or (names and not any(leaf.fits(names) for leaf in leaves)):
            from robodyn_cli.summaries.keys import refusal

            with check:
                message = refusal(commands[0], key, names, number)
                check.fail(
                    key_place(check.root, section, key),
                    message,
                    at_key=isinstance(find(check.root, section), MappingNode),
                )


def named_keys(scene: Scene) -> Iterator[tuple[str, Expectation | None, Path]]:
    """Yield the keys of summaries that a scene names: each with what is expected of it, and the section."""
    yield from ((key, expected, ("expect",)) for key, expected in scene.expect.items())
    yield from ((key, None, ("study", "of")) for key in scene.study.of)
    search = scene.search
    if search is not None:
        yield from ((key, None, ("search", "minimise")) for key in (search.minimise,) if key)
        yield from ((key, None, ("search", "maximise")) for key in (search.maximise,) if key)
        yield from ((key, expected, ("search", "reach")) for key, expected in (search.reach or {}).items())
        yield from ((key, expected, ("search", "keep")) for key, expected in (search.keep or {}).items())


def unit_fault(scene: Scene, command: str, key: str, expected: Expectation) -> str | None:
    """Return what is wrong with the unit of what is expected of a number in the summary of a command."""
    from robodyn_cli.summaries.keys import leaf_of

    leaf = leaf_of(command, key)
    return None if leaf is None or not leaf.is_number else _unit_fault(scene, key, expected, [leaf])


def _unit_fault(scene: Scene, key: str, expected: Expectation, leaves: Sequence[Leaf]) -> str | None:
    """Return what is wrong with bounds of another kind than all the values that they may be for."""
    from robodyn_cli.expr import units

    given = units.of(expected.unit) if expected.unit else None
    if given is None:
        return None
    names = _units_of_names(scene, key)
    faults = [
        units.fault(given.dims, "rad" if unit == "deg" else unit, expected.text)
        for unit in (leaf.unit(names) for leaf in leaves)
        if any(map(units.of, units.forms(unit)))
    ]
    return f"{expected.text!r} does not fit: {faults[0]}" if faults and all(faults) else None


def _units_of_names(scene: Scene, key: str) -> dict[str, str]:
    """Return the units of what the names in a key of a summary name, as far as they are known."""
    if key.startswith(EXTREMES):
        from robodyn_cli.scene.checks.columns import units_of_columns

        return units_of_columns(scene, places_of(scene))
    units = column_units(scene.robot, velocities=True) | column_units(scene.robot)
    return units | (latch_units(scene) if key.startswith(LOCKS) else {})


def latch_units(scene: Scene) -> dict[str, str]:
    """Return the units of what latches hold, ``rad`` or ``m``, by their names."""
    units = column_units(scene.robot, velocities=True)
    joints = {frozenset((joint.parent, joint.link)): joint.name for joint in scene.robot.joints}
    return {
        latch.name: units.get(latch.joint or joints.get(frozenset(latch.between or ()), ""), "rad")
        for latch in scene.deploy.latches
    }


def key_names(scene: Scene, of_columns: bool = True) -> Names:
    """Return the names that keys of summaries of a scene may have in them, by kind; ``of_columns`` : those too."""
    rates = columns(scene.robot, velocities=True)
    joints = (joint.name for joint in scene.robot.joints)
    named: dict[str, tuple[str, ...]] = {}
    if of_columns:
        from robodyn_cli.scene.checks.columns import column_names

        named["COLUMN"] = column_names(scene, places_of(scene))
    return {
        **named,
        "JOINT": tuple(dict.fromkeys((*columns(scene.robot), *rates, *joints))),
        "LOOP": (*(x.name for x in (*scene.loops, *scene.couplers)), "latch"),
        "LIMIT": tuple(f"{name} {limit}" for name in rates for limit in ("speed", "acceleration", "effort")),
        "PAYLOAD": tuple(payload.name for payload in scene.payloads),
        "LATCH": tuple(latch.name for latch in scene.deploy.latches),
        "PAIR": () if scene.kinematics.design is None else tuple(scene.kinematics.design.ratios),
        "POINT": places_of(scene),
        "ROW": _row_names(scene),
    }


def places_of(scene: Scene) -> tuple[str, ...]:
    """Return the points of which a run tells where they are."""
    led = () if scene.trajectory is None else scene.trajectory.places
    return (*scene.robot.points, *led, *scene.kinematics.places)


def _row_names(scene: Scene) -> tuple[str, ...]:
    """Return the names that rows of closures, couplers and prescribed joints may have; in the plane some vanish."""
    closures = list(scene.loops)
    if scene.deploy.latch is not None:
        from robodyn_cli.loops.pairs import FixedLoop

        closures.append(FixedLoop(name="latch", type="fixed", between=("", "")))
    rows = _rows_of(closures) if closures else ()
    moved = {name.partition(".")[0] for name in scene.prescribed}
    prescribed = (
        f"prescribed.{name}{axis}" for name in moved for axis in ("", ".x", ".y", ".z", ".wx", ".wy", ".wz")
    )
    return (*rows, *(f"{coupler.name}.coupling" for coupler in scene.couplers), *prescribed)


def _rows_of(closures: Sequence[LoopClosure]) -> tuple[str, ...]:
    """Return the names of the rows of closures, as they are between any two frames."""
    from robodyn_cli.loops.base import LoopFrame
    from robodyn_cli.spatial.algebra import identity, zeros

    none = zeros(3)
    ends = [
        LoopFrame(p, identity(), zeros(3, 1), zeros(3, 1), none, none, none, [0.0])
        for p in (none, none + 1.0)
    ]
    return tuple(row.name for loop in closures for row in loop.rows(*ends))
