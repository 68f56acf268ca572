"""Loss of rank of the loops' constraints: seen from afar, found by looking ahead, and a stop or a pose to pass.

Watched is the closeness 1 / (tr A tr A^-1) of A = Psi Psi^T, which lies between the squared ratio of smallest to
largest singular value and m^2 times less. How far away the motion still is when it falls below a threshold depends on
the mechanism. So there is a ladder of thresholds, each met at a quarter of the distance of the one before. At each the
motion is followed ahead (``pose_ahead.py``); where the pose is still far, the next one is waited for.
"""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import numpy as np

from robodyn_cli.equations.constraints import closeness
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, SingularConfigurationError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.events import GO_ON, Event, EventFunction, EventKind, Leap, Outcome
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.motion import Motion, Watcher
from robodyn_cli.motion.singular.leap import BesidePose, LeapEquations, LeapState, leap_rounding
from robodyn_cli.motion.singular.leap import PoseLeap as FoundLeap
from robodyn_cli.motion.singular.pose_ahead import NODES, REACH, PoseAhead, PoseApproach, Unresolved
from robodyn_cli.ready.singularity import classify, culprit, refuse_dependent_rows
from robodyn_cli.spatial.algebra import Array

NEAR = 0.03  # ratio of singular values at the highest threshold
RUNGS = 8
LOWER = 1 / 16  # one threshold of the closeness over the one before: a quarter of the distance, squared
SCOUTED = 20_000  # steps towards a pose, far more than it takes; steps that shrink to nothing get no further
# of a leap in a second integration, which must not repeat its error; its nodes are hardly closer to the pose, where
# rounding grows as the distance falls
OTHER_NODES, OTHER_REACH = 14, 0.3


class PosesAhead(Watcher):
    """Looks ahead for poses in which the loops lose rank; what becomes of them is for those who derive from it."""

    kind = EventKind.RANK_LOSS

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.nodes, self.reach = NODES, REACH
        rows = problem.loop_psi
        if len(rows):
            near = closeness(rows)
            self.functions = tuple(self._rung(near, NEAR * NEAR * LOWER**k, k) for k in range(RUNGS))

    def _rung(self, near: Scalar, threshold: float, k: int) -> EventFunction:
        return EventFunction(f"near_rank_loss.{k + 1}", near - threshold, -1, self.kind, self)

    def follow(self, motion: Motion) -> None:
        self.motion, self.end = motion, motion.scene.simulate.duration
        self._equations: LeapEquations | None = None

    def begin(self, t: float, x: Array, options: Options) -> Array:
        self.options = options
        return x

    @property
    def kernels(self) -> dict[str, SampleKernel]:
        near = self.equations
        parts = {"loops": near.geometry, "rates": near.rates, "steps": near.shift}
        return {f"{part} near a loss of rank": kernel for part, kernel in parts.items()}

    @property
    def equations(self) -> LeapEquations:
        """The equations of motion in parts, compiled when the first pose comes near."""
        if self._equations is None:
            self._equations = LeapEquations(self.problem, bool(self.motion.system.work_done_by))
        return self._equations

    def ahead(self, event: Event) -> PoseAhead | Unresolved | None:
        """Return the pose that the motion from an event runs into, None where it does not, is still far, or where
        another event comes first, after which the motion goes on otherwise.

        Raises
        ------
        NumericalError : only the rows that were kept of redundant ones lose rank.
        """
        scout = self._scout(event)

        def advance(time: float) -> LeapState:
            scout.advance(time)
            return self._moment(scout.time, scout.state)

        turning = np.array([unit == "rad" for unit in self.problem.model.v_units])
        self.equations.in_contact(self._given(event))
        approach = PoseApproach(self.equations, advance, turning, self.nodes, self.reach, self.check)
        try:
            pose = approach.pose_ahead(self._moment(event.time, event.state), self.end)
        except NumericalError:
            return None  # the run itself comes to the same place and says what is wrong
        if pose is None or self._turns_before(event, pose):
            return None
        refuse_dependent_rows(self.problem, pose.state.q, pose.time)
        return pose

    def _turns_before(self, event: Event, pose: PoseAhead | Unresolved) -> bool:
        """Tell whether a latch closes or opens, or a contact or a payload changes, on the way to a pose ahead."""
        functions = self.motion.system.events
        if not any(function.turns_motion for function in functions):
            return False
        here, there = self._scout(event).integrator, self._moment_of(pose)
        before = here.event_values()
        here.reset(there.time, self.motion.system.join(there.q, there.v, there.z), self.options)
        return any(
            function.turns_motion and function.crosses(a, b)
            for function, a, b in zip(functions, before, here.event_values())
        )

    def _moment_of(self, pose: PoseAhead | Unresolved) -> LeapState:
        """Return up to where nothing else is to happen."""
        return pose.state

    def check(self, leap: FoundLeap, pose: float) -> None:
        """Refuse a leap over a pose at a time [s] that the run is not to make (NotSmooth)."""

    def _given(self, event: Event) -> Array:
        """Return the values of p that events have set: contact states of joints, what is carried."""
        return event.parameters[: len(self.motion.system.parameters)]

    def _scout(self, event: Event) -> Driver:
        """Return a driver of its own that stands at an event."""
        options = self.options
        if options.step is None:
            options = dataclasses.replace(options, max_steps=min(options.max_steps, SCOUTED))
        scout = Driver(self.motion.system, self.motion.choice.method, options, parameters=self._given(event))
        scout.start(event.time, event.state)
        return scout

    def _moment(self, time: float, state: Array) -> LeapState:
        return LeapState(time, *self.motion.system.split(state))


