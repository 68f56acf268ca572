"""Facts of a scene that decide what its equations need, and how to say them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.kinematics import poses, transforms
from robodyn_cli.expr.graph import Scalar, free_symbols, is_nonzero
from robodyn_cli.model.build import build_model
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import BASE, PARAMETER_GROUP, UNKNOWN_GROUP, Body, Model
from robodyn_cli.record import record
from robodyn_cli.scene import types as sc

Array = NDArray[np.float64]
PARALLEL = 1e-12
SHOWN = 6  # names in a list before it is cut short
TENSOR = ("xx", "yy", "zz", "xy", "xz", "yz")


def listed(names: Iterable[str]) -> str:
    """Return names as a phrase; long lists are cut short."""
    names = list(dict.fromkeys(names))
    if len(names) > SHOWN:
        return f"{', '.join(names[: SHOWN - 1])} and {len(names) - SHOWN + 1} more"
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def listed_data(names: Iterable[str]) -> str:
    """Return names such as ``inertia.xx of link2`` as a phrase, links with the same data together."""
    of_link: dict[str, list[str]] = {}
    for name in names:
        what, _, link = name.partition(" of ")
        of_link.setdefault(link, []).append(what)
    same: dict[tuple[str, ...], list[str]] = {}
    for link, whats in of_link.items():
        same.setdefault(tuple(whats), []).append(link)
    return "; ".join(f"{', '.join(short_data(whats))} of {listed(links)}" for whats, links in same.items())


def short_data(whats: Sequence[str]) -> list[str]:
    """Return ``inertia.xx, yy`` for ``inertia.xx``, ``inertia.yy``."""
    tensor = [w.partition(".")[2] for w in whats if w.startswith("inertia.")]
    found = [w for w in whats if not w.startswith("inertia.")]
    return [*found, f"inertia.{tensor[0]}", *tensor[1:]] if tensor else found


def plural(count: int, word: str) -> str:
    """Return ``2 joints``, ``1 joint``, ``no joint``."""
    return f"{count or 'no'} {word}{'s' if count > 1 else ''}"


def direction(d: Array) -> str:
    """Return a direction as the name of a coordinate axis, or by its components."""
    for k, name in enumerate("xyz"):
        if abs(abs(d[k]) - 1.0) < 1e-9:
            return name if d[k] > 0 else f"-{name}"
    return f"({d[0]:.3g}, {d[1]:.3g}, {d[2]:.3g})"


@record
class Facts:
    """What the geometry of a model says; everything in base coordinates."""

    model: Model

    @cached_property
    def frames(self) -> list[Array]:
        """Axes of the bodies (columns) in a pose where nothing is aligned by chance."""
        manifold = Manifold(self.model)
        q = manifold.integrate(
            manifold.neutral(), 0.37 + 0.61 * np.arange(self.model.nv, dtype=np.float64)
        ).tolist()
        pose = poses(self.model, transforms(self.model, q))
        return [np.array(pose[k].R, dtype=float) for k in range(len(self.model.bodies))]

    @cached_property
    def axes(self) -> list[Array]:
        """Directions of the joint axes in that pose."""
        return [R[:, 2] for R in self.frames]

    def normal_in(self, body: int) -> Array:
        """Return the plane's normal in the axes of a body (or the base); zero where there is no plane."""
        if self.normal is None:
            return np.zeros(3)
        n = self.normal if body == BASE else self.frames[body].T @ self.normal
        return np.round(n, 12)

    def _of(self, kind: str) -> list[int]:
        return [k for k, b in enumerate(self.model.bodies) if b.joint.type == kind]

    @cached_property
    def normal(self) -> Array | None:
        """Normal of the plane in which all bodies move, None where there is no such plane."""
        turning = self._of("revolute")
        if not turning or len(turning) + len(self._of("prismatic")) < len(self.model.bodies):
            return None
        n = self.axes[turning[0]]
        parallel = all(np.linalg.norm(np.cross(n, self.axes[k])) < PARALLEL for k in turning)
        across = all(abs(float(n @ self.axes[k])) < PARALLEL for k in self._of("prismatic"))
        return n if parallel and across else None

    @property
    def planar(self) -> bool:
        return self.normal is not None

    @property
    def gravity(self) -> Array:
        return np.array(self.model.gravity, dtype=float)

    def plane_reason(self) -> str:
        """Say why the motion is planar."""
        assert self.normal is not None
        joints = len(self._of("revolute"))
        axis = direction(self.normal).lstrip("-")
        if len(self.model.bodies) == 1:
            text = f"the only joint turns about {axis} of the base: its body moves in one plane"
        elif self._of("prismatic"):
            text = f"all turning axes are parallel to {axis} of the base and all sliding ones across it"
        else:
            all_axes = "both joint axes" if joints == 2 else f"all {joints} joint axes"
            text = f"{all_axes} are parallel to {axis} of the base: every body moves in one plane"
        g = self.gravity
        if not g.any():
            return text
        across = float(g @ self.normal)
        if abs(across) < PARALLEL * float(np.linalg.norm(g)):
            return text + ", and gravity lies in it"
        if np.linalg.norm(g - across * self.normal) < PARALLEL * float(np.linalg.norm(g)):
            return text + "; gravity along the axes loads the bearings, not the joints"
        return f"{text}; of gravity, {abs(across):.3g} m/s^2 along the axes loads the bearings only"

    def spatial_reason(self) -> str:
        """Say which joint takes the motion out of the plane."""
        turning = self._of("revolute")
        for b in self.model.bodies:
            if b.joint.type not in ("revolute", "prismatic"):
                return f"joint {b.joint_name} is {b.joint.type}"
        if not turning:
            return "no joint turns, the sliding axes span space"
        first = turning[0]
        for k, b in enumerate(self.model.bodies):
            cosine = abs(float(self.axes[first] @ self.axes[k]))
            if cosine < 1.0 - PARALLEL if b.joint.type == "revolute" else cosine > PARALLEL:
                break
        name = b.joint_name
        if b.parent < 0:
            return f"the axis of {name} lies across that of {self.model.bodies[first].joint_name}"
        angle = np.degrees(np.arccos(np.clip(float(b.X_tree.E[2, 2]), -1.0, 1.0)))
        return f"the axis of {name} is at {angle:.4g} deg to that of {self.model.bodies[b.parent].joint_name}"

    def exact_entries(self) -> tuple[int, int]:
        """Return how many entries of the rotations between bodies are exactly 0 or +-1, and of how many."""
        entries = [float(x) for b in self.model.bodies for x in b.X_tree.E.flat]
        return sum(x in (0.0, 1.0, -1.0) for x in entries), len(entries)

    def zero_levers(self) -> tuple[int, int]:
        """Return how many components of the lever arms between joints are zero, and how many there are."""
        components = [float(x) for b in self.model.bodies for x in b.X_tree.r]
        return sum(x == 0.0 for x in components), len(components)

    def gravity_text(self) -> str:
        """Say where gravity points."""
        g = self.gravity
        size = float(np.linalg.norm(g))
        return f"gravity of {size:.4g} m/s^2 points along {direction(g / size)} of the base"


