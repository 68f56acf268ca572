"""Exact derivatives of the figures of drives in a motion that is given: what they bear changes with its samples.

M, what holds each pose, and Psi are differentiated as torques are (see ``along_motions``); data of motors and gears are
those of a scene with the key changed, where they change with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.drives.report import Drives, Moved, standing_outputs, standstill
from robodyn_cli.equations.problem import Problem
from robodyn_cli.model.parts import trains
from robodyn_cli.motors.drive import Train
from robodyn_cli.over.sensitivity.asked import NEARBY, AskedSlopes
from robodyn_cli.over.sensitivity.gradients import MotionGradients
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.drives import DriveFigures


class DriveSlopes:
    """The drives that outputs are of, along the samples of an inverse run, changed by one of some keys.

    numbers : of the keys. places : of their numbers, see ``MotionGradients``.
    """

    def __init__(
        self, asked: AskedSlopes, problem: Problem, numbers: Sequence[int], places: Sequence[str]
    ) -> None:
        self.asked, self.problem, self.numbers = asked, problem, numbers
        self.outputs = standing_outputs(problem)
        self.gradients = MotionGradients(problem, self.outputs, places)

    def at_rest(
        self, groups: Mapping[str, Array], moved: Mapping[str, Array]
    ) -> dict[str, tuple[Array, Array]]:
        """Return what joints feel where the motion stands still: values (T, n) and derivatives (T, n, K) by name.

        groups, moved : samples of t, q, v, v-dot and multipliers, and derivatives of t and q.
        """
        nothing = {name: np.zeros_like(groups[name]) for name in ("v", "a", "lam")}
        along, change = self.gradients({**groups, **nothing}), {name: moved[name] for name in ("t", "q")}
        return {name: (along[name], along.change(name, change)) for name in self.outputs}

    def figures(self, run: Moved, rest: Mapping[str, Array], k: int, step: float) -> dict[str, DriveFigures]:
        """Return the figures in a motion, for the k-th of the keys changed by ``step``; rest : (T, n) by name."""
        by_joint = self._by_joint[0] if not step or self._by_joint[1][k] else self._changed(k, step)
        return Drives.along(self.problem, by_joint, run, standstill(self.problem, rest)).figures()

    @cached_property
    def _by_joint(self) -> tuple[dict[str, Train], list[bool]]:
        """The drives of the scene as it stands, and for each key whether they stay as they are."""
        own = self._of(self.asked.scene)
        values = [abs(self.asked.values[number]) or 1.0 for number in self.numbers]
        return own, [self._changed(k, NEARBY * value) == own for k, value in enumerate(values)]

    def _changed(self, k: int, step: float) -> dict[str, Train]:
        number = self.numbers[k]
        return self._of(self.asked.changed([number], step / (abs(self.asked.values[number]) or 1.0)))

    def _of(self, scene: Scene) -> dict[str, Train]:
        """Return the drives of a scene that outputs are of, by joint."""
        heads = {name: f"drives.{name}." for name in scene.drives}
        wanted = {
            name for name, head in heads.items() if any(x.startswith(head) for x in self.asked.task.outputs)
        }
        return {name: train for name, train in trains(scene).items() if name in wanted}
