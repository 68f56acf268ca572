"""Counts of compilations so far; apart from the compiler, so that reading them does not load LLVM."""

from __future__ import annotations


class CompileReport:
    """Seconds spent, modules compiled, modules that came from the cache, and warnings, each once."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.compiled = 0
        self.cached = 0
        self.warnings: list[str] = []

    def warn(self, message: str) -> None:
        """Keep a warning for the report of the run."""
        if message not in self.warnings:
            self.warnings.append(message)


REPORT = CompileReport()
