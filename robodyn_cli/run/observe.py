"""From integrated states to everything a simulation reports, block by block."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.dynamics import Rolled
from robodyn_cli.formulations.index1 import residuals
from robodyn_cli.formulations.system import GROUPS, System
from robodyn_cli.kernels.rolled import RolledForwardDynamics
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.loops.base import Row
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.results.writer import ResultWriter
from robodyn_cli.run.evaluation import SampleFunction
from robodyn_cli.run.least_norm import LeastNorm, equations_of
from robodyn_cli.run.places import FORCES, place_dataset, place_outputs
from robodyn_cli.run.reactions import ReactionSamples, figures
from robodyn_cli.run.units import joint_columns

Array = NDArray[Any]
XYZ = ("x", "y", "z")
MEANINGS = {
    "q": "joint position", "qd": "joint velocity", "qdd": "joint acceleration", "tau": "actuator torque"
}  # fmt: skip
MOST_ROWS = 40  # of Psi, up to which its singular values are worth their time at every sample


@record
class Column:
    """A dataset of the result: units, meaning and names of its columns (see ``Result.add``)."""

    units: str
    long_name: str
    dims: tuple[str, ...]
    names: tuple[str, ...] = ()
    column_units: tuple[str, ...] = ()


def observed(problem: Problem, accelerations: bool = True) -> dict[str, Sequence[Scalar]]:
    """Return what is evaluated at the samples of a simulation, by output."""
    outputs: dict[str, Sequence[Scalar]] = {
        "tau": _actuator_torques(problem),
        "energy": [problem.kinetic, problem.potential],
    }
    if problem.model.forces:
        outputs["forces.potential"] = [effect.potential for effect in problem.elements.effects]
        outputs["forces.power"] = [effect.power for effect in problem.elements.effects]
    if accelerations and not problem.dependent:
        outputs["qdd"] = list(problem.forward.qdd)
    if problem.dependent:
        return {**outputs, **equations_of(problem), **place_outputs(problem)}
    if problem.constraints.rows:
        found = residuals(problem)
        outputs["lam"] = list(problem.forward.lam)
        outputs["eta"] = found["position"]
        outputs["eta_rate"] = found["velocity"]
        if len(problem.constraints.rows) <= MOST_ROWS:
            outputs["psi"] = list(problem.psi.ravel())
    return {**outputs, **place_outputs(problem)}


def _actuator_torques(problem: Problem) -> list[Scalar]:
    """Actuator torques; a prescribed joint's is the multiplier that drives it."""
    tau = list(problem.actuator_torques)
    if problem.dependent:  # ``LeastNorm`` knows the multipliers
        return tau
    for i in problem.constraints.prescribed:
        for k, x in enumerate(problem.constraints.rows[i].psi):
            if isinstance(x, Expr) or x != 0.0:
                tau[k] = tau[k] + x * problem.forward.lam[i]
    return tau


class _Rolled:
    """What is observed of a long chain: accelerations by loops over its bodies, the rest from expressions.

    These grow with the length only, and are interpreted where that takes less time than compiling them.
    """

    def __init__(self, problem: Problem, dynamics: Rolled, samples: int) -> None:
        self.places = list(dynamics.places)
        forces = [dynamics.forces[k] for k in self.places]
        outputs = {**observed(problem, accelerations=False), "forces": forces}
        self.function = SampleFunction(outputs, GROUPS, samples)
        self.forward = RolledForwardDynamics(problem.model)

    def evaluate(self, samples: int, groups: dict[str, Array]) -> dict[str, Array]:
        # parameters are no samples, and simulations have none
        columns = {name: np.reshape(x, (samples, -1)) for name, x in groups.items() if name != "p"}
        found = self.function(**columns)
        tau = np.zeros(columns["v"].shape, order="F")
        tau[:, self.places] = found["forces"]
        found["qdd"] = self.forward(columns["q"], columns["v"], tau)
        return found


