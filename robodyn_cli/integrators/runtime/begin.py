"""What the memory of a run holds as it begins: of one run, and of many at once."""

from __future__ import annotations

import math
from typing import Any

from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot
from robodyn_cli.integrators.runtime.options import Options

SMALLEST_ATOL = 1e-300  # keeps weights finite where the tolerance is zero
FIRST = 1e-3  # first step of a run, as a part of the time to its end


def doubles_at_start(time: float, options: Options) -> dict[int, float]:
    """Return the slots of doubles that are not zero as a run begins."""
    return {
        DoubleSlot.T: time,
        DoubleSlot.RTOL: options.rtol,
        DoubleSlot.ATOL: max(options.atol, SMALLEST_ATOL),
        DoubleSlot.H_MAX: options.max_step,
        DoubleSlot.CONTRACTION: 1.0,
        DoubleSlot.LAST_ERROR: 1.0,
        DoubleSlot.T_AFTER: -math.inf,
        DoubleSlot.T_BEFORE: math.inf,
    }


def integers_at_start(velocities: int) -> dict[int, int]:
    """Return the slots of integers that are not zero as a run begins, without samples."""
    return {IntegerSlot.VELOCITIES: velocities, IntegerSlot.LAST_SAMPLE: -1}


def first_step(way: Any, options: Options) -> Any:
    """Return the first step of a run over times ``way`` [s]: numbers or arrays.

    It is well below any sensible step: growth is quick, and a first step that is far too long can look good where
    derivatives happen to vanish.
    """
    return FIRST * options.first * way
