"""One run by its command: its summary, whatever ended it, and the numbers in it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from robodyn_cli.errors import RobodynError
from robodyn_cli.results.result import Result
from robodyn_cli.run.batch.criteria import exit_code, lookup_number


def summary_of(run: Callable[[], Result]) -> tuple[dict[str, Any], int, Result]:
    """Return the summary of a run, which may have failed on the way, its exit code and its result.

    Raises
    ------
    RobodynError : the run came to nothing at all.
    """
    try:
        result = run()
    except RobodynError as error:
        if not isinstance(error.result, Result):
            raise
        summary = {**error.result.summary, **error.result.head, "error": error.facts}
        return summary, error.exit_code, error.result
    summary = {**result.summary, **result.head}
    return summary, exit_code(summary), result


def reason_of(summary: Mapping[str, Any], code: int) -> str:
    """Return why a run failed; nothing where it did not."""
    error = summary.get("error")
    return "" if code == 0 else str(error["message"] if error else summary["termination"]["reason"])


def number_of(summary: Mapping[str, Any], key: str) -> float:
    """Return a number of a summary; nan where it has none there."""
    value = lookup_number(summary, key)
    return math.nan if value is None else value


def error_of(summary: Mapping[str, Any], key: str) -> float:
    """Return the estimated error of a number of a summary, where the summary tells one."""
    beside = lookup_number(summary, f"{key}_error")
    if beside is None and key.startswith(("final.q.", "final.qd.")):
        beside = lookup_number(summary, f"error_estimate.{key.split('.')[1]}_end")
    return math.nan if beside is None else beside
