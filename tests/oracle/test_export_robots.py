"""Exported robots: read again they have the same equations, and MuJoCo and Pinocchio find the same in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from robodyn_cli.cli.commands.export import OF_SCENES
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.over.export.scene import export_robot, formats
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.scene.types import Scene
from tests import urdf_robots
from tests.exported_robots import (
    GRAVITY,
    Array,
    Equations,
    initial,
    random_q,
    random_robot,
    scene_of,
    with_loops,
)

EXACT = 2e-13  # of the largest entry
IN_URDF = ("friction", "damper", "limits", "rotor")
KINDS = {
    "urdf+": ("revolute", "prismatic", "fixed", "floating", "planar"),
    "extended-urdf": ("revolute", "prismatic", "fixed", "floating", "planar", "universal", "spherical"),
    "sdf": ("floating", "revolute", "prismatic", "fixed", "helical", "universal", "spherical"),
    "mjcf": ("revolute", "prismatic", "fixed", "floating", "planar", "universal", "spherical", "cylindrical"),
}
LOOPS = {
    "urdf+": ("revolute", "prismatic", "planar", "fixed"),
    "extended-urdf": ("spherical", "fixed"),
    "sdf": ("revolute", "prismatic", "universal", "spherical", "fixed"),
    "mjcf": ("revolute", "spherical", "fixed"),
}
ACTING = {
    "urdf+": IN_URDF,
    "extended-urdf": IN_URDF,
    "sdf": (*IN_URDF, "spring"),
    "mjcf": (*IN_URDF, "spring", "ball rotor"),
}


def same(ours: Array, theirs: Array, scale: float | None = None) -> None:
    size = max(float(np.abs(ours).max(initial=0.0)), 1e-3) if scale is None else scale
    assert np.abs(ours - theirs).max(initial=0.0) <= EXACT * size


def read_again(scene: Scene, kind: str, folder: Path) -> tuple[Scene, list[str]]:
    files, notes = export_robot(scene, kind, folder)
    gravity = ", ".join(map(repr, GRAVITY))
    return load_scene_text(f"schema: 1\ngravity: [{gravity}]\nrobot: {files[0]}\n"), notes


def carried_over(old: Model, new: Model, q: Array, start: Array) -> tuple[Array, list[int]]:
    """Return positions of the new model, counted from ``start``, and for each of its velocities that of the old one."""
    out, places = np.zeros(new.nq), [0] * new.nv
    columns = {
        name.replace(".", "_"): (name in old.q_names and old.q_names.index(name), k)
        for k, name in enumerate(old.v_names)
    }
    for body in new.bodies:
        here = slice(body.q, body.q + body.joint.nq)
        if body.joint.nq == 1:  # of several MuJoCo makes one each
            at, places[body.v] = columns[body.joint_name]
            out[here] = q[at] - start[at]
            continue
        one = next(
            b
            for b in old.bodies
            if b.joint_name == body.joint_name or (b.joint.quasi and b.name == body.name)
        )
        there = slice(one.q, one.q + one.joint.nq)
        moved = one.joint.difference(start[there], q[there])
        out[here] = np.array(body.joint.integrate(np.array(body.joint.neutral()), moved), dtype=float)
        places[body.v : body.v + body.joint.nv] = range(one.v, one.v + one.joint.nv)
    return out, places


def compare(old: Scene, new: Scene, q: Array, start: Array, rng: np.random.Generator, closed: bool) -> None:
    ours, theirs = Problem(old).model, Problem(new).model
    there, places = carried_over(ours, theirs, q, start)
    v = rng.normal(size=ours.nv)
    if (
        closed
    ):  # and rates that keep the loops closed, since what rows say of others is a matter of their form
        v = v - Equations.of(old, q, v).directions @ v
    a, b = Equations.of(old, q, v), Equations.of(new, there, v[places])
    same(a.M[np.ix_(places, places)], b.M)
    same(a.h[places], b.h)
    if closed:
        same(a.directions[np.ix_(places, places)], b.directions, 1e2)
        same(a.drift[places], b.drift, 1e2 * max(1.0, float(np.abs(a.drift).max())))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", KINDS)
def test_a_tree_read_again_is_the_same(kind: str, seed: int, tmp_path: Path) -> None:
    """Every joint of the format with full inertias, turned frames, D-H parameters and what acts in it, to rounding."""
    rng = np.random.default_rng(seed)
    old = scene_of(random_robot(rng, KINDS[kind], ACTING[kind]))
    new, _ = read_again(old, kind, tmp_path)
    neutral = Manifold(Problem(old).model).neutral()
    for _ in range(3):
        compare(old, new, random_q(Problem(old).model, rng), neutral, rng, False)
    for joint in old.robot.joints if kind != "mjcf" else ():  # it has no limits of speed
        limits = dict(joint.forces).get("limits")
        if limits is not None:
            read = dict(next(x for x in new.robot.joints if x.name == joint.name).forces)["limits"]
            assert (read.lower, read.upper, read.speed, read.effort) == (
                limits.lower, limits.upper, limits.speed, limits.effort
            )  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("kind", "loop"), [(kind, loop) for kind in KINDS for loop in LOOPS[kind]])
def test_loops_read_again_are_the_same(kind: str, loop: str, seed: int, tmp_path: Path) -> None:
    """Each kind of loop with points and axes anywhere in turned links, one end of one loop on the ground."""
    rng = np.random.default_rng(100 + seed)
    # without a free body in SDF, where a loop to the ground is what holds it
    kinds = tuple(one for one in KINDS[kind] if one != "floating" or kind != "sdf")
    robot, q = with_loops(random_robot(rng, kinds, (), n=9), (loop, loop), rng)
    scene = scene_of(robot)
    model = Problem(scene).model
    scene = scene_of(robot, initial={"q": initial(model, q), "hold": list(model.joint_names)})
    new, notes = read_again(scene, kind, tmp_path)
    start = Manifold(model).neutral()
    if kind == "sdf":  # the poses of the file are those of closed loops
        start = q
        assert any("count from the start" in note for note in notes)
    compare(scene, new, q, start, rng, True)


@pytest.mark.parametrize(("first", "second"), [(a, b) for a in KINDS for b in KINDS])
def test_by_way_of_two_formats(first: str, second: str, tmp_path: Path) -> None:
    """What both can hold, with a coupler, is the same behind both: what is read can be written again."""
    rng = np.random.default_rng([len(first), len(second)])
    kinds = tuple(one for one in KINDS[first] if one in KINDS[second] and one != "floating")
    acting = tuple(one for one in ACTING[first] if one in ACTING[second])
    couplers = [{"name": "c", "terms": {"q0": 2.0, "q1": -0.7}, "value": 0.4}]
    old = scene_of(random_robot(rng, kinds, acting), couplers=couplers)
    between, _ = read_again(old, first, tmp_path / "first")
    new, _ = read_again(between, second, tmp_path / "second")
    model = Problem(old).model
    compare(old, new, random_q(model, rng), Manifold(model).neutral(), rng, True)
    (coupler,) = new.couplers
    assert coupler.value is not None
    scale = coupler.terms["q0"] / 2.0
    assert coupler.terms["q1"] == pytest.approx(-0.7 * scale) and coupler.value.constant == pytest.approx(
        0.4 * scale
    )


@pytest.mark.parametrize("last", ["revolute", "spherical", "planar"])
def test_links_without_mass_between_joints_are_no_bodies_of_mujoco(last: str, tmp_path: Path) -> None:
    """It has several joints in a body, each at its place in the frame of the last link, which are turned and off here."""
    rng = np.random.default_rng(len(last))
    robot = random_robot(rng, ("revolute", "prismatic", "universal", last, "fixed"), ("damper", "limits"), 5)
    for k, (joint, link) in enumerate(zip(robot["joints"], robot["links"])):
        joint["parent"] = f"link{k - 1}" if k else "base"
        if k in (1, 2):
            for key in ("com", "com_frame", "inertia"):
                del link[key]
            link["mass"] = 0.0
    old = scene_of(robot)
    new, _ = read_again(old, "mjcf", tmp_path)
    assert (tmp_path / "robot.xml").read_text(encoding="utf-8").count("<body") == 3
    model = Problem(old).model
    for _ in range(3):
        compare(old, new, random_q(model, rng), Manifold(model).neutral(), rng, False)
    robot["joints"][2] |= {"type": "cylindrical"}  # a coordinate more than fit into a body
    del robot["joints"][2]["axis2"]
    robot["joints"][1] = {
        **robot["joints"][2],
        **{k: robot["joints"][1][k] for k in ("name", "parent", "link")},
    }
    if last != "revolute":
        with pytest.raises(CapabilityError, match="link 'link1' moves and has no mass"):
            export_robot(scene_of(robot), "mjcf", tmp_path)


MIMICS = "[{name: c1, terms: {q0: 2.0, q1: -0.7}, value: 0.4}, {name: c2, terms: {q2: 1.0, q1: 0.3}}]"


@pytest.mark.parametrize("kind", KINDS)
def test_couplers_read_again_are_the_same(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    robot = random_robot(rng, ("revolute", "prismatic", "revolute"), (), n=3)
    old = scene_of(robot, couplers=yaml.safe_load(MIMICS))
    new, _ = read_again(old, kind, tmp_path)
    ours, theirs = Problem(old).model, Problem(new).model
    neutral = Manifold(ours).neutral()
    compare(old, new, random_q(ours, rng), neutral, rng, True)
    # a pose that satisfies them here does so there
    q = np.array([0.2 + 0.35 * 0.8, 0.8, -0.24])
    there, _ = carried_over(ours, theirs, q, neutral)
    for scene, at in ((old, q), (new, there)):
        from robodyn_cli.solve.closure import Numbers

        assert np.abs(Numbers(Problem(scene), ()).eta(at)).max() < 1e-15


def test_a_coupling_over_chains_comes_back(tmp_path: Path) -> None:
    """URDF+ couples all joints between two links, with one ratio: what it can say, and what it cannot."""
    rng = np.random.default_rng(6)
    robot = random_robot(rng, ("revolute",) * 5, (), n=5)
    for joint, parent in zip(robot["joints"], ("base", "base", "link0", "link1", "link3")):
        joint["parent"] = parent
    terms = {"q0": -1.5, "q2": -1.5, "q1": 0.5, "q3": 0.5, "q4": 0.5}
    old = scene_of(robot, couplers=[{"name": "belt", "terms": terms}])
    new, _ = read_again(old, "urdf+", tmp_path)
    assert {k: x * -0.5 for k, x in new.couplers[0].terms.items()} == pytest.approx(terms, abs=1e-16)
    inner = scene_of(robot, couplers=[{"name": "belt", "terms": {"q1": 1.0, "q3": 1.0, "q4": 1.0}}])
    assert dict(read_again(inner, "urdf+", tmp_path)[0].couplers[0].terms) == {
        "q1": 1.0,
        "q3": 1.0,
        "q4": 1.0,
    }
    skew = scene_of(robot, couplers=[{"name": "belt", "terms": {**terms, "q4": 0.4}}])
    with pytest.raises(CapabilityError, match="coupler 'belt' of 5 joints"):
        export_robot(skew, "urdf+", tmp_path)


@pytest.mark.parametrize("kind", ["urdf+", "extended-urdf"])
def test_pinocchio_finds_the_same_tree(kind: str, tmp_path: Path) -> None:
    """It reads the file, with loops too, and finds the equations that are read of it here."""
    pin = pytest.importorskip("pinocchio")
    rng = np.random.default_rng(11)
    kinds = ("revolute", "prismatic", "fixed", "floating")
    robot = random_robot(rng, kinds, ("friction", "limits"), n=7)
    files, _ = export_robot(scene_of(robot), kind, tmp_path)
    apart = urdf_robots.compare(files[0])
    assert max(apart.torques, apart.mass, apart.frames) < 1e-12
    files, _ = export_robot(scene_of(with_loops(robot, ("fixed",), rng)[0]), kind, tmp_path)
    assert pin.buildModelFromUrdf(str(files[0])).nv == apart.joints


def test_formats_of_the_command_line() -> None:
    assert tuple(formats) == OF_SCENES


# -- MuJoCo ------------------------------------------------------------------------------------------------
class InMujoco:
    """An exported MJCF: its coordinates among ours, and velocities of free bodies in our axes."""

    def __init__(self, path: Path, model: Model) -> None:
        self.mj = pytest.importorskip("mujoco")
        self.model = self.mj.MjModel.from_xml_path(str(path))
        self.data, self.ours = self.mj.MjData(self.model), model

    def set(self, q: Array, v: Array) -> Array:
        """Set a state; return the matrix (nv, nv) that takes our velocities to MuJoCo's."""
        T = np.zeros((self.model.nv, self.ours.nv))
        for body in self.ours.bodies:
            j = int(self.model.body_jntadr[self.model.body(body.name).id])
            at, first = int(self.model.jnt_qposadr[j]), int(self.model.jnt_dofadr[j])
            own = q[body.q : body.q + body.joint.nq].copy()
            turn = np.eye(body.joint.nv)
            if body.joint.type == "floating":  # theirs count from the world
                start, R = self.model.qpos0[at : at + 7], np.zeros(9)
                self.mj.mju_mulPose(
                    own[:3], own[3:], start[:3].copy(), start[3:].copy(), own[:3].copy(), own[3:].copy()
                )
                self.mj.mju_quat2Mat(R, own[3:])
                turn[:3, :3] = R.reshape(3, 3)
            self.data.qpos[at : at + body.joint.nq] = own
            T[first : first + body.joint.nv, body.v : body.v + body.joint.nv] = turn
        self.data.qvel[:] = T @ v
        self.mj.mj_forward(self.model, self.data)
        return T

    def mass_matrix(self) -> Array:
        M = np.zeros((self.model.nv, self.model.nv))
        for k, unit in enumerate(np.eye(self.model.nv)):
            self.mj.mj_mulM(self.model, self.data, M[k], unit)
        return M

    def jacobian(self) -> Array:
        kind = int(self.mj.mjtConstraint.mjCNSTR_EQUALITY)
        J = self.data.efc_J.reshape(-1, self.model.nv)[: self.data.nefc]
        return np.array(J[self.data.efc_type[: self.data.nefc] == kind])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("free", [False, True])
