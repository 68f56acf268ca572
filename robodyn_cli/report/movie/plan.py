"""Which samples a movie shows, and how fast it goes."""

from __future__ import annotations

import math

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.record import record
from robodyn_cli.report.drawing.instants import nearest
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

SHORTEST, LONGEST = 3.0, 20.0  # seconds of a movie whose speed is not asked for
STEPS = (1.0, 2.0, 5.0)
HOLD = 1.5  # seconds for which the last frame stays
MOST_FRAMES = 5000
HUNDREDTHS = 100  # of a second: the unit of delays in a GIF


@record
class Plan:
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


def plan_movie(result: Result, speed: float | None, fps: float, hundredths: bool) -> Plan:
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
    return Plan(speed, fps, samples, round(HOLD * fps))


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
