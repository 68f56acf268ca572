"""Motions of many mechanisms that their loops and what leads them determine, run beside run.

The runs go from sample to sample together, in strides as long as all of them are made in one step; all other samples of
all runs are solved at once from quintics through these (``solve/sparse.py``). A run in which these do not count is
followed sample by sample; one that ends before is left to the command.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Sequence
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.many import Expressions, ManyNumbers, Recipe
from robodyn_cli.given.loop_conditions import Lead, LoopConditions
from robodyn_cli.over.many.keys import NUMBER, Key
from robodyn_cli.record import record
from robodyn_cli.solve import closure
from robodyn_cli.solve.guided import MISS, Places, same_branch, solve_together
from robodyn_cli.solve.sparse import FEWEST, NEAR, Strides, interpolated
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import TaskSpaceTrajectory

HALVINGS = 8  # of the way between samples; what needs more is left to the command
ATTITUDE = 0.5  # cosine, below which links are half a turn away from the attitude that is asked for
FARTHEST = 0.99  # rad, or part of the size: steps are cut at 1, beyond which the command does not begin
AT_ONCE = 16_384  # places that are solved together
Chosen = NDArray[np.bool_]


class Numbered(Protocol):
    """What has numbers for rows of values (N, keys): a structure."""

    recipe: Recipe

    def numbers(self, values: Array) -> ManyNumbers: ...


@record
class ManyMotions:
    """Motions of runs at times (T,): q, v and a (N, T, nv), and which runs came to the end (N,)."""

    q: Array
    v: Array
    a: Array
    good: Chosen

    def part(self, rows: NDArray[np.int64]) -> ManyMotions:
        """Return those of some runs."""
        return ManyMotions(self.q[rows], self.v[rows], self.a[rows], self.good[rows])

    def put(self, rows: NDArray[np.int64], other: ManyMotions) -> None:
        """Put others in the place of some of them."""
        for name in ("q", "v", "a", "good"):
            getattr(self, name)[rows] = getattr(other, name)


class Guided:
    """The equations of motions that loops and a lead determine, for any numbers of a structure.

    Parameters
    ----------
    built : the structure. times : of the samples (T,).
    """

    def __init__(self, built: Numbered, problem: Problem, lead: Lead, times: Array) -> None:
        self.built, self.problem, self.times = built, problem, times
        self.conditions = LoopConditions(problem, lead, times)
        self.here, self.rates = (Expressions(x) for x in self.conditions.entries())
        self.cosines = Expressions([row.cosine for row in problem.constraint_rows])

    @property
    def start(self) -> Array:
        """Positions (nq,) near which the loops close: initial ones, and those of the joints that lead."""
        scene, lead = self.problem.scene, self.conditions.lead
        guess = scene.trajectory.ik.guess if lead.led is not None else {}
        led = dict(zip(lead.positions, lead.asked(self.times[:1])[0][0].tolist()))
        given = {**scene.initial.q, **guess, **led}
        return np.array([given[name] for name in self.problem.model.q_names])

    @cached_property
    def varies(self) -> bool:
        """Whether other runs have other motions."""
        parts = (self.here, self.rates)
        return any(self.built.recipe.varies(x) for part in parts for x in (*part.constants, *part.outputs))

    def residuals(self, values: Array, motions: ManyMotions) -> dict[str, Array]:
        """Return the largest residuals (N,) of positions, rates and accelerations of motions."""
        count, samples, n = motions.q.shape
        each, times = np.repeat(values, samples, axis=0), np.tile(self.times, count)
        conditions = _RunConditions(self, each, times)
        q, v, a = (x.reshape(-1, n) for x in (motions.q, motions.v, motions.a))
        F, J = conditions.at_runs(q)
        c, b = conditions.rates_at_samples(q, v, slice(None))
        off = (F, *((J @ x[..., None])[..., 0] - y for x, y in ((v, c), (a, b))))
        levels = ("position", "velocity", "acceleration")
        return {x: np.abs(y).reshape(count, -1).max(axis=1, initial=0.0) for x, y in zip(levels, off)}

    def follow(self, values: Array) -> ManyMotions:
        """Return the motions of runs with rows of values (N, keys)."""
        if not self.varies and len(values) > 1:
            return self.follow(values[:1]).part(np.zeros(len(values), dtype=np.int64))
        size = max(1, AT_ONCE // len(self.times))
        parts = [self._follow(values[k : k + size]) for k in range(0, len(values), size)]
        names = ("q", "v", "a", "good")
        return ManyMotions(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @np.errstate(all="ignore")  # what is not finite does not count
    def _follow(self, values: Array) -> ManyMotions:
        runs, last = _Going(self, values), len(self.times) - 1
        strides = Strides(last + 1 < FEWEST)
        while runs.at[-1] < last and runs.good.any():
            strides.go(runs.at[-1], last, runs.go_to)
        motions = runs.at_all()
        while len(runs.at) <= last and len(again := np.flatnonzero(runs.good & ~motions.good)):
            between = ((a + b) // 2 for a, b in itertools.pairwise(runs.at))
            closer, there = sorted({*runs.at, *between} - {0}), runs.good
            runs = _Going(self, values)
            runs.good &= there & ~motions.good
            for k in closer:
                runs.go_to(k)
            motions.put(again, runs.at_all().part(again))
        return motions


class _RunConditions:
    """The conditions of runs, each with its own numbers and time: what ``LoopConditions`` are at samples of one run."""

    def __init__(self, guided: Guided, values: Array, times: Array) -> None:
        base = guided.conditions
        self.lengths, self.sizes, self.manifold, self._base = base.lengths, base.sizes, base.manifold, base
        self.same, self.singular = base.same, base.singular
        self._guided, self._times, self._numbers = guided, times, guided.built.numbers(values)
        each, place = np.unique(times, return_inverse=True)
        self._asked = [x[place] for x in base.lead.asked(each)]

    def _evaluate(self, expressions: Expressions, q: Array, v: Array) -> Array:
        groups = {"q": list(q.T), "v": list(v.T), "t": [self._times], "p": []}
        return self._numbers.evaluate(expressions, groups)

    def part(self, rows: NDArray[np.intp]) -> _RunConditions:
        """Return the conditions of some of the runs."""
        own = copy.copy(self)
        own._numbers, own._times = self._numbers.rows(rows), self._times[rows]
        own._asked = [x[rows] for x in self._asked]
        return own

    def cosines(self, q: Array) -> Array:
        """Return the cosines of the loops' attitudes (N, m)."""
        return self._evaluate(self._guided.cosines, q, np.zeros_like(q))

    def at_runs(self, q: Array) -> tuple[Array, Array]:
        """Return F (N, m) and J (N, m, nv)."""
        return self._base.lacking(self._evaluate(self._guided.here, q, np.zeros_like(q)), q, self._asked[0])

    def at_samples(self, q: Array, samples: slice) -> tuple[Array, Array]:
        return self.at_runs(q)

    def rates_at_samples(self, q: Array, v: Array, samples: slice) -> tuple[Array, Array]:
        return self._base.moving(self._evaluate(self._guided.rates, q, v), *self._asked[1:])


