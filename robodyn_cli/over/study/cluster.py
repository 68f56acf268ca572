"""Runs of a study on a Dask cluster: chunks of runs are its tasks, and each worker compiles a study's code once.

A worker makes one chunk at a time, by as many threads as it has. What a worker was at when it died goes to another one.
"""

from __future__ import annotations

import contextlib
import logging
import platform
import threading
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError, OutputError, of_option
from robodyn_cli.kernels.cache import code_digest
from robodyn_cli.kernels.compiler import machine
from robodyn_cli.over.study.rows import Points, RowFile, RunRows, Task, killed
from robodyn_cli.over.study.runs import LARGEST_BLOCK, Compiled, SceneSource, Waiting, run_points, suits
from robodyn_cli.record import record
from robodyn_cli.version import __version__

EXTRA = "needs the package distributed: pip install 'robodyn[cluster]'"
CONNECT = 10.0  # s to wait for the scheduler and for a first worker
LOOK = 1.0  # s between looks at whether there are workers
PER_WORKER = 2  # chunks: one that is made, one that waits
SECONDS_OF_CHUNK = 1.0  # about
FIRST_CHUNK = 16  # runs
MOST_STUDIES = 2  # whose code a worker keeps


@record
class Host:
    """What the bits of a run depend on: lanes of vectors, fused multiply-add, the system's mathematical library."""

    lanes: int
    fused: bool
    library: str

    @staticmethod
    def own() -> Host:
        """Return what this process runs on."""
        cpu = machine()
        return Host(cpu.lanes, cpu.fused, f"{platform.system()} {' '.join(platform.libc_ver())}".strip())

    def __str__(self) -> str:
        return f"{self.lanes} lanes{'' if self.fused else ' without fused multiply-add'}, {self.library}"


@record
class Chunk:
    """What a task gives: rows, the time that it took [s], where it was made."""

    rows: RunRows
    seconds: float
    host: Host


# -- on a worker ----------------------------------------------------------------------------------------
_alone = threading.Lock()
_code: dict[str, Compiled | None] = {}  # of studies, by digest; None where they have none


def make_chunk(study: str, task: Task, points: Points) -> Chunk:
    """Make runs of a study; called on a worker. study : its digest."""
    from distributed import get_worker

    threads = get_worker().state.nthreads
    with _alone:
        start = time.perf_counter()
        rows = run_points(task, points, 1, _code_of(study, task, threads))
        return Chunk(rows, time.perf_counter() - start, Host.own())


def _code_of(study: str, task: Task, threads: int) -> Compiled | None:
    """Return a study's compiled code, made once a worker."""
    if study not in _code:
        if len(_code) >= MOST_STUDIES:
            del _code[next(iter(_code))]
        _code[study] = Compiled(task, threads) if suits(task) else None
    return _code[study]


def _version() -> tuple[str, str]:
    return __version__, code_digest()


