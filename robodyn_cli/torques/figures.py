"""Figures of the joints in an inverse run, and their errors: keys of its summary."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.results.summary import ABSENT, Absent


@record
class JointFigures:
    """Figures that size the actuator of a joint: torque [N m or N], speed [rad/s or m/s], power [W], energy [J]."""

    peak_torque: float
    peak_torque_time: float
    rms_torque: float
    torque_range: list[float]
    peak_speed: float
    peak_power: float
    energy: float
    energy_net: float
    units: dict[str, str]


@record
class ErrorEstimate:
    """Errors of the figures; see ``checks.error_estimate``."""

    ik_residual: float | Absent
    attitude_residual: float | Absent
    round_trip: float | None
    energy_balance: float
    energy_balance_relative: float
    torque_rounding: float | None
    energy_quadrature: float | Absent = ABSENT
    rms_quadrature: float | Absent = ABSENT
    closure: dict[str, float] | Absent = ABSENT
    virtual_work_residual: float | Absent = ABSENT