def test_mujoco_finds_the_same_tree(seed: int, free: bool, tmp_path: Path) -> None:
    """M, and bias with friction, dampers and springs, at random states; free bodies on and off the world's frame."""
    rng = np.random.default_rng(30 + seed)
    robot = random_robot(rng, KINDS["mjcf"], ("damper", "spring", "rotor", "ball rotor"))
    if free:
        del robot["base"]
        next(j for j in robot["joints"] if j["type"] == "floating").pop("origin")
    scene = scene_of(robot)
    files, _ = export_robot(scene, "mjcf", tmp_path)
    model = Problem(scene).model
    peer = InMujoco(files[0], model)
    assert (peer.model.jnt_type == int(peer.mj.mjtJoint.mjJNT_FREE)).any()
    for _ in range(3):
        q, v = random_q(model, rng), rng.normal(size=model.nv)
        T = peer.set(q, v)
        ours = Equations.of(scene, q, v)
        same(ours.M, T.T @ peer.mass_matrix() @ T)
        # theirs is of velocities whose axes turn: T-dot v, seen by differences of nothing but T
        h = peer.data.qfrc_bias - peer.data.qfrc_passive + peer.mass_matrix() @ turning(peer, q, v)
        same(ours.h, T.T @ h)


def test_a_rotor_without_mass(tmp_path: Path) -> None:
    """MuJoCo takes none of that, and is given what no equation notices; what slides on another link has names of q."""
    rng = np.random.default_rng(5)
    robot = random_robot(rng, ("revolute", "revolute", "floating"), (), n=3)
    robot["links"][1] |= {"mass": 0.0, "inertia": {"xx": 1e-4, "yy": 1e-4, "zz": 1.5e-4}}
    robot["joints"][1]["parent"], robot["joints"][2]["parent"] = "link0", "link0"
    scene = scene_of(robot)
    files, notes = export_robot(scene, "mjcf", tmp_path)
    assert any("1e-15 kg" in note and "link1" in note for note in notes)
    text = files[0].read_text(encoding="utf-8")
    assert 'name="q2.x"' in text and "freejoint" not in text
    peer, model = InMujoco(files[0], Problem(scene).model), Problem(scene).model
    q = np.array([0.3, -0.7, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    T = peer.set(q, np.zeros(model.nv))
    same(Equations.of(scene, q, np.zeros(model.nv)).M, T.T @ peer.mass_matrix() @ T)
    _, notes = export_robot(
        scene_of({**robot, "joints": robot["joints"][:2], "links": robot["links"][:2]}), "sdf", tmp_path
    )
    assert any("without mass" in note and "link1" in note for note in notes)


def turning(peer: InMujoco, q: Array, v: Array) -> Array:
    """Return T-dot v: of a free body R (w x v), of others nothing."""
    out = np.zeros(peer.model.nv)
    for body in peer.ours.bodies:
        if body.joint.type == "floating":
            first = int(peer.model.jnt_dofadr[int(peer.model.body_jntadr[peer.model.body(body.name).id])])
            R = np.zeros(9)
            at = int(peer.model.jnt_qposadr[int(peer.model.body_jntadr[peer.model.body(body.name).id])])
            peer.mj.mju_quat2Mat(R, peer.data.qpos[at + 3 : at + 7])
            own = v[body.v : body.v + 6]
            out[first : first + 3] = R.reshape(3, 3) @ np.cross(own[3:], own[:3])
    return out


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("loop", LOOPS["mjcf"])
def test_mujoco_finds_the_same_loops(loop: str, seed: int, tmp_path: Path) -> None:
    """The Jacobians of its equalities span what our rows span, where the loops are closed."""
    rng = np.random.default_rng(60 + seed)
    kinds = tuple(kind for kind in KINDS["mjcf"] if kind != "floating")
    robot, q = with_loops(random_robot(rng, kinds, (), n=9), (loop, loop), rng)
    scene = scene_of(robot)
    model = Problem(scene).model
    files, notes = export_robot(scene, "mjcf", tmp_path)
    assert any("soft" in note for note in notes)
    peer = InMujoco(files[0], model)
    T = peer.set(q, np.zeros(model.nv))
    assert np.abs(peer.data.efc_pos[: peer.data.ne]).max() < 1e-12
    J = peer.jacobian() @ T
    same(Equations.of(scene, q, np.zeros(model.nv)).directions, np.linalg.pinv(J, rcond=1e-9) @ J, 1e2)


def test_mujoco_finds_the_same_couplers(tmp_path: Path) -> None:
    """Two joints as an equality of joints, three as one of a tendon; motors and ranges are there."""
    rng = np.random.default_rng(9)
    robot = random_robot(
        rng, ("revolute", "prismatic", "revolute", "revolute", "prismatic"), ("limits",), n=5
    )
    couplers = [{"name": "gear", "terms": {"q0": 2.0, "q1": -0.7}, "value": 0.4},
                {"name": "sum", "terms": {"q2": 1.0, "q3": -2.0, "q4": 0.5}, "value": -0.3}]  # fmt: skip
    scene = scene_of(robot, couplers=couplers, actuated=["q1", "q3"])
    files, _ = export_robot(scene, "mjcf", tmp_path)
    model = Problem(scene).model
    peer = InMujoco(files[0], model)
    q = np.array([0.2 + 0.35 * 0.8, 0.8, -0.3 + 0.2 - 0.05, 0.1, 0.1])
    T = peer.set(q, np.zeros(5))
    assert np.abs(peer.data.efc_pos[: peer.data.ne]).max() < 1e-15
    J = peer.jacobian() @ T
    same(Equations.of(scene, q, np.zeros(5)).directions, np.linalg.pinv(J) @ J)
    assert [peer.model.actuator(k).name for k in range(peer.model.nu)] == ["q1_motor", "q3_motor"]
    assert peer.model.joint("q1").range.tolist() == [*_range(scene, "q1")]


def _range(scene: Scene, name: str) -> tuple[float, float]:
    limits: Any = scene.robot.limits_of(name)
    return limits.lower, limits.upper
