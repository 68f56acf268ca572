"""``inverse`` for many runs: one motion, whose torques are evaluated with the numbers of each run."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.expr.fixed import witnessed
from robodyn_cli.given.motion import Planned
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.over.many.command import AskedRuns, BatchCommand, ManyRuns, Rows
from robodyn_cli.over.many.groups import Built, first_of, table_rows
from robodyn_cli.over.many.keys import NUMBER, Key, settings
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.torques.build import OpenChain
from robodyn_cli.torques.checks import FIGURES, Loaded, between, breaks_of
from robodyn_cli.torques.program import InverseProgram
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.works.inverse import at_rest, inverse, program_of

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
        self._planned: Planned | None = None

    def planned(self, samples: int) -> Planned:
        """Return the motion, which is the same in all runs."""
        if self._planned is None or len(self._planned.times) != samples:
            self._planned = at_rest(self.program.problem, self.program.plan(samples))
        return self._planned


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


class InverseRuns(BatchCommand[InverseStructure]):
    """Torques of the scene's trajectory; ends are the ends of the motion."""

    name = "inverse"
    sampled = ("q", "qd", "qdd", "tau")

    @cached_property
    def _endings(self) -> tuple[str, ...]:
        return tuple(f".{figure}" for figure in FIGURES)

    def structure(self, family: Family, keys: Sequence[Key], row: Array) -> InverseStructure:
        return InverseStructure(family, keys, row)

    def is_plain(self, key: str) -> bool:
        short = key.partition(".")[0] in FIGURES  # peak_torque.theta1
        return short or (key.startswith("joints.") and key.endswith(self._endings))

    def with_samples(self, scene: Scene, samples: int) -> Scene:
        return dataclasses.replace(scene, inverse=dataclasses.replace(scene.inverse, samples=samples))

    @np.errstate(
        all="ignore"
    )  # runs with numbers that are not finite are left to ``inverse``, which names them
    def make(self, structure: InverseStructure, rows: Rows, asked: AskedRuns) -> list[int]:
        samples = asked.samples or structure.program.problem.scene.inverse.samples
        samples = (samples - 1) * between(structure.program.problem, samples) + 1
        planned = structure.planned(samples)
        tables = table_rows(structure.tables, structure.numbers(asked.result.values[rows]))
        left: list[int] = []
        runs = max(1, ENTRIES // (structure.size * samples))
        for first in range(0, len(rows), runs):
            part = slice(first, first + runs)
            left += self._evaluate(structure, planned, tables[part], rows[part], asked)
        return left

    def _evaluate(
        self, structure: InverseStructure, planned: Planned, tables: Array, rows: Rows, asked: AskedRuns
    ) -> list[int]:
        """Keep the runs with rows of tables; return those that are left to be made one by one."""
        result, motion, times = asked.result, planned.motion, planned.times
        groups = {"t": times[:, None], "q": motion.q, "v": motion.qd, "a": motion.qdd}
        arrays = structure.kernel.of_tables(tables, len(times), groups)
        tau = np.sum([arrays[name] for name in structure.terms], axis=0)  # (N, nv, T)
        good = np.isfinite(tau).all(axis=(1, 2))
        for array in arrays.values():
            good &= np.isfinite(array).all(axis=(1, 2))
        tau, to = tau[good], rows[good]
        figures = self._figures(list(result.outputs), result.qd_names, Loaded(
            times, tau.reshape(-1, len(times)).T, np.tile(motion.qd, (1, len(tau))),
            breaks_of(structure.program.problem, times, motion),
        ))  # fmt: skip
        for key, column in figures.items():
            result.outputs[key][to] = column
        result.code[to], result.time[to] = 0, times[-1]
        result.q[to], result.qd[to] = motion.q[-1], motion.qd[-1]
        if asked.samples:
            kept, own = result.samples, slice(None, None, (len(times) - 1) // (asked.samples - 1))
            kept["time"][to], kept["tau"][to] = times[own], tau.transpose(0, 2, 1)[:, own]
            kept["q"][to], kept["qd"][to], kept["qdd"][to] = motion.q[own], motion.qd[own], motion.qdd[own]
        return [int(row) for row in rows[~good]]

    def _figures(self, keys: Sequence[str], joints: Sequence[str], loaded: Loaded) -> dict[str, Array]:
        """Return the keys of the summary (N,) that joints have."""
        by_key: dict[str, Array] = {}
        columns: dict[str, Array] = {}
        for key in keys:
            for k, joint in enumerate(joints):
                for name, figure in FIGURES.items():
                    if key in (f"joints.{joint}.{name}", f"{name}.{joint}"):
                        if name not in columns:
                            columns[name] = figure(loaded)[0].reshape(-1, len(joints))
                        by_key[key] = columns[name][:, k]
        return by_key

    def single(self, scene: Scene) -> Result:
        return inverse(scene)

    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        if (termination := summary.get("termination")) is not None:
            result.time[row] = termination["time"]
        if result.samples:
            result.q[row], result.qd[row] = (result.samples[name][row, -1] for name in ("q", "qd"))
