"""Compilations so far and at present; apart from the compiler, so that reading them does not load LLVM."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar

# instructions that take LLVM some seconds, in which no other thread of Python runs
MANY = 20_000

_seconds: ContextVar[float] = ContextVar("_seconds", default=0.0)


class CompileReport:
    """Seconds that this thread has spent, modules compiled, modules that came from the cache, and warnings, each once.

    ``now`` says in words what is being compiled, empty between compilations. ``listener``, where there is one, is told
    of a compilation that takes long before it begins.
    """

    def __init__(self) -> None:
        self.compiled = 0
        self.cached = 0
        self.now = ""
        self.listener: Callable[[str], None] | None = None
        self.warnings: list[str] = []

    @property
    def seconds(self) -> float:
        """Spent by this thread, so that times of stages of a run are its own."""
        return _seconds.get()

    def spend(self, seconds: float) -> None:
        """Add time that this thread has spent."""
        _seconds.set(_seconds.get() + seconds)

    def begin(self, instructions: int) -> None:
        """Note the compilation that begins."""
        self.now = f"compiling {instructions} instructions"
        if instructions >= MANY and self.listener is not None:
            self.listener(f"robodyn: {self.now} takes a while; the code is kept for the next run")

    def warn(self, message: str) -> None:
        """Keep a warning for the report of the run."""
        if message not in self.warnings:
            self.warnings.append(message)


REPORT = CompileReport()
