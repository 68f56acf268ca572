"""Latches in the equations of motion: what they hold, and when they close and open.

Whether a latch is closed is a parameter p of the equations, so one compiled program serves all combinations.

    rigid:      rho v = 0, where hold = 1
    compliant:  tau = -s max(0, k delta + c delta-dot) where delta = s (q - rest) > 0 and closed = 1

rho (nv,) is the row of what the latch holds: the rate of a joint, or the rate at which two links turn against each
other about the axis of the closure that joins them. s is the direction in which the latch was passed when it closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.functions import maximum, where
from robodyn_cli.expr.graph import Expr, Scalar, is_nonzero
from robodyn_cli.model.model import BASE, PARAMETER_GROUP, TORQUE, Loop, Model
from robodyn_cli.model.places import placed
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Matrix, Values, Vector, dot, vector, zeros

if TYPE_CHECKING:
    from robodyn_cli.equations.constraints import MechanismParts
    from robodyn_cli.scene.nested_options import DeployLatch

TOGETHER = 1e-10  # s, or part of the time: latches that would close so soon after one another close together
# closed : 1 where it is. hold : 1 where its row is solved with; others may hold it already. direction, rest : s, rest
# near : of an open one in its position, how far it has to leave that before it can close; -1 where nothing can move;
# else 0. Of a closed spring the growth below which its load is at rest or falls
FIELDS = ("closed", "hold", "direction", "rest", "near")


@record
class LatchRow:
    """A latch in the equations.

    place : of its first parameter. psi, gamma : its row rho (nv,) and rho-dot v. q, v : places of the coordinate that
    it holds, None for one between links. closing : place in v of the coordinate whose position closes it, if one does.
    closes : passes zero where it closes, None: in a dead point. opens : rises
    through zero where it opens, None: never.
    """

    spec: DeployLatch
    place: int
    closed: Scalar
    hold: Scalar
    direction: Scalar
    rest: Scalar
    near: Scalar
    psi: Vector
    gamma: Scalar
    q: int | None
    v: int | None
    closing: int | None
    closes: Scalar | None
    opens: Scalar | None

    @property
    def name(self) -> str:
        return self.spec.name

    @property
    def end(self) -> int:
        """The place behind its last parameter."""
        return self.place + len(FIELDS)

    @property
    def rigid(self) -> bool:
        return self.spec.hold == "rigid"

    @property
    def is_own(self) -> bool:
        """Whether the position at which it closes is that of the coordinate that it holds."""
        return self.closing is not None and self.closing == self.v

    def unit(self, model: Model) -> str:
        """Return the unit of what it holds: an angle between links."""
        return "rad" if self.v is None else model.v_units[self.v]

    def load_unit(self, model: Model) -> str:
        """Return the unit of what it exerts."""
        return TORQUE[self.unit(model)]

    def closing_unit(self, model: Model) -> str:
        """Return the unit of the position at which it closes; empty where it closes at none."""
        return "" if self.closing is None else model.v_units[self.closing]

    # -- a compliant one ------------------------------------------------------------------------------
    def position(self, q: Any) -> Any:
        """Return the position that its spring knows; that between links is a sum of joints' own."""
        return dot(self.psi, q) if self.q is None else q[self.q]

    def rate(self, v: Any) -> Any:
        """Return the rate of this position, or its acceleration from v-dot."""
        return dot(self.psi, v) if self.v is None else v[self.v]

    def depth(self, q: Sequence[Any], v: Sequence[Any]) -> tuple[Any, Any]:
        """Return delta and its rate."""
        return self.direction * (self.position(q) - self.rest), self.direction * self.rate(v)

    def law(self, delta: Any, rate: Any) -> Any:
        """Return k delta + c delta-dot, or the rate of that from rates."""
        return self.spec.hold.stiffness * delta + self.spec.hold.damping * rate

    def pushes(self, q: Sequence[Any], v: Sequence[Any]) -> Any:
        """Return s times the torque against the motion, without sign."""
        delta, rate = self.depth(q, v)
        return self.closed * where(delta, maximum(self.law(delta, rate), 0.0), 0.0)

    def torque(self, q: Sequence[Any], v: Sequence[Any]) -> Any:
        """Return the torque on its joint."""
        return -(self.direction * self.pushes(q, v))

    def on_joints(self, torque: Any) -> dict[int, Any]:
        """Return what a torque of it is on the joints, by velocity index."""
        return {k: x * torque for k, x in enumerate(self.psi) if is_nonzero(x)}

    def torques(self, q: Sequence[Any], v: Sequence[Any]) -> Vector:
        """Return the torques on all joints (nv,)."""
        torques = zeros(len(v))
        for k, torque in self.on_joints(self.torque(q, v)).items():
            torques[k] = torque
        return torques

    def losses(self, q: Sequence[Any], v: Sequence[Any]) -> dict[int, Any]:
        """Return the part of the torques that is no gradient of the potential, by velocity index."""
        delta, _ = self.depth(q, v)
        elastic = self.direction * self.closed * (self.spec.hold.stiffness * maximum(delta, 0.0))
        return self.on_joints(self.torque(q, v) + elastic)

    def potential(self, q: Sequence[Any]) -> Any:
        """Return the energy stored [J]."""
        return self.closed * self.stored(q, self.direction, self.rest)

    def stored(self, q: Any, direction: Any, rest: Any) -> Any:
        """Return the energy [J] in its spring while it is closed with such s and rest."""
        delta = maximum(direction * (self.position(q) - rest), 0.0)
        return 0.5 * self.spec.hold.stiffness * (delta * delta)


