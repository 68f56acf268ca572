"""Keys of every summary, beside those of its command."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import ANY, fact


@record
class Failure:
    """What ended a run that failed."""

    kind: str = fact("class of the error")
    message: str = fact("what went wrong, in words")
    exit_code: int = fact("exit code of the command")


@record
class EveryRun:
    """Keys of every summary. ``exit_code`` may be expected, and is not written."""

    status: str = fact("`ok`, `locked`, `no_lock`, `overload`, `undersized` or `failed`")
    command: str = fact("command that was run")
    title: str = fact("title of the scene")
    error: Failure = fact("of a run that failed: what ended it")
    exit_code: int = fact("exit code of the run, for `expect`; not written")
    wall_time_s: dict[str, float] = fact(
        "time by stage (`load`, `equations`, `compile`, `integrate`, `write`, `plots`, ...), and `total`",
        "s",
        names=ANY,
    )
    scene_file: str = fact("where the scene lies")
    run_id: str = fact("of this run, the same as the attribute of `result.h5`")
    outputs: list[str] = fact("names of the files that were written")
