"""Names and units of the columns of joint quantities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.model.model import Model
from robodyn_cli.record import record
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from robodyn_cli.trajectories.motion import JointMotion

TORQUE = {"rad": "N m", "m": "N"}


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


def add_motion(result: Result, model: Model, times: NDArray[np.float64], motion: JointMotion) -> None:
    """Add times (T,) and the motion of the joints to a result."""
    columns = joint_columns(model)
    result.add("time", times)
    for path, data in (("q", motion.q), ("qd", motion.qd), ("qdd", motion.qdd)):
        result.add(path, data, **columns[path].described())
