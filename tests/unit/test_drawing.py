"""The description of a drawing: what there is and where, from which side, and the strokes that show it."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from robodyn_cli import assemble, deploy, inverse, kinematics, load_scene, load_scene_text, simulate, statics
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Graph, free_symbols
from robodyn_cli.model.build import build_model
from robodyn_cli.report.drawing import build, paper, symbols
from robodyn_cli.report.drawing.bodies import traced_bodies
from robodyn_cli.report.drawing.build import make_drawing, paths_of, problem_of
from robodyn_cli.report.drawing.camera import View, along_axis, default_camera
from robodyn_cli.report.drawing.parts import cuboid
from robodyn_cli.report.drawing.places import KnownNodes, along_motion, motion_between, nearest
from robodyn_cli.report.drawing.record import Drawing, DrawnPart, mixed
from robodyn_cli.report.drawing.strokes import BODY, LATCH, TRAIL, silhouette, strokes
from robodyn_cli.report.registry import draw
from robodyn_cli.report.style import styled
from robodyn_cli.results.result import Result, evenly
from robodyn_cli.works.info import info

RUN = {"inverse": inverse, "simulate": simulate, "deploy": deploy, "kinematics": kinematics, "statics": statics,
       "assemble": assemble}  # fmt: skip
SCENES = sorted(path for path in Path("configs").rglob("*.yaml") if path.parent.name != "robots")
QUICK = (
    "four_bar_kinematics",
    "puma560_hold",
    "spinning_top",
    "spatial_slider_crank",
    "slider_crank",
    "andrews",
)


@pytest.fixture(autouse=True)
def no_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", category=DeprecationWarning, module="matplotlib|pyparsing")
        yield


def result_of(name: str) -> Result:
    path = next(path for path in SCENES if path.stem == name)
    scene = load_scene(path, ["simulate.error_estimate=false", "simulate.samples=41"])
    return RUN[scene.command or "simulate"](scene)


def painted(view: View, k: int) -> np.ndarray:
    """Return the pixels of a view on plain paper."""
    figure = Figure(figsize=(4, 3), dpi=50)
    canvas = FigureCanvasAgg(figure)
    ax = figure.add_axes((0, 0, 1, 1))
    paper.set_up(ax, view, scale=False)
    paper.put(ax, view, k)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


@pytest.mark.parametrize("name", QUICK)
def test_links_pass_through_the_recorded_outlines_and_points(name: str) -> None:
    """The recorded outlines and points come from the run's own compiled kinematics."""
    result = result_of(name)
    drawing = make_drawing(result)
    size = drawing.size
    for link, item in result.group("skeleton").items():
        part = next((p for p in drawing.links if p.name == link), None)
        if part is None:
            continue
        corners = drawing.vertices[:, list(part.vertices)]
        gaps = np.linalg.norm(item.data[:, :, None] - corners[:, None], axis=-1).min(axis=2)
        assert gaps.max() < 1e-9 * size, link
    for trail in drawing.trails:
        assert np.allclose(trail.points[-1], result[f"points/{trail.name}"][-1], atol=1e-9 * size)


def test_a_ternary_link_is_a_plate_and_a_spring_in_a_joint_a_coil() -> None:
    drawing = make_drawing(result_of("four_bar_kinematics"))
    assert {p.name: len(p.vertices) for p in drawing.links} == {"arm": 2, "bar": 3, "swing": 2}
    assert [pin.kind for pin in drawing.pins] == ["hinge"] * 4
    assert {pin.name for pin in drawing.pins if pin.grounded} == {"crank", "rocker"}
    plate = next(s for s in strokes(fitted(drawing), 0) if s.closed and s.layer == BODY)
    assert len(plate.points) == 3
    held = make_drawing(result_of("balanced_four_bar"))
    assert {pin.name: pin.about for pin in held.pins if pin.about} == {"crank": ("spring",)}
    assert {arrow.name for arrow in held.arrows} == {"crank", "coupler", "rocker", "pin"}


def fitted(drawing: Drawing) -> View:
    view = View(drawing, default_camera(drawing))
    view.fit(400.0, 300.0)
    return view


