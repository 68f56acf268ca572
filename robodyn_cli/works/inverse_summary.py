"""The keys of the summary of ``inverse`` (see docs/cli.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robodyn_cli.record import record
from robodyn_cli.results.summary import ABSENT, Absent, Residual, Termination
from robodyn_cli.torques.figures import ErrorEstimate, JointFigures

if TYPE_CHECKING:
    from robodyn_cli.drives.figures import DriveFigures
    from robodyn_cli.fastest.report import FastestFigures

# meaning of the figures, for readers of summary.json
DEFINITIONS = {
    "peak_torque": "largest magnitude among the samples",
    "rms_torque": "root of the time average of the squared torque",
    "energy": "integral of the positive mechanical power: what the actuator delivers if it takes none back",
    "energy_net": "integral of the mechanical power",
    "integrals": "polynomials of degree 5 through the samples",
    "round_trip": "accelerations of forward after inverse dynamics, difference over the largest",
    "torque_rounding": "how far rounding may have put any torque off, cancellation included [N m or N]",
    "energy_balance": "work of actuators and losses less the change of kinetic and potential energy [J]",
    "energy_quadrature": "largest change of an energy when every second sample is left out [J]",
    "rms_quadrature": "largest change of an RMS torque when every second sample is left out [N m or N]",
}
CLOSED_DEFINITIONS = {
    **DEFINITIONS,
    "round_trip": "accelerations of forward dynamics with loops under the computed torques, relative",
    "virtual_work_residual": "what of the generalised force neither actuators nor loops hold [N m or N]",
}


@record
class Mechanism:
    """The joints that bear the load of a mechanism with loops, and whether torques and multipliers are ``unique``, or
    of least norm and why."""

    degrees_of_freedom: int
    actuated: list[str]
    torques: str
    multipliers: str


@record
class InverseSummary:
    """The summary of an inverse run."""

    termination: Termination
    samples: int
    warnings: list[str] | Absent
    mechanism: Mechanism | Absent
    fastest: FastestFigures | Absent
    inverse_kinematics: str | Absent
    ik_residual: float | Absent
    attitude_residual: float | Absent
    error_estimate: ErrorEstimate
    round_trip: float | None
    constraint_residual: Residual | Absent
    joints: dict[str, JointFigures]
    definitions: dict[str, str]
    counters: dict[str, int]
    reactions: dict[str, Any] | Absent
    drives: dict[str, DriveFigures] | Absent = ABSENT
    catalogue: str | Absent = ABSENT
