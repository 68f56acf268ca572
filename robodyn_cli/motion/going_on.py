"""Runs that go on: one that was killed, from its journal; and one from a state of a stored run,
``initial: {from: RESULT, at: TIME}``.

A journal begins with a line that says of which run it is. Each block follows as a line (JSON: the shape, the counters,
the changes of method, what watchers have noted) and its numbers: times (m,), states (m, nx) and parameters (np,), as
doubles. A block that was being written when the run ended is not used.

From a stored run the clock goes on too: formulas of time and prescribed joints see its time, and `simulate.duration` is
the end on that clock. What is stored is the whole state (q, v, and the work done so far). Contact states are found anew
from it, as at any start; latches of a deployment that were closed stay closed, where the scene has them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from robodyn_cli.commands import COMMANDS
from robodyn_cli.equations.control.taken_over import taken_over
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import ResultFileError, SceneError, did_you_mean
from robodyn_cli.foreign import opened
from robodyn_cli.kernels.cache import code_digest
from robodyn_cli.motion.contact.latches import Latches
from robodyn_cli.motion.driver import Driver, MethodChange
from robodyn_cli.motion.motion import Beginning, Motion
from robodyn_cli.record import record
from robodyn_cli.results.atomic import output_errors
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import sha256
from robodyn_cli.scene.checks.robot import columns
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.motion import Counters

DOUBLE = np.dtype("<f8")


@record
class JournalBlock:
    """Samples at times t (m,) with states x (m, nx), all with parameters p; what the run had done by then.

    noted : by the driver's watchers, in their order.
    """

    t: Array
    x: Array
    p: Array
    counters: Counters
    changes: tuple[MethodChange, ...]
    noted: tuple[dict[str, float], ...]


class Journal:
    """Context manager around the file of one run; ``is_empty`` until it has blocks.

    resume : whether to take over the blocks of an earlier run; ``taken`` tells whether there are any.

    Raises
    ------
    SceneError : the blocks are of another scene, or of other settings.
    """

    def __init__(self, path: Path, scene: Scene, resume: bool = False) -> None:
        self.path = path
        self._head = {"scene": sha256(scene.text), "code": code_digest()}
        self._length = 0
        self.taken = resume and self._find(scene)
        self.is_empty = not self.taken
        self._file: BinaryIO | None = None

    def _find(self, scene: Scene) -> bool:
        """Tell whether there are blocks of this run, and note how long the file is up to its last whole one."""
        if not self.path.exists():
            return False
        with output_errors(self.path), opened(self.path) as file:
            head = _line(file)
            if head is not None and head != self._head:
                raise SceneError(
                    f"the unfinished run in {self.path} is of another scene, other settings or other "
                    "code of robodyn; allowed: the same ones, or a run from the start, without --resume",
                    (scene.path,), file=scene.path,
                )  # fmt: skip
            for _ in _blocks(file):
                self._length = file.tell()
        return self._length > 0

    def __enter__(self) -> Journal:
        with output_errors(self.path):
            if self.taken:
                os.truncate(self.path, self._length)
                self._file = open(self.path, "ab")
            else:
                self._file = open(self.path, "wb")
                self._write(json.dumps(self._head).encode() + b"\n")
        return self

    def __exit__(self, *error: object) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()

    def blocks(self) -> Iterator[JournalBlock]:
        """Yield the blocks that were taken over."""
        if self.taken:
            with opened(self.path) as file:
                _line(file)
                for block in _blocks(file):
                    yield block
                    if file.tell() >= self._length:  # behind it are those that this run adds
                        return

    def add(self, t: Array, x: Array, driver: Driver) -> None:
        """Write a block of samples; it is in the file when this returns."""
        p = driver.parameters
        head = {
            "shape": [*x.shape, len(p)],
            "counters": dataclasses.astuple(driver.counters),
            "changes": [dataclasses.astuple(change) for change in driver.changes],
            "noted": [watcher.noted for watcher in driver.watchers],
        }
        numbers = np.concatenate([t, x.ravel(), p]).astype(DOUBLE)
        with output_errors(self.path):
            self._write(json.dumps(head).encode() + b"\n" + numbers.tobytes())
        self.is_empty = False

    def _write(self, data: bytes) -> None:
        assert self._file is not None
        self._file.write(data)
        self._file.flush()


def _line(file: BinaryIO) -> dict[str, Any] | None:
    """Return the next line, None where there is no whole one."""
    line = file.readline()
    with contextlib.suppress(ValueError):
        entry = json.loads(line)
        if line.endswith(b"\n") and isinstance(entry, dict):
            return entry
    return None


def _blocks(file: BinaryIO) -> Iterator[JournalBlock]:
    """Yield the whole blocks from here on."""
    while (head := _line(file)) is not None:
        m, n, k = head["shape"]
        data = file.read(DOUBLE.itemsize * (m * (n + 1) + k))
        if len(data) < DOUBLE.itemsize * (m * (n + 1) + k):
            return
        t, x, p = np.split(np.frombuffer(data, DOUBLE).copy(), [m, m * (n + 1)])
        changes = tuple(MethodChange(*c) for c in head["changes"])
        yield JournalBlock(t, x.reshape(m, n), p, Counters(*head["counters"]), changes, tuple(head["noted"]))


RESULT_FILE = "result.h5"
STORED = ("time", "q", "qd", "energy/work", "control/states")
STILL = 1e-9  # part of the largest rate below which a joint stands still
SAME_TIME = 1e-9  # part of a time (or of a second) by which the sample asked for may differ
# Runs with Baumgarte's method or none drift from the loops; beyond this [m, rad and their rates] the loops are others.
CLOSED = 1e-3


@record
class Stored:
    """Samples of a stored run: times (T,), q (T, nq), v (T, nv) with the names of their columns, work (T,) if any.
    control : states of the controller (T, nc), if any, with their names.

    sample : the one to go on from. latched : whether it is of a deployment with latches. events : of that run.
    """

    scene: Scene
    times: Array
    q: Array
    v: Array
    q_names: tuple[str, ...]
    v_names: tuple[str, ...]
    work: Array | None
    control: Array | None
    control_names: tuple[str, ...]
    sample: int
    latched: bool
    events: tuple[Mapping[str, Any], ...]

    @property
    def time(self) -> float:
        return float(self.times[self.sample])

    def completed(self) -> Scene:
        """Return the scene with the positions and rates of the first sample where it gives none at t = 0.

        The state at t = 0 still decides how the equations are set up (which rows are redundant, which method suits).

        Raises
        ------
        SceneError : the stored run lacks a joint.
        """
        initial, robot = self.scene.initial, self.scene.robot
        if new := [name for name in columns(robot) if name not in self.q_names]:
            hint = did_you_mean(new[0], [name for name in self.q_names if name not in columns(robot)])
            kind = "coordinate" if "." in new[0] else "joint"
            raise self._refused(f"has no {kind} {new[0]!r}{hint}; it has {_listed(self.q_names)}")
        if initial.q:
            return self.scene
        q, v = (
            {name: x for name, x in zip(names, row[0].tolist()) if name in own}
            for names, row, own in (
                (self.q_names, self.q, columns(robot)),
                (self.v_names, self.v, columns(robot, velocities=True)),
            )
        )
        return dataclasses.replace(
            self.scene, initial=dataclasses.replace(initial, q=q, qd={**v, **initial.qd})
        )

    def beginning(self, motion: Motion) -> Beginning:
        """Return where the run of a motion begins.

        Raises
        ------
        SceneError : the state is not one of this mechanism.
        """
        model, system = motion.problem.model, motion.system
        told: list[str] = []
        q = self._columns("positions", self.q_names, model.q_names, self.q[self.sample])
        v = self._columns("rates", self.v_names, model.v_names, self.v[self.sample])
        if gone := self._gone(model.v_names):
            told.append(f"joints of the stored run that this scene does not have: {_listed(gone)}")
        latches = next((w for w in motion.watchers if isinstance(w, Latches)), None)
        closed = self.closed_latches()
        if opened := tuple(name for name in closed if latches is None or name not in latches.names):
            told.append(
                f"latches that were closed and that this scene does not have, so they are open: {_listed(opened)}"
            )
        if latches is not None:
            self._refuse_end(motion.scene, closed)
            latches.given = closed
        self._check_loops(motion.problem, q, v)
        return Beginning(self.time, system.join(q, v, self._further(motion, q, v, told)), tuple(told))

    def _refuse_end(self, scene: Scene, closed: Collection[str]) -> None:
        """Refuse a deployment that waits for what is closed already and does not open."""
        until = scene.deploy.until
        waited = [latch for latch in scene.deploy.latches if until in ("all", latch.name)]
        if waited and all(latch.name in closed and latch.release is None for latch in waited):
            named = until if until != "all" else f"all ({_listed(tuple(latch.name for latch in waited))})"
            raise SceneError(
                f"{named}: closed already in the stored run, at {self.time:g} s, and "
                "nothing opens it; allowed: end, or a latch that is open there or has a 'release'",
                (scene.path, "deploy.until"), file=scene.path, key="deploy.until",
            )  # fmt: skip

    def _columns(self, quantity: str, names: Sequence[str], needed: Sequence[str], row: Array) -> Array:
        """Return the columns that a scene needs; a deployment may have others, of joints that are gone."""
        have = dict(zip(names, row.tolist()))
        if tuple(names) != tuple(needed) and not (self.latched and set(needed) <= have.keys()):
            raise self._refused(
                f"holds {quantity} of {_listed(tuple(names))}; this scene has {_listed(tuple(needed))}"
            )
        return np.array([have[name] for name in needed])

    def _gone(self, needed: Sequence[str]) -> tuple[str, ...]:
        """Return the columns of rates of joints that are gone, which have to stand still."""
        gone = [k for k, name in enumerate(self.v_names) if name not in needed]
        fastest = float(np.abs(self.v[self.sample]).max(initial=0.0))
        for k in gone:
            if abs(rate := float(self.v[self.sample, k])) > STILL * fastest:
                raise self._refused(
                    f"has joint {self.v_names[k]!r}, which this scene does not have, and which moves at {rate:.3g} "
                    f"(rad/s or m/s) at {self.time:g} s; allowed: joints that stand still there, as latched ones do"
                )
        return tuple(self.v_names[k] for k in gone)

    def closed_latches(self) -> dict[str, Mapping[str, Any]]:
        """Return the latches that are closed at the sample, by name, with the event at which each closed."""
        closed: dict[str, Mapping[str, Any]] = {}
        for event in self.events:
            if event["kind"] in ("latched", "carried") and event["time"] <= self.time:
                closed[event["name"]] = event
            elif event["kind"] == "opened" and event["time"] <= self.time:
                closed.pop(event["name"], None)
        return closed

    def _further(self, motion: Motion, q: Array, v: Array, told: list[str]) -> Array:
        """Return the further states: those of the controller, and the work so far, where that is integrated."""
        row = [] if self.control is None else self.control[self.sample].tolist()
        try:
            found = taken_over(motion.problem.control, dict(zip(self.control_names, row)), q, v)
        except ValueError as error:
            raise self._refused(str(error)) from None
        told += found.told
        if not motion.system.work_done_by:
            return found.states
        if self.work is None:
            raise self._refused("has no work (energy/work), which this scene's drives or losses do")
        return np.append(found.states, self.work[self.sample])

    def _check_loops(self, problem: Problem, q: Array, v: Array) -> None:
        constraints = problem.constraints
        if not constraints.rows:
            return
        off = [
            problem.numbers(entries, q, self.time, v)
            for entries in (constraints.eta, constraints.velocity_residual(problem.v))
        ]
        largest = max(float(np.abs(x).max(initial=0.0)) for x in off)
        if not largest <= CLOSED:
            raise self._refused(
                f"has at {self.time:g} s a state in which this scene's loops and prescribed joints are off by "
                f"{largest:.2g} (m or rad, or their rates); allowed: a state in which they hold"
            )

    def _refused(self, why: str) -> SceneError:
        return refused(self.scene, f"the stored run {why}")


def refused(scene: Scene, why: str, key: str = "from") -> SceneError:
    """Return the error of what `initial.from` (or `initial.at`) names."""
    return SceneError(why, (scene.path, f"initial.{key}"), file=scene.path, key=f"initial.{key}")


def stored_run(scene: Scene) -> Stored:
    """Return the stored run that a scene goes on from.

    Raises
    ------
    SceneError : there is no such result, or it cannot be gone on from.
    """
    named = scene.initial.source
    assert named is not None
    result = _read(scene, Path(scene.path).parent / named)
    able = [name for name, row in COMMANDS.items() if row.takes_up]
    if result.command not in able:
        allowed = " or ".join(map(repr, able))
        raise refused(scene, f"{named!r} is a result of {result.command!r}; allowed: of {allowed}")
    if "criteria" in result.summary:
        raise refused(
            scene,
            f"{named!r} is a deployment with one 'latch', whose samples end before it closes; allowed: one with "
            "'deploy.latches', or a result of 'simulate'",
        )
    time, q, v = (result.variables[path] for path in STORED[:3])
    work, control = (result.variables.get(path) for path in STORED[3:])
    sample = _sample(scene, time.data)
    return Stored(
        scene,
        time.data,
        q.data,
        v.data,
        q.names,
        v.names,
        None if work is None else work.data,
        None if control is None else control.data,
        () if control is None else control.names,
        sample,
        "locks" in result.summary,
        tuple(result.events),
    )


def _read(scene: Scene, path: Path) -> Result:
    from robodyn_cli.results.hdf5 import read

    try:
        return read(path / RESULT_FILE if path.is_dir() else path, lambda name: name in STORED)
    except ResultFileError as error:
        raise refused(scene, error.message) from error


def _sample(scene: Scene, times: Array) -> int:
    """Return the number of the sample to go on from: the last one, or that at `initial.at`."""
    at = scene.initial.at
    k = len(times) - 1 if at is None else int(np.argmin(np.abs(times - at)))
    time = float(times[k])
    if at is not None and abs(time - at) > SAME_TIME * max(1.0, abs(at)):
        raise refused(
            scene,
            f"there is no sample at {at:g} s; allowed: a time of a sample of the stored run, which has {len(times)} "
            f"from {times[0]:g} s to {times[-1]:g} s (the nearest: {time:.17g} s)",
            "at",
        )
    if not time < scene.simulate.duration:
        raise refused(
            scene,
            f"the run would begin at {time:g} s, and simulate.duration, the end on the same clock, is "
            f"{scene.simulate.duration:g} s; allowed: a later end",
            "from" if at is None else "at",
        )
    return k


def _listed(names: tuple[str, ...]) -> str:
    shown = ", ".join(names[:8])
    return f"{shown}, ... ({len(names)})" if len(names) > 8 else shown or "no joints"