class _Loops:
    """The first m rows of conditions, those of the loops, for ``newton_of_many``."""

    def __init__(self, conditions: _RunConditions, m: int) -> None:
        self._conditions, self.lengths, self.sizes = conditions, conditions.lengths, conditions.sizes[:m]

    def at_runs(self, q: Array) -> tuple[Array, Array]:
        F, J = self._conditions.at_runs(q)
        return F[:, : len(self.sizes)], J[:, : len(self.sizes)]

    def part(self, rows: NDArray[np.intp]) -> _Loops:
        return _Loops(self._conditions.part(rows), len(self.sizes))


class _Going:
    """Runs on their way: the samples that they were at, their places there, and which of them came so far."""

    def __init__(self, guided: Guided, values: Array) -> None:
        self.guided, self.values = guided, values
        now, self.good = self._begin()
        self.at, self.through = [0], [now]

    def _begin(self) -> tuple[Places, Chosen]:
        """Return the places at the first sample: loops closed with joints that lead kept, then all conditions met."""
        guided, count = self.guided, len(self.values)
        conditions = self._conditions(self.values, float(guided.times[0]))
        lead, m = guided.conditions.lead, len(guided.problem.constraints.rows)
        free = [k for k, name in enumerate(guided.problem.model.q_names) if name not in lead.positions]
        loops = _Loops(conditions, m)
        q, left = closure.newton_of_many(loops, np.tile(guided.start, (count, 1)), free)
        places = solve_together(conditions, q, slice(None))
        good = (left <= closure.CLOSED) & places.regular & (places.moved < FARTHEST)
        return places, good & (conditions.cosines(places.q) >= ATTITUDE).all(axis=1)

    def _conditions(self, values: Array, t: float) -> _RunConditions:
        return _RunConditions(self.guided, values, np.full(len(values), t))

    def go_to(self, k: int) -> int:
        """Go on to a sample; returns 1 if all runs made one step, else 2."""
        before, own = self.through[-1], np.flatnonzero(self.good)
        times = self.guided.times
        place = before.part(np.arange(len(self.values)))  # of runs that are lost it is where they were
        steps = 1
        if len(own):
            new, there, halved = self._advance(before.part(own), times[self.at[-1]], times[k], own)
            place.put(own, new)
            self.good[own], steps = there, 2 if halved else 1
        self.at.append(k)
        self.through.append(place)
        return steps

    def _advance(
        self, now: Places, t: float, end: float, rows: NDArray[np.int64], depth: int = 0
    ) -> tuple[Places, Chosen, bool]:
        """Return places at time ``end``, which are on the branch that they come from, and whether steps were halved."""
        h = end - t
        guess = now.q + h * now.v + 0.5 * h * h * now.a
        new = solve_together(self._conditions(self.values[rows], end), guess, slice(None))
        good = new.regular & (new.moved < MISS) & same_branch(now.J, new.J)
        again = np.flatnonzero(~good)
        if not len(again) or depth == HALVINGS:
            return new, good, False
        middle, first, _ = self._advance(now.part(again), t, 0.5 * (t + end), rows[again], depth + 1)
        on = again[first]
        if len(on):
            last, second, _ = self._advance(
                middle.part(np.flatnonzero(first)), 0.5 * (t + end), end, rows[on], depth + 1
            )
            new.put(on, last)
            good[on] = second
        return new, good, True

    def at_all(self) -> ManyMotions:
        """Return the motions at all samples, those between the places solved at once, run by run."""
        times, (count, n) = self.guided.times, self.through[0].q.shape
        q, v, a = np.full((3, count, len(times), n), np.nan)
        motions = ManyMotions(q, v, a, np.zeros(count, dtype=bool))
        own = np.flatnonzero(self.good)
        if len(own):
            motions.put(own, self._at_all(own))
        return motions

    def _at_all(self, own: NDArray[np.int64]) -> ManyMotions:
        times, n = self.guided.times, self.through[0].q.shape[1]
        states = [(x.q[own].ravel(), x.v[own].ravel(), x.a[own].ravel()) for x in self.through]
        shape = (len(times), len(own), n)
        if len(self.at) == len(times):
            q, v, a = (np.array(x).reshape(shape).swapaxes(0, 1) for x in zip(*states))
            return ManyMotions(q, v, a, np.ones(len(own), dtype=bool))
        guess = interpolated(times, self.at, states).reshape(shape).swapaxes(0, 1).reshape(-1, n)
        each = np.repeat(self.values[own], len(times), axis=0)
        places = solve_together(
            _RunConditions(self.guided, each, np.tile(times, len(own))), guess, slice(None)
        )
        counts = (places.regular & (places.moved <= NEAR)).reshape(len(own), -1)
        counts[:, 1:] &= same_branch(places.J[:-1], places.J[1:])[_within(len(own), len(times))]
        q, v, a = (x.reshape(len(own), len(times), n) for x in (places.q, places.v, places.a))
        return ManyMotions(q, v, a, np.asarray(counts.all(axis=1)))