def loop_columns(rows: Sequence[Row], dependent: bool = False) -> dict[str, Column]:
    """Return units and names of what is recorded of constraint rows, by path; ``dependent``: on each other."""
    dims, names = ("time", "constraint"), tuple(row.name for row in rows)
    force = "N" if all(row.kind == "force" for row in rows) else "N or N m"
    least = " (rows depend on each other: those of least norm)" if dependent else ""
    return {
        "constraints/multipliers": Column(force, f"Lagrange multipliers{least}", dims, names),
        "constraints/position_residual": Column("m", "residual of position constraints", dims, names),
        "constraints/velocity_residual": Column("m/s", "residual of velocity constraints", dims, names),
    }


class Observer:
    """Evaluates accelerations, torques, multipliers, residuals, energies and places at sampled states."""

    def __init__(self, problem: Problem, system: System, singular: Sequence[int] | None = None) -> None:
        self.problem = problem
        self.system = system
        self.passive = singular
        self.kernel: _Rolled | SampleKernel | LeastNorm
        if isinstance(system.dynamics, Rolled):
            self.kernel = _Rolled(problem, system.dynamics, problem.scene.simulate.samples)
            outputs = self.kernel.function.outputs
        else:
            outputs = {name: list(entries) for name, entries in observed(problem).items()}
            self.kernel = LeastNorm(problem, outputs) if problem.dependent else SampleKernel(outputs, GROUPS)
        self.places = [path for path in outputs if path.startswith(("points/", "skeleton/", "frames/"))]
        self.normalise = SampleKernel({"n": system.normalisation}, GROUPS) if system.normalisation else None
        positions = system.sample_positions or system.position_correction
        velocities = system.sample_velocities or system.velocity_correction
        self.correct_q = SampleKernel({"q": positions}, GROUPS) if positions else None
        self.correct_v = SampleKernel({"v": velocities}, GROUPS) if velocities else None
        self.parameters = np.zeros(max(1, len(problem.model.parameters)))
        asked = problem.scene.outputs.reactions
        self.reactions = ReactionSamples(problem, problem.scene.simulate.samples) if asked else None

    def project(self, t: Array, x: Array) -> Array:
        """Return the states put back on manifolds and constraints (positions by Newton steps, then rates)."""
        s = self.system
        if self.normalise is not None:
            x = np.asfortranarray(x)
            x[:, list(s.normalised)] = self.normalise.evaluate(len(t), s.own_groups(t, x, self.parameters))[
                "n"
            ]
        if self.correct_q is None or self.correct_v is None:
            return x
        x = np.asfortranarray(x)
        if isinstance(self.kernel, LeastNorm):
            return self._least_norm(self.kernel, t, x)
        places = list(s.q_places)
        for _ in range(4):
            q = self.correct_q.evaluate(len(t), s.own_groups(t, x, self.parameters))["q"]
            moved = float(np.abs(q - x[:, places]).max(initial=0.0))
            x[:, places] = q
            if not moved > 1e-9:
                break
        found = self.correct_v.evaluate(len(t), s.own_groups(t, x, self.parameters))
        x[:, list(s.v_places)] = found["v"]
        return x

    def _least_norm(self, kernel: LeastNorm, t: Array, x: Array) -> Array:
        s = self.system
        q_places, v_places = list(s.q_places), list(s.v_places)
        for _ in range(4):
            groups = self._groups(t, x)
            dq, _ = kernel.correct(len(t), groups)
            x[:, q_places] = kernel.moved(groups["q"], dq)
            if not float(np.abs(dq).max(initial=0.0)) > 1e-9:
                break
        x[:, v_places] += kernel.correct(len(t), self._groups(t, x))[1]
        return x

    def _groups(self, t: Array, x: Array) -> dict[str, Array]:
        return self.system.groups(t, x, self.parameters)

    def observe(self, t: Array, x: Array, project: bool = True) -> dict[str, Array]:
        """Return the datasets of a block of samples by path; ``x`` (T, nx) is projected first."""
        problem = self.problem
        x = self.project(t, x) if project else x
        q, v, z = self.system.split(x)
        found = self.kernel.evaluate(len(t), self._groups(t, x))
        kinetic, potential = found["energy"].T
        data: dict[str, Array] = {
            "time": t,
            "q": q,
            "qd": v,
            "qdd": found["qdd"],
            "tau": found["tau"],
            "energy/kinetic": kinetic,
            "energy/potential": potential,
            "energy/total": kinetic + potential,
        }
        if z.shape[1]:
            data["energy/work"] = z[:, 0]
        for path in FORCES:
            if (name := path.replace("/", ".")) in found:
                data[path] = found[name]
        if problem.constraints.rows:
            data["constraints/multipliers"] = found["lam"]
            data["constraints/position_residual"] = found["eta"]
            data["constraints/velocity_residual"] = found["eta_rate"]
            if "psi" in found:
                data.update(self._singular(found["psi"]))
        for path in self.places:
            name, block = place_dataset(path, found[path])
            data[name] = block
        if self.reactions is not None:
            data.update(
                self.reactions(t, data["q"], data["qd"], data["qdd"], data.get("constraints/multipliers"))
            )
        return data

    def _singular(self, flat: Array) -> dict[str, Array]:
        """Return the singular values of Psi and of its passive block along the samples."""
        constraints = self.problem.constraints
        loops = [i for i in range(len(constraints.rows)) if i not in constraints.prescribed]
        if not loops:
            return {}
        psi = flat.reshape(len(flat), len(constraints.rows), self.problem.model.nv)[:, loops, :]
        rank = self.problem.loop_rank  # the others are zero in every pose
        data = {"singularity/psi": np.linalg.svd(psi, compute_uv=False)[:, :rank]}
        if self.passive:
            block = psi[:, :, list(self.passive)]
            data["singularity/passive"] = np.linalg.svd(block, compute_uv=False)[:, :rank]
            if block.shape[1] == block.shape[2]:
                data["singularity/determinant"] = np.linalg.det(block)
        return data

    def singular_ratio(self, t: Array, x: Array) -> Array:
        """Return the smallest singular value of the passive block over the largest of Psi (T,)."""
        data = self._singular(self.kernel.evaluate(len(t), self._groups(t, self.project(t, x)))["psi"])
        ratio: Array = data["singularity/passive"][:, -1] / data["singularity/psi"][:, 0]
        return ratio

    def describe(self) -> dict[str, Column]:
        """Return units and names of the datasets whose columns belong to this scene."""
        table = {
            path: Column(long_name=MEANINGS[path], **columns.described())
            for path, columns in joint_columns(self.problem.model).items()
        }
        elements = self.problem.elements.names
        table["forces/potential"] = Column("J", "potential energy of forces", ("time", "force"), elements)
        table["forces/power"] = Column("W", "power of forces", ("time", "force"), elements)
        table.update(loop_columns(self.problem.constraints.rows, bool(self.problem.dependent)))
        if self.reactions is not None:
            for path, names in self.reactions.names.items():
                meaning = self.reactions.meanings[path]
                table[path] = Column("N, N m", meaning, ("time", "wrench"), names)
        return table


