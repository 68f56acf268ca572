"""Figures of responses: how what a controller leads goes to where it is to be."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import OWN, Absent, UnitOf, fact

SQUARE = UnitOf("(N m)^2 s", "N^2 s")


@record
class ResponseErrors:
    """Errors of the figures of a response: of the motion, and of what lies between the samples."""

    rise: float | None = fact("of the rise; `null` where it is not known", "s")
    overshoot: float | None = fact("of the overshoot; likewise")
    settling: float | None = fact("of the settling; likewise", "s")
    final_error: float = fact("of the error at the end", OWN)
    effort: float | Absent = fact("of the effort", SQUARE)
    energy: float | Absent = fact("of the energy", "J")


@record
class Response:
    """The way of a coordinate from where it begins to the reference at the end of the run: its step."""

    step: float = fact("reference at the end less position at the start", OWN, column="step")
    rise: float | None = fact(
        "from a tenth of the step to nine tenths of it, first met; `null` where it does not come there, or there is no "
        "step",
        "s",
        errors=(".errors.rise",),
        column="rise",
    )
    overshoot: float | None = fact(
        "how far it goes beyond the end at most, over the step; 0: never; `null` where there is no step",
        errors=(".errors.overshoot",),
        column="overshoot",
    )
    settling: float | None = fact(
        "from the start until it is within 2 % of the step about the end for good; `null` where it is not at the end "
        "of the run, or there is no step",
        "s",
        errors=(".errors.settling",),
        column="settling",
    )
    final_error: float = fact(
        "reference less position at the end of the run",
        OWN,
        errors=(".errors.final_error",),
        column="error at the end",
    )
    effort: float | Absent = fact(
        "of a driven joint: integral of the square of its torque",
        SQUARE,
        errors=(".errors.effort",),
        column="effort",
    )
    energy: float | Absent = fact(
        "of a driven joint: integral of the magnitude of its power, driving and braking",
        "J",
        errors=(".errors.energy",),
        column="energy",
    )
    errors: ResponseErrors = fact("errors of these figures")
    unit: str = fact("of the coordinate")


@record
class ResponseKeys:
    """Keys of a run with a controller that is asked for its response."""

    response: dict[str, Response] = fact(
        "of each coordinate that the controller leads, where `outputs.response`, `expect` or `--of` ask for it",
        names="TRACKED",
    )
