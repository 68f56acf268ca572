"""The model that a controller computes with: the mechanism's own, or one with other numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.algorithms.external import PathKinematics, path_torques
from robodyn_cli.control.base import Linear, PointTask
from robodyn_cli.equations.control.equations import Equations
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.fixed import literal
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.rebuild import renamed
from robodyn_cli.model.model import BASE
from robodyn_cli.scene.points import with_points
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array, Vector, Wrench, vector, zeros

LEFT = 1e-9  # of the largest torque: a joint that nobody drives may need so much to be held in a pose


def model_scene(scene: Scene) -> Scene:
    """Return the scene of the controller's model: without drives, with the values of ``control.model.set``.

    Raises
    ------
    SceneError : a key or a value is not allowed.
    """
    given = scene.control.model.set
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
            raise SceneError(
                f"{scene.path}: control.model.set: {error.message}", file=scene.path, key="control.model.set"
            ) from error
    return dataclasses.replace(scene, control=None, torques={}, prescribed={}, trajectory=None)


class ControllerModel:
    """Inverse dynamics, gravity and a point of the controller's model, at any state.

    Parameters
    ----------
    problem : the equations of the mechanism itself, whose columns the model has too. make : gives those of a scene.
    """

    def __init__(self, problem: Equations, make: Callable[..., Equations]) -> None:
        self.controller = problem.scene.control
        scene = model_scene(problem.scene)
        lead = getattr(getattr(self.controller, "reference", None), "point", None)
        if lead is not None:
            scene = with_points(scene, [lead])
        self.problem, self.t = make(scene), problem.t
        if self.problem.model.v_names != problem.model.v_names:
            raise SceneError(
                f"{scene.path}: control.model.set: the model has other joints than the mechanism; allowed: "
                "other numbers",
                file=scene.path, key="control.model.set",
            )  # fmt: skip
        self.driven = [problem.model.v_names.index(name) for name in self.controller.joints]

    def at(
        self, entries: Sequence[Scalar], q: Sequence[Any], v: Sequence[Any], a: Sequence[Any] = ()
    ) -> list[Any]:
        """Return expressions of the model at other positions, rates and accelerations; its parameters p are zero."""
        p = dict.fromkeys(range(4 * len(self.problem.model.v_names)), 0.0)
        groups: dict[str, Mapping[int, Any]] = {
            name: dict(enumerate(x)) for name, x in (("q", q), ("v", v), ("a", a))
        }
        return renamed(entries, {**groups, "p": p, "t": {0: self.t}})

    @cached_property
    def _friction(self) -> Vector:
        """Torques of springs, dampers and friction; losses of gears, which depend on the torque, are left out."""
        if not self.controller.model.friction:
            return zeros(self.problem.model.nv)
        terms = self.problem.passive_forces(smooth=True)
        return sum(
            (x for name, x in terms.items() if name in ("passive", "friction")), zeros(self.problem.model.nv)
        )

    def inverse_dynamics(self, q: Sequence[Any], v: Sequence[Any], a: Sequence[Any]) -> list[Any]:
        """Return M a + C v + G - tau_f (nv,)."""
        return self.at(list(self.problem.inverse_dynamics - self._friction), q, v, a)

    def gravity(self, q: Sequence[Any]) -> list[Any]:
        """Return G (nv,)."""
        rest = zeros(self.problem.model.nv)
        return self.at(
            list(self.problem.newton_euler(rest, rest, self.problem.gravity)), q, [0.0] * len(rest)
        )

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
            tau = path_torques(own.model, own.q, own.X, {frame.body: wrench})
            known = {"q": dict(enumerate(q)), "force": dict(enumerate(force)), "t": {0: self.t}}
            found = renamed(list(tau), known)
            return [found[k] for k in self.driven]

        at, moving = self.at(list(p[:m]), q, v), self.at(list(pd[:m]), q, v)
        return PointTask(at, moving, list(wanted), list(rate), torques)

    def linear(self, pose: Array, q: Sequence[Any], v: Sequence[Any]) -> Linear:
        """Return the model about a pose q (nq,) at rest, for measured q and v.

        Raises
        ------
        SceneError : the driven joints cannot hold it there.
        """
        from robodyn_cli.equations.linear.reduce import linearise_states
        from robodyn_cli.equations.linear.residuals import Residuals, States

        own, nv, driven = self.problem, self.problem.model.nv, self.driven
        if any(body.joint.quasi for body in own.model.bodies):
            self.refuse("a joint has an attitude, which 'lqr' does not linearise; allowed: joints of axes")
        equations = Residuals(own, self._friction + self._others, own.model.switched)
        still = np.zeros((1, nv))
        holding = equations.values(States(np.zeros(1), pose[None], still, None, still))["load"][0]
        left = [k for k in range(nv) if k not in driven]
        if left and np.abs(holding[left]).max() > LEFT * max(1.0, float(np.abs(holding).max())):
            worst = left[int(np.argmax(np.abs(holding[left])))]
            self.refuse(
                f"the pose is no equilibrium: joint {own.model.v_names[worst]!r}, which the controller does not drive, "
                f"would need {holding[worst]:.4g} N m (or N) there; allowed: a pose that the driven joints can hold"
            )
        tau = np.where(np.isin(np.arange(nv), driven), holding, 0.0)
        at_rest = States(np.zeros(1), pose[None], still, None, tau[None])
        found = linearise_states(equations, at_rest, driven, tuple(range(nv)))
        held = [literal(float(x), f"control.pose.{name}") for name, x in zip(own.model.q_names, pose)]
        x = [*(a - b for a, b in zip(q, held)), *v]
        return Linear(
            found.A[0], found.B[0], x, holding[driven], own.model.v_names, self._period, self.refuse
        )

    @property
    def _period(self) -> float | None:
        return None if self.controller.period is None else float(self.controller.period)

    @cached_property
    def _others(self) -> Vector:
        """Torques of forces between bodies and from outside that are no springs of joints, and of soft stops."""
        terms = self.problem.passive_forces(smooth=True)
        left = [x for name, x in terms.items() if name not in ("passive", "friction", "gear")]
        return sum(left, zeros(self.problem.model.nv))

    def refuse(self, why: str) -> None:
        """Raise the error of a controller for which there is no gain."""
        path = self.problem.scene.path
        raise SceneError(f"{path}: control: {why}", file=path, key="control")
