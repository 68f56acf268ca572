"""The page of results in a real browser: it draws the stored poses, follows the hand, stays smooth, and runs no text."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.report.drawing.build import make_drawing
from robodyn_cli.report.page.motion import MOST_POSES, chosen_samples
from robodyn_cli.report.page.page import Shown, write_page
from robodyn_cli.results.moments import moments
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.works.inverse import inverse
from tests.browser.conftest import Opener, barriers
from tests.unit.synthetic_results import four_bar_result, inverse_result
from tests.unit.test_shapes import ball, stl_bytes

CONFIGS = Path(__file__).parents[2] / "configs"
MANY = 20  # frames, each with a pose of its own


def four_bar() -> Result:
    result = four_bar_result()
    theta = result["q"][:, 0]
    result.add("points/pin", np.stack([np.cos(theta), np.sin(theta), 0.0 * theta], axis=1))
    result.summary["error_estimate"] = {"method": "a closed form", "q_max": 1.25e-12}
    return result


@pytest.fixture(scope="module")
def planar(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    result, target = four_bar(), tmp_path_factory.mktemp("page") / "four_bar.html"
    assert write_page([Shown("deploy", result)], target) < 1e6
    return result, target


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    """The seven-joint arm at 100 001 samples, and its page."""
    result = inverse(load_scene(CONFIGS / "seven_joint_arm.yaml", ["inverse.samples=100001"]))
    target = tmp_path_factory.mktemp("page") / "arm.html"
    assert write_page([Shown("inverse", result)], target) < 2.2e6
    return result, target


def set_slider(page: Any, pose: int) -> None:
    page.locator(".time").evaluate(
        "(slider, pose) => { slider.value = pose; slider.dispatchEvent(new Event('input')); }", pose
    )
    page.locator(f".scene[data-pose='{pose}']").wait_for()


def wait_for_frame(page: Any) -> None:
    """Return after the page has drawn what was asked before: a key marks the drawing, the next frame draws it."""
    page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")


def ends_of(page: Any, name: str) -> np.ndarray:
    """Return the ends (2, 2) of a link as it is drawn in a flat view, in metres, read back from the picture."""
    scene = page.locator(".scene")
    data = scene.evaluate("svg => ({...svg.dataset, box: svg.getAttribute('viewBox')})")
    _, _, width, height = map(float, data["box"].split())
    path = page.locator(f".scene [data-part='link {name}']").get_attribute("d")
    pixels = np.array(re.findall(r"[ML](-?[\d.]+) (-?[\d.]+)", path), dtype=float)
    middle = np.array([float(data["x"]), float(data["y"])])
    return middle + (pixels - [width / 2, height / 2]) * [1, -1] / float(data["scale"])


def test_the_first_drawing_is_not_empty(planar: tuple[Result, Path], opened: Opener) -> None:
    page = opened(planar[1])
    page.locator(".scene[data-pose]").wait_for()
    assert page.locator(".scene path").count() > 10
    for name in ("crank", "coupler", "follower"):
        assert page.locator(f".scene [data-part='link {name}']").count() == 1
    assert page.get_by_role("heading", name="Four-bar linkage unfolding").count() == 1
    assert "1.3·10⁻¹² rad" in page.locator(".motion").inner_text()
    page.wait_for_timeout(300)
    assert page.locator(".scene").get_attribute("data-pose") == "0", "nothing plays before it is asked to"


def test_the_slider_brings_the_drawing_to_the_stored_pose(
    planar: tuple[Result, Path], opened: Opener
) -> None:
    result, target = planar
    page = opened(target)
    samples = chosen_samples(result.time, moments(result), MOST_POSES)
    drawing = make_drawing(result, samples)
    scale = float(page.locator(".scene").get_attribute("data-scale"))
    for pose in (0, 17, 600, len(samples) - 1):
        set_slider(page, pose)
        for part in drawing.links:
            seen = ends_of(page, part.name)
            for corner in drawing.vertices[pose, list(part.vertices), :2]:
                assert np.abs(seen - corner).sum(axis=1).min() < 0.1 / scale, (pose, part.name)
        assert float(re.findall(r"[\d.]+", page.locator(".clock").inner_text())[0]) == pytest.approx(
            result.time[samples[pose]], abs=0.01
        )
    assert page.locator(".scene [data-part='latch closed']").count() > 0, "at its end the latch is closed"


def test_plots_and_the_drawing_follow_each_other(planar: tuple[Result, Path], opened: Opener) -> None:
    result, target = planar
    page = opened(target)
    plot = page.locator("figure.plot").first
    plot.scroll_into_view_if_needed()
    plot.locator(".chart .frame").wait_for()
    set_slider(page, 614)
    x = [float(plot.locator(".cursor").get_attribute(name)) for name in ("x1", "x2")]
    frame = [float(v) for v in re.findall(r"-?[\d.]+", plot.locator(".frame").get_attribute("d"))]
    left, right = frame[0], frame[3]
    assert x[0] == x[1] == pytest.approx(left + (right - left) * 614 / 1228, abs=0.2)
    written = [value.replace("−", "-") for value in plot.locator(".legend span").all_inner_texts()]
    assert [float(value) for value in written] == pytest.approx(result["q"][614], rel=1e-5)
    chart = plot.locator(".chart > svg").first
    box = chart.bounding_box()
    page.mouse.click(box["x"] + left + 0.25 * (right - left), box["y"] + 0.5 * box["height"])
    pose = int(page.locator(".time").input_value())
    assert abs(pose - 307) <= 2
    page.locator(f".scene[data-pose='{pose}']").wait_for()
    page.get_by_role("button", name="dead point").click()
    page.locator(".scene[data-pose='1228']").wait_for()


def test_a_small_change_of_a_large_value_is_read_off_to_the_end(tmp_path: Path, opened: Opener) -> None:
    """Ticks have numbers of their own; at the end of a run of 0.7 s the cursor still reads values."""
    result = four_bar_result(60)
    result.time[:] = np.linspace(0.0, 0.7, len(result.time))
    result["q"][:] = 1228.28 + 1e-4 * np.sin(result.time)[:, None]
    write_page([Shown("deploy", result)], tmp_path / "narrow.html")
    page = opened(tmp_path / "narrow.html")
    plot = page.locator("figure.plot").first
    plot.scroll_into_view_if_needed()
    plot.locator(".chart .frame").wait_for()
    numbers = [text for text in plot.locator(".chart text.end").all_text_contents() if text]
    assert len(numbers) >= 3 and len(set(numbers)) == len(numbers), numbers
    set_slider(page, len(result.time) - 1)
    assert plot.locator(".legend span").all_inner_texts() == ["1228.28"] * 3


def camera(page: Any) -> tuple[str, float]:
    page.wait_for_timeout(100)
    scene = page.locator(".scene")
    return scene.get_attribute("data-flat"), float(scene.get_attribute("data-scale"))


def test_hand_wheel_and_keys_turn_and_zoom(planar: tuple[Result, Path], opened: Opener) -> None:
    page = opened(planar[1])
    flat, scale = camera(page)
    assert flat == "true"
    box = page.locator(".scene").bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 100)
    page.mouse.wheel(0, 200)
    assert camera(page)[1] == scale and page.evaluate("scrollY") > 0, "a page is scrolled over its drawing"
    page.evaluate("scrollTo(0, 0)")
    page.keyboard.down("Control")
    page.mouse.wheel(0, -300)
    page.keyboard.up("Control")
    assert camera(page)[1] > 1.2 * scale
    before = ends_of(page, "crank")
    page.mouse.down()
    page.mouse.move(box["x"] + 400, box["y"] + 160, steps=4)
    page.mouse.up()
    assert camera(page)[0] == "false"
    assert np.abs(ends_of(page, "crank") - before).max() > 0.02
    page.get_by_role("button", name="reset the view").click()
    assert camera(page) == ("true", pytest.approx(scale))
    page.locator(".scene").focus()
    page.keyboard.press("+")
    assert camera(page) == ("true", pytest.approx(1.2 * scale))
    page.keyboard.press("ArrowLeft")
    assert camera(page)[0] == "false"
    page.keyboard.press("0")
    assert camera(page) == ("true", pytest.approx(scale))
    page.keyboard.press(" ")
    page.get_by_role("button", name="Pause").wait_for()
    page.keyboard.press(" ")
    page.get_by_role("button", name="Play").wait_for()
    page.locator(".time").focus()
    here = int(page.locator(".time").input_value())
    page.keyboard.press("ArrowRight")
    assert int(page.locator(".time").input_value()) == here + 1
    assert page.locator(".time").get_attribute("aria-valuetext").endswith("seconds")


def test_a_body_tells_what_it_is_and_does(planar: tuple[Result, Path], opened: Opener) -> None:
    """A click on a body, or the keys, choose one; its pose is that of the time shown, and it can be followed."""
    result, target = planar
    page = opened(target)
    told = page.locator(".told-body")
    assert told.is_hidden()
    set_slider(page, 300)
    box = page.locator(".scene [data-part='link crank']").bounding_box()
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    assert told.locator("strong").inner_text() == "crank" and page.locator(".body").input_value() == "0"
    theta = float(result["q"][300, 0])
    place = told.locator("tr", has_text="origin of its frame").locator("td").inner_text().replace("−", "-")
    x, y = (float(part) for part in re.findall(r"-?[\d.]+(?=[,)])", place)[:2])
    assert [x, y] == pytest.approx([np.cos(theta), np.sin(theta)], abs=1e-4)
    assert "not given" in told.inner_text(), "the mass is not in the scene"
    assert f"{np.degrees(theta):.4g}°" in told.inner_text()
    page.locator(".scene").focus()
    page.keyboard.press("n")
    wait_for_frame(page)
    assert {"crank", "coupler", "follower"} <= set(page.locator(".words text").all_text_contents())
    page.keyboard.press("Shift+B")
    assert told.is_hidden(), "before the first there is none"
    page.locator(".body").select_option(label="coupler")
    page.locator(".scene").focus()
    paths = page.locator(".scene path").count()
    page.keyboard.press("g")
    page.keyboard.press("f")
    wait_for_frame(page)
    assert page.locator(".scene path").count() >= paths + 20, "links at seven times, and axes of three frames"
    page.keyboard.press("g")
    page.keyboard.press("c")
    wait_for_frame(page)
    before = ends_of(page, "coupler")
    set_slider(page, 900)
    now = ends_of(page, "coupler")
    end = make_drawing(result, [300, 900])
    part = next(part for part in end.links if part.name == "coupler")
    assert np.ptp(end.vertices[:, list(part.vertices), :2], axis=0).max() > 0.5
    near = np.linalg.norm(before[:, None] - now[None], axis=2).min()
    assert near < 0.01, "the origin of its frame stays where it was seen"
    page.locator(".body").select_option(label="none")
    assert told.is_hidden() and page.locator(".follow").is_disabled()


def test_two_fingers_zoom_on_a_phone(planar: tuple[Result, Path], opened: Opener) -> None:
    page = opened(planar[1], viewport={"width": 390, "height": 800}, has_touch=True, is_mobile=True)
    scale, box = camera(page)[1], page.locator(".scene").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    session = page.context.new_cdp_session(page)

    def touch(kind: str, gap: float) -> None:
        places = [{"x": x + sign * gap, "y": y, "id": place} for place, sign in enumerate((-1, 1))]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places if gap else []})

    touch("touchStart", 30)
    for gap in (35, 40, 50, 60):
        touch("touchMove", gap)
    touch("touchEnd", 0)
    assert camera(page)[1] == pytest.approx(2.0 * scale, rel=0.1)


def test_a_finger_scrolls_the_page_over_the_drawing(planar: tuple[Result, Path], opened: Opener) -> None:
    """Up and down it scrolls, to the side it turns."""
    page = opened(planar[1], viewport={"width": 390, "height": 800}, has_touch=True, is_mobile=True)
    session, box = page.context.new_cdp_session(page), page.locator(".scene").bounding_box()
    x, y = box["x"] + 60, box["y"] + 0.8 * box["height"]

    def drag(dx: float, dy: float) -> None:
        for k in range(10):
            place = {"x": x + k * dx, "y": y + k * dy, "id": 0}
            session.send(
                "Input.dispatchTouchEvent",
                {"type": "touchMove" if k else "touchStart", "touchPoints": [place]},
            )
        session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        page.wait_for_timeout(200)

    drag(0, -12)
    assert camera(page)[0] == "true" and page.evaluate("scrollY") > 20
    page.evaluate("scrollTo(0, 0)")
    drag(12, 1)
    assert camera(page)[0] == "false" and page.evaluate("scrollY") < 5


def test_a_phone_needs_no_scrolling_to_the_side(arm: tuple[Result, Path], opened: Opener) -> None:
    page = opened(arm[1], viewport={"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    for name in ("Play", "reset the view"):
        box = page.get_by_role("button", name=name).bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= 390 and box["height"] >= 30
    plot = page.locator(".chart").first
    plot.scroll_into_view_if_needed()
    plot.locator(".frame").wait_for()
    assert plot.bounding_box()["width"] <= 390


# poses that the drawing goes through while it plays; benchmarks/pages.py has the frames a second
POSES = """async (wanted) => {
  const poses = new Set();
  document.querySelector('.play').click();
  await new Promise((done) => {
    const step = () => {
      poses.add(document.querySelector('.scene').dataset.pose);
      poses.size < wanted ? requestAnimationFrame(step) : done();
    };
    requestAnimationFrame(step);
  });
  return [...poses].map(Number);
}"""


def check_that_it_plays(page: Any) -> None:
    """The drawing goes through its poses in their order; it does so in time or the page's own limit ends the test."""
    poses = page.evaluate(POSES, MANY)
    assert len(poses) >= MANY and poses == sorted(poses)


