"""What a trajectory yields: joint motion, or the motion asked of a point.

A trajectory is one of two kinds, told apart by the method that it has: ``motion`` in joint space, ``target``
in task space (``solve`` finds the joints then). Each has a ``duration``, times run from 0 to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


@record
class JointMotion:
    """Positions, rates and accelerations of the joints at T times, columns in the order of the joints asked.

    q : (T, nq) [rad or m]. qd : (T, nv) [rad/s or m/s]. qdd : (T, nv) [rad/s^2 or m/s^2].
    All in column order, which compiled kernels read in place.
    """

    q: Array
    qd: Array
    qdd: Array


@record
class PointMotion:
    """Position [m], velocity [m/s] and acceleration [m/s^2] asked of a point at T times, world coordinates.

    p, pd, pdd : (T, 3), or (T, 2) where only x and y are asked for and z is left free.
    """

    p: Array
    pd: Array
    pdd: Array


@runtime_checkable
class JointSpace(Protocol):
    """A trajectory that gives the joints' motion itself."""

    @property
    def duration(self) -> float: ...

    @property
    def joints(self) -> tuple[str, ...]: ...

    def motion(self, times: Array, joints: Sequence[str], parameters: Mapping[str, float]) -> JointMotion:
        """Return the motion of ``joints``, columns of q, at ``times`` (T,); ``parameters`` are those of the scene."""
        ...


@runtime_checkable
class TaskSpace(Protocol):
    """A trajectory that says where a named point should be."""

    @property
    def duration(self) -> float: ...

    @property
    def point(self) -> str: ...

    @property
    def ik(self) -> Any: ...

    def target(self, times: Array, parameters: Mapping[str, float]) -> PointMotion:
        """Return what is asked of the point at ``times`` (T,); ``parameters`` are those of the scene."""
        ...


def column_order(columns: Sequence[Any], samples: int) -> Array:
    """Return columns (arrays of T samples, or numbers held over all of them) as an array (T, n)."""
    out = np.empty((samples, len(columns)), order="F")
    for k, column in enumerate(columns):
        out[:, k] = column
    return out
