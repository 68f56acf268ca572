"""Why a pose is not reached: out of reach, a joint's limit, or a singular pose in between."""

from __future__ import annotations

import numpy as np

from robodyn_cli.given.poses.inverse_kinematics import InverseKinematics
from robodyn_cli.given.poses.limits import PositionLimits
from robodyn_cli.given.poses.targets import Poses
from robodyn_cli.spatial.algebra import Array

AT_LIMIT = 1e-6  # rad or m
PATIENCE = 1000  # steps towards the nearest pose, to which they may go slowly
SINGULAR = 1e-4  # smallest over largest singular value below which a pose is called singular


def explain_miss(solver: InverseKinematics, found: Poses, k: int) -> str:
    """Return why target k of ``found`` is not reached, as a part of a sentence."""
    target, q, error = found.targets[k], found.q[k], float(found.error[k])
    equations = solver.equations
    d = equations.data(target[None], q)
    nearer = equations.settle(equations.approach, q[None], d, PATIENCE)
    _, left = equations.reach({"q": nearer, "d": d, "p": solver.limits.numbers}, solver.tolerance, 0)
    if left[0] < error:
        q, error = nearer[0], float(left[0])
    text = f"the nearest pose found is {_distance(solver, target, q)} away"
    limits = solver.limits
    if limits.places:
        beyond = _reached_beyond(solver, target, q)
        if beyond is not None:
            return f"{text}; it is within reach only with {beyond}"
        held = _at_limits(limits, q)
        if held:
            text += f", with {held}"
    J = solver.equations.jacobian(q, target)
    moving = solver.equations.moving
    _, s, Vt = np.linalg.svd(J[:, moving])
    rank = min(len(moving) - solver.freedom, len(s))
    if rank > 0 and s[rank - 1] < SINGULAR * s[0]:
        joint = solver.model.joint_of(moving[int(np.argmax(np.abs(Vt[rank - 1])))])
        text += f", in a singular pose, in which moving joint {joint!r} does not bring it nearer"
    return text


def _distance(solver: InverseKinematics, target: Array, q: Array) -> str:
    """Return how far a target (12,) is from the frame at q, as far as it is asked for: distance and angle."""
    task = solver.task
    p, R = (x[0] for x in solver.forward(q[None]))
    wanted, places, parts = target[3:].reshape(3, 3), list(task.position), []
    if places:
        parts.append(f"{np.linalg.norm((target[:3] - p)[places]):.4g} m")
    if task.orientation == "axis":
        half_sine = 0.5 * np.linalg.norm((wanted - R) @ task.axis)
    elif task.orientation == "full":
        half_sine = np.linalg.norm(wanted - R) / np.sqrt(8.0)
    if task.orientation != "free":
        parts.append(f"{2.0 * np.arcsin(min(1.0, half_sine)):.4g} rad")
    return " and ".join(parts)


def _reached_beyond(solver: InverseKinematics, target: Array, q: Array) -> str | None:
    """Return the limits that a solution without limits passes, None where there is no solution."""
    free = solver.without_limits.solve(target[:3], target[3:].reshape(3, 3), near=q)
    if not free.reached[0]:
        return None
    at = solver.limits.unwound(free.q[0], q, solver.model)
    return "joint " + " and ".join(
        f"{name!r} at {at[place]:.6g}, beyond its limits of {low:.6g} to {high:.6g}"
        for name, place, low, high, over in _each(solver.limits, solver.limits.excess(at))
        if over > AT_LIMIT
    )


def _at_limits(limits: PositionLimits, q: Array) -> str:
    """Return the joints that stand on a limit."""
    own = q[limits.places]
    gaps = np.minimum(np.abs(own - limits.lower), np.abs(limits.upper - own))
    found = [
        f"{name!r} at {q[place]:.6g}" for name, place, _, _, gap in _each(limits, gaps) if gap < AT_LIMIT
    ]
    return f"joint {' and '.join(found)} on its limit" if found else ""


def _each(limits: PositionLimits, values: Array) -> list[tuple[str, int, float, float, float]]:
    """Return name, place in q, lower and upper limit and a value for each joint with limits."""
    numbers = (limits.lower.tolist(), limits.upper.tolist(), values.tolist())
    return list(zip(limits.names, limits.places, *numbers))
