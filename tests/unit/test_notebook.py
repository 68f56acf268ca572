"""A result in a notebook: tables, errors, pictures, plots."""

from __future__ import annotations

import base64
import io
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest

import robodyn
from robodyn_cli import assemble, deploy, inverse, kinematics, load_scene, simulate, statics
from robodyn_cli.errors import CapabilityError
from robodyn_cli.report.cells import figure
from robodyn_cli.report.figures import notes, tables
from robodyn_cli.report.page.tables import main_figures
from robodyn_cli.results.report import Report
from robodyn_cli.scene import load_scene_text
from tests.unit.synthetic_results import inverse_result

CONFIGS = Path(__file__).parents[2] / "configs"
RUNS = {
    "inverse": (inverse, "2r_circle"),
    "simulate": (simulate, "tumbling_body"),
    "deploy": (deploy, "four_bar_deploy"),
    "kinematics": (kinematics, "mechanisms/four_bar_kinematics"),
    "statics": (statics, "mechanisms/balanced_four_bar"),
    "assemble": (assemble, "four_bar_deploy"),
}


class Page(HTMLParser):
    """Rows of the tables, texts and pictures; every element that is opened is closed, in its order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.pictures: list[str] = []
        self.text = ""
        self.open: list[str] = []
        self.names: set[str] = set()
        self.feed(text)
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.add(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag == "img":
            self.pictures.append(str(dict(attrs)["src"]))
        elif tag != "br":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += plain(data)


def plain(text: str) -> str:
    """Return what is printed as it is typed: 2e-13 for 2·10⁻¹³, a space for a product of units."""
    typed = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−–", "-0123456789--")
    text = re.sub("·10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", lambda found: f"e{found[1].translate(typed)}", text)
    return text.replace("²", "^2").replace("·", " ").translate(typed)


@pytest.mark.parametrize("command", RUNS)
def test_every_command_shows_its_figures_and_its_mechanism(command: str) -> None:
    run, scene = RUNS[command]
    result = run(load_scene(CONFIGS / f"{scene}.yaml"))
    page = Page(result._repr_html_())
    assert result.title in page.text and f"{command}: {result.status}" in page.text
    assert all(any(row) for row in page.rows), "no row of empty headers, which would be read aloud"
    names = [row[0] for row in page.rows]
    for name in result.variables["q"].names:
        assert name in names
    (picture,) = page.pictures
    kind, _, data = picture.partition(",")
    assert kind == "data:image/png;base64"
    image = matplotlib.image.imread(io.BytesIO(base64.b64decode(data)))
    assert image.shape[1] > 500 and len(np.unique(image[..., 0])) > 20, "the drawing is not empty"


def test_the_error_of_a_figure_stands_beside_it() -> None:
    result = simulate(load_scene(CONFIGS / "double_pendulum.yaml"))
    (table,) = tables(result)
    error = result.summary["error_estimate"]["q_end"]
    value, bound, unit = re.fullmatch(r"(\S+) ± (\S+) (\S+)", str(table.rows[0][1])).groups()
    assert float(value) == pytest.approx(result["q"][-1, 0], rel=1e-9)
    assert error <= float(bound) <= 2.0 * error and unit == "rad"
    assert any(text.startswith("largest error of q ") for text in notes(result))
    without = simulate(load_scene(CONFIGS / "double_pendulum.yaml", ["simulate.error_estimate=false"]))
    assert "±" not in str(tables(without)[0].rows[0][1])
    locked = deploy(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    assert re.match(r"locked at t = 12\.282995609\d+ ± \S+e-1\d s: dead point", notes(locked)[0])


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (12.28299560963, 2e-13, "12.2829956096300 ± 2e-13 m"),
        (12.28299560963, 0.03, "12.28 ± 0.04 m"),
        (12.28299560963, 0.0301, "12.28 ± 0.04 m"),
        (0.0802284, 0.05, "0.08 ± 0.06 m"),
        (168.4, 30.0, "170 ± 40 m"),
        (2.5e-9, 3e-11, "2.50e-09 ± 3e-11 m"),
        (0.1 + 0.2, 0.0, "0.3 ± 0 m"),
        (1.5, math.nan, "1.5 m"),
        (-4.01557e-14, 8.7e-12, "0 ± 9e-12 m"),
        (4e-13, 8.7e-12, "0 ± 1e-11 m"),
        (1.0, None, "1 m"),
        (0.0, 1e-9, "0 ± 1e-09 m"),
        (None, 1e-9, "-"),
        (True, None, "True"),
    ],
)
def test_digits_follow_the_error(value: Any, error: float | None, shown: str) -> None:
    assert figure(value, error, "m") == shown


def test_texts_of_a_scene_are_no_markup() -> None:
    result = inverse_result()
    result.title = "<script>alert(1)</script>"
    result.summary = {"joints": {}, "warnings": ["a < b & <b>"]}
    page = Page(result._repr_html_())
    assert (
        "script" not in page.names and "<script>alert(1)</script>" in page.text and "a < b & <b>" in page.text
    )


def test_long_tables_say_what_is_left_out() -> None:
    result = simulate(load_scene(CONFIGS / "double_pendulum.yaml"))
    joints = {f"j{k}": 0.1 * k for k in range(40)}
    result.summary["final"] = {"time": 1.0, "q": joints, "qd": joints}
    page = Page(result._repr_html_())
    assert len(page.rows) == 13 and "and 28 more" in page.text


def test_a_failed_run_says_so() -> None:
    result = inverse_result()
    result.status, result.summary = "failed", {"termination": {"reason": "step size underflow"}}
    assert "failed: step size underflow" in Page(result._repr_html_()).text


def test_a_line_for_the_terminal() -> None:
    assert repr(inverse_result()).startswith("<Result of inverse, ") and len(repr(inverse_result())) < 200


def test_plots_show_themselves_and_can_be_stored(tmp_path: Path) -> None:
    result = inverse_result()
    figure = result.plot("torques")
    assert figure._repr_png_()[:8] == b"\x89PNG\r\n\x1a\n"  # type: ignore[attr-defined]
    figure.savefig(tmp_path / "torques.svg")
    assert (tmp_path / "torques.svg").stat().st_size > 1000
    with pytest.raises(CapabilityError, match=r"no plot 'torque' of this result; possible: .*torques"):
        result.plot("torque")


ASKED: dict[str, Any] = {
    "optimise": lambda: robodyn.optimise(CONFIGS / "search" / "spring_balance.yaml", starts=1, jobs=1),
    "sensitivity": lambda: robodyn.sensitivity(
        CONFIGS / "2r_circle.yaml", to="robot.links.link2.mass", of="peak_torque.theta1", jobs=1
    ),
    "linearise": lambda: robodyn.linearise(CONFIGS / "double_pendulum.yaml", at="balance"),
    "crosscheck": lambda: robodyn.crosscheck(CONFIGS / "2r_circle.yaml", with_="pinocchio"),
}
# what a row of each says: a value with its error
ROWS = {
    "optimise": ("forces.spring.stiffness", r"122\.62\d+ ± \S+e-\d+ N/m"),
    "sensitivity": ("robot.links.link2.mass", r"9\.9428789\d* ± \S+e-\d+ N m/kg"),
    "linearise": ("0 ± 2.6271i 1/s", r"\S+e-1\d 1/s"),
    "crosscheck": ("tau", r"\S+e-\d+"),
}


@pytest.mark.parametrize("command", ASKED)
def test_what_asks_commands_shows_its_figures(command: str) -> None:
    if command == "crosscheck":
        pytest.importorskip("pinocchio")
    page = Page(ASKED[command]()._repr_html_())
    name, value = ROWS[command]
    (row,) = [row for row in page.rows if row[0] == name]
    assert re.fullmatch(value, row[1]), row
    assert not re.search(r"\de[-+]\d", page.text)


def test_tables_say_what_their_columns_are() -> None:
    result = inverse(load_scene(CONFIGS / "2r_circle.yaml"))
    (table,) = tables(result)
    told = dict(part.split(": ", 1) for part in table.meaning.split("; "))
    assert set(told) == set(table.head[1:]) - {"at"}
    assert told["energy"].startswith("integral of the positive mechanical power")
    assert table.meaning in Page(result._repr_html_()).text and f"{table.meaning}." in str(
        main_figures(result)
    )
    moved = kinematics(load_scene(CONFIGS / "mechanisms/four_bar_kinematics.yaml"))
    assert not any("smallest: " in one.meaning or "`" in one.meaning for one in tables(moved))


PENDULUM = """\
schema: 1
title: Pendulum
gravity: [0, -9.81, 0]
robot:
  joints: [{name: hinge, type: revolute, axis: [0, 0, 1], damper: {damping: 0.2}}]
  links: [{name: rod, mass: 2, com: [0.4, 0, 0], inertia: {zz: 0.11}}]
