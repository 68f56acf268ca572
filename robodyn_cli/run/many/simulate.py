"""``simulate`` for many runs: groups of one structure, compiled code where it does, else scene by scene."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import RobodynError
from robodyn_cli.exit_codes import INTERNAL
from robodyn_cli.results.result import Result
from robodyn_cli.run.many.integrate import Batch, Driven, integrate, method_of
from robodyn_cli.run.many.keys import Key, settings
from robodyn_cli.run.many.record import ManyRuns
from robodyn_cli.run.many.single import error_of, number_of, reason_of, summary_of
from robodyn_cli.run.many.structure import Structure, Structures
from robodyn_cli.scene.load import Family
from robodyn_cli.spatial.algebra import Array

Rows = NDArray[np.int64]
ESTIMATE = "error_estimate"


class Simulation:
    """Makes rows of runs of one mechanism.

    Parameters
    ----------
    of : keys of the summary that are wanted. samples : at how many uniform times, from the start to the end, states are
    wanted. threads : that make runs.
    """

    def __init__(self, structures: Structures, result: ManyRuns, samples: int, threads: int) -> None:
        self.structures, self.result, self.samples, self.threads = structures, result, samples, threads

    def compiled(self, rows: Rows, q: Array | None, qd: Array | None) -> Rows:
        """Make these rows in compiled code; return those that are left to be made one by one.

        q, qd : initial states (N, nq), (N, nv) in place of the scene's.
        """
        plain = all(is_plain(key) for key in self.result.outputs)
        left: list[int] = []
        for structure, group in self.structures.groups(self.result.values[rows]):
            here = rows[group]
            if structure is None or structure.obstacle or not plain:
                left += here.tolist()
            else:
                left += self._compiled(structure, here, q, qd)
        return np.array(sorted(left), dtype=np.int64)

    def one_by_one(self, rows: Rows, q: Array | None, qd: Array | None) -> None:
        """Make these rows as the command does."""
        for row in rows.tolist():
            self._alone(row, q, qd)

    def _compiled(self, structure: Structure, rows: Rows, q: Array | None, qd: Array | None) -> list[int]:
        """Make runs of one structure; return those that are left to be made one by one."""
        own_q, own_qd = (None if x is None else x[rows] for x in (q, qd))
        batch = Batch.of(structure, self.result.values[rows], own_q, own_qd, self.threads)
        found = method_of(batch)
        left: list[int] = []
        for method in dict.fromkeys(found.tolist()):
            chosen = np.flatnonzero(found == method)
            part = batch if len(chosen) == len(rows) else batch.part(chosen)
            driven = integrate(part, method, max(0, self.samples - 1))
            self._keep(structure, part, driven, rows[chosen])
            left += rows[chosen[~driven.trusted]].tolist()
        return left

    def _keep(self, structure: Structure, batch: Batch, driven: Driven, rows: Rows) -> None:
        """Write those runs of a batch that can be trusted into the result."""
        result, system, good = self.result, structure.motion.system, driven.trusted
        runs, to = driven.runs, rows[driven.trusted]
        result.code[to], result.time[to], result.steps[to] = 0, runs.time[good], runs.steps[good]
        result.q[to], result.qd[to], _ = system.split(runs.y[good])
        result.q_error[to], result.qd_error[to], _ = system.split(driven.errors[good])
        counts = {"steps": runs.steps, "rejected": runs.rejected, "evaluations": runs.evaluations}
        for key, column in result.outputs.items():
            section, _, name = key.partition(".")
            if section == "final":
                column[to] = self._final(name, to)
            elif section == "counters":
                column[to] = counts[name][good]
            elif name == "steps":
                column[to] = driven.second_steps[good]
            else:
                column[to] = self._largest_error(name.removesuffix("_end"), to)
            result.errors[key][to] = self._error_of(key, to)
        if self.samples:
            self._keep_samples(system, batch, driven, to)

    def _final(self, name: str, rows: Rows) -> Array:
        """Return the last time, or a last position or rate: ``q.theta1``."""
        result = self.result
        if name == "time":
            return result.time[rows]
        group, _, column = name.partition(".")
        names = result.q_names if group == "q" else result.qd_names
        if column not in names:
            return np.full(len(rows), math.nan)
        found: Array = getattr(result, group)[rows, names.index(column)]
        return found

    def _largest_error(self, group: str, rows: Rows) -> Array:
        errors: Array = self.result.q_error if group == "q" else self.result.qd_error
        return errors[rows].max(axis=1, initial=0.0)

    def _error_of(self, key: str, rows: Rows) -> Array | float:
        """Return the estimated errors of an output, as a study of single runs tells them."""
        parts = key.split(".")
        return self._largest_error(parts[1], rows) if parts[0] == "final" and len(parts) > 2 else math.nan

    def _keep_samples(self, system: Any, batch: Batch, driven: Driven, rows: Rows) -> None:
        samples, good = self.result.samples, driven.trusted
        states = np.concatenate([batch.states[:, None], driven.runs.out.transpose(0, 2, 1)], axis=1)[good]
        share = np.arange(self.samples) / max(self.samples - 1, 1)
        samples["time"][rows] = batch.ends[good, None] * share
        samples["q"][rows], samples["qd"][rows], _ = system.split(states)

    # -- one by one -------------------------------------------------------------------------------------
    def _alone(self, row: int, q: Array | None, qd: Array | None) -> None:
        """Make one run as the command does."""
        result = self.result
        result.one_by_one[row] = True
        try:
            summary, code, found = self._summary(row, q, qd)
        except RobodynError as refusal:
            result.code[row], result.reason[row] = refusal.exit_code, refusal.message
            return
        except Exception as fault:  # of the program, in one run: the others stay as they are
            result.code[row], result.reason[row] = INTERNAL, f"{type(fault).__name__}: {fault}"
            return
        result.code[row], result.reason[row] = code, reason_of(summary, code)
        final = summary.get("final")
        if isinstance(final, Mapping):
            result.time[row] = final["time"]
            result.q[row] = [final["q"][name] for name in result.q_names]
            result.qd[row] = [final["qd"][name] for name in result.qd_names]
            result.steps[row] = summary["counters"]["steps"]
        for group, errors in (("q", result.q_error), ("qd", result.qd_error)):
            errors[row] = number_of(summary, f"{ESTIMATE}.{group}_end")
        for key, column in result.outputs.items():
            column[row], result.errors[key][row] = number_of(summary, key), error_of(summary, key)
        if self.samples and len(found.time) == self.samples:
            result.samples["time"][row] = found.time
            result.samples["q"][row], result.samples["qd"][row] = found["q"], found["qd"]

    def _summary(self, row: int, q: Array | None, qd: Array | None) -> tuple[dict[str, Any], int, Result]:
        from robodyn_cli.run.simulate import simulate

        scene = scene_of(
            self.structures.family, self.structures.keys, self.result, row, (q, qd), self.samples
        )
        return summary_of(lambda: simulate(scene))


def scene_of(
    family: Family,
    keys: Sequence[Key],
    result: ManyRuns,
    row: int,
    start: tuple[Array | None, Array | None],
    samples: int,
) -> Any:
    """Return the scene of one run."""
    import dataclasses

    scene = family.scene(settings([key.name for key in keys], result.values[row]))
    initial, simulate = scene.initial, scene.simulate
    q, qd = start
    if q is not None:
        initial = dataclasses.replace(initial, q=dict(zip(result.q_names, q[row].tolist())))
    if qd is not None:
        initial = dataclasses.replace(initial, qd=dict(zip(result.qd_names, qd[row].tolist())))
    if samples:
        simulate = dataclasses.replace(simulate, samples=samples)
    return dataclasses.replace(scene, initial=initial, simulate=simulate)


def is_plain(key: str) -> bool:
    """Tell whether compiled code gives this key of the summary."""
    return key.startswith(("final.q.", "final.qd.")) or key in (
        "final.time", "counters.steps", "counters.rejected", "counters.evaluations",
        f"{ESTIMATE}.q_end", f"{ESTIMATE}.qd_end", f"{ESTIMATE}.steps",
    )  # fmt: skip
