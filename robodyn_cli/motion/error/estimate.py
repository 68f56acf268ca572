"""Errors of motions from the differences of two integrations, and what rounding is expected to leave of them.

Arrays have a leading axis of runs, which is of length 1 for a run alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.motion.error.attempts import First
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from robodyn_cli.motion.error.conditioning import Conditioning

    ConditioningOf = Callable[[int], Conditioning]

NEAR_ROUNDING = 1e3  # times the rounding of the state: below it what rounds the accelerations is looked at
HALF_UNIT = 1.1e-16
TIME_ROUNDING = 1e-14  # part of the time of an event that rounding leaves over the steps of a run


def remainder(first: First, more: Any) -> Array:
    """Return 1 / (1 - (n_1 / n_2)^p), at most 2 (N,): what the second run's own error hides of the first one's.

    more : n_2, the steps of the second runs (N,).
    """
    kind = methods[first.method]
    # between steps the dense output decides
    power = min(kind.order, kind.dense_order + 1)
    left = np.minimum(1.0, first.steps / np.maximum(more, 1)) ** power
    found: Array = 1.0 / (1.0 - np.minimum(left, 0.5))
    return found


@record
class Courses:
    """States (N, T, nx) of both integrations at the start, the samples that are judged, and the end; their ``scale``
    (N,), see ``remainder``."""

    system: System
    first: Array
    second: Array
    scale: Array

    @property
    def errors(self) -> Array:
        """Estimated errors of the first (N, T, nx)."""
        found: Array = self.scale[:, None, None] * np.abs(self.second - self.first)
        return found

    def at_end(self, floor: Floor) -> Array:
        """Return the errors at the end (N, nx), no less than the floor.

        There the errors of both may agree by chance. So they are no less than what the second run's own error, a part
        1 - 1/scale of the first one's (see ``remainder``), typically is over the second half of the samples.
        """
        errors = self.errors
        found: Array = errors[:, -1].copy()
        for places, least in ((self.system.q_places, floor.q), (self.system.v_places, floor.qd)):
            largest = errors[:, errors.shape[1] // 2 :, list(places)].max(axis=2, initial=0.0)
            typical = (1.0 - 1.0 / self.scale) * np.median(largest, axis=1)
            found[:, list(places)] = np.maximum(found[:, list(places)], np.maximum(typical, least)[:, None])
        return found

    def floor(
        self, steps: Any, lasted: Any, conditioning: Callable[[int], Conditioning], watched: float = 0.0
    ) -> Floor:
        """Return what rounding is expected to leave.

        Parameters
        ----------
        steps : of the first integrations (N,), which lasted so long (N,) [s]. conditioning : that of a run, by number;
            the first one that it counts for is asked. watched : what others say that rounding leaves.
        """
        largest, part = (
            np.abs(self.first).max(axis=1, initial=0.0),
            HALF_UNIT * np.sqrt(np.maximum(1.0, steps)),
        )
        both = list(self.system.q_places), list(self.system.v_places)
        q, qd = (np.maximum(part * largest[:, places].max(axis=1, initial=0.0), watched) for places in both)
        errors = self.errors[:, :, [*both[0], *both[1]]].max(axis=(1, 2), initial=0.0)
        near = errors <= NEAR_ROUNDING * np.maximum(q, qd)
        if not near.any():
            return Floor(q, qd)
        off_q, off_qd = conditioning(int(np.argmax(near))).leaves(lasted)
        return Floor(np.where(near, np.maximum(q, off_q), q), np.where(near, np.maximum(qd, off_qd), qd))


@record
class Floor:
    """Errors that rounding alone is expected to leave, of positions and of rates (N,).

    The state's own rounding grows as sqrt(steps). Where errors are not far above that, what constants and the
    conditioning of the equations do counts too (see ``Conditioning``). Both runs share some of it, so that their
    difference hides it.
    """

    q: Array
    qd: Array


def time_errors(first: First, apart: Any, more: Any, times: Any) -> Array:
    """Return the errors of the times (N,) [s] of events, which second runs with so many steps put ``apart``.

    An agreement below what rounding leaves over the steps of a run says nothing.
    """
    found: Array = np.maximum(remainder(first, more) * apart, TIME_ROUNDING * times)
    return found
