"""From integrated states to the datasets of a simulation, block by block, and those of all commands on mechanisms."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError, unknown_data
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.formulations.system import System
from robodyn_cli.kernels.samples import SampleKernel, compile_together
from robodyn_cli.loops.base import Row
from robodyn_cli.model.model import BASE, STATE_GROUPS, TORQUE, unknown_among
from robodyn_cli.observe.places import FORCES, add_places, place_dataset, place_outputs, point_motion
from robodyn_cli.observe.units import add_motion, joint_columns, load_columns, unit_text
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from robodyn_cli.observe.evaluation import SampleFunction
    from robodyn_cli.observe.observe_rolled import ObservedRolled
    from robodyn_cli.observe.reactions import ReactionSamples
    from robodyn_cli.observe.singular_values import LeastNorm

MEANINGS = {
    "q": "joint position", "qd": "joint velocity", "qdd": "joint acceleration", "tau": "actuator torque"
}  # fmt: skip
MOST_ROWS = 40  # of Psi: up to so many, singular values are computed at every sample


@record
class Column:
    """A dataset of the result: units, meaning and names of its columns (see ``Result.add``)."""

    units: str
    long_name: str
    dims: tuple[str, ...]
    names: tuple[str, ...] = ()
    column_units: tuple[str, ...] = ()


def observed(problem: Problem, accelerations: bool = True) -> dict[str, Sequence[Scalar]]:
    """Return the expressions that are evaluated at the samples of a simulation, by output."""
    outputs: dict[str, Sequence[Scalar]] = {
        "tau": _actuator_torques(problem),
        "energy": [problem.kinetic, potential_energy(problem)],
    }
    if problem.control is not None or problem.scene.outputs.signals:
        from robodyn_cli.observe.control import control_outputs

        outputs.update(control_outputs(problem))
    if problem.model.forces:
        outputs["forces.potential"] = [effect.potential for effect in problem.elements.effects]
        outputs["forces.power"] = [effect.power for effect in problem.elements.effects]
    if accelerations and not problem.dependent:
        outputs["qdd"] = list(problem.forward.qdd)
    if problem.latches:
        from robodyn_cli.equations.latches import latch_loads

        outputs["latch_loads"] = latch_loads(problem)
    if problem.dependent:
        from robodyn_cli.observe.singular_values import equations_of

        return {**outputs, **equations_of(problem), **place_outputs(problem)}
    if problem.constraints.rows:
        outputs["lam"] = list(problem.forward.lam)
        outputs["eta"] = problem.constraints.eta
        outputs["eta_rate"] = problem.constraints.velocity_residual(problem.v)
        if len(problem.constraints.rows) <= MOST_ROWS:
            outputs["psi"] = list(problem.psi.ravel())
    return {**outputs, **place_outputs(problem)}


def potential_energy(problem: Problem) -> Scalar:
    """Return the potential energy; unknown data that only shift it by a constant count as zero. These are the data
    that its gradient does not depend on, such as the height of the centre of mass of a cart on level ground.
    """
    energy = problem.potential
    if not unknown_among([energy]):
        return energy
    from robodyn_cli.expr.calculus import jacobian
    from robodyn_cli.observe.evaluation import without_idle_unknowns

    gradient = jacobian([energy], [q for q in problem.q if isinstance(q, Expr)])[0]
    return without_idle_unknowns([energy], list(gradient.values()))[0]


def _actuator_torques(problem: Problem) -> list[Scalar]:
    """Actuator torques; that of a prescribed joint is the multiplier of its row."""
    tau = list(problem.actuator_torques)
    if problem.dependent:  # ``LeastNorm`` knows the multipliers
        return tau
    for i in problem.constraints.prescribed:
        for k, x in problem.constraints.rows[i].entries.items():
            tau[k] = tau[k] + x * problem.forward.lam[i]
    return tau


def loop_columns(rows: Sequence[Row], dependent: bool = False) -> dict[str, Column]:
    """Return units and names of the datasets of constraint rows, by path; ``dependent`` : whether rows are."""
    dims, names = ("time", "constraint"), tuple(row.name for row in rows)
    units = [row.unit for row in rows]

    def column(meaning: str, own: Sequence[str]) -> Column:
        return Column(unit_text(own), meaning, dims, names, tuple(own) if len(set(own)) > 1 else ())

    least = " (rows depend on each other: those of least norm)" if dependent else ""
    return {
        "constraints/multipliers": column(f"Lagrange multipliers{least}", [TORQUE[unit] for unit in units]),
        "constraints/position_residual": column("residual of position constraints", units),
        "constraints/velocity_residual": column(
            "residual of velocity constraints", [f"{unit}/s" for unit in units]
        ),
    }


def _kernel(
    problem: Problem, system: System, outputs: Mapping[str, Sequence[Scalar]]
) -> SampleKernel | ObservedRolled:
    if not system.dynamics.any_size:
        return SampleKernel({name: list(entries) for name, entries in outputs.items()}, STATE_GROUPS)
    from robodyn_cli.observe.observe_rolled import ObservedRolled

    return ObservedRolled(problem, system.dynamics, outputs)


def _least_norm(problem: Problem, outputs: Mapping[str, Sequence[Scalar]]) -> LeastNorm:
    from robodyn_cli.observe.singular_values import LeastNorm

    return LeastNorm(problem, {name: list(entries) for name, entries in outputs.items()})


def _point_motion(problem: Problem) -> SampleFunction | None:
    """Return velocities and accelerations of the points that move as a function of q, v and v-dot."""
    if all(frame.body == BASE for frame in problem.model.points.values()):
        return None
    from robodyn_cli.observe.evaluation import SampleFunction

    return SampleFunction(point_motion(problem), ("t", "q", "v", "a"), problem.scene.simulate.samples)


def _reactions(problem: Problem) -> ReactionSamples:
    from robodyn_cli.observe.reactions import ReactionSamples

    return ReactionSamples(problem, problem.scene.simulate.samples)


@contextlib.contextmanager
def all_missing_data(problem: Problem, system: System, reactions: bool) -> Iterator[None]:
    """Make an error about data that the scene does not give name all that the run needs, not only the first part's."""
    try:
        yield
    except SceneError as error:
        if "missing" not in error.details:
            raise
        rolled = system.dynamics.any_size
        missing = set(error.details["missing"])
        for entries in observed(problem, accelerations=not rolled).values():
            missing.update(unknown_among(entries))
        if not rolled:
            missing.update(unknown_among(system.rates))
        if reactions or problem.scene.outputs.reactions:
            try:
                _reactions(problem)
            except SceneError as more:
                missing.update(more.details.get("missing", ()))
        raise unknown_data(sorted(missing)) from None


