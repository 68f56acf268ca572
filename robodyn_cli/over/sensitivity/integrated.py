"""Exact derivatives of what motions that are integrated end with: of a simulation, and of a lock."""

from __future__ import annotations

import math
from collections.abc import Sequence

from robodyn_cli.errors import CapabilityError
from robodyn_cli.formulations.events import EventKind
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.sensitivity.asked import Asked
from robodyn_cli.over.sensitivity.exact import NEARBY, Found, refuse_structure
from robodyn_cli.over.sensitivity.motion.end import Ending, MotionSlopes
from robodyn_cli.over.sensitivity.motion.variational import programs_of
from robodyn_cli.over.sensitivity.slope import EXACT, Slope
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.tools.stopwatch import Stopwatch


def simulate(asked: Asked, numbers: Sequence[int]) -> Found:
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
    other = build_motion(integrable(asked.changed(numbers, NEARBY)))
    refuse_structure(asked, numbers, programs_of(motion), programs_of(other))
    slopes = MotionSlopes(
        motion, [asked.keys[k] for k in numbers], asked.places(numbers), Ending(scene.simulate.duration)
    )
    return _of_end(motion, outputs, slopes, ("final.time", "termination.time"), ("final.q.", "", "final.qd."))


def deploy(asked: Asked, numbers: Sequence[int]) -> Found:
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
