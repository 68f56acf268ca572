"""What a controller asks of the equations of its mechanism; the model that it computes with: the mechanism's own, or
one with other numbers; the motion that it follows, as expressions of time with exact derivatives."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from robodyn_cli.algorithms.constraints import DrivenJoints
from robodyn_cli.algorithms.external import PathKinematics, path_torques
from robodyn_cli.algorithms.kinematics import Pose
from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.control.base import PointTask
from robodyn_cli.equations.constraints import Combination, Constraints, Dependence
from robodyn_cli.equations.discontinuities import is_of_time, switches, switching_times
from robodyn_cli.equations.linear.residuals import LinearisedEquations
from robodyn_cli.equations.time_structure import beside, structure
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.fixed import literal
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.rebuild import renamed
from robodyn_cli.model.model import BASE, Model
from robodyn_cli.model.places import free_places, place_is_in, with_free, with_own_places
from robodyn_cli.scene.points import with_points
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Transform, Values, Vector, Wrench, vector, zeros
from robodyn_cli.trajectories.formulas import joint_expressions
from robodyn_cli.trajectories.led import Followed


class ControlledEquations(LinearisedEquations, Protocol):
    """The equations of a scene (satisfied by ``Problem``)."""

    scene: Scene
    t: Expr
    keep_rows: Sequence[int] | None
    dependent: tuple[Dependence, ...]
    braces: Mapping[str, float]

    @property
    def environment(self) -> dict[str, Any]: ...
    @property
    def of_points(self) -> dict[str, Scalar]: ...
    @property
    def gravity(self) -> Vector | None: ...
    @property
    def X(self) -> list[Transform]: ...
    @property
    def pose(self) -> dict[int, Pose]: ...
    @property
    def inverse_dynamics(self) -> Vector: ...
    def newton_euler(self, v: Values, a: Values, gravity: Vector | None) -> Vector: ...
    def passive_forces(self, smooth: bool) -> dict[str, Vector]: ...

    @property
    def elimination_order(self) -> list[int]: ...
    @property
    def combinations(self) -> list[Combination]: ...
    @property
    def independent_rows(self) -> Constraints: ...

    @property
    def of(self) -> Callable[..., ControlledEquations]:
        """What gives the equations of another scene."""
        ...


SET = "control.model.set"


def model_scene(scene: Scene) -> Scene:
    """Return the scene of the controller's model: without drives, with the values of ``control.model.set``.

    A mechanism with loops keeps its prescribed joints: they move whatever the controller does.

    Raises
    ------
    SceneError : a key or a value is not allowed.
    """
    given = scene.control.model.set
    prescribed = scene.prescribed if scene.loops or scene.couplers else {}
    if given:
        from robodyn_cli.scene.load import load_scene_text

        settings = [
            "control=null",
            *(f"{section}=null" for section in ("outputs", "expect", "study")),
            *(f"{name}={value}" for name, value in given.items()),
        ]
        # numbers that are asked to be no structure stay so, but for those that the model has of its own
        own = {place for place in free_places(scene) if not any(place_is_in(place, name) for name in given)}
        try:
            scene = load_scene_text(scene.text, scene.path, settings)
        except SceneError as error:
            raise SceneError(error.message, (scene.path, SET), file=scene.path, key=SET) from error
        scene = with_own_places(with_free(scene, own), tuple(given), SET)
    return dataclasses.replace(scene, control=None, torques={}, prescribed=prescribed, trajectory=None)


def passive_forces(problem: ControlledEquations, friction: bool) -> Vector:
    """Return the torques (nv,) of springs, dampers and friction that a controller's model has.

    Losses of gears, which depend on the torque, are left out.
    """
    terms = problem.passive_forces(smooth=True) if friction else {}
    chosen = (x for name, x in terms.items() if name in ("passive", "friction"))
    return sum(chosen, zeros(problem.model.nv))


class ControllerModel:
    """Inverse dynamics, gravity and a point of the controller's model, at any state; torques of the driven joints.

    Parameters
    ----------
    problem : the equations of the mechanism itself, whose columns the model has too. make : gives those of a scene.
    """

    def __init__(self, problem: ControlledEquations, make: Callable[..., ControlledEquations]) -> None:
        self.controller = problem.scene.control
        scene = model_scene(problem.scene)
        motion = self.controller.reference
        if motion is not None and motion.point is not None:
            scene = with_points(scene, [motion.point])
        self.problem, self.t = make(scene, **_same_rows(problem)), problem.t
        if self.problem.model.v_names != problem.model.v_names:
            raise SceneError(
                "the model has other joints than the mechanism; allowed: other numbers", (scene.path, SET),
                file=scene.path, key=SET,
            )  # fmt: skip
        self.driven = [problem.model.v_names.index(name) for name in self.controller.joints]
        # of rows that depend on each other those combinations that the mechanism's own equations use
        self._combined = {
            own.place + k: theirs_k
            for own, theirs in zip(self.problem.combinations, problem.combinations)
            for k, theirs_k in enumerate(theirs.W.ravel())
        }

    def at(
        self, entries: Sequence[Scalar], q: Sequence[Any], v: Sequence[Any], a: Sequence[Any] = ()
    ) -> list[Any]:
        """Return expressions of the model at other positions, rates and accelerations.

        Of its parameters p those of contacts and payloads are zero.
        """
        p = dict.fromkeys(range(4 * len(self.problem.model.v_names)), 0.0) | self._combined
        groups: dict[str, Mapping[int, Any]] = {
            name: dict(enumerate(x)) for name, x in (("q", q), ("v", v), ("a", a))
        }
        return renamed(entries, {**groups, "p": p, "t": {0: self.t}})

    # -- torques of the driven joints -----------------------------------------------------------------
    def inverse_dynamics(self, q: Sequence[Any], v: Sequence[Any], a: Sequence[Any]) -> list[Any]:
        """Return the torques (n,) that give the driven joints accelerations a (n,).

        In an open chain those of M a + C v + G - tau_f, where joints that are not driven have none.
        """
        return self.at(self._inverse_dynamics, q, v, self._of_all(a))

    @cached_property
    def _inverse_dynamics(self) -> list[Any]:
        own = self.problem
        passive = passive_forces(own, self.controller.model.friction)
        if self._loops is None:
            return self._of_driven(own.inverse_dynamics - passive)
        gamma = own.independent_rows.gamma
        wanted = vector([own.a[k] for k in self.driven])
        return list(self._loops.torques(wanted - self._loops.free(passive - own.bias, gamma)))

    def gravity(self, q: Sequence[Any]) -> list[Any]:
        """Return the torques (n,) against gravity: G of the driven joints, or their share of it."""
        own, rest = self.problem, zeros(self.problem.model.nv)
        return self.at(self._share(own.newton_euler(rest, rest, own.gravity)), q, [0.0] * len(rest))

    def _share(self, load: Vector) -> list[Any]:
        """Return what the driven joints bear of a load (nv,) at rest: its entries, or the share that loops leave."""
        if self._loops is None:
            return self._of_driven(load)
        still = zeros(len(self.problem.independent_rows.rows))
        return list(self._loops.torques(-self._loops.free(-load, still)))

    @cached_property
    def _loops(self) -> DrivenJoints | None:
        """The driven joints of a mechanism with loops."""
        own = self.problem
        if not own.model.closures:
            return None
        factor = LdlFactor.of(own.mass_matrix, own.elimination_order)
        given = self.controller.directions
        directions = None if given is None else np.array(given, dtype=object)
        return DrivenJoints(factor, own.independent_rows.psi(own.model.nv), self.driven, directions)

    def _of_driven(self, entries: Values) -> list[Any]:
        return [entries[k] for k in self.driven]

    def _of_all(self, entries: Sequence[Any]) -> list[Any]:
        """Return entries (nv,) of all joints, zero where they are not driven."""
        full = [0.0] * self.problem.model.nv
        for k, x in zip(self.driven, entries):
            full[k] = x
        return full

    # -- a point --------------------------------------------------------------------------------------
    def point(
        self, q: Sequence[Any], v: Sequence[Any], wanted: Sequence[Any], rate: Sequence[Any]
    ) -> PointTask:
        """Return the point that the reference leads, for the first components of x, y, z that it gives."""
        own, m = self.problem, len(wanted)
        frame = own.model.place(self.controller.reference.point)
        end = PathKinematics(own.model, own.X, own.q, own.v, BASE).end(frame)
        to_world = own.model.base.E.T
        p, pd = own.model.base.point(end.p), to_world @ end.v

        def torques(force: Sequence[Any]) -> list[Any]:
            symbols = own.graph.symbols(["F.x", "F.y", "F.z"], "force")[:m]
            world = vector([*symbols, *([0.0] * (3 - m))])
            local = own.pose[frame.body].R.T @ (own.model.base.E @ world)
            wrench = Wrench(zeros(3), local).shifted(frame.p)
            tau = self._share(path_torques(own.model, own.q, own.X, {frame.body: wrench}))
            known = {"q": dict(enumerate(q)), "force": dict(enumerate(force)), "t": {0: self.t}}
            return renamed(tau, {**known, "p": self._combined})

        at, moving = self.at(list(p[:m]), q, v), self.at(list(pd[:m]), q, v)
        return PointTask(at, moving, list(wanted), list(rate), torques)

    def refuse(self, why: str) -> None:
        """Raise the error of a controller that cannot be built."""
        path = self.problem.scene.path
        raise SceneError(why, (path, "control"), file=path, key="control")


def _same_rows(problem: ControlledEquations) -> dict[str, Any]:
    """Return how the equations of the mechanism treat the rows of its loops, as arguments of its model."""
    if not problem.model.closures:
        return {}
    return {"keep_rows": problem.keep_rows, "dependent": problem.dependent, "braces": problem.braces}


Columns = tuple[list[Any], list[Any], list[Any]]


class Reference:
    """Positions, rates and accelerations of joints over time; held at the end of the motion.

    Parameters
    ----------
    motion : a trajectory in joint space; None for the pose ``start`` (by column of q).
    """

    def __init__(self, motion: Any, joints: Sequence[str], start: Mapping[str, float], until: float) -> None:
        self.motion, self.joints, self.start, self.until = motion, tuple(joints), start, until

    @property
    def known(self) -> bool:
        """Whether there is a motion, or a pose of all the joints, to follow."""
        return self.motion is not None or all(name in self.start for name in self.joints)

    def at(self, t: Expr, env: Mapping[str, Any]) -> Columns:
        """Return (q, qd, qdd) of the joints, each (n,), as expressions of t; env : values for formulas."""
        n, q = len(self.joints), self.positions(self.joints, t, env)
        if self.motion is None:
            return q, [0.0] * n, [0.0] * n
        qd = directional(q, [t], [1.0])
        return q, qd, directional(qd, [t], [1.0])

    def positions(self, names: Sequence[str], t: Expr, env: Mapping[str, Any]) -> list[Any]:
        """Return the positions of some joints of one coordinate, as expressions of t."""
        if self.motion is None:
            return self._held(names)
        given = Followed(self.motion, self.until).expressions({**env, "t": t})
        return [given[name] for name in names]

    def of_all(self, model: Model, t: Expr, env: Mapping[str, Any]) -> tuple[list[Any], list[Any]]:
        """Return positions (nq,) and rates (nv,) of all joints, as expressions of t; the motion must give all."""
        if self.motion is None:
            return self._held(model.q_names), [0.0] * model.nv
        given = Followed(self.motion, self.until).expressions({**env, "t": t})
        motion = joint_expressions(given, model.q_names, t)
        return motion.q, motion.v

    def _held(self, names: Sequence[str]) -> list[Any]:
        return [literal(float(self.start.get(name, 0.0)), f"initial.q.{name}") for name in names]

    def breakpoints(self, t: Expr, env: Mapping[str, Any]) -> list[float]:
        """Return the times at which the motion is not smooth, where steps have to end."""
        if self.motion is None:
            return []
        known = Followed(self.motion, self.until).breakpoints
        if known is not None:
            return [float(x) for x in known]
        times: set[float] = {self.motion.duration} if self.until > self.motion.duration else set()
        entries = [x for x in self.at(t, env)[0] if isinstance(x, Expr)]
        for switch in switches(entries):
            if is_of_time(switch, t):
                times.update(switching_times(switch, t, self.until))
        for x in entries:
            times.update(beside(structure(x, t, self.until), times, self.until))
        return sorted(times)


def reference_of(scene: Scene, start: Mapping[str, float]) -> Reference:
    """Return what the controller of a scene follows."""
    controller = scene.control
    own = controller.reference
    motion = None if own is None or own.lacks else own
    return Reference(motion, controller.joints, start, scene.simulate.duration)


def tracked_joints(reference: Reference, pose: Mapping[str, float], model: Model) -> tuple[str, ...]:
    """Return the joints of one coordinate that have a position to be at: the driven ones, and others that the motion
    leads, or that are held in a ``pose`` of all joints."""
    single = [name for name in model.v_names if name in model.q_names]
    given = pose if reference.motion is None else dict.fromkeys(reference.motion.joints)
    return (*reference.joints, *(name for name in single if name in given and name not in reference.joints))
