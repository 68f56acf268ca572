"""Pages of results without a browser: what is in them, how large they are, that text stays text, and mistakes."""

from __future__ import annotations

import base64
import dataclasses
import html
import itertools
import json
import re
import webbrowser
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from scipy.spatial.transform import Rotation

from robodyn_cli import simulate
from robodyn_cli.cli.app import run
from robodyn_cli.over.plan.plan import plan
from robodyn_cli.report.canvas import below_heading
from robodyn_cli.report.drawing.bodies import traced_bodies
from robodyn_cli.report.figures import shown_errors, shown_units
from robodyn_cli.report.numbers import typeset
from robodyn_cli.report.page.charts import Arrays, Store, captions, chart_data
from robodyn_cli.report.page.compared import SideBySide, compared, judged
from robodyn_cli.report.page.motion import MOST_POSES, chosen_samples, motion_data
from robodyn_cli.report.page.page import Shown, make_page
from robodyn_cli.report.page.plots import plot_of
from robodyn_cli.report.page.summary import summary_tables
from robodyn_cli.report.page.tables import Html, Quantity, element, errors_of, json_block, within, written
from robodyn_cli.report.page.verdict import verdicts
from robodyn_cli.report.registry import applicable, draw
from robodyn_cli.results.hdf5 import write
from robodyn_cli.results.moments import Moment
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.scene.text.leaves import leaves_of_text
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.linearise.linearise import linearise
from tests.unit.synthetic_results import (
    FOUR_BAR,
    chain_result,
    four_bar_result,
    inverse_result,
    pendulum_result,
)

CONFIGS = Path(__file__).parents[2] / "configs"
TURNING_AND_SLIDING = """
schema: 1
command: inverse
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: theta, type: revolute, axis: [0, 1, 0]}
    - {name: slide, type: prismatic, axis: [1, 0, 0]}
  links:
    - {name: arm, mass: 2, com: [0.2, 0, 0], inertia: {xx: 0.01, yy: 0.02, zz: 0.02}}
    - {name: carriage, mass: 1, com: [0, 0, 0], inertia: {xx: 0.01, yy: 0.01, zz: 0.01}}
trajectory: {type: joint, duration: 1, q: {theta: 0.3*sin(3*t), slide: 0.5 + 0.1*t^2}}
inverse: {samples: 11}
"""


def unpacked(arrays: Arrays, number: int) -> np.ndarray:
    item = arrays.packed[number]
    return np.frombuffer(base64.b64decode(item["data"]), dtype=f"<{item['type']}").reshape(item["shape"])


# -- markup and arrays ----------------------------------------------------------------------------------------
def test_text_is_escaped_and_markup_is_not() -> None:
    assert element(
        "p", 'a < b & "c"', Html("<b>d</b>"), ["e", None], class_='x"y', data_k=3, hidden=True
    ) == ('<p class="x&quot;y" data-k="3" hidden>a &lt; b &amp; &quot;c&quot;<b>d</b>e</p>')
    assert element("input", type="checkbox", checked=False) == '<input type="checkbox">'


def test_no_text_ends_a_block_of_json() -> None:
    data = {"title": "</script><!-- &\u2028", "x": [1.5, None]}
    block = json_block(data, "data")
    inside = re.fullmatch(r'<script type="application/json" id="data">(.*)</script>', block, re.DOTALL)
    assert inside is not None and not set("<>&\u2028") & set(inside[1])
    assert json.loads(inside[1]) == data


def test_arrays_are_stored_once_and_come_back() -> None:
    arrays, x = Arrays(), np.array([[1.0, np.nan], [1e300, -2.5e-7]])
    numbers = [arrays.put(x), arrays.put(x.copy()), arrays.put(x, double=True), arrays.put(x.ravel())]
    assert numbers == [0, 0, 1, 2]
    assert np.array_equal(unpacked(arrays, 1), x, equal_nan=True)
    assert np.allclose(unpacked(arrays, 0)[1, 1], x[1, 1], rtol=1e-7) and np.isinf(unpacked(arrays, 0)[1, 0])


