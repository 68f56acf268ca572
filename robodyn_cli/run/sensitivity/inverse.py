"""Exact derivatives of the figures of ``inverse`` in open chains: its torques depend on numbers of the scene directly.

    d figure / dk = d figure(tau + s tau_k) / ds at s = 0,  tau_k = d tau / dk along the motion

The figures are those of ``run/inverse/checks.py``; their slope along tau_k is a central difference, which is exact for
peaks and ranges, and for integrals up to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.by_keys import ByKeys
from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.run.inverse.checks import FIGURES, Loaded
from robodyn_cli.run.inverse.inverse import at_rest, program_of
from robodyn_cli.run.inverse.program import InverseProgram
from robodyn_cli.run.many.inverse import motion_obstacle
from robodyn_cli.run.many.keys import NUMBER, Key
from robodyn_cli.run.sensitivity.slope import EXACT, Slope
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.motion import TaskSpace

SMALL = 1e-5  # part of the largest torque by which torques are changed
ROUNDING = 1e-11  # of a difference over so small a change


def figures_among(outputs: Sequence[str], joints: Sequence[str]) -> dict[str, tuple[str, int]]:
    """Return the outputs that are figures of joints: the figure, and the number of the joint."""
    return {
        key: (name, k)
        for key in outputs
        for k, joint in enumerate(joints)
        for name in FIGURES
        if key in (f"joints.{joint}.{name}", f"{name}.{joint}")
    }


class TorqueFigures:
    """The torques of a motion, and their derivatives by numbers of the scene.

    Raises
    ------
    CapabilityError : keys change the motion, or loops share the load.
    """

    def __init__(self, scene: Scene, keys: Sequence[Key]) -> None:
        self.program, self.keys = program_of(scene), keys
        if why := motion_obstacle(self.program, scene, keys) or _change_of_motion(self.program, scene, keys):
            raise CapabilityError(why)
        terms = [self.program.outputs[f"torque_terms/{name}"] for name in self.program.terms]
        total = [sum(parts) for parts in zip(*terms)]
        rows = jacobian(total, [], _by_keys(keys))
        self._places = [(i, k) for i, row in enumerate(rows) for k in row]
        outputs = {"tau": total, "by_key": [x for row in rows for x in row.values()]}
        self.kernel = SampleKernel({name: x for name, x in outputs.items() if x}, MOTION_GROUPS)

    @property
    def digest(self) -> str:
        """Key of everything that decides the code of torques and derivatives."""
        return self.kernel.program.digest

    @cached_property
    def _sampled(self) -> tuple[Loaded, Array]:
        """The motion with its torques (T, nv), and their derivatives by keys (T, nv, K)."""
        problem = self.program.problem
        planned = at_rest(problem, self.program.plan(problem.scene.inverse.samples))
        motion, times = planned.motion, planned.times
        groups = {"t": times[:, None], "q": motion.q, "v": motion.qd, "a": motion.qdd}
        found = self.kernel.evaluate(len(times), groups)
        slopes = np.zeros((*found["tau"].shape, len(self.keys)))
        if self._places:
            joints, keys = np.array(self._places).T
            slopes[:, joints, keys] = found["by_key"]
        return Loaded(times, found["tau"], motion.qd), slopes

    def slopes(self, figure: str, joint: int) -> list[Slope]:
        """Return the derivatives of a figure of one joint, one for each key."""
        loaded, slopes = self._sampled
        own = Loaded(loaded.times, loaded.tau[:, [joint]], loaded.qd[:, [joint]])
        return [_along(figure, own, slopes[:, [joint], k]) for k in range(len(self.keys))]


def _change_of_motion(program: InverseProgram, scene: Scene, keys: Sequence[Key]) -> str:
    """Return why keys change the motion itself; nothing where they do not."""
    if any(key.sort != NUMBER for key in keys):
        return "the key is no number of the equations"
    if not isinstance(scene.trajectory, TaskSpace):
        return ""
    problem = program.problem
    points = [x for frame in problem.model.points.values() for x in problem.world_point(frame)]
    frames = [x for pose in problem.pose.values() for x in (*pose.p, *pose.R.flat)]
    moved = jacobian([*points, *frames], [], _by_keys(keys))
    return "a point is led, and the key changes the joints that lead it there" if any(moved) else ""


def _by_keys(keys: Sequence[Key]) -> ByKeys:
    return ByKeys({key.place: k for k, key in enumerate(keys)})


def _along(figure: str, own: Loaded, slope: Array) -> Slope:
    """Return the derivative of a figure of one joint whose torques change with such a slope (T, 1)."""
    largest = float(np.abs(slope).max())
    if largest == 0.0:
        return Slope(0.0, 0.0, EXACT)

    def difference(s: float) -> float:
        ends = [FIGURES[figure](Loaded(own.times, own.tau + way * slope, own.qd))[0] for way in (s, -s)]
        return float((ends[0] - ends[1]) / (2.0 * s))

    step = SMALL * max(float(np.abs(own.tau).max()), 1e-300) / largest
    value, wide = difference(step), difference(2.0 * step)
    return Slope(value, abs(value - wide) + ROUNDING * max(abs(value), largest), EXACT)
