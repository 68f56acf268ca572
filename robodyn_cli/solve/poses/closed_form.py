"""Closed-form inverse kinematics: which arms have one, and what all of them give."""

from __future__ import annotations

import numpy as np

from robodyn_cli.model.model import Model
from robodyn_cli.record import record
from robodyn_cli.solve.poses.families import ArmFamily, ParallelAxes, SphericalWrist, ThreeParallel
from robodyn_cli.solve.poses.screws import Screws
from robodyn_cli.solve.poses.steps import PoseTask
from robodyn_cli.spatial.algebra import Array


@record
class ClosedForm:
    """The closed form of one arm and one task."""

    family: ArmFamily

    @staticmethod
    def of(model: Model, task: PoseTask) -> ClosedForm | None:
        """Return the closed form of an arm for a task, None where there is none."""
        screws = Screws.of(model, task.frame)
        if screws is None or len(task.position) != 3:
            return None
        if task.orientation == "full":
            six: ArmFamily | None = SphericalWrist.recognise(screws) or ThreeParallel.recognise(screws)
            if six is not None:
                return ClosedForm(six)
        arm: ArmFamily | None = ParallelAxes.recognise(screws, task.orientation)
        return None if arm is None else ClosedForm(arm)

    @property
    def names(self) -> list[tuple[str, ...]]:
        """All branches by name, those of the first choice together."""
        names: list[tuple[str, ...]] = [()]
        for pair in self.family.words:
            names = [(*name, word) for name in names for word in pair]
        return names

    def branches(self, p: Array, R: Array, others: Array) -> dict[tuple[str, ...], Array]:
        """Return q (T, nq) of each branch for targets p (T, 3) and R (T, 3, 3) of the world.

        others : (T, nq) positions, of which the joints keep theirs that do not move the frame.
        """
        screws = self.family.screws
        found = {}
        for branch in self.family.branches(*screws.in_base(p, R)):
            q = np.array(np.broadcast_to(others, (len(p), screws.nq)), dtype=float)
            for axis, column in zip(screws.axes, branch.values.T):
                q[:, axis.place] = column
            found[branch.name] = q
        return found
