"""Mechanisms at rest: balances and their stability, and the torques that hold a pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import position_rates
from robodyn_cli.equations.contact_joints import moving_freely
from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import torque_terms
from robodyn_cli.errors import CapabilityError, NumericalError, SingularConfigurationError, unknown_data
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.given.loop_conditions import Lead, LoopConditions, nothing_led, velocity_places
from robodyn_cli.model.model import unknown_among
from robodyn_cli.observe.evaluation import cause, without_idle_unknowns
from robodyn_cli.ready.prepare import held_columns
from robodyn_cli.record import record
from robodyn_cli.solve.equilibrium import Balance, balance
from robodyn_cli.solve.load_sharing import LostRank, Shared, TooFewActuators, share
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.mechanism import Balanced, Held
from robodyn_cli.torques.closed import lost_rank
from robodyn_cli.trajectories.led import led_joints, position_columns


@record
class AtRest:
    """A configuration at rest with the torques (nv,) and the multipliers (m,) of the loops that hold it.

    terms : the torques (nv,) by term, where actuators hold it.
    """

    problem: Problem
    q: Array
    tau: Array
    lam: Array
    facts: Balanced | Held
    terms: Mapping[str, Array]


def refuse_unknown(entries: Sequence[Scalar]) -> None:
    """Refuse expressions that depend on data which the scene does not give.

    Raises
    ------
    SceneError
    """
    if missing := unknown_among(entries):
        raise unknown_data(missing)


def held(problem: Problem, q: Array) -> AtRest:
    """Return the torques of actuators that hold a closed configuration q (nq,).

    Raises
    ------
    CapabilityError : too few actuators. SingularConfigurationError : they cannot hold it there.
    """
    model = problem.model
    terms = {name: x for name, x in torque_terms(problem).items() if name not in ("inertia", "coriolis")}
    refuse_unknown([x for term in terms.values() for x in term])
    needed = {name: problem.numbers([term], q) for name, term in terms.items()}
    needed = needed or {"gravity": np.zeros((1, model.nv))}
    conditions = LoopConditions(problem, nothing_led(), np.zeros(1))
    _, J = conditions.at(q, 0.0)
    names = holding_joints(problem)
    shared = _shared(problem, J[problem.constraints.of_loops], names, needed, q)
    facts = Held(list(names), *shared.uniqueness, shared.residual)
    split = {name: term[0] for name, term in shared.terms.items()}
    return AtRest(problem, q, shared.tau[0], shared.multipliers[0], facts, split)


def holding_joints(problem: Problem) -> tuple[str, ...]:
    """Return the joints with an actuator: those in ``actuated``, else those with torques or prescribed or held ones,
    or all."""
    scene, model = problem.scene, problem.model
    if scene.actuated is not None:
        return scene.actuated
    driven = tuple(dict.fromkeys((*scene.torques, *led_joints(scene.prescribed), *scene.initial.hold)))
    return driven if model.closures and driven else model.joint_names


def _shared(
    problem: Problem, psi: Array, names: tuple[str, ...], needed: Mapping[str, Array], q: Array
) -> Shared:
    columns = velocity_places(problem.model, names)
    try:
        return share(psi[None], columns, needed)
    except TooFewActuators as few:
        if len(columns) >= few.freedom:
            raise SingularConfigurationError(
                f"dead point of the actuators: {', '.join(names)} cannot hold the mechanism in this configuration, "
                f"which leaves {few.freedom - few.commanded} of its {few.freedom} degrees of freedom to itself",
                key="actuated", kind="dead_point", q=q.tolist(),
            ) from None  # fmt: skip
        raise CapabilityError(
            f"the mechanism has {few.freedom} degrees of freedom, and its actuated joints ({', '.join(names)}) hold "
            f"{few.commanded} of them; name more in 'actuated', or find the balance (statics.find: balance)",
            key="actuated",
        ) from None
    except LostRank as lost:
        raise lost_rank(problem, lost, np.zeros(1), q[None]) from None


class _RestForces:
    """Generalised forces at rest (see ``solve.equilibrium.Forces``): r = G - tau_passive - tau_a at v = 0, t = 0."""

    def __init__(self, problem: Problem, conditions: LoopConditions) -> None:
        model = self.model = problem.model
        self.parameters = moving_freely(problem.contact_joints)  # no joint sticks or rests on a stop
        load = load_at_rest(problem)
        lam = problem.graph.symbols(list(conditions.names), "lam")
        rows = problem.constraints.rows
        held: list[Scalar] = list(load)
        for row, multiplier in zip(rows, lam):  # led rows have a constant Psi
            for k, x in enumerate(row.psi):
                held[k] = held[k] - x * multiplier
        entries: list[Scalar] = []
        for j in range(model.nv):
            unit: list[Any] = [1.0 if k == j else 0.0 for k in range(model.nv)]
            entries += directional(held, problem.q, position_rates(model, problem.q, unit))
        refuse_unknown(load)
        self._slopes = entries
        self._load, self._stiffness = Evaluator(load), Evaluator(without_idle_unknowns(entries, load))

    def _values(self, q: Array) -> dict[str, Any]:
        return {"q": q.tolist(), "v": [0.0] * self.model.nv, "t": [0.0], "p": self.parameters}

    def load(self, q: Array) -> Array:
        return np.array(self._load(self._values(q)), dtype=float)

    def stiffness(self, q: Array, lam: Array) -> Array:
        values = {**self._values(q), "lam": lam.tolist()}
        found = np.array(self._stiffness(values), dtype=float)
        if not np.isfinite(found).all():
            place = ", ".join(f"{name} = {x:.6g}" for name, x in zip(self.model.q_names, q))
            raise NumericalError(
                f"the forces have no finite slope at {place}, so no balance can be sought from there: "
                f"{cause(self._slopes, values)}",
                q=q.tolist(),
            )
        return found.reshape(self.model.nv, self.model.nv).T


def load_at_rest(problem: Problem) -> list[Scalar]:
    """Return r = h - tau_passive - tau_a (nv,), the forces that constraints must give where nothing moves."""
    return list(problem.bias - problem.applied)


def staying(problem: Problem, q: Array) -> Lead:
    """Return a lead that keeps the held joints where they are."""
    model = problem.model
    prescribed = position_columns(problem.scene.prescribed)
    held = [x for x in held_columns(problem.scene, problem) if x not in prescribed]
    return Lead.staying(model, held, q[[model.q_names.index(name) for name in held]].tolist())


def staying_places(problem: Problem) -> list[int]:
    """Return the places in v of the coordinates that stay where they are: of held joints and prescribed ones."""
    scene = problem.scene
    return velocity_places(problem.model, [*scene.initial.hold, *led_joints(scene.prescribed)])


def balanced(problem: Problem, q: Array) -> AtRest:
    """Return the balance that is reached downhill from a closed configuration q (nq,).

    Raises
    ------
    NumericalError : none is found.
    """
    conditions = LoopConditions(problem, staying(problem, q), np.zeros(1))
    found = balance(conditions, _RestForces(problem, conditions), q)
    if not found.converged:
        raise NumericalError(
            f"no balance found in {found.iterations} steps: a force of {found.residual:.3g} N m or N is left; start "
            "nearer to one (initial.q), or hold joints that nothing balances (initial.hold)",
            residual=found.residual, q=found.q.tolist(),
        )  # fmt: skip
    loops = problem.constraints.of_loops
    tau = problem.numbers(problem.actuator_torques, found.q)
    _, J = conditions.at(found.q, 0.0)
    holding = [i for i in range(len(conditions.names)) if i not in loops]
    needed = J[holding].T @ found.lam[holding]
    facts = _described(found, {problem.model.v_names[k]: float(needed[k]) for k in staying_places(problem)})
    return AtRest(problem, found.q, tau + needed, found.lam[loops], facts, {})


def _described(found: Balance, holding: Mapping[str, float]) -> Balanced:
    real = bool(np.all(np.abs(found.stiffness.imag) <= 1e-9 * np.abs(found.stiffness).max(initial=1.0)))
    stiffness = found.stiffness.real.tolist() if real else [[x.real, x.imag] for x in found.stiffness]
    return Balanced(
        found.stability, stiffness, found.residual, found.iterations, dict(holding) if holding else ABSENT
    )