def test_the_four_bar_plays(planar: tuple[Result, Path], opened: Opener) -> None:
    check_that_it_plays(opened(planar[1]))


def test_seven_links_with_meshes_are_drawn_and_move(tmp_path: Path, opened: Opener) -> None:
    """The arm with a fine mesh on each link: faces are there, bars are not, and a stored result needs no files."""
    (tmp_path / "ball.stl").write_bytes(stl_bytes(ball(3, 1.0)))
    text = (CONFIGS / "seven_joint_arm.yaml").read_text(encoding="utf-8")
    shape = "{mesh: MESH, scale: [0.1, 0.06, 0.08], origin: {xyz: [0.02, 0, 0.05]}}"
    shape = shape.replace("MESH", str(tmp_path / "ball.stl"))
    overrides = [f"robot.links.link{k}.visual=[{shape}]" for k in range(1, 8)]
    scene = load_scene_text(text, str(CONFIGS / "arm.yaml"), overrides)
    (tmp_path / "ball.stl").unlink()
    assert write_page([Shown("inverse", inverse(scene))], tmp_path / "arm.html") < 2.2e6
    page = opened(tmp_path / "arm.html")
    set_slider(page, 3)
    for k in range(1, 8):
        assert page.locator(f".scene [data-part='shape link{k}']").count() > 40
        assert page.locator(f".scene [data-part='link link{k}']").count() == 0
    check_that_it_plays(page)
    page.locator(".view").select_option(label="x-z")
    page.locator(".scene[data-flat='true']").wait_for()
    assert page.locator(".scene [data-part='shape link7']").count() == 1, "its outline"


