"""The scene's forces as torques on the joints: elements in joints (springs, dampers, friction, stops), and forces on
points and between bodies, with their energy and power."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from robodyn_cli.algorithms.external import PathKinematics, common_axis, path_torques, turn_about
from robodyn_cli.equations.contact_joints import ContactJoint
from robodyn_cli.equations.gears import depends_on_load
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.formula_tree import AXES
from robodyn_cli.expr.functions import absolute, atan2, sqrt
from robodyn_cli.expr.graph import Expr, Scalar, free_symbols, is_nonzero
from robodyn_cli.expr.rebuild import renamed
from robodyn_cli.model.model import BASE, FixedFrame, Force, JointForce, Model
from robodyn_cli.spatial.algebra import Transform, Values, Vector, Wrench, cross, dot, vector, zeros

if TYPE_CHECKING:
    from robodyn_cli.forces.element import Action, Effect, HalfTurn, LineOfAction


class Elements:
    """The effects of the elements of ``model.forces`` at q, v.

    Parameters
    ----------
    X : transforms from parent to body. values : t, positions, rates and parameters for formulas. time : t.
    """

    def __init__(
        self,
        model: Model,
        X: Sequence[Transform],
        q: Values,
        v: Values,
        values: Mapping[str, Any],
        time: Scalar,
    ) -> None:
        self.model, self.X, self.q, self.v = model, X, q, v
        self.values, self.time = values, time
        self._kinematics: dict[int, PathKinematics] = {}

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(force.name for force in self.model.forces)

    def root(self, force: Force) -> int:
        """Return the last common ancestor of the bodies that a force acts on; the base for a force from outside."""
        if len(force.ends) == 1:
            return BASE
        return self.model.common_ancestor(force.ends[0].body, force.ends[1].body)

    def _from(self, root: int) -> PathKinematics:
        if root not in self._kinematics:
            self._kinematics[root] = PathKinematics(self.model, self.X, self.q, self.v, root)
        return self._kinematics[root]

    @cached_property
    def effects(self) -> list[Effect]:
        """The effect of each element, in the order of the scene."""
        return [self._effect(force) for force in self.model.forces]

    def line(self, force: Force) -> LineOfAction:
        """Return the line between the two ends of a force."""
        from robodyn_cli.forces.element import LineOfAction

        kinematics = self._from(self.root(force))
        return LineOfAction.of(tuple(kinematics.end(frame) for frame in force.ends))

    def _effect(self, force: Force) -> Effect:
        from robodyn_cli.forces.element import Setting  # few scenes have forces

        root = self.root(force)
        kinematics = self._from(root)
        setting = Setting(
            self.values,
            self.time,
            self.model.base.E,
            lambda axis: turn_about(self.model, self.q, force.ends, axis, root),
            lambda: common_axis(self.model, self.q, force.ends, root),
        )
        ends = tuple(kinematics.end(frame) for frame in force.ends)
        effect = force.element.effect(ends, setting)
        driven = [a for a in effect.actions if force.ends[a.end].body == BASE]
        # what moves an end on the ground gives -F.v, beside what the force gives to the bodies
        given = sum((dot(action.wrench.f, ends[action.end].v) for action in driven), 0.0)
        return dataclasses.replace(effect, power=effect.power - given) if is_nonzero(given) else effect

    @cached_property
    def torques(self) -> dict[str, Vector]:
        """Torques on the joints (nv,) [N m or N] by term."""
        wrenches: dict[tuple[str, int], dict[int, Wrench]] = {}
        for force, effect in zip(self.model.forces, self.effects):
            root = self.root(force)
            self._add_to(wrenches.setdefault((force.element.term, root), {}), force, effect, root)
        terms: dict[str, Vector] = {}
        for (term, root), group in wrenches.items():
            tau = path_torques(self.model, self.q, self.X, group, root)
            terms[term] = terms[term] + tau if term in terms else tau
        return terms

    def _add_to(self, group: dict[int, Wrench], force: Force, effect: Effect, root: int) -> None:
        """Add the wrenches of an element on the bodies behind a root."""
        for action in effect.actions:
            end = force.ends[action.end]
            if end.body not in (BASE, root):
                group[end.body] = group.get(end.body, Wrench.zero()) + self._on_body(end, root, action)

    def each_torque(self) -> dict[str, Vector]:
        """Return the torques of each element on the joints (nv,) [N m or N], by its name."""
        torques = {}
        for force, effect in zip(self.model.forces, self.effects):
            group: dict[int, Wrench] = {}
            root = self.root(force)
            self._add_to(group, force, effect, root)
            torques[force.name] = path_torques(self.model, self.q, self.X, group, root)
        return torques

    @cached_property
    def wrenches(self) -> dict[int, Wrench]:
        """The wrenches of all elements on each body and on the base, about its origin in its coordinates."""
        by_body: dict[int, Wrench] = {}
        for force, effect in zip(self.model.forces, self.effects):
            for action in effect.actions:
                end = force.ends[action.end]
                exerted = self._on_body(end, self.root(force), action)
                by_body[end.body] = by_body.get(end.body, Wrench.zero()) + exerted
        return by_body

    def _on_body(self, end: FixedFrame, root: int, action: Action) -> Wrench:
        """Return an action's wrench about the body's origin, in body coordinates."""
        to_body = end.R if action.local else self._from(root).pose(end.body).R.T
        return action.wrench.rotated(to_body).shifted(end.p)

    @property
    def potential(self) -> Scalar:
        """Potential energy of all elements together [J]."""
        return sum((effect.potential for effect in self.effects), 0.0)

    @property
    def power(self) -> Scalar:
        """Power of the forces without a potential [W]."""
        return sum((effect.power for effect in self.effects), 0.0)

    @property
    def breakpoints(self) -> set[float]:
        """Times at which the slope of tabulated forces jumps."""
        return {t for force in self.model.forces for t in force.element.breakpoints}

    @cached_property
    def half_turns(self) -> list[tuple[str, HalfTurn]]:
        """Where the angle of an element jumps, with the element's name."""
        return [
            (force.name, turn)
            for force, effect in zip(self.model.forces, self.effects)
            for turn in effect.half_turns
            if isinstance(turn.switch, Expr)
        ]

    @cached_property
    def formulas(self) -> list[tuple[str, list[Scalar]]]:
        """Values of the elements' formulas, with the key of the element."""
        return [
            (f"forces.{force.name}", [x for a in effect.actions for x in (*a.wrench.f, *a.wrench.n)])
            for force, effect in zip(self.model.forces, self.effects)
            if force.element.switching
        ]

    @cached_property
    def moving(self) -> list[tuple[str, Vector, Vector]]:
        """Ends on the ground that move by formulas: key, place [m] and velocity [m/s] along the axes of the base."""
        places = []
        for force in self.model.forces:
            for reference, frame in zip(force.element.references, force.ends):
                if frame.body == BASE and any(symbol is self.time for symbol in free_symbols(list(frame.p))):
                    end = self._from(BASE).end(frame)
                    places.append((f"forces.{force.name}.{reference}", end.p, end.v))
        return places


