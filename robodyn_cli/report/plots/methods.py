"""Methods compared: over the stability suite, and by error against run time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robodyn_cli.integration_methods import REPRESENTATIVES
from robodyn_cli.report.analysis import STATUS
from robodyn_cli.report.numbers import power
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import GREY, HANDLE_LENGTH, marked_style
from robodyn_cli.results.result import Result
from robodyn_cli.summaries.facts import rounded_up

LIGHT = {
    "stable": "#CDEBE0",
    "inaccurate": "#F8E0AE",
    "diverged": "#F2C3A5",
    "too_slow": "#D3EBF8",
    "unsupported": "#EDEDED",
}


def words(trial: Mapping[str, Any]) -> str:
    """Return what a cell says: the error, or what kept the method from one."""
    if trial["relative"] == 0.0:
        return "0"
    if trial["relative"] is not None:
        digit, exponent = f"{rounded_up(trial['relative'], 1):.0e}".split("e")
        return f"{digit}·{power(int(exponent))}"
    if trial["status"] == "stable":
        return "stops" if trial["failure"] else "ran"
    return {"diverged": "diverges", "too_slow": "too slow", "unsupported": "cannot"}.get(
        trial["status"], trial["status"]
    )


@plot(lambda result: "cases" in result.summary)
def stability_suite(result: Result) -> Figure:
    """The stability suite as one picture: cases by methods, status as colour and mark, error in figures."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    cases, methods = result.summary["cases"], result.summary["methods"]
    left, high = 2.05, 0.27
    wide = 0.82 if len(methods) <= 12 else 0.6
    slanted = len(methods) > 8
    right = 0.055 * len(methods[-1]) - 0.5 * wide if slanted else 0.0  # what of the last name stands out
    width, height = (
        left + wide * len(methods) + max(0.45, right),
        1.15 + (0.55 if slanted else 0.0) + high * len(cases) + 0.5,
    )
    figure = Figure(figsize=(width, height), dpi=120)
    kept = len(cases) - result.summary["missed"]
    figure.text(
        0.1 / width, 1 - 0.24 / height, result.summary["title"], fontsize=11, fontweight="bold", va="center"
    )
    figure.text(
        0.1 / width,
        1 - 0.47 / height,
        f"{kept} of {len(cases)} cases as expected; figures: largest error over the range of its quantity",
        color=GREY,
        va="center",
    )
    box = (left / width, 0.5 / height, wide * len(methods) / width, high * len(cases) / height)
    ax = figure.add_axes(box)
    ax.set_xlim(0, len(methods))
    ax.set_ylim(len(cases), 0)
    for row, case in enumerate(cases):
        for column, name in enumerate(methods):
            if name in case["methods"]:
                _cell(ax, row, column, case["methods"][name], 8 if wide > 0.7 else 7)
    ax.set_xticks(
        [k + 0.5 for k in range(len(methods))],
        methods,
        rotation=40 if slanted else 0,
        fontsize=8,
        ha="left" if slanted else "center",
    )
    ax.xaxis.tick_top()
    marks = ["" if case["holds"] else "  MISSED" for case in cases]
    ax.set_yticks(
        [k + 0.5 for k in range(len(cases))], [c["name"] + m for c, m in zip(cases, marks)], fontsize=8
    )
    ax.tick_params(length=0)
    ax.grid(False)
    for side in ax.spines.values():
        side.set_visible(False)
    handles = [Patch(facecolor=LIGHT[s], label=s.replace("_", " ")) for s in STATUS]
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.02, 0.0), ncols=5)
    return figure


def _cell(ax: Axes, row: int, column: int, trial: Mapping[str, Any], size: int) -> None:
    """Draw what a method made of a case."""
    from matplotlib.patches import Rectangle

    status = trial["status"]
    ax.add_patch(Rectangle((column, row), 1, 1, facecolor=LIGHT[status], edgecolor="white", linewidth=1.5))
    dark = "black" if status != "unsupported" else GREY
    mark = "" if status != "inaccurate" else " !"
    ax.text(
        column + 0.5, row + 0.52, words(trial) + mark, ha="center", va="center", fontsize=size, color=dark
    )