def test_a_hundred_thousand_samples_play(arm: tuple[Result, Path], opened: Opener) -> None:
    result, target = arm
    page = opened(target)
    assert "1500 of 100001 samples" in page.locator("figcaption").inner_text()
    check_that_it_plays(page)
    page.locator(".play").click()
    page.locator(".view").select_option(label="x-z")
    set_slider(page, 750)
    samples = chosen_samples(result.time, [], MOST_POSES)
    drawing = make_drawing(result, samples[[750]])
    scale = camera(page)[1]
    moving = [part for part in drawing.links if len(part.vertices) > 1]
    part = max(moving, key=lambda p: np.ptp(drawing.vertices[0, list(p.vertices)], axis=0).max())
    seen = ends_of(page, part.name)
    for corner in drawing.vertices[0, list(part.vertices)][:, [0, 2]]:
        assert np.abs(seen - corner).sum(axis=1).min() < 0.1 / scale


def test_text_of_a_scene_runs_nothing(tmp_path: Path, opened: Opener) -> None:
    evil = "</script><img src=x onerror=\"document.title='run'\"><script>document.title='run'</script>"
    result = four_bar()
    result.title = f"{evil}'\"&"
    result.scene_text += f"# {evil}\n"
    result.summary[evil] = {evil: [evil], "name": {evil: evil}}
    result.attributes["cpu"] = evil
    for variable in (result.variables["q"], result.variables["constraints/multipliers"]):
        variable.names = tuple(f"{name}{evil}" for name in variable.names)
    result.variables[f"points/{evil}"] = result.variables.pop("points/pin")
    target = tmp_path / "evil.html"
    write_page([Shown(evil, result), Shown("second", four_bar())], target)
    page = opened(target)
    page.locator(".chart .frame").first.wait_for()
    for figure in page.locator("figure").all():
        figure.scroll_into_view_if_needed()
    page.wait_for_timeout(300)
    assert page.title() == "2 results - robodyn"
    assert page.locator("img:not([src^='data:image/'])").count() == 0
    assert page.locator("script:not([type])").count() == 1
    assert evil in page.locator("#result-1 h2").inner_text()


