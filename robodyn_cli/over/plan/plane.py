"""The plane in which all bodies of a model move, where there is one: from the joints' motion subspaces.

Compiled programs as the plan lists them.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from robodyn_cli.algorithms.kinematics import poses, slice_q, transforms
from robodyn_cli.expr.fixed import places
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.kernels.compiler import machine
from robodyn_cli.kernels.lower import is_inlined
from robodyn_cli.kernels.program import Program
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import BASE, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import PARALLEL, Array
from robodyn_cli.summaries.checks import Kernel


@record
class Directions:
    """The motions that a joint allows: unit vectors of the axes that it turns about and slides along, in the base."""

    name: str
    turning: tuple[Array, ...]
    sliding: tuple[Array, ...]

    def out_of(self, normal: Array) -> Array | None:
        """Return a direction of the joint that leaves the planes across ``normal``, None where there is none."""
        tilted = (d for d in self.turning if np.linalg.norm(np.cross(normal, d)) >= PARALLEL)
        lifting = (d for d in self.sliding if abs(float(normal @ d)) >= PARALLEL)
        return next(itertools.chain(tilted, lifting), None)


class Plane:
    """Whether and why all bodies of a model move in one plane; coordinates of the base.

    normal : (3,), None where the motion is spatial. turns : whether any joint turns its body.
    """

    def __init__(self, model: Model) -> None:
        self.gravity: Array = np.array(model.gravity, dtype=float)
        # a pose in which nothing is aligned by chance
        manifold = Manifold(model)
        q = manifold.integrate(manifold.neutral(), 0.37 + 0.61 * np.arange(model.nv)).tolist()
        pose = poses(model, transforms(model, q))
        self._frames = [np.array(pose[k].R, dtype=float) for k in range(len(model.bodies))]
        self._joints = []
        for body, R in zip(model.bodies, self._frames):
            S = np.array(body.joint.S(slice_q(body, q)), dtype=float)
            self._joints.append(Directions(body.joint_name, _units(R @ S[:3]), _units(R @ S[3:])))
        self._turning = [d for joint in self._joints for d in joint.turning]
        self._sliding = [d for joint in self._joints for d in joint.sliding]
        self.turns = bool(self._turning)
        self._candidate = self._only_possible_normal()
        spatial = any(joint.out_of(self._candidate) is not None for joint in self._joints)
        self.normal = None if spatial else self._candidate

    def _only_possible_normal(self) -> Array:
        """Return the normal, if there is one; where bodies only slide along a line, gravity decides."""
        if self._turning:
            return self._turning[0]
        down = self.gravity / (
            np.abs(self.gravity).max() or 1.0
        )  # squares of it may exceed what a double holds
        across = (np.cross(self._sliding[0], d) for d in (*self._sliding, down, *np.eye(3)))
        return next(n / np.linalg.norm(n) for n in across if np.linalg.norm(n) > PARALLEL)

    def normal_in(self, body: int) -> Array:
        """Return the normal in the axes of a body (or the base); zero where the motion is spatial."""
        if self.normal is None:
            return np.zeros(3)
        return np.round(self.normal if body == BASE else self._frames[body].T @ self.normal, 12)

    def reason(self) -> str:
        """Say why the motion is planar, or which joint takes it out of the plane."""
        axis = direction(self._candidate).lstrip("-")
        if self.normal is None:
            joint, d = next((j, d) for j in self._joints if (d := j.out_of(self._candidate)) is not None)
            angle = np.degrees(np.arccos(min(1.0, abs(float(d @ self._candidate)))))
            moves = "turns about" if any(d is t for t in joint.turning) else "slides along"
            others = "about which another turns" if self.turns else "across which others slide"
            return f"joint {joint.name} {moves} an axis at {angle:.4g} deg to {axis} of the base, {others}"
        turning = "the turning axis is" if len(self._turning) == 1 else "all turning axes are"
        axes = [f"{turning} parallel to"] if self._turning else []
        axes += ["all sliding axes lie across"] if self._sliding else []
        joined = " and ".join(f"{words} {axis} of the base" for words in axes)
        return f"{joined}: every body moves in one plane{self._load_across(self.normal)}"

    def _load_across(self, normal: Array) -> str:
        size, across = float(np.linalg.norm(self.gravity)), abs(float(self.gravity @ normal))
        if size == 0.0:
            return ""
        if across < PARALLEL * size:
            return ", and gravity lies in it"
        return f"; of gravity, {across:.3g} m/s^2 across the plane loads the bearings only"


def _units(columns: Array) -> tuple[Array, ...]:
    """Return the columns that are not zero, each of length 1."""
    return tuple(d / np.linalg.norm(d) for d in columns.T if np.linalg.norm(d) > PARALLEL)


def direction(d: Array) -> str:
    """Return a direction as the name of a coordinate axis, or by its components."""
    for k, name in enumerate("xyz"):
        if abs(abs(d[k]) - 1.0) < 1e-9:
            return name if d[k] > 0 else f"-{name}"
    return f"({d[0]:.3g}, {d[1]:.3g}, {d[2]:.3g})"


class Code(Protocol):
    """Straight-line code, or loops over the bodies.

    inputs, sizes : of the arrays that it reads and gives. numbers : of the scene, in its table.
    """

    @property
    def operations(self) -> int: ...
    @property
    def inputs(self) -> Mapping[str, int]: ...
    @property
    def sizes(self) -> Mapping[str, int]: ...
    @property
    def numbers(self) -> Sequence[Scalar]: ...
    @property
    def digest(self) -> str: ...


def at_samples(name: str, code: Code, compiled: bool = True, beside: int = 0) -> Kernel:
    """Return a program that runs over samples; ``beside`` : operations of what goes with it."""
    if not compiled:
        return dataclasses.replace(_kernel(name, code, 1, "blocks of samples"), engine="interpreted")
    kernel = _kernel(name, code, machine().lanes, "samples")
    return dataclasses.replace(kernel, operations=kernel.operations + beside)


def in_steps(name: str, code: Code, lanes: int = 1, lanes_hold: str = "stages") -> Kernel:
    """Return a program of the stepping loop."""
    placed = "inlined" if isinstance(code, Program) and is_inlined(code) else "function"
    kernel = _kernel(name, code, lanes, "state" if lanes == 1 else lanes_hold)
    return dataclasses.replace(kernel, placed=placed)


def _kernel(name: str, code: Code, lanes: int, hold: str) -> Kernel:
    shape, digest = "unrolled", code.digest
    if not isinstance(code, Program):
        shape, digest = "rolled", hashlib.sha256(digest.encode()).hexdigest()
    reads = dict(code.inputs), places(code.numbers)
    return Kernel(
        name, code.operations, *reads, dict(code.sizes), "compiled", shape, lanes, hold, digest[:12]
    )
