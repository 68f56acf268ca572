"""The summary of ``deploy``, beside the keys of every integrated motion."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import (
    ABSENT,
    JOINT,
    LOOP,
    OWN,
    RATE,
    ROW,
    Absent,
    LoopResidual,
    PeakLoad,
    fact,
    same_as,
)
from robodyn_cli.summaries.motion import Counters, MotionErrors

FACTOR = "FACTOR"  # keys of a map: factors of growth, as text
NORM = "N and N m"  # of multipliers of rows of both kinds


@record
class CriterionErrors:
    """Errors of the times at which criteria fired; left out where none was asked for."""

    dead_point: float | Absent | None = fact("of the time of the dead point", "s", default=ABSENT)
    growth: float | Absent | None = fact(
        "of the times of multipliers, the interval at which they are judged included; `null` where a second, tighter "
        "scan does not have one of them",
        "s", default=ABSENT,
    )  # fmt: skip


GROWTH, GROWTH_TIMES = "criteria.errors.growth", "criteria.growth_times"


@record
class CriterionTimes:
    """When each criterion fired, whichever was chosen."""

    chosen: str = fact("the criterion that stops the run")
    dead_point: float | None = fact("when a dead point was met", "s", errors=("criteria.errors.dead_point",))
    multipliers: float | None = fact("when the multipliers had grown", "s", errors=(GROWTH,))
    growth_times: dict[str, float | None] = fact(
        "when the multipliers had grown by each factor", "s", names=FACTOR, errors=(GROWTH,)
    )
    limit_time: float | None = fact("when the multipliers exceeded the limit", "s", errors=(GROWTH,))
    grid: float = fact("interval at which the multipliers are judged", "s")
    latch: float | Absent | None = fact(
        "when the latch came to its position, for that criterion",
        "s", errors=("lock.time_error",), default=ABSENT,
    )  # fmt: skip
    errors: CriterionErrors = fact("errors of these times", default=CriterionErrors())


@record
class MultiplierGrowth:
    """Growth of the multipliers over their running median."""

    largest_ratio: float | None = fact(
        "largest ratio to the running median over the whole scan; `null` where the multipliers diverge",
        errors=("lock.multiplier_growth.ratio_error",),
    )
    ratio_error: float | Absent | None = fact("error of this ratio", default=ABSENT)
    times: dict[str, float | None] = same_as(
        GROWTH_TIMES, fact("when each factor was passed", "s", names=FACTOR, errors=(GROWTH,))
    )
    median_grid: float = fact("interval of the samples of the median", "s")


@record
class NormErrors:
    """Errors of norms of multipliers; left out where none was asked for."""

    start: float | Absent | None = fact("of the norm at the start", NORM, default=ABSENT)
    at_lock: float | Absent | None = fact("of the norm at the lock", NORM, default=ABSENT)
    largest_until_lock: float | Absent | None = fact("of the largest norm", NORM, default=ABSENT)


@record
class MultiplierKeys:
    """Norm of the loops' multipliers along the run."""

    start: float = fact("norm at the start", NORM, errors=(".errors.start",))
    at_lock: float | None = fact(
        "norm at the lock; `null` where the multipliers diverge", NORM, errors=(".errors.at_lock",)
    )
    largest_until_lock: float | None = fact(
        "largest norm until the lock; `null` where the multipliers diverge",
        NORM, errors=(".errors.largest_until_lock",),
    )  # fmt: skip
    errors: NormErrors = fact("errors of these norms")
    rows: list[str] = fact("the rows")
    diverge: bool = fact("whether they diverge: a motion is driven into a dead point")


@record
class SingularValues:
    """Singular values at the lock, largest first."""

    psi: list[float] = fact(
        "of the constraint Jacobian Psi; its entries are in SI units",
        errors=("lock.singular_values.psi_error",),
    )
    passive: list[float] = fact(
        "of its block of passive coordinates; entries in SI units",
        errors=("lock.singular_values.passive_error",),
    )
    psi_error: float | Absent | None = fact("largest error of those of Psi", default=ABSENT)
    passive_error: float | Absent | None = fact("largest error of those of the block", default=ABSENT)


@record
class ImpactErrors:
    """Errors of what the latch does; left out where none was asked for."""

    rates: float | Absent | None = fact("largest of any rate", RATE, default=ABSENT)
    impulse: float | Absent | None = fact("largest of any row's impulse", "N s or N m s", default=ABSENT)
    angular_impulse: float | Absent | None = fact("of the angular impulse", "N m s", default=ABSENT)
    linear_impulse: float | Absent | None = fact("of the linear impulse", "N s", default=ABSENT)
    energy_lost: float | Absent | None = fact("of the energy", "J", default=ABSENT)


@record
class LatchKeys:
    """What the latch does at the instant it closes."""

    rates_before: dict[str, float] = fact(
        "rates before it has closed", RATE, errors=("lock.latch.errors.rates",)
    )
    rates_after: dict[str, float] = fact(
        "rates after it has closed", RATE, errors=("lock.latch.errors.rates",)
    )
    impulse: dict[str, float] = fact(
        "of each constraint row", "N s or N m s", names=ROW, errors=("lock.latch.errors.impulse",)
    )
    angular_impulse: float = fact(
        "of the latch on the second link",
        "N m s", errors=(".errors.angular_impulse",), column="angular impulse",
    )  # fmt: skip
    angular_impulse_vector: list[float] = fact(
        "of the latch on the second link, base axes", "N m s", errors=("lock.latch.errors.angular_impulse",)
    )
    linear_impulse: float = fact("of the latch on the second link", "N s", errors=(".errors.linear_impulse",))
    energy_lost: float = fact(
        "that the impact cost", "J", errors=(".errors.energy_lost",), column="energy lost"
    )
    errors: ImpactErrors = fact("errors of these figures")


