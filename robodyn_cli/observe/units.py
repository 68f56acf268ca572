"""Names and units of the columns of joint quantities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.model.model import TORQUE, Model
from robodyn_cli.record import record
from robodyn_cli.results.catalogue import JOINT_LIMITS
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene

if TYPE_CHECKING:
    from robodyn_cli.equations.latches import LatchRow
    from robodyn_cli.forces.limits import Limits
    from robodyn_cli.trajectories.motion import JointMotion


def unit_text(units: Sequence[str]) -> str:
    """Return one text for the units of all columns: ``rad/s``, ``m/s`` or ``rad/s or m/s``."""
    return " or ".join(dict.fromkeys(units)) or "1"


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


def load_columns(model: Model, latches: Sequence[LatchRow]) -> JointColumns:
    """Return the columns of the loads of latches."""
    units = tuple(latch.load_unit(model) for latch in latches)
    return JointColumns(tuple(latch.name for latch in latches), units, ("time", "latch"))


def add_joint_limits(result: Result, scene: Scene, model: Model) -> None:
    """Add the limits of the joints that have some: a column for each joint with such a limit."""
    if not scene.robot.limited:
        return
    from robodyn_cli.observe.joint_limits import limited_joints

    joints, columns = limited_joints(scene, model), joint_columns(model)
    for path, limited in JOINT_LIMITS.items():
        units = dict(zip(columns[path].names, columns[path].column_units))
        for name in limited:
            limits = {joint.name: _stored(joint.limits, name) for joint in joints if joint.name in units}
            limits = {joint: value for joint, value in limits.items() if value is not None}
            if limits:
                shown = JointColumns(
                    tuple(limits), tuple(units[joint] for joint in limits), (f"{name}_limit",)
                )
                result.add(f"joint_limits/{name}", list(limits.values()), **shown.described())


def _stored(limits: Limits, name: str) -> float | None:
    """Return a limit by its name in a result: one for both directions, or the ``least_`` or ``largest_`` one."""
    side, _, kind = name.rpartition("_")
    limit = getattr(limits, kind)
    if isinstance(limit, tuple) != bool(side):
        return None
    return limit if not side else limit[0 if side == "least" else 1]


def add_motion(result: Result, model: Model, times: NDArray[np.float64], motion: JointMotion) -> None:
    """Add times (T,) and the motion of the joints to a result."""
    columns = joint_columns(model)
    result.add("time", times)
    for path, data in (("q", motion.q), ("qd", motion.qd), ("qdd", motion.qdd)):
        result.add(path, data, **columns[path].described())
