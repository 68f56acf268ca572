"""``robodyn assemble``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

from robodyn_cli.cli.figure_words import figure_table
from robodyn_cli.cli.offers import names_in
from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict, utf8
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import closure_text, mobility_lines, number, stated
from robodyn_cli.report.cells import Figure, Table
from robodyn_cli.summaries.facts import ACCELERATION, RATE

ILL_CONDITIONED = 1e6  # condition number of the inertia that is told
ROUNDING = 1e-9  # tolerance from which on loops do not close exactly


EXAMPLES = (
    "assemble configs/four_bar_deploy.yaml",
    "assemble configs/four_bar_deploy.yaml --branches",
    "assemble configs/published/delta.yaml --json",
)


def command(
    scene: SceneFile,
    branches: Annotated[
        bool, typer.Option("--branches", help="Find and list all the ways in which the loops close.")
    ] = False,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            metavar="q.NAME=...",
            autocompletion=names_in("robot.joints", before=("q.", "qd."), after="="),
            parser=utf8,
            help="Joints to hold, and where; rates as qd.NAME=... too.",
        ),
    ] = None,
    *,
    shared: SharedOptions,
    strict: Strict = False,
) -> int:
    """Run the command; return its exit code."""
    changes: list[str] = []
    if at:
        from robodyn_cli.scene.load import load_scene
        from robodyn_cli.works.state_text import state_overrides

        changes += state_overrides(load_scene(scene, shared.overrides or ()), at)
    if branches:
        changes.append("assemble.branches=true")
    return run_scene(shared.job("assemble", scene, strict, changes), shared.console, describe)


def _motion(summary: Mapping[str, Any]) -> str:
    """Return the table of rates and accelerations, with their errors."""
    rows: list[list[str | Figure]] = []
    for name, rate in summary["rates"].items():
        off, unit = summary["error_estimate"], summary["units"][name]
        moving = Figure(rate, off["rates"][name], RATE(unit))
        changing = Figure(summary["accelerations"][name], off["accelerations"][name], ACCELERATION(unit))
        rows.append([name, moving, changing])
    return figure_table(Table(("joint", "rate", "acceleration"), rows))


def _branches(summary: Mapping[str, Any]) -> str:
    """Return the table of the ways in which the loops close."""
    branches, units = summary["branches"], summary["units"]
    signed = any(branch["orientation"] is not None for branch in branches)
    head = ("branch", *branches[0]["configuration"], *(["orientation"] if signed else []), "singular ratio")
    rows: list[list[str | Figure]] = []
    for k, branch in enumerate(branches, start=1):
        sign = {1: "+", -1: "-", 0: "0"}.get(branch["orientation"], "?")
        q = [Figure(x, branch["errors"][name], units[name]) for name, x in branch["configuration"].items()]
        chosen = f"{k} (chosen)" if branch["chosen"] else str(k)
        ratio = Figure(branch["singular_ratio"], branch["singular_ratio_error"])
        rows.append([chosen, *q, *([sign] if signed else []), ratio])
    return figure_table(Table(head, rows))


def describe(summary: Mapping[str, Any], verbose: bool = True, figures: Sequence[str] = ()) -> str:
    """Return the summary of an assembly."""
    held = ", ".join(summary["held"]) or "none"
    lines = [
        f"{summary['title']}",
        f"  closed             held: {held}; solved: {', '.join(summary['solved'])}",
        *figures,
    ]
    moves = any(summary["rates"].values())
    if verbose or moves:
        lines.append(_motion(summary))
    residual = summary["residual"]
    told = residual if verbose or moves else {"position": residual["position"]}
    lines.append("  residual           " + closure_text(told))
    if summary["tolerance"] >= ROUNDING:
        lines.append(
            f"  not exact          redundant rows contradict each other by rounding in the data: closed to "
            f"{summary['tolerance']:g} (rad, or part of the size), as far as the residual tells"
        )
    if "nearest" in summary:
        near = summary["nearest"]
        lines.append(
            f"  start              none given: of {near['closed']} poses closed from {near['starts']} starts the "
            f"nearest to q = 0, {number(near['distance'], 6)} away (rad, sizes of the mechanism); other branches may "
            "exist: initial.q chooses, --branches lists them"
        )
    if summary["redundant_rows"]:
        lines.append(f"  redundant rows     {', '.join(summary['redundant_rows'])}")
    lines += mobility_lines(summary) if verbose else []
    undriven: dict[str, int] = {}
    for part in summary.get("undriven", ()):
        joints = ", ".join(part["joints"])
        undriven[joints] = undriven.get(joints, 0) + part["count"]
    lines += [f"  nothing drives     {n} of the freedoms: of {joints}" for joints, n in undriven.items()]
    if (condition := summary.get("mass_condition", 0.0)) > ILL_CONDITIONED:
        digits, off = math.log10(condition), summary["mass_condition_error"]
        lines.append(
            f"  inertia            condition number {stated(condition, off)} over the freedoms, as very "
            f"light links make it: accelerations lose {digits:.0f} digits"
        )
    branches = summary.get("branches")
    if branches:
        lines.append(_branches(summary))
        search = summary["branch_search"]
        lines.append(
            f"  search             {search['found']} branches found from {search['starts']} starts, of which "
            f"{search['closed']} closed; that there are no others is not proved"
        )
    return "\n".join(lines)
