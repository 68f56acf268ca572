"""What a controller is and what it did: keys of motions that have one."""

from __future__ import annotations

from collections.abc import Mapping

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import ABSENT, LOAD, OWN, Absent, fact

# columns of gains of one's own coordinate alone
OWN_GAINS = ("position", "rate", "integral")
STATE = "STATE"  # a row or a column of a matrix
POLE_UNIT = "1/s; of a sampled one 1"


def is_diagonal(gains: Mapping[str, Mapping[str, float]]) -> bool:
    """Tell whether each row of a matrix by names has gains of its own coordinate alone."""
    n = len(gains)
    return all(
        not x or j % n == k for k, row in enumerate(gains.values()) for j, x in enumerate(row.values())
    )


@record
class TrackingErrors:
    """Errors of the figures of a tracking error: of the motion, and of what lies between the samples."""

    peak: float = fact("of the largest magnitude", OWN)
    at: float = fact("of its time", "s")
    rms: float = fact("of the root of the mean squared error", OWN)


@record
class Tracking:
    """Error of one coordinate."""

    peak: float = fact(
        "largest magnitude of reference less motion", OWN, errors=(".errors.peak",), column="largest error"
    )
    at: float = fact("when it is largest", "s", errors=(".errors.at",), column="at")
    rms: float = fact("root of the mean squared error", OWN, errors=(".errors.rms",), column="RMS error")
    errors: TrackingErrors = fact("errors of these figures")
    unit: str = fact("of the coordinate")


@record
class DrivenWork:
    """Work of the driven joints; its difference is what they give."""

    driving: float = fact("work while they drive", "J", errors=(".error",))
    braking: float = fact("work while they brake", "J", errors=(".error",))
    error: float = fact("error of these: of the motion, and of what lies between the samples", "J")


@record
class LoopPole:
    """A pole of the loop that a controller is made for."""

    real: float = fact("real part; 0 where no larger than the error", POLE_UNIT, errors=(".error",))
    imaginary: float = fact("imaginary part; 0 where no larger than the error", POLE_UNIT, errors=(".error",))
    error: float = fact("how far rounding may move it", POLE_UNIT)


@record
class EquilibriumErrors:
    """Errors of the pose about which a regulator is made."""

    q: dict[str, float] = fact("of the positions: 0 where they are given, else of closing the loops", OWN)
    torques: dict[str, float] = fact("of the torques: of rounding, and of the positions", LOAD)


@record
class Equilibrium:
    """The pose about which a regulator is made."""

    q: dict[str, float] = fact(
        "position of each coordinate", OWN, errors=("control.equilibrium.errors.q.JOINT",)
    )
    torques: dict[str, float] = fact(
        "of the driven joints, which hold it there",
        LOAD,
        errors=("control.equilibrium.errors.torques.JOINT",),
    )
    errors: EquilibriumErrors = fact("errors of these")


@record
class ControlSummary:
    """What a controller is, and what it did."""

    type: str = fact("of the controller")
    joints: list[str] = fact("that it drives")
    period: float | Absent = fact("between its samples, where it is sampled", "s")
    delay: float | Absent = fact("from a sample to its torque, where it is sampled", "s")
    updates: int | Absent = fact("how many samples it took")
    tracking: dict[str, Tracking] | Absent = fact("error of each coordinate that it leads", names="TRACKED")
    limits: dict[str, float] | Absent = fact("largest torque or force of joints that have one", LOAD)
    least_limits: dict[str, float] | Absent = fact("least one, where it is not the same the other way", LOAD)
    saturated: dict[str, float] | Absent = fact(
        "time at the limit, of joints that have one; of a sampled controller where `control.energy` is known",
        "s",
        errors=("control.saturated_error.JOINT",),
        column="at its limit",
    )
    saturated_error: dict[str, float] | Absent = fact("errors of these times", "s")
    energy: DrivenWork | Absent = fact(
        "work of the driven joints; of a sampled controller that may change its torques twice between two samples of "
        "the run only where `outputs.response`, `expect` or `--of` ask for it or for a response"
    )
    gains: dict[str, dict[str, float]] | Absent = fact(
        "what each row gives (a driven joint; of `computed_torque` its acceleration, of `task_pd` a force along an "
        "axis) for each unit by which a column is off (positions, `qd.NAME`, of `pid` `integral.NAME`), of kinds that "
        "have gains; of `lqr` K, rows joints, columns states",
        "unit of the row over that of the column",
        names=STATE,
        errors=("control.gain_errors.STATE.STATE",),
        default=ABSENT,
    )
    gain_errors: dict[str, dict[str, float]] | Absent = fact(
        "errors of gains that were found, by row and column",
        "unit of the row over that of the column",
        names=STATE,
        default=ABSENT,
    )
    row_units: dict[str, str] | Absent = fact("units of the rows of `gains`", names=STATE, default=ABSENT)
    column_units: dict[str, str] | Absent = fact(
        "units of the columns of `gains`", names=STATE, default=ABSENT
    )
    riccati: dict[str, dict[str, float]] | Absent = fact(
        "of `lqr`: P by states, the least cost from x being x^T P x: of the integral, or of the sum over samples",
        "1 over the units of row and column",
        names=STATE,
        errors=("control.riccati_errors.STATE.STATE",),
        default=ABSENT,
    )
    riccati_errors: dict[str, dict[str, float]] | Absent = fact(
        "errors of P", "1 over the units of row and column", names=STATE, default=ABSENT
    )
    poles: list[LoopPole] | Absent = fact(
        "of the loop that the controller is made for, without delay, sensors and limits, with the controller's own "
        "model: of `lqr`, of a sampled one per sample; and of a continuous `computed_torque`",
        default=ABSENT,
    )
    equilibrium: Equilibrium | Absent = fact("of `lqr`: the pose q_0 and what holds it", default=ABSENT)


@record
class ControlKeys:
    """Keys of a motion with a controller."""

    control: ControlSummary = fact("what the controller is, and what it did")
