"""Sensitivities: derivatives of outputs of a command by keys of its scene, exact where there are such, with errors."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from robodyn_cli.commands import COMMANDS, places
from robodyn_cli.errors import CapabilityError, RobodynError
from robodyn_cli.expr.many import ByKeys
from robodyn_cli.formulations.events import EventKind
from robodyn_cli.kernels.program import Program
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.motion import Motion
from robodyn_cli.observe.units import unit_text
from robodyn_cli.over.many.keys import NUMBER, STRUCTURE, Key
from robodyn_cli.over.sensitivity.asked import AskedSlopes, prepare
from robodyn_cli.over.sensitivity.differences import (
    DIFFERENCES,
    EXACT,
    Slope,
    differences,
    is_time_of_sample,
    why_not,
)
from robodyn_cli.over.sensitivity.motion.ends import Ending, MotionSlopes
from robodyn_cli.over.sensitivity.motion.latched import latched
from robodyn_cli.over.sensitivity.motion.peaks import slopes_of_extremes
from robodyn_cli.over.sensitivity.motion.variational import programs_of
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.record import record
from robodyn_cli.registry import Registry
from robodyn_cli.results.result import Result
from robodyn_cli.scene.checks.check import EXTREMES
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.study import OF_KEY, OF_OUTPUT, NominalNumber, SensitivitySummary, SlopeKeys
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress

Programs = Sequence[Program]
Found = dict[str, list[Slope]]  # by output, a derivative for each key
FOLLOWS = 1e-2  # part of a small change of a number by which its derivatives may miss it
CANCELLED = 1e-14  # of the largest change of any number
ROUNDING = 1e-11  # of numbers that are computed, far below NEARBY
NEARBY = 1e-6  # part of a key's value, by which another scene differs whose equations are compared

works: Registry[Any] = Registry("robodyn_cli", places("slopes"))


def exact_slopes(asked: AskedSlopes) -> tuple[dict[tuple[str, int], Slope], dict[int, str]]:
    """Return exact derivatives by output and number of the key, and for keys without any the reason."""
    why = {k: reason for k, key in enumerate(asked.keys) if (reason := _obstacle(asked, key))}
    work = works.get(asked.task.command)
    exact: dict[tuple[str, int], Slope] = {}
    if work is None:
        return exact, dict.fromkeys(range(len(asked.keys)), f"{asked.task.command} has no exact derivatives")

    def attempt(numbers: Sequence[int]) -> None:
        try:
            slopes = compared(work, asked, numbers) if isinstance(work, type) else work(asked, numbers)
        except RobodynError as obstacle:
            if len(numbers) == 1:
                why[numbers[0]] = obstacle.message
            for k in numbers if len(numbers) > 1 else ():  # one key may stand in the way of the others
                attempt([k])
            return
        each = [(name, k, s) for name, column in slopes.items() for k, s in zip(numbers, column)]
        exact.update({(name, k): s.times(asked.keys[k].scale) for name, k, s in each})

    if able := [k for k in range(len(asked.keys)) if k not in why]:
        attempt(able)
    return exact, why


def _obstacle(asked: AskedSlopes, key: Key) -> str:
    """Return why a key has no exact derivatives; nothing where it may have them."""
    if key.name.partition(".")[0] in COMMANDS[asked.task.command].given:
        return ""
    if key.sort in (NUMBER, STRUCTURE) and key.place not in asked.placed:
        return "the key is part of the code (structure), not a number that it reads"
    return ""


def refuse_structure(
    asked: AskedSlopes, numbers: Sequence[int], own: Programs, give: Callable[[Scene], Programs]
) -> None:
    """Refuse keys whose values are part of the code, or of numbers that do not know it: derivatives would not see them.

    Parameters
    ----------
    own : of the scene as it stands. give : those of a scene, asked for with the keys changed by ``NEARBY``; not for
        code that was compared before.

    Raises
    ------
    CapabilityError
    """
    code: tuple[int | str, ...] = (*numbers, *(x.digest for x in own))
    if code in asked.compared:
        return
    other = give(asked.changed(numbers, NEARBY))
    if [x.digest for x in own] != [x.digest for x in other]:
        raise CapabilityError("the key is structure: an axis, an attitude, or what decides about terms")
    by_keys = ByKeys({place: k for k, place in enumerate(asked.places(numbers)) if place})
    steps = [NEARBY * (abs(asked.values[k]) or 1.0) * asked.keys[k].scale for k in numbers]
    pairs = [(x, y) for one, two in zip(own, other) for x, y in zip(one.numbers, two.numbers)]
    # what sums that cancel leave, where all that they are of is proportional to a key that is zero
    nothing = CANCELLED * max((abs(float(y) - float(x)) for x, y in pairs), default=0.0)
    for x, y in pairs:
        slopes: Mapping[int, Any] = by_keys(x)
        expected = math.fsum(float(slope) * steps[k] for k, slope in slopes.items())
        change, size = float(y) - float(x), abs(float(x)) + abs(float(y))
        if abs(change - expected) > FOLLOWS * max(abs(change), abs(expected)) + ROUNDING * size + nothing:
            raise CapabilityError(
                "numbers of the equations follow from the key in a way that has no derivative"
            )
    asked.compared.add(code)


class Direct(Protocol):
    """What a command computes without any integration, for some keys: its programs, and their derivatives."""

    @property
    def programs(self) -> Programs: ...
    def slopes(self) -> Found: ...


def compared(
    kind: Callable[[AskedSlopes, Scene, Sequence[int]], Direct], asked: AskedSlopes, numbers: Sequence[int]
) -> Found:
    """Return the derivatives of a command without any integration, by keys that are no structure."""
    direct = kind(asked, asked.scene, numbers)
    refuse_structure(asked, numbers, direct.programs, lambda x: kind(asked, x, numbers).programs)
    return direct.slopes()


def simulate(asked: AskedSlopes, numbers: Sequence[int]) -> Found:
    """Return the derivatives of the end of a simulation by some keys.

    Raises
    ------
    CapabilityError : there are none.
    """
    outputs, scene = asked.task.outputs, asked.scene
    if not any(name.startswith(("final.", EXTREMES)) or name == "termination.time" for name in outputs):
        return {}
    if scene.initial.source is not None:
        raise CapabilityError("the run goes on from a stored one")
    motion = build_motion(integrable(scene))
    if motion.problem.model.switched:
        raise CapabilityError("payloads are gripped or released on the way")
    refuse_structure(asked, numbers, programs_of(motion), lambda x: programs_of(build_motion(integrable(x))))
    end = Ending(scene.simulate.duration)
    slopes = MotionSlopes(motion, [asked.keys[k] for k in numbers], asked.places(numbers), end)
    own = _of_end(motion, outputs, slopes, ("final.time", "termination.time"), ("final.q.", "", "final.qd."))
    return own | slopes_of_extremes(asked, slopes, end)


def deploy(asked: AskedSlopes, numbers: Sequence[int]) -> Found:
    """Return the derivatives of a lock by some keys.

    Raises
    ------
    CapabilityError : there are none.
    """
    from robodyn_cli.works.deploy.deploy import build_deployment
    from robodyn_cli.works.deploy.scan import decide, scan

    outputs, scene = asked.task.outputs, asked.scene
    if not any(name.startswith(("lock", "criteria.", "termination.", EXTREMES)) for name in outputs):
        return {}
    if scene.deploy.latches:
        return latched(asked, numbers, refuse_structure)
    motion = build_deployment(scene, Stopwatch())
    refuse_structure(
        asked, numbers, programs_of(motion), lambda x: programs_of(build_deployment(x, Stopwatch()))
    )
    found = scan(motion, motion.options, multipliers=scene.deploy.criterion not in ("dead_point", "latch"))
    end = decide(motion, found)
    kinds = {"dead_point": EventKind.DEAD_POINT, "latch": EventKind.LATCH}
    if found.driven or end.time is None or end.criterion not in kinds:
        raise CapabilityError("no event of the motion's state gives the time of the lock")
    function = next(e.value for e in motion.system.events if e.kind is kinds[end.criterion])
    ending = Ending(end.time, function)
    slopes = MotionSlopes(motion, [asked.keys[k] for k in numbers], asked.places(numbers), ending)
    times = ("lock.time", "termination.time", f"criteria.{end.criterion}")
    own = _of_end(motion, outputs, slopes, times, ("lock.angles.", "lock.angles_deg.", "lock.rates."))
    # behind the lock another mechanism moves
    return own if scene.deploy.after == "continue" else own | slopes_of_extremes(asked, slopes, ending)


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
    heads = tuple(prefix for prefix in prefixes if prefix)
    if not any(name in times or name.startswith(heads) for name in outputs):
        return {}
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


JUMPS = Slope(
    math.nan,
    math.nan,
    DIFFERENCES,
    "it is the time of one of the samples, which stays or jumps to another one",
)


@record
class Sensitivities:
    """All derivatives (outputs, keys), and why those by differences are not exact, by the number of the key."""

    asked: AskedSlopes
    slopes: tuple[tuple[Slope, ...], ...]
    obstacles: dict[int, str]


def sensitivities(asked: AskedSlopes, jobs: int = 1, progress: Progress = no_progress) -> Sensitivities:
    """Return the derivatives of all outputs by all keys.

    Parameters
    ----------
    jobs : processes or threads for runs of central differences. progress : is told how many of these are made.
    """
    exact, obstacles = exact_slopes(asked)
    outputs, count = asked.task.outputs, len(asked.keys)
    exact |= {
        (name, k): JUMPS
        for name in outputs
        if is_time_of_sample(asked.task.command, name)
        for k in range(count)
    }
    rest = [k for k in range(count) if any((name, k) not in exact for name in outputs)]
    others = differences(asked, rest, jobs, progress)
    slopes = tuple(
        tuple(exact.get((name, k)) or others[k][place] for k in range(count))
        for place, name in enumerate(outputs)
    )
    return Sensitivities(asked, slopes, obstacles)


def report(derivatives: Sensitivities, seconds: float) -> Result:
    """Return the result: for each output its derivatives by the keys, their errors, and which are exact."""
    asked = derivatives.asked
    task = asked.task
    result = Result("sensitivity", asked.scene.title or task.command, "ok", asked.scene.text)
    key_units = tuple(unit or "1" for unit in asked.units)
    result.add(
        "keys/value", asked.values, units=unit_text(key_units), column_units=key_units, names=task.keys
    )
    for k, (name, slopes) in enumerate(zip(task.outputs, derivatives.slopes)):
        units = tuple(quotient(asked.output_units[k], unit) for unit in asked.units)
        value = asked.outputs[k]
        columns = {
            "derivatives": [s.value for s in slopes],
            "derivative_errors": [s.error for s in slopes],
            "normalised": [_nan(normalised(s, key, value)) for s, key in zip(slopes, asked.values)],
            "exact": [float(s.method == EXACT) for s in slopes],
        }
        for group, (meaning, own) in MEANINGS.items():
            result.add(
                f"{group}/{name}", columns[group], long_name=meaning.format(name),
                units="1" if own else unit_text(units), column_units=() if own else units, names=task.keys,
            )  # fmt: skip
    result.summarise(
        SensitivitySummary(
            of=task.command,
            nominal={
                name: NominalNumber(y, unit, None if math.isnan(error) else error)
                for name, y, unit, error in zip(task.outputs, asked.outputs, asked.output_units, asked.errors)
            },
            keys={
                name: NominalNumber(x, unit) for name, x, unit in zip(task.keys, asked.values, asked.units)
            },
            sensitivities={
                name: _ranked(derivatives, k, slopes)
                for k, (name, slopes) in enumerate(zip(task.outputs, derivatives.slopes))
            },
            seconds=seconds,
        )
    )
    return result


# of datasets: what they hold, and whether they are plain numbers
MEANINGS = {
    "derivatives": ("derivative of {} by each key", False),
    "derivative_errors": ("estimated error of the derivative of {} by each key", False),
    "normalised": ("derivative of {} by each key times the key over the output", True),
    "exact": ("1 where the derivative of {} is exact, 0 where it is by differences", True),
}


def _ranked(derivatives: Sensitivities, output: int, slopes: Sequence[Slope]) -> dict[str, SlopeKeys]:
    """Return the derivatives of one output by key, those first that move it most."""
    asked = derivatives.asked
    value, name_of = asked.outputs[output], asked.task.outputs[output]
    keys = {}
    for k, (name, slope) in enumerate(zip(asked.task.keys, slopes)):
        reason = slope.reason or (
            ""
            if slope.method == EXACT
            else derivatives.obstacles.get(k, why_not(asked.task.command, name_of))
        )
        keys[name] = SlopeKeys(
            derivative=_finite(slope.value),
            error=_finite(slope.error),
            unit=quotient(asked.output_units[output], asked.units[k]),
            normalised=normalised(slope, asked.values[k], value),
            method=slope.method,
            reason=reason or ABSENT,
        )
    return dict(sorted(keys.items(), key=lambda item: _weight(item[1]), reverse=True))


def _weight(slope: SlopeKeys) -> tuple[float, float]:
    """Return by what derivatives are ranked: the normalised one, else the plain one."""
    return abs(slope.normalised or 0.0), abs(slope.derivative or 0.0)


def normalised(slope: Slope, key: float, output: float) -> float | None:
    """Return (key / output) d output / d key, None where either is zero or there is no derivative."""
    if not (key and output and math.isfinite(slope.value)):
        return None
    return slope.value * key / output if abs(slope.value) > slope.error else 0.0


def quotient(unit: str, of: str) -> str:
    """Return the unit of a derivative; ``N/(unit of the key)`` where one of both is not known, as in a formula."""
    unit, of = unit or f"({OF_OUTPUT})", of or OF_KEY
    if of == "1":
        return unit
    below = f"({of})" if " " in of or "/" in of else of
    return f"{unit}/{below}"


def _finite(x: float) -> float | None:
    return x if math.isfinite(x) else None


def _nan(x: float | None) -> float:
    return np.nan if x is None else x


def sensitivity(
    scene: Scene | Family | str | os.PathLike[str], to: Sequence[str], of: Sequence[str], jobs: int = 1
) -> Result:
    """Return the derivatives d output / d key, each with its estimated error.

    Parameters
    ----------
    scene : names a command; its file, or as it was loaded.
    to : keys of the scene with a number, as in ``--set``; ``KEY#n`` is the n-th number of a formula.
    of : keys of the summary of the command.
    jobs : processes or threads for runs of central differences.

    Returns
    -------
    A Result with a dataset ``derivatives/OUTPUT`` (keys,) in SI units for each output, ``derivative_errors/OUTPUT``,
    ``normalised/OUTPUT`` (key / output times the derivative) and ``exact/OUTPUT``; ``summary["sensitivities"]`` ranks
    them and says why one is not exact.

    Raises
    ------
    SceneError : the scene names no command, or fails; a key does not exist, has no number, or takes no others; an
        output is not in the summary, or is no number.
    """
    start = time.perf_counter()
    family = Family.of(scene)
    derivatives = sensitivities(prepare(family, to, of), jobs)
    return report(derivatives, time.perf_counter() - start)
