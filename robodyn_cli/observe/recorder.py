"""The samples of a simulation, in memory or in a file, and the extremes that its summary reports."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.integrators.runtime.options import stride_of
from robodyn_cli.observe.observe import Column, Observer
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import PeakLoad

if TYPE_CHECKING:
    from robodyn_cli.results.hdf5.writer import ResultWriter
    from robodyn_cli.results.held import HeldColumns

KEPT_IN_MEMORY = 100_000  # samples, when all of them go to a file
OVERLAP = 12  # samples of loads that are looked at once more with those behind them


class Recorder:
    """Collects blocks of observations into a Result; keeps the extremes that the summary reports.

    With a ``writer`` everything goes to the file block by block, and only every ``every``-th sample stays in
    memory, for plots and for the error estimate: a run of 10^7 samples never fills memory.

    judged : blocks of the states by which errors are judged, as they were integrated. last_state : the last one.
    samples : number of samples recorded, of those of the run, by default of the scene. last_time : of the last one,
    -infinity before the first.
    """

    def __init__(
        self,
        observer: Observer,
        writer: ResultWriter | None = None,
        every: int = 1,
        samples: int | None = None,
    ) -> None:
        self.observer = observer
        self.writer = writer
        self.every = every
        samples = samples or observer.problem.scene.simulate.samples
        self.stride = max(1, int(stride_of(samples)))
        self._offset = (samples - 1) % self.stride // every * every
        self.judged: list[Array] = []
        self.samples = 0
        self.blocks: dict[str, list[Array]] = {}
        self.drift = 0.0
        self.energy_scale = 0.0
        self.position_residual = 0.0
        self.velocity_residual = 0.0
        self._loads: dict[str, PeakLoad] = {}
        self._borne: list[dict[str, Array]] = []  # blocks of loads that are not looked at yet
        self.not_finite: NumericalError | None = None
        self._start: float | None = None
        self._potential = np.zeros(0)
        self.last_time = -np.inf

    @staticmethod
    def of(observer: Observer, writer: ResultWriter | None, samples: int) -> Recorder:
        """Return the recorder of a whole run; beside a file, memory holds no more than every n-th sample."""
        # a power of two, as ``stride`` is
        every = 1 if writer is None else 1 << ((samples - 1) // KEPT_IN_MEMORY).bit_length()
        return Recorder(observer, writer, every, samples)

    def is_judged(self, k: Any) -> Any:
        """Tell by which samples, of these numbers (T,), errors are judged: the first, and every n-th up to the last."""
        return (k == 0) | (k % self.stride == self._offset)

    @np.errstate(all="ignore")  # a run that blows up reports its last states, infinite ones too
    def emit(self, t: Array, x: Array, p: Array, project: bool = True, extra: bool = False) -> None:
        """Observe and keep states x (T, nx) at times t (T,), all with the parameters p.

        project : put them back onto the constraints first. extra : off the uniform grid, and kept in any case.
        """
        self.observer.parameters = p
        self.last_state = x[-1].copy()
        if not extra:
            self.judged.append(x[self.is_judged(self.samples + np.arange(len(x)))])
        data = self.observer.observe(t, x, project)
        if self.not_finite is None:
            self.not_finite = self._not_finite(t, x, data)
        balance = data["energy/total"] - data.get("energy/work", 0.0)
        if self._start is None:
            self._start = float(balance[0])
        self.drift = _largest(self.drift, np.abs(balance - self._start))
        # from the lowest to the highest of the whole run, whatever the blocks
        self._potential = np.append(self._potential, data["energy/potential"])
        self._potential = np.array([self._potential.min(), self._potential.max()])
        self.energy_scale = _largest(self.energy_scale, np.ptp(self._potential), data["energy/kinetic"])
        if "constraints/position_residual" in data:
            self.position_residual = _largest(
                self.position_residual, np.abs(data["constraints/position_residual"])
            )
            self.velocity_residual = _largest(
                self.velocity_residual, np.abs(data["constraints/velocity_residual"])
            )
        if self.observer.reactions is not None:
            self._borne.append({path: data[path] for path in ("time", *self.observer.reactions.names)})
            if self.writer is not None and sum(len(block["time"]) for block in self._borne) > KEPT_IN_MEMORY:
                self._loads = self.largest_loads()
                self._borne = [{path: block[-OVERLAP:].copy() for path, block in self._borne[-1].items()}]
        if self.writer is not None:
            for path, block in data.items():
                self._stream(path, block)
            first = 0 if extra else -self.samples % self.every
            data = {path: block[first :: self.every].copy() for path, block in data.items()}
        self.samples += len(t)
        self.last_time = float(t[-1])
        for path, block in data.items():
            self.blocks.setdefault(path, []).append(block)

    def go_back(self, time: float) -> None:
        """Forget the samples from a time [s] on."""
        kept = self.array("time") < time
        self.blocks = {path: [self.array(path)[kept]] for path in self.blocks}
        self._borne = [{path: x[block["time"] < time] for path, x in block.items()} for block in self._borne]
        self.samples = int(np.sum(kept))
        self.last_time = float(self.array("time").max(initial=-np.inf))

    @property
    def relative_drift(self) -> float:
        """The drift of the energy over the energy exchanged."""
        return self.drift / self.energy_scale if self.energy_scale else 0.0

    def keep_last_state(self, time: float, state: Array, p: Array) -> None:
        """Record the last state (nx,) that a run came to, with its parameters, if it lies beyond the last sample."""
        if time > self.last_time and np.all(np.isfinite(state)):
            self.emit(np.array([time]), state[None, :], p, extra=True)

    def _not_finite(self, t: Array, x: Array, data: dict[str, Array]) -> NumericalError | None:
        """Return the error of the first number of a block that is not finite, with its formula where there is one."""
        if np.isfinite(sum(float(block.sum()) for block in data.values())):
            return None
        from robodyn_cli.observe.evaluation import TOO_LARGE, first_fault, not_finite
        from robodyn_cli.observe.formulas import TimedState, formula_without_value

        fault = first_fault(data)
        if fault is None:
            return None
        path, (sample, *rest) = fault
        z = self.observer.system.split(x[sample])[2]
        at = TimedState(float(t[sample]), data["q"][sample], data["qd"][sample], z)
        formula = formula_without_value(self.observer.problem, at)
        column = self.columns.get(path)
        name = f" of {column.names[rest[-1]]!r}" if column is not None and column.names and rest else ""
        return not_finite(path, float(t[sample]), TOO_LARGE if formula is None else formula.message, name)

    def largest_loads(self, events: Sequence[float] = ()) -> dict[str, PeakLoad]:
        """Return the largest load of each joint and closure by name; events : times [s] at which loads may jump."""
        reactions = self.observer.reactions
        if reactions is None or not self._borne:
            return self._loads
        data = {path: np.concatenate([block[path] for block in self._borne]) for path in self._borne[0]}
        loads = reactions.largest(data["time"], data, self.breaks(data["time"], events))
        return {name: load.or_larger(self._loads.get(name, load)) for name, load in loads.items()}

    def breaks(self, times: Array, events: Sequence[float] = ()) -> list[float]:
        """Return where functions of samples at times (T,) may jump or bend, in steps from the first: at events [s], and
        where the equations switch in time, as a trajectory has knots.
        """
        from robodyn_cli.solve.quadrature import breaks_at

        return breaks_at(times, events, self.observer.system.breakpoints)

    def _stream(self, path: str, block: Array) -> None:
        assert self.writer is not None
        self.writer.append(path, block, **self.described(path))

    def make_last_least_norm(self, time: float) -> None:
        """Replace accelerations and multipliers of the last sample, where Psi has lost rank, by least-norm ones."""
        problem = self.observer.problem
        q, qd = self.blocks["q"][-1][-1], self.blocks["qd"][-1][-1]
        M, f, gamma, psi = (
            problem.numbers(entries, q, time, qd, self.observer.parameters)
            for entries in (
                problem.mass_matrix, problem.applied - problem.bias, problem.constraints.gamma, problem.psi
            )
        )  # fmt: skip
        spread = np.linalg.solve(M, psi.T)
        lam, *_ = np.linalg.lstsq(psi @ spread, -(gamma + spread.T @ f), rcond=1e-9)
        self.blocks["constraints/multipliers"][-1][-1] = lam
        self.blocks["qdd"][-1][-1] = np.linalg.solve(M, f) + spread @ lam
        if self.observer.reactions is not None:
            last = [self.blocks[path][-1][-1:] for path in ("q", "qd", "qdd", "constraints/multipliers")]
            q, qd, qdd, lam = last
            loads = self.observer.reactions(np.array([time]), q, qd, qdd, lam, self.observer.parameters)
            for path, load in loads.items():
                self.blocks[path][-1][-1] = load[0]

    @functools.cached_property
    def columns(self) -> dict[str, Column]:
        """Units and names of the datasets whose columns belong to the scene."""
        return self.observer.describe()

    @functools.cached_property
    def _held(self) -> dict[str, HeldColumns]:
        control = self.observer.problem.control
        if control is None or control.period is None:
            return {}
        from robodyn_cli.observe.controllers.held_columns import held_columns

        return held_columns(self.observer.problem, control)

    def described(self, path: str) -> dict[str, Any]:
        """Return the arguments of ``Result.add`` beside path and data."""
        column = self.columns.get(path)
        return {} if column is None else {**dataclasses.asdict(column), "held": self._held.get(path)}

    def array(self, path: str) -> Array:
        """Return the array collected under ``path``."""
        return np.concatenate(self.blocks[path])

    def fill(self, result: Result) -> None:
        """Put everything into the result."""
        for path, blocks in self.blocks.items():
            data = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
            result.add(path, data, **self.described(path))
        control = self.observer.problem.control
        if control is not None:
            from robodyn_cli.observe.controllers.design import add_design

            add_design(result, control)


def _largest(*values: Any) -> float:
    """Return the largest number; NaN, which `max` passes over, where there is one."""
    return float(np.max([np.max(x, initial=-np.inf) for x in values]))
