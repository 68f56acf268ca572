"""The step from the mechanism's q, v to an integrator's state where a joint has quasi-velocities, q-dot = N(q) v.

See ``layout`` for where everything then lies. All expressions are written anew in the integrator's symbols.
"""

from __future__ import annotations

import dataclasses
import itertools

from robodyn_cli.algorithms.kinematics import position_rates, slice_q
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.dynamics import Dynamics, Expanded
from robodyn_cli.formulations.layout import Layout
from robodyn_cli.formulations.system import Corrections, System


def with_layout(problem: Problem, system: System, layout: Layout) -> System:
    """Return the system whose state lies as ``layout`` says; ``system`` is written in the mechanism's symbols."""
    rates = rates_at(problem, system.dynamics, layout)
    normal = _normalisation(problem, layout)
    c, n = system.corrections, layout.ordinary
    parts = (
        rates[n:], normal.values(), c.position, c.velocity, c.sample_position, c.sample_velocity,
        [e.value for e in system.events],
    )  # fmt: skip
    renamed = layout.renamed([x for part in parts for x in part])
    ends = itertools.accumulate(len(part) for part in parts)
    own, normalisation, *corrections, events = (
        tuple(renamed[end - len(part) : end]) for part, end in zip(parts, ends)
    )
    position, velocity, sample_position, sample_velocity = corrections
    return dataclasses.replace(
        system,
        nq=n,
        nv=n,
        dynamics=Expanded(own[:n], own[n:]),
        nz=layout.size - 2 * n,
        corrections=Corrections(
            position, velocity, normalisation, tuple(normal), sample_position, sample_velocity
        ),
        events=tuple(dataclasses.replace(e, value=x) for e, x in zip(system.events, events)),
        layout=layout,
        forms=None,
    )


def rates_at(problem: Problem, dynamics: Dynamics, layout: Layout) -> list[Scalar]:
    """Return x-dot in the places of the layout, in the mechanism's symbols."""
    rates: list[Scalar] = [0.0] * layout.size
    acceleration, z_rate = dynamics.expressions()
    position = position_rates(problem.model, problem.q, problem.v)
    for places, values in ((layout.q, position), (layout.v, acceleration), (layout.z, z_rate)):
        for place, x in zip(places, values):
            rates[place] = x
    return rates


def _normalisation(problem: Problem, layout: Layout) -> dict[int, Scalar]:
    """Return the positions put back on their joints' manifolds, by place, for those that this changes."""
    normal: dict[int, Scalar] = {}
    for body in problem.model.bodies:
        if body.joint.quasi:
            q = slice_q(body, problem.q)
            for k, x in enumerate(body.joint.normalise(q)):
                if x is not q[k]:
                    normal[layout.q[body.q + k]] = x
    return normal
