"""What a leap over a singular pose must not step over: contacts, jumps of the equations with the state, dead points."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.events import EventFunction, EventKind
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.motion.singular.leap import Equations, Leap, NotSmooth
from robodyn_cli.spatial.algebra import Array

TIMES = 97  # at which a leap is looked at
AT_THE_POSE = 0.02  # part of a leap about the pose, where the input loses its grip in any case


class BesidePose:
    """Event functions of a run, to be evaluated along a leap, which no event ends.

    Parameters
    ----------
    functions : of all watchers of the run.
    """

    def __init__(self, problem: Problem, functions: Iterable[EventFunction]) -> None:
        self.problem = problem
        known = [f for f in functions if f.kind in (EventKind.CONTACT, EventKind.DEAD_POINT)]
        switches = problem.switching.with_state
        self.names = [f.name for f in known] + [f"{key} switches" for key, _ in switches]
        self.falling = np.array(
            [f.kind is EventKind.CONTACT for f in known] + [False] * len(switches), dtype=bool
        )
        self.grip = np.array(
            [f.kind is EventKind.DEAD_POINT for f in known] + [False] * len(switches), dtype=bool
        )
        values: list[Scalar] = [*(f.value for f in known), *(switch for _, switch in switches)]
        self.kernel = SampleKernel({"g": values}, STATE_GROUPS) if values else None

    def refuse_held(self, parameters: Array) -> str:
        """Return why no leap starts in the contact states of ``parameters``, "" where one may."""
        for joint in self.problem.contact_joints:
            if parameters[joint.place]:
                return f"joint {joint.name!r} sticks or lies on its stop there"
        return ""

    def check(self, equations: Equations, leap: Leap, pose: float) -> None:
        """Refuse a leap in which a function changes its sign.

        Raises
        ------
        NotSmooth : names it, and the time.
        """
        if self.kernel is None:
            return
        t = np.linspace(leap.start.time, leap.end, TIMES)
        g = np.sign(equations.values(self.kernel, t, *leap.at(t))["g"])
        crossed = (g[:-1] * g[1:] < 0.0) & ~(self.falling & (g[:-1] < 0.0))
        near = np.abs(0.5 * (t[:-1] + t[1:]) - pose) < AT_THE_POSE * leap.length
        crossed &= ~(near[:, None] & self.grip)
        if crossed.any():
            k, which = np.argwhere(crossed)[0]
            raise NotSmooth(f"{self.names[which]} at t = {t[k]:.6g} s, too close to the pose")
