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
    "driving": "J", "braking": "J", "driving_power": "W", "braking_power": "W", "driving_energy": "J",
    "braking_energy": "J", "regenerated": "J", "copper_loss": "J", "friction_loss": "J", "gear_loss": "J",
    "peak_current": "A", "rms_current": "A", "margin": "1", "least_margin": "1", "use": "1", "ratio": "1", "mass": "kg",
}  # fmt: skip
WINDING = "degC"


def unit_of_output(key: str, model: Model) -> str:
    """Return the unit of a key of a summary: ``N m`` of ``peak_torque.theta1``; ``UNKNOWN`` where none is known."""
    joints = {**dict(zip(model.v_names, model.v_units)), **dict(zip(model.q_names, model.q_units))}
    for head, power in STATES.items():
        if key.startswith(f"{head}.") and (unit := joints.get(key.removeprefix(f"{head}."))):
            return unit + power if unit != "1" or not power else UNKNOWN
    section, _, rest = key.partition(".")
    if section == "torques_of_joints":
        return TORQUE.get(joints.get(rest, ""), UNKNOWN)
    if section == "singular_ratio":
        return "s" if rest == "time" else "1"
    if section in ("drives", "control"):
        return _of_joint_in(section, rest, joints)
    figure, _, name = key.partition(".")
    if figure == "joints":
        name, _, figure = name.rpartition(".")
    if name in joints:
        return _of_joint(figure, joints[name])
    return _by_last_step(key)


def _of_joint_in(section: str, key: str, joints: dict[str, str]) -> str:
    """Return the unit of a key below ``drives.JOINT`` or ``control``."""
    *path, last = key.split(".")
    unit = next((joints[step] for step in (*path, last) if step in joints), "")
    if section == "drives":
        if "winding" in path:
            return WINDING
        side = "rad" if "shaft" in path else unit  # a motor turns whatever its joint does
        return _of_joint(last.replace("mean_torque", "rms_torque"), side)
    if path[:1] == ["tracking"]:
        return "s" if last == "at" else unit or "m"
    if path[:1] == ["limits"]:
        return TORQUE.get(unit, UNKNOWN)
    return "s" if path[:1] == ["saturated"] or last in ("period", "delay") else _by_last_step(last)


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
