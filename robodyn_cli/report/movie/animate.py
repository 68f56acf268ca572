"""From a stored result to a movie (GIF and WebP by Pillow, MP4 by PyAV), or to a strip of stills at one scale."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError, did_you_mean, of_option
from robodyn_cli.report import numbers, style
from robodyn_cli.report.canvas import Sheet, save
from robodyn_cli.report.drawing import paper
from robodyn_cli.report.drawing.build import make_drawing, require_poses
from robodyn_cli.report.drawing.camera import View, default_camera
from robodyn_cli.report.drawing.places import along_motion
from robodyn_cli.report.movie.frames import Frames, Seen, plan_movie
from robodyn_cli.report.style import styled
from robodyn_cli.results.atomic import written
from robodyn_cli.results.result import Result, evenly
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.checks import MovieReport

COLOURS = 127  # what is left of 256 lets Pillow mark what has not changed
STEP = 16  # levels by which colours of the palette differ
SAMPLED = 6  # pictures from which the palette is made
QUALITY = 80  # of WebP, of 100
RATE_FACTOR = "20"  # of H.264, where less is better: at 18 nobody sees a difference


def write_movie(frames: Frames, target: Path) -> None:
    """Write a movie to a file of the kind that its suffix says, whole or not at all.

    Raises
    ------
    OutputError : it cannot be written.
    """
    with written(target) as temporary:
        WRITERS[target.suffix.lower()](frames, temporary)


def require_encoder(suffix: str) -> None:
    """Refuse a kind of movie that nothing here can write.

    Raises
    ------
    CapabilityError : it needs a package that is not installed.
    """
    if suffix == ".mp4" and importlib.util.find_spec("av") is None:
        raise CapabilityError(
            "MP4 needs the package PyAV: pip install 'robodyn[movie]' (or 'av'); GIF and WebP need nothing more"
        )


def _durations(frames: Frames) -> list[int]:
    """Return how long each picture stays [ms]."""
    one = 1000.0 / frames.plan.fps
    return [round(one)] * (len(frames) - 1) + [round(one * (1 + frames.plan.held))]


def _image(picture: Array) -> Any:
    """Return a picture as Pillow's image, without the layer that says how opaque it is."""
    from PIL import Image

    height, width, _ = picture.shape
    return Image.frombuffer("RGBA", (width, height), picture, "raw", "RGBA", 0, 1).convert("RGB")


def _gif(frames: Frames, path: Path) -> None:
    """Write a GIF with one palette for all pictures: a palette a picture takes twice the room and more time."""
    from PIL import Image

    palette = _palette(frames)
    indexed = (_image(p).quantize(palette=palette, dither=Image.Dither.NONE) for p in frames)
    first = next(indexed)
    first.save(
        path, "GIF", save_all=True, append_images=indexed, duration=_durations(frames), loop=0, optimize=False
    )


def _palette(frames: Frames) -> Any:
    """Return an image with the most frequent colours of some pictures, as they are.

    A palette that is fitted to all pixels shifts white and the colours of links. Of colours that are almost equal only
    the most frequent one is taken: Pillow looks for the nearest one in steps of some levels, and would turn white grey.
    """
    from PIL import Image

    chosen = evenly(len(frames), SAMPLED)
    pixels = np.concatenate([frames.picture(int(k))[..., :3].reshape(-1, 3) for k in chosen])
    packed = pixels.astype(np.uint32) @ np.array([65536, 256, 1], dtype=np.uint32)
    colours, counts = np.unique(packed, return_counts=True)
    ordered = colours[np.argsort(-counts, kind="stable")]
    rgb = np.stack([ordered >> 16, ordered >> 8 & 255, ordered & 255], axis=1)
    _, first = np.unique(rgb // STEP, axis=0, return_index=True)
    palette = Image.new("P", (1, 1))
    palette.putpalette(rgb[np.sort(first)[:COLOURS]].ravel().tolist())
    return palette


def _webp(frames: Frames, path: Path) -> None:
    images = (_image(picture) for picture in frames)
    first = next(images)
    first.save(
        path,
        "WEBP",
        save_all=True,
        append_images=images,
        duration=_durations(frames),
        loop=0,
        quality=QUALITY,
    )


def _mp4(frames: Frames, path: Path) -> None:
    """Write H.264 in colours that every player shows."""
    import av

    def repeated() -> Iterator[Any]:
        for k, picture in enumerate(frames):
            for _ in range(1 + (frames.plan.held if k == len(frames) - 1 else 0)):
                yield picture

    rate = Fraction(frames.plan.fps).limit_denominator(1000)
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as container:
        height, width, _ = frames.picture(0).shape
        stream = container.add_stream(
            "libx264", rate=rate, options={"crf": RATE_FACTOR, "preset": "veryfast"}
        )
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for picture in repeated():
            image = av.VideoFrame.from_ndarray(picture, format="rgba")
            container.mux(stream.encode(image))
        container.mux(stream.encode())


WRITERS: dict[str, Callable[[Frames, Path], None]] = {".gif": _gif, ".webp": _webp, ".mp4": _mp4}

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
        ax.set_title(
            f"t = {numbers.times([float(poses.times[k])])[0]}", fontsize=style.FONT_SIZE, loc="left", pad=3
        )
    return sheet.figure


FPS = 25.0
KINDS = (".gif", ".mp4", ".webp", ".png")


def animate(
    result: Result,
    target: Path,
    speed: float | None = None,
    fps: float = FPS,
    follow: str | None = None,
    seen: Seen = lambda *_: None,
) -> MovieReport:
    """Write a movie of a result, or a strip of stills as PNG; return what it shows.

    Parameters
    ----------
    speed : seconds of the run in a second of the movie; None for 1, or a round number that makes it some seconds long.
    follow : a named point that stays in the middle. seen : is told how many pictures are drawn, and of how many.

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
        raise of_option(
            "--follow",
            f"no point {follow!r}{did_you_mean(follow, points)}; allowed: {listed}",
            CapabilityError,
        )
    if suffix == ".png":
        return _strip(result, target, follow)

    require_encoder(suffix)
    plan = plan_movie(result, speed, fps, suffix == ".gif")
    with styled():
        write_movie(Frames(result, plan, follow, seen), target)
    return MovieReport(
        "ok", str(target), target.stat().st_size, frames=plan.frames, held=plan.held, fps=plan.fps,
        speed=plan.speed, duration=plan.frames / plan.fps,
    )  # fmt: skip


def _strip(result: Result, target: Path, follow: str | None) -> MovieReport:
    with styled():
        figure = draw_strip(result, follow)
        save(figure, target)
    return MovieReport("ok", str(target), target.stat().st_size, stills=len(figure.axes))
