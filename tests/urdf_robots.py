"""Robots in URDF beside Pinocchio, for tests and benchmarks: differences of their equations, and random robots.

Pinocchio reads the same file. Its joints follow another order, an angle without limits is a pair (cos, sin), and the
quaternion of a free body has its scalar last; ``Peer`` translates.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli import InverseDynamics, inverse, load_scene_text
from robodyn_cli.algorithms.aba import aba
from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.kinematics import poses, transforms
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import Model
from robodyn_cli.ready.mass_matrix import SINGULAR, lightest_joint
from robodyn_cli.scene.text.nodes import Faults, Source
from robodyn_cli.scene.types import Scene
from robodyn_cli.scene.urdf.elements import UrdfRobot, read_elements
from robodyn_cli.scene.urdf.structure import Relation, relations
from robodyn_cli.scene.urdf.xml import joint_names, link_names, parse_xml

Array = NDArray[np.float64]
GRAVITY = (0.3, -1.2, -9.81)


def real(x: Any) -> Array:
    return np.array(x, dtype=float)


@dataclasses.dataclass
class Differences:
    """Largest differences from Pinocchio, over the largest entry of each array.

    joints : coordinates of velocity. mimics : those that follow others. singular : the joint because of which forward
    dynamics is refused. torques, mass, acceleration, frames : of the rigid bodies; acceleration None where refused, and
    ``residual`` is what it leaves of the torques. drag : damping and friction against their formulas. coupled : torques
    of the leading joints against Pinocchio's, projected onto the coupling; None without mimics.
    """

    joints: int
    mimics: int
    torques: float
    mass: float
    frames: float
    drag: float
    acceleration: float | None = None
    residual: float | None = None
    singular: str = ""
    coupled: float | None = None


class Peer:
    """Pinocchio's model of a URDF, with arrays in our order."""

    def __init__(self, path: Path, robot: UrdfRobot, model: Model) -> None:
        import pinocchio as pin

        self.pin = pin
        self.model = pin.buildModelFromUrdf(str(path))
        self.model.gravity.linear = np.array(GRAVITY)
        self.data = self.model.createData()
        names = joint_names(joint.name for joint in robot.joints)
        held = [name for name, relation in mimics(robot).items() if relation.joint is None]
        self.held = {name: mimics(robot)[name].offset for name in held}
        self.ours = model
        # columns of v in Pinocchio for each of ours
        self.columns = np.zeros(model.nv, dtype=int)
        self.joints: list[tuple[Any, int, int]] = []  # joint, first columns of q and v on our side
        for joint in robot.joints:
            if joint.type == "fixed" or joint.name in self.held:
                continue
            body = model.body_of(names[joint.name])
            found = self.model.joints[self.model.getJointId(joint.name)]
            self.columns[body.v : body.v + found.nv] = range(found.idx_v, found.idx_v + found.nv)
            self.joints.append((found, body.q, body.v))
        self.links = link_names(link.name for link in robot.links)

    def q(self, q: Array) -> Array:
        out = self.pin.neutral(self.model)
        for name, value in self.held.items():
            joint = self.model.joints[self.model.getJointId(name)]
            self._place(out, joint, np.array([value]))
        for joint, first, _ in self.joints:
            self._place(out, joint, q[first : first + {1: 1, 6: 7}[joint.nv]])
        return out

    @staticmethod
    def _place(out: Array, joint: Any, value: Array) -> None:
        here = slice(joint.idx_q, joint.idx_q + joint.nq)
        if joint.nq == 2:
            out[here] = np.cos(value[0]), np.sin(value[0])
        elif joint.nq == 7:
            out[here] = [*value[:3], *value[4:], value[3]]
        else:
            out[here] = value

    def v(self, v: Array) -> Array:
        out = np.zeros(self.model.nv)
        out[self.columns] = v
        return out

    def torques(self, q: Array, v: Array, a: Array) -> Array:
        tau = self.pin.rnea(self.model, self.data, self.q(q), self.v(v), self.v(a))
        return real(tau)[self.columns]

    def mass_matrix(self, q: Array) -> Array:
        M = np.triu(self.pin.crba(self.model, self.data, self.q(q)))
        return real(M + np.triu(M, 1).T)[np.ix_(self.columns, self.columns)]

    def acceleration(self, q: Array, v: Array, tau: Array) -> Array:
        """Return the acceleration with held joints kept still."""
        M, still = self.mass_matrix(q), np.zeros(len(v))
        if not self.held:
            found = self.pin.aba(self.model, self.data, self.q(q), self.v(v), self.v(tau))
            return real(found)[self.columns]
        return np.linalg.solve(M, tau - self.torques(q, v, still))

    def frames(self, q: Array) -> dict[str, tuple[Array, Array]]:
        """Return position and axes of each link, by our name."""
        self.pin.framesForwardKinematics(self.model, self.data, self.q(q))
        found = {}
        for theirs, ours in self.links.items():
            place = self.data.oMf[self.model.getFrameId(theirs, self.pin.FrameType.BODY)]
            found[ours] = (real(place.translation), real(place.rotation))
        return found


