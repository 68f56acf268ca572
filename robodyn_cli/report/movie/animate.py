"""A strip of stills, for papers: some instants side by side, at one scale.

From a stored result to a movie, or to a strip of stills.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError, did_you_mean
from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.drawing import paper
from robodyn_cli.report.drawing.build import make_drawing, require_poses
from robodyn_cli.report.drawing.camera import View, default_camera
from robodyn_cli.report.drawing.places import along_motion, evenly
from robodyn_cli.report.movie.frames import plan_movie
from robodyn_cli.report.ticks import number
from robodyn_cli.results.result import Result
from robodyn_cli.summaries.checks import MovieReport

STILLS = 6
ACROSS, ACROSS_WIDE = 3, 2  # stills side by side, and of drawings that are wide
WIDE = 1.6  # width over height from which on a drawing is wide
STRIP_WIDTH, BETWEEN = 5.9, 0.15  # of all stills side by side, and between them [inch]
RIM = 0.3  # above and below a still, for the marks of joints [inch]


def draw_strip(result: Result, follow: str | None = None) -> Any:
    """Return a figure of some instants equally far apart along the motion."""
    samples = evenly(len(result.time), 400)
    drawing = make_drawing(result, samples)
    chosen = along_motion(drawing, STILLS)
    poses = drawing.at(chosen)
    places = None if follow is None else result[f"points/{follow}"][samples[np.array(chosen)]]
    view = View(poses, default_camera(drawing), places)
    width, height = view.extent[1] - view.extent[0]
    across = min(ACROSS_WIDE if width > WIDE * height else ACROSS, len(chosen))
    wide = (STRIP_WIDTH - (across - 1) * BETWEEN) / across
    high = paper.height_of(view, wide, 0.8, 2.0 * wide) + RIM
    sheet = Sheet(
        result,
        paper.caption(view),
        panels=len(chosen),
        across=across,
        height=high,
        gap=0.3,
        between=BETWEEN,
        numbered=False,
    )
    for k, ax in enumerate(sheet.axes):
        paper.set_up(ax, view, scale=False)
        paper.put(ax, view, k)
        ax.set_title(f"t = {number(float(poses.times[k]), 4)} s", fontsize=style.FONT_SIZE, loc="left", pad=3)
    return sheet.figure


FPS = 25.0
KINDS = (".gif", ".mp4", ".webp", ".png")


def animate(
    result: Result, target: Path, speed: float | None = None, fps: float = FPS, follow: str | None = None
) -> MovieReport:
    """Write a movie of a result, or a strip of stills as PNG; return what it shows.

    Parameters
    ----------
    speed : seconds of the run in a second of the movie; None for 1, or a round number that makes it some seconds long.
    follow : a named point that stays in the middle.

    Raises
    ------
    CapabilityError : the kind of file is unknown or has no encoder, the result has no poses or the movie too many
        frames, there is no such point. OutputError : it cannot be written.
    """
    suffix = target.suffix.lower()
    if suffix not in KINDS:
        raise CapabilityError(f"{target}: unknown kind of picture {suffix!r}; allowed: {', '.join(KINDS)}")
    require_poses(result)
    points = list(result.group("points"))
    if follow is not None and follow not in points:
        listed = ", ".join(points) or "none in this result"
        raise CapabilityError(
            f"--follow: no point {follow!r}{did_you_mean(follow, points)}; allowed: {listed}"
        )
    if suffix == ".png":
        return _strip(result, target, follow)
    from robodyn_cli.report.movie.files import require_encoder, write_movie
    from robodyn_cli.report.movie.frames import Frames
    from robodyn_cli.report.style import styled

    require_encoder(suffix)
    plan = plan_movie(result, speed, fps, suffix == ".gif")
    with styled():
        write_movie(Frames(result, plan, follow), target)
    return MovieReport(
        "ok", str(target), target.stat().st_size, frames=plan.frames, held=plan.held, fps=plan.fps,
        speed=plan.speed, duration=plan.frames / plan.fps,
    )  # fmt: skip


def _strip(result: Result, target: Path, follow: str | None) -> MovieReport:
    from robodyn_cli.report.canvas import save
    from robodyn_cli.report.style import styled

    with styled():
        figure = draw_strip(result, follow)
        save(figure, target)
    return MovieReport("ok", str(target), target.stat().st_size, stills=len(figure.axes))
