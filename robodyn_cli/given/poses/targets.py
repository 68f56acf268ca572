"""What inverse kinematics takes and gives: targets, tasks, found positions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError, did_you_mean, unknown_name
from robodyn_cli.given.poses.criteria import Criterion
from robodyn_cli.given.poses.equations import packed
from robodyn_cli.model.model import FixedFrame, Model
from robodyn_cli.record import record
from robodyn_cli.scene.points import point_problem, with_points
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.poses.steps import ORIENTATIONS, PoseTask
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Array

SAME = 1e-6  # rad or m, for positions that count as one


@record
class PoseDemand:
    """What is asked of a frame, and how its poses are sought.

    position : the components that are asked for, of ``xyz``. orientation : ``full``; ``axis``, the direction of
    ``axis`` (3,) in the frame's coordinates alone; or ``free``. criterion : what decides between positions: ``nearest``
    (to ``near``), ``away_from_limits``, ``least_torque``. limits : whether the joints' limits are respected.
    method : ``auto``, or ``damped`` for no closed form.
    """

    position: str = "xyz"
    orientation: str = "full"
    axis: Sequence[float] = (0.0, 0.0, 1.0)
    criterion: str = Criterion.NEAREST.value
    limits: bool = True
    method: str = "auto"

    def task(self, frame: FixedFrame) -> PoseTask:
        """Return the task for a frame.

        Raises
        ------
        SceneError : a choice that there is not, or nothing is asked.
        """
        check_choice("orientation", self.orientation, ORIENTATIONS)
        check_choice("method", self.method, ("auto", "damped"))
        check_choice("criterion", self.criterion, tuple(x.value for x in Criterion))
        position, length = self.position, float(np.linalg.norm(self.axis))
        if any(x not in "xyz" for x in position) or len(set(position)) != len(position):
            raise SceneError(f"position {position!r}: the components that are asked for, each once, of xyz")
        if not position and self.orientation == "free":
            raise SceneError("nothing is asked of the frame: neither a position nor an orientation")
        if len(self.axis) != 3 or not length > 0.0:
            raise SceneError(f"axis {list(self.axis)}: three numbers, not all zero")
        x, y, z = (float(x) / length for x in self.axis)
        return PoseTask(frame, tuple(sorted("xyz".index(x) for x in position)), self.orientation, (x, y, z))


@record
class Poses:
    """Positions q (T, nq) for T targets (T, 12), and what is left of them.

    targets : position, then rotation row by row. error : the larger of distance [m] and angle [rad] to each target,
    and of what the loops lack (T,). reached : (T,). branch : of each target the place of its branch in ``branch_names``
    of the inverse kinematics, -1 where no closed form found it.
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


def packed_targets(task: PoseTask, position: Array, rotation: Array | None) -> Array:
    """Return targets (T, 12) of positions and rotations as ``InverseKinematics.solve`` takes them.

    Raises
    ------
    SceneError : of another shape, or no rotation.
    """
    p = np.atleast_2d(np.asarray(position, dtype=float))
    if p.ndim != 2 or p.shape[1] != 3:
        raise SceneError(f"targets need positions of three numbers, here of shape {np.shape(position)}")
    if rotation is None:
        if task.orientation != "free":
            raise SceneError("a target with an orientation needs a rotation; or choose orientation: free")
        rotation = np.eye(3)
    R = np.asarray(rotation, dtype=float)
    if R.shape[-1] == 4:
        R = quaternion.rotations(R)
    if R.shape[-2:] != (3, 3) or R.ndim > 3 or np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max() > 1e-9:
        raise SceneError(f"targets need rotations (3, 3) or unit quaternions (4,), here of shape {R.shape}")
    T = max(len(p), len(R) if R.ndim == 3 else 1)
    return packed(np.broadcast_to(p, (T, 3)), np.broadcast_to(R, (T, 3, 3)))


def find_frame(model: Model, name: str) -> FixedFrame:
    """Return a named point, a named frame or a link's frame.

    Raises
    ------
    SceneError : there is none of that name.
    """
    for known in (model.frames, model.points, model.links):
        if name in known:
            return known[name]
    names = [*model.points, *model.frames, *model.links]
    raise SceneError(unknown_name("frame", name, names))


def with_frame(source: Scene | Problem, frame: str) -> Problem:
    """Return the equations, with a place such as ``LINK.end`` among the points."""
    if isinstance(source, Problem):
        return source
    named = "." in frame and point_problem(source.robot, frame) is None
    return Problem(with_points(source, [frame]) if named else source)


def check_choice(key: str, value: str | None, allowed: Sequence[str | None]) -> None:
    if value not in allowed:
        listed = ", ".join(x for x in allowed if x is not None) or "none: there is no closed form here"
        raise SceneError(
            f"{key} {value!r}{did_you_mean(str(value), [x for x in allowed if x])}; allowed: {listed}"
        )


def nothing_found(targets: Array, near: Array) -> Poses:
    """Return the result before anything is found."""
    T = len(near)
    return Poses(targets, near.copy(), np.full(T, np.inf), np.zeros(T, dtype=bool), np.full(T, -1))


def different(q: Array, rows: Array) -> list[int]:
    """Return the first of each group of rows whose positions q agree."""
    kept: list[int] = []
    for k in rows.tolist():
        if all(float(np.abs(q[k] - q[j]).max()) > SAME for j in kept):
            kept.append(k)
    return kept