def mimics(robot: UrdfRobot) -> dict[str, Relation]:
    return relations({joint.name: joint for joint in robot.joints})


def scene_of(path: Path, more: str = "") -> Scene:
    gravity = ", ".join(map(repr, GRAVITY))
    return load_scene_text(f"schema: 1\ngravity: [{gravity}]\nrobot: {path}\n{more}")


def compare(path: Path, seed: int = 0) -> Differences:
    """Return how far our equations of a robot are from Pinocchio's at a random state."""
    root = parse_xml(path.read_text(encoding="utf-8"), Source(str(path), "."))
    robot = read_elements(root, Faults())
    scene = scene_of(path)
    model = build_model(scene)
    peer = Peer(path, robot, model)
    rng = np.random.default_rng(seed)
    q, v, a = random_position(model, rng), rng.normal(size=model.nv), rng.normal(size=model.nv)
    tau, M = peer.torques(q, v, a), peer.mass_matrix(q)
    ours = real(rnea(model, list(q), list(v), list(a), model.gravity)) if model.nv else np.zeros(0)
    found = Differences(
        joints=model.nv,
        mimics=sum(relation.joint is not None for relation in mimics(robot).values()),
        torques=relative(ours, tau),
        mass=relative(real(crba(model, list(q))), M) if model.nv else 0.0,
        frames=_frames(model, q, peer),
        drag=_drag(scene, robot, model, q, v, a, ours),
    )
    if model.nv:
        _forward(found, model, peer, q, v, tau)
    if found.mimics:
        found.coupled = coupled_difference(path, robot, model, peer, rng)
    return found


def relative(ours: Array, theirs: Array) -> float:
    """Return the largest difference over the largest entry."""
    if not theirs.size:
        return 0.0
    scale = float(np.abs(theirs).max())
    return float(np.abs(ours - theirs).max()) / (scale or 1.0)


def random_position(model: Model, rng: np.random.Generator) -> Array:
    q = rng.uniform(-1.5, 1.5, size=model.nq)
    for body in model.bodies:
        if body.joint.quasi:
            x = rng.normal(size=4)
            q[body.q + body.joint.nq - 4 : body.q + body.joint.nq] = x / np.linalg.norm(x)
    return q


def _frames(model: Model, q: Array, peer: Peer) -> float:
    pose = poses(model, transforms(model, list(q)))
    worst = 0.0
    for name, (p, R) in peer.frames(q).items():
        frame = model.links[name]
        here = pose[frame.body]
        worst = max(worst, float(np.abs(real(here.point(frame.p)) - p).max()))
        worst = max(worst, float(np.abs(real(here.R) @ real(frame.R) - R).max()))
    return worst


