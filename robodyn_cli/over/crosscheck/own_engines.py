"""A mechanism in another engine as its users have it, with the engine's own steps and closures; in MuJoCo."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.over.crosscheck.engine import Translation, is_plain
from robodyn_cli.over.crosscheck.engines import InMujoco, robot_of
from robodyn_cli.over.export.mjcf import MJCF, mjcf_text
from robodyn_cli.over.export.robot import ExportedRobot
from robodyn_cli.over.export.scene import coupler_of, renamed
from robodyn_cli.spatial.algebra import Array

# what its users do not have in a mechanism without shapes, or what would hide that a run has blown up
FLAGS = {"contact": "disable", "limit": "disable", "autoreset": "disable"}


class OwnRun(ABC):
    """A mechanism that another engine moves by its own steps. Arrays are in our order and coordinates.

    name, version : of the engine. step : of time [s]. settings : those that matter, in words by name.
    """

    name: str
    version: str
    step: float
    settings: dict[str, str]

    @abstractmethod
    def start(self, q: Array, v: Array) -> None:
        """Begin at a state at t = 0."""

    @abstractmethod
    def advance(self, tau: Array) -> tuple[Array, Array, Array]:
        """Make a step under joint torques (nv,); return the state q (nq,), v (nv,) behind it, and the accelerations
        (nv,) that the engine has at its begin."""

    @abstractmethod
    def inertia(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the engine's M (nv, nv), rotors included, and h (nv,) at a state."""


def plain_robot(translated: Translation) -> ExportedRobot:
    """Return the mechanism for an engine that has springs and dampers of its own, and is handed the other torques.

    Raises
    ------
    CapabilityError : a body moves without mass, which no engine takes.
    """
    model = translated.model
    bodies = (
        dataclasses.replace(body, forces=tuple(force for force in body.forces if is_plain(force)))
        for body in model.bodies
    )
    neutral = Manifold(model).neutral()
    couplers = (coupler_of(translated.scene, one, model, neutral) for one in translated.scene.couplers)
    robot = robot_of(dataclasses.replace(model, bodies=tuple(bodies)))
    robot = renamed(dataclasses.replace(robot, couplers=tuple(couplers)), MJCF, [])
    if problems := [*MJCF.problems(robot)]:
        raise CapabilityError("not for another engine: " + "; ".join(problems))
    return robot


class OwnMujoco(InMujoco, OwnRun):
    """MuJoCo with soft equalities, its default step and integrator, without contacts and stops."""

    def __init__(self, translated: Translation, step: float | None) -> None:
        self._translated = translated
        super().__init__(translated.model)
        option, names = self.model.opt, self.mj
        if step is not None:
            option.timestep = step
        self.step = float(option.timestep)
        self.settings = {
            "integrator": names.mjtIntegrator(option.integrator).name.removeprefix("mjINT_"),
            "solver": names.mjtSolver(option.solver).name.removeprefix("mjSOL_"),
        }
        if self.model.neq:
            self.settings["solref"] = " ".join(f"{x:g}" for x in self.model.eq_solref[0])
            self.settings["solimp"] = " ".join(f"{x:g}" for x in self.model.eq_solimp[0])

    def _described(self, model: Model) -> tuple[str, list[str]]:
        robot = plain_robot(self._translated)
        return mjcf_text(robot, FLAGS), [link.name for link in robot.links]

    def start(self, q: Array, v: Array) -> None:
        self.mj.mj_resetData(self.model, self.data)
        self._set(q, v)

    def advance(self, tau: Array) -> tuple[Array, Array, Array]:
        _, before, T = self._state()
        self.data.qfrc_applied[:] = (T @ tau)[self.v_places]
        self.mj.set_mju_user_warning(_no_word)  # or it would write a file into the working directory
        try:
            self.mj.mj_step(self.model, self.data)
        finally:
            self.mj.set_mju_user_warning(None)
        a = self.in_our_order(np.array(self.data.qacc)) @ T - self._drift(before)
        q, v, _ = self._state()
        return q, v, a

    def _state(self) -> tuple[Array, Array, Array]:
        """Return q, v and T."""
        q = np.empty(len(self.q_places))
        q[self.q_places] = self.data.qpos
        T = self._turn(q)
        return q, self.in_our_order(np.array(self.data.qvel)) @ T, T

    def inertia(self, q: Array, v: Array) -> tuple[Array, Array]:
        self.bring(q, v)
        M, bias = self.mass_matrix(), self.in_our_order(np.array(self.data.qfrc_bias))
        return M, np.asarray(bias @ self._T) + M @ self._lag


def _no_word(text: str) -> None:
    """Leave a warning of an unstable run alone: the state behind the step says it too."""
