"""Exit codes of the program that no error class carries, and which of several is the worst (docs/cli.md)."""

from __future__ import annotations

from collections.abc import Iterable

FAILED = 1  # no lock, an expectation that does not hold, results that differ
WRONG_USAGE = 2
INTERNAL = 70
NO_OUTPUT = 74
INTERRUPTED = 130

# of a run by its status, where no error says more
OF_STATUS = {"ok": 0, "locked": 0, "no_lock": FAILED, "overload": FAILED, "undersized": FAILED}
# with these a run puts what it found in the place of an earlier run's files; with others it leaves them as they are
REPLACING = (0, FAILED, 3, 4)
# from good to bad; what is not listed is worse than all of them
BADNESS = (0, FAILED, 3, WRONG_USAGE, 4, 5, NO_OUTPUT, INTERNAL)
ALL = (*BADNESS, INTERRUPTED)


def worst(codes: Iterable[int]) -> int:
    """Return the worst of several exit codes: 1 over 0, 3 over 1, 2 over 3, then 4, 5, 74, 70."""
    return max(codes, key=lambda code: BADNESS.index(code) if code in BADNESS else len(BADNESS), default=0)
