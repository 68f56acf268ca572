"""A page of results, a section each: one file that needs no network, with a policy that lets nothing but its own script
run."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.report.drawing.build import has_poses
from robodyn_cli.report.figures import alarms, notes, shown_errors, shown_units
from robodyn_cli.report.numbers import number, typeset
from robodyn_cli.report.page import several, tables
from robodyn_cli.report.page.charts import Store, looks
from robodyn_cli.report.page.motion import motion_data
from robodyn_cli.report.page.plots import plots_of, still
from robodyn_cli.report.page.summary import summary_tables
from robodyn_cli.report.page.tables import Html, element, json_block, markup
from robodyn_cli.report.page.verdict import verdicts
from robodyn_cli.report.time_sheet import lost_note
from robodyn_cli.results.atomic import write_bytes
from robodyn_cli.results.moments import moments
from robodyn_cli.results.result import Result
from robodyn_cli.version import __version__

SPEEDS = (0.001, 0.01, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 100.0, 1000.0)
LISTED = 12  # moments that have a button
HELP = (
    "Drag or arrow keys: turn. Ctrl and wheel (wheel alone after a click), pinch, + and −: zoom. Shift and drag: move. "
    "0: as at first. Space: play. Click a body, or B: what it is and does; C: follow it. N: names. F: frames. "
    "G: ghosts, the links at other times."
)
USUAL = 48  # points of a curve over a key
LIVE = (
    "Drawing, figures and plots here are of runs in this page, made more than once, so that they have errors as those "
    "of the command; plots and tables below are of the stored result. What is marked below a slider is left to the "
    "command."
)
LIVE_GIVEN = (
    "Drawing, figures and plots here are computed in this page along the motion that is asked for, with errors as "
    "those of the command; plots and tables below are of the stored result. What is marked below a slider is left to "
    "the command."
)
SHORT = f"Pages of more than {several.WHOLE} results have no plots of each; a page of this one alone has."
UNDRAWN = f"Pages of more than {several.DRAWINGS} results have no drawing of each either."


@record
class Shown:
    """A result on a page: its label, and, if it is shown, the plan of its scene and what runs of it in the page."""

    label: str
    result: Result
    plan: Mapping[str, Any] | None = None
    live: Mapping[str, Any] | None = None


def section(place: int, shown: Shown, store: Store, among: int | None) -> Html:
    """Return the section of the ``place``-th result; what the script draws goes into ``store``.

    among : how many results there are, None of the page's only one, whose title is that of the page. Among very many
    it has no plots of its own, and a small drawing.

    Raises
    ------
    CapabilityError : the result has poses, but this version cannot read its scene.
    """
    result = shown.result
    moving, whole = has_poses(result), among is None or among <= several.WHOLE
    parts: list[Any] = [
        _head(shown, among is None),
        _motion(result, store, among or 1) if moving else None,
        None if shown.live is None else _live(place, store, shown.live, result),
        tables.main_figures(result),
        plots_of(result, store, moving) if whole else element("p", SHORT, class_="note"),
        _summary(result, whole),
    ]
    if shown.plan is not None and whole:
        parts += [element("h3", "Plan"), tables.plan_tables(shown.plan)]
    scene = element("summary", "the scene as it was run"), element("pre", result.scene_text, tabindex="0")
    parts += [
        element("h3", "Scene"),
        tables.provenance_table(result.summary, result.attributes),
        element("details", *scene, class_="scene-text"),
    ]
    if among is None:
        parts = [tables.raised(markup(parts))]
    alone = "alone" if among is None else None
    return element("section", parts, id=f"result-{place}", class_=alone, data_result=True)


def _summary(result: Result, whole: bool) -> Html:
    found = summary_tables(result.summary, shown_units(result), shown_errors(result))
    inside = element("div", found, class_="tables")
    if whole:
        return markup([element("h3", "Summary"), inside])
    return element("details", element("summary", "Summary"), inside, class_="whole-summary")


def _head(shown: Shown, alone: bool) -> Html:
    """Return what stands above: title, status, command, what happened, and what is to be known of the result."""
    result = shown.result
    told = [
        element("strong", one.words, class_="status alarm" if one.alarming else "status")
        for one in verdicts(result)
    ]
    words: list[Any] = [element("span", result.command, class_="label")]
    words += [element("span", shown.label, class_="label")] if shown.label != result.command else []
    said = [element("li", typeset(note)) for note in notes(result)]
    said += [element("li", typeset(alarm), class_="alarm") for alarm in alarms(result)]
    parts = [
        element("h1" if alone else "h2", result.title or shown.label),
        element("p", [told, words], class_="verdicts"),
        [element("p", alarm, class_="alarm") for alarm in lost_note(result)],
        element("ul", said, class_="notes") if said else None,
    ]
    return markup(parts)


def _motion(result: Result, store: Store, among: int) -> Html:
    """Return the drawing with what moves it; of one among very many results a small one, folded away."""
    if among > several.DRAWINGS:
        return element("p", UNDRAWN, class_="note")
    small = among > several.WHOLE
    data = motion_data(result, store.arrays, 3.0 / among if small else 1.0)
    poses, samples = data["poses"], data["samples"]
    drawing = element(
        "svg", class_="scene", tabindex="0", role="img", aria_label=f"The mechanism of {result.title}. {HELP}"
    )
    words: list[str] = [element("span", data["caption"], class_="grid-caption")]
    if poses < samples:
        kept = ", those at moments of the run among them" if moments(result) else ""
        words.append(f" {poses} of {samples} samples are shown{kept}.")
    told = element("div", class_="told-body", hidden=True, role="group", aria_label="Chosen body")
    spare = None if small else still(result, store)
    content = [drawing, spare, _controls(data), told, _moments(result) if poses > 1 else None]
    content += [element("figcaption", words, element("span", f" {HELP}", class_="help"))]
    seen = [path for path in ("q", "qd", "tau", "reactions") if path in result or result.group(path)]
    content += [tables.errors_of(result, *seen)]
    figure = element("figure", content, class_="motion", data_figure=store.add(data))
    return element("details", element("summary", "Drawing"), figure, class_="drawing") if small else figure


def _looks(result: Result) -> dict[int, list[dict[str, Any]]]:
    """Return the looks of lines of the stored result, by how many there are of a quantity, and of one alone."""
    counts = {1, *(result[name].shape[1] for name in ("q", "qd", "tau") if name in result.variables)}
    return {count: looks(count) for count in sorted(counts)}


def _live(place: int, store: Store, live: Mapping[str, Any], result: Result) -> Html:
    """Return where the ``place``-th scene runs in the page; its script shows it, where there is WebAssembly."""
    number_of = store.run({**live, "looks": _looks(result)})
    note = LIVE_GIVEN if live.get("given") else LIVE
    buttons = {"again": "as in the scene", "keep": "keep this run beside others", "copy": "copy as --set"}
    content = [
        element("h3", "Other values, run in this page"),
        element("p", note, class_="note"),
        element("div", class_="keys"),
        element(
            "p", [element("button", words, type="button", class_=name) for name, words in buttons.items()]
        ),
        element("p", element("code", class_="settings")),
        element("p", class_="refused alarm", role="status"),
        element("table", element("tbody")),
        _sweep(),
        element("div", class_="plots"),
    ]
    return element(
        "figure", content, class_="live", id=f"live-{place}", data_live=str(number_of), hidden=True
    )


def _sweep() -> Html:
    """Return what asks for the curve of a figure over the range of a key."""
    counts = [
        element("option", f"{n} points", value=str(n), selected=n == USUAL or None)
        for n in (24, USUAL, 96, 192)
    ]
    asked = [
        element("select", aria_label="key"),
        element("select", aria_label="figure"),
        element("select", counts, aria_label="number of points"),
    ]
    return element(
        "details",
        element("summary", "a figure over the range of a key"),
        element("p", asked, class_="controls"),
        class_="sweep",
    )


def _controls(data: Mapping[str, Any]) -> Html:
    speeds = sorted({*SPEEDS, data["speed"]})
    choices = [
        element("option", f"{number(speed)}×", value=speed, selected=speed == data["speed"])
        for speed in speeds
    ]
    views = [element("option", camera["name"], value=k) for k, camera in enumerate(data["cameras"])]
    boxes = [
        element("label", element("input", type="checkbox", checked=on, data_layer=layer), words)
        for layer, words, on, there in _layers(data)
        if there
    ]
    motion = [
        element("button", "▶", class_="play", type="button", aria_label="Play"),
        element(
            "input",
            type="range",
            class_="time",
            min=0,
            max=data["poses"] - 1,
            value=0,
            step=1,
            aria_label="Time",
        ),
        element("span", class_="clock"),
        element("select", choices, class_="speed", aria_label="Speed"),
    ]
    looks = [
        element("select", views, class_="view", aria_label="View") if len(views) > 1 else None,
        element("button", "reset", class_="reset", type="button", aria_label="reset the view"),
        element("button", "full screen", class_="full", type="button", hidden=True),
        boxes,
    ]
    if data["bodies"]:
        names = [element("option", "none", value="")]
        names += [element("option", body["name"], value=k) for k, body in enumerate(data["bodies"])]
        looks.append(element("label", "body", element("select", names, class_="body")))
        if data["poses"] > 1:
            box = element("input", type="checkbox", class_="follow", disabled=True)
            looks.append(element("label", box, "follow"))
    moving = element("div", motion, class_="controls") if data["poses"] > 1 else None
    return markup([moving, element("div", looks, class_="controls")])


def _layers(data: Mapping[str, Any]) -> list[tuple[str, str, bool, bool]]:
    """Return what can be shown in a drawing: key, words, whether it is at first, whether there is any."""
    arrows = data["arrows"]
    return [
        ("arrows", "forces", True, any(not arrow["reaction"] for arrow in arrows)),
        ("reactions", "reactions", True, any(arrow["reaction"] for arrow in arrows)),
        ("trails", "paths", True, bool(data["trails"])),
        ("masses", "centres of mass", True, bool(data["masses"])),
        ("names", "names", False, True),
        ("frames", "frames", False, bool(data["bodies"])),
        ("ghosts", "ghosts", False, data["poses"] > 1),
    ]


def _moments(result: Result) -> Html | None:
    """Return buttons that go to the moments of the run."""
    marks = moments(result)
    if not marks:
        return None
    buttons = [
        element("button", f"{number(moment.time, 5)} s: {moment.text}", type="button", data_time=moment.time)
        for moment in marks[:LISTED]
    ]
    left = len(marks) - LISTED
    return element("p", buttons, f" and {left} more" if left > 0 else None, class_="moments")


# one after another they are the script of the page
SCRIPTS = (
    "words.js",
    "strokes.js",
    "surfaces.js",
    "player.js",
    "bodies.js",
    "axes.js",
    "charts.js",
    "pointing.js",
    "saved.js",
    "enlarged.js",
)
RUNNING = ("rules.js", "runner.js", "given.js", "sweep.js", "live.js")  # where scenes run in the page
BESIDE = ("several.js",)  # where there are several results
STYLE = "page.css"


def write_page(shown: Sequence[Shown], target: Path) -> int:
    """Write results into one page, whole or not at all; return its size in bytes.

    Raises
    ------
    CapabilityError : a result has poses, but this version cannot read its scene. OutputError : it cannot be written.
    """
    content = make_page(shown).encode()
    write_bytes(target, content)
    return len(content)


def make_page(shown: Sequence[Shown]) -> str:
    """Return the page of results, one below another, with a table of contents where there are several."""
    store = Store()
    alone = len(shown) == 1
    sections = [
        section(place, one, store, None if alone else len(shown)) for place, one in enumerate(shown, 1)
    ]
    titles = {one.result.title or one.label for one in shown}
    heading = f"{len(shown)} results" if len(titles) > 1 else titles.pop()
    main, beside = [element("main", sections)], {}
    if not alone:
        results, names = [one.result for one in shown], _names(shown)
        compared, beside["several"] = several.beside(names, results, store.arrays)
        main = [several.contents(names, results), element("main", compared, sections)]
    noscript = element(
        "p",
        "Drawings that move, and plots that zoom and are read at a cursor, need JavaScript.",
        class_="note",
    )
    body = [
        None if alone else element("header", element("h1", heading)),
        element("noscript", noscript),
        main if alone else element("div", main, class_="with-list"),
        element("footer", f"Made by robodyn {__version__}. This page fetches nothing and sends nothing."),
        json_block(
            {"arrays": store.arrays.packed, "figures": store.figures, **store.running, **beside}, "data"
        ),
    ]
    scripts = [*(RUNNING if store.running else ()), *(BESIDE if beside else ())]
    return _document(heading, markup(body), scripts)


def _names(shown: Sequence[Shown]) -> list[tuple[str, str]]:
    """Return the name of each result on the page, and what else the list says of it: titles where they tell apart."""
    titles = [one.result.title or one.label for one in shown]
    if len(set(titles)) == 1:
        return [(one.label, one.result.command) for one in shown]
    return [
        (title, f"{one.result.command} {one.label}")
        if titles.count(title) == 1
        else (f"{title} ({one.label})", one.result.command)
        for title, one in zip(titles, shown)
    ]


def _document(title: str, body: Html, scripts: Sequence[str]) -> str:
    """Return the page; scripts : beside those of every page. Where scenes run WebAssembly may be compiled."""
    names, runs = (*SCRIPTS, *scripts, "page.js"), any(name in RUNNING for name in scripts)
    script, style = Html("\n".join(_asset(name) for name in names)), Html(_asset(STYLE))
    wasm = " 'wasm-unsafe-eval'" if runs else ""
    policy = (
        f"default-src 'none'; script-src {_digest(script)}{wasm}; style-src {_digest(style)}; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    head = [
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("title", f"{title} - robodyn"),
        element("style", style),
    ]
    parts = (element("head", head), element("body", body, element("script", script)))
    return "<!doctype html>\n" + element("html", parts, lang="en") + "\n"


def _asset(name: str) -> str:
    return (files("robodyn_cli.report.page") / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    """Return the source expression of the policy that allows exactly this text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
