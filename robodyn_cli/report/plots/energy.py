"""Energy over time, and how far it strays from what it must be."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from robodyn_cli.report.curves import curves, zero_note
from robodyn_cli.report.lines import finite, largest, where_largest
from robodyn_cli.report.numbers import error_number, number, times
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import BLACK, line_styles, positive_floor
from robodyn_cli.report.time_sheet import TimeSheet
from robodyn_cli.results.moments import lock_time
from robodyn_cli.results.result import Result
from robodyn_cli.results.sampling import too_far_apart
from robodyn_cli.results.stated_errors import meaningful_error

# each kind with its look, the same where another is not there: dashed, as the total often lies on the potential
KINDS = dict(zip(("kinetic", "potential", "total", "work"), line_styles(4)))
KINDS["total"] = {**KINDS["total"], "color": BLACK}


@plot(lambda result: "energy/total" in result)
def energy(result: Result) -> Any:
    """Kinetic, potential and total energy and the work done, over time."""
    kinds = [kind for kind in KINDS if f"energy/{kind}" in result]
    columns = {kind: finite(result[f"energy/{kind}"]) for kind in kinds}
    labels, subtitle = list(kinds), "Energies" + (" and work done" if "work" in kinds else "")
    level, datum = max(largest(np.abs(item)) for item in columns.values()), _datum(columns)
    if datum:
        for kind in ("potential", "total"):
            columns[kind] = columns[kind] - datum
        labels = [f"{kind} − V(0)" if kind in ("potential", "total") else kind for kind in kinds]
        subtitle += f"; potential and total counted from V(0) = {number(datum, 6)} J"
    errors = [meaningful_error(result, f"energy/{kind}") for kind in kinds]
    units = ["J"] * len(kinds)
    apart = np.column_stack([too_far_apart(result, f"energy/{kind}") for kind in kinds])
    shown = curves(np.column_stack(list(columns.values())), labels, units, errors, {"J": level})
    shown = dataclasses.replace(shown, apart=apart)
    sheet = TimeSheet(result, subtitle, "energy", shown.nothing, labels=labels)
    handles = sheet.draw(sheet.ax, shown, [KINDS[kind] for kind in kinds])
    sheet.ax.set_ylabel("energy [J]")
    sheet.finish(handles, labels)
    return sheet.figure


def _datum(columns: dict[str, Any]) -> float:
    """Return what to count the potential from: its start if its level would dwarf its changes, or 0."""
    if "potential" not in columns:
        return 0.0
    spread = max(largest(item) + largest(-item) for item in columns.values())
    start = float(columns["potential"][0])
    return start if abs(start) > 2.0 * spread > 0.0 else 0.0


ROUNDING = 8.0 * float(np.finfo(float).eps)


@plot(lambda result: "energy/total" in result and len(result.time) > 1)
def energy_drift(result: Result) -> Any:
    """How far the energy strays from what it must be, on a logarithmic axis."""
    total = finite(result["energy/total"])
    change = total - total[0]
    worked = "energy/work" in result and bool(np.any(result["energy/work"] != 0.0))
    if worked:
        work = finite(result["energy/work"])
        change = change - (work - work[0])
    locked, window = lock_time(result), slice(None)
    if locked is not None and np.any(result.time < locked):
        # A latch takes energy by an impulse, which is no error of the integration.
        window = slice(int(np.count_nonzero(result.time < locked * (1.0 - 1e-12))))
    time, error = result.time[window], np.abs(change)
    error[len(time) :] = np.nan
    level, scale = _sizes(result)
    # What rounding leaves of sums of the largest energies: below it there is nothing to see.
    floor = ROUNDING * level if level > 0.0 else 1e-16
    worst = where_largest(error)
    name = "|E(t) − E(0) − work|" if worked else "|E(t) − E(0)|"
    subtitle = (
        f"Energy {'balance error' if worked else 'drift'} {name}: largest {error_number(error[worst])} J"
    )
    if scale > 0.0 and error[worst] > 0.0:
        share = error_number(error[worst] / scale)
        subtitle += f" at {times([float(time[worst])])[0]}, {share} of the energy exchanged"
    shown = curves(error[:, None], [name], ["J"], floor)
    sheet = TimeSheet(result, subtitle + zero_note(shown.data), nothing=shown.nothing)
    sheet.draw_log(sheet.ax, shown, positive_floor(error, floor=floor), window=window)
    sheet.ax.set_ylabel(f"{name} [J]")
    sheet.finish([], [])
    return sheet.figure


def _sizes(result: Result) -> tuple[float, float]:
    """Return (largest energy, energy exchanged): a potential's level is arbitrary, its range is not."""
    parts = {
        k: finite(result[f"energy/{k}"]) for k in ("kinetic", "potential", "total") if f"energy/{k}" in result
    }
    level = max(largest(np.abs(part)) for part in parts.values())
    spans = [largest(parts[k]) + largest(-parts[k]) for k in ("potential", "total") if k in parts]
    return level, max([*spans, largest(parts.get("kinetic", np.zeros(1)))])
