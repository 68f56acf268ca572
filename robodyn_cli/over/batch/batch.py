"""Many scenes, each by its own command in a process of its own; what is finished is not run again."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import IO, Any

from robodyn_cli import errors as exit_codes
from robodyn_cli.errors import INTERNAL, INTERRUPTED, NumericalError
from robodyn_cli.over.batch.criteria import exit_code
from robodyn_cli.over.batch.entries import BatchEntry, finished, settle
from robodyn_cli.results.output_dir import SUMMARY_NAME, OutputDirectory
from robodyn_cli.results.summary import read_summary
from robodyn_cli.threads import single_thread

TIMED_OUT = NumericalError.exit_code  # no result in the time given: as where a run takes too many steps
GRACE = 5.0  # seconds that an interrupted worker has to tidy up


def interrupt(process: subprocess.Popen[bytes]) -> None:
    """Ask a worker to end."""
    with contextlib.suppress(OSError):
        process.send_signal(signal.SIGTERM if sys.platform == "win32" else signal.SIGINT)


def _summary(printed: bytes) -> dict[str, Any]:
    """Return what a worker printed of a run that failed; nothing if it did not get as far."""
    try:
        summary = json.loads(printed)
    except ValueError:
        return {}
    return summary if isinstance(summary, dict) else {}


class Clock:
    """Ends a worker when its time is over: asks it first, so that it can tidy up."""

    def __init__(self, process: subprocess.Popen[bytes], seconds: float | None) -> None:
        self.process = process
        self.fired = False
        self._stopped = threading.Event()
        if seconds is not None:
            # a longer time than this cannot be waited for
            longest = min(seconds, threading.TIMEOUT_MAX)
            threading.Thread(target=self._wait, args=(longest,), daemon=True).start()

    def _wait(self, seconds: float) -> None:
        if self._stopped.wait(seconds):
            return
        self.fired = True
        interrupt(self.process)
        if not self._stopped.wait(GRACE):
            self.process.kill()

    def stop(self) -> None:
        """Stop: the worker has ended."""
        self._stopped.set()


class Batch:
    """Runs scenes in worker processes.

    Parameters
    ----------
    scenes : loaded. jobs : processes at a time. drawn : ends of names of drawings that a finished result has.
    force : run what is finished too.
    timeout : seconds that each scene may take; one that takes longer is interrupted, and ended where it goes on.
    worker : command line of a worker for a command, a scene and a directory; it must end when its standard input
    does, so that it does not outlive the batch.
    """

    def __init__(
        self,
        scenes: Sequence[BatchEntry],
        jobs: int,
        worker: Callable[[str, Path, Path], list[str]],
        drawn: Sequence[str],
        force: bool,
        timeout: float | None = None,
    ) -> None:
        self.scenes = list(scenes)
        self.jobs = max(1, min(jobs, len(self.scenes)))
        self.worker = worker
        self.drawn = drawn
        self.force = force
        self.timeout = timeout
        self._lock = threading.Lock()
        self._running: set[subprocess.Popen[bytes]] = set()
        self._stopping = False
        self._done: queue.Queue[BatchEntry | BaseException] = queue.Queue()

    def run(self) -> Iterator[BatchEntry]:
        """Yield each scene when it is done; interrupted, stop the workers."""
        waiting = iter(self.scenes)
        threads = [
            threading.Thread(target=self._serve, args=(waiting,), daemon=True) for _ in range(self.jobs)
        ]
        try:
            for thread in threads:
                thread.start()
            for _ in self.scenes:
                entry = self._next()
                entry.stopped = False
                yield entry
        finally:
            self._stop()

    def _next(self) -> BatchEntry:
        """Wait for the next scene that is done."""
        while True:
            try:
                # without a time limit an interrupt would not be seen on every system
                entry = self._done.get(timeout=0.2)
            except queue.Empty:
                continue
            if isinstance(entry, BaseException):
                raise entry
            return entry

    def _serve(self, waiting: Iterator[BatchEntry]) -> None:
        while not self._stopping:
            with self._lock:
                entry = next(waiting, None)
            if entry is None:
                return
            try:
                self._one(entry)
            except BaseException as error:
                self._done.put(error)
                return
            if not self._stopping:
                self._done.put(entry)

    def _one(self, entry: BatchEntry) -> None:
        if entry.directory is None:
            return
        start = time.perf_counter()
        if not self.force:
            summary = finished(entry, self.drawn)
            if summary is not None:
                entry.unchanged = entry.has_result = True
                settle(entry, exit_code(summary), summary)
                entry.seconds = time.perf_counter() - start
                return
        entry.replaced = OutputDirectory(entry.directory, scene=entry.path).other_scene()
        code, said, printed, late = self._work(entry)
        entry.seconds = time.perf_counter() - start
        if late:
            entry.exit_code = TIMED_OUT
            entry.message = f"ended after {self.timeout:g} s: the time limit of a scene (--timeout)"
            return
        # with other codes the file, if there is one, is an earlier run's
        entry.has_result = code in exit_codes.REPLACING
        summary = read_summary(entry.directory / SUMMARY_NAME) if entry.has_result else _summary(printed)
        if not summary or exit_code(summary) != code:
            summary = {"status": "failed", "error": {"exit_code": code, "message": said}}
        settle(entry, code, summary)

    def _work(self, entry: BatchEntry) -> tuple[int, str, bytes, bool]:
        """Return a worker's exit code, its last message, what it printed, and whether it ran out of time."""
        with tempfile.TemporaryFile() as printed:
            code, said, late = self._wait_for(entry, printed)
            printed.seek(0)
            return code, said, printed.read(), late

    def _wait_for(self, entry: BatchEntry, printed: IO[bytes]) -> tuple[int, str, bool]:
        """Run a worker that prints into a file; return its exit code, last message, and whether it was too late."""
        with self._lock:
            if self._stopping:
                return INTERNAL, "", False
            process = self._start(entry, printed)
            self._running.add(process)
        assert process.stderr is not None and process.stdin is not None
        clock = Clock(process, self.timeout)
        try:
            lines = process.stderr.read().decode(errors="replace").strip().splitlines()
            code = process.wait()
        finally:
            clock.stop()
            with self._lock:
                self._running.discard(process)
            process.stderr.close()
            with contextlib.suppress(OSError):
                process.stdin.close()
        said = lines[-1].removeprefix("robodyn: error: ") if lines else ""
        if code < 0:
            said = f"the process of this scene was ended by signal {-code} ({signal.strsignal(-code)})"
            code = INTERNAL
        elif code not in exit_codes.ALL:
            said = f"the process of this scene ended with code {code}: {said}"
            code = INTERNAL
        # a worker that ended by itself as its time ran out counts as it ended
        return code, said, clock.fired and code in (INTERNAL, INTERRUPTED)

    def _start(self, entry: BatchEntry, printed: IO[bytes]) -> subprocess.Popen[bytes]:
        """Start the worker of a scene."""
        assert entry.directory is not None
        environment = dict(os.environ)
        single_thread(environment)
        # a session of its own: an interrupt from the terminal reaches a worker through `interrupt` alone
        own: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            own = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        return subprocess.Popen(
            self.worker(entry.command, entry.path, entry.directory),
            stdin=subprocess.PIPE,
            stdout=printed,
            stderr=subprocess.PIPE,
            env=environment,
            **own,
        )

    def _stop(self) -> None:
        """End the workers: interrupt them, wait, and kill what is left."""
        with self._lock:
            self._stopping = True
            running = list(self._running)
        for process in running:
            interrupt(process)
        limit = time.monotonic() + GRACE
        try:
            for process in running:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(max(0.0, limit - time.monotonic()))
        finally:
            for process in running:
                if process.poll() is None:
                    process.kill()
