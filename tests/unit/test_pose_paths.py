"""Paths of poses followed by arms and mechanisms: exact rates, branches by name, redundancy, and what is in the way."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robodyn_cli import InverseKinematics, load_scene
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import GeometryError, SceneError, SingularConfigurationError
from robodyn_cli.ready.doors import along
from robodyn_cli.scene.points import with_points
from robodyn_cli.solve.poses.screws import rotations
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.torques.build import build_inverse
from robodyn_cli.torques.checks import attitude_error
from robodyn_cli.trajectories.base import Ik, TaskSpaceTrajectory
from robodyn_cli.trajectories.motion import PoseMotion
from robodyn_cli.works.kinematics import plan
from tests.numeric import assert_close
from tests.source import ROOT
from tests.unit.arms import differences
from tests.unit.pose_arms import angles, general

ROBOTS = ROOT / "robodyn_cli" / "robots"
PUMA = load_scene(ROBOTS / "puma560.yaml")
SEVEN = load_scene(ROBOTS / "seven_joint_arm.yaml")
TIMES = np.linspace(0.0, 2.0, 201)
POSES = {"link6": [0.3, 0.7, -0.9, 0.4, -0.8, 0.2], "link7": [0.1, 0.6, 0.2, -1.5, 0.3, 1.2, 0.1]}


class ScrewPath(TaskSpaceTrajectory):
    """A frame that goes to and fro along a line while it turns about an axis: p0 + s a, rot(u, s) R0, s = sin(w t) / 2."""

    def __init__(self, point: str, p: Array, R: Array, ik: Ik, along: Array) -> None:
        self.point, self.p, self.R, self.ik, self.along, self.duration = point, p, R, ik, along, 2.0

    def target(self, times: Array, parameters: object) -> PoseMotion:
        w, u = 1.3, np.array([1.0, 2.0, -1.0]) / np.sqrt(6.0)
        t = np.asarray(times)
        s, v, a = 0.5 * np.sin(w * t), 0.5 * w * np.cos(w * t), -0.5 * w * w * np.sin(w * t)
        line = [np.outer(x, self.along) for x in (s, v, a)]
        return PoseMotion(
            self.p + line[0], line[1], line[2], rotations(u, s) @ self.R, np.outer(v, u), np.outer(a, u)
        )


def followed(scene, frame, q=None, along=(0.2, 0.1, -0.16), guess=True, **ik):
    """Return the motion, the scene with its path, and the inverse kinematics of the frame."""
    solver = InverseKinematics(scene, frame)
    q = np.array(POSES[frame] if q is None else q)
    p, R = solver.forward(q[None])
    start = dict(zip(solver.model.q_names, q.tolist())) if guess else {}
    path = ScrewPath(
        f"{frame}.origin", p[0], R[0], dataclasses.replace(Ik(), guess=start, **ik), np.array(along)
    )
    place = solver.task.frame
    scene = with_points(scene, [path.point])
    problem = Problem(
        dataclasses.replace(
            scene, trajectory=path, kinematics=dataclasses.replace(scene.kinematics, samples=201)
        )
    )
    # the path is that of the link's frame, whose origin may lie elsewhere than the joint's
    problem.model.points[path.point] = place
    return plan(problem)[0], path, solver


def check(planned, path, solver, tolerance=1e-12):
    """Check poses, and rates and accelerations by differences."""
    target = path.target(TIMES, {})
    p, R = solver.forward(planned.motion.q)
    assert_close(p, target.p, tolerance, scale=1.0)
    assert angles(R, target.R).max() < 10 * tolerance
    h = TIMES[1] - TIMES[0]
    for x, rate in ((planned.motion.q, planned.motion.qd), (planned.motion.qd, planned.motion.qdd)):
        assert_close(differences(x, h), rate[4:-4], 1e-7, scale=max(1.0, np.abs(rate).max()))


@pytest.mark.parametrize(("scene", "frame"), [(PUMA, "link6"), (SEVEN, "link7")])
def test_a_path_of_poses_is_followed_with_exact_rates(scene, frame: str) -> None:
    check(*followed(scene, frame))


@pytest.mark.parametrize("branch", ["righty-elbow_up-flip", "lefty-elbow_down-no_flip"])
def test_the_branch_is_chosen_by_name_and_kept(branch: str) -> None:
    planned, path, solver = followed(PUMA, "link6", guess=False, branch=branch)
    check(planned, path, solver)
    target = path.target(TIMES, {})
    named = solver.solve(target.p, target.R, branch=branch, near=planned.motion.q)
    assert_close(named.q, planned.motion.q, 1e-9, scale=1.0)


def test_torque_stays_near_its_least_along_a_path() -> None:
    q = InverseKinematics(SEVEN, "link7", criterion="least_torque")
    kept, path, solver = followed(SEVEN, "link7", redundancy="least_torque")
    check(kept, path, solver, 1e-11)
    free, *_ = followed(SEVEN, "link7", guess=True)
    targets = path.target(TIMES, {})
    d = np.concatenate([targets.p, targets.R.reshape(-1, 9)], axis=1)
    value = {name: q._values(m.motion.q, d, m.motion.q) for name, m in (("kept", kept), ("free", free))}
    assert value["kept"].max() < value["free"].min()
    best = q.solve(targets.p[::40], targets.R[::40], near=kept.motion.q[::40])
    assert np.all(value["kept"][::40] <= 1.05 * q._values(best.q, best.targets, best.q) + 1e-6)


def test_a_path_away_from_limits_begins_in_their_middle() -> None:
    scene = general(np.random.default_rng(4), 8, (), "limits: {lower: -2.0, upper: 2.0}")
    solver = InverseKinematics(scene, "flange", criterion="away_from_limits")
    q = 0.4 * np.cos(np.arange(8.0))
    p, R = solver.forward(q[None])
    found = solver.solve(p, R)
    assert found.reached[0] and np.sum(found.q**2) < np.sum(q**2)


def test_the_attitude_is_judged_beside_the_place() -> None:
    """A last joint that is off by an angle turns the frame by it, and moves no point of its axis."""
    program = build_inverse(along(load_scene(ROOT / "configs" / "trajectories" / "pick_and_place.yaml")))
    planned = program.plan(program.times(21))
    problem, q = program.problem, planned.motion.q.copy()
    exact = attitude_error(problem, planned)
    assert isinstance(exact, float) and exact < 1e-11
    q[7, -1] -= 1e-3
    off = dataclasses.replace(planned, motion=dataclasses.replace(planned.motion, q=q))
    assert attitude_error(problem, off) == pytest.approx(1e-3, rel=1e-9)
    assert attitude_error(problem, dataclasses.replace(planned, axes=None)) is ABSENT


@pytest.mark.parametrize(("robot", "frame"), [("stewart_platform", "platform")])
def test_a_platform_is_led_by_poses(robot: str, frame: str) -> None:
    from robodyn_cli import assemble

    scene = load_scene(ROBOTS / f"{robot}.yaml")
    q = assemble(scene)["q"][0]
    solver = InverseKinematics(scene, frame)
    scene = dataclasses.replace(
        scene, prescribed={}, trajectory=None,
        initial=dataclasses.replace(scene.initial, q=dict(zip(solver.model.q_names, q.tolist())), hold=()),
    )  # fmt: skip
    planned, path, solver = followed(scene, frame, q, along=(0.05, 0.04, 0.03), guess=False)
    target = path.target(TIMES[:21], {})
    assert planned.method == "newton" and max(planned.residuals.values()) < 1e-9
    p, R = solver.forward(planned.motion.q[:21])
    assert_close(p, target.p, 1e-10, scale=1.0)
    assert angles(R, target.R).max() < 1e-9


# -- what is in the way -------------------------------------------------------------------------------------
def test_a_singular_pose_is_named_with_time_and_joint() -> None:
    straight_wrist = [0.3, 0.7, -0.9, 0.4, 0.0, 0.2]
    with pytest.raises(
        SingularConfigurationError, match="singular configuration at t = 0 s .* joint 'q[46]'"
    ):
        followed(PUMA, "link6", straight_wrist)


def test_a_target_out_of_reach_is_named_with_its_time() -> None:
    with pytest.raises(GeometryError, match=r"cannot reach its target at t = 0\.\d+ s"):
        followed(PUMA, "link6", along=(3.0, 0.0, 0.0), max_iterations=8)
    with pytest.raises(
        GeometryError, match="cannot reach its target at t = 0 s on branch righty-elbow_up-flip"
    ):
        solver = InverseKinematics(PUMA, "link6")
        path = ScrewPath(
            "link6.origin", np.array([3.0, 0, 0]), np.eye(3), Ik(branch="righty-elbow_up-flip"), np.ones(3)
        )
        plan(
            Problem(dataclasses.replace(with_points(solver.problem.scene, ["link6.origin"]), trajectory=path))
        )


@pytest.mark.parametrize(
    ("scene", "frame", "ik", "said"),
    [
        (PUMA, "link6", {"branch": "elbow_up"}, "no branch of this arm; allowed: righty-elbow_up-no_flip"),
        (SEVEN, "link7", {"branch": "elbow_up"}, "only for arms whose branches have names"),
        (PUMA, "link6", {"redundancy": "least_torque"}, "the path determines all joints"),
    ],
)
def test_options_that_do_not_fit(scene, frame: str, ik: dict, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        followed(scene, frame, **ik)
