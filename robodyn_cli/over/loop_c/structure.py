"""A scene's motion as C: which keys vary, its code, and what runs and rules need."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.errors import CapabilityError
from robodyn_cli.kernels.as_c.writer import write_c99
from robodyn_cli.kernels.compiler import Target
from robodyn_cli.over.live.structure import LiveKey, LiveStructure
from robodyn_cli.over.many.keys import NUMBER, START, Key, value_of
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.scene.load import Family
from robodyn_cli.spatial.algebra import Array

C99 = Target("", "", "", lanes=1, fused=False)


class CStructure(LiveStructure):
    """The motion of a scene with keys that C can set; a key without a range takes what the scene allows."""

    where = "leave as C"
    in_page = False

    @staticmethod
    def _live_key(mechanism: Mechanism, key: Key, ends: tuple[float, float]) -> LiveKey:
        low, high = ends
        if key.scale != 1.0:
            raise CapabilityError(
                f"--key {key.name}: it has a unit or a sign in the scene; allowed: the key without '#'"
            )
        value = value_of(mechanism.family, key.name)
        if value is None:
            raise CapabilityError(f"--key {key.name}: it has no value in the scene; give it one by --set")
        if not low <= value <= high:
            raise CapabilityError(
                f"--key {key.name}: the scene's own value {value:.6g} lies outside {low:.6g}:{high:.6g}"
            )
        return LiveKey(key, value, low, high)

    def _corners(self) -> list[Array]:
        """Return rows of values at the ends of the ranges that there are."""
        rows = []
        for k, key in enumerate(self.keys):
            if math.isfinite(key.low) and math.isfinite(key.high):
                for x in (key.low, key.high):
                    row = self.row.copy()
                    row[k] = x
                    rows.append(row)
        return rows

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
) -> tuple[CStructure, list[str]]:
    """Return the motion of a scene with the keys that are asked for; without any, with those of ``cheap`` that can
    vary, and the given starts. The second are the keys that are left out.

    Raises
    ------
    CapabilityError, SceneError : what cannot leave, by name.
    """
    if asked:
        return CStructure(family, asked), []
    scene, free = family.own, (-math.inf, math.inf)
    starts = {f"initial.{g}.{name}": free for g in ("q", "qd") for name in getattr(scene.initial, g)}
    wanted = {**cheap, **starts}
    sorts = {key.name: key.sort for key in Mechanism(family, list(wanted)).keys}
    able = {name: ends for name, ends in wanted.items() if sorts[name] in (NUMBER, START)}
    for keys in (able, {name: ends for name, ends in able.items() if name in starts}, {}):
        try:
            made = CStructure(family, keys)
            made.texts(C99)
        except CapabilityError:
            if not keys:
                raise
        else:
            return made, [name for name in wanted if name not in keys]
    raise AssertionError("the loop ends before")
