"""What became of a run, in few words: what stands in the header of a result, and in the list of several."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.report.numbers import number, typeset
from robodyn_cli.results.moments import DECISIVE, moments
from robodyn_cli.results.result import Result
from robodyn_cli.results.stated_errors import meaningful_until

BAD = ("failed", "no_lock", "overload", "undersized", "missed")  # how a run ends that asks for a look
UNSTABLE = ("unstable", "saturated")
# keys of what is sized, of its verdict, and words
SIZED = (
    ("drives", "passes", "drive", "drives suffice"),
    ("motorisation", "met", "margin of motorisation", "margins of motorisation suffice"),
)
AS_USUAL = "no warnings"
MOST = 4  # decisive moments that are told


@record
class Became:
    """What is found about a run; alarming where nobody should miss it."""

    words: str
    alarming: bool = False


def verdicts(result: Result) -> list[Became]:
    """Return how a run ended, and what was found about it: nothing but ``ok`` is never all."""
    summary = result.summary
    status = result.status.replace("_", " ")
    found = [*_ends(result), *_stability(summary), *_too_small(summary)]
    until = meaningful_until(summary)
    if math.isfinite(until):
        found.append(Became(f"not meaningful after {number(until, 4)} s", True))
    refused = _estimate(summary).get("reason")
    if refused:
        found.append(Became("no error estimate", True))
    warned = summary.get("warnings")
    if isinstance(warned, Sequence) and warned:
        found.append(Became("1 warning" if len(warned) == 1 else f"{len(warned)} warnings", True))
    first = Became(status, result.status in BAD)
    return [first, *found] if found else [first, Became(AS_USUAL)]


def _ends(result: Result) -> Iterator[Became]:
    """Yield what a run is about: its lock, its overload, why it failed, how many runs of a study did."""
    summary = result.summary
    for moment in [moment for moment in moments(result) if moment.kind in DECISIVE][:MOST]:
        yield Became(
            f"{moment.text} at {number(moment.time, 6)} s", moment.kind in ("overload", "bifurcation")
        )
    share = summary.get("failed")
    if isinstance(share, Mapping) and share.get("share"):
        yield Became(f"{100.0 * share['share']:.3g} % of the runs failed", True)
    failure = summary.get("error")
    ended = summary.get("termination")
    if result.status == "failed":
        reason = failure.get("kind") if isinstance(failure, Mapping) else None
        when = ended.get("time") if isinstance(ended, Mapping) else None
        if isinstance(when, int | float) and math.isfinite(when):
            yield Became(f"ended at {number(when, 6)} s", True)
        elif reason:
            yield Became(typeset(str(reason)), True)


def _stability(summary: Mapping[str, Any]) -> Iterator[Became]:
    """Yield whether a pose, an equilibrium or a loop is stable."""
    loop = summary.get("closed_loop")
    alone = "without control" if isinstance(loop, Mapping) else ""
    for holder, words in ((summary, alone), (summary.get("equilibrium"), ""), (loop, "with the controller")):
        stability = holder.get("stability") if isinstance(holder, Mapping) else None
        if isinstance(stability, str):
            # what a controller holds may be unstable without it
            alarming = stability in UNSTABLE and not (holder is summary and alone)
            yield Became(f"{stability} {words}".strip(), alarming)


def _too_small(summary: Mapping[str, Any]) -> Iterator[Became]:
    """Yield whether drives and margins of motorisation suffice."""
    for key, mark, what, suffices in SIZED:
        every = summary.get(key)
        if isinstance(every, Mapping) and every:
            weak = [
                name for name, one in every.items() if isinstance(one, Mapping) and one.get(mark) is False
            ]
            yield Became(f"{what} too small: {', '.join(weak)}" if weak else suffices, bool(weak))


def _estimate(summary: Mapping[str, Any]) -> Mapping[str, Any]:
    estimate = summary.get("error_estimate")
    return estimate if isinstance(estimate, Mapping) else {}
