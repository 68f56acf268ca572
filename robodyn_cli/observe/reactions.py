"""Forces and moments in joints and loop closures along a motion, from its accelerations and multipliers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import islice

import numpy as np

from robodyn_cli.algorithms.kinematics import Pose, motions, poses
from robodyn_cli.algorithms.reactions import Reactions, reactions
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.forces.element import Effect
from robodyn_cli.model.joints import joint_axes
from robodyn_cli.model.model import BASE, Force, Model, are_known
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.record import record
from robodyn_cli.results.result import Result, magnitude
from robodyn_cli.scene.points import point_link
from robodyn_cli.solve.extremes import largest
from robodyn_cli.solve.quadrature import Breaks
from robodyn_cli.spatial.algebra import Array, Matrix, Wrench, identity
from robodyn_cli.summaries.facts import ABSENT, PeakLoad, PeakLoads
from robodyn_cli.trajectories.motion import JointMotion

NAMES = ("fx", "fy", "fz", "mx", "my", "mz")
REACTION_GROUPS = ("t", "q", "v", "a", "lam", "p")
BASE_PATH, FORCE_WRENCHES = "base_wrench", "force_wrenches/"
NONE: Array = np.zeros(0)


class ReactionSamples:
    """Wrenches in joints and closures as functions of samples of t, q, v, v-dot and the multipliers.

    A component that depends on data which the scene does not give (the moment across the plane of an arm of which
    only zz is known) is left out; ``missing`` names them.
    """

    def __init__(self, problem: Problem, samples: int) -> None:
        model, self.problem = problem.model, problem
        self.rows = problem.constraints.names
        lam = dict(zip(self.rows, problem.graph.symbols(self.rows, "lam")))
        applied = problem.elements.wrenches
        motion = motions(model, problem.X, problem.q, problem.v, problem.a, problem.gravity)
        loads = reactions(model, problem.X, motion, lam, applied)
        self.names: dict[str, tuple[str, ...]] = {}
        self.meanings: dict[str, str] = {}
        self.missing: dict[str, list[str]] = {}
        outputs: dict[str, list[Scalar]] = {}
        wrenches = self._entries(model, loads)
        given = iter(are_known([e for entries, _ in wrenches.values() for e in entries]))
        for path, (entries, meaning) in wrenches.items():
            known = [k for k, is_known in enumerate(islice(given, len(entries))) if is_known]
            if len(known) < len(NAMES):
                self.missing[path] = [NAMES[k] for k in range(len(NAMES)) if k not in known]
            if known:
                outputs[path] = [entries[k] for k in known]
                self.names[path] = tuple(NAMES[k] for k in known)
                self.meanings[path] = meaning
        self.function = SampleFunction(outputs, REACTION_GROUPS, samples)

    def _entries(self, model: Model, loads: Reactions) -> dict[str, tuple[list[Scalar], str]]:
        """Return forces and moments of each joint and closure, and of the base, each with its meaning in words."""
        problem = self.problem
        in_world = problem.scene.outputs.reaction_axes == "world"
        to_world = model.base.E.T
        joints = {joint.name: joint for joint in problem.scene.robot.joints}
        entries: dict[str, tuple[list[Scalar], str]] = {}
        for k, body in enumerate(model.bodies):
            axes = to_world @ problem.pose[k].R if in_world else joint_axes(joints[body.joint_name]).T
            parent = "base" if body.parent == BASE else model.bodies[body.parent].name
            frame = "world axes" if in_world else "axes of the joint's frame, turning with the link"
            meaning = f"what {parent} exerts on {body.name}, about the joint's origin, {frame}"
            entries[f"reactions/{body.joint_name}"] = (_turned(axes, loads.joints[k]), meaning)
        for loop, wrench in zip(model.loops, loads.loops):
            first = loop.first
            link, other = (point_link(problem.scene.robot, text) for text in loop.element.between)
            if in_world:
                R = identity() if wrench.root == BASE else problem.pose[wrench.root].R
                axes, frame = to_world @ R, "world axes"
            else:
                pose: dict[int, Pose] = poses(model, problem.X, wrench.root)
                axes, frame = (pose[first.body].R @ first.R).T, f"axes of {link}'s frame"
            meaning = f"what {other} exerts on {link}, about the first point of the closure, {frame}"
            entries[f"loop_reactions/{loop.name}"] = (_turned(axes, wrench.on_first), meaning)
        meaning = "what it exerts on its last place, about that place, world axes"
        for force, effect in zip(model.forces, problem.elements.effects):
            own = self._on_last_end(force, effect)
            entries[f"{FORCE_WRENCHES}{force.name}"] = ([*own.f, *own.n], meaning)
        meaning = "what the ground exerts on the mechanism, about the base's origin, world axes"
        entries[BASE_PATH] = (_turned(to_world, loads.base), meaning)
        return entries

    def _on_last_end(self, force: Force, effect: Effect) -> Wrench:
        """Return the wrench of an element on its last end, about that end, world axes."""
        problem, last = self.problem, len(force.ends) - 1
        end, root = force.ends[last], problem.elements.root(force)
        to_world, pose = problem.model.base.E.T, problem.pose
        own = Wrench.zero()
        for action in effect.actions:
            if action.end == last:
                body = end.body if action.local else root
                R = identity() if body == BASE else pose[body].R
                own = own + action.wrench.rotated(to_world @ (R @ end.R if action.local else R))
        return own

    def __call__(
        self, t: Array, q: Array, qd: Array, qdd: Array, lam: Array | None, p: Array = NONE
    ) -> dict[str, Array]:
        """Return {path: (T, 6)}; lam (T, m) are multipliers of the problem's rows, p (n,) or (T, n) parameters."""
        if lam is None:
            lam = np.zeros((len(t), len(self.rows)))
        p = np.broadcast_to(p, (len(t), p.shape[-1]))
        return self.function(t=np.reshape(t, (-1, 1)), q=q, v=qd, a=qdd, lam=lam, p=p)

    def add(self, result: Result, data: Mapping[str, Array]) -> None:
        """Add the loads to a result."""
        for path, array in data.items():
            result.add(path, array, long_name=self.meanings[path], names=self.names[path])

    @property
    def of_parts(self) -> list[str]:
        """The paths of joints, closures and the base."""
        return [path for path in self.names if not path.startswith(FORCE_WRENCHES)]

    def largest(self, times: Array, data: Mapping[str, Array], breaks: Breaks) -> dict[str, PeakLoad]:
        """Return the largest load of each joint and closure along samples at times (T,), by name."""
        return figures(times, {path: data[path] for path in self.of_parts}, self.names, breaks)

    def described(self, largest: dict[str, PeakLoad]) -> PeakLoads:
        """Return what the summary says: the axes, components that the data do not determine, and the largest loads."""
        missing = {
            path.split("/")[-1]: names
            for path, names in self.missing.items()
            if not path.startswith(FORCE_WRENCHES)
        }
        return PeakLoads(self.problem.scene.outputs.reaction_axes, missing or ABSENT, largest)


