"""``kinematics`` for many runs: loops that joints lead are closed for all of them at once, sample after sample.

It is Newton's method of ``solve/guided.py`` on arrays: the same conditions, extrapolation and bounds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.fixed import witnessed
from robodyn_cli.expr.many import Expressions, ManyNumbers
from robodyn_cli.given.loop_conditions import Lead, LoopConditions
from robodyn_cli.given.prescribed import prescribed_starts
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.kernels.program import make_program
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.over.many.command import AskedRuns, BatchCommand, ManyRuns, Rows
from robodyn_cli.over.many.groups import Built, first_of
from robodyn_cli.over.many.keys import NUMBER, Key, settings
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import MOST_STEP
from robodyn_cli.solve.guided import CLOSED, ITERATIONS, MISS, SAME, SINGULAR
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.works.kinematics import (
    AT_SAMPLE,
    between_samples,
    closer_times,
    hermite,
    kinematics,
    leading,
    outputs,
    problem_of,
)

HALVINGS = 8  # of the way between samples; what needs more is left to the command
NEAR = 1e-6  # rad, or part of the size, by which closed loops still move
HALVED, LARGEST_ROUNDS, SLOW = 12, 60, 3  # as in ``newton``: halvings, rounds, and slow ones in a row
ATTITUDE = 0.5  # cosine, below which links are half a turn away from the attitude that is asked for
TINY = 1e-300
PLACES = ("points", "point_velocities", "point_accelerations")


@record
class Going:
    """Where runs are: positions, rates and accelerations (N, nv), and determinants of J^T J there."""

    q: Array
    v: Array
    a: Array
    J: Array

    def part(self, rows: NDArray[Any]) -> Going:
        """Return some of them."""
        return Going(self.q[rows], self.v[rows], self.a[rows], self.J[rows])

    def put(self, rows: NDArray[Any], other: Going) -> None:
        """Put others in the place of some of them."""
        for name in ("q", "v", "a", "J"):
            getattr(self, name)[rows] = getattr(other, name)


class KinematicsStructure(Built):
    """The conditions of a scene with one row of values.

    Raises
    ------
    RobodynError : there is no motion with these values.
    """

    def __init__(self, family: Family, keys: Sequence[Key], row: Array) -> None:
        scene = family.scene(settings([key.name for key in keys], row))
        with witnessed() as witnesses:
            self.problem = problem_of(scene)
            self.lead, samples = leading(self.problem)
            self.times = closer_times(self.problem, samples)
            known = outputs(self.problem)
            places = {path: x for path, x in known.items() if path.partition("/")[0] in PLACES}
            conditions = {} if self.lead is None else self._conditions(self.lead)
            program = make_program({**conditions, **places}, MOTION_GROUPS)
        self.places = {path: Expressions(x) for path, x in places.items()}
        self.levels = {name: Expressions(x) for name, x in conditions.items()}
        self.cosines = Expressions([row.cosine for row in self.problem.constraint_rows])
        super().__init__(
            keys, row, Tables([program]), witnesses, obstacle(self.problem, self.lead, self.times, keys)
        )

    def _conditions(self, lead: Lead) -> dict[str, list[Any]]:
        self.conditions = LoopConditions(self.problem, lead, self.times)
        return dict(zip(("values", "rates", "accelerations", "J"), self.conditions.levels()))


def obstacle(problem: Problem, lead: Lead | None, times: Array, keys: Sequence[Key]) -> str:
    """Return why runs are made one by one; nothing where their loops are closed together."""
    scene, model = problem.scene, problem.model
    reasons = {
        "an open chain is led": lead is None,
        "a point is led": lead is not None and lead.led is not None,
        "joints of several axes move": model.nq != model.nv or model.q_names != model.v_names,
        "joints are prescribed": bool(scene.prescribed),
        "places are wanted behind the end": any(
            t > times[-1] * (1.0 + AT_SAMPLE) for t in scene.kinematics.at
        ),
        "joints without an initial position close the loops": set(scene.initial.q)
        | set(lead.positions if lead else ())
        < set(model.q_names),
        "what is asked of the motion varies": any(key.sort != NUMBER for key in keys)
        or any(key.place.startswith(("kinematics.", "trajectory.", "parameters.")) for key in keys),
    }
    return first_of(reasons)


class ManyGuides:
    """Follows the motion of many runs of a structure, with the numbers of each."""

    def __init__(self, structure: KinematicsStructure, numbers: ManyNumbers) -> None:
        self.structure, self.numbers, self.conditions = structure, numbers, structure.conditions
        self.nv, self.count = structure.problem.model.nv, numbers.runs

    def _evaluate(self, expressions: Expressions, place: Going, t: float, rows: NDArray[Any]) -> Array:
        """Return expressions (N, n) at the places of some runs; those of others are computed in vain."""
        groups = {}
        for name, own in (("q", place.q), ("v", place.v), ("a", place.a)):
            whole = np.zeros((self.count, self.nv))
            whole[rows] = own
            groups[name] = list(whole.T)
        out = self.numbers.evaluate(expressions, {**groups, "t": [np.full(self.count, t)], "p": []})
        return np.asarray(out[rows])

    def _scaled(self, J: Array) -> Array:
        return np.asarray(J * self.conditions.lengths / self.conditions.sizes[:, None])

    def at(self, place: Going, t: float, rows: NDArray[Any]) -> tuple[Array, Array]:
        """Return what the conditions lack (N, m), and J (N, m, nv)."""
        levels, wanted = self.structure.levels, self.conditions.asked(t)[0]
        eta = self._evaluate(levels["values"], place, t, rows)
        columns = [self.structure.problem.model.q_names.index(name) for name in self.structure.lead.positions]  # type: ignore[union-attr]
        F = np.concatenate([eta, place.q[:, columns] - wanted], axis=1)
        return F, self._evaluate(levels["J"], place, t, rows).reshape(
            len(F), len(self.conditions.names), self.nv
        )

    def solve(self, guess: Array, t: float, rows: NDArray[Any]) -> tuple[Going, Array, Array]:
        """Return places at a time near positions (N, nv), what the conditions lack, and how far they moved."""
        sizes, lengths = self.conditions.sizes, self.conditions.lengths
        nothing = np.zeros_like(guess)
        place, moved = Going(guess, nothing, nothing, np.zeros(len(guess))), nothing.copy()
        F, J = self.at(place, t, rows)
        for _ in range(ITERATIONS):
            step = _least(self._scaled(J), -F / sizes)
            place, moved = dataclasses.replace(place, q=place.q + step * lengths), moved + step
            F, J = self.at(place, t, rows)
            if np.abs(step).max(initial=0.0) < CLOSED:
                break
        left = np.abs(F / sizes).max(axis=1, initial=0.0)
        return self._moving(place, J, t, rows), left, np.abs(moved).max(axis=1, initial=0.0)

    def _moving(self, place: Going, J: Array, t: float, rows: NDArray[Any]) -> Going:
        """Return places with rates and accelerations."""
        levels, (_, rate, acceleration) = self.structure.levels, self.conditions.asked(t)
        led = len(rate)
        c = -self._evaluate(levels["rates"], place, t, rows)
        c[:, c.shape[1] - led :] += rate
        place = dataclasses.replace(place, v=_least(J, c))
        b = -self._evaluate(levels["accelerations"], place, t, rows)
        b[:, b.shape[1] - led :] += acceleration
        return dataclasses.replace(place, a=_least(J, b), J=self._scaled(J))

    def advance(
        self, now: Going, t: float, end: float, rows: NDArray[Any], depth: int = 0
    ) -> tuple[Going, Array]:
        """Return places at time ``end``, and which of them are on the branch that they come from."""
        h = end - t
        new, left, moved = self.solve(now.q + h * now.v + 0.5 * h * h * now.a, end, rows)
        s = np.linalg.svd(new.J, compute_uv=False)
        sign = np.linalg.det(now.J.transpose(0, 2, 1) @ new.J)
        good = (left < SAME) & (moved < MISS) & (sign > 0.0) & (s[:, -1] > SINGULAR * s[:, 0])
        again = np.flatnonzero(~good)
        if len(again) and depth < HALVINGS:
            middle, first = self.advance(now.part(again), t, 0.5 * (t + end), rows[again], depth + 1)
            last, second = self.advance(middle, 0.5 * (t + end), end, rows[again], depth + 1)
            new.put(again, last)
            good[again] = first & second
        return new, good

    def closed(self, q: Array) -> Array:
        """Return positions with loops closed by the steps of ``newton`` of ``solve/closure.py``, led joints kept."""
        names = self.structure.problem.model.q_names
        lead, m = self.structure.lead, len(self.structure.problem.constraints.rows)
        assert lead is not None
        columns = [k for k, name in enumerate(names) if name not in lead.positions]
        lengths, sizes, rows = self.conditions.lengths[columns], self.conditions.sizes[:m], np.arange(len(q))

        def lacking(q: Array) -> tuple[Array, Array, Array]:
            nothing = np.zeros_like(q)
            F, J = self.at(Going(q, nothing, nothing, np.zeros(len(q))), float(self.structure.times[0]), rows)
            F = F[:, :m] / sizes
            return F, J[:, :m][:, :, columns] * lengths / sizes[:, None], np.abs(F).max(axis=1)

        F, J, size = lacking(q)
        active, slow = np.isfinite(size), np.zeros(len(q))
        for _ in range(LARGEST_ROUNDS):
            active &= np.isfinite(J).all(axis=(1, 2)) & (size > TINY)
            if not active.any():
                break
            step = np.zeros((len(q), len(columns)))
            step[active] = _least(J[active], -F[active])
            step *= np.minimum(1.0, MOST_STEP / np.maximum(np.abs(step).max(axis=1), TINY))[:, None]
            waiting, before = active.copy(), size.copy()
            for _ in range(HALVED):
                trial = q.copy()
                trial[:, columns] += step * lengths
                F_new, J_new, new = lacking(trial)
                takes = waiting & (new < size)
                q[takes], F[takes], J[takes], size[takes] = (
                    trial[takes],
                    F_new[takes],
                    J_new[takes],
                    new[takes],
                )
                waiting &= ~takes
                if not waiting.any():
                    break
                step[waiting] *= 0.5
            slow = np.where(size > 0.5 * before, slow + 1, 0)
            active &= ~waiting & (slow <= SLOW)
        return q

    def follow(self, start: Array, times: Array) -> tuple[list[Going], Array]:
        """Return the places at times (T,), from positions nearby (N, nv), and which runs come to the end."""
        rows = np.arange(self.count)
        now, left, moved = self.solve(self.closed(start), float(times[0]), rows)
        s = np.linalg.svd(now.J, compute_uv=False)
        good = (left < SAME) & (moved < NEAR) & (s[:, -1] > SINGULAR * s[:, 0])
        good &= (self._evaluate(self.structure.cosines, now, 0.0, rows) >= ATTITUDE).all(axis=1)
        places = [now]
        for t, end in zip(times.tolist(), times[1:].tolist()):
            own = np.flatnonzero(good)
            if not len(own):
                break
            new, there = self.advance(now.part(own), t, end, rows[own])
            now = Going(now.q.copy(), now.v.copy(), now.a.copy(), now.J.copy())
            now.put(own, new)
            good[own] = there
            places.append(now)
        return places, good


def _least(J: Array, F: Array) -> Array:
    """Return x (N, n) with J x = F, of least norm and least error."""
    return np.asarray(np.linalg.pinv(J) @ F[..., None])[..., 0]


class KinematicsRuns(BatchCommand[KinematicsStructure]):
    """Motions that joints lead; ends are the ends of the motion."""

    name = "kinematics"

    def structure(self, family: Family, keys: Sequence[Key], row: Array) -> KinematicsStructure:
        return KinematicsStructure(family, keys, row)

    def is_plain(self, key: str) -> bool:
        return key.startswith("at.") and not key.endswith(".time")

    def with_samples(self, scene: Scene, samples: int) -> Scene:
        return dataclasses.replace(scene, kinematics=dataclasses.replace(scene.kinematics, samples=samples))

    @np.errstate(all="ignore")  # what is not finite is left to the command, which names it
    def make(self, structure: KinematicsStructure, rows: Rows, asked: AskedRuns) -> list[int]:
        result, problem, times = asked.result, structure.problem, structure.times
        values = result.values[rows]
        guides = ManyGuides(structure, structure.numbers(values))
        given = {**problem.scene.initial.q, **prescribed_starts(problem.scene)}
        lead = structure.lead
        assert lead is not None
        given |= dict(zip(lead.positions, lead.asked(times[:1])[0][0].tolist()))
        start = np.tile([given[name] for name in problem.model.q_names], (len(rows), 1))
        try:
            places, good = guides.follow(start, times)
        except np.linalg.LinAlgError:
            good = np.zeros(len(rows), dtype=bool)
        if not good.any():
            return rows.tolist()
        for key, column in result.outputs.items():
            value, error = self._output(key, guides, places)
            column[rows], result.errors[key][rows] = value, error
            good &= np.isfinite(value)
        result.code[rows[good]], result.time[rows[good]] = 0, times[-1]
        result.q[rows], result.qd[rows] = places[-1].q, places[-1].v
        left: list[int] = rows[~good].tolist()
        return left

    def _output(self, key: str, guides: ManyGuides, places: Sequence[Going]) -> tuple[Array, Array]:
        """Return a coordinate of a point at one of the times (N,), or its error, and the error of that."""
        structure = guides.structure
        _, number, _, *name, axis = key.split(".")
        at, point = structure.problem.scene.kinematics.at, ".".join(name)
        nothing = np.full(guides.count, np.nan)
        if int(number) >= len(at) or f"points/{point}" not in structure.places:
            return nothing, nothing
        k, h, s = between_samples(at[int(number)], structure.times)
        rows = np.arange(guides.count)
        ends = []
        for j in (k, k + 1):
            paths = [structure.places.get(f"{group}/{point}") for group in PLACES]
            t = float(structure.times[j])
            own = [
                np.zeros((guides.count, 3)) if x is None else guides._evaluate(x, places[j], t, rows)
                for x in paths
            ]
            ends.append((own[0], own[1], own[2]))
        y, off = hermite(ends, h, s)
        error = off.max(axis=1) + CLOSED
        return (error, nothing) if axis == "error" else (y[:, "xyz".index(axis)], error)

    def single(self, scene: Scene) -> Result:
        return kinematics(scene)

    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        if (termination := summary.get("termination")) is not None:
            result.time[row] = termination["time"]