# -- motion ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("most", [100, 1500])
@pytest.mark.parametrize("count", [1, 90, 1500, 20_001])
def test_samples_at_moments_are_kept(count: int, most: int) -> None:
    times = np.linspace(0.0, 7.0, count)
    happened = [Moment(time, "impact", "") for time in (0.0, 1.2345, 3.3, 6.999, 7.0)]
    found = chosen_samples(times, happened, most)
    assert len(found) <= max(most, min(count, most)) and (np.diff(found) > 0).all()
    assert found[0] == 0 and found[-1] == count - 1
    for moment in happened:
        at = int(np.argmin(np.abs(times - moment.time)))
        assert {at, max(at - 1, 0)} <= set(found.tolist())


def test_the_drawing_is_that_of_the_stored_poses() -> None:
    result = four_bar_result()
    store = Store()
    data = motion_data(result, store.arrays)
    assert data["poses"] == data["samples"] == len(result.time)
    vertices = unpacked(store.arrays, data["vertices"])
    crank = next(part for part in data["parts"] if part["name"] == "crank" and part["kind"] == "link")
    end = vertices[:, crank["vertices"][1]]
    theta = result["q"][:, 0]
    assert np.allclose(end, np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=1), atol=1e-6)
    assert np.array_equal(unpacked(store.arrays, data["times"]), result.time)
    assert unpacked(store.arrays, data["axes"]).shape[0] == 1, "axes that never turn are stored once"
    assert data["latches"][0]["closed"] == [[12.283, None]] and data["cameras"][0]["distance"] is None


@pytest.mark.parametrize("scene", ["seven_joint_arm", "double_pendulum"])
def test_what_bodies_do_agrees_with_differences(scene: str) -> None:
    """Velocities are the rates of places and attitudes; the centre of mass is that of the link as it is written."""
    run_, samples = (inverse, "inverse") if scene == "seven_joint_arm" else (simulate, "simulate")
    result = run_(load_scene(CONFIGS / f"{scene}.yaml", [f"{samples}.samples=4001"]))
    written_links = {link.name: link for link in load_scene_text(result.scene_text).robot.links}
    for body in traced_bodies(result, np.arange(4001)):
        place, attitude, rate, spin = np.split(body.tracks, [3, 7, 10], axis=1)
        turned = Rotation.from_quat(attitude[:, [1, 2, 3, 0]])
        assert body.centre is not None and body.mass == pytest.approx(written_links[body.name].mass)
        centre = place + turned.apply(body.centre)
        step = result.time[1] - result.time[0]
        slopes = (centre[2:] - centre[:-2]) / (2 * step)
        angles = (turned[2:] * turned[:-2].inv()).as_rotvec() / (2 * step)
        scale = 1.0 + np.abs(rate).max() + np.abs(spin).max()
        assert np.abs(slopes - rate[1:-1]).max() < 1e-3 * scale, body.name
        assert np.abs(angles - spin[1:-1]).max() < 1e-3 * scale, body.name
        assert body.torque is None or np.array_equal(
            body.torque[0], result["tau"][:, result.variables["tau"].names.index(body.joint)]
        )


def test_what_never_changes_of_a_body_is_one_number() -> None:
    store, result = Store(), four_bar_result()
    crank = next(body for body in motion_data(result, store.arrays)["bodies"] if body["name"] == "crank")
    assert crank["attitude"][1] == crank["attitude"][2] == 0.0 and crank["mass"] is None
    half = unpacked(store.arrays, crank["attitude"][0][0])
    assert np.allclose(np.abs(half), np.abs(np.cos(0.5 * result["q"][:, 0])), atol=1e-6)
    assert crank["place"] is None and isinstance(crank["vertex"], int), "its place is that of a vertex"