def test_the_policy_stops_a_script_that_got_in(
    planar: tuple[Result, Path], tmp_path: Path, chromium: Any
) -> None:
    """A second line of defence: what no text can do, not even markup that was put into the file can."""
    text = planar[1].read_text(encoding="utf-8")
    target = tmp_path / "changed.html"
    target.write_text(
        text.replace(
            "<main>", "<main><script>document.title='run'</script><img src='https://example.org/x.png'>"
        ),
        encoding="utf-8",
    )
    page = chromium.new_page()
    page.goto(target.as_uri())
    page.locator(".scene[data-pose]").wait_for()
    assert page.title() != "run"
    page.close()


def luminance(colour: str) -> float:
    return float(np.mean([float(x) for x in re.findall(r"[\d.]+", colour)[:3]]))


@pytest.mark.parametrize(("scheme", "dark"), [("light", False), ("dark", True)])
def test_light_and_dark(planar: tuple[Result, Path], opened: Opener, scheme: str, dark: bool) -> None:
    page = opened(planar[1], color_scheme=scheme)
    body = page.evaluate("getComputedStyle(document.body).backgroundColor")
    words = page.evaluate("getComputedStyle(document.body).color")
    ink = page.locator(".cross path").first.evaluate("node => getComputedStyle(node).stroke")
    assert (
        (luminance(body) < 60) is dark and (luminance(words) > 180) is dark and (luminance(ink) > 180) is dark
    )