def latch_rows(problem: MechanismParts) -> tuple[LatchRow, ...]:
    """Return the latches of a scene whose command follows them; their parameters follow those of contact states.

    Raises
    ------
    CapabilityError : a latch cannot hold what it is to hold. In a variant of the scene's equations it is left out.
    """
    from robodyn_cli.equations.contact_joints import FIELDS as OF_CONTACT

    model = problem.model
    first = len(model.parameters) + len(OF_CONTACT) * len(problem.contact_joints)
    rows = []
    for k, given in enumerate(problem.scene.deploy.latches):
        spec = placed(given, f"deploy.latches.{given.name}")
        place = first + len(FIELDS) * k
        closed, hold, direction, rest, near = (
            model.graph.symbol(f"{spec.name}.{name}", PARAMETER_GROUP, place + i)
            for i, name in enumerate(FIELDS)
        )
        try:
            held = _held(problem, spec)
        except CapabilityError:
            if problem.is_variant:
                continue
            raise
        opens = None if spec.release is None else spec.release.evaluate(problem.environment)
        rows.append(
            LatchRow(
                spec,
                place,
                closed,
                hold,
                direction,
                rest,
                near,
                *held,
                *_closes(problem, spec),
                opens,
            )
        )
    return tuple(rows)


def _closes(problem: MechanismParts, spec: DeployLatch) -> tuple[int | None, Scalar | None]:
    """Return the place in v of the coordinate whose position closes a latch, and what passes zero where it closes."""
    if spec.when is not None:
        return None, spec.when.evaluate(problem.environment)
    if spec.at_dead_point:
        return None, None
    name, at = spec.position(problem.scene.robot)
    model = problem.model
    return model.v_names.index(name), problem.q[model.q_names.index(name)] - at


def _held(problem: MechanismParts, spec: DeployLatch) -> tuple[Vector, Scalar, int | None, int | None]:
    """Return the row of what a latch holds, its drift, and the places of its coordinate in q and v."""
    model = problem.model
    name = spec.joint or _joint_between(problem, spec)
    if name is not None and name in model.v_names:
        v = model.v_names.index(name)
        unit = zeros(model.nv)
        unit[v] = 1.0
        return unit, 0.0, model.q_names.index(name), v
    assert spec.between is not None
    first, second = spec.between
    one, two = (model.links[link].body for link in spec.between)
    loop = next((x for x in model.loops if {x.first.body, x.second.body} == {one, two}), None)
    if loop is None or loop.element.type != "revolute":
        raise CapabilityError(
            f"latch {spec.name!r} cannot hold {first!r} and {second!r}: neither "
            "a joint of one axis nor a closure of type 'revolute' joins them; allowed: links that one of these joins",
            (problem.scene.path, "deploy.latches"),
            key="deploy.latches",
        )
    psi, drift = _turning(problem, loop)
    is_sum = len(model.q_names) == model.nv and not any(isinstance(x, Expr) for x in psi)
    if spec.hold != "rigid" and not is_sum:
        raise CapabilityError(
            f"latch {spec.name!r} has a spring, which needs a position; "
            f"{first!r} and {second!r} meet in closure {loop.name!r}, where the turn of one against the other is no "
            "sum of positions of joints; allowed: hold: rigid, or a loop whose joints turn about parallel axes",
            (problem.scene.path, "deploy.latches"),
            key="deploy.latches",
        )
    sign = 1.0 if loop.first.body == one else -1.0
    return sign * psi, sign * drift, None, None


def _joint_between(problem: MechanismParts, spec: DeployLatch) -> str | None:
    """Return the joint of one axis that joins the two links of a latch."""
    model = problem.model
    assert spec.between is not None
    one, two = (model.links[link].body for link in spec.between)
    for body, other in ((one, two), (two, one)):
        if body != BASE and model.bodies[body].parent == other and model.bodies[body].joint.nv == 1:
            return model.bodies[body].joint_name
    return None


