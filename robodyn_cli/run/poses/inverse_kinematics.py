"""Inverse kinematics of poses: joint positions that bring a frame of any arm or mechanism to many poses at once."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError, did_you_mean
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.record import record
from robodyn_cli.run.observation.places import world_pose
from robodyn_cli.run.poses.criteria import Criterion
from robodyn_cli.run.poses.equations import PoseEquations, packed
from robodyn_cli.run.poses.limits import PositionLimits
from robodyn_cli.scene.points import point_problem, with_points
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.branches import halton
from robodyn_cli.solve.poses.closed_form import ClosedForm
from robodyn_cli.solve.poses.task import ORIENTATIONS, PoseTask
from robodyn_cli.spatial.algebra import Array

TOLERANCE = 1e-10  # m and rad
ROUNDING = 1e-14  # of the size of the mechanism, below which no tolerance can be met
FINISHED = 1e-3  # part of the tolerance at which steps end, so that only rounding is left
ROUNDS = 24  # steps from one start
STARTS = 96  # positions to start from, beside the one nearby
POLISH = 4  # steps that take the rounding from a closed form
CLOSE = 1e-5  # m or rad to the target from which on a closed form counts as a solution to polish
IMPROVE = 60  # steps towards the criterion
SETTLED = 1e-9  # rad: step of the criterion that ends them
SAME = 1e-6  # rad or m, for positions that count as one
CHOICE = 8  # solutions among which the criterion chooses where there is no closed form


@record
class Poses:
    """Positions q (T, nq) for T targets (T, 12), and what is left of them.

    targets : position, then rotation row by row. error : the larger of distance [m] and angle [rad] to each target (T,), and of what the loops lack. reached : (T,).
    branch : of each target the place of its branch in ``branches`` of the class, -1 where there is no closed form.
    """

    targets: Array
    q: Array
    error: Array
    reached: Array
    branch: Array


@record
class Way:
    """One way to reach a pose: name, q (nq,), error, and whether it is within the joints' limits."""

    name: str
    q: Array
    error: float
    within_limits: bool


