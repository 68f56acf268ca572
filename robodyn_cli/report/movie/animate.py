"""From a stored result to a movie, or to a strip of stills."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from robodyn_cli.errors import CapabilityError, did_you_mean
from robodyn_cli.report.drawing.build import require_poses
from robodyn_cli.report.movie.plan import plan_movie
from robodyn_cli.results.result import Result

FPS = 25.0
KINDS = (".gif", ".mp4", ".webp", ".png")


def animate(
    result: Result, target: Path, speed: float | None = None, fps: float = FPS, follow: str | None = None
) -> dict[str, Any]:
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
    return {"file": str(target), "frames": plan.frames, "held": plan.held, "fps": plan.fps, "speed": plan.speed,
            "duration": plan.frames / plan.fps, "size": target.stat().st_size}  # fmt: skip


def _strip(result: Result, target: Path, follow: str | None) -> dict[str, Any]:
    from robodyn_cli.report.canvas import save
    from robodyn_cli.report.movie.strip import draw_strip
    from robodyn_cli.report.style import styled

    with styled():
        figure = draw_strip(result, follow)
        save(figure, target)
    return {"file": str(target), "stills": len(figure.axes), "size": target.stat().st_size}
