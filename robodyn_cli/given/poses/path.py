"""Where a path of poses begins, and what a redundant arm does along it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robodyn_cli.algorithms.kinematics import position_rates
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import GeometryError, SceneError
from robodyn_cli.expr.calculus import directional, substitute
from robodyn_cli.given.poses.criteria import Criterion
from robodyn_cli.given.poses.inverse_kinematics import InverseKinematics, explain_miss
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.observe.places import in_world
from robodyn_cli.solve.inverse_kinematics import PathTask
from robodyn_cli.solve.newton import Drift
from robodyn_cli.spatial.algebra import Array, vector
from robodyn_cli.trajectories.motion import PoseMotion

SETTLING = 10.0  # times the drift towards the criterion's optimum decays by e along a path


def solver_of(
    problem: Problem, task: PathTask, criterion: Criterion = Criterion.NEAREST
) -> InverseKinematics:
    """Return the inverse kinematics of what a path leads.

    Raises
    ------
    CapabilityError : the criterion has no meaning for the arm.
    """
    target = task.target(np.zeros(1))
    return InverseKinematics(
        problem,
        task.trajectory.point,
        position="xyz"[: target.p.shape[1]],
        orientation="full" if isinstance(target, PoseMotion) else "free",
        criterion=criterion.value,
    )


def start_of(problem: Problem, task: PathTask) -> Mapping[str, float] | None:
    """Return the joint positions at t = 0 on the branch ``ik.branch``, or at the best value of ``ik.redundancy``.

    None where neither decides: then the motion starts near the positions given, or the closed form of a planar arm
    knows its branch itself.

    Raises
    ------
    SceneError : the arm has no such branch. GeometryError : it does not reach the path there.
    """
    ik = task.ik
    wanted = ik.branch if task.arm is None else None
    redundant = ik.redundancy != "least_rates"
    if wanted is None and not redundant:
        return None
    _refuse_unknown_start(task)
    criterion = Criterion(ik.redundancy) if redundant else Criterion.NEAREST
    solver = solver_of(problem, task, criterion)
    if redundant and not solver.freedom:
        raise SceneError(
            f"trajectory.ik.redundancy ({ik.redundancy}): the path determines all joints, so nothing "
            "is left to choose",
            (task.where,),
            key="trajectory.ik.redundancy",
        )
    if wanted is not None and wanted not in solver.branch_names:
        if not solver.branch_names:
            return None  # the caller says which arms have named branches
        raise SceneError(
            f"trajectory.ik.branch ({wanted}) is no branch of this arm; allowed: "
            f"{', '.join(solver.branch_names)}",
            (task.where,),
            key="trajectory.ik.branch",
        )
    near = _near(task)
    target = task.target(np.zeros(1))
    at, R = in_world(problem.model, task.moving, target.p, target.R, near)
    p = np.zeros((1, 3))
    p[:, : at.shape[1]] = at
    poses = solver.solve(p, R, near=near[0] if task.start else None, branch=wanted)
    if not poses.reached[0]:
        raise GeometryError(
            f"point {task.trajectory.point!r} cannot reach its target at t = 0 s"
            + (f" on branch {wanted}" if wanted else "")
            + f": {explain_miss(solver, poses, 0)}",
            (task.where,),
            time=0.0,
            distance=float(poses.error[0]),
        )
    return dict(zip(problem.model.q_names, poses.q[0].tolist()))


def _near(task: PathTask) -> Array:
    """Return the positions (1, nq) from which the start is sought: prescribed joints are where they begin."""
    given = None if task.prescribed else task.start_positions()
    if given is not None:
        return given[None]
    near = Manifold(task.model).neutral()
    for name, x in task.start.items():
        near[task.model.q_names.index(name)] = x
    return near[None]


def _refuse_unknown_start(task: PathTask) -> None:
    """Refuse a path whose first target in the world is not known, or not that of the joints to be found alone.

    Raises
    ------
    SceneError
    """
    prescribed, model = {name.partition(".")[0] for name in task.prescribed}, task.model
    own = {model.bodies[k].joint_name for k in model.path_to(task.frame.body)}
    below = (
        set()
        if task.moving is None
        else {model.bodies[k].joint_name for k in model.path_to(task.moving.body)}
    )
    open_, shared = sorted(below - own - prescribed), sorted(own & (prescribed | below))
    if open_ or shared:
        why = (
            f"joint {open_[0]!r}, which carries {task.trajectory.relative_to!r}, is not prescribed"
            if open_
            else f"joint {shared[0]!r}, which carries {task.trajectory.point!r}, is prescribed or carries the path too"
        )
        raise SceneError(
            f"'branch' and 'redundancy' go with a path whose place in the world is known at "
            f"the start, and {why}; use trajectory.ik.guess instead",
            (task.where, "trajectory.ik"),
            key="trajectory.ik",
        )


def drift_of(problem: Problem, task: PathTask) -> Drift:
    """Return the rates u = -k grad h(q) towards the best value of h = |c|^2 / 2, and u-dot (Liegeois 1977).

    k is such that the distance from the optimum decays by e ``SETTLING`` times along the path, in the units of the
    criterion.
    """
    model = problem.model
    equations = solver_of(problem, task, Criterion(task.ik.redundancy)).equations
    c, C = equations.criterion_rows
    gain = SETTLING / task.trajectory.duration
    u = [-gain * x for x in vector(C.T @ vector(c))]
    limits = equations.limits.numbers.tolist()
    numbers = {symbol.index: x for symbol, x in zip((*equations.lower, *equations.upper), limits)}
    u = substitute(u, dict(numbers))
    rates = directional(u, problem.q, position_rates(model, problem.q, problem.v))
    kernel = SampleKernel({"u": u, "rate": rates}, ("q", "v"))

    def drift(q: Array, v: Array) -> tuple[Array, Array]:
        values = kernel.evaluate(len(q), {"q": q, "v": v})
        return values["u"], values["rate"]

    return drift