def _forward(found: Differences, model: Model, peer: Peer, q: Array, v: Array, tau: Array) -> None:
    lightest = lightest_joint(model, q)
    if lightest is not None and lightest.share < SINGULAR:
        found.singular = lightest.joint
        return
    theirs = peer.acceleration(q, v, tau)
    ours = real(aba(model, list(q), list(v), list(tau), model.gravity))
    found.acceleration = relative(ours, theirs)
    found.residual = relative(peer.torques(q, v, ours), tau)


def drag_of(robot: UrdfRobot) -> dict[str, tuple[float, float]]:
    """Return damping and friction of each joint with one coordinate, by our name."""
    names = joint_names(joint.name for joint in robot.joints)
    single = ("revolute", "continuous", "prismatic")
    return {names[j.name]: (j.damping, j.friction) for j in robot.joints if j.type in single}


def resisting(robot: UrdfRobot, model: Model, v: Array) -> Array:
    """Return what the drives give against damping and friction: b v + f sign(v)."""
    drag = drag_of(robot)
    out = np.zeros(model.nv)
    for k, name in enumerate(model.v_names):
        b, f = drag.get(name, (0.0, 0.0))
        out[k] = b * v[k] + f * np.sign(v[k])
    return out


def _drag(scene: Scene, robot: UrdfRobot, model: Model, q: Array, v: Array, a: Array, rigid: Array) -> float:
    """Return the difference of damping and friction from their formulas, over the largest torque."""
    if not model.nv:
        return 0.0
    free = dataclasses.replace(scene, couplers=())
    tau = InverseDynamics(free)(q[None], v[None], a[None])[0]
    return float(np.abs(tau - rigid - resisting(robot, model, v)).max()) / max(
        1e-300, float(np.abs(tau).max())
    )


def projection(robot: UrdfRobot, model: Model) -> tuple[list[int], Array]:
    """Return the leading columns, and the rates (nv, leading) of all coordinates with theirs."""
    found = {n: r for n, r in mimics(robot).items() if r.joint is not None}
    names = joint_names(joint.name for joint in robot.joints)
    followers = {names[n] for n in found}
    leading = [k for k, name in enumerate(model.v_names) if name not in followers]
    G = np.zeros((model.nv, len(leading)))
    for j, k in enumerate(leading):
        G[k, j] = 1.0
    for name in found:
        row, factor, relation = model.v_names.index(names[name]), 1.0, found[name]
        while True:
            factor *= relation.multiplier
            if relation.joint not in found:
                break
            relation = found[relation.joint]
        G[row, leading.index(model.v_names.index(names[relation.joint]))] = factor
    return leading, G


def coupled_difference(
    path: Path, robot: UrdfRobot, model: Model, peer: Peer, rng: np.random.Generator
) -> float:
    """Return the difference of the leading joints' torques, by the command ``inverse``, from Pinocchio's: G^T tau.

    Each leading joint moves as q0 + v0 t + a0 t^2 / 2; sample 0 is compared.
    """
    leading, G = projection(robot, model)
    q0, v0, a0 = (rng.uniform(-0.5, 0.5, size=len(leading)) for _ in range(3))
    numbers = zip(q0.tolist(), v0.tolist(), a0.tolist())
    lead = [model.v_names[k] for k in leading]
    motion = ", ".join(f'{n}: "{x!r} + {v!r}*t + {a / 2!r}*t^2"' for n, (x, v, a) in zip(lead, numbers))
    scene = scene_of(
        path,
        f"actuated: [{', '.join(lead)}]\ntrajectory: {{type: joint, duration: 1.0e-3, q: {{{motion}}}}}\n"
        "inverse: {samples: 2}\n",
    )
    result = inverse(scene)
    q, v, a = (result[name][0] for name in ("q", "qd", "qdd"))
    theirs = G.T @ (peer.torques(q, v, a) + resisting(robot, model, v))
    couplings = [np.abs(q[leading] - q0).max(), np.abs(v - G @ v0).max(), np.abs(a - G @ a0).max()]
    assert max(couplings) < 1e-9, couplings
    return relative(result["tau"][0][leading], theirs)