# -- where the study is ---------------------------------------------------------------------------------
class Cluster:
    """Context manager around the connection to a scheduler.

    Parameters
    ----------
    address : of the scheduler, ``tcp://host:8786``. note : is told what the user should know.

    Raises
    ------
    CapabilityError : Dask is not installed, nobody answers there, no worker comes, or one has another version.
    OutputError : the connection is lost.
    """

    def __init__(self, address: str, note: Callable[[str], None]) -> None:
        self.address, self._note = address, note
        self._own = Host.own()
        self._noted: set[str] = set()

    def __enter__(self) -> Cluster:
        try:
            import distributed
        except ImportError as error:
            raise of_option("--scheduler", EXTRA, CapabilityError) from error
        for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters is said by us
        self._dask: Any = distributed
        try:
            self._client = self._dask.Client(self.address, timeout=CONNECT)
        except (OSError, ValueError, ImportError) as error:
            raise of_option(
                f"--scheduler {self.address}",
                f"no scheduler answers there ({type(error).__name__}); "
                "allowed: the address of a running one, e.g. tcp://localhost:8786 after 'dask scheduler'",
                CapabilityError,
            ) from error
        try:
            self._check()
        except BaseException:
            self._client.close()
            raise
        return self

    def _check(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=CONNECT)
        except self._dask.TimeoutError as error:
            raise of_option(
                f"--scheduler {self.address}",
                f"it has no workers; start one: dask worker {self.address}",
                CapabilityError,
            ) from error
        for worker, version in self._client.run(_version, on_error="return").items():
            if version != _version():
                fault = "does not have robodyn"
                if isinstance(version, tuple):
                    same = version[0] == __version__
                    fault = f"has robodyn {version[0]}" + (" with other code" if same else "")
                raise of_option(
                    f"--scheduler {self.address}",
                    f"the worker {worker} {fault}; needed on all of them: {__version__}",
                    CapabilityError,
                )

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.close()

    def run(self, task: Task, file: RowFile) -> Iterator[RunRows]:
        """Yield the rows of all missing runs, in the order in which they are done."""
        missing, suspects = file.missing(), Waiting()
        size, most = FIRST_CHUNK, LARGEST_BLOCK
        flying: dict[Any, Points] = {}
        while flying or missing.left or suspects.left:
            with self._answering():
                # a run that may have killed its worker goes alone: what waits there beside it would be suspected too
                source: SceneSource = suspects if suspects.left else missing
                room = 1 if suspects.left else PER_WORKER * max(1, self._workers())
                while source.left and len(flying) < room:
                    points = source.take(size)
                    flying[self._client.submit(make_chunk, file.study, task, points, pure=False)] = points
                ended = self._ended(list(flying))
            for future in ended:
                points = flying.pop(future)
                if isinstance(future.exception(), self._dask.KilledWorker):
                    # whichever of the runs did it: each goes on its own, and the one that does it again is a row
                    if len(points) == 1:
                        yield killed(points, task)
                    else:
                        suspects.add(points)
                    continue
                chunk = self._chunk(future)
                yield chunk.rows
                size = int(np.clip(len(points) * SECONDS_OF_CHUNK / max(chunk.seconds, 1e-3), 1, most))

    def _workers(self) -> int:
        """Return how many workers there are."""
        workers = len(self._client.nthreads())
        if not workers:
            self._say(f"there is no worker at {self.address}; waiting for one")
        return workers

    def _ended(self, futures: list[Any]) -> list[Any]:
        """Wait a while; return the tasks that have ended."""
        with contextlib.suppress(self._dask.TimeoutError):
            self._dask.wait(futures, timeout=LOOK, return_when="FIRST_COMPLETED")
        if self._client.status != "running" or any(future.cancelled() for future in futures):
            raise OSError("lost")
        return [future for future in futures if future.done()]

    def _chunk(self, future: Any) -> Chunk:
        """Return what a task gave; say where it was made if that matters."""
        if future.status == "error":
            raise future.exception()
        with self._answering():
            chunk: Chunk = future.result()
        self._tell(chunk.host)
        return chunk

    @contextlib.contextmanager
    def _answering(self) -> Iterator[None]:
        """Tell the user where the connection is lost."""
        try:
            yield
        except (OSError, self._dask.TimeoutError, self._dask.CancelledError) as error:
            raise OutputError(
                f"the scheduler at {self.address} does not answer any more; the rows that are done are kept, and the "
                "same command goes on from there"
            ) from error

    def _tell(self, host: Host) -> None:
        """Say where rows come from other processors, whose rounding differs."""
        if host != self._own:
            self._say(
                f"workers differ from this machine ({host}; here {self._own}): their rows are not its rows to the bit, "
                "but to the error that is stated"
            )

    def _say(self, text: str) -> None:
        if text not in self._noted:
            self._noted.add(text)
            self._note(f"robodyn: {text}")
