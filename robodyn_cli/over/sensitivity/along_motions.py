"""Exact derivatives of the figures of ``inverse``: of a motion, loops and torques along it.

    d tau / dk = tau_k + tau_t dt + tau_q dq + tau_v dv + tau_a da

in an open chain; with loops it is the change of the load B tau + Psi^T lambda, which actuators and loops share.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.drives.report import Moved
from robodyn_cli.equations.gears import geared
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.kernels.program import Program
from robodyn_cli.observe.reactions import ReactionSamples
from robodyn_cli.observe.reactions import figures as largest_loads
from robodyn_cli.over.many.inverse import figure_of
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import Slope
from robodyn_cli.over.sensitivity.gradients import MotionGradients, every_nth, slopes_along
from robodyn_cli.over.sensitivity.led import LedCourse, LedSlopes
from robodyn_cli.over.sensitivity.of_drives import DriveSlopes
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.load_sharing import Unbalanced, share_change
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.drives import DriveFigures
from robodyn_cli.summaries.facts import ABSENT, Absent, PeakLoads, Termination
from robodyn_cli.summaries.inverse import JointFigures
from robodyn_cli.torques.checks import Loaded, breaks_of, joint_figures, turning
from robodyn_cli.torques.closed import ClosedLoops, unbalanced_by_a_key
from robodyn_cli.torques.program import InverseProgram, Sampled
from robodyn_cli.works.inverse import evaluated_at, looked_at, program_of


@record
class InverseFigures:
    """The keys of the summary of ``inverse`` that are figures of its samples."""

    termination: Termination
    joints: dict[str, JointFigures]
    reactions: PeakLoads | Absent = ABSENT
    drives: dict[str, DriveFigures] | Absent = ABSENT


class InverseSlopes:
    """The samples of an inverse run, and their derivatives by some keys, which are named by their numbers.

    Raises
    ------
    CapabilityError : they cannot be computed exactly.
    """

    def __init__(self, asked: AskedSlopes, scene: Scene, numbers: Sequence[int]) -> None:
        self.asked, self.numbers = asked, numbers
        self.led = LedSlopes(asked, scene, numbers, self._course)
        self.program = program_of(scene)
        self.problem = self.program.problem
        _refuse(self.program)
        self.loads = (
            ReactionSamples(self.problem, len(self.led.course.times)) if scene.outputs.reactions else None
        )
        self.gradients = MotionGradients(self.problem, self._outputs(), self.led.places)
        has_drives = bool(scene.drives) and any(x.startswith("drives.") for x in asked.task.outputs)
        self.drives = DriveSlopes(asked, self.problem, numbers, self.led.places) if has_drives else None

    def _outputs(self) -> dict[str, Sequence[Scalar]]:
        terms = self.program.terms.values()
        found: dict[str, Sequence[Scalar]] = {"load": [sum(parts) for parts in zip(*terms)]}
        if isinstance(self.program, ClosedLoops):
            found["psi"] = self.program.others["psi"]
        if self.loads is not None:
            found |= self.loads.function.outputs
        return found

    @property
    def programs(self) -> list[Program]:
        """The code of values and derivatives."""
        drives = [] if self.drives is None else [self.drives.gradients.program]
        return [self.gradients.program, *self.led.programs, *drives]

    def slopes(self) -> dict[str, list[Slope]]:
        """Return the derivatives of those outputs that are figures of the samples."""
        sampled, moved = self.sampled, self.moved
        arrays = [
            (sampled.motion.qd, moved["v"]),
            (sampled.motion.qdd, moved["a"]),
            (sampled.tau, moved["tau"]),
        ]
        arrays += [(wrench, moved[path]) for path, wrench in self.wrenches.items()]
        return slopes_along(self.asked, self.numbers, self._figures, arrays)

    @cached_property
    def sampled(self) -> Sampled:
        """The run of the scene as it stands."""
        return evaluated_at(self.program, self.led.course.times)[1]

    @cached_property
    def _groups(self) -> dict[str, Array]:
        """Samples (T, n) of t, q, v, v-dot, and multipliers of all rows."""
        sampled, motion = self.sampled, self.sampled.motion
        lam = self.program.row_multipliers(sampled)
        if lam is None:
            lam = np.zeros((len(sampled.times), len(self.problem.constraints.rows)))
        return {"t": sampled.times[:, None], "q": motion.q, "v": motion.qd, "a": motion.qdd, "lam": lam}

    @cached_property
    def moved(self) -> dict[str, Array]:
        """Derivatives (T, n, K) of t, q, v, v-dot, of the torques, and of the wrenches that are wanted by path."""
        sampled = self.sampled
        moved = self.led.moved({name: x for name, x in self._groups.items() if name != "lam"})
        along = self.gradients(self._groups)
        tau = along.change("load", moved)
        if sampled.loops is not None:
            tau, moved["lam"] = self._shared(along.change("psi", moved), tau)
        paths = self.loads.names if self.loads is not None else ()
        return {**moved, "tau": tau, **{path: along.change(path, moved) for path in paths}}

    def _shared(self, psi_change: Array, load_change: Array) -> tuple[Array, Array]:
        """Return the change of torques (T, nv, K), and of the multipliers of all rows (T, m, K)."""
        loops, constraints = self.sampled.loops, self.problem.constraints
        assert loops is not None
        tau = np.zeros_like(load_change)
        lam = np.zeros((len(tau), len(constraints.rows), len(self.numbers)))
        for k in range(len(self.numbers)):
            psi = psi_change[:, :, k].reshape(loops.psi.shape)
            try:
                tau[:, :, k], lam[:, constraints.of_loops, k] = share_change(
                    loops.psi, loops.driven, loops.shared, psi, load_change[:, :, k]
                )
            except Unbalanced as lacking:
                raise unbalanced_by_a_key(self.problem, lacking, loops.driven) from None
        return tau, lam

    @staticmethod
    def _course(scene: Scene) -> LedCourse:
        program = program_of(scene)
        lead = program.lead if isinstance(program, ClosedLoops) else None
        samples = scene.inverse.samples
        # where a joint turns back moves with a key, and a cut there with it
        cut = turning(program.problem) and scene.trajectory is not None

        def times() -> Array:
            return looked_at(program, samples, program.plan).times if cut else program.looked_at(samples)

        return LedCourse(program.problem, times, lead)

    @cached_property
    def _wanted(self) -> set[str]:
        """The figures of joints that are asked for."""
        return {own[1] for name in self.asked.task.outputs if (own := figure_of(name)) is not None}

    def _figures(self, k: int, step: float, every: int) -> InverseFigures:
        """Return the figures for a key changed by so much, along the derivatives of the samples."""
        sampled, moved = self.sampled, self.moved
        motion, part = sampled.motion, every_nth(sampled.times, every)
        arrays = {"q": motion.q, "v": motion.qd, "a": motion.qdd, "tau": sampled.tau, **self.wrenches}
        there = {name: (x + step * moved[name][:, :, k])[part] for name, x in arrays.items()}
        times = (sampled.times + step * moved["t"][:, 0, k])[part]
        motion = dataclasses.replace(motion, q=there["q"], qd=there["v"], qdd=there["a"])
        sampled = dataclasses.replace(sampled, times=times, motion=motion, terms={"all": there["tau"]})
        loaded = Loaded.of(self.problem, sampled)
        figures = InverseFigures(
            Termination("end of the trajectory", float(times[-1])),
            joint_figures(self.problem, sampled, loaded, self._wanted),
        )
        if self.loads is not None:
            data = {path: there[path] for path in self.loads.names}
            figures = dataclasses.replace(
                figures,
                reactions=PeakLoads(
                    ABSENT, ABSENT, largest_loads(times, data, self.loads.names, loaded.breaks)
                ),
            )
        if self.drives is not None:
            breaks = tuple(breaks_of(self.problem, times, motion))
            run = Moved(times, motion.q, motion.qd, motion.qdd, there["tau"], breaks)
            rest = {name: (x + step * change[:, :, k])[part] for name, (x, change) in self.rest.items()}
            figures = dataclasses.replace(figures, drives=self.drives.figures(run, rest, k, step))
        return figures

    @cached_property
    def rest(self) -> dict[str, tuple[Array, Array]]:
        """What drives feel of the mechanism where it stands still, with derivatives; see ``DriveSlopes``."""
        return {} if self.drives is None else self.drives.at_rest(self._groups, self.moved)

    @cached_property
    def wrenches(self) -> Mapping[str, Array]:
        """Forces and moments (T, n) by path, where they are wanted."""
        if self.loads is None:
            return {}
        sampled, motion = self.sampled, self.sampled.motion
        lam = self.program.row_multipliers(sampled)
        return self.loads(sampled.times, motion.q, motion.qd, motion.qdd, lam, sampled.p)


def _refuse(program: InverseProgram) -> None:
    """Refuse runs whose torques do not follow from t, q, v and v-dot alone.

    Raises
    ------
    CapabilityError
    """
    if program.problem.model.switched:
        raise CapabilityError("payloads are gripped or released on the way")
    if isinstance(program, ClosedLoops) and geared(program.problem.model):
        raise CapabilityError("the losses of gears depend on how loops share the load")
