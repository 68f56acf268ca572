"""From a mechanism's equations to the system that an integrator steps: a formulation, its events, its coordinates."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import powers, total
from robodyn_cli.expr.graph import Scalar, is_nonzero
from robodyn_cli.formulations.events import EventFunction, EventKind, Passing
from robodyn_cli.formulations.index1 import Formulated, Formulation
from robodyn_cli.formulations.layout import Layout
from robodyn_cli.formulations.system import Partition, System
from robodyn_cli.kernels.crossover import prefer_rolled
from robodyn_cli.registry import Registry
from robodyn_cli.scene.types import Baumgarte

FORMULATIONS: Registry[Formulation] = Registry(
    "robodyn_cli.formulations",
    {
        "none": "index1:plain",
        "projection": "index1:projected",
        "baumgarte": "index1:baumgarte",
        "independent": "independent:independent",
        "rolled": "rolled:rolled",
    },
)
ORDER = {kind: k for k, kind in enumerate(EventKind)}


def build_system(
    problem: Problem,
    stabilisation: str | Baumgarte = "projection",
    events: Sequence[EventFunction] = (),
    work: bool = True,
    expanded: bool = False,
) -> System:
    """Return the system that an integrator steps.

    Long open trees get rolled dynamics (see ``prefer_rolled``), all others expressions.

    Parameters
    ----------
    stabilisation : of closed loops: ``projection``, ``independent``, ``none``, or Baumgarte's gains.
    events : functions to watch beside discontinuities and re-partitions.
    work : carry the work of actuators and damping as a further state, where there is any.
    expanded : give expressions in any case, for callers that analyse them.
    """
    formulated, z_rate, doers = _formulated(problem, stabilisation, work, expanded)
    partition = formulated.partition or _row_combinations(problem)
    own = (*discontinuities(problem), *(partition.functions if partition is not None else ()))
    system = System(
        nq=problem.model.nq,
        nv=problem.model.nv,
        dynamics=formulated.dynamics,
        nz=len(z_rate),
        corrections=formulated.corrections,
        events=tuple(sorted((*events, *own), key=lambda e: ORDER[e.kind])),
        breakpoints=problem.switching.breakpoints,
        partition=partition,
        parameters=problem.at_start,
        work_done_by=doers,
        forms=formulated.forms,
    )
    layout = Layout.of(problem.model, len(z_rate))
    if layout is not None:
        from robodyn_cli.formulations.quasi import with_layout

        system = with_layout(problem, system, layout)
    if problem.latches and not expanded:
        from robodyn_cli.formulations.closings import Closings

        system = dataclasses.replace(system, closings=Closings.of(problem, layout))
    if problem.control is None or problem.control.period is None:
        return system
    from robodyn_cli.formulations.updates import Updates

    updates = Updates.of(problem.control, layout, problem.scene.simulate.duration)
    return dataclasses.replace(system, updates=updates)


def expanded_rates(problem: Problem, stabilisation: str | Baumgarte) -> tuple[list[Scalar], list[Scalar]]:
    """Return the rates of an expanded system, in the mechanism's symbols: of all states but work, and of work."""
    formulated, z_rate, doers = _formulated(problem, stabilisation, work=True, expanded=True)
    layout = Layout.of(problem.model, len(z_rate))
    if layout is None:
        rates = list(itertools.chain(*formulated.dynamics.expressions()))
    else:
        from robodyn_cli.formulations.quasi import rates_at

        rates = rates_at(problem, formulated.dynamics, layout)[layout.ordinary :]
    own = len(rates) - bool(doers)
    return rates[:own], rates[own:]


def formulation_of(problem: Problem, stabilisation: str | Baumgarte, expanded: bool = False) -> str:
    """Return the name of the formulation that suits a mechanism; without constraints there is nothing to stabilise."""
    if not problem.independent_rows.rows:
        return "rolled" if not expanded and is_rolled(problem) else "none"
    return "baumgarte" if isinstance(stabilisation, Baumgarte) else stabilisation


def _formulated(
    problem: Problem, stabilisation: str | Baumgarte, work: bool, expanded: bool
) -> tuple[Formulated, tuple[Scalar, ...], tuple[str, ...]]:
    """Return the equations as they are formulated, the rates of the further states, and what does work or takes energy,
    but for gravity and springs; where anything does, its power is the last of the rates."""
    by_name: dict[str, Scalar] = {}
    if work:
        by_name = {name: power for name, power in powers(problem).items() if is_nonzero(power)}
        # these bring or take energy at once
        if any(joint.stops for joint in problem.contact_joints):
            by_name["impacts on rigid stops"] = 0.0
        if problem.latches:
            by_name["latches that close and open"] = 0.0
        if problem.model.switched:
            by_name["payloads, gripped and released"] = 0.0
    z_rate = () if problem.control is None else tuple(problem.control.rates)
    z_rate += (total(by_name.values()),) if by_name else ()
    name = formulation_of(problem, stabilisation, expanded)
    return FORMULATIONS[name](problem, z_rate, stabilisation), z_rate, tuple(by_name)


def is_rolled(problem: Problem) -> bool:
    """Tell whether a simulation goes by loops over the bodies instead of one graph of expressions."""
    quasi = any(body.joint.quasi for body in problem.model.bodies)
    plain = not quasi and not problem.scene.prescribed and not problem.is_held
    plain = plain and not problem.model.switched
    return plain and prefer_rolled(problem.model)


def discontinuities(problem: Problem) -> tuple[EventFunction, ...]:
    """Return the events of formulas that switch with the state (times are breakpoints)."""
    owner = Passing()
    return tuple(
        EventFunction(key, switch, kind=EventKind.DISCONTINUITY, owner=owner)
        for key, switch in problem.switching.with_state
    )


def _row_combinations(problem: Problem) -> Partition | None:
    """Return the choice of independent combinations of dependent rows, where there are such rows."""
    if not problem.dependent:
        return None
    from robodyn_cli.formulations.independent import RowCombinations

    return RowCombinations(problem)
