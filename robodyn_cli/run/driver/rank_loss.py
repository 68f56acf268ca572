"""The stop where the loops' constraints lose rank: seen from afar, and found by looking ahead.

Close to a loss of rank the multipliers are ill-conditioned, so it is never crept up to. What is watched is the
closeness 1 / (tr A tr A^-1) of A = Psi Psi^T, which lies between the squared ratio of smallest to largest singular
value and m times less; where it falls below NEAR^2 a look ahead tells whether the motion runs into a loss of rank.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.dependence import closeness
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SingularConfigurationError
from robodyn_cli.formulations.events import GO_ON, Event, EventFunction, EventKind, Outcome
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.run.driver.driver import Driver
from robodyn_cli.run.driver.motion import Motion, Watcher
from robodyn_cli.run.driver.singularity import RANK, classify, culprit, refuse_dependent_rows, singular_ratio

Array = NDArray[np.float64]
NEAR = 0.02  # ratio of singular values from which on a loss of rank is looked for ahead
FIRST_STEP = 0.05  # of the time in which the ratio would vanish at the speed of the fastest joint
ON_THE_WAY = 0.9  # of the way to the root of the secant that one trial step covers
LOOKS = 60
RECEDING = 3  # times that the root may recede instead of closing in


class RankLoss(Watcher):
    """Stops a run that comes to a loss of rank; coming near and leaving again passes."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        rows = problem.independent_rows
        if len(rows):
            value = closeness(rows) - NEAR * NEAR
            self.functions = (EventFunction("near_rank_loss", value, -1, EventKind.RANK_LOSS, self),)

    def follow(self, motion: Motion) -> None:
        self.motion = motion

    def begin(self, t: float, x: Array, options: Options) -> Array:
        self.options = options
        return x

    def handle(self, event: Event) -> Outcome:
        """Go on where the motion only comes near.

        Raises
        ------
        SingularConfigurationError : Psi loses rank.
        """
        ahead = self.ahead(event)
        if ahead is None:
            return GO_ON
        time, state = ahead
        q, _, _ = self.motion.system.split(state)
        found = classify(self.problem, q, ())
        named = culprit(self.problem, q, range(self.problem.model.nv), time)
        raise SingularConfigurationError(
            f"bifurcation at t = {time:.9g} s: the constraint Jacobian of loop {named.loop} loses rank and lets joint "
            f"{named.joint} go, so the multipliers are not unique and the motion may branch; set simulate.singular: "
            "pass to go on",
            time=time, kind="bifurcation", singular_values=found.psi.tolist(), q=q.tolist(),
            loop=named.loop, joint=named.joint,
        )  # fmt: skip

    def ahead(self, event: Event) -> tuple[float, Array] | None:
        """Return time and state of the loss of rank that the motion runs into from here on, None where it does not.

        Raises
        ------
        NumericalError : only the rows that were kept of redundant ones lose rank.
        """
        found = rank_loss_ahead(self.motion, self.options, event)
        if found is not None:
            refuse_dependent_rows(self.problem, self.motion.system.split(found[1])[0], found[0])
        return found


def rank_loss_ahead(motion: Motion, options: Options, event: Event) -> tuple[float, Array] | None:
    """Tell whether the motion from an event on runs into a loss of rank, and where: time and state, else None.

    It is approached by steps that cover nine tenths of the way to the root of the secant of the ratio of singular
    values (which falls linearly towards it), and the small rest is extrapolated.
    """
    system = motion.system
    driver = Driver(system, motion.choice.method, options)

    def ratio_at(state: Array) -> float:
        return singular_ratio(motion.problem, system.split(state)[0])

    speed = float(np.abs(system.split(event.state)[1]).max())
    if speed == 0.0:
        return None
    low, state = event.time, event.state
    ratio = ratio_at(state)
    trial, rest, receding = low + FIRST_STEP * ratio / speed, np.inf, 0
    for _ in range(LOOKS):
        driver.start(low, state, dataclasses.replace(options, max_step=(trial - low) / 4))
        try:
            driver.advance(trial)
        except NumericalError:
            break
        before, low, state = (low, ratio, state), trial, driver.state
        ratio = ratio_at(state)
        slope = (ratio - before[1]) / (low - before[0])
        if not slope < 0.0:
            return None
        root = low - ratio / slope
        # on the way to a mere minimum the root recedes instead of closing in
        receding = receding + 1 if root - low > 0.5 * rest else 0
        if receding > RECEDING:
            return None
        rest = root - low
        if ratio < RANK:
            return root, state + rest / (low - before[0]) * (state - before[2])
        trial = low + ON_THE_WAY * rest
    return None
