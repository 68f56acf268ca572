"""Why a pose is not reached: out of reach, a joint's limit, or a singular pose in between.

Inverse kinematics of poses: joint positions that bring a frame of any arm or mechanism to many poses at once.
"""

from __future__ import annotations

import copy
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import world_pose
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.given.poses.criteria import Criterion, PositionLimits
from robodyn_cli.given.poses.targets import (
    PoseDemand,
    PoseEquations,
    Poses,
    Way,
    check_choice,
    different,
    find_frame,
    nothing_found,
    packed_targets,
    with_frame,
)
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import BASE
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closing.search import halton
from robodyn_cli.solve.poses.closed_form import ClosedForm
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.threads import ThreadSafe, one_at_a_time

AT_LIMIT = 1e-6  # rad or m
PATIENCE = 1000  # steps towards the nearest pose, to which they may go slowly
SINGULAR = 1e-4  # smallest over largest singular value below which a pose is called singular


def explain_miss(solver: InverseKinematics, poses: Poses, k: int) -> str:
    """Return why target k of ``poses`` is not reached, as a part of a sentence."""
    target, q, error = poses.targets[k], poses.q[k], float(poses.error[k])
    equations = solver.equations
    d = equations.data(target[None], q)
    nearer = equations.settle(equations.approach, q[None], d, PATIENCE)
    _, left = equations.reach({"q": nearer, "d": d, "p": solver.limits.numbers}, solver.tolerance, 0)
    if left[0] < error:
        q, error = nearer[0], float(left[0])
    text = f"the nearest pose found is {_distance(solver, target, q)} away"
    limits = solver.limits
    if limits.places:
        beyond = _reached_beyond(solver, target, q)
        if beyond is not None:
            return f"{text}; it is within reach only with {beyond}"
        held = _at_limits(limits, q)
        if held:
            text += f", with {held}"
    J = solver.equations.jacobian(q, target)
    moving = solver.equations.moving
    _, s, Vt = np.linalg.svd(J[:, moving])
    rank = min(len(moving) - solver.freedom, len(s))
    if rank > 0 and s[rank - 1] < SINGULAR * s[0]:
        joint = solver.model.joint_of(moving[int(np.argmax(np.abs(Vt[rank - 1])))])
        text += f", in a singular pose, in which moving joint {joint!r} does not bring it nearer"
    return text


def _distance(solver: InverseKinematics, target: Array, q: Array) -> str:
    """Return how far a target (12,) is from the frame at q, as far as it is asked for: distance and angle."""
    task = solver.task
    p, R = (x[0] for x in solver.forward(q[None]))
    wanted, places, parts = target[3:].reshape(3, 3), list(task.position), []
    if places:
        parts.append(f"{np.linalg.norm((target[:3] - p)[places]):.4g} m")
    if task.orientation == "axis":
        half_sine = 0.5 * np.linalg.norm((wanted - R) @ task.axis)
    elif task.orientation == "full":
        half_sine = np.linalg.norm(wanted - R) / np.sqrt(8.0)
    if task.orientation != "free":
        parts.append(f"{2.0 * np.arcsin(min(1.0, half_sine)):.4g} rad")
    return " and ".join(parts)


def _reached_beyond(solver: InverseKinematics, target: Array, q: Array) -> str | None:
    """Return the limits that a solution without limits passes, None where there is no solution."""
    free = solver.without_limits.solve(target[:3], target[3:].reshape(3, 3), near=q)
    if not free.reached[0]:
        return None
    at = solver.limits.unwound(free.q[0], q, solver.model)
    return "joint " + " and ".join(
        f"{name!r} at {at[place]:.6g}, beyond its limits of {low:.6g} to {high:.6g}"
        for name, place, low, high, over in _each(solver.limits, solver.limits.excess(at))
        if over > AT_LIMIT
    )


def _at_limits(limits: PositionLimits, q: Array) -> str:
    """Return the joints that stand on a limit."""
    own = q[limits.places]
    gaps = np.minimum(np.abs(own - limits.lower), np.abs(limits.upper - own))
    joints = [
        f"{name!r} at {q[place]:.6g}" for name, place, _, _, gap in _each(limits, gaps) if gap < AT_LIMIT
    ]
    return f"joint {' and '.join(joints)} on its limit" if joints else ""


