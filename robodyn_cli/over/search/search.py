"""A search: starts, solvers side by side, the best end examined, and its run by the command itself."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.over.search.asked import Search
from robodyn_cli.over.search.lanes import Lanes
from robodyn_cli.over.search.optimum import Examiner, Optimum
from robodyn_cli.over.search.points import DesignPoint, OutputSlopes, PointMaker
from robodyn_cli.over.search.solve import Asks, FirstMet, ScaledSearch, Solver, SolverWay, sizes_of
from robodyn_cli.over.study.design import Samples, make_samples
from robodyn_cli.over.study.rows import RunRows
from robodyn_cli.over.study.runs import make_one
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.tools.progress import Progress, no_progress

MOST_LANES = 64  # solvers at a time
DRAWS = 8  # points that are tried for each start, since runs may fail there
SAME = 1e-4  # of the way between bounds, within which two ends are one


@record
class EndedSearch:
    """A search that has come to its end.

    optimum : None without keys between bounds, and where no start holds the constraints. best : its point. ways : of
    all starts, with the number of their combination. own : the run of the optimum by the command itself, and its
    summary.
    """

    search: Search
    scaled: ScaledSearch
    optimum: Optimum | None
    best: DesignPoint
    ways: tuple[tuple[int, SolverWay], ...]
    own: DesignPoint
    summary: Mapping[str, Any]


def run_search(search: Search, maker: PointMaker, progress: Progress = no_progress) -> EndedSearch:
    """Make a search; tell of how many starts the solvers have ended, or how many runs of all choices are made.

    Raises
    ------
    CapabilityError : no run ends as it should, wherever one begins.
    """
    combinations = list(search.combinations())
    if not search.continuous:
        made = maker.runs(combinations, progress)
        good = _good(made, maker)
        scaled = ScaledSearch(search, combinations[0], sizes_of(good))
        ways = [
            (k, SolverWay(scaled, (point,), (), point.is_good, point.reason)) for k, point in enumerate(made)
        ]
    else:
        begun = _beginnings(search, maker, combinations, progress)
        sizes = sizes_of(_good([p for _, _, p in begun], maker))
        begun = [one for one in begun if one[2].is_good]
        ways, met = [], FirstMet()
        for first in range(0, len(begun), MOST_LANES):
            part = begun[first : first + MOST_LANES]
            solvers = [Solver(ScaledSearch(search, combinations[k], sizes), u, met) for k, u, _ in part]
            lanes: Lanes[Asks, tuple[DesignPoint, OutputSlopes | None], SolverWay] = Lanes(
                functools.partial(_answer, maker), functools.partial(_tell, progress, first, len(begun))
            )
            ends = lanes.run(solvers)
            ways += [(k, way) for (k, _, _), way in zip(part, ends)]
        scaled = ways[0][1].scaled
    chosen = min((way for _, way in ways), key=lambda way: way.scaled.rank(way.best))
    best, optimum = chosen.best, None
    if search.continuous:
        optimum = Examiner(chosen, lambda xs: _derive(maker, xs))(best)
        best = optimum.point
    rows, summary = make_one(search.task, 0, best.x)
    own = with_row(best, rows)
    if not (search.goal.is_reach or chosen.scaled.holds(own)):
        optimum = None
    return EndedSearch(search, chosen.scaled, optimum, best, tuple(ways), own, summary)


def with_row(point: DesignPoint, made: RunRows) -> DesignPoint:
    """Return a point with what another run with its values gave."""
    row = made.rows[0]
    return dataclasses.replace(
        point, y=row["outputs"].copy(), error=row["errors"].copy(), code=int(row["code"]),
        reason=made.reasons.get(0, ""),
    )  # fmt: skip


def _good(points: Sequence[DesignPoint], maker: PointMaker) -> list[DesignPoint]:
    """Return the points whose runs ended well.

    Raises
    ------
    CapabilityError : there is none.
    """
    good = [point for point in points if point.is_good]
    if not good:
        code, count = maker.failures.most_common(1)[0]
        raise CapabilityError(
            f"no run ends as it should at any of the {len(points)} points from which the search would begin; {count} "
            f"end with exit code {code}: {maker.reasons[code]}"
        )
    return good


def _beginnings(
    search: Search, maker: PointMaker, combinations: Sequence[Array], progress: Progress
) -> list[tuple[int, Array, DesignPoint]]:
    """Return starts: the number of a combination, u between the bounds, and the run there.

    Where runs fail, other points of the sequence take their place, as far as there are such.
    """
    sources = [_places(search) for _ in combinations]
    begun: list[tuple[int, Array, DesignPoint]] = []
    lacking = [search.options.starts] * len(combinations)
    for _ in range(DRAWS):
        drawn = [(k, u) for k, count in enumerate(lacking) for _, u in zip(range(count), sources[k])]
        if not drawn:
            break
        made = maker.runs([search.value_of(u, combinations[k]) for k, u in drawn], progress)
        begun += [(k, u, point) for (k, u), point in zip(drawn, made)]
        good = [k for k, _, point in begun if point.is_good]
        lacking = [search.options.starts - good.count(k) for k in range(len(combinations))]
    return begun


def _places(search: Search) -> Iterator[Array]:
    """Yield places u to begin at: the scene as it stands, if it lies between the bounds, and a Sobol sequence."""
    low, high = search.bounds.T
    stands = (np.array([search.stands[k] for k in search.continuous]) - low) / (high - low)
    if bool(((stands >= 0.0) & (stands <= 1.0)).all()):
        yield stands
    most = DRAWS * search.options.starts
    samples: Samples = make_samples("sobol", most, len(low), search.options.seed)
    yield from samples.rows(0, most)


def _tell(progress: Progress, before: int, total: int, ended: int) -> None:
    """Tell of how many starts the solvers have ended."""
    progress(before + ended, total, "starts")


def _answer(maker: PointMaker, asks: Sequence[Asks]) -> list[tuple[DesignPoint, OutputSlopes | None]]:
    """Return the runs that solvers ask for, and derivatives where they do."""
    points = maker.runs([ask.x for ask in asks])
    wanted = [point for ask, point in zip(asks, points) if ask.slopes and point.is_good]
    slopes = dict(zip((point.run for point in wanted), maker.slopes(wanted)))
    return [(point, slopes.get(point.run)) for point in points]


def _derive(maker: PointMaker, xs: Sequence[Array]) -> list[tuple[DesignPoint, OutputSlopes | None]]:
    return _answer(maker, [Asks(x, True) for x in xs])