def test_a_printed_page_has_everything_and_is_light(planar: tuple[Result, Path], opened: Opener) -> None:
    page = opened(planar[1], color_scheme="dark")
    content = page.pdf(prefer_css_page_size=True, print_background=True)
    assert content.startswith(b"%PDF") and 3 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= 25
    page.set_viewport_size({"width": 690, "height": 1000})
    page.emulate_media(media="print")
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    charts = page.locator(".chart").count()
    assert charts >= 3 and page.locator(".chart > svg:first-of-type").count() == charts
    assert page.locator(".scene-text pre").is_visible() and not page.locator(".play").is_visible()
    high = page.locator(".plots figure").evaluate_all(
        "all => all.map((x) => x.getBoundingClientRect().height)"
    )
    assert max(high) < 490, "two go on a page of 269 mm at 96 pixels an inch"
    assert page.locator("details:not([open]):not(.sweep)").count() == 0, "nothing stays folded"
    assert luminance(page.evaluate("getComputedStyle(document.body).backgroundColor")) > 250


def test_several_results_stand_one_below_another(tmp_path: Path, opened: Opener) -> None:
    second = four_bar_result(60)
    second.title = "Second"
    target = tmp_path / "two.html"
    write_page([Shown("a", four_bar()), Shown("b", second)], target)
    page = opened(target)
    assert page.locator("nav a").all_inner_texts() == ["Four-bar linkage unfolding until it locks", "Second"]
    page.locator("nav a").last.click()
    assert page.locator("#result-2 h2").bounding_box()["y"] < 900
    sliders = page.locator(".time")
    sliders.last.evaluate("slider => { slider.value = 30; slider.dispatchEvent(new Event('input')); }")
    page.locator("#result-2 .scene[data-pose='30']").wait_for()
    assert page.locator("#result-1 .scene").get_attribute("data-pose") == "0"


