"""The moments of a run that matter: lock, impacts, sticking and slipping, overload. For drawings, movies and lists."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.results.result import Result

# what happens, in words, by the kind of the event; the name is that of the joint, part or loop
WORDS = {
    "impact": "{name} hits its stop",
    "contact": "{name} comes to rest on its stop",
    "release": "{name} leaves its stop",
    "stick": "{name} sticks",
    "slip": "{name} slips",
    "grip": "{name} is gripped",
    "let_go": "{name} is released",
    "overload": "{name} is overloaded",
    "bifurcation": "bifurcation",
    "limit": "{name}",
    "latched": "latch {name} closes",
    "opened": "latch {name} opens",
}
LATCH = "latch closes"
ROOM = 16  # characters that one more time and the end of a line take
# those that end or change a run as a whole, and are told with their time
DECISIVE = ("lock", "overload", "bifurcation", "limit")
# those after which nothing is as before, and which every summary tells
LASTING = ("lock", "latch", "latched", "overload")


@record
class Moment:
    """A moment of a run: time [s], kind of event, and what happens in words."""

    time: float
    kind: str
    text: str


def lock(result: Result) -> dict[str, Any]:
    """Return what the run reported about its lock; empty if it did not lock."""
    facts = result.summary.get("lock")
    return facts if isinstance(facts, dict) else {}


def lock_time(result: Result) -> float | None:
    """Return the time of the lock in seconds, or None."""
    time = lock(result).get("time")
    return float(time) if isinstance(time, int | float) and math.isfinite(time) else None


def moment_lines(result: Result, width: int = 80) -> list[str]:
    """Return what happened how often and when, a line each, in the order in which it happened first.

    What the summary of a command tells anyway is left out: locks and overloads.
    """
    times: dict[str, list[float]] = {}
    for moment in moments(result):
        if moment.kind not in LASTING:
            times.setdefault(moment.text, []).append(moment.time)
    lines: list[str] = []
    for text, when in times.items():
        often = f", {len(when)} times" if len(when) > 1 else ""
        line, told = f"  {'' if lines else 'moments':<19}{text}{often}: {when[0]:.6g}", 1
        while told < len(when) and len(line) + ROOM <= width:
            line, told = f"{line}, {when[told]:.6g}", told + 1
        lines.append(line + (" ... s" if told < len(when) else " s"))
    return lines


def moments(result: Result) -> list[Moment]:
    """Return the moments of a run in the order of time; those at which multipliers pass a multiple of their median are
    left out, for the drawing of the multipliers shows them."""
    return sorted([*_events(result.events), *_lock(result)], key=lambda moment: moment.time)


def _events(events: Sequence[Mapping[str, Any]]) -> list[Moment]:
    marks = []
    for event in events:
        time, kind = event.get("time"), str(event.get("kind"))
        if kind in WORDS and isinstance(time, int | float) and math.isfinite(time):
            marks.append(Moment(float(time), kind, WORDS[kind].format(name=event.get("name", ""))))
    return marks


def _lock(result: Result) -> list[Moment]:
    time = lock_time(result)
    if time is None:
        return []
    facts = lock(result)
    marks = [Moment(time, "lock", str(facts.get("kind") or "lock").replace("_", " "))]
    if isinstance(facts.get("latch"), dict):
        marks.append(Moment(time, "latch", LATCH))
    return marks
