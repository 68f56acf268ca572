"""``robodyn run``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from robodyn_cli.cli.console import Console, guarded
from robodyn_cli.cli.options import NoPlots, Overrides, Quiet, ReportAsJson
from robodyn_cli.cli.parameters import argument, option


def command(
    scenes: Annotated[
        list[str],
        argument(metavar="SCENE...|GLOB|DIR", help="Scenes, patterns, folders."),
    ],
    jobs: Annotated[
        int | None,
        option("--jobs", "-j", metavar="N", min=1, help="Processes at a time. [default: one a core]"),
    ] = None,
    out: Annotated[
        Path, option("--out", "-o", metavar="DIR", help="Results go to DIR/<scene>/<command>.")
    ] = Path("outputs"),
    junit: Annotated[Path | None, option("--junit", metavar="FILE", help="Write a JUnit XML report.")] = None,
    markdown: Annotated[
        Path | None, option("--markdown", metavar="FILE", help="Write a summary in Markdown.")
    ] = None,
    force: Annotated[bool, option("--force", help="Run again what is finished and unchanged.")] = False,
    overrides: Overrides = None,
    timeout: Annotated[
        float | None,
        option("--timeout", metavar="SECONDS", help="Time that each scene may take. [default: no limit]"),
    ] = None,
    no_plots: NoPlots = False,
    as_json: ReportAsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run many scenes, each by its own command; check them."""
    console = Console(as_json, quiet)

    def action() -> int:
        import functools
        import json
        import math
        import os
        import time

        from robodyn_cli.cli.worker import command_line
        from robodyn_cli.errors import CapabilityError
        from robodyn_cli.results.atomic import write_bytes
        from robodyn_cli.run.batch import reports
        from robodyn_cli.run.batch.batch import Batch
        from robodyn_cli.run.batch.entries import entries
        from robodyn_cli.run.batch.findings import worst
        from robodyn_cli.run.batch.gather import gather

        start = time.perf_counter()
        if timeout is not None and not 0.0 < timeout < math.inf:
            raise CapabilityError(f"--timeout: not a time (value {timeout:g}); allowed: a number > 0 [s]")
        settings = list(overrides or ())
        found = entries(gather(scenes), out, settings)
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        worker = functools.partial(command_line, not no_plots, settings)
        batch = Batch(found, jobs or cores, worker, not no_plots, force, timeout)
        width = max(len(e.name) for e in found)
        try:
            for e in batch.run():
                time_taken = "unchanged" if e.unchanged else f"{e.seconds:.2f} s"
                console.say(f"{e.verdict:<7} {e.name:<{width}}  {e.command or '-':<8} {time_taken:>9}")
                for problem in e.problems if e.verdict != "ok" else ():
                    console.say(f"        {problem}")
                if quiet and e.verdict == "error":
                    console.error(f"{e.name}: {'; '.join(e.problems)}")
        finally:
            # interrupted too, there is a report of what was done
            if junit is not None:
                write_bytes(junit, reports.junit(found))
            if markdown is not None:
                write_bytes(markdown, reports.markdown(found).encode())
        code = worst([e.exit_code for e in found])
        console.say(f"{reports.tally(found)}; {time.perf_counter() - start:.2f} s")
        status = "ok" if code == 0 else "failed"
        report = {"status": status, "exit_code": code, "scenes": [e.as_dict() for e in found]}
        console.data(json.dumps(report, ensure_ascii=False, indent=2))
        return code

    guarded(console, action)