def test_zeros_errors_and_what_is_lost_are_seen_on_the_page(tmp_path: Path, opened: Opener) -> None:
    """Before a latch closes its loads are zero in the legend; errors are bands, and a lost motion is hatched."""
    result = four_bar_result(201)
    result["constraints/multipliers"][:100] = 0.0
    result.summary["error_estimate"] = {"method": "m", "q_max": 3.0, "qd_max": 3.0, "meaningful_until": 8.0}
    write_page([Shown("deploy", result)], tmp_path / "lost.html")
    page = opened(tmp_path / "lost.html")
    for title in ("Joint angles", "Multipliers"):
        plot = page.locator("figure.plot", has=page.locator(f"h2:text-is('{title}')"))
        plot.scroll_into_view_if_needed()
        plot.locator(".chart .frame").first.wait_for()
        assert plot.locator(".chart pattern").count() >= 1
        assert "not meaningful after" in plot.locator("xpath=ancestor::section").first.inner_text()
        bands = plot.locator(".chart g path[opacity='0.22']").count()
        assert bands == (3 if title == "Joint angles" else 0)
    set_slider(page, 60)
    assert plot.locator(".legend span").all_inner_texts()[:3] == ["0", "0", "0"]


def test_results_are_compared_filtered_and_laid_over_one_another(tmp_path: Path, opened: Opener) -> None:
    """Differences carry the sum of both errors, in the table and in the chart; a filter leaves what holds its words."""
    results = []
    for k in range(3):
        result = four_bar_result(201)
        result.title, result["q"][:] = f"Run {k}", result["q"] + 0.125 * k
        result.scene_text += f"\nparameters: {{a_number_with_a_name_as_long_as_some_are: {k}}}\n"
        result.summary["lock"] = {"time": 12.0 + 0.5 * k, "time_error": 1e-9, "kind": "dead_point"}
        result.summary["error_estimate"] = {"method": "m", "q_max": 1e-6}
        results.append(result)
    write_page([Shown(f"r{k}", result) for k, result in enumerate(results)], tmp_path / "three.html")
    page = opened(tmp_path / "three.html")
    page.locator(".to").select_option(label="Run 0")
    row = page.locator(".sided tr", has=page.locator("th:has-text('lock.time')")).first
    assert row.locator("td").all_inner_texts() == [
        "12.000000000 ± 1·10⁻⁹ s", "+0.500000000 ± 2·10⁻⁹ s", "+1.000000000 ± 2·10⁻⁹ s"]  # fmt: skip
    few = page.get_by_label("only what differs")
    few.check()
    for head, cell in zip(page.locator(".sided thead th").all(), row.locator("td").all()):
        assert head.bounding_box()["x"] == cell.bounding_box()["x"], "heads stand over their columns"
    few.uncheck()
    told = page.locator(".overlay .told")
    with page.expect_download() as file:
        page.locator(".overlay").get_by_role("button", name="CSV").click()
    assert "less_that_of_Run_0" in file.value.suggested_filename
    saved = file.value.path().read_text().splitlines()[0]
    assert saved == "time [s],Run 1 less that of Run 0 [rad],Run 2 less that of Run 0 [rad]"
    assert "both errors added: 2·10⁻⁶ rad" in told.inner_text()
    assert page.locator(".overlay .legend li").count() == 2, "the chosen one less itself is no line"
    page.locator(".filter").fill("R2 dead")
    assert page.locator("nav li:visible a").all_inner_texts() == ["Run 2"]
    assert page.locator("#result-1").is_hidden() and page.locator("#result-3").is_visible()
    assert page.locator(".count").inner_text() == "1 of 3 results"
    page.locator(".filter").fill("")
    page.locator(".to").select_option(value="")
    assert row.locator("td").nth(1).inner_text() == "12.500000000 ± 1·10⁻⁹ s"
    page.get_by_role("checkbox", name="lines of Run 1").uncheck()
    assert page.locator(".overlay .legend button").all_inner_texts() == [" Run 0", " Run 2"]
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    box, name = page.locator(".sided"), row.locator("th")
    place = name.bounding_box()["x"]
    assert name.bounding_box()["width"] < 0.45 * box.bounding_box()["width"], (
        "figures have room beside their names"
    )
    box.evaluate("box => { box.scrollLeft = 200; }")
    assert box.evaluate("box => box.scrollLeft") == 200 and name.bounding_box()["x"] == place
    last = row.locator("td").last.bounding_box()
    box.evaluate("box => { box.scrollLeft = 1e6; }")
    assert (
        last["x"] + last["width"] > 390 >= (end := row.locator("td").last.bounding_box())["x"] + end["width"]
    )