def _each(limits: PositionLimits, values: Array) -> list[tuple[str, int, float, float, float]]:
    """Return name, place in q, lower and upper limit and a value for each joint with limits."""
    numbers = (limits.lower.tolist(), limits.upper.tolist(), values.tolist())
    return list(zip(limits.names, limits.places, *numbers))


TOLERANCE = 1e-10  # m and rad
ROUNDING = 1e-14  # of the size of the mechanism, below which no tolerance can be met
FINISHED = 1e-3  # part of the tolerance at which steps end, so that only rounding is left
ROUNDS = 24  # steps from one start
STARTS = 96  # positions to start from, beside the one nearby
POLISH = 4  # steps that take the rounding from a closed form
CLOSE = 1e-5  # m or rad to the target from which on a closed form counts as a solution to polish
IMPROVE = 60  # steps towards the criterion
CHOICE = 8  # solutions among which the criterion chooses where there is no closed form


class InverseKinematics(ThreadSafe):
    """Joint positions that bring a frame to poses, or parts of poses.

    An arm whose structure allows it has a closed form with named branches: planar arms and SCARA robots (elbow_up,
    elbow_down); arms with a spherical wrist whose second and third axes are parallel, and arms with three parallel
    axes as the UR (righty or lefty, elbow_up or elbow_down, no_flip or flip). Everything else, mechanisms with loops
    included, is solved by damped steps from several starts, always the same ones. That nothing is found then is no
    proof that nothing exists.

    Parameters
    ----------
    source : scene or equations. frame : a named point or frame, a link, or ``LINK.end``. asked : see ``PoseDemand``.

    Raises
    ------
    SceneError : an unknown frame or choice. CapabilityError : a criterion that has no meaning here.
    """

    def __init__(self, source: Scene | Problem, frame: str, **asked: Any) -> None:
        super().__init__()
        self.problem = problem = with_frame(source, frame)
        scene = problem.scene
        self.model = problem.model
        place = find_frame(self.model, frame)
        if place.body == BASE:
            raise SceneError(f"{frame!r} is fixed to the base and cannot be brought anywhere")
        options = PoseDemand(**asked)
        self.task = options.task(place)
        self.limits = PositionLimits.of(scene, self.model, options.limits)
        self.equations = PoseEquations(problem, self.task, self.limits, Criterion(options.criterion))
        self.closed_form = ClosedForm.of(self.model, self.task) if options.method == "auto" else None
        self.tolerance = max(TOLERANCE, ROUNDING * self.equations.size)
        self.home = self._home(scene)

    def _home(self, scene: Scene) -> Array:
        """The position near which solutions are sought by default: ``initial.q``, else the middle of the limits."""
        home = Manifold(self.model).neutral()
        for k, lower, upper in zip(self.limits.places, self.limits.lower, self.limits.upper):
            if np.isfinite(lower) and np.isfinite(upper):
                home[k] = 0.5 * (lower + upper)
            elif not lower <= home[k] <= upper:
                home[k] = lower if np.isfinite(lower) else upper
        for name, value in scene.initial.q.items():
            home[self.model.q_names.index(name)] = value
        return home

    @property
    def branch_names(self) -> list[str]:
        """The branches of the closed form by name, [] where there is none."""
        return [] if self.closed_form is None else ["-".join(name) for name in self.closed_form.names]

    @property
    @one_at_a_time
    def freedom(self) -> int:
        """How many freedoms are left when the task is met, in general poses."""
        return self.equations.freedom

    @one_at_a_time
    def forward(self, q: Array) -> tuple[Array, Array]:
        """Return positions (T, 3) [m] and rotations (T, 3, 3) of the frame in the world at positions q (T, nq)."""
        pose = self._forward(q=np.asarray(q, dtype=float))
        return pose["p"], pose["R"].reshape(-1, 3, 3)

    @cached_property
    def _forward(self) -> SampleKernel:
        pose = world_pose(self.model, self.problem.pose, self.task.frame)
        return SampleKernel({"p": list(pose.p), "R": list(pose.R.flat)}, ("q",))

    @cached_property
    def without_limits(self) -> InverseKinematics:
        """The same for joints without limits, to reach the nearest pose."""
        if not self.limits.places:
            return self
        free = copy.copy(self)
        free.limits = PositionLimits.of(self.problem.scene, self.model, respected=False)
        free.equations = PoseEquations(self.problem, self.task, free.limits, Criterion.NEAREST)
        return free

    # -- many poses -----------------------------------------------------------------------------------
    @one_at_a_time
    def solve(
        self,
        position: Array,
        rotation: Array | None = None,
        near: Array | None = None,
        branch: str | None = None,
    ) -> Poses:
        """Return joint positions for targets in the world.

        Parameters
        ----------
        position : (T, 3) or (3,) [m]; components that are not asked for do not matter. rotation : (T, 3, 3) or
        (3, 3), or unit quaternions (T, 4) or (4,), scalar first; not needed where the orientation is free.
        near : (T, nq) or (nq,), where to start and what ``nearest`` refers to; the scene's ``initial.q``, or the middle
        of the limits, by default. branch : of the closed form, by name.

        Raises
        ------
        SceneError : targets of a wrong shape, or a branch that there is not.
        """
        targets = packed_targets(self.task, position, rotation)
        start = self._near(near, len(targets))
        check_choice("branch", branch, (None, *self.branch_names))
        poses = nothing_found(targets, start)
        if self.closed_form is not None:
            poses = self._from_closed_form(targets, start, branch)
        left = np.flatnonzero(~poses.reached)
        if len(left) and branch is None:
            rest = self._by_steps(targets[left], start[left])
            for own, more in zip((poses.q, poses.error, poses.reached), (rest.q, rest.error, rest.reached)):
                own[left] = more
        return poses

    def _from_closed_form(self, targets: Array, near: Array, branch: str | None) -> Poses:
        """Return the branch that the criterion chooses among those that are within the limits, or the one asked for."""
        ways = self._ways(targets, near)
        names = self.branch_names
        chosen = [names.index(branch)] if branch is not None else range(len(names))
        equations = self.without_limits.equations
        d, p = equations.data(targets, near), equations.limits.numbers
        best = np.full(len(targets), np.inf)
        poses = nothing_found(targets, near)
        for k in chosen:
            q = ways[k]
            _, error = equations.reach({"q": q, "d": d, "p": p}, CLOSE, 0)
            fits = (error <= CLOSE) & self.limits.within(q)
            value = self._values(q, targets, near)
            better = np.where(fits, value < best, np.isinf(best) & (error < poses.error))
            best = np.where(better & fits, value, best)
            poses.q[better], poses.error[better], poses.branch[better] = q[better], error[better], k
        reached = np.isfinite(best)
        q, error = equations.reach({"q": poses.q, "d": d, "p": p}, FINISHED * self.tolerance, POLISH)
        kept = reached & (error <= poses.error)
        poses.q[kept], poses.error[kept] = q[kept], error[kept]
        poses.reached[:] = reached & (poses.error <= self.tolerance)
        return poses

    def _ways(self, targets: Array, near: Array) -> list[Array]:
        """Return q (T, nq) of each branch of the closed form, turned back within the limits where that goes."""
        assert self.closed_form is not None
        rotation = targets[:, 3:].reshape(-1, 3, 3)
        ways = self.closed_form.branches(targets[:, :3], rotation, near)
        return [self.limits.unwound(ways[name], near, self.model) for name in self.closed_form.names]

    def _by_steps(self, targets: Array, near: Array) -> Poses:
        """Return what damped steps find: first from nearby, then from the same starts for all targets."""
        poses = nothing_found(targets, near)
        wanted = 1 if self.equations.criterion is Criterion.NEAREST else CHOICE
        best, count = np.full(len(targets), np.inf), np.zeros(len(targets), dtype=int)
        for start in (None, *self._starts):
            left = np.flatnonzero(count < wanted)
            if not len(left):
                break
            q = near[left]
            if start is not None:
                q = np.tile(start, (len(left), 1))
                q[:, self._idle] = near[left][:, self._idle]
            q, error = self._from_start(q, targets[left], near[left])
            good = error <= self.tolerance
            value = np.where(good, self._values(q, targets[left], near[left]), np.inf)
            better = np.where(good, value < best[left], ~poses.reached[left] & (error < poses.error[left]))
            rows = left[better]
            poses.q[rows], poses.error[rows], best[rows] = q[better], error[better], value[better]
            poses.reached[left] |= good
            count[left] += good
        return poses

    def _from_start(self, q: Array, targets: Array, near: Array) -> tuple[Array, Array]:
        """Return positions and errors that steps from q (T, nq) lead to; of free mechanisms, the criterion's best."""
        equations, finished = self.equations, FINISHED * self.tolerance
        groups = {"d": equations.data(targets, near), "p": self.limits.numbers}
        q, error = equations.reach({"q": q, **groups}, finished, ROUNDS)
        q = self.limits.unwound(q, near, self.model)
        good = error <= self.tolerance
        if not self.freedom or not good.any():
            return q, error
        settled = equations.settle(equations.improve, q, groups["d"], IMPROVE)
        better, left = equations.reach({"q": settled, **groups}, finished, ROUNDS)
        gain = self._values(better, targets, near) < self._values(q, targets, near)
        taken = good & gain & (left <= self.tolerance)
        return np.where(taken[:, None], better, q), np.where(taken, left, error)

    def _values(self, q: Array, targets: Array, near: Array) -> Array:
        """Return the criterion's value (T,)."""
        groups = {"q": q, "d": self.equations.data(targets, near), "p": self.limits.numbers}
        values: Array = self.equations.value.evaluate(len(q), groups)["value"][:, 0]
        return values

    @cached_property
    def _starts(self) -> Array:
        """Positions (k, nq) to start from: points of Halton's sequence."""
        moving = self.equations.moving
        points = np.full((STARTS, self.model.nv), 0.5)
        points[:, moving] = halton(STARTS, len(moving))
        return self.limits.spread(points, self.model, self.equations.size)

    @cached_property
    def _idle(self) -> list[int]:
        """The places in q of what neither the frame nor loops depend on."""
        manifold = Manifold(self.model)
        idle = [k for k in range(self.model.nv) if k not in self.equations.moving]
        return sorted({column for velocity in idle for column in manifold.columns(velocity)})

    # -- all ways to one pose -------------------------------------------------------------------------
    @one_at_a_time
    def ways(self, position: Array, rotation: Array | None = None, near: Array | None = None) -> list[Way]:
        """Return the ways to reach one pose: the branches of the closed form, else what steps from many starts find.

        Raises
        ------
        CapabilityError : the pose leaves the mechanism free, so that there are infinitely many.
        """
        targets = packed_targets(self.task, position, rotation)[:1]
        start = self._near(near, 1)
        if self.closed_form is not None:
            q = np.concatenate(self._ways(targets, start))
            polished, left = self._polished(q, targets, start, POLISH)
            kept = left <= self.tolerance
            q, error = np.where(kept[:, None], polished, q), left
            names = self.branch_names
        else:
            q, error = self._search(targets, start)
            names = [str(k + 1) for k in range(len(q))]
        within = self.limits.within(q)
        return [Way(*way) for way in zip(names, q, error.tolist(), within.tolist())]

    def _search(self, targets: Array, start: Array) -> tuple[Array, Array]:
        """Return the positions (k, nq) that steps from many starts find for one target, and their errors (k,)."""
        if self.freedom:
            raise CapabilityError(
                f"the pose leaves {self.freedom} degrees of freedom, so there are infinitely many ways to reach it; "
                "solve for one by a criterion, or ask for more of the pose"
            )
        starts = self._starts.copy()
        starts[:, self._idle] = start[:, self._idle]
        starts = np.concatenate([start, starts])
        q, error = self._polished(starts, targets, start, 4 * ROUNDS)
        q = self.limits.unwound(q, np.broadcast_to(start, q.shape), self.model)
        kept = different(q, np.flatnonzero(error <= self.tolerance))
        return q[kept], error[kept]

    def _polished(self, q: Array, targets: Array, near: Array, rounds: int) -> tuple[Array, Array]:
        """Return where steps from q (k, nq) lead, without regard to limits, for one target."""
        equations = self.without_limits.equations
        d = np.repeat(equations.data(targets, near), len(q), axis=0)
        groups = {"q": q, "d": d, "p": equations.limits.numbers}
        return equations.reach(groups, FINISHED * self.tolerance, rounds)

    # -- arguments ------------------------------------------------------------------------------------
    def _near(self, near: Array | None, samples: int) -> Array:
        wanted = self.home if near is None else np.asarray(near, dtype=float)
        if wanted.shape[-1] != self.model.nq:
            raise SceneError(f"a position near has {self.model.nq} numbers: {', '.join(self.model.q_names)}")
        return np.array(np.broadcast_to(wanted, (samples, self.model.nq)))
