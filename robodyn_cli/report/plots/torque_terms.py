"""What the torque of each joint is made of: one panel a joint, one line a term."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import finite
from robodyn_cli.report.lines import draw_columns, quiet_axis
from robodyn_cli.report.style import COLOURS, DASHES, FONT_SIZE
from robodyn_cli.report.ticks import load_label
from robodyn_cli.results.result import Result, column_names, units_of

# The order of the contract, so that a term has the same colour in every drawing.
ORDER = ("inertia", "coriolis", "gravity", "friction", "passive", "external", "stops", "gear")
MOST_JOINTS = 8


def applies(result: Result) -> bool:
    """Tell whether the run split its torques into terms."""
    return bool(result.group("torque_terms")) and "tau" in result and result["tau"].size > 0


def draw(result: Result) -> Any:
    """Return the figure."""
    terms = result.group("torque_terms")
    order = [name for name in ORDER if name in terms] + [name for name in terms if name not in ORDER]
    total = result.variables["tau"]
    names = column_names(total)
    units = units_of(total)
    peak = np.max(np.nan_to_num(np.abs(finite(total.data))), axis=0)
    joints = _largest(peak)
    subtitle = "Terms of the actuator torque, which sum to the total"
    left_out = int(np.count_nonzero(peak)) - len(joints)
    if left_out > 0:
        subtitle += f"; the {len(joints)} of {len(names)} joints with the largest torque"
    elif len(joints) < len(names):
        subtitle += f"; {len(names) - len(joints)} joints without any left out"
    labels = [*order, "total"]
    count = len(joints)
    height = {1: 3.3, 2: 2.0}.get(count, 1.6)
    across = 1 if count <= 3 else 2
    sheet = TimeSheet(
        result, subtitle, panels=count, across=across, height=height, gap=0.36, titled=True, labels=labels
    )
    styles = [_look(name) for name in order]
    styles.append({"color": "#000000", "linestyle": "-", "linewidth": 1.8})
    handles: list[Any] = []
    for ax, joint in zip(sheet.axes, joints):
        columns = [terms[name].data[:, joint] for name in order] + [total.data[:, joint]]
        handles = draw_columns(ax, result.time, np.column_stack(columns), styles)
        scale = max((peak[k] for k in range(len(names)) if units[k] == units[joint]), default=0.0)
        quiet_axis(ax, np.column_stack(columns), scale)
        ax.set_title(names[joint], fontsize=FONT_SIZE, loc="left", pad=4)
        ax.set_ylabel(load_label("torque or force", units[joint]))
    sheet.label_time()
    sheet.legend(handles, labels)
    return sheet.figure


def _look(name: str) -> dict[str, Any]:
    colours = [colour for colour in COLOURS if colour != "#000000"]
    index = ORDER.index(name) if name in ORDER else len(ORDER)
    # black is the total's, so there is one term more than colours: it is wine
    colours.append("#882255")
    return {
        "color": colours[min(index, 7)],
        "linestyle": (0, (2, 2, 6, 2)) if index >= 7 else DASHES[index + 1],
        "linewidth": 1.4,
    }


def _largest(peak: Any) -> list[int]:
    """Return the joints with the largest torques, in their own order; none that are zero beside others."""
    order = np.argsort(-peak, kind="stable")[:MOST_JOINTS].tolist()
    return sorted([k for k in order if peak[k] > 0.0] or order)
