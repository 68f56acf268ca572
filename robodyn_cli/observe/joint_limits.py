"""The limits of joints and where a sampled motion passes them; names and units of the columns of joint quantities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.model.model import TORQUE, Model
from robodyn_cli.record import record
from robodyn_cli.results.catalogue import JOINT_LIMITS
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from robodyn_cli.forces.limits import Limits
    from robodyn_cli.trajectories.motion import JointMotion

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
    found = []
    for joint in scene.robot.joints:
        for key, limits in joint.forces:
            kind, _, coordinate = key.partition(".")
            name = f"{joint.name}.{coordinate}" if coordinate else joint.name
            if kind == "limits" and name in model.q_names:
                place, velocity = model.q_names.index(name), model.v_names.index(name)
                found.append(LimitedJoint(name, limits, place, velocity, model.q_units[place]))
    return found


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

    def sentence(self, joint: str) -> str:
        """Return what is passed, from when, and by how much."""
        beyond = self.over > ROUNDING * max(1.0, abs(self.limit))
        first, worst = int(np.argmax(beyond)), int(np.argmax(self.over))
        return (
            f"joint {joint!r} is beyond its {self.name} limit of {self.limit:.6g} {self.unit} from "
            f"t = {self.times[first]:.6g} s; {self.values[worst]:.6g} {self.unit} at t = {self.times[worst]:.6g} s"
        )


def warnings_at_rest(joints: Sequence[LimitedJoint], q: Array, tau: Array) -> list[str]:
    """Return a warning for each limit of position and effort that a balance is beyond; ``q`` (nq,), ``tau`` (nv,)."""
    now, found = np.zeros(1), []
    for joint in joints:
        bounds = [*position_bounds(joint, now, q[None]), *rate_bounds(joint, now, {"tau": tau[None]})]
        found += [
            f"joint {joint.name!r} at rest is beyond its {bound.name} limit of {bound.limit:.6g} {bound.unit}: "
            f"{bound.values[0]:.6g} {bound.unit}"
            for bound in bounds
            if bound.passed
        ]
    return found


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
    if "qdd" in columns:
        columns["jerk"] = np.diff(columns["qdd"]) / np.diff(times)
    for name, column, what in (
        ("speed", "qd", f"{unit}/s"),
        ("acceleration", "qdd", f"{unit}/s^2"),
        ("jerk", "jerk", f"{unit}/s^3"),
        ("effort", "tau", TORQUE[unit]),
    ):
        limit = getattr(joint.limits, name)
        if limit is not None and column in columns:
            values = columns[column]
            yield Bound(name, limit, values, np.abs(values) - limit, what, times)


def limit_warnings(
    joints: Sequence[LimitedJoint], times: Array, rates: Mapping[str, Array], q: Array | None = None
) -> list[str]:
    """Return a warning for each limit that a motion passes at its samples, with joint and time.

    Parameters
    ----------
    times : (T,). rates : see ``rate_bounds``. q : positions (T, nq), where they are to be looked at.
    """
    found = []
    for joint in joints:
        for bound in position_bounds(joint, times, q) if q is not None else ():
            if bound.passed:
                found.append(bound.sentence(joint.name) + _stop(joint.limits))
        found += [b.sentence(joint.name) for b in rate_bounds(joint, times, rates) if b.passed]
    return found


def _stop(limits: Limits) -> str:
    """Return what becomes of stops along a given motion."""
    if not limits.acts:
        return ""
    return "; its rigid stop is ignored" if limits.rigid else "; the torques press on its stop"


def unit_text(units: Sequence[str]) -> str:
    """Return one text for the units of all columns: ``rad/s``, ``m/s`` or ``rad/s or m/s``."""
    return " or ".join(dict.fromkeys(units)) or "rad"


@record
class JointColumns:
    """Units and names of an array (T, nq) or (T, nv) of joint quantities (see ``Result.add``)."""

    names: tuple[str, ...]
    column_units: tuple[str, ...]
    dims: tuple[str, ...]

    @property
    def units(self) -> str:
        """One text for all columns."""
        return unit_text(self.column_units)

    def described(self) -> dict[str, Any]:
        """Return the arguments of ``Result.add``."""
        mixed = len(set(self.column_units)) > 1
        units = {"column_units": self.column_units} if mixed else {}
        return {"units": self.units, "names": self.names, "dims": self.dims, **units}


def joint_columns(model: Model) -> dict[str, JointColumns]:
    """Return the columns of ``q``, ``qd``, ``qdd`` and ``tau``."""
    rates = ("time", "joint")
    # quaternions have other columns than their rates
    positions = rates if model.q_names == model.v_names else ("time", "position")
    return {
        "q": JointColumns(model.q_names, model.q_units, positions),
        "qd": JointColumns(model.v_names, tuple(f"{u}/s" for u in model.v_units), rates),
        "qdd": JointColumns(model.v_names, tuple(f"{u}/s^2" for u in model.v_units), rates),
        "tau": JointColumns(model.v_names, tuple(TORQUE[u] for u in model.v_units), rates),
    }


def add_joint_limits(result: Result, scene: Scene, model: Model) -> None:
    """Add the limits of the joints that have some: a column for each joint with such a limit."""
    if not scene.robot.limited:
        return

    joints, columns = limited_joints(scene, model), joint_columns(model)
    for path, limited in JOINT_LIMITS.items():
        units = dict(zip(columns[path].names, columns[path].column_units))
        for name in limited:
            limits = {joint.name: getattr(joint.limits, name) for joint in joints if joint.name in units}
            limits = {joint: value for joint, value in limits.items() if value is not None}
            if limits:
                shown = JointColumns(
                    tuple(limits), tuple(units[joint] for joint in limits), (f"{name}_limit",)
                )
                result.add(f"joint_limits/{name}", list(limits.values()), **shown.described())


def add_motion(result: Result, model: Model, times: NDArray[np.float64], motion: JointMotion) -> None:
    """Add times (T,) and the motion of the joints to a result."""
    columns = joint_columns(model)
    result.add("time", times)
    for path, data in (("q", motion.q), ("qd", motion.qd), ("qdd", motion.qdd)):
        result.add(path, data, **columns[path].described())
