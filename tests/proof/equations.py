"""The equations of motion of a random mechanism, from Pinocchio and by hand.

M a + h = J^T lam, J a + c = 0, where the rows J are the loops, prescribed joints and joints that are held. On a branch
q = at(x) all of it is projected: P^T M P xdd + P^T (M Pd xd + h) = 0.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from tests.proof.mechanism import Array, Body, Bushing, Loop, Mechanism, Payload, Point


class HalfTurnError(Exception):
    """A bushing comes near half a turn, where its moment jumps."""


JointForce = Callable[[float, float, "Modes"], float]  # of position, rate and modes


@dataclasses.dataclass
class Modes:
    """What stays as it is between two events.

    s : an instant [s] inside the stretch. sides : on which side of its switches each compliant stop is. slip : direction
    of motion of joints with set-valued friction, 0 where held. rest : direction in which the stop pushes joints that lie on one.
    drive : torques of a controller, by place in v.
    """

    s: float = 0.0
    sides: dict[tuple[int, int], float] = dataclasses.field(default_factory=dict)
    slip: dict[int, float] = dataclasses.field(default_factory=dict)
    rest: dict[int, float] = dataclasses.field(default_factory=dict)
    drive: dict[int, float] = dataclasses.field(default_factory=dict)

    @property
    def held(self) -> list[int]:
        return [k for k, way in self.slip.items() if way == 0.0] + list(self.rest)


def cross(a: Array, b: Array) -> Array:
    """Return a x b; numpy's own takes ten times as long for one pair."""
    a0, a1, a2 = a
    b0, b1, b2 = b
    return np.array((a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0))


def skew(r: Array) -> Array:
    return np.array(((0.0, -r[2], r[1]), (r[2], 0.0, -r[0]), (-r[1], r[0], 0.0)))


def _sub_joints(body: Body) -> list[Any]:
    axis = body.axis / np.linalg.norm(body.axis)
    turn, slide = pin.JointModelRevoluteUnaligned, pin.JointModelPrismaticUnaligned
    if body.kind == "revolute":
        return [turn(axis)]
    if body.kind == "prismatic":
        return [slide(axis)]
    if body.kind == "helical":
        return [pin.JointModelHelicalUnaligned(axis, body.pitch)]
    if body.kind == "cylindrical":
        return [turn(axis), slide(axis)]
    if body.kind == "spherical":
        return [pin.JointModelSpherical()]
    if body.kind == "floating":
        return [pin.JointModelFreeFlyer()]
    assert body.axis2 is not None
    second = body.axis2 / np.linalg.norm(body.axis2)
    if body.kind == "universal":
        return [turn(axis), turn(second)]
    return [slide(second), slide(cross(axis, second)), turn(axis)]


def _depth_first(bodies: list[Body]) -> list[int]:
    """Return the order that Pinocchio asks for: each body is followed by all that hang on it."""
    found: list[int] = []

    def visit(k: int) -> None:
        found.append(k)
        for j, body in enumerate(bodies):
            if body.parent == k:
                visit(j)

    for k, body in enumerate(bodies):
        if body.parent < 0:
            visit(k)
    return found


