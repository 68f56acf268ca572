"""Progress of long runs: a callback from numerics to whoever shows it."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, float], None]


def no_progress(done: float, total: float) -> None:
    """Show nothing."""
