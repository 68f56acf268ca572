"""The limits of joints, and where a sampled motion passes them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from robodyn_cli.model.model import TORQUE, Model
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.spans import sides
from robodyn_cli.solve.extremes import largest
from robodyn_cli.solve.quadrature import Breaks, gaps_between
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from robodyn_cli.forces.limits import Limits

# a motion that stays on a limit passes it by rounding
ROUNDING = 1e-9


@record
class LimitedJoint:
    """A joint that moves, or a coordinate of one, and its limits.

    place : of its coordinate in q. velocity : in v. unit : of q.
    """

    name: str
    limits: Limits
    place: int
    velocity: int
    unit: str


def limited_joints(scene: Scene, model: Model) -> list[LimitedJoint]:
    """Return the joints with limits in the order of the scene."""
    limited = []
    for joint in scene.robot.joints:
        for key, limits in joint.forces:
            kind, _, coordinate = key.partition(".")
            name = f"{joint.name}.{coordinate}" if coordinate else joint.name
            if kind == "limits" and name in model.q_names:
                place, velocity = model.q_names.index(name), model.v_names.index(name)
                limited.append(LimitedJoint(name, limits, place, velocity, model.q_units[place]))
    return limited


@record
class Bound:
    """One limit: ``over`` (T,) is positive where the motion is beyond it, and ``values`` (T,) are what is limited."""

    name: str
    limit: float
    values: Array
    over: Array
    unit: str
    times: Array

    @property
    def passed(self) -> bool:
        """Whether the motion is beyond it at any sample, by more than rounding."""
        return bool(self.over.size) and bool(self.over.max() > ROUNDING * max(1.0, abs(self.limit)))

    def sentence(self, joint: str, breaks: Breaks) -> str:
        """Return what is passed, from when, and by how much: the peak between samples that figures state."""
        beyond = self.over > ROUNDING * max(1.0, abs(self.limit))
        first, worst = int(np.argmax(beyond)), int(np.argmax(self.over))
        value, time = float(self.values[worst]), float(self.times[worst])
        if len(self.values) == len(self.times):
            symmetric = self.over[worst] == abs(value) - self.limit
            sign = -1.0 if value < (0.0 if symmetric else self.limit) else 1.0
            peak = largest(self.times, sign * self.values[:, None], breaks)
            value, time = sign * float(peak.value[0]), float(peak.time[0])
        return (
            f"joint {joint!r} is beyond its {self.name} limit of {self.limit:.6g} {self.unit} from "
            f"t = {self.times[first]:.6g} s; {value:.6g} {self.unit} at t = {time:.6g} s"
        )


def bounds_at_rest(scene: Scene, model: Model) -> dict[int, tuple[float, float]]:
    """Return the limits of joints that are no stops, by their places in q; infinite where there is none."""
    joints = [one for one in limited_joints(scene, model) if not one.limits.acts]
    bounds = ((one.place, one.limits.lower, one.limits.upper) for one in joints)
    return {k: (-np.inf if low is None else low, np.inf if high is None else high) for k, low, high in bounds}


def warnings_at_rest(joints: Sequence[LimitedJoint], q: Array, tau: Array) -> list[str]:
    """Return a warning for each limit of position and effort that a balance is beyond; ``q`` (nq,), ``tau`` (nv,)."""
    now, texts = np.zeros(1), []
    for joint in joints:
        bounds = [*position_bounds(joint, now, q[None]), *rate_bounds(joint, now, {"tau": tau[None]})]
        texts += [
            f"joint {joint.name!r} at rest is beyond its {bound.name} limit of {bound.limit:.6g} {bound.unit}: "
            f"{bound.values[0]:.6g} {bound.unit}"
            for bound in bounds
            if bound.passed
        ]
    return texts


def position_bounds(joint: LimitedJoint, times: Array, q: Array) -> Iterator[Bound]:
    """Yield the limits of position; ``q`` (T, nq)."""
    x, limits = q[:, joint.place], joint.limits
    if limits.lower is not None:
        yield Bound("lower", limits.lower, x, limits.lower - x, joint.unit, times)
    if limits.upper is not None:
        yield Bound("upper", limits.upper, x, x - limits.upper, joint.unit, times)


def rate_bounds(joint: LimitedJoint, times: Array, rates: Mapping[str, Array]) -> Iterator[Bound]:
    """Yield the limits of speed, acceleration, jerk and effort, as far as ``rates`` has them: ``qd``, ``qdd`` and
    ``tau`` (T, nv).

    The jerk between two samples is the mean: somewhere between them it is as large, or larger.
    """
    unit = joint.unit
    columns = {name: values[:, joint.velocity] for name, values in rates.items()}
    # between both sides of a jump there is no mean
    own = np.delete(np.arange(len(times)), gaps_between(times))
    if "qdd" in columns:
        columns["jerk"] = np.diff(columns["qdd"][own]) / np.diff(times[own])
    for name, column, limit_unit in (
        ("speed", "qd", f"{unit}/s"),
        ("acceleration", "qdd", f"{unit}/s^2"),
        ("jerk", "jerk", f"{unit}/s^3"),
        ("effort", "tau", TORQUE[unit]),
    ):
        limit = getattr(joint.limits, name)
        if limit is None or column not in columns:
            continue
        values = columns[column]
        at = times[own] if name == "jerk" else times
        if isinstance(limit, tuple):
            low, high = sides(limit)
            yield Bound(name, low, values, low - values, limit_unit, at)
            yield Bound(name, high, values, values - high, limit_unit, at)
        else:
            yield Bound(name, limit, values, np.abs(values) - limit, limit_unit, at)


def limit_warnings(
    joints: Sequence[LimitedJoint],
    times: Array,
    rates: Mapping[str, Array],
    q: Array | None = None,
    breaks: Breaks = (),
) -> list[str]:
    """Return a warning for each limit that a motion passes at its samples, with joint and time.

    Parameters
    ----------
    times : (T,). rates : see ``rate_bounds``. q : positions (T, nq), where they are to be looked at. breaks : see
        ``quadrature``.
    """
    texts = []
    for joint in joints:
        for bound in position_bounds(joint, times, q) if q is not None else ():
            if bound.passed:
                texts.append(bound.sentence(joint.name, breaks) + _stop(joint.limits))
        texts += [b.sentence(joint.name, breaks) for b in rate_bounds(joint, times, rates) if b.passed]
    return texts


def _stop(limits: Limits) -> str:
    """Return what becomes of stops along a given motion."""
    if not limits.acts:
        return ""
    return "; its rigid stop is ignored" if limits.rigid else "; the torques press on its stop"