class InverseKinematics:
    """Joint positions that bring a frame to poses, or parts of poses.

    An arm whose structure allows it has a closed form with named branches: planar arms and SCARA robots (elbow_up,
    elbow_down); arms with a spherical wrist whose second and third axes are parallel, and arms with three parallel
    axes as the UR (righty or lefty, elbow_up or elbow_down, no_flip or flip). Everything else, mechanisms with loops
    included, is solved by damped steps from several starts, always the same ones. That nothing is found then is no
    proof that nothing exists.

    Parameters
    ----------
    source : scene, or its equations. frame : a named point or frame, a link, or ``LINK.end``.
    position : the components that are asked for, of ``xyz``. orientation : ``full``; ``axis``, the direction of
    ``axis`` (3,) in the frame's coordinates alone; or ``free``.
    criterion : what decides between positions: ``nearest`` (to ``near``), ``away_from_limits``, ``least_torque``.
    limits : whether the joints' limits are respected. method : ``auto``, or ``damped`` for no closed form.

    Raises
    ------
    SceneError : an unknown frame or choice. CapabilityError : a criterion that has no meaning here.
    """

    def __init__(
        self,
        source: Scene | Problem,
        frame: str,
        *,
        position: str = "xyz",
        orientation: str = "full",
        axis: Sequence[float] = (0.0, 0.0, 1.0),
        criterion: str = "nearest",
        limits: bool = True,
        method: str = "auto",
    ) -> None:
        self.problem = problem = _with_frame(source, frame)
        scene = problem.scene
        self.model = problem.model
        place = find_frame(self.model, frame)
        if place.body == BASE:
            raise SceneError(f"{frame!r} is fixed to the base and cannot be brought anywhere")
        self.task = _task(place, position, orientation, axis)
        _choice("method", method, ("auto", "damped"))
        _choice("criterion", criterion, tuple(x.value for x in Criterion))
        self.limits = PositionLimits.of(scene, self.model, limits)
        self.equations = PoseEquations(problem, self.task, self.limits, Criterion(criterion))
        self.closed_form = ClosedForm.of(self.model, self.task) if method == "auto" else None
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
    def freedom(self) -> int:
        """How many freedoms are left when the task is met, in general poses."""
        return self.equations.freedom

    def forward(self, q: Array) -> tuple[Array, Array]:
        """Return positions (T, 3) [m] and rotations (T, 3, 3) of the frame in the world at positions q (T, nq)."""
        found = self._forward(q=np.asarray(q, dtype=float))
        return found["p"], found["R"].reshape(-1, 3, 3)

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

    def explain(self, found: Poses, k: int) -> str:
        """Return why target k of ``found`` is not reached, as a part of a sentence."""
        from robodyn_cli.run.poses.explain import explain_miss

        return explain_miss(self, found.targets[k], found.q[k], float(found.error[k]))

    # -- many poses -----------------------------------------------------------------------------------
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
        targets = self._targets(position, rotation)
        start = self._near(near, len(targets))
        _choice("branch", branch, (None, *self.branch_names))
        found = _nothing(targets, start)
        if self.closed_form is not None:
            found = self._from_closed_form(targets, start, branch)
        left = np.flatnonzero(~found.reached)
        if len(left) and branch is None:
            rest = self._by_steps(targets[left], start[left])
            for own, more in zip((found.q, found.error, found.reached), (rest.q, rest.error, rest.reached)):
                own[left] = more
        return found

    def _from_closed_form(self, targets: Array, near: Array, branch: str | None) -> Poses:
        """Return the branch that the criterion chooses among those that are within the limits, or the one asked for."""
        ways = self._ways(targets, near)
        names = self.branch_names
        chosen = [names.index(branch)] if branch is not None else range(len(names))
        equations = self.without_limits.equations
        d, p = equations.data(targets, near), equations.limits.numbers
        best = np.full(len(targets), np.inf)
        found = _nothing(targets, near)
        for k in chosen:
            q = ways[k]
            _, error = equations.reach({"q": q, "d": d, "p": p}, CLOSE, 0)
            fits = (error <= CLOSE) & self.limits.within(q)
            value = self._values(q, targets, near)
            better = np.where(fits, value < best, np.isinf(best) & (error < found.error))
            best = np.where(better & fits, value, best)
            found.q[better], found.error[better], found.branch[better] = q[better], error[better], k
        reached = np.isfinite(best)
        q, error = equations.reach({"q": found.q, "d": d, "p": p}, FINISHED * self.tolerance, POLISH)
        kept = reached & (error <= found.error)
        found.q[kept], found.error[kept] = q[kept], error[kept]
        found.reached[:] = reached & (found.error <= self.tolerance)
        return found

    def _ways(self, targets: Array, near: Array) -> list[Array]:
        """Return q (T, nq) of each branch of the closed form, turned back within the limits where that goes."""
        assert self.closed_form is not None
        rotation = targets[:, 3:].reshape(-1, 3, 3)
        found = self.closed_form.branches(targets[:, :3], rotation, near)
        return [self.limits.unwound(found[name], near, self.model) for name in self.closed_form.names]

    def _by_steps(self, targets: Array, near: Array) -> Poses:
        """Return what damped steps find: first from nearby, then from the same starts for all targets."""
        found = _nothing(targets, near)
        wanted = 1 if self.equations.criterion is Criterion.NEAREST else CHOICE
        best, count = np.full(len(targets), np.inf), np.zeros(len(targets), dtype=int)
        for start in (None, *self._starts):
            left = np.flatnonzero(count < wanted)
            if not len(left):
                break
            q = near[left] if start is None else np.broadcast_to(start, (len(left), self.model.nq))
            q, error = self._from_start(q, targets[left], near[left])
            good = error <= self.tolerance
            value = np.where(good, self._values(q, targets[left], near[left]), np.inf)
            better = np.where(good, value < best[left], ~found.reached[left] & (error < found.error[left]))
            rows = left[better]
            found.q[rows], found.error[rows], best[rows] = q[better], error[better], value[better]
            found.reached[left] |= good
            count[left] += good
        return found

    def _from_start(self, q: Array, targets: Array, near: Array) -> tuple[Array, Array]:
        """Return positions and errors that steps from q (T, nq) lead to; of free mechanisms, the criterion's best."""
        equations, finished = self.equations, FINISHED * self.tolerance
        groups = {"d": equations.data(targets, near), "p": self.limits.numbers}
        q, error = equations.reach({"q": q, **groups}, finished, ROUNDS)
        q = self.limits.unwound(q, near, self.model)
        good = error <= self.tolerance
        if not self.freedom or not good.any():
            return q, error
        extra = np.tile([1e-2, np.inf], (len(q), 1))
        state, _ = equations.improve({"q": np.concatenate([q, extra], axis=1), **groups}, SETTLED, IMPROVE)
        better, left = equations.reach({"q": state[:, : self.model.nq], **groups}, finished, ROUNDS)
        gain = self._values(better, targets, near) < self._values(q, targets, near)
        taken = good & gain & (left <= self.tolerance)
        return np.where(taken[:, None], better, q), np.where(taken, left, error)

    def _values(self, q: Array, targets: Array, near: Array) -> Array:
        """Return the criterion's value (T,)."""
        groups = {"q": q, "d": self.equations.data(targets, near), "p": self.limits.numbers}
        found: Array = self.equations.value.evaluate(len(q), groups)["value"][:, 0]
        return found

    @cached_property
    def _starts(self) -> list[Array]:
        moving = self.equations.moving
        points = np.full((STARTS, self.model.nv), 0.5)
        points[:, moving] = halton(STARTS, len(moving))
        starts = self.limits.spread(points, self.model, self.equations.size)
        idle = [k for k in range(self.model.nv) if k not in moving]
        manifold = Manifold(self.model)
        for k in (column for velocity in idle for column in manifold.columns(velocity)):
            starts[:, k] = self.home[k]
        return list(starts)

    # -- all ways to one pose -------------------------------------------------------------------------
    def ways(self, position: Array, rotation: Array | None = None, near: Array | None = None) -> list[Way]:
        """Return the ways to reach one pose: all branches of the closed form, else those that steps from many starts find.

        Raises
        ------
        CapabilityError : the pose leaves the mechanism free, so that there are infinitely many.
        """
        targets = self._targets(position, rotation)[:1]
        start = self._near(near, 1)
        equations = self.without_limits.equations
        if self.closed_form is not None:
            q = np.concatenate(self._ways(targets, start))
            names = self.branch_names
        else:
            if self.freedom:
                raise CapabilityError(
                    f"the pose leaves {self.freedom} degrees of freedom, so there are infinitely many ways to reach it; "
                    "solve for one by a criterion, or ask for more of the pose"
                )
            q, names = np.array([start[0], *self._starts]), []
        groups = {"d": np.repeat(equations.data(targets, start), len(q), axis=0), "p": equations.limits.numbers}
        rounds = POLISH if names else 4 * ROUNDS
        polished, error = equations.reach({"q": q, **groups}, FINISHED * self.tolerance, rounds)
        good = error <= self.tolerance
        if names:
            q = np.where(good[:, None], polished, q)
            places = range(len(q))
        else:
            q = self.limits.unwound(polished, np.broadcast_to(start, polished.shape), self.model)
            places = _different(q, np.flatnonzero(good))
            names = [str(k + 1) for k in range(len(q))]
        within = self.limits.within(q)
        return [Way(name, q[k], float(error[k]), bool(within[k])) for name, k in zip(names, places)]

    # -- arguments ------------------------------------------------------------------------------------
    def _targets(self, position: Array, rotation: Array | None) -> Array:
        p = np.atleast_2d(np.asarray(position, dtype=float))
        if p.ndim != 2 or p.shape[1] != 3:
            raise SceneError(f"targets need positions of three numbers, here of shape {np.shape(position)}")
        if rotation is None:
            if self.task.orientation != "free":
                raise SceneError("a target with an orientation needs a rotation; or choose orientation: free")
            rotation = np.eye(3)
        R = np.asarray(rotation, dtype=float)
        if R.shape[-1] == 4:
            R = _rotations(R)
        if R.shape[-2:] != (3, 3) or R.ndim > 3 or np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max() > 1e-9:
            raise SceneError(f"targets need rotations (3, 3) or unit quaternions (4,), here of shape {R.shape}")
        T = max(len(p), len(R) if R.ndim == 3 else 1)
        return packed(np.broadcast_to(p, (T, 3)), np.broadcast_to(R, (T, 3, 3)))

    def _near(self, near: Array | None, samples: int) -> Array:
        wanted = self.home if near is None else np.asarray(near, dtype=float)
        if wanted.shape[-1] != self.model.nq:
            raise SceneError(f"a position near has {self.model.nq} numbers: {', '.join(self.model.q_names)}")
        return np.array(np.broadcast_to(wanted, (samples, self.model.nq)))


