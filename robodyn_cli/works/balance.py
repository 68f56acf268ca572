"""What a known motion does to its foundation and to the shaft of its driver: shaking force and moment, a flywheel."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import motions
from robodyn_cli.algorithms.reactions import reactions
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.model.model import MOTION_GROUPS, are_known
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.observe.reactions import NAMES
from robodyn_cli.results.result import Result
from robodyn_cli.solve.extremes import largest, root_mean_square, smallest
from robodyn_cli.solve.quadrature import running
from robodyn_cli.spatial.algebra import Array, cross, zeros
from robodyn_cli.summaries.design import (
    BalanceKeys,
    FlywheelErrors,
    FlywheelFigures,
    ShakingErrors,
    ShakingFigures,
)
from robodyn_cli.summaries.facts import ABSENT, Absent
from robodyn_cli.torques.checks import breaks_of
from robodyn_cli.torques.program import InverseProgram, Sampled
from robodyn_cli.trajectories.motion import JointMotion

CONSTANT = 1e-8  # part of a rate by which it may vary and counts as constant
WHOLE = 1e-8  # turns: so near to a whole number of them a motion is a cycle
KEY = "inverse.flywheel.joint"


def with_balance(
    records: list[Any], result: Result, program: InverseProgram, sampled: Sampled, looked: Sampled
) -> list[Any]:
    """Return the records of a summary with those of shaking forces and of a flywheel; add their datasets.

    sampled, looked : the motion at the samples, and where figures are looked at.
    """
    scene = program.problem.scene
    breaks = breaks_of(program.problem, looked.times, looked.motion)
    shaking: ShakingFigures | Absent = ABSENT
    flywheel: FlywheelFigures | Absent = ABSENT
    if scene.inverse.shaking is not None:
        of = Shaking(program.problem, scene.inverse.shaking, len(looked.times))
        result.add("shaking", of(sampled), names=of.names)
        shaking = of.figures(looked, breaks)
    if scene.inverse.flywheel is not None:
        wheel = Wheel(program.problem, len(looked.times))
        flywheel = wheel.figures(looked, breaks)
        own = breaks_of(program.problem, sampled.times, sampled.motion)
        result.add("flywheel/torque", sampled.tau[:, wheel.k])
        result.add("flywheel/energy", wheel.energy(sampled, own)[0])
    return [*records, BalanceKeys(shaking, flywheel)]


class Shaking:
    """Shaking force and moment about a point of the base: less the rates of momentum of the links,

        F = -d/dt sum m v,        M = -d/dt sum (c x m v + I w)

    which are what the base bears beside weights and given forces. Rotors count as masses alone.

    Components that depend on data which the scene does not give are left out; ``missing`` names them.
    """

    def __init__(self, problem: Problem, about: str, samples: int) -> None:
        model, self.about = problem.model, about
        motion = motions(model, problem.X, problem.q, problem.v, problem.a)
        inertial = reactions(model, problem.X, motion, {}).base.rotated(model.base.E.T)
        # about the point, from about the base's origin
        arm = problem.world_point(model.points[about]) - model.base.point(zeros(3))
        entries: list[Scalar] = [*(-inertial.f), *(-(inertial.n - cross(arm, inertial.f)))]
        known = are_known(entries)
        self.names = tuple(name for name, given in zip(NAMES, known) if given)
        self.missing = [name for name in NAMES if name not in self.names]
        chosen = [x for x, given in zip(entries, known) if given]
        self.function = SampleFunction({"shaking": chosen}, MOTION_GROUPS, samples)

    def __call__(self, sampled: Sampled) -> Array:
        """Return the components (T, n) along a motion."""
        return self.function.along(sampled.times, sampled.motion, sampled.p)["shaking"]

    def figures(self, sampled: Sampled, breaks: list[float]) -> ShakingFigures:
        """Return the figures along a motion; breaks : where loads jump, in steps from the first sample."""
        data = self(sampled)
        found: dict[str, Any] = {}
        errors = dict.fromkeys((f"{kind}_{x}" for x in ("force", "moment") for kind in ("peak", "rms")), 0.0)
        errors |= {"peak_force_time": 0.0, "peak_moment_time": 0.0}
        for letter, name in (("f", "force"), ("m", "moment")):
            columns = [k for k, one in enumerate(self.names) if one[0] == letter]
            if not columns:
                found |= dict.fromkeys((f"peak_{name}", f"peak_{name}_time", f"rms_{name}"), ABSENT)
                continue
            square = (data[:, columns] ** 2).sum(axis=1)[:, None]
            peak = largest(sampled.times, square, breaks)
            size, off = _root(float(peak.value[0]), float(peak.error[0]))
            rms, rms_off = root_mean_square(sampled.times, np.sqrt(square), breaks)
            rounded = 1e-12 * size  # what motion in loops is closed to
            found |= {
                f"peak_{name}": size,
                f"peak_{name}_time": float(peak.time[0]),
                f"rms_{name}": float(rms[0]),
            }
            errors |= {
                f"peak_{name}": off + rounded,
                f"peak_{name}_time": float(peak.time_error[0]),
                f"rms_{name}": float(rms_off[0]) + rounded,
            }
        return ShakingFigures(
            self.about, **found, not_determined=self.missing or ABSENT, errors=ShakingErrors(**errors)
        )


def _root(square: float, error: float) -> tuple[float, float]:
    """Return a length from its square, and its error."""
    root, most = math.sqrt(max(square, 0.0)), math.sqrt(max(square + error, 0.0))
    return root, max(most - root, root - math.sqrt(max(square - error, 0.0)))


def refuse_flywheel(problem: Problem, motion: JointMotion) -> None:
    """Refuse a motion in which a flywheel has no meaning.

    Raises
    ------
    CapabilityError : its joint does not turn at a constant rate, by whole turns, or bears no torque.
    """
    wheel, model = problem.scene.inverse.flywheel, problem.model
    assert wheel is not None
    joint, where, what = wheel.joint, (problem.scene.path, KEY), f"joint {wheel.joint!r}"
    k = model.v_names.index(joint)
    if model.v_units[k] != "rad":
        raise CapabilityError(f"{what} slides; allowed: one that turns", where, key=KEY)
    actuated = problem.scene.actuated
    if (model.closures or actuated is not None) and joint not in (actuated or problem.scene.torques or ()):
        raise CapabilityError(f"{what} bears no torque; allowed: one in 'actuated'", where, key=KEY)
    rate, q = motion.qd[:, k], motion.q[:, model.q_names.index(joint)]
    mean = float(rate.mean())
    if mean == 0.0 or float(np.ptp(rate)) > CONSTANT * abs(mean):
        raise CapabilityError(
            f"{what} turns at {rate.min():.6g} to {rate.max():.6g} rad/s; a flywheel follows from a motion in "
            "which it turns at a constant rate",
            where,
            key=KEY,
        )
    turns = abs(float(q[-1] - q[0])) / (2.0 * math.pi)
    if round(turns) < 1 or abs(turns - round(turns)) > WHOLE:
        raise CapabilityError(
            f"{what} makes {turns:.9g} turns; a flywheel follows from a cycle, of one or several whole turns",
            where,
            key=KEY,
        )
    gap = np.abs(motion.qd[-1] - motion.qd[0]).max() / max(float(np.abs(motion.qd).max()), 1e-300)
    if gap > 1e2 * WHOLE:
        raise CapabilityError(
            f"{what}: the motion is no cycle, since its rates at the end are not those of the beginning",
            where,
            key=KEY,
        )


class Wheel:
    """The flywheel that a scene asks for.

    E(t) = int (P - mean P) dt,        J = (max E - min E) / (C w^2) - mean 2 T / w^2

    function : kinetic energy T; None where it depends on data that the scene does not give.
    """

    def __init__(self, problem: Problem, samples: int) -> None:
        assert problem.scene.inverse.flywheel is not None
        self.problem, self.asked = problem, problem.scene.inverse.flywheel
        self.k = problem.model.v_names.index(self.asked.joint)
        self.function: SampleFunction | None = None
        if are_known([problem.kinetic])[0]:
            self.function = SampleFunction({"kinetic": [problem.kinetic]}, MOTION_GROUPS, samples)

    def energy(self, sampled: Sampled, breaks: list[float]) -> tuple[Array, float, float]:
        """Return the energy (T,) that the flywheel gives, the work of the whole motion, and the error of both."""
        times, power = sampled.times, sampled.tau[:, self.k] * sampled.motion.qd[:, self.k]
        work, off = running(times, power, breaks)
        given: Array = work - work[-1] * (times - times[0]) / (times[-1] - times[0])
        return given, float(work[-1]), off

    def figures(self, sampled: Sampled, breaks: list[float]) -> FlywheelFigures:
        """Return the figures along a motion; breaks : where loads jump, in steps from the first sample.

        Raises
        ------
        CapabilityError : the motion is no cycle at a constant rate (``refuse_flywheel``).
        """
        refuse_flywheel(self.problem, sampled.motion)
        times, tau, rate = sampled.times, sampled.tau[:, self.k], sampled.motion.qd[:, self.k]
        given, work, off = self.energy(sampled, breaks)
        duration, w = float(times[-1] - times[0]), float(rate.mean())
        most, least = (find(times, given[:, None], breaks) for find in (largest, smallest))
        energy = float(most.value[0] - least.value[0])
        rounded = 1e-12 * float(np.abs(tau * rate).max()) * duration
        error = float(most.error[0] + least.error[0]) + 2.0 * off + rounded
        square = self.asked.fluctuation * w * w
        whole, own = energy / square, self._own_inertia(sampled, breaks, w)
        less, less_error = (0.0, 0.0) if own is None else own
        return FlywheelFigures(
            joint=self.asked.joint,
            rate=w,
            inertia=max(0.0, whole - less),
            whole_inertia=whole,
            own_inertia=ABSENT if own is None else less,
            energy=energy,
            mean_torque=work / (duration * w),
            fullest_time=float(least.time[0]),
            emptiest_time=float(most.time[0]),
            errors=FlywheelErrors(
                inertia=error / square + less_error,
                whole_inertia=error / square,
                own_inertia=ABSENT if own is None else less_error,
                energy=error,
                mean_torque=(off + rounded) / (duration * abs(w)),
                fullest_time=float(least.time_error[0]),
                emptiest_time=float(most.time_error[0]),
            ),
        )

    def _own_inertia(self, sampled: Sampled, breaks: list[float], rate: float) -> tuple[float, float] | None:
        """Return the mean inertia of the mechanism reduced to a joint with a constant rate [kg m^2], and its error."""
        if self.function is None:
            return None
        kinetic = self.function.along(sampled.times, sampled.motion, sampled.p)["kinetic"][:, 0]
        integral, off = running(sampled.times, kinetic, breaks)
        duration = float(sampled.times[-1] - sampled.times[0])
        most = off + 1e-12 * duration * float(kinetic.max())
        return 2.0 * float(integral[-1]) / (duration * rate**2), 2.0 * most / (duration * rate**2)
