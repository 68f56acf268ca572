"""Which samples a movie shows, and how fast it goes.

Frames of a movie as pixels: what stands still is drawn once, what moves is painted over it.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from robodyn_cli.errors import CapabilityError
from robodyn_cli.record import record
from robodyn_cli.report import style
from robodyn_cli.report.drawing import paper
from robodyn_cli.report.drawing.build import make_drawing
from robodyn_cli.report.drawing.camera import View, default_camera
from robodyn_cli.report.drawing.paper import paint
from robodyn_cli.report.drawing.places import nearest
from robodyn_cli.report.drawing.strokes import strokes
from robodyn_cli.report.numbers import number
from robodyn_cli.results.moments import LASTING, Moment, moments
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

SHORTEST, LONGEST = 3.0, 20.0  # seconds of a movie whose speed is not asked for
STEPS = (1.0, 2.0, 5.0)
HOLD = 1.5  # seconds for which the last frame stays
MOST_FRAMES = 5000
HUNDREDTHS = 100  # of a second: the unit of delays in a GIF


@record
class MoviePlan:
    """What a movie shows.

    speed : seconds of the run in a second of the movie. fps : frames in a second. samples : (K,) of the result, one a
    frame, which shows what was computed at the sample nearest to its time. held : how often the last one is repeated.
    """

    speed: float
    fps: float
    samples: Array
    held: int

    @property
    def frames(self) -> int:
        """Number of frames, those included that hold the last pose."""
        return len(self.samples) + self.held


def plan_movie(result: Result, speed: float | None, fps: float, hundredths: bool) -> MoviePlan:
    """Return which samples of a result a movie shows.

    Parameters
    ----------
    speed : None for 1, or the round number that makes the movie take some seconds. hundredths : whether a frame lasts
        whole hundredths of a second, as in a GIF; fps is then the nearest that fits.

    Raises
    ------
    CapabilityError : the result is a single pose, or the movie would have too many frames.
    """
    if len(result.time) < 2 or not result.time[-1] > result.time[0]:
        raise CapabilityError(
            f"the result of '{result.command}' is one pose without motion; draw it with --file NAME.png"
        )
    if hundredths:
        fps = HUNDREDTHS / max(2, round(HUNDREDTHS / fps))
    start, end = float(result.time[0]), float(result.time[-1])
    if speed is None:
        speed = usual_speed(end - start)
    count = math.floor((end - start) / speed * fps + 1e-9) + 1
    if count > MOST_FRAMES:
        least = (end - start) * fps / MOST_FRAMES
        raise CapabilityError(
            f"{count} frames are too many; allowed: {MOST_FRAMES}, so a --speed of at least {least:.2g}, or fewer --fps"
        )
    times = start + np.arange(count) * speed / fps
    samples = nearest(result.time, times)
    if samples[-1] != len(result.time) - 1:
        samples = np.append(samples, len(result.time) - 1)
    return MoviePlan(speed, fps, samples, round(HOLD * fps))


def usual_speed(duration: float) -> float:
    """Return 1 where a movie of that many seconds is neither over at once nor long, else a round number near to it."""
    if SHORTEST <= duration <= LONGEST:
        return 1.0
    ideal = duration / (LONGEST if duration > LONGEST else SHORTEST)
    power = 10.0 ** math.floor(math.log10(ideal))
    steps = [step * power for step in (*STEPS, 10.0)]
    # slow enough at the short end, short enough at the long one
    if duration > LONGEST:
        return next(step for step in steps if step >= ideal * (1.0 - 1e-9))
    return [step for step in steps if step <= ideal * (1.0 + 1e-9)][-1]


DPI = 100
WIDTH = 6.4  # [inch]
TITLE, FOOT = 0.42, 0.3  # rooms above and below the drawing [inch]
LEAST, MOST = 2.2, 5.2  # height of the drawing [inch]
SHOWN_FOR = 1.0  # seconds of the movie for which a moment is told


Seen = Callable[[float, float, str], None]


class Frames:
    """The frames of a movie: RGBA arrays (height, width, 4) of bytes, height and width even.

    Parameters
    ----------
    follow : name of the point that stays in the middle, None for a camera that stands still.
    seen : is told before each picture that is asked for how many there were, and how many there are.
    """

    def __init__(
        self, result: Result, plan: MoviePlan, follow: str | None = None, seen: Seen = lambda *_: None
    ) -> None:
        self.plan, self.seen = plan, seen
        self.drawing = make_drawing(result, plan.samples)
        places = None if follow is None else result[f"points/{follow}"][plan.samples]
        self.view = View(self.drawing, default_camera(self.drawing), places)
        self.moments = moments(result)
        height = paper.height_of(self.view, WIDTH, LEAST, MOST)
        total = round((height + TITLE + FOOT) * DPI / 2) * 2 / DPI
        self.figure = Figure(figsize=(WIDTH, total), dpi=DPI)
        self.canvas: Any = FigureCanvasAgg(self.figure)
        self.ax = self.figure.add_axes((0.0, FOOT / total, 1.0, 1.0 - (TITLE + FOOT) / total))
        paper.set_up(self.ax, self.view, scale=False)
        if not self.view.flat:
            paper.cross_of_axes(self.ax, self.view)
        self._still(result, total, follow)

    def _still(self, result: Result, total: float, follow: str | None) -> None:
        """Add the words that do not change, and those that do, which are drawn with each frame."""
        title = textwrap.shorten(result.title or result.command, 62, placeholder=" ...")
        self.figure.text(0.02, 1.0 - 0.12 / total, title, fontsize=11, fontweight="bold", va="top")
        words = [paper.caption(self.view)]
        words += [f"speed {number(self.plan.speed)}"] if self.plan.speed != 1.0 else []
        words += [f"follows {follow}"] if follow is not None else []
        foot: dict[str, Any] = {"fontsize": 8.5, "color": style.GREY, "va": "bottom"}
        self.figure.text(0.98, 0.1 / total, ", ".join(words), ha="right", **foot)
        self.told = self.figure.text(0.02, 0.1 / total, "", ha="left", **{**foot, "color": style.ALARM})
        self.clock = self.figure.text(0.98, 1.0 - 0.12 / total, "", fontsize=11, ha="right", va="top")

    def __len__(self) -> int:
        """Return the number of different pictures; the last one is to stay for ``plan.held`` frames more."""
        return len(self.drawing.times)

    @cached_property
    def _background(self) -> Any:
        """What stands still, drawn once."""
        for moving in (self.told, self.clock):
            moving.set_visible(False)
        self.canvas.draw()
        background = self.canvas.copy_from_bbox(self.figure.bbox)
        for moving in (self.told, self.clock):
            moving.set_visible(True)
        return background

    def picture(self, k: int) -> Array:
        """Return the k-th picture, (height, width, 4) bytes; it is overwritten by the next one."""
        self.canvas.restore_region(self._background)
        renderer = self.canvas.get_renderer()
        paint(renderer, strokes(self.view, k), self.ax.transData, self.ax.bbox)
        self._write(k, renderer)
        return np.asarray(self.canvas.buffer_rgba())

    def __iter__(self) -> Iterator[Array]:
        """Yield the pictures one after another."""
        for k in range(len(self)):
            self.seen(k, len(self), "pictures")
            yield self.picture(k)

    def _write(self, k: int, renderer: Any) -> None:
        """Write the time, and what has just happened."""
        time = float(self.drawing.times[k])
        self.clock.set_text(f"t = {time:.{self._digits}f} s")
        shown = [m.text for m in self.moments if self._fresh(m, time)]
        self.told.set_text("; ".join(dict.fromkeys(shown[-3:])))
        self.clock.draw(renderer)
        self.told.draw(renderer)

    def _fresh(self, moment: Moment, time: float) -> bool:
        """Tell whether a moment is told: for a while, and what a run ends or changes by for good."""
        passed = time * (1.0 + 1e-12) - moment.time
        return passed >= 0.0 and (moment.kind in LASTING or passed <= SHOWN_FOR * self.plan.speed)

    @property
    def _digits(self) -> int:
        """Digits of the clock behind the point: as many as a frame moves."""
        step = self.plan.speed / self.plan.fps
        return int(np.clip(np.ceil(-np.log10(step)), 0, 9))
