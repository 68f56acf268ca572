"""The model that a controller computes with: the mechanism's own, or one with other numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.algorithms.driven import DrivenJoints
from robodyn_cli.algorithms.external import PathKinematics, path_torques
from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.control.base import PointTask
from robodyn_cli.equations.control.equations import Equations
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.rebuild import renamed
from robodyn_cli.model.model import BASE
from robodyn_cli.model.places import with_own_places
from robodyn_cli.scene.points import with_points
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Values, Vector, Wrench, vector, zeros

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
            "outputs.signals=null",
            *(f"{name}={value}" for name, value in given.items()),
        ]
        try:
            scene = load_scene_text(scene.text, scene.path, settings)
        except SceneError as error:
            raise SceneError(f"{scene.path}: {SET}: {error.message}", file=scene.path, key=SET) from error
        scene = with_own_places(scene, tuple(given), SET)
    return dataclasses.replace(scene, control=None, torques={}, prescribed=prescribed, trajectory=None)


def passive_forces(problem: Equations, friction: bool) -> Vector:
    """Return the torques (nv,) of springs, dampers and friction that a controller's model has.

    Losses of gears, which depend on the torque, are left out.
    """
    terms = problem.passive_forces(smooth=True) if friction else {}
    found = (x for name, x in terms.items() if name in ("passive", "friction"))
    return sum(found, zeros(problem.model.nv))


class ControllerModel:
    """Inverse dynamics, gravity and a point of the controller's model, at any state; torques of the driven joints.

    Parameters
    ----------
    problem : the equations of the mechanism itself, whose columns the model has too. make : gives those of a scene.
    """

    def __init__(self, problem: Equations, make: Callable[..., Equations]) -> None:
        self.controller = problem.scene.control
        scene = model_scene(problem.scene)
        motion = self.controller.reference
        if motion is not None and motion.point is not None:
            scene = with_points(scene, [motion.point])
        self.problem, self.t = make(scene, **_same_rows(problem)), problem.t
        if self.problem.model.v_names != problem.model.v_names:
            raise SceneError(
                f"{scene.path}: {SET}: the model has other joints than the mechanism; allowed: other numbers",
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
        found = [0.0] * self.problem.model.nv
        for k, x in zip(self.driven, entries):
            found[k] = x
        return found

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
        raise SceneError(f"{path}: control: {why}", file=path, key="control")


def _same_rows(problem: Equations) -> dict[str, Any]:
    """Return how the equations of the mechanism treat the rows of its loops, as arguments of its model."""
    if not problem.model.closures:
        return {}
    return {"keep_rows": problem.keep_rows, "dependent": problem.dependent, "braces": problem.braces}
