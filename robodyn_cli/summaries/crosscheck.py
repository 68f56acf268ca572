"""What ``crosscheck`` prints for programs (``--json``): two answers, or how far an engine is off as it is used."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import ABSENT, ACCELERATION, ANY, OWN, Absent, Termination, fact

OF_QUANTITY = "rad or m, rad/s or m/s, N m or N"


@record
class ComparedQuantity:
    """One quantity of two engines at the sample and in the column where they differ most."""

    quantity: str = fact("`tau`, `q` or `qd`")
    column: str = fact("the coordinate")
    time: float = fact("of the sample", "s")
    ours: float = fact("value here", OF_QUANTITY, errors=(".our_error",))
    theirs: float = fact("value in the other engine", OF_QUANTITY, errors=(".their_error",))
    difference: float = fact("of the two, the largest", OF_QUANTITY)
    our_error: float = fact("error of the answer here", OF_QUANTITY)
    their_error: float = fact("error of the other answer", OF_QUANTITY)
    allowed: float = fact("difference that is allowed: ten times both errors together", OF_QUANTITY)
    size: float = fact(
        "of the answer here: the largest torque, or how far the motion goes from its start", OF_QUANTITY
    )
    agrees: bool | None = fact(
        "whether the difference is allowed; `null` where that proves nothing, as more is allowed than `size`"
    )


@record
class CrosscheckReport:
    """What ``crosscheck`` found."""

    status: str = fact(
        "`ok`, `differs`, or `open` where the errors are too large for a comparison to prove anything"
    )
    title: str = fact("title of the scene")
    command: str = fact("what was compared: `inverse` or `simulate`")
    engine: str = fact("the other engine")
    version: str = fact("of that engine")
    compared: list[ComparedQuantity] = fact("of each quantity, where the answers differ most")
    handed_over: list[str] = fact("what acts and is handed over as joint torques: it is not checked")
    by_own_formulas: list[str] = fact("what acts and is added by formulas of the check")
    compared_until: float | Absent = fact(
        "last sample that is compared, of a motion that passes a singular pose behind it: from there on the equations "
        "have more than one solution",
        "s",
        default=ABSENT,
    )

    @property
    def agrees(self) -> bool:
        """Whether all differences are allowed, and that proves something."""
        return self.status == "ok"


@record
class ClosureGap:
    """How far another engine opens a closure: a reading of its own states."""

    closure: str = fact("loop or coupler")
    unit: str = fact("`m`: distance of the two points, or what a coupler is off by; `rad`: angle")
    largest: float = fact("largest gap at any step", "m or rad")
    time: float = fact("when", "s")
    start: float = fact("gap at the start", "m or rad")
    final: float = fact("gap at the end", "m or rad")
    here: float = fact("largest gap of the motion here", "m or rad")


@record
class OffFromExact:
    """Accelerations that an engine has at the begin of its steps, beside the exact ones at the same states."""

    start: float = fact("largest difference at the start", ACCELERATION, errors=(".error",))
    start_relative: float | None = fact(
        "that over the largest exact acceleration there; `null` where that is zero"
    )
    start_column: str = fact("the coordinate")
    largest: float = fact("largest difference at any step", ACCELERATION, errors=(".error",))
    relative: float | None = fact("that over `size`; `null` where that is zero")
    column: str = fact("the coordinate")
    time: float = fact("when", "s")
    size: float = fact("largest acceleration of the motion here", ACCELERATION)
    error: float = fact(
        "of the differences: how far exact accelerations and those by the engine's M and h are apart at up to 16 "
        "states, and rounding",
        ACCELERATION,
    )


@record
class EnergyMade:
    """Energy that an engine makes, less the work of torques and dampers."""

    largest: float = fact("where it is off most: positive is made, negative is lost", "J", errors=(".error",))
    relative: float | None = fact("its magnitude over `kinetic`; `null` where that is zero")
    time: float = fact("when", "s")
    final: float = fact("at the end", "J", errors=(".error",))
    kinetic: float = fact("largest kinetic energy of the motion here", "J")
    error: float = fact("of the energies: sum over dampers, and rounding", "J")
    here: float = fact("largest error of the energy balance of the motion here", "J")


@record
class OffFromMotion:
    """How far joints are from the motion here, at the ends of the engine's steps."""

    unit: str = fact("`rad` or `m`: of the joints")
    largest: float = fact("largest difference", OWN, errors=(".error",))
    column: str = fact("the coordinate")
    time: float = fact("when", "s")
    final: float = fact("largest at the end", OWN, errors=(".error",))
    error: float | None = fact("error of the motion here; `null` where the scene asks for none", OWN)


@record
class OwnSettingsSummary:
    """What ``crosscheck --own-settings`` tells; it has no verdict."""

    termination: Termination = fact("how the other engine's run ended")
    engine: str = fact("the other engine")
    version: str = fact("of that engine")
    settings: dict[str, str] = fact("of that engine, by name", names=ANY)
    step: float = fact("its time step", "s")
    steps: int = fact("that it made")
    closures: list[ClosureGap] = fact("of loops and couplers; a reading of the engine's own states")
    accelerations: OffFromExact = fact("how far they are off")
    energy: EnergyMade = fact("that is made or lost")
    joints: list[OffFromMotion] = fact("how far turns, and slides, are from the motion here")
    handed_over: list[str] = fact("what acts and is handed over as joint torques at the begin of each step")
    of_the_engine: list[str] = fact("springs, dampers and viscous friction that the engine has itself")
    with_small_mass: list[str] = fact(
        "links that move without mass in the scene, and got a millionth of the least there is for both answers"
    )
