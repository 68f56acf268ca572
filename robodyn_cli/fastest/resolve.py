"""From a path that is to be run through as fast as the drives allow to a motion in time, and which of its limits binds
when."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from robodyn_cli.equations.gears import geared
from robodyn_cli.errors import CapabilityError, GeometryError
from robodyn_cli.expr.graph import is_nonzero
from robodyn_cli.fastest.limits import LimitedPath, PathBounds, PathLimits, Torques
from robodyn_cli.fastest.profile import NoProfile
from robodyn_cli.fastest.search import Fastest, fastest, merged
from robodyn_cli.given.along import motion_along, motion_at
from robodyn_cli.given.motion import led_by
from robodyn_cli.model.model import Model
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.spans import use_of
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.inverse import FastestFigures
from robodyn_cli.torques.build import build_inverse
from robodyn_cli.torques.closed import ClosedLoops, ClosedTorques
from robodyn_cli.torques.program import InverseProgram, Sampled
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.trajectories.fastest import (
    BOUNDS,
    FastestTrajectory,
    TimedJoints,
    TimedPath,
    names_of,
    timed,
)
from robodyn_cli.trajectories.legs import Scaling
from robodyn_cli.trajectories.motion import JointMotion

BINDS = 1e-3  # of a limit: as near to it the motion is on it


def use_of_limits(scaling: Scaling, model: Model, sampled: Sampled) -> tuple[list[str], Array]:
    """Return the names of the limits, ``joint kind``, and how much of each is used (T, n), 1 on the limit."""
    limits = names_of(scaling.limits, model.v_names)
    values = {"speed": sampled.motion.qd, "acceleration": sampled.motion.qdd, "effort": sampled.tau}
    columns = [
        use_of(values[kind][:, model.v_names.index(name)], scaling.limits[kind][name])
        for kind, name in limits
    ]
    return [f"{name} {kind}" for kind, name in limits], np.column_stack(columns)


def add_limits(result: Result, scaling: Scaling, model: Model, sampled: Sampled) -> None:
    """Add the use of each limit, and the limit that binds at each sample, -1 where none does."""
    names, use = use_of_limits(scaling, model, sampled)
    result.add("limits/use", use, names=names)
    result.add("limits/binding", _binding(use))


def _binding(use: Array) -> Array:
    return np.where(use.max(axis=1) >= 1.0 - BINDS, use.argmax(axis=1), -1).astype(float)


def warnings(scaling: Scaling) -> list[str]:
    """Return what is to be said of a duration that is less exact than was asked for."""
    relative = scaling.error / scaling.law.duration
    if scaling.tolerance is None or relative <= scaling.tolerance:
        return []
    return [
        f"the least time is known to {relative:.1e} of it only, with {scaling.intervals} intervals of the path; "
        f"trajectory.tolerance asks for {scaling.tolerance:.1e}"
    ]


def figures(scaling: Scaling, model: Model, sampled: Sampled) -> FastestFigures:
    """Return the figures of a motion."""
    names, use = use_of_limits(scaling, model, sampled)
    binding = _binding(use)
    duration, steps = scaling.law.duration, np.diff(sampled.times)
    share = np.append(steps, 0.0) + np.append(
        0.0, steps
    )  # half of the time to the samples on both sides, twice
    parts = {name: float(share[binding == k].sum()) / (2.0 * duration) for k, name in enumerate(names)}
    unlike = np.where(binding[1:] != binding[:-1], 0.5 * steps, 0.0)
    off = [unlike[(binding[1:] == k) | (binding[:-1] == k)].sum() for k in range(len(names))]
    return FastestFigures(
        duration=duration,
        duration_error=scaling.error,
        largest_use=float(use.max()),
        binding={name: x for name, x in parts.items() if x > 0.0},
        binding_error=float(max(off) + 0.5 * steps.max()) / duration,
        intervals=scaling.intervals,
    )


SAME = 1e-6  # s, up to which a payload that changes at the end of a way counts as changing there
STILL = 1e-6  # of the largest |dq/ds|: the path stands still
CORNER = 1e-6  # of it: the direction jumps
BISECTIONS = 45
LOOKS = 200  # intervals in which corners and turns are looked for


def timed_path(scene: Scene, trajectory: FastestTrajectory, begin: float = 0.0) -> TimedJoints | TimedPath:
    """Return a path in the least time as a motion in time of the scene's joints, or of a point.

    begin : when it begins [s], which decides about the payloads that are carried.

    Raises
    ------
    CapabilityError : forces depend on time or load, or a payload comes or goes on the way. GeometryError : no motion on
    the path keeps to the limits, or it stands still or turns a corner on the way. Others as the inverse kinematics and
    ``build_inverse`` raise.
    """
    program = build_inverse(led_by(with_payloads_at(scene, begin), trajectory.way))
    path = limited_path(trajectory, program)
    fixed = special_points(trajectory, program, path)
    timing = fastest_on(path, trajectory, fixed, program)
    limits = {name: dict(getattr(trajectory, name)) for name in BOUNDS}
    tolerance = trajectory.tolerance if trajectory.intervals is None else None
    scaling = Scaling(timing.law, timing.error, limits, len(timing.s) - 1, tolerance)
    result = timed(trajectory.way, scaling)
    for payload in scene.payloads:
        for key, instant in payload.instants.items():
            if instant.time is not None and begin + SAME < instant.time < begin + result.duration - SAME:
                raise CapabilityError(
                    f"payload {payload.name!r} changes at {instant.time:.9g} s ({key!r}), on a way in the least time "
                    f"from {begin:.9g} s to {begin + result.duration:.9g} s; allowed: times outside of it, while the "
                    "motion rests or between two segments"
                )
    return result


def with_payloads_at(scene: Scene, time: float) -> Scene:
    """Return the scene with what is carried from a time on [s], as if it stayed so.

    Raises
    ------
    CapabilityError : an event decides whether a payload is carried.
    """
    carried = []
    for payload in scene.payloads:
        times = {key: instant.time for key, instant in payload.instants.items()}
        if None in times.values():
            raise CapabilityError(
                f"payload {payload.name!r} is gripped or released by an event, which the times that 'fastest' chooses "
                "would move; allowed there: 'time'"
            )
        if (times.get("from") or 0.0) <= time + SAME and (times.get("until") or np.inf) > time + SAME:
            carried.append(dataclasses.replace(payload, start=None, until=None))
    return dataclasses.replace(scene, payloads=tuple(carried)) if scene.payloads else scene


def limited_path(trajectory: FastestTrajectory, program: InverseProgram) -> LimitedPath:
    """Return the path, and what limits the motion on it."""
    model = program.problem.model
    ik = trajectory.way.ik
    if ik is not None and ik.redundancy != "least_rates":
        raise CapabilityError(
            f"trajectory.path.ik.redundancy ({ik.redundancy}) makes the path depend on its times, which 'fastest' "
            "chooses; allowed there: least_rates"
        )
    limits = [PathBounds.of(getattr(trajectory, kind), model.v_names) for kind in BOUNDS]
    torques = _torques_of(program)
    return LimitedPath(_path_of(program), torques, *limits)


def _path_of(program: InverseProgram) -> Callable[[Array], JointMotion]:
    problem = program.problem
    if not problem.model.closures and not isinstance(problem.scene.trajectory, TaskSpaceTrajectory):
        return lambda s: motion_at(problem, s)
    way = motion_along(problem)
    return lambda s: way.motion(s, problem.model.q_names, {})


def _torques_of(program: InverseProgram) -> Torques:
    """Return the actuators' torques as a function of samples.

    Raises
    ------
    CapabilityError : forces depend on time, or on the load; or loops or prescribed joints on time.
    """
    from robodyn_cli.torques.dynamics import InverseDynamics, timeless

    problem = program.problem
    if geared(problem.model):
        raise CapabilityError("losses of gears depend on the load, so no path can be timed by them")
    timeless(problem)
    if not problem.model.closures:
        return InverseDynamics(problem, eager=False)
    moves = [row.name for row in problem.constraints.rows if is_nonzero(row.eta_t)]
    if moves:
        raise CapabilityError(
            f"{moves[0]} moves by a formula of t, and 'fastest' chooses the times; allowed there: loops to places that "
            "stay where they are, prescribed joints that stay"
        )
    assert isinstance(program, ClosedLoops)
    return ClosedTorques(program)


def special_points(trajectory: FastestTrajectory, program: InverseProgram, path: LimitedPath) -> Array:
    """Return where the path is not smooth, and where a joint with forces turns back."""
    way = trajectory.way
    fixed = np.array([x for x in way.knots or () if 0.0 < x < way.duration])
    s = merged(np.linspace(0.0, way.duration, LOOKS + 1), fixed)
    points = path.at(s)
    problem = program.problem
    _check_path(points, s, problem.model)
    if isinstance(path.torques, ClosedTorques):
        path.torques.hold(points.q, path.places(s))
    if any(body.forces for body in problem.model.bodies):
        fixed = np.append(fixed, _turns(path, s, points))
    return fixed


def _check_path(way: JointMotion, s: Array, model: Model) -> None:
    """Refuse paths that stand still or turn a corner.

    Raises
    ------
    GeometryError
    """
    slope = way.qd.reshape(len(s) - 1, -1, way.qd.shape[1])
    size = np.linalg.norm(slope, axis=2)
    largest = float(size.max())
    still = size.min(axis=1) <= STILL * largest
    if still.any():
        k = int(np.argmax(still))
        raise GeometryError(
            f"the path stands still at its t = {s[k]:.6g} s, where it has no direction; 'fastest' takes "
            "paths that move all the time (`points`, a circle, formulas without rests)",
            ("trajectory",),
            key="trajectory",
            time=float(s[k]),
        )
    jump = np.abs(slope[1:, 0] - slope[:-1, -1])
    if jump.size and jump.max() > CORNER * largest:
        k, joint = (int(x) for x in np.unravel_index(int(np.argmax(jump)), jump.shape))
        raise GeometryError(
            f"the path has a corner at its t = {s[k + 1]:.6g} s (joint {model.v_names[joint]!r}), which "
            "'fastest' cannot pass without a stop; use a smooth path",
            ("trajectory",),
            key="trajectory",
            time=float(s[k + 1]),
        )


def _turns(path: LimitedPath, s: Array, way: JointMotion) -> Array:
    """Return where joints turn back."""
    slope = way.qd.reshape(len(s) - 1, -1, way.qd.shape[1])
    first, last = slope[:, 0], slope[:, -1]
    segments, joints = np.nonzero(first * last < 0.0)
    low, high = s[segments].copy(), s[segments + 1].copy()
    sign = np.sign(first[segments, joints])
    for _ in range(BISECTIONS if segments.size else 0):
        middle = 0.5 * (low + high)
        order = np.argsort(middle, kind="stable")
        here = np.empty_like(middle)
        here[order] = path.motion(np.append(0.0, middle[order])).qd[1:][np.arange(len(order)), joints[order]]
        same = np.sign(here) == sign
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return 0.5 * (low + high)


def fastest_on(
    path: LimitedPath,
    trajectory: FastestTrajectory,
    fixed: Array,
    program: InverseProgram,
) -> Fastest:
    """Return the fastest motion along the path.

    Raises
    ------
    GeometryError : no motion keeps to the limits.
    """
    limits = PathLimits(path)
    try:
        return fastest(trajectory.way.duration, trajectory.intervals, trajectory.tolerance, fixed, limits)
    except NoProfile as failure:
        assert limits.grid is not None
        raise _refusal(path, float(limits.grid[failure.place]), program.problem.model) from None


def _refusal(path: LimitedPath, where: float, model: Model) -> GeometryError:
    """Return why no motion on the path keeps to the limits at s = ``where``."""
    way = path.motion(np.array([0.0, where]) if where > 0.0 else np.zeros(1))
    zero = np.zeros(len(way.q))
    at_rest = path.torques_at(way, zero, zero)[-1]
    at = f"at t = {where:.6g} s of its path"
    if at_rest.size and np.abs(at_rest).max() > 1.0:
        k = int(np.argmax(np.abs(at_rest)))
        efforts, joint = path.effort, model.v_names[path.effort.places[k]]
        needed, (low, high) = (
            at_rest[k] * efforts.half[k] + efforts.middle[k],
            (efforts.low[k], efforts.high[k]),
        )
        same = low == -high
        needed, most = (abs(needed), f"{high:.6g}") if same else (needed, f"{low:.6g} to {high:.6g}")
        return GeometryError(
            f"the limits allow no motion {at}: joint {joint!r} needs {needed:.6g} there "
            f"at rest, and its effort is limited to {most}", ("trajectory",), key="trajectory",
            time=where, joint=joint,
        )  # fmt: skip
    return GeometryError(
        f"no speed keeps to the limits {at}; use a smoother path, or raise them",
        ("trajectory",),
        key="trajectory",
        time=where,
    )
