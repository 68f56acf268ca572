"""Inverse dynamics of mechanisms with loops: actuator torques and multipliers that a motion needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.problem import GROUPS, Problem
from robodyn_cli.errors import CapabilityError, RobodynError, SceneError, SingularConfigurationError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.model.model import Model
from robodyn_cli.results.result import Result
from robodyn_cli.run.driver.singularity import loop_rows
from robodyn_cli.run.inverse.checks import DEFINITIONS, Sampled, error_estimate, joint_figures
from robodyn_cli.run.inverse.inverse import begin_summary, energies, fill, path_error, torque_terms
from robodyn_cli.run.inverse.motion import Planned, with_led_point
from robodyn_cli.run.mechanism.guided_motion import GuidedMotion, guided_motion
from robodyn_cli.run.mechanism.loop_conditions import Lead, coordinate_name, lead_of, velocity_places
from robodyn_cli.run.observation.evaluation import SampleFunction
from robodyn_cli.run.observation.observe import loop_columns
from robodyn_cli.run.observation.places import add_places, place_outputs
from robodyn_cli.run.observation.reactions import add_reactions
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.load_sharing import LostRank, Shared, TooFewActuators, accelerations, share

Array = NDArray[np.float64]

CLOSED_DEFINITIONS = {
    **DEFINITIONS,
    "round_trip": "accelerations of forward dynamics with loops under the computed torques, relative",
    "virtual_work_residual": "what of the generalised force neither actuators nor loops hold [N m or N]",
}


def inverse_closed(scene: Scene, samples: int, watch: Stopwatch) -> Result:
    """Compute the actuator torques and the multipliers that the motion of a mechanism needs.

        B tau + Psi^T lambda = M qdd + h - tau_passive - tau_friction

    The motion is that of the joints or of the point in ``trajectory``, or of prescribed joints; the loops decide
    about the other joints, at position, velocity and acceleration level.

    Returns
    -------
    A Result with the datasets of ``inverse`` and the multipliers of the loops. Torques are zero in joints without
    an actuator; where there are more actuators than degrees of freedom they are of least norm, and so are
    multipliers of redundant rows.

    Raises
    ------
    SceneError : no motion. CapabilityError : motion or actuators do not suffice. GeometryError : the motion cannot
    be met. SingularConfigurationError : a dead point of the motion or of the actuators on the way.
    """
    with watch.stage("equations"):
        problem = Problem(with_led_point(scene))
        refuse_gears(problem)
        lead = lead_of(problem)
        duration = motion_duration(scene)
        actuated = actuated_joints(problem, lead)
    with watch.stage("solve"):
        guided = guided_motion(problem, lead, np.linspace(0.0, duration, samples))
        if guided.stopped is not None:
            raise guided.stopped
    with watch.stage("equations"):
        rows = [problem.constraints.rows[i] for i in loop_rows(problem)]
        terms = torque_terms(problem)
        places = place_outputs(problem)
        psi = [x for row in rows for x in row.psi]
        more = {
            "psi": psi, "gamma": [row.gamma for row in rows], "M": list(problem.mass_matrix.ravel()),
            "eta": [row.eta for row in rows], "eta_t": [row.eta_t for row in rows],
        }  # fmt: skip
        more = {name: entries for name, entries in more.items() if entries}
        function = SampleFunction({**terms, **energies(problem, terms), **more, **places}, GROUPS, samples)
    motion = guided.motion
    with watch.stage("evaluate"):
        arrays = function(t=guided.times[:, None], q=motion.q, v=motion.qd, a=motion.qdd)
        nv = problem.model.nv
        Psi = arrays["psi"].reshape(samples, len(rows), nv)
        places_of = velocity_places(problem.model, actuated)
        shared = _share(problem, guided, Psi, places_of, {name: arrays[name] for name in terms})
        # closures to a ground that moves do work at the rate -lambda eta_t
        arrays["dissipation"] = (
            arrays["dissipation"] - (shared.multipliers * arrays["eta_t"]).sum(axis=1)[:, None]
        )
        sampled = Sampled(guided.times, motion, shared.terms, arrays)
    result = Result("inverse", scene.title or "inverse", "ok", scene.text)
    planned = Planned(motion, lead.point, method="newton" if lead.point else None)
    fill(result, problem, sampled, planned)
    kept = [row.name for row in rows]
    described = loop_columns(rows)
    for path, data in (
        ("constraints/multipliers", shared.multipliers),
        ("constraints/position_residual", arrays["eta"]),
        ("constraints/velocity_residual", np.einsum("tmv,tv->tm", Psi, motion.qd) + arrays["eta_t"]),
    ):
        column = described[path]
        result.add(path, data, units=column.units, long_name=column.long_name, names=kept)
    result.add("singularity/psi", np.linalg.svd(Psi, compute_uv=False))
    add_places(result, {path: arrays[path] for path in places})
    if lead.point is not None:
        asked = arrays[f"points/{lead.point}"].copy()
        asked[:, : lead.components] = lead.asked(guided.times)[0]
        result.add(f"targets/{lead.point}", asked)
    with watch.stage("error_estimate"):
        trip = _round_trip(sampled, Psi, arrays)
        _summarise(result, problem, sampled, guided, shared, actuated, trip)
    if scene.outputs.reactions:
        with watch.stage("evaluate"):
            add_reactions(result, problem, _all_rows(problem, shared.multipliers))
    return result


def needed_data(scene: Scene, samples: int) -> tuple[Model, list[Scalar]]:
    """Return the model and the expressions that the torques need, once the motion has been tried out.

    Raises
    ------
    RobodynError : as ``inverse_closed``, but for what depends on the torques.
    """
    problem = Problem(with_led_point(scene))
    lead = lead_of(problem)
    times = np.linspace(0.0, motion_duration(scene), samples)
    actuated_joints(problem, lead)
    guided = guided_motion(problem, lead, times)
    if guided.stopped is not None:
        raise guided.stopped
    return problem.model, [x for term in torque_terms(problem).values() for x in term]


def refuse_gears(problem: Problem) -> None:
    """Refuse losses that depend on the load of a drive: loops share the load, and they would decide about the share.

    Raises
    ------
    CapabilityError
    """
    if geared(problem.model):
        raise CapabilityError(
            "losses in gears depend on the load of each drive, and with closed loops that load depends on the losses; "
            "allowed here: friction in the joints"
        )


def motion_duration(scene: Scene) -> float:
    """Return the length of the motion: of the trajectory, else of the simulation, where joints are prescribed.

    Raises
    ------
    SceneError : nothing moves.
    """
    if scene.trajectory is not None:
        return float(scene.trajectory.duration)
    if scene.prescribed:
        return scene.simulate.duration
    raise SceneError(
        f"{scene.path}: key 'trajectory' is missing: inverse dynamics needs a motion, of as many joints as the "
        "mechanism has degrees of freedom (kinds: joint, quintic, table), or of a point (circle, cartesian); or "
        "prescribe joints",
        key="trajectory",
    )


def actuated_joints(problem: Problem, lead: Lead) -> tuple[str, ...]:
    """Return the joints that have an actuator: ``actuated``, else those that are led or have torques.

    Raises
    ------
    SceneError : a point is led and nothing says what drives.
    """
    scene = problem.scene
    if scene.actuated is not None:
        return scene.actuated
    led = (*lead.joints, *(scene.prescribed or {}))
    found = tuple(dict.fromkeys(led if led else (scene.torques or {})))
    if not found:
        raise SceneError(
            f"{scene.path}: a point is led, so the scene must say which joints drive the mechanism: key 'actuated'",
            key="actuated",
        )
    return found


def _share(
    problem: Problem, guided: GuidedMotion, psi: Array, actuated: list[int], needed: dict[str, Array]
) -> Shared:
    try:
        return share(psi, actuated, needed)
    except TooFewActuators as few:
        names = ", ".join(coordinate_name(problem.model, k) for k in actuated)
        raise CapabilityError(
            f"the mechanism has {few.freedom} degrees of freedom, and its actuated joints ({names}) command "
            f"{few.commanded} of them anywhere; allowed: as many independent ones, in 'actuated'"
        ) from None
    except LostRank as lost:
        raise lost_rank(problem, lost, guided.times, guided.motion.q) from None


def lost_rank(problem: Problem, lost: LostRank, times: Array, q: Array) -> RobodynError:
    """Return the error of a sample at which loops or actuators lose their hold, with loop and joint."""
    time, where = float(times[lost.sample]), q[lost.sample].tolist()
    worst = int(np.argmax(lost.weights))
    if lost.what == "actuators":
        joint = coordinate_name(problem.model, worst)
        when = f"at t = {time:.9g} s"
        if lost.passed:
            when = f"between t = {time:.9g} s and {float(times[lost.sample + 1]):.9g} s"
        return SingularConfigurationError(
            f"dead point of the actuators {when}: joint {joint} moves without them, so no finite torques "
            "give it the acceleration asked for; actuate another joint, or more",
            time=time, kind="dead_point", joint=joint, q=where,
        )  # fmt: skip
    row = problem.constraints.rows[loop_rows(problem)[worst]].name
    return SingularConfigurationError(
        f"bifurcation at t = {time:.9g} s: the rows of loop {row.rsplit('.', 1)[0]} lose rank there ({row}), so the "
        "multipliers are not unique and the mechanism may go on in more than one way",
        time=time, kind="bifurcation", loop=row.rsplit(".", 1)[0], row=row, q=where,
    )  # fmt: skip


def _round_trip(sampled: Sampled, psi: Array, arrays: dict[str, Array]) -> float:
    """Return the relative difference between forward dynamics under the torques and the accelerations asked for.

    Forward dynamics solves for the free motion with M and h, which the torques did not use.
    """
    force = sampled.tau - arrays["bias"]
    for name in sampled.terms:
        if name not in ("inertia", "coriolis", "gravity"):
            force = force - arrays[name]
    nv = force.shape[1]
    M = arrays["M"].reshape(-1, nv, nv)
    found = accelerations(M, force, psi, arrays.get("gamma", np.zeros((len(M), 0))))
    loose = accelerations(M, -arrays["bias"], psi, np.zeros(psi.shape[:2]))
    asked = sampled.motion.qdd
    scale = max(float(np.abs(asked).max()), float(np.abs(loose).max()))
    error = float(np.abs(found - asked).max())
    return error / scale if error else 0.0


def _summarise(
    result: Result,
    problem: Problem,
    sampled: Sampled,
    guided: GuidedMotion,
    shared: Shared,
    actuated: tuple[str, ...],
    trip: float,
) -> None:
    summary = begin_summary(result, problem, sampled)
    summary["mechanism"] = {
        "degrees_of_freedom": shared.freedom,
        "actuated": list(actuated),
        "torques": "unique"
        if shared.unique_torques
        else "least norm: more actuators than degrees of freedom",
        "multipliers": "unique" if shared.unique_multipliers else "least norm: redundant rows",
    }
    if any(path.startswith("targets/") for path in result.variables):
        summary["inverse_kinematics"] = "newton"
        name = next(iter(result.group("targets")))
        summary["ik_residual"] = path_error(result, name)
    estimate = error_estimate(problem, sampled, trip)
    estimate["closure"] = guided.residuals
    estimate["virtual_work_residual"] = shared.residual
    summary["error_estimate"] = estimate
    summary["round_trip"] = trip
    summary["constraint_residual"] = {key: guided.residuals[key] for key in ("position", "velocity")}
    figures = joint_figures(problem.model, sampled)
    driven = [problem.model.v_names[k] for k in velocity_places(problem.model, actuated)]
    summary["joints"] = {name: figures[name] for name in driven}
    summary["definitions"] = CLOSED_DEFINITIONS
    summary["counters"] = guided.counters


def _all_rows(problem: Problem, lam: Array) -> Array:
    """Return multipliers of all rows: those of prescribed joints are torques of their actuators here."""
    out = np.zeros((len(lam), len(problem.constraints.rows)))
    out[:, loop_rows(problem)] = lam
    return out
