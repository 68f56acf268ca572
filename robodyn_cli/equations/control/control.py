"""A controller in the equations of a mechanism: continuous, or sampled with its torques held in between.

Its states are further states z of the system, before the work. Those of a continuous controller have rates. All of a
sampled one (states of the law, held torques, torques on their way, the last measurement) are constant between the
samples, and an update gives all of them anew:

    phase 0, at n T:          measure -> law -> limits -> new states; the torques go into the delay line
                              what sensors give is kept up to the next sample, for results and for differences
    phase 1, at n T + rest:   the oldest of them act, where the delay is no multiple of the period T
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.control.design import ControlDesign, Leading
from robodyn_cli.equations.control.model import ControlledEquations, Reference, reference_of, tracked_joints
from robodyn_cli.equations.control.situation import At, Measured
from robodyn_cli.equations.discontinuities import switches
from robodyn_cli.expr.functions import maximum, minimum, nearest
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.rebuild import evaluate, renamed
from robodyn_cli.model.model import TORQUE
from robodyn_cli.record import record
from robodyn_cli.schema.spans import sides
from robodyn_cli.spatial.algebra import Array, Vector, zeros

STATES = "z"
NOISE, ASKED = (
    "noise",
    "asked",
)  # inputs of updates: standard normal numbers, and what a function in Python gave
MEASURED, MEASURED_RATES = "measured", "measured_rates"  # groups of states: what sensors have given last
SHORT = 1e-9  # of a period: a delay that differs by less is a multiple of it


@record
class Law:
    """What a law gives in one situation: torques asked for and left by the limits (n,), new states or their rates."""

    asked: list[Any]
    given: list[Any]
    states: list[Any]


@record
class Tracked:
    """A coordinate that follows the reference: its name and unit, what is wanted and what it is, without sensors."""

    name: str
    unit: str
    wanted: Any
    actual: Any


class Control:
    """The controller of a scene.

    Parameters
    ----------
    problem : the equations of the mechanism, whose symbols t, q, v the law is built on.
    """

    def __init__(self, problem: ControlledEquations) -> None:
        self.problem, self.controller = problem, problem.scene.control
        self.joints: tuple[str, ...] = self.controller.joints
        model = problem.model
        self.places = [model.v_names.index(name) for name in self.joints]
        self.units = tuple(TORQUE[model.v_units[k]] for k in self.places)
        self.period: float | None = self.controller.period
        self.function = self.controller.call
        own = self.controller.states(self.joints)
        self.own = tuple(name for name, _ in own)
        self._starts = [float(x) for _, x in own]
        self.whole, self.rest = self._delay()
        self.names = (*self.own, *self._held_names())
        self.z: list[Expr] = problem.graph.symbols([f"control.{name}" for name in self.names], STATES)

    def _delay(self) -> tuple[int, float]:
        """Return the delay as whole periods and the rest [s]."""
        if self.period is None:
            return 0, 0.0
        delay = float(self.controller.delay)
        period = float(self.period)
        whole = math.floor(delay / period + SHORT)
        rest = delay - whole * period
        return whole, rest if rest > SHORT * period else 0.0

    def _held_names(self) -> list[str]:
        """Return the names of the states that only a sampled controller has."""
        if self.period is None:
            return []
        names = [f"held.{name}" for name in self.joints]
        if not self.controller.sensors.exact:
            names += [f"{MEASURED}.{name}" for name in self.problem.model.q_names]
            names += [f"{MEASURED_RATES}.{name}" for name in self.problem.model.v_names]
        if self.rest:
            names += [f"waiting.{name}" for name in self.joints]
        return names + [f"delayed{k + 1}.{name}" for k in range(self.whole) for name in self.joints]

    def group(self, name: str) -> list[Expr]:
        """Return the states called ``name.JOINT``."""
        return [
            z for z, own in zip(self.z, self.names) if own.partition(".")[0] == name and own not in self.own
        ]

    # -- what acts ------------------------------------------------------------------------------------
    @cached_property
    def torques(self) -> list[Any]:
        """Torques on the driven joints (n,)."""
        return self._law.given if self.period is None else list(self.group("held"))

    def on_joints(self) -> Vector:
        """Return the torques on all joints (nv,)."""
        tau = zeros(self.problem.model.nv)
        for place, torque in zip(self.places, self.torques):
            tau[place] = torque
        return tau

    @property
    def rates(self) -> list[Any]:
        """Rates of the states: zero where they are constant between samples."""
        return self._law.states if self.period is None else [0.0] * len(self.z)

    # -- the law --------------------------------------------------------------------------------------
    @cached_property
    def reference(self) -> Reference:
        return reference_of(self.problem.scene, self._starting)

    @property
    def _starting(self) -> dict[str, float]:
        """Positions by column that are held without a motion to follow, as far as the scene gives them."""
        return {**self.problem.scene.initial.q, **self.controller.pose}

    @cached_property
    def tracked(self) -> list[Tracked]:
        """What follows the reference: joints, the driven ones first, or the point that it leads; nothing where it leads
        none."""
        at, model = self.exact, self.problem.model
        if self.controller.at_point:
            task = at.point()
            names = [f"{self.controller.reference.point}.{axis}" for axis in "xyz"]
            return [Tracked(name, "m", *pair) for name, *pair in zip(names, task.wanted, task.p)]
        if not self.reference.known:
            return []
        places = {name: k for k, name in enumerate(model.q_names)}
        joints = tracked_joints(self.reference, self.controller.pose, model)
        wanted = self.reference.positions(joints, self.problem.t, self.problem.environment)
        return [
            Tracked(name, model.q_units[places[name]], r, self.problem.q[places[name]])
            for name, r in zip(joints, wanted)
        ]

    @cached_property
    def design(self) -> ControlDesign | None:
        """What the controller is, as far as its kind has gains."""
        at_point = self.controller.at_point
        names = tuple(x.name for x in self.tracked) if at_point else self.joints
        units = (
            tuple(x.unit for x in self.tracked)
            if at_point
            else tuple(self.problem.model.v_units[k] for k in self.places)
        )
        loads = ("N",) * len(names) if at_point else self.units
        found: ControlDesign | None = self.controller.written(Leading(names, units, loads))
        return found

    def situation(self, seen: Measured) -> At:
        """Return what the law sees, with measured positions and rates."""
        return At(self.problem, seen, self.reference, dict(zip(self.own, self.z)))

    @cached_property
    def exact(self) -> At:
        """The situation without sensors."""
        return self.situation(Measured(list(self.problem.q), list(self.problem.v)))

    @cached_property
    def _law(self) -> Law:
        if self.period is None:
            at = self.exact
            asked = self.controller.torques(at)
            given = self._limited(asked)
            return Law(asked, given, self.controller.rates(at, asked, given))
        at = self.situation(self.measured)
        asked = self.controller.torques(at)
        given = self._limited(asked)
        if self.controller.rate_limit:
            given = self._limited_rate(given)
        return Law(asked, given, self.controller.updated(at, asked, given, self.period))

    @cached_property
    def limits(self) -> list[tuple[float, float] | None]:
        """What the law's torques are cut to: ``bounds``."""
        return self.bounds

    @property
    def bounds(self) -> list[tuple[float, float] | None]:
        """Least and largest torque of each driven joint, None where there is no limit."""
        robot, efforts = self.problem.scene.robot, []
        for name in self.joints:
            own = _of_joint(self.controller.limit, name)
            if own is None:
                limits = robot.limits_of(name)
                own = None if limits is None else limits.effort
            efforts.append(None if own is None else sides(own))
        return efforts

    def _limited(self, asked: Sequence[Any]) -> list[Any]:
        return [
            x if most is None else minimum(maximum(x, most[0]), most[1])
            for x, most in zip(asked, self.limits)
        ]

    def _limited_rate(self, wanted: Sequence[Any]) -> list[Any]:
        """Return the torques after those of the last sample, which no more than ``rate_limit`` lies between."""
        assert self.period is not None
        last = self.group("delayed1") or self.group("waiting") or self.group("held")
        torques = []
        for name, x, before in zip(self.joints, wanted, last):
            rate = _of_joint(self.controller.rate_limit, name)
            step = None if rate is None else rate * self.period
            torques.append(x if step is None else minimum(maximum(x, before - step), before + step))
        return torques

    # -- sensors --------------------------------------------------------------------------------------
    @cached_property
    def measured(self) -> Measured:
        """Positions and rates of all joints as a sampled controller sees them."""
        p, sensors, period = self.problem, self.controller.sensors, self.period
        q: list[Any] = list(p.q)
        v: list[Any] = list(p.v)
        for k, name in enumerate(p.model.v_names):
            if name not in p.model.q_names:
                continue  # an attitude
            place = p.model.q_names.index(name)
            q[place] = self._sensed(p.q[place], name, k)
            noise = _of_joint(sensors.rate_noise, name)
            if sensors.rates == "differences" and period is not None:
                v[k] = (q[place] - self.group(MEASURED)[place]) / period
            elif noise:
                v[k] = p.v[k] + noise * self._noise(p.model.nv + k)
        return Measured(q, v)

    def _sensed(self, q: Scalar, name: str, channel: int) -> Any:
        sensors = self.controller.sensors
        noise, step = _of_joint(sensors.noise, name), _of_joint(sensors.resolution, name)
        if noise:
            q = q + noise * self._noise(channel)
        return q if step is None else step * nearest(q / step)

    def _noise(self, channel: int) -> Expr:
        return self.problem.graph.symbol(f"noise.{channel}", NOISE, channel)

    @property
    def channels(self) -> int:
        """How many random numbers a sample takes."""
        return 2 * self.problem.model.nv if self.controller.sensors.noisy else 0

    # -- updates --------------------------------------------------------------------------------------
    @cached_property
    def phases(self) -> list[list[Any]]:
        """The states (nc,) after each phase of a period."""
        law = self._law
        new: dict[str, Sequence[Any]] = {}
        if self.whole:
            line = [law.given, *(self.group(f"delayed{k + 1}") for k in range(self.whole))]
            new |= {f"delayed{k + 1}": line[k] for k in range(self.whole)}
            due = line[-1]
        else:
            due = law.given
        new["waiting" if self.rest else "held"] = due
        if not self.controller.sensors.exact:
            new |= {MEASURED: self.measured.q, MEASURED_RATES: self.measured.v}
        first = [*law.states, *self._replaced(new)]
        if not self.rest:
            return [first]
        return [first, [*self.z[: len(self.own)], *self._replaced({"held": self.group("waiting")})]]

    def _replaced(self, new: dict[str, Sequence[Any]]) -> list[Any]:
        """Return the states behind those of the law, some groups of which are new."""
        states: list[Any] = []
        groups = dict.fromkeys(name.partition(".")[0] for name in self.names[len(self.own) :])
        for name in groups:
            states += new.get(name, self.group(name))
        return states

    def start(self, q: Array, v: Array, p: Array, noise: Array) -> Array:
        """Return the states (nc,) at t = 0, where the joints are at q (nq,) and v (nv,); sampled ones after an update.

        p : parameters of the equations. noise : random numbers of the first sample.
        """
        z = self.before_start(q, v, p, noise)
        if self.period is None:
            return z
        inputs = self._inputs(q, v, z, p, noise)
        if self.function is not None:
            if hasattr(self.controller.function, "reset"):
                self.controller.function.reset()
            seen = [np.array(evaluate(x, inputs), dtype=float) for x in (self.measured.q, self.measured.v)]
            inputs[ASKED] = self.function(0.0, *seen)
        return np.array([float(x) for x in evaluate(self.phases[0], inputs)])

    @cached_property
    def begun(self) -> list[Any]:
        """The states (nc,) at t = 0 as expressions of q, v, parameters and noise: what ``start`` evaluates."""
        z: list[Any] = self.starts.tolist()
        for k, measured in zip(self.last, self.measured.q if self.last else ()):
            z[k] = measured
        if self.period is None:
            return z
        return renamed(self.phases[0], {STATES: dict(enumerate(z)), "t": {0: 0.0}})

    def before_start(self, q: Array, v: Array, p: Array, noise: Array) -> Array:
        """Return the states (nc,) before the first update at t = 0: what was measured last is what is there."""
        z = self.starts
        if self.last:
            z[self.last] = [float(x) for x in evaluate(self.measured.q, self._inputs(q, v, z, p, noise))]
        return z

    @property
    def starts(self) -> Array:
        """The states (nc,) before anything is measured."""
        return np.array([*self._starts, *([0.0] * (len(self.names) - len(self.own)))])

    @property
    def last(self) -> list[int]:
        """Numbers of the states that hold the last measurement of all positions, where the law keeps it."""
        if self.controller.sensors.rates != "differences":
            return []
        own = len(self.own)
        return [own + k for k, name in enumerate(self.names[own:]) if name.startswith(f"{MEASURED}.")]

    def _inputs(self, q: Array, v: Array, z: Array, p: Array, noise: Array) -> dict[str, Any]:
        p = np.pad(p, (0, 4 * len(v) + len(self.problem.model.parameters)))
        return {"t": [0.0], "q": q, "v": v, STATES: z, NOISE: noise, "p": p}

    # -- where steps have to end ----------------------------------------------------------------------
    @cached_property
    def switches(self) -> list[tuple[str, Expr]]:
        """Expressions at whose sign changes a continuous law bends: limits, formulas that switch."""
        if self.period is not None:
            return []
        bends = switches([*self._law.given, *self._law.states])
        return [(f"control {self.controller.type}", x) for x in bends]

    @cached_property
    def breakpoints(self) -> list[float]:
        """Times at which the reference of a continuous law is not smooth."""
        if self.period is not None:
            return []
        return self.reference.breakpoints(self.problem.t, self.problem.environment)


def _of_joint(value: Any, name: str) -> Any:
    return value.get(name) if isinstance(value, dict) else value
