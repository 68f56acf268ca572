"""Summaries in words, for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as aligned columns; the first row is the head, the first column is text."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:]))]
        lines.append("  " + "  ".join(cells).rstrip())
    return "\n".join(lines)


def number(x: Any, digits: int = 6) -> str:
    """Return a number for reading."""
    if x is None:
        return "-"
    return f"{x:.{digits}g}" if isinstance(x, (int, float)) else str(x)


def _error_line(summary: Mapping[str, Any]) -> list[str]:
    estimate = summary.get("error_estimate")
    lines = []
    if isinstance(estimate, Mapping) and estimate.get("state_max") is not None:
        note = ""
        if estimate.get("at_rounding"):
            note = f" (at rounding, whose floor is {estimate['rounding_floor']:.0e})"
        elif estimate.get("meaningful_until") is not None:
            note = f" (not meaningful after t = {estimate['meaningful_until']:.4g} s)"
        if estimate.get("q_max") is not None:
            lines.append(
                f"  estimated error    q {estimate['q_max']:.1e}, qd {estimate['qd_max']:.1e} at the worst sample{note}"
            )
        else:
            lines.append(f"  estimated error    {estimate['state_max']:.1e} at the worst sample{note}")
    elif isinstance(estimate, Mapping) and estimate.get("reason"):
        lines.append(f"  estimated error    none: {estimate['reason']}")
    else:
        lines.append("  estimated error    not asked for")
    if summary.get("energy_drift") is not None:
        balance = summary.get("energy_balance", "energy")
        lines.append(f"  energy drift       {summary['energy_drift']:.1e} J ({balance})")
    residual = summary.get("constraint_residual")
    if isinstance(residual, Mapping):
        # of loops, and of prescribed joints where there are no loops
        lines.append(
            f"  constraints        off by {residual['position']:.1e} m or rad, {residual['velocity']:.1e} m/s or rad/s "
            "at the worst sample"
        )
    return lines + multiplier_lines(summary)


def multiplier_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return what is said where loops, or actuators, could share the load in another way."""
    found, shared = summary.get("multipliers", {}), summary.get("mechanism", {})
    lines = []
    if shared.get("torques", "unique") != "unique":
        lines.append(f"  not unique         torques are those of {shared['torques']}")
    dependent = shared.get("multipliers", "unique") != "unique" or (
        "equilibrium" in summary and summary.get("mobility", {}).get("redundant_rows", 0) > 0
    )
    if dependent or found.get("unique") is False:
        loops = sorted({loop for group in found.get("dependent", ()) for loop in group["loops"]})
        where = f" of {', '.join(loops)}" if loops else ""
        lines.append(
            f"  not unique         rows{where} depend on each other: multipliers, and reactions that follow from them, "
            "are those of least norm"
        )
    return lines


def _cost_line(summary: Mapping[str, Any]) -> str:
    counters = summary.get("counters", {})
    times = summary.get("wall_time_s", {})
    steps = f"{counters.get('steps', 0)} steps, {counters.get('evaluations', 0)} evaluations"
    parts = ", ".join(f"{k} {1e3 * v:.3g}" for k, v in times.items() if k != "total" and v >= 5e-5)
    told = " without an error estimate" if summary.get("error_estimate", {}) is None else ""
    return f"  cost               {steps}; ms: {parts}; in all {1e3 * times.get('total', 0.0):.4g}{told}"


def describe_simulate(summary: Mapping[str, Any]) -> str:
    """Return the summary of a simulation."""
    tolerances = ", ".join(f"{k} {v:.4g}" for k, v in summary.get("tolerances", {}).items())
    lines = [
        f"{summary['title']}",
        f"  simulated          {number(summary['termination'].get('time'))} s, {summary['samples']} samples, "
        f"{summary['integrator']} ({tolerances})",
        *_error_line(summary),
        _cost_line(summary),
    ]
    return "\n".join(lines)


