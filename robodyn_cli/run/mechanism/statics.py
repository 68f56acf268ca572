"""Statics: where a mechanism balances, and what holds it where it is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.kinematics import slice_q, slice_v
from robodyn_cli.equations.contact_joints import contact_joints, moving_freely
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError, SingularConfigurationError
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.expr.rebuild import Evaluator, evaluate
from robodyn_cli.kernels.program import unknown_data
from robodyn_cli.results.result import Result
from robodyn_cli.run.driver.prepare import held_columns, initial_positions
from robodyn_cli.run.driver.singularity import loop_rows
from robodyn_cli.run.inverse.closed import lost_rank, refuse_gears
from robodyn_cli.run.inverse.inverse import torque_terms
from robodyn_cli.run.mechanism.loop_conditions import Lead, LoopConditions, velocity_places
from robodyn_cli.run.mechanism.mobility import mobility
from robodyn_cli.run.mechanism.prescribed import check_prescribed
from robodyn_cli.run.observation.evaluation import without_idle_unknowns
from robodyn_cli.run.observation.observe import loop_columns
from robodyn_cli.run.observation.places import add_places, place_outputs
from robodyn_cli.run.observation.reactions import add_reactions
from robodyn_cli.run.observation.units import joint_columns
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.assembly import assemble
from robodyn_cli.solve.equilibrium import Balance, balance
from robodyn_cli.solve.load_sharing import LostRank, Shared, TooFewActuators, share

Array = NDArray[np.float64]


def statics(scene: Scene, *, progress: Progress = no_progress, watch: Stopwatch | None = None) -> Result:
    """Find the balanced configuration of a scene, or the torques that hold the given one.

    ``balance``: springs, weights, forces and the scene's torques at t = 0 balance; joints in ``initial.hold`` and
    prescribed ones stay, and the torque that this takes is a result. ``hold``: the actuators hold the initial
    configuration; their torques in the scene are ignored.

    Returns
    -------
    A Result of one sample with torques, multipliers and, where asked for, reactions; stability of the balance in the
    summary.

    Raises
    ------
    NumericalError : no balance is found. CapabilityError : too few actuators to hold the mechanism.
    GeometryError, SingularConfigurationError : from closing the loops; a dead point of the actuators.
    """
    watch = watch or Stopwatch()
    find = scene.statics.find
    with watch.stage("equations"):
        problem = Problem(scene)
        given = initial_positions(scene, problem)
        held = tuple(dict.fromkeys((*held_columns(scene, problem), *scene.prescribed)))
        check_prescribed(problem)
    with watch.stage("assemble"):
        q = assemble(problem, given, {}, held).q
    with watch.stage("solve"):
        state = _balanced(problem, q) if find == "balance" else _held(problem, q)
    _within_stops(problem, state.q)
    result = Result("statics", scene.title or "statics", "ok", scene.text)
    _fill(result, problem, state)
    progress(0.0, 0.0)
    result.summary["wall_time_s"] = watch.report()
    return result


def _within_stops(problem: Problem, q: Array) -> None:
    """Refuse a configuration beyond a rigid stop: what the stop bears is not among the forces that balance."""
    for joint in contact_joints(problem.model):
        for push, at in joint.stops:
            if push * (q[joint.q] - at) < -1e-9 * max(1.0, abs(at)):
                raise CapabilityError(
                    f"joint {joint.name!r} would be at {q[joint.q]:.6g}, beyond its rigid stop at {at:.6g}, which "
                    "`statics` does not follow; allowed: stops with 'stiffness', or the joint in 'initial.hold'"
                )


class _State:
    """A configuration at rest with the torques (nv,) and the multipliers (m,) of the loops that hold it."""

    def __init__(
        self, q: Array, tau: Array, lam: Array, terms: dict[str, Array], facts: dict[str, Any]
    ) -> None:
        self.q, self.tau, self.lam, self.terms, self.facts = q, tau, lam, terms, facts


class _RestForces:
    """Generalised forces at rest (see ``solve.equilibrium.Forces``): r = G - tau_passive - tau_a at v = 0, t = 0."""

    def __init__(self, problem: Problem, conditions: LoopConditions) -> None:
        model = self.model = problem.model
        self.parameters = moving_freely(problem.contact_joints)  # nothing sticks, and no stop is met
        load = list(problem.bias - problem.applied)
        lam = problem.graph.symbols(list(conditions.names), "lam")
        rows = problem.constraints.rows
        held: list[Scalar] = list(load)
        for row, multiplier in zip(rows, lam):  # led rows have a constant Psi
            for k, x in enumerate(row.psi):
                held[k] = held[k] - x * multiplier
        entries: list[Scalar] = []
        for j in range(model.nv):
            unit: list[Any] = [1.0 if k == j else 0.0 for k in range(model.nv)]
            rates: list[Any] = [0.0] * model.nq
            for body in model.bodies:
                moved = body.joint.velocity_map(slice_q(body, problem.q), slice_v(body, unit))
                rates[body.q : body.q + body.joint.nq] = list(moved)
            entries += directional(held, problem.q, rates)
        missing = [s.value[0] for s in free_symbols(load) if s.value[1] == "unknown"]
        if missing:
            raise unknown_data(missing)
        self._load, self._stiffness = Evaluator(load), Evaluator(without_idle_unknowns(entries, load))

    def _values(self, q: Array) -> dict[str, Any]:
        return {"q": q.tolist(), "v": [0.0] * self.model.nv, "t": [0.0], "p": self.parameters}

    def load(self, q: Array) -> Array:
        return np.array(self._load(self._values(q)), dtype=float)

    def stiffness(self, q: Array, lam: Array) -> Array:
        found = self._stiffness({**self._values(q), "lam": lam.tolist()})
        return np.array(found, dtype=float).reshape(self.model.nv, self.model.nv).T


def _stay(problem: Problem, q: Array) -> Lead:
    """Return a lead that keeps the held joints where they are."""
    model = problem.model
    held = [x for x in held_columns(problem.scene, problem) if x not in problem.scene.prescribed]
    quasi = [name for name in problem.scene.initial.hold if model.body_of(name).joint.quasi]
    if quasi:
        raise CapabilityError(
            f"joint {quasi[0]!r} cannot be held in a balance, since its velocities are no rates of positions; use "
            "joints of one axis in its place, or a loop closure of type fixed"
        )
    places = [model.q_names.index(name) for name in held]

    def asked(times: Array) -> tuple[Array, Array, Array]:
        still = np.tile(q[places], (len(times), 1))
        return still, 0.0 * still, 0.0 * still

    return Lead(asked, joints=tuple(held))


def _balanced(problem: Problem, q: Array) -> _State:
    conditions = LoopConditions(problem, _stay(problem, q), np.zeros(1))
    forces = _RestForces(problem, conditions)
    found = balance(conditions, forces, q)
    if not found.converged:
        raise NumericalError(
            f"no balance found in {found.iterations} steps: a force of {found.residual:.3g} N m or N is left; start "
            "nearer to one (initial.q), or hold joints that nothing balances (initial.hold)",
            residual=found.residual, q=found.q.tolist(),
        )  # fmt: skip
    model = problem.model
    loops = loop_rows(problem)
    values = {"q": found.q.tolist(), "v": [0.0] * model.nv, "t": [0.0], "p": []}
    tau = np.array(evaluate(list(problem.actuator_torques), values), dtype=float)
    _, J = conditions.at(found.q, 0.0)
    holding = [i for i in range(len(conditions.names)) if i not in loops]
    tau += J[holding].T @ found.lam[holding]
    return _State(found.q, tau, found.lam[loops], {}, _facts(found))


def _facts(found: Balance) -> dict[str, Any]:
    real = bool(np.all(np.abs(found.stiffness.imag) <= 1e-9 * np.abs(found.stiffness).max(initial=1.0)))
    return {
        "stability": found.stability,
        "stiffness": found.stiffness.real.tolist() if real else [[x.real, x.imag] for x in found.stiffness],
        "residual": found.residual,
        "iterations": found.iterations,
    }


def _held(problem: Problem, q: Array) -> _State:
    scene, model = problem.scene, problem.model
    if model.closures:
        refuse_gears(problem)
    names = scene.actuated
    if names is None:
        driven = tuple(dict.fromkeys((*scene.torques, *scene.prescribed, *scene.initial.hold)))
        names = driven if model.closures and driven else model.joint_names
    conditions = LoopConditions(problem, Lead(lambda times: (np.zeros((len(times), 0)),) * 3), np.zeros(1))
    _, J = conditions.at(q, 0.0)
    psi = J[loop_rows(problem)]
    values = {"q": q.tolist(), "v": [0.0] * model.nv, "a": [0.0] * model.nv, "t": [0.0], "p": []}
    terms = {
        name: term for name, term in torque_terms(problem).items() if name not in ("inertia", "coriolis")
    }
    entries = [x for term in terms.values() for x in term]
    missing = [s.value[0] for s in free_symbols(entries) if s.value[1] == "unknown"]
    if missing:
        raise unknown_data(missing)
    needed = {name: np.array([evaluate(term, values)], dtype=float) for name, term in terms.items()}
    needed = needed or {"gravity": np.zeros((1, model.nv))}
    columns = velocity_places(model, names)
    try:
        shared: Shared = share(psi[None], columns, needed)
    except TooFewActuators as few:
        if len(columns) >= few.freedom:
            raise SingularConfigurationError(
                f"dead point of the actuators: {', '.join(names)} cannot hold the mechanism in this configuration, "
                f"which leaves {few.freedom - few.commanded} of its {few.freedom} degrees of freedom to itself",
                kind="dead_point", q=q.tolist(),
            ) from None  # fmt: skip
        raise CapabilityError(
            f"the mechanism has {few.freedom} degrees of freedom, and its actuated joints ({', '.join(names)}) hold "
            f"{few.commanded} of them; name more in 'actuated', or find the balance (statics.find: balance)"
        ) from None
    except LostRank as lost:
        raise lost_rank(problem, lost, np.zeros(1), q[None]) from None
    facts = {
        "actuated": list(names),
        "torques": "unique"
        if shared.unique_torques
        else "least norm: more actuators than degrees of freedom",
        "multipliers": "unique" if shared.unique_multipliers else "least norm: redundant rows",
        "residual": shared.residual,
    }
    split = {name: term[0] for name, term in shared.terms.items()}
    return _State(q, shared.tau[0], shared.multipliers[0], split, facts)


def _fill(result: Result, problem: Problem, state: _State) -> None:
    model, scene = problem.model, problem.scene
    columns = joint_columns(model)
    still = np.zeros((1, model.nv))
    result.add("time", np.zeros(1))
    for path, data in (("q", state.q[None]), ("qd", still), ("qdd", still), ("tau", state.tau[None])):
        result.add(path, data, **columns[path].described())
    for name, term in state.terms.items():
        result.add(f"torque_terms/{name}", term[None], **columns["tau"].described())
    values = {"q": state.q.tolist(), "v": [0.0] * model.nv, "t": [0.0], "p": []}
    places = place_outputs(problem)
    add_places(result, {path: np.array([evaluate(e, values)], dtype=float) for path, e in places.items()})
    loops = loop_rows(problem)
    rows = [problem.constraints.rows[i] for i in loops]
    summary = result.summary
    if rows:
        described = loop_columns(rows)["constraints/multipliers"]
        result.add("constraints/multipliers", state.lam[None], units=described.units, names=described.names)
        psi = np.array([evaluate([x for row in rows for x in row.psi], values)], dtype=float)
        summary["mobility"] = mobility(problem, psi.reshape(1, len(rows), model.nv))
        summary["multipliers"] = dict(zip([row.name for row in rows], state.lam.tolist()))
        eta = np.array(evaluate([row.eta for row in rows], values), dtype=float)
        summary["constraint_residual"] = {"position": float(np.abs(eta).max())}
    summary["status"] = "ok"
    summary["termination"] = {
        "reason": "balanced" if scene.statics.find == "balance" else "held",
        "time": 0.0,
    }
    summary["samples"] = 1
    summary["find"] = scene.statics.find
    summary["configuration"] = dict(zip(model.q_names, state.q.tolist()))
    summary["torques_of_joints"] = dict(zip(model.v_names, state.tau.tolist()))
    summary["equilibrium"] = state.facts
    summary["error_estimate"] = {"force_residual": state.facts["residual"]}
    if scene.outputs.reactions:
        lam = np.zeros((1, len(problem.constraints.rows)))
        lam[0, loops] = state.lam
        add_reactions(result, problem, lam)
