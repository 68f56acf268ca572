"""Observation of long chains, whose accelerations come from loops over the bodies."""

from __future__ import annotations

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.formulations.dynamics import Dynamics
from robodyn_cli.formulations.rolled import Rolled
from robodyn_cli.kernels.rolled.kernels import RolledForwardDynamics
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.observe.evaluation import Outputs, SampleFunction
from robodyn_cli.spatial.algebra import Array


class ObservedRolled:
    """Observation of a long chain: accelerations by loops over its bodies, other outputs from expressions.

    outputs : these others. Their size grows with the length only; they are interpreted where that takes less time than
    compiling.
    """

    def __init__(self, problem: Problem, dynamics: Dynamics, outputs: Outputs) -> None:
        assert isinstance(dynamics, Rolled)
        self.places = list(dynamics.places)
        forces = [dynamics.forces[k] for k in self.places]
        samples = problem.scene.simulate.samples
        self.function = SampleFunction({**outputs, "forces": forces}, STATE_GROUPS, samples)
        self.forward = RolledForwardDynamics(problem.model)

    def evaluate(self, samples: int, groups: dict[str, Array]) -> dict[str, Array]:
        # parameters are no samples, and simulations have none
        columns = {name: np.reshape(x, (samples, -1)) for name, x in groups.items() if name != "p"}
        values = self.function(**columns)
        tau = np.zeros(columns["v"].shape, order="F")
        tau[:, self.places] = values["forces"]
        values["qdd"] = self.forward(columns["q"], columns["v"], tau)
        return values
