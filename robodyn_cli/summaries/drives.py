"""What motors and gears bear in a motion, and its margins of motorisation: keys of motions that have these.

Errors are null where nothing tells them: of runs of which samples alone are known.
"""

from __future__ import annotations

from typing import ClassVar

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import LOAD, OWN, RATE, TURNS, Absent, fact

LIMITS = ("peak", "continuous", "winding", "gear_peak", "gear_rated", "gear_speed", "brake")


@record
class SideErrors:
    """Errors of the figures of one side of a gear: of what lies between the samples, and of an integrated motion."""

    peak_torque: float | None = fact("of the largest torque", LOAD)
    peak_torque_time: float | None = fact("of its time", "s")
    rms_torque: float | None = fact("of the RMS torque", LOAD)
    mean_torque: float | None = fact("of the mean torque", LOAD)
    peak_speed: float | None = fact("of the largest speed", RATE)
    power: float | None = fact("of the largest powers", "W")
    energy: float | None = fact("of the energies", "J")


@record
class ShaftErrors(SideErrors):
    """The same of the shaft of each motor."""

    peak_torque: float | None = fact("of the largest torque", "N m")
    rms_torque: float | None = fact("of the RMS torque", "N m")
    mean_torque: float | None = fact("of the mean torque", "N m")
    peak_speed: float | None = fact("of the largest speed", "rad/s")


@record
class Side:
    """Torque, speed, power and energy a cycle at the joint, behind the gears."""

    ERRORS: ClassVar[type[SideErrors]] = SideErrors
    peak_torque: float = fact("largest magnitude of the torque", LOAD, errors=(".errors.peak_torque",))
    peak_torque_time: float = fact("when the torque is largest", "s", errors=(".errors.peak_torque_time",))
    rms_torque: float = fact("root of the mean squared torque", LOAD, errors=(".errors.rms_torque",))
    mean_torque: float = fact("mean magnitude of the torque", LOAD, errors=(".errors.mean_torque",))
    peak_speed: float = fact("largest magnitude of the speed", RATE, errors=(".errors.peak_speed",))
    driving_power: float = fact("largest power to the mechanism", "W", errors=(".errors.power",))
    braking_power: float = fact("largest power back from the mechanism", "W", errors=(".errors.power",))
    driving_energy: float = fact("energy to the mechanism, a cycle", "J", errors=(".errors.energy",))
    braking_energy: float = fact("energy back from the mechanism, a cycle", "J", errors=(".errors.energy",))
    errors: SideErrors = fact("errors of these figures")


@record
class Shaft(Side):
    """The same at the shaft of each motor, the acceleration of its rotor included."""

    ERRORS = ShaftErrors
    peak_torque: float = fact("largest magnitude of the torque", "N m", errors=(".errors.peak_torque",))
    rms_torque: float = fact("root of the mean squared torque", "N m", errors=(".errors.rms_torque",))
    mean_torque: float = fact("mean magnitude of the torque", "N m", errors=(".errors.mean_torque",))
    peak_speed: float = fact("largest magnitude of the speed", "rad/s", errors=(".errors.peak_speed",))
    errors: ShaftErrors = fact("errors of these figures")


@record
class ElectricalErrors:
    """Errors of the electrical figures: of what lies between the samples, and of an integrated motion."""

    peak_current: float | None = fact("of the largest current", "A")
    rms_current: float | None = fact("of the RMS current", "A")
    energy: float | None = fact("the largest of any energy", "J")


@record
class Electrical:
    """Of each motor whose current is known: currents, energy a cycle from the supply and back, and where it goes."""

    peak_current: float = fact("largest magnitude of the current", "A", errors=(".errors.peak_current",))
    rms_current: float = fact("root of the mean squared current", "A", errors=(".errors.rms_current",))
    energy: float = fact("from the supply, a cycle", "J", errors=(".errors.energy",))
    regenerated: float = fact("back to the supply, a cycle", "J", errors=(".errors.energy",))
    copper_loss: float = fact("that warms the winding, a cycle", "J", errors=(".errors.energy",))
    friction_loss: float = fact("of the motor, a cycle", "J", errors=(".errors.energy",))
    errors: ElectricalErrors = fact("errors of these figures")


@record
class WindingTemperatures:
    """Temperatures of the winding of motors with thermal data."""

    peak: float = fact("largest in the steady periodic state", "degC", errors=(".error",))
    mean: float = fact("mean in the steady periodic state", "degC", errors=(".error",))
    after_one_cycle: float = fact(
        "after a first cycle that begins at the surroundings' temperature", "degC", errors=(".error",)
    )
    error: float | None = fact(
        "error of these: of what lies between the samples, and of an integrated motion", "K"
    )