class Observer:
    """Evaluates accelerations, torques, multipliers, residuals, energies and places at sampled states.

    passive : velocity coordinates without an actuator. reactions : observe these in any case, not only if asked for.
    ``parameters`` are the p at which the next samples are evaluated.
    """

    def __init__(
        self, problem: Problem, system: System, passive: Sequence[int] = (), reactions: bool = False
    ) -> None:
        self.problem = problem
        self.controlled = problem.control is not None or bool(problem.scene.outputs.signals)
        self.system = system
        self.passive = tuple(passive)
        outputs = observed(problem, accelerations=not system.dynamics.any_size)
        self.least_norm = _least_norm(problem, outputs) if problem.dependent else None
        self.kernel = self.least_norm or _kernel(problem, system, outputs)
        self.places = [path for path in outputs if path.startswith(("points/", "skeleton/", "frames/"))]
        c = system.corrections
        self.normalise = SampleKernel({"n": c.normalisation}, STATE_GROUPS) if c.normalisation else None
        positions = c.sample_position or c.position
        velocities = c.sample_velocity or c.velocity
        self.correct_q = SampleKernel({"q": positions}, STATE_GROUPS) if positions else None
        self.correct_v = SampleKernel({"v": velocities}, STATE_GROUPS) if velocities else None
        self.residuals = None
        if self.correct_q is not None:
            rows = problem.constraints
            residuals = {"q": rows.eta, "v": rows.velocity_residual(problem.v)}
            self.residuals = SampleKernel(residuals, STATE_GROUPS)
        compile_together(self.kernel, self.normalise, self.correct_q, self.correct_v, self.residuals)
        self.parameters = np.zeros(max(1, len(problem.model.parameters)))
        with_reactions = reactions or problem.scene.outputs.reactions
        self.reactions = _reactions(problem) if with_reactions else None
        # whether the summary has figures that follow from the samples
        self.figures = problem.scene.control is not None
        self.point_motion = _point_motion(problem)

    @property
    def kernels(self) -> dict[str, SampleKernel | SampleFunction]:
        """The programs that are evaluated at the samples, by name."""
        observation = self.kernel if isinstance(self.kernel, SampleKernel) else self.kernel.function
        programs = {
            "observation": observation,
            "manifolds at the samples": self.normalise,
            "projection of positions at the samples": self.correct_q,
            "projection of velocities at the samples": self.correct_v,
            "residuals at the samples": self.residuals,
            "velocities and accelerations of points": self.point_motion,
            "reactions": None if self.reactions is None else self.reactions.function,
        }
        return {name: kernel for name, kernel in programs.items() if kernel is not None}

    def project(self, t: Array, x: Array) -> Array:
        """Return the states put back on manifolds and constraints (positions by Newton steps, then rates)."""
        s = self.system
        if self.normalise is not None:
            x = np.asfortranarray(x)
            x[:, list(s.corrections.normalised)] = self.normalise.evaluate(
                len(t), s.own_groups(t, x, self.parameters)
            )["n"]
        if self.correct_q is None or self.correct_v is None:
            return x
        x = np.asfortranarray(x)
        if self.least_norm is not None:
            return self._project_least_norm(self.least_norm, t, x)
        for _ in range(4):
            moved = self._corrected(t, x, self.correct_q, "q", list(s.q_places))
            if not moved > 1e-9:
                break
        self._corrected(t, x, self.correct_v, "v", list(s.v_places))
        return x

    def _corrected(self, t: Array, x: Array, kernel: SampleKernel, output: str, places: list[int]) -> float:
        """Correct entries of states x (T, nx) in place, where that lessens the residual; return the largest change.
        Close to a loss of rank a correction is magnified rounding.
        """
        assert self.residuals is not None
        better = x.copy(order="F")
        better[:, places] = kernel.evaluate(len(t), self.system.own_groups(t, x, self.parameters))[output]
        before, after = (
            np.abs(self.residuals.evaluate(len(t), self._groups(t, states))[output]).max(axis=1)
            for states in (x, better)
        )
        taken = after <= before
        change = np.abs(better - x)[taken]
        x[taken] = better[taken]
        return float(change.max(initial=0.0))

    def _project_least_norm(self, kernel: LeastNorm, t: Array, x: Array) -> Array:
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

    def observe(self, t: Array, x: Array, project: bool = True, singular: bool = True) -> dict[str, Array]:
        """Return the datasets of a block of samples by path; ``x`` (T, nx) is projected first. singular : singular
        values, which take longest, too."""
        problem = self.problem
        x = self.project(t, x) if project else x
        q, v, z = self.system.split(x)
        values = self.kernel.evaluate(len(t), self._groups(t, x))
        kinetic, potential = values["energy"].T
        data: dict[str, Array] = {
            "time": t,
            "q": q,
            "qd": v,
            "qdd": values["qdd"],
            "tau": values["tau"],
            "energy/kinetic": kinetic,
            "energy/potential": potential,
            "energy/total": kinetic + potential,
        }
        # the structure behind a lock may have nothing any more that does work
        if self.system.work_done_by and z.shape[1]:
            data["energy/work"] = z[:, -1]
        for path in (*FORCES, "latch_loads"):
            if (name := path.replace("/", ".")) in values:
                data[path] = values[name]
        if self.controlled:
            from robodyn_cli.observe.control import control_data

            data.update(control_data(problem, values))
        if problem.constraints.rows:
            data["constraints/multipliers"] = values["lam"]
            data["constraints/position_residual"] = values["eta"]
            data["constraints/velocity_residual"] = values["eta_rate"]
            if singular and "psi" in values:
                data.update(self._singular(values["psi"]))
        for path in self.places:
            name, block = place_dataset(path, values[path])
            data[name] = block
        if self.point_motion is not None:
            data.update(self.point_motion(t=t[:, None], q=data["q"], v=data["qd"], a=data["qdd"]))
        if self.reactions is not None:
            lam = data.get("constraints/multipliers")
            data.update(self.reactions(t, data["q"], data["qd"], data["qdd"], lam, self.parameters))
        return data

    def _singular(self, flat: Array) -> dict[str, Array]:
        """Return the singular values of Psi and of its passive block along the samples."""
        constraints = self.problem.constraints
        loops = constraints.of_loops
        if not loops:
            return {}
        from robodyn_cli.observe.singular_values import singular_values

        psi = flat.reshape(len(flat), len(constraints.rows), self.problem.model.nv)[:, loops, :]
        return singular_values(psi, self.passive, self.problem.loop_rank)

    def multipliers(self, t: Array, x: Array) -> Array:
        """Return the multipliers (T, m) at states x (T, nx), which are projected first."""
        return self.kernel.evaluate(len(t), self._groups(t, self.project(t, x)))["lam"]

    def largest_residuals(self, t: Array, x: Array) -> tuple[float, float]:
        """Return the largest residuals of positions and of velocities at states, as ``multipliers`` takes them."""
        seen = self.residuals is None
        kernel, names = (self.kernel, ("eta", "eta_rate")) if seen else (self.residuals, ("q", "v"))
        values = kernel.evaluate(len(t), self._groups(t, self.project(t, x)))  # type: ignore[union-attr]
        position, velocity = (float(np.abs(values[name]).max(initial=0.0)) for name in names)
        return position, velocity

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
        if self.problem.model.forces:
            elements = self.problem.elements.names
            table["forces/potential"] = Column("J", "potential energy of forces", ("time", "force"), elements)
            table["forces/power"] = Column("W", "power of forces", ("time", "force"), elements)
        if latches := self.problem.latches:
            described = load_columns(self.problem.model, latches).described()
            table["latch_loads"] = Column(long_name="load of each latch on what it holds", **described)
        if self.controlled:
            from robodyn_cli.observe.control import control_columns

            table.update({path: Column(**given) for path, given in control_columns(self.problem).items()})
        if self.problem.constraints.rows:
            table.update(loop_columns(self.problem.constraints.rows, bool(self.problem.dependent)))
        if self.reactions is not None:
            for path, names in self.reactions.names.items():
                meaning = self.reactions.meanings[path]
                table[path] = Column("N, N m", meaning, ("time", "wrench"), names)
        return table


def add_sample(result: Result, problem: Problem, q: Array, v: Array, a: Array) -> None:
    """Add the one sample q (nq,), v and v-dot (nv,) at t = 0, and places of points, frames and links, to a result."""
    from robodyn_cli.trajectories.motion import JointMotion

    add_motion(result, problem.model, np.zeros(1), JointMotion(q[None], v[None], a[None]))
    places = place_outputs(problem)
    # all at once, for places share most of what they are computed from
    values = problem.numbers([x for entries in places.values() for x in entries], q, v=v)
    ends = np.cumsum([len(entries) for entries in places.values()])
    add_places(result, {path: part[None] for path, part in zip(places, np.split(values, ends[:-1]))})


def add_rows(
    result: Result, rows: Sequence[Row], arrays: Mapping[str, Array], dependent: bool = False
) -> None:
    """Add arrays of the loops' rows (T, m), by path, to a result; ``dependent`` : whether rows are."""
    columns = loop_columns(rows, dependent)
    for path, data in arrays.items():
        column = columns[path]
        result.add(
            path, data, units=column.units, long_name=column.long_name, names=column.names,
            column_units=column.column_units,
        )  # fmt: skip
