"""The plane in which all bodies of a model move, where there is one: from the joints' motion subspaces."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from robodyn_cli.algorithms.kinematics import poses, slice_q, transforms
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import BASE, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

PARALLEL = 1e-12


@record
class Directions:
    """The motions that a joint allows: unit vectors of the axes it turns about and slides along, in base
    coordinates."""

    name: str
    turning: tuple[Array, ...]
    sliding: tuple[Array, ...]

    def lies_in(self, normal: Array) -> bool:
        """Tell whether the joint moves its body in the planes across ``normal`` only."""
        parallel = all(np.linalg.norm(np.cross(normal, d)) < PARALLEL for d in self.turning)
        return parallel and all(abs(float(normal @ d)) < PARALLEL for d in self.sliding)


class Plane:
    """Whether and why all bodies of a model move in one plane; coordinates of the base.

    ``normal`` : (3,), None where the motion is spatial.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.gravity: Array = np.array(model.gravity, dtype=float)

    @cached_property
    def _pose(self) -> tuple[list[Array], list[Directions]]:
        """Axes of the bodies (columns) and directions of the joints, in a pose in which nothing is aligned by
        chance."""
        manifold = Manifold(self.model)
        steps = 0.37 + 0.61 * np.arange(self.model.nv, dtype=np.float64)
        q = manifold.integrate(manifold.neutral(), steps).tolist()
        pose = poses(self.model, transforms(self.model, q))
        frames = [np.array(pose[k].R, dtype=float) for k in range(len(self.model.bodies))]
        directions = []
        for body, R in zip(self.model.bodies, frames):
            S = np.array(body.joint.S(slice_q(body, q)), dtype=float)
            directions.append(Directions(body.joint_name, _units(R @ S[:3]), _units(R @ S[3:])))
        return frames, directions

    @property
    def _turning(self) -> list[Array]:
        return [d for joint in self._pose[1] for d in joint.turning]

    @property
    def _sliding(self) -> list[Array]:
        return [d for joint in self._pose[1] for d in joint.sliding]

    @property
    def turns(self) -> bool:
        """Whether any joint turns its body."""
        return bool(self._turning)

    @cached_property
    def _candidate(self) -> Array:
        """The only possible normal; where bodies only slide along a line, gravity decides."""
        if self._turning:
            return self._turning[0]
        across = (np.cross(self._sliding[0], d) for d in (*self._sliding, self.gravity, *np.eye(3)))
        return next(n / np.linalg.norm(n) for n in across if np.linalg.norm(n) > PARALLEL)

    @cached_property
    def normal(self) -> Array | None:
        return self._candidate if all(joint.lies_in(self._candidate) for joint in self._pose[1]) else None

    def normal_in(self, body: int) -> Array:
        """Return the normal in the axes of a body (or the base); zero where the motion is spatial."""
        if self.normal is None:
            return np.zeros(3)
        n = self.normal if body == BASE else self._pose[0][body].T @ self.normal
        return np.round(n, 12)

    def reason(self) -> str:
        """Say why the motion is planar, or which joint takes it out of the plane."""
        if self.normal is None:
            return self._spatial_reason()
        return self._planar_reason() + self._load_across(self.normal)

    def _planar_reason(self) -> str:
        axis = direction(self._candidate).lstrip("-")
        count = len(self._turning)
        if not count:
            return f"no joint turns, and all sliding axes lie across {axis} of the base"
        if count == 1 and not self._sliding:
            return f"the only joint turns about {axis} of the base: its body moves in one plane"
        turning = (
            "all turning axes"
            if self._sliding
            else "both joint axes"
            if count == 2
            else f"all {count} joint axes"
        )
        across = " and all sliding ones across it" if self._sliding else ""
        return f"{turning} are parallel to {axis} of the base{across}: every body moves in one plane"

    def _load_across(self, normal: Array) -> str:
        size = float(np.linalg.norm(self.gravity))
        if size == 0.0:
            return ""
        across = float(self.gravity @ normal)
        if abs(across) < PARALLEL * size:
            return ", and gravity lies in it"
        if np.linalg.norm(self.gravity - across * normal) < PARALLEL * size:
            return "; gravity along the axes loads the bearings, not the joints"
        return f"; of gravity, {abs(across):.3g} m/s^2 along the axes loads the bearings only"

    def _spatial_reason(self) -> str:
        n = self._candidate
        joint = next(joint for joint in self._pose[1] if not joint.lies_in(n))
        if not self._turning:
            return "no joint turns, the sliding axes span space"
        if len(joint.turning) > 1:
            return f"joint {joint.name} turns about {len(joint.turning)} axes"
        first = next(j.name for j in self._pose[1] if j.turning)
        if joint.name == first:
            return f"joint {joint.name} also slides along the axis that it turns about"
        axis = (*joint.turning, *joint.sliding)[0]
        angle = np.degrees(np.arccos(min(1.0, abs(float(axis @ n)))))
        if joint.turning:
            return f"the axis of {joint.name} is at {angle:.4g} deg to that of {first}"
        return f"joint {joint.name} slides at {90.0 - angle:.4g} deg to the plane across the axis of {first}"


def _units(columns: Array) -> tuple[Array, ...]:
    """Return the columns that are not zero, each of length 1."""
    return tuple(d / np.linalg.norm(d) for d in columns.T if np.linalg.norm(d) > PARALLEL)


def direction(d: Array) -> str:
    """Return a direction as the name of a coordinate axis, or by its components."""
    for k, name in enumerate("xyz"):
        if abs(abs(d[k]) - 1.0) < 1e-9:
            return name if d[k] > 0 else f"-{name}"
    return f"({d[0]:.3g}, {d[1]:.3g}, {d[2]:.3g})"
