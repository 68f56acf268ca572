"""What follows from the courses of many runs that compiled code makes: errors, and figures between samples.

Errors are those of a second integration, by the rules of ``motion.error``. Extremes and loads are those of the same
steps with close samples (``RecordedMotion``), of a motion that takes the numbers of one run after another.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import NumericalError, RobodynError
from robodyn_cli.formulations.events import Event, EventKind, Outcome, Owner
from robodyn_cli.integrators.runtime.fleet import Runs, Sampling
from robodyn_cli.integrators.runtime.memory import DoubleSlot
from robodyn_cli.integrators.runtime.options import JUDGED, Grid, stride_of
from robodyn_cli.kernels.program import Program
from robodyn_cli.motion.conditioning import Conditioning
from robodyn_cli.motion.error import Courses, First, Masks, difference, remainder
from robodyn_cli.motion.motion import Beginning, Motion
from robodyn_cli.motion.self_check import EPS
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.over.many.command import error_of, number_of
from robodyn_cli.over.many.integrate import Driven, RunBatch, first_run, in_parts, second_runs, trust
from robodyn_cli.record import record
from robodyn_cli.results.summary import as_keys
from robodyn_cli.scene.checks.columns import asking
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from robodyn_cli.motion.between.extremes import RecordedMotion

LARGEST = tuple(f"error_estimate.{name}" for name in ("q_max", "qd_max", "state_max", "rounding_floor"))
BETWEEN = ("extremes", "fluctuation", "reactions")  # sections of the summary
NO_NUMBERS = (0.0,)
Figure = tuple[Array, Array]  # values and errors, both (N,)
Rows = NDArray[np.int64]


@record
class CourseErrors:
    """Errors of runs: of states at the end (N, nx), of any position and of any rate over the samples of the scene (N,),
    nan where these are not looked at, and what rounding is expected to leave (N,).

    steps : of the second runs (N,). done : which of these came to their end.
    """

    at_end: Array
    q_max: Array
    qd_max: Array
    floor: Array
    steps: NDArray[np.int64]
    done: Masks

    @staticmethod
    def unknown(shape: tuple[int, ...]) -> CourseErrors:
        """Return errors of runs of which none is estimated; shape : of their states."""
        q_max, qd_max, floor = np.full((3, shape[0]), np.nan)
        steps, done = np.zeros(shape[0], dtype=np.int64), np.zeros(shape[0], dtype=bool)
        return CourseErrors(np.full(shape, np.nan), q_max, qd_max, floor, steps, done)

    def put(self, rows: Rows, other: CourseErrors) -> None:
        """Put those of some runs in their place."""
        for field in dataclasses.fields(self):
            getattr(self, field.name)[rows] = getattr(other, field.name)

    def figures(self) -> dict[str, Figure]:
        """Return keys of the summary that say how accurate the whole motion is."""
        values = (self.q_max, self.qd_max, np.maximum(self.q_max, self.qd_max), self.floor)
        return {key: (x, np.full_like(x, np.nan)) for key, x in zip(LARGEST, values)}


def integrate(
    batch: RunBatch, method: str, samples: int = 0, course: bool = False
) -> tuple[Driven, CourseErrors]:
    """Make the runs of a batch by one method, and estimate their errors by a second integration.

    course : whether errors over all samples of the scene are wanted.
    """
    structure = batch.structure
    simulate = structure.motion.scene.simulate
    if not simulate.error_estimate:
        runs = first_run(batch, method, Sampling(samples))
        return Driven(runs, trust(batch, runs, method)), CourseErrors.unknown(runs.y.shape)
    whole = samples or (max(simulate.samples - 1, 1) if course else 0)
    sampling, wanted, judged = samplings(batch, method, whole)
    runs = first_run(batch, method, sampling)
    trusted, errors = trust(batch, runs, method), CourseErrors.unknown(runs.y.shape)
    if course:
        trusted &= structure.observed_alike(batch.numbers)
    if len(rows := np.flatnonzero(trusted)):
        own = sampling.part(rows), judged, wanted if course else None
        errors.put(rows, _Judge(batch.part(rows), runs.part(rows), method, *own).errors())
        trusted[rows] = errors.done[rows]
    if not samples:
        wanted = slice(0)
    driven = Driven(
        dataclasses.replace(runs, out=runs.out[:, :, wanted]),
        trusted,
        errors.at_end,
        second_steps=errors.steps,
    )
    return driven, errors


def integrate_to(batch: RunBatch, method: str, times: Array) -> CourseErrors:
    """Return the errors of runs up to times (N,) [s] at which an event ended them, with the samples of the scene until
    then."""
    simulate = batch.structure.motion.scene.simulate
    count, every = max(simulate.samples - 1, 1), max(1, int(stride_of(simulate.samples)))
    step, judged = batch.ends / count, slice((count - 1) % every, None, every)
    taken = np.array([Grid(0.0, h, count + 1).first_at(t) for h, t in zip(step, times)]) - 1
    errors = CourseErrors.unknown(batch.states.shape)
    for samples in np.unique(taken):
        rows = np.flatnonzero(taken == samples)
        part = dataclasses.replace(batch.part(rows), ends=times[rows])
        sampling = Sampling(max(int(samples), 0), step[rows])
        runs = part.drive(method, part.options, sampling=sampling, watch=False)
        errors.put(rows, _Judge(part, runs, method, sampling, judged, slice(None), watch=False).errors())
        errors.done[rows] &= runs.arrived
    return errors


@record
class _Judge:
    """Estimates the errors of first runs of a batch by second ones.

    judged : which of the samples count. wanted : those over which errors are largest; None: none. watch : whether to
    look for events.
    """

    batch: RunBatch
    runs: Runs
    method: str
    sampling: Sampling
    judged: slice
    wanted: slice | None = None
    watch: bool = True

    @property
    def first(self) -> First:
        return First(self.batch.options, self.method, self.runs.steps, self.batch.ends)

    def part(self, rows: Any) -> _Judge:
        return dataclasses.replace(
            self, batch=self.batch.part(rows), runs=self.runs.part(rows), sampling=self.sampling.part(rows)
        )

    def errors(self) -> CourseErrors:
        """Return the errors of the runs."""
        second, done = self._again(self.first)
        steep = self.batch.structure.motion.is_steep
        courses, apart = self._courses(second), self._apart(second)
        floor = courses.floor(self.runs.steps, self.batch.ends, self._conditioning, self.runs.rounded)
        courses, doubt = courses.settled(floor, steep)
        if len(rows := np.flatnonzero(done & doubt)):
            few = self.part(rows)
            third, ended = few._again(few.first.once_more(steep))
            more = np.zeros_like(courses.apart)
            more[rows[ended]] = few._courses(third).apart[ended]
            made = np.zeros(len(courses.apart), dtype=bool)
            made[rows[ended]] = True
            courses = courses.beside(more, made, steep)
            for x, y in zip(apart, few._apart(third)):
                x[rows[ended]] = np.maximum(x[rows[ended]], y[ended])
        q_max, qd_max = (np.maximum(courses.scale * x, y) for x, y in zip(apart, (floor.q, floor.qd)))
        return CourseErrors(
            courses.at_end(floor), q_max, qd_max, np.maximum(floor.q, floor.qd), second.steps, done
        )

    def _again(self, first: First) -> tuple[Runs, Masks]:
        return second_runs(self.batch, first, _arrived, self.sampling, self.watch)

    def _courses(self, other: Runs) -> Courses:
        own = self._course(self.runs)
        times = self._times(0)
        sampled_end = len(times) > 0 and bool(times[-1] >= (1.0 - EPS) * self.batch.ends[0])
        apart = difference(own, self._course(other), sampled_end)
        return Courses(self.batch.structure.motion.system, own, apart, remainder(self.first, other.steps))

    def _course(self, runs: Runs) -> Array:
        """Return the states (N, T, nx) at the start, the samples that are judged, and the end."""
        samples = runs.out.transpose(0, 2, 1)[:, self.judged]
        return np.concatenate([self.batch.states[:, None], samples, runs.y[:, None]], axis=1)

    def _apart(self, other: Runs) -> tuple[Array, Array]:
        """Return by how much positions and rates are apart from those of others at most (N,), at samples as they are
        recorded."""
        if self.wanted is None:
            nothing = np.full((2, len(self.runs)), np.nan)
            return nothing[0], nothing[1]
        own, again = (runs.out.transpose(0, 2, 1)[:, self.wanted].copy() for runs in (self.runs, other))
        structure = self.batch.structure
        if structure.motion.system.corrections.acts:
            for k, observer in enumerate(structure.observers(self.batch.numbers)):
                times = self._times(k, self.wanted)
                own[k], again[k] = (observer.project(times, x[k].copy()) for x in (own, again))
        split = zip(structure.motion.system.split(own)[:2], structure.motion.system.split(again)[:2])
        q, qd = (np.abs(y - x).max(axis=(1, 2), initial=0.0) for x, y in split)
        return q, qd

    def _times(self, runs: Any, which: slice | None = None) -> Array:
        """Return the times (T,) of samples of a run, or (n, T) of some; by default those that are judged [s]."""
        start, step = (self.runs.w[runs, slot] for slot in (DoubleSlot.SAMPLE_START, DoubleSlot.SAMPLE_STEP))
        times: Array = start[..., None] + step[..., None] * np.arange(1, self.runs.out.shape[2] + 1)
        return times[..., self.judged if which is None else which]

    def _conditioning(self, near: Masks) -> Conditioning:
        """Return the conditioning of some of the runs (N,), 0 of the others."""
        rows, course = np.flatnonzero(near), self._course(self.runs)
        found = np.zeros((3, len(near)))
        for part in in_parts(len(rows), course.shape[1]):
            some = rows[part]
            ends = self.batch.ends[some, None]
            times = np.hstack([np.zeros_like(ends), self._times(some), ends])
            one = self.batch.structure.motion.conditioning(times, course[some], self.batch.numbers.rows(some))
            found[:, some] = one.acceleration, one.closing, one.changes
        return Conditioning(*found)


def samplings(batch: RunBatch, method: str, samples: int) -> tuple[Sampling, slice, slice]:
    """Return which samples are taken, and which of them are asked for (so many) and judged: those of single runs.

    Runs in lanes, which take steps of their own up to each sample, are judged by as few as may be.
    """
    count = samples or max(batch.structure.motion.scene.simulate.samples - 1, 1)
    stride = stride_of(count + 1)
    if samples:
        share, every = max(1, round(1 / stride)), max(1, int(stride))
        first = (samples * share - 1) % every
        return Sampling(samples * share), slice(share - 1, None, share), slice(first, None, every)
    if batch.structure.fleet(method).lanes > 1:
        return Sampling(JUDGED), slice(0), slice(None)
    taken, step = math.ceil(count / stride), batch.ends / count
    return Sampling(taken, step * stride, step * (count - taken * stride)), slice(0), slice(None)


def _arrived(runs: Runs) -> Masks:
    return runs.arrived


# -- between samples ------------------------------------------------------------------------------------
def is_between(key: str) -> bool:
    """Tell whether ``figures_between`` gives this key of the summary."""
    return key.partition(".")[0] in BETWEEN


@record
class CourseEnds:
    """How runs ended: times (N,) [s] of the first and of the second ones, states (N, nx), steps (N,) of the first, and
    what rounding leaves (N,), nan where no errors are estimated."""

    times: Array
    second: Array
    states: Array
    steps: Array
    floor: Array

    def part(self, rows: Rows) -> CourseEnds:
        """Return those of some runs."""
        return CourseEnds(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))


class _Doubtful:
    """Owner of events that are judged on numbers of the scene."""

    def handle(self, event: Event) -> Outcome:
        raise NumericalError(f"{event.name} at t = {event.time:.6g} s", time=event.time)

    def again(self) -> None:
        return None


# what is only noted on the way has no owner
OTHERS: dict[EventKind, Owner | None] = {EventKind.RANK_LOSS: _Doubtful(), EventKind.MARK: None}


def motions_of(batch: RunBatch, keys: Sequence[str], method: str) -> Iterator[Motion]:
    """Yield the motion of one run after another: that of the structure with numbers, start and end of the run.

    Watchers and observer are the same objects in all runs. keys : of the summary that scenes are to give. method : of
    the runs.
    """
    structure, numbers, motion = batch.structure, batch.numbers, batch.structure.motion
    system = motion.system.watched_by(lambda e: OTHERS.get(e.kind, e.owner))
    rows: dict[int, tuple[Sequence[float], Array]] = {}  # of tables, by their identity, which they keep

    def row(k: int, own: Sequence[float]) -> Array:
        if id(own) not in rows:
            rows[id(own)] = own, np.ascontiguousarray(numbers.table(own))
        return rows[id(own)][1][k]

    def read(k: int, programs: Sequence[Program]) -> Array:
        return np.concatenate([row(k, program.numbers or NO_NUMBERS) for program in programs])

    kernels = [kernel for watcher in motion.watchers for kernel in watcher.kernels.values()]
    (psi, off), asked = batch.start_rounding, asking(motion.scene, keys)
    choice = dataclasses.replace(motion.choice, method=method)
    for k, observer in enumerate(structure.observers(numbers, asked.outputs.reactions)):
        for kernel in kernels:
            kernel.take([row(k, kernel.numbers[0])])
        scene = asked
        if scene.simulate.duration != batch.ends[k]:
            simulate = dataclasses.replace(scene.simulate, duration=float(batch.ends[k]))
            scene = dataclasses.replace(scene, simulate=simulate)
        closed = dataclasses.replace(motion.assembled, q=batch.starts.q[k], v=batch.starts.v[k])
        own = system.with_numbers(partial(read, k))
        one = dataclasses.replace(motion, scene=scene, assembled=closed, system=own, choice=choice)
        own_numbers = numbers.rows(np.array([k]))
        known = {
            "observer": observer, "held": motion.held,
            "conditioning": partial(motion.conditioning, runs=own_numbers),
            "start_rounding": (psi[k : k + 1], off[k : k + 1]),
        }  # fmt: skip
        vars(one).update(known)
        yield one


def recordings(
    batch: RunBatch, method: str, ended: CourseEnds, keys: Sequence[str]
) -> Iterator[RecordedMotion]:
    """Yield the motions of runs, recorded at the samples of the scene."""
    count = max(batch.structure.motion.scene.simulate.samples - 1, 1)
    step = batch.ends / count
    taken = np.array([Grid(0.0, h, count + 1).first_at(t) for h, t in zip(step, ended.times)])
    runs = batch.sampled(method, ended.times, int(taken.max(initial=1)), step)
    for k, motion in enumerate(motions_of(batch, keys, method)):
        own = int(taken[k]) - 1
        states = np.vstack([batch.states[k], runs.out[k, :, :own].T, ended.states[k]])
        recorder = Recorder(motion.observer)
        times = np.append(step[k] * np.arange(own + 1), ended.times[k])
        recorder.emit(times, np.asfortranarray(states), motion.observer.parameters)
        yield _recorded(batch, method, ended, k, (motion, recorder, states))


def _recorded(
    batch: RunBatch, method: str, ended: CourseEnds, k: int, own: tuple[Motion, Recorder, Array]
) -> RecordedMotion:
    from robodyn_cli.motion.between.extremes import RecordedMotion
    from robodyn_cli.motion.second_run import FirstRun
    from robodyn_cli.summaries.motion import MotionErrors

    (motion, recorder, states), floor = own, float(ended.floor[k])
    first = FirstRun(
        batch.options, method, ended.steps[k : k + 1], ended.times[k : k + 1],
        Beginning(0.0, states[0]), Grid(0.0, 0.0, 0), float(ended.times[k]), states[-1],
    )  # fmt: skip
    if math.isnan(floor):
        return RecordedMotion(motion, first, recorder)
    again = dataclasses.replace(first, end=float(ended.second[k]))
    return RecordedMotion(motion, first, recorder, again, MotionErrors("", rounding_floor=floor))


def figures_between(
    batch: RunBatch, method: str, ended: CourseEnds, keys: Sequence[str], command: str
) -> dict[str, Figure]:
    """Return figures of sections in ``BETWEEN`` of all runs, nan of those that the command has to look into."""
    from robodyn_cli.motion.between.extremes import extremes_over
    from robodyn_cli.motion.figures import loads_of
    from robodyn_cli.summaries.extremes import RunExtremes

    scene = asking(batch.structure.motion.scene, keys)
    names = scene.outputs.extremes
    found = {key: (np.full(len(batch.values), np.nan), np.full(len(batch.values), np.nan)) for key in keys}
    for k, motion in enumerate(recordings(batch, method, ended, keys)):
        summary: dict[str, Any] = {"command": command}
        with contextlib.suppress(RobodynError):  # the command says what is wrong
            described = motion.recorder.observer.reactions
            if described is not None and any(key.startswith("reactions") for key in keys):
                summary |= {"reactions": as_keys(described.described(loads_of(motion)))}
            if names:
                summary |= as_keys(RunExtremes.of(extremes_over([motion], names), scene.simulate.fluctuation))
            for key, (values, errors) in found.items():
                values[k], errors[k] = number_of(summary, key), error_of(summary, key)
    return found


def with_between(
    driven: Driven, batch: RunBatch, method: str, ended: CourseEnds, keys: Sequence[str], command: str
) -> Driven:
    """Return what a batch came to with those figures among keys that lie between samples; runs of which one is not
    found are left to the command."""
    own = [key for key in keys if is_between(key)]
    if not own:
        return driven
    reactions = asking(batch.structure.motion.scene, own).outputs.reactions

    def figures(rows: Rows) -> Mapping[str, Figure]:
        return figures_between(batch.part(rows), method, ended.part(rows), own, command)

    driven = driven.with_figures(batch, figures, reactions)
    there = np.all([np.isfinite(driven.figures[key][0]) for key in own], axis=0)
    return dataclasses.replace(driven, trusted=driven.trusted & there)
