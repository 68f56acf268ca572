"""What the engines are told of a case: model, start, and what acts in its joints, in terms that engines have too."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import poses, transforms
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SingularConfigurationError
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.over.stability.cases import Case
from robodyn_cli.ready.prepare import initial_positions, prepare
from robodyn_cli.scene.load import load_scene_text

SECONDS = 10.0  # of computing; a run that takes longer is too slow
Run = Callable[[np.ndarray], np.ndarray]


class TooSlow(Exception):
    """A run has taken its time."""


class Refused(Exception):
    """The engine cannot be given this model; the message says why, in few words."""


class Clock:
    """Ends a run whose time is up."""

    def __init__(self) -> None:
        self.end = time.process_time() + SECONDS

    @property
    def up(self) -> bool:
        return time.process_time() > self.end

    def check(self) -> None:
        if self.up:
            raise TooSlow


class Mechanism:
    """A case as an engine needs it; arrays over the joint coordinates are in robodyn's order.

    k, rest, c : springs and dampers of joints. coulomb : levels of dry friction, and ``speed`` what a scene smooths
    them over (0: exact). stops : of each coordinate lower bound, upper bound and restitution, or None.
    plain : whether nothing else acts in the joints. stiffening : where all that acts is linear in positions and rates,
    k, rest, c and constant torque at a time, for engines that let a user set these anew before each step.
    """

    def __init__(self, case: Case, text: str | None = None) -> None:
        # engines want whole inertias; in the plane the other components have no effect
        text = case.text(True) if text is None else text
        whole = re.sub(r"inertia: \{zz: ([^}]+)\}", r"inertia: {xx: \1, yy: \1, zz: \1}", text)
        self.name = case.name
        self.scene = load_scene_text(whole, "case.yaml")
        try:
            setup = prepare(self.scene)
            self.problem = setup.problem
            self.q, self.v = setup.assembled.q, setup.assembled.v
        except SingularConfigurationError:
            # what robodyn refuses to start, others are given as it is written
            self.problem = Problem(self.scene)
            given = initial_positions(self.scene, self.problem)
            self.q = np.array([given[name] for name in self.problem.model.q_names])
            self.v = np.zeros(self.problem.model.nv)
        self.model = self.problem.model
        n = self.model.nv
        self.k, self.rest, self.c = np.zeros(n), np.zeros(n), np.zeros(n)
        self.coulomb, self.speed = np.zeros(n), 0.0
        self.stops: list[tuple[float, float, float] | None] = [None] * n
        self.plain = not self.scene.torques
        for body in self.model.bodies:
            for force in body.forces:
                self._take(body.v, force.element)
        self.stiffening = STIFFENING.get(case.name)

    def _take(self, j: int, element: Any) -> None:
        kind = type(element).__name__
        if kind == "Spring":
            self.k[j], self.rest[j] = element.stiffness, element.rest
        elif kind == "Damper":
            self.c[j] = element.damping
        elif kind == "Friction":
            self.c[j] += element.viscous
            self.coulomb[j], self.speed = element.coulomb, element.transition_speed or 0.0
        elif kind == "Limits" and element.stop.stiffness is None:
            self.stops[j] = (element.lower, element.upper, element.stop.restitution)
        else:
            raise Refused(f"no {kind}")

    @cached_property
    def _applied(self) -> Evaluator:
        return Evaluator(list(self.problem.applied))

    @property
    def rigid(self) -> bool:
        return any(stop is not None for stop in self.stops)

    def torques(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return everything that acts on the joints but gravity and impacts; dry friction by the sign of the rate."""
        if self.coulomb.any() and not self.speed:
            return self.passive(q, v) - self.coulomb * np.sign(v)
        if self.plain and not self.coulomb.any():
            return self.passive(q, v)
        return np.array(self._applied({"t": [t], "q": q, "v": v, "p": []}), dtype=float)

    def passive(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return -self.k * (q - self.rest) - self.c * v

    def gaps(self, states: np.ndarray) -> np.ndarray:
        """Return how far the ends of the loops are apart in each state (T,) [m]."""
        model, found = self.model, np.zeros(len(states))
        for k, state in enumerate(states):
            pose = poses(model, transforms(model, state[: model.nq]))

            def place(frame: Any, pose: Any = pose) -> np.ndarray:
                p = frame.p if frame.body < 0 else pose[frame.body].point(frame.p)
                return np.asarray(p, dtype=float)

            found[k] = max(
                np.linalg.norm(place(loop.first) - place(loop.second)) for loop in self.model.loops
            )
        return found


STIFFENING: dict[str, Callable[[float], tuple[list[float], ...]]] = {
    "governor": lambda t: ([0.0, 10.0**t], [0.0, 0.5], [0.2, 0.1 * 10.0**t], [1.6, 0.0])
}
