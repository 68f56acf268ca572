"""The summary of ``deploy``: its keys, beside those of every integrated motion."""

from __future__ import annotations

from robodyn_cli.integrators.runtime.options import Counters
from robodyn_cli.motion.second_run import ErrorEstimate
from robodyn_cli.record import record
from robodyn_cli.results.summary import ABSENT, Absent, Residual


@record
class Criteria:
    """When each criterion fired [s]; ``grid`` is the interval at which the multipliers are judged [s].

    latch : when the latch came to its position, for that criterion.
    """

    chosen: str
    dead_point: float | None
    multipliers: float | None
    growth_times: dict[str, float | None]
    limit_time: float | None
    grid: float
    latch: float | Absent | None = ABSENT


@record
class Growth:
    """Growth of the multipliers over their running median; times by level [s]."""

    largest_ratio: float
    times: dict[str, float | None]
    median_grid: float


@record
class MultiplierKeys:
    """Norm of the loops' multipliers along the run, and their rows."""

    start: float
    at_lock: float
    largest_until_lock: float
    rows: list[str]
    diverge: bool


@record
class SingularValues:
    """Of Psi and of its passive block at the lock, largest first."""

    psi: list[float]
    passive: list[float]


@record
class LatchKeys:
    """Rates before and after the latch has closed, impulses [N s, N m s] and the energy that it cost [J]."""

    rates_before: dict[str, float]
    rates_after: dict[str, float]
    impulse: dict[str, float]
    angular_impulse: float
    angular_impulse_vector: list[float]
    linear_impulse: float
    energy_lost: float


@record
class LockKeys:
    """Keys of ``summary.lock``; those of multipliers are None in an open chain."""

    time: float
    time_error: float | None
    time_error_method: str
    angles: dict[str, float]
    angles_deg: dict[str, float]
    rates: dict[str, float] | None
    kind: str
    joint: str | None
    loop: str | None
    criterion: str
    driven: bool
    multiplier_growth: Growth | None
    growth_times: dict[str, float | None]
    multipliers: MultiplierKeys | None
    singular_values: SingularValues | None
    latch: LatchKeys | Absent | None = ABSENT
    latch_note: str | Absent = ABSENT


@record
class LatchLoad:
    """Largest force [N] and moment [N m] in the latch, when [s], and those at the end."""

    peak_force: float
    peak_force_time: float
    force_at_end: float
    peak_moment: float
    peak_moment_time: float
    moment_at_end: float


@record
class AfterLock:
    """Keys of ``summary.after_lock``: the motion of the locked structure up to ``until`` [s]."""

    degrees_of_freedom: int
    rows: list[str]
    closure: str
    samples: int
    until: float
    error_estimate: ErrorEstimate | Absent | None = ABSENT
    energy_drift: float | Absent = ABSENT
    constraint_residual: Residual | Absent = ABSENT
    latch: LatchLoad | Absent = ABSENT
    largest: dict[str, dict[str, float]] | Absent = ABSENT
    counters: Counters | Absent = ABSENT


@record
class Overload:
    """The first sample at which a joint or closure bore more than it may; value, largest and limit in N or N m."""

    name: str
    quantity: str
    limit: float
    time: float
    value: float
    largest: float


@record
class DeploySummary:
    """Keys of the summary of ``deploy``, beside those of every integrated motion."""

    criteria: Criteria
    lock: LockKeys | None
    after_lock: AfterLock | Absent | None
    overload: Overload | Absent | None
