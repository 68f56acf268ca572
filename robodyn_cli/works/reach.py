"""``reach``: joint positions that bring a frame to a pose, and all branches where the arm's structure names them."""

from __future__ import annotations

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import GeometryError, SceneError
from robodyn_cli.given.poses.inverse_kinematics import InverseKinematics, explain_miss
from robodyn_cli.given.poses.targets import Poses, Way
from robodyn_cli.model.joints import orientation
from robodyn_cli.observe.evaluation import refuse_result
from robodyn_cli.observe.observe import add_sample
from robodyn_cli.observe.units import JointColumns
from robodyn_cli.ready.doors import at_rest
from robodyn_cli.results.result import Result
from robodyn_cli.scene.nested_options import ReachOptions
from robodyn_cli.scene.types import Ready, Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Termination
from robodyn_cli.summaries.mechanism import ReachedBranch, ReachSummary
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress


@np.errstate(all="ignore")  # ``refuse_result`` names numbers that are not finite
def reach(scene: Scene, *, progress: Progress = no_progress, watch: Stopwatch | None = None) -> Result:
    """Find joint positions that bring a frame to the pose of the scene's ``reach``.

    Returns
    -------
    A Result of one sample, and of all branches where the pose leaves no freedom.

    Raises
    ------
    SceneError : nothing is asked for, or a choice that the arm does not have. GeometryError : the pose is out of
    reach; by how much, and which joint or limit is in the way.
    """
    watch = watch or Stopwatch()
    options = _options(scene)
    target, R = _pose(options)
    solver, poses = reached(scene, watch)
    with watch.stage("branches"):
        ways = [] if solver.freedom else solver.ways(target, R)
    progress(0.0, 0.0)
    q = poses.q[0]
    result = Result.of("reach", scene)
    still = np.zeros(solver.model.nv)
    add_sample(result, solver.problem, q, still, still)
    branches = [_described(solver, way, q) for way in ways]
    _add_branches(result, solver.problem, [way.q for way, branch in zip(ways, branches) if branch.reached])
    number = int(poses.branch[0])
    result.summarise(
        ReachSummary(
            termination=Termination("reached", 0.0),
            samples=1,
            frame=options.frame,
            method="analytic" if solver.closed_form is not None and number >= 0 else "damped",
            configuration=dict(zip(solver.model.q_names, q.tolist())),
            units=solver.model.coordinate_units,
            branch=solver.branch_names[number] if number >= 0 else ABSENT,
            error=float(poses.error[0]),
            freedom=solver.freedom,
            singular_ratio=_singular_ratio(solver, poses.targets[0], q),
            branches=branches or ABSENT,
        ),
        seconds=watch.report(),
    )
    refuse_result(result)
    return result


def _options(scene: Scene) -> ReachOptions:
    if scene.reach is None:
        raise SceneError("key 'reach' is missing: which frame is to go where", (scene.path,), key="reach")
    return scene.reach


def _pose(options: ReachOptions) -> tuple[Array, Array | None]:
    """Return the position (3,) and the attitude (3, 3) that are asked for."""
    R = None if options.orientation is None else np.array(orientation(options.orientation), dtype=float)
    return np.array(options.position or (0.0, 0.0, 0.0), dtype=float), R


def reached(scene: Scene, watch: Stopwatch) -> tuple[InverseKinematics, Poses]:
    """Return the solver, and the joint positions that bring the frame to the pose.

    Raises
    ------
    RobodynError : see ``reach``.
    """
    options = _options(scene)
    with watch.stage("equations"):
        solver = _solver(at_rest(scene), options)
    with watch.stage("solve"):
        poses = solver.solve(*_pose(options), branch=options.branch)
    if not poses.reached[0]:
        beside = f" on branch {options.branch}" if options.branch else ""
        raise GeometryError(
            f"{options.frame!r} cannot reach the pose{beside}: {explain_miss(solver, poses, 0)}", (scene.path,),
            frame=options.frame, distance=float(poses.error[0]),
        )  # fmt: skip
    return solver, poses


def _solver(scene: Ready, options: ReachOptions) -> InverseKinematics:
    axis = options.axis
    oriented = options.orientation is not None
    return InverseKinematics(
        scene,
        options.frame,
        position=options.components if options.position is not None else "",
        orientation=("axis" if axis is not None else "full") if oriented else "free",
        axis=axis or (0.0, 0.0, 1.0),
        criterion=options.criterion,
        limits=options.limits,
    )


def _described(solver: InverseKinematics, way: Way, q: Array) -> ReachedBranch:
    chosen = bool(np.abs(way.q - q).max() < 1e-6)
    configuration = dict(zip(solver.model.q_names, way.q.tolist()))
    reached = way.error <= solver.tolerance
    return ReachedBranch(way.name, configuration, reached, way.within_limits, way.error, chosen)


def _add_branches(result: Result, problem: Problem, configurations: list[Array]) -> None:
    """Add the positions of the ways that reach the pose, and the outlines of links there."""
    if not configurations:
        return
    model = problem.model
    q = np.array(configurations)
    result.add("branches/q", q, **JointColumns(model.q_names, model.q_units, ("branch", "joint")).described())
    for name, outline in model.outlines.items():
        corners = [problem.world_point(corner) for corner in outline]
        result.add(f"branch_skeleton/{name}", np.array([problem.numbers(corners, x) for x in q]))


def _singular_ratio(solver: InverseKinematics, target: Array, q: Array) -> float:
    """Return the smallest over the largest singular value of what moves the frame, as far as its general rank."""
    moving = solver.equations.moving
    s = np.linalg.svd(solver.equations.jacobian(q, target)[:, moving], compute_uv=False)
    rank = min(len(moving) - solver.freedom, len(s))
    return float(s[rank - 1] / s[0]) if rank else 0.0
