"""``kinematics`` for many runs: loops that joints or a point lead are closed for all of them at once (``guides``)."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.algorithms.bands import singular_values
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import RobodynError
from robodyn_cli.expr.fixed import witnessed
from robodyn_cli.given.loop_conditions import Lead
from robodyn_cli.given.motion import Planned, knot_places, plan_motion
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.observe.columns import chosen_extremes
from robodyn_cli.over.many.command import AskedRuns, BatchCommand, ManyRuns, Rows, error_of, number_of
from robodyn_cli.over.many.groups import Built, first_of, table_rows
from robodyn_cli.over.many.guides import LED, Guided, ManyMotions, changes_lengths, guided_reasons
from robodyn_cli.over.many.keys import Key, settings
from robodyn_cli.ready.singularity import mobility
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import as_keys
from robodyn_cli.scene.checks.columns import DESIGNED, asking
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.guided import CLOSED
from robodyn_cli.solve.quadrature import spaced
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.design import DesignFigures
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.summaries.mechanism import JointRange, RangeErrors
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.trajectories.course import between
from robodyn_cli.trajectories.led import velocity_columns
from robodyn_cli.trajectories.motion import JointMotion
from robodyn_cli.works.kinematic_figures import (
    AT_SAMPLE,
    PLACES,
    Figures,
    between_samples,
    path_figures,
    range_figures,
    ratio_figures,
    transmission_angle,
    transmission_figures,
)
from robodyn_cli.works.kinematics import closer_times, kinematics, leading, outputs, problem_of, report

# sections of the summary whose numbers are found for many runs; counters are those of single runs
SECTIONS = (
    "at",
    "design",
    "error_estimate",
    "extremes",
    "joints",
    "mobility",
    "points",
    "samples",
    "singular_ratio",
    "termination",
    "transmission_angle",
)
TOLD = ("design", "extremes")  # those that the command says of each run from its arrays
FOUR_BARS = "design.four_bars."
ENTRIES = 4_000_000  # of evaluated arrays at a time: 32 MB


class KinematicsStructure(Built):
    """The equations of a scene with one row of values.

    Raises
    ------
    RobodynError : there is no motion with these values.
    """

    def __init__(self, family: Family, keys: Sequence[Key], row: Array) -> None:
        scene = family.scene(settings([key.name for key in keys], row))
        with witnessed() as witnesses:
            self.problem = problem_of(scene)
            self.lead, self.samples = leading(self.problem)
            self.times = closer_times(self.problem, self.samples)
            self.guided = None if self.lead is None else Guided(self, self.problem, self.lead, self.times)
            self.paths = {**_designed(self.problem), **outputs(self.problem)}
            # without names from the scene, scenes with equal equations share their code
            self.kernel = SampleKernel({f"o{k}": x for k, x in enumerate(self.paths.values())}, MOTION_GROUPS)
            poses = _pins(self.problem)
            self.pins = SampleKernel(poses, ("t", "q")) if poses else None
        self.breaks = spaced(knot_places(self.problem.scene, self.times), len(self.times))
        self.size = sum(len(x) for x in self.paths.values())
        super().__init__(
            keys,
            row,
            Tables([self.kernel.program, None if self.pins is None else self.pins.program]),
            witnesses,
            obstacle(self.problem, self.lead, self.times, keys),
        )

    def motions(self, values: Array) -> ManyMotions:
        """Return the motions of runs with rows of values (N, keys)."""
        if self.guided is not None:
            return self.guided.follow(values)
        own = plan_motion(self.problem, self.times).motion
        q, v, a = (np.tile(x, (len(values), 1, 1)) for x in (own.q, own.qd, own.qdd))
        return ManyMotions(q, v, a, np.ones(len(values), dtype=bool))

    def evaluated(self, values: Array, motions: ManyMotions) -> dict[str, Array]:
        """Return what is evaluated along motions (T, N, n), by path."""
        groups = {"t": self.times[:, None], "q": motions.q, "v": motions.v, "a": motions.a}
        arrays = self.kernel.of_tables(self._tables(self.kernel, values), len(self.times), groups)
        return {path: np.moveaxis(arrays[f"o{k}"], 2, 0) for k, path in enumerate(self.paths)}

    def poses(self, values: Array, motions: ManyMotions) -> dict[str, Array]:
        """Return the poses (N, 12) at the start of motions that chains of four links are found by."""
        if self.pins is None:
            return {}
        groups = {"t": self.times[:1, None], "q": motions.q[:, :1]}
        return {
            k: x[:, :, 0] for k, x in self.pins.of_tables(self._tables(self.pins, values), 1, groups).items()
        }

    def _tables(self, kernel: SampleKernel, values: Array) -> Array:
        """Return the tables (N, n) of a kernel for rows of values."""
        first = self.tables.start(kernel.program)
        return table_rows(self.tables, self.numbers(values))[:, first : first + len(kernel.program.table)]


def _designed(problem: Problem) -> dict[str, list[Any]]:
    """Return the expressions that kinematic design follows from, where a scene asks for it."""
    if problem.scene.kinematics.design is None:
        return {}
    from robodyn_cli.works.design import Designed

    return Designed.outputs(problem)


def _pins(problem: Problem) -> dict[str, list[Any]]:
    """Return the expressions that chains of four links follow from, where a scene asks for these."""
    if problem.scene.kinematics.design is None or not problem.scene.kinematics.design.grashof:
        return {}
    from robodyn_cli.works.four_bars import pose_outputs

    return pose_outputs(problem)


def obstacle(problem: Problem, lead: Lead | None, times: Array, keys: Sequence[Key]) -> str:
    """Return why runs are made one by one; nothing where their motions are found together."""
    scene = problem.scene
    point = isinstance(scene.trajectory, TaskSpaceTrajectory)
    reasons = {
        LED: point and (lead is None or lead.led is None) and changes_lengths(keys),
        "places are wanted behind the end": any(
            t > times[-1] * (1.0 + AT_SAMPLE) for t in scene.kinematics.at
        ),
        "margins of motorisation are judged": scene.motorisation is not None,
        **guided_reasons(problem, lead, keys),
    }
    return first_of(reasons)


class ManyFigures:
    """Figures of the motions of many runs, by key of the summary; each group is found once, when it is asked for.

    Parameters
    ----------
    values : of the keys (N, keys). keys : that are asked for.
    """

    def __init__(
        self, structure: KinematicsStructure, values: Array, motions: ManyMotions, keys: Sequence[str]
    ) -> None:
        self.structure, self.values, self.motions, self.keys = structure, values, motions, keys
        self.scene, self.times, self.breaks = structure.problem.scene, structure.times, structure.breaks
        self.closed = CLOSED if structure.problem.model.closures else 0.0
        self._known: dict[tuple[str, str], Figures] = {}

    @cached_property
    def arrays(self) -> dict[str, Array]:
        """What is evaluated along the motions (T, N, n), by path."""
        return self.structure.evaluated(self.values, self.motions)

    @cached_property
    def psi(self) -> Array:
        """Psi of the loops (T, N, m, nv)."""
        psi = self.arrays["psi"]
        return psi.reshape(*psi.shape[:2], -1, self.structure.problem.model.nv)

    def __getitem__(self, key: str) -> tuple[Array, Array]:
        """Return a figure and its error (N,); nan of what a run does not have."""
        leaf, nothing = leaf_of("kinematics", key), np.full(len(self.values), np.nan)
        section, _, rest = (key if leaf is None else leaf.key).partition(".")
        if section in TOLD:
            own = np.array([(number_of(told, key), error_of(told, key)) for told in self._told])
            return own[:, 0], own[:, 1]
        name, _, figure = rest.rpartition(".")
        of_errors = name == "errors" or name.endswith(".errors") or figure.endswith("_error")
        name, figure = name.removesuffix("errors").removesuffix("."), figure.removesuffix("_error")
        if (section, name) not in self._known:
            self._known[section, name] = getattr(self, f"_{section}")(name)
        value, error = self._known[section, name].get(figure, (nothing, nothing))
        return (error, nothing) if of_errors else (value, error)

    @cached_property
    def _told(self) -> list[dict[str, Any]]:
        """What the command says of extremes and of kinematic design in each run; nothing where it refuses one."""
        told = []
        for k in range(len(self.values)):
            told.append({"command": "kinematics"})
            with contextlib.suppress(RobodynError):
                told[-1] |= self._told_of(k)
        return told

    def _told_of(self, k: int) -> dict[str, Any]:
        problem, lead, names = (
            self.structure.problem,
            self.structure.lead,
            asking(self.scene, self.keys).outputs.extremes,
        )
        motion = JointMotion(
            *(np.asfortranarray(x[k]) for x in (self.motions.q, self.motions.v, self.motions.a))
        )
        planned, found = Planned(self.times, motion), {}
        arrays = {path: x[:, k] for path, x in self.arrays.items()}
        if own := [name for name in names if not name.startswith(DESIGNED)]:
            led = problem.model.v_names if lead is None else lead.joints
            places = {path: arrays[path] for path in outputs(problem)}
            found = chosen_extremes(report(problem, planned, led, places), own, self.breaks, self.closed)
        figures = DesignFigures(ABSENT, ABSENT, ABSENT)
        if self.scene.kinematics.design is not None:
            from robodyn_cli.works.design import Designed

            looked = Designed(problem, planned, arrays)
            looked.asked = names
            found |= looked.extremes()
            figures = DesignFigures(self._four_bars(k), looked.dead_points, looked.unbounded)
        return {"extremes": {name: as_keys(x) for name, x in found.items()}, "design": as_keys(figures)}

    @cached_property
    def _chained(self) -> tuple[dict[str, Array], dict[str, Figures]]:
        """What chains of four links follow from: poses at the start, and where joints go."""
        names = self.structure.problem.model.v_names
        return self.structure.poses(self.values, self.motions), {name: self._joints(name) for name in names}

    def _four_bars(self, k: int) -> Any:
        """Return the chains of four links of a run, where they are asked for."""
        if not any(key.startswith(FOUR_BARS) for key in self.keys):
            return ABSENT
        from robodyn_cli.works.four_bars import four_bars

        poses, joints = self._chained
        gone = {}
        for name, figures in joints.items():
            own, off = ({x: float(one[part][k]) for x, one in figures.items()} for part in (0, 1))
            gone[name] = JointRange(**own, errors=RangeErrors(**off), units={})
        own_poses = {name: x[k] for name, x in poses.items()}
        return four_bars(self.structure.problem, own_poses, self.motions.q[k, 0], gone)

    def _joints(self, name: str) -> Figures:
        names = self.structure.problem.model.v_names
        if name not in names:
            return {}
        q, v, a = (x[:, :, names.index(name)].T for x in (self.motions.q, self.motions.v, self.motions.a))
        return range_figures(self.times, (q, v, a), self.breaks, self.closed)

    def _points(self, name: str) -> Figures:
        ways = [self.arrays.get(f"{group}/{name}") for group in PLACES[1:]]
        if ways[0] is None or ways[1] is None:
            return {}
        return path_figures(self.times, ways[0], ways[1], self.breaks)

    def _transmission_angle(self, _: str) -> Figures:
        points = self.scene.kinematics.transmission
        if points is None:
            return {}
        return transmission_figures(
            self.times, transmission_angle(self.arrays, points), self.breaks, self.closed
        )

    def _singular_ratio(self, _: str) -> Figures:
        problem, lead = self.structure.problem, self.structure.lead
        led = () if lead is None else (*lead.joints, *velocity_columns(self.scene.prescribed))
        passive = [k for k, name in enumerate(problem.model.v_names) if name not in led]
        if (
            lead is None
            or not passive
            or len(passive) == problem.model.nv
            or not problem.constraints.of_loops
        ):
            return {}
        of_all, block = (np.linalg.svd(x, compute_uv=False) for x in (self.psi, self.psi[..., passive]))
        return ratio_figures(self.times, block, of_all, self.breaks, self.closed)

    def _mobility(self, _: str) -> Figures:
        problem = self.structure.problem
        if not problem.constraints.of_loops:
            return {}
        own = [as_keys(mobility(problem, singular_values(self.psi[:, k]))) for k in range(len(self.values))]
        return _exact({name: np.array([float(x[name]) for x in own]) for name in own[0]})

    def _samples(self, _: str) -> Figures:
        return _exact({"": np.full(len(self.values), float(len(self.structure.samples)))})

    def _termination(self, _: str) -> Figures:
        return _exact({"time": np.full(len(self.values), self.times[-1])})

    def _error_estimate(self, _: str) -> Figures:
        guided = self.structure.guided
        if guided is None or not self.structure.problem.model.closures:
            return {}
        return _exact(guided.residuals(self.values, self.motions))

    def _at(self, number: str) -> Figures:
        """Return the coordinates of a point at one of the times."""
        index, _, point = number.partition(".points.")
        at = self.scene.kinematics.at
        if int(index) >= len(at) or f"points/{point}" not in self.arrays:
            return {}
        k, h, s = between_samples(at[int(index)], self.times)
        ways = [self.arrays.get(f"{group}/{point}") for group in PLACES]
        still = np.zeros_like(ways[0])
        first, last = (tuple(still[j] if x is None else x[j] for x in ways) for j in (k, k + 1))
        y, off = between((first, last), h, s)
        error = off.max(axis=1) + self.closed
        return {
            **{axis: (y[:, i], error) for i, axis in enumerate("xyz")},
            "error": (error, np.full_like(error, np.nan)),
        }


def _exact(values: Mapping[str, Array]) -> Figures:
    """Return figures that have no error."""
    return {name: (x, np.full(len(x), np.nan)) for name, x in values.items()}


def _is_time(key: str) -> bool:
    """Tell whether a key is a time that the scene gives."""
    return key.startswith("at.") and key.endswith(".time")


class KinematicsRuns(BatchCommand[KinematicsStructure]):
    """Motions that joints or points lead; ends are the ends of the motion."""

    name = "kinematics"

    def structure(self, family: Family, keys: Sequence[Key], row: Array) -> KinematicsStructure:
        return KinematicsStructure(family, keys, row)

    def is_plain(self, key: str) -> bool:
        leaf = leaf_of("kinematics", key)
        if leaf is None or leaf.key.startswith("termination."):
            return key == "termination.time"
        return leaf.is_number and leaf.key.partition(".")[0] in SECTIONS and not _is_time(leaf.key)

    def with_samples(self, scene: Scene, samples: int) -> Scene:
        return dataclasses.replace(scene, kinematics=dataclasses.replace(scene.kinematics, samples=samples))

    @np.errstate(all="ignore")  # what is not finite is left to the command, which names it
    def make(self, structure: KinematicsStructure, rows: Rows, asked: AskedRuns) -> list[int]:
        left: list[int] = []
        size = max(1, ENTRIES // (structure.size * len(structure.times)))
        for first in range(0, len(rows), size):
            left += self._make(structure, rows[first : first + size], asked.result)
        return left

    def _make(self, structure: KinematicsStructure, rows: Rows, result: ManyRuns) -> list[int]:
        values = result.values[rows]
        try:
            motions = structure.motions(values)
        except np.linalg.LinAlgError:
            return rows.tolist()
        good = motions.good
        if not good.any():
            return rows.tolist()
        own = np.flatnonzero(good)
        figures = ManyFigures(structure, values[own], motions.part(own), list(result.outputs))
        for key, column in result.outputs.items():
            value, error = figures[key]
            column[rows[own]], result.errors[key][rows[own]] = value, error
            good[own] &= np.isfinite(value)
        result.code[rows[good]], result.time[rows[good]] = 0, structure.times[-1]
        result.q[rows], result.qd[rows] = motions.q[:, -1], motions.v[:, -1]
        left: list[int] = rows[~good].tolist()
        return left

    def single(self, scene: Scene) -> Result:
        return kinematics(scene)

    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        if (termination := summary.get("termination")) is not None:
            result.time[row] = termination["time"]