# -- random robots -----------------------------------------------------------------------------------------
def random_urdf(rng: np.random.Generator, joints: int, mimic: bool = False) -> str:
    """Return a random tree: axes of any length, turned inertial frames, fixed joints between, massless frames.

    With ``mimic`` half of the joints with one coordinate follow others, some before or behind them in the file.
    """
    links = [_random_link(rng, 0)]
    elements = []
    kinds = ["revolute", "continuous", "prismatic", "fixed"] + ([] if mimic else ["floating"])
    single: list[str] = []
    for k in range(1, joints + 1):
        kind = str(rng.choice(kinds, p=[0.4, 0.1, 0.2, 0.3] if mimic else [0.35, 0.1, 0.2, 0.25, 0.1]))
        parent = int(rng.integers(max(0, k - 3), k))
        single += [f"j{k}"] if kind not in ("fixed", "floating") else []
        # only a fixed joint may carry a link without mass, and not the last one of a chain that moves
        links.append(_random_link(rng, k, massless=kind == "fixed" and rng.random() < 0.5))
        elements.append([k, kind, parent, ""])
    if mimic and len(single) > 1:
        leaders = [str(x) for x in rng.choice(single, size=(len(single) + 1) // 2, replace=False)]
        for element in elements:
            if f"j{element[0]}" in single and f"j{element[0]}" not in leaders:
                m, o = rng.uniform(0.5, 2.0), rng.uniform(-0.3, 0.3)
                element[3] = f'<mimic joint="{rng.choice(leaders)}" multiplier="{m!r}" offset="{o!r}"/>'
    body = "\n".join([*links, *(_random_joint(rng, *element) for element in elements)])
    return f'<?xml version="1.0"?>\n<robot name="random">\n{body}\n</robot>\n'


def _numbers(values: Any) -> str:
    return " ".join(repr(float(x)) for x in values)


def _random_link(rng: np.random.Generator, k: int, massless: bool = False) -> str:
    if massless:
        return f'<link name="link{k}"/>'
    # masses at random points have an inertia that a body can have
    points = rng.normal(size=(6, 3)) * rng.uniform(0.05, 0.2, size=3)
    points -= points.mean(axis=0)
    m = rng.uniform(0.2, 3.0)
    I = m / 6 * sum(p @ p * np.eye(3) - np.outer(p, p) for p in points)
    entries = {f"i{a}{b}": I["xyz".index(a), "xyz".index(b)] for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")}
    inertia = " ".join(f'{name}="{float(x)!r}"' for name, x in entries.items())
    return (
        f'<link name="link{k}"><inertial><origin xyz="{_numbers(rng.normal(size=3) * 0.2)}" '
        f'rpy="{_numbers(rng.uniform(-3, 3, size=3))}"/><mass value="{m!r}"/><inertia {inertia}/></inertial></link>'
    )


def _random_joint(rng: np.random.Generator, k: int, kind: str, parent: int, mimic: str) -> str:
    damping, friction = rng.uniform(0.0, 0.5, size=2).tolist()
    limit = (
        '<limit lower="-2" upper="2" effort="10" velocity="5"/>' if kind in ("revolute", "prismatic") else ""
    )
    more = (
        f'<dynamics damping="{damping!r}" friction="{friction!r}"/>'
        if kind not in ("fixed", "floating")
        else ""
    )
    return (
        f'<joint name="j{k}" type="{kind}"><parent link="link{parent}"/><child link="link{k}"/>'
        f'<origin xyz="{_numbers(rng.normal(size=3) * 0.4)}" rpy="{_numbers(rng.uniform(-3, 3, size=3))}"/>'
        f'<axis xyz="{_numbers(rng.normal(size=3) * 10.0 ** rng.uniform(-2, 2))}"/>{limit}{more}{mimic}</joint>'
    )
