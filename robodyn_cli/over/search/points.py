"""The points of a search: their runs, each made once, and derivatives there, exact where the command has such."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.commands import places
from robodyn_cli.errors import CapabilityError, RobodynError
from robodyn_cli.over.many.keys import STRUCTURE, settings
from robodyn_cli.over.search.asked import Search
from robodyn_cli.over.search.differences import ROUGH, RunsBeside, places_beside, step_beside
from robodyn_cli.over.search.journal import SearchJournal
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.gradients import SOLVED
from robodyn_cli.over.sensitivity.report import exact_slopes
from robodyn_cli.over.study.rows import Points, RunRows, joined, told
from robodyn_cli.over.study.runs import Compiled, Waiting, one_by_one, suits
from robodyn_cli.record import record
from robodyn_cli.registry import Registry
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.tools.progress import Progress, no_progress

at_once: Registry[Any] = Registry("robodyn_cli", places("together"))


@record
class DesignPoint:
    """A run: its number, values of the keys (K,), outputs and their errors (n,), exit code, why it failed.

    compiled : whether compiled code has made it.
    """

    run: int
    x: Array
    y: Array
    error: Array
    code: int
    reason: str
    compiled: bool

    @property
    def is_good(self) -> bool:
        """Whether the run ended as it should and has all outputs."""
        return self.code == 0 and bool(np.isfinite(self.y).all())


@record
class OutputSlopes:
    """Derivatives d output / d key (n, K) at a point and their errors; nan where there is none.

    exact : whether any was computed exactly. jumps : how far outputs jump from run to run (n,), zero of smooth ones.
    """

    values: Array
    errors: Array
    jumps: Array
    exact: bool = False


class PointMaker:
    """Makes the runs and derivatives of a search, each once.

    Parameters
    ----------
    jobs : threads or processes. tell : is told how many runs there are.

    Attributes
    ----------
    points : all runs, in their order. failures, reasons : of runs that failed, by exit code. exact : derivatives that
    were computed exactly. not_exact : why others are differences, by key.
    """

    def __init__(
        self, search: Search, jobs: int, journal: SearchJournal, tell: Callable[[int], None]
    ) -> None:
        self.search, self.jobs, self.tell, self.journal = search, jobs, tell, journal
        self.points: list[DesignPoint] = []
        self.failures: Counter[int] = Counter()
        self.reasons: dict[int, str] = {}
        self.not_exact: dict[str, str] = {}
        self._compiled = Compiled(search.task, jobs, search.keys) if suits(search.task) else None
        if self._compiled is not None and search.continuous:
            for values in search.combinations():
                ends = [search.value_of(np.full(len(search.continuous), u), values) for u in (0.0, 1.0)]
                self._compiled.allow(np.array(ends))
                break  # others are looked at as they come
        self._slopes_at_once = None if (kind := at_once.get(search.task.command)) is None else kind()
        self._known: dict[bytes, DesignPoint] = {}
        self._slopes: dict[bytes, OutputSlopes] = {}
        self._compared: set[tuple[int | str, ...]] = set()  # code of which keys are no structure
        self._able: list[int] | None = None  # keys of which there are exact derivatives
        self._rough: dict[int, NDArray[np.bool_]] = {}  # outputs (n,) that jump, by key

    # -- runs -----------------------------------------------------------------------------------------------
    def runs(self, xs: Sequence[Array], progress: Progress = no_progress) -> list[DesignPoint]:
        """Return the points with these values of the keys (K,)."""
        new = [x for x in {x.tobytes(): x for x in xs}.values() if x.tobytes() not in self._known]
        left = []
        for x in new:
            if (kept := self.journal.run(x)) is not None:
                self._take(DesignPoint(len(self.points), x, *kept), is_new=False)
            else:
                left.append(x)
        if left:
            made, compiled = self._made(Points(np.arange(len(left)), np.array(left)), progress)
            order = np.argsort(made.runs, kind="stable")
            for k, (x, row) in enumerate(zip(left, made.rows[order])):
                y, error, code = row["outputs"].copy(), row["errors"].copy(), int(row["code"])
                reason = made.reasons.get(k, "")
                self._take(DesignPoint(len(self.points), x, y, error, code, reason, k in compiled))
        return [self._known[x.tobytes()] for x in xs]

    def _made(self, points: Points, progress: Progress) -> tuple[RunRows, set[int]]:
        """Return the rows of runs, and the numbers of those that compiled code makes."""
        parts, count = [], len(points)
        if self._compiled is not None:
            parts.append(self._compiled.make(points))
            points = points.part(np.isin(points.runs, parts[0].runs, invert=True))
        compiled = {run for part in parts for run in part.runs.tolist()}
        alone = one_by_one(self.search.task, Waiting([points]), self.jobs)
        parts += told(alone, count, progress, count - len(points))
        return joined(parts), compiled

    def _take(self, point: DesignPoint, is_new: bool = True) -> None:
        """Keep a run."""
        self.points.append(point)
        self._known[point.x.tobytes()] = point
        if is_new:
            self.journal.add_run(point.x, (point.y, point.error, point.code, point.reason, point.compiled))
        if not point.is_good:
            self.failures[point.code] += 1
            self.reasons.setdefault(point.code, point.reason or self._lacking(point.y))
        self.tell(len(self.points))

    def _lacking(self, y: Array) -> str:
        names = [name for name, value in zip(self.search.task.outputs, y) if not math.isfinite(value)]
        return f"the run has no {', '.join(names)}"

    # -- derivatives ----------------------------------------------------------------------------------------
    def slopes(self, points: Sequence[DesignPoint]) -> list[OutputSlopes]:
        """Return the derivatives at points by the keys that lie between bounds; others are zero."""
        unknown: dict[bytes, DesignPoint] = {}
        for point in points:
            x = point.x.tobytes()
            if x not in self._slopes and (kept := self.journal.slopes(point.x)) is not None:
                self._slopes[x] = OutputSlopes(*kept)
            elif x not in self._slopes:
                unknown[x] = point
        new = self._together([point for point in unknown.values() if point.compiled])
        new |= {x: self._exactly(point) for x, point in unknown.items() if x not in new}
        self._complete(points, new)
        for x, own in new.items():
            self.journal.add_slopes(np.frombuffer(x), (own.values, own.errors, own.jumps, own.exact))
            self._slopes[x] = own
        return [self._slopes[point.x.tobytes()] for point in points]

    def _together(self, points: Sequence[DesignPoint]) -> dict[bytes, OutputSlopes]:
        """Return the derivatives at those points where compiled code gives all of them at once."""
        if self._compiled is None or self._slopes_at_once is None or not points:
            return {}
        keys, span = list(self.search.continuous), np.ptp(self.search.bounds, axis=1)
        together = {}
        values = np.array([point.x for point in points])
        slopes = np.full((len(points), len(points[0].y), len(points[0].x)), np.nan)
        served = self._compiled.structures(values)
        # what is zero is structure, and its derivative is in another structure, where it is a number
        others = [(structure, np.arange(len(points))) for structure, _ in served]
        same = [k for k, key in enumerate(self.search.keys) if key.sort == STRUCTURE]
        for structure, rows in [*served, *others]:
            is_like = (values[rows][:, same] == structure.row[same]).all(axis=1) & structure.fits(
                values[rows]
            )
            own = rows[is_like & ~np.isfinite(slopes[rows][:, :, keys]).all(axis=(1, 2))]
            if not len(own):
                continue
            with contextlib.suppress(CapabilityError, np.linalg.LinAlgError):
                slopes[own] = self._slopes_at_once(structure, values[own], self.search.task.outputs)
        for point, J in zip(points, slopes):
            if not np.isfinite(J[:, keys]).all():
                continue
            own = self._nothing(point)
            own.values[:, keys] = J[:, keys]
            own.errors[:, keys] = SOLVED * np.maximum(np.abs(J[:, keys]), np.abs(point.y)[:, None] / span)
            together[point.x.tobytes()] = dataclasses.replace(own, exact=True)
        return together

    @property
    def exact(self) -> int:
        """How many points have derivatives of which some are exact."""
        return sum(own.exact for own in self._slopes.values())

    def _nothing(self, point: DesignPoint) -> OutputSlopes:
        """Return derivatives that are not known yet: nan, but for keys without bounds."""
        J = np.full((len(point.y), len(point.x)), np.nan)
        J[:, [k for k in range(len(point.x)) if k not in self.search.continuous]] = 0.0
        return OutputSlopes(J, J.copy(), np.zeros(len(point.y)))

    def _exactly(self, point: DesignPoint) -> OutputSlopes:
        """Return the derivatives at a point that can be computed exactly, nan in the place of others."""
        search, nothing = self.search, self._nothing(point)
        J, errors = nothing.values, nothing.errors
        able = list(search.continuous) if self._able is None else self._able
        if not able:
            return nothing
        try:
            found, why = exact_slopes(self._asked(point, able))
        except RobodynError as obstacle:
            found, why = {}, dict.fromkeys(range(len(able)), obstacle.message)
        for (name, k), slope in found.items():
            row = search.task.outputs.index(name)
            J[row, able[k]], errors[row, able[k]] = slope.value, slope.error
        if self._able is None:
            has = {able[k] for _, k in found}
            self._able = [k for k in able if k in has]
            for k, name in enumerate(search.task.keys):
                if k in able and not np.isfinite(J[:, k]).all():
                    missing = [
                        o for o, slope in zip(search.task.outputs, J[:, k]) if not math.isfinite(slope)
                    ]
                    text = why.get(able.index(k), f"{', '.join(missing)} has no exact derivatives")
                    self.not_exact[name] = text
        return dataclasses.replace(nothing, exact=bool(found))

    def _asked(self, point: DesignPoint, able: Sequence[int]) -> AskedSlopes:
        """Return what a sensitivity at a point is asked for."""
        search, task = self.search, self.search.task
        row = np.zeros(1, task.layout)
        row["values"], row["outputs"], row["errors"], row["done"] = point.x, point.y, point.error, True
        own = dataclasses.replace(
            task,
            family=task.family.with_values(settings(task.keys, point.x)),
            keys=tuple(task.keys[k] for k in able),
        )
        return AskedSlopes(
            own, tuple(search.keys[k] for k in able), tuple(float(point.x[k]) for k in able),
            RunRows(np.zeros(1, dtype=np.int64), row, {}), ("",) * len(able), ("",) * len(task.outputs), self._compared,
        )  # fmt: skip

    def _complete(self, points: Sequence[DesignPoint], slopes: Mapping[bytes, OutputSlopes]) -> None:
        """Put differences where derivatives are missing; all runs that they need are made at once, and wider ones where
        outputs may jump."""
        own = {x: point for point in points if (x := point.x.tobytes()) in slopes}
        pairs = [
            (own[x], k) for x in own for k in self.search.continuous if np.isnan(slopes[x].values[:, k]).any()
        ]
        rough = [self._rough.get(k, np.zeros(len(point.y), dtype=bool)) for point, k in pairs]
        steps = [ROUGH if jump.all() else step_beside(p.y, p.error) for jump, (p, _) in zip(rough, pairs)]
        near = self._beside(pairs, steps)
        wide = [
            runs is not None and not jump.all() and bool((jump | runs.may_jump()).any())
            for jump, runs in zip(rough, near)
        ]
        wider = iter(self._beside([pair for pair, w in zip(pairs, wide) if w], [ROUGH] * sum(wide)))
        for (point, k), jump, runs, is_wide in zip(pairs, rough, near, wide):
            beside = next(wider) if is_wide else runs if jump.all() else None
            if runs is not None:
                self._put(slopes[point.x.tobytes()], k, runs, beside)

    def _put(self, slopes: OutputSlopes, k: int, runs: RunsBeside, wider: RunsBeside | None) -> None:
        """Put differences by a key where derivatives are missing; wider : runs over steps at which jumps count less."""
        missing, (value, error) = np.isnan(slopes.values[:, k]), runs.slope()
        if wider is not None:
            jumps = runs.jumps(wider, self._rough.get(k))
            rough, off = wider.rough_slope(jumps)
            value, error = np.where(jumps > 0.0, rough, value), np.where(jumps > 0.0, off, error)
            slopes.jumps[missing] = np.maximum(slopes.jumps, jumps)[missing]
            if jumps.any():
                self._rough[k] = jumps > 0.0
        slopes.values[missing, k], slopes.errors[missing, k] = value[missing], error[missing]

    def _beside(
        self, pairs: Sequence[tuple[DesignPoint, int]], steps: Sequence[float]
    ) -> list[RunsBeside | None]:
        """Return runs on both sides of points along keys, None where both fail; ``steps`` : parts of the way between
        bounds."""
        bounds = [self.search.bounds[self.search.continuous.index(k)] for _, k in pairs]
        places = [
            places_beside(point.x, k, own, step * float(np.ptp(own)))
            for (point, k), own, step in zip(pairs, bounds, steps)
        ]
        made = iter(self.runs([x for each in places for x in each]))
        found: list[RunsBeside | None] = []
        for (point, k), own, each in zip(pairs, bounds, places):
            there = [p for p in [next(made) for _ in each] if p.is_good]
            changes, errors = np.array([p.y - point.y for p in there]), np.array([p.error for p in there])
            away = np.array([p.x[k] - point.x[k] for p in there])
            runs = RunsBeside(point.y, point.error, away, changes, errors, float(np.ptp(own)))
            found.append(runs if there else None)
        return found