def _within(count: int, samples: int) -> NDArray[np.int64]:
    """Return which of the steps from place to place are within a run (count, samples - 1)."""
    return np.arange(count)[:, None] * samples + np.arange(samples - 1)


LED = "a point of an open chain is led, so lengths change the motion"
WITHOUT_LENGTHS = ("robot.links.", "gravity", "forces.", "torques.")
IN_JOINTS = ("spring", "damper", "friction")


def changes_lengths(keys: Sequence[Key]) -> bool:
    """Tell whether keys may change where the links and their points are at given positions of joints."""

    def dynamic(key: Key) -> bool:
        section, group, *rest = [*key.place.split("."), "", ""]
        in_joint = (section, group) == ("robot", "joints") and not {*rest[1:2]}.isdisjoint(IN_JOINTS)
        return in_joint or key.place.startswith(WITHOUT_LENGTHS)

    return not all(key.sort == NUMBER and dynamic(key) for key in keys)


def guided_reasons(problem: Problem, lead: Lead | None, keys: Sequence[Key]) -> dict[str, bool]:
    """Return why motions of many runs are not followed together, by whether that holds."""
    scene, model = problem.scene, problem.model
    trajectory = scene.trajectory
    point = isinstance(trajectory, TaskSpaceTrajectory)
    known = {*scene.initial.q, *(lead.positions if lead else ()), *(trajectory.ik.guess if point else ())}
    return {
        "joints of several axes move": model.nq != model.nv or model.q_names != model.v_names,
        "joints are prescribed": bool(scene.prescribed),
        "joints without an initial position close the loops": bool(model.closures)
        and known < set(model.q_names),
        "a point is led relative to a body": lead is not None
        and lead.led is not None
        and lead.led.relative_to is not None,
        "the motion asked for varies": any(key.sort != NUMBER for key in keys)
        or any(key.place.startswith(("kinematics.", "trajectory.", "parameters.")) for key in keys),
    }
