"""How far states that are linearised about may be off, and their accelerations."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from robodyn_cli.equations.linear.reduce import accelerations, tolerance_at
from robodyn_cli.equations.linear.residuals import Residuals, States
from robodyn_cli.equations.problem import Problem
from robodyn_cli.given.loop_conditions import LoopConditions, nothing_led
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.observe.rounding import DRAWS
from robodyn_cli.ready.closed_errors import ErrorsOfClosing, Noise, largest_of
from robodyn_cli.record import record
from robodyn_cli.solve.closing.assembly import Assembled
from robodyn_cli.solve.closure import RANK
from robodyn_cli.spatial.algebra import Array

TRIALS = 8  # states beside, each coordinate at one end of its error
FAR = 1e-6  # rad, or m, that they are away at most, so that first order holds
TWICE = 2.0  # times the farthest of them: no trial has all coordinates at their worst ends


@record
class OffState:
    """Errors of positions q (nq,), rates v (nv,) and further torques tau (nv,) of a state."""

    q: Array
    v: Array
    tau: Array

    @staticmethod
    def exact(problem: Problem) -> OffState:
        """Return those of a state that is given."""
        nq, nv = len(problem.model.q_names), problem.model.nv
        return OffState(np.zeros(nq), np.zeros(nv), np.zeros(nv))

    @property
    def largest(self) -> float:
        return max(float(x.max(initial=0.0)) for x in (self.q, self.v))


def errors_of_assembled(problem: Problem, assembled: Assembled) -> OffState:
    """Return the errors of a state at the start: those that closing its loops leaves."""
    exact = OffState.exact(problem)
    if assembled.rates is None:
        return exact
    cut = max(RANK, 0.0 if assembled.closure is None else assembled.closure.cut)
    closing = ErrorsOfClosing(LoopConditions(problem, nothing_led(), np.zeros(1)), cut)
    off = closing.of_state(assembled.q, assembled.v, np.zeros(problem.model.nv), assembled.rates)
    return OffState(off.q, off.v, exact.tau)


def errors_of_accelerations(equations: Residuals, states: States, off: OffState) -> Array:
    """Return how far the accelerations (nv,) of a state may be off: by what the state is, and by rounding."""
    limit = tolerance_at(equations, states)
    own, _ = accelerations(equations.values(states), states.tau, limit)
    changed = _rounded(equations, states)
    tau = np.tile(states.tau, (len(changed["load"]), 1))
    rounded, _ = accelerations(changed, tau, limit)
    enlarged = FAR / off.largest if off.largest else 1.0
    beside = _beside(equations.problem.model, states, off, enlarged)
    there, _ = accelerations(equations.values(beside), beside.tau, limit)
    moved: Array = TWICE / enlarged * np.abs(there - own).max(axis=0, initial=0.0)
    return moved + largest_of(rounded - own)


def _rounded(equations: Residuals, states: States) -> Mapping[str, Array]:
    """Return what rounding may make of the equations at a state, enlarged: (draw, ...) by name."""
    parts = {name: np.asarray(x, dtype=object) for name, x in equations.parts.items()}
    groups = dict(states.groups) | ({"p": np.array([equations.parameters])} if equations.parameters else {})
    noise = Noise([e for x in parts.values() for e in x.flat])(groups)
    values = equations.values(states)
    found, cuts = {}, np.cumsum([x.size for x in parts.values()])[:-1]
    for name, own in zip(parts, np.split(noise, cuts, axis=1)):
        found[name] = values[name] + own.reshape(DRAWS, *values[name].shape[1:])
    return found


def _beside(model: Model, states: States, off: OffState, enlarged: float) -> States:
    """Return states beside one, as far away as its errors, enlarged."""
    random = np.random.default_rng(3)
    q, v, tau = (
        own + random.choice([-1.0, 1.0], (TRIALS, own.shape[1])) * enlarged * apart
        for own, apart in ((states.q, off.q), (states.v, off.v), (states.tau, off.tau))
    )
    manifold = Manifold(model)
    q = np.array([manifold.normalise(x) for x in q])
    return dataclasses.replace(states, times=np.tile(states.times, TRIALS), q=q, v=v, tau=tau)