class Recorder:
    """Collects blocks of observations into a Result; keeps the extremes that the summary reports.

    With a ``writer`` everything goes to the file block by block, and only every ``every``-th sample stays in
    memory, for plots and for the error estimate: a run of 10^7 samples never stands in memory whole.
    """

    def __init__(self, observer: Observer, writer: ResultWriter | None = None, every: int = 1) -> None:
        self.observer = observer
        self.writer = writer
        self.every = every
        self.seen = 0
        self.blocks: dict[str, list[Array]] = {}
        self.drift = 0.0
        self.energy_scale = 0.0
        self.position_residual = 0.0
        self.velocity_residual = 0.0
        self.loads: dict[str, dict[str, float]] = {}
        self._start: float | None = None
        self._last = -np.inf

    @np.errstate(all="ignore")  # a run that blows up reports its last states, infinite ones too
    def emit(self, t: Array, x: Array, project: bool = True, extra: bool = False) -> None:
        """Observe and keep a block of states; ``extra`` marks one off the uniform grid, which is always kept."""
        data = self.observer.observe(t, x, project)
        balance = data["energy/total"] - data.get("energy/work", 0.0)
        if self._start is None:
            self._start = float(balance[0])
        self.drift = max(self.drift, float(np.abs(balance - self._start).max()))
        self.energy_scale = max(
            self.energy_scale, float(np.ptp(data["energy/potential"])), float(data["energy/kinetic"].max())
        )
        if "constraints/position_residual" in data:
            self.position_residual = max(
                self.position_residual, float(np.abs(data["constraints/position_residual"]).max(initial=0.0))
            )
            self.velocity_residual = max(
                self.velocity_residual, float(np.abs(data["constraints/velocity_residual"]).max(initial=0.0))
            )
        if self.observer.reactions is not None:
            self._keep_largest_loads(data, self.observer.reactions)
        if self.writer is not None:
            for path, block in data.items():
                self._stream(path, block)
            first = 0 if extra else -self.seen % self.every
            data = {path: block[first :: self.every].copy() for path, block in data.items()}
        self.seen += len(t)
        self._last = float(t[-1])
        for path, block in data.items():
            self.blocks.setdefault(path, []).append(block)

    def _keep_largest_loads(self, data: dict[str, Array], known: ReactionSamples) -> None:
        for name, load in figures({path: data[path] for path in known.names}, known.names).items():
            held = self.loads.setdefault(name, load)
            self.loads[name] = {key: max(value, held[key]) for key, value in load.items()}

    def _stream(self, path: str, block: Array) -> None:
        assert self.writer is not None
        column = self.observer.describe().get(path)
        if column is None:
            self.writer.append(path, block)
        else:
            self.writer.append(path, block, **dataclasses.asdict(column))

    def make_last_least_norm(self, time: float) -> None:
        """Replace accelerations and multipliers of the last sample, where Psi has lost rank, by least-norm ones."""
        problem = self.observer.problem
        nv = problem.model.nv
        q, qd = self.blocks["q"][-1][-1], self.blocks["qd"][-1][-1]
        values = {"q": q.tolist(), "v": qd.tolist(), "t": [time], "p": self.observer.parameters.tolist()}
        entries = [
            *problem.mass_matrix.ravel(),
            *(problem.applied - problem.bias),
            *problem.constraints.gamma,
        ]
        numbers = np.array(evaluate(entries, values), dtype=float)
        M, f, gamma = (
            numbers[: nv * nv].reshape(nv, nv),
            numbers[nv * nv : nv * nv + nv],
            numbers[nv * nv + nv :],
        )
        psi = np.array(evaluate(list(problem.psi.ravel()), values), dtype=float).reshape(len(gamma), nv)
        spread = np.linalg.solve(M, psi.T)
        lam, *_ = np.linalg.lstsq(psi @ spread, -(gamma + spread.T @ f), rcond=1e-9)
        self.blocks["constraints/multipliers"][-1][-1] = lam
        self.blocks["qdd"][-1][-1] = np.linalg.solve(M, f) + spread @ lam
        if self.observer.reactions is not None:
            last = [self.blocks[path][-1][-1:] for path in ("q", "qd", "qdd", "constraints/multipliers")]
            for path, load in self.observer.reactions(np.array([time]), *last).items():
                self.blocks[path][-1][-1] = load[0]

    @property
    def samples(self) -> int:
        """Number of samples recorded."""
        return self.seen

    @property
    def last_time(self) -> float:
        """Time of the last sample recorded, -infinity before the first."""
        return self._last

    def array(self, path: str) -> Array:
        """Return what was collected under ``path``."""
        return np.concatenate(self.blocks[path])

    def fill(self, result: Result) -> None:
        """Put everything into the result."""
        described = self.observer.describe()
        for path, blocks in self.blocks.items():
            data = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
            column = described.get(path)
            if column is None:
                result.add(path, data)
            else:
                result.add(path, data, **dataclasses.asdict(column))
