"""The recorded run of a deployment: up to what the scan has found to end it, on the scene's grid."""

from __future__ import annotations

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.events import GO_ON, STOP, Event, EventKind, Outcome
from robodyn_cli.integrators.runtime.options import Grid
from robodyn_cli.motion.driver import Driver, Repeat
from robodyn_cli.motion.joint_limits import LimitWatcher
from robodyn_cli.motion.motion import Motion
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.tools.progress import Progress
from robodyn_cli.works.deploy.scan import Pose, Scan, ScanEnd

# smallest singular value of the passive block, relative to the largest of Psi, that is still worth reporting
NEAR_SINGULAR = 1e-3
SHORT_OF = 1e-2  # part of the extrapolated way to a loss of rank that samples stay short of it
AT_EVENT = 1e-9  # part of the time by which an event may come sooner than in the scan


class StopAt:
    """Ends a run at the event at ``time`` [s], passing those before; None: at none."""

    def __init__(self, time: float | None) -> None:
        self.time = time

    def handle(self, event: Event) -> Outcome:
        if self.time is None or event.time < self.time - AT_EVENT * max(1.0, self.time):
            return GO_ON
        return STOP

    def again(self) -> None:
        return None


def record_motion(
    motion: Motion, found: Scan, end: ScanEnd, recorder: Recorder, progress: Progress
) -> Driver:
    """Integrate once more and observe; the last sample is the end itself.

    The events are those of the scan, so that the steps are the same and a singular configuration is met in the
    same way: by a step from afar, never by creeping up to it.
    """
    stretch = _stretch(motion, found, end)
    driver = _driver(motion, found, stretch.event)
    driver.tick = lambda time: progress(time, stretch.end)

    def emit(t: Array, x: Array) -> None:
        if found.driven:
            # close to the dead point the rates of the passive joints grow without bound: nothing to report there
            angle = motion.observer.singular_ratio(t, x)
            t, x = t[angle > NEAR_SINGULAR], x[angle > NEAR_SINGULAR]
        if len(t):
            recorder.emit(t, x, driver.parameters)
        progress(float(t[-1]) if len(t) else stretch.end, stretch.end)

    driver.start(0.0, motion.start)
    try:
        driver.run(stretch.end, stretch.grid, emit)
    except NumericalError:
        if found.stopped is None:
            raise
    if stretch.lost is not None:
        time, state = stretch.lost
        recorder.emit(np.array([time]), state[None, :].copy(), driver.parameters, project=False, extra=True)
        recorder.make_last_least_norm(time)
    elif not found.driven:
        recorder.keep_last_state(driver.time, driver.state, driver.parameters)
    return driver


@record
class _RecordedStretch:
    """What is recorded: samples of ``grid`` up to ``end`` [s].

    event : time of the located pose that ends the run, None where it ends otherwise. lost : the pose in which the loops
    lose rank, which becomes the last sample.
    """

    grid: Grid
    end: float
    event: float | None
    lost: Pose | None


def _stretch(motion: Motion, found: Scan, end: ScanEnd) -> _RecordedStretch:
    """Return what is recorded of a motion, by what ends it."""
    s = motion.scene.simulate
    grid = Grid.over(s.duration, s.samples)
    lost = found.bifurcation if end.bifurcated else None
    stop = lost[0] if lost is not None else end.time
    located = (
        []
        if found.driven
        else [pose[0] for pose in (found.dead_point, found.bifurcation, found.latched) if pose]
    )
    event = stop if stop in located else None
    until = s.duration if stop is None or event is not None else stop
    if found.stopped is not None:
        until = min(until, found.end)
    if lost is not None:
        # the way from the threshold on was travelled by extrapolation; samples stop short of the pose
        until = lost[0] - SHORT_OF * (lost[0] - found.clean_until)
        grid = grid.up_to(int(until / grid.step) + 1)
    return _RecordedStretch(grid, until, event, lost)


def _driver(motion: Motion, found: Scan, stop: float | None) -> Driver:
    """Return the driver of the recorded run, which stops at the pose that was located at ``stop`` [s].

    It changes the method after the same steps as the scan.
    """
    at = StopAt(stop)
    poses = (EventKind.RANK_LOSS, EventKind.DEAD_POINT, EventKind.LATCH)
    system = motion.system.watched_by(lambda e: at if e.kind in poses else e.owner)
    # of limits that are passed the recorded run tells, since the scan goes on behind its end
    watchers = [w for w in motion.watchers if w.changes_motion or isinstance(w, LimitWatcher)]
    return Driver(system, motion.choice.method, motion.options, watchers, Repeat(found.changes))
