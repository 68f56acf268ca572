"""The summary of ``linearise``."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import ACCELERATION, LOAD, OWN, RATE, Absent, Termination, fact
from robodyn_cli.summaries.loops import ClosedLoop, LoopMargins

POLE = (".error",)


@record
class LinearSignal:
    """A state, an input or an output of a linear system."""

    name: str = fact("of the state, the input or the output")
    unit: str = fact("its unit")


@record
class Mode:
    """A pole s of x-dot = A x, with its mode; a pair of complex poles is one mode, with the one above the real axis."""

    real: float = fact("real part of the pole; 0 where no larger than the error", "1/s", errors=POLE)
    imaginary: float = fact(
        "imaginary part of the pole; 0 where no larger than the error", "1/s", errors=POLE
    )
    error: float = fact(
        "how far rounding may move the pole: far where poles meet, since a double one is known to the root of the "
        "rounding only",
        "1/s",
    )
    multiplicity: int = fact(
        "how many poles it stands for: 2 at 0 of a free motion, of position and rate, which goes on at its rate"
    )
    frequency: float = fact("|s| / 2 pi, of the undamped oscillation", "Hz", errors=(".frequency_error",))
    damping: float | None = fact(
        "-Re s / |s|, the damping ratio: 1 of a decay without oscillation; `null` at 0",
        errors=(".damping_error",),
    )
    time: float | None = fact(
        "1 / |Re s|, in which it decays or grows e times; `null` where it does neither", "s",
        errors=(".time_error",),
    )  # fmt: skip
    frequency_error: float = fact("of the frequency, by that of the pole", "Hz")
    damping_error: float | None = fact("of the damping ratio, likewise")
    time_error: float | None = fact("of the time, likewise; `null` where the pole may as well be at 0", "s")
    shape: dict[str, list[float]] = fact(
        "amplitude of each coordinate, the largest 1, in its own unit, and its phase", "1 and rad"
    )
    reached: bool = fact("whether the inputs reach it (controllable)")
    shown: bool = fact("whether the outputs show it (observable)")


@record
class LinearInstant:
    """The system at a sample of a motion, as if it stayed so."""

    time: float = fact("of the sample", "s")
    stability: str = fact("`stable`, `unstable`, or `marginal`: a mode neither decays nor grows")
    modes: list[Mode] = fact("of the system there, slowest first")


@record
class LargestGrowth:
    """The pole farthest to the right along a motion."""

    largest: float = fact("its real part", "1/s", errors=POLE)
    error: float = fact("of this part", "1/s")
    time: float = fact("when it is there", "s")


@record
class LinearErrors:
    """How far the state may be off: what residuals and rounding make of it; `null` where rounding decides whether it is
    held."""

    configuration: dict[str, float | None] = fact("of the joint positions", OWN)
    rates: dict[str, float | None] = fact("of the rates", RATE)
    accelerations: dict[str, float | None] = fact("of the accelerations", ACCELERATION)


@record
class DiscreteModel:
    """The model from sample to sample under inputs that are held: ``/discrete`` of the result."""

    period: float = fact("of the samples", "s")
    delay: float = fact("from a sample until its inputs act", "s")
    states: list[LinearSignal] = fact(
        "of the columns and rows of its A: those of the model, then inputs on their way"
    )


@record
class LinearSummary:
    """The summary of ``linearise``."""

    termination: Termination = fact("how the run ended")
    samples: int = fact("number of samples: 1 but along a motion")
    about: str = fact("`state`, `balance`, `hold`, `motion`, or `controller`: the pose that it is to keep")
    freedoms: int = fact("number of independent coordinates")
    configuration: dict[str, float] | Absent = fact(
        "joint positions of the state; not along a motion",
        OWN,
        errors=("error_estimate.configuration.JOINT",),
    )
    rates: dict[str, float] | Absent = fact(
        "their rates; not along a motion", RATE, errors=("error_estimate.rates.JOINT",)
    )
    accelerations: dict[str, float] | Absent = fact(
        "their accelerations; not along a motion",
        ACCELERATION,
        errors=("error_estimate.accelerations.JOINT",),
    )
    units: dict[str, str] | Absent = fact("unit of each coordinate: `rad`, `m` or `1`; not along a motion")
    holding_torques: dict[str, float] | Absent = fact(
        "with `--hold`: the constant torques of the inputs; at a balance: of joints in `initial.hold` and prescribed "
        "ones, which keep them there",
        LOAD,
        errors=("holding_torques_error.JOINT",),
    )
    holding_torques_error: dict[str, float | None] | Absent = fact(
        "their errors; `null` where rounding decides whether the inputs hold the pose", LOAD
    )
    largest_acceleration: float | Absent = fact(
        "of an independent coordinate at the state; 0, but for rounding, at an equilibrium", ACCELERATION,
        errors=("largest_acceleration_error",),
    )  # fmt: skip
    largest_acceleration_error: float | Absent | None = fact(
        "its error; `null` where rounding decides whether the state is held", ACCELERATION
    )
    error_estimate: LinearErrors | Absent = fact("estimated errors; not along a motion")
    states: list[LinearSignal] = fact("of the columns and rows of A, in their order")
    inputs: list[LinearSignal] = fact("of the columns of B and D, in their order")
    measured: list[LinearSignal] = fact("the outputs: of the rows of C and D, in their order")
    stability: str | Absent = fact("`stable`, `unstable`, or `marginal`: a mode neither decays nor grows")
    modes: list[Mode] | Absent = fact("of the system, slowest first; not along a motion")
    growth: LargestGrowth | Absent = fact("along a motion: the pole farthest to the right")
    instants: list[LinearInstant] | Absent = fact("with `--instants`: samples along the motion")
    discrete: DiscreteModel | Absent = fact("with a period: the model under a hold; not along a motion")
    warnings: list[str] | Absent = fact("what a reader of the linear system should know; printed too")


@record
class LoopKeys:
    """Keys of a scene with a controller, but along a motion."""

    loop: dict[str, LoopMargins] = fact("the loop opened at each driven joint in turn, all others closed")
    closed_loop: ClosedLoop = fact("the loop with all inputs closed")
