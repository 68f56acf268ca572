"""What the runs of a study share, and what one of them gave."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.scene.load import Family

Values = tuple[float, ...]


@record
class Row:
    """What one run gave.

    code : exit code that the command would have. outputs, errors : numbers, nan where a run has none. holds : whether
    all of ``expect`` holds. reason : why a run failed.
    """

    values: Values
    code: int
    outputs: tuple[float, ...]
    errors: tuple[float, ...]
    holds: bool
    reason: str
    seconds: float


@record
class Task:
    """What all runs of a study share: their scenes, the command, the keys that vary, the outputs."""

    family: Family
    command: str
    keys: tuple[str, ...]
    outputs: tuple[str, ...]
