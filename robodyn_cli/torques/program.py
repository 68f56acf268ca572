"""The expressions of an inverse run (parts of the torque, energies, places) and their values at samples."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import Outputs, torque_terms
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.given.motion import Planned, knots_of, looked_at
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.observe.evaluation import SampleFunction, without_idle_unknowns
from robodyn_cli.observe.places import place_outputs
from robodyn_cli.observe.rounding import DRAWS, MOST_SAMPLES, Rounded, few
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.motion import JointMotion

if TYPE_CHECKING:
    from robodyn_cli.solve.load_sharing import Shared
    from robodyn_cli.trajectories.legs import Scaling

RIGID = ("inertia", "coriolis", "gravity")


@record
class LoopSamples:
    """The loops' part of an evaluated motion: Psi (T, m, nv), and how actuators and multipliers share the load.

    residual : largest of the loops by level. actuated : joints with an actuator. driven : their velocity coordinates.
    """

    psi: Array
    shared: Shared
    residual: dict[str, float]
    actuated: tuple[str, ...]
    driven: list[int]


@record
class Sampled:
    """A motion at uniform times with its torque terms (T, nv) and all other arrays evaluated along it.

    p : parameters (T, n), which say what is carried. counters : of iterations and steps.
    """

    times: Array
    motion: JointMotion
    p: Array
    terms: Mapping[str, Array]
    arrays: Mapping[str, Array]
    counters: Mapping[str, int]
    loops: LoopSamples | None = None

    @cached_property
    def tau(self) -> Array:
        """Actuator torques (T, nv): the sum of the terms [N m or N]."""
        first, *others = self.terms.values()
        total = first.copy(order="F")
        for term in others:
            total += term
        return total

    @cached_property
    def power(self) -> Array:
        """Mechanical power of each actuator (T, nv) [W]."""
        return self.tau * self.motion.qd

    @property
    def applied(self) -> Array:
        """Generalised force (T, nv) of actuators and of all terms but the rigid bodies' [N m or N]."""
        total = self.tau
        for name in self.terms:
            if name not in RIGID:
                total = total - self.arrays[f"torque_terms/{name}"]
        return total

    def inputs(self, places: Array) -> dict[str, Array]:
        """Return the symbols' values at some samples, by group."""
        motion = self.motion
        return {
            "t": self.times[places, None],
            "q": motion.q[places],
            "v": motion.qd[places],
            "a": motion.qdd[places],
            "p": self.p[places],
        }


class AlongMotion(Protocol):
    """Evaluates outputs along a motion: ``SampleFunction``, or code with the numbers of another run."""

    operations: int
    compiled: bool

    def along(self, times: Array, motion: JointMotion, p: Array | None = None) -> dict[str, Array]: ...


