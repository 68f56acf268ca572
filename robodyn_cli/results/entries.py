"""How a path of a result file is described; the paths of controllers and of linear models."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from robodyn_cli.record import record


@record
class Entry:
    """One path of the format; ``names`` label the last dimension where they are always the same.

    by_column : units of columns by their names, where they differ in every file.
    has_gaps : whether it is nan where it has no finite value, as a pole at infinity.
    """

    path: str
    dims: tuple[str, ...]
    units: str
    long_name: str
    names: tuple[str, ...] = ()
    by_column: Mapping[str, str] = dataclasses.field(default_factory=dict)
    has_gaps: bool = False


ROWS_OVER_COLUMNS = "that of the row over that of the column"

CONTROL = (
    Entry("control/reference", ("time", "tracked"), "rad or m", "what the controller follows"),
    Entry("control/error", ("time", "tracked"), "rad or m", "reference less motion"),
    Entry("control/torque", ("time", "driven"), "N m or N", "torque or force of the controller"),
    Entry(
        "control/measured", ("time", "joint"), "rad or m",
        "positions as the controller saw them last: with noise, rounded, up to a period ago; where it has `sensors`",
    ),
    Entry(
        "control/measured_rates", ("time", "joint"), "rad/s or m/s",
        "rates as it saw them last, by sensors or by differences; likewise",
    ),
    Entry("control/states", ("time", "control_state"), "1", "states of the controller"),
    Entry("control/period", (), "s", "sampling period of the controller"),
    Entry("control/delay", (), "s", "time from a sample to the torques that follow from it"),
    *(
        Entry(f"control/{name}{error}", dims, units, f"{'errors of ' * bool(error)}{meaning}")
        for name, dims, units, meaning in (
            ("gains", ("gain_row", "gain_column"), ROWS_OVER_COLUMNS,
             "what each row of `summary.control.gains` gives for each unit by which a column is off"),
            ("riccati", ("gain_column_row", "gain_column"), "1 over those of the row and the column",
             "P of a regulator: x^T P x is the least cost"),
        )
        for error in ("", "_error")
    ),
    Entry(
        "control/poles_real", ("control_pole",), "1/s or 1",
        "real parts of the poles of the loop that the controller is made for",
    ),
    Entry("control/poles_imaginary", ("control_pole",), "1/s or 1", "imaginary parts of these poles"),
    Entry("control/poles_error", ("control_pole",), "1/s or 1", "how far rounding may move these poles"),
    *(
        Entry(f"control/{name}{error}", dims, units, f"{'errors of ' * bool(error)}{meaning}")
        for name, dims, units, meaning in (
            ("equilibrium", ("position",), "rad or m", "the pose about which a regulator is made"),
            ("holding_torques", ("gain_row",), "N m or N", "torques of the driven joints that hold that pose"),
        )
        for error in ("", "_error")
    ),
)  # fmt: skip
FEED_FORWARD = (
    Entry("feed_forward/time", ("feed_forward_sample",), "s", "multiples of `inverse.period`"),
    *(
        Entry(f"feed_forward/{name}", ("feed_forward_sample", "joint"), units, f"{meaning} there")
        for name, units, meaning in (
            ("q", "rad or m", "joint position"), ("qd", "rad/s or m/s", "joint velocity"),
            ("qdd", "rad/s^2 or m/s^2", "joint acceleration"), ("tau", "N m or N", "actuator torque or force"),
        )
    ),
)  # fmt: skip
LINEAR = (
    *(
        Entry(f"linear/{name}", dims, ROWS_OVER_COLUMNS, f"{name} of the linear system")
        for name, dims in (
            ("A", ("state", "state_column")), ("B", ("state", "input")), ("C", ("output", "state")),
            ("D", ("output", "input")),
        )
    ),
    Entry("linear/poles_real", ("pole",), "1/s", "real parts of the poles; 0 where no larger than the error"),
    Entry(
        "linear/poles_imaginary", ("pole",), "1/s", "imaginary parts of the poles; 0 where no larger than the error"
    ),
    Entry("linear/poles_error", ("pole",), "1/s", "how far rounding may move the poles"),
    Entry("linear/frequency", ("frequency",), "rad/s", "angular frequency of the responses"),
    Entry("linear/instant", ("instant",), "s", "times of the samples that `--instants` chose"),
    *(
        Entry(
            f"linear/response_{part}", ("frequency", "output", "input"), ROWS_OVER_COLUMNS,
            f"{part} part of outputs over inputs, C (i w E - A)^-1 B + D",
        )
        for part in ("real", "imaginary")
    ),
    *(
        Entry(f"{group}/{name}", dims, ROWS_OVER_COLUMNS, f"{name} of {what}")
        for group, what in (
            ("discrete", "the linear system under a hold, by samples; its last states are inputs on their way"),
            ("loop", "the loop opened at the torques: u in, what the law gives for it out, with the sign turned"),
        )
        for name, dims in (
            ("A", (f"{group}_state", f"{group}_state_column")), ("B", (f"{group}_state", "input")),
            ("C", ("output", f"{group}_state")), ("D", ("output", "input")),
        )
    ),
    Entry("discrete/period", (), "s", "period of the samples"),
    Entry("discrete/delay", (), "s", "time from a sample until its input acts"),
    Entry("loop/period", (), "s", "period of the samples of the loop, of a controller that has one"),
    Entry("loop/delay", (), "s", "time from a sample of the loop until its torques act"),
    Entry(
        "loop/gains", ("input", "state"), ROWS_OVER_COLUMNS,
        "gains of the law about the pose: torques, with the sign turned, for each unit of the plant's states",
    ),
    Entry(
        "loop/poles_real", ("loop_pole",), "1/s or 1",
        "real parts of the poles of the closed loop, of a sampled one per sample",
    ),
    Entry("loop/poles_imaginary", ("loop_pole",), "1/s or 1", "imaginary parts of these poles"),
    Entry("loop/poles_error", ("loop_pole",), "1/s or 1", "how far rounding may move these poles"),
    Entry("loop/frequency", ("loop_frequency",), "rad/s", "angular frequencies of the responses of the loop"),
    *(
        Entry(
            f"loop/response_{part}", ("loop_frequency", "input"), "1",
            f"{part} part of the loop opened at each input in turn, all others closed",
        )
        for part in ("real", "imaginary")
    ),
    Entry(
        "loop/singular_values", ("loop_frequency", "singular_value"), "1",
        "singular values of the loop opened at all inputs",
    ),
    Entry(
        "loop/sensitivity", ("loop_frequency", "singular_value"), "1",
        "singular values of its sensitivity (E + L)^-1",
    ),
    Entry(
        "modes/q", ("mode", "side", "position"), "rad or m",
        "poses on both sides of each mode, drawn large, loops closed, in the order of `summary.modes`",
    ),
)  # fmt: skip
