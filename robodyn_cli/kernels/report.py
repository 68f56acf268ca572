"""What compilation did so far; apart from the compiler, so that asking loads nothing."""

from __future__ import annotations


class CompileReport:
    """Seconds spent, modules compiled, and modules that came from the cache."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.compiled = 0
        self.cached = 0


REPORT = CompileReport()