EVERYTHING = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: slide, type: prismatic, axis: [0, 0, 1], parent: base, link: a, spring: {stiffness: 50}, damper: {damping: 1}}
    - {name: ball, type: spherical, parent: a, link: b, origin: {xyz: [0.4, 0, 0]}}
    - {name: cross, type: universal, parent: base, link: c, origin: {xyz: [0, 1, 0]}}
    - {name: free, type: floating, parent: base, link: d}
    - {name: plate, type: planar, parent: base, link: e}
    - {name: screw, type: helical, axis: [1, 0, 0], pitch: 0.1, parent: base, link: f}
    - {name: sleeve, type: cylindrical, axis: [0, 1, 0], parent: base, link: g}
  links:
    - {name: a, mass: 1, com: [0, 0, 0.1], inertia: {xx: 0.01, yy: 0.02, zz: 0.03}}
    - {name: b, mass: 1, com: [0.1, 0.2, 0], inertia: {xx: 0.01, yy: 0.02, zz: 0.025}}
    - {name: c, mass: 1, com: [0.1, 0, 0.2], inertia: {xx: 0.01, yy: 0.02, zz: 0.025}}
    - {name: d, mass: 2, com: [0, 0, 0.1], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
    - {name: e, mass: 2, com: [0, 0.1, 0.1], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
    - {name: f, mass: 2, com: [0, 0.1, 0.1], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
    - {name: g, mass: 2, com: [0, 0.1, 0.1], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
  points: {hook: {link: b, at: [0.3, 0, 0]}, wall: {link: base, at: [0, 0, 1]}, tip: {link: d, at: [0, 0, 0.3]}}
forces:
  - {name: s, type: spring, between: [wall, hook], stiffness: 10, damping: 1, length: 0.2}
  - {name: r, type: constant_force, between: [hook, tip], force: 2}
  - {name: t, type: torsional_spring, between: [a.origin, b.origin], stiffness: 0.1}
  - {name: h, type: bushing, between: [c.origin, e.origin], stiffness: [1, 1, 1, 0, 0, 0]}
  - {name: push, type: force, at: tip, force: ["3*cos(t)", 0, 1]}
  - {name: turned, type: wrench, at: hook, force: [0, 0, 2], frame: body}
initial: {q: {slide: 0.1, ball: {rpy: [0.1, 0, 0]}, cross: [0.1, 0.2], free: {x: 0.5, y: 0.1, z: 0.3, rpy: [0, 0, 0]},
  plate: [0.1, 0, 0.2], screw: 0.3, sleeve: [0.1, 0.2]}}
simulate: {duration: 0.2, samples: 21, error_estimate: false}
"""


def everything() -> Result:
    return simulate(load_scene_text(EVERYTHING))


def test_every_kind_of_joint_and_force_is_drawn() -> None:
    result = everything()
    drawing = make_drawing(result)
    assert {pin.name: pin.kind for pin in drawing.pins} == {
        "slide": "slide", "ball": "ball", "cross": "cross", "plate": "table", "screw": "hinge", "sleeve": "sleeve",
        "s": "hinge",  # where the spring hangs on the ground
    }  # fmt: skip
    kinds = {(part.kind, part.name) for part in drawing.parts}
    assert {("spring", "slide"), ("damper", "slide"), ("spring", "s"), ("damper", "s")} <= kinds
    assert {("rope", "r"), ("coil", "t"), ("bushing", "h"), ("rail", "screw"), ("rail", "sleeve")} <= kinds
    sides = [part.aside for part in drawing.parts if part.name == "s"]
    assert sorted(sides) == [-1, 1], "spring and damper lie side by side"
    push = next(arrow for arrow in drawing.arrows if arrow.name == "push")
    expected = np.stack([3.0 * np.cos(result.time), 0.0 * result.time, np.ones(len(result.time))], axis=1)
    assert np.allclose(push.force, expected, atol=1e-12)
    turned = next(arrow for arrow in drawing.arrows if arrow.name == "turned")
    assert (
        np.allclose(np.linalg.norm(turned.force, axis=1), 2.0) and np.ptp(turned.force, axis=0).max() > 1e-3
    )
    assert drawing.flat is None
    pixels = painted(fitted(drawing), len(drawing.times) - 1)
    assert (pixels != 255).any(axis=2).mean() > 0.02


def test_arrows_are_to_one_scale_and_reactions_keep_their_axes() -> None:
    """Forces on a link of a four-bar in balance sum to its weight, whatever axes they were recorded in."""
    scene = next(path for path in SCENES if path.stem == "balanced_four_bar")
    for axes in ("world", "joint"):
        drawing = make_drawing(statics(load_scene(scene, [f"outputs.reaction_axes={axes}"])))
        force = {arrow.name: arrow.force[0] for arrow in drawing.arrows}
        assert force["coupler"] + force["pin"] == pytest.approx([0.0, 3.0 * 9.81, 0.0], abs=1e-9)
        view = fitted(drawing)
        lengths = {a.name: np.hypot(*v) for a, (_, v) in zip(drawing.arrows, view.tips(0))}
        sizes = {name: np.linalg.norm(f) for name, f in force.items()}
        ratios = [lengths[name] / sizes[name] for name in sizes]
        assert ratios == pytest.approx([ratios[0]] * len(ratios))


def test_a_planar_mechanism_is_flat_and_a_tower_that_turns_is_not() -> None:
    assert make_drawing(result_of("four_bar_kinematics")).flat == 2
    assert make_drawing(result_of("spinning_top")).flat is None
    tower = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints: [{name: turn, type: revolute, axis: [0, 0, 1]}]
  links: [{name: tower, mass: 1, com: [0.1, 0, 1], inertia: {xx: 1, yy: 1, zz: 1}}]
  points: {top: {link: tower, at: [0.2, 0, 2]}}
initial: {q: {turn: 0}, qd: {turn: 1}}
simulate: {duration: 1, samples: 11, error_estimate: false}
"""
    assert make_drawing(simulate(load_scene_text(tower))).flat is None


@pytest.mark.parametrize("moves", [True, False])
@pytest.mark.parametrize("gravity", ["[0, 0, -9.81]", "[0, 0, 0]"])
def test_a_mechanism_in_a_slanting_plane_is_seen_face_on(moves: bool, gravity: str) -> None:
    """Then links are seen at their true lengths; gravity is down as far as it lies in the plane."""
    text = f"""
schema: 1
gravity: {gravity}
robot:
  base: {{rpy: [50 deg, 20 deg, 30 deg]}}
  joints:
    - {{name: a, type: revolute, axis: [0, 0, 1], parent: base, link: upper}}
    - {{name: b, type: revolute, axis: [0, 0, 1], parent: upper, link: lower, origin: {{xyz: [0.7, 0, 0]}}}}
  links:
    - {{name: upper, mass: 1, com: [0.3, 0, 0], inertia: {{xx: 0.1, yy: 0.1, zz: 0.1}}}}
    - {{name: lower, mass: 1, com: [0.2, 0, 0], inertia: {{xx: 0.1, yy: 0.1, zz: 0.1}}}}
  points: {{tip: {{link: lower, at: [0.4, 0, 0]}}}}
initial: {{q: {{a: 0.3, b: 0.9}}, qd: {{a: {5.0 * moves}, b: 1}}}}
simulate: {{duration: 0.2, samples: 11, error_estimate: false}}
"""
    result = simulate(load_scene_text(text))
    if not moves:
        result["q"][:] = result["q"][:1]
    drawing = make_drawing(result)
    x, y, z = (np.radians(angle) for angle in (50.0, 20.0, 30.0))
    normal = np.array(
        [
            np.cos(z) * np.sin(y) * np.cos(x) + np.sin(z) * np.sin(x),
            np.sin(z) * np.sin(y) * np.cos(x) - np.cos(z) * np.sin(x),
            np.cos(y) * np.cos(x),
        ]
    )
    assert drawing.flat is None and drawing.normal is not None
    view = fitted(drawing)
    assert view.flat and not view.numbered and abs(view.camera.back @ normal) == pytest.approx(1.0, abs=1e-9)
    assert view.camera.right @ drawing.up == pytest.approx(0.0, abs=1e-9) or gravity == "[0, 0, 0]"
    for part, length in zip(drawing.links, (0.7, 0.4)):
        a, b = view.corners[:, list(part.vertices[:2]), :2].transpose(1, 0, 2)
        assert np.hypot(*(b - a).T) == pytest.approx(length), part.name


def test_in_space_joints_are_seen_apart() -> None:
    """A gate of four posts in a row: seen from its side they would be one."""
    for angle in (0.0, 40.0, 90.0, 130.0):
        row = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
        feet = np.arange(4)[:, None] * row
        places = np.concatenate([feet, feet + [0.0, 0.0, 1.0]])
        parts = tuple(DrawnPart("link", str(k), (k, k + 4), "#000000") for k in range(4))
        drawing = Drawing(
            np.zeros(1), places[None], np.zeros((1, 0, 3)), parts, (), (), (), (), (), (), np.zeros(3)
        )
        back = default_camera(drawing).back
        across = back - (back @ [0.0, 0.0, 1.0]) * np.array([0.0, 0.0, 1.0])
        assert abs(across @ row) < 0.8 * np.linalg.norm(across)


FOLDED = {"four_bar_deploy": (150.46, -165.23, 165.23), "four_bar_kinematics": (75.0, -50.0, 60.0)}


@pytest.mark.parametrize("name", FOLDED)
def test_names_of_links_touch_nothing_that_is_not_theirs(name: str) -> None:
    path = next(path for path in SCENES if path.stem == name)
    result = Result("simulate", "", "ok", load_scene(path).text)
    result.add("time", np.zeros(1))
    result.add("q", np.radians([FOLDED[name]]))
    with styled():
        figure = draw(result, "mechanism")
    renderer, ax = FigureCanvasAgg(figure).get_renderer(), figure.axes[0]
    view = fitted(make_drawing(result))
    scale = figure.dpi / 72.0
    links = {part.name: view.corners[0, list(part.vertices), :2] for part in view.drawing.links}
    assert {text.get_text() for text in ax.texts} == set(links)
    boxes = {text.get_text(): text.get_window_extent(renderer) for text in ax.texts}
    for own, box in boxes.items():
        assert not any(box.overlaps(other) for name_, other in boxes.items() if name_ != own)
        for other, corners in links.items():
            for a, b in zip(corners, np.roll(corners, -1, axis=0)) if other != own else ():
                along = ax.transData.transform(a + np.linspace(0.0, 1.0, 200)[:, None] * (b - a))
                off = np.maximum(
                    np.abs(along - box.get_points().mean(axis=0)) - 0.5 * np.array([box.width, box.height]),
                    0.0,
                )
                assert np.hypot(*off.T).min() >= 0.5 * view.link_width * scale, (own, other)


# -- camera ---------------------------------------------------------------------------------------------------
def test_the_projection_is_that_of_a_pinhole() -> None:
    """The line from the eye through a point meets the plane through the target at the point's projection."""
    drawing = make_drawing(result_of("spinning_top"))
    camera = default_camera(drawing)
    frame = np.stack([camera.right, camera.up, camera.back])
    assert np.allclose(frame @ frame.T, np.eye(3), atol=1e-12) and np.linalg.det(frame) > 0.0
    eye = camera.target + camera.distance * camera.back
    rng = np.random.default_rng(3)
    for p in camera.target + 0.3 * drawing.size * rng.normal(size=(20, 3)):
        s = camera.distance / ((eye - p) @ camera.back)
        hit = eye + s * (p - eye)
        x, y, depth = camera.project(p)
        assert camera.target + x * camera.right + y * camera.up == pytest.approx(hit, abs=1e-9)
        assert depth == pytest.approx((p - camera.target) @ camera.back)
    assert camera.up @ drawing.up > 0.5
    assert np.isnan(camera.project(eye + camera.back)[:2]).all()


@pytest.mark.parametrize(("axis", "shown"), [(0, (1, 2)), (1, (0, 2)), (2, (0, 1))])
def test_views_along_axes_keep_the_coordinates_of_the_world(axis: int, shown: tuple[int, int]) -> None:
    p = np.array([1.0, 2.0, 3.0])
    camera = along_axis(axis)
    assert camera.project(p)[:2] == pytest.approx(p[list(shown)])
    assert camera.labels == tuple(f"{'xyz'[k]} [m]" for k in shown)


def test_everything_stays_in_the_picture_at_equal_scales() -> None:
    drawing = make_drawing(result_of("slider_crank"))
    view = View(drawing, default_camera(drawing))
    for width, height in ((400.0, 100.0), (100.0, 400.0), (300.0, 300.0)):
        view.fit(width, height)
        span = view.high - view.low
        assert span[0] / width == pytest.approx(span[1] / height) == pytest.approx(view.pt)
        places = view.corners[..., :2]
        assert (places >= view.low).all() and (places <= view.high).all()


# -- strokes --------------------------------------------------------------------------------------------------
def test_hull_and_cuboid() -> None:
    rng = np.random.default_rng(0)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    inside = rng.uniform(0.05, 0.95, (40, 2))
    assert {tuple(p) for p in symbols.hull(np.concatenate([inside, square]))} == {tuple(p) for p in square}
    assert len(symbols.hull(np.array([[0, 0], [2, 2], [1, 1.0]]))) == 2
    m, sides = 3.0, np.array([0.2, 0.5, 0.9])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    moments = m / 12.0 * (np.sum(sides**2) - sides**2)
    corners = cuboid(m, turn @ np.diag(moments) @ turn.T)
    assert corners is not None
    assert np.sort(np.ptp(corners @ turn, axis=0)) == pytest.approx(sides)
    assert cuboid(1.0, np.zeros((3, 3))) is None


def test_the_latch_closes_at_the_lock_and_paths_grow() -> None:
    scene = load_scene(
        next(p for p in SCENES if p.stem == "four_bar_deploy"), ["simulate.error_estimate=false"]
    )
    result = deploy(scene)
    drawing = make_drawing(result, evenly(len(result.time), 60))
    assert [latch.closed for latch in drawing.latches] == [((result.summary["lock"]["time"], np.inf),)]
    view = fitted(drawing)
    before, after = (
        [s.colour for s in strokes(view, k) if s.layer == LATCH] for k in (10, len(drawing.times) - 1)
    )
    assert len(after) > len(before) > 0 and set(before).isdisjoint(after)
    passed = [
        max(len(s.points) for s in strokes(view, k) if s.layer == TRAIL and s.depth > 0.0)
        for k in (10, 30, 59)
    ]
    assert passed[0] < passed[1] < passed[2]
    still, moved = painted(view, 10), painted(view, 40)
    assert (still != moved).any()


def test_instants_follow_the_motion() -> None:
    drawing = make_drawing(result_of("slider_crank"))
    chosen = along_motion(drawing, 5)
    assert chosen[0] == 0 and chosen[-1] == len(drawing.times) - 1 and len(chosen) <= 5
    times = np.array([0.0, 1.0, 1.0, 2.5])
    assert times[nearest(times, np.array([-1.0, 0.4, 0.6, 2.0, 9.0]))].tolist() == [0.0, 0.0, 1.0, 2.5, 2.5]
    assert nearest(np.array([3.0]), np.array([0.0, 9.0])).tolist() == [0, 0]


@pytest.mark.parametrize("swings", [1, 2, 3.5, 7, 14, 21])
def test_instants_of_a_swing_are_not_all_at_its_ends(swings: float) -> None:
    """Equal steps along a way to and fro of as many swings as steps all lie at its two ends."""
    result = result_of("slider_crank")
    result["q"][:] = result["q"][:1]
    result["q"][:, 0] = 0.5 * np.cos(swings * np.pi * np.linspace(0.0, 1.0, len(result.time)))
    chosen = along_motion(make_drawing(result), 8)
    places = np.sort(result["q"][chosen, 0])
    assert 7 <= len(chosen) <= 8 and chosen[0] == 0 and chosen[-1] == len(result.time) - 1
    assert np.count_nonzero(np.diff(places) > 0.02) >= 3


def test_places_that_are_no_numbers_are_left_out() -> None:
    result = result_of("slider_crank")
    for value in (math.nan, math.inf, 1e300):
        result["q"][:] = value
        view = fitted(make_drawing(result))
        assert (painted(view, 0) != 255).any(), value  # the ground is there all the same


def test_all_drawings_of_a_result_have_one_model(monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[str] = []

    def count(scene: Any, *args: Any) -> Any:
        built.append(scene.title)
        return build_model(scene, *args)

    monkeypatch.setattr(build, "build_model", count)
    result = inverse(load_scene(Path("configs") / "2r_circle.yaml"), samples=11)
    build._model_of.cache_clear()
    built.clear()
    first, second = make_drawing(result), make_drawing(result)
    assert paths_of(result) and traced_bodies(result, np.arange(3)) and len(built) == 1
    np.testing.assert_array_equal(first.vertices, second.vertices)
    assert problem_of(result).graph is not problem_of(result).graph


@pytest.mark.parametrize("name", [*QUICK, "stewart_platform", "crane", "catching_arm"])
def test_a_state_is_drawn_by_the_equations_of_its_report(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which draw what the stored scene gives, to the bit; payloads are drawn by the stored scene."""
    path = next(path for path in SCENES if path.stem == name)
    result = info(path)
    stored = dataclasses.replace(result, problem=None)
    assert (result.problem is None) == bool(load_scene(path).payloads)
    expected = make_drawing(stored)
    if result.problem is not None:
        monkeypatch.setattr(build, "build_model", None)
        build._model_of.cache_clear()
        build._stored_scene.cache_clear()
    found = make_drawing(result)
    for array in ("vertices", "axes", "gravity"):
        np.testing.assert_array_equal(getattr(found, array), getattr(expected, array))
    assert [found.parts, found.pins, found.masses, found.flat] == [
        expected.parts, expected.pins, expected.masses, expected.flat
    ]  # fmt: skip


def test_results_without_poses_say_so() -> None:
    result = Result("stability", "", "ok", "")
    with pytest.raises(CapabilityError, match="a result of 'stability' has no poses to draw"):
        make_drawing(result)
    result.add("time", np.zeros(1))
    result.add("q", np.zeros((1, 2)))
    with pytest.raises(CapabilityError, match="scene stored in the result cannot be read"):
        make_drawing(result)


def test_mixed_colours() -> None:
    assert mixed("#000000", "#ffffff", 0.5) == "#808080"
    assert mixed("#102030", "#ffffff", 0.0) == "#102030"


# -- payloads ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("grip", ["time: 0.21", 'when: "q.hinge - 0.6"'])
@pytest.mark.parametrize("data", ["inertia: {xx: 0.02, yy: 0.03, zz: 0.04}", "inertia: {zz: 0.01}"])
def test_a_payload_is_a_body_at_its_place_while_it_is_carried(grip: str, data: str) -> None:
    """One body is carried from the start up to a time and flies on from there, the other from a time or an event on; both
    are heavy."""
    result = simulate(
        load_scene_text(
            f"""
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{{name: hinge, type: revolute, axis: [0, 0, 1]}}]
  links: [{{name: arm, mass: 2, com: [0.2, 0, 0], inertia: {{zz: 0.4}}}}]
  points: {{tip: {{link: arm, at: [0.7, 0.1, 0]}}}}
payloads:
  - {{name: first, at: tip, mass: 300, {data}, until: {{time: 0.4}}}}
  - {{name: second, at: tip, mass: 300, com: [0.1, 0, 0], {data}, from: {{{grip}}}}}
initial: {{q: {{hinge: 0}}, qd: {{hinge: 3}}}}
simulate: {{duration: 1, samples: 51}}
"""
        )
    )
    drawing = make_drawing(result)
    assert drawing.flat == 2 and default_camera(drawing).distance == math.inf
    q, t = result["q"][:, 0], drawing.times
    grips = next(event["time"] for event in result.events if event["kind"] == "grip")
    assert 0.15 < grips < 0.35
    for name, x, shown in (("first", 0.7, t <= 0.4), ("second", 0.8, t > grips)):
        (part,) = [part for part in drawing.parts if part.name == name]
        corners = drawing.vertices[:, list(part.vertices)]
        place = np.column_stack([x * np.cos(q) - 0.1 * np.sin(q), x * np.sin(q) + 0.1 * np.cos(q), 0.0 * q])
        assert np.array_equal(np.isfinite(corners).all(axis=(1, 2)), shown | (name == "first"))
        np.testing.assert_allclose(corners[shown].mean(axis=1), place[shown], rtol=0, atol=1e-12)
    view = View(drawing, default_camera(drawing))
    bodies = [sum(s.layer == BODY and s.closed for s in strokes(view, k, grid=False)) for k in (1, 25)]
    assert bodies == [1 + int((t > grips)[k]) for k in (1, 25)] == [1, 2]  # carried or in flight


@pytest.mark.parametrize(
    ("joints", "distance", "spring", "damper", "drawn"),
    [(2, 1.0, False, True, 1), (2, 1.0, True, True, 2), (2, 1.0, True, False, 1), (30, 0.1, False, True, 0)],
)
def test_a_damper_about_a_joint_is_a_dashpot_and_none_hides_a_long_chain(
    joints: int, distance: float, spring: bool, damper: bool, drawn: int
) -> None:
    forces = ", spring: {stiffness: 1}" * spring + ", damper: {damping: 0.1}" * damper
    rows = [
        f"    - {{name: j{k}, type: revolute, a: {distance}, alpha: 0, d: 0{forces}}}" for k in range(joints)
    ]
    links = [
        f"    - {{name: l{k}, mass: 1, com: [0, 0, 0], com_frame: joint, inertia: {{zz: 0.1}}}}"
        for k in range(joints)
    ]
    head = ["schema: 1", "gravity: [0, 0, 0]", "robot:", "  convention: standard", "  joints:"]
    start = "initial: {q: {" + ", ".join(f"j{k}: 0.1" for k in range(joints)) + "}}"
    text = "\n".join([*head, *rows, "  links:", *links, start])
    result = simulate(
        load_scene_text(text + "\nsimulate: {duration: 0.01, samples: 2, error_estimate: false}\n")
    )
    view = fitted(make_drawing(result))
    assert {pin.about for pin in view.drawing.pins} == {("damper",) * damper + ("spring",) * spring}
    # only these have more points than a link or a joint, or parts
    curled = [s for s in strokes(view, 0, grid=False) if len(s.points) > 30 and not s.closed]
    assert len(curled) == joints * drawn
    in_parts = [s for s in curled if np.isnan(s.points).any()]
    assert len(in_parts) == joints * drawn * damper // max(1, spring + damper), "a dashpot consists of parts"
    circles = [s for s in strokes(view, 0, grid=False) if s.closed and len(s.points) == len(symbols.CIRCLE)]
    widest = max(float(np.ptp(s.points, axis=0).max()) + s.width * view.pt for s in circles)
    assert len(circles) >= joints and widest < 0.4 * distance, "marks leave most of each link to be seen"


def test_faint_poses_of_a_slide_show_its_block_and_of_a_body_its_box() -> None:
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: JOINT}]
  links: [{name: block, mass: 1, com: [0, 0, 0], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}]
initial: {q: {x: START}}
simulate: {duration: 0.1, samples: 3, error_estimate: false}
"""
    for joint, start in (
        ("prismatic, axis: [1, 0, 0]", "0.1"),
        ("floating", "{x: 0.1, y: 0, z: 0, rpy: [0, 0, 0]}"),
    ):
        result = simulate(load_scene_text(text.replace("JOINT", joint).replace("START", start)))
        outlines = silhouette(fitted(make_drawing(result)), 0)
        assert outlines and all(np.ptp(line, axis=0).min() > 0.0 for line in outlines)


def test_several_latches_are_drawn_while_they_are_closed() -> None:
    path = next(p for p in SCENES if p.stem == "solar_array_springs")
    release = ["deploy.latches.latch2.release=t - 3", "deploy.until=end", "simulate.error_estimate=false"]
    result = deploy(load_scene(path, release))
    drawing = make_drawing(result, evenly(len(result.time), 60))
    locks = result.summary["locks"]
    first, second, third = drawing.latches
    assert first.closed == ((locks["latch1"]["time"], np.inf),) and third.closed == (
        (locks["latch3"]["time"], np.inf),
    )
    assert second.closed[0] == (pytest.approx(1.638417, abs=1e-6), pytest.approx(3.0, abs=1e-9))
    assert [second.is_closed(t) for t in (1.0, 2.0, 3.001)] == [False, True, False]
    view = fitted(drawing)
    plates = [len([s for s in strokes(view, k) if s.layer == LATCH]) for k in range(len(drawing.times))]
    assert len(drawing.latches) == 3 and plates[0] == 6 and max(plates) > plates[0]


CATAPULT = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{name: arm, type: revolute, parent: base, axis: [0, 0, 1], spring: {stiffness: 60, rest: -170 deg}}]
  links: [{name: beam, mass: 2, com: [0.5, 0, 0], inertia: {zz: 0.2}}]
  points: {cup: {link: beam, at: [1.1, 0, 0]}}
payloads: [{name: stone, at: cup, mass: 0.8, inertia: {zz: 0.001}, until: {when: "-100 deg - q.arm"}, range: {through: [0, -3, 0]}}]
initial: {q: {arm: 10 deg}}
simulate: {duration: 2, samples: 61, error_estimate: false}
"""


def test_paths_stay_on_the_circle_between_samples_and_on_the_parabola() -> None:
    """Samples lie up to 40 degrees apart; straight lines between them come 6 % nearer to the hinge."""
    result = simulate(load_scene_text(CATAPULT))
    times, path = paths_of(result)["cup"]
    radius = np.linalg.norm(path, axis=1)
    assert len(path) > 10 * len(result.time) and np.abs(radius - 1.1).max() < 1e-12
    tight = simulate(load_scene_text(CATAPULT.replace("samples: 61", "samples: 3001")))
    for k in range(2):
        own = np.interp(tight.time, times, path[:, k])
        assert np.abs(own - tight["points/cup"][:, k])[tight.time > 0.4].max() < 0.02
    drawing = make_drawing(result)
    cup, stone = drawing.trails
    release, landing = (result.summary["payloads"]["stone"][x] for x in ("release", "landing"))
    assert not cup.flight and stone.flight and stone.times[-1] == landing["time"]
    since = (stone.times - result.summary["payloads"]["stone"]["released"])[:, None]
    place, velocity = (np.array(list(release[x].values())) for x in ("position", "velocity"))
    parabola = place + since * velocity + 0.5 * since**2 * np.array([0.0, -9.81, 0.0])
    np.testing.assert_allclose(stone.points, parabola, atol=1e-9)
    near, whole = (View(drawing, default_camera(drawing), near=x) for x in (True, False))
    (low, high), (far_low, far_high) = near.extent, whole.extent
    assert np.abs([low, high]).max() < 1.3 and np.ptp([far_low, far_high], axis=0).max() > 5.0


def test_paths_go_straight_where_something_happens_between_samples() -> None:
    """Rates on both sides of a bounce say nothing of the way between."""
    path = next(p for p in SCENES if p.stem == "bouncing_pendulum")
    result = simulate(load_scene(path, ["simulate.error_estimate=false", "simulate.samples=61"]))
    problem = Problem(load_scene_text(result.scene_text))
    times, q = motion_between(result, problem) or (None, None)
    assert times is not None and q is not None
    np.testing.assert_array_equal(q[np.searchsorted(times, result.time)], result["q"])
    k = int(np.searchsorted(result.time, result.events[0]["time"])) - 1
    inside = (times > result.time[k]) & (times < result.time[k + 1])
    share = (times[inside] - result.time[k]) / np.diff(result.time)[k]
    straight = result["q"][k] + share[:, None] * (result["q"][k + 1] - result["q"][k])
    np.testing.assert_allclose(q[inside], straight, atol=1e-12)
    assert motion_between(simulate(load_scene(path, ["simulate.samples=2001"])), problem) is None


def test_paths_of_a_ball_joint_stay_at_their_distance_however_far_apart_samples_are() -> None:
    path = next(p for p in SCENES if p.stem == "spinning_top")
    for samples, least in ((401, 1000), (21, 21)):  # with 21 of them the top turns several times between two
        result = simulate(load_scene(path, ["simulate.error_estimate=false", f"simulate.samples={samples}"]))
        _, peg = paths_of(result)["peg"]
        joined = np.isfinite(peg).all(axis=1)
        assert (joined[1:] & joined[:-1]).any() == (samples > 100)  # no chords
        radius = np.linalg.norm(peg[joined], axis=1)
        assert len(radius) >= least and np.ptp(radius) < 1e-9 * radius.max()


def test_known_nodes_are_those_without_other_symbols() -> None:
    rng, graph = np.random.default_rng(3), Graph()
    leaves = [graph.symbol(f"{group}{k}", group, k) for group in ("q", "v", "unknown") for k in range(3)]
    nodes: list[Any] = list(leaves)
    for _ in range(300):
        a, b = (nodes[k] for k in rng.integers(len(nodes), size=2))
        nodes.append(a * b + 1.0 if rng.uniform() < 0.5 else a - 2.0 * b)
    known = KnownNodes(("q", "v"))
    for k in rng.permutation(len(nodes)):
        wanted = all(symbol.value[1] != "unknown" for symbol in free_symbols([nodes[k]]))
        assert known([nodes[k], 3.0]) is wanted
