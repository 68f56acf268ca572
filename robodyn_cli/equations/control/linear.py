"""The law of a controller about a pose, as a linear one: without sensors, noise and limits, its delay apart.

    continuous:  s-dot = S x + Z s,  u = -K x - H s
    sampled:     s(k+1) = S x(k) + Z s(k),  u(k) = -K x(k) - H s(k)

x are the states of the plant in minimal coordinates, s those of the law, and of a sampled one that takes differences
for rates the positions of the sample before.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.control.base import Sensors
from robodyn_cli.equations.control.control import Control
from robodyn_cli.equations.control.model import ControlledEquations
from robodyn_cli.equations.control.rest import drifts, resting, situation
from robodyn_cli.equations.linear.reduce import Linear
from robodyn_cli.equations.linear.residuals import States, by_steps, by_symbols, evaluated
from robodyn_cli.expr.graph import Expr
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

STILL = 1e-8  # of the pose and of the states: what moves them so little leaves them at rest


@record
class LinearLaw:
    """K (n, 2f), H (n, s), S (s, 2f), Z (s, s), the names of the states s.

    torques : (n,) that are asked for at the pose itself, the law's states at rest there. restless : names of own states
    that do not rest there.
    """

    K: Array
    H: Array
    S: Array
    Z: Array
    names: tuple[str, ...]
    torques: Array
    restless: tuple[str, ...] = ()


class Unlimited(Control):
    """A controller whose torques have no limits."""

    @cached_property
    def limits(self) -> list[tuple[float, float] | None]:
        """No limit for any joint."""
        return [None] * len(self.joints)


class AtLimits(Control):
    """A controller some of whose torques are at a limit, where they stay whatever it asks for.

    stuck : the torque at the limit, by joint.
    """

    def __init__(self, problem: ControlledEquations, stuck: Mapping[str, float]) -> None:
        super().__init__(problem)
        self.stuck = stuck

    @cached_property
    def limits(self) -> list[tuple[float, float] | None]:
        """No limit but for those joints."""
        return [(self.stuck[name], self.stuck[name]) if name in self.stuck else None for name in self.joints]


def without_bounds(scene: Scene) -> Scene:
    """Return a scene whose controller sees all as it is, and gives what it asks for at once."""
    sensors = Sensors(rates=scene.control.sensors.rates)
    own = dataclasses.replace(scene.control, sensors=sensors, rate_limit=None)
    return dataclasses.replace(scene, control=own)


def linear_law(control: Control, states: States, linear: Linear, needed: Array) -> LinearLaw:
    """Return the law about a state, in the minimal coordinates of ``linear``, its own states where they rest.

    control : see ``without_bounds``. needed : torques (n,) of its joints that hold the pose.
    """
    problem, own = control.problem, len(control.own)
    kept = [*range(own), *control.last]
    symbols = [control.z[k] for k in kept]
    law = control._law
    after: list[Any] = list(law.states)
    if control.last:
        after += list(control.measured.q)
    outputs: dict[str, Any] = {"asked": law.asked, "drift": drifts(control)}
    for name, entries in (("u", law.given), ("s", after)):
        if entries:
            outputs |= {f"{name}_q": by_steps(problem, entries), f"{name}_v": by_symbols(entries, problem.v)}
            outputs[f"{name}_s"] = by_symbols(entries, symbols) if symbols else np.zeros((len(entries), 0))
    z = resting(control, states, needed, linear.dq[0][control.places])
    found = {name: x[0] for name, x in evaluated(outputs, situation(control, states, z)).items()}
    step = np.concatenate([linear.dq[0], np.zeros_like(linear.dq[0])], axis=1)

    def by_x(name: str) -> Array:
        whole: Array = found[f"{name}_q"] @ step + found[f"{name}_v"] @ linear.dv[0]
        return whole

    K, H = -by_x("u"), -found["u_s"]
    S = by_x("s") if after else np.zeros((0, K.shape[1]))
    Z = found["s_s"] if after else np.zeros((0, 0))
    names = [control.names[k] for k in kept]
    # the last measurement of joints whose rate the law does not ask for is no state of it, nor is what never changes
    used = [k for k, x in enumerate(drifts(control)) if isinstance(x, Expr)]
    used += [k for k in range(own, len(kept)) if H[:, k].any() or Z[:own, k].any()]
    by_s = Z[:own, :own] - (0.0 if control.period is None else np.eye(own))
    size = np.abs(S[:own]).sum(axis=1) + np.abs(by_s) @ np.maximum(1.0, np.abs(z[:own]))
    restless = tuple(name for name, x, most in zip(names, found["drift"], STILL * size) if not abs(x) <= most)
    return LinearLaw(
        K, H[:, used], S[used], Z[np.ix_(used, used)], tuple(names[k] for k in used), found["asked"], restless
    )