# -- charts ---------------------------------------------------------------------------------------------------
def test_lines_end_at_the_very_time_at_which_the_cursor_does() -> None:
    """Single precision ends a run of 0.7 s at 0.69999999, where the cursor at its end reads nothing."""
    result, arrays = inverse_result(), Arrays()
    result.time[:] = np.linspace(0.0, 0.7, len(result.time))
    data = chart_data(draw(result, "joint_angles"), arrays)
    assert data is not None and result.time[-1] == 0.7
    assert {unpacked(arrays, line["x"])[-1] for panel in data["panels"] for line in panel["lines"]} == {0.7}


def test_charts_show_what_the_figures_show() -> None:
    """Lines, units, scales and legends of every plot over time; others become pictures."""
    drawn = set()
    for result in (inverse_result(), pendulum_result(201), four_bar_result(), chain_result(12)):
        for name in applicable(result):
            figure, arrays = draw(result, name), Arrays()
            data = chart_data(figure, arrays)
            if data is None:
                continue
            drawn.add(name)
            shown = [ax for ax in figure.axes if ax.lines or ax.collections]
            assert len(shown) == len(data["panels"])
            curves = [line for panel in data["panels"] for line in panel["lines"] if not any(line["spans"])]
            entries = {k for k, entry in enumerate(data["legend"]) if entry["width"] and not entry["marker"]}
            assert curves and entries <= {line["entry"] for line in curves}, name
            for ax, panel in zip(shown, data["panels"]):
                assert panel["label"] == ax.get_ylabel() and panel["log"] == (ax.get_yscale() == "log")
                assert panel["y"] == pytest.approx(ax.get_ylim())
                for line, artist in zip(panel["lines"], ax.lines):
                    x, y = unpacked(arrays, line["x"]), unpacked(arrays, line["y"])
                    values = np.asarray(artist.get_ydata(), dtype=float)
                    assert np.nanmax(y) == pytest.approx(np.nanmax(values), rel=1e-6)
                    assert np.nanmin(y) == pytest.approx(np.nanmin(values), rel=1e-6)
                    assert len(x) == len(y) and line["thinned"] == (len(x) < len(values))
    assert {
        "joint_angles",
        "torques",
        "torque_terms",
        "energy",
        "multipliers",
        "constraint_residual",
    } <= drawn
    assert "tip_path" not in drawn and "mechanism" not in drawn
    assert chart_data(draw(chain_result(100), "joint_angles"), Arrays()) is None, "a map is a picture"


def test_a_picture_leaves_its_heading_to_the_page() -> None:
    """The rest of it is whole: no panel and no legend is cut off, and the title is printed no more."""
    for result, name in ((inverse_result(), "tip_path"), (four_bar_result(), "mechanism")):
        figure = draw(result, name)
        said = captions(figure)
        assert said and result.title not in said
        part = below_heading(figure)
        assert part is not None and part.height < figure.get_size_inches()[1] - 0.3
        renderer = FigureCanvasAgg(figure).get_renderer()
        for artist in (*figure.axes, *figure.legends):
            inside = artist.get_tightbbox(renderer).transformed(figure.dpi_scale_trans.inverted())
            assert inside.y1 <= part.y1 + 0.02 and inside.y0 >= part.y0 - 0.02, name
        heading = [text for text in figure.texts if any(text.get_text() in x for x in (result.title, *said))]
        assert len(heading) > len(said) and not any(text.get_visible() for text in heading)


def test_notes_of_a_figure_are_sentences_of_its_caption() -> None:
    """Each note stands whole, whatever lines it takes in the figure; one that is the heading is not said again."""
    result = chain_result(3)
    said = captions(draw(result, "joint_angles"))
    assert said == ["Joint angles", "No error is stated for this"]
    plot = str(plot_of(result, "joint_angles", Store()))
    assert f'<p class="caption">{said[1]}</p>' in plot
    plot = str(plot_of(inverse_result(), "torques", Store()))
    assert "thin line: root mean square; figures of the samples. No error is stated for this</p>" in plot


def test_dashes_tell_lines_apart_as_in_the_figure() -> None:
    data = chart_data(draw(chain_result(5), "joint_angles"), Arrays())
    assert data is not None
    looks = [(line["colour"], tuple(line["dashes"])) for line in data["panels"][0]["lines"]]
    assert len(set(looks)) == 5 and looks[0][1] == () and len(looks[1][1]) == 2
    assert [line["entry"] for line in data["panels"][0]["lines"]] == [0, 1, 2, 3, 4]


