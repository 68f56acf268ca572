"""``inverse`` for many runs: torques along one motion, or along those of mechanisms, with the numbers of each run."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.drives.report import UNDERSIZED
from robodyn_cli.errors import FAILED, RobodynError
from robodyn_cli.given.motion import Planned
from robodyn_cli.over.many.command import (
    STATUS,
    TOO_SMALL,
    AskedRuns,
    BatchCommand,
    ManyRuns,
    Rows,
    error_of,
    number_of,
)
from robodyn_cli.over.many.groups import table_rows
from robodyn_cli.over.many.keys import Key
from robodyn_cli.over.many.torques import ENTRIES, InverseStructure
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import as_keys
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.inverse import ROUNDING
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.torques.checks import FIGURES, Loaded, breaks_of, error_estimate
from robodyn_cli.torques.program import Sampled
from robodyn_cli.works.inverse import inverse, looked_at, summarise


def figure_of(key: str) -> tuple[str, str] | None:
    """Return the joint and the figure that a key of the summary is about; None where it is no figure of a joint."""
    leaf = leaf_of("inverse", key)
    joint = leaf.names[0] if leaf is not None and leaf.names else ""
    section, _, figure = leaf.key.partition(f".{joint}.") if leaf is not None else ("", "", "")
    known = figure in FIGURES or figure.startswith("errors.")
    return (joint, figure) if section == "joints" and known else None


class Figures:
    """Figures of joints and their errors (N,) in many runs, by key of the summary; each is computed once.

    Parameters
    ----------
    loaded : columns of all joints of all runs. joints : of a run. rounding : of the torques in each run (N,).
    """

    def __init__(self, loaded: Loaded, joints: Sequence[str], rounding: Callable[[], Array]) -> None:
        self._loaded, self._joints, self._round = loaded, list(joints), rounding
        self._known: dict[str, tuple[Array, Array]] = {}

    @cached_property
    def _rounding(self) -> Array:
        return self._round()

    def __getitem__(self, key: str) -> tuple[Array, Array]:
        """Return a figure and the largest error that its declaration names; nan of a joint that is not there."""
        joint, figure = figure_of(key) or ("", "")
        leaf = leaf_of("inverse", key)
        if leaf is None or joint not in self._joints:
            nothing = np.full(self._loaded.tau.shape[1] // max(len(self._joints), 1), np.nan)
            return nothing, nothing
        if figure not in FIGURES:
            error = self._error(joint, key)
            return error, np.full_like(error, np.nan)
        errors = [self._error(joint, error) for error in leaf.errors]
        return self._columns(figure, joint)[0], np.fmax.reduce(errors)

    def _columns(self, figure: str, joint: str) -> tuple[Array, Array]:
        if figure not in self._known:
            self._known[figure] = FIGURES[figure](self._loaded)
        k, step = self._joints.index(joint), len(self._joints)
        value, error = self._known[figure]
        return value[k::step], error[k::step]

    def _error(self, joint: str, key: str) -> Array:
        """Return the error that stands under a key of the summary."""
        if key == ROUNDING:
            return self._rounding
        name = key.rpartition(".")[2]
        if name == "energy":
            name = (
                "energy_net"  # has the same error, and takes no search for where the power changes its sign
            )
        return np.max([self._columns(x, joint)[1] for x in FIGURES if x.partition(".")[0] == name], axis=0)


# sections of the summary beside figures of joints that are found for many runs; counters are those of single runs
UNIQUE = "unique"
# what the summary says of every run that is made here where a scene expects one of them
WORDS: Mapping[str, str] = {"mechanism.torques": UNIQUE, "mechanism.multipliers": UNIQUE}
SECTIONS = (
    "attitude_residual",
    "constraint_residual",
    "drives",
    "error_estimate",
    "flywheel",
    "ik_residual",
    "mechanism",
    "motorisation",
    "reactions",
    "round_trip",
    "samples",
    "shaking",
    "termination",
)


class InverseRuns(BatchCommand[InverseStructure]):
    """Torques of the scene's trajectory; ends are the ends of the motion."""

    name = "inverse"
    sampled = ("q", "qd", "qdd", "tau")
    words = WORDS
    missed: Mapping[str, Any] = {STATUS: UNDERSIZED, **WORDS}
    judges = True

    def structure(self, family: Family, keys: Sequence[Key], row: Array) -> InverseStructure:
        return InverseStructure(family, keys, row)

    def is_plain(self, key: str) -> bool:
        leaf = leaf_of("inverse", key)
        known = leaf is not None and leaf.is_number and leaf.key.partition(".")[0] in SECTIONS
        return known or key in self.words or figure_of(key) is not None

    def with_samples(self, scene: Scene, samples: int) -> Scene:
        return dataclasses.replace(scene, inverse=dataclasses.replace(scene.inverse, samples=samples))

    @np.errstate(
        all="ignore"
    )  # runs with numbers that are not finite are left to ``inverse``, which names them
    def make(self, structure: InverseStructure, rows: Rows, asked: AskedRuns) -> list[int]:
        samples = asked.samples or structure.program.problem.scene.inverse.samples
        times = structure.program.looked_at(samples)
        if structure.lead is None:  # one motion
            times = looked_at(structure.program, samples, structure.planned).times
        tables = table_rows(structure.tables, structure.numbers(asked.result.values[rows]))
        beside = [key for key in asked.result.outputs if figure_of(key) is None]
        one_motion = structure.lead is None and not beside and not structure.beside.judges
        left: list[int] = []
        runs = max(1, ENTRIES // (structure.size * len(times)))
        for first in range(0, len(rows), runs):
            part = slice(first, first + runs)
            evaluate = self._evaluate if one_motion else self._evaluate_each
            left += evaluate(structure, times, tables[part], rows[part], asked)
        return left

    def _evaluate(
        self, structure: InverseStructure, times: Array, tables: Array, rows: Rows, asked: AskedRuns
    ) -> list[int]:
        """Keep the runs of one motion with rows of tables; return those that are left to be made one by one."""
        result, planned, program = asked.result, structure.planned(times), structure.program
        motion = planned.motion
        tau, good = structure.torques(planned, tables)
        tau, to = tau[good], rows[good]
        loaded = Loaded(
            times, tau.reshape(-1, len(times)).T, np.tile(motion.qd, (1, len(tau))),
            breaks_of(program.problem, times, motion),
        )  # fmt: skip
        sampled = Sampled(times, motion, program.parameters(times), {}, {}, {})
        figures = Figures(loaded, result.qd_names, lambda: structure.rounding(sampled, result.values[to]))
        for key, column in result.outputs.items():
            column[to], result.errors[key][to] = figures[key]
        result.code[to], result.time[to] = 0, times[-1]
        result.q[to], result.qd[to] = motion.q[-1], motion.qd[-1]
        if asked.samples:
            own = structure.planned(program.times(asked.samples))
            tau = structure.torques(own, tables[good])[0].transpose(0, 2, 1)
            _keep_samples(result, to, own, tau)
        return [int(row) for row in rows[~good]]

    def _evaluate_each(
        self, structure: InverseStructure, times: Array, tables: Array, rows: Rows, asked: AskedRuns
    ) -> list[int]:
        """The same for runs whose motions, or whose summaries, are their own."""
        result, values = asked.result, asked.result.values[rows]
        alike = structure.numbers(values).decided_alike(structure.forward)
        worded = bool(set(self.words) & set(structure.program.problem.scene.expect))
        made: list[_MadeRun] = []
        for k, planned in enumerate(structure.motions(values, times)):
            if planned is None or not alike[k] or structure.turns_in_crowds(planned):
                continue
            with contextlib.suppress(RobodynError):  # the command names it
                sampled = structure.sampled(planned, tables[k])
                loops = sampled.loops
                if not worded or loops is None or set(loops.shared.uniqueness) == {UNIQUE}:
                    run = _MadeRun(structure, values[k : k + 1], int(rows[k]), planned, sampled)
                    run.beside  # noqa: B018 - what the command refuses is left to it
                    made.append(run)
        for runs in _with_equal_breaks(made):
            _keep_figures(structure, runs, result)
        for run in made:
            row, motion = run.row, run.planned.motion
            result.code[row], result.time[row] = 0 if run.beside[1] else FAILED, times[-1]
            result.reason[row] = "" if run.beside[1] else TOO_SMALL
            result.q[row], result.qd[row] = motion.q[-1], motion.qd[-1]
        kept = {run.row for run in made}
        if asked.samples:
            own = structure.motions(values, structure.program.times(asked.samples))
            for k, planned in enumerate(own):
                if planned is not None and rows[k] in kept:
                    _keep_samples(
                        result, rows[k : k + 1], planned, structure.sampled(planned, tables[k]).tau[None]
                    )
        return [row for row in rows.tolist() if row not in kept]

    def single(self, scene: Scene) -> Result:
        return inverse(scene)

    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        if (termination := summary.get("termination")) is not None:
            result.time[row] = termination["time"]
        if result.samples:
            result.q[row], result.qd[row] = (result.samples[name][row, -1] for name in ("q", "qd"))


def _keep_samples(result: ManyRuns, rows: Rows, planned: Planned, tau: Array) -> None:
    """Write the samples of runs that have one motion, with their torques (N, T, nv)."""
    kept, motion = result.samples, planned.motion
    kept["tau"][rows], kept["time"][rows] = tau, planned.times
    kept["q"][rows], kept["qd"][rows], kept["qdd"][rows] = motion.q, motion.qd, motion.qdd


@record
class _MadeRun:
    """A run: its values (1, keys), its row of the result, its motion, and what is evaluated along it."""

    structure: InverseStructure
    values: Array
    row: int
    planned: Planned
    sampled: Sampled

    @cached_property
    def loaded(self) -> Loaded:
        return Loaded.of(self.structure.program.problem, self.sampled)

    @cached_property
    def rounding(self) -> float:
        return float(self.structure.rounding(self.sampled, self.values)[0])

    @cached_property
    def beside(self) -> tuple[list[Any], bool]:
        """The records of drives, margins, shaking forces and a flywheel, and whether drives and margins suffice."""
        numbers = self.structure.numbers(self.values)
        return self.structure.beside.records(self.sampled, numbers, self.loaded.breaks)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The summary of the run but for the figures of its joints."""
        program, numbers = self.structure.program, self.structure.numbers(self.values)
        errors = error_estimate(program, self.planned, self.sampled, self.loaded, numbers)
        own = summarise(program, self.planned, self.sampled, self.loaded, errors, ())
        own = dataclasses.replace(
            own, reactions=self.structure.loads(self.sampled, self.values, self.loaded.breaks)
        )
        keys = {**as_keys(own), "samples": program.problem.scene.inverse.samples}
        for record_of in self.beside[0]:
            keys |= as_keys(record_of)
        return keys


def _with_equal_breaks(runs: Sequence[_MadeRun]) -> list[list[_MadeRun]]:
    """Return runs in groups whose torques jump or bend at the same times."""
    groups: dict[tuple[float, ...], list[_MadeRun]] = {}
    for run in runs:
        groups.setdefault(tuple(run.loaded.breaks), []).append(run)
    return list(groups.values())


def _keep_figures(structure: InverseStructure, runs: Sequence[_MadeRun], result: ManyRuns) -> None:
    """Write the outputs of runs whose torques jump or bend at the same times."""
    rows, driven = np.array([run.row for run in runs]), structure.driven
    tau, qd = (
        np.hstack([x[:, driven] for x in own])
        for own in zip(*((r.sampled.tau, r.planned.motion.qd) for r in runs))
    )
    loaded = Loaded(runs[0].planned.times, tau, qd, runs[0].loaded.breaks)
    names = [structure.program.problem.model.v_names[k] for k in driven]
    figures = Figures(loaded, names, lambda: np.array([run.rounding for run in runs]))
    for key, column in result.outputs.items():
        if figure_of(key) is not None:
            column[rows], result.errors[key][rows] = figures[key]
        else:
            column[rows] = [number_of(run.summary, key) for run in runs]
            result.errors[key][rows] = [error_of({"command": "inverse", **run.summary}, key) for run in runs]
