"""How extremes of columns over an integrated motion change with keys.

By the envelope theorem the derivative of an extreme is that of the column at the instant where it is extreme,

    d/dk max y(t, x, k) = y_k + y_x S + (dy/dt) dt/dk,   S = dx/dk

and the last term is zero inside of the motion, where dy/dt is, and at its start, which stays.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.functions import sqrt
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.observe.columns import ChosenColumn, chosen
from robodyn_cli.observe.control import SIGNALS
from robodyn_cli.observe.observe import observed
from robodyn_cli.observe.places import point_motion
from robodyn_cli.over.commands import execute
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import EXACT, Slope
from robodyn_cli.over.sensitivity.motion.ends import Ending, MotionSlopes
from robodyn_cli.results.result import Result
from robodyn_cli.scene.checks.columns import column_of
from robodyn_cli.tools.progress import Stopwatch, no_progress

AT_END = 1e-9  # part of the motion's time, within which an instant is that of its end, or of its start
SHARP = 1e-3  # part of the motion's time: an instant that is known less well is none of one extreme
FLAT = 1e-4  # part of the mean rate of a column, of its range over the time, that is left of it at an extreme
SAME = 1e-8  # part of an extreme by which the column there may differ from it


def slopes_of_extremes(asked: AskedSlopes, slopes: MotionSlopes, end: Ending) -> dict[str, list[Slope]]:
    """Return the derivatives of those extremes among the outputs that have exact ones, by all keys of ``slopes``.

    Parameters
    ----------
    slopes : of the motion to its end. They are followed anew to each instant.
    """
    wanted = {name: own for name in asked.task.outputs if (own := column_of(asked.scene, name))}
    if not wanted:
        return {}
    run = execute(asked.task.command, asked.scene, no_progress, Stopwatch())
    found: dict[str, list[Slope]] = {}
    expressions = _expressions(slopes)
    for name, own in wanted.items():
        column, which = chosen(run.variables, own), name.rpartition(".")[2]
        figure = None if column is None else _figure(column, expressions, run)
        if figure is None or which not in ("smallest", "largest", "final"):
            continue
        try:
            found[name] = _slopes(copy.copy(slopes), end, figure, run.summary["extremes"][own], which)
        except CapabilityError:
            continue  # left to differences
    return found


def _expressions(slopes: MotionSlopes) -> dict[str, list[Scalar]]:
    """Return expressions of the integrator's symbols by path of their dataset."""
    motion = slopes.motion
    problem, layout = motion.problem, slopes.variational.system.layout
    known: dict[str, Sequence[Scalar]] = {
        **observed(problem),
        "q": problem.q,
        "qd": problem.v,
        **point_motion(problem),
    }
    if SIGNALS in known:
        known |= {f"{SIGNALS}/{name}": [x] for name, x in zip(problem.scene.outputs.signals, known[SIGNALS])}
    return {
        path: list(x) if layout is None else layout.renamed(list(x))
        for path, x in known.items()
        if all(e.value[1] in STATE_GROUPS for e in free_symbols(x))
    }


def _figure(column: ChosenColumn, known: Mapping[str, Sequence[Scalar]], run: Result) -> Scalar | None:
    """Return what a column is an expression of; None where it is not known as a function of the state."""
    entries, data = known.get(column.path), run[column.path]
    if entries is None or len(entries) != (1 if data.ndim == 1 else data.shape[1]):
        return None
    own = [entries[k] for k in column.places or (0,)]
    return sqrt(sum(x * x for x in own)) if column.is_length else own[0]


def _slopes(
    slopes: MotionSlopes, end: Ending, figure: Scalar, extremes: Mapping[str, Any], which: str
) -> list[Slope]:
    """Return the derivatives of an extreme of a figure.

    Raises
    ------
    CapabilityError : it is none of a smooth function, or not at one instant.
    """
    value, error = extremes[which], extremes["errors"][which]
    time, doubt = end.time, 0.0
    if which != "final":
        time, doubt = extremes[f"{which}_time"], extremes["errors"][f"{which}_time"]
    if error is None or doubt is None or doubt > SHARP * end.time:
        raise CapabilityError("it is not known when the column is extreme")
    near, ending = AT_END * end.time, dataclasses.replace(end, figures=(figure,))
    inside = time < end.time - near
    if inside:
        # at the start it is that of an instant later
        doubt = doubt if time > near else max(doubt, 2.0 * near)
        ending = Ending(max(time, near), figures=(figure,), doubt=doubt, lasts=False)
    slopes.until(ending)
    own, off = slopes.found()
    (there,), (rate,) = slopes.seen
    mean = (extremes["largest"] - extremes["smallest"]) / end.time
    if inside and time > near and abs(rate) > FLAT * mean:
        raise CapabilityError("the column has a corner where it is extreme")
    if abs(there - value) > SAME * max(abs(value), mean * end.time) + error:
        raise CapabilityError("the column is another one there")
    return [Slope(float(y), float(e), EXACT) for y, e in zip(own.figures[0], off.figures[0])]