def test_lines_without_an_entry_are_hidden_with_the_line_of_their_colour() -> None:
    """Marks of peaks and root mean squares belong to their joint; what marks times belongs to none."""
    data = chart_data(draw(inverse_result(), "torques"), Arrays())
    assert data is not None
    lines = data["panels"][0]["lines"]
    assert sorted(line["of"] for line in lines) == [0, 0, 0, 1, 1, 1]
    assert [line["entry"] for line in lines].count(None) == 4
    data = chart_data(draw(four_bar_result(), "joint_angles"), Arrays())
    assert data is not None
    moments = [line for line in data["panels"][0]["lines"] if line["spans"][1]]
    assert moments and all(line["of"] is None for line in moments)


# -- tables ---------------------------------------------------------------------------------------------------
def test_errors_stand_beside_the_figures_they_belong_to() -> None:
    summary = {
        "error_estimate": {"method": "m", "q_max": 1e-9, "qd_max": 2e-8, "closure": {"position": 3e-12}},
        "energy_drift": 4e-7,
        "after_lock": {"error_estimate": {"qd_max": 5e-6}},
    }
    expected = {
        "q": ["1·10⁻⁹", "3·10⁻¹²"], "qd": ["2·10⁻⁸", "5·10⁻⁶"], "energy": ["4·10⁻⁷"], "constraints/multipliers": [],
    }  # fmt: skip
    result = four_bar_result()
    result.summary = summary
    for path, values in expected.items():
        assert re.findall(r" ([0-9][^ ]*)", errors_of(result, path) or "") == values
    assert "after the lock: largest error of qd 5·10⁻⁶ rad/s or m/s" in (errors_of(result, "qd") or "")
    assert "largest error of q 1·10⁻⁹ rad;" in (errors_of(result, "q") or ""), "all joints turn"
    assert errors_of(result, "unknown") is None
    result.summary = {}
    assert errors_of(result, "q") is None


def test_summaries_become_tables_whatever_is_in_them() -> None:
    rows = [{"method": f"m{k}", "error": 10.0**-k, "status": "ok"} for k in range(300)]
    text = "".join(summary_tables({
        "status": "ok", "samples": 3, "none": None, "flag": True, "empty": {}, "words": ["a", "b"],
        "runs": rows, "joints": {"q1": {"peak": 1.5}, "q2": {"rms": 2.0}}, "deep": {"a": {"b": {"c": 1}}, "d": -2},
    }, lambda key: ""))  # fmt: skip
    for part in ("<th scope=\"row\">samples</th><td>3</td>", "<td>–</td>", "<td>yes</td>", "<td>a, b</td>", "<td>none</td>",
                 "The first 200 of 300 rows", "<th scope=\"row\">q2</th>", "<td>−2</td>"):  # fmt: skip
        assert part in text, part
    assert text.count("<tr>") < 260 and "m299" not in text


def test_figures_of_a_page_have_their_units() -> None:
    """Numbers of each command's summary that are declared with a unit stand with it, those of joints with their own."""
    result = inverse(load_scene_text(TURNING_AND_SLIDING))
    text = "".join(summary_tables(result.summary, shown_units(result)))
    for key, unit in (("theta", "N·m"), ("slide", "N")):
        peak = written(Quantity(result.summary["joints"][key]["peak_torque"], unit))
        assert peak.endswith(f" {unit}") and f">{peak}</td>" in text, peak
    low, high = result.summary["joints"]["slide"]["torque_range"]
    assert f"{written(low)} to {written(high)} N</td>" in text
    assert f"{written(result.summary['wall_time_s']['total'])} s</td>" in text
    study = Result("sweep", "", "ok", "", summary={"results": {"lock.time": {"minimum": 1.5, "unit": "s"}}})
    assert ">1.5 s</td>" in "".join(summary_tables(study.summary, shown_units(study)))


