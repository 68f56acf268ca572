"""A scene's motion as C: which keys vary, its code, and what runs and rules need."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from robodyn_cli.errors import CapabilityError, RobodynError, of_option
from robodyn_cli.expr.fixed import places
from robodyn_cli.kernels.as_c.writer import write_c99
from robodyn_cli.kernels.compiler import Target
from robodyn_cli.over.live.keys import SORTS, cannot, ends_of, entries_of
from robodyn_cli.over.live.structure import LiveStructure
from robodyn_cli.over.many.keys import NUMBER, understand
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.read_joints import QUATERNION
from robodyn_cli.spatial.algebra import Array

BESIDE = 1e-3  # relative
IDLE = "nothing in the simulation depends on it as a number"
C99 = Target("", "", "", lanes=1, fused=False)


class CStructure(LiveStructure):
    """The motion of a scene with keys that C can set; a key without a range takes what the scene allows."""

    where = "leave as C"
    in_page = False

    def __init__(self, family: Family, ranges: Mapping[str, tuple[float, float]]) -> None:
        self.stays: list[
            int
        ] = []  # keys at whose values equations are others, that all the same are no structure
        super().__init__(family, ranges)
        depends = places(entries_of(self.tables))
        idle = [k.key.name for k in self.keys if k.key.sort == NUMBER and k.key.place not in depends]
        if idle:
            asked = f"{self._option(idle[0])} {idle[0]}"
            raise of_option(asked, IDLE, CapabilityError, keys=idle)

    @property
    def is_led(self) -> bool:
        """Whether the motion that a controller follows is set on the way."""
        return False

    def _option(self, name: str) -> str:
        return "--key"

    def _corners(self) -> list[Array]:
        """Return rows of values at the ends of the ranges that there are."""
        rows = []
        for k, key in enumerate(self.keys):
            if math.isfinite(key.low) and math.isfinite(key.high):
                for x in ends_of(key):
                    row = self.row.copy()
                    row[k] = x
                    rows.append(row)
        return [*rows, *self._beside()]

    def _beside(self) -> list[Array]:
        """Return a row beside that of the scene where a controller acts: its numbers may follow in Python."""
        if self.family.own.control is None or not self.keys:
            return []
        moved = self.row + BESIDE * np.maximum(np.abs(self.row), 1.0) * (
            1.0 + np.arange(len(self.keys)) / 7.0
        )
        inside = [key.key.sort == NUMBER and key.low <= x <= key.high for key, x in zip(self.keys, moved)]
        inside = [x and k not in self.stays for k, x in enumerate(inside)]
        return [np.where(inside, moved, self.row)]

    def _picture(self) -> dict[str, list[Any]]:
        return {}  # C draws nothing

    def code(self, equations: Sequence[str]) -> str:
        """Return the C of the loop and of some of the equations."""
        exports = ["many", "numbers", "run_to_event", *equations]
        trial = "trial_step" if self.system.events else ""
        calls = {"run": "run_to_event", "trial": trial, "close": ""}  # by address
        return write_c99(self.texts(C99), [*exports, trial], calls)


def structure_of(
    family: Family, asked: Mapping[str, tuple[float, float]], cheap: Mapping[str, tuple[float, float]]
) -> tuple[CStructure, dict[str, str]]:
    """Return the motion of a scene with the keys that are asked for; without any, with those of ``cheap`` that can
    vary, and the given starts. The second are the keys that are left out, with the reason.

    Raises
    ------
    CapabilityError, SceneError : what cannot leave, by name.
    """
    if asked:
        return CStructure(family, asked), {}
    return with_able_keys(family, cheap, lambda keys: CStructure(family, keys))


Made = TypeVar("Made", bound=CStructure)


def with_able_keys(
    family: Family,
    cheap: Mapping[str, tuple[float, float]],
    build: Callable[[Mapping[str, tuple[float, float]]], Made],
) -> tuple[Made, dict[str, str]]:
    """Return the motion with those of ``cheap`` and of the given starts that can be keys; the others with the reason.

    Errors name the keys that they are about, all of one kind at once; what stands in the way otherwise is found by
    halves: such keys are few.

    Raises
    ------
    CapabilityError, SceneError : the motion cannot leave without any key, either.
    """
    keys: dict[str, tuple[float, float]] = {}
    where = build({}).where  # a motion that cannot leave says so before its many keys are tried
    able, left = _candidates(family, cheap)
    found: list[Made] = []

    def tried(more: Mapping[str, tuple[float, float]]) -> None:
        made = build({**keys, **more})
        made.texts(C99)
        keys.update(more)
        found[:] = [made]

    def add(names: Sequence[str]) -> None:
        try:
            tried({name: able[name] for name in names})
        except RobodynError as error:
            if behind := [name for name in names if name in error.details.get("keys", ())]:
                left.update(dict.fromkeys(behind, error.sentence))
                rest = [name for name in names if name not in behind]
                if rest or not found:
                    add(rest)
                return
            if not found:
                tried({})
            if len(names) == 1:
                left[names[0]] = error.beyond(*cannot(where))
            else:
                add(names[: len(names) // 2])
                add(names[len(names) // 2 :])

    if able:
        add(list(able))
    else:
        tried({})
    return found[0], left


def _candidates(
    family: Family, cheap: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, tuple[float, float]], dict[str, str]]:
    """Return the keys that may be such by default with their ranges, and the others with the reason."""
    scene, free = family.own, (-math.inf, math.inf)
    starts = {f"initial.{g}.{name}": free for g in ("q", "qd") for name in getattr(scene.initial, g)}
    # of the parameters of torques, which functions are given, only the motion knows
    parameters = {f"parameters.{name}": free for name in scene.parameters}
    able, left = {}, {}
    for name, ends in {**parameters, **cheap, **starts}.items():
        joint, _, part = name.removeprefix("initial.q.").rpartition(".")
        if name in starts and joint and part in QUATERNION:
            left[name] = "an attitude starts where the scene says, its parts are no numbers of their own"
            continue
        try:
            sort = understand(family, name).sort
        except RobodynError as error:
            own = "the scene has no number of its own for this start"
            left[name] = own if name in starts else error.message
            continue
        if sort in SORTS:
            left[name] = f"it {SORTS[sort]}"
        else:
            able[name] = ends
    return able, left


def left_out(left: Mapping[str, str]) -> list[str]:
    """Return what to say of keys that are left out: those with one reason together."""
    together: dict[str, list[str]] = {}
    for name, why in left.items():
        together.setdefault(why, []).append(name)
    return [f"not a key of the loop: {', '.join(names)}: {why}" for why, names in together.items()]
