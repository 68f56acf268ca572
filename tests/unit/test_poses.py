"""Inverse kinematics of poses: closed forms, damped steps, limits and criteria; poses are checked by Pinocchio."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli import InverseKinematics, load_scene
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.given.poses.inverse_kinematics import explain_miss
from robodyn_cli.scene import load_scene_text
from tests.numeric import assert_close
from tests.source import ROOT
from tests.unit.pose_arms import (
    Oracle,
    angles,
    general,
    parallel_axes,
    spherical_wrist,
    three_parallel,
)

pytest.importorskip("pinocchio")
ROBOTS = ROOT / "robodyn_cli" / "robots"
SEVEN = load_scene(ROBOTS / "seven_joint_arm.yaml")

ARMS = {
    "spherical wrist": (spherical_wrist, 8),
    "three parallel axes": (three_parallel, 8),
    "planar 3R": (lambda rng: parallel_axes(rng, 3, None), 2),
    "SCARA, slide third": (lambda rng: parallel_axes(rng, 3, 2), 2),
    "SCARA, slide first": (lambda rng: parallel_axes(rng, 3, 0), 2),
    "SCARA, slide last": (lambda rng: parallel_axes(rng, 3, 3), 2),
}


def same_turn(q, p):
    """Largest difference of angles that may differ by whole turns."""
    return np.abs(np.angle(np.exp(1j * (q - p)))).max(axis=-1)


def spread(ik, count, seed=7):
    rng = np.random.default_rng(seed)
    return ik.limits.spread(rng.uniform(size=(count, ik.model.nv)), ik.model, ik.equations.size)


# -- closed forms -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ARMS)
@pytest.mark.parametrize("seed", range(4))
def test_branches_of_random_arms_reach_the_pose_and_one_is_the_arm_as_it_was(kind: str, seed: int) -> None:
    make, count = ARMS[kind]
    ik = InverseKinematics(make(np.random.default_rng(seed)), "flange")
    assert len(ik.branch_names) == count
    oracle = Oracle(ik.model, "flange")
    # slides move lengths, which wrap no turns
    q = np.where([unit == "rad" for unit in ik.model.q_units], spread(ik, 40, seed), 0.3)
    p, R = oracle(q)
    recovered = np.zeros(len(q), dtype=int)
    for name in ik.branch_names:
        found = ik.solve(p, R, branch=name)
        at, axes = oracle(found.q[found.reached])
        assert_close(at, p[found.reached], 1e-11, scale=1.0)
        assert angles(axes, R[found.reached]).max(initial=0.0) < 1e-10
        recovered += found.reached & (same_turn(found.q, q) < 1e-6)
    assert np.all(recovered == 1)


@pytest.mark.parametrize("make", [spherical_wrist, three_parallel])
def test_a_branch_keeps_its_name_along_a_motion(make) -> None:
    """The name is that of the arm, not of a number in a list: it changes in singular poses only."""
    ik = InverseKinematics(make(np.random.default_rng(5)), "flange")
    start, end = spread(ik, 2, 3)
    way = start + np.linspace(0.0, 0.2, 200)[:, None] * (end - start)
    p, R = ik.forward(way)
    names, ratios = [], []
    for k, q in enumerate(way):
        fits = [way.name for way in ik.ways(p[k], R[k]) if same_turn(way.q, q) < 1e-6]
        names.append(fits)
        J = ik.equations.jacobian(q, np.concatenate([p[k], R[k].ravel()]))
        ratios.append(np.linalg.det(J))
    changes = [k for k in range(1, len(way)) if names[k] != names[k - 1]]
    for k in changes:
        assert ratios[k] * ratios[k - 1] < 0.0
    assert len(changes) < 10 and all(len(fits) == 1 for fits in names)


def test_words_of_the_puma_are_what_is_seen() -> None:
    ik = InverseKinematics(load_scene(ROBOTS / "puma560.yaml"), "link6")
    ways = {way.name: way.q for way in ik.ways([0.5, 0.1, 0.8], np.diag([1.0, -1.0, -1.0]))}
    corners = ik.problem.model.links
    for name, q in ways.items():
        shoulder, elbow, wrist = (
            ik.problem.numbers(list(ik.problem.world_point(corners[link])), q)
            for link in ("link1", "link2", "link4")
        )
        out = (wrist - shoulder) @ [1.0, 0.0, 0.0]
        above = elbow[2] - shoulder[2] > (wrist[2] - shoulder[2]) * ((elbow - shoulder)[0] / out)
        assert above == ("elbow_up" in name)
    # the front of the first joint is where the wrist is in the zero position: ahead at 0, behind at half a turn
    assert all((np.cos(q[0]) > 0.0) == name.startswith("righty") for name, q in ways.items())
    assert all((np.sin(q[4]) < 0.0) == name.endswith("no_flip") for name, q in ways.items())


def test_singular_wrist_has_a_solution() -> None:
    ik = InverseKinematics(load_scene(ROBOTS / "puma560.yaml"), "link6")
    q = np.array([[0.3, 0.7, 0.4, 0.5, 0.0, 0.2]])
    p, R = ik.forward(q)
    for name in ik.branch_names[2:4]:
        found = ik.solve(p, R, branch=name)
        at, axes = ik.forward(found.q)
        assert_close(at, p, 1e-8, scale=1.0)
        assert angles(axes, R).max() < 1e-7


# -- damped steps -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("joints", "slides"), [(6, ()), (6, (3,)), (7, ()), (7, (1, 5)), (8, (2,)), (5, ())])
def test_general_arms_reach_every_pose_that_some_position_has(joints: int, slides: tuple[int, ...]) -> None:
    limits = "limits: {lower: -2.5, upper: 2.8}"
    ik = InverseKinematics(general(np.random.default_rng(joints), joints, slides, limits), "flange")
    assert ik.closed_form is None and ik.freedom == max(joints - 6, 0)
    oracle = Oracle(ik.model, "flange")
    p, R = oracle(spread(ik, 200))
    found = ik.solve(p, R)
    assert found.reached.mean() >= (1.0 if joints != 5 else 0.97)
    at, axes = oracle(found.q[found.reached])
    assert np.abs(at - p[found.reached]).max() < 1e-10
    assert angles(axes, R[found.reached]).max() < 2e-10
    assert found.q.min() >= -2.5 - 1e-9 and found.q.max() <= 2.8 + 1e-9


def test_a_pose_has_one_answer_whatever_stands_beside_it() -> None:
    ik = InverseKinematics(SEVEN, "link7")
    p, R = ik.forward(spread(ik, 30))
    together = ik.solve(p, R)
    for k in (0, 7, 29):
        alone = ik.solve(p[k], R[k])
        np.testing.assert_array_equal(alone.q[0], together.q[k])


def test_parts_of_a_pose() -> None:
    oracle = Oracle(InverseKinematics(SEVEN, "link7").model, "link7")
    q = spread(InverseKinematics(SEVEN, "link7"), 50)
    p, R = oracle(q)
    for position, freedom in (("xyz", 3), ("xz", 4), ("y", 5)):
        ik = InverseKinematics(SEVEN, "link7", position=position, orientation="free")
        found = ik.solve(p)
        kept = ["xyz".index(x) for x in position]
        assert ik.freedom == freedom and found.reached.all()  # the last joint turns about the frame's origin
        assert np.abs(oracle(found.q)[0] - p)[:, kept].max() < 1e-10
    axis = np.array([1.0, 2.0, -0.5])
    ik = InverseKinematics(SEVEN, "link7", orientation="axis", axis=axis)
    found = ik.solve(p, R)
    at, axes = oracle(found.q)
    assert found.reached.all() and ik.freedom == 2
    assert_close(at, p, 1e-10, scale=1.0)
    assert_close(axes @ axis, R @ axis, 1e-9, scale=1.0)
    ik = InverseKinematics(SEVEN, "link7", position="", orientation="full")
    found = ik.solve(p, R)
    assert found.reached.all() and angles(oracle(found.q)[1], R).max() < 1e-10


def test_a_joint_without_influence_keeps_its_value() -> None:
    scene = load_scene(ROBOTS / "puma560.yaml")
    ik = InverseKinematics(scene, "link4", orientation="free")
    near = np.array([0.2, 0.3, -0.4, 1.1, -7.0, 9.0])
    p, _ = ik.forward(spread(ik, 20))
    found = ik.solve(p, near=near)
    assert found.reached.all()
    np.testing.assert_array_equal(found.q[:, 4:], np.tile(near[4:], (20, 1)))


# -- limits -----------------------------------------------------------------------------------------------
PUMA_LIMITS = """schema: 1
gravity: [0, 0, -9.81]
robot:
  convention: standard
  joints:
    - {name: q1, type: revolute, d: 0.67, a: 0, alpha: 90 deg, limits: {lower: -160 deg, upper: 160 deg}}
    - {name: q2, type: revolute, d: 0, a: 0.43, alpha: 0, limits: {lower: -20 deg, upper: 200 deg}}
    - {name: q3, type: revolute, d: 0.15, a: 0.02, alpha: -90 deg, limits: {lower: -225 deg, upper: 45 deg}}
    - {name: q4, type: revolute, d: 0.43, a: 0, alpha: 90 deg, limits: {lower: -400 deg, upper: 400 deg}}
    - {name: q5, type: revolute, d: 0, a: 0, alpha: -90 deg, limits: {lower: -100 deg, upper: 100 deg}}
    - {name: q6, type: revolute, d: 0.05, a: 0, alpha: 0, limits: {lower: 10 deg, upper: 300 deg}}
  links: [{name: l1}, {name: l2}, {name: l3}, {name: l4}, {name: l5}, {name: l6}]