@pytest.mark.parametrize("law, unit", [("", "1/s"), ("period: 0.01, ", "per sample")])
def test_tables_of_poles_and_modes_have_plain_figures_and_units(law: str, unit: str) -> None:
    """The first column has its unit, too; a pole that of its loop; amplitude and phase one each."""
    control = f"control={{type: pd, {law}joints: [theta1, theta2], gains: {{kp: 900, kd: 90}}}}"
    result = linearise(load_scene(CONFIGS / "double_pendulum.yaml", [control]))
    text = html.unescape("".join(summary_tables(result.summary, shown_units(result), shown_errors(result))))
    for pole in result.summary["closed_loop"]["poles"]:
        assert f">{written(Quantity(pole['real'], unit, pole['error']))}<" in text
    for mode in result.summary["modes"]:
        assert f">{written(Quantity(mode['real'], '1/s', mode['error']))}<" in text
        assert f">{written(Quantity(mode['frequency'], 'Hz', mode['frequency_error']))}<" in text
        amplitude, phase = mode["shape"]["theta1"]
        assert f">{written([amplitude, Quantity(phase, 'rad')])}<" in text and ">shape: theta1<" in text
    for word in ("Quantity", "of·a·sampled", "and·rad"):
        assert word not in text


def test_the_plan_is_on_the_page(tmp_path: Path) -> None:
    result = inverse(load_scene(CONFIGS / "2r_circle.yaml", ["inverse.samples=11"]))
    stored, target = write(result, tmp_path / "result.h5"), tmp_path / "r.html"
    found = plan(load_scene_text(result.scene_text), "inverse")
    assert run(["report", str(stored), "--file", str(target), "--quiet"]) == 0
    page = target.read_text(encoding="utf-8")
    assert "Terms kept" in page and "Terms left out" in page
    for term, cost in (
        *((t, t["operations"]) for t in found["kept"]),
        *((t, t["operations_saved"]) for t in found["left_out"]),
    ):
        number = "<td>–</td>" if cost is None else f'<td class="number">{cost}</td>'
        assert f'<th scope="row">{escape(term["term"])}</th>{number}<td>{escape(term["reason"])}</td>' in page
    assert run(["report", str(stored), "--file", str(target), "--quiet", "--no-plan"]) == 0
    assert "Terms kept" not in target.read_text(encoding="utf-8")


def test_a_number_with_its_error_covers_the_number() -> None:
    """What is printed, plus and minus the printed error, holds the value plus and minus its own."""
    random = np.random.default_rng(5)
    for value, error in zip(random.normal(size=300) * 10.0 ** random.integers(-9, 9, 300), 10.0 ** random.uniform(-14, 6, 300)):  # fmt: skip
        shown = within(float(value), float(error)).replace("−", "-")
        plain = re.sub(
            "·10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)",
            lambda m: "e" + m[1].translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")),
            shown,
        )
        middle, off = map(float, plain.split(" ± "))
        room = 1e-15 * abs(value)
        assert middle - off <= value - error + room and value + error <= middle + off + room, (
            value,
            error,
            shown,
        )
        assert off <= 2.6 * max(error, 2e-15 * abs(value)), "no more than its first digit is rounded"
    assert within(-4.0e-14, 9e-12) == "0 ± 1·10⁻¹¹"
    assert within(9.1455, 17.4) == "10 ± 20" and within([1.25, -2.5], 0.001) == "1.250, −2.500 ± 0.001"
    assert typeset("at t = 0.7783 +- 7.6e-15 s") == "at t = 0.7783 ± 7.6·10⁻¹⁵ s"
    assert typeset("2.626 ± 7e-12 N m") == "2.626 ± 7·10⁻¹² N·m" and typeset("-0.5 at q-1") == "−0.5 at q-1"


