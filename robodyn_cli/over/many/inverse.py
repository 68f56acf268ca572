"""``inverse`` for many runs: one motion, whose torques are evaluated with the numbers of each run."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.fixed import witnessed
from robodyn_cli.given.motion import Planned
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.observe.rounding import largest_differences
from robodyn_cli.over.many.command import AskedRuns, BatchCommand, ManyRuns, Rows
from robodyn_cli.over.many.groups import Built, first_of, table_rows
from robodyn_cli.over.many.keys import NUMBER, Key, settings
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.inverse import ROUNDING
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.torques.build import OpenChain
from robodyn_cli.torques.checks import FIGURES, Loaded, breaks_of
from robodyn_cli.torques.program import InverseProgram, Sampled
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.works.inverse import inverse, looked_at, planned_at, program_of

ENTRIES = 4_000_000  # of evaluated arrays at a time: 32 MB


class InverseStructure(Built):
    """The equations of a scene with one row of values, compiled once.

    Raises
    ------
    RobodynError : there are no inverse dynamics with these values.
    """

    def __init__(self, family: Family, keys: Sequence[Key], row: Array) -> None:
        scene = family.scene(settings([key.name for key in keys], row))
        with witnessed() as witnesses:
            self.program = program_of(scene)
            outputs = list(self.program.outputs.values())
            # without names from the scene, scenes with equal equations share their code
            self.kernel = SampleKernel({f"o{k}": x for k, x in enumerate(outputs)}, MOTION_GROUPS)
        names = list(self.program.outputs)
        self.terms = [f"o{names.index(f'torque_terms/{name}')}" for name in self.program.terms]
        self.size = sum(len(x) for x in outputs)
        super().__init__(
            keys, row, Tables([self.kernel.program]), witnesses, obstacle(self.program, scene, keys)
        )
        self._planned: dict[bytes, Planned] = {}

    def planned(self, times: Array) -> Planned:
        """Return the motion at times (T,), which is the same in all runs."""
        key = times.tobytes()
        if key not in self._planned:
            self._planned[key] = planned_at(self.program, times)
        return self._planned[key]

    def torques(self, planned: Planned, tables: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the torques (N, nv, T) along a motion with rows of tables, and where all of a run is finite (N,)."""
        motion, times = planned.motion, planned.times
        groups = {"t": times[:, None], "q": motion.q, "v": motion.qd, "a": motion.qdd}
        arrays = self.kernel.of_tables(tables, len(times), groups)
        tau = np.sum([arrays[name] for name in self.terms], axis=0)
        good = np.isfinite(tau).all(axis=(1, 2))
        for array in arrays.values():
            good &= np.isfinite(array).all(axis=(1, 2))
        return tau, good

    def rounding(self, planned: Planned, values: Array) -> Array:
        """Return how far rounding may have put any torque off in runs with rows of values (N, keys)."""
        program, times = self.program, planned.times
        sampled = Sampled(times, planned.motion, program.parameters(times), {}, {}, {})
        off = np.empty(len(values))
        runs = max(1, ENTRIES // program.rounded_size)
        for first in range(0, len(values), runs):
            part = slice(first, first + runs)
            draws = program.torques_by_draw(sampled, self.numbers(values[part]))
            off[part] = np.nan if draws is None else largest_differences(draws)
        return np.where(np.isfinite(off), off, np.nan)


def obstacle(program: InverseProgram, scene: Scene, keys: Sequence[Key]) -> str:
    """Return why runs are made one by one; nothing where their torques are evaluated at once."""
    if isinstance(scene.trajectory, TaskSpaceTrajectory):
        return "a point is led, so lengths change the motion"
    return motion_obstacle(program, scene, keys)


def motion_obstacle(program: InverseProgram, scene: Scene, keys: Sequence[Key]) -> str:
    """Return why torques do not depend on the keys directly, whether a point is led or not; nothing where they do."""
    reasons = {
        "closed loops share the load": not isinstance(program, OpenChain),
        "limits of torques or paths decide the motion": scene.trajectory is not None
        and not scene.trajectory.in_time,
        "parameters may change the motion": any(
            key.sort == NUMBER and key.place.startswith("parameters.") for key in keys
        ),
        "a prescribed motion changes": any(key.place.startswith("prescribed.") for key in keys),
        "payloads are gripped or released": bool(program.problem.model.switched),
        "forces in the joints' bearings are wanted": bool(scene.outputs.reactions),
    }
    return first_of(reasons)


def figure_of(key: str) -> tuple[str, str] | None:
    """Return the joint and the figure that a key of the summary is about; None where it is no figure of a joint."""
    leaf = leaf_of("inverse", key)
    joint = leaf.names[0] if leaf is not None and leaf.names else ""
    section, _, figure = leaf.key.partition(f".{joint}.") if leaf is not None else ("", "", "")
    return (joint, figure) if section == "joints" and figure in FIGURES else None


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


class InverseRuns(BatchCommand[InverseStructure]):
    """Torques of the scene's trajectory; ends are the ends of the motion."""

    name = "inverse"
    sampled = ("q", "qd", "qdd", "tau")

    def structure(self, family: Family, keys: Sequence[Key], row: Array) -> InverseStructure:
        return InverseStructure(family, keys, row)

    def is_plain(self, key: str) -> bool:
        return figure_of(key) is not None

    def with_samples(self, scene: Scene, samples: int) -> Scene:
        return dataclasses.replace(scene, inverse=dataclasses.replace(scene.inverse, samples=samples))

    @np.errstate(
        all="ignore"
    )  # runs with numbers that are not finite are left to ``inverse``, which names them
    def make(self, structure: InverseStructure, rows: Rows, asked: AskedRuns) -> list[int]:
        samples = asked.samples or structure.program.problem.scene.inverse.samples
        planned = looked_at(structure.program, samples, structure.planned)
        tables = table_rows(structure.tables, structure.numbers(asked.result.values[rows]))
        left: list[int] = []
        runs = max(1, ENTRIES // (structure.size * len(planned.times)))
        for first in range(0, len(rows), runs):
            part = slice(first, first + runs)
            left += self._evaluate(structure, planned, tables[part], rows[part], asked)
        return left

    def _evaluate(
        self, structure: InverseStructure, planned: Planned, tables: Array, rows: Rows, asked: AskedRuns
    ) -> list[int]:
        """Keep the runs with rows of tables; return those that are left to be made one by one."""
        result, motion, times = asked.result, planned.motion, planned.times
        tau, good = structure.torques(planned, tables)
        tau, to = tau[good], rows[good]
        loaded = Loaded(
            times, tau.reshape(-1, len(times)).T, np.tile(motion.qd, (1, len(tau))),
            breaks_of(structure.program.problem, times, motion),
        )  # fmt: skip
        figures = Figures(loaded, result.qd_names, lambda: structure.rounding(planned, result.values[to]))
        for key, column in result.outputs.items():
            column[to], result.errors[key][to] = figures[key]
        result.code[to], result.time[to] = 0, times[-1]
        result.q[to], result.qd[to] = motion.q[-1], motion.qd[-1]
        if asked.samples:
            kept, own = result.samples, structure.planned(structure.program.times(asked.samples))
            kept["tau"][to] = structure.torques(own, tables[good])[0].transpose(0, 2, 1)
            kept["time"][to], kept["q"][to] = own.times, own.motion.q
            kept["qd"][to], kept["qdd"][to] = own.motion.qd, own.motion.qdd
        return [int(row) for row in rows[~good]]

    def single(self, scene: Scene) -> Result:
        return inverse(scene)

    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        if (termination := summary.get("termination")) is not None:
            result.time[row] = termination["time"]
        if result.samples:
            result.q[row], result.qd[row] = (result.samples[name][row, -1] for name in ("q", "qd"))