def find_frame(model: Model, name: str) -> FixedFrame:
    """Return a named point, a named frame or a link's frame.

    Raises
    ------
    SceneError : there is none of that name.
    """
    for known in (model.points, model.frames, model.links):
        if name in known:
            return known[name]
    names = [*model.points, *model.frames, *model.links]
    raise SceneError(f"unknown frame {name!r}{did_you_mean(name, names)}; allowed: {', '.join(names)}")


def _with_frame(source: Scene | Problem, frame: str) -> Problem:
    """Return the equations, with a place such as ``LINK.end`` among the points."""
    if isinstance(source, Problem):
        return source
    named = "." in frame and point_problem(source.robot, frame) is None
    return Problem(with_points(source, [frame]) if named else source)


def _task(frame: FixedFrame, position: str, orientation: str, axis: Sequence[float]) -> PoseTask:
    _choice("orientation", orientation, ORIENTATIONS)
    if any(x not in "xyz" for x in position) or len(set(position)) != len(position):
        raise SceneError(f"position {position!r}: the components that are asked for, each once, of xyz")
    if not position and orientation == "free":
        raise SceneError("nothing is asked of the frame: neither a position nor an orientation")
    length = float(np.linalg.norm(axis))
    if len(axis) != 3 or not length > 0.0:
        raise SceneError(f"axis {list(axis)}: three numbers, not all zero")
    direction = tuple(float(x) / length for x in axis)
    return PoseTask(frame, tuple(sorted("xyz".index(x) for x in position)), orientation, direction)


def _choice(key: str, value: str | None, allowed: Sequence[str | None]) -> None:
    if value not in allowed:
        listed = ", ".join(x for x in allowed if x is not None) or "none: there is no closed form here"
        raise SceneError(f"{key} {value!r}{did_you_mean(str(value), [x for x in allowed if x])}; allowed: {listed}")


def _nothing(targets: Array, near: Array) -> Poses:
    """Return the result before anything is found."""
    T = len(near)
    return Poses(targets, near.copy(), np.full(T, np.inf), np.zeros(T, dtype=bool), np.full(T, -1))


def _different(q: Array, rows: Array) -> list[int]:
    """Return the first of each group of rows whose positions q agree."""
    kept: list[int] = []
    for k in rows.tolist():
        if all(float(np.abs(q[k] - q[j]).max()) > SAME for j in kept):
            kept.append(k)
    return kept


def _rotations(quaternions: Array) -> Array:
    """Return the rotations (..., 3, 3) of quaternions (..., 4), scalar first."""
    w, x, y, z = np.moveaxis(quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))
