"""How deployments with latches change with keys: exact derivatives through their closings.

Each latch is plain (see ``closings``). What it does follows from the state where it closes, so that each closing is
looked at as the end of a motion; what moves on behind it begins with the derivatives of that state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.closings import closing_alone
from robodyn_cli.kernels.program import Program
from robodyn_cli.over.commands import execute
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import EXACT, Slope
from robodyn_cli.over.sensitivity.motion.ends import Ending, MotionSlopes
from robodyn_cli.over.sensitivity.motion.peaks import slopes_of_extremes
from robodyn_cli.over.sensitivity.motion.variational import EndSlopes, programs_of
from robodyn_cli.scene.types import Scene
from robodyn_cli.tools.progress import Stopwatch, no_progress
from robodyn_cli.works.deploy.deploy import build_deployment

Refuse = Callable[[AskedSlopes, Sequence[int], Sequence[Program], Callable[[Scene], Sequence[Program]]], None]
TIME, ENDS = "time", ("lock.time", "termination.time")
FIGURES = ("angle", "speed", "energy_lost", "angular_impulse")


def latched(asked: AskedSlopes, numbers: Sequence[int], refuse: Refuse) -> dict[str, list[Slope]]:
    """Return the derivatives of what latches do, of the last lock and of extremes, by some keys.

    refuse : see ``refuse_structure``.

    Raises
    ------
    CapabilityError : there are none.
    """
    scene, outputs = asked.scene, asked.task.outputs
    motion = build_deployment(scene, Stopwatch())
    if motion.system.closings is None or motion.system.layout is not None or scene.initial.source is not None:
        raise CapabilityError("latches that close change the motion")
    refuse(asked, numbers, programs_of(motion), lambda x: programs_of(build_deployment(x, Stopwatch())))
    summary = execute("deploy", scene, no_progress, Stopwatch()).summary
    locks, end = summary["locks"], float(summary["termination"]["time"])
    if not locks:
        raise CapabilityError("no latch closes")
    last = max(locks, key=lambda name: locks[name]["time"])
    ends = Ending(end, _closes(motion.problem, last)) if locks[last]["time"] == end else Ending(end)
    slopes = MotionSlopes(motion, [asked.keys[k] for k in numbers], asked.places(numbers), ends)
    found: dict[str, list[Slope]] = {}
    for name, lock in locks.items():
        heads = (f"locks.{name}.", *(("lock.",) if name == last else ()))
        at_end = ENDS if lock["time"] == end else ENDS[:1]
        wanted = [x for x in outputs if x.startswith(heads) or (name == last and x in at_end)]
        if not wanted or lock["closings"] > 1:
            continue
        own = _of_latch(slopes, name, lock["time"])
        found |= {output: own[key] for output in wanted if (key := _short(output, name)) in own}
    return found | slopes_of_extremes(asked, slopes, ends)


def _short(output: str, name: str) -> str:
    """Return what an output is of a latch that closes."""
    return TIME if output in ENDS else output.removeprefix(f"locks.{name}.")


def _closes(problem: Any, name: str) -> Scalar:
    closes: Scalar = next(row.closes for row in problem.latches if row.name == name)
    return closes


def _of_latch(slopes: MotionSlopes, name: str, time: float) -> Mapping[str, list[Slope]]:
    """Return the derivatives of what a latch does that closes at a time [s], and of the state right before."""
    problem = slopes.motion.problem
    k = next(n for n, row in enumerate(problem.latches) if row.name == name)
    place, struck = problem.latches[k].v, closing_alone(problem)
    assert place is not None
    figures = (struck["q"][k], problem.v[place], struck["lost"][0], struck["impulses"][k])
    slopes.until(Ending(time, _closes(problem, name), figures, closes=k))
    own, off = slopes.found()
    impulse = slopes.seen[0][-1]

    def rows(pick: Callable[[EndSlopes], Any], factor: float = 1.0) -> list[Slope]:
        return [Slope(factor * float(y), abs(factor) * float(e), EXACT) for y, e in zip(pick(own), pick(off))]

    by_key = {name: rows(lambda x, n=n: x.figures[n]) for n, name in enumerate(FIGURES)}  # type: ignore[misc]
    by_key |= {
        TIME: rows(lambda x: x.time),
        FIGURES[-1]: rows(lambda x: x.figures[-1], math.copysign(1.0, impulse)),
    }
    for n, (joint, unit) in enumerate(zip(problem.model.q_names, problem.model.q_units)):
        by_key[f"lock.angles.{joint}"] = rows(lambda x, n=n: x.q[n])  # type: ignore[misc]
        by_key[f"lock.rates.{joint}"] = rows(lambda x, n=n: x.v[n])  # type: ignore[misc]
        if unit == "rad":
            by_key[f"lock.angles_deg.{joint}"] = rows(lambda x, n=n: x.q[n], math.degrees(1.0))  # type: ignore[misc]
    return by_key
