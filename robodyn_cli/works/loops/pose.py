"""The pose that a controller is to keep: that of its regulator, the end of its reference, or else the start."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.given.along import motion_along
from robodyn_cli.ready.doors import along, at_rest
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.trajectories.led import Followed


@record
class Aim:
    """A scene that begins at rest where its controller is to keep it, at a time [s]; what that pose is, in words."""

    scene: Scene
    time: float
    words: str


def aim_of(scene: Scene) -> Aim:
    """Return where a controller, made ready, is to keep its mechanism.

    Raises
    ------
    RobodynError : no motion of the joints follows the path of a point.
    """
    controller = scene.control
    motion: Any = controller.reference
    if controller.type == "lqr":
        return Aim(resting(scene, controller.pose), 0.0, "the pose of the regulator")
    if motion is None:
        return Aim(resting(scene, {}), 0.0, "the start, which the controller holds")
    if controller.at_point:
        motion = motion_along(Problem(along(dataclasses.replace(scene, control=None, trajectory=motion))))
    problem = Problem(at_rest(scene))
    given = Followed(motion, motion.duration).expressions({**problem.environment, "t": problem.t})
    names = [name for name in problem.model.q_names if name in given]
    known = {"t": [float(motion.duration)], "q": [0.0] * len(problem.model.q_names)}
    values = evaluate([given[name] for name in names], known)
    ends = {name: float(x) for name, x in zip(names, values)}
    return Aim(resting(scene, ends), float(motion.duration), "the end of the reference")


def resting(scene: Scene, positions: Mapping[str, float]) -> Scene:
    """Return a scene that begins at rest, some joints at given positions; in loops the driven ones keep theirs."""
    initial = dataclasses.replace(scene.initial, q={**scene.initial.q, **positions}, qd={})
    if scene.loops or scene.couplers:
        driven = [name for name in scene.control.joints if name in initial.q]
        initial = dataclasses.replace(initial, hold=tuple(dict.fromkeys([*initial.hold, *driven])))
    return dataclasses.replace(scene, initial=initial)


def holding(scene: Scene, q: Mapping[str, float]) -> Scene:
    """Return the scene whose controller holds a pose, given by all positions, in place of the motion of joints that it
    follows."""
    own = scene.control
    if not own.at_point and own.reference is not None:
        own = dataclasses.replace(own, reference=None)
    initial = dataclasses.replace(scene.initial, q=dict(q), qd={})
    return dataclasses.replace(scene, control=own, initial=initial)
