"""``robodyn sensitivity``."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Annotated, Any

import typer

from robodyn_cli.cli import offers
from robodyn_cli.cli.options import Jobs, SceneFile, SharedOptions
from robodyn_cli.cli.runner import begun, output, publish, show, store
from robodyn_cli.cli.words import number as shown
from robodyn_cli.cli.words import stated, table
from robodyn_cli.threads import cores

MOST_REASONS = 6  # shown on the terminal


EXAMPLES = (
    "sensitivity configs/2r_circle.yaml --of peak_torque.theta1 --to robot.links.link2.mass",
    "sensitivity configs/four_bar_deploy.yaml --of lock.time --to robot.links.crank.mass "
    "--to 'torques.theta1#2'",
    "sensitivity configs/double_pendulum.yaml --of final.q.theta2 --to initial.q.theta1 --json",
)


def command(
    scene: SceneFile,
    to: Annotated[
        list[str] | None,
        typer.Option("--to", metavar="KEY", autocompletion=offers.bare_keys,
                     help="Key of the scene with a number, e.g. robot.links.link1.mass; KEY#n: the n-th of a formula."),
    ] = None,
    of: Annotated[
        list[str] | None,
        typer.Option("--of", metavar="KEY", autocompletion=offers.outputs(),
                     help="Output: a key of the summary, as in expect, e.g. lock.time."),
    ] = None,
    jobs: Jobs = None,
    *,
    shared: SharedOptions,
) -> int:  # fmt: skip
    """Compute derivatives of outputs by keys."""
    from robodyn_cli.over.sensitivity.asked import prepare
    from robodyn_cli.over.sensitivity.report import report, sensitivities
    from robodyn_cli.scene.load import Family
    from robodyn_cli.tools.progress import Stopwatch

    watch = Stopwatch()
    console, drawings = shared.console, shared.drawings("sensitivity")
    target = shared.directory(scene, "sensitivity")
    start = time.perf_counter()
    with console.waiting(lambda: "deriving"), output(target, scene, console) as directory:
        asked = prepare(Family(scene, shared.overrides or ()), to or (), of or ())
        with begun(directory, console):
            try:
                derivatives = sensitivities(asked, jobs or cores(), console.progress)
            finally:
                console.clear()
            result = report(derivatives, time.perf_counter() - start)
            store(result, directory)
            publish(result, directory, drawings, console, watch)
    show(result, directory, console, describe)
    return 0


def describe(summary: Mapping[str, Any], verbose: bool = True) -> str:
    """Return the summary for the terminal."""
    lines = [summary["title"], f"  sensitivities      of {summary['of']}, {summary['seconds']:.3g} s"]
    reasons: dict[str, list[str]] = {}
    for name, slopes in summary["sensitivities"].items():
        lines += ["", _head(name, summary["nominal"][name])]
        rows = [["key", "derivative", "unit", *(["value", "normalised", "method"] if verbose else [])]]
        for key, slope in slopes.items():
            value = shown(summary["keys"][key]["value"])
            more = [value, shown(slope["normalised"], 4), slope["method"]] if verbose else []
            rows.append([key, stated(slope["derivative"], slope["error"]), slope["unit"], *more])
            if "reason" in slope and key not in reasons.setdefault(slope["reason"], []):
                reasons[slope["reason"]].append(key)
        lines.append(table(rows))
    if reasons:
        lines.append("")
    for reason, keys in list(reasons.items())[:MOST_REASONS]:
        lines.append(f"  not exact          {', '.join(keys)}: {reason}")
    return "\n".join(lines)


def _head(name: str, facts: Mapping[str, Any]) -> str:
    unit = "" if facts["unit"] in ("", "1") else f" {facts['unit']}"
    return f"  {name} = {stated(facts['value'], facts.get('error'))}{unit}"
