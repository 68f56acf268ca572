"""Inverse dynamics: what torques does this motion need."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import GROUPS, Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar, is_nonzero
from robodyn_cli.results.result import Result
from robodyn_cli.run.inverse.checks import DEFINITIONS, Sampled, beyond_limits, error_estimate, joint_figures
from robodyn_cli.run.inverse.dynamics import ForwardDynamics, InverseDynamics, joint_force_terms, open_problem
from robodyn_cli.run.inverse.motion import Planned, plan_motion, with_led_point
from robodyn_cli.run.observation.evaluation import SampleFunction, without_idle_unknowns
from robodyn_cli.run.observation.places import FORCES, add_places, place_outputs
from robodyn_cli.run.observation.reactions import add_reactions
from robodyn_cli.run.observation.units import joint_columns
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene

__all__ = ["ForwardDynamics", "InverseDynamics", "inverse"]

Array = NDArray[np.float64]


def inverse(
    scene: Scene,
    *,
    samples: int | None = None,
    progress: Progress = no_progress,
    watch: Stopwatch | None = None,
) -> Result:
    """Compute the joint torques that the scene's trajectory needs.

        tau = M qdd + C qd + G - tau_passive - tau_friction - tau_external

    ``tau`` (T, nv) is the actuators' torque [N m or N]; the terms are signed so that they sum to it.

    Parameters
    ----------
    samples : number of uniform samples; default: the scene's ``inverse.samples``.
    progress : told when the work is done; watch : adds up wall times by stage.

    Returns
    -------
    A Result with the contract's datasets (``docs/hdf5.md``); joints, residuals and errors in the summary.

    Raises
    ------
    SceneError : no trajectory, or data that the equations need is not given. CapabilityError : loops.
    GeometryError, SingularConfigurationError : from the inverse kinematics.
    """
    watch = watch or Stopwatch()
    count = scene.inverse.samples if samples is None else samples
    if count < 2:
        raise ValueError(f"samples: {count}; allowed: 2 or more")
    if scene.loops or scene.couplers:
        from robodyn_cli.run.inverse.closed import inverse_closed

        result = inverse_closed(scene, count, watch)
        progress(float(result.time[-1]), float(result.time[-1]))
        result.summary["wall_time_s"] = watch.report()
        return result
    with watch.stage("equations"):
        problem = open_problem(with_led_point(scene), "inverse dynamics")
        _check_actuated(problem)
    with watch.stage("solve"):
        duration = scene.trajectory.duration if scene.trajectory is not None else 0.0
        times = np.linspace(0.0, duration, count)
        planned = plan_motion(problem, times)
    with watch.stage("equations"):
        terms = torque_terms(problem)
        places = place_outputs(problem)
        function = SampleFunction({**terms, **energies(problem, terms), **places}, GROUPS, count)
    motion = planned.motion
    with watch.stage("evaluate"):
        arrays = function(t=times[:, None], q=motion.q, v=motion.qd, a=motion.qdd)
        sampled = Sampled(times, motion, {name: arrays[name] for name in terms}, arrays)
    result = Result("inverse", scene.title or "inverse", "ok", scene.text)
    fill(result, problem, sampled, planned)
    add_places(result, {path: arrays[path] for path in places})
    if planned.target is not None:
        result.add(f"targets/{planned.point}", _asked(planned, arrays[f"points/{planned.point}"]))
    with watch.stage("error_estimate"):
        _summarise(result, problem, sampled, planned, function)
    if scene.outputs.reactions:
        with watch.stage("evaluate"):
            add_reactions(result, problem, None)
    progress(float(times[-1]), float(times[-1]))
    result.summary["wall_time_s"] = watch.report()
    return result


def torque_terms(problem: Problem) -> dict[str, list[Scalar]]:
    """Return the parts of the actuator torque that the scene has, by name; their sum is the torque.

    Inertia is always there; any other part that vanishes identically is left out.
    """
    terms: dict[str, list[Scalar]] = {name: list(term) for name, term in problem.rigid_terms().items()}
    for name, term in joint_force_terms(problem).items():
        terms[name] = [-x for x in term]
    return {
        name: term for name, term in terms.items() if name == "inertia" or any(is_nonzero(x) for x in term)
    }


def _check_actuated(problem: Problem) -> None:
    """Refuse motion of joints that nothing drives: passive joints of an open chain follow no given path."""
    actuated = problem.scene.actuated
    passive = [n for n in problem.model.joint_names if actuated is not None and n not in actuated]
    if passive:
        raise CapabilityError(
            f"inverse dynamics needs every joint of an open chain to be actuated, and 'actuated' lacks "
            f"{passive[0]!r}; allowed: all of {', '.join(problem.model.joint_names)}"
        )


def energies(problem: Problem, terms: dict[str, list[Scalar]]) -> dict[str, list[Scalar]]:
    """Return the energies, the bias C qd + G, and the power of what dissipates.

    Data that no torque needs can only shift the level at which the potential energy is zero.
    """
    lost: Any = 0.0
    for place, torque in problem.losses(smooth=False):
        lost = lost + torque * problem.v[place]
    lost = lost + problem.elements.power
    found = {
        "kinetic": [problem.kinetic],
        "potential": [problem.potential],
        "dissipation": [lost],
        "bias": list(problem.bias),
    }
    if problem.model.forces:
        effects = problem.elements.effects
        found |= {
            "forces/potential": [e.potential for e in effects],
            "forces/power": [e.power for e in effects],
        }
    needed = [x for term in terms.values() for x in term]
    return {name: without_idle_unknowns(entries, needed) for name, entries in found.items()}


def fill(result: Result, problem: Problem, sampled: Sampled, planned: Planned) -> None:
    """Add time, motion, torques and energies."""
    model, motion = problem.model, sampled.motion
    columns = joint_columns(model)
    result.add("time", sampled.times)
    for path, data in (("q", motion.q), ("qd", motion.qd), ("qdd", motion.qdd), ("tau", sampled.tau)):
        result.add(path, data, **columns[path].described())
    for name, term in sampled.terms.items():
        result.add(f"torque_terms/{name}", term, **columns["tau"].described())
    kinetic, potential = sampled.arrays["kinetic"][:, 0], sampled.arrays["potential"][:, 0]
    result.add("energy/kinetic", kinetic)
    result.add("energy/potential", potential)
    result.add("energy/total", kinetic + potential)
    for path in FORCES:
        if path in sampled.arrays:
            result.add(path, sampled.arrays[path], names=problem.elements.names)


def _asked(planned: Planned, actual: Array) -> Array:
    """Return the target in three coordinates; what it leaves free is taken from the point itself."""
    assert planned.target is not None
    out = actual.copy()
    out[:, : planned.target.p.shape[1]] = planned.target.p
    return out


def begin_summary(result: Result, problem: Problem, sampled: Sampled) -> dict[str, Any]:
    """Return the summary with what every inverse run says first."""
    summary = result.summary
    summary["status"] = "ok"
    summary["termination"] = {"reason": "end of the trajectory", "time": float(sampled.times[-1])}
    summary["samples"] = len(sampled.times)
    if warnings := beyond_limits(problem, sampled.times, sampled.motion):
        summary["warnings"] = warnings
    return summary


def path_error(result: Result, point: str) -> float:
    """Return the largest distance [m] of a point from its target."""
    gap = result[f"points/{point}"] - result[f"targets/{point}"]
    return float(np.sqrt(np.einsum("ti,ti->t", gap, gap).max()))


def _summarise(
    result: Result, problem: Problem, sampled: Sampled, planned: Planned, function: SampleFunction
) -> None:
    summary = begin_summary(result, problem, sampled)
    if planned.target is not None:
        summary["inverse_kinematics"] = planned.method
        summary["ik_residual"] = path_error(result, str(planned.point))
    errors = error_estimate(problem, sampled)
    if "ik_residual" in summary:
        errors = {"ik_residual": summary["ik_residual"], **errors}
    summary["error_estimate"] = errors
    summary["round_trip"] = errors["round_trip"]
    summary["joints"] = joint_figures(problem.model, sampled)
    summary["definitions"] = DEFINITIONS
    summary["counters"] = {
        "operations": function.operations,
        "compiled": function.compiled,
        **planned.counters,
    }
