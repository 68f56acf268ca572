"""Entry point: other modules are imported only when an interrupt ends with its exit code."""

from __future__ import annotations

import gc
import os
import sys

from robodyn_cli.cli import interrupts
from robodyn_cli.threads import single_thread


def prepare_process() -> None:
    """Set up the process before the libraries are imported."""
    interrupts.leave_at_once()
    # imports and graphs make some hundred thousand objects and hardly any garbage: collect it less often
    gc.set_threshold(1_000_000, 20, 20)
    single_thread(os.environ)
    # drawings are files; matplotlib refuses to be imported under the backend of a notebook that is not installed
    os.environ["MPLBACKEND"] = "agg"
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # a terminal may lack letters


def main() -> None:
    """Run the command line; the exit codes are those of docs/cli.md."""
    prepare_process()
    from robodyn_cli.cli.app import run

    interrupts.end(run(sys.argv[1:]))
