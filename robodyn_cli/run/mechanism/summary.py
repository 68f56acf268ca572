"""The keys of the summaries of ``assemble``, ``kinematics`` and ``statics`` (see docs/cli.md)."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.results.summary import ABSENT, Absent


@record
class Termination:
    """Why a run ended, and when [s]."""

    reason: str
    time: float


@record
class Residual:
    """Largest residuals of the loops, at position level and below where they are known."""

    position: float
    velocity: float | Absent = ABSENT
    acceleration: float | Absent = ABSENT