class Equations:
    """Numbers of one mechanism, fast enough to be integrated."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = m = mechanism
        self.model = pin.Model()
        self.model.gravity = pin.Motion(np.array(m.gravity), np.zeros(3))
        self.ids = [0] * len(m.bodies)
        for k in _depth_first(m.bodies):
            body = m.bodies[k]
            place = pin.SE3(pin.rpy.rpyToMatrix(*body.rpy), np.array(body.xyz))
            parent = self.ids[body.parent] if body.parent >= 0 else 0
            for j, joint in enumerate(_sub_joints(body)):
                parent = self.model.addJoint(parent, joint, place, f"{body.name}_{j}")
                place = pin.SE3.Identity()
            self.model.appendBodyToJoint(
                parent, pin.Inertia(body.mass, np.array(body.com), np.array(body.inertia)), pin.SE3.Identity()
            )
            self.ids[k] = parent
        self.data = self.model.createData()
        self.nq, self.nv = int(m.first_q[-1]), int(m.first_v[-1])
        self._places()
        self.armature = np.zeros(self.nv)
        self.joint_forces: list[tuple[int, int, JointForce]] = []
        for k, body in enumerate(m.bodies):
            self._joint(k, body)
        self.carried = bool(m.springs or m.loads or m.bushings)

    def _places(self) -> None:
        """Find where our coordinates and velocities are in Pinocchio's, which go depth first and put qw last."""
        m, joints = self.mechanism, self.model.joints
        self.to_q, self.to_v = np.zeros(self.nq, int), np.zeros(self.nv, int)
        self.quaternions: list[int] = []
        for k, body in enumerate(m.bodies):
            count = len(_sub_joints(body))
            first = joints[self.ids[k] - count + 1]
            nq, nv = m.first_q[k + 1] - m.first_q[k], m.first_v[k + 1] - m.first_v[k]
            places = np.arange(first.idx_q, first.idx_q + nq)
            if body.kind in ("spherical", "floating"):
                places[-4:] = places[[-1, -4, -3, -2]]
                self.quaternions.append(int(m.first_q[k + 1]) - 4)
            self.to_q[m.first_q[k] : m.first_q[k + 1]] = places
            self.to_v[m.first_v[k] : m.first_v[k + 1]] = np.arange(first.idx_v, first.idx_v + nv)
        self.square = np.ix_(self.to_v, self.to_v)

    # -- joints ---------------------------------------------------------------------------------------
    def _joint(self, k: int, body: Body) -> None:
        q, v, extra = int(self.mechanism.first_q[k]), int(self.mechanism.first_v[k]), body.extra
        N = extra.get("gear_ratio", 1.0)
        self.armature[v] += N * N * extra.get("rotor_inertia", 0.0)
        add = self.joint_forces.append
        if spring := extra.get("spring"):
            add((q, v, lambda x, xd, modes: -spring["stiffness"] * (x - spring.get("rest", 0.0))))
        if damper := extra.get("damper"):
            add((q, v, lambda x, xd, modes: -damper["damping"] * xd))
        if friction := extra.get("friction"):
            add((q, v, friction_torque(k, friction, N)))
        limits = extra.get("limits")
        if limits and "stiffness" in limits["stop"]:
            for side, name in enumerate(("lower", "upper")):
                if name in limits:
                    add((q, v, stop_torque(k, side, limits[name], limits["stop"])))

    # -- kinematics -----------------------------------------------------------------------------------
    def pinocchio_q(self, q: Array) -> Array:
        found = np.empty(self.nq)
        found[self.to_q] = q
        for at in self.quaternions:
            found[self.to_q[at : at + 4]] /= np.linalg.norm(q[at : at + 4])
        return found

    def pinocchio_v(self, v: Array) -> Array:
        found = np.empty(self.nv)
        found[self.to_v] = v
        return found

    def moved(self, q: Array, dq: Array) -> Array:
        """Return the coordinates after a step in velocity coordinates."""
        found: Array = pin.integrate(self.model, self.pinocchio_q(q), self.pinocchio_v(dq))
        return found[self.to_q]

    def rates(self, q: Array, v: Array) -> Array:
        """Return the time derivative of the coordinates."""
        if not self.quaternions:
            return v
        found = np.empty(self.nq)
        first_q, first_v = self.mechanism.first_q, self.mechanism.first_v
        for k, body in enumerate(self.mechanism.bodies):
            a, b = first_q[k], first_v[k]
            if body.kind not in ("spherical", "floating"):
                found[a : first_q[k + 1]] = v[b : first_v[k + 1]]
                continue
            at = first_q[k + 1] - 4
            w, u = q[at], q[at + 1 : at + 4]
            omega = v[first_v[k + 1] - 3 : first_v[k + 1]]
            found[at] = -0.5 * (u @ omega)
            found[at + 1 : at + 4] = 0.5 * (w * omega + cross(u, omega))
            if body.kind == "floating":
                linear = v[b : b + 3]
                unit = math.sqrt(w * w + u @ u)
                w, u = w / unit, u / unit
                found[a : a + 3] = linear + 2.0 * cross(u, cross(u, linear) + w * linear)
        return found

    def place(self, point: Point) -> Array:
        """Return the place of a point in the world; kinematics must be up to date."""
        if point.body < 0:
            return np.asarray(point.at)
        found: Array = self.data.oMi[self.ids[point.body]].act(np.asarray(point.at))
        return found

    def _velocity(self, point: Point) -> Array:
        if point.body < 0:
            return np.zeros(3)
        j = self.ids[point.body]
        found: Array = self.data.oMi[j].rotation @ (
            self.data.v[j].linear + cross(self.data.v[j].angular, point.at)
        )
        return found

    def _jacobian(self, point: Point) -> Array:
        if point.body < 0:
            return np.zeros((3, self.nv))
        j = self.ids[point.body]
        J = pin.getJointJacobian(self.model, self.data, j, pin.LOCAL_WORLD_ALIGNED)[:, self.to_v]
        r = self.data.oMi[j].rotation @ point.at
        found: Array = J[:3] - skew(r) @ J[3:]
        return found

    def _bias(self, point: Point) -> Array:
        """Return the acceleration of a point where all joint accelerations are zero."""
        if point.body < 0:
            return np.zeros(3)
        j = self.ids[point.body]
        R, omega = self.data.oMi[j].rotation, self.data.v[j].angular
        a, r = self.data.a[j], np.asarray(point.at)
        linear = a.linear + cross(omega, self.data.v[j].linear)
        found: Array = R @ (linear + cross(a.angular, r) + cross(omega, cross(omega, r)))
        return found

    # -- forces ---------------------------------------------------------------------------------------
    def _external(self, t: float, q: Array, v: Array, modes: Modes) -> Any:
        found = pin.StdVec_Force()
        forces = [np.zeros(6) for _ in range(self.model.njoints)]

        def push(point: Point, f: Array, moment: Array | None, local: bool = False) -> None:
            if point.body < 0:
                return
            j = self.ids[point.body]
            if not local:
                f = self.data.oMi[j].rotation.T @ f
                moment = None if moment is None else self.data.oMi[j].rotation.T @ moment
            forces[j][:3] += f
            forces[j][3:] += cross(point.at, f) + (0.0 if moment is None else moment)

        for spring in self.mechanism.springs:
            line = self.place(spring.second) - self.place(spring.first)
            length = float(np.linalg.norm(line))
            way = line / length
            rate = float(way @ (self._velocity(spring.second) - self._velocity(spring.first)))
            pull = (spring.stiffness * (length - spring.length) + spring.damping * rate) * way
            push(spring.first, pull, None)
            push(spring.second, -pull, None)
        for load in self.mechanism.loads:
            f = np.array([x.value(t, modes.s, q, v) for x in load.force])
            m = None if load.moment is None else np.array([x.value(t, modes.s, q, v) for x in load.moment])
            push(load.at, f, m, load.frame == "body")
        for bushing in self.mechanism.bushings:
            push(bushing.at, *self._bushing(bushing))
        for f in forces:
            found.append(pin.Force(f))
        return found

    def _bushing(self, bushing: Bushing) -> tuple[Array, Array]:
        """Return force and moment of a bushing on its body, in the axes of the world."""
        j = self.ids[bushing.at.body]
        ground, body = pin.rpy.rpyToMatrix(*bushing.rpy), self.data.oMi[j].rotation
        turn = ground.T @ body
        angle, along = pin.log3(turn), pin.Jlog3(turn)
        if np.linalg.norm(angle) > 3.0:
            raise HalfTurnError
        xi = np.concatenate([ground.T @ (self.place(bushing.at) - bushing.ground), angle])
        rate = np.concatenate([ground.T @ self._velocity(bushing.at), along @ self.data.v[j].angular])
        f = bushing.stiffness * xi + bushing.damping * rate
        return -ground @ f[:3], -body @ along.T @ f[3:]

    def dynamics(self, t: float, q: Array, v: Array, modes: Modes) -> tuple[Array, Array]:
        """Return M and h."""
        qp, vp, model, data = self.pinocchio_q(q), self.pinocchio_v(v), self.model, self.data
        zero = np.zeros(self.nv)
        M = pin.crba(model, data, qp)
        M = (np.triu(M) + np.triu(M, 1).T)[self.square] + np.diag(self.armature)
        if self.carried:
            pin.forwardKinematics(model, data, qp, vp, zero)  # places and velocities of the points
            h = pin.rnea(model, data, qp, vp, zero, self._external(t, q, v, modes))[self.to_v]
        else:
            h = pin.nonLinearEffects(model, data, qp, vp)[self.to_v]
        if self.mechanism.loops:
            pin.forwardKinematics(model, data, qp, vp, zero)  # for their rows, without gravity
        for at, place, force in self.joint_forces:
            h[place] -= force(q[at], v[place], modes)
        for (k, c), formula in self.mechanism.torques.items():
            h[self.mechanism.first_v[k] + c] -= formula.value(t, modes.s, q, v)
        for place, torque in modes.drive.items():
            h[place] -= torque
        return M, h

    # -- payloads -------------------------------------------------------------------------------------
    def carry(self, payload: Payload, sign: float) -> None:
        """Add a payload to its body, or (sign -1) take it away."""
        j = self.ids[payload.at.body]
        place = np.asarray(payload.at.at) + payload.com
        own = pin.Inertia(payload.mass, place, payload.inertia).toDynamicParameters()
        both = self.model.inertias[j].toDynamicParameters() + sign * own
        self.model.inertias[j] = pin.Inertia.FromDynamicParameters(both)

    def gripped(self, t: float, q: Array, v: Array, payload: Payload, modes: Modes) -> Array:
        """Return the rates after a payload is gripped: the momentum of all is kept but for what the loops take."""
        M, _ = self.dynamics(t, q, v, modes)
        rows, _ = self.loop_rows(q) if self.mechanism.loops else (np.zeros((0, self.nv)), None)
        pin.computeJointJacobians(self.model, self.data, self.pinocchio_q(q))
        j = self.ids[payload.at.body]
        turning = pin.getJointJacobian(self.model, self.data, j, pin.LOCAL_WORLD_ALIGNED)[3:, self.to_v]
        moving = self._jacobian(Point(payload.at.body, np.asarray(payload.at.at) + payload.com))
        R = self.data.oMi[j].rotation
        brought = moving.T @ (payload.mass * payload.velocity)
        brought += turning.T @ (R @ payload.inertia @ R.T @ payload.spin)
        self.carry(payload, 1.0)
        whole, _ = self.dynamics(t, q, v, modes)
        found: Array = constrained(whole, -(M @ v + brought), [rows], [-rows @ v])[0]
        return found

    # -- rows -----------------------------------------------------------------------------------------
    def gap(self, q: Array) -> Array:
        """Return by how much loops are open; kinematics are brought up to date."""
        pin.forwardKinematics(self.model, self.data, self.pinocchio_q(q))
        parts = []
        for loop in self.mechanism.loops:
            line = self.place(loop.second) - self.place(loop.first)
            parts.append(loop.directions @ line if loop.directions is not None else _bar(line, loop))
        return np.concatenate(parts) if parts else np.zeros(0)

    def loop_rows(self, q: Array) -> tuple[Array, Array]:
        """Return J and c of the loops; velocities and zero accelerations must be up to date."""
        qp = self.pinocchio_q(q)
        pin.computeJointJacobians(self.model, self.data, qp)
        rows, biases = [], []
        for loop in self.mechanism.loops:
            J = self._jacobian(loop.second) - self._jacobian(loop.first)
            bias = self._bias(loop.second) - self._bias(loop.first)
            if loop.directions is not None:
                rows.append(loop.directions @ J)
                biases.append(loop.directions @ bias)
            else:
                line = self.place(loop.second) - self.place(loop.first)
                rate = self._velocity(loop.second) - self._velocity(loop.first)
                rows.append((line @ J)[None])
                biases.append(np.array([line @ bias + rate @ rate]))
        return np.concatenate(rows), np.concatenate(biases)

    def unit_rows(self, joints: list[int]) -> Array:
        found = np.zeros((len(joints), self.nv))
        for row, k in enumerate(joints):
            found[row, self.mechanism.first_v[k]] = 1.0
        return found

    def solve(self, t: float, q: Array, v: Array, modes: Modes) -> tuple[Array, dict[int, float]]:
        """Return accelerations and the forces that hold the joints that are held."""
        M, h = self.dynamics(t, q, v, modes)
        rows, biases = [], []
        if self.mechanism.loops and self.mechanism.branch is None:
            J, c = self.loop_rows(q)
            rows.append(J)
            biases.append(c)
        led = list(self.mechanism.prescribed)
        if led:
            rows.append(self.unit_rows(led))
            biases.append(np.array([-self.mechanism.prescribed[k][2].value(t, modes.s, q, v) for k in led]))
        held = modes.held
        if held:
            rows.append(self.unit_rows(held))
            biases.append(np.zeros(len(held)))
        a, lam = constrained(M, h, rows, biases)
        return a, dict(zip(held, lam[len(lam) - len(held) :])) if held else {}


