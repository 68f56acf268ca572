"""Payloads along a given motion: the torques jump where they are gripped and released."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from robodyn_cli.model.parts import SAME_TIME
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.torques.program import Sampled

KINDS = {"from": "grip", "until": "let_go"}  # of events, by key
STILL = 1e-12  # part of the largest kinetic energy that an impact may take without being told


def refuse_events(scene: Scene) -> None:
    """Refuse payloads whose times are those of events: the motion is given, and so are its times.

    Raises
    ------
    SceneError
    """
    for k, payload in enumerate(scene.payloads):
        for name, instant in payload.instants.items():
            if instant.when is not None:
                where = f"payloads.{k}.{name}.when"
                raise SceneError(
                    "the motion is given in 'inverse'; allowed there: 'time'", (scene.path, where),
                    file=scene.path, key=where,
                )  # fmt: skip


def impact_warnings(problem: Problem, sampled: Sampled) -> list[str]:
    """Return a warning for each payload that is gripped in motion, which takes impulses beside the torques."""
    energies: Array = sampled.arrays["payloads"]
    largest = float(sampled.arrays["energy/kinetic"].max(initial=0.0))
    texts = []
    for k, payload in enumerate(problem.model.payloads):
        if payload.spec.start is None or payload.spec.start.time > sampled.times[-1]:
            continue
        energy = float(np.interp(payload.spec.start.time, sampled.times, energies[:, k]))
        if energy > STILL * largest:
            texts.append(
                f"payload {payload.name!r} is gripped at t = {payload.spec.start.time:g} s in motion: {energy:.3g} J "
                "of motion against what holds it end at once, by impulses of the actuators that the torques do not show"
            )
    return texts


def events_of(scene: Scene, times: Array) -> list[dict[str, Any]]:
    """Return when payloads are gripped and released, as events of the result."""
    events = [
        {"time": float(instant.time), "name": payload.name, "kind": KINDS[name]}
        for payload in scene.payloads
        for name, instant in payload.instants.items()
        if instant.time is not None and instant.time <= times[-1]
    ]
    return sorted(events, key=lambda event: event["time"])


def breaks(events: Iterable[Any], times: Array) -> list[float]:
    """Return where torques jump among times (T,) by events at which payloads come and go, in steps from the first; a
    sample at the time of a change is that of before."""
    places = []
    for event in events:
        if event["kind"] not in KINDS.values():
            continue
        after = int(np.searchsorted(times, (1.0 + SAME_TIME) * event["time"], side="right"))
        if 0 < after < len(times):
            place = np.interp(event["time"], times, np.arange(float(len(times))))
            places.append(float(np.clip(place, after - 1, np.nextafter(after, 0.0))))
    return places