def test_nested_values_are_tables_with_errors_beside() -> None:
    """No cell of the duty of motors holds names and numbers in a row; errors stand beside what they are of."""
    result = inverse(load_scene(CONFIGS / "2r_drives.yaml"))
    text = "".join(summary_tables(result.summary, shown_units(result), shown_errors(result)))
    cells = [html.unescape(cell) for cell in re.findall("<td[^>]*>(.*?)</td>", text)]
    assert not [cell for cell in cells if re.search(r"[a-z]_[a-z]+ [\d−]", cell)]
    for name, drive in result.summary["drives"].items():
        margin = within(drive["margin"], drive["errors"]["margin"])
        use = drive["limits"]["peak"]
        assert margin in cells and within(use["use"], use["use_error"]) in cells, name
    assert "use error" not in text and ">units<" not in text


def test_matrices_and_maps_alike_stand_side_by_side() -> None:
    summary = {
        "m": [[1.0, -2.0], [3.0, 4.5]],
        "end": {"time": 2.0, "q": {"a": 1.0, "b": 2.0}, "qd": {"a": 3.0, "b": 4.0}},
    }
    text = "".join(summary_tables(summary, lambda key: ""))
    assert '<th scope="row">1</th><td class="number">1</td><td class="number">−2</td>' in text
    assert '<th scope="row">a</th><td class="number">1</td><td class="number">3</td>' in text


DUTY = {
    **dict.fromkeys(("motor", "gear", "brake")),
    "count": 1,
    "shaft": {"rms_torque": 1.0},
    "margin": 0.1,
    "decides": "peak",
    "errors": {"margin": None},
}


@pytest.mark.parametrize(
    "status, summary, words, alarming",
    [
        ("ok", {}, ["ok", "no warnings"], []),
        ("ok", {"stability": "unstable"}, ["ok", "unstable"], ["unstable"]),
        ("ok", {"stability": "unstable", "closed_loop": {"stability": "stable", "about": "x", "poles": []}},
         ["ok", "unstable without control", "stable with the controller"], []),
        ("undersized", {"drives": {"a": {"passes": False, **DUTY}, "b": {"passes": True, **DUTY}}},
         ["undersized", "drive too small: a"], ["undersized", "drive too small: a"]),
        ("ok", {"motorisation": {"a": {"met": True}}}, ["ok", "margins of motorisation suffice"], []),
        ("ok", {"error_estimate": {"meaningful_until": 4.25}}, ["ok", "not meaningful after 4.25 s"],
         ["not meaningful after 4.25 s"]),
        ("failed", {"termination": {"time": 0.5, "reason": "steps"}}, ["failed", "ended at 0.5 s"],
         ["failed", "ended at 0.5 s"]),
        ("ok", {"warnings": ["a", "b"]}, ["ok", "2 warnings"], ["2 warnings"]),
        ("ok", {"failed": {"share": 0.25}}, ["ok", "25 % of the runs failed"], ["25 % of the runs failed"]),
    ],
)  # fmt: skip
def test_the_header_says_what_became_of_a_run(
    status: str, summary: dict[str, Any], words: list[str], alarming: list[str]
) -> None:
    result = Result("simulate", "t", status, FOUR_BAR, summary={"status": status, **summary})
    found = verdicts(result)
    assert [one.words for one in found] == words and [one.words for one in found if one.alarming] == alarming
    assert all(f">{escape(one.words)}</strong>" in make_page([Shown("r", result)]) for one in found)


def test_a_yield_that_nobody_asked_for_is_not_shown() -> None:
    share = {"share": 0.0, "low": 0.0, "high": 0.2}
    for summary, there in (({"yield": share}, False), ({"yield": share, "least_yield": 0.9}, True),
                           ({"yield": {**share, "share": 0.5}}, True)):  # fmt: skip
        assert ("yield</" in "".join(summary_tables(summary, lambda key: ""))) is there


# -- pages ----------------------------------------------------------------------------------------------------
def test_a_page_is_small_says_what_is_thinned_and_is_the_same_every_time() -> None:
    result = four_bar_result()
    page = make_page([Shown("deploy", result)])
    assert len(page.encode()) < 1e6 and page == make_page([Shown("deploy", result)])
    assert "samples are shown" not in page
    long = make_page([Shown("deploy", four_bar_result(20_001))])
    shown = re.search(r"(\d+) of 20001 samples are shown, those at moments of the run among them", long)
    assert shown is not None and 1400 < int(shown[1]) <= MOST_POSES and "are thinned" in long
    assert not re.search(r"(src|href)=\"(?!data:|#)", page)