@record
class Loads:
    """Forces and moments in joints and closures along a motion, by result path."""

    samples: ReactionSamples
    times: Array
    data: Mapping[str, Array]

    def add_to(self, result: Result) -> None:
        """Add them to a result."""
        self.samples.add(result, self.data)

    def summary(self, breaks: Breaks) -> PeakLoads:
        """Return what the summary says. breaks : where loads jump, in steps from the first sample."""
        return self.samples.described(self.samples.largest(self.times, self.data, breaks))


def loads_along(
    problem: Problem, times: Array, motion: JointMotion, lam: Array | None, p: Array = NONE
) -> Loads:
    """Return the loads at times (T,) with the multipliers lam (T, m) of all rows, and parameters p (T, n)."""
    samples = ReactionSamples(problem, len(times))
    return Loads(samples, times, samples(times, motion.q, motion.qd, motion.qdd, lam, p))


def figures(
    times: Array, data: Mapping[str, Array], names: Mapping[str, tuple[str, ...]], breaks: Breaks = ()
) -> dict[str, PeakLoad]:
    """Return the largest force and moment of each joint and closure [N, N m] along samples at times (T,).

    breaks : where loads jump, in steps from the first sample.
    """
    return figures_of_runs(times, [data], names, breaks)[0]


def figures_of_runs(
    times: Array,
    runs: Sequence[Mapping[str, Array]],
    names: Mapping[str, tuple[str, ...]],
    breaks: Breaks = (),
) -> list[dict[str, PeakLoad]]:
    """Return the same of the loads in several runs, which is found for all of them at once."""
    sizes = [
        magnitude(x, names[path], letter) for data in runs for path, x in data.items() for letter in "fm"
    ]
    peak = largest(times, np.column_stack(sizes) if sizes else np.zeros((len(times), 0)), breaks)
    peaks = iter(np.column_stack([peak.value.reshape(-1, 2), peak.error.reshape(-1, 2)]).tolist())
    return [{path.split("/")[-1]: PeakLoad(*next(peaks)) for path in data} for data in runs]


def _turned(axes: Matrix, wrench: Wrench) -> list[Scalar]:
    turned = wrench.rotated(axes)
    return [*turned.f, *turned.n]