def functions_of_points(model: Model, X: Sequence[Transform], q: Values, v: Values) -> dict[str, Scalar]:
    """Return what formulas ask of points, by the names that these give: distances [m], angles [rad], coordinates in the
    world [m], and their rates.

    Each is built relative to the last common ancestor of its points, coordinates and speeds to the base.
    """
    by_name: dict[str, Scalar] = {}
    to_world = model.base.E.T
    for name, frames in model.of_points.items():
        function, bodies = name.partition("(")[0], [frame.body for frame in frames]
        root = BASE if len(frames) == 1 else functools.reduce(model.common_ancestor, bodies)
        kinematics = PathKinematics(model, X, q, v, root)
        ends = tuple(kinematics.end(frame) for frame in frames)
        if function in AXES:
            place = model.base.point(ends[0].p) if AXES[function] == "q" else to_world @ ends[0].v
            by_name[name] = place["xyz".index(function[-1])]
        elif function == "speed":
            by_name[name] = _norm(ends[0].v)
        elif function == "angle":
            a, c = ends[0].p - ends[1].p, ends[2].p - ends[1].p
            by_name[name] = atan2(_norm(cross(a, c)), dot(a, c))
        else:
            from robodyn_cli.forces.element import LineOfAction  # few scenes have forces

            line = LineOfAction.of(ends)
            by_name[name] = line.length if function == "length" else line.rate
    return by_name


