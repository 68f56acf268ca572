"""Movies: which samples they show, how fast, that files hold what they say, and that mistakes leave nothing behind."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from robodyn_cli.cli.app import run
from robodyn_cli.cli.commands.animate import describe
from robodyn_cli.errors import CapabilityError
from robodyn_cli.report.drawing.build import make_drawing
from robodyn_cli.report.drawing.paper import Painted
from robodyn_cli.report.drawing.record import PAPER, mixed
from robodyn_cli.report.movie import animate as files
from robodyn_cli.report.movie.animate import animate, draw_strip
from robodyn_cli.report.movie.frames import HOLD, MOST_FRAMES, Frames, plan_movie, usual_speed
from robodyn_cli.report.style import styled
from robodyn_cli.results.hdf5 import write
from robodyn_cli.results.result import Result
from tests.unit.synthetic_results import FOUR_BAR, four_bar_result, pendulum_result


@pytest.fixture(scope="module")
def result() -> Result:
    found = four_bar_result(120)
    theta, phi = found["q"][:, 0], found["q"][:, 1]
    found.add("points/pin", np.stack([np.cos(theta), np.sin(theta), 0.0 * phi], axis=1))
    found.summary["lock"]["latch"] = {"energy_lost": 1.0}
    return found


# -- plan -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("speed", "fps"), [(1.0, 25.0), (0.25, 30.0), (3.0, 12.5), (None, 50.0)])
def test_frames_show_the_samples_nearest_to_their_times(
    result: Result, speed: float | None, fps: float
) -> None:
    plan = plan_movie(result, speed, fps, hundredths=False)
    wanted = np.arange(len(plan.samples)) * plan.speed / plan.fps
    gaps = np.abs(result.time[plan.samples] - wanted)
    assert gaps[:-1].max() <= 0.5 * np.diff(result.time).max() * (1 + 1e-9)
    assert plan.samples[0] == 0 and plan.samples[-1] == len(result.time) - 1
    assert plan.held == round(HOLD * plan.fps)


@pytest.mark.parametrize(
    ("fps", "exact"), [(25.0, 25.0), (30.0, 100.0 / 3.0), (24.0, 25.0), (100.0, 50.0), (3.0, 100.0 / 33.0)]
)
def test_a_gif_keeps_the_speed_although_its_delays_are_whole_hundredths(
    result: Result, fps: float, exact: float
) -> None:
    plan = plan_movie(result, 1.0, fps, hundredths=True)
    assert plan.fps == pytest.approx(exact)
    assert len(plan.samples) / plan.fps == pytest.approx(result.time[-1], abs=2.0 / plan.fps)


@pytest.mark.parametrize("duration", [1e-4, 0.03, 0.5, 2.0, 3.0, 12.3, 20.0, 25.0, 90.0, 3600.0, 1e7])
def test_the_usual_speed_is_round_and_the_movie_some_seconds_long(duration: float) -> None:
    speed = usual_speed(duration)
    assert f"{speed:.0e}"[0] in "125" and speed == pytest.approx(float(f"{speed:.0e}"))
    assert 2.9 <= duration / speed <= 20.1
    assert speed == 1.0 or not 3.0 <= duration <= 20.0


def test_too_many_frames_and_a_single_pose_are_refused(result: Result) -> None:
    with pytest.raises(CapabilityError, match=f"allowed: {MOST_FRAMES}, so a --speed of at least"):
        plan_movie(result, 1e-3, 25.0, False)
    still = four_bar_result(1)
    with pytest.raises(CapabilityError, match="one pose without motion; draw it with --file NAME.png"):
        plan_movie(still, None, 25.0, False)


# -- files ----------------------------------------------------------------------------------------------------
def test_a_gif_holds_the_frames_it_says_and_white_stays_white(result: Result, tmp_path: Path) -> None:
    report = animate(result, tmp_path / "a.gif", speed=4.0, fps=10.0)
    with Image.open(tmp_path / "a.gif") as movie:
        lasts = []
        for k in range(movie.n_frames):
            movie.seek(k)
            lasts.append(movie.info["duration"])
        assert sum(lasts) == pytest.approx(1000.0 * report.duration, abs=20.0)
        assert movie.info["loop"] == 0
        last = np.asarray(movie.convert("RGB"))
        movie.seek(0)
        first = np.asarray(movie.convert("RGB"))
    assert (first[2, 2] == 255).all() and (last[2, 2] == 255).all()
    assert (first != last).any(axis=2).mean() > 0.02
    again = tmp_path / "b.gif"
    animate(result, again, speed=4.0, fps=10.0)
    assert again.read_bytes() == (tmp_path / "a.gif").read_bytes()


def test_pictures_of_a_gif_are_those_that_were_drawn(result: Result, tmp_path: Path) -> None:
    """The palette moves no colour of an area; only the soft rims of lines may shift."""
    plan = plan_movie(result, 4.0, 5.0, True)
    animate(result, tmp_path / "a.gif", speed=4.0, fps=5.0)
    with styled():
        drawn = Frames(result, plan).picture(3)[..., :3].astype(int)
    with Image.open(tmp_path / "a.gif") as movie:
        movie.seek(3)
        stored = np.asarray(movie.convert("RGB")).astype(int)
    off = np.abs(drawn - stored).max(axis=2)
    assert (off > 6).mean() < 0.03 and off.mean() < 1.0


def test_webp_and_the_strip(result: Result, tmp_path: Path) -> None:
    report = animate(result, tmp_path / "a.webp", speed=8.0, fps=5.0)
    with Image.open(tmp_path / "a.webp") as movie:
        assert 1 < movie.n_frames <= report.frames
    strip = animate(result, tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as image:
        assert image.width == 840 and (np.asarray(image.convert("L")) < 200).any()
    assert strip.stills == 6


def test_mp4_has_all_frames_at_their_rate(result: Result, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    report = animate(result, tmp_path / "a.mp4", speed=4.0, fps=12.5)
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        assert float(stream.average_rate) == pytest.approx(12.5)
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert len(pictures) == report.frames
    with styled():
        drawn = Frames(result, plan_movie(result, 4.0, 12.5, False)).picture(0)[..., :3]
    assert np.abs(pictures[0].astype(int) - drawn).mean() < 3.0


def test_a_camera_that_follows_keeps_the_point_in_place(result: Result) -> None:
    plan = plan_movie(result, 4.0, 5.0, True)
    frames = Frames(result, plan, follow="pin")
    # the crank ends at the pin
    crank = next(part for part in frames.drawing.links if part.name == "crank")
    places = frames.view.corners[:, crank.vertices[1], :2]
    assert np.ptp(places, axis=0) == pytest.approx([0.0, 0.0], abs=1e-12)
    assert (frames.picture(0).copy() != frames.picture(9)).any()


def test_a_strip_follows_a_point_in_a_flat_drawing(result: Result) -> None:
    """In every still the coupler begins where the camera looks, at its origin, for there is the pin."""
    with styled():
        figure = draw_strip(result, follow="pin")
    links = make_drawing(result, [0]).links
    colour = mixed(next(part.colour for part in links if part.name == "coupler"), PAPER, 0.62)
    for ax in figure.axes:
        painted = next(artist for artist in ax.artists if isinstance(artist, Painted))
        coupler = next(stroke.points for stroke in painted.strokes if stroke.colour == colour)
        assert np.linalg.norm(coupler, axis=1).min() < 1e-9 * np.ptp(ax.get_xlim())


def test_moments_are_told_when_they_happen(result: Result) -> None:
    frames = Frames(result, plan_movie(result, 1.0, 25.0, False))
    frames.picture(len(frames) - 1)
    assert frames.told.get_text() == "dead point; latch closes"
    frames.picture(5)
    assert frames.told.get_text() == ""


# -- mistakes -------------------------------------------------------------------------------------------------
def test_mistakes_are_one_message_and_leave_nothing(
    result: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = write(result, tmp_path / "result.h5")
    plain = Result("stability", "no motion", "ok", FOUR_BAR)
    other = write(plain, tmp_path / "table.h5")
    foreign = tmp_path / "foreign.h5"
    foreign.write_text("not HDF5")
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(stored.read_bytes()[:2000])
    old = write(dataclasses.replace(result, scene_text="schema: 1\nrobot: {}\n"), tmp_path / "old.h5")
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.setattr(files.importlib.util, "find_spec", lambda name: None)
    cases: list[tuple[list[str], int, str]] = [
        ([str(stored), "--file", "a.avi"], 2, "allowed: .gif, .mp4, .webp, .png"),
        ([str(stored), "--file", "a"], 2, "allowed: .gif"),
        ([str(stored), "--file", "a.mp4"], 2, "pip install 'robodyn[movie]'"),
        ([str(other), "--file", "a.gif"], 2, "has no poses to draw"),
        ([str(foreign), "--file", "a.gif"], 2, "cannot be read as HDF5"),
        ([str(damaged), "--file", "a.gif"], 2, "cannot be read as HDF5"),
        ([str(old), "--file", "a.gif"], 2, "the scene stored in the result cannot be read"),
        ([str(tmp_path / "none.h5"), "--file", "a.gif"], 2, "no such file"),
        ([str(stored), "--file", "a.gif", "--follow", "pinn"], 2, "did you mean 'pin'"),
        ([str(stored), "--file", "a.gif", "--speed", "0"], 2, "allowed: a number > 0"),
        ([str(stored), "--file", "a.gif", "--fps", "nan"], 2, "<= 100"),
        ([str(stored), "--file", "nowhere/a.gif"], 74, "cannot write nowhere"),
    ]
    place = tmp_path / "empty"
    place.mkdir()
    monkeypatch.chdir(place)
    for words, code, message in cases:
        assert run(["animate", *words]) == code, words
        said = capsys.readouterr().err
        assert message in said and said.count("robodyn: error:") == 1, said
        assert list(place.iterdir()) == [], words


def test_a_failure_half_way_leaves_the_old_file(
    result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "a.gif"
    target.write_text("old")

    def fail(self: Frames, k: int, renderer: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Frames, "_write", fail)
    with pytest.raises(KeyboardInterrupt):
        animate(result, target)
    assert target.read_text() == "old" and list(tmp_path.iterdir()) == [target]


def test_the_command_reports_what_it_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pendulum = pendulum_result(101)
    pendulum.scene_text = """\
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: theta1, type: revolute, a: 1, alpha: 0, d: 0}
    - {name: theta2, type: revolute, a: 1, alpha: 0, d: 0}
  links: [{name: a, mass: 1, com: [1, 0, 0], com_frame: joint}, {name: b, mass: 1, com: [1, 0, 0], com_frame: joint}]
"""
    stored = write(pendulum, tmp_path / "result.h5")
    code = run(
        ["animate", str(stored), "--file", str(tmp_path / "m.gif"), "--speed", "5", "--fps", "10", "--json"]
    )
    report = json.loads(capsys.readouterr().out)
    assert code == 0 and report["frames"] == 21 + 15 and report["held"] == 15 and report["speed"] == 5.0
    assert "(21 frames, then the last one for 1.5 s; 3.6 s in all at 10 a second" in describe(report)
    assert report["size"] == (tmp_path / "m.gif").stat().st_size
