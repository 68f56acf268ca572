"""Progress of long runs, and their wall time by stage."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, TypeVar

from robodyn_cli.kernels.cache import REPORT

Item = TypeVar("Item")


class Progress(Protocol):
    """What is told how far a pass of a run is: ``done`` of ``total``, in seconds of its motion or in ``unit``."""

    def __call__(self, done: float, total: float, unit: str = "s", /) -> None: ...


def no_progress(done: float, total: float, unit: str = "s") -> None:
    """Show nothing."""


def counted(items: Sequence[Item], progress: Progress, unit: str) -> Iterator[Item]:
    """Yield items; tell before each how many are done, in a unit like ``methods``."""
    for k, item in enumerate(items):
        progress(k, len(items), unit)
        yield item


class Stopwatch:
    """Adds up wall time by stage; compilation inside a stage is counted as ``compile`` instead.

    ``now`` is the stage at present, empty between stages; ``reached`` says how far it is, where that is known.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.now = self.reached = ""
        self._start = time.perf_counter()

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time inside the block under ``name``."""
        start, compiling = time.perf_counter(), REPORT.seconds
        before, self.now, self.reached = self.now, name, ""
        try:
            yield
        finally:
            self.now, self.reached = before, ""
            spent = REPORT.seconds - compiling
            self.add("compile", spent)
            self.add(name, time.perf_counter() - start - spent)

    def add(self, name: str, seconds: float) -> None:
        self.seconds[name] = self.seconds.get(name, 0.0) + seconds

    def listen(self, listener: Callable[[str], None]) -> None:
        """Have long compilations told before they begin."""
        REPORT.listener = listener

    def doing(self) -> str:
        """Say what takes the time at present."""
        return REPORT.now or ": ".join(filter(None, (self.now.replace("_", " "), self.reached)))

    def reach(self, text: str) -> None:
        """Say how far the present stage is."""
        self.reached = text

    def report(self) -> dict[str, float]:
        """Return seconds by stage, and in all."""
        return {
            **{k: round(v, 6) for k, v in self.seconds.items() if v > 0.0},
            "total": round(time.perf_counter() - self._start, 6),
        }
