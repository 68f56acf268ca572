"""Index 1: accelerations from equation (36), loops kept closed by projection, by Baumgarte, or not at all."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.algorithms.constraints import correction
from robodyn_cli.algorithms.kinematics import slice_q, slice_v
from robodyn_cli.equations.modes import FIELDS, Gate
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar, is_nonzero
from robodyn_cli.formulations.dynamics import Expanded
from robodyn_cli.formulations.index3 import Index3
from robodyn_cli.formulations.layout import Layout
from robodyn_cli.formulations.residual import Residual
from robodyn_cli.formulations.system import Chart, EventFunction, System
from robodyn_cli.kernels.crossover import prefer_rolled
from robodyn_cli.scene.types import Baumgarte

if TYPE_CHECKING:
    from robodyn_cli.formulations.rolled import Rolled


def index1(
    problem: Problem,
    stabilisation: str | Baumgarte = "projection",
    events: Sequence[EventFunction] = (),
    work: bool = True,
    expanded: bool = False,
) -> System:
    """Return the system that an explicit or collocation method steps.

    Long open trees get rolled dynamics (see ``prefer_rolled``), all others expressions.

    Parameters
    ----------
    stabilisation : ``projection`` (position and velocity put back after each step), ``independent`` (see
        ``formulations.independent``), ``none``, or Baumgarte's gains, which add -2 alpha (Psi v + eta_t) - beta^2 eta
        to the acceleration constraint.
    work : carry the work of actuators and damping as a further state, where there is any.
    expanded : give expressions in any case, for those who look into them.
    """
    constraints = problem.independent_rows
    power = problem.power if work else 0.0
    impacts = work and any(gate.stops for gate in problem.gates)  # they take energy at once
    z_rate = (power,) if is_nonzero(power) or impacts else ()
    position: Sequence[Scalar] = ()
    velocity: Sequence[Scalar] = ()
    if constraints.rows and isinstance(stabilisation, Baumgarte):
        alpha, beta = stabilisation.alpha, stabilisation.beta
        rate = constraints.velocity_residual(problem.v)
        gamma = [
            g + 2.0 * alpha * r + beta * beta * e for g, r, e in zip(constraints.gamma, rate, constraints.eta)
        ]
        qdd = problem.solution(gamma)[0].qdd
    elif not expanded and is_rolled(problem):
        from robodyn_cli.formulations.rolled import Rolled

        rolled = Rolled(problem.model, list(problem.applied), z_rate)
        return _system(problem, rolled, events)
    else:
        qdd = problem.forward.qdd
    if constraints.rows and stabilisation == "projection":
        position, velocity = projection(problem)
    elif constraints.rows and stabilisation == "independent":
        return _partitioned(problem, z_rate, events)
    system = _system(
        problem, Expanded(tuple(qdd), z_rate), events,
        position_correction=tuple(position), velocity_correction=tuple(velocity),
    )  # fmt: skip
    index3 = None if isinstance(stabilisation, Baumgarte) or system.layout is not None else Index3(problem)
    residual = Residual(problem, z_rate) if system.layout is None and Residual.fits(problem) else None
    return dataclasses.replace(system, index3=index3, residual=residual)


def _partitioned(problem: Problem, z_rate: Sequence[Scalar], events: Sequence[EventFunction]) -> System:
    from robodyn_cli.formulations.independent import PartitionChart, partition

    found = partition(problem, z_rate)
    system = _system(
        problem, Expanded(tuple(found.acceleration), tuple(found.z_rate)), (*events, found.renewal),
        position_correction=tuple(found.position), velocity_correction=tuple(found.velocity),
    )  # fmt: skip
    positions, velocities = projection(problem)
    if system.layout is not None:
        positions, velocities = system.layout.renamed(positions), system.layout.renamed(velocities)
    return dataclasses.replace(
        system,
        chart=PartitionChart(problem),
        sample_positions=tuple(positions),
        sample_velocities=tuple(velocities),
    )


def _system(
    problem: Problem, dynamics: Rolled | Expanded, events: Sequence[EventFunction], **corrections: Any
) -> System:
    rows_renewed, chart = _row_chart(problem)
    events = (*events, *kinks(problem), *rows_renewed, *mode_events(problem))
    layout = Layout.of(problem.model, len(dynamics.z_rate))
    if layout is not None:
        assert isinstance(dynamics, Expanded)
        return _quasi_system(problem, dynamics, events, layout, chart, **corrections)
    return System(
        nq=problem.model.nq,
        nv=problem.model.nv,
        dynamics=dynamics,
        nz=len(dynamics.z_rate),
        events=events,
        breakpoints=problem.breakpoints,
        chart=chart,
        parameters=start_modes(problem),
        **corrections,
    )


def _row_chart(problem: Problem) -> tuple[Sequence[EventFunction], Chart | None]:
    """Return when and how the combinations of dependent rows are chosen anew, where there are such rows."""
    if not problem.dependent:
        return (), None
    from robodyn_cli.formulations.row_chart import RowChart, renewals

    return renewals(problem), RowChart(problem)


def _quasi_system(
    problem: Problem,
    dynamics: Expanded,
    events: Sequence[EventFunction],
    layout: Layout,
    chart: Chart | None,
    position_correction: Sequence[Scalar] = (),
    velocity_correction: Sequence[Scalar] = (),
) -> System:
    """Return the system of a mechanism with quasi-velocities: q-dot = N(q) v is integrated beside v-dot."""
    rates: list[Scalar] = [0.0] * layout.size
    normal: dict[int, Scalar] = {}
    for body in problem.model.bodies:
        joint, q, v = body.joint, slice_q(body, problem.q), slice_v(body, problem.v)
        for k, x in enumerate(joint.velocity_map(q, v)):
            rates[layout.q[body.q + k]] = x
        for k in range(joint.nv):
            rates[layout.v[body.v + k]] = dynamics.acceleration[body.v + k]
        if joint.quasi:
            for k, x in enumerate(joint.normalise(q)):
                if x is not q[k]:
                    normal[layout.q[body.q + k]] = x
    for place, x in zip(layout.z, dynamics.z_rate):
        rates[place] = x
    n = layout.ordinary
    parts = [rates[n:], normal.values(), position_correction, velocity_correction, [e.value for e in events]]
    found = layout.renamed([x for part in parts for x in part])
    ends = list(itertools.accumulate(len(part) for part in parts))
    renamed = [tuple(found[end - len(part) : end]) for part, end in zip(parts, ends)]
    return System(
        nq=n,
        nv=n,
        dynamics=Expanded(renamed[0][:n], renamed[0][n:]),
        nz=layout.size - 2 * n,
        position_correction=renamed[2],
        velocity_correction=renamed[3],
        events=tuple(dataclasses.replace(e, value=x) for e, x in zip(events, renamed[4])),
        breakpoints=problem.breakpoints,
        chart=chart,
        parameters=start_modes(problem),
        layout=layout,
        normalisation=renamed[1],
        normalised=tuple(normal),
    )


def is_rolled(problem: Problem) -> bool:
    """Tell whether a simulation goes by loops over the bodies instead of one graph of expressions."""
    quasi = any(body.joint.quasi for body in problem.model.bodies)
    plain = not quasi and not problem.scene.prescribed and not problem.gates
    return plain and prefer_rolled(problem.model)


def kinks(problem: Problem) -> tuple[EventFunction, ...]:
    """Return the events of formulas that switch with the state (times are breakpoints)."""
    return tuple(
        EventFunction(key, switch, terminal=False, kink=True) for key, switch in problem.state_switches
    )


def mode_events(problem: Problem) -> tuple[EventFunction, ...]:
    """Return the events at which joints with modes may change theirs: stops, ``rest``, and ``break``."""
    found: list[EventFunction] = []

    def add(kind: str, gate: Gate, value: Scalar) -> None:
        found.append(EventFunction(f"{kind} {gate.joint}", value, -1, terminal=False, mode=True))

    # forces that hold cost the accelerations, which the loops of a long chain do without
    for gate, force in zip(problem.gates, problem.holding if problem.gates else []):
        for push, at in gate.stops:
            add("stop lower" if push > 0.0 else "stop upper", gate, push * (problem.q[gate.q] - at))
        if gate.friction is not None:
            add("rest", gate, gate.direction * problem.v[gate.v])
        add("break high", gate, gate.hold * (gate.high - force))
        add("break low", gate, gate.hold * (force - gate.low))
    return tuple(found)


def start_modes(problem: Problem) -> tuple[float, ...]:
    """Return parameters with which every joint moves freely, without Coulomb friction."""
    if not problem.gates:
        return ()
    last = problem.gates[-1]
    return (0.0,) * (last.place + len(FIELDS))


def projection(problem: Problem) -> tuple[list[Scalar], list[Scalar]]:
    """Return one Newton step onto eta = 0, along the joints' manifolds, and the step onto Psi v + eta_t = 0.

    Both are of least norm in the velocity coordinates, on which Psi acts.
    """
    constraints = problem.independent_rows
    psi = constraints.psi(problem.model.nv)
    dq = correction(psi, constraints.eta)
    dv = correction(psi, constraints.velocity_residual(problem.v))
    q = problem.moved(dq)
    v: list[Scalar] = [x - d for x, d in zip(problem.v, dv)]
    return q, v


def residuals(problem: Problem) -> dict[str, list[Scalar]]:
    """Return eta and Psi v + eta_t, for reports."""
    constraints = problem.constraints
    return {"position": constraints.eta, "velocity": constraints.velocity_residual(problem.v)}


def multiplier_norm(lam: np.ndarray) -> np.ndarray:
    """Return the Euclidean norm over the rows (T,)."""
    return np.asarray(np.sqrt((lam**2).sum(axis=1)))