"""


@pytest.mark.parametrize("method", ["auto", "damped"])
def test_limits_are_kept_and_whole_turns_tried(method: str) -> None:
    ik = InverseKinematics(load_scene_text(PUMA_LIMITS), "l6", method=method)
    p, R = ik.forward(spread(ik, 300))
    found = ik.solve(p, R)
    assert found.reached.all()
    assert ik.limits.within(found.q).all()
    assert_close(ik.forward(found.q)[0], p, 1e-10, scale=1.0)


def test_what_is_in_the_way_is_named() -> None:
    ik = InverseKinematics(load_scene_text(PUMA_LIMITS), "l6", orientation="free")
    far = ik.solve([0.0, 0.0, 2.6])
    assert not far.reached[0] and explain_miss(ik, far, 0).startswith("the nearest pose found is 1.0")
    stretched = InverseKinematics(load_scene(ROBOTS / "planar_2r.yaml"), "link2.end", orientation="free")
    far = stretched.solve([2.0, 3.0, 0.0])
    assert "in a singular pose, in which moving joint" in explain_miss(stretched, far, 0)
    one = load_scene_text(
        "schema: 1\ngravity: [0, 0, 0]\nrobot:\n  joints:\n"
        "    - {name: turn, type: revolute, origin: {}, axis: [0, 0, 1], limits: {lower: -1, upper: 1}}\n"
        "  links: [{name: l}]\n  points: {tip: {link: l, at: [1, 0, 0]}}\n"
    )
    ik = InverseKinematics(one, "tip", position="xy", orientation="free")
    found = ik.solve([0.0, 1.0, 0.0])
    assert not found.reached[0] and found.q[0, 0] == pytest.approx(1.0)
    assert "joint 'turn' at 1.5708, beyond its limits of -1 to 1" in explain_miss(ik, found, 0)


# -- criteria ---------------------------------------------------------------------------------------------
def self_motion(ik, q, steps=800):
    """Positions (k, n) all the way round the self-motion through q, by small steps along the null space of J."""
    p, R = ik.forward(q[None])
    target = np.concatenate([p[0], R[0].ravel()])
    found, direction = [q], None
    for _ in range(steps):
        J = ik.equations.jacobian(found[-1], target)
        null = np.linalg.svd(J)[2][-1]
        direction = null if direction is None or null @ direction > 0.0 else -null
        moved = ik.without_limits._polished((found[-1] + 0.02 * direction)[None], target[None], q[None], 8)
        found.append(moved[0][0])
    return np.array(found)


@pytest.mark.parametrize("criterion", ["nearest", "least_torque"])
def test_the_criterion_has_its_smallest_value_of_all_the_self_motion(criterion: str) -> None:
    ik = InverseKinematics(SEVEN, "link7", criterion=criterion)
    q = np.array([0.4, 0.7, -0.5, 1.3, 0.6, 0.9, -0.2])
    near = q + 0.25 * np.array([1.0, -1.0, 1.0, 0.5, -0.5, 1.0, 1.0])
    p, R = ik.forward(q[None])
    found = ik.solve(p, R, near=near)
    ring = self_motion(ik, q)
    target = np.concatenate([p[0], R[0].ravel()])
    values = ik._values(ring, np.tile(target, (len(ring), 1)), np.tile(near, (len(ring), 1)))
    best = ik._values(found.q, target[None], near[None])[0]
    assert found.reached[0]
    assert best <= values.min() * (1.0 + 1e-9)
    if criterion == "nearest":
        assert best == pytest.approx(0.5 * np.sum((found.q[0] - near) ** 2), rel=1e-12)


def test_least_torque_is_the_torque_of_gravity() -> None:
    from robodyn_cli import InverseDynamics

    ik = InverseKinematics(SEVEN, "link7", criterion="least_torque")
    q = spread(ik, 5)
    d = np.zeros((5, 12))
    rest = np.zeros_like(q)
    tau = InverseDynamics(SEVEN)(q, rest, rest)
    values = ik._values(q, d, q)
    ratios = values / np.sum(tau**2, axis=1)
    assert_close(ratios, np.full(5, ratios[0]), 1e-12)


def test_away_from_limits_goes_to_the_middle() -> None:
    limits = "limits: {lower: -2.0, upper: 2.5}"
    scene = general(np.random.default_rng(2), 8, (), limits)
    plain = InverseKinematics(scene, "flange")
    away = InverseKinematics(scene, "flange", criterion="away_from_limits")
    p, R = plain.forward(0.25 + 0.5 * (spread(plain, 20) - 0.25))
    one, other = plain.solve(p, R, near=np.full(8, 2.3)), away.solve(p, R)
    assert one.reached.all() and other.reached.all()
    offset = lambda q: np.sum((q - 0.25) ** 2, axis=1)  # noqa: E731
    assert np.all(offset(other.q) <= offset(one.q) + 1e-9)
    # what is left of the gradient points along no self-motion
    for k in range(5):
        J = away.equations.jacobian(other.q[k], other.targets[k])
        null = np.linalg.svd(J)[2][6:]
        assert np.abs(null @ (other.q[k] - 0.25)).max() < 1e-6


# -- mechanisms -------------------------------------------------------------------------------------------
def test_five_bar_by_trigonometry() -> None:
    scene = load_scene(ROOT / "configs" / "mechanisms" / "five_bar_circle.yaml")
    ik = InverseKinematics(scene, "tip", position="xy", orientation="free")
    angle = np.linspace(0.0, 6.0, 40)
    targets = np.stack([0.3 + 0.15 * np.cos(angle), 0.9 + 0.15 * np.sin(angle), 0.0 * angle], axis=1)
    found = ik.solve(targets)
    assert found.reached.all()
    at, _ = ik.forward(found.q)
    assert_close(at[:, :2], targets[:, :2], 1e-12, scale=1.0)
    eta = np.array([ik.problem.numbers([row.eta for row in ik.problem.constraints.rows], q) for q in found.q])
    assert np.abs(eta).max() < 1e-12


@pytest.mark.parametrize(
    ("robot", "frame", "orientation"),
    [("stewart_platform", "platform", "full"), ("delta", "platform", "free")],
)
def test_parallel_robots_by_their_own_legs(robot: str, frame: str, orientation: str) -> None:
    from robodyn_cli import assemble

    scene = load_scene(ROBOTS / f"{robot}.yaml")
    ik = InverseKinematics(scene, frame, orientation=orientation)
    q = assemble(scene)["q"][0]
    p, R = ik.forward(q[None])
    rng = np.random.default_rng(1)
    targets = p + 0.03 * rng.normal(size=(50, 3))
    found = ik.solve(targets, R if orientation == "full" else None, near=q)
    assert found.reached.all() and ik.freedom == 0
    at, axes = ik.forward(found.q)
    assert_close(at, targets, 1e-10, scale=1.0)
    if orientation == "full":
        assert angles(axes, np.broadcast_to(R, axes.shape)).max() < 1e-10
    rows = [row.eta for row in ik.problem.constraints.rows]
    assert max(np.abs(ik.problem.numbers(rows, q)).max() for q in found.q) < 1e-10


# -- what is refused --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"frame": "link9"}, "unknown frame 'link9'"),
        ({"position": "xx"}, "each once"),
        ({"position": "", "orientation": "free"}, "nothing is asked"),
        ({"orientation": "half"}, "allowed: full, axis, free"),
        ({"criterion": "neerest"}, "did you mean 'nearest'"),
        ({"axis": (0, 0, 0)}, "not all zero"),
    ],
)
def test_choices_that_there_are_not(options: dict, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        InverseKinematics(SEVEN, options.pop("frame", "link7"), **options)


def test_targets_that_are_none() -> None:
    ik = InverseKinematics(SEVEN, "link7")
    with pytest.raises(SceneError, match="needs a rotation"):
        ik.solve([0.4, 0.1, 0.5])
    with pytest.raises(SceneError, match="rotations"):
        ik.solve([0.4, 0.1, 0.5], np.diag([1.0, 1.0, 2.0]))
    with pytest.raises(SceneError, match="positions of three"):
        ik.solve([0.4, 0.1], np.eye(3))
    with pytest.raises(SceneError, match="no closed form"):
        ik.solve([0.4, 0.1, 0.5], np.eye(3), branch="elbow_up")
    with pytest.raises(CapabilityError, match="infinitely many"):
        ik.ways([0.4, 0.1, 0.5], np.eye(3))
    with pytest.raises(CapabilityError, match="limits"):
        InverseKinematics(SEVEN, "link7", criterion="away_from_limits").solve([0.4, 0.1, 0.5], np.eye(3))
