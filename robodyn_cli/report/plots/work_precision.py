"""Error against run time and against evaluations, for ``work-precision``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robodyn_cli.integration_methods import REPRESENTATIVES
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# a dash a formulation; colour and marker tell the methods apart
DASHES = ("-", "--", ":", "-.")
# more curves than these cannot be told apart; all of them are in runs.csv
MOST = 12


def applies(result: Result) -> bool:
    """Tell whether methods were compared."""
    return "runs" in result.summary


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
    """Return at most MOST curves: those that are best somewhere first, then one of each family."""
    if len(curves) <= MOST:
        return curves
    front = {(b["method"], b["formulation"]) for b in best}

    def rank(name: str) -> tuple[bool, bool]:
        run = curves[name][0]
        return (run["method"], run["formulation"]) not in front, run["method"] not in REPRESENTATIVES

    kept = set(sorted(curves, key=rank)[:MOST])
    return {name: runs for name, runs in curves.items() if name in kept}


def draw(result: Result) -> Figure:
    """Return the figure: two panels that share the error axis."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    from robodyn_cli.report.style import HANDLE_LENGTH, marked_style
    from robodyn_cli.report.ticks import PowerFormatter

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
