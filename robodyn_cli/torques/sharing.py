"""How actuators and loops share a load; errors name joints and loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SingularConfigurationError
from robodyn_cli.solve.load_sharing import LostRank, Shared, TooFewActuators, share
from robodyn_cli.spatial.algebra import Array


def refuse_idle_gears(problem: Problem, driven: Sequence[int]) -> None:
    """Refuse gears with losses in joints without an actuator, on which nothing says what the gear passes on.

    Raises
    ------
    CapabilityError
    """
    for _, gear in geared(problem.model):
        if gear.v not in driven:
            raise CapabilityError(
                f"joint {gear.name!r} has a gear with losses but no actuator (`actuated`), so no load goes through the "
                "gear; allowed there: friction",
                joint=gear.name,
            )


def share_load(
    problem: Problem, psi: Array, driven: Sequence[int], needed: Mapping[str, Array], times: Array, q: Array
) -> Shared:
    """Return torques and multipliers that bear a load (see ``solve.load_sharing.share``).

    Parameters
    ----------
    psi : (T, m, nv) of the loops. driven : velocity coordinates with an actuator. needed : the load (T, nv) by name.
    times, q : of the samples (T,), (T, nq), for messages.

    Raises
    ------
    CapabilityError : too few actuators. SingularConfigurationError : loops or actuators lose their hold at a sample.
    """
    try:
        return share(psi, driven, needed)
    except TooFewActuators as few:
        names = ", ".join(problem.model.joint_of(k) for k in driven)
        raise CapabilityError(
            f"the mechanism has {few.freedom} degrees of freedom, and its actuated joints ({names}) command "
            f"{few.commanded} of them anywhere; allowed: as many independent ones, in 'actuated'",
            key="actuated",
        ) from None
    except LostRank as lost:
        raise lost_rank(problem, lost, times, q) from None


def lost_rank(problem: Problem, lost: LostRank, times: Array, q: Array) -> SingularConfigurationError:
    """Return the error of a sample at which loops or actuators lose their hold, with loop and joint."""
    time, where = float(times[lost.sample]), q[lost.sample].tolist()
    worst = int(np.argmax(lost.weights))
    if lost.what == "actuators":
        joint = problem.model.joint_of(worst)
        when = f"at t = {time:.9g} s"
        if lost.passed:
            when = f"between t = {time:.9g} s and {float(times[lost.sample + 1]):.9g} s"
        return SingularConfigurationError(
            f"dead point of the actuators {when}: joint {joint} moves without them, so no finite torques "
            "give it the acceleration asked for; actuate another joint, or more",
            time=time, kind="dead_point", joint=joint, q=where,
        )  # fmt: skip
    row = problem.constraints.loop_rows[worst]
    return SingularConfigurationError(
        f"bifurcation at t = {time:.9g} s: the rows of loop {row.closure} lose rank there ({row.name}), so the "
        "multipliers are not unique and the mechanism may go on in more than one way",
        time=time, kind="bifurcation", loop=row.closure, row=row.name, q=where,
    )  # fmt: skip