initial: {q: {hinge: 30 deg}}
simulate: {duration: 2, samples: 101}
outputs: {response: true}
trajectory: {type: joint, duration: 2, q: {hinge: 45 deg}}
"""


def test_a_controller_shows_its_gains_how_it_follows_and_its_response() -> None:
    result = simulate(
        load_scene_text(f"{PENDULUM}control: {{type: pid, gains: {{kp: 60, ki: 40, kd: 6}}}}\n")
    )
    page = Page(result._repr_html_())
    heads = {tuple(row) for row in page.rows}
    assert ("gains", "position", "rate", "integral") in heads and ("hinge [N m]", "60", "6", "40") in heads
    own = result.summary
    told = [row for row in page.rows if row[0] == "hinge"]
    assert len(told) == 3 and len(page.pictures) == 2  # its last state, its way, its response
    followed, response = told[1:]
    peak, rise = own["control"]["tracking"]["hinge"], own["response"]["hinge"]
    for cell, value, error, unit in (
        (followed[1], peak["peak"], peak["errors"]["peak"], "rad"),
        (response[2], rise["rise"], rise["errors"]["rise"], "s"),
        (response[6], rise["effort"], rise["errors"]["effort"], r"\(N m\)\^2 s"),
    ):
        shown, bound = re.fullmatch(rf"(\S+) ± (\S+) {unit}", cell).groups()  # type: ignore[union-attr]
        assert float(shown) == pytest.approx(value, rel=1e-5) and float(bound) >= error


def test_a_regulator_shows_its_gains_with_their_errors_and_the_poles_of_its_loop() -> None:
    law = "{type: lqr, pose: {hinge: 90 deg}, gains: {q: 10, qd: 1, tau: 0.1}}"
    result = simulate(
        load_scene_text(f"{PENDULUM}control: {law}\n".replace("outputs: {response: true}\n", ""))
    )
    rows = {row[0]: row[1:] for row in Page(result._repr_html_()).rows}
    gain = result.summary["control"]["gains"]["hinge"]["qd.hinge"]
    assert rows["gain of"] == ["hinge [N m]"] and rows["pole of the loop [1/s]"] == ["off by"]
    assert re.fullmatch(rf"{gain:.5g}\d* ± \S+e-1\d", rows["qd.hinge [rad/s]"][0])


def test_a_loop_shows_its_margins_and_whether_it_is_stable() -> None:
    law = "type: pid, gains: {kp: 60, ki: 40, kd: 6}"
    for more, limit in ((", period: 0.01, delay: 0.013", False), ("", True)):
        result = robodyn.linearise(load_scene_text(f"{PENDULUM}control: {{{law}{more}}}\n"))
        page = Page(result._repr_html_())
        (row,) = [row for row in page.rows if row[0] == "hinge"]
        assert (row[1] == "no limit") == limit and re.fullmatch(r"\S+ ± \S+ rad", row[3])
        assert "loop with the controller: stable" in page.text
        assert ["pole without control", "off by", "damping"] in page.rows
        assert [f"pole of the loop [{'1/s' if limit else 'per sample'}]", "off by"] in page.rows


@pytest.mark.parametrize(("suffix", "named"), [(".gif", "alt"), (".mp4", "aria-label"), (".html", "title")])
def test_what_commands_make_has_a_name_for_those_who_listen(suffix: str, named: str) -> None:
    """The first line that the command says, as text."""
    shown = Report({}, 'a "swing" & <b>\nmore', 0, (b"GIF89a", suffix))._repr_html_()
    assert f'{named}="a &quot;swing&quot; &amp; &lt;b&gt;"' in shown