@pytest.mark.parametrize(("scheme", "width"), [("light", 1100), ("dark", 390)])
def test_nothing_keeps_anybody_out(scheme: str, width: int, tmp_path: Path, opened: Opener) -> None:
    """Names, contrasts, headings and keys of one result and of several, as axe judges them."""
    torques, study = inverse_result(60), Result("sweep", "a study", "ok", "schema: 1\n")
    torques.variables.pop("q")
    study.summary = {"status": "ok", "points": [{"mass": 1.0, "peak": 2.0}]}
    several = [Shown("deploy", four_bar()), Shown("inverse", torques), Shown("sweep", study)]
    for name, shown in (("one", several[:1]), ("three", several)):
        target = tmp_path / f"{name}.html"
        write_page(shown, target)
        view = {"width": width, "height": 900}
        page = opened(target, color_scheme=scheme, viewport=view, bypass_csp=True)
        assert barriers(page) == [], name


def test_without_a_script_figures_stand_there_and_nothing_is_asked(tmp_path: Path, chromium: Any) -> None:
    results = [four_bar_result(60) for _ in range(2)]
    write_page([Shown(f"r{k}", result) for k, result in enumerate(results)], tmp_path / "two.html")
    context = chromium.new_context(java_script_enabled=False, offline=True)
    page = context.new_page()
    page.goto((tmp_path / "two.html").as_uri())
    assert page.locator(".sided").is_visible() and page.locator("nav.results a").first.is_visible()
    assert page.locator(":is(select, input, button):visible").count() == 0
    context.close()


def test_pictures_and_digests_fit_a_phone(opened: Opener, tmp_path: Path) -> None:
    result = inverse(load_scene("configs/2r_circle.yaml"), samples=101)
    result.attributes["robodyn_code_sha256"] = "0123456789abcdef" * 4
    write_page([Shown("arm", result)], tmp_path / "page.html")
    page = opened(tmp_path / "page.html", viewport={"width": 400, "height": 800})
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    for selector in ("svg.picture", ".hash"):
        for box in page.locator(selector).all():
            place = box.bounding_box()
            assert place is not None and place["x"] >= 0.0 and place["x"] + place["width"] <= 400.0, selector
    assert page.locator("svg.picture").count() and page.locator(".hash").count() == 1


def test_a_curve_in_two_panels_has_two_values(opened: Opener, tmp_path: Path) -> None:
    result = inverse(load_scene("configs/2r_circle.yaml"), samples=101)
    write_page([Shown("arm", result)], tmp_path / "page.html")
    figure = opened(tmp_path / "page.html").locator("figure.plot", has_text="Point coordinates")
    figure.scroll_into_view_if_needed()
    figure.locator(".chart svg").first.wait_for()
    told = figure.locator(".legend li span").first.inner_text().split("; ")
    # x and y of the tip at the start
    assert [float(x.replace("−", "-")) for x in told] == pytest.approx(result["points/tip"][0, :2], rel=1e-4)


def test_a_drawing_among_very_many_is_made_where_it_is_opened(opened: Opener, tmp_path: Path) -> None:
    results = [four_bar_result(201) for _ in range(13)]
    write_page([Shown(f"r{k}", result) for k, result in enumerate(results)], tmp_path / "many.html")
    page = opened(tmp_path / "many.html")
    assert page.locator(".scene path").count() == 0 and page.locator("details.drawing").count() == 13
    section = page.locator("#result-7")
    section.locator(".drawing > summary").click()
    section.locator(".scene[data-pose='0'] path").first.wait_for()
    last = int(section.locator(".time").get_attribute("max"))
    set_slider(section, last)
    assert last > 20 and section.locator(".scene").bounding_box()["width"] > 300
    assert page.locator(".scene path").count() == section.locator(".scene path").count(), "no other is made"
