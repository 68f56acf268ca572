"""One run by its command: its summary, whatever ended it, and the numbers in it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from robodyn_cli.errors import RobodynError
from robodyn_cli.exit_codes import INTERNAL
from robodyn_cli.over.batch.criteria import exit_code, lookup_number
from robodyn_cli.record import record
from robodyn_cli.results.result import Result


@record
class Ended:
    """What a run came to: its summary, its exit code, why it failed, its result; nothing where it did not begin."""

    summary: Mapping[str, Any]
    code: int
    reason: str
    result: Result | None


def ended(run: Callable[[], Result]) -> Ended:
    """Make a run; whatever ends it is part of what it came to."""
    try:
        result = run()
    except RobodynError as error:
        if not isinstance(error.result, Result):
            return Ended({}, error.exit_code, error.message, None)
        result, code = error.result, error.exit_code
        summary = {**result.summary, **result.head, "error": error.facts}
    except Exception as fault:  # of the program, in one run: the others stay as they are
        return Ended({}, INTERNAL, f"{type(fault).__name__}: {fault}", None)
    else:
        summary = {**result.summary, **result.head}
        code = exit_code(summary)
    return Ended(summary, code, _reason(summary, code), result)


def _reason(summary: Mapping[str, Any], code: int) -> str:
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
