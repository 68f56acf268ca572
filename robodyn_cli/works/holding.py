"""The torques of actuators that hold a mechanism where it is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import torque_terms
from robodyn_cli.errors import CapabilityError, SingularConfigurationError
from robodyn_cli.given.loop_conditions import LoopConditions, nothing_led, velocity_places
from robodyn_cli.solve.load_sharing import LostRank, Shared, TooFewActuators, share
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.mechanism import Held
from robodyn_cli.torques.sharing import lost_rank
from robodyn_cli.trajectories.led import led_joints
from robodyn_cli.works.at_rest import AtRest, refuse_unknown


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
