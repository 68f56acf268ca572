"""What ``size`` adds to the summary of ``inverse``."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import fact


@record
class MotorAndGear:
    """A motor and a gear, of all equal drives of a joint."""

    motor: str = fact("the motor")
    gear: str | None = fact("the gear")
    cost: float = fact("in the currency of the catalogue")
    mass: float = fact("of all motors, gears and brakes of the joint", "kg")
    margin: float = fact(
        "part of the limit that is left which decides",
        errors=("size.margin_difference", "drives.JOINT.errors.margin"),
    )
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
    cost: float = fact("of all drives, in the currency of the catalogue")
    mass: float = fact("of all drives", "kg")
    sweeps: int = fact("over all joints, until the choice stayed as it was")
    margin_difference: float = fact(
        "largest difference between margins of the search and those of `inverse` with the chosen drives"
    )
    joints: dict[str, Sized] = fact("of each joint")


@record
class SizeSummary:
    """What ``size`` adds to the summary of ``inverse`` with the drives that were found."""

    size: Sizing = fact("what was sought and found")
