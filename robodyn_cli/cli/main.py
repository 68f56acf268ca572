"""Entry point: nothing is imported before an interrupt can be met with its exit code."""

from __future__ import annotations

import gc
import os
import sys

from robodyn_cli.threads import single_thread

INTERRUPTED = 130


def main() -> None:
    """Run the command line; the exit code is the contract's (docs/cli.md)."""
    # imports and graphs make a hundred thousand objects and hardly any garbage: look for it less often
    gc.set_threshold(200_000, 20, 20)
    single_thread(os.environ)
    try:
        from robodyn_cli.cli.quick import run_plain

        run_plain(sys.argv[1:])
        from robodyn_cli.cli.app import app

        app()
    except KeyboardInterrupt:
        print("robodyn: error: interrupted", file=sys.stderr)
        raise SystemExit(INTERRUPTED) from None
    finally:
        # Python searches all that is in memory for cycles before it ends, a tenth of a small run's time
        gc.freeze()
