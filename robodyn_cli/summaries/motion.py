"""The summary of a motion that was integrated: the keys that ``simulate`` and ``deploy`` share."""

from __future__ import annotations

from typing import Any

from robodyn_cli.record import mutable_record, record
from robodyn_cli.summaries.facts import (
    ABSENT,
    ANY,
    IMPULSE,
    LATCH,
    LOAD,
    OWN,
    PAYLOAD,
    RATE,
    Absent,
    LoopResidual,
    PeakLoads,
    Termination,
    fact,
)

STATE = "rad or m, rad/s or m/s"


@mutable_record
class Counters:
    """Counts of what a run did."""

    steps: int = fact("steps of the integration", default=0)
    rejected: int = fact("steps that were rejected", default=0)
    evaluations: int = fact("of the right-hand side; eight lanes at once count as one", default=0)
    projections: int = fact("of states onto the constraints", default=0)
    events: int = fact("that were located", default=0)

    def __add__(self, other: Counters) -> Counters:
        return Counters(**{k: v + vars(other)[k] for k, v in vars(self).items()})

    @property
    def attempts(self) -> int:
        """Steps, rejected ones too."""
        return self.steps + self.rejected


@record
class Accuracy:
    """What the accuracy was asked by: tolerances, or a fixed step."""

    rtol: float | Absent = fact("relative tolerance of a step", default=ABSENT)
    atol: float | Absent = fact("absolute tolerance of a step", STATE, default=ABSENT)
    step: float | Absent = fact("fixed step", "s", default=ABSENT)


# part of the range of a quantity above which its error means that its digits are lost
NOT_MEANINGFUL = 1e-2


@record
class MotionErrors:
    """Estimated errors of the motion over its samples, and how they were found."""

    method: str = fact("how the error was estimated, in words")
    q_max: float | Absent = fact("largest error of any position over all samples", OWN, default=ABSENT)
    qd_max: float | Absent = fact("largest error of any rate over all samples", RATE, default=ABSENT)
    state_max: float | None = fact(
        "the larger of `q_max` and `qd_max`; `null` where the second integration failed", STATE, default=None
    )
    q_end: float | Absent = fact("largest error of any position at the last sample", OWN, default=ABSENT)
    qd_end: float | Absent = fact("largest error of any rate at the last sample", RATE, default=ABSENT)
    rounding_floor: float | Absent = fact(
        "the error that rounding alone is expected to leave, that of constants and ill-conditioned equations included "
        "where the estimate comes near it; no estimate is below it",
        STATE, default=ABSENT,
    )  # fmt: skip
    steps: int | Absent = fact("of the second integration", default=ABSENT)
    at_rounding: bool | Absent = fact(
        "whether the estimate is within 100 times of `rounding_floor`", default=ABSENT
    )
    meaningful_until: float | Absent = fact(
        "time from which on the estimate exceeds 1 % of the motion, or `atol` at rest", "s", default=ABSENT
    )
    reason: str | Absent = fact("why there is no estimate", default=ABSENT)


@record
class Gains:
    """Baumgarte's gains as a study of them has chosen: alpha = beta = c / h."""

    alpha: float = fact("gain of the velocities", "1/s")
    beta: float = fact("gain of the positions", "1/s")
    factor: float = fact("c: the gains times the step")
    step: float = fact("h, the mean step of the projected run", "s")
    drift: float = fact("of the positions from the constraints, in the trial run", "m or rad")
    error: float = fact("largest of any position, in the trial run", OWN)
    integration_error: float = fact(
        "of the projected run, or what rounding leaves: the bar for the drift", OWN
    )
    over: float = fact("length of the trial runs", "s")
    met: bool = fact("whether the drift stays below the bar")


@record
class Assembly:
    """Closing the loops at t = 0."""

    position_residual: float = fact("largest residual of the loops", "m or rad")
    velocity_residual: float = fact("largest residual of their velocities", "m/s or rad/s")
    redundant_rows: list[str] = fact("rows that follow from others")
    vanishing_rows: list[str] = fact("rows that vanish identically, and were left out")


@record
class DependentRows:
    """Rows that depend on each other."""

    loops: list[str] = fact("the loops that they belong to")
    rows: list[str] = fact("the rows")
    rank: int = fact("how many of them are independent")


@record
class MultiplierChoice:
    """Whether the multipliers are unique, else which were chosen and why."""

    unique: bool = fact("whether the rows decide them")
    choice: str | Absent = fact(
        "`least norm`, where they do not; or while which joints stick together", default=ABSENT
    )
    dependent: list[DependentRows] | Absent = fact(
        "each group of rows that depend on each other", default=ABSENT
    )
    renewals: int | Absent = fact(
        "how often the combinations that are solved with were chosen anew", default=ABSENT
    )


@record
class MethodKeys:
    """A change of method on the way."""

    time: float = fact("when it changed", "s")
    to: str = fact("the new method")
    fastest_decay: float | None = fact(
        "time constant of the fastest decay there; `null`: nothing decays", "s"
    )


AXES = ("x", "y", "z")