# a dash a formulation; colour and marker tell the methods apart
DASHES = ("-", "--", ":", "-.")
# more curves than these cannot be told apart; all of them are in runs.csv
MOST_METHODS = 12


def _curves(runs: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Return usable runs by method and formulation, best formulation names short."""
    several = len({r["formulation"] for r in runs}) > 1
    curves: dict[str, list[dict[str, Any]]] = {}
    for run in runs:
        if run["error"] is None or run["run_time_s"] is None or not run["error"] > 0.0:
            continue
        name = f"{run['method']}, {run['formulation']}" if several else run["method"]
        curves.setdefault(name, []).append(run)
    return curves


def _readable(
    curves: dict[str, list[dict[str, Any]]], best: list[dict[str, Any]]
) -> dict[str, list[dict[str, Any]]]:
    """Return at most MOST_METHODS curves: those that are best somewhere first, then one of each family."""
    if len(curves) <= MOST_METHODS:
        return curves
    front = {(b["method"], b["formulation"]) for b in best}

    def rank(name: str) -> tuple[bool, bool]:
        run = curves[name][0]
        return (run["method"], run["formulation"]) not in front, run["method"] not in REPRESENTATIVES

    kept = set(sorted(curves, key=rank)[:MOST_METHODS])
    return {name: runs for name, runs in curves.items() if name in kept}


@plot(lambda result: "runs" in result.summary)
def work_precision(result: Result) -> Figure:
    """Error against run time and against evaluations, for ``work-precision``; two panels that share the error axis."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    from robodyn_cli.report.style import PowerFormatter

    summary = result.summary
    curves = _readable(_curves(summary["runs"]), summary["best"])
    rows = -(-len(curves) // 3)
    height = 4.6 + 0.2 * rows
    figure = Figure(figsize=(9.0, height))
    bottom = (0.7 + 0.2 * rows) / height
    axes = [figure.add_axes((0.09 + 0.47 * k, bottom, 0.42, 0.85 - bottom)) for k in range(2)]
    methods = list(dict.fromkeys(r[0]["method"] for r in curves.values()))
    kinds = list(dict.fromkeys(r[0]["formulation"] for r in curves.values()))
    for name, runs in curves.items():
        look = marked_style(methods.index(runs[0]["method"]))
        dash = DASHES[kinds.index(runs[0]["formulation"]) % len(DASHES)]
        for axis, key, factor in ((axes[0], "run_time_s", 1e3), (axes[1], "evaluations", 1.0)):
            axis.plot(
                [factor * r[key] for r in runs], [r["error"] for r in runs], linestyle=dash,
                markersize=5.4, linewidth=1.3, label=name, **look,
            )  # fmt: skip
    for axis, label in zip(axes, ("run time [ms], median", "evaluations of the right-hand side [1]")):
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.margins(0.04)
        axis.set_xlabel(label)
        for one in (axis.xaxis, axis.yaxis):
            one.set_major_formatter(PowerFormatter())
            one.set_minor_formatter(NullFormatter())
        axis.grid(True, which="major", color="#dddddd", linewidth=0.7)
        axis.spines[["top", "right"]].set_visible(False)
    lock = summary.get("lock_time")
    axes[0].set_ylabel(
        "largest error of q or qd [rad, m; per s]" if lock is None else "error of the time of the lock [s]"
    )
    axes[1].tick_params(labelleft=False)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="lower left", bbox_to_anchor=(0.07, 0.0), ncols=3, frameon=False, fontsize=8,
        handlelength=HANDLE_LENGTH + 1.2,  # the marker hides as much of the line
    )  # fmt: skip
    figure.text(0.09, 0.945, result.title, fontsize=12, fontweight="bold")
    what = f"to t = {summary['compared_until']:.4g} s" if lock is None else f"of the lock at t = {lock:.9g} s"
    figure.text(
        0.09, 0.9,
        f"error {what} against a reference good to {summary['reference_digits']:.1f} digits; compilation apart",
        fontsize=9, color="#555555",
    )  # fmt: skip
    return figure
