"""Units of outputs of a study, which are keys of a summary."""

from __future__ import annotations

from robodyn_cli.model.model import TORQUE, Model
from robodyn_cli.results.columns import UNKNOWN

# maps from joints or their coordinates to numbers, by their key; what follows the joint's own unit
STATES = {
    "final.q": "", "lock.angles": "", "configuration": "",
    "final.qd": "/s", "lock.rates": "/s", "rates": "/s", "accelerations": "/s^2",
}  # fmt: skip
# figures of joints: ``joints.NAME.FIGURE`` or ``FIGURE.NAME``
MOTIONS = {"smallest": "", "largest": "", "peak_speed": "/s", "peak_acceleration": "/s^2"}
TORQUES = ("peak_torque", "rms_torque", "torque_range")
# other keys, by their last step
LAST = {
    "energy": "J", "energy_net": "J", "energy_drift": "J", "energy_balance": "J", "energy_quadrature": "J",
    "energy_lost": "J", "peak_power": "W", "peak_force": "N", "peak_moment": "N m", "ik_residual": "m",
    "path_length": "m", "peak_speed": "m/s", "peak_acceleration": "m/s^2", "round_trip": "1", "singular_ratio": "1",
    "meaningful_until": "s", "linear_impulse": "N s", "angular_impulse": "N m s", "exit_code": "1", "samples": "1",
    "attitude_residual": "rad",
}  # fmt: skip
# keys of drives, below ``drives.JOINT``: those of the joint's own side follow its unit
OF_JOINT = {"wind_up": "", "joint.peak_speed": "/s"}
LOADS = ("joint.peak_torque", "joint.rms_torque", "joint.mean_torque")
OF_DRIVE = {
    "margin": "1", "least_margin": "1", "errors.margin": "1", "mass": "kg", "cost": "1", "count": "1", "gear_loss": "J",
    "shaft.peak_torque": "N m", "shaft.rms_torque": "N m", "shaft.mean_torque": "N m", "shaft.peak_speed": "rad/s",
    "errors.rms_torque": "N m", "errors.winding": "K", "inertia_ratio": "1",
}  # fmt: skip
OF_DRIVE_LAST = {
    "use": "1", "driving_power": "W", "braking_power": "W", "driving_energy": "J", "braking_energy": "J",
    "peak_current": "A", "rms_current": "A", "energy": "J", "regenerated": "J", "copper_loss": "J",
    "friction_loss": "J",
}  # fmt: skip


def unit_of_output(key: str, model: Model) -> str:
    """Return the unit of a key of a summary: ``N m`` of ``peak_torque.theta1``; ``UNKNOWN`` where none is known."""
    joints = {**dict(zip(model.v_names, model.v_units)), **dict(zip(model.q_names, model.q_units))}
    for head, power in STATES.items():
        if key.startswith(f"{head}.") and (unit := joints.get(key.removeprefix(f"{head}."))):
            return unit + power if unit != "1" or not power else UNKNOWN
    if key.startswith("torques_of_joints."):
        return TORQUE.get(joints.get(key.partition(".")[2], ""), UNKNOWN)
    figure, _, name = key.partition(".")
    if figure == "singular_ratio":
        return "s" if name == "time" else "1"
    if figure in ("drives", "control"):
        return (_of_drive if figure == "drives" else _of_control)(name, joints)
    if figure == "joints":
        name, _, figure = name.rpartition(".")
    if name in joints:
        return _of_joint(figure, joints[name])
    return _by_last_step(key)


def _of_drive(key: str, joints: dict[str, str]) -> str:
    """Return the unit of a key below ``drives``."""
    name, _, figure = key.partition(".")
    unit = joints.get(name, UNKNOWN)
    if figure in LOADS:
        return TORQUE.get(unit, UNKNOWN)
    if figure in OF_JOINT:
        return unit + OF_JOINT[figure] if unit != UNKNOWN else UNKNOWN
    if figure == "ratio":
        return {"rad": "1", "m": "rad/m"}.get(unit, UNKNOWN)
    if figure.startswith("winding."):
        return "degC"
    found = OF_DRIVE.get(figure) or OF_DRIVE_LAST.get(figure.rpartition(".")[2])
    return found or _by_last_step(figure)


def _of_control(key: str, joints: dict[str, str]) -> str:
    """Return the unit of a key below ``control``."""
    group, _, rest = key.partition(".")
    name, _, figure = rest.rpartition(".")
    if group == "tracking":
        return joints.get(name, UNKNOWN) if figure in ("peak", "rms") else "s"
    if group == "limits":
        return TORQUE.get(joints.get(rest, ""), UNKNOWN)
    if group == "energy":
        return "J"
    return {"saturated": "s", "period": "s", "delay": "s", "updates": "1"}.get(group, UNKNOWN)


def _of_joint(figure: str, unit: str) -> str:
    if figure in TORQUES:
        return TORQUE.get(unit, UNKNOWN)
    if figure in MOTIONS:
        return unit + MOTIONS[figure]
    return _by_last_step(figure)


def _by_last_step(key: str) -> str:
    last = key.rpartition(".")[2]
    if last.endswith("_deg") or ".angles_deg." in key:
        return "deg"
    if last.endswith("_relative") or key.startswith("counters."):
        return "1"
    if last.endswith(("time", "time_error", "duration", "duration_error")):
        return "s"
    return LAST.get(last, UNKNOWN)