def describe_deploy(summary: Mapping[str, Any]) -> str:
    """Return the summary of a deployment."""
    lock = summary.get("lock")
    criteria = summary.get("criteria", {})
    lines = [f"{summary['title']}"]
    if lock:
        error = lock.get("time_error")
        bound = f" +- {error:.1e}" if error is not None else ""
        verb = "overload" if lock["kind"] == "overload" else "locked"
        lines.append(f"  {verb:<18} t = {lock['time']:.9g}{bound} s  ({lock['kind'].replace('_', ' ')})")
        lines.append(f"  why                {summary['termination']['reason']}")
        angles = ", ".join(f"{n} {x:.5f} deg" for n, x in lock["angles_deg"].items())
        lines.append(f"  configuration      {angles}")
        m = lock["multipliers"]
        lines.append(
            f"  multipliers        {m['start']:.5g} N at the start, {m['at_lock']:.6g} N at the last sample"
            + (", diverging" if m["diverge"] else ", finite")
        )
        latch = lock.get("latch")
        if latch:
            lines.append(
                f"  latch              energy lost {latch['energy_lost']:.8g} J, angular impulse "
                f"{latch['angular_impulse']:.6g} N m s"
            )
        lines += _after_lock(summary)
    else:
        lines.append(f"  no lock            within {number(summary['termination'].get('time'))} s")
    growth = criteria.get("growth_times", {})
    fired = ", ".join(f"{k}x at {v:.3f} s" if v is not None else f"{k}x never" for k, v in growth.items())
    dead = criteria.get("dead_point")
    where = f"dead point at {dead:.9g} s" if dead is not None else "no dead point"
    lines.append(f"  criteria           {where}; multipliers over their running median {fired}")
    lines += [*_error_line(summary), _cost_line(summary)]
    return "\n".join(lines)


# of the table of an inverse run: heading, key in the summary, quantity that the unit belongs to, digits
FIGURES = (
    ("peak torque", "peak_torque", "torque", 6),
    ("at t", "peak_torque_time", "time", 4),
    ("RMS torque", "rms_torque", "torque", 6),
    ("peak speed", "peak_speed", "speed", 4),
    ("peak power", "peak_power", "power", 4),
    ("energy", "energy", "energy", 4),
)


def _columns(joints: list[Mapping[str, Any]]) -> list[list[str]]:
    """Return the columns of figures; a unit that is not the same for all joints stands beside each figure."""
    columns = []
    for heading, key, quantity, digits in FIGURES:
        units = [{**joint.get("units", {}), "time": "s"}.get(quantity, "") for joint in joints]
        figures = [number(joint.get(key), digits) for joint in joints]
        if len(set(units)) > 1:
            columns.append([heading, *(f"{x} {unit}" for x, unit in zip(figures, units))])
        else:
            columns.append([f"{heading} [{units[0]}]", *figures])
    return columns


def _after_lock(summary: Mapping[str, Any]) -> list[str]:
    """Return what is said of the locked structure, and of loads beyond their limit."""
    lines = []
    after = summary.get("after_lock")
    if after and after.get("latch"):
        latch = after["latch"]
        lines.append(
            f"  locked structure   {after['degrees_of_freedom']} degrees of freedom, followed to t = "
            f"{number(after['until'])} s; latch bears up to {number(latch['peak_moment'])} N m and "
            f"{number(latch['peak_force'])} N"
        )
    over = summary.get("termination", {}).get("overload")
    if over:
        lines.append(f"  overload           {over}")
    return lines


def describe_inverse(summary: Mapping[str, Any]) -> str:
    """Return the summary of an inverse run."""
    lines = [f"{summary['title']}"]
    joints: Mapping[str, Mapping[str, Any]] = summary.get("joints", {})
    if joints:
        lines.append(table(list(zip(["joint", *joints], *_columns(list(joints.values()))))))
    for label, key, unit in (
        ("path error", "ik_residual", "m"),
        ("round trip error", "round_trip", "relative, forward dynamics after inverse"),
    ):
        value = summary.get(key)
        if isinstance(value, float) and math.isfinite(value):
            lines.append(f"  {label:<18} {value:.1e} {unit}")
    lines += multiplier_lines(summary)
    times = summary.get("wall_time_s", {})
    parts = ", ".join(f"{k} {1e3 * v:.3g}" for k, v in times.items() if k != "total" and v >= 5e-5)
    lines.append(f"  cost               ms: {parts}; in all {1e3 * times.get('total', 0.0):.4g}")
    return "\n".join(lines)
