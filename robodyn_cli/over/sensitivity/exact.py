"""Exact derivatives of the outputs of a command, where it has such.

Exact derivatives of what motions that are integrated end with: of a simulation, and of a lock.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from robodyn_cli.commands import COMMANDS, places
from robodyn_cli.errors import CapabilityError, RobodynError
from robodyn_cli.expr.many import ByKeys
from robodyn_cli.formulations.events import EventKind
from robodyn_cli.kernels.program import Program
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.many.keys import NUMBER, STRUCTURE, Key
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.motion.end import Ending, MotionSlopes
from robodyn_cli.over.sensitivity.motion.variational import programs_of
from robodyn_cli.over.sensitivity.slope import EXACT, Slope
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.registry import Registry
from robodyn_cli.scene.types import Scene
from robodyn_cli.tools.stopwatch import Stopwatch

Programs = Sequence[Program]
Found = dict[str, list[Slope]]  # by output, a derivative for each key
Work = Callable[[AskedSlopes, Sequence[int]], Found]  # of keys by their numbers
FOLLOWS = 1e-2  # part of a small change of a number by which its derivatives may miss it
CANCELLED = 1e-14  # of the largest change of any number
ROUNDING = 1e-11  # of numbers that are computed, far below NEARBY
NEARBY = 1e-6  # part of a key's value, by which another scene differs whose equations are compared

works: Registry[Work] = Registry("robodyn_cli", places("slopes"))


def exact_slopes(asked: AskedSlopes) -> tuple[dict[tuple[str, int], Slope], dict[int, str]]:
    """Return exact derivatives by output and number of the key, and for keys without any the reason."""
    why = {k: reason for k, key in enumerate(asked.keys) if (reason := _obstacle(asked, key))}
    work = works.get(asked.task.command)
    found: dict[tuple[str, int], Slope] = {}
    if work is None:
        return found, dict.fromkeys(range(len(asked.keys)), f"{asked.task.command} has no exact derivatives")

    def attempt(numbers: Sequence[int]) -> None:
        try:
            slopes = work(asked, numbers)
        except RobodynError as obstacle:
            if len(numbers) == 1:
                why[numbers[0]] = obstacle.message
            for k in numbers if len(numbers) > 1 else ():  # one key may stand in the way of the others
                attempt([k])
            return
        found.update({(name, k): s for name, column in slopes.items() for k, s in zip(numbers, column)})

    if able := [k for k in range(len(asked.keys)) if k not in why]:
        attempt(able)
    return found, why


def _obstacle(asked: AskedSlopes, key: Key) -> str:
    """Return why a key has no exact derivatives; nothing where it may have them."""
    if key.name.partition(".")[0] in COMMANDS[asked.task.command].given:
        return ""
    if key.sort in (NUMBER, STRUCTURE) and key.place not in asked.placed:
        return "the key is part of the code (structure), not a number that it reads"
    return ""


def refuse_structure(asked: AskedSlopes, numbers: Sequence[int], own: Programs, other: Programs) -> None:
    """Refuse keys whose values are part of the code, or of numbers that do not know it: derivatives would not see them.

    Parameters
    ----------
    own, other : of the scene as it stands, and with the keys changed by ``NEARBY``.

    Raises
    ------
    CapabilityError
    """
    if [x.digest for x in own] != [x.digest for x in other]:
        raise CapabilityError(
            "the key is structure: an axis, an attitude, or what decides which terms there are"
        )
    by_keys = ByKeys({place: k for k, place in enumerate(asked.places(numbers)) if place})
    steps = [NEARBY * (abs(asked.values[k]) or 1.0) for k in numbers]
    pairs = [(x, y) for one, two in zip(own, other) for x, y in zip(one.numbers, two.numbers)]
    # what sums that cancel leave, where all that they are of is proportional to a key that is zero
    nothing = CANCELLED * max((abs(float(y) - float(x)) for x, y in pairs), default=0.0)
    for x, y in pairs:
        slopes: Mapping[int, Any] = by_keys(x)
        expected = math.fsum(float(slope) * steps[k] for k, slope in slopes.items())
        found, size = float(y) - float(x), abs(float(x)) + abs(float(y))
        if abs(found - expected) > FOLLOWS * max(abs(found), abs(expected)) + ROUNDING * size + nothing:
            raise CapabilityError(
                "numbers of the equations follow from the key in a way that has no derivative"
            )


class Direct(Protocol):
    """What a command computes without any integration, for some keys: its programs, and their derivatives."""

    @property
    def programs(self) -> Programs: ...
    def slopes(self) -> Found: ...


def compared(
    kind: Callable[[AskedSlopes, Scene, Sequence[int]], Direct], asked: AskedSlopes, numbers: Sequence[int]
) -> Found:
    """Return the derivatives of a command without any integration, by keys that are no structure."""
    found = kind(asked, asked.scene, numbers)
    other = kind(asked, asked.changed(numbers, NEARBY), numbers)
    refuse_structure(asked, numbers, found.programs, other.programs)
    return found.slopes()


def simulate(asked: AskedSlopes, numbers: Sequence[int]) -> Found:
    """Return the derivatives of the end of a simulation by some keys.

    Raises
    ------
    CapabilityError : there are none.
    """
    outputs, scene = asked.task.outputs, asked.scene
    if not any(name.startswith("final.") or name == "termination.time" for name in outputs):
        return {}
    if scene.initial.source is not None:
        raise CapabilityError("the run goes on from a stored one")
    motion = build_motion(integrable(scene))
    if motion.problem.model.switched:
        raise CapabilityError("payloads are gripped or released on the way")
    other = build_motion(integrable(asked.changed(numbers, NEARBY)))
    refuse_structure(asked, numbers, programs_of(motion), programs_of(other))
    slopes = MotionSlopes(
        motion, [asked.keys[k] for k in numbers], asked.places(numbers), Ending(scene.simulate.duration)
    )
    return _of_end(motion, outputs, slopes, ("final.time", "termination.time"), ("final.q.", "", "final.qd."))


def deploy(asked: AskedSlopes, numbers: Sequence[int]) -> Found:
    """Return the derivatives of a lock by some keys.

    Raises
    ------
    CapabilityError : there are none.
    """
    from robodyn_cli.works.deploy.deploy import build_deployment
    from robodyn_cli.works.deploy.scan import decide, scan

    outputs, scene = asked.task.outputs, asked.scene
    if not any(name.startswith(("lock.", "criteria.", "termination.")) for name in outputs):
        return {}
    motion = build_deployment(scene, Stopwatch())
    other = build_deployment(asked.changed(numbers, NEARBY), Stopwatch())
    refuse_structure(asked, numbers, programs_of(motion), programs_of(other))
    criterion = scene.deploy.criterion
    found = scan(motion, motion.options, multipliers=criterion not in ("dead_point", "latch"))
    end = decide(motion, found)
    kinds = {"dead_point": EventKind.DEAD_POINT, "latch": EventKind.LATCH}
    if found.driven or end.time is None or end.criterion not in kinds:
        raise CapabilityError("no event of the motion's state gives the time of the lock")
    function = next(e.value for e in motion.system.events if e.kind is kinds[end.criterion])
    slopes = MotionSlopes(
        motion, [asked.keys[k] for k in numbers], asked.places(numbers), Ending(end.time, function)
    )
    times = ("lock.time", "termination.time", f"criteria.{end.criterion}")
    return _of_end(motion, outputs, slopes, times, ("lock.angles.", "lock.angles_deg.", "lock.rates."))


def _of_end(
    motion: Motion,
    outputs: Sequence[str],
    slopes: MotionSlopes,
    times: Sequence[str],
    prefixes: tuple[str, str, str],
) -> Found:
    """Return the derivatives of those outputs that the end of a motion gives.

    times : keys of its time. prefixes : of its positions, its positions in degrees, and its rates.
    """
    model = motion.problem.model
    values, errors = slopes.found()
    rows = dict.fromkeys(times, (values.time, errors.time))
    for prefix, group, names, factor in (
        (prefixes[0], "q", model.q_names, 1.0),
        (prefixes[1], "q", model.q_names, math.degrees(1.0)),
        (prefixes[2], "v", model.v_names, 1.0),
    ):
        for k, name in enumerate(names if prefix else ()):
            rows[prefix + name] = factor * getattr(values, group)[k], factor * getattr(errors, group)[k]
    return {
        name: [Slope(float(y), float(e), EXACT) for y, e in zip(*rows[name])]
        for name in outputs
        if name in rows
    }
