"""The figures of an inverse run, and how far they can be trusted."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.forces.limits import Limits
from robodyn_cli.model.model import Model
from robodyn_cli.record import record
from robodyn_cli.run.observation.evaluation import SampleFunction, without_idle_unknowns
from robodyn_cli.run.observation.quadrature import integrate, integrate_positive, mean_square
from robodyn_cli.trajectories.motion import JointMotion

Array = NDArray[np.float64]


RIGID = ("inertia", "coriolis", "gravity")

# what the figures of the summary mean, for readers of the file alone
DEFINITIONS = {
    "peak_torque": "largest magnitude among the samples",
    "rms_torque": "root of the time average of the squared torque",
    "energy": "integral of the positive mechanical power: what the actuator delivers if it takes none back",
    "energy_net": "integral of the mechanical power",
    "integrals": "polynomials of degree 5 through the samples",
    "round_trip": "accelerations of forward after inverse dynamics, difference over the largest",
    "energy_balance": "work of actuators and losses less the change of kinetic and potential energy [J]",
    "energy_quadrature": "largest change of an energy when every second sample is left out [J]",
}


@record
class Sampled:
    """A motion at uniform times with its torque terms (T, nv) and whatever else was evaluated along it."""

    times: Array
    motion: JointMotion
    terms: Mapping[str, Array]
    arrays: Mapping[str, Array]

    @cached_property
    def tau(self) -> Array:
        """Actuator torques (T, nv): the sum of the terms [N m or N]."""
        first, *others = self.terms.values()
        total = first.copy(order="F")
        for term in others:
            total += term
        return total

    @cached_property
    def power(self) -> Array:
        """Mechanical power of each actuator (T, nv) [W]."""
        return self.tau * self.motion.qd

    @property
    def step(self) -> float:
        """Time between samples [s]."""
        return float(self.times[1] - self.times[0])


def joint_figures(model: Model, sampled: Sampled) -> dict[str, dict[str, Any]]:
    """Return what sizes the actuators, by joint.

    peak_torque : largest magnitude among the samples, and its time. rms_torque : root of the time average of
    tau^2.
    energy : integral of the positive mechanical power, what the actuator delivers if it cannot take back any;
    energy_net : integral of the power. Integrals are of degree 5 between samples (see ``quadrature``).
    """
    h, tau, power = sampled.step, sampled.tau, sampled.power
    rms = np.sqrt(np.maximum(0.0, mean_square(tau, h)))
    delivered, net = integrate_positive(power, h), integrate(power, h)
    figures: dict[str, dict[str, Any]] = {}
    for k, (name, unit) in enumerate(zip(model.v_names, model.v_units)):
        at = int(np.argmax(np.abs(tau[:, k])))
        figures[name] = {
            "peak_torque": float(np.abs(tau[at, k])),
            "peak_torque_time": float(sampled.times[at]),
            "rms_torque": float(rms[k]),
            "torque_range": [float(tau[:, k].min()), float(tau[:, k].max())],
            "peak_speed": float(np.abs(sampled.motion.qd[:, k]).max()),
            "peak_power": float(np.abs(power[:, k]).max()),
            "energy": float(delivered[k]),
            "energy_net": float(net[k]),
            "units": {
                "torque": "N m" if unit == "rad" else "N", "speed": f"{unit}/s", "power": "W", "energy": "J"
            },
        }  # fmt: skip
    return figures


def beyond_limits(problem: Problem, times: Array, motion: JointMotion) -> list[str]:
    """Return a warning for each joint that the motion takes beyond its limits.

    A compliant stop has its torque there, a rigid one is passed as if it were not.
    """
    model, found = problem.model, []
    for joint in problem.scene.robot.joints:
        limits = next((force for _, force in joint.forces if isinstance(force, Limits)), None)
        if limits is None or joint.name not in model.q_names:
            continue
        column = model.q_names.index(joint.name)
        q, unit = motion.q[:, column], model.q_units[column]
        what = "its rigid stop is ignored" if limits.rigid else "the torques press on its stop"
        for side, limit, over in (
            ("lower", limits.lower, None if limits.lower is None else limits.lower - q),
            ("upper", limits.upper, None if limits.upper is None else q - limits.upper),
        ):
            if over is not None and over.max() > 1e-12 * max(1.0, abs(limit or 0.0)):
                at = int(np.argmax(over))
                found.append(
                    f"the motion leaves the limits of joint {joint.name!r}: {q[at]:.6g} {unit} "
                    f"at t = {times[at]:.6g} s, {side} {limit:.6g} {unit}; {what}"
                )
    return found


def error_estimate(problem: Problem, sampled: Sampled, trip: float | None = None) -> dict[str, Any]:
    """Return the errors of an inverse run.

    round_trip : accelerations from forward dynamics under the computed torques, less those asked for, over
    the
        largest acceleration among those asked for and those that the bias alone would cause; None where the
        mass matrix is singular.
    energy_balance : work of actuators and losses, less the change of kinetic and potential energy [J]; it is
    as
        large as the errors of rates, torques and quadrature together. energy_balance_relative : over the
        largest energy turned over.
    energy_quadrature : difference of the energies (net) to those from every second sample [J].

    Parameters
    ----------
    trip : the round trip where it is known already (mechanisms with loops).
    """
    power = np.column_stack([sampled.power, sampled.arrays["dissipation"]])
    work = integrate(power, sampled.step)
    total = sampled.arrays["kinetic"][:, 0] + sampled.arrays["potential"][:, 0]
    balance = float(work.sum() - (total[-1] - total[0]))
    turned = max(float(np.ptp(total)), float(integrate(np.abs(power), sampled.step).max()), 1e-300)
    found: dict[str, Any] = {
        "round_trip": round_trip(problem, sampled) if trip is None else trip,
        "energy_balance": balance,
        "energy_balance_relative": balance / turned if balance else 0.0,
    }
    if len(sampled.times) % 2 and len(sampled.times) > 2:
        half = integrate(power[::2], 2.0 * sampled.step)
        found["energy_quadrature"] = float(np.abs(half - work).max())
    return found


def round_trip(problem: Problem, sampled: Sampled) -> float | None:
    """Return the relative residual of forward after inverse dynamics (see ``error_estimate``)."""
    bias, asked = sampled.arrays["bias"], sampled.motion.qdd
    f = sampled.tau - bias
    for name, term in sampled.terms.items():
        if name not in RIGID:
            f = f - term
    q = np.concatenate([sampled.motion.q] * 2)
    forces = problem.graph.symbols(problem.model.v_names, "f")
    try:
        a = list(problem.free_accelerations(forces))
    except ZeroDivisionError:
        return None
    # unknown data that cancels in M may stand in articulated inertias
    a = without_idle_unknowns(a, list(problem.mass_matrix.flat))
    function = SampleFunction({"a": a}, ("q", "f"), len(q))
    with np.errstate(all="ignore"):
        found, loose = np.split(function(q=q, f=np.concatenate([f, bias]))["a"], 2)
    scale = max(float(np.abs(asked).max()), float(np.abs(loose).max()))
    residual = float(np.abs(found - asked).max())
    if not np.isfinite(residual) or not np.isfinite(scale):
        return None
    return residual / scale if residual else 0.0
