"""``robodyn deploy``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.cli.latch_words import latch_lines, open_lines, payload_lines
from robodyn_cli.cli.options import NO_ERROR_ESTIMATE, NoErrorEstimate, SceneFile, SharedOptions, Strict
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import (
    balance_lines,
    cost_lines,
    motorisation_lines,
    multiplier_lines,
    number,
    stated,
)


def describe(summary: Mapping[str, Any], verbose: bool = True, figures: Sequence[str] = ()) -> str:
    """Return the summary of a deployment."""
    lock = summary.get("lock")
    criteria = summary.get("criteria", {})
    lines = [f"{summary['title']}"]
    if "locks" in summary:
        lines += [*_latches(summary, verbose), *figures, *_after_lock(summary)]
    elif lock:
        verb, kind = (
            ("overload", "") if lock["kind"] == "overload" else ("locked", lock["kind"].replace("_", " "))
        )
        lines += [f"  {verb:<18} {kind}".rstrip(), *figures]
        angles = [f"{n} {round(x, 5) + 0.0:.5f} deg" for n, x in lock["angles_deg"].items()]
        lengths = [f"{n} {x:.6g}" for n, x in lock["angles"].items() if n not in lock["angles_deg"]]
        if verbose:
            lines.append(f"  why                {summary['termination']['reason']}")
            lines.append(f"  configuration      {', '.join([*angles, *lengths])}")
        if verbose and (m := lock["multipliers"]):
            last = "diverging" if m["diverge"] else f"{m['at_lock']:.6g} N at the last sample, finite"
            lines.append(f"  multipliers        {m['start']:.5g} N at the start, {last}")
        lines += _after_lock(summary)
    else:
        lines += [f"  no lock            within {number(summary['termination'].get('time'))} s", *figures]
    if verbose and (growth := criteria.get("growth_times", {})):
        fired = ", ".join(f"{k}x at {v:.3f} s" if v is not None else f"{k}x never" for k, v in growth.items())
        dead = criteria.get("dead_point")
        when = stated(dead, criteria["errors"].get("dead_point"))
        where = f"dead point at {when} s" if dead is not None else "no dead point"
        lines.append(f"  criteria           {where}; multipliers over their running median {fired}")
    lines += [
        *payload_lines(summary),
        *balance_lines(summary),
        *motorisation_lines(summary),
        *multiplier_lines(summary),
        *cost_lines(summary, verbose),
    ]
    return "\n".join(lines)


def _latches(summary: Mapping[str, Any], verbose: bool) -> list[str]:
    """Return lines about several latches: whether what was waited for is closed, which are open, and what each did
    where all is told or they did not lock."""
    status, termination = summary.get("status"), summary["termination"]
    verb = "locked" if status == "locked" else "no lock" if status == "no_lock" else str(status)
    end, why, lock = f"{number(termination.get('time'), 9)} s", termination["reason"], summary.get("lock")
    if status == "locked" and lock:
        later = "" if lock["time"] == termination["time"] else f"; the run ends at t = {end}"
        lines = [f"  {verb:<18} {why}{later}"]  # the time is a headline
    else:
        lines = [f"  {verb:<18} t = {end}  ({why})"]
    whole = verbose or status != "locked"
    return [*lines, *(latch_lines(summary) if whole else open_lines(summary))]


def _after_lock(summary: Mapping[str, Any]) -> list[str]:
    """Return lines about the locked structure, and loads beyond their limits."""
    lines = []
    after = summary.get("after_lock")
    if after and after.get("latch"):
        latch, errors = after["latch"], after["latch"].get("errors", {})
        moment, force = (stated(latch[key], errors.get(key)) for key in ("peak_moment", "peak_force"))
        lines.append(
            f"  locked structure   {after['degrees_of_freedom']} degrees of freedom, followed to t = "
            f"{number(after['until'])} s; load of the latch up to {moment} N m and {force} N"
        )
    over = summary.get("termination", {}).get("overload")
    if over:
        lines.append(f"  overload           {over}")
    return lines


EXAMPLES = (
    "deploy configs/four_bar_deploy.yaml",
    "deploy configs/mechanisms/solar_array.yaml --no-plots",
    "deploy configs/four_bar_deploy.yaml --set initial.q.phi1=3.1 --out outputs/other_branch",
)


def command(
    scene: SceneFile,
    shared: SharedOptions,
    strict: Strict = False,
    no_error_estimate: NoErrorEstimate = False,
) -> int:
    """Simulate a mechanism until it locks; return the exit code."""
    job = shared.job("deploy", scene, strict, NO_ERROR_ESTIMATE if no_error_estimate else ())
    return run_scene(job, shared.console, describe)