@record
class LockErrors:
    """Errors of the pose and the rates at the lock; left out where none was asked for."""

    angles: float | Absent | None = fact("largest of any position", OWN, default=ABSENT)
    angles_deg: float | Absent | None = fact("largest of any angle", "deg", default=ABSENT)
    rates: float | Absent | None = fact("largest of any rate", RATE, default=ABSENT)


@record
class LockKeys:
    """The lock; what is said of multipliers is null in an open chain."""

    time: float = fact("time of the lock", "s", errors=("lock.time_error",), column="time")
    time_error: float | None = fact("estimated error of the time", "s")
    time_error_method: str = fact("how the error was estimated, in words")
    angles: dict[str, float] = fact("positions at the lock", OWN, errors=("lock.errors.angles",))
    angles_deg: dict[str, float] = fact("angles at the lock", "deg", errors=("lock.errors.angles_deg",))
    rates: dict[str, float] | None = fact(
        "rates at the lock; `null` where a motion is driven into it", RATE, errors=("lock.errors.rates",)
    )
    errors: LockErrors = fact("errors of positions and rates")
    kind: str = fact(
        "`dead_point`; `approaching_dead_point` if the multipliers fired on the way to one; `latched`; `overload`"
    )
    joint: str | None = fact("the joint that moves without the input at the lock")
    loop: str | None = fact("the loop that lets it")
    criterion: str = fact("which criterion stopped the run")
    driven: bool = fact("whether a prescribed motion ran into the dead point")
    multiplier_growth: MultiplierGrowth | None = fact("growth of the multipliers")
    growth_times: dict[str, float | None] = same_as(
        GROWTH_TIMES, fact("when each factor of growth was passed", "s", names=FACTOR, errors=(GROWTH,))
    )
    multipliers: MultiplierKeys | None = fact("norm of the loops' multipliers")
    singular_values: SingularValues | None = fact("at the lock")
    latch: LatchKeys | Absent | None = fact("what the latch does when it closes", default=ABSENT)
    name: str | Absent = fact("of several latches the one that closed", default=ABSENT)
    latch_note: str | Absent = fact("why no latch can close", default=ABSENT)


@record
class LatchErrors:
    """Errors of the loads of a latch, that of the motion and of what lies between the samples."""

    peak_force: float | None = fact("of the largest force", "N")
    peak_force_time: float | None = fact("of its time", "s")
    peak_moment: float | None = fact("of the largest moment", "N m")
    peak_moment_time: float | None = fact("of its time", "s")
    force_at_end: float | Absent | None = fact("of the force at the end", "N", default=ABSENT)
    moment_at_end: float | Absent | None = fact("of the moment at the end", "N m", default=ABSENT)


@record
class LatchLoad:
    """Load of the latch after the lock."""

    peak_force: float = fact("largest force", "N", errors=(".errors.peak_force",))
    peak_force_time: float = fact("when the force is largest", "s", errors=(".errors.peak_force_time",))
    force_at_end: float = fact("force at the end", "N", errors=(".errors.force_at_end",))
    peak_moment: float = fact("largest moment", "N m", errors=(".errors.peak_moment",))
    peak_moment_time: float = fact("when the moment is largest", "s", errors=(".errors.peak_moment_time",))
    moment_at_end: float = fact("moment at the end", "N m", errors=(".errors.moment_at_end",))
    errors: LatchErrors = fact("errors of these figures")


@record
class AfterLock:
    """The motion of the locked structure."""

    degrees_of_freedom: int = fact("of the locked structure")
    rows: list[str] = fact("of the latch")
    closure: str = fact("name of the latch as a closure")
    samples: int = fact("number of samples after the lock")
    until: float = fact("end of this motion", "s")
    error_estimate: MotionErrors | Absent | None = fact("errors of this motion", errors=None, default=ABSENT)
    energy_drift: float | Absent = fact(
        "largest error of the energy balance", "J", errors=None, default=ABSENT
    )
    constraint_residual: LoopResidual | Absent = fact(
        "of the loops and the latch", errors=None, default=ABSENT
    )
    latch: LatchLoad | Absent = fact("load of the latch", default=ABSENT)
    largest: dict[str, PeakLoad] | Absent = fact(
        "load of each joint, closure and the base", names=(JOINT, LOOP, "base_wrench"), default=ABSENT
    )
    counters: Counters | Absent = fact("what this run did", default=ABSENT)


@record
class Overload:
    """The first time at which a joint or closure bore more than it may."""

    name: str = fact("the joint or closure")
    quantity: str = fact("`force` or `moment`")
    limit: float = fact("what it may bear", "N or N m")
    time: float = fact("when it first bore more", "s", errors=(".time_error",))
    time_error: float | None = fact("error of this time", "s")
    largest: float = fact("the largest that it bore", "N or N m", errors=(".largest_error",))
    largest_error: float | None = fact("error of the largest load", "N or N m")


@record
class DeploySummary:
    """Keys of the summary of ``deploy``, beside those of every integrated motion."""

    lock: LockKeys | None = fact("the lock; `null` without one; of several latches the last that closed")
    criteria: CriterionTimes | Absent = fact("when each criterion fired", default=ABSENT)
    after_lock: AfterLock | Absent | None = fact(
        "with `deploy.after: continue`: the motion of the locked structure; `null` where no latch could close",
        default=ABSENT,
    )
    overload: Overload | Absent | None = fact(
        "with `deploy.loads`: the first load beyond its limit; `null` if there is none", default=ABSENT
    )
