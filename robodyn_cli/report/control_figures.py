"""What a controller is, as small tables of text: gains, and poles of the loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robodyn_cli.report.cells import Table, figure
from robodyn_cli.summaries.control import OWN_GAINS, is_diagonal
from robodyn_cli.summaries.facts import rounded_up

Summary = Mapping[str, Any]


def control_tables(summary: Summary) -> list[Table]:
    """Return the gains of a controller, and the poles of the loop that it is made for or that it is in."""
    listed = []
    control = summary.get("control")
    if isinstance(control, Mapping):
        listed += [_gains(control)] if control.get("gains") else []
        listed += [_poles(control)] if control.get("poles") else []
    loop = summary.get("closed_loop")
    return [*listed, _poles(loop)] if isinstance(loop, Mapping) else listed


def loop_note(summary: Summary) -> list[str]:
    """Return what is to be known of the loop of a controller in a sentence; none without a loop."""
    loop = summary.get("closed_loop")
    if not isinstance(loop, Mapping):
        return []
    rest = f", sampled every {loop['period']:g} s" if "period" in loop else ""
    late = f", {loop['delay']:g} s late" if loop.get("delay") else ""
    left = "; the law does not hold this pose" if "held_back" in loop else ""
    return [f"loop with the controller: {loop['stability']}{rest}{late}; about {loop['about']}{left}"]


def _gains(control: Summary) -> Table:
    """Return gains, a row for each column of their matrix: of a diagonal one a row for each joint."""
    gains, units, of = control["gains"], control["row_units"], control["column_units"]
    errors = control.get("gain_errors") or {}
    if not errors and is_diagonal(gains):
        n, columns = len(gains), list(next(iter(gains.values())))
        rows = [
            [f"{row} [{units[row]}]", *(figure(x[name]) for name in columns[k::n])]
            for k, (row, x) in enumerate(gains.items())
        ]
        return Table(("gains", *OWN_GAINS[: len(columns) // n]), rows)
    columns = list(next(iter(gains.values())))
    rows = [
        [
            f"{name} [{of[name]}]",
            *(figure(gains[row][name], errors.get(row, {}).get(name)) for row in gains),
        ]
        for name in columns
    ]
    return Table(("gain of", *(f"{row} [{units[row]}]" for row in gains)), rows)


def _poles(of: Summary) -> Table:
    """Return poles of a loop, pairs once, an error beside each."""
    unit = "per sample" if "period" in of else "1/s"
    rows = []
    for pole in of["poles"]:
        if pole["imaginary"] >= 0.0:
            beside = f" ± {pole['imaginary']:.6g}i" if pole["imaginary"] else ""
            rows.append([f"{pole['real']:.6g}{beside}", f"{rounded_up(pole['error'], 1):.1g}"])
    return Table((f"pole of the loop [{unit}]", "off by"), rows)