def _turning(problem: MechanismParts, loop: Loop) -> tuple[Vector, Scalar]:
    """Return rho and rho-dot v of the rate at which the links of a closure turn about its axis.

    rho v = n . (w_2 - w_1). The closure keeps w_2 - w_1 along n, so that n-dot adds nothing.
    """
    from robodyn_cli.algorithms.constraints import LoopRows
    from robodyn_cli.loops.pieces import direction

    first, second = LoopRows(problem.model, problem.X, problem.q, problem.v).ends(loop)
    n = direction(first, loop.element.axis)
    return n @ (second.Jw - first.Jw), dot(n, second.wd - first.wd)


def moving(problem: MechanismParts) -> dict[int, Scalar]:
    """Return for each coordinate that rigid latches may hold, by its place in v, 1 while it moves and 0 else."""
    moves: dict[int, Scalar] = {}
    for latch in problem.latches:
        if latch.rigid and latch.v is not None:
            moves[latch.v] = moves.get(latch.v, 1.0) - latch.hold
    return moves


def without_held(problem: MechanismParts, f: Values, psi: Matrix) -> tuple[Matrix, Vector, Matrix]:
    """Return M (nv, nv), f (nv,) and rows Psi (m, nv) without the coordinates that rigid latches hold.

    In their own equations nothing is left but their inertia, so that they have no acceleration, and the others move as
    if they were not there.
    """
    if not problem.latches:
        return problem.mass_matrix, vector(list(f)), psi
    M, f, psi = problem.mass_matrix.copy(), vector(list(f)), psi.copy()
    for v, moves in moving(problem).items():
        own, M[v] = M[v, v], M[v] * moves
        M[:, v] = M[:, v] * moves
        M[v, v], f[v], psi[:, v] = own, f[v] * moves, psi[:, v] * moves
    return M, f, psi


def held_rows(problem: MechanismParts) -> tuple[Matrix, list[Scalar], list[Scalar]]:
    """Return what parameters hold by a multiplier, joints with a contact state first, then latches between links that a
    closure joins: rows (k, nv), their drift, and the parameters that hold them.
    """
    contacts = problem.contact_joints
    latches = [latch for latch in problem.latches if latch.rigid and latch.v is None]
    rows = zeros(len(contacts) + len(latches), problem.model.nv)
    for k, joint in enumerate(contacts):
        rows[k, joint.v] = 1.0
    for k, latch in enumerate(latches, start=len(contacts)):
        rows[k] = latch.psi
    drift = [*(0.0 for _ in contacts), *(latch.gamma for latch in latches)]
    return rows, drift, [*(joint.hold for joint in contacts), *(latch.hold for latch in latches)]


def latch_loads(problem: Any) -> list[Scalar]:
    """Return what each latch exerts on its joint, or about the axis of its closure on the second of its links.

    rigid:  M v-dot + h - tau - Psi^T lambda in the coordinate that it holds, or the multiplier of its row rho
    """
    rows, _, _ = held_rows(problem)
    closures = iter(problem.holding[len(problem.contact_joints) :])
    bearing = np.concatenate([problem.psi, rows])
    multipliers = [*problem.forward.lam, *problem.holding]
    f = problem.applied - problem.bias
    loads = []
    for latch in problem.latches:
        if not latch.rigid:
            loads.append(latch.torque(problem.q, problem.v))
        elif latch.v is None:
            loads.append(next(closures))
        else:
            v = latch.v
            others = dot(problem.mass_matrix[v], problem.forward.qdd) - f[v]
            loads.append(latch.hold * (others - dot(bearing[:, v], vector(multipliers))))
    return loads


def refuse_company(problem: MechanismParts) -> None:
    """Refuse what does not go with latches.

    Raises
    ------
    CapabilityError
    """
    scene, model = problem.scene, problem.model
    dead = [row.name for row in problem.latches if row.spec.at_dead_point]
    dead_points, of_dead_points = bool(dead), f"deploy.latches.{''.join(dead[:1])}.at_dead_point"
    reasons = {
        "'at_dead_point' in an open chain, which has none": dead_points and not model.closures,
        "'at_dead_point' and prescribed motion together; allowed: criterion: dead_point": dead_points
        and bool(scene.prescribed),
        "joints whose motion is prescribed, in a rigid one that holds such; allowed: a spring": any(
            row.rigid and row.q is not None and model.q_names[row.q] in scene.prescribed
            for row in problem.latches
        ),
    }
    for words, there in reasons.items():
        if there:
            key = of_dead_points if words.startswith("'at_dead_point'") else "deploy.latches"
            raise CapabilityError(f"does not go with {words}", (scene.path, key), key=key)