TINY = 1e-300  # beside a square whose root is taken: no more than rounding, but the slope at zero is zero then, not 0/0


def _norm(x: Vector) -> Scalar:
    """Return the norm of a vector.

    Steps of an integration end where it bends at zero: that of points in a plane or on a line, which has a single
    component, and that of a velocity which a single joint gives, c(q) q-dot.
    """
    entries = [entry for entry in x if is_nonzero(entry)]
    rates = {s.value[2]: s for s in free_symbols(entries) if s.value[1] == "v"}
    if len(entries) > 1 and len(rates) == 1:
        ((k, rate),) = rates.items()
        still, unit = (renamed(entries, {"v": {k: number}}) for number in (0.0, 1.0))
        if not any(map(is_nonzero, still)):
            return absolute(rate) * _norm(vector(unit))
    return absolute(entries[0]) if len(entries) == 1 else sqrt(dot(entries, entries) + TINY)


def given_torques(torques: Mapping[str, Any], model: Model, environment: Mapping[str, Any]) -> Vector:
    """Return the scene's ``torques`` (nv,): constants, formulas, tables."""
    tau = zeros(model.nv)
    for name, torque in torques.items():
        tau[model.v_names.index(name)] = torque.evaluate(environment)
    return tau


class JointForces:
    """What the elements in the joints of a model do at q, v; ``contacts`` : the joints with a contact state."""

    def __init__(self, model: Model, q: Values, v: Values, contacts: Sequence[ContactJoint]) -> None:
        self.model, self.q, self.v = model, q, v
        self.sliding = {id(joint.friction): joint for joint in contacts if joint.friction is not None}

    def torque(self, force: JointForce, smooth: bool) -> Any:
        """Return one element's torque, a vector in space.

        smooth : as a simulation has it, else with the exact sign of the rate.
        """
        rate, gear = self._rate(force), force.gear_ratio
        torque: Any
        if smooth and (joint := self.sliding.get(id(force.element))) is not None:
            torque = force.element.slip_torque(rate, gear, joint.direction) + joint.carried
            return torque
        try:
            torque = force.element.torque(self.q[force.q], rate, gear, smooth)
        except CapabilityError as error:
            raise CapabilityError(f"joint {force.name}: {error.message}", joint=force.name) from error
        return torque

    def _rate(self, force: JointForce) -> Any:
        return vector(self.v[force.v]) if force.in_space else self.v[force.v]

    def terms(self, smooth: bool) -> dict[str, Vector]:
        """Return the torques (nv,) by term: ``passive`` (springs, dampers), ``friction``, ``stops``."""
        terms: dict[str, Vector] = {}
        for body in self.model.bodies:
            for force in body.forces:
                if depends_on_load(force):  # see ``gears``
                    continue
                term = terms.setdefault(force.element.term, zeros(self.model.nv))
                term[force.v] = term[force.v] + self.torque(force, smooth)
        return terms

    def losses(self, smooth: bool) -> list[tuple[int, Scalar]]:
        """Return the torques that are not the gradient of a potential, with their velocity index."""
        losses: list[tuple[int, Scalar]] = []
        for body in self.model.bodies:
            for force in body.forces:
                if depends_on_load(force):
                    continue
                if force.element.dissipative:
                    lost = self.torque(force, smooth)
                    losses += (
                        zip(range(self.model.nv)[force.v], lost) if force.in_space else [(force.v, lost)]
                    )
                    continue
                loss = force.element.loss(self.q[force.q], self.v[force.v], force.gear_ratio, smooth)
                if loss is not None:
                    losses.append((force.v, loss))
        return losses

    def switches(self) -> list[tuple[str, Expr]]:
        """Return the expressions that change sign where an element engages or releases, with the key of the
        element."""
        crossings: list[tuple[str, Expr]] = []
        for body in self.model.bodies:
            for force in body.forces:
                entries = force.element.switches(self.q[force.q], self.v[force.v])
                crossings += [(f"{force.name}.{force.kind}", switch) for switch in entries]
        return crossings