class RankLoss(PosesAhead):
    """Stops a run that comes to a loss of rank; coming near and leaving again passes."""

    def handle(self, event: Event) -> Outcome:
        """Go on where the motion only comes near.

        Raises
        ------
        SingularConfigurationError : Psi loses rank.
        """
        pose = self.ahead(event)
        if pose is None:
            return GO_ON
        q = pose.state.q
        kind = classify(self.problem, q, ())
        named = culprit(self.problem, q, range(self.problem.model.nv), pose.time)
        several = f" in {pose.lost} directions" if isinstance(pose, PoseAhead) and pose.lost > 1 else ""
        raise SingularConfigurationError(
            f"bifurcation at t = {pose.time:.9g} s: the constraint Jacobian of loop {named.loop} loses rank{several} "
            f"and lets joint {named.joint} go, so the multipliers are not unique and the motion may branch; set "
            "simulate.singular: pass to go on",
            time=pose.time, kind="bifurcation", singular_values=kind.psi.tolist(), q=q.tolist(),
            loop=named.loop, joint=named.joint,
        )  # fmt: skip


class Passage(PosesAhead):
    """Passes poses in which the loops lose rank, along the motion's own branch. ``crossed`` : their times [s]."""

    kind = EventKind.PASSAGE
    changes_motion = True

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self.crossed: list[float] = []
        self._rounding = 0.0

    def begin(self, t: float, x: Array, options: Options) -> Array:
        self.crossed, self._rounding = [], 0.0
        return super().begin(t, x, options)

    @property
    def rounding(self) -> float:
        return self._rounding

    def facts(self, end: float) -> dict[str, Any]:
        return {"passed": [time for time in self.crossed if time <= end]}

    def again(self) -> Passage:
        """Return one with other nodes, so that two integrations do not share the error of a leap."""
        other = copy.copy(self)
        other.nodes, other.reach = OTHER_NODES, OTHER_REACH
        return other

    @property
    def kernels(self) -> dict[str, SampleKernel]:
        beside = self._beside.kernel
        return super().kernels | ({"events beside a pose that is passed": beside} if beside else {})

    def follow(self, motion: Motion) -> None:
        super().follow(motion)
        self._beside = BesidePose(self.problem, [f for w in motion.watchers for f in w.functions])

    def check(self, leap: FoundLeap, pose: float) -> None:
        self._beside.check(self.equations, leap, pose)

    def _moment_of(self, pose: PoseAhead | Unresolved) -> LeapState:
        return pose.leap.start if isinstance(pose, PoseAhead) else pose.state

    def handle(self, event: Event) -> Outcome:
        """Leap over the pose ahead, where there is one.

        Raises
        ------
        SingularConfigurationError : a pose that no smooth branch leads over.
        """
        pose = self.ahead(event)
        if pose is None:
            return GO_ON
        held = self._beside.refuse_held(event.parameters)
        if held and isinstance(pose, PoseAhead):
            pose = Unresolved(pose.state, pose.regular_until, held)
        if isinstance(pose, Unresolved):
            loops = ", ".join(self.problem.model.closures)
            raise SingularConfigurationError(
                f"the singular configuration at t = {pose.time:.9g} s, in which the constraints of {loops} lose rank, "
                f"cannot be passed: {pose.reason}",
                time=pose.time, kind="bifurcation",
            )  # fmt: skip
        self.crossed.append(pose.time)
        leap = pose.leap
        self._rounding += leap_rounding(self.equations, leap)

        def states(t: Array) -> Array:
            """Return states (T, nx): of the way to the leap, then of the leap itself."""
            scout = self._scout(event)
            rows = []
            for time in t[t < leap.start.time].tolist():
                scout.advance(time)
                rows.append(scout.state)
            rows += [self.motion.system.join(*moment) for moment in zip(*leap.at(t[t >= leap.start.time]))]
            return np.array(rows)

        return Leap(leap.end, states(np.array([leap.end]))[0], states)
