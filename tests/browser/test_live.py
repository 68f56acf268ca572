"""Scenes that run in a page, in a real browser: sliders, drawing, figures with errors, what is left to the command."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from robodyn_cli.over.live.pages import live_parts
from robodyn_cli.report.page.page import Shown, make_page, write_page
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene
from robodyn_cli.works.deploy.deploy import deploy
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.kinematics import kinematics
from robodyn_cli.works.simulate import simulate
from tests.browser.conftest import Opener, barriers
from tests.mechanisms import CONFIGS

MASS, ANGLE = ("robot.links.crank.mass", "5", "60"), ("initial.q.theta1", "0.5 deg", "17 deg")
ADDED = 150_000  # bytes, at most, that running adds to the page


@pytest.fixture(scope="module")
def four_bar() -> Result:
    return deploy(load_scene(CONFIGS / "four_bar_deploy.yaml"))


@pytest.fixture(scope="module")
def live_page(four_bar: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("live") / "four_bar.html"
    write_page([Shown("deploy", four_bar, live=live_parts([four_bar], [MASS, ANGLE])[0])], target)
    return target


def running(opened: Opener, file: Path, **options: Any) -> Any:
    page = opened(file, **options)
    page.locator("html[data-running]").wait_for(state="attached", timeout=20_000)
    page.locator(".live[data-runs='1']").wait_for()
    return page


def figures(page: Any) -> dict[str, str]:
    rows = page.locator(".live tbody tr").all()
    return {row.locator("th").inner_text(): row.locator("td").inner_text() for row in rows}


def number_of(text: str) -> float:
    return float(re.match(r"-?[\d.]+", text.replace("−", "-")).group())  # type: ignore[union-attr]


def slide(page: Any, k: int, value: float) -> None:
    before = int(page.locator(".live").get_attribute("data-runs"))
    page.locator(".live input[type=range]").nth(k).evaluate(
        "(slider, x) => { slider.value = x; slider.dispatchEvent(new Event('input')); }", value
    )
    page.locator(f".live[data-runs='{before + 1}']").wait_for()


def test_a_slider_runs_the_scene_at_once(live_page: Path, four_bar: Result, opened: Opener) -> None:
    page = running(opened, live_page)
    lock = four_bar.summary["lock"]["time"]
    told = figures(page)["time of the lock"]
    assert abs(number_of(told) - lock) < 1e-11 and "± " in told and told.endswith(" s")
    poses = page.locator(".scene").evaluate("svg => svg.closest('figure').querySelector('.time').max")
    slide(page, 0, 40.0)
    assert number_of(figures(page)["time of the lock"]) > lock + 2.0
    assert page.locator(".live .settings").inner_text() == ""
    page.locator(".live .copy").click()
    assert page.locator(".live .settings").inner_text() == "--set robot.links.crank.mass=40"
    clock = page.locator(".clock")
    page.locator(".time").evaluate("s => { s.value = s.max; s.dispatchEvent(new Event('input')); }")
    assert number_of(clock.inner_text().removeprefix("t = ")) > lock + 2.0, "the drawing shows this run"
    page.locator(".live .again").click()
    page.locator(".live[data-runs='3']").wait_for()
    assert number_of(figures(page)["time of the lock"]) == pytest.approx(lock, abs=1e-11)
    assert page.locator(".time").get_attribute("max") == poses, "the stored drawing is back"


def test_keys_and_a_second_run_beside(live_page: Path, opened: Opener) -> None:
    page = running(opened, live_page)
    first = figures(page)["time of the lock"]
    page.locator(".live .keep").click()
    assert page.locator(".live .keep").get_attribute("aria-pressed") == "true"
    page.locator(".live input[type=range]").first.focus()
    page.keyboard.press("ArrowRight")
    page.locator(".live[data-runs='2']").wait_for()
    assert figures(page)["time of the lock"] != first
    page.locator(".live .plots").scroll_into_view_if_needed()
    page.locator(".live .plots path[opacity='0.5']").first.wait_for(state="attached")  # paler than the other


def test_a_figure_over_the_range_of_a_key(four_bar: Result, tmp_path: Path, opened: Opener) -> None:
    """Its curve passes through what is seen, refused parts are hatched there and marked at the slider."""
    length = ("robot.joints.theta1.a", "1.2405", "1.2415")
    target = tmp_path / "sweep.html"
    write_page([Shown("deploy", four_bar, live=live_parts([four_bar], [MASS, length])[0])], target)
    page = running(opened, target)
    page.locator(".live .sweep summary").click()
    page.locator(".live .sweep[data-points='49']").wait_for()
    assert page.locator(".live .sweep .chart path").count() >= 1
    assert float(page.locator(".live .sweep .legend span").inner_text()) == pytest.approx(
        number_of(figures(page)["time of the lock"]), rel=1e-5
    )
    page.locator(".live .sweep select").first.select_option("1")
    page.locator(".live .sweep rect[fill^='url']").first.wait_for(state="attached")
    assert "the loops come near a loss of rank" in page.locator(".live .sweep .note").inner_text()
    strips = page.locator(".live .parts")
    assert strips.nth(1).locator("rect").count() >= 2 and strips.nth(0).locator("rect").count() == 0
    assert strips.nth(1).get_attribute("aria-label").startswith("left to the command: 1.24")


def test_torques_along_a_motion(tmp_path: Path, opened: Opener) -> None:
    """Their figures and curves follow a slider; the motion stays."""
    result, target = inverse(load_scene(CONFIGS / "2r_circle.yaml")), tmp_path / "torques.html"
    asked = [("robot.links.link2.mass", "5", "25")]
    write_page([Shown("inverse", result, live=live_parts([result], asked)[0])], target)
    assert target.stat().st_size - len(make_page([Shown("inverse", result)]).encode()) < ADDED
    page = running(opened, target)
    peak, known = "peak torque of theta1", result.summary["joints"]["theta1"]["peak_torque"]
    assert number_of(figures(page)[peak]) == pytest.approx(known, abs=1e-6)
    slide(page, 0, 20.0)
    heavier = inverse(load_scene(CONFIGS / "2r_circle.yaml", ["robot.links.link2.mass=20"]))
    told = heavier.summary["joints"]["theta1"]["peak_torque"]
    assert number_of(figures(page)[peak]) == pytest.approx(told, abs=1e-6)
    page.locator(".live .plots").scroll_into_view_if_needed()
    titles = [item.inner_text() for item in page.locator(".live .plots h3").all()]
    assert titles == ["Live: torques", "Live: positions", "Live: rates"]
    page.locator(".live .sweep summary").click()
    page.locator(".live .sweep[data-points='49']").wait_for()


def test_a_loop_closes_for_other_lengths(tmp_path: Path, opened: Opener) -> None:
    """The drawing moves with them; where the crank no longer turns round, the values are left to the command."""
    scene = CONFIGS / "mechanisms" / "four_bar_kinematics.yaml"
    result, target = kinematics(load_scene(scene)), tmp_path / "loop.html"
    write_page(
        [Shown("kinematics", result, live=live_parts([result], [("robot.joints.crank.a", "0.2", "0.9")])[0])],
        target,
    )
    page = running(opened, target)
    told = "largest transmission angle"
    assert number_of(figures(page)[told]) == pytest.approx(82.284211, abs=1e-5)
    slide(page, 0, 0.5)
    other = kinematics(load_scene(scene, ["robot.joints.crank.a=0.5"])).summary["transmission_angle"]
    assert number_of(figures(page)[told]) == pytest.approx(other["largest_deg"], abs=1e-5)
    assert page.locator(".live .refused").inner_text() == ""
    slide(page, 0, 0.85)
    assert "the loops do not close along the whole motion" in page.locator(".live .refused").inner_text()
    page.locator(".live .parts.some").wait_for()


def test_a_phone_in_the_dark_by_keys_alone(live_page: Path, opened: Opener) -> None:
    """Every control has its turn, in the order in which it stands, and nothing is wider than the screen."""
    page = running(
        opened, live_page, viewport={"width": 360, "height": 740}, color_scheme="dark", bypass_csp=True
    )
    page.locator(".live input[type=range]").first.focus()
    kinds = []
    for _ in range(11):
        kinds.append(page.evaluate("document.activeElement.type || document.activeElement.tagName"))
        if kinds[-1] == "SUMMARY":
            page.keyboard.press("Enter")
        page.keyboard.press("Tab")
    assert kinds == ["range", "number"] * 2 + ["button"] * 3 + ["SUMMARY"] + ["select-one"] * 3
    page.locator(".live .sweep[data-points='49']").wait_for()
    page.locator(".live input[type=number]").first.focus()
    page.keyboard.press("Control+a")
    page.keyboard.type("33")
    page.keyboard.press("Enter")
    page.locator(".live[data-runs='2']").wait_for()
    page.locator(".live .copy").press("Enter")
    assert page.locator(".live .settings").inner_text() == "--set robot.links.crank.mass=33"
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    assert barriers(page) == []


def test_values_that_a_page_leaves_to_the_command_are_told(live_page: Path, opened: Opener) -> None:
    page = running(opened, live_page)
    field = page.locator(".live input[type=number]").first
    field.fill("500")
    field.press("Enter")
    page.locator(".live.left").wait_for()
    told = page.locator(".live .refused").inner_text()
    assert (
        told
        == "This page leaves these values to the command: a value is outside its range (robot.links.crank.mass)."
    )


def test_without_webassembly_the_page_is_as_it_was(live_page: Path, chromium: Any) -> None:
    context = chromium.new_context(offline=True)
    context.add_init_script("delete globalThis.WebAssembly")
    page = context.new_page()
    page.goto(live_page.as_uri())
    page.locator("html[data-ready]").wait_for(state="attached")
    assert page.locator(".live").is_hidden() and page.locator(".scene[data-pose]").count() == 1
    context.close()


def test_several_results_each_run_by_themselves(four_bar: Result, tmp_path: Path, opened: Opener) -> None:
    other = simulate(load_scene(CONFIGS / "double_pendulum.yaml"))
    parts = live_parts([four_bar, other], [MASS, ("robot.links.link1.mass", "5", "25")])
    target = tmp_path / "both.html"
    write_page([Shown("one", four_bar, live=parts[0]), Shown("two", other, live=parts[1])], target)
    page = opened(target)
    page.locator("html[data-running]").wait_for(state="attached", timeout=20_000)
    page.locator("#live-2[data-runs='1']").wait_for()
    end = page.locator("#live-2 tbody tr").first.inner_text()
    assert abs(number_of(end.split("\t")[1]) - float(other["q"][-1, 0])) < 1e-9


def test_what_running_adds_to_a_page(four_bar: Result) -> None:
    plain = make_page([Shown("deploy", four_bar)])
    live = make_page([Shown("deploy", four_bar, live=live_parts([four_bar], [MASS, ANGLE])[0])])
    assert "wasm-unsafe-eval" in live and "wasm-unsafe-eval" not in plain and "Runner" not in plain
    assert len(live.encode()) - len(plain.encode()) < ADDED


def test_fields_go_back_and_lines_look_as_stored(live_page: Path, opened: Opener) -> None:
    """An emptied field leaves the value that is seen; curves have the looks of the stored plots."""
    page = running(opened, live_page)
    slide(page, 0, 40.0)
    field = page.locator(".live input[type=number]").first
    field.fill("")
    field.dispatch_event("change")
    page.locator(".live[data-runs='3']").wait_for()
    assert field.input_value() == "40" and page.locator(".live .refused").inner_text() == ""
    slide(page, 0, 30.0)
    assert field.input_value() == "30"
    dashes = "svg => [...svg.querySelectorAll('path[stroke-dasharray]')].map((p) => [p.getAttribute('stroke'), p.getAttribute('stroke-dasharray')])"
    looks = []
    for figure in (
        page.locator(".live .plots figure").first,
        page.locator("figure.plot", has_text="Joint angles"),
    ):
        figure.scroll_into_view_if_needed()
        figure.locator("path[stroke-dasharray]").nth(2).wait_for(state="attached")
        looks.append([x for svg in figure.locator(".chart svg").all() for x in svg.evaluate(dashes)])
    assert len({tuple(x) for x in looks[0]}) == 3 and all(x in looks[1] for x in looks[0])