@pytest.mark.parametrize("command", ["work-precision", "sweep", "info", "plan"])
def test_results_without_poses_have_their_tables(command: str) -> None:
    result = Result(
        command,
        "no motion",
        "ok",
        FOUR_BAR,
        summary={"status": "ok", "cases": [{"run": 1, "why": "largest"}]},
    )
    page = make_page([Shown("r", result)])
    assert '<th scope="col">why</th>' in page and 'class="scene"' not in page


# -- commands -------------------------------------------------------------------------------------------------
def test_the_command_writes_the_page_and_view_opens_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    places = [write(four_bar_result(60), tmp_path / f"{name}.h5") for name in "ab"]
    target = tmp_path / "r.html"
    assert run(["report", *map(str, places), "--file", str(target), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report == {"status": "ok", "file": str(target), "results": 2, "size": target.stat().st_size}
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: opened.append(url) or True)
    assert run(["view", str(places[0]), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    made = Path(report["file"])
    assert (
        report["opened"]
        and opened == [made.as_uri()]
        and made.read_text(encoding="utf-8").startswith("<!doctype html>")
    )
    monkeypatch.setattr(webbrowser, "open", lambda url: False)
    assert run(["view", str(places[0])]) == 0
    assert "no browser was found" in capsys.readouterr().err


def test_mistakes_are_one_message_and_leave_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    result = four_bar_result(60)
    stored = write(result, tmp_path / "result.h5")
    foreign, damaged = tmp_path / "foreign.h5", tmp_path / "damaged.h5"
    foreign.write_text("not HDF5")
    damaged.write_bytes(stored.read_bytes()[:2000])
    old = write(dataclasses.replace(result, scene_text="schema: 1\nrobot: {}\n"), tmp_path / "old.h5")
    cases: list[tuple[list[Any], int, str]] = [
        ([stored, "--file", "a.pdf"], 2, "allowed: a name that ends with .html"),
        ([stored], 2, "--file"),
        ([foreign, "--file", "a.html"], 2, "cannot be read as HDF5"),
        ([stored, damaged, "--file", "a.html"], 2, "cannot be read as HDF5"),
        ([stored, old, "--file", "a.html"], 2, f"{old}: the scene stored in the result cannot be read"),
        ([tmp_path / "none", "--file", "a.html"], 2, "no such file"),
        ([stored, "--file", "nowhere/a.html"], 74, "cannot write nowhere"),
    ]
    place = tmp_path / "empty"
    place.mkdir()
    monkeypatch.chdir(place)
    for words, code, message in cases:
        assert run(["report", *map(str, words)]) == code, words
        said = capsys.readouterr().err
        assert message in said and said.count("robodyn: error:") == 1, said
        assert list(place.iterdir()) == [], words


# -- several results ------------------------------------------------------------------------------------------
def test_figures_differ_beyond_their_errors_or_within_them() -> None:
    for first, second, mark in (
        (Quantity(1.0, "s", 0.1), Quantity(1.15, "s", 0.1), "within"),
        (Quantity(1.0, "s", 0.1), Quantity(1.25, "s", 0.1), "differ"),
        (Quantity(1.0, "s", 0.1), None, ""),
        (Quantity(1.0, "s", 0.1), Quantity(1.0, "s", 0.0), ""),
        (1.0, 1.0 + 1e-15, "open"),
        (Quantity(1.0, "s", 0.1), Quantity(7.0, "s"), "open"),
        (Quantity(1.0, "N", 0.1), Quantity(1.0, "N m", 0.1), "differ"),
        (2, 3, "differ"),
        ("a", "a", ""),
        ("a", "b", "differ"),
    ):
        assert SideBySide("x", [first, second]).mark == mark, (first, second)


def test_several_figures_are_judged_as_the_pair_that_is_most_apart() -> None:
    values = np.random.default_rng(4).normal(size=(200, 5))
    errors = np.random.default_rng(5).exponential(1.5, size=(200, 5))
    rank = ["", "within", "differ"]
    marks = set()
    for row in zip(values.tolist(), errors.tolist()):
        figures = [Quantity(x, "m", e) for x, e in zip(*row)]
        pairs = [judged(pair) for pair in itertools.combinations(figures, 2)]
        marks.add(SideBySide("x", figures).mark)
        assert SideBySide("x", figures).mark == max(pairs, key=rank.index)
        assert judged([*figures, Quantity(0.0, "m")]) == ("differ" if "differ" in pairs else "open")
    assert marks == {"within", "differ"}


def test_scenes_are_told_apart_by_their_keys() -> None:
    first = leaves_of_text(TURNING_AND_SLIDING)
    second = leaves_of_text(TURNING_AND_SLIDING.replace("mass: 2", "mass: 3"))
    assert {key for key in first if first[key] != second[key]} == {"robot.links.arm.mass"}
    assert first["gravity"] == "[0, 0, -9.81]" and leaves_of_text("{") == {}
    texts = [TURNING_AND_SLIDING, TURNING_AND_SLIDING.replace("mass: 2", "mass: 3")]
    found = compared([inverse(load_scene_text(text)) for text in texts])
    given = [one for one in found if one.given]
    assert [(one.name, one.values) for one in given] == [("robot.links.arm.mass", ["2", "3"])]
    by_name = {one.name: one for one in found}
    assert by_name["joints.theta.peak_torque"].mark == "differ"
    assert by_name["joints.theta.peak_speed"].mark == "" and "wall_time_s.total" not in by_name


def test_a_page_of_very_many_results_stays_small() -> None:
    """Its table has a row a result, each figure with its error; drawings are small, and plots of each are left out."""
    results = [four_bar_result(301) for _ in range(30)]
    for k, result in enumerate(results):
        result.summary["lock"] = {"time": 12.0 + 0.01 * k, "time_error": 1e-9, "kind": "dead_point"}
    page = make_page([Shown(f"r{k}", result) for k, result in enumerate(results)])
    assert len(page) < 3e6 and page.count('<details class="drawing">') == 30 and 'class="plot"' not in page
    block = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert block and all(one["poses"] <= MOST_POSES * 3 / 30 + 1 for one in json.loads(block[1])["figures"])
    assert page.count("<tr data-of=") == 30 and ">12.290000000 ± 1·10⁻⁹ s</td>" in page
    few = make_page([Shown(f"r{k}", result) for k, result in enumerate(results[:2])])
    assert few.count('class="scene"') == 2 and '<tr class="differ figure"' in few


def test_what_says_the_same_stands_once_beside_one_another() -> None:
    """Keys that are declared to have the same as another do have its kind, unit and errors."""
    times = {"10": 1.5, "100": 2.0}
    result = four_bar_result()
    result.summary["criteria"] = {"growth_times": times, "errors": {"growth": 0.1}}
    result.summary["lock"] |= {"growth_times": times, "multiplier_growth": {"times": times}}
    names = [one.name for one in compared([result, result])]
    assert [name for name in names if name.endswith(".100")] == ["criteria.growth_times.100"]
    del result.summary["criteria"]["growth_times"]
    names = [one.name for one in compared([result, result])]
    assert {name for name in names if name.endswith(".100")} == {
        "lock.growth_times.100", "lock.multiplier_growth.times.100"
    }  # fmt: skip
    for key in ("lock.growth_times", "lock.multiplier_growth.times"):
        own = leaf_of("deploy", f"{key}.100")
        assert own is not None
        other = leaf_of("deploy", f"{own.fact.same_as}.100")
        assert other is not None and (own.kind, own.errors) == (other.kind, other.errors)
        assert (own.fact.unit, own.fact.names) == (other.fact.unit, other.fact.names)