def joints_with(model: Model, has: Callable[[Body], bool]) -> list[str]:
    """Return the names of the joints whose body satisfies ``has``."""
    return [b.joint_name for b in model.bodies if has(b)]


def force_joints(model: Model, has: Callable[[Any], bool]) -> list[str]:
    """Return the names of the joints that have such a force element."""
    return joints_with(model, lambda b: any(has(f.element) for f in b.forces))


def unknown_data(model: Model, outputs: Sequence[Scalar]) -> tuple[list[str], list[str]]:
    """Return what the scene does not say of its bodies: what the outputs need, and what they do not."""
    unknown = [e.value[0] for e in model.graph.nodes if e.op == "sym" and e.value[1] == UNKNOWN_GROUP]
    needed = {e.value[0] for e in free_symbols(outputs) if e.value[1] == UNKNOWN_GROUP}
    return [n for n in unknown if n in needed], [n for n in unknown if n not in needed]


def given_constants(scene: sc.Scene) -> dict[str, str]:
    """Return the paths of the links' data that are given and not zero, and what to call them."""
    found: dict[str, str] = {}
    for link in scene.robot.links:
        path = f"links.{link.name}"
        if link.mass:
            found[f"{path}.mass"] = f"mass of {link.name}"
        for k, x in enumerate(link.com or ()):
            if x:
                found[f"{path}.com.{k}"] = f"com[{k}] of {link.name}"
        for key in TENSOR:
            if getattr(link.inertia, key):
                found[f"{path}.inertia.{key}"] = f"inertia.{key} of {link.name}"
    return found


def idle_constants(scene: sc.Scene, outputs: Callable[[Model], Sequence[Scalar]]) -> list[str]:
    """Return given data without effect: made symbols, they do not occur in the finished graph."""
    names = given_constants(scene)
    model = build_model(scene, list(names))
    used = {e.value[0] for e in free_symbols(outputs(model)) if e.value[1] == PARAMETER_GROUP}
    return [text for path, text in names.items() if path not in used]


def depends_on_time(outputs: Sequence[Scalar]) -> bool:
    """Tell whether time itself is an input."""
    return any(e.value[1] == "t" for e in free_symbols(outputs))


def is_zero(entries: Iterable[Scalar]) -> bool:
    """Tell whether all entries are identically zero."""
    return not any(is_nonzero(x) for x in entries)
