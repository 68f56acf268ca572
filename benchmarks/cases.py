"""The cases that engines are compared on: numbers, start, reference, and what their error is.

Nothing here imports an engine, robodyn included, before it is asked to.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import arms
import numpy as np
from lock_time import LOCK

HERE = Path(__file__).parent
CONFIGS = HERE.parent / "configs"


@dataclasses.dataclass
class Entry:
    """One engine with one setting.

    run : what is timed; returns (what the error is taken of, steps). path : where the error is that along the
    whole run, a further call that returns times and states (times, 2 n), in what order it likes.
    """

    engine: str
    setting: str
    run: Callable[[], Any]
    path: Callable[[], Any] | None = None


class Wanted:
    """The one setting that is asked for, or all: engines need not build what is not wanted."""

    setting: str | None = None

    @classmethod
    def of(cls, settings: Iterable[Any], write: Callable[[Any], str]) -> list[Any]:
        """Return those settings whose text is wanted."""
        return [x for x in settings if cls.setting in (None, write(x))]


@lru_cache(maxsize=1)
def references() -> dict[str, Any]:
    found: dict[str, Any] = json.loads((HERE / "reference.json").read_text(encoding="utf-8"))
    return found


@dataclasses.dataclass(frozen=True)
class Chain:
    """An arm that swings freely, with springs [N m/rad] and dampers [N m s/rad] in its joints.

    whole : whether the error is the largest of any angle along the run (otherwise: of angles and rates at its end).
    """

    key: str
    title: str
    arm: arms.Arm
    start: tuple[float, ...]
    duration: float
    stiffness: tuple[float, ...] = ()
    damping: tuple[float, ...] = ()
    whole: bool = False

    @property
    def n(self) -> int:
        return self.arm.n

    @property
    def stiff(self) -> bool:
        return any(self.stiffness)

    @cached_property
    def k(self) -> np.ndarray:
        return np.array(self.stiffness or [0.0] * self.n)

    @cached_property
    def c(self) -> np.ndarray:
        return np.array(self.damping or [0.0] * self.n)

    @cached_property
    def y0(self) -> np.ndarray:
        return np.array([*self.start, *([0.0] * self.n)])

    @property
    def times(self) -> np.ndarray:
        """When an engine is judged where the error is that along the run."""
        return np.array(references()["times"])

    @property
    def reference(self) -> np.ndarray:
        """States at ``times``, or at the end alone."""
        return np.array(references()[self.key]["states"])

    def error(self, entry: Entry, result: Any) -> float:
        if entry.path is None or not self.whole:
            return float(np.abs(np.asarray(result) - self.reference[-1]).max())
        times, states = entry.path()
        right = self.reference
        worst, reached = 0.0, 0
        for t, y in zip(times, np.asarray(states)):
            near = np.flatnonzero(np.abs(self.times - t) < 1e-9 * max(1.0, t))
            if len(near):
                reached += 1
                worst = max(worst, float(np.abs(y[: self.n] - right[near[0], : self.n]).max()))
                if not np.all(np.isfinite(y)):
                    return float("nan")
        return worst if reached else float("nan")

    def scene_text(self) -> str:
        """Return the case as a scene of robodyn."""
        lines = []
        joint = 0
        for line in arms.scene_text(self.arm).splitlines():
            if "type: revolute" in line:
                more = ""
                if self.k[joint]:
                    more += f", spring: {{stiffness: {float(self.k[joint])!r}}}"
                if self.c[joint]:
                    more += f", damper: {{damping: {float(self.c[joint])!r}}}"
                line, joint = line.rstrip("}") + more + "}", joint + 1
            lines.append(line)
        start = ", ".join(f"q{k + 1}: {float(x)!r}" for k, x in enumerate(self.start))
        lines += [
            "command: simulate",
            f"initial: {{q: {{{start}}}}}",
            f"simulate: {{duration: {self.duration}}}",
        ]
        return "\n".join(lines) + "\n"


@dataclasses.dataclass(frozen=True)
class FourBar:
    """The lecture's four-bar from its start to the lock; the error is that of the time of the lock."""

    key: str = "four_bar"
    title: str = "four-bar from start to lock"
    whole: bool = False
    stiff: bool = False
    lengths: tuple[float, ...] = (1.241, 1.241, 1.2, 1.2)  # ground, crank, coupler, follower
    mass: tuple[float, ...] = (20.15, 8.25, 8.25)
    com: tuple[float, ...] = (1.2, 0.6, 0.6)
    inertia: tuple[float, ...] = (9.6, 0.06, 0.06)
    first: float = 0.01
    torque: tuple[float, float] = (1.96, 0.1)  # preload [N m], stiffness [N m/rad]

    @cached_property
    def angles(self) -> np.ndarray:
        """Directions of crank, coupler and follower at the start, the loop closed."""
        l0, l1, l2, _ = self.lengths
        end = l1 * np.array([np.cos(self.first), np.sin(self.first)])
        across = np.array([l0, 0.0]) - end
        r = float(np.hypot(*across))
        pin = end + across / 2 + np.sqrt(l2**2 - r**2 / 4) * np.array([-across[1], across[0]]) / r
        coupler = float(np.arctan2(*(pin - end)[::-1]))
        return np.array([self.first, coupler, float(np.arctan2(pin[1], pin[0] - l0))])

    def error(self, entry: Entry, result: Any) -> float:
        return abs(float(result) - LOCK)


# the lecture's arm in four variants: ratio of the second mass and inertia, spring [N m/rad] on joint 2,
# damper [N m s/rad] on both joints
VARIANTS = {
    "plain": (1.0, 0.0, 0.0),
    "stiff": (1.0, 1e6, 1e4),
    "light": (1e-6, 1e6, 1e4),
    "heavy": (1e6, 0.0, 0.0),
}
START = (-0.5, 0.25)  # angles in units of pi


def pendulum(key: str) -> Chain:
    ratio, spring, damper = VARIANTS[key]
    arm = arms.planar_2r()
    scale = np.array([1.0, ratio])
    arm = dataclasses.replace(arm, mass=arm.mass * scale, inertia=arm.inertia * scale[:, None, None])
    titles = {
        "plain": "double pendulum, 10 s",
        "stiff": "stiff double pendulum, 10 s",
        "light": "stiff double pendulum, second mass 1e-6, 10 s",
        "heavy": "double pendulum, second mass 1e6, 10 s",
    }
    return Chain(
        key,
        titles[key],
        arm,
        tuple(np.pi * x for x in START),
        10.0,
        (0.0, spring),
        (damper, damper),
        spring > 0.0,
    )


ARM_START = (0.3, 0.5, -0.4, -1.2, 0.6, 0.9, -0.2)
ARM_DURATION = 2.0


def arm() -> Chain:
    title = f"7-joint arm swinging freely, {ARM_DURATION:g} s"
    return Chain("arm", title, arms.seven_joint_arm(), ARM_START, ARM_DURATION)


CASES: dict[str, Callable[[], Any]] = {
    **{key: lambda key=key: pendulum(key) for key in ("plain", "stiff", "light", "heavy")},
    "four_bar": FourBar,
    "arm": arm,
}