@record
class Release:
    """A payload where it was released, in the world."""

    position: dict[str, float] = fact(
        "of its centre of mass", "m", names=AXES, errors=("payloads.PAYLOAD.release.position_error",)
    )
    velocity: dict[str, float] = fact(
        "of that", "m/s", names=AXES, errors=("payloads.PAYLOAD.release.velocity_error",)
    )
    angular_velocity: dict[str, float] = fact(
        "of the payload", "rad/s", names=AXES, errors=("payloads.PAYLOAD.release.angular_velocity_error",)
    )
    energy: float = fact("its kinetic energy", "J", errors=(".energy_error",))
    position_error: float | Absent | None = fact("error of the place", "m", default=ABSENT)
    velocity_error: float | Absent | None = fact("error of the velocity", "m/s", default=ABSENT)
    angular_velocity_error: float | Absent | None = fact(
        "error of the angular velocity", "rad/s", default=ABSENT
    )
    energy_error: float | Absent | None = fact("error of the energy", "J", default=ABSENT)


@record
class Landing:
    """Where the flight of a payload came down to the plane of its `range`, in the world."""

    time: float = fact("when, perhaps after the end of the run", "s", errors=(".time_error",))
    position: dict[str, float] = fact(
        "of its centre of mass", "m", names=AXES, errors=("payloads.PAYLOAD.landing.position_error",)
    )
    velocity: dict[str, float] = fact(
        "of that", "m/s", names=AXES, errors=("payloads.PAYLOAD.landing.velocity_error",)
    )
    range: float = fact("way along the plane from the release", "m", errors=(".range_error",))
    highest: float = fact("largest height above the plane", "m", errors=(".highest_error",))
    time_error: float | Absent | None = fact("error of the time", "s", default=ABSENT)
    position_error: float | Absent | None = fact("error of the place", "m", default=ABSENT)
    velocity_error: float | Absent | None = fact("error of the velocity", "m/s", default=ABSENT)
    range_error: float | Absent | None = fact("error of the range", "m", default=ABSENT)
    highest_error: float | Absent | None = fact("error of the height", "m", default=ABSENT)


@record
class PayloadFacts:
    """What happened to a payload; nothing of one that was neither gripped nor released."""

    gripped: float | Absent = fact("when it was gripped", "s", errors=(".gripped_error",), default=ABSENT)
    energy_lost: float | Absent = fact(
        "in the impact of gripping it", "J", errors=(".energy_lost_error",), default=ABSENT
    )
    released: float | Absent = fact("when it was released", "s", errors=(".released_error",), default=ABSENT)
    gripped_error: float | Absent | None = fact("error of the time when it was gripped", "s", default=ABSENT)
    energy_lost_error: float | Absent | None = fact("error of the energy lost", "J", default=ABSENT)
    released_error: float | Absent | None = fact(
        "error of the time when it was released", "s", default=ABSENT
    )
    release: Release | Absent = fact("where and how fast it was then", default=ABSENT)
    landing: Landing | Absent = fact("with `range`: where its flight came down", default=ABSENT)


@record
class LatchLockErrors:
    """Errors of what a latch did; left out where none was asked for."""

    time: float | Absent | None = fact("of the time", "s", default=ABSENT)
    angle: float | Absent | None = fact("of the position", OWN, default=ABSENT)
    speed: float | Absent | None = fact("of the rate", RATE, default=ABSENT)
    energy_lost: float | Absent | None = fact("of the energy", "J", default=ABSENT)
    angular_impulse: float | Absent | None = fact("of the impulse", IMPULSE, default=ABSENT)
    peak_moment: float | Absent | None = fact("of the largest load", LOAD, default=ABSENT)
    peak_time: float | Absent | None = fact("of its time", "s", default=ABSENT)
    opened: float | Absent | None = fact("of the time when it opened", "s", default=ABSENT)


@record
class LatchLock:
    """What one of several latches did when it closed, the last time where it did so more often."""

    order: int = fact(
        "1 for the first to close; latches that close together have the same; 0: that of `initial.from` had closed it, "
        "and this run tells what it did since"
    )
    time: float | Absent = fact("when it closed", "s", errors=(".errors.time",), default=ABSENT)
    angle: float | Absent = fact(
        "position of the joint that it holds; not of two links that a closure joins",
        OWN, errors=(".errors.angle",), default=ABSENT,
    )  # fmt: skip
    speed: float | Absent = fact(
        "rate of what it holds, right before", RATE, errors=(".errors.speed",), default=ABSENT
    )
    energy_lost: float | Absent = fact(
        "that the impact cost; of latches that close together, that of all of them",
        "J", errors=(".errors.energy_lost",), default=ABSENT,
    )  # fmt: skip
    angular_impulse: float | Absent = fact(
        "of a rigid one: its impulse, along a sliding joint in N s; of latches that close together and hold the same, "
        "those of least norm",
        IMPULSE, errors=(".errors.angular_impulse",), default=ABSENT,
    )  # fmt: skip
    peak_moment: float | Absent = fact(
        "its largest load; of one with a spring absent where the run ends before the load's first peak; of a rigid "
        "one, impulses apart, where `expect`, `--of` or `outputs.extremes` ask for it or for `latch_loads.LATCH`",
        LOAD, errors=(".errors.peak_moment",), default=ABSENT,
    )  # fmt: skip
    peak_time: float | Absent = fact(
        "when its load is largest", "s", errors=(".errors.peak_time",), default=ABSENT
    )
    redundant: bool = fact(
        "whether loops, or latches that closed before or with it, held already what it holds when it closed: then it "
        "bears nothing as long as they do, and its impulse is a share of least norm",
        default=False,
    )
    rebounds: int = fact("of one with a spring: how often it was left again", default=0)
    closings: int = fact("how often it closed", default=1)
    opened: float | Absent = fact(
        "when it opened again; absent while it is closed", "s", errors=(".errors.opened",), default=ABSENT
    )
    errors: LatchLockErrors | Absent = fact("errors of these figures", default=ABSENT)
    unit: str = fact("of the coordinate that it holds: `rad` or `m`", default="rad")


