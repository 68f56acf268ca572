"""Several latches and flying payloads in words: what each did in a run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from robodyn_cli.cli.words import stated
from robodyn_cli.summaries.facts import IMPULSE, LOAD

TOLD = ("time", "energy_lost", "peak_moment", "angular_impulse", "opened")  # of a latch


def latch_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return lines about several latches: what each did, in the order in which they closed, and which stay open."""
    lines = []
    for name, own in sorted(
        summary.get("locks", {}).items(), key=lambda item: float(item[1].get("time", -math.inf))
    ):
        told = {key: stated(own[key], own.get("errors", {}).get(key)) for key in TOLD if key in own}
        parts = [f"closes at t = {told['time']} s" if "time" in own else "closed from the start on"]
        if "energy_lost" in own:
            parts.append(f"energy lost {told['energy_lost']} J")
        if "peak_moment" in own:
            parts.append(f"loaded by up to {told['peak_moment']} {LOAD(own['unit'])}")
        elif "angular_impulse" in own:
            parts.append(f"impulse {told['angular_impulse']} {IMPULSE(own['unit'])}")
        if own["redundant"]:
            parts.append("redundant")
        if "opened" in own:
            parts.append(f"open again from t = {told['opened']} s on")
        lines.append(f"  {name:<18} {', '.join(parts)}")
    return lines + open_lines(summary)


def open_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return lines about the latches that stay open."""
    lines = []
    for name, own in summary.get("missed", {}).items():
        errors = own.get("errors", {})
        near = f"{stated(own['nearest'], errors.get('nearest'))} {own['unit']}".rstrip()
        when = stated(own["time"], errors.get("time"))
        told = "" if own["time"] is None else f", nearest at t = {when} s: {near} off"
        lines.append(f"  {name:<18} open{told}")
    return lines


def payload_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return lines about what was released and came down: how far it flew, and how high."""
    return [
        f"  {name:<18} comes down at t = {_within(own['landing'], 'time')} s: range "
        f"{_within(own['landing'], 'range')} m, up to {_within(own['landing'], 'highest')} m above the plane, "
        f"released with {_within(own['release'], 'energy')} J"
        for name, own in summary.get("payloads", {}).items()
        if "landing" in own
    ]


def _within(facts: Mapping[str, Any], key: str) -> str:
    """Return a figure with the error that stands beside it, where one is known."""
    return stated(facts[key], facts.get(f"{key}_error"))
