"""Stability of a scene: eigenvalues, errors of methods, energy over a long run, Baumgarte's gains."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robodyn_cli.integration_methods import EXTREMES, METHODS
from robodyn_cli.report.analysis import LEAST, STATUS, bar_beside, fit_label, powers
from robodyn_cli.report.canvas import CHARACTER, Sheet
from robodyn_cli.report.format import current
from robodyn_cli.report.numbers import number, raised
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import BLACK, FEW, GREY, MARKERS, PlainFormatter, dashed_style
from robodyn_cli.results.result import Result

# step limits that are drawn
SHOWN = tuple(name for name in EXTREMES if not METHODS[name].stiff)


@plot(lambda result: "stability/time" in result)
def stability_spectrum(result: Result) -> Figure:
    """Eigenvalues in the complex plane, and the largest stable steps along the run."""
    found = result.summary["spectrum"]
    names = [name for name in result.variables["stability/step_limit"].names if name in SHOWN]
    sheet = Sheet(
        result,
        f"stiffness ratio at most {number(found['stiffness_ratio'])}; "
        f"fastest decay {number(found['fastest_decay'])} 1/s, "
        f"fastest oscillation {number(found['fastest_oscillation'], 3)} rad/s",
        panels=2,
        height=2.4,
        gap=0.62,
        degrees=True,
        labels=names,
        captions=[
            "Eigenvalues: left decays, right grows. Steps, explicit: all modes inside |R| <= 1; gauss: the iteration "
            "of a step is done within its rounds; no error is stated for this"
        ],
    )
    _eigenvalues(sheet.axes[0], result)
    sheet.legend(_steps(sheet.axes[1], result, names), names)
    return sheet.figure


def _eigenvalues(plane: Axes, result: Result) -> None:
    """Draw the eigenvalues in the complex plane, shaded by time."""
    time = result["stability/time"]
    real, imaginary = result["stability/eigenvalues_real"], result["stability/eigenvalues_imaginary"]
    size = max(float(np.abs(real).max()), float(np.abs(imaginary).max()), 1e-9)
    smallest = max(result.summary["spectrum"]["slowest_rate"], 1e-9 * size)
    shades = np.repeat(time[:, None], real.shape[1], axis=1)
    dots = plane.scatter(
        real.ravel(), imaginary.ravel(), c=shades.ravel(), cmap="cividis", s=11, linewidths=0
    )
    for name, values in (("x", real), ("y", imaginary)):
        largest = float(np.abs(values).max())
        if largest > 30.0 * smallest:
            getattr(plane, f"set_{name}scale")("symlog", linthresh=smallest, linscale=0.6)
            _sparse(plane, name, smallest, largest)
        else:
            getattr(plane, f"{name}axis").set_major_formatter(PlainFormatter())
    plane.axvline(0.0, color=GREY, linewidth=0.8)
    plane.margins(0.06)
    fit_label(plane, "x", "real part of eigenvalues [1/s]")
    plane.set_ylabel("imaginary part [rad/s]")
    plane.figure.colorbar(dots, cax=bar_beside(plane, "time [s]"))


def _steps(ax: Axes, result: Result, names: list[str]) -> list[Any]:
    """Draw the largest stable steps along the run; return a handle for each method."""
    time, steps = result["stability/time"], result["stability/step_limit"]
    columns, handles = result.variables["stability/step_limit"].names, []
    for name in names:
        k, place = columns.index(name), SHOWN.index(name)  # a method looks the same in every scene
        good = np.isfinite(steps[:, k])
        handles += ax.plot(
            time[good], steps[good, k], label=name, marker=MARKERS[place % len(MARKERS)] if good.sum() < 4 else None,
            **dashed_style(place),
        )  # fmt: skip
    ax.set_yscale("log")
    powers(ax, "y")
    ax.set_xlabel("time [s]")
    ax.set_ylabel("largest stable step [s]")
    return handles


def _sparse(ax: Axes, name: str, smallest: float, largest: float) -> None:
    """Put a handful of ticks on a symmetric logarithmic axis."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    from robodyn_cli.report.numbers import power

    first, last = int(np.ceil(np.log10(smallest))), int(np.floor(np.log10(largest)))
    every = max(1, (last - first) // 4)
    powers = list(range(last, first - 1, -every)) if last >= first else []
    places = [0.0, *(s * 10.0**p for p in powers for s in (-1.0, 1.0))]
    axis = getattr(ax, f"{name}axis")
    axis.set_major_locator(FixedLocator(sorted(places)))
    axis.set_minor_locator(NullLocator())

    def text(x: float, _: Any = None) -> str:
        if x == 0.0:
            return "0"
        return ("−" if x < 0 else "") + power(round(np.log10(abs(x))))

    axis.set_major_formatter(FuncFormatter(text))


WORDS, BRIEF = 2.75, 0.95  # room for what is said of a method [inch]
ROOMY = 6.0  # width from which on there is room for all of it [inch]


@plot(lambda result: bool(result.summary["methods"]) and "cases" not in result.summary)
def stability_methods(result: Result) -> Figure:
    """Error of each method at its default settings as a bar, with its status in words."""
    rows = result.summary["methods"]
    ref = result.summary["reference"]
    told = (
        f"against {ref['methods'][0]} and {ref['methods'][1]}, which agree to {ref['digits']:.1f} digits up to t = "
        f"{number(ref['until'], 4)} s"
        if ref
        else "no reference: no two methods get through at tight tolerance"
    )
    bars = (
        "Bars: largest error of a run at default settings, over the range of its quantity; "
        "beyond the dashed line: inaccurate"
    )
    sheet = Sheet(result, told, height=0.32 * len(rows), captions=[bars])
    width, left = current().width, 0.25 + CHARACTER * max(len(row["method"]) for row in rows)
    brief = width < ROOMY  # leaves out what stands behind the status
    ax, box = sheet.ax, sheet.ax.get_position()
    ax.set_position((left / width, box.y0, 1.0 - (left + (BRIEF if brief else WORDS)) / width, box.height))
    for k, row in enumerate(rows):
        colour, hatch = STATUS[row["status"]]
        value = row["relative"]
        if value is not None:
            ax.barh(k, value, left=0, color=colour, hatch=hatch, edgecolor="white", height=0.68)
        note = row["status"].replace("_", " ") + (", error 0" if value == 0.0 else "")
        if row["method"] == "auto" and row["chosen"]:
            note += f" ({row['chosen']})"
        elif value is None and row["until"] > 0.0:
            note += f", to t = {number(row['until'], 3)} s"
        elif row["honest"] is False:
            note += ", and its estimate hides it"
        note = note.partition(",")[0].partition(" (")[0] if brief else note
        ax.text(1.02, k, note, transform=ax.get_yaxis_transform(), va="center", color="black", fontsize=8.5)
    ax.axvline(1e-3, color="#D55E00", linewidth=1.0, linestyle="--")
    largest = max((r["relative"] for r in rows if r["relative"] is not None), default=1.0)
    ax.set_xscale("log")
    ax.set_xlim(LEAST, max(10.0, 3 * largest))
    powers(ax, "x")
    ax.set_yticks(range(len(rows)), [r["method"] for r in rows])
    ax.set_ylim(len(rows) - 0.45, -0.55)
    ax.grid(False, axis="y")
    ax.locator_params(axis="x", numticks=3 if brief else 6)
    fit_label(ax, "x", "largest relative error [1]")
    return sheet.figure


def _curves(result: Result) -> dict[str, Mapping[str, Any]]:
    """Return the facts of the methods that have a curve, by name."""
    facts = {m["method"]: m for m in result.summary.get("energy_growth", {}).get("methods", ())}
    return {n: m for n, m in facts.items() if f"energy_growth/{n}/error" in result and m["steps"]}


@plot(lambda result: bool(_curves(result)))
def energy_growth(result: Result) -> Figure:
    """Error of the energy balance over a thousand periods."""
    labels = {name: _label(name, m) for name, m in _curves(result).items()}
    for name in labels:
        labels[name] += "" if np.any(result[f"energy_growth/{name}/error"]) else ", zero"
    period = result.summary["energy_growth"]["period"]
    text = f"a period is {number(period['seconds'], 4)} s: {period['source']}"
    grows = "~tᵖ: the error grows like this power of time t over the last nine tenths of the run"
    sheet, handles = Sheet(result, text, height=3.3, labels=list(labels.values()), captions=[grows]), []
    ax = sheet.ax
    for k, (name, label) in enumerate(labels.items()):
        t, error = result[f"energy_growth/{name}/periods"][1:], result[f"energy_growth/{name}/error"][1:]
        handles += ax.plot(t, np.maximum.accumulate(error), label=label, **_look(k))
    ax.set_xscale("log")
    ax.set_yscale("log", nonpositive="mask")  # no line before the first error that is not zero
    ax.set_ylim(bottom=LEAST)
    powers(ax, "x", "y")
    ax.set_xlabel("time [periods]")
    ax.set_ylabel("largest error of the energy balance so far [1]")
    sheet.legend(handles, list(labels.values()))
    return sheet.figure


def _look(k: int) -> dict[str, Any]:
    """Return the look of the k-th method: where colours repeat, black, as no sum is drawn here."""
    return {**dashed_style(k), **({"color": BLACK} if k >= FEW else {})}


def _label(name: str, facts: Mapping[str, Any]) -> str:
    power = "" if facts["exponent"] is None else f", ~t{raised(number(round(facts['exponent'], 1) + 0.0))}"
    ended = "" if facts["status"] == "ok" else f", {facts['status'].replace('_', ' ')}"
    return f"{name}{power}{ended}"


def _planes(result: Result) -> list[str]:
    return [name for name in ("own", "fixed") if f"baumgarte/{name}/drift" in result]


BESIDE = 0.5  # of a panel's width, for a scale of colours [inch]


@plot(lambda result: bool(_planes(result)))
def baumgarte(result: Result) -> Figure:
    """Drift and error over the plane of Baumgarte's gains, with the chosen pair marked."""
    found, planes = result.summary["baumgarte"], _planes(result)
    sheet = Sheet(
        result,
        "star: alpha = beta = c/h, the smallest whose drift stays below the integration error; hatched: unstable",
        panels=2 * len(planes),
        across=2,
        height=2.3,
        gap=0.85,
        titled=True,
    )
    axes = iter(sheet.axes)
    for name in planes:
        gain = result[f"baumgarte/{name}/gain"]
        chosen = found[name]["chosen"]
        for path, words in (("drift", "drift"), ("error", "error of q")):
            ax, width = next(axes), current().width
            box = ax.get_position()
            ax.set_position((box.x0, box.y0, box.width - BESIDE / width, box.height))
            bar = bar_beside(ax)
            _plane(ax, bar, gain, result[f"baumgarte/{name}/{path}"], f"{words} [rad, m]")
            # where no gain is needed the star stands in the corner, for the axes have no zero
            ax.plot(
                [max(chosen["beta"], gain[0])],
                [max(chosen["alpha"], gain[0])],
                marker="*",
                markersize=13,
                color="white",
                markeredgecolor="black",
                clip_on=False,
            )
            none = ", no gain needed" if chosen["alpha"] == 0.0 == chosen["beta"] else ""
            ax.set_title(
                f"{found[name]['method']}, {path}, h = {number(found[name]['reference_step'], 2)} s{none}",
                fontsize=9,
            )
            ax.set_xlabel("beta [1/s]")
            if path == "drift" or sheet.across == 1:
                ax.set_ylabel("alpha [1/s]")
    return sheet.figure


def _plane(ax: Axes, bar: Axes, gain: Any, data: Any, label: str) -> None:
    from matplotlib.colors import LogNorm

    shown = np.ma.masked_invalid(data)
    half = np.sqrt(gain[1] / gain[0])
    edges = np.append(gain / half, gain[-1] * half)
    # the colour of the scale's end says "no more than that", of zeros too
    low = max(float(shown.min()), LEAST) if shown.count() else 1e-12
    high = max(float(shown.max()) if shown.count() else 1.0, 10.0 * low)
    ax.patch.set(facecolor="white", edgecolor="#8a8a8a", hatch="///", linewidth=0.0)
    drawn = ax.pcolormesh(edges, edges, np.ma.maximum(shown, low), norm=LogNorm(low, high), cmap="cividis")
    ax.grid(False)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylim(edges[0], edges[-1])
    powers(ax, "x", "y")
    ax.figure.colorbar(drawn, cax=bar, extend="min" if np.any(shown < low) else "neither")
    bar.set_ylabel(label)
    powers(bar, "y")
