"""``reach``: joint positions that bring a frame to a pose, and all branches where the arm's structure names them."""

from __future__ import annotations

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import GeometryError, SceneError
from robodyn_cli.given.poses.inverse_kinematics import InverseKinematics, explain_miss
from robodyn_cli.given.poses.targets import Poses, Way
from robodyn_cli.model.joints import orientation
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.observe.evaluation import refuse_result
from robodyn_cli.observe.observe import add_sample
from robodyn_cli.observe.rounding import ENLARGED
from robodyn_cli.observe.units import JointColumns
from robodyn_cli.ready.closed_errors import SAFETY, Noise
from robodyn_cli.ready.doors import at_rest
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.nested_options import ReachOptions
from robodyn_cli.scene.types import Ready, Scene
from robodyn_cli.solve.closing.balance import LEFT
from robodyn_cli.solve.closure import RANK
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Termination
from robodyn_cli.summaries.mechanism import ReachedBranch, ReachErrors, ReachSummary
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.works.rest.errors import BELIEVED, CLEAR, Nearby, beyond_rounding, parts_of

AT_LEAST = 2.0  # times the largest draw of a row: what rounding makes of it


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
    errors = ErrorsOfPoses(solver, poses.targets[0])
    branches, off = [_described(solver, errors, way, q) for way in ways], errors(q)
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
            singular_ratio=errors.ratio(q),
            singular_ratio_error=off.ratio,
            error_estimate=ReachErrors(dict(zip(solver.model.q_names, off.q.tolist()))),
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


def _described(solver: InverseKinematics, errors: ErrorsOfPoses, way: Way, q: Array) -> ReachedBranch:
    chosen = bool(np.abs(way.q - q).max() < 1e-6)
    names, reached = solver.model.q_names, way.error <= solver.tolerance
    off = dict(zip(names, errors(way.q).q.tolist())) if reached else ABSENT
    configuration = dict(zip(names, way.q.tolist()))
    return ReachedBranch(way.name, configuration, reached, way.within_limits, way.error, chosen, off)


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


@record
class OffPose:
    """How far positions that reach a pose may be off: by coordinate (nq,), and the ratio of singular values there."""

    q: Array
    ratio: float


class ErrorsOfPoses:
    """Errors of joint positions that bring a frame to a pose.

    What is left of the pose and of loops, and rounding, which is drawn as for loops (``ready.closed_errors``), move the
    positions by J dq = e, with the least norm where the pose leaves freedoms. A direction in which J changes by
    much over such an error, as where branches meet, is searched instead (see ``works.rest.errors``).

    Parameters
    ----------
    solver : of the frame. target : (12,).
    """

    def __init__(self, solver: InverseKinematics, target: Array) -> None:
        self.equations, self.target = solver.equations, target
        self.moving, self.manifold = list(solver.equations.moving), Manifold(solver.model)
        self.lengths = np.array(self.equations.lengths)
        rows = self.equations.rows
        self.rank = min(len(self.moving) - solver.freedom, len(rows.e))
        self._noise = Noise([*rows.e, *rows.J.flat])

    def ratio(self, q: Array) -> float:
        """Return the smallest over the largest singular value of what moves the frame, as far as its general rank."""
        return self._ratio(self._at(q)[1])

    def __call__(self, q: Array) -> OffPose:
        """Return the errors of positions q (nq,)."""
        e, J = self._at(q)
        d = self.equations.data(self.target[None], q)
        noise = self._noise({"q": q[None], "d": d, "p": np.array(self.equations.limits.numbers)[None]})
        off, dJ = noise[:, : len(e)], noise[:, len(e) :].reshape(len(noise), len(e), -1)[:, :, self.moving]
        U, s, Vt = np.linalg.svd(J, full_matrices=False)
        kept = (np.arange(len(s)) < self.rank) & (s > RANK * s.max(initial=0.0))
        for _ in range(2):
            strong = (Vt[kept].T / s[kept]) @ U[:, kept].T
            steps = (ENLARGED * e + off) @ strong.T
            parts = parts_of(steps[None], np.ones(len(self.moving)))[0]
            places = [self._moved(q, part * step) for part, step in zip(parts, steps)]
            jacobians = [self._at(x)[1] + part * own for x, part, own in zip(places, parts, dJ)]
            weights = SAFETY / (ENLARGED * parts)
            there = np.array([np.linalg.svd(x, compute_uv=False) for x in jacobians])
            believed = kept & (weights[:, None] * np.abs(there - s) <= BELIEVED * s).all(axis=0)
            if (believed == kept).all():
                break
            kept = believed
        sure = CLEAR * SAFETY / ENLARGED * np.abs(off @ U).max(axis=0)
        for k in np.flatnonzero(~kept[: self.rank]):
            places += self._cleared(q, (U[:, k], Vt[k], strong), float(sure[k]))
        none = np.zeros((len(places), 0))
        nearby = Nearby(np.array(places), none, none[:, None], weights)
        ratios = np.array([self._ratio(x) for x in jacobians] + [self.ratio(x) for x in places[len(parts) :]])
        error = nearby.off((ratios - self._ratio(J))[:, None])[0] + LEFT
        # the draws of a figure may all chance to be small: what each row lacks at least, with the worst sign
        lacking = np.abs(e) + AT_LEAST / ENLARGED * np.abs(off).max(axis=0, initial=0.0)
        for k in np.flatnonzero(kept)[-1:]:
            way = Vt[k] * (np.abs(U[:, k]) @ lacking / s[k])
            error = max(error, *(abs(self.ratio(self._moved(q, x)) - self._ratio(J)) for x in (way, -way)))
        least = self._by_coordinate(np.abs(strong) @ lacking)
        return OffPose(np.maximum(nearby.off(nearby.q - q), least), float(error))

    def _by_coordinate(self, steps: Array) -> Array:
        """Return what positions (nq,) are off by where what moves is, in comparable units."""
        found = np.zeros(len(self.manifold.neutral()))
        for k, step in zip(self.moving, steps):
            found[list(self.manifold.columns(k))] += step * self.lengths[k]
        return found

    def _at(self, q: Array) -> tuple[Array, Array]:
        e, J = self.equations.at(q, self.target)
        return e, J[:, self.moving]

    def _ratio(self, J: Array) -> float:
        s = np.linalg.svd(J, compute_uv=False)
        return float(s[self.rank - 1] / s[0]) if self.rank else 0.0

    def _moved(self, q: Array, step: Array) -> Array:
        """Return positions after a step of what moves, in comparable units."""
        dq = np.zeros(len(self.lengths))
        dq[self.moving] = step * self.lengths[self.moving]
        return self.manifold.normalise(self.manifold.integrate(q, dq))

    def _cleared(self, q: Array, along: tuple[Array, Array, Array], sure: float) -> list[Array]:
        """Return positions on both sides from which on more is left along a motion than here, rounding included; none
        where that is nowhere.

        along : the row u (m,), the motion v, and the inverse of the other motions, which meet what they can.
        """
        u, v, strong = along
        sure += CLEAR * abs(float(u @ self._at(q)[0]))

        def at(s: float) -> Array:
            there = self._moved(q, s * v)
            return self._moved(there, strong @ self._at(there)[0])

        return beyond_rounding(at, lambda x: abs(float(u @ self._at(x)[0])) > sure)
