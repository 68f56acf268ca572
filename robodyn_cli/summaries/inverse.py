"""The summary of ``inverse``, and what ``size`` adds to it."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import (
    ABSENT,
    ANY,
    LIMIT,
    LOAD,
    RATE,
    Absent,
    LoopResidual,
    PeakLoads,
    Termination,
    definitions,
    fact,
)

ROUNDING = "error_estimate.torque_rounding"


@record
class JointErrors:
    """Errors of the figures of a joint that are due to the samples: of what lies between them."""

    peak_torque: float = fact("of the largest magnitude of the torque", LOAD)
    peak_torque_time: float = fact("of the time when the torque is largest", "s")
    rms_torque: float = fact("of the RMS torque", LOAD)
    torque_range: float = fact("of the smallest and the largest torque", LOAD)
    peak_speed: float = fact("of the largest speed", RATE)
    peak_power: float = fact("of the largest power", "W")
    energy: float = fact("of the integrals of the power", "J")


@record
class JointFigures:
    """Figures that size the actuator of a joint, of polynomials of degree 5 through the samples."""

    peak_torque: float = fact(
        "largest magnitude of the torque",
        LOAD,
        errors=(ROUNDING, ".errors.peak_torque"),
        column="peak torque",
    )
    peak_torque_time: float = fact(
        "when the torque is largest", "s", errors=(".errors.peak_torque_time",), column="at"
    )
    rms_torque: float = fact(
        "root of the time average of the squared torque",
        LOAD, errors=(ROUNDING, ".errors.rms_torque"), column="RMS torque",
    )  # fmt: skip
    torque_range: list[float] = fact(
        "smallest and largest torque", LOAD, errors=(ROUNDING, "joints.JOINT.errors.torque_range")
    )
    peak_speed: float = fact(
        "largest magnitude of the rate", RATE, errors=(".errors.peak_speed",), column="peak speed"
    )
    peak_power: float = fact(
        "largest magnitude of the mechanical power", "W", errors=(".errors.peak_power",), column="peak power"
    )
    energy: float = fact(
        "integral of the positive mechanical power: what the actuator delivers if it takes none back",
        "J", errors=(".errors.energy",), column="energy",
    )  # fmt: skip
    energy_net: float = fact("integral of the mechanical power", "J", errors=(".errors.energy",))
    errors: JointErrors = fact("errors of the figures")
    units: dict[str, str] = fact("units of this joint", names=("torque", "speed", "power", "energy"))


@record
class InverseErrors:
    """Errors of the figures of ``inverse``."""

    ik_residual: float | Absent = fact("largest distance of the led point from its target", "m")
    attitude_residual: float | Absent = fact(
        "largest angle by which the led frame is turned against its target", "rad"
    )
    round_trip: float | None = fact(
        "accelerations of forward after inverse dynamics, difference over the largest; with loops, of forward dynamics "
        "with them"
    )
    energy_balance: float = fact(
        "work of actuators and losses less the change of kinetic and potential energy", "J"
    )
    energy_balance_relative: float = fact("the energy balance over the largest energy turned over")
    torque_rounding: float | None = fact(
        "how far rounding may have put any torque off, cancellation and conditioning included", LOAD
    )
    energy_quadrature: float = fact("largest error of an energy that is due to the samples", "J")
    rms_quadrature: float = fact("largest error of an RMS torque that is due to the samples", LOAD)
    closure: LoopResidual | Absent = fact("largest residuals of the loops by level", default=ABSENT)
    virtual_work_residual: float | Absent = fact(
        "what of the generalised force neither actuators nor loops hold", LOAD, default=ABSENT
    )


@record
class LoadedMechanism:
    """The joints that bear the load of a mechanism with loops."""

    degrees_of_freedom: int = fact("of the mechanism")
    actuated: list[str] = fact("joints that bear the load")
    torques: str = fact("`unique`, or of least norm and why")
    multipliers: str = fact("`unique`, or of least norm and why")


@record
class FastestFigures:
    """Figures of a motion in the least time."""

    duration: float = fact("the least time", "s", errors=("fastest.duration_error",), column="least time")
    duration_error: float = fact("change of the duration between the last two grids, continued", "s")
    largest_use: float = fact(
        "check of the limits: how much of any the samples use at most; 1 on it", errors=None
    )
    binding: dict[str, float] = fact(
        "part of the time during which each limit binds, by joint and kind of limit",
        names=LIMIT, errors=("fastest.binding_error",),
    )  # fmt: skip
    binding_error: float = fact(
        "largest error of these parts: of where between two samples another limit begins to bind"
    )
    intervals: int = fact("of the path")


@record
class InverseSummary:
    """The summary of an inverse run."""

    termination: Termination = fact("how the run ended")
    samples: int = fact("number of samples")
    warnings: list[str] | Absent = fact(
        "doubts about the run, printed too: joints beyond their limits, with the time, for example"
    )
    mechanism: LoadedMechanism | Absent = fact("with loops")
    fastest: FastestFigures | Absent = fact("of a path in the least time")
    inverse_kinematics: str | Absent = fact("`analytic` or `newton`, where a point is led")
    ik_residual: float | Absent = fact("largest distance of the led point from its target", "m", errors=None)
    attitude_residual: float | Absent = fact(
        "of a path with attitudes: largest angle by which the led frame is turned against its target",
        "rad",
        errors=None,
    )
    error_estimate: InverseErrors = fact("errors of the figures", errors=None)
    round_trip: float | None = fact(
        "forward dynamics under the computed torques less the accelerations asked for, relative",
        errors=None,
    )
    constraint_residual: LoopResidual | Absent = fact("with loops", errors=None)
    joints: dict[str, JointFigures] = fact("of each joint with an actuator")
    definitions: dict[str, str] = fact("what the figures and their errors are, in words", names=ANY)
    counters: dict[str, int] = fact(
        "`operations` a sample, `compiled` or interpreted; `ik_iterations` and `ik_steps` of Newton's method for the "
        "led point; with loops `iterations` and `steps` along the motion",
        names=("operations", "compiled", "ik_iterations", "ik_steps", "iterations", "steps"),
    )
    reactions: PeakLoads | Absent = fact("loads of joints and closures, where asked for")


def definitions_of(closed: bool) -> dict[str, str]:
    """Return what the figures are, for readers of ``summary.json``; ``closed`` : of a mechanism with loops."""
    errors = ["round_trip", "torque_rounding", "energy_balance", "energy_quadrature", "rms_quadrature"]
    if closed:
        errors.append("virtual_work_residual")
    return definitions(
        (JointFigures, ("peak_torque", "rms_torque", "energy", "energy_net")), (InverseErrors, tuple(errors))
    )


@record
class MotorAndGear:
    """A motor and a gear, of all equal drives of a joint."""

    motor: str = fact("the motor")
    gear: str | None = fact("the gear")
    cost: float = fact("in the currency of the catalogue")
    mass: float = fact("of all motors, gears and brakes of the joint", "kg")
    margin: float = fact(
        "part of the limit that is left which decides",
        errors=("size.margin_difference", ".margin_error"),
    )
    margin_error: float = fact("of the margin")
    decides: str = fact("the limit that decides")


@record
class Sized:
    """What was found for a joint."""

    combinations: int = fact("of motors and gears that were tried")
    passing: int = fact("how many of them bear its motion")
    best: MotorAndGear = fact("the one with the largest margin, also where none passes")
    front: list[MotorAndGear] = fact(
        "those that no other beats in both cost (or mass) and margin, the cheapest (lightest) first"
    )
    motors: list[str] = fact("that a column of `/candidates` counts from 0 on")
    gears: list[str | None] = fact("that a column of `/candidates` counts from 0 on")


@record
class Sizing:
    """What was sought and found."""

    by: str = fact("what is to be small: `cost` or `mass`")
    proven: bool = fact("whether no other combination that bears all motions is cheaper (lighter)")
    cost: float = fact("of all drives, in the currency of the catalogue", column="cost")
    mass: float = fact("of all drives", "kg", column="mass")
    sweeps: int = fact("over all joints, until the choice stayed as it was")
    margin_difference: float = fact(
        "largest difference between margins of the search and those of `inverse` with the chosen drives"
    )
    joints: dict[str, Sized] = fact("of each joint")


@record
class SizeSummary:
    """What ``size`` adds to the summary of ``inverse`` with the drives that were found."""

    size: Sizing = fact("what was sought and found")
