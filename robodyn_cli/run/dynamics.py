"""Inverse and forward dynamics of open chains as compiled functions of arrays of samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import Model
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import Vector, zeros

Array = NDArray[np.float64]


def open_problem(source: sc.Scene | Model | Problem, what: str) -> Problem:
    """Return the equations of a scene or a model.

    Raises
    ------
    CapabilityError : it has loops or prescribed joints.
    """
    if isinstance(source, Model):
        # the model brings everything but drives, and what is driven is not asked here
        nothing = sc.Scene(schema=1, robot=sc.Robot(joints=(), links=()), gravity=(0.0, 0.0, 0.0))
        source = Problem(nothing, model=source)
    problem = source if isinstance(source, Problem) else Problem(source)
    if problem.model.loops:
        raise CapabilityError(
            f"{what} of closed loops (here {problem.model.loops[0].name!r}) is not implemented yet: the "
            "actuated joints share the load in more than one way; allowed: robots without loops"
        )
    if problem.scene.prescribed:
        name = next(iter(problem.scene.prescribed))
        raise CapabilityError(
            f"{what} takes all motion from its input, so 'prescribed' ({name!r}) has no place there"
        )
    return problem


def joint_force_terms(problem: Problem) -> dict[str, Vector]:
    """Return the torques of springs, dampers and friction on the joints, with the exact sign of the rate."""
    return problem.joint_forces(smooth=False)


class InverseDynamics:
    """Joint torques that a motion needs, tau = M qdd + C qd + G - tau_passive - tau_friction.

    Calling it takes q (T, nq), qd and qdd (T, nv) and returns tau (T, nv) [N m or N], columns in the order of
    the joints. Column-ordered arrays (``order="F"``) of float64 are read in place, others are copied first;
    the result is column-ordered.
    """

    def __init__(self, source: sc.Scene | Model | Problem) -> None:
        problem = open_problem(source, "inverse dynamics")
        tau: Any = problem.inverse_dynamics
        for term in joint_force_terms(problem).values():
            tau = tau - term
        self.joints = problem.model.v_names
        self.kernel = SampleKernel({"tau": list(tau)}, ("q", "v", "a"))

    @property
    def operations(self) -> int:
        """Arithmetic operations and function calls a sample."""
        return self.kernel.program.operations

    def __call__(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return tau (T, nv)."""
        return self.kernel(q=q, v=qd, a=qdd)["tau"]


class ForwardDynamics:
    """Joint accelerations that torques cause, qdd = M^-1 (tau + tau_passive + tau_friction - C qd - G).

    Calling it takes q (T, nq), qd and tau (T, nv) and returns qdd (T, nv); arrays as for
    ``InverseDynamics``, whose inverse it is: friction has the exact sign of the rate, and is 0 at rest.
    """

    def __init__(self, source: sc.Scene | Model | Problem) -> None:
        problem = open_problem(source, "forward dynamics")
        model = problem.model
        f: Any = zeros(model.nv)
        for k, symbol in enumerate(problem.graph.symbols(model.v_names, "tau")):
            f[k] = symbol
        for term in joint_force_terms(problem).values():
            f = f + term
        self.joints = model.v_names
        self.kernel = SampleKernel(
            {"a": list(problem.free_accelerations(f - problem.bias))}, ("q", "v", "tau")
        )

    @property
    def operations(self) -> int:
        """Arithmetic operations and function calls a sample."""
        return self.kernel.program.operations

    def __call__(self, q: Array, qd: Array, tau: Array) -> Array:
        """Return qdd (T, nv)."""
        return self.kernel(q=q, v=qd, tau=tau)["a"]