@record
class MissedLatchErrors:
    """Errors of how near a latch came; left out where none was asked for."""

    nearest: float | Absent | None = fact("of the distance", OWN, default=ABSENT)
    time: float | Absent | None = fact("of its time", "s", default=ABSENT)


@record
class MissedLatch:
    """How near a latch that has not closed came to it."""

    nearest: float = fact(
        "least distance from the position at which it closes; of `when` the least magnitude of its formula, in the "
        "units of that; of a dead point that of the determinant of the passive columns of Psi, which is zero there",
        OWN, errors=(".errors.nearest",),
    )  # fmt: skip
    time: float = fact("when it was nearest", "s", errors=(".errors.time",))
    errors: MissedLatchErrors = fact("errors of these figures")
    unit: str = fact("of `nearest`: `rad` or `m`; of a formula and of a dead point empty")


@record
class FinalState:
    """The last state of a run."""

    time: float = fact("of the last state", "s", errors=("lock.time_error",))
    q: dict[str, float] = fact(
        "position at the end",
        OWN,
        errors=("error_estimate.q_end", "lock.errors.angles"),
        column="q at the end",
    )
    qd: dict[str, float] = fact(
        "rate at the end; of none where a motion is driven into a dead point",
        RATE, errors=("error_estimate.qd_end", "lock.errors.rates"), column="qd at the end",
    )  # fmt: skip


@record
class MotionSummary:
    """Keys of the summary of every integrated motion, in their order."""

    termination: Termination | dict[str, Any] = fact(
        "how the run ended; of one that stopped, what is known of the cause", names=ANY
    )
    integrator: str = fact("the method")
    integrator_reason: str = fact("why it was chosen")
    tolerances: Accuracy = fact("what the accuracy was asked by", errors=None)
    samples: int = fact("number of samples")
    error_estimate: MotionErrors | None = fact(
        "errors of the motion; `null` where it was not asked for", errors=None
    )
    energy_drift: float = fact("largest error of the energy balance", "J", errors=None)
    energy_drift_relative: float = fact("the energy drift over the energy exchanged", errors=None)
    energy_balance: str = fact("what the energy balance is of")
    constraint_residual: LoopResidual | Absent = fact("with loops", errors=None)
    assembly: Assembly | Absent = fact("closing the loops at t = 0", errors=None)
    repartitions: int | Absent = fact(
        "with `stabilisation: independent`: how often other coordinates were chosen"
    )
    multipliers: MultiplierChoice | Absent = fact("whether the loops' rows decide their multipliers")
    reactions: PeakLoads | Absent = fact("loads of joints and closures, where asked for")
    counters: Counters = fact("what the run did")
    warnings: list[str] | Absent = fact(
        "doubts about the run, printed too: loops that have closed in a dead point of the input; a second integration "
        "that failed, so that the error is not known; absent without any"
    )
    baumgarte: Gains | Absent = fact(
        "where `stabilisation: baumgarte` left the gains to the run", errors=None
    )
    switches: list[MethodKeys] | Absent = fact("changes of the method on the way, if any", errors=None)
    transitions: dict[str, int] | Absent = fact(
        "of joints with set-valued friction or rigid stops, counted",
        names=("stick", "slip", "impact", "contact", "release"), default=ABSENT,
    )  # fmt: skip
    payloads: dict[str, PayloadFacts] | Absent = fact("that come or go", names=PAYLOAD, default=ABSENT)
    locks: dict[str, LatchLock] | Absent = fact(
        "with `deploy.latches`: those that closed, open ones among them", names=LATCH, default=ABSENT
    )
    missed: dict[str, MissedLatch] | Absent = fact(
        "with `deploy.latches`: those that have not closed", names=LATCH, default=ABSENT
    )
    passed: list[float] | Absent = fact(
        "with `singular: pass`: times of the singular configurations that were stepped over",
        "s", errors=("passed_error",), default=ABSENT,
    )  # fmt: skip
    passed_error: float | Absent | None = fact(
        "largest error of these times; `null` where the second integration met another number of them",
        "s", default=ABSENT,
    )  # fmt: skip
    final: FinalState | Absent = fact("last state of a simulated motion", default=ABSENT)
