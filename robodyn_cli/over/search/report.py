"""The result of a search: all its runs as datasets, and what is known of the best one."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.expr.statements import parse_expectation, parse_variation, written_arguments
from robodyn_cli.over.batch.criteria import lookup
from robodyn_cli.over.search.asked import Constraint, options_of, prepare
from robodyn_cli.over.search.journal import SearchJournal
from robodyn_cli.over.search.optimum import ACTIVE, Optimum
from robodyn_cli.over.search.points import DesignPoint, PointMaker
from robodyn_cli.over.search.search import SAME, EndedSearch, run_search
from robodyn_cli.over.search.solve import ScaledSearch, SolverWay
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Absent
from robodyn_cli.summaries.search import (
    FoundKey,
    FoundOutput,
    KeptLimit,
    OtherOptimum,
    SearchEffort,
    SearchProof,
    SearchSummary,
)

SAME_GOAL = 1e-12  # part of a goal, by which two are the same but for rounding
SMALL = 1e-4  # of the size of a goal, over the way between bounds: a derivative that is left is small


def report(ended: EndedSearch, maker: PointMaker, seconds: float) -> Result:
    """Return the result of a search."""
    search, own = ended.search, ended.own
    not_held = broken(ended)
    result = Result("optimise", search.family.own.title or search.task.command, "missed" if not_held else "ok",
                    search.family.own.text)  # fmt: skip
    _store(result, ended, maker.points)
    same, others = _others(ended)
    result.summarise(
        SearchSummary(
            of=search.task.command,
            goal=search.goal.words(search.task.outputs),
            repeat=search.repeat(own.x.tolist()),
            keys={name: _key(ended, k) for k, name in enumerate(search.task.keys)},
            figures=_outputs(ended),
            limits={limit.name: _limit(ended, limit) for limit in search.limits},
            left_out=search.left_out,
            not_held=not_held or ABSENT,
            other=_other(ended, others),
            proof=_proof(ended, same),
            not_exact=maker.not_exact,
            search=SearchEffort(
                len(maker.points) + 1, maker.exact, search.count, len(ended.ways), same,
                {str(code): count for code, count in sorted(maker.failures.items())},
                {str(code): text for code, text in sorted(maker.reasons.items())}, seconds,
            ),
        )
    )  # fmt: skip
    return result


def _store(result: Result, ended: EndedSearch, points: Sequence[DesignPoint]) -> None:
    """Add all runs of a search to its result: values, outputs, errors, exit codes, and which start asked for each."""
    search = ended.search
    for k, key in enumerate(search.task.keys):
        result.add(f"inputs/{key}", [p.x[k] for p in points], units=search.units[k] or "1",
                   long_name=f"value of {key}", dims=("run",))  # fmt: skip
    for k, name in enumerate(search.task.outputs):
        unit = search.output_units[k]
        result.add(f"outputs/{name}", [p.y[k] for p in points], units=unit, long_name=name, dims=("run",))
        result.add(f"errors/{name}", [p.error[k] for p in points], units=unit,
                   long_name=f"estimated error of {name}", dims=("run",))  # fmt: skip
    starts = np.full(len(points), -1)
    for number, (_, way) in reversed(list(enumerate(ended.ways))):
        starts[[p.run for p in way.points]] = number
    result.add("runs/exit_code", [p.code for p in points], dims=("run",))
    result.add("runs/holds", [int(ended.scaled.holds(p)) for p in points], dims=("run",))
    result.add("runs/start", starts, dims=("run",))
    result.add("runs/best", [int(p.run == ended.best.run) for p in points], dims=("run",))


def broken(ended: EndedSearch) -> list[str]:
    """Return what the run of the optimum breaks: targets, constraints, and what the scene expects of how a run goes."""
    search, own, scaled = ended.search, ended.own, ended.scaled
    if not own.is_good:
        return [own.reason or "the run lacks an output"]
    texts = [
        f"{search.task.outputs[k]} is {target.shown(float(own.y[k]))}, not {target.text}"
        for k, target, miss in zip(
            search.goal.outputs, search.goal.targets, scaled.misses(own) if search.goal.is_reach else ()
        )
        if miss > 1.0
    ]
    texts += [
        f"{limit.name} is {limit.expected.shown(float(own.y[limit.output]))}, not {limit.expected.text}"
        for limit in search.limits
        if not limit.expected.holds(float(own.y[limit.output]))
    ]
    for name in search.left_out:
        expected = search.family.own.expect[name]
        value = lookup(ended.summary, name)
        if not ("+-" in expected.text or expected.low == expected.high) and not expected.holds(value):
            texts.append(f"{name} is {expected.shown(value)}, not {expected.text}")
    return texts


def _finite(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None


def _outputs(ended: EndedSearch) -> dict[str, FoundOutput]:
    """Return the outputs of the run of the optimum."""
    search, own = ended.search, ended.own
    goal, outputs = search.goal, {}
    targets = dict(zip(goal.outputs, goal.targets))
    if goal.is_reach and own.is_good:
        tolerances = dict(zip(goal.outputs, ended.scaled.tolerances(own, goal)))
        misses = dict(zip(goal.outputs, ended.scaled.misses(own)))
    for k, name in enumerate(search.task.outputs):
        known = k in targets and own.is_good
        short: float | Absent | None = ABSENT
        if k in goal.outputs and not goal.is_reach and ended.optimum is not None:
            short = (
                _finite(abs(_goal_size(ended)) * ended.optimum.short)
                if _has_errors(ended, ended.optimum)
                else None
            )
        outputs[name] = FoundOutput(
            _finite(own.y[k]), search.output_units[k], _finite(own.error[k]),
            targets[k].text if k in targets else ABSENT,
            float(tolerances[k]) if known else ABSENT,
            bool(misses[k] <= 1.0) if known else ABSENT, short,
        )  # fmt: skip
    return outputs


def _goal_size(ended: EndedSearch) -> float:
    """Return the size of the goal, by which it is scaled."""
    goal = ended.search.goal
    return 1.0 if goal.is_reach else float(ended.scaled.sizes[goal.outputs[0]]) * goal.sign


def _key(ended: EndedSearch, k: int) -> FoundKey:
    """Return what is known of a key at the optimum."""
    search, optimum = ended.search, ended.optimum
    variation, value, unit = search.variations[k], float(ended.own.x[k]), search.units[k]
    if variation.is_grid:
        return FoundKey(value, unit, 0.0, choices=variation.text)
    at = search.continuous.index(k)
    (low, high), span, size = search.bounds[at], float(ended.scaled.span[at]), _goal_size(ended)
    words = " .. ".join(written_arguments(variation))
    if optimum is None:
        return FoundKey(value, unit, None, float(low), float(high), bounds=words)
    side = "lower bound" if optimum.at_low[at] else "upper bound" if optimum.at_high[at] else ABSENT
    own: dict[str, Any] = {}
    if not search.goal.is_reach:
        own["curvature"] = _finite(size * optimum.curved.H[at, at] / span**2)
        own["curvature_error"] = _finite(abs(size) * optimum.curved.H_error / span**2)
        if optimum.sides.held[at]:
            own["price"] = size * float(optimum.sides.bound_prices[at]) / span
            own["price_error"] = abs(size) * _gradient_error(ended.scaled, optimum) / span
    # between its bounds a key is off by no more than they are apart
    off = (
        _finite(min(optimum.off[at], 1.0) * span)
        if optimum.sides.held[at] or _has_errors(ended, optimum)
        else None
    )
    return FoundKey(value, unit, off, float(low), float(high), bounds=words, at=side, **own)


def _has_errors(ended: EndedSearch, optimum: Optimum) -> bool:
    """Tell whether the run states errors of all outputs on which the values depend."""
    binding = [ended.scaled.sides[k][0].output for k in optimum.sides.binding]
    return bool(np.isfinite(ended.own.error[[*ended.search.goal.outputs, *binding]]).all())


def _gradient_error(scaled: ScaledSearch, optimum: Optimum) -> float:
    """Return the error of the derivatives of the goal, and what of them is left."""
    rows = list(scaled.goal.outputs)
    return float(np.nan_to_num(np.abs(optimum.J_error[rows])).max(initial=0.0)) + optimum.left


def _limit(ended: EndedSearch, limit: Constraint) -> KeptLimit:
    """Return what is known of a constraint at the optimum."""
    own, optimum, scaled = ended.own, ended.optimum, ended.scaled
    value = float(own.y[limit.output])
    price: float | Absent = ABSENT
    error: float | Absent = ABSENT
    active = False
    if optimum is not None:
        for k, (other, sign, _) in enumerate(scaled.sides):
            if other == limit and k in optimum.sides.binding:
                ratio = _goal_size(ended) / float(scaled.sizes[limit.output])
                slope = max(float(np.abs(optimum.sides.gradients[k]).max(initial=0.0)), 1e-300)
                price, active = -sign * float(optimum.sides.prices[k]) * ratio, True
                error = abs(ratio) * _gradient_error(scaled, optimum) / slope
            elif other == limit and optimum.sides.room[k] <= ACTIVE:
                active = True
    return KeptLimit(
        limit.expected.text, limit.source, _finite(value), _finite(own.error[limit.output]),
        limit.expected.holds(value), active, price, error,
    )  # fmt: skip


def _others(ended: EndedSearch) -> tuple[int, list[tuple[int, SolverWay]]]:
    """Return how many starts came to the result, and the ways of others whose ends are runs that went well."""
    same, others = 0, []
    for number, (_, way) in enumerate(ended.ways):
        if _alike(ended, way.best, ended.best):
            same += 1
        elif way.best.is_good:
            others.append((number, way))
    return same, others


def _alike(ended: EndedSearch, one: DesignPoint, two: DesignPoint) -> bool:
    """Tell whether two points are one but for what a solver leaves."""
    columns = list(ended.search.continuous)
    fixed = [k for k in range(len(one.x)) if k not in columns]
    if not np.array_equal(one.x[fixed], two.x[fixed]):
        return False
    return not columns or bool((np.abs(one.x[columns] - two.x[columns]) <= SAME * ended.scaled.span).all())


def _other(ended: EndedSearch, others: Sequence[tuple[int, SolverWay]]) -> OtherOptimum | None:
    """Return the best of the other ends."""
    if not others:
        return None
    scaled = ended.scaled
    best = min((way for _, way in others), key=lambda way: scaled.rank(way.best)).best
    goal = scaled.goal
    number = float(scaled.misses(best).max()) if goal.is_reach else float(best.y[goal.outputs[0]])
    return OtherOptimum(
        number, scaled.holds(best), dict(zip(ended.search.task.keys, best.x.tolist())),
        sum(_alike(ended, way.best, best) for _, way in others),
    )  # fmt: skip


def _proof(ended: EndedSearch, same: int) -> SearchProof:
    """Return what shows that the values are the best."""
    search, optimum, count = ended.search, ended.optimum, len(ended.ways)
    if not search.continuous:
        return SearchProof(f"all {count} combinations were run: none is better")
    if optimum is None:
        text = f"no start of {count} came to values that hold all that is asked: these break it least"
        return SearchProof(f"{text}, which does not prove that there are none")
    if search.goal.is_reach:
        free = [search.task.keys[k] for k, is_free in zip(search.continuous, optimum.free) if is_free]
        if broken(ended):
            return SearchProof(f"not proved: no start of {count} came nearer, but other values may")
        others = f"; the targets do not determine {', '.join(free)}: other values do it too" if free else ""
        return SearchProof(
            f"the outputs themselves show that the targets are met; {same} of {count} starts came here{others}"
        )
    bends = optimum.bends
    error = _gradient_error(ended.scaled, optimum) - optimum.left
    known: dict[str, float] = {"first_order": optimum.left, "first_order_error": error}
    if len(bends):
        known |= {"second_order": float(bends.min()), "second_order_error": optimum.curved.H_error}
    text = f"{_first(optimum, error)}, {_second(optimum, bends)}"
    if optimum.jumps:
        text = f"the output jumps by {optimum.jumps:.1g} from run to run, more than it changes with the keys nearby"
    elif optimum.corner:
        text = "the goal has a corner here, as a magnitude that is zero has, and rises from it along each key"
    elif (
        len(bends)
        and optimum.left <= error
        and np.abs(bends).max() <= optimum.curved.H_error
        and _are_equal(ended)
    ):
        keys = [search.task.keys[k] for k in search.continuous]
        text = f"the output does not depend on {', '.join(keys)}, as far as derivatives and all starts tell"
    best = f"that no other is better is not proved: {same} of {count} starts came here"
    return SearchProof(f"{text}; {best}", **{name: x for name, x in known.items() if math.isfinite(x)})


def _are_equal(ended: EndedSearch) -> bool:
    """Tell whether the goal is the same, but for rounding, wherever a start came to."""
    output = ended.scaled.goal.outputs[0]
    goals = np.array([way.best.y[output] for _, way in ended.ways], dtype=float)
    return bool(np.ptp(goals) <= SAME_GOAL * np.abs(goals).max())


def _first(optimum: Optimum, error: float) -> str:
    if not optimum.left <= max(SMALL, 10.0 * error):
        return "no optimum as far as derivatives tell"
    return "derivatives are those of an optimum"


def _second(optimum: Optimum, bends: Array) -> str:
    """Return in words what the second derivatives say."""
    if optimum.sides.held.all() or (not len(bends) and np.isfinite(optimum.curved.H).all()):
        return "which bounds and constraints decide alone"
    if not len(bends):
        return "with second derivatives that are not known"
    if bends.min() > optimum.curved.H_error:
        return "and all directions that are free are worse"
    return (
        "with a direction in which the goal is flat"
        if bends.min() >= -optimum.curved.H_error
        else "but second derivatives show a direction that is better"
    )


def optimise(
    scene: Scene | Family | str | os.PathLike[str],
    vary: Mapping[str, Any] | None = None,
    jobs: int = 1,
    **search: Any,
) -> Result:
    """Return the values of keys that make an output least or largest, or bring outputs to given values.

    Parameters
    ----------
    scene : names a command; its file, or as it was loaded.
    vary : keys of the scene with their bounds (``uniform(low, high)``) or the values that they may take.
    jobs : processes or threads.
    search : ``minimise`` or ``maximise``, an output; or ``reach``, values by output; ``keep``, what holds by output;
        ``starts`` and ``seed``. What is not given is that of the scene's section ``search``.

    Returns
    -------
    A Result with all runs (``inputs/KEY``, ``outputs/OUTPUT``, ``runs/best``); ``summary["keys"]`` has the values.

    Raises
    ------
    SceneError : the search makes no sense. CapabilityError : no run ends as it should wherever it would begin.
    """
    start = time.perf_counter()
    family = Family.of(scene)
    given: dict[str, Any] = {**search, "vary": {key: parse_variation(x) for key, x in (vary or {}).items()}}
    for name in ("reach", "keep"):
        given[name] = {key: parse_expectation(x, key) for key, x in search.get(name, {}).items()}
    asked = prepare(family, options_of(family.own.search, given))
    maker = PointMaker(asked, jobs, SearchJournal(), lambda runs: None)
    return report(run_search(asked, maker), maker, time.perf_counter() - start)
