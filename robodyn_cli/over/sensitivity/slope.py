"""One derivative, and how it was found."""

from __future__ import annotations

from robodyn_cli.record import record

EXACT, DIFFERENCES = "exact", "differences"


@record
class Slope:
    """d output / d key in SI units, its estimated error, and the method; nan with a ``reason`` where there is none."""

    value: float
    error: float
    method: str
    reason: str = ""


# outputs that follow the errors of a run, by the beginning or the end of their keys
OF_ERRORS = ("error_estimate.", "round_trip", "ik_residual", "attitude_residual", "constraint_residual", "energy_drift",
             "assembly.", "counters.")  # fmt: skip
ERRORS = ("_error", "_residual", "energy_balance")
# outputs that are the time of a sample: the largest or smallest one of a course
TIMES = ("_time", "singular_ratio.time")


def is_time_of_sample(output: str) -> bool:
    """Tell whether an output is the time of one of the samples, which stays or jumps when a key changes."""
    figures = output.startswith("drives.") and output.endswith(".time")
    return (
        output.endswith(TIMES)
        or figures
        or (output.startswith("control.tracking.") and output.endswith(".at"))
    )


def why_not(output: str) -> str:
    """Return why an output has no exact derivatives."""
    if output.startswith(OF_ERRORS) or output.endswith(ERRORS):
        return "this output tells of errors of the run, not of the mechanism"
    return "this output has no exact derivatives"
