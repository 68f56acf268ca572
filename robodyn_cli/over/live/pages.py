"""What a page gets of results whose scenes run in it."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from robodyn_cli.errors import CapabilityError, RobodynError, SceneError, of_option
from robodyn_cli.kernels.wasm import WasmModule
from robodyn_cli.over.live.given import LiveInverse, given_commands
from robodyn_cli.over.live.moving import LiveKinematics, kinematic_commands
from robodyn_cli.over.live.structure import LiveStructure, motion_commands
from robodyn_cli.over.many.keys import NO_VALUE, value_of
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import Family, load_scene_text
from robodyn_cli.scene.text.overrides import AskedSetting
from robodyn_cli.scene.units import refuse_doubles

Asked = tuple[str, str, str]  # a key, and the lowest and highest value of it as they are written


class Running(Protocol):
    """A scene that runs in a page."""

    def module(self) -> WasmModule:
        """Return the code."""
        ...

    def data(self) -> dict[str, Any]:
        """Return what a page needs beside the code."""
        ...


def live_parts(results: Sequence[Result], asked: Sequence[Asked]) -> list[Mapping[str, Any] | None]:
    """Return what a page runs of each result, None of those without any of the keys.

    Raises
    ------
    CapabilityError : what cannot leave, by name. SceneError : no scene has a key, or none takes such values.
    """
    makers: dict[str, Callable[[Family, Mapping[str, tuple[float, float]]], Running]] = {
        **dict.fromkeys(motion_commands(), LiveStructure), **dict.fromkeys(given_commands(), LiveInverse),
        **dict.fromkeys(kinematic_commands(), LiveKinematics),
    }  # fmt: skip
    parts: list[Mapping[str, Any] | None] = []
    refused: dict[str, RobodynError] = {}
    served: set[str] = set()
    for result in results:
        ranges: dict[str, tuple[float, float]] = {}
        make = makers.get(result.command)
        if make is not None:
            family = Family.of(load_scene_text(result.scene_text))
            for key, low, high in asked:
                try:
                    written = _written(family, key, low), _written(family, key, high)
                except SceneError as error:
                    refused.setdefault(key, error)
                    continue
                if value_of(family, key) is None:  # a map of free names takes any key
                    refused.setdefault(key, of_option(f"--live {key}", NO_VALUE, CapabilityError))
                else:
                    refuse_doubles(family.root, [*ranges, key], "--live")
                    ranges[key] = written
        served |= set(ranges)
        parts.append(_part(make(family, ranges)) if make is not None and ranges else None)
    for key, _, _ in asked:
        if key not in served:
            raise refused.get(key) or of_option(
                f"--live {key}", f"allowed: keys of scenes of {', '.join(makers)}", CapabilityError
            )
    return parts


def _written(family: Family, key: str, text: str) -> float:
    """Return the value [SI] that a key has with what is written."""
    asked = f"--live {key}"
    value = value_of(family.with_values([AskedSetting(f"{key}={text}", asked)]), key, asked)
    if value is None:
        raise of_option(f"--live {key}", f"{text!r} is no number", CapabilityError)
    return value


def _part(live: Running) -> dict[str, Any]:
    """Return data and code of a structure."""
    made = live.module()
    code = {"imports": list(made.imports), "constants": made.constants, "text": _packed(made.code)}
    data = json.dumps(live.data(), separators=(",", ":"), allow_nan=False).encode()
    return {"code": code, "data": _packed(data), "given": not isinstance(live, LiveStructure)}


def _packed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()