def constrained(M: Array, h: Array, rows: list[Array], biases: list[Array]) -> tuple[Array, Array]:
    """Return a and lam of M a + h = J^T lam, J a + c = 0."""
    if not rows:
        return np.linalg.solve(M, -h), np.zeros(0)
    J, c = np.concatenate(rows), np.concatenate(biases)
    n, k = len(h), len(c)
    whole = np.block([[M, -J.T], [J, np.zeros((k, k))]])
    found = np.linalg.solve(whole, np.concatenate([-h, -c]))
    return found[:n], found[n:]


def _bar(line: Array, loop: Loop) -> Array:
    return np.array([0.5 * (line @ line - loop.length**2)])


def friction_level(friction: dict[str, Any], speed: float) -> float:
    """Return Coulomb and Stribeck friction at a speed, without its sign."""
    level = float(friction.get("coulomb", 0.0))
    if "stribeck_speed" in friction:
        level += (friction["static"] - level) * math.exp(-((speed / friction["stribeck_speed"]) ** 2))
    return level


def friction_torque(k: int, friction: dict[str, Any], N: float) -> JointForce:
    """Return the torque of friction in a joint: smooth, or with the sign that the modes give."""
    motor = friction.get("side") == "motor"
    b = friction.get("viscous", 0.0) * (N * N if motor else 1.0)
    scale = abs(N) if motor else 1.0

    def smooth(x: float, xd: float, modes: Modes) -> float:
        sign = math.tanh(xd / friction["transition_speed"]) if "transition_speed" in friction else 0.0
        return -b * xd - scale * friction_level(friction, xd) * sign

    def exact(x: float, xd: float, modes: Modes) -> float:
        return -b * xd - scale * friction_level(friction, xd) * modes.slip[k]

    return exact if friction.get("law") == "set_valued" else smooth


def stop_switches(side: int, at: float, stop: dict[str, Any], x: float, xd: float) -> tuple[float, float]:
    """Return the depth in a compliant stop, and its law (without the depth of Hunt and Crossley's) over the stiffness."""
    depth, rate = (at - x, -xd) if side == 0 else (x - at, xd)
    damping = stop.get("damping", 0.0) / stop["stiffness"]
    return depth, (1.0 if stop.get("law") == "hunt_crossley" else depth) + damping * rate


def stop_torque(k: int, side: int, at: float, stop: dict[str, Any]) -> JointForce:
    """Return the torque of a compliant stop, by the sides of its two switches."""
    n = stop.get("exponent", 1.0)

    def torque(x: float, xd: float, modes: Modes) -> float:
        if modes.sides[k, 2 * side] <= 0.0 or modes.sides[k, 2 * side + 1] <= 0.0:
            return 0.0
        depth, law = stop_switches(side, at, stop, x, xd)
        if stop.get("law") == "hunt_crossley":
            law *= max(depth, 0.0) ** n
        law *= stop["stiffness"]
        return law if side == 0 else -law

    return torque