@record
class UsedLimit:
    """How much of a limit is used."""

    use: float = fact("part of the limit that is used; 1: all of it", errors=(".use_error",))
    use_error: float | None = fact(
        "error of this part: of what lies between the samples, and of an integrated motion"
    )
    time: float | Absent = fact(
        "when most of it is used, where that is an instant", "s", errors=(".time_error",)
    )
    time_error: float | Absent | None = fact("error of this time", "s")


@record
class DriveErrors:
    """Errors of the figures of a drive: of what lies between the samples, and of an integrated motion."""

    margin: float | None = fact("of the margin")
    time: float | Absent | None = fact("of the time when the limit decides", "s")
    gear_loss: float | None = fact("of the energy that the gears lose", "J")
    inertia_ratio: float | Absent | None = fact("of the smallest and largest ratio of inertias")
    wind_up: float | Absent | None = fact("of the angle or way by which the gears give way", OWN)


@record
class DriveFigures:
    """The figures of one joint's drive."""

    passes: bool = fact("whether `margin` is at least `least_margin`")
    margin: float = fact("part of the limit that is left which decides", errors=(".errors.margin",))
    least_margin: float = fact("margin that is asked for")
    decides: str = fact("the limit that decides")
    time: float | Absent = fact("when it decides, where that is an instant", "s", errors=(".errors.time",))
    motor: str = fact("the motor")
    gear: str | None = fact("the gear")
    brake: str | None = fact("the brake")
    count: int = fact("number of motors at this joint")
    ratio: float = fact("the motor's turn over the joint's coordinate", TURNS)
    mass: float = fact("of all motors, gears and brakes of the joint", "kg")
    cost: float = fact("of all motors, gears and brakes of the joint, in the currency of the catalogue")
    limits: dict[str, UsedLimit] = fact(
        "`peak`: the motor's envelope, speed and torque scaled together; `continuous`: RMS over rated current, or the "
        "continuous envelope at RMS speed and torque; `winding`: warming over the warming allowed; `gear_peak`, "
        "`gear_rated` (root mean cube, weighted by the speed), `gear_speed`; `brake`: torque that holds "
        "the poses at rest",
        names=LIMITS,
    )
    joint: Side = fact("at the joint, behind the gears")
    shaft: Shaft = fact("at the shaft of each motor, the acceleration of its rotor included")
    electrical: Electrical | Absent = fact("of each motor whose current is known")
    winding: WindingTemperatures | Absent = fact("of motors with thermal data")
    gear_loss: float = fact("energy that the gears lose a cycle", "J", errors=(".errors.gear_loss",))
    inertia_ratio: list[float] | Absent = fact(
        "smallest and largest inertia of the mechanism at the joint over that of the drive; left out where data are "
        "unknown, or loops leave the motion of a joint alone open",
        errors=("drives.JOINT.errors.inertia_ratio",),
    )
    wind_up: float | Absent = fact(
        "largest load over the stiffness of the gears", OWN, errors=(".errors.wind_up",)
    )
    errors: DriveErrors = fact("errors of the figures")
    units: dict[str, str] = fact("units at the joint", names=("torque", "speed", "wind_up", "ratio"))


@record
class DriveKeys:
    """Keys of a motion with drives."""

    drives: dict[str, DriveFigures] = fact("what the motors bear, of scenes with `drives`")
    catalogue: str | Absent = fact("title of the catalogue that the drives come from")


@record
class RatioErrors:
    """Errors of a ratio of motorisation: of what lies between the samples, and of an integrated motion."""

    ratio: float | None = fact("of the ratio; null where it is not known")
    time: float | None = fact("of the time when it is least", "s")
    angle: float | Absent | None = fact("of the position there", OWN)


@record
class Ratio:
    """The least ratio of torque available over factored resistance."""

    ratio: float | None = fact(
        "least ratio of the torque available, less what stands outside, over the factored resistance; null where "
        "nothing resists",
        errors=(".errors.ratio",),
    )
    time: float = fact("when it is least", "s", errors=(".errors.time",))
    angle: float | Absent = fact("position of the joint there", OWN, errors=(".errors.angle",))
    decides: str | None = fact("the largest factored resistance there; null where nothing resists")
    errors: RatioErrors = fact("errors of the figures")


@record
class MotorisationFigures(Ratio):
    """The margin of motorisation of a driven joint: the lesser of both ratios, whether it suffices, and both."""

    required: float = fact("least ratio that is required")
    met: bool = fact("whether the ratio is at least `required` all the time")
    static: Ratio = fact("of the poses: in motion so slow that rates do not count, without inertia")
    dynamic: Ratio | Absent = fact(
        "of the motion: with its rates; the inertia of a motion that is given counts, that of one that follows from "
        "the torques is their surplus"
    )


@record
class MotorisationKeys:
    """Keys of a motion with margins of motorisation."""

    motorisation: dict[str, MotorisationFigures] = fact("margin of each driven joint")