@record
class InverseProgram(ABC):
    """The equations of an inverse run, and the expressions evaluated along its motion.

    problem : equations of the scene; the point that the trajectory leads is among its points.
    duration : of the motion [s].
    terms : of the load on actuators (and loops), by name: their sum is the generalised force (nv,) [N m or N].
    others : energies, power, bias, and the rows of the loops, by name. places : points, frames and outlines.
    """

    problem: Problem
    duration: float
    terms: Outputs
    others: Outputs
    places: Outputs

    @property
    def scaling(self) -> Scaling | None:
        """How the path got its times, None where it had them."""
        trajectory = self.problem.scene.trajectory
        return None if trajectory is None else trajectory.scaling

    @property
    def outputs(self) -> Outputs:
        """All expressions that are evaluated at samples, by result path where they are datasets."""
        terms = {f"torque_terms/{name}": term for name, term in self.terms.items()}
        return {**terms, **self.others, **self.places}

    def loads(self, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return the terms (T, nv) by name from the evaluated arrays."""
        return {name: arrays[f"torque_terms/{name}"] for name in self.terms}

    def compile(self, samples: int) -> SampleFunction:
        """Return ``outputs`` as a function of t, q, v and v-dot at so many samples.

        Raises
        ------
        SceneError : the outputs depend on data that the scene does not give.
        """
        return SampleFunction(self.outputs, MOTION_GROUPS, samples)

    def times(self, samples: int) -> Array:
        """Return the uniform times (T,) of the samples [s]."""
        return np.linspace(0.0, self.duration, samples)

    def looked_at(self, samples: int, turns: Sequence[float] = ()) -> Array:
        """Return the times (T,) at which figures are looked at [s]: between payloads that come and go, too, and between
        turns of joints [s]."""
        instants = [x.time for one in self.problem.scene.payloads for x in one.instants.values()]
        knots = [*knots_of(self.problem.scene), *(float(x) for x in instants if x is not None), *turns]
        return looked_at(self.times(samples), [x for x in knots if 0.0 < x < self.duration])

    def parameters(self, times: Array) -> Array:
        """Return p (T, n) at times (T,): which payloads are carried."""
        if not self.problem.model.switched:
            return np.zeros((len(times), 0))
        from robodyn_cli.model.parts import carried_at, changing

        return carried_at(changing(self.problem.model), times)

    @abstractmethod
    def plan(self, times: Array) -> Planned:
        """Return the motion of all joints at times (T,)."""

    @abstractmethod
    def evaluate(self, planned: Planned, function: AlongMotion) -> Sampled:
        """Return the torques of a planned motion, and all other arrays, at its samples."""

    @abstractmethod
    def forward(self, sampled: Sampled, numbers: ManyNumbers | None = None) -> tuple[Array, Array] | None:
        """Return accelerations (T, nv) by forward dynamics: under the computed torques, and under zero torques.

        None where the mass matrix is singular. numbers : see ``error_estimate``.
        """

    def torques_by_draw(self, sampled: Sampled, runs: ManyNumbers | None = None) -> Array | None:
        """Return torques (draw, T, nv) at a few samples, as they are and as rounding might make them.

        None where actuators would lose their hold by a change of the last digits.
        runs : numbers of the scene in many runs with this motion; then torques are (run, draw, T, nv).
        """
        places = few(len(sampled.times))
        drawn = self._rounded(sampled.inputs(places), runs)
        split = np.split(drawn, [sum(len(term) for term in self.terms.values())], axis=-1)
        terms = split[0].reshape(-1, len(self.terms), split[0].shape[-1] // len(self.terms))
        loads = dict(zip(self.terms, np.moveaxis(terms, 1, 0)))
        tau = self.shared(loads, split[1].reshape(len(terms), -1), sampled, places)
        return None if tau is None else tau.reshape(*drawn.shape[:-1], -1)

    @cached_property
    def _rounded(self) -> Rounded:
        """The torques' terms, and what decides how they are shared, as rounding might make them."""
        return Rounded([*(x for term in self.terms.values() for x in term), *self.shared_by])

    @property
    def rounded_size(self) -> int:
        """Numbers that ``torques_by_draw`` holds for each of many runs."""
        return len(self._rounded.nodes) * (DRAWS + 1) * MOST_SAMPLES

    @property
    def shared_by(self) -> list[Scalar]:
        """The expressions beside the terms that decide how actuators share the load."""
        return []

    def shared(self, loads: Mapping[str, Array], by: Array, sampled: Sampled, places: Array) -> Array | None:
        """Return the torques (S, nv) that bear loads (S, nv) by name, shared as expressions ``by`` (S, n) decide.

        places : of the S rows among the samples (T,); S may be a multiple, with all places again and again.
        """
        total: Array = np.sum(list(loads.values()), axis=0)
        return total

    @abstractmethod
    def row_multipliers(self, sampled: Sampled) -> Array | None:
        """Return multipliers (T, m) of all rows of the problem, None where it has none."""

    @abstractmethod
    def add_loops(self, result: Result, sampled: Sampled) -> None:
        """Add multipliers, residuals and singular values of the loops to a result, where there are loops."""


def energies(problem: Problem, terms: Outputs) -> Outputs:
    """Return the energies, the bias C qd + G, and the dissipated power. Data that no torque needs can only shift the
    level at which the potential energy is zero.
    """
    lost: Any = 0.0
    for place, torque in problem.losses(smooth=False):
        lost = lost + torque * problem.v[place]
    lost = lost + problem.elements.power
    outputs = {
        "energy/kinetic": [problem.kinetic],
        "energy/potential": [problem.potential],
        "dissipation": [lost],
        "bias": list(problem.bias),
    }
    if problem.model.forces:
        effects = problem.elements.effects
        outputs |= {
            "forces/potential": [e.potential for e in effects],
            "forces/power": [e.power for e in effects],
        }
    if jumps := problem.elements.half_turns:
        outputs["half_turns"] = [jump.angle for _, jump in jumps]
    needed = [x for term in terms.values() for x in term]
    return {name: without_idle_unknowns(entries, needed) for name, entries in outputs.items()}


def expressions_of(problem: Problem) -> dict[str, Outputs]:
    """Return the expressions of every program, as fields of ``InverseProgram``."""
    terms = torque_terms(problem)
    others = energies(problem, terms)
    if problem.model.payloads:
        from robodyn_cli.equations.payloads import relative_energies

        others["payloads"] = relative_energies(problem)
    return {"terms": terms, "others": others, "places": place_outputs(problem)}
